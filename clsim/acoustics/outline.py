"""Outlines of ellipsoids and capsules along lines of sight: their points, and how many of them a field takes.

Geometry is that of the body's own frame, m, with its centre at the origin.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Floats, read_only
from clsim.numerics.quaternions import cross_product

# Points of an outline beyond the turns of the phase along it, and the most points, those for (k a)^(2/3).
FEWEST_OF_ELLIPSOID, FEWEST_OF_CAPSULE, MOST_POINTS = 24.0, 40.0, (24.0, 15.0)
FLATTEST, OF_FLATNESS = 512.0, 4.0  # most points of flat ellipsoids, and those for a ratio of semi-axes of 1
NEAREST_END = 0.2  # of the largest radius: endpoints count as at least so far from an outline
NEAR_ROUNDS = (
    4  # of finding how near a line of sight passes an ellipsoid: within 3 % rms up to semi-axes of 10 to 1, by trial
)
LEAST = 1e-30
NEAR_AXIS = 0.1  # sine of the angle between line of sight and axis of a capsule below which its ends come together


@dataclass(frozen=True, slots=True, eq=False)
class OutlinePoints:
    """Points of outlines and the ellipses in which planes across them cut the body, each field (n, N).

    The plane of a point holds its normal (coordinate p) and the line of sight (coordinate q). In it the body is ``2 p /
    h + p^2 Q_nn + 2 p q Q_nz + q^2 Q_zz < 0``, with the point at the origin.
    """

    support: Floats  # h, distance of the tangent plane from the centre, m
    q_nn: Floats  # 1/m^2
    q_nz: Floats
    q_zz: Floats
    depth: Floats  # p of both endpoints, m; negative where the line of sight meets the body
    source: Floats  # q of the source, m
    receiver: Floats
    beside: Floats  # distance of the line of sight from the plane, m
    step: Floats  # length of outline that a point stands for, m


class Outline(Protocol):
    """Protocol of bodies with an outline."""

    @property
    def largest(self) -> Any:
        """Largest distance of the surface from the centre, m, or those of each line of sight (n,)."""
        ...

    @property
    def fewest(self) -> Any:
        """Points where the phase is the same all along the outline; this and the next also of each line of sight."""
        ...

    @property
    def sharpness(self) -> Any:
        """Points, of the fewest and of the most, because the outline has sharp ends."""
        ...

    def part(self, rows: NDArray[np.int64]) -> Outline:
        """Return that of some lines of sight."""
        ...

    def turning(self, source: Floats, receiver: Floats) -> Floats:
        """Bounds (n,) of the largest rate of the phase along `table`, in turns of the table, over wave numbers, m."""
        ...

    def table(self, count: int) -> Floats:
        """Points (6, count) along any line of sight: cosine, sine, sign, whether on a side, place there, share."""
        ...

    def points(self, source: Floats, receiver: Floats, count: int) -> OutlinePoints:
        """Points of the outline as seen along the lines between endpoints (n, 3), `count` for each line."""
        ...

    def clearance(self, source: Floats, receiver: Floats) -> tuple[Floats, Floats]:
        """Distances (n,) by which lines of sight (n, 3) pass it, about, m, and at which shares of their lengths.

        Distances are 0 or less where they meet it.
        """
        ...


@dataclass(frozen=True, slots=True, eq=False)
class EllipsoidOutline:
    """The outline of an ellipsoid with semi-axes (3,), m, or those of each line of sight (n, 3)."""

    semi_axes: Floats

    @property
    def sharpness(self) -> Any:
        """Points because edge-on the outline has sharp ends."""
        ratio = self.largest / self.semi_axes.min(axis=-1)
        return np.maximum(np.minimum(OF_FLATNESS * ratio, FLATTEST) - FEWEST_OF_ELLIPSOID, 0.0)

    @property
    def fewest(self) -> Any:
        """Points where the phase is the same all along the outline."""
        return FEWEST_OF_ELLIPSOID + self.sharpness

    @property
    def largest(self) -> Any:
        """Longest semi-axis, m."""
        return self.semi_axes.max(axis=-1)

    def turning(self, source: Floats, receiver: Floats) -> Floats:
        """Rates ``((A^2 - B^2) / 2 + y A) (1 / t1 + 1 / t2)`` (n,), m, with the semi-axes A and B of the outline."""
        sight, one, other = _frame(source, receiver)
        squared = self.semi_axes**2
        first, both, second = (_dot(x * y, squared) for x, y in ((one, one), (one, other), (other, other)))
        half = np.hypot(0.5 * (first - second), both)
        reach = np.sqrt(np.maximum(_dot(sight**2, squared) - 1.0 / _dot(sight**2, 1.0 / squared), 0.0))
        beside = np.hypot(_dot(source, one), _dot(source, other))
        long = np.sqrt(0.5 * (first + second) + half)
        return np.asarray((half + beside * long) * _nearness(self.largest, reach, sight, (source, receiver)))

    def part(self, rows: NDArray[np.int64]) -> EllipsoidOutline:
        """Return that of some lines of sight."""
        return EllipsoidOutline(self.semi_axes[rows]) if self.semi_axes.ndim > 1 else self

    def table(self, count: int) -> Floats:
        """Cosine and sine of the eccentric angle, and the share of a turn, of points (6, count)."""
        return _turns_of_ellipse(count)

    def clearance(self, source: Floats, receiver: Floats) -> tuple[Floats, Floats]:
        """Distances (n,) of lines of sight from their nearest points on the surface.

        The surface's point nearest to one at p is ``a^2 p / (a^2 + l)`` with semi-axes a. Newton's rule finds l by the
        reciprocal norm, which is about straight in l (J. J. More, D. C. Sorensen, SIAM J. Sci. Stat. Comput. 4 (1983),
        553); the line's point nearest to that follows. The first is that of the unit sphere in affine coordinates.
        """
        along, squared, lift = receiver - source, self.semi_axes**2, np.zeros((len(source), 1))
        scale, foot = squared, np.zeros_like(source)
        for _ in range(NEAR_ROUNDS):
            level = np.maximum(np.sum(along**2 / scale, axis=1), LEAST)
            share = np.clip(np.sum((foot - source) * along / scale, axis=1) / level, 0.0, 1.0)
            nearest, scale = source + share[:, None] * along, np.ones(3)
            bent = nearest / (squared + lift)
            size = np.sqrt(_dot(bent**2, squared))[:, None]
            slope = np.sum(squared * bent**2 / (squared + lift), axis=1, keepdims=True)
            lift = np.maximum(lift + (size - 1.0) * size**2 / np.maximum(slope, LEAST), 0.0)
            foot = nearest * squared / (squared + lift)
        return np.linalg.norm(nearest - foot, axis=1), np.asarray(share)

    def points(self, source: Floats, receiver: Floats, count: int) -> OutlinePoints:
        """Points at equal eccentric angles of the ellipse that is the body's projection along the line of sight.

        With the projection B of the squared axes that ellipse is the root of B times a unit circle.
        """
        sight, one, other = _frame(source, receiver)
        squared, pairs = self.semi_axes**2, ((one, one), (one, other), (other, other))
        first, both, second = wide = [_dot(x * y, squared)[:, None] for x, y in pairs]
        area = np.sqrt(first * second - both**2)
        size = np.sqrt(first + second + 2.0 * area)
        cosine, sine, _, _, _, share = self.table(count)
        a, b, c = (second + area) * cosine - both * sine, (first + area) * sine - both * cosine, (first + area) * sine
        speed = np.hypot(both * cosine - c, a) / size
        length = np.hypot(a, b)
        u, v = a / length, b / length
        support = np.sqrt(_quadratic(wide, u, v))
        slant = [_dot(axis * sight, squared)[:, None] for axis in (one, other)]
        up = (slant[0] * u + slant[1] * v) / support
        across = ((wide[2] - wide[0]) * u * v + wide[1] * (u * u - v * v)) / support
        sharp = [_dot(x * y, 1.0 / squared)[:, None] for x, y in (*pairs, (one, sight), (other, sight), (sight, sight))]
        along, aside, behind, ahead = _seen((sight, one, other), source, receiver)
        return OutlinePoints(
            support, _quadratic(sharp, u, v), sharp[3] * u + sharp[4] * v, np.broadcast_to(sharp[5], u.shape),
            u * along + v * aside - support, behind - up, ahead - up, u * aside - v * along - across, share * speed,
        )  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class CapsuleOutline:
    """The outline of a cylinder about z with half spheres at its ends; radius and half of the cylinder's length, m.

    Both may be those of each line of sight (n,): one call then serves many capsules.
    """

    radius: Floats | float
    half: Floats | float
    fewest: ClassVar[float] = FEWEST_OF_CAPSULE
    sharpness: ClassVar[float] = 0.0

    @property
    def largest(self) -> Any:
        """Half of the whole length, m."""
        return self.radius + self.half

    def part(self, rows: NDArray[np.int64]) -> CapsuleOutline:
        """Return that of some lines of sight."""
        each = (size[rows] if isinstance(size, np.ndarray) else size for size in (self.radius, self.half))
        return CapsuleOutline(*each)

    def turning(self, source: Floats, receiver: Floats) -> Floats:
        """Rates (n,), m, of the sides or of the half circles, whichever are larger; a quarter of the table on each."""
        sight, one, other = self._frame(source, receiver)
        sine = np.hypot(sight[:, 0], sight[:, 1])
        half = self._apart(sine)
        side = 2.0 * half * sine
        along, aside = (np.abs(np.sum(source * axis, axis=1)) for axis in (one, other))
        most = np.maximum(
            side * (0.4625 * side + 2.0 * along), 2.0 * math.pi * self.radius * np.hypot(aside, along + 0.5 * side)
        )
        reach = half * np.abs(sight[:, 2])
        return np.asarray(most * (2.0 / math.pi) * _nearness(self.largest, reach, sight, (source, receiver)))

    def table(self, count: int) -> Floats:
        """Points (6, count) on two half circles and the sides between them: a quarter on each, fewer towards its ends.

        First the half circle about the axis as seen, from one side to the other; then that side from there backwards.
        """
        return _pieces_of_capsule(count)

    def clearance(self, source: Floats, receiver: Floats) -> tuple[Floats, Floats]:
        """Distances (n,) of lines of sight from the side's middle line, less the radius."""
        along = receiver - source
        level, slope, length = np.sum(along**2, axis=1), along[:, 2], np.sum(source * along, axis=1)
        parted = np.maximum(level - slope**2, 1e-12 * level + LEAST)
        height = np.clip((source[:, 2] * level - slope * length) / parted, -self.half, self.half)
        share = np.clip((height * slope - length) / np.maximum(level, LEAST), 0.0, 1.0)
        height = np.clip(source[:, 2] + share * slope, -self.half, self.half)
        apart = source + share[:, None] * along
        apart[:, 2] -= height
        return np.asarray(np.linalg.norm(apart, axis=1) - self.radius), np.asarray(share)

    def points(self, source: Floats, receiver: Floats, count: int) -> OutlinePoints:
        """Points on both half circles and both sides.

        With ``x = u - sin(2 pi u) / (2 pi)`` on each, sums converge as those over a smooth closed curve nearly do.
        Along the line of sight sides are no longer than the body: beyond its ends endpoints may lie in the cylinder.
        """
        sight, one, other = self._frame(source, receiver)
        sine = np.hypot(sight[:, 0], sight[:, 1])
        half = self._apart(sine)[:, None]
        cosine, rise, sign, on_side, at, share = self.table(count)
        u, v, up = sign * cosine, sign * rise, sign * at * half  # of the half circle, along the axis
        radius = np.broadcast_to(np.reshape(self.radius, (-1, 1)), up.shape)
        along, aside, behind, ahead = _seen((sight, one, other), source, receiver)
        upright, slanted, forward = (axis[:, 2:] for axis in (one, other, sight))
        curved = 1.0 / radius**2
        straight = np.maximum(sine**2, (self.radius / self.largest) ** 2)[:, None]
        return OutlinePoints(
            radius, curved, np.zeros_like(up), np.where(on_side > 0.0, straight * curved, curved),
            u * along + v * aside - radius - up * (u * upright + v * slanted), behind - up * forward,
            ahead - up * forward, u * aside - v * along - up * (u * slanted - v * upright),
            share * np.where(on_side > 0.0, 2.0 * half * sine[:, None], math.pi * radius),
        )  # fmt: skip

    def _apart(self, sine: Floats) -> Floats:
        """Half of the distance (n,) of both half circles along the axis, m, by its angle to the line of sight.

        Along the axis they are one circle, whose halves belong to neither end: at its middle, our own choice.
        """
        return self.half * faded(sine, (NEAR_AXIS, 0.0))

    @staticmethod
    def _frame(source: Floats, receiver: Floats) -> tuple[Floats, Floats, Floats]:
        """Return unit vectors (n, 3): the line of sight, and across it the axis as seen, the middle of half circles."""
        sight, one, _ = _frame(source, receiver)
        axis = np.array([0.0, 0.0, 1.0]) - sight[:, 2:] * sight
        sine = np.linalg.norm(axis, axis=1)
        one = np.where(sine[:, None] > 1e-9, axis / np.maximum(sine, LEAST)[:, None], one)
        return sight, one, cross_product(sight, one)


