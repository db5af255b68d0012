"""Sound at edges, exactly: the integral of Biot, Tolstoy, Medwin and Svensson, with the time convention ``exp(+jωt)``.

Coordinates and the four terms are those of `clsim.acoustics.diffraction`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from clsim.acoustics.diffraction import TERMS, transition

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import ArrayLike

    from clsim.acoustics.diffraction import EdgeWay
    from clsim.arrays import Complexes, Floats

_POINTS = 40  # of the contour; steps stay below 0.2, which leaves exp(-2π 0.57 / 0.2) = -155 dB
_FADED = 20.0  # exponent of the fall along the contour at which it is left
_ROOT_J = np.exp(0.25j * np.pi)


def exact_wedge_terms(
    n: ArrayLike, angles: Floats, lit: ArrayLike, source_r: Floats, receiver_r: Floats, way: EdgeWay, wave: Floats
) -> list[Complexes]:
    """Return the four terms of the exact field at a hard wedge, each (..., F), over ``exp(-jkL) / L``.

    Shapes: angles (..., 4); lit (..., 4); wave (..., F) 1/m.

    lit: 1 for partners that are taken as seen, also shortly beyond the boundary, -1 for others.

    The integral along an infinite edge of U. P. Svensson, R. I. Fred and J. Vanderkooy, "An analytic secondary source
    model of edge diffraction impulse responses", J. Acoust. Soc. Am. 106(5), 1999, eq. 27 and 30, over the length ``L -
    jv²`` in place of the place on the edge: there ``exp(-jkp)`` falls as ``exp(-kv²)`` and does not turn. What a term
    has as its pole, where that length is the partner's R, is integrated in closed form, ``E(√(k (L - R))) L / 2R``; the
    rest is smooth, also on the boundary. Half-way rule in u of ``v = a sinh u``, with a fine enough for the highest
    wave number and the wedge, and an end where the lowest has fallen.
    """
    n = np.asarray(n, dtype=np.float64)[..., None]
    angle = angles - 2.0 * n * np.pi * np.round(angles / (2.0 * n * np.pi))
    side = np.where(angle >= 0.0, 1.0, -1.0)
    lit = np.where(np.abs(angles) <= n * np.pi, lit, side)
    length, product = way.length[..., None], (source_r * receiver_r)[..., None]
    shorter = 4.0 * product * np.sin(0.5 * angle) ** 2
    direct = np.sqrt(np.maximum(length**2 - shorter, 1e-30 * length**2))
    detour = shorter / (length + direct)
    has_pole = np.abs(angle) < np.pi
    v, step = _contour(way, wave)
    rests = _integrands(n, angle, length, product, v)
    fall = step[..., None] * np.exp(-(v**2)[..., None] * wave[..., None, :])
    found = []
    for term in range(TERMS):
        pole = np.where(has_pole, side * length / direct, 0.0)[..., term, None]
        root = np.sqrt(detour[..., term, None])
        rest = next(rests) + pole * _ROOT_J / np.pi * root / (v**2 + 1j * detour[..., term, None])
        both = np.stack([rest.real, rest.imag], axis=-2) @ fall
        seen = lit[..., term, None]
        closed = transition(seen * side[..., term, None] * root * np.sqrt(wave))
        found.append(both[..., 0, :] + 1j * both[..., 1, :] - 0.5 * seen * np.abs(pole) * closed)
    return found


def _contour(way: EdgeWay, wave: Floats) -> tuple[Floats, Floats]:
    """Return the points v (..., points) of the contour, roots of m, and their weights."""
    finest = np.minimum(np.sqrt(way.breadth), 1.0 / np.sqrt(wave.max(axis=-1)))
    last = np.arcsinh(np.sqrt(_FADED / wave.min(axis=-1)) / finest)
    spacing = (last / _POINTS)[..., None]
    u = spacing * (np.arange(_POINTS) + 0.5)
    return finest[..., None] * np.sinh(u), finest[..., None] * spacing * np.cosh(u)


def _integrands(n: Floats, angle: Floats, length: Floats, product: Floats, v: Floats) -> Iterator[Complexes]:
    """Yield what is integrated over v (..., points) for each term, without its fall."""
    both = 2.0 * length - 1j * v**2  # p + L
    half = v / _ROOT_J * np.sqrt(both / (4.0 * product))  # sinh(η / 2)
    eta = 2.0 * np.arcsinh(half)
    common = -length / (np.pi * n * _ROOT_J) / (np.sqrt(both * product) * np.sqrt(1.0 + half**2))
    squared = np.sinh(0.5 * eta / n) ** 2
    for term in range(TERMS):
        turn = angle[..., term, None] / n
        yield common * np.sin(turn) / (2.0 * (squared + np.sin(0.5 * turn) ** 2))
