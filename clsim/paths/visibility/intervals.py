"""Intervals in which paths are valid, by certified subdivision of time; in NumPy.

The twin of ``intervals.cl``: an interval of time is done if the clearance at its middle exceeds what the ends can move
within it. Otherwise the part that the clearance covers is done, and the rests on both sides are looked at.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Floats
from clsim.paths.propagation import UniformAir
from clsim.paths.trajectory_tables import PERTURBATIONS, TrajectoryTables
from clsim.paths.visibility.clearance import Reach, mirrored, path_status
from clsim.scene.room.walls import Walls

Evaluation = Callable[
    ["VisibilityQuery", NDArray[np.int32], NDArray[np.int64], Floats, Floats],
    tuple[NDArray[np.bool_], Floats, Floats],
]

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
        emission_time = time - ends.delay(image, at, time, self.medium)
        late = self.time_dilation[receiver]
        reach = Reach(
            half * late * ends.speed_over(source, emission_time - late * half, emission_time + late * half),
            half * ends.speed_over(row, time - half, time + half),
            ends.mounts[source, :3],
            ends.mounts[row, :3],
        )
        origin = ends.lifted(source, ends.position(source, emission_time) + PERTURBATIONS[0])
        return origin, ends.lifted(row, at + PERTURBATIONS[1]), reach


@dataclass(frozen=True, slots=True, eq=False)
class Intervals:
    """Intervals [begin, end) of paths, sorted by path and time."""

    path: NDArray[np.int64]  # (n,) row of the paths that were asked for
    begin: Floats  # (n,) s
    end: Floats  # likewise
    evaluations: int  # evaluations that were needed


def find_intervals(
    query: VisibilityQuery,
    sequence: NDArray[np.int32],
    receiver: NDArray[np.int64],
    evaluation: Evaluation | None = None,
    spans: tuple[Floats, Floats] | None = None,
    parts: int = 1,
) -> Intervals:
    """Return the intervals in which paths are valid.

    Shapes: sequence (n, N); receiver (n,).

    evaluation: what says whether other paths than those by walls are valid, and how far their ends may move; as
    `evaluate`.

    spans: times from and up to which each path is looked at, s; those of its receiver when left out.

    parts: into how many what is left of an interval is cut at most, see `divided`.
    """
    evaluate_at = evaluation or evaluate
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
        valid, clear, reach = evaluate_at(query, sequence[path], receiver[path], middle, half)
        evaluations += len(path)
        done = (clear > reach) | (2.0 * half <= query.resolution) | (reach < SMALLEST_MOVE * query.walls.size)
        grazing = np.flatnonzero(~done & (clear < GRAZE * query.walls.size) & (half <= 0.5 * GRAZE_TIME))
        for instant in (begin, end) if len(grazing) else ():
            requested = sequence[path[grazing]], receiver[path[grazing]]
            seen, beside, most = evaluate_at(query, *requested, instant[grazing], half[grazing])
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
    paths, begins, ends = (np.concatenate([f[i] for f in found]) for i in range(3))
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
    order = np.lexsort((begin, path))
    path, begin, end = path[order], begin[order], end[order]
    first = np.ones(len(path), dtype=bool)
    first[1:] = (path[1:] != path[:-1]) | (begin[1:] != end[:-1])
    starts = np.flatnonzero(first)
    ends = np.append(starts[1:], len(path))[: len(starts)] - 1
    return Intervals(path[starts], begin[starts], end[ends], evaluations)