@lru_cache(maxsize=64)
def _turns_of_ellipse(count: int) -> Floats:
    """Points of `EllipsoidOutline.table`."""
    turn, ones = (np.arange(count) + 0.5) * (2.0 * math.pi / count), np.ones(count)
    return read_only(
        np.stack([np.cos(turn), np.sin(turn), ones, 0.0 * ones, 0.0 * ones, (2.0 * math.pi / count) * ones])
    )


@lru_cache(maxsize=64)
def _pieces_of_capsule(count: int) -> Floats:
    """Points of `CapsuleOutline.table`."""
    piece, within = np.divmod(np.arange(count), count // 4)
    u = (within + 0.5) / (count // 4)
    at, dense = u - np.sin(2.0 * math.pi * u) / (2.0 * math.pi), 1.0 - np.cos(2.0 * math.pi * u)
    on_side = piece % 2 == 1
    turn = np.where(on_side, 0.5 * math.pi, math.pi * (at - 0.5))
    along = np.where(on_side, 1.0 - 2.0 * at, 1.0)
    sign = np.where(piece >= 2, -1.0, 1.0)
    return read_only(np.stack([np.cos(turn), np.sin(turn), sign, on_side, along, dense / (count // 4)]))


def _frame(source: Floats, receiver: Floats) -> tuple[Floats, Floats, Floats]:
    """Return unit vectors (n, 3): from source to receiver, and two across."""
    sight = receiver - source
    sight = sight / np.maximum(np.linalg.norm(sight, axis=1), LEAST)[:, None]
    one = cross_product(sight, np.eye(3)[np.abs(sight).argmin(axis=1)])
    one /= np.linalg.norm(one, axis=1)[:, None]
    return sight, one, cross_product(sight, one)


def _dot(one: Floats, other: Floats) -> Floats:
    """Products (n,) of vectors (n, 3), or of such and one (3,)."""
    return np.asarray(np.sum(one * other, axis=-1))


def _quadratic(form: list[Floats], u: Floats, v: Floats) -> Floats:
    """Values (n, N) of forms (n, 1) of unit vectors across the line of sight."""
    return np.asarray(form[0] * u * u + 2.0 * form[1] * u * v + form[2] * v * v)


def _seen(frame: tuple[Floats, Floats, Floats], source: Floats, receiver: Floats) -> Iterator[Floats]:
    """Coordinates (n, 1) of the line of sight across it, and of both endpoints along it, m."""
    sight, one, other = frame
    for place, axis in ((source, one), (source, other), (source, sight), (receiver, sight)):
        yield _dot(place, axis)[:, None]


def _nearness(largest: Any, reach: Floats, sight: Floats, ends: tuple[Floats, Floats]) -> Floats:
    """Sum ``1 / t`` (n,), 1/m, over distances t of endpoints (n, 3) from outlines that reach so far (n,) along."""
    along = [sign * np.sum(end * sight, axis=1) - reach for sign, end in zip((-1.0, 1.0), ends, strict=True)]
    first, second = (np.maximum(t, NEAREST_END * largest) for t in along)
    return np.asarray(1.0 / first + 1.0 / second)


def most_points(outline: Outline, wave: float) -> Any:
    """Return the most points that outlines take at a largest wave number, 1/m; our own choice."""
    return MOST_POINTS[0] + outline.sharpness + MOST_POINTS[1] * (wave * outline.largest) ** (2.0 / 3.0)


def steps_of_points(most: float) -> list[tuple[float, int]]:
    """Return numbers of points up to which as many or a few more are taken: quarter octaves; our own choice."""
    last = max(math.ceil(4.0 * math.log2(most / 8.0)), 0)
    return [(8.0 * 2.0 ** (0.25 * step), 8 * math.ceil(2.0 ** (0.25 * step))) for step in range(last + 1)]


def counts_of_points(outline: Outline, wave: float, source: Floats, receiver: Floats) -> NDArray[np.int64]:
    """Points (n,) of an outline as seen along lines between endpoints (n, 3), at a largest wave number, 1/m.

    A sum over N evenly spaced points of a closed curve is right but for Fourier coefficients of orders from N on
    (L. N. Trefethen, J. A. C. Weideman, SIAM Rev. 56, 2014, section 2). Those of a phase end little above its turns at
    its largest rate. With `fewest` more, fields are within 5e-4 of the free one; grazing lines near small bodies 2e-3.
    """
    requested = outline.fewest + wave * outline.turning(source, receiver)
    most = most_points(outline, wave)
    limits, counts = (np.array(column) for column in zip(*steps_of_points(float(np.max(most))), strict=True))
    step = np.searchsorted(limits, np.minimum(requested, most))
    return np.asarray(counts[np.minimum(step, len(limits) - 1)])


def eased(x: Floats, ends: tuple[float, float]) -> Floats:
    """Go from 1 at the first of two numbers to 0 at the second, with a continuous second derivative."""
    part = np.clip((x - ends[1]) / (ends[0] - ends[1]), 0.0, 1.0)
    return np.asarray(part**3 * (10.0 + part * (6.0 * part - 15.0)))


def faded(x: Floats, ends: tuple[float, float]) -> Floats:
    """Go from 1 at the first of two numbers to 0 at the second, smoothly."""
    part = np.clip((x - ends[1]) / (ends[0] - ends[1]), 0.0, 1.0)
    return np.asarray(part * part * (3.0 - 2.0 * part))
