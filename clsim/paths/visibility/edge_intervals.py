"""Intervals of paths over edges: of both sides in turn, cut where adjacent paths of their terms begin or end."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.acoustics.diffraction import ON_LINE, TERMS, adjacent_reflections
from clsim.acoustics.edge_gap import FOUND, NEWTON, STEPS
from clsim.arrays import Bools, Floats, Rows
from clsim.errors import InputError
from clsim.paths.vertices.edge_field import BOTH
from clsim.paths.vertices.edge_pair import ACROSS_AIR
from clsim.paths.visibility import intervals
from clsim.paths.visibility.device import DeviceSearch
from clsim.paths.visibility.edge_ends import IN_AIR, OVERLAP, SMALL, SPARE, EndVisibility, GapVisibility, seen_frames
from clsim.paths.visibility.edges import (
    CONTRACTED,
    CONTRACTIONS,
    ENDS_BESIDE,
    FAR,
    SIDES,
    EdgeCandidates,
    EdgeVisibility,
    FaceLegs,
)
from clsim.paths.visibility.occlusion import in_air
from clsim.scene.room.edges import Edges

Sides = NDArray[np.int8]


_CHUNK = 20_000  # intervals looked at at a time, which bounds what waits
_PARTS = 8  # into which intervals of paths over ends are cut at most: others keep their times to the last bit
APART = 2.0  # resolutions between the times at which different tests find the same event, at most
NEAR = 1e-8  # of the room's size, which ends go in between; ten times the tolerance of an outline
STEP = 1e-3  # s, in which it is looked how far ends go
LONGEST = 1e-4  # s between these times, also where ends hardly move
_CONSTANTS = {
    "AT_EDGE": 1, "CONTRACTIONS": CONTRACTIONS, "CONTRACTED": CONTRACTED, "HALF_TURN": np.pi, "ON_LINE": ON_LINE,
    "NEWTON": NEWTON, "FOUND": FOUND, "STEPS": STEPS, "SMALL": SMALL, "SPARE": SPARE, "IN_AIR": IN_AIR,
    "OVERLAP": f"{{{OVERLAP[0]},{OVERLAP[1]}}}",
}  # fmt: skip
MOST_TOGETHER = 10_000_000  # evaluations of all paths of a batch: their intervals take 350 MB at most


@dataclass(frozen=True, slots=True, eq=False)
class EdgeSearch:
    """Answers one query for paths over the edges of a room: on a device with float64, or by its NumPy twin."""

    query: intervals.VisibilityQuery  # room, ends and resolution
    edges: Edges  # of the room
    device: DeviceSearch | None  # of the same query; NumPy when None
    air: NDArray[np.int64]  # (W,) on which side of each wall paths can be, see `air_sides`

    def find(self, candidates: EdgeCandidates, side: int | None = None) -> intervals.Intervals:
        """Return the intervals in which candidates are there, or one side of them."""
        if side is None:
            found = self._there(candidates)
            if candidates.over_ends_of_pairs:  # of which both sides are found before
                return found
        else:
            row, receiver = np.arange(len(candidates.edge)), candidates.receiver
            found = self._find(candidates, side, row, (self.query.first[receiver], self.query.last[receiver]))
        row, walls = found.path, self.query.walls
        stance = self.visibility(candidates).stance(row, 0.5 * (found.begin + found.end), np.zeros(len(row)))
        met = [
            in_air(walls, self.air, sequence[row], end)
            for sequence, end in zip((candidates.before, candidates.after), stance.ends, strict=True)
        ]
        kept = np.flatnonzero(met[0] & met[1] if side is None else met[side])
        return intervals.Intervals(row[kept], found.begin[kept], found.end[kept], found.evaluations)

    def visibility(self, candidates: EdgeCandidates) -> EdgeVisibility:
        """Make the test of whether candidates are there."""
        if candidates.over_ends_of_pairs and not candidates.over_meeting_edges:
            return EndVisibility.of(self.edges, candidates, self.query)
        if np.any(candidates.face == ACROSS_AIR):
            return GapVisibility.of(self.edges, candidates, self.query)
        return EdgeVisibility(self.edges, candidates, self.query)

    def _there(self, candidates: EdgeCandidates) -> intervals.Intervals:
        """Return the intervals in which candidates are there within the tolerances of outlines."""
        receiver, evaluations = candidates.receiver, 0
        always = np.arange(len(candidates.edge)), self.query.first[receiver], self.query.last[receiver]
        row, begin, end = candidates.spans or always
        if candidates.over_meeting_edges:
            ahead, wanted = self.visibility(candidates).ahead, row.astype(np.int32)[:, None]
            found = intervals.find_intervals(self.query, wanted, receiver[row], ahead, (begin, end), _PARTS)
            return intervals.merged(row[found.path], found.begin, found.end, found.evaluations)
        across_air = bool(np.any(candidates.face == ACROSS_AIR))
        first = 2 if candidates.over_ends_of_pairs else 0  # their legs to endpoints are found before
        for side in range(first, 4 if across_air else 2):
            found = self._find(candidates, side, row, (begin, end))
            row, begin, end = row[found.path], found.begin, found.end
            evaluations += found.evaluations
        legs = FaceLegs(self.visibility(candidates))
        hindered = np.zeros(len(row), dtype=bool) if across_air else legs.hindered(row)
        if not hindered.any():
            return intervals.merged(row, begin, end, evaluations)
        requested, spans = row[hindered], (begin[hindered], end[hindered])
        walls = requested.astype(np.int32)[:, None]
        found = intervals.find_intervals(self.query, walls, receiver[requested], legs.evaluate, spans)
        parts = (row, requested[found.path]), (begin, found.begin), (end, found.end)
        row, begin, end = (np.concatenate([free[~hindered], rest]) for free, rest in parts)
        return intervals.merged(row, begin, end, evaluations + found.evaluations)

    def _find(
        self, candidates: EdgeCandidates, side: int, row: Rows, spans: tuple[Floats, Floats]
    ) -> intervals.Intervals:
        """Return when one side of some candidates is there within spans of time."""
        if self.device is None or candidates.over_ends_of_pairs:
            evaluate = partial(self.visibility(candidates).evaluate, side)
            sequence = row.astype(np.int32)[:, None]
            parts = _PARTS if candidates.over_ends_of_pairs else 1
            return intervals.find_intervals(self.query, sequence, candidates.receiver[row], evaluate, spans, parts)
        edges, across_air = self.edges, bool(np.any(candidates.face == ACROSS_AIR))
        before, after, between = (x[row] for x in (candidates.before, candidates.after, candidates.between))
        mine = (before, after, between[:, ::-1], between[:, :0])[side]
        other = np.concatenate([before, after, between], axis=1) if across_air else (after, before)[side]
        counts = np.array([other.shape[1], before.shape[1], after.shape[1], side], dtype=np.int32)
        places = np.repeat(np.arange(len(row))[:, None], 2, axis=1) if across_air else candidates.face[row]
        columns: dict[str, NDArray[Any]] = {
            "sequences": mine, "others": other, "edge_of": candidates.edge[row], "face_of": places,
            "end_of": candidates.end[row], "receiver_of": candidates.receiver[row],
        }  # fmt: skip
        every, requested = (
            np.column_stack([edges.frames.reshape(-1, 12), edges.length, edges.n]),
            candidates.edge[row, 1],
        )
        seen = every[requested] if across_air else every
        if across_air:
            seen[:, :12] = seen_frames(self.query.walls, edges, requested, between).reshape(-1, 12)
        others = {
            "counts": counts, "far": FAR * self.query.walls.size, "edges": every, "seen": seen,
        }  # fmt: skip
        return self.device.settle("edge_intervals", _CONSTANTS | {"GAP": int(across_air)}, columns, spans, others)


@dataclass(frozen=True, slots=True, eq=False)
class Pieces:
    """Stretches of candidates between boundaries of their terms."""

    row: NDArray[np.int64]  # (n,) of the candidates
    begin: Floats  # (n,) s
    end: Floats  # likewise
    sides: Sides  # (n, 11) see `EdgeVisibility.sides`


def find_pieces(finder: EdgeSearch, candidates: EdgeCandidates, order: int, notify: Callable[[], None]) -> Pieces:
    """Find the intervals in which candidates are active, and cut them at the boundaries of their terms."""
    there, visibility = finder.find(candidates), finder.visibility(candidates)
    near = intervals.GRAZE * finder.query.walls.size
    met = sum(np.sum(x >= 0, axis=1) for x in (candidates.before, candidates.after, candidates.between))[:, None]
    ignored = np.zeros((len(candidates.edge), SIDES), dtype=bool)  # terms whose partners have too many reflections
    one, last = (adjacent_reflections(finder.edges.n[edge]) for edge in candidates.edge.T)
    shared = ((candidates.face >= 0) & (candidates.face != ACROSS_AIR))[:, :1]  # with the fewest at the other edge
    for term, mine, other in ((0, one, last), (TERMS + 1, last, one)):
        ignored[:, term : term + TERMS] = met + mine + shared * other.min(axis=1, keepdims=True) > order
    stack = [(there.path, there.begin, there.end)]
    found: list[tuple[Any, ...]] = [(there.path[:0], there.begin[:0], there.end[:0], np.empty((0, SIDES), np.int8))]
    evaluations = np.zeros(len(candidates.edge), dtype=np.int64)
    while stack:
        row, begin, end = stack.pop()
        if len(row) > _CHUNK:
            stack.append((row[_CHUNK:], begin[_CHUNK:], end[_CHUNK:]))
            row, begin, end = row[:_CHUNK], begin[:_CHUNK], end[:_CHUNK]
        half = 0.5 * (end - begin)
        sides, sure, off, reach = visibility.sides(row, begin + half, half)
        sides[ignored[row]] = 0
        done = sure | (2.0 * half <= finder.query.resolution)
        unsure = np.flatnonzero(~done & (off < near) & (half <= 0.5 * intervals.GRAZE_TIME))
        if len(unsure):
            both, instants = np.tile(row[unsure], 2), np.append(begin[unsure], end[unsure])
            beside, _, off, _ = visibility.sides(both, instants, np.zeros(len(both)))
            beside[ignored[both]] = 0
            along = off < np.tile(np.minimum(near, intervals.ALONG * reach[unsure]), 2)
            along &= np.all(beside == np.tile(sides[unsure], (2, 1)), axis=1)
            unsure = unsure[along.reshape(2, -1).all(axis=0)]
        done[unsure] = True
        np.add.at(evaluations, row, 1)
        _refuse_endless(evaluations, lambda worst: finder.edges.names[candidates.edge[worst, 0]])
        notify()
        found.append((row[done], begin[done], end[done], sides[done]))
        row, begin, end = row[~done], begin[~done], end[~done]
        if len(row):
            stack.append(intervals.divided(row, begin, end, 2, _PARTS if candidates.over_ends_of_pairs else 2))
    over = (candidates.end >= 0) & (not candidates.over_ends_of_pairs)
    return Pieces(*_joined_pieces(over, *(np.concatenate(column) for column in zip(*found, strict=True))))


def _refuse_endless(evaluations: NDArray[np.int64], name: Callable[[int], str]) -> None:
    worst = int(np.argmax(evaluations)) if len(evaluations) else 0
    together = evaluations.sum()
    if together > MOST_TOGETHER or (together and evaluations[worst] > intervals.MOST_EVALUATIONS):
        raise InputError(
            "diffraction",
            f"must let paths over edges be settled within {intervals.MOST_EVALUATIONS} evaluations of each and "
            f"{MOST_TOGETHER} of a batch, but one over {name(worst)!r} has had {evaluations[worst]}: "
            "it runs along a boundary of shadow or reflection; move an end a millimetre, shorten the run, lower "
            "max_order, or give a larger resolution",
        )


def _joined_pieces(over: Bools, row: Rows, begin: Floats, end: Floats, sides: Sides) -> tuple[Any, Any, Any, Any]:
    """Sort intervals by path and time, and join those that touch and have the same sides."""
    first, last = intervals.joined([row], begin, end, sides)
    row, begin, end, sides = row[first], begin[first], end[last], sides[first]
    some, others = np.flatnonzero(over[row]), np.flatnonzero(~over[row])
    of_ends = sides[some, :TERMS], sides[some, TERMS], sides[some][:, ENDS_BESIDE]
    kept, starting, ending, lit = joined_over_ends(row[some], begin[some], end[some], *of_ends)
    of_joined = np.array(sides[some[kept]])
    of_joined[:, :TERMS] = lit
    columns = ((row, row[some[kept]]), (begin, starting), (end, ending), (sides, of_joined))
    row, begin, end, sides = (np.concatenate([column[others], more]) for column, more in columns)
    rank = np.lexsort((begin, row))
    return row[rank], begin[rank], end[rank], sides[rank]


def joined_over_ends(
    path: Rows, begin: Floats, end: Floats, lit: Sides, side: Sides, beside: Sides
) -> tuple[Rows, Floats, Floats, Sides]:
    """Join the pieces of paths over ends of edges between two changes of side of the end.

    Shapes: path (n,); begin, end (n,) s; lit (n, 4); side (n,); beside (n, 2); result (m,), (m,) s, (m, 4).
    path: which path each piece belongs to; pieces are in the order of paths and times.
    lit: sides of the terms as the end changes sides: beyond that the field depends on them, elsewhere not. Times `BOTH`
    where the term passes its own boundary at the same time: the line of sight passes the corner itself, and the paths
    over both edges there cancel in what each would add by going round its boundary on one side.
    """
    follows = np.append(False, (path[1:] == path[:-1]) & (begin[1:] == end[:-1]))[: len(path)]
    turns = follows & np.append(False, side[1:] != side[:-1])[: len(path)]
    cut = ~follows | turns | np.append(False, np.any(beside[1:] != beside[:-1], axis=1))[: len(path)]
    first = np.flatnonzero(cut)
    last = np.append(first[1:], len(path))[: len(first)] - 1
    times = np.ones(lit.shape, dtype=np.int8)
    times[1:][lit[1:] != lit[:-1]] = BOTH
    found: list[tuple[int, float, float, Sides]] = []
    for one, other in zip(first.tolist(), last.tolist(), strict=True):
        at_start = times[one] * lit[one] if turns[one] else None
        at_end = times[other + 1] * lit[other] if other + 1 < len(path) and turns[other + 1] else None
        at_start, at_end = (lit[one] if at_end is None else at_end) if at_start is None else at_start, at_end
        if at_end is None or np.array_equal(at_start, at_end):
            found.append((one, begin[one], end[other], at_start))
        else:
            middle = 0.5 * (begin[one] + end[other])
            found += [(one, begin[one], middle, at_start), (one, middle, end[other], at_end)]
    kept, starts, ends, sides = ([row[i] for row in found] for i in range(4))
    return (
        np.array(kept, np.int64), np.array(starts), np.array(ends), np.array(sides, np.int8).reshape(-1, lit.shape[1]),
    )  # fmt: skip


def indistinct(moved: Floats, resolution: float, size: float) -> Floats:
    """Compute by how much times (n,) of the same event may differ, s, where ends go (n,) m within `STEP`."""
    slowest = NEAR * size / LONGEST * STEP
    return np.asarray(APART * resolution + NEAR * size * STEP / np.maximum(moved, slowest))
