"""Every path over two edges of bodies, or over two of the room by bodies, and when each is heard.

Both edges share a face, or have air between.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from clsim.acoustics.diffraction import ON_LINE, TERMS, adjacent_reflections, lit_angles
from clsim.arrays import Floats, Rows
from clsim.paths.chain import Chain
from clsim.paths.family import PathFamily
from clsim.paths.legs.legs import moving_paths
from clsim.paths.legs.mirrors import ROOM, EdgeLines, dot
from clsim.paths.search.bodies import BodySearch, PairQuery
from clsim.paths.search.body_edges import ABSENT, END, EdgeFinder, free_legs, halves, leg_is_free, tied
from clsim.paths.search.edge_gaps import cotangents, in_air, open_gaps, segment_off
from clsim.paths.vertices.edge import COLUMNS, EdgeVertex
from clsim.paths.vertices.edge_events import EdgePairEvents, EdgePairs, EdgePairSolver, GapPairs, GapPairSolver
from clsim.paths.vertices.edge_pair import ACROSS_AIR, EdgePairVertex, GapPairVertex
from clsim.paths.visibility.edges import footprint, in_face, lines_apart
from clsim.paths.visibility.subdivision import ROUNDS

Codes = NDArray[np.int16]
Span = tuple[float, float]
Route = tuple[int, int, NDArray[np.int32], int, NDArray[np.int64]]

_SECOND = 8 << TERMS  # of the codes of `body_edges`: the first bit for the terms of the second edge
_LONGER = 1.2  # times a path as it is when received, as which it may have been before
_NO_FACE = np.full(2, ACROSS_AIR)
_IN_AIR = 1e-7  # rad off the faces of an edge, from which on another edge is in its air


def moving_edge_pair_paths(search: BodySearch, others: tuple[PathFamily, ...]) -> Chain:
    """Find every path over two edges of one face of which the edges or a mirror belong to a body."""
    return moving_pairs(EdgePairFinder(search), EdgePairVertex, search, others)


class EdgePairFinder(EdgeFinder):
    """Looks for paths over two edges, from each source to each receiver."""

    def __init__(self, search: BodySearch) -> None:
        super().__init__(search)
        self._faces = _FacesBetween(search, self.lines)

    def _evaluate(self, pair: PairQuery, chains: Any) -> Callable[[Rows, Floats], Codes]:
        return PairEvaluation(self._search, self._faces, pair, chains)

    def _chains(self, source: int, receiver: int, span: Span) -> GapPairs:
        sides = self._reached(source, None, span), self._reached(source, receiver, span)
        none = np.empty((0, self.width), np.int32)
        parts: list[Any] = [(none, none, *(np.empty(0, np.int64),) * 3, np.empty((0, 2), np.int64), none)]
        for one, other, walls, end, face in self._routes(source, span):
            owners = np.concatenate([self.lines.owner[[one, other]], np.append(self._mirrors.owner, ROOM)[walls]])
            met, at_rest = int(np.sum(walls >= 0)), bool(np.all(owners == ROOM))
            before, after = self._met(sides, (one, other), self._order - met, at_rest)
            edges = (np.full(len(before), x) for x in (one, end, other))
            shared = np.tile(face, (len(before), 1))
            parts.append((before, after, *edges, shared, np.tile(walls, (len(before), 1))))
        return GapPairs(*(np.concatenate([part[i] for part in parts]) for i in range(7)))

    def _routes(self, source: int, span: Span) -> Iterator[Route]:
        """Yield edges, mirrors between (order,), ends, and shared faces (2,) of paths without their sides."""
        none = np.full(self.width, -1, np.int32)
        for (one, other), face in zip(*self.lines.pairs(), strict=True):
            yield int(one), int(other), none, -1, face

    def _columns(
        self, ends: tuple[int, int], chains: GapPairs, received: tuple[Floats, Floats], code: Codes
    ) -> dict[str, Any]:
        columns = self._own_columns(ends, chains, received, code)
        met, bits = columns["order"] - 1, _SECOND << np.arange(TERMS)
        met = met + np.sum(chains.between >= 0, axis=1, dtype=np.int32)
        last_lit = np.where(code[:, None] & bits, 1, -1).astype(np.int8)
        first, last = (adjacent_reflections(self.lines.n[edge]) for edge in (chains.edge, chains.last))
        on_face = chains.face[:, :1] != ACROSS_AIR
        least = (x.min(axis=1, keepdims=True) * on_face for x in (first, last))
        for lit, mine, other in zip((last_lit, columns["lit"]), (last, first), least, strict=True):
            lit[met[:, None] + mine + other > self._order] = 0
        more = {"order": met + 2, "last_edge": chains.last, "last_lit": last_lit, "shared": chains.face}
        return columns | more


class _FacesBetween:
    """What stands on the faces between two edges, and hides one from the other."""

    def __init__(self, search: BodySearch, lines: EdgeLines) -> None:
        meshes = search.scene.room.as_mesh(), *(body.mesh for body in lines.bodies)
        self.lines, self._walls = lines, [mesh.walls for mesh in meshes]
        self._first = np.cumsum([0, *(len(edges) for edges in lines.parts)])
        self._standing = cache(self._find)

    def free(self, pairs: EdgePairs, along: Floats) -> NDArray[np.bool_]:
        """Mask (n,) of pairs between whose places (n, 2) nothing stands, m."""
        free = np.ones(len(along), dtype=bool)
        for i, (edge, last, face) in enumerate(np.column_stack([pairs.edge, pairs.last, pairs.face[:, 0]]).tolist()):
            standing = self._standing(edge, last, face)
            if len(standing):
                frames, (edges, own) = self.lines.frames[[edge, last]], self._owned(edge)
                places = frames[:, 0] + along[i][:, None] * frames[:, 3]
                free[i] = not lines_apart(in_face(edges, own, face, places), standing)[0].any()
        return free

    def _owned(self, edge: int) -> tuple[Any, int]:
        """Edges of the object that an edge belongs to, and its number among them."""
        owner = int(self.lines.owner[edge]) + 1
        return self.lines.parts[owner], edge - int(self._first[owner])

    def _find(self, edge: int, last: int, face: int) -> Floats:
        (edges, one), (_, other) = self._owned(edge), self._owned(last)
        return footprint(edges, self._walls[int(self.lines.owner[edge]) + 1], one, other, face)


@dataclass(frozen=True, slots=True, eq=False)
class PairEvaluation:
    """How paths over two edges are at some times, as codes: `ABSENT`, or bits for what of theirs is seen."""

    search: BodySearch
    faces: _FacesBetween
    pair: PairQuery
    pairs: GapPairs

    solver: ClassVar[type[EdgePairSolver]] = EdgePairSolver

    def __call__(self, rows: Rows, times: Floats) -> Codes:
        """Codes of paths at times (P, T), s."""
        lines, pair = self.faces.lines, self.pair
        solver = self.solver(self.search.obstacles.mirrors, lines, pair.ends, pair.medium, rounds=ROUNDS)
        pairs = self.pairs.part(rows)
        events: Any = solver.find(pairs, times)
        p, t = free_legs(self.search, pairs, events, times, self.on(solver, pairs, events))
        there = self.free(pairs, events, p, t)
        p, t = p[there], t[there]
        wedges = lines.n[pairs.edge[p]], lines.n[pairs.last[p]]
        t_s, t_r = (end[1][p, t] for end in (events.source, events.receiver))
        ahead, back = self.between(pairs, events, p, t)
        met: Any = sum(np.sum(walls[p] >= 0, axis=1) for walls in (pairs.before, pairs.after, pairs.between))
        code = np.full(times.shape, ABSENT, dtype=np.int16)
        ended, inside = self.ended(solver, pairs, events, p, t)
        code[p, t] = END * inside
        edges = (1, wedges[0], (t_s, ahead)), (_SECOND, wedges[1], (back, t_r))
        for (first, wedge, angles), ends in zip(edges, ended.T[..., None], strict=True):
            seen = ends | (lit_angles(wedge, *angles) >= 0.0) & (
                met[:, None] + adjacent_reflections(wedge) <= self.search.order
            )
            code[p, t] += (seen @ (first << np.arange(TERMS))).astype(np.int16)
        code[p, t] += halves(wedges, (t_s, t_r)).astype(np.int16)
        return code

    def ended(self, solver: Any, pairs: Any, events: Any, p: Rows, t: Rows) -> tuple[Any, Any]:
        """Masks of edges (n, 2) that end, and of paths (n,) whose shortest ways over both edges meet those."""
        return np.zeros((len(p), 2), dtype=bool), np.zeros(len(p), dtype=bool)

    def free(self, pairs: Any, events: Any, p: Rows, t: Rows) -> NDArray[np.bool_]:
        """Mask (n,) of some paths at times (n,) of which the way between both edges is free."""
        return self.faces.free(pairs.part(p), events.along[p, :, t])

    def between(self, pairs: Any, events: Any, p: Rows, t: Rows) -> tuple[Floats, Floats]:
        """Angles (n,) of the way between about both edges."""
        face, lines = np.pi * pairs.face[p], self.faces.lines
        return face[:, 0] * lines.n[pairs.edge[p]], face[:, 1] * lines.n[pairs.last[p]]

    def on(self, solver: EdgePairSolver, pairs: EdgePairs, events: EdgePairEvents) -> NDArray[np.bool_]:
        """Mask (P, T) of paths that meet both edges, from the air, with each end beyond the other's edge."""
        on = on_edges(solver, pairs, events)
        for r, _ in solver.ahead(pairs, events):
            on &= r > 0.0
        return np.asarray(on)


