"""Validity of paths over two edges with air between, or over an edge and an end of another, at an instant.

And how far endpoints may move before it changes.

Notes
-----
The places on both edges are where the length of the way is least; by how much they go where both ends go a distance is
known to first order from its second derivatives. 2.5 times as much is taken, while that distance is small against all
legs. An end rests, so that only the place on the other edge slides, as if the path began at rest there.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import cast

import numpy as np
from numpy.typing import NDArray

from clsim.acoustics.diffraction import TERMS, EdgePath, lit_angles, path_over_edge, wedge_terms
from clsim.acoustics.edge_gap import Crossing, EdgeGap
from clsim.arrays import Bools, Floats, Rows
from clsim.paths.vertices.edge_events import MEETING, OF_LAST, TWO_ENDS
from clsim.paths.visibility.clearance import EVER, Reach, mirrored, moves_within, path_status, turned
from clsim.paths.visibility.edges import FAR, Course, EdgeCandidates, EdgeStance, EdgeVisibility, End, beside_faces
from clsim.paths.visibility.intervals import VisibilityQuery
from clsim.scene.room.edges import Edges
from clsim.scene.room.walls import Walls

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
        ends, reach = (place, stance.apexes[side - 2]), Reach(moves, moves, none, none)
        clear_path, clear = path_status(walls, part, *ends, reach, True)
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


_LEAST = 1e-12  # m


def off_edges(edges: Edges, candidates: EdgeCandidates, seen: Floats, which: Rows) -> tuple[Floats, Floats, Floats]:
    """Where candidates' ends are along their edges, m, the ends (n, 3), and their places about the other edges."""
    end, (one, other) = candidates.end[which], candidates.edge[which].T
    end = np.where(end >= TWO_ENDS, end % MEETING, end)
    last, frames = (end >= OF_LAST)[:, None, None], (edges.frames[one], seen)
    mine, theirs = np.where(last, frames[1], frames[0]), np.where(last, frames[0], frames[1])
    number = np.where(end >= MEETING, end // 2, end) % 2
    along = np.where(number == 1, edges.length[np.where(end >= OF_LAST, other, one)], 0.0)
    place = mine[:, 0] + along[:, None] * mine[:, 3]
    return along, place, np.einsum("nai,ni->an", theirs[:, 1:], place - theirs[:, 0])


@dataclass(frozen=True, slots=True, eq=False)
class EndVisibility(GapVisibility):
    """Tells of candidates over an edge and an end of another whether they are there, and which partners are seen."""

    last: Bools  # (n,) whether the end is one of the last edge
    along: Floats  # (n,) where it is along its edge, m
    beside: Floats  # (n,) and from the line of the other edge, m
    height: Floats  # (n,) and along that, m
    held: Floats  # (n,) where the other edge ends, of paths over ends of both, m; else NaN

    @staticmethod
    def of(edges: Edges, candidates: EdgeCandidates, query: VisibilityQuery) -> EndVisibility:
        """Make it for edges of a room."""
        one, other = candidates.edge.T
        seen = seen_frames(query.walls, edges, other, candidates.between)
        along, _, (x, y, z) = off_edges(edges, candidates, seen, np.arange(len(one)))
        gap = EdgeGap(edges.frames[one], seen, (edges.n[one], edges.n[other]))
        last, length = candidates.end % MEETING >= OF_LAST, edges.length[candidates.edge]
        held = np.where(candidates.end // 4 == 3, np.where(last, *length.T), 0.0)
        held = np.where(candidates.end >= TWO_ENDS, held, np.nan)
        return EndVisibility(edges, candidates, query, gap, last, along, np.hypot(x, y), z, held)

    def course(self, which: Rows, source: End, receiver: End) -> Course:
        """Shortest ways of candidates `which` (n,) between ends at r and z about the first and the last edges, m."""
        last, (along, r_c, z_c) = self.last[which], (x[which] for x in (self.along, self.beside, self.height))
        far, near = ([np.where(last, a, b) for a, b in zip(*ends, strict=True)]
                     for ends in ((receiver, source), (source, receiver)))  # fmt: skip
        route, leg = path_over_edge(r_c, z_c, *near), np.hypot(far[0], along - far[1])
        held = self.held[which]
        over, loose = np.where(np.isnan(held), route.apex, held), np.where(np.isnan(held), r_c, np.nan)
        parts = np.hypot(r_c, over - z_c), np.hypot(near[0], over - near[1])
        length, places = leg + parts[0] + parts[1], (np.where(last, over, along), np.where(last, along, over))
        gap = self.gap(which)
        away = gap.first[:, 0] + places[0][:, None] * gap.first[:, 3]
        away = away - gap.last[:, 0] - places[1][:, None] * gap.last[:, 3]
        legs = np.where(last, parts[1], leg), np.maximum(parts[0], _LEAST), np.where(last, leg, parts[1])
        crossing = Crossing(places, legs, away, (np.where(last, loose, np.nan), np.where(last, np.nan, loose)))
        edge_paths = EdgePath(length, places[0], length), EdgePath(length, places[1], length)
        return Course(edge_paths, (r_c, r_c), crossing)

    def between(self, stance: EdgeStance, which: Rows, turns: End) -> tuple[End, End]:
        """Angles (n,) at which the first edges see what is behind them, and the last ones what is before, and turns."""
        angles, more = GapVisibility.between(self, stance, which, turns)
        face = self.candidates.face[which]
        over_face, edge = face <= 1, self.candidates.edge[which]
        held = np.where(over_face, face * np.pi * self.edges.n[edge], np.stack(angles, axis=1))
        still = np.where(over_face, 0.0, np.stack(more, axis=1))
        return (held[:, 0], held[:, 1]), (still[:, 0], still[:, 1])

    def slides(self, stance: EdgeStance, edge: int, end: Rows, size: float) -> Floats:
        """Largest motion of the point on the first or second edge along it, (n,) m; of an end none.

        With the end at rest r off the edge, the other endpoint at R - r and a length of L over it, the point slides by
        at most r L / R² of what that endpoint moves.
        """
        crossing, reach = stance.course.crossing, stance.reaches[edge]
        assert crossing is not None
        over_edge = np.where(edge == 0, crossing.legs[0], crossing.legs[2]) + crossing.legs[1]
        across = crossing.slides[edge] + stance.distances[edge] - reach
        sliding = reach * crossing.slides[edge] * (over_edge + reach) / np.where(across > 0.0, across, 1.0) ** 2
        return np.where(np.isnan(across), 0.0, np.where(across > 0.0, sliding, FAR * size))

    def sides(self, which: Rows, time: Floats, half: Floats) -> tuple[NDArray[np.int8], Bools, Floats, Floats]:
        """Tell on which sides of their boundaries candidates are, see `EdgeVisibility.sides`."""
        stance, (one, other) = self.stance(which, time, half), self.candidates.edge[which].T
        crossing, last, reach = stance.course.crossing, self.last[which], stance.reach
        assert crossing is not None
        moved = list(zip(stance.reaches, stance.distances, strict=True))
        near = (moved[0][0] < moved[0][1]) & (moved[1][0] < moved[1][1])
        turns = [np.arcsin(np.where(near, own / np.where(near, r, 1.0), 1.0)) for own, r in moved]
        (ahead, back), _ = self.between(stance, which, (turns[0], turns[1]))
        terms = lit_angles(self.edges.n[one], stance.angles[0], ahead), lit_angles(self.edges.n[other], back,
                                                                                  stance.angles[1])  # fmt: skip
        angles = np.where(last[:, None], *terms)
        sure = near & np.all(np.abs(angles) > np.where(last, *turns)[:, None], axis=1)
        beside, passed = beside_faces(self.edges.n[self.candidates.edge[which].T], np.stack(stance.angles))
        sure &= np.all(passed > np.stack(turns), axis=0)
        inside, turning = self._inside(stance, which)
        inner, sliding = self._over_both(stance, which)
        both = ~np.isnan(self.held[which])
        inside, turning = np.where(both, inner, inside), np.where(both, sliding, turning)
        sure &= np.abs(inside) > turning
        distances = np.minimum(*stance.distances)
        off = np.minimum(np.minimum(np.abs(angles).min(axis=1), passed.min(axis=0)), np.abs(inside)) * distances
        lit, every = np.where(angles >= 0.0, 1, -1), np.ones(angles.shape, dtype=np.int64)
        first, second = np.where(last[:, None], lit, every), np.where(last[:, None], every, lit)
        return (
            np.column_stack([first, np.where(inside >= 0.0, 1, -1), second, *beside]).astype(np.int8),
            sure, off, reach,
        )  # fmt: skip

    def _over_both(self, stance: EdgeStance, which: Rows) -> tuple[Floats, Floats]:
        """How far (n,) paths over one end are inside the other edge's end, m, and by how much this slides at most."""
        last, r_c = self.last[which], self.beside[which]
        near = [np.where(last, *x) for x in (stance.distances, stance.heights)]
        route, reach = path_over_edge(r_c, self.height[which], near[0], near[1]), np.where(last, *stance.reaches)
        across = r_c + near[0] - reach
        sliding = np.where(across > 0.0, reach * r_c * (route.length + reach) / across**2, np.inf)
        return np.where(self.held[which] == 0.0, route.apex, self.held[which] - route.apex), sliding

    def _inside(self, stance: EdgeStance, which: Rows) -> tuple[Floats, Floats]:
        """How far (n,) paths over both edges are inside the end, as a difference of cosines, and its change at most."""
        crossing, last, no_end = stance.course.crossing, self.last[which], np.full(len(which), -1)
        assert crossing is not None
        frames = np.where(last[:, None], self.gap(which).last[:, 3], self.gap(which).first[:, 3])
        legs = np.maximum(np.where(last, crossing.legs[2], crossing.legs[0]), _LEAST), crossing.legs[1]
        towards = np.einsum("ni,ni->n", crossing.away, frames) * np.where(last, 1.0, -1.0) / legs[1]
        slope = np.where(last, stance.places[1] - stance.heights[1], stance.places[0] - stance.heights[0]) / legs[0]
        slope = slope - towards
        far, slides = (
            stance.reaches[::-1],
            [self.slides(stance, edge, no_end, self.query.walls.size) for edge in (0, 1)],
        )
        moved = np.where(last, *far), np.where(last, *slides)
        change = [m / np.maximum(leg - m, _LEAST) for m, leg in zip(moved, legs, strict=True)]
        return np.where(self.candidates.end[which] % OF_LAST == 1, slope, -slope), change[0] + change[1]


def end_levels(seen: EdgeVisibility, which: Rows, time: Floats, wave: float, direct: bool) -> Floats:
    """Estimate the pressure (n,) of paths over ends at times (n,), see `levels_over_ends`, at a wave number, 1/m."""
    still, longer = np.zeros(len(which)), np.full(len(which), np.nan)
    if isinstance(seen, EndVisibility):  # over ends of both edges a share of what is over one
        whole = seen.stance(which, time, still).course.edge_paths[0].length
        longer = np.where(np.isnan(seen.held[which]), np.nan, whole)
        seen = replace(seen, held=np.full_like(seen.held, np.nan))
    stance, edges = seen.stance(which, time, still), seen.candidates.edge[which].T
    (ahead, back), _ = seen.between(stance, which, (still, still))
    crossing, last = stance.course.crossing, seen.candidates.end[which] % MEETING >= OF_LAST
    heights = tuple(height - place for place, height in zip(stance.places, stance.heights, strict=True))
    between, slope = still, None
    if crossing is not None:
        between, gap = crossing.legs[1], cast("GapVisibility", seen).gap(which)
        frames = np.where(last[:, None], gap.last[:, 3], gap.first[:, 3])
        slope = np.einsum("ni,ni->n", crossing.away, frames) * np.where(last, 1.0, -1.0) / between
    angles = (stance.angles[0], ahead), (back, stance.angles[1])
    apart = np.linalg.norm(stance.ends[0] - stance.ends[1], axis=1) if direct else None
    ends, n = (stance.distances, (heights[0], heights[1])), (seen.edges.n[edges[0]], seen.edges.n[edges[1]])
    lengths = stance.course.edge_paths[0].length, longer
    return levels_over_ends(n, angles, ends, (between, slope), lengths, last, wave, apart)


def levels_over_ends(
    n: End, angles: tuple[End, End], ends: tuple[End, End], middle: tuple[Floats, Floats | None], lengths: End,
    last: Bools, wave: float, apart: Floats | None,
) -> Floats:  # fmt: skip
    """Estimate the pressure (n,) of paths over ends at a wave number, 1/m, over that in free air.

    Magnitudes of all terms add up, and those of transitions are ``1 / sqrt(1 + π x²)``: within some decibels.
    ends: r and z of both endpoints from the places on the edges, m.
    middle: length of the way between both edges, m, and the cosine between the edge that ends and that way; None of
    corners at which both edges end.
    lengths: of the shortest paths over both edges of corners, and of paths over ends of both edges, m; NaN of others.
    apart: distance in free air, m; None: as far as the path is long.
    """
    legs, (between, slope), (shortest, longer) = [np.hypot(*end) for end in zip(*ends, strict=True)], middle, lengths
    tie = np.ones(len(last))
    if slope is not None:
        beyond, far = between + np.where(last, *legs), [np.where(last, x[1], x[0]) for x in ends]
        shortest = np.hypot(far[0] + np.sqrt(np.maximum(1.0 - slope**2, 0.0)) * beyond, slope * beyond - far[1])
        tie = np.sqrt(legs[0] * legs[1] / ((legs[0] + between) * (between + legs[1])))
    whole, roots, weights = legs[0] + between + legs[1], [], []
    for wedge, (came, went), r, leg in zip(n, angles, ends[0], legs, strict=True):
        weight, root = wedge_terms(wedge, lit_angles(wedge, came, went))
        roots.append(root * np.sqrt(2.0 * wave * leg * (whole - leg) / whole)[:, None] * (r / leg)[:, None])
        weights.append(np.abs(weight))
    end, total = np.sqrt(wave * np.maximum(whole - shortest, 0.0)), np.zeros(len(last))
    for i, j in np.ndindex(TERMS, TERMS):
        a, b = roots[0][:, i], roots[1][:, j]
        share = _end_share(end, a + b if slope is None else np.where(last, b, a))
        both = _fall(np.maximum(a, b)) * _fall(np.minimum(a, b) * np.sqrt(np.maximum(1.0 - tie**2, 0.0)))
        total += 0.25 * weights[0][:, i] * weights[1][:, j] * share * both
    beyond_both = np.sqrt(wave * np.maximum(longer - whole, 0.0))
    total *= np.where(np.isnan(longer), 1.0, _end_share(beyond_both, end))
    return np.asarray(total * (whole if apart is None else apart) / shortest)


def _end_share(end: Floats, root: Floats) -> Floats:
    near = root * (root + 0.6)
    return np.asarray(0.5 * _fall(end) * near / (near + end**2 + 1e-9))


def _fall(root: Floats) -> Floats:
    return np.asarray(1.0 / np.sqrt(1.0 + np.pi * root**2))
