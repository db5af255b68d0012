"""Validity of paths over two edges with air between, at an instant, and how far ends may move before it can change.

Notes
-----
The places on both edges are where the length of the way is least; by how much they go where both ends go a distance is
known to first order from its second derivatives. 2.5 times as much is taken, while that distance is small against all
legs.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clsim.acoustics.diffraction import EdgePath
from clsim.acoustics.edge_gap import EdgeGap
from clsim.arrays import Floats
from clsim.paths.visibility.clearance import EVER, Reach, mirrored, moves_within, path_status, turned
from clsim.paths.visibility.edges import FAR, Course, EdgeCandidates, EdgeStance, EdgeVisibility, End
from clsim.paths.visibility.intervals import VisibilityQuery
from clsim.scene.room.edges import Edges
from clsim.scene.room.walls import Walls

Bools = NDArray[np.bool_]
Rows = NDArray[np.int64]

SMALL = 0.3  # of the least leg, up to which the first order is taken for where places go
SPARE = 2.5  # times that, for what it leaves out: second derivatives change by 1.3³ until there
OVERLAP = 0.35, 0.71  # of the way from the last edge to the last reflection, from where is looked at either edge
IN_AIR = 1e-7  # rad off the faces of an edge, from which on another edge is in its air


def seen_frames(walls: Walls, edges: Edges, last: Rows, between: NDArray[np.int32]) -> Floats:
    """Frames (n, 4, 3) of edges (n,) as they are seen by walls (n, B), the last of which is next to them."""
    start, *axes = np.moveaxis(edges.frames[last], 1, 0)
    for wall in between.T[::-1]:
        some = np.flatnonzero(wall >= 0)
        start, axes = np.array(start), [np.array(axis) for axis in axes]
        start[some] = mirrored(walls, wall[some], start[some])
        for axis in axes:
            axis[some] = turned(walls, wall[some], axis[some])
    return np.stack([start, *axes], axis=1)


@dataclass(frozen=True, slots=True, eq=False)
class GapVisibility(EdgeVisibility):
    """Tells of candidates over two edges with air between whether they are there, and which partners are seen."""

    every: EdgeGap  # the air between the edges of all candidates

    @staticmethod
    def of(edges: Edges, candidates: EdgeCandidates, query: VisibilityQuery) -> GapVisibility:
        """Make it for edges of a room."""
        one, other = candidates.edge.T
        seen = seen_frames(query.walls, edges, other, candidates.between)
        return GapVisibility(edges, candidates, query, EdgeGap(edges.frames[one], seen, (edges.n[one], edges.n[other])))

    def gap(self, which: Rows) -> EdgeGap:
        """Return the air between the edges of candidates `which` (n,)."""
        every = self.every
        return EdgeGap(every.first[which], every.last[which], (every.n[0][which], every.n[1][which]))

    def course(self, which: Rows, source: End, receiver: End) -> Course:
        """Shortest ways of candidates `which` (n,) between ends at r and z about the first and the last edges, m."""
        found = self.gap(which).cross(source, receiver)
        before, between, behind = found.legs
        slopes = source[0] / before, receiver[0] / behind
        across = slopes[0] * (between + behind), slopes[1] * (before + between)
        edge_paths = tuple(EdgePath(found.length, place, found.length) for place in found.places)
        return Course((edge_paths[0], edge_paths[1]), across, found)

    def between(self, stance: EdgeStance, which: Rows, turns: End) -> tuple[End, End]:
        """Angles (n,) at which the first edges see what is behind them, and the last ones what is before, and turns."""
        gap, crossing = self.gap(which), stance.course.crossing
        assert crossing is not None
        ahead, back, _ = gap.angles(crossing.away)
        skew = np.linalg.norm(np.cross(gap.first[:, 3], gap.last[:, 3]), axis=1)
        no_end, more = np.full(len(which), -1), []
        for edge, frame in ((1, gap.first), (0, gap.last)):  # sliding on the one turns what the other one sees
            off = np.linalg.norm(np.cross(crossing.away, frame[:, 3]), axis=1)
            moved = self.slides(stance, edge, no_end, 1.0) * skew
            more.append(np.arcsin(np.minimum(moved / np.maximum(off, 1e-300), 1.0)))
        return (ahead, back), (more[0], more[1])

    def slides(self, stance: EdgeStance, edge: int, end: Rows, size: float) -> Floats:
        """Largest motion of the point on the first or second edge along it, (n,) m."""
        crossing, reach = stance.course.crossing, stance.reach
        assert crossing is not None
        small = reach < SMALL * np.min([*crossing.legs, *stance.distances], axis=0)
        return np.where(small, SPARE * reach * crossing.slides[edge], FAR * size)

    def evaluate(
        self, side: int, sequence: NDArray[np.int32], receiver: Rows, time: Floats, half: Floats
    ) -> tuple[Bools, Floats, Floats]:
        """Return validity, clearance and how far the ends can move, of one side of candidates, each (n,).

        The sides from the source and from the receiver are 0 and 1. Walls that hold a place on an edge hide nothing of
        it: the way between is looked at in two parts that overlap, 2 and 3, from places between the last reflection and
        the last edge to either edge.
        """
        if side < 2:
            return EdgeVisibility.evaluate(self, side, sequence, receiver, time, half)
        which, walls = sequence[:, 0].astype(np.int64), self.query.walls
        stance, no_end = self.stance(which, time, half), np.full(len(sequence), -1)
        moves = np.maximum(*(self.slides(stance, edge, no_end, walls.size) for edge in (0, 1)))
        still, none = np.zeros(len(which)), np.zeros((len(which), 3))
        (ahead, back), more = self.between(stance, which, (still, still))
        edges = self.candidates.edge[which].T
        off = [np.minimum(a, np.pi * self.edges.n[e] - a) for a, e in zip((ahead, back), edges, strict=True)]
        free = np.minimum(*off) > IN_AIR
        beside = np.minimum(*(moves_within(np.abs(o - IN_AIR), m) for o, m in zip(off, more, strict=True)))
        met = self.candidates.between[which]
        place = _before_last(walls, met, stance.apexes, OVERLAP[side - 2])
        part = met[:, ::-1] if side == 2 else met[:, :0]
        clear_path, clear = path_status(
            walls, part, place, stance.apexes[side - 2], Reach(moves, moves, none, none), True
        )
        sure = moves_within(clear, moves)
        blocked = np.where(free, sure, np.maximum(beside, sure))
        ratio = np.where(clear_path, np.where(free, np.minimum(beside, sure), beside), blocked)
        return free & clear_path, np.minimum(ratio, EVER) * stance.reach, stance.reach


def _before_last(walls: Walls, between: NDArray[np.int32], ends: tuple[Floats, Floats], part: float) -> Floats:
    """Places (n, 3) at a part of the way from the second ends to the last reflections by walls (n, B) between, m."""
    image, share = ends[0], np.ones(len(between))
    for wall in between.T:
        image = mirrored(walls, wall, image)
        heights = [np.einsum("ni,ni->n", x, walls.normal[wall]) - walls.offset[wall] for x in (ends[1], image)]
        apart = heights[0] - heights[1]
        share = np.clip(heights[0] / np.where(apart == 0.0, 1.0, apart), 0.0, 1.0)
    return np.asarray(ends[1] + part * share[:, None] * (image - ends[1]))
