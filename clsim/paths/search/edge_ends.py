"""Paths over an edge and a free end of another edge: where those over two edges run off an end of one.

The end rests. So both sides of a path are found apart: from the source to the end or the edge, and likewise from each
receiver. A path is active while both are, later by what sound takes from the end to the receiver.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.acoustics.diffraction import adjacent_reflections
from clsim.arrays import Floats, Rows, spread
from clsim.paths.chain import Chain
from clsim.paths.propagation import UniformAir
from clsim.paths.search.edge_gaps import PARTS, apart, between_edges, in_air, legs_open
from clsim.paths.search.edge_levels import least_level, loud, lowest_wave
from clsim.paths.search.edges import EdgePaths, EdgeReach, Others, Requested, Sides, rows_of
from clsim.paths.search.mesh import Progress
from clsim.paths.vertices.edge_end import EdgeEndVertex
from clsim.paths.vertices.edge_events import MEETING, OF_LAST, TWO_ENDS, at_meeting, end_numbers
from clsim.paths.vertices.edge_pair import ACROSS_AIR
from clsim.paths.visibility.clearance import in_planes
from clsim.paths.visibility.edge_ends import end_levels, off_edges, seen_frames
from clsim.paths.visibility.edge_intervals import EdgeSearch
from clsim.paths.visibility.edges import CONTRACTED, CONTRACTIONS, EdgeCandidates, imaged
from clsim.paths.visibility.intervals import PERTURBATIONS, TrajectoryTables, with_points
from clsim.scene.room.edges import Edges
from clsim.scene.room.walls import Walls

_NEAR = 1e-7  # of the room's size, up to which an end is on another edge
_BESIDE = 0.1  # of the room's size, from an end to the place that stands for what is beyond it
_BATCH = 20_000  # candidates searched at a time
_LISTENED = 2_000  # candidates whose levels are estimated together
_AT_ONCE = UniformAir(1e15)  # without delays
_SAME = 9  # decimals of places that are the same, m


def end_edge_paths(search: EdgePaths, others: Others, progress: Progress | None = None) -> Chain:
    """Find every path over an edge and a free end of another one."""
    given: Any = {"wave": lowest_wave(search.scene), "direct": search.search.direct is not False}
    fewest, audible = 2 if search.edges.free.any() else sys.maxsize, partial(_audible_rows, **given)
    rows = search.rows(partial(end_candidates, **given), others, progress, fewest, audible)
    return search.chain(rows, EdgeEndVertex(**search.gap_columns(rows)))


def end_candidates(reach: EdgeReach, wave: float, direct: bool) -> Requested:
    """Yield candidates over an edge and an end of another one, with times of both sides, and the share of the work."""
    finder, order, routes = reach.finder, reach.order, _routes(reach)
    met, fewest = np.sum(routes.between >= 0, axis=1), adjacent_reflections(finder.edges.n).min(axis=1)
    left = order - met - fewest[routes.edge].sum(axis=1)
    routes, met, left = _part(routes, np.flatnonzero(left >= 0)), met[left >= 0], left[left >= 0]
    if not len(left):
        return
    source = _Sight(reach, 0, routes, left)
    after = left - source.fewest
    sights = [_Sight(reach, row, routes, after) for row in range(1, len(reach.to_receivers) + 1)]
    kinds = np.column_stack([at_meeting(routes.end), routes.face[:, 0] == ACROSS_AIR, met])
    every, kind = np.unique(kinds, axis=0, return_inverse=True)
    for number in range(len(every)):
        rows, count = np.flatnonzero(kind.ravel() == number), int(every[number, 2])
        some = replace(_part(routes, rows), between=routes.between[rows, :count])
        found = (
            x
            for sight in sights
            for x in _joined(finder, some, left[rows], (source.request[rows], sight.request[rows]), (source, sight))
        )
        audible = (_audible_ones(finder, x, wave, direct) for x in _together(found, _LISTENED))
        yield from ((number / len(every), x) for x in _together(audible, _BATCH))


def _part(routes: EdgeCandidates, rows: Rows) -> EdgeCandidates:
    names = (field.name for field in fields(EdgeCandidates) if field.name != "spans")
    return EdgeCandidates(**{name: getattr(routes, name)[rows] for name in names})


def _together(parts: Iterator[EdgeCandidates], count: int) -> Iterator[EdgeCandidates]:
    """Join parts until they have so many candidates."""
    waiting: list[EdgeCandidates] = []
    for part in parts:
        waiting += [part] if len(part.edge) else []
        if sum(len(some.edge) for some in waiting) >= count:
            yield EdgeCandidates.joined(waiting)
            waiting = []
    if waiting:
        yield EdgeCandidates.joined(waiting)


def _routes(reach: EdgeReach) -> EdgeCandidates:
    """Make routes without sides: over faces that edges share, and across air by up to so many walls."""
    finder, order = reach.finder, reach.order
    edges, walls = finder.edges, finder.query.walls
    found, pairs = [over_faces(walls, edges, order)], apart(finder)
    from_edge = reach.from_edges(pairs) if len(pairs) else []
    for count in range(order + 1) if len(pairs) else ():
        pair, between = between_edges(pairs, from_edge, count)
        between = np.pad(between, ((0, 0), (0, order - count)), constant_values=-1)
        for first in range(0, len(pair), _BATCH):
            some, met = pair[first : first + _BATCH], between[first : first + _BATCH]
            routes = _with_ends(walls, edges, some, np.full(some.shape, ACROSS_AIR), met)
            found.append(_seen_ends(finder, routes, count))
    return EdgeCandidates.joined(found)


def over_faces(walls: Walls, edges: Edges, order: int) -> EdgeCandidates:
    """Make routes without sides over faces that edges share: over ends, and over corners at which both end."""
    (pair, face), near = edges.pairs(), _NEAR * walls.size
    found = _with_ends(walls, edges, pair, face, np.full((len(pair), order), -1, dtype=np.int32))
    _, place, _ = off_edges(edges, found, edges.frames[found.edge[:, 1]], np.arange(len(found.edge)))
    (mine, mine_face), (theirs, their_face) = _ended(found)
    ahead = np.einsum("ni,ni->n", place - edges.start[theirs], edges.inward(theirs, their_face)) > near
    ends = np.stack([edges.start[theirs], edges.stop[theirs]], axis=1) - edges.start[mine, None]
    ahead &= np.einsum("nei,ni->ne", ends, edges.inward(mine, mine_face)).min(axis=1) > -near
    found = _part(found, np.flatnonzero(ahead))
    of_both, meeting = _of_both(walls, edges, found), _meeting(walls, edges, pair, face, order)
    return EdgeCandidates.joined([found, of_both, meeting])


def _seen_ends(finder: EdgeSearch, routes: EdgeCandidates, count: int) -> EdgeCandidates:
    """Return routes across air, by so many walls, with an end from which some of the other edge may be seen."""
    edges, walls, near = finder.edges, finder.query.walls, _NEAR * finder.query.walls.size
    seen = seen_frames(walls, edges, routes.edge[:, 1], routes.between)
    _, _, (x, y, _) = off_edges(edges, routes, seen, np.arange(len(routes.edge)))
    (mine, _), (theirs, _) = _ended(routes)
    last, real = (routes.end >= OF_LAST)[:, None, None], edges.frames[routes.edge[:, 0]]
    ended, other = np.where(last, seen, real), np.where(last, real, seen)
    ahead = in_air(edges.n[theirs], x, y, near)
    stops = other[:, 0] - ended[:, 0], other[:, 0] - ended[:, 0] + edges.length[theirs, None] * other[:, 3]
    heights = (np.einsum("ni,nai->an", stop, ended[:, 1:3]) for stop in stops)
    air = [in_air(edges.n[mine], x, y, near) for x, y in heights]
    routes = _part(routes, np.flatnonzero(ahead & (air[0] | air[1] | (edges.n[mine] < 1.0))))
    (mine, _), (theirs, _) = _ended(routes)
    place = np.where((routes.end % OF_LAST == 1)[:, None], edges.stop[mine], edges.start[mine])
    onto = routes.between[:, :count]  # from the other edge to the end
    onto = np.where((routes.end >= OF_LAST)[:, None], onto, onto[:, ::-1])
    left, share = np.flatnonzero(~in_planes(walls, place, onto).any(axis=1)), np.linspace(0.0, 1.0, PARTS + 1)
    hidden = np.ones(len(place), dtype=bool)
    for i in range(PARTS):
        start, stop = (x[theirs[left], None] for x in (edges.start, edges.stop))
        part = start + share[None, i : i + 2, None] * (stop - start)
        hidden[left[legs_open(walls, onto[left], part, place[left, None])]] = False
        left = left[hidden[left]]
    return _part(routes, np.flatnonzero(~hidden))


def _meeting(walls: Walls, edges: Edges, pair: Rows, face: Rows, order: int) -> EdgeCandidates:
    """Make routes over corners at which both edges of pairs (n, 2) end."""
    ends = np.stack([edges.start, edges.stop], axis=1)
    apart = np.linalg.norm(ends[pair[:, 0], :, None] - ends[pair[:, 1], None], axis=-1)
    free = edges.free[pair[:, 0], :, None] & edges.free[pair[:, 1], None]
    rows, one, other = np.nonzero(free & (apart <= _NEAR * walls.size))
    none, no_walls = np.empty((len(rows), 0), dtype=np.int32), np.full((len(rows), order), -1, dtype=np.int32)
    return EdgeCandidates(none, none, pair[rows], face[rows], MEETING + 2 * other + one, rows, no_walls)


def _of_both(walls: Walls, edges: Edges, routes: EdgeCandidates) -> EdgeCandidates:
    """Make routes over ends of both edges from those over one, where neither end is on the other edge's line."""
    (mine, my_face), (theirs, _) = _ended(routes)
    ends = np.stack([edges.start[theirs], edges.stop[theirs]], axis=1) - edges.start[mine, None]
    ahead = np.einsum("nei,ni->ne", ends, edges.inward(mine, my_face)) > _NEAR * walls.size
    rows, other = np.nonzero(edges.free[theirs] & ahead)
    found = _part(routes, rows)
    return replace(found, end=found.end + TWO_ENDS + 4 * other)