def on_edges(solver: EdgePairSolver, pairs: EdgePairs, events: EdgePairEvents) -> NDArray[np.bool_]:
    """Mask (P, T) of paths that meet both edges from the air."""
    lines, edges = solver.lines, np.stack([pairs.edge, pairs.last], axis=1)
    on = (events.along > 0.0) & (events.along < lines.length[edges][..., None])
    on = np.all(on | ~np.isnan(solver.held(pairs)), axis=1)
    for edge, (_, angle, _) in zip(edges.T, (events.source, events.receiver), strict=True):
        on &= (angle > 0.0) & (angle < np.pi * lines.n[edge][:, None])
    return np.asarray(on)


def moving_gap_paths(search: BodySearch, others: tuple[PathFamily, ...]) -> Chain:
    """Find every path over two edges with air between of which an edge or a mirror belongs to a body."""
    return moving_pairs(GapFinder(search), GapPairVertex, search, others)


def moving_pairs(
    finder: EdgePairFinder, kind: type[EdgePairVertex], search: BodySearch, others: tuple[PathFamily, ...]
) -> Chain:
    """Find every path over two edges with a kind of vertices."""
    held = finder.every_path()
    own: dict[str, Any] = {name: held[name] for name in COLUMNS}
    alike: dict[str, Any] = {"lines": finder.lines, "model": "utd"}
    last = EdgeVertex(**(own | {"edge": held["last_edge"], "lit": held["last_lit"]}), **alike)
    more: dict[str, Any] = {name: held[name] for name in ("between", "budget") if name in held}
    more |= {"seen": np.zeros((len(held["edge"]), 4, 3))} if more else {}
    vertex = kind(**own, **alike, last=last, shared=held["shared"], **more)
    return tied(moving_paths(search.scene, search.obstacles.mirrors, held, ("before", "after"), vertex), others)


