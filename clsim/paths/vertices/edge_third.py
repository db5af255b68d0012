"""Three edges as vertices: paths over two edges that pass a third one, which shares a face with one of these."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self, cast

import numpy as np
from numpy.typing import NDArray

from clsim.acoustics.diffraction import (
    ON_LINE,
    double_transition,
    lit_angles,
    transition,
    wedge_terms,
)
from clsim.arrays import Floats
from clsim.paths.family import Links, Pair, Rows
from clsim.paths.response import Kinematics, SceneResponse
from clsim.paths.vertices.edge import COLUMNS, EdgeVertex, Triple
from clsim.paths.vertices.edge_end import EdgeEndVertex
from clsim.paths.vertices.edge_field import EdgeView, RolledOut, polar
from clsim.paths.vertices.edge_pair import SOFTEST, EdgePairVertex
from clsim.scene.scene import Scene


@dataclass(frozen=True, slots=True, eq=False)
class ThirdEdgeVertex(EdgeVertex):
    """Two edges, or an edge and an end, with a third edge before or behind; columns of `EdgeVertex` are the pair's.

    The endpoint beyond the third edge is rolled out about it into the plane of the face that it shares with the pair.
    From there the pair sees it.

    Attributes
    ----------
    pair : EdgeEndVertex
        The pair, all edges of which share faces; `over_end` is -1 where neither edge ends.
    third : EdgeVertex
        The third edges.
    face : ndarray (P, 2) int
        Face that the pair's nearest edge and the third one share, of each: 0 for its 0-face, 1 for its n-face.
    leads : ndarray (P,) bool
        Whether the third edge comes before the pair.
    """

    pair: EdgeEndVertex
    third: EdgeVertex
    face: NDArray[np.int64]
    leads: NDArray[np.bool_]

    kind: ClassVar[str] = "three edges"
    loudest: ClassVar[float] = 36.0

    def part(self, rows: Rows) -> ThirdEdgeVertex:
        """Return some of the vertices."""
        columns: dict[str, Any] = {name: getattr(self, name)[rows] for name in (*COLUMNS, "face", "leads")}
        pair: Any = self.pair.part(rows)
        return replace(self, **columns, pair=pair, third=self.third.part(rows))

    def in_scene(self, scene: Scene) -> Self:
        """Return the same vertices with the bodies of another scene."""
        first = EdgeVertex.in_scene(self, scene)
        return replace(first, pair=self.pair.in_scene(scene), third=self.third.in_scene(scene))

    def named(self, moving: bool) -> Iterator[tuple[str, Any]]:
        """Yield the columns by name."""
        yield from self.pair.named(moving)
        for name in ("edge", "lit") if moving else ("frame", "n", "faces", "lit"):
            yield f"third_{name}", getattr(self.third, name)
        yield from (("third_face", self.face), ("leads", self.leads))

    @property
    def end_place(self) -> Floats:
        """NaN (P,): `met` says where paths meet the edges."""
        return np.full(len(self), np.nan)

    @property
    def objects(self) -> NDArray[np.int64]:
        """Numbers of all edges or ends among the names, (P, 3)."""
        pair, third = self.pair.objects, self.third.edge[:, None]
        return np.where(self.leads[:, None], np.hstack([third, pair]), np.hstack([pair, third]))

    @property
    def outer(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """The first and the last edges, (P,)."""
        leads, third = self.leads, self.third.edge
        return np.where(leads, third, self.pair.edge), np.where(leads, self.pair.last.edge, third)

    @property
    def near(self) -> NDArray[np.int64]:
        """Edges of the pair (P,) that share faces with the third ones."""
        return np.where(self.leads, self.pair.edge, self.pair.last.edge)

    @property
    def wedges(self) -> tuple[Floats, Floats]:
        """Exterior angles over π of the first and of the last edge of each path, (P,)."""
        first, last = self.outer
        return self.lines.n[first], self.lines.n[last]

    def views(self, links: Links) -> tuple[EdgeView, EdgeView]:
        """Take the views of the endpoints from the first and the last edge of each path."""
        ends = zip(links.legs, self.outer, strict=True)
        first, last = (EdgeView.of(leg.matrix, leg.offset, self.lines.frames[edge]) for leg, edge in ends)
        return first, last

    def rolled_out(self, source: Any, receiver: Any) -> tuple[Pair, Pair]:
        """R and z (P, T) about the pair's edges of endpoints at r and z about the outer edges, m."""
        leads, far = (
            self.leads[:, None],
            [np.where(self.leads[:, None], *x) for x in zip(source, receiver, strict=True)],
        )
        r, z = self.beyond()[0](*far)
        seen = np.maximum(r, ON_LINE), z
        first, last = (
            tuple(np.where(third, a, b) for a, b in zip(seen, own, strict=True))
            for third, own in ((leads, source), (~leads, receiver))
        )
        return (first[0], first[1]), (last[0], last[1])

    def beyond(self) -> tuple[RolledOut, RolledOut]:
        """Take the views from the nearest edge of the pair beyond the third one, and back."""
        edges = self.near, self.third.edge
        frames, n = (self.lines.frames[edge] for edge in edges), (self.lines.n[edge] for edge in edges)
        return RolledOut.between((next(frames), next(frames)), (next(n), next(n)), self.face)

    def places_on(self, source: Pair, receiver: Pair) -> tuple[tuple[Floats, Floats, Floats], Floats, Floats]:
        """Places on the pair's edges and on the third ones, lengths (P, T), and those along the faces between, m."""
        ends, over_end = self.rolled_out(source, receiver), self.pair.over_end >= 0
        places, length = EdgePairVertex.met(self.pair, *ends)
        if over_end.any():
            found, whole = self.pair.met(*ends)
            rows, length = over_end[:, None], np.where(over_end[:, None], whole, length)
            places = np.where(rows, found[0], places[0]), np.where(rows, found[1], places[1])
        leads = self.leads[:, None]
        r, z = self.beyond()[1](np.zeros_like(length), np.where(leads, *places))
        far_r, far_z = (np.where(leads, *x) for x in zip(source, receiver, strict=True))
        across = np.maximum(far_r + r, ON_LINE)  # r is negative where nodes just beyond a corner of both are evaluated
        between = np.hypot(across, far_z - z) * r / across
        return (places[0], places[1], (far_z * r + z * far_r) / across), length, between

    def met(self, source: Pair, receiver: Pair) -> tuple[Pair, Floats]:
        """Places on the outer edges, and lengths, of shortest paths between ends at r and z about them, (P, T) m."""
        (one, other, third), length, _ = self.places_on(source, receiver)
        leads = self.leads[:, None]
        return (np.where(leads, third, one), np.where(leads, other, third)), length

    def places(self, links: Links, ends: Pair, times: Floats, kinematics: Kinematics) -> tuple[Floats, ...]:
        """Locate the points (P, 3) on all edges, m."""
        seen = (polar(view.places(x[:, None])) for view, x in zip(self.views(links), ends, strict=True))
        found, _, _ = self.places_on(*seen)
        edges = self.pair.edge, self.pair.last.edge, self.third.edge
        one, other, third = (
            self.lines.frames[edge, 0] + place * self.lines.frames[edge, 3]
            for edge, place in zip(edges, found, strict=True)
        )
        leads = self.leads[:, None]
        return np.where(leads, third, one), np.where(leads, one, other), np.where(leads, other, third)

    def lengths(self, links: Links, ends: Pair, images: Pair, times: Any) -> Floats:
        """Lengths (P,) of the shortest paths between endpoints (P, 3), and their images, on static legs, m."""
        seen = (polar(view.places(x[:, None])) for view, x in zip(self.views(links), ends, strict=True))
        return np.asarray(self.met(*seen)[1][:, 0])

    def _field(self, source: Triple, receiver: Triple, end: Floats, wave: Floats, at: SceneResponse) -> Any:
        """Field (P, T, F) beyond all edges, without its phase, of endpoints at r, θ, z about the outer ones.

        Our own derivation: that of the pair with the endpoint rolled out, of which the third edge lets pass ``½ Σ κ
        E(b, c) / E(b)`` with the root b of the nearest edge and c of its own. In the plane of the face that is a half.
        """
        field, turned = (
            np.zeros(wave.shape, dtype=np.complex128),
            np.pi * self.face[:, :1] * self.lines.n[self.near][:, None],
        )
        ends = self.rolled_out(source[::2], receiver[::2])
        kinds: Any = (self.pair.over_end < 0, EdgePairVertex), (self.pair.over_end >= 0, EdgeEndVertex)
        for of_kind, kind in kinds:
            rows = np.flatnonzero(of_kind)
            if len(rows):
                leads, pair = self.leads[rows, None], cast("Any", self.pair.part(rows))
                angles = (np.where(x, turned[rows], own[1][rows]) for x, own in ((leads, source), (~leads, receiver)))
                seen = [(r[rows], t, z[rows]) for (r, z), t in zip(ends, angles, strict=True)]
                none = np.full((len(rows), 1), np.nan)
                field[rows] = kind._field(pair, seen[0], seen[1], none, wave[rows], at)
        for first in (False, True):
            rows = np.flatnonzero(self.leads == first)
            if len(rows):
                some: Any = tuple(tuple(x[rows] for x in end) for end in (source, receiver))
                field[rows] *= self.part(rows)._passing(first, some, wave[rows], at)
        return field

    def _passing(self, leads: bool, ends: tuple[Triple, ...], wave: Floats, at: SceneResponse) -> Any:
        """Share (P, T, F) that the third edges let pass, of paths whose third edges all lead, or come last."""
        roots, tie, breadth = self.coupling(*(end[::2] for end in ends))
        edge, face, angle = self.third, self.face[:, 1], ends[0 if leads else 1][1]
        on_face = np.pi * (face * edge.n)[:, None]
        came, went = (angle, on_face) if leads else (on_face, angle)
        given, by_face = (edge.n, came, went, edge.lit, edge.faces), (2, 3) if leads else (3, 2)
        root, weights, factors = EdgePairVertex._terms(given, breadth, by_face, at, False)
        share: Any = np.zeros(wave.shape, dtype=np.complex128)
        for i, weight in enumerate(weights):
            share += 0.5 * weight * double_transition(roots, root[..., i], tie, wave)
        share /= transition(roots[..., None] * np.sqrt(wave))
        factor: Any = np.where((face == 1)[:, None, None], factors[1], factors[0])
        twice = np.any(edge.lit[:, 2:] != 0, axis=1)[:, None, None]
        return share / np.where(twice, np.where(np.abs(1.0 + factor) > SOFTEST, 1.0 + factor, SOFTEST), 1.0)

    def coupling(self, source: Pair, receiver: Pair) -> tuple[Floats, Floats, Floats]:
        """Roots of the nearest edges' terms, couplings with the third ones, and breadths of these, (P, T)."""
        places, length, between = self.places_on(source, receiver)
        leads = self.leads[:, None]
        (far_r, far_z), (r, z) = (
            [np.where(x, *ends) for ends in zip(*pairs, strict=True)]
            for x, pairs in ((leads, (source, receiver)), (leads, self.rolled_out(source, receiver)))
        )
        behind, own = np.maximum(np.hypot(far_r, far_z - places[2]), ON_LINE), np.where(leads, *places[:2])
        before, onto = np.maximum(length - between - behind, ON_LINE), np.maximum(np.hypot(r, z - own), ON_LINE)
        tie = np.sqrt(np.clip(before * behind / ((before + between) * (between + behind)), 0.0, 1.0))
        n = self.lines.n[self.near]
        shared = np.where(self.leads, self.pair.shared[:, 0], self.pair.shared[:, 1])
        _, root = wedge_terms(n, lit_angles(n, shared * np.pi * n, self.face[:, 0] * np.pi * n))
        near = np.abs(root[:, :1]) * np.sqrt(2.0 * before * np.maximum(length - before, 0.0) / length) * r / onto
        return near, tie, 2.0 * behind * np.maximum(length - behind, 0.0) / length * (far_r / behind) ** 2
