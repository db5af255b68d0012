"""Every path over two edges with air between of which an edge or a mirror belongs to a body, and when each is heard."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from clsim.paths.legs.mirrors import ROOM
from clsim.paths.legs.moving import moving_paths
from clsim.paths.search.body_edge_pairs import EdgePairFinder, PairLook, on_edges
from clsim.paths.search.body_edges import leg_is_free
from clsim.paths.search.edge_chains import tied
from clsim.paths.search.gap_parts import open_gaps
from clsim.paths.vertices.edge import COLUMNS, EdgeVertex
from clsim.paths.vertices.gap_events import GapPairs, GapPairSolver
from clsim.paths.vertices.gap_pair import ACROSS_AIR, GapPairVertex

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from clsim.arrays import Floats
    from clsim.paths.chain import Chain
    from clsim.paths.family import PathFamily
    from clsim.paths.search.bodies import BodySearch, PairQuery

    Rows = NDArray[np.int64]
    Span = tuple[float, float]

_IN_AIR = 1e-7  # rad off the faces of an edge, from which on another edge is in its air


def moving_gap_paths(search: BodySearch, others: tuple[PathFamily, ...]) -> Chain:
    """Find every path over two edges with air between of which an edge or a mirror belongs to a body.

    others: paths over fewer edges, and over two of the room: where one of these is taken over from, its time is taken.
    """
    finder, scene = _GapFinder(search), search.scene
    held = finder.every_path()
    own: dict[str, Any] = {name: held[name] for name in COLUMNS}
    alike: dict[str, Any] = {"lines": finder.lines, "model": "utd"}
    last = EdgeVertex(**(own | {"edge": held["last_edge"], "lit": held["last_lit"]}), **alike)
    more = {name: held[name] for name in ("shared", "between", "budget")}
    vertex = GapPairVertex(**own, **alike, last=last, **more, seen=np.zeros((len(held["edge"]), 4, 3)))
    return tied(moving_paths(scene, search.obstacles.mirrors, held, ("before", "after"), vertex), others)


class _GapFinder(EdgePairFinder):
    """Looks for paths over two edges with air between, from each source to each receiver."""

    on_faces: ClassVar[bool] = False

    def __init__(self, search: BodySearch) -> None:
        super().__init__(search)
        self._hidden = self._find_hidden()

    def _look(self, pair: PairQuery, chains: Any) -> Callable[[Rows, Floats], Any]:
        return _GapLook(self._search, self._faces, pair, chains)

    def _chains(self, source: int, receiver: int, span: Span) -> GapPairs:
        sides = self._reached(source, None, span), self._reached(source, receiver, span)
        none = np.empty((0, self.width), np.int32)
        parts: list[Any] = [(none, none, *(np.empty(0, np.int64),) * 3, np.empty((0, 2), np.int64), none)]
        for one, other, walls in self._gaps(source, span):
            met, at_rest = int(np.sum(walls >= 0)), self._all_rest(one, other, walls)
            before, after = self._met(sides, (one, other), self._order - met, at_rest)
            edges = (np.full(len(before), x) for x in (one, -1, other))
            shared = np.full((len(before), 2), ACROSS_AIR)
            parts.append((before, after, *edges, shared, np.tile(walls, (len(before), 1))))
        return GapPairs(*(np.concatenate([part[i] for part in parts]) for i in range(7)))

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

    def _columns(self, ends: tuple[int, int], chains: Any, heard: tuple[Floats, Floats], code: Any) -> dict[str, Any]:
        columns = EdgePairFinder._columns(self, ends, chains, heard, code)
        met = columns["order"] - 2
        return columns | {"between": chains.between, "budget": self._order - met.astype(np.int64)}

    def met_between(self, chains: GapPairs) -> Any:
        """Numbers (n,) of mirrors between both edges."""
        return np.sum(chains.between >= 0, axis=1)


@dataclass(frozen=True, slots=True, eq=False)
class _GapLook(PairLook):
    """How paths over two edges with air between are at some times, see `PairLook`."""

    solver: ClassVar[type[GapPairSolver]] = GapPairSolver

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