def _apart(places: Floats, others: Floats) -> Floats:
    """Largest distances (P, T) between places (P, T, k, 3) and others (P, T, l, 3), m."""
    away = places[:, :, :, None] - others[:, :, None]
    return np.asarray(np.sqrt(np.einsum("ptkli,ptkli->ptkl", away, away)).max(axis=(2, 3)))


class GapFinder(EdgePairFinder):
    """Looks for paths over two edges with air between, from each source to each receiver."""

    def __init__(self, search: BodySearch) -> None:
        super().__init__(search)
        self._hidden = self._find_hidden()

    def _evaluate(self, pair: PairQuery, chains: Any) -> Callable[[Rows, Floats], Any]:
        return GapEvaluation(self._search, self._faces, pair, chains)

    def _routes(self, source: int, span: Span) -> Iterator[Route]:
        """Yield edges, mirrors between (order,), ends, and shared faces (2,) of paths without their sides."""
        for one, other, walls in self._gaps(source, span):
            yield one, other, walls, -1, _NO_FACE

    def _find_hidden(self) -> NDArray[np.bool_]:
        """Mask (E, E) of edges of one object of which neither sees the other."""
        hidden, lines = np.zeros((len(self.lines), len(self.lines)), dtype=bool), self.lines
        meshes = self._search.room, *(body.mesh for body in lines.bodies)
        for owner, (mesh, edges) in enumerate(zip(meshes, lines.parts, strict=True), start=ROOM):
            pair = np.argwhere(np.ones((len(edges), len(edges))))
            seen, own = (
                open_gaps(mesh.walls, edges, pair, np.empty((len(pair), 0), np.int32)).pair,
                lines.owner == owner,
            )
            sees = np.zeros((len(edges), len(edges)), dtype=bool)
            sees[tuple(seen.T)] = True
            hidden[np.ix_(own, own)] = ~sees
        return hidden

    def _gaps(self, source: int, span: Span) -> list[tuple[int, int, NDArray[np.int32]]]:
        """List pairs of edges that share no face, and mirrors (order,) by which one may be reached from the other."""
        (_, longest), (begin, end) = self._search.queries[source], span
        found, lines, hidden = [], self.lines, self._hidden
        shared = (lines.faces[:, None, :, None] == lines.faces[None, :, None, :]).any(axis=(2, 3))
        for one, middle in enumerate(self._middles(0.5 * (begin - longest + end))):
            beams = self._beams(source, (middle, 0.5 * float(lines.length[one])), span)
            for other in np.flatnonzero(~shared[one]).tolist():
                kept = [met[~self._held[one][met[:, 0]]] if met.shape[1] else met for met in beams[other]]
                kept = kept[1:] if hidden[one, other] else kept
                found += [(one, other, walls) for walls in self._padded(other, kept, backwards=False)]
        return found

    def _columns(
        self, ends: tuple[int, int], chains: Any, received: tuple[Floats, Floats], code: Any
    ) -> dict[str, Any]:
        columns = EdgePairFinder._columns(self, ends, chains, received, code)
        order = columns["order"].astype(np.int64)
        return columns | {"order": order, "between": chains.between, "budget": self._order + 2 - order}


