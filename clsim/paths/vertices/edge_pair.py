"""Pairs of edges as vertices: of one face, such as those of a thick screen, or with air between, as of two posts."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from clsim.acoustics import diffraction
from clsim.acoustics.edge_gap import EdgeGap
from clsim.arrays import Floats
from clsim.paths.family import Columns, Instant, Links, Pair, Rows
from clsim.paths.legs.legs import path_vertices
from clsim.paths.legs.mirrors import dot
from clsim.paths.propagation import UniformAir
from clsim.paths.response import Kinematics, SceneResponse
from clsim.paths.vertices import edge_events
from clsim.paths.vertices.edge import EdgeVertex, Triple
from clsim.paths.vertices.edge_field import EdgeView, RolledOut, adjacent_factors, face_factor
from clsim.scene.scene import Scene

FaceTerms = tuple[Floats, list[Any], list[Any]]
Law = Callable[[Any, Any, Any, Any], Any]

SOFTEST = 1e-3  # least magnitude of one and the factor of the face between


@dataclass(frozen=True, slots=True, eq=False)
class EdgePairVertex(EdgeVertex):
    """Two edges that share a face; columns of `EdgeVertex` are those of the first one.

    Rolled out into the plane of the shared face, the path between both is straight.
    """

    last: EdgeVertex
    # (P, 2) shared face of the first and of the second edge: 0 for the 0-face, 1 for the n-face.
    shared: NDArray[np.int64]

    kind: ClassVar[str] = "edge pair"
    loudest: ClassVar[float] = 18.0

    def in_scene(self, scene: Scene) -> Self:
        """Return the same vertices with the bodies of another scene."""
        first = EdgeVertex.in_scene(self, scene)
        return replace(first, last=self.last.in_scene(scene))

    def named(self, moving: bool) -> Iterator[tuple[str, Any]]:
        """Yield the columns by name."""
        yield from EdgeVertex.named(self, moving)
        for name in ("edge", "lit") if moving else ("frame", "n", "faces", "lit"):
            yield f"last_{name}", getattr(self.last, name)
        yield "shared", self.shared

    @property
    def objects(self) -> NDArray[np.int64]:
        """Numbers of both edges among the names, (P, 2)."""
        return np.stack([self.edge, self.last.edge], axis=1)

    @property
    def wedges(self) -> tuple[Floats, Floats]:
        """Exterior angles over π of both edges, (P,)."""
        return self.n, self.last.n

    def views(self, links: Links) -> tuple[EdgeView, EdgeView]:
        """Take the views of the endpoints from the first and the last edge of each path."""
        edges = zip(links.legs, (self, self.last), strict=True)
        first, last = (EdgeView.of(leg.matrix, leg.offset, edge.frame) for leg, edge in edges)
        return first, last

    def met(self, source: Pair, receiver: Pair) -> tuple[Pair, Floats]:
        """Places on both edges, and lengths, of shortest paths between ends at r and z about them, (P, T) m each."""
        beyond = self.beyond()
        edge_path = diffraction.path_over_edge(*source, *beyond[0](*receiver))
        return (edge_path.apex, diffraction.path_over_edge(*receiver, *beyond[1](*source)).apex), edge_path.length

    def beyond(self) -> tuple[RolledOut, RolledOut]:
        """Take the views from both edges beyond each other, across the shared face."""
        return RolledOut.between((self.frame, self.last.frame), self.wedges, self.shared)

    def on_moving_legs(
        self, links: Links, medium: UniformAir, times: Floats, kinematics: Kinematics
    ) -> edge_events.EdgePairEvents:
        """Solve paths between moving legs."""
        before, after = links.legs
        pairs = edge_events.EdgePairs(
            before.surfaces, after.surfaces, self.edge, self.over_end, self.last.edge, self.shared
        )
        solver = edge_events.EdgePairSolver(before.mirrors, self.lines, links.motions, medium, kinematics.retarded)
        found: edge_events.EdgePairEvents = solver.find(pairs, times)
        return found

    def _seen_length(self, events: edge_events.EdgeEvents) -> Floats:
        (r_s, _, z_s), (r_r, _, z_r) = events.source, events.receiver
        return diffraction.path_over_edge(r_s, z_s, *_ahead(*self.beyond()[0](r_r, z_r))).length

    def moving_lengths(self, links: Links, places: Pair, times: Instant) -> Floats:
        """Lengths (P,) between endpoints (P, 3) on moving legs, with all where it is at times, m."""
        first, last = self._rested(links, places, (self.edge, self.last.edge), times)
        (r_s, z_s), (r_r, z_r) = ((r[:, None], z[:, None]) for r, z in (first, last))
        return diffraction.path_over_edge(r_s, z_s, *_ahead(*self.beyond()[0](r_r, z_r))).length[:, 0]

    def _apexes(self, links: Links, ends: Pair) -> Pair:
        places = zip((self.frame, self.last.frame), self._met_by(links, ends), strict=True)
        one, other = (frame[:, 0] + place[:, None] * frame[:, 3] for frame, place in places)
        return np.asarray(one), np.asarray(other)

    def _field(self, source: Triple, receiver: Triple, end: Floats, wave: Floats, at: SceneResponse) -> Any:
        """Field (P, T, F) beyond both edges, without its phase, of endpoints at r, θ, z about the first and the last.

        Along a rigid face all is twice as loud as what comes from either side, which the second edge has twice again:
        what the two edges make of it is halved, and for other faces divided by one and the face's factor. Paths whose
        terms by faces are left out have neither.
        """
        (r_s, t_s, z_s), (r_r, t_r, z_r) = source, receiver
        edge_paths, received = self.rolled_out((r_s, z_s), (r_r, z_r))
        sent = _ahead(*self.beyond()[1](r_s, z_s))
        tie = diffraction.double_tie(
            edge_paths[0],
            r_s * edge_paths[0].length / (r_s + received[0]),
            r_r * edge_paths[1].length / (r_r + sent[0]),
        )
        found = self.face_terms((t_s, t_r), (edge_paths[0].breadth, edge_paths[1].breadth), at)
        return self.over_face(found, tie, wave, edge_paths[0].length)

    def rolled_out(
        self, source: Pair, receiver: Pair
    ) -> tuple[tuple[diffraction.EdgePath, diffraction.EdgePath], Pair]:
        """Paths over either edge to what is beyond the other one, and r and z of that for the first, (P, T) m."""
        beyond = self.beyond()
        received, sent = _ahead(*beyond[0](*receiver)), _ahead(*beyond[1](*source))
        return (diffraction.path_over_edge(*source, *received), diffraction.path_over_edge(*receiver, *sent)), received

    def face_terms(self, angles: Pair, breadths: Pair, at: SceneResponse, own: int = -1) -> list[FaceTerms]:
        """Terms of both edges, from ends at angles (P, T); own: that of 0 and 1 whose sides its angles tell."""
        face = self.shared[:, :, None] * np.pi * np.stack([self.n, self.last.n], axis=1)[:, :, None]
        edges = (
            (self.n, angles[0], face[:, 0], self.lit, self.faces),
            (self.last.n, face[:, 1], angles[1], self.last.lit, self.last.faces),
        )
        columns = zip(edges, breadths, ((2, 3), (3, 2)), strict=True)
        return [self._terms(edge, breadth, by_face, at, i == own) for i, (edge, breadth, by_face) in enumerate(columns)]

    def over_face(
        self,
        found: list[FaceTerms],
        tie: Floats,
        wave: Floats,
        length: Floats,
        law: Law = diffraction.double_transition,
    ) -> Any:
        """Field (P, T, F) of the products of terms, of paths of a length (P, T), m."""
        (first, before, _), (last, after, last_factors) = found
        field: Any = np.zeros(wave.shape, dtype=np.complex128)
        for i, weight in enumerate(before):
            for j, other in enumerate(after):
                field += 0.25 * weight * other * law(first[..., i], last[..., j], tie, wave)
        field /= length[..., None]
        return field / self.doubled(last_factors)

    def doubled(self, factors: list[Any]) -> Any:
        """Ratio (P, T, F) of sound along the face to that from either side, by the factors of the last edges' faces."""
        factor: Any = np.where(self.shared[:, 1, None, None] == 1, factors[1], factors[0])
        both: Any = 1.0 + factor
        twice = np.where((self.n < 1.0)[:, None], self.lit[:, :2], self.lit[:, 2:])
        both = np.where(np.any(twice, axis=1)[:, None, None], both, 1.0)
        return np.where(np.abs(both) > SOFTEST, both, SOFTEST)

    @staticmethod
    def _terms(
        edge: tuple[Any, ...], breadth: Floats, by_face: tuple[int, int], at: SceneResponse, own: bool
    ) -> FaceTerms:
        """Return roots (P, T, 2), weights (P, T, F) of the two kinds of terms at an edge, and its faces' factors."""
        n, came, went, lit, faces = edge
        angles = diffraction.lit_angles(n[:, None], came, went)
        sides: Any = np.where(angles < 0.0, -1, 1) * np.abs(lit)[:, None] if own else lit[:, None]
        weight, root = diffraction.wedge_terms(n[:, None], angles, sides)
        cosine = np.broadcast_to(np.cos(0.5 * (went - came)), breadth.shape)
        factors = [face_factor(walls, cosine, at) for walls in faces.T]
        kept, past, inner = weight * np.abs(lit)[:, None], np.ones((len(n), 1, 1)), np.flatnonzero(n < 1.0)
        sheets = np.flatnonzero(at.panels[faces[:, 0]] & (faces[:, 0] == faces[:, 1]))
        if len(inner):  # these stand for reflections by both faces
            past = np.ones(factors[0].shape, dtype=np.complex128)
            past[inner] = (factors[0] * factors[1])[inner]
        if len(sheets):  # what passes them needs no edge, see `adjacent_factors`
            past = past * np.ones(factors[0].shape, dtype=np.complex128)
            cosine = np.broadcast_to(np.cos(0.5 * (went - came)), breadth.shape)
            past[sheets] -= face_factor(faces[sheets, 0] + at.surfaces, cosine[sheets], at)
        weights = [kept[..., i, None] * past + kept[..., j, None] * factors[j - 2] for i, j in enumerate(by_face)]
        root = np.where(lit[:, None, :2] != 0, root[..., :2], root[..., list(by_face)])
        return root * np.sqrt(breadth)[..., None], weights, factors


