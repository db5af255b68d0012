"""Candidates over two edges with air between: pairs of edges, walls, and when sound may run so."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from clsim.acoustics.diffraction import partner_reflections
from clsim.paths.search.gap_parts import PARTS, Fans, Gaps, fans_of_ends, open_gaps
from clsim.paths.vertices.gap_pair import ACROSS_AIR
from clsim.paths.visibility.clearance import segments_apart
from clsim.paths.visibility.edges import EdgeCandidates

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray

    from clsim.arrays import Floats
    from clsim.paths.visibility.edge_intervals import EdgeSearch

    Ints = NDArray[np.int64]
    Sides = list[list[NDArray[np.int32]]]
    Reached = Callable[[tuple[Floats, float]], Sides]

_NEAR = 1e-7  # of the room's size, up to which edges meet
_CELL = 0.03  # of the room's size, by which both ends move in a cell of time
_MOST_CELLS = 32
_MOST_FANS = 200_000  # of an end, in all cells
_BATCH = 20_000  # candidates searched at a time


def gap_candidates(
    finder: EdgeSearch, sides: tuple[Sides, list[Sides]], reached: Reached, order: int, longest: float
) -> Iterator[tuple[float, EdgeCandidates]]:
    """Yield candidates over two edges with air between, and the share of the work so far.

    sides: sequences of walls to each edge from the source and from each receiver, see `edges._sequences`.

    reached: the same from a ball.

    longest: time that sound takes at most, s.
    """
    edges, pairs = finder.edges, _apart(finder)
    if not len(pairs):
        return
    balls = zip(0.5 * (edges.start + edges.stop), 0.5 * edges.length, strict=True)
    from_edge = [reached(ball) if e in pairs else [] for e, ball in enumerate(balls)]
    match = _Match.of(finder, sides, longest)
    fewest = partner_reflections(edges.n).min(axis=1)
    numbers = [(b, n, m) for b in range(order + 1) for n in range(order + 1 - b) for m in range(order + 1 - b - n)]
    for done, (b, n, m) in enumerate(numbers):
        if n == m == 0:
            kept = pairs[b + fewest[pairs].sum(axis=1) <= order]
            gaps = open_gaps(finder, *_between(kept, from_edge, b), match.cones(order - b))
        parts: list[EdgeCandidates] = []
        for i in np.flatnonzero(n + m + b + fewest[gaps.pair].sum(axis=1) <= order).tolist():
            parts += match.candidates(gaps, i, n, m)
            if sum(len(part.edge) for part in parts) >= _BATCH:
                yield done / len(numbers), EdgeCandidates.joined(parts)
                parts = []
        if parts:
            yield (done + 1) / len(numbers), EdgeCandidates.joined(parts)


def _apart(finder: EdgeSearch) -> Ints:
    """List edges (n, 2), in either order, that share no face and do not meet."""
    edges, near = finder.edges, _NEAR * finder.query.walls.size
    ends = np.stack([edges.start, edges.stop], axis=1)
    apart = ~(edges.faces[:, None, :, None] == edges.faces[None, :, None, :]).any(axis=(2, 3))
    apart &= segments_apart(ends, edges.start, edges.stop) > near
    return np.argwhere(apart)


def _between(pairs: Ints, from_edge: list[Sides], count: int) -> tuple[Ints, NDArray[np.int32]]:
    """List pairs of edges (n, 2) and a number of walls (n, count) by which either may be reached from the other."""
    which, walls = [np.empty((0, 2), dtype=np.int64)], [np.empty((0, count), dtype=np.int32)]
    for one, other in pairs.tolist():
        back = {sequence[::-1].tobytes() for sequence in from_edge[other][one][count]}
        found = [sequence for sequence in from_edge[one][other][count] if sequence.tobytes() in back]
        which.append(np.tile([[one, other]], (len(found), 1)))
        walls += [sequence[None] for sequence in found]
    return np.concatenate(which), np.concatenate(walls)


@dataclass(frozen=True, slots=True, eq=False)
class _Match:
    """Ways of ends to edges in cells of time, by edge and number of walls, and when they meet ways between edges."""

    finder: EdgeSearch
    sides: tuple[Sides, list[Sides]]
    cuts: Floats  # (C + 1,) of time, s
    before: list[list[Fans]]
    after: list[list[list[Fans]]]  # of each receiver

    @staticmethod
    def of(finder: EdgeSearch, sides: tuple[Sides, list[Sides]], longest: float) -> _Match:
        """Make it for what sound takes at most, s."""
        query, tables = finder.query, finder.query.trajectory_tables
        last = float(query.last.max(initial=0.0))
        travel = last * (tables.scales[0, 2] + tables.scales[1:, 2].max(initial=0.0))
        sequences = max(sum(len(s) for of_edge in side for s in of_edge) for side in (sides[0], *sides[1]))
        most = min(_MOST_CELLS, max(1, _MOST_FANS // max(sequences, 1)))
        count = int(np.clip(math.ceil(travel / (_CELL * query.walls.size)), 1, most))
        cuts = np.linspace(0.0, last, count + 1)

        def fans(row: int, side: Sides, early: float) -> list[list[Fans]]:
            still = tables.scales[row, 2] == 0.0
            spans = [(cuts[0], cuts[-1])] if still else pairwise(cuts)
            balls = [tables.sphere(row, begin - early, end) for begin, end in spans]
            centre, radius = np.array([c for c, _ in balls]), np.array([r for _, r in balls])
            return [[fans_of_ends(finder, e, s, centre, radius) for s in of_edge] for e, of_edge in enumerate(side)]

        after = [fans(1 + r, side, 0.0) for r, side in enumerate(sides[1])]
        return _Match(finder, sides, cuts, fans(0, sides[0], longest), after)

    def cones(self, order: int) -> tuple[Fans, Fans]:
        """Fans (edges, parts) that hold those of all ways with up to so many walls, of the source and of receivers."""
        every = [self.before], self.after
        of_edges = range(len(self.finder.edges))
        before, after = (
            [Fans.hull([f for side in sides for f in side[e][: order + 1]]) for e in of_edges] for sides in every
        )
        return Fans.stacked(before), Fans.stacked(after).turned()

    def candidates(self, gaps: Gaps, i: int, before: int, after: int) -> Iterator[EdgeCandidates]:
        """Yield candidates over a gap with so many walls before and after it, of each receiver."""
        (one, other), query = gaps.pair[i].tolist(), self.finder.query
        first = gaps.fans[0].part(i).meet(self.before[one][before], 0)
        for receiver, fans in enumerate(self.after) if first.any() else ():
            last = gaps.fans[1].part(i).meet(fans[other][after].turned(), 1)
            product = first.reshape(*first.shape[:2], PARTS**2) @ last.reshape(*last.shape[:2], PARTS**2).swapaxes(1, 2)
            there = np.zeros((len(self.cuts) + 1, *product.shape[1:]), dtype=np.int8)  # none before and after
            there[1:-1] = product > 0.0
            rows = np.argwhere(there.any(axis=0))
            if not len(rows):
                continue
            steps = np.diff(there[:, rows[:, 0], rows[:, 1]].T, axis=1)
            (row, begin), (_, end) = np.nonzero(steps == 1), np.nonzero(steps == -1)
            begins, ends = (
                np.maximum(self.cuts[begin], query.first[receiver]),
                np.minimum(self.cuts[end], query.last[receiver]),
            )
            count = len(rows)
            yield EdgeCandidates(
                self.sides[0][one][before][rows[:, 0]], self.sides[1][receiver][other][after][rows[:, 1]],
                np.tile(gaps.pair[i], (count, 1)), np.full((count, 2), ACROSS_AIR), np.full(count, -1),
                np.full(count, receiver), np.tile(gaps.walls[i], (count, 1)), (row, begins, ends),
            )  # fmt: skip
