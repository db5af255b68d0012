"""Ways of sound over two edges with open air between them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from clsim.acoustics.diffraction import ON_LINE, off_line, path_over_edge
from clsim.arrays import Floats

End = tuple[Floats, Floats]

STEPS = 80  # of the search for places on both edges
FOUND = 1e-11  # of the least leg: the last step along the edges
NEWTON = 0.2  # of the least leg: steps that are shorter are Newton's


@dataclass(frozen=True, slots=True, eq=False)
class Crossing:
    """The shortest ways over two edges, each array (...)."""

    places: tuple[Floats, Floats]  # where they meet the edges, m from their starts
    legs: tuple[Floats, Floats, Floats]  # lengths before, between and behind the edges, m
    away: Floats  # (..., 3) from the places on the last edges to those on the first, m
    slides: tuple[Floats, Floats]  # m by which the places go where both ends go 1 m, at most, to first order

    @property
    def length(self) -> Floats:
        """Lengths of the whole ways (...), m."""
        before, between, behind = self.legs
        return before + between + behind


@dataclass(frozen=True, slots=True, eq=False)
class EdgeGap:
    """Pairs of edges (...), the last ones as the first see them by the walls between.

    Shapes: first, last (..., 4, 3), see `Edges.frames`; n (...), exterior angles over π.
    """

    first: Floats
    last: Floats
    n: tuple[Floats, Floats]

    def cross(self, source: End, receiver: End) -> Crossing:
        """Find the shortest ways between ends at distances r and heights z (...) about the first and the last edges, m.

        Their length is convex in both places. Either of these is that of a way over one edge where the other one is
        given; near the end both are found together, by Newton's method.
        """
        (r_s, z_s), (r_r, z_r) = ((np.maximum(r, ON_LINE), z) for r, z in (source, receiver))
        offset, along = self.first[..., 0, :] - self.last[..., 0, :], (self.first[..., 3, :], self.last[..., 3, :])
        pairs = [_dot(offset, offset), _dot(offset, along[0]), _dot(offset, along[1]), _dot(along[0], along[1])]
        given = [np.broadcast_to(x, r_s.shape).ravel() for x in (r_s, z_s, r_r, z_r, *pairs)]
        u, v = _parallel(*given)
        slides, left = np.empty((2, len(u))), np.arange(len(u))
        for _ in range(STEPS):
            some = [x[left] for x in given]
            u[left], v[left], found, slides[:, left] = _nearer(u[left], v[left], *some)
            left = left[~found]
            if not len(left):
                break
        u, v = u.reshape(r_s.shape), v.reshape(r_s.shape)
        away = offset + u[..., None] * along[0] - v[..., None] * along[1]
        legs = np.hypot(r_s, u - z_s), np.maximum(np.sqrt(_dot(away, away)), ON_LINE), np.hypot(r_r, v - z_r)
        return Crossing((u, v), legs, away, (slides[0].reshape(r_s.shape), slides[1].reshape(r_s.shape)))

    def angles(self, away: Floats) -> tuple[Floats, Floats, Floats]:
        """Angles (...) of the way between about either edge, and the cosine between their directions.

        away: (..., 3) as of `Crossing`.
        """
        found: list[Floats] = []
        towards: list[Any] = []
        for frame, n, sign in ((self.first, self.n[0], -1.0), (self.last, self.n[1], 1.0)):
            x, y = (sign * _dot(away, frame[..., axis, :]) for axis in (1, 2))
            angle = off_line(n, x, y, 0.5 * np.pi * (n - 2.0))[1]
            found.append(angle)
            towards.append(np.cos(angle)[..., None] * frame[..., 2, :] - np.sin(angle)[..., None] * frame[..., 1, :])
        return found[0], found[1], np.sum(towards[0] * towards[1], axis=-1)


def _dot(a: Floats, b: Floats) -> Floats:
    return np.asarray(np.einsum("...i,...i->...", a, b))


def _parallel(
    r_s: Floats, z_s: Floats, r_r: Floats, z_r: Floats, square: Floats, first: Floats, last: Floats, cosine: Floats
) -> tuple[Floats, Floats]:
    """Places (n,) to begin with: those of edges that are parallel; of offsets as `_nearer`, m."""
    sign = np.where(cosine < 0.0, -1.0, 1.0)
    across = r_s + np.sqrt(np.maximum(square - first**2, 0.0))
    slope = (sign * z_r - first - z_s) / (across + r_r)
    return np.asarray(z_s + slope * r_s), np.asarray(sign * (z_s + slope * across + first))


def _nearer(
    u: Floats, v: Floats, r_s: Floats, z_s: Floats, r_r: Floats, z_r: Floats, square: Floats, first: Floats,
    last: Floats, cosine: Floats,
) -> tuple[Floats, Floats, Any, Floats]:  # fmt: skip
    """Places (n,) nearer to those of the shortest ways than u and v, m, whether they are these, and `Crossing.slides`.

    square, first, last: of the offset from the start of the last edge to that of the first, and along both, m.
    """
    s, t = np.hypot(r_s, u - z_s), np.hypot(r_r, v - z_r)
    one, other = first + u - v * cosine, last + u * cosine - v  # parts of the way between along both edges
    apart = np.maximum(square + u**2 + v**2 + 2.0 * (u * first - v * last - u * v * cosine), ON_LINE**2)
    between = np.sqrt(apart)
    slope = (u - z_s) / s + one / between, (v - z_r) / t - other / between
    a, d = r_s**2 / s**3 + (1.0 - one**2 / apart) / between, r_r**2 / t**3 + (1.0 - other**2 / apart) / between
    b = -(cosine - one * other / apart) / between
    determinant = np.maximum(a * d - b**2, 1e-300)
    step = np.stack([d * slope[0] - b * slope[1], a * slope[1] - b * slope[0]]) / determinant
    longest, scale = np.max(np.abs(step), axis=0), np.minimum(np.minimum(s, t), between)
    near, moves = longest <= NEWTON * scale, (r_s / s**2, r_r / t**2)
    slides = np.stack([d * moves[0] + np.abs(b) * moves[1], a * moves[1] + np.abs(b) * moves[0]]) / determinant
    # Where that is far, each in turn with the other one as it is.
    place = path_over_edge(r_s, z_s, _off(apart, one), u - one).apex
    one, other = first + place - v * cosine, last + place * cosine - v
    apart = square + place**2 + v**2 + 2.0 * (place * first - v * last - place * v * cosine)
    behind = path_over_edge(r_r, z_r, _off(apart, other), v + other).apex
    found = near & (longest <= FOUND * scale)
    return np.where(near, u - step[0], place), np.where(near, v - step[1], behind), found, slides


def _off(square: Floats, along: Floats) -> Floats:
    """Distances (n,) from a line of what is so far off, squared, and so far along it, at least `ON_LINE`, m."""
    return np.asarray(np.sqrt(np.maximum(square - along**2, ON_LINE**2)))