def _ahead(r: Floats, z: Floats) -> tuple[Floats, Floats]:
    """Return r and z (P, T) as an edge sees what is beyond the other one, r at least `ON_LINE`.

    Behind the edge there is no path, but nodes just beyond its interval are evaluated: there the field keeps the
    value that it has at the edge.
    """
    return np.maximum(r, diffraction.ON_LINE), z


Terms = tuple[Floats, Floats, Floats, list[Any]]

AT_ONCE = 100_000  # nodes and frequencies
ACROSS_AIR = 2  # in place of the faces that edges share
LEAVING, COMING = np.array([1.0, -1.0, -1.0, 1.0]), np.array([-1.0, 1.0, -1.0, 1.0])  # d(lit angle) / d(angle)


@dataclass(frozen=True, slots=True, eq=False)
class GapPairVertex(EdgePairVertex):
    """Two edges with open air between them, and walls by which the second one is seen."""

    seen: Floats  # (P, 4, 3) frames of the second edges as the first ones see them by these walls
    between: NDArray[np.int32]  # (P, B) walls between both edges from the first one's side, -1 behind the last
    budget: NDArray[np.int64]  # (P,) reflections that terms of both edges may stand for together

    kind: ClassVar[str] = "edge gap"
    loudest: ClassVar[float] = 9.0
    solver: ClassVar[type[edge_events.GapPairSolver]] = edge_events.GapPairSolver

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

    def on_moving_legs(
        self, links: Links, medium: UniformAir, times: Floats, kinematics: Kinematics
    ) -> edge_events.GapEvents:
        """Solve paths between moving legs."""
        before, after = links.legs
        pairs = edge_events.GapPairs(
            before.surfaces, after.surfaces, self.edge, self.over_end, self.last.edge, self.shared, self.between
        )
        solver = self.solver(before.mirrors, self.lines, links.motions, medium, kinematics.retarded)
        found: edge_events.GapEvents = solver.find(pairs, times)
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
        """Field (P, T, F) beyond both edges, without its phase, of ends at r, θ, z about the first and the last."""
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
    met = [diffraction.adjacent_reflections(edge.n) for edge in (pair, pair.last)]
    i, j = np.divmod(np.arange(16), 4)
    kept = (met[0][:, i] + met[1][:, j] <= pair.budget[:, None]) & (pair.lit[:, i] != 0) & (pair.last.lit[:, j] != 0)
    weight = 0.25 * one[..., i] * other[..., j] * kept[:, None]
    used = np.flatnonzero(np.any(weight != 0.0, axis=(0, 1)))
    i, j, weight = i[used], j[used], weight[..., used]
    made = diffraction.gap_transition(
        first[..., i], last[..., j], tie[..., None] * side[..., i] * last_side[..., j], wave
    )
    made *= weight[..., None]
    for term, (mine, theirs) in enumerate(zip(i.tolist(), j.tolist(), strict=True)):
        for factor in (before[mine], after[theirs]):
            if factor is not None:
                made[..., term, :] *= factor
    return made.sum(axis=-2)


def terms_of(
    edge: EdgeVertex, angles: Pair, slope: Floats, breadth: Floats, turns: Floats, at: SceneResponse, own: bool = False
) -> Terms:
    """Roots and weights (P, T, 4) of the terms at an edge, their sides and directions together, and faces' factors."""
    lit = None if own else edge.lit[:, None]
    weight, root = diffraction.wedge_terms(edge.n[:, None], diffraction.lit_angles(edge.n[:, None], *angles), lit)
    factors = adjacent_factors(edge.n, edge.faces, angles, slope, at)
    return root * np.sqrt(breadth)[..., None], weight, np.where(weight > 0.0, -turns, turns), factors
