"""Every path over two edges with air between of which an edge or a mirror belongs to a body, and when each is heard."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from clsim.acoustics.diffraction import ON_LINE
from clsim.arrays import Floats
from clsim.paths.chain import Chain
from clsim.paths.family import PathFamily
from clsim.paths.legs.mirrors import ROOM, dot
from clsim.paths.legs.moving import moving_paths
from clsim.paths.search.bodies import BodySearch, PairQuery
from clsim.paths.search.body_edge_pairs import EdgePairFinder, PairEvaluation, on_edges
from clsim.paths.search.body_edges import ABSENT, leg_is_free, tied
from clsim.paths.search.gap_parts import cotangents, in_air, open_gaps, segment_off
from clsim.paths.vertices.edge import COLUMNS, EdgeVertex
from clsim.paths.vertices.gap_events import GapPairs, GapPairSolver
from clsim.paths.vertices.gap_pair import ACROSS_AIR, GapPairVertex

Rows = NDArray[np.int64]
Span = tuple[float, float]
Route = tuple[int, int, NDArray[np.int32], int, NDArray[np.int64]]

_LONGER = 1.2  # times a path as it is when received, as which it may have been before
_NO_FACE = np.full(2, ACROSS_AIR)
_IN_AIR = 1e-7  # rad off the faces of an edge, from which on another edge is in its air


def moving_gap_paths(search: BodySearch, others: tuple[PathFamily, ...]) -> Chain:
    """Find every path over two edges with air between of which an edge or a mirror belongs to a body.

    others: paths over fewer edges, and over two of the room: where one of these is taken over from, its time is taken.
    """
    return moving_pairs(GapFinder(search), GapPairVertex, search, others)


def moving_pairs(
    finder: GapFinder, kind: type[GapPairVertex], search: BodySearch, others: tuple[PathFamily, ...]
) -> Chain:
    """Find every path over two edges with a kind of vertices."""
    held = finder.every_path()
    own: dict[str, Any] = {name: held[name] for name in COLUMNS}
    alike: dict[str, Any] = {"lines": finder.lines, "model": "utd"}
    last = EdgeVertex(**(own | {"edge": held["last_edge"], "lit": held["last_lit"]}), **alike)
    more = {name: held[name] for name in ("shared", "between", "budget")}
    vertex = kind(**own, **alike, last=last, **more, seen=np.zeros((len(held["edge"]), 4, 3)))
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

    def _chains(self, source: int, receiver: int, span: Span) -> GapPairs:
        sides = self._reached(source, None, span), self._reached(source, receiver, span)
        none = np.empty((0, self.width), np.int32)
        parts: list[Any] = [(none, none, *(np.empty(0, np.int64),) * 3, np.empty((0, 2), np.int64), none)]
        for one, other, walls, end, face in self._routes(source, span):
            met, at_rest = int(np.sum(walls >= 0)), self._all_rest(one, other, walls)
            before, after = self._met(sides, (one, other), self._order - met, at_rest)
            edges = (np.full(len(before), x) for x in (one, end, other))
            shared = np.tile(face, (len(before), 1))
            parts.append((before, after, *edges, shared, np.tile(walls, (len(before), 1))))
        return GapPairs(*(np.concatenate([part[i] for part in parts]) for i in range(7)))

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

    def _all_rest(self, one: int, other: int, walls: NDArray[np.int32]) -> bool:
        """Whether two edges and the mirrors between them belong to the room."""
        owners = np.append(self._mirrors.owner, ROOM)[walls]
        return bool(np.all(self.lines.owner[[one, other]] == ROOM) and np.all(owners == ROOM))

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
        met = columns["order"] - 2
        return columns | {"between": chains.between, "budget": self._order - met.astype(np.int64)}

    def met_between(self, chains: GapPairs) -> Any:
        """Numbers (n,) of mirrors between both edges."""
        return np.sum(chains.between >= 0, axis=1)


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
        """Mask (P, T) of paths with an end and the other edge in the air of an edge, at angles that may agree.

        Shapes: slack (P, T) m, by which they may be elsewhere.
        """
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

    def met(self, pairs: Any) -> NDArray[np.int64]:
        """Numbers (P,) of mirrors between both edges."""
        return np.asarray(np.sum(pairs.between >= 0, axis=1))

    def on(self, solver: Any, pairs: Any, events: Any) -> NDArray[np.bool_]:
        """Mask (P, T) of paths that meet both edges from the air, of which each is in the air of the other."""
        on = on_edges(solver, pairs, events)
        for angle, edge in zip(np.moveaxis(events.middle[..., :2], 2, 0), (pairs.edge, pairs.last), strict=True):
            on &= (angle > _IN_AIR) & (angle < np.pi * solver.lines.n[edge][:, None] - _IN_AIR)
        return np.asarray(on)