@dataclass(frozen=True, slots=True, eq=False)
class GapEvaluation(PairEvaluation):
    """How paths over two edges with air between are at some times, see `PairEvaluation`."""

    solver: ClassVar[type[GapPairSolver]] = GapPairSolver

    def __call__(self, rows: Rows, times: Floats) -> NDArray[Any]:
        """Codes of paths at times (P, T), s."""
        code = np.full(times.shape, ABSENT, dtype=np.int16)
        p, t = np.nonzero(self.possible(self.pairs.part(rows), times))
        if len(p):
            code[p, t] = PairEvaluation.__call__(self, rows[p], times[p, t][:, None])[:, 0]
        return code

    def possible(self, pairs: Any, times: Floats) -> NDArray[np.bool_]:
        """Mask (P, T) of paths that may be there, as all is when sound is received, and by how far it moves."""
        seen = self._seen(pairs, times)
        (_, first, source, ahead), (_, second, receiver, _) = seen
        length = sum(_apart(*places) for places in ((source, first), (ahead, first), (receiver, second)))
        slack = (self._fastest(pairs) * _LONGER / self.search.scene.air.slowest)[:, None] * length
        return self.may_pass(pairs, times, seen, slack)

    def may_pass(self, pairs: Any, times: Floats, seen: Any, slack: Floats) -> NDArray[np.bool_]:
        """Mask (P, T) of paths that both edges may let pass, by what these see."""
        (edge, first, *before), (last, second, *behind) = seen
        mine = self.alike(edge, times, first, (before[0], before[1]), slack)
        return mine & self.alike(last, times, second, (behind[0], behind[1]), slack)

    def _seen(self, pairs: Any, times: Floats) -> list[tuple[Rows, Floats, Floats, Floats]]:
        """Return both edges, each with its ends (P, T, 2, 3) and what it sees, m: an end, and the other edge's ends."""
        lines, between, none = self.faces.lines, pairs.between.T, np.zeros(times.shape)
        first, last = (
            np.stack(
                [
                    lines.placed(edge, none + along[:, None], times)
                    for along in (0.0 * lines.length[edge], lines.length[edge])
                ],
                2,
            )
            for edge in (pairs.edge, pairs.last)
        )
        source, receiver = (end.position(times)[:, :, None] for end in self.pair.ends)
        source, receiver = (
            self._images(pairs.before.T, source, times),
            self._images(pairs.after.T[::-1], receiver, times),
        )
        ahead, back = self._images(between[::-1], last, times), self._images(between, first, times)
        return [(pairs.edge, first, source, ahead), (pairs.last, last, receiver, back)]

    def alike(
        self, edge: Rows, times: Floats, own: Floats, seen: tuple[Floats, Floats], slack: Floats
    ) -> NDArray[np.bool_]:
        """Mask (P, T) of paths with an end and the other edge in the air of an edge, at angles that may agree."""
        lines, possible, bounds = self.faces.lines, np.ones(times.shape, dtype=bool), []
        axes, n, length = lines.axes(edge, times), lines.n[edge][:, None, None], lines.length[edge][:, None]
        for places, sign in zip(seen, (-1.0, 1.0), strict=True):
            x, y, z = (dot(places - own[:, :, :1], axis[:, :, None]) for axis in axes)
            possible &= np.any(in_air(n, x, y, -slack[..., None]), axis=2)
            least = np.maximum(segment_off(np.stack([x, y], axis=3)) - slack, ON_LINE)
            heights = z.min(axis=2) - slack - length, z.max(axis=2) + slack
            found = cotangents(*heights, least, np.maximum(np.hypot(x, y).max(axis=2) + slack, ON_LINE))
            bounds.append(found if sign > 0.0 else (-found[1], -found[0]))
        return np.asarray(possible & (bounds[0][0] <= bounds[1][1]) & (bounds[1][0] <= bounds[0][1]))

    def _images(self, walls: NDArray[np.int32], places: Floats, times: Floats) -> Floats:
        """Places (P, T, k, 3), m, mirrored by mirrors (N, P) as they are at times (P, T), s."""
        for met in walls:
            plane = self.search.obstacles.mirrors.planes(met, times, np.zeros(times.shape), None)
            off = dot(places, plane.normal[:, :, None]) - plane.offset[..., None]
            places = places - 2.0 * off[..., None] * plane.normal[:, :, None]
        return places

    def _fastest(self, pairs: Any) -> Floats:
        """Bounds (P,) of how fast what an edge sees moves, as it sees it, m/s."""
        search, rates = self.search, self.pair.rates
        source = float(rates.source.over(np.array([rates.bodies.first]), np.array([rates.bodies.last])).max())
        size, owner = search.room.walls.size, np.append(search.obstacles.mirrors.owner, ROOM)
        fastest = max(body.peak_speed + size * body.trajectory.peak_turn for body in rates.bodies.bodies)
        met = sum(np.sum(owner[walls] != ROOM, axis=1) for walls in (pairs.before, pairs.between, pairs.after))
        return np.asarray(source + fastest * (2.0 + 2.0 * met))

    def free(self, pairs: Any, events: Any, p: Rows, t: Rows) -> NDArray[np.bool_]:
        """Mask (n,) of some paths at times (n,) of which the way between both edges is free."""
        return np.asarray(leg_is_free(self.search, pairs.between[p], events.between, events.leaving, p, t))

    def between(self, pairs: Any, events: Any, p: Rows, t: Rows) -> tuple[Floats, Floats]:
        """Angles (n,) of the way between about both edges."""
        return events.middle[p, t, 0], events.middle[p, t, 1]

    def on(self, solver: Any, pairs: Any, events: Any) -> NDArray[np.bool_]:
        """Mask (P, T) of paths that meet both edges from the air, of which each is in the air of the other."""
        on = on_edges(solver, pairs, events)
        for angle, edge in zip(np.moveaxis(events.middle[..., :2], 2, 0), (pairs.edge, pairs.last), strict=True):
            on &= (angle > _IN_AIR) & (angle < np.pi * solver.lines.n[edge][:, None] - _IN_AIR)
        return np.asarray(on)
