"""Bounds of how fast bodies and ends move, turn and speed up between any two times."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import ByRow, Floats, by_value, read_only
from clsim.numerics.quaternions import cross_product, rotate
from clsim.paths.legs.mirrors import FARTHEST
from clsim.scene.body import Body
from clsim.scene.motion.curves import CONTINUATION
from clsim.scene.motion.motion import Motion, seen_by

_CELL = 1e-3  # s, in each of which motions are bounded
_MOST_CELLS = 1_000_000
_SLICE = 16_384  # cells bounded at a time
_APART = 0.01  # of a cell; nearer to where velocities jump none begins
# What an error in the middle of a cubic says of its derivatives, and twice.
_SPEED_SPARE, _ACCELERATION_SPARE = 8.0, 64.0
_BEFORE = 0.06  # s, before the earliest emission

_ROUNDING = 1e-9  # m/s, rad/s
_GRAZE = 1e-6  # m
GRAZE_TIME = 0.5e-3  # s
FAR = 1e30  # m, s, next to no bound


def lasts(distance: Floats, speed: Floats) -> Floats:
    """Return for how long distances (n,), m, last at speeds (n,), m/s; s."""
    moves = speed > 0.0
    return np.asarray(np.where(moves, np.minimum(distance / np.where(moves, speed, 1.0), FAR), FAR))


def taken_for(sure: Floats, fastest: Floats) -> Floats:
    """Return for how long what looks on both sides agree in is taken to be so, (n,) s."""
    return np.where(sure * fastest < _GRAZE, GRAZE_TIME, 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class Middle:
    """The middle of a body, from which its motion is bounded."""

    place: Floats  # (3,) in the body's own coordinates, m
    # How far points of the body are from it at most, and from axes through it about which the body turns, m.
    radius: float
    lever: float  # likewise
    limit: float  # the same of places at which mirrors are taken from the body's motion, m
    fastest: float  # bound of the speed of any point of the body, m/s


@lru_cache(maxsize=256)
def middle_of(body: Body) -> Middle:
    """Return the middle of a body."""
    corners, turning = body.mesh.vertices, body.trajectory.turning
    place = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
    away = corners - place
    lever = 0.0 if turning is None else turning.lever(away)
    limit = FARTHEST * body.radius + float(np.linalg.norm(place))
    return Middle(read_only(place), float(np.linalg.norm(away, axis=1).max()), lever, limit, body.peak_speed)


@dataclass(frozen=True, slots=True, eq=False)
class Peaks:
    """Largest values over cells of time, over pairs of these, and so on."""

    bounds: Floats  # (cells + 1,) of the cells, s; before and beyond, the first and the last cell's values hold
    levels: tuple[Floats, ...]  # largest of q values over 1, 2, 4, … cells

    @staticmethod
    def of(bounds: Floats, values: Floats) -> Peaks:
        """Return the peaks of values (cells, q)."""
        levels = [values]
        while len(levels[-1]) > 1:
            level = levels[-1]
            even = level[: len(level) // 2 * 2]
            levels.append(np.concatenate([np.maximum(even[::2], even[1::2]), level[len(even) :]]))
        return Peaks(read_only(bounds), tuple(read_only(level) for level in levels))

    def over(self, begin: Floats, end: Floats) -> Floats:
        """Return the largest values (n, q) between two times (n,)."""
        last = len(self.levels[0]) - 1
        a, b = (np.clip(np.searchsorted(self.bounds, t, "right") - 1, 0, last) for t in (begin, end))
        level = np.zeros(len(a), dtype=np.int64)
        while np.any(wide := b - a > 1):
            a, b, level = np.where(wide, a // 2, a), np.where(wide, b // 2, b), level + wide
        found = np.empty((len(a), self.levels[0].shape[1]))
        for each, rows in by_value(level):
            found[rows] = np.maximum(self.levels[each][a[rows]], self.levels[each][b[rows]])
        return found


@dataclass(frozen=True, slots=True, eq=False)
class Pace(ByRow):
    """Bounds over n stretches of time, of B bodies and two ends."""

    half: Floats  # (n,) half of each stretch of times of reception, s
    source: Floats  # (n,) speeds of the ends, m/s
    receiver: Floats  # likewise
    speed: Floats  # (n, B) speeds of the middles of bodies, m/s, and angular velocities, rad/s
    turn: Floats  # likewise
    # (n, B) accelerations of the middles, m/s², and by how much those of other points may differ for each metre, 1/s².
    gain: Floats
    lift: Floats  # (n, B) likewise
    # (n, B) by how much velocities of the middles, m/s, and angular velocities, rad/s, jump within them in all.
    jolt: Floats
    twist: Floats  # (n, B) likewise
    held: NDArray[np.bool_]  # (n, B, 2) whether bodies hold source and receiver where they are

    @property
    def all_lengths(self) -> Floats:
        """Sum (n,) of the speeds of all that moves, of points a metre from where bodies turn, m/s."""
        return np.asarray(self.source + self.receiver + np.sum(self.speed + self.turn, axis=1))

    def unless_jumps(self, sure: Floats) -> Floats:
        """Return times (n,) for which something is certain, s; 0 for those that end before a jump of velocities may."""
        jumps = np.any((self.jolt > 0.0) | (self.twist > 0.0), axis=1)
        return np.where(jumps & (sure < self.half), 0.0, sure)


@dataclass(frozen=True, slots=True, eq=False)
class BodyRates:
    """How fast bodies move and turn."""

    bodies: tuple[Body, ...]  # of the scene
    peaks: tuple[Peaks, ...]  # for each body those of speed, turn, gain and lift; see `Pace`
    jumps: tuple[Floats, ...]  # for each body sums of jolt and twist up to each bound of its cells
    first: float  # between which they are known, s
    last: float  # likewise

    @staticmethod
    def of(bodies: Sequence[Body], longest: float, last: float) -> BodyRates:
        """Return those of bodies, from a longest delay before 0 s to a last time, s."""
        first = -longest - _BEFORE
        found = [_body_cells(body, first, last) for body in bodies]
        return BodyRates(tuple(bodies), tuple(p for p, _ in found), tuple(j for _, j in found), first, last)

    def of_ends(self, source: Motion, receivers: Sequence[Motion]) -> EndRates:
        """Return those of a source and of receivers as well."""
        own = tuple(_end_cells(end, self.first, self.last) for end in (source, *receivers))
        held = [[seen_by(body.trajectory, end).is_static for body in self.bodies] for end in (source, *receivers)]
        pairs = [np.stack([held[0], other], axis=1) for other in held[1:]]
        return EndRates(self, own[0], own[1:], np.array(pairs))


@dataclass(frozen=True, slots=True, eq=False)
class EndRates:
    """How fast bodies, a source and receivers move."""

    bodies: BodyRates  # of all bodies
    source: Peaks  # of the speed of the source
    receivers: tuple[Peaks, ...]  # of the speeds of R receivers
    held: NDArray[np.bool_]  # (R, B, 2) whether bodies hold the source and each receiver where they are

    def over(self, receiver: NDArray[np.int64], emitted: Floats, middle: Floats, half: Floats) -> Pace:
        """Return bounds for what receivers (n,) hear within `half` of times (n,), emitted from others (n,) on, s."""
        count, end, table = len(middle), middle + half, self.bodies
        columns = np.zeros((6, count, len(table.bodies)))
        for i, (peaks, jumps) in enumerate(zip(table.peaks, table.jumps, strict=True)):
            columns[:4, :, i] = peaks.over(emitted, end).T
            later, before = np.searchsorted(peaks.bounds, end, "right"), np.searchsorted(peaks.bounds, emitted, "left")
            columns[4:, :, i] = (jumps[later] - jumps[before]).T
        received, source = np.empty(count), self.source.over(emitted, end)[:, 0]
        for ear, rows in by_value(receiver):
            received[rows] = self.receivers[ear].over(emitted[rows], end[rows])[:, 0]
        speed, turn, gain, lift, jolt, twist = columns
        return Pace(half, source, received, speed, turn, gain, lift, jolt, twist, self.held[receiver])


@lru_cache(maxsize=16)
def _end_cells(motion: Motion, first: float, last: float) -> Peaks:
    if motion.is_static:
        return Peaks.of(np.array([first, last]), np.zeros((1, 1)))
    bounds = _cells(first, last, np.empty(0))
    return Peaks.of(bounds, motion.speed_over(bounds[:-1], bounds[1:])[:, None])


def _cells(first: float, last: float, breaks: Floats) -> Floats:
    """Return bounds of cells, of which one is each of some times at which velocities may jump."""
    count = min(max(math.ceil((last - first) / _CELL), 1), _MOST_CELLS)
    even, step = np.linspace(first, last, count + 1), (last - first) / count
    breaks = np.unique(breaks[(breaks > first + _APART * step) & (breaks < last - _APART * step)])
    if len(breaks):
        near = np.minimum(
            *(np.abs(even - breaks[np.clip(np.searchsorted(breaks, even) - i, 0, len(breaks) - 1)]) for i in (0, 1))
        )
        even = even[near > _APART * step]
    return np.union1d(even, breaks)


def _body_cells(body: Body, first: float, last: float) -> tuple[Peaks, Floats]:
    """Return the peaks of a body, and sums (cells + 2, 2) of its jumps.

    The middle and the three axes go from one bound of a cell to the next as cubics with their velocities at both. A
    cubic's derivatives lie within their Bézier points. What a cubic misses, 1/384 of the fourth derivative by the
    fourth power of the cell's length, is measured in its middle; it leaves 3.1 times that over the length of the
    velocity, and 32 times that over its square of the acceleration, of which twice are added.
    """
    motion = body.trajectory
    if body.is_static:
        return Peaks.of(np.array([first, last]), np.zeros((1, 4))), np.zeros((3, 2))
    breaks = motion.breaks if motion.turning is None else np.union1d(motion.breaks, motion.turning.breaks)
    stands = [t for t in (motion.start, motion.end) if math.isfinite(t)]
    bounds = _cells(first, last, np.concatenate([breaks, *([t - CONTINUATION, t, t + CONTINUATION] for t in stands)]))
    values, before, after = np.empty((len(bounds) - 1, 4)), [], []
    for i in range(0, len(values), _SLICE):
        begin, end = bounds[:-1][i : i + _SLICE], bounds[1:][i : i + _SLICE]
        begin, end = np.nextafter(begin, np.inf), np.nextafter(end, -np.inf)  # velocities jump at bounds
        values[i : i + _SLICE], ends = _cubic_peaks(body, begin, end)
        after.append(ends[0])
        before.append(ends[1])
    jump = np.linalg.norm(np.concatenate(after)[1:] - np.concatenate(before)[:-1], axis=2)
    given = np.stack([jump[:, 0], np.sqrt(0.5 * np.sum(jump[:, 1:] ** 2, axis=1))], axis=1)
    given[given < _ROUNDING] = 0.0
    sums = [np.zeros((2, 2)), np.cumsum(given, axis=0), np.sum(given, axis=0)[None]]
    return Peaks.of(bounds, values), np.concatenate(sums)


def _cubic_peaks(body: Body, begin: Floats, end: Floats) -> tuple[Floats, tuple[Floats, Floats]]:
    """Return speed, turn, gain and lift (n, 4) in cells, and velocities (n, 4, 3) of middle and axes at both ends."""
    (p, u), (q, v) = (_state(body, t) for t in (begin, end))
    length = (end - begin)[:, None, None]
    middle = _state(body, 0.5 * (begin + end))[0]
    missed = np.linalg.norm(middle - 0.5 * (p + q) - 0.125 * length * (u - v), axis=2)
    mean = (q - p) / length
    speed = np.max([np.linalg.norm(x, axis=2) for x in (u, 3.0 * mean - u - v, v)], axis=0)
    speed += _SPEED_SPARE * missed / length[..., 0]
    bends = ((6.0 * mean - 4.0 * u - 2.0 * v) / length, (2.0 * u + 4.0 * v - 6.0 * mean) / length)
    gain = np.max([np.linalg.norm(x, axis=2) for x in bends], axis=0)
    gain += _ACCELERATION_SPARE * missed / length[..., 0] ** 2
    turn = np.sqrt(0.5 * np.sum(speed[:, 1:] ** 2, axis=1))
    lift = np.sqrt(np.sum(gain[:, 1:] ** 2, axis=1))
    return np.stack([speed[:, 0], turn, gain[:, 0], lift], axis=1), (u, v)


def _state(body: Body, times: Floats) -> tuple[Floats, Floats]:
    """Return places and velocities (n, 4, 3) of the middle of a body, and its axes and how these change."""
    motion = body.trajectory
    place, velocity = np.empty((2, len(times), 4, 3))
    turning, turned = motion.angular_velocity(times), motion.orientation(times)
    arm = rotate(turned, middle_of(body).place)
    place[:, 0], velocity[:, 0] = motion.position(times) + arm, motion.velocity(times) + cross_product(turning, arm)
    place[:, 1:] = rotate(turned[:, None], np.eye(3))
    velocity[:, 1:] = cross_product(turning[:, None], place[:, 1:])
    return place, velocity
