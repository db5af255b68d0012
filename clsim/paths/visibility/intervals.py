"""Intervals in which paths are valid, by certified subdivision of time; where their endpoints are meanwhile; in NumPy.

The twin of ``intervals.cl``: an interval of time is done if the clearance at its middle exceeds what the ends can move
within it. Otherwise the part that the clearance covers is done, and the rests on both sides are looked at.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Floats, Ints, firsts, read_only
from clsim.errors import InputError
from clsim.paths.cubics import KNOT_RATES, cubics_between
from clsim.paths.propagation import UniformAir, contract_delay
from clsim.paths.visibility.clearance import Reach, mirrored, path_status
from clsim.paths.visibility.occlusion import in_air
from clsim.scene.motion.motion import Motion
from clsim.scene.room.faces import Mount
from clsim.scene.room.walls import Walls

PERTURBATIONS = np.array([[6.1e-8, -3.7e-8, 7.0e-8], [-2.9e-8, 8.3e-8, 4.7e-8]])  # m, of the source and of receivers
_TOLERANCE = 1e-8  # m, of a position between knots
_WORST = 1e-3  # m, the same where a motion has corners, or knots are as many as they may be
_MOST_KNOTS = 2_000_000
_SLICE = 65536  # knots made at a time


@dataclass(frozen=True, slots=True, eq=False)
class BoundingSpheres:
    """Spheres that hold the ends of paths over the time that matters: centres (n, 3) and radii (n,), m."""

    centre: Floats
    radius: Floats


@dataclass(frozen=True, slots=True, eq=False)
class TrajectoryTables:
    """Trajectories of one source (row 0) and of receivers (rows 1, 2, …)."""

    places: NDArray[np.int64]  # (rows, 3) first knot, first speed and number of knots of each
    scales: Floats  # (rows, 3) time of the first knot (s), knots per second, largest speed (m/s)
    knots: Floats  # (knots, 12) coefficients [power][xyz] of the cubic from each knot to the next, m
    speeds: Floats  # (speeds,) bounds of the speed from each knot to the next, of pairs of them, and so on, m/s
    # (rows, 4) unit normal of the wall that each sits in, and offset of the plane a step in front of it, m; zero in the
    # open.
    mounts: Floats

    def position(self, row: NDArray[np.int64], time: Floats) -> Floats:
        """Return positions (n, 3) at times (n,), m; before the first and after the last knot those at them."""
        first, count = self.places[row, 0], self.places[row, 2]
        place = (time - self.scales[row, 0]) * self.scales[row, 1]
        knot = np.clip(place, 0.0, count - 1.0).astype(np.int64)
        u = np.clip(place - knot, 0.0, 1.0)[:, None]
        c = self.knots[first + knot].reshape(-1, 4, 3)
        return np.asarray(c[:, 0] + u * (c[:, 1] + u * (c[:, 2] + u * c[:, 3])))

    def lifted(self, row: NDArray[np.int64], positions: Floats) -> Floats:
        """Return positions (n, 3) of ends as validity takes them: those in a wall a step in front of it, m."""
        normal, offset = self.mounts[row, :3], self.mounts[row, 3]
        return np.asarray(positions + (offset - np.sum(positions * normal, axis=1))[:, None] * normal)

    def speed_over(self, row: NDArray[np.int64], begin: Floats, end: Floats) -> Floats:
        """Return a bound of the speed between two times (n,), m/s."""
        start, rate, last = self.scales[row, 0], self.scales[row, 1], self.places[row, 2] - 1
        a, b = (np.clip((t - start) * rate, 0.0, last).astype(np.int64) for t in (begin, end))
        level, count = self.places[row, 1].copy(), last + 1
        while np.any(wide := b - a > 1):
            level = np.where(wide, level + count, level)
            count = np.where(wide, (count + 1) // 2, count)
            a, b = np.where(wide, a // 2, a), np.where(wide, b // 2, b)
        return np.asarray(np.maximum(self.speeds[level + a], self.speeds[level + b]))

    def sphere(self, row: int, begin: float = 0.0, end: float = math.inf) -> tuple[Floats, float]:
        """Return centre and radius of a sphere that holds a trajectory between two times, 0 to its end at most, m."""
        start, count = self.places[row, 0], self.places[row, 2]
        first, last = (int(min(max(t * self.scales[row, 1], 0.0), count - 1.0)) for t in (begin, end))
        c = self.knots[start + first : start + last + 1].reshape(-1, 4, 3)
        # Bézier points of each cubic: it stays within their hull.
        hull = np.concatenate([c[:, 0], c[:, 0] + c[:, 1] / 3, c[:, 0] + (2 * c[:, 1] + c[:, 2]) / 3, c.sum(axis=1)])
        centre = 0.5 * (hull.min(axis=0) + hull.max(axis=0))
        for _ in range(64):  # Ritter's steps towards the farthest point shrink the ball
            away = hull - centre
            distance = np.linalg.norm(away, axis=1)
            i = int(np.argmax(distance))
            better = centre + 0.05 * away[i]
            if np.linalg.norm(hull - better, axis=1).max() >= distance[i]:
                break
            centre = better
        lift = float(np.abs(self.mounts[row, 3] - hull @ self.mounts[row, :3]).max())  # of an end off its wall
        return centre, float(np.linalg.norm(hull - centre, axis=1).max()) + lift

    def receiver_spheres(self, begin: float = 0.0, end: float = math.inf) -> BoundingSpheres:
        """Return spheres that hold the receivers, one for each."""
        spheres = [self.sphere(row, begin, end) for row in range(1, len(self.places))]
        return BoundingSpheres(np.array([s[0] for s in spheres]).reshape(-1, 3), np.array([s[1] for s in spheres]))


def with_points(tables: TrajectoryTables, row: int, places: Floats) -> TrajectoryTables:
    """Return tables of one of the ends, and of places (n, 3) at rest in the place of receivers, m."""
    count, still = len(places), np.zeros((len(places), 9))
    first = len(tables.knots), len(tables.speeds)
    points = np.column_stack([first[0] + np.arange(count), first[1] + np.arange(count), np.ones(count, dtype=np.int64)])
    return TrajectoryTables(
        np.concatenate([tables.places[[row]], points]),
        np.concatenate([tables.scales[[row]], np.tile([0.0, 1.0, 0.0], (count, 1))]),
        np.concatenate([tables.knots, np.column_stack([places, still])]),
        np.concatenate([tables.speeds, np.zeros(count)]),
        np.concatenate([tables.mounts[[row]], np.zeros((count, 4))]),
    )


def trajectory_tables(
    source: Motion, receivers: Sequence[Motion], mounts: Sequence[Mount | None] = ()
) -> TrajectoryTables:
    """Return the tables of one source and its receivers, from time 0 to the end of each; no mounts when left out."""
    tables = [_knots("sources.trajectory", source)]
    tables += [_knots(f"receivers[{i}].trajectory", motion) for i, motion in enumerate(receivers)]
    levels = [_speeds(knots, rate) for knots, _, rate in tables]
    counts, sizes = (np.array([len(each) for each in some]) for some in ([knots for knots, _, _ in tables], levels))
    places = np.column_stack([firsts(counts)[:-1], firsts(sizes)[:-1], counts])
    scales = np.array([[first, rate, level.max()] for (_, first, rate), level in zip(tables, levels, strict=True)])
    knots = np.concatenate([knots for knots, _, _ in tables])
    planes = np.zeros((len(tables), 4))
    for plane, mount in zip(planes, mounts, strict=False):
        if mount is not None:
            plane[:] = [*mount.normal, mount.offset + mount.step]
    columns = (places, scales, knots, np.concatenate(levels), planes)
    return TrajectoryTables(*(read_only(column) for column in columns))


def _knots(field: str, motion: Motion) -> tuple[Floats, float, float]:
    """Return cubics (n, 12), time of the first knot and knots per second."""
    if motion.is_static:
        still = np.zeros((1, 12))
        still[0, :3] = motion.position(0.0)
        return still, 0.0, 1.0
    length = max(motion.end, 1e-3)
    for rate in KNOT_RATES:
        count = min(max(1, math.ceil(length * rate)), _MOST_KNOTS)
        cubics, error = _cubics(motion, length, count)
        if error <= _TOLERANCE or count == _MOST_KNOTS:
            break
    if error > _WORST and count == _MOST_KNOTS:
        bound = f"must be known within {_WORST:g} m from {_MOST_KNOTS} places for paths in a mesh"
        known = f"{length:g} s of it are known within {error:.2g} m"
        raise InputError(field, f"{bound}, but {known}; make it shorter or smoother")
    return cubics, 0.0, count / length


def _cubics(motion: Motion, length: float, count: int) -> tuple[Floats, float]:
    """Return cubics (count, 12) of even lengths from 0 s on, and the largest error that was met on any, m."""
    cubics, largest, step = np.empty((count, 12)), 0.0, length / count
    rng = np.random.default_rng(0)
    for first in range(0, count, _SLICE):
        last = min(first + _SLICE, count)
        times = np.arange(2 * first, 2 * last + 1) * (0.5 * step)
        position, velocity = motion.position(times), motion.velocity(times[::2]) * step
        found = cubics_between(position[::2], velocity)
        middle = sum(c * 0.5**power for power, c in enumerate(found))
        largest = max(largest, float(np.abs(middle - position[1::2]).max()))
        if step * KNOT_RATES[0] > 1.0:  # so long that motions may repeat from knot to knot
            u = rng.random((last - first, 1))
            anywhere = sum(c * u**power for power, c in enumerate(found))
            largest = max(largest, float(np.abs(anywhere - motion.position(times[:-1:2] + step * u[:, 0])).max()))
        cubics[first:last] = np.concatenate(found, axis=1)
    return cubics, largest


def _speeds(knots: Floats, rate: float) -> Floats:
    """Return bounds of the speed on each cubic, on pairs of them and so on, in a row."""
    c = knots.reshape(-1, 4, 3)
    # Bézier points of the derivative.
    points = np.stack([c[:, 1], c[:, 1] + c[:, 2], c[:, 1] + 2.0 * c[:, 2] + 3.0 * c[:, 3]])
    level = np.linalg.norm(points, axis=2).max(axis=0) * rate
    levels = [level]
    while len(level) > 1:
        level = np.maximum(level[::2], np.append(level[1::2], 0.0) if len(level) % 2 else level[1::2])
        levels.append(level)
    return np.concatenate(levels)


Search = Callable[[NDArray[np.int32], NDArray[np.int64]], "Intervals"]
Evaluation = Callable[[NDArray[np.int32], NDArray[np.int64], Floats, Floats], tuple[NDArray[np.bool_], Floats, Floats]]

SMALLEST_MOVE = 1e-9  # of the room's size; ends that move less stand still
GRAZE = 1e-6  # of the room's size; paths that pass an edge nearer than this run along it
GRAZE_TIME = 1e-3  # s; intervals shorter than this of such a path are one, if both ends agree with the middle
ALONG = 0.02  # of what the ends can move meanwhile, by which a path that runs along an edge comes off it at most
CERTAIN = 0.999  # of a clearance, what is relied on
LEAST_SHARE = 0.05  # of an interval; less of it is not taken out of its middle
MOST_EVALUATIONS = 3_000_000  # evaluations of one path
_CHUNK = 20_000  # intervals looked at at a time
_AT_ONCE = 400  # intervals below which more of them cost next to nothing


@dataclass(frozen=True, slots=True, eq=False)
class VisibilityQuery:
    """What is asked of a search: the room, its ends, and how finely."""

    walls: Walls  # the room
    trajectory_tables: TrajectoryTables  # the source and the receivers
    medium: UniformAir  # what sound travels in
    # (receivers,) times from and up to which each receiver's paths are looked at, s; nowhere if not first < last.
    first: Floats
    last: Floats  # (receivers,) likewise
    resolution: float  # to which ends of intervals are found, s

    def during(self, begin: float, end: float) -> VisibilityQuery:
        """Return the same query for a part of the time."""
        first, last = np.maximum(self.first, begin), np.minimum(self.last, end)
        return replace(self, first=first, last=last)

    @property
    def time_dilation(self) -> Floats:
        """How much faster emission times can pass than times of reception, (receivers,)."""
        mach = self.trajectory_tables.scales[:, 2] / self.medium.slowest
        return np.asarray((1.0 + mach[1:]) / (1.0 - mach[0]))

    def ends_about(
        self, sequence: NDArray[np.int32], receiver: NDArray[np.int64], time: Floats, half: Floats
    ) -> tuple[Floats, Floats, Reach]:
        """Locate endpoints of paths (n, 3), m, as validity takes them; bound their motion within `half` of a time."""
        walls, ends = self.walls, self.trajectory_tables
        row, source = receiver + 1, np.zeros(len(receiver), dtype=np.int64)
        at = ends.position(row, time)
        image = at
        for k in range(sequence.shape[1] - 1, -1, -1):
            image = mirrored(walls, sequence[:, k], image)
        emission_time = time - contract_delay(self.medium, partial(ends.position, source), image, at, time)
        late = self.time_dilation[receiver]
        reach = Reach(
            half * late * ends.speed_over(source, emission_time - late * half, emission_time + late * half),
            half * ends.speed_over(row, time - half, time + half), ends.mounts[source, :3], ends.mounts[row, :3],
        )  # fmt: skip
        origin = ends.lifted(source, ends.position(source, emission_time) + PERTURBATIONS[0])
        return origin, ends.lifted(row, at + PERTURBATIONS[1]), reach

    def found_in_air(
        self, air: Ints, search: Search, sequence: NDArray[np.int32], receiver: NDArray[np.int64]
    ) -> Intervals:
        """Search without paths that meet a closed shell from behind, by the sides of walls in the air, see `in_air`."""
        found = search(sequence, receiver)
        walls, middle = sequence[found.path], 0.5 * (found.begin + found.end)
        source, _, _ = self.ends_about(walls, receiver[found.path], middle, np.zeros(len(middle)))
        kept = np.flatnonzero(in_air(self.walls, air, walls, source))
        return Intervals(found.path[kept], found.begin[kept], found.end[kept], found.evaluations)


@dataclass(frozen=True, slots=True, eq=False)
class Intervals:
    """Intervals [begin, end) of paths, sorted by path and time."""

    path: NDArray[np.int64]  # (n,) row of the paths that were asked for
    begin: Floats  # (n,) s
    end: Floats  # likewise
    evaluations: int  # evaluations that were needed


def find_intervals(
    query: VisibilityQuery, sequence: NDArray[np.int32], receiver: NDArray[np.int64],
    evaluation: Evaluation | None = None, spans: tuple[Floats, Floats] | None = None, parts: int = 1,
) -> Intervals:  # fmt: skip
    """Return the intervals in which paths by sequences (n, N) of walls to receivers (n,) are valid.

    An `evaluation` takes the place of `evaluate` of the query for other paths. They are evaluated over `spans` of time,
    s, or over those of their receivers. What is left of an interval is cut into so many `parts` at most, see `divided`.
    """
    evaluate_at = evaluation or partial(evaluate, query)
    first, last = spans or (query.first[receiver], query.last[receiver])
    path = np.flatnonzero(first < last)
    stack = [(path, first[path], last[path])]
    found: list[tuple[Any, Any, Any]] = [(path[:0], np.empty(0), np.empty(0))]
    evaluations = 0
    while stack:
        path, begin, end = stack.pop()
        if len(path) > _CHUNK:
            stack.append((path[_CHUNK:], begin[_CHUNK:], end[_CHUNK:]))
            path, begin, end = path[:_CHUNK], begin[:_CHUNK], end[:_CHUNK]
        half, middle = 0.5 * (end - begin), begin + 0.5 * (end - begin)
        valid, clear, reach = evaluate_at(sequence[path], receiver[path], middle, half)
        evaluations += len(path)
        done = (clear > reach) | (2.0 * half <= query.resolution) | (reach < SMALLEST_MOVE * query.walls.size)
        grazing = np.flatnonzero(~done & (clear < GRAZE * query.walls.size) & (half <= 0.5 * GRAZE_TIME))
        for instant in (begin, end) if len(grazing) else ():
            requested = sequence[path[grazing]], receiver[path[grazing]]
            seen, beside, most = evaluate_at(*requested, instant[grazing], half[grazing])
            evaluations += len(grazing)
            grazing = grazing[(seen == valid[grazing]) & (beside < np.minimum(GRAZE * query.walls.size, ALONG * most))]
        done[grazing] = True
        good = done & valid
        found.append((path[good], begin[good], end[good]))
        split = ~done
        path, begin, end = path[split], begin[split], end[split]
        middle, half, valid = middle[split], half[split], valid[split]
        share = CERTAIN * clear[split] / np.maximum(reach[split], 1e-300)
        share[(share < LEAST_SHARE) | (share * half < 0.5 * query.resolution)] = 0.0
        left, right = middle - share * half, middle + share * half
        known = valid & (right > left)
        found.append((path[known], left[known], right[known]))
        rest = np.concatenate([path, path]), np.concatenate([begin, right]), np.concatenate([left, end])
        real = rest[2] > rest[1]
        if real.any():
            stack.append(divided(rest[0][real], rest[1][real], rest[2][real], 1, parts))
    paths, begins, ends = map(np.concatenate, zip(*found, strict=True))
    return merged(paths, begins, ends, evaluations)


def divided(
    path: NDArray[np.int64], begin: Floats, end: Floats, fewest: int, most: int
) -> tuple[NDArray[np.int64], Floats, Floats]:
    """Cut intervals (n,) of paths into even parts: into more where they are few, which costs next to nothing."""
    parts = int(np.clip(_AT_ONCE // len(path), fewest, most))
    cuts = np.column_stack([begin[:, None] + (end - begin)[:, None] * (np.arange(parts) / parts), end])
    return np.repeat(path, parts), cuts[:, :-1].ravel(), cuts[:, 1:].ravel()


def evaluate(
    query: VisibilityQuery, sequence: NDArray[np.int32], receiver: NDArray[np.int64], time: Floats, half: Floats
) -> tuple[NDArray[np.bool_], Floats, Floats]:
    """Return validity, clearance and how far the ends can move within `half` of a time, each (n,)."""
    source, at, reach = query.ends_about(sequence, receiver, time, half)
    valid, clear = path_status(query.walls, sequence, source, at, reach)
    return valid, clear, reach.most


def merged(path: NDArray[np.int64], begin: Floats, end: Floats, evaluations: int) -> Intervals:
    """Sort intervals and join those that touch."""
    first, last = joined([path], begin, end)
    return Intervals(path[first], begin[first], end[last], evaluations)


def joined(keys: Sequence[Any], begin: Any, end: Any, state: Any = None) -> tuple[Any, Any]:
    """Find the first and the last rows (m,) of intervals (n,) that touch, sorted by keys (n,) and beginnings."""
    rows = np.lexsort([begin, *keys[::-1]])
    cut = begin[rows[1:]] > end[rows[:-1]]
    for column in keys if state is None else (*keys, *np.atleast_2d(state.T)):
        cut |= column[rows[1:]] != column[rows[:-1]]
    starts = np.flatnonzero(np.append(True, cut)[: len(rows)])
    return rows[starts], rows[np.append(starts[1:], len(rows))[: len(starts)] - 1]
