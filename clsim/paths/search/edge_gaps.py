"""Candidates over two edges with air between: pairs of edges, walls, and when sound may run so."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from clsim.acoustics.diffraction import adjacent_reflections
from clsim.arrays import Floats
from clsim.paths.chain import Chain
from clsim.paths.search.edges import EdgePaths, EdgeReach, Others, Requested, Sides
from clsim.paths.search.gap_parts import PARTS, Fans, Gaps, fans_of_ends, open_gaps, unhidden
from clsim.paths.search.mesh import Progress
from clsim.paths.vertices.gap_pair import ACROSS_AIR, GapPairVertex
from clsim.paths.visibility.clearance import segments_apart
from clsim.paths.visibility.edge_intervals import EdgeSearch
from clsim.paths.visibility.edges import EdgeCandidates

Ints = NDArray[np.int64]

_NEAR = 1e-7  # of the room's size, up to which edges meet
_CELL = 0.03  # of the room's size, by which both ends move in a cell of time
_MOST_CELLS = 32
_MOST_FANS = 200_000  # of an end, in all cells
_BATCH = 20_000  # candidates searched at a time


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
        self._balls = [self._balls_of(row, reach.longest if row == 0 else 0.0) for row in range(len(self._sides))]
        self._every = cache(self._fans)
        self._open = cache(self._unhidden)

    def _balls_of(self, row: int, early: float) -> tuple[Floats, Floats]:
        """Balls (C, 3) and (C,) that hold an end in each cell and `early` s before, m; one for an end at rest."""
        tables, cuts = self._finder.query.trajectory_tables, self._cuts
        spans = [(cuts[0], cuts[-1])] if tables.scales[row, 2] == 0.0 else pairwise(cuts)
        balls = [tables.sphere(row, begin - early, end) for begin, end in spans]
        return np.array([centre for centre, _ in balls]), np.array([radius for _, radius in balls])

    def _fans(self, row: int, edge: int, count: int) -> Fans:
        """Ways of an end to an edge by a number of walls, hidden ones as well."""
        return fans_of_ends(self._finder, edge, self._sides[row][edge][count], *self._balls[row])

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
            there = np.zeros(
                (len(self._cuts) + 1, first.shape[1], last.shape[1]), dtype=np.int8
            )  # none before and after
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
