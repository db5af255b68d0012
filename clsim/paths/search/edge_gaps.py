"""Candidates over two edges with air between: pairs of edges, walls, and when sound may run so.

Edges are cut into parts and time into cells. A way over a part of each of two edges is ruled out for a cell

- where an end is inside the wedge of an edge,
- where the way misses a wall that reflects it,
- where a wall hides all of it,
- where the angles with an edge before and behind it cannot be the same.

All tests are of convex hulls, so that no way is missed.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.acoustics.diffraction import adjacent_reflections
from clsim.arrays import Bools, ByRow, Floats, Ints, spread
from clsim.paths.chain import Chain
from clsim.paths.search.edges import EdgePaths, EdgeReach, Others, Requested, Sides
from clsim.paths.search.mesh import Progress
from clsim.paths.vertices.edge_pair import ACROSS_AIR, GapPairVertex
from clsim.paths.visibility.clearance import mirrored, segments_apart
from clsim.paths.visibility.edge_ends import seen_frames
from clsim.paths.visibility.edge_intervals import EdgeSearch
from clsim.paths.visibility.edges import EdgeCandidates
from clsim.paths.visibility.occlusion import CLEARLY, WallLookup
from clsim.scene.room.edges import Edges
from clsim.scene.room.walls import Walls

Numbers = NDArray[np.integer[Any]]

_NEAR = 1e-7  # of the room's size, up to which edges meet
_CELL = 0.03  # of the room's size, by which both ends move in a cell of time
_MOST_CELLS = 32
_MOST_FANS = 200_000  # of an end, in all cells
_BATCH = 20_000  # candidates searched at a time
PARTS = 8  # of an edge
_TOGETHER = 20_000  # ways looked at at a time
_OFF = 2e-7  # m, by which ends may be perturbed
_COPLANAR = 0.1  # of what is clear, from which on another edge is off a face
_CUBE = np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3, indexing="ij"), axis=-1).reshape(8, 3)


def gap_edge_paths(search: EdgePaths, others: Others, progress: Progress | None = None) -> Chain:
    """Find every path over two edges with air between, with up to `max_order` reflections before, between and after."""
    rows = search.rows(gap_candidates, others, progress, fewest=2)
    return search.chain(rows, GapPairVertex(**search.gap_columns(rows)))


def gap_candidates(reach: EdgeReach) -> Requested:
    """Yield candidates over two edges with air between, and the share of the work so far."""
    finder, order = reach.finder, reach.order
    edges, pairs = finder.edges, apart(finder)
    if not len(pairs):
        return
    from_edge, match = reach.from_edges(pairs), _Match(reach)
    fewest = adjacent_reflections(edges.n).min(axis=1)
    numbers = [(b, n, m) for b in range(order + 1) for n in range(order + 1 - b) for m in range(order + 1 - b - n)]
    for done, (b, n, m) in enumerate(numbers):
        if n == m == 0:
            kept = pairs[b + fewest[pairs].sum(axis=1) <= order]
            gaps = open_gaps(finder.query.walls, edges, *between_edges(kept, from_edge, b), match.cones(order - b))
        parts: list[EdgeCandidates] = []
        for i in np.flatnonzero(n + m + b + fewest[gaps.pair].sum(axis=1) <= order).tolist():
            parts += match.candidates(gaps, i, n, m)
            if sum(len(part.edge) for part in parts) >= _BATCH:
                yield done / len(numbers), EdgeCandidates.joined(parts)
                parts = []
        if parts:
            yield (done + 1) / len(numbers), EdgeCandidates.joined(parts)


def apart(finder: EdgeSearch) -> Ints:
    """List edges (n, 2), in either order, that share no face and do not meet."""
    edges, near = finder.edges, _NEAR * finder.query.walls.size
    ends = np.stack([edges.start, edges.stop], axis=1)
    separate = ~(edges.faces[:, None, :, None] == edges.faces[None, :, None, :]).any(axis=(2, 3))
    separate &= segments_apart(ends, edges.start, edges.stop) > near
    return np.argwhere(separate)


def between_edges(pairs: Ints, from_edge: list[Sides], count: int) -> tuple[Ints, NDArray[np.int32]]:
    """List pairs of edges (n, 2) and a number of walls (n, count) by which either may be reached from the other."""
    which, walls = [np.empty((0, 2), dtype=np.int64)], [np.empty((0, count), dtype=np.int32)]
    for one, other in pairs.tolist():
        back = {sequence[::-1].tobytes() for sequence in from_edge[other][one][count]}
        found = [sequence for sequence in from_edge[one][other][count] if sequence.tobytes() in back]
        which.append(np.tile([[one, other]], (len(found), 1)))
        walls += [sequence[None] for sequence in found]
    return np.concatenate(which), np.concatenate(walls)


class _Match:
    """Ways of ends to edges in cells of time, and when they meet ways between edges."""

    def __init__(self, reach: EdgeReach) -> None:
        query, tables = reach.finder.query, reach.finder.query.trajectory_tables
        self._finder, self._sides = reach.finder, [reach.from_source, *reach.to_receivers]
        last = float(query.last.max(initial=0.0))
        travel = last * (tables.scales[0, 2] + tables.scales[1:, 2].max(initial=0.0))
        sequences = max(sum(len(s) for of_edge in side for s in of_edge) for side in self._sides)
        most = min(_MOST_CELLS, max(1, _MOST_FANS // max(sequences, 1)))
        self._cuts = np.linspace(0.0, last, int(np.clip(math.ceil(travel / (_CELL * query.walls.size)), 1, most)) + 1)
        self._balls = []  # (C, 3) and (C,) that hold an end in each cell, the source that much before, m; one at rest
        for row in range(len(self._sides)):
            early = reach.longest if row == 0 else 0.0
            spans = [(self._cuts[0], self._cuts[-1])] if tables.scales[row, 2] == 0.0 else pairwise(self._cuts)
            balls = [tables.sphere(row, begin - early, end) for begin, end in spans]
            self._balls.append((np.array([centre for centre, _ in balls]), np.array([radius for _, radius in balls])))
        self._every = cache(
            lambda row, edge, count: fans_of_ends(self._finder, edge, self._sides[row][edge][count], *self._balls[row])
        )
        self._open = cache(self._unhidden)

    def _unhidden(self, row: int, edge: int, count: int) -> Fans:
        sequence, fans = self._sides[row][edge][count], self._every(row, edge, count)
        return unhidden(self._finder, edge, sequence, *self._balls[row], fans)

    def cones(self, order: int) -> tuple[Fans, Fans]:
        """Fans (edges, parts) that hold those of all ways with up to so many walls, of the source and of receivers."""
        ends = range(1), range(1, len(self._sides))
        before, after = (
            [
                Fans.hull([self._every(row, edge, count) for row in rows for count in range(order + 1)])
                for edge in range(len(self._finder.edges))
            ]
            for rows in ends
        )
        return Fans.stacked(before), Fans.stacked(after).turned()

    def candidates(self, gaps: Gaps, i: int, before: int, after: int) -> Iterator[EdgeCandidates]:
        """Yield candidates over a gap with so many walls before and after it, of each receiver."""
        (one, other), query = gaps.pair[i].tolist(), self._finder.query
        first = _flat(gaps.fans[0].part(i).meet(self._open(0, one, before), 0))
        for row in range(1, len(self._sides)) if first.any() else ():
            last = _flat(gaps.fans[1].part(i).meet(self._open(row, other, after).turned(), 1))
            # None before and after.
            there = np.zeros((len(self._cuts) + 1, first.shape[1], last.shape[1]), dtype=np.int8)
            there[1:-1] = first @ last.swapaxes(1, 2) > 0.0
            i_j = np.argwhere(there.any(axis=0))
            if not len(i_j):
                continue
            steps = np.diff(there[:, i_j[:, 0], i_j[:, 1]].T, axis=1)
            (which, begin), (_, end) = np.nonzero(steps == 1), np.nonzero(steps == -1)
            begins = np.maximum(self._cuts[begin], query.first[row - 1])
            ends, count = np.minimum(self._cuts[end], query.last[row - 1]), len(i_j)
            yield EdgeCandidates(
                self._sides[0][one][before][i_j[:, 0]], self._sides[row][other][after][i_j[:, 1]],
                np.tile(gaps.pair[i], (count, 1)), np.full((count, 2), ACROSS_AIR), np.full(count, -1),
                np.full(count, row - 1), np.tile(gaps.walls[i], (count, 1)), (which, begins, ends),
            )  # fmt: skip


def _flat(lengths: Floats) -> Floats:
    """Ways (C, n, parts, parts) with the parts of both edges along one axis."""
    return lengths.reshape(*lengths.shape[:2], PARTS**2)


@dataclass(frozen=True, slots=True, eq=False)
class Fans(ByRow):
    """Which parts of edges may be met on ways (..., parts), and the cotangents of their angles with the edges there."""

    free: Bools
    low: Floats
    high: Floats

    @staticmethod
    def hull(every: list[Fans]) -> Fans:
        """Fan (parts,) that holds several (..., parts)."""
        free, low, high = (np.concatenate([getattr(fan, name).reshape(-1, PARTS) for fan in every]) for name in _NAMES)
        lowest, highest = np.where(free, low, np.inf).min(axis=0, initial=np.inf), np.where(free, high, -np.inf)
        return Fans(np.any(free, axis=0), lowest, highest.max(axis=0, initial=-np.inf))

    @staticmethod
    def stacked(every: list[Fans]) -> Fans:
        """Return several as one, along a new first axis."""
        return Fans(*(np.stack([getattr(fan, name) for fan in every]) for name in _NAMES))

    def turned(self) -> Fans:
        """Return the ways the other way round."""
        return Fans(self.free, -self.high, -self.low)

    def meet(self, ends: Fans, edge: int) -> Floats:
        """Mask (..., parts, parts) of ways between edges that go on as ways (..., parts) of ends, as numbers."""
        free, low, high = (np.expand_dims(getattr(ends, name), -2 if edge else -1) for name in _NAMES)
        return np.asarray(self.free & free & (low <= self.high) & (high >= self.low), dtype=np.float32)


_NAMES = "free", "low", "high"


def fans_of_ends(
    finder: EdgeSearch, edge: int, sequence: NDArray[np.int32], centre: Floats, radius: Floats
) -> Fans:  # fmt: skip
    """Ways by sequences of walls (n, N) from balls (C, 3) and (C,), m, to an edge (C, n, parts), also hidden ones."""
    walls, edges, frame = finder.query.walls, finder.edges, finder.edges.frames[edge]
    shape, near = (len(radius), len(sequence), PARTS), CLEARLY * finder.query.walls.size
    ball, row = (x.ravel() for x in np.indices(shape[:2]))
    image, size = centre[ball], radius[ball] + _OFF
    for wall in sequence[row].T:
        image = mirrored(walls, wall, image)
    x, y, z = ((image - frame[0]) @ frame[axis] for axis in (1, 2, 3))
    free = np.repeat(in_air(edges.n[edge], x, y, -near - size)[:, None], PARTS, axis=1)
    places, r = np.linspace(0.0, edges.length[edge], PARTS + 1), np.hypot(x, y)
    heights = places[:-1] - (z + size)[:, None], places[1:] - (z - size)[:, None]
    low, high = cotangents(*heights, np.maximum(r - size, near)[:, None], (r + size)[:, None])
    return Fans(free.reshape(shape), low.reshape(shape), high.reshape(shape))


def unhidden(
    finder: EdgeSearch, edge: int, sequence: NDArray[np.int32], centre: Floats, radius: Floats, fans: Fans
) -> Fans:  # fmt: skip
    """Return the ways of `fans_of_ends` without those that walls hide, or that miss walls they are reflected by."""
    frame, free = finder.edges.frames[[edge]], fans.free.copy()
    ball, row, part = np.nonzero(fans.free)
    corners = centre[ball, None] + (radius[ball] + _OFF)[:, None, None] * _CUBE
    ends = _places(frame, finder.edges.length[[edge]])[0, np.stack([part, part + 1], axis=1)]
    free[ball, row, part] = legs_open(finder.query.walls, sequence[row], corners, ends)
    return Fans(free, fans.low, fans.high)


@dataclass(frozen=True, slots=True, eq=False)
class Gaps:
    """Pairs of edges (n, 2) and walls (n, B) between them, with the ways from parts of the first to parts of the last.

    Of both fans (n, parts, parts) the first has the angles at the first edges, the other those at the last ones.
    """

    pair: NDArray[np.int64]
    walls: NDArray[np.int32]
    fans: tuple[Fans, Fans]


def open_gaps(
    walls: Walls, edges: Edges, pair: Ints, between: NDArray[np.int32], ends: tuple[Fans, Fans] | None = None
) -> Gaps:
    """Find the pairs of edges (n, 2) some parts of which may see each other by walls (n, B), and ends by fans."""
    frames = edges.frames[pair[:, 0]], seen_frames(walls, edges, pair[:, 1], between)
    length, real = edges.length[pair], edges.frames[pair[:, 1]]
    seen = [_places(frame, length[:, i]) for i, frame in enumerate(frames)]
    here, there = (
        _seen(frames[i], edges.n[pair[:, i]], seen[1 - i], length[:, i], CLEARLY * walls.size) for i in (0, 1)
    )
    there = Fans(there.free.swapaxes(1, 2), there.low.swapaxes(1, 2), there.high.swapaxes(1, 2)).turned()
    free = here.free & there.free
    here, there = Fans(free, here.low, here.high), Fans(free, there.low, there.high)
    if ends is not None:
        free = (here.meet(ends[0].part(pair[:, 0]), 0) * there.meet(ends[1].part(pair[:, 1]), 1)).astype(bool)
    g, i, j = np.nonzero(free)
    parts = [
        places[g[:, None], np.stack([part, part + 1], axis=1)]
        for places, part in ((seen[0], i), (_places(real, length[:, 1]), j))
    ]
    free[g, i, j] = legs_open(walls, between[g], *parts)
    kept = np.flatnonzero(free.any(axis=(1, 2)))
    fans = (Fans(free[kept], fan.low[kept], fan.high[kept]) for fan in (here, there))
    return Gaps(pair[kept], between[kept], (next(fans), next(fans)))


def _places(frame: Floats, length: Floats) -> Floats:
    """Places (n, parts + 1, 3) between the parts of edges of frames (n, 4, 3) and lengths (n,), m."""
    share = np.linspace(0.0, 1.0, PARTS + 1)
    return np.asarray(frame[:, None, 0] + (share * length[:, None])[..., None] * frame[:, None, 3])


def _seen(frame: Floats, n: Floats, other: Floats, length: Floats, near: float) -> Fans:
    """Ways (n, parts, parts) from parts of edges of frames (n, 4, 3) to those between places (n, parts + 1, 3)."""
    x, y, z = (np.einsum("npi,ni->np", other - frame[:, None, 0], frame[:, axis]) for axis in (1, 2, 3))
    beside = np.sin(np.pi * n)[:, None] * x - np.cos(np.pi * n)[:, None] * y
    above, beside = (np.maximum(h[:, :-1], h[:, 1:]) > _COPLANAR * near for h in (y, beside))
    air = np.where(n[:, None] < 1.0, above & beside, above | beside)
    places, r = np.linspace(0.0, 1.0, PARTS + 1) * length[:, None], np.hypot(x, y)
    low = np.minimum(z[:, :-1], z[:, 1:])[:, None, :] - places[:, 1:, None]
    high = np.maximum(z[:, :-1], z[:, 1:])[:, None, :] - places[:, :-1, None]
    flat = np.stack([x, y], axis=2)
    least = np.maximum(segment_off(np.stack([flat[:, :-1], flat[:, 1:]], axis=2)), near)
    most = np.maximum(np.maximum(r[:, :-1], r[:, 1:]), near)
    return Fans(np.repeat(air[:, None], PARTS, axis=1), *cotangents(low, high, least[:, None], most[:, None]))


def in_air(n: Floats | float, x: Floats, y: Floats, least: Floats | float) -> Bools:
    """Mask (...) of places at x and y about edges that are in the air of their wedges, by at least so much, m."""
    above, beside = y > least, np.sin(np.pi * n) * x - np.cos(np.pi * n) * y > least
    return np.asarray(np.where(np.asarray(n) < 1.0, above & beside, above | beside))


def cotangents(low: Floats, high: Floats, least: Floats, most: Floats) -> tuple[Floats, Floats]:
    """Least and largest ratios of heights from low to high over distances from least to most."""
    return low / np.where(low < 0.0, least, most), high / np.where(high > 0.0, least, most)


def segment_off(ends: Floats) -> Floats:
    """Distances (...) of segments between places (..., k, 2) from the origin; of one place, its own."""
    a, along = ends[..., 0, :], ends[..., -1, :] - ends[..., 0, :]
    share = np.clip(-np.sum(a * along, axis=-1) / np.maximum(np.sum(along**2, axis=-1), 1e-300), 0.0, 1.0)
    return np.asarray(np.linalg.norm(a + share[..., None] * along, axis=-1))


def legs_open(walls: Walls, sequence: NDArray[np.int32], first: Floats, last: Floats) -> Bools:
    """Mask of sequences of walls (n, N) by which something of hulls (n, a, 3) may see something of others (n, b, 3)."""
    parts = (slice(i, i + _TOGETHER) for i in range(0, len(sequence), _TOGETHER))
    found = [_legs_open(walls, sequence[part], first[part], last[part]) for part in parts]
    return np.concatenate([np.empty(0, dtype=bool), *found])


def _legs_open(walls: Walls, sequence: NDArray[np.int32], first: Floats, last: Floats) -> Bools:
    starts, stops = [first], [last]
    for wall in sequence.T:
        starts.append(_mirrored(walls, wall, starts[-1]))
    for wall in sequence.T[::-1]:
        stops.insert(0, _mirrored(walls, wall, stops[0]))
    free = np.ones(len(sequence), dtype=bool)
    for k, wall in enumerate(sequence.T):
        rows = np.flatnonzero(free)
        free[rows] = _may_meet(walls, wall[rows], starts[k + 1][rows], stops[k + 1][rows])
    for leg in range(sequence.shape[1] + 1):
        rows = np.flatnonzero(free)
        ends = sequence[rows, leg - 1] if leg else None, sequence[rows, leg] if leg < sequence.shape[1] else None
        free[rows] = ~_hidden(walls, ends, starts[leg][rows], stops[leg][rows])
    return free


def _mirrored(walls: Walls, wall: Numbers, points: Floats) -> Floats:
    return np.asarray(points - 2.0 * _heights(walls, wall, points)[..., None] * walls.normal[wall][:, None])


def _heights(walls: Walls, wall: Numbers, points: Floats) -> Floats:
    """Heights (n, a) of points (n, a, 3) over walls (n,), m."""
    return np.asarray(np.einsum("nai,ni->na", points, walls.normal[wall]) - walls.offset[wall][:, None])


def _apart(before: Floats, behind: Floats) -> Floats:
    """Least heights (n,) of hulls on both sides of walls, at heights (n, a) and (n, b), m; below 0 where not."""
    one, other = (
        np.minimum(-before.max(axis=1), behind.min(axis=1)),
        np.minimum(before.min(axis=1), -behind.max(axis=1)),
    )
    return np.asarray(np.maximum(one, other))


def _crossings(before: Floats, behind: Floats, start: Floats, stop: Floats) -> Floats:
    """Places (n, a b, 3) at height 0 on lines between points (n, a, 3) and (n, b, 3) at given heights."""
    share = before[:, :, None] / (before[:, :, None] - behind[:, None, :])
    points = start[:, :, None] + share[..., None] * (stop[:, None] - start[:, :, None])
    return points.reshape(len(points), start.shape[1] * stop.shape[1], 3)


def _may_meet(walls: Walls, wall: Numbers, start: Floats, stop: Floats) -> Bools:
    """Mask of lines from image hulls (n, a, 3) to others (n, b, 3) of which some may cross walls (n,)."""
    near = CLEARLY * walls.size
    before, behind = _heights(walls, wall, start), _heights(walls, wall, stop)
    both = np.concatenate([before, behind], axis=1)
    meets = (both.min(axis=1) <= near) & (both.max(axis=1) >= -near)
    apart = _apart(before, behind)
    whole = walls.first_piece[wall + 1] - walls.first_piece[wall] == 1
    rows = np.flatnonzero(meets & (apart > near) & whole)
    points = _crossings(before[rows], behind[rows], start[rows], stop[rows])
    of, line = spread(walls.first_line, walls.first_piece[wall[rows]])
    off = np.einsum("nai,ni->na", points[of], walls.line[line, :3]) - walls.line[line, 3, None]
    meets[rows[of[off.max(axis=1) < -near]]] = False
    return np.asarray(meets)


def _hidden(walls: Walls, mirrors: tuple[Any, Any], start: Floats, stop: Floats) -> Bools:
    """Mask of lines from hulls (n, a, 3) to others (n, b, 3) all of which a wall hides between two mirrors (n,)."""
    near, hidden = CLEARLY * walls.size, np.zeros(len(start), dtype=bool)
    row, wall, piece = WallLookup(walls).crossings(start.mean(axis=1), stop.mean(axis=1))
    kept = walls.plane[wall] >= 0
    for mirror in mirrors:
        if mirror is not None:
            kept &= walls.plane[wall] != walls.plane[mirror[row]]
    row, wall, piece = row[kept], wall[kept], piece[kept]
    before, behind = _heights(walls, wall, start[row]), _heights(walls, wall, stop[row])
    apart = _apart(before, behind)
    clear = np.flatnonzero(apart > near)
    row, piece = row[clear], piece[clear]
    points = _crossings(before[clear], behind[clear], start[row], stop[row])
    covers = np.ones(len(row), dtype=bool)
    for mirror, ends in zip(mirrors, (start, stop), strict=True):
        if mirror is not None:
            off, beyond = _heights(walls, mirror[row], ends[row]), _heights(walls, mirror[row], points)
            above = (off.max(axis=1) < 0.0) & (beyond.min(axis=1) > near)
            covers &= above | (off.min(axis=1) > 0.0) & (beyond.max(axis=1) < -near)
    of, line = spread(walls.first_line, piece)
    inside = np.einsum("nai,ni->na", points[of], walls.line[line, :3]) - walls.line[line, 3, None]
    covers[of[inside.min(axis=1) < near]] = False
    hidden[row[covers]] = True
    return hidden
