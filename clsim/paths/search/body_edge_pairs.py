"""Every path over two edges of one face of a body, or over two of the room by bodies, and when each is heard."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from clsim.acoustics.diffraction import TERMS, adjacent_reflections, lit_angles
from clsim.arrays import Floats
from clsim.paths.chain import Chain
from clsim.paths.family import PathFamily
from clsim.paths.legs.mirrors import EdgeLines
from clsim.paths.legs.moving import moving_paths
from clsim.paths.search.bodies import BodySearch, PairQuery
from clsim.paths.search.body_edges import ABSENT, END, EdgeFinder, free_legs, halves, tied
from clsim.paths.vertices.edge import COLUMNS, EdgeVertex
from clsim.paths.vertices.edge_pair import EdgePairVertex
from clsim.paths.vertices.edge_pair_events import EdgePairEvents, EdgePairs, EdgePairSolver
from clsim.paths.vertices.gap_pair import ACROSS_AIR
from clsim.paths.visibility.edges import footprint, in_face, lines_apart
from clsim.paths.visibility.subdivision import ROUNDS

Rows = NDArray[np.int64]
Codes = NDArray[np.int16]

_SECOND = 8 << TERMS  # of the codes of `body_edges`: the first bit for the terms of the second edge


def moving_edge_pair_paths(search: BodySearch, others: tuple[PathFamily, ...]) -> Chain:
    """Find every path over two edges of one face of which the edges or a mirror belong to a body.

    others: paths over fewer edges, and over two of the room: where one of these is taken over from, its time is taken.
    """
    finder, scene = EdgePairFinder(search), search.scene
    held = finder.every_path()
    own: dict[str, Any] = {name: held[name] for name in COLUMNS}
    alike: dict[str, Any] = {"lines": finder.lines, "model": "utd"}
    last = EdgeVertex(**(own | {"edge": held["last_edge"], "lit": held["last_lit"]}), **alike)
    vertex = EdgePairVertex(**own, **alike, last=last, shared=held["shared"])
    return tied(moving_paths(scene, search.obstacles.mirrors, held, ("before", "after"), vertex), others)


class EdgePairFinder(EdgeFinder):
    """Looks for paths over two edges, from each source to each receiver."""

    def __init__(self, search: BodySearch) -> None:
        super().__init__(search)
        self._faces = _FacesBetween(search, self.lines)

    def _evaluate(self, pair: PairQuery, chains: Any) -> Callable[[Rows, Floats], Codes]:
        return PairEvaluation(self._search, self._faces, pair, chains)

    def _chains(self, source: int, receiver: int, span: tuple[float, float]) -> EdgePairs:
        sides = self._reached(source, None, span), self._reached(source, receiver, span)
        parts: list[Any] = [(*(np.empty((0, self.width), np.int32),) * 2, *(np.empty(0, np.int64),) * 3)]
        shared = [np.empty((0, 2), np.int64)]
        for (edge, last), face in zip(*(x.tolist() for x in self.lines.pairs()), strict=True):
            before, after = self._met(sides, (edge, last), self._order)
            parts.append((before, after, *(np.full(len(before), x) for x in (edge, -1, last))))
            shared.append(np.tile(face, (len(before), 1)))
        before, after, edges, none, others = (np.concatenate([part[i] for part in parts]) for i in range(5))
        return EdgePairs(before, after, edges, none, others, np.concatenate(shared))

    def _columns(
        self, ends: tuple[int, int], chains: EdgePairs, received: tuple[Floats, Floats], code: Codes
    ) -> dict[str, Any]:
        columns = self._own_columns(ends, chains, received, code)
        met, bits = columns["order"] - 1, _SECOND << np.arange(TERMS)
        met = met + self.met_between(chains)
        last_lit = np.where(code[:, None] & bits, 1, -1).astype(np.int8)
        first, last = (adjacent_reflections(self.lines.n[edge]) for edge in (chains.edge, chains.last))
        on_face = chains.face[:, :1] != ACROSS_AIR
        least = (x.min(axis=1, keepdims=True) * on_face for x in (first, last))
        for lit, mine, other in zip((last_lit, columns["lit"]), (last, first), least, strict=True):
            lit[met[:, None] + mine + other > self._order] = 0
        more = {"order": met + 2, "last_edge": chains.last, "last_lit": last_lit, "shared": chains.face}
        return columns | more

    def met_between(self, chains: Any) -> Any:
        """Numbers (n,) of mirrors between both edges."""
        return 0


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
    pairs: EdgePairs

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
        met = np.sum(pairs.before[p] >= 0, axis=1) + np.sum(pairs.after[p] >= 0, axis=1) + self.met(pairs)[p]
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

    def met(self, pairs: Any) -> NDArray[np.int64]:
        """Numbers (P,) of mirrors between both edges."""
        return np.zeros(len(pairs.edge), dtype=np.int64)

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
