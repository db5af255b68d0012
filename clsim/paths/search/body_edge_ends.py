"""Every path over an edge and a free end of another one, or over ends of both, of bodies or by these."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields, replace
from functools import cache
from typing import Any, ClassVar

import numpy as np

from clsim.acoustics.diffraction import ON_LINE, path_over_edge
from clsim.arrays import Bools, Floats, Rows
from clsim.paths.chain import Chain
from clsim.paths.family import PathFamily
from clsim.paths.legs.mirrors import dot
from clsim.paths.search.bodies import BodySearch, PairQuery
from clsim.paths.search.body_edge_pairs import GapEvaluation, GapFinder, Route, Span, moving_pairs, on_edges
from clsim.paths.search.edge_ends import over_faces
from clsim.paths.search.edge_gaps import in_air
from clsim.paths.search.edge_levels import least_level, loud, lowest_wave
from clsim.paths.search.mesh import visibility_query
from clsim.paths.vertices import edge_events
from clsim.paths.vertices.edge_end import EdgeEndVertex
from clsim.paths.vertices.edge_pair import ACROSS_AIR
from clsim.paths.visibility.edge_ends import levels_over_ends
from clsim.paths.visibility.intervals import VisibilityQuery
from clsim.paths.visibility.subdivision import ROUNDS

_TIMES = 9, 33  # times of a stretch at which levels are estimated, fewest and most
_EVERY = 4  # of the times at which paths are searched, for which there is one of these
_SPARE = 0.05  # of the least level, from which on paths are looked for: between these times they may be louder
_ON_FACE = 1e-6  # m by which ends may be off the faces that they end at


def moving_end_paths(search: BodySearch, others: tuple[PathFamily, ...]) -> Chain:
    """Find every path over an edge and an end of another one of which an edge or a mirror belongs to a body."""
    return moving_pairs(_EndFinder(search), EdgeEndVertex, search, others)


class _EndFinder(GapFinder):
    """Looks for paths over an edge and an end of another one, from each source to each receiver."""

    def __init__(self, search: BodySearch) -> None:
        super().__init__(search)
        self._direct = search.search.direct is not False
        self._wave, self._pair, self._query = lowest_wave(search.scene), search.pair, cache(self._find_query)
        self._over_faces = list(self._find_over_faces())

    def _find_query(self, source: int) -> VisibilityQuery:
        """Query as `EdgePaths` has it, up to whose end levels are estimated."""
        search, scene = self._search.search, self._search.scene
        order, source_of = search.max_order + 1, scene.sources[source]
        return visibility_query(scene, self._search.room, source_of, order, search.resolution)[0]

    def _find_over_faces(self) -> Iterator[Route]:
        """Yield routes over faces that edges of one object share."""
        first, none = 0, np.full(self.width, -1, np.int32)
        meshes = self._search.room, *(body.mesh for body in self.lines.bodies)
        for mesh, edges in zip(meshes, self.lines.parts, strict=True):
            found = over_faces(mesh.walls, edges, 0)
            pairs = (found.edge + first).tolist()
            for (one, other), end, face in zip(pairs, found.end.tolist(), found.face, strict=True):
                yield one, other, none, end, face
            first += len(edges)

    def _routes(self, source: int, span: Span) -> Iterator[Route]:
        yield from self._over_faces
        free = self.lines.free.tolist()
        for one, other, walls, _, face in GapFinder._routes(self, source, span):
            for end in range(2 * edge_events.OF_LAST):
                if free[other if end >= edge_events.OF_LAST else one][end % edge_events.OF_LAST]:
                    yield one, other, walls, end, face

    def _evaluate(self, pair: PairQuery, chains: Any) -> Callable[[Rows, Floats], Any]:
        return _EndEvaluation(self._search, self._faces, pair, chains)

    def _chains(self, source: int, receiver: int, span: Span) -> edge_events.GapPairs:
        """Objects that paths may meet within an interval of time, but where these stay below the least level."""
        pairs, pair = GapFinder._chains(self, source, receiver, span), self._pair(source, receiver)
        inner = int(np.sum((pair.times > span[0]) & (pair.times < span[1])))
        times = np.tile(np.linspace(*span, int(np.clip(inner // _EVERY, *_TIMES))), (len(pairs.edge), 1))
        levels = _EndEvaluation(self._search, self._faces, pair, pairs).levels(times, self._wave, self._direct)
        return pairs.part(np.flatnonzero(levels.max(axis=1, initial=0.0) > _SPARE * least_level(self._direct)))

    def _columns(
        self, ends: tuple[int, int], chains: Any, received: tuple[Floats, Floats], code: Any
    ) -> dict[str, Any]:
        """Columns of paths but those that stay below the least level all the while they are there, as in rooms."""
        columns, pair, query = GapFinder._columns(self, ends, chains, received, code), self._pair(*ends), self._query
        span = np.maximum(received[0], 0.0), np.minimum(received[1], float(query(ends[0]).last[ends[1]]))

        def levels(some: Rows, times: Floats) -> Floats:
            evaluation = _EndEvaluation(self._search, self._faces, pair, chains.part(some))
            return evaluation.levels(times, self._wave, self._direct)

        tables = query(ends[0]).trajectory_tables
        moved = tables.scales[0, 2] + tables.scales[1 + ends[1], 2]
        speed = moved + 2.0 * max((body.peak_speed for body in self.lines.bodies), default=0.0)
        keys = np.column_stack([getattr(chains, f.name) for f in fields(chains) if f.name != "end"])
        speeds = np.full(len(code), speed)
        kept = loud(levels, span, speeds, least_level(self._direct), (chains.end, keys)) if len(code) else code[:0]
        return {name: column[kept] for name, column in columns.items()}


@dataclass(frozen=True, slots=True, eq=False)
class _EndEvaluation(GapEvaluation):
    """How paths over an edge and an end of another one are at some times, see `PairEvaluation`."""

    solver: ClassVar[type[edge_events.EdgeEndSolver]] = edge_events.EdgeEndSolver

    def levels(self, times: Floats, wave: float, direct: bool) -> Floats:
        """Estimate the pressure (P, T) of paths at times of reception (P, T), s, see `end_levels`."""
        levels = np.zeros(times.shape)
        rows, when = np.nonzero(self.possible(self.pairs, times))
        if not len(rows):
            return levels
        pairs, lines = self.pairs.part(rows), self.faces.lines
        mirrors = self.search.obstacles.mirrors
        solver = self.solver(mirrors, lines, self.pair.ends, self.pair.medium, rounds=ROUNDS)
        now, longer, both = (
            times[rows, when],
            np.full(len(rows), np.nan),
            np.flatnonzero(pairs.end >= edge_events.TWO_ENDS),
        )
        longer[both] = _lengths(solver.find(pairs.part(both), now[both, None]))[:, 0]
        end = pairs.end
        pairs = replace(pairs, end=np.where(end >= edge_events.TWO_ENDS, end % edge_events.MEETING, end))
        events: Any = solver.find(pairs, now[:, None])
        ahead, back, between, _, *slopes = np.moveaxis(events.middle[:, 0], 1, 0)
        (r_s, t_s, z_s), (r_r, t_r, z_r) = ([x[:, 0] for x in end] for end in (events.source, events.receiver))
        on_face = pairs.face[:, 0] != ACROSS_AIR
        turned = np.where(on_face[:, None], np.pi * pairs.face * lines.n[np.stack([pairs.edge, pairs.last], 1)], 0.0)
        ahead, back = np.where(on_face, turned[:, 0], ahead), np.where(on_face, turned[:, 1], back)
        z_s, z_r = z_s - events.along[:, 0, 0], z_r - events.along[:, 1, 0]
        meeting, last = edge_events.at_meeting(pairs.end), pairs.end >= edge_events.OF_LAST
        whole = self._rolled_out(solver, pairs, events).length[:, 0]
        emission = now - (events.first.delay + events.last.delay)[:, 0]
        source, receiver = (end.position(t) for end, t in zip(self.pair.ends, (emission, now), strict=True))
        apart = np.linalg.norm(source - receiver, axis=-1)
        for some, slope in ((meeting, None), (~meeting, np.where(last, slopes[1], slopes[0]))):
            k = np.flatnonzero(some)
            angles = (t_s[k], ahead[k]), (back[k], t_r[k])
            ends = (r_s[k], r_r[k]), (z_s[k], z_r[k])
            middle = between[k], None if slope is None else slope[k]
            n = lines.n[pairs.edge[k]], lines.n[pairs.last[k]]
            lengths, free = (whole[k], longer[k]), apart[k] if direct else None
            levels[rows[k], when[k]] = levels_over_ends(n, angles, ends, middle, lengths, last[k], wave, free)
        return levels

    def _rolled_out(self, solver: Any, pairs: Any, events: Any) -> Any:
        """Paths over the first edges to what is beyond the last ones, rolled out, of pairs of one face."""
        (r_s, _, z_s), (r, z) = events.source, solver.ahead(pairs, events)[0]
        return path_over_edge(r_s, z_s, np.maximum(r, ON_LINE), z)

    def may_pass(self, pairs: Any, times: Floats, seen: Any, slack: Floats) -> Bools:
        held, lines = (
            edge_events.held_places(pairs.end, self.faces.lines.length[np.stack([pairs.edge, pairs.last], 1)]),
            self.faces.lines,
        )
        possible, on_face = np.ones(times.shape, dtype=bool), pairs.face[:, 0] != ACROSS_AIR
        slack = slack + np.where(on_face, _ON_FACE * self.search.room.walls.size, 0.0)[:, None]
        for i, (edge, own, near, across) in enumerate(seen):
            axes, n = lines.axes(edge, times), lines.n[edge][:, None]
            x, y = (dot(near[:, :, 0] - own[:, :, 0], axis) for axis in axes[:2])
            possible &= in_air(n, x, y, -slack)
            met = held[:, 1 - i]  # of the other edge, of which this one sees but the end that is met
            end = np.where(np.isnan(met) | (met > 0.0), 1, 0)[:, None, None, None]
            there = np.where(end == 1, across[:, :, -1:], across[:, :, :1])
            free = np.flatnonzero(np.isnan(held[:, i]))
            possible[free] &= self.alike(edge[free], times[free], own[free], (near[free], there[free]), slack[free])
        return possible

    def ended(self, solver: Any, pairs: Any, events: Any, p: Rows, t: Rows) -> tuple[Any, Any]:
        """Masks of edges (n, 2) that end, and of paths (n,) whose shortest ways over both edges meet those."""
        number, middle = pairs.end[p], events.middle[p, t]
        meeting, both = edge_events.at_meeting(number), number >= edge_events.TWO_ENDS
        last = (number % edge_events.MEETING >= edge_events.OF_LAST) & ~meeting
        (r_s, z_s), (r_r, z_r) = ((r[p, t], z[p, t]) for r, _, z in (events.source, events.receiver))
        along = events.along[p, :, t]
        r, z = np.where(last, r_r, r_s), np.where(last, z_r - along[:, 1], z_s - along[:, 0])
        slope = -z / np.hypot(r, z) - np.where(last, middle[:, 5], middle[:, 4])
        apex = self._rolled_out(solver, pairs, events).apex[p, t]
        length = self.faces.lines.length[np.where(last, pairs.last[p], pairs.edge[p])]
        slope = np.where(meeting, np.where(number % 2 == 1, length - apex, -apex), slope)
        inside = np.where(number % 2 == 1, slope, -slope)
        near = np.where(last, r_s, r_r), np.where(last, z_s, z_r)
        inside[both] = self._over_both(pairs.part(p[both]), (near[0][both], near[1][both]))
        return np.stack([~last & ~meeting, last], axis=1), inside >= 0.0

    def _over_both(self, pairs: Any, near: tuple[Floats, Floats]) -> Floats:
        """How far (n,) paths over one end are inside the other edge's end, m, to endpoints at r and z about that."""
        lines, last, edges = (
            self.faces.lines,
            pairs.end % edge_events.MEETING >= edge_events.OF_LAST,
            np.stack([pairs.edge, pairs.last]),
        )
        held = edge_events.held_places(pairs.end, lines.length[edges.T]).T
        mine, theirs = np.where(last, edges[::-1], edges)
        along, end = np.where(last, held[::-1], held)
        own, other = lines.frames[mine], lines.frames[theirs]
        away = own[:, 0] + along[:, None] * own[:, 3] - other[:, 0]
        x, y, z = np.einsum("nai,ni->an", other[:, 1:], away)
        apex = path_over_edge(np.hypot(x, y), z, *near).apex
        return np.asarray(np.where(end == 0.0, apex, end - apex))

    def free(self, pairs: Any, events: Any, p: Rows, t: Rows) -> Bools:
        """Mask (n,) of some paths at times (n,) of which the way between both edges is free."""
        free, air = np.ones(len(p), dtype=bool), pairs.face[p, 0] == ACROSS_AIR
        there, along = np.flatnonzero(air), np.flatnonzero(~air & ~edge_events.at_meeting(pairs.end[p]))
        free[there] = GapEvaluation.free(self, pairs, events, p[there], t[there])
        free[along] = self.faces.free(pairs.part(p[along]), events.along[p[along], :, t[along]])
        return free

    def between(self, pairs: Any, events: Any, p: Rows, t: Rows) -> tuple[Floats, Floats]:
        """Angles (n,) of the way between about both edges."""
        air, lines = pairs.face[p, 0] == ACROSS_AIR, self.faces.lines
        turned = np.pi * pairs.face[p] * lines.n[np.stack([pairs.edge[p], pairs.last[p]], axis=1)]
        ahead, back = np.where(air[:, None], events.middle[p, t, :2], turned).T
        return ahead, back

    def on(self, solver: Any, pairs: Any, events: Any) -> Bools:
        """Mask (P, T) of paths that meet both edges from the air, of which each is in the air of the other."""
        on, across = GapEvaluation.on(self, solver, pairs, events), pairs.face[:, 0] == ACROSS_AIR
        on = np.where(across[:, None], on, on_edges(solver, pairs, events))
        for r, _ in solver.ahead(pairs, events):
            on &= ~edge_events.at_meeting(pairs.end)[:, None] | (r > 0.0)
        return np.asarray(on)


def _lengths(events: Any) -> Floats:
    """Lengths (P, T) of paths over two edges at rest, m."""
    ends = ((end[0], end[2] - events.along[:, i]) for i, end in enumerate((events.source, events.receiver)))
    return np.asarray(events.middle[..., 2] + sum(np.hypot(*end) for end in ends))
