"""Pairs of edges with open air between them as vertices, such as those of two posts or two screens."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from clsim.acoustics.diffraction import adjacent_reflections, gap_transition, lit_angles, wedge_terms
from clsim.acoustics.edge_gap import EdgeGap
from clsim.arrays import Floats
from clsim.paths.arrivals import Kinematics
from clsim.paths.family import Instant, Rows
from clsim.paths.legs.mirrors import dot
from clsim.paths.legs.static import path_vertices
from clsim.paths.links import Columns, Links, Pair
from clsim.paths.propagation import UniformAir
from clsim.paths.response import SceneResponse
from clsim.paths.vertices.edge import EdgeVertex, Triple
from clsim.paths.vertices.edge_field import adjacent_factors
from clsim.paths.vertices.edge_pair import EdgePairVertex
from clsim.paths.vertices.gap_events import GapEvents, GapPairs, GapPairSolver

Terms = tuple[Floats, Floats, Floats, list[Any]]

AT_ONCE = 100_000  # nodes and frequencies
ACROSS_AIR = 2  # in place of the faces that edges share
LEAVING, COMING = np.array([1.0, -1.0, -1.0, 1.0]), np.array([-1.0, 1.0, -1.0, 1.0])  # d(lit angle) / d(angle)


@dataclass(frozen=True, slots=True, eq=False)
class GapPairVertex(EdgePairVertex):
    """Two edges with open air between them, and walls by which the second one is seen.

    Attributes
    ----------
    seen : ndarray (P, 4, 3)
        Frames of the second edges as the first ones see them by these walls.
    between : ndarray (P, B) int
        Walls between both edges from the first one's side, -1 behind the last.
    budget : ndarray (P,) int
        Reflections that terms of both edges may stand for together.
    """

    seen: Floats
    between: NDArray[np.int32]
    budget: NDArray[np.int64]

    kind: ClassVar[str] = "edge gap"
    loudest: ClassVar[float] = 9.0
    solver: ClassVar[type[GapPairSolver]] = GapPairSolver

    def part(self, rows: Rows) -> GapPairVertex:
        """Return some of the vertices."""
        some: Any = EdgePairVertex.part(self, rows)
        found: GapPairVertex = replace(some, seen=self.seen[rows], between=self.between[rows], budget=self.budget[rows])
        return found

    def named(self, moving: bool) -> Iterator[tuple[str, Any]]:
        """Yield the columns by name."""
        yield from EdgePairVertex.named(self, moving)
        yield from (("between", self.between), ("budget", self.budget))

    @property
    def gap(self) -> EdgeGap:
        """The air between, (P, 1)."""
        n = self.n[:, None], self.last.n[:, None]
        return EdgeGap(self.frame[:, None], self.seen[:, None], n)

    def met(self, source: Pair, receiver: Pair) -> tuple[Pair, Floats]:
        """Places on both edges, and lengths, of shortest paths between ends at r and z about them, (P, T) m each."""
        crossing = self.gap.cross(source, receiver)
        return crossing.places, crossing.length

    def places(self, links: Links, ends: Pair, times: Floats, kinematics: Kinematics) -> tuple[Floats, ...]:
        """Locate the points (P, 3) on both edges, and of reflections between, m."""
        (first, last), faces = self._apexes(links, ends), links.chain.scene.room.faces
        bounces = path_vertices((faces.normals, faces.offsets), self.between, first, last)[:, 1:-1]
        inner = np.where((self.between >= 0)[..., None], bounces, np.nan)
        return first, *np.moveaxis(inner, 1, 0), last

    def lengths(self, links: Links, ends: Pair, images: Pair, times: Any) -> Floats:
        """Lengths (P,) of the shortest paths between endpoints (P, 3), and their images, on static legs, m."""
        views = zip(self.views(links), ends, strict=True)
        (x, y, z_s), (u, v, z_r) = (view.places(place[:, None]) for view, place in views)
        return np.asarray(self.met((np.hypot(x, y), z_s), (np.hypot(u, v), z_r))[1][:, 0])

    def speeds(self, moving: bool) -> Floats:
        """Bounds (P,) of the sums of the speeds of both edges, m/s."""
        return EdgePairVertex.speeds(self, moving) + self.last.speeds(moving)

    def on_moving_legs(self, links: Links, medium: UniformAir, times: Floats, kinematics: Kinematics) -> GapEvents:
        """Solve paths between moving legs."""
        before, after = links.legs
        pairs = GapPairs(
            before.surfaces, after.surfaces, self.edge, self.over_end, self.last.edge, self.shared, self.between
        )
        solver = self.solver(before.mirrors, self.lines, links.motions, medium, kinematics.retarded)
        found: GapEvents = solver.find(pairs, times)
        return found

    def passed(self, events: Any, kinematics: Kinematics) -> Columns:
        """Columns of arrivals on moving legs."""
        columns = EdgePairVertex.passed(self, events, kinematics)
        for i, name in enumerate(("emitted_at", "receiver_at")):
            columns[name][..., 2] -= events.along[:, i]
        return columns | {"middle": events.middle}

    def _seen_length(self, events: Any) -> Floats:
        ends = ((end[0], end[2] - events.along[:, i]) for i, end in enumerate((events.source, events.receiver)))
        return np.asarray(events.middle[..., 2] + sum(np.hypot(*end) for end in ends))

    def moving_lengths(self, links: Links, places: Pair, times: Instant) -> Floats:
        """Lengths (P,) between endpoints (P, 3) on moving legs, with all where it is at times, m."""
        ends = self._rested(links, places, (self.edge, self.last.edge), times)
        (r_s, z_s), (r_r, z_r) = ((r[:, None], z[:, None]) for r, z in ends)
        now, none = np.array(np.broadcast_to(times, len(self))[:, None]), np.zeros((len(self), 1))
        frames = [
            np.stack([self.lines.placed(edge, none, now), *self.lines.axes(edge, now)], axis=2)
            for edge in (self.edge, self.last.edge)
        ]
        for met in self.between.T[::-1]:
            plane = links.legs[0].mirrors.planes(met, now, none, None)
            normal = plane.normal[:, :, None]
            off = dot(frames[1], normal)
            off[:, :, 0] -= plane.offset
            frames[1] = frames[1] - 2.0 * off[..., None] * normal
        return self._length_between((frames[0], frames[1]), (r_s, z_s), (r_r, z_r))[:, 0]

    def _length_between(self, frames: Pair, source: Pair, receiver: Pair) -> Floats:
        """Lengths (P, 1) of shortest paths over edges with frames (P, 1, 4, 3), m."""
        return EdgeGap(frames[0], frames[1], (self.n[:, None], self.last.n[:, None])).cross(source, receiver).length

    def _field(self, source: Triple, receiver: Triple, end: Floats, wave: Floats, at: SceneResponse) -> Any:
        """Field (P, T, F) beyond both edges, without its phase, of endpoints at r, θ, z about the first and the last.

        end: of moving legs what `GapEvents.middle` says of the way between, with which the ends are told from the
        places on the edges.
        """
        if end.ndim == 3:
            ahead, back, between, turn = np.moveaxis(end[..., :4], 2, 0)
            legs = np.hypot(*source[::2]), between, np.hypot(*receiver[::2])
            return gap_field(self, (source, receiver), legs, (ahead, back, turn), wave, at)
        crossing = self.gap.cross(source[::2], receiver[::2])
        field = gap_field(self, (source, receiver), crossing.legs, self.gap.angles(crossing.away), wave, at)
        if self.between.size:
            field *= at.reflection(self.between)[:, None]
            towards = -crossing.away / crossing.legs[1][..., None]
            at.apply_angular_walls(field, self.between, towards)
        return field


def gap_field(
    pair: GapPairVertex, ends: tuple[Triple, Triple], legs: Triple, between: Triple, wave: Floats, at: SceneResponse
) -> Any:  # fmt: skip
    """Compute the field (P, T, F) beyond two edges with air between, from ends at r, θ, z about the first and the last.

    legs: lengths before, between and behind the edges, m.

    between: angles of the way between about both edges, and the cosine between their directions, see `EdgeGap.angles`.

    The product of the terms of either edge, each as if the other were an end of its way, with one transition for both.
    Products that stand for more reflections than are asked for are left out: so are their partners, over one edge.
    """
    count = max(1, min(len(pair), wave.size // AT_ONCE))
    if count > 1:
        rows = np.array_split(np.arange(len(pair)), count)

        def some(columns: Any, part: Rows) -> Any:
            return tuple(x[part] for x in columns)

        parts = [
            gap_field(
                pair.part(part), (some(ends[0], part), some(ends[1], part)), some(legs, part), some(between, part),
                wave[part], at,
            )
            for part in rows
        ]  # fmt: skip
        return np.concatenate(parts)
    ((r_s, t_s, _), (r_r, t_r, _)), whole = ends, legs[0] + legs[1] + legs[2]
    slopes = r_s / legs[0], r_r / legs[2]
    breadths = (
        2.0 * leg * (whole - leg) / whole * slope**2 for leg, slope in zip((legs[0], legs[2]), slopes, strict=True)
    )
    angles = (t_s, between[0]), (between[1], t_r)
    columns = zip((pair, pair.last), angles, slopes, breadths, (LEAVING, COMING), strict=True)
    first, last = (terms_of(*given, at) for given in columns)
    tie = between[2] * np.sqrt(legs[0] * legs[2] / ((legs[0] + legs[1]) * (legs[1] + legs[2])))
    return product_of_terms(pair, (first, last), tie, wave) / whole[..., None]


def product_of_terms(pair: GapPairVertex, found: tuple[Terms, Terms], tie: Floats, wave: Floats) -> Any:
    """Sum the products (P, T, F) of the terms of both edges that are kept."""
    (first, one, side, before), (last, other, last_side, after) = found
    met = [adjacent_reflections(edge.n) for edge in (pair, pair.last)]
    i, j = np.divmod(np.arange(16), 4)
    kept = (met[0][:, i] + met[1][:, j] <= pair.budget[:, None]) & (pair.lit[:, i] != 0) & (pair.last.lit[:, j] != 0)
    weight = 0.25 * one[..., i] * other[..., j] * kept[:, None]
    used = np.flatnonzero(np.any(weight != 0.0, axis=(0, 1)))
    i, j, weight = i[used], j[used], weight[..., used]
    made = gap_transition(first[..., i], last[..., j], tie[..., None] * side[..., i] * last_side[..., j], wave)
    made *= weight[..., None]
    for term, (mine, theirs) in enumerate(zip(i.tolist(), j.tolist(), strict=True)):
        for factor in (before[mine], after[theirs]):
            if factor is not None:
                made[..., term, :] *= factor
    return made.sum(axis=-2)


def terms_of(
    edge: EdgeVertex, angles: Pair, slope: Floats, breadth: Floats, turns: Floats, at: SceneResponse, own: bool = False
) -> Terms:
    """Roots and weights (P, T, 4) of the terms at an edge, their sides and directions together, and faces' factors.

    own: whether the angles, and not the edge, tell on which side each term is.
    """
    lit = None if own else edge.lit[:, None]
    weight, root = wedge_terms(edge.n[:, None], lit_angles(edge.n[:, None], *angles), lit)
    factors = adjacent_factors(edge.n, edge.faces, angles, slope, at)
    return root * np.sqrt(breadth)[..., None], weight, np.where(weight > 0.0, -turns, turns), factors
