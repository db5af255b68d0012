"""Sound over two edges of a face that meet at a corner, off the planes in which it would graze the face."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from clsim.acoustics.diffraction import ON_LINE, transition
from clsim.arrays import Floats

_POINTS = 32  # of the angle between the edges: -90 dB of the field where phases of grazing are above 1


@dataclass(frozen=True, slots=True, eq=False)
class CornerLeg:
    """How sound goes from a corner to an endpoint, as the edge on that endpoint's side sees it.

    Attributes
    ----------
    n : ndarray (P, 1)
        Exterior angle over π.
    r, z : ndarray (P, T)
        Distance of the endpoint from the edge, and place along it from the corner, positive where the edge is, m.
    turn : ndarray (P, T)
        Angle from the endpoint to the face that both edges share, rad.
    shares : list of ndarray (P, T, F)
        Factors of the terms of ``π + turn`` and of ``π - turn``.
    """

    n: Floats
    r: Floats
    z: Floats
    turn: Floats
    shares: list[Any]

    @property
    def length(self) -> Floats:
        """Lengths (P, T), m."""
        return np.maximum(np.hypot(self.r, self.z), ON_LINE)

    def directed(self, cosine: Floats) -> Any:
        """Field (P, T, F) sent in a direction along the face, of a cosine (P, 1) to the edge, see `meeting_field`."""
        sine, across = np.sqrt(np.maximum(1.0 - cosine**2, 1e-12)), self.r / self.length
        cosh = (1.0 + cosine * self.z / self.length) / np.maximum(sine * across, 1e-12)
        cosh = np.cosh(np.arccosh(np.maximum(cosh, 1.0)) / self.n)
        angles = (np.pi + self.turn) / self.n, (np.pi - self.turn) / self.n
        terms = (np.sin(angle) / np.maximum(cosh - np.cos(angle), 1e-12) for angle in angles)
        return sum(term[..., None] * share for term, share in zip(terms, self.shares, strict=True))


def meeting_field(legs: tuple[CornerLeg, CornerLeg], cosine: Floats, wave: Floats) -> Any:
    """Compute the field (P, T, F) over both edges by a corner, over the phase of the path by the corner, 1/m.

    Shapes: cosine (P, 1) between the edges, both from the corner on; wave (P, T, F) 1/m.

    Our own derivation: the line integral of U. P. Svensson, R. I. Fred and J. Vanderkooy, J. Acoust. Soc. Am. 106(5),
    1999, eq. 27, along both edges, over the places ``ρ cos ψ`` and ``ρ sin ψ`` on them. Directions of sound depend on
    ψ alone, and the phase is a parabola of ρ, so that the integral over ρ is a `transition`. It is exact far from
    the edges; it has both the path over the corner and the path over both edges, if there is one near the corner.
    """
    (one, other), total = legs, np.zeros(wave.shape, dtype=np.complex128)
    along = [leg.z / leg.length for leg in legs]
    bends = [(1.0 - x**2) / leg.length for x, leg in zip(along, legs, strict=True)]
    for point, weight in zip(*_points(), strict=True):
        a, b = np.cos(point), np.sin(point)
        between = np.sqrt(np.maximum(1.0 - 2.0 * a * b * cosine, 1e-12))
        slope = between - a * along[0] - b * along[1]
        bend = a**2 * bends[0] + b**2 * bends[1]
        sent = one.directed((b * cosine - a) / between) * other.directed((a * cosine - b) / between)
        scale = np.sqrt(2.0 * bend)[..., None] * np.sqrt(wave)
        total += sent * transition(slope[..., None] * wave / scale) / scale * (weight / between)[..., None]
    shape = np.sqrt(-1j * np.pi) / (4.0 * np.pi) ** 2 / (one.n * other.n * one.length * other.length)
    return total * shape[..., None]


@cache
def _points() -> tuple[Floats, Floats]:
    """Angles and weights of Gauss's rule from 0 to a quarter turn."""
    x, weight = np.polynomial.legendre.leggauss(_POINTS)
    return 0.25 * np.pi * (x + 1.0), 0.25 * np.pi * weight