def _with_ends(walls: Walls, edges: Edges, pair: Rows, face: Rows, between: NDArray[np.int32]) -> EdgeCandidates:
    """Make routes over each free end of either edge of pairs (n, 2) that is not on the other edge's line."""
    count = len(pair)
    rows, end = np.tile(np.arange(count), 4), np.repeat(np.arange(4), count)
    none = np.empty((4 * count, 0), dtype=np.int32)
    routes = EdgeCandidates(none, none, pair[rows], face[rows], end, rows, between[rows])
    seen = seen_frames(walls, edges, routes.edge[:, 1], routes.between)
    _, _, (x, y, _) = off_edges(edges, routes, seen, np.arange(len(rows)))
    off_line = np.hypot(x, y) > _NEAR * walls.size
    return _part(routes, np.flatnonzero(edges.free[_ended(routes)[0][0], end % OF_LAST] & off_line))


def _ended(routes: EdgeCandidates) -> tuple[tuple[Rows, Rows], tuple[Rows, Rows]]:
    """Edges and shared faces (n,) of the edges that end, and of the other ones."""
    rows, last = np.arange(len(routes.edge)), (routes.end >= OF_LAST).astype(np.int64)
    return (routes.edge[rows, last], routes.face[rows, last]), (
        routes.edge[rows, 1 - last],
        routes.face[rows, 1 - last],
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Seen:
    """When an endpoint is seen, by number of walls; rows of request q are from `first[q]` to `first[q + 1]`."""

    first: Rows
    sequence: NDArray[np.int32]
    begin: Floats
    end: Floats


class _Sight:
    """When the source, row 0, or a receiver sees the ends and edges of routes by up to `most` (n,) walls."""

    def __init__(self, reach: EdgeReach, row: int, routes: EdgeCandidates, most: Rows) -> None:
        finder, sides = reach.finder, [reach.from_source, *reach.to_receivers][row]
        edges, walls, every = finder.edges, finder.query.walls, np.arange(len(routes.edge))
        self.row = row
        seen = seen_frames(walls, edges, routes.edge[:, 1], routes.between)
        _, _, (x, y, z) = off_edges(edges, routes, seen, every)
        edge = routes.edge[:, int(row > 0)]
        self._end = end_numbers(routes.end)[int(row > 0)]
        ended = self._end >= 0
        r = np.where(ended, _BESIDE * walls.size, np.hypot(x, y))
        z = np.where(ended, self._end * edges.length[edge], z)
        keys = np.round(np.column_stack([edge, self._end, r, z]), _SAME)
        _, some, self.request = np.unique(keys, axis=0, return_index=True, return_inverse=True)
        self.request = self.request.ravel()
        self._edge, self._end, r, z = edge[some], self._end[some], r[some], z[some]
        self._most = np.full(len(some), -1)
        np.maximum.at(self._most, self.request, most)
        half = 0.5 * np.pi * edges.n[self._edge]
        off = np.cos(half)[:, None] * edges.across[self._edge] + np.sin(half)[:, None] * edges.out[self._edge]
        place = edges.start[self._edge] + z[:, None] * edges.along[self._edge] + r[:, None] * off
        late = r / finder.query.medium.speed_of_sound * ((self._end >= 0) & (row == 0))  # from ends to what is beyond
        query, last = finder.query, float(finder.query.last.max(initial=0.0))
        span = (-reach.longest, last) if row == 0 else (float(query.first[row - 1]), float(query.last[row - 1]))
        requested = replace(
            query, trajectory_tables=_perturbed(with_points(query.trajectory_tables, row, place), row),
            medium=query.medium if row == 0 else _AT_ONCE, first=np.full(len(some), span[0]), last=span[1] + late,
        )  # fmt: skip
        device = None if finder.device is None else replace(finder.device, query=requested)
        self._finder = replace(finder, query=requested, device=device)
        self._seen = [self._found(sides, n, late) for n in range(int(most.max(initial=-1)) + 1)]

    def __len__(self) -> int:
        return len(self._seen)

    def __getitem__(self, count: int) -> _Seen:
        return self._seen[count]

    @property
    def fewest(self) -> Rows:
        """Fewest walls (n,) by which what routes ask for is seen, one more than was looked for where it never is."""
        seen = [np.diff(found.first) > 0 for found in self._seen]
        fewest: Rows = np.argmax([*seen, np.ones(len(self._edge), dtype=bool)], axis=0)
        return fewest[self.request]

    def _found(self, sides: Sides, count: int, late: Floats) -> _Seen:
        """Find when each request is seen by so many walls, and `late` (q,) before, s."""
        walls, edges, parts = self._finder.query.walls, self._finder.edges, [np.empty((0, count), dtype=np.int32)]
        for edge, end, most in zip(self._edge.tolist(), self._end.tolist(), self._most.tolist(), strict=True):
            sequence = sides[edge][count][: None if count <= most else 0]
            if end >= 0 and count:  # nothing comes to an end by a wall that it lies in
                sequence = sequence[~in_planes(walls, (edges.start, edges.stop)[end][edge], sequence).any(axis=1)]
            parts.append(sequence)
        request = np.repeat(np.arange(len(parts) - 1), [len(part) for part in parts[1:]])
        sequence, found = np.concatenate(parts), [np.empty((3, 0))]
        for begin in range(0, len(request), _BATCH):
            some = np.arange(begin, min(begin + _BATCH, len(request)))
            edge, none = self._edge[request[some]], np.empty((len(some), 0), dtype=np.int32)
            pair, face = np.stack([edge, edge], axis=1), np.full((len(some), 2), -1)
            wanted = EdgeCandidates(sequence[some], none, pair, face, self._end[request[some]], request[some], none)
            there = self._finder.find(wanted, 0)
            found.append(np.stack([some[there.path], there.begin, there.end]))
        rows, begins, ends = np.concatenate(found, axis=1)
        kept = rows.astype(np.int64)
        request = request[kept]
        first = np.searchsorted(request, np.arange(len(parts)))
        return _Seen(first, sequence[kept], begins - late[request], ends - late[request])


def _perturbed(tables: TrajectoryTables, row: int) -> TrajectoryTables:
    """Shift knots so that searches, which perturb both ends, perturb end `row` by its own way, and no places."""
    shift = np.full((len(tables.knots), 3), PERTURBATIONS[min(row, 1)] - PERTURBATIONS[0])
    shift[tables.places[1:, 0]] = -PERTURBATIONS[1]
    return replace(tables, knots=np.concatenate([tables.knots[:, :3] + shift, tables.knots[:, 3:]], axis=1))


def _joined(
    finder: EdgeSearch, routes: EdgeCandidates, left: Rows, requests: tuple[Rows, Rows], sights: tuple[_Sight, _Sight]
) -> Iterator[EdgeCandidates]:
    """Yield both sides of routes by up to `left` (n,) walls: candidates, with when they may be active."""
    most = range(int(left.max()) + 1)
    for n, m in ((n, m) for n in most[: len(sights[0])] for m in most[: len(sights[1])]):
        some, before, after = np.flatnonzero(left >= n + m), sights[0][n], sights[1][m]
        mine, theirs = requests[0][some], requests[1][some]
        count = np.cumsum(np.diff(before.first)[mine] * np.diff(after.first)[theirs])
        for part in np.split(np.arange(len(some)), np.flatnonzero(np.diff(count // _BATCH)) + 1):
            route, i = spread(before.first, mine[part])
            which, j = spread(after.first, theirs[part][route])
            route, i = some[part][route[which]], i[which]
            walls = (np.pad(x, ((0, 0), (0, len(most) - 1 - x.shape[1])), constant_values=-1)
                     for x in (before.sequence[i], after.sequence[j]))  # fmt: skip
            found = replace(_part(routes, route), receiver=np.full(len(route), sights[1].row - 1))
            found = replace(found, before=next(walls), after=next(walls))
            begin, end = (_received(finder, found, times) for times in (before.begin[i], before.end[i]))
            begin, end = np.maximum(begin, after.begin[j]), np.minimum(end, after.end[j])
            kept = np.flatnonzero(begin < end)
            yield replace(_part(found, kept), spans=(np.arange(len(kept)), begin[kept], end[kept]))


def _audible_ones(finder: EdgeSearch, found: EdgeCandidates, wave: float, direct: bool) -> EdgeCandidates:
    """Return candidates that are not quiet at all times."""
    assert found.spans is not None
    kept, (_, begin, end) = _audible(finder, found, wave, direct), found.spans
    return replace(_part(found, kept), spans=(np.arange(len(kept)), begin[kept], end[kept]))


def _audible(finder: EdgeSearch, found: EdgeCandidates, wave: float, direct: bool) -> Rows:
    """Find which candidates are not quiet at all times, see `loud`."""
    assert found.spans is not None
    every, begin, end = found.spans
    seen, scales = finder.visibility(found), finder.query.trajectory_tables.scales

    def levels(some: Rows, times: Floats) -> Floats:
        which = np.repeat(every[some], times.shape[1])
        return end_levels(seen, which, times.ravel(), wave, direct).reshape(times.shape)

    speed = scales[0, 2] + scales[1 + found.receiver, 2]
    keys = np.column_stack([found.receiver, found.edge, found.face, found.before, found.after, found.between])
    return loud(levels, (begin, end), speed, least_level(direct), (found.end, keys))


def _audible_rows(
    reach: EdgeReach, wanted: EdgeCandidates, adjacent: Any, notify: Any, wave: float, direct: bool
) -> list[dict[str, Any]]:
    """Return paths that candidates give, but those that are quiet while they are there."""
    found, query, order = list(rows_of(reach, wanted, adjacent, notify)), reach.finder.query, reach.order
    if not found:
        return found
    columns = {name: [row[name] for row in found] for name in found[0]}
    walls = np.full((3, len(found), order), -1, dtype=np.int32)
    for sequences, name in zip(walls, ("before", "after", "between"), strict=True):
        for row, sequence in zip(sequences, columns[name], strict=True):
            row[: len(sequence)] = sequence
    receiver = np.array(columns["receiver"])
    begin, end = np.maximum(columns["start"], 0.0), np.minimum(columns["end"], query.last[receiver])
    pair, face, ends = (np.array(columns[name]) for name in ("edges", "faces", "end_of"))
    some = EdgeCandidates(walls[0], walls[1], pair, face, ends, receiver, walls[2][:, : wanted.between.shape[1]])
    some = replace(some, spans=(np.arange(len(found)), begin, end))
    return [found[row] for row in _audible(reach.finder, some, wave, direct)]


def _received(finder: EdgeSearch, found: EdgeCandidates, times: Floats) -> Floats:
    """Compute when (n,) what is at the ends of candidates at times (n,), or at the last edges, is received, s."""
    edges, query, rows = finder.edges, finder.query, np.arange(len(times))
    seen = seen_frames(query.walls, edges, found.edge[:, 1], found.between)
    _, _, (x, y, z_c) = off_edges(edges, found, seen, rows)
    (first, number), row, edge = end_numbers(found.end), found.receiver + 1, found.edge[:, 1]
    last = number >= 0
    r_c, z_c = np.where(last, 0.0, np.hypot(x, y)), np.where(last, number * edges.length[edge], z_c)
    ends = [np.where((n == 1)[:, None], edges.stop[e], edges.start[e])
            for n, e in ((first, found.edge[:, 0]), (number, edge))]  # fmt: skip
    between = np.where(found.end >= TWO_ENDS, np.linalg.norm(ends[0] - ends[1], axis=1), 0.0)
    from_end = edges.start[edge] + z_c[:, None] * edges.along[edge]
    late = np.zeros(len(times))
    for _ in range(CONTRACTIONS):
        at = query.trajectory_tables.position(row, times + late) + PERTURBATIONS[1]
        at = query.trajectory_tables.lifted(row, at)
        r, _, z = edges.cylindrical(edge, imaged(query.walls, found.after, at))
        later = query.medium.passage(between + np.hypot(r + r_c, z - z_c), at - from_end).time - late
        late = late + later
        if not np.any(np.abs(later) > CONTRACTED):
            break
    return times + late
