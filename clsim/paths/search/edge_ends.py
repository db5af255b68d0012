"""Paths over an edge and a free end of another edge: where those over two edges run off an end of one.

The end rests. So both sides of a path are found apart: from the source to the end or the edge, and likewise from each
receiver. A path is active while both are, later by what sound takes from the end to the receiver.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from clsim.acoustics.diffraction import adjacent_reflections
from clsim.arrays import spread
from clsim.paths.propagation import UniformAir
from clsim.paths.search.edge_chains import end_chain, with_swaps
from clsim.paths.search.edge_gaps import apart, between_edges
from clsim.paths.search.edges import in_planes, rows_of
from clsim.paths.search.gap_parts import PARTS, legs_open, open_gaps
from clsim.paths.trajectory_tables import PERTURBATIONS, with_points
from clsim.paths.vertices.edge_end import OF_LAST
from clsim.paths.vertices.gap_pair import ACROSS_AIR
from clsim.paths.visibility.edge_ends import end_levels, off_edges
from clsim.paths.visibility.edge_gaps import seen_frames
from clsim.paths.visibility.edges import CONTRACTED, CONTRACTIONS, MEETING, EdgeCandidates, imaged

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from clsim.arrays import Floats
    from clsim.paths.chain import Chain
    from clsim.paths.family import PathFamily
    from clsim.paths.options import PathOptions
    from clsim.paths.search.edges import Reached, Sides
    from clsim.paths.visibility.edge_intervals import EdgeSearch
    from clsim.scene.scene import Scene

    Rows = NDArray[np.int64]

_NEAR = 1e-7  # of the room's size, up to which an end is on another edge
_BESIDE = 0.1  # of the room's size, from an end to the place that stands for what is beyond it
_QUIET = 1e-3  # pressure over that in free air: paths that stay below it are left out
_SAMPLED = np.linspace(0.0, 1.0, 9)  # of an interval, where it is looked how loud a path is
_AT_ONCE = UniformAir(1e15)  # without delays
_SAME = 9  # decimals of places that are the same, m


def end_edge_paths(scene: Scene, search: PathOptions, others: tuple[PathFamily, ...]) -> Chain:
    """Return every path over an edge and a free end of another one.

    others: paths without edges, over one and over two, whose times are taken as by `double_edge_paths`.
    """
    lowest = min((source.emitted.centre_frequency for source in scene.sources), default=0.0)
    wave = 2.0 * np.pi * lowest / scene.air.speed_of_sound
    rows, order, within = rows_of(scene, search, others, partial(end_candidates, wave=wave))
    return with_swaps(end_chain(scene, order, rows), within)


def end_candidates(
    finder: EdgeSearch, sides: tuple[Sides, list[Sides]], reached: Reached, order: int, longest: float, wave: float
) -> Iterator[tuple[float, EdgeCandidates]]:
    """Yield candidates over an edge and an end of another one, with the times of both sides, and the share of the work.

    wave: wave number at which those that stay below `_QUIET` are left out, 1/m.

    sides, reached, longest: see `gap_candidates`.
    """
    movers, edges = [sides[0], *sides[1]], finder.edges
    fewest = adjacent_reflections(edges.n).min(axis=1)
    for count, routes in enumerate(_routes(finder, reached, order)):
        routes = _part(routes, np.flatnonzero(routes.between.shape[1] + fewest[routes.edge].sum(axis=1) <= order))
        if not len(routes.edge):
            continue
        least = routes.between.shape[1] + fewest[routes.edge].sum(axis=1)
        sights = [_Sight(finder, row, mover, routes, order, longest) for row, mover in enumerate(movers)]
        for n in range(order + 1):
            for m in range(order + 1 - n):
                some = np.flatnonzero(least + n + m <= order)
                for receiver in range(1, len(movers)) if len(some) else ():
                    found = _joined(finder, routes, some, (sights[0], sights[receiver]), (n, m))
                    found = _audible_ones(finder, found, wave)
                    if len(found.edge):
                        yield count / (order + 2), found


def _part(routes: EdgeCandidates, rows: Rows) -> EdgeCandidates:
    names = "before", "after", "edge", "face", "end", "receiver", "between"
    return EdgeCandidates(**{name: getattr(routes, name)[rows] for name in names})


def _routes(finder: EdgeSearch, reached: Reached, order: int) -> Iterator[EdgeCandidates]:
    """Yield routes without sides: over faces that edges share, and across air by 0, 1, … walls."""
    edges, near = finder.edges, _NEAR * finder.query.walls.size
    pair, face = edges.pairs()
    over_faces = _with_ends(finder, pair, face, np.empty((len(pair), 0), dtype=np.int32))
    _, place, _ = off_edges(edges, over_faces, edges.frames[over_faces.edge[:, 1]], np.arange(len(over_faces.edge)))
    (mine, mine_face), (theirs, their_face) = _ended(over_faces)
    ahead = np.einsum("ni,ni->n", place - edges.start[theirs], edges.inward(theirs, their_face)) > near
    ends = np.stack([edges.start[theirs], edges.stop[theirs]], axis=1) - edges.start[mine, None]
    ahead &= np.einsum("nei,ni->ne", ends, edges.inward(mine, mine_face)).min(axis=1) > -near
    yield _part(over_faces, np.flatnonzero(ahead))
    yield _meeting(finder, pair, face)
    pairs = apart(finder)
    balls = zip(0.5 * (edges.start + edges.stop), 0.5 * edges.length, strict=True)
    from_edge = [reached(ball) if e in pairs else [] for e, ball in enumerate(balls)] if len(pairs) else []
    for count in range(order + 1) if len(pairs) else ():
        gaps = open_gaps(finder.query.walls, edges, *between_edges(pairs, from_edge, count))
        routes = _with_ends(finder, gaps.pair, np.full(gaps.pair.shape, ACROSS_AIR), gaps.walls)
        free = gaps.fans[0].free  # of the parts that the ends are ends of
        of_end = np.stack([free[:, 0].any(axis=1), free[:, -1].any(axis=1), free[..., 0].any(axis=1),
                           free[..., -1].any(axis=1)])  # fmt: skip
        routes = _part(routes, np.flatnonzero(of_end[routes.end, routes.receiver]))
        yield _part(routes, np.flatnonzero(_may_be_seen(finder, routes)))


def _may_be_seen(finder: EdgeSearch, routes: EdgeCandidates) -> NDArray[np.bool_]:
    """Mask of routes (n,) across air with an end from which some of the other edge may be seen."""
    edges, walls, count = finder.edges, finder.query.walls, len(routes.edge)
    last, seen = routes.end >= OF_LAST, np.zeros(count, dtype=bool)
    (mine, _), (theirs, _) = _ended(routes)
    place = np.where((routes.end % OF_LAST == 1)[:, None], edges.stop[mine], edges.start[mine])
    onto = np.where(last[:, None], routes.between, routes.between[:, ::-1])  # from the other edge to the end
    rows = np.flatnonzero(~in_planes(walls, place, onto).any(axis=1))
    share = np.linspace(0.0, 1.0, PARTS + 1)
    for i in range(PARTS):
        left = rows[~seen[rows]]
        start, stop = (x[theirs[left], None] for x in (edges.start, edges.stop))
        part = start + share[None, i : i + 2, None] * (stop - start)
        seen[left] = legs_open(walls, onto[left], part, place[left, None])
    hidden = np.ones(count, dtype=bool)
    hidden[rows] = ~seen[rows]
    return ~hidden


def _meeting(finder: EdgeSearch, pair: Rows, face: Rows) -> EdgeCandidates:
    """Make routes over corners at which both edges of pairs (n, 2) end."""
    edges = finder.edges
    ends = np.stack([edges.start, edges.stop], axis=1)
    apart = np.linalg.norm(ends[pair[:, 0], :, None] - ends[pair[:, 1], None], axis=-1)
    free = edges.free[pair[:, 0], :, None] & edges.free[pair[:, 1], None]
    rows, one, other = np.nonzero(free & (apart <= _NEAR * finder.query.walls.size))
    none = np.empty((len(rows), 0), dtype=np.int32)
    return EdgeCandidates(none, none, pair[rows], face[rows], MEETING + 2 * other + one, rows, none)


def _with_ends(finder: EdgeSearch, pair: Rows, face: Rows, between: NDArray[np.int32]) -> EdgeCandidates:
    """Make routes over each free end of either edge of pairs (n, 2) that is not on the other edge.

    In the place of receivers they have the numbers of the pairs.
    """
    edges, count = finder.edges, len(pair)
    rows, end = np.tile(np.arange(count), 4), np.repeat(np.arange(4), count)
    none = np.empty((4 * count, 0), dtype=np.int32)
    routes = EdgeCandidates(none, none, pair[rows], face[rows], end, rows, between[rows])
    seen = seen_frames(finder.query.walls, edges, routes.edge[:, 1], routes.between)
    _, _, (x, y, z) = off_edges(edges, routes, seen, np.arange(len(rows)))
    mine, theirs = (edge for edge, _ in _ended(routes))
    beside = np.maximum(np.maximum(-z, z - edges.length[theirs]), 0.0)
    apart = np.hypot(np.hypot(x, y), beside) > _NEAR * finder.query.walls.size
    off_line = np.hypot(x, y) > _NEAR * finder.query.walls.size
    return _part(routes, np.flatnonzero(edges.free[mine, end % OF_LAST] & apart & off_line))


def _ended(routes: EdgeCandidates) -> tuple[tuple[Rows, Rows], tuple[Rows, Rows]]:
    """Edges and shared faces (n,) of the edges that end, and of the other ones."""
    rows, last = np.arange(len(routes.edge)), (routes.end >= OF_LAST).astype(np.int64)
    return (routes.edge[rows, last], routes.face[rows, last]), (
        routes.edge[rows, 1 - last],
        routes.face[rows, 1 - last],
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Seen:
    """When an endpoint is seen, by number of walls: sequences of these (n, N), from and up to when (n,), s.

    Those of request q are from `first[q]` to `first[q + 1]`.
    """

    first: Rows
    sequence: NDArray[np.int32]
    begin: Floats
    end: Floats


class _Sight:
    """When the source, row 0, or a receiver sees the ends and edges of routes.

    What is beyond an end or an edge is a place at rest in its air: as far from the edge, and along it, as the end.
    """

    def __init__(
        self, finder: EdgeSearch, row: int, sides: Sides, routes: EdgeCandidates, order: int, longest: float
    ) -> None:
        edges, walls, every = finder.edges, finder.query.walls, np.arange(len(routes.edge))
        self.row = row
        seen = seen_frames(walls, edges, routes.edge[:, 1], routes.between)
        _, _, (x, y, z) = off_edges(edges, routes, seen, every)
        edge = routes.edge[:, int(row > 0)]
        ended = (routes.end >= OF_LAST) == (row > 0)
        ended |= routes.end >= MEETING
        number = np.where((routes.end >= MEETING) & (row > 0), routes.end // 2, routes.end) % 2
        self._end = np.where(ended, number, -1)
        r = np.where(ended, _BESIDE * walls.size, np.hypot(x, y))
        z = np.where(ended, self._end * edges.length[edge], z)
        keys = np.round(np.column_stack([edge, self._end, r, z]), _SAME)
        _, some, self.request = np.unique(keys, axis=0, return_index=True, return_inverse=True)
        self.request = self.request.ravel()
        self._edge, self._end, r, z = edge[some], self._end[some], r[some], z[some]
        half = 0.5 * np.pi * edges.n[self._edge]
        off = np.cos(half)[:, None] * edges.across[self._edge] + np.sin(half)[:, None] * edges.out[self._edge]
        place = edges.start[self._edge] + z[:, None] * edges.along[self._edge] + r[:, None] * off
        late = r / finder.query.medium.speed_of_sound * ((self._end >= 0) & (row == 0))  # from ends to what is beyond
        query, last = finder.query, float(finder.query.last.max(initial=0.0))
        span = (-longest, last) if row == 0 else (float(query.first[row - 1]), float(query.last[row - 1]))
        requested = replace(
            query, trajectory_tables=with_points(query.trajectory_tables, row, place),
            medium=query.medium if row == 0 else _AT_ONCE, first=np.full(len(some), span[0]), last=span[1] + late,
        )  # fmt: skip
        device = None if finder.device is None else finder.device.for_query(requested)
        self._finder = replace(finder, query=requested, device=device)
        self._seen = [self._found(sides, n, late) for n in range(order + 1)]

    def __getitem__(self, count: int) -> _Seen:
        return self._seen[count]

    def _found(self, sides: Sides, count: int, late: Floats) -> _Seen:
        """Find when each request is seen by so many walls, and `late` (q,) before, s."""
        walls, edges, parts = self._finder.query.walls, self._finder.edges, [np.empty((0, count), dtype=np.int32)]
        for edge, end in zip(self._edge.tolist(), self._end.tolist(), strict=True):
            sequence = sides[edge][count]
            if end >= 0 and count:  # nothing comes to an end by a wall that it lies in
                sequence = sequence[~in_planes(walls, (edges.start, edges.stop)[end][edge], sequence).any(axis=1)]
            parts.append(sequence)
        request = np.repeat(np.arange(len(parts) - 1), [len(part) for part in parts[1:]])
        sequence = np.concatenate(parts)
        none, same = np.empty((len(request), 0), dtype=np.int32), np.repeat(self._edge[request, None], 2, axis=1)
        wanted = EdgeCandidates(
            sequence, none, same, np.full(same.shape, -1), self._end[request], request, none
        )  # fmt: skip
        found = self._finder.find(wanted, 0)
        request = request[found.path]
        first = np.searchsorted(request, np.arange(len(parts)))
        return _Seen(first, sequence[found.path], found.begin - late[request], found.end - late[request])


def _joined(
    finder: EdgeSearch, routes: EdgeCandidates, some: Rows, sights: tuple[_Sight, _Sight], counts: tuple[int, int]
) -> EdgeCandidates:
    """Join both sides of some routes by so many walls each: candidates, with when they may be active."""
    (before, after), requests = (sight[n] for sight, n in zip(sights, counts, strict=True)), [s.request for s in sights]
    mine, theirs = requests[0][some], requests[1][some]
    route, i = spread(before.first, mine)
    which, j = spread(after.first, theirs[route])
    route, i = some[route[which]], i[which]
    receiver = np.full(len(route), sights[1].row - 1)
    found = replace(_part(routes, route), before=before.sequence[i], after=after.sequence[j], receiver=receiver)
    begin, end = (_received(finder, found, times) for times in (before.begin[i], before.end[i]))
    begin, end = np.maximum(begin, after.begin[j]), np.minimum(end, after.end[j])
    kept = np.flatnonzero(begin < end)
    return replace(_part(found, kept), spans=(np.arange(len(kept)), begin[kept], end[kept]))


def _audible_ones(finder: EdgeSearch, found: EdgeCandidates, wave: float) -> EdgeCandidates:
    """Return candidates without those that are quiet at some times of theirs."""
    assert found.spans is not None
    every, begin, end = found.spans
    seen, loudest = finder.visibility(found), np.zeros(len(every))
    for share in _SAMPLED if len(every) else ():
        loudest = np.maximum(loudest, end_levels(seen, finder.query, every, begin + share * (end - begin), wave))
    kept = np.flatnonzero(loudest > _QUIET)
    return replace(_part(found, kept), spans=(np.arange(len(kept)), begin[kept], end[kept]))


def _received(finder: EdgeSearch, found: EdgeCandidates, times: Floats) -> Floats:
    """Compute when (n,) what is at the ends of candidates at times (n,), or at the last edges, is received, s."""
    edges, query, rows = finder.edges, finder.query, np.arange(len(times))
    seen = seen_frames(query.walls, edges, found.edge[:, 1], found.between)
    along, _, (x, y, z_c) = off_edges(edges, found, seen, rows)
    last, row, edge = found.end >= OF_LAST, found.receiver + 1, found.edge[:, 1]
    r_c, z_c = np.where(last, 0.0, np.hypot(x, y)), np.where(last, along, z_c)
    from_end = edges.start[edge] + z_c[:, None] * edges.along[edge]
    late = np.zeros(len(times))
    for _ in range(CONTRACTIONS):
        at = query.trajectory_tables.position(row, times + late) + PERTURBATIONS[1]
        at = query.trajectory_tables.lifted(row, at)
        r, _, z = edges.cylindrical(edge, imaged(query.walls, found.after, at))
        later = query.medium.passage(np.hypot(r + r_c, z - z_c), at - from_end).time - late
        late = late + later
        if not np.any(np.abs(later) > CONTRACTED):
            break
    return times + late
