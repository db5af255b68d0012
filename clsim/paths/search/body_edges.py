"""Every path over one edge of a body, or over one of the room by bodies: sequences, and when each is heard."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from functools import cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.acoustics.diffraction import EVEN, TERMS, adjacent_reflections, lit_angles, path_over_edge
from clsim.arrays import Floats, Rows, read_only
from clsim.errors import InputError
from clsim.paths.chain import Chain
from clsim.paths.family import PairPaths, PathFamily
from clsim.paths.legs.events import Events
from clsim.paths.legs.legs import moving_paths
from clsim.paths.legs.mirrors import ROOM, EdgeLines
from clsim.paths.response import RETARDED
from clsim.paths.search.beam_tree import BeamTree
from clsim.paths.search.bodies import BodySearch, PairQuery
from clsim.paths.search.mesh import BEAM_LIMIT
from clsim.paths.search.same_events import SAME_DELAY
from clsim.paths.vertices.edge import COLUMNS, EdgeVertex
from clsim.paths.vertices.edge_events import Chains, EdgeEvents, EdgeSolver
from clsim.paths.visibility.edge_intervals import joined_over_ends
from clsim.paths.visibility.intervals import BoundingSpheres, joined
from clsim.paths.visibility.subdivision import ROUNDS, coded

Codes = NDArray[np.signedinteger[Any]]

_ON = 1e-7  # of the room's size; what is nearer to a plane is in it
_INNER = 1e-9  # share of a way between two hits, from which on the one is not at the other
_WITHIN = 1e-4  # s between two times at which the same event was found, at most
ABSENT = -1  # code of a path that is not there; else bits for the sides of its terms, of its end, and of both ends
END, HALVES = 1 << TERMS, (2 << TERMS, 4 << TERMS)


def moving_edge_paths(search: BodySearch, others: tuple[PathFamily, ...]) -> Chain:
    """Return every path over one edge of which the edge or a mirror belongs to a body."""
    finder, scene = EdgeFinder(search), search.scene
    held = finder.every_path()
    own: dict[str, Any] = {name: held[name] for name in COLUMNS}
    vertex = EdgeVertex(**own, lines=finder.lines, model=search.search.diffraction_model)
    return tied(moving_paths(scene, search.obstacles.mirrors, held, ("before", "after"), vertex), others)


class EdgeFinder:
    """Looks for paths over edges, from each source to each receiver."""

    def __init__(self, search: BodySearch) -> None:
        self._search, self.lines = search, EdgeLines.of(search.scene.room, search.scene.bodies)
        self._mirrors, self._order = search.obstacles.mirrors, search.order
        # Mirrors (E, W) that hold edges whatever moves: those of the same object.
        frames, mirrors = self.lines.frames, self._mirrors
        ends = np.stack([frames[:, 0], frames[:, 0] + self.lines.length[:, None] * frames[:, 3]], axis=1)
        height = np.abs(ends @ mirrors.normal.T - mirrors.offset).max(axis=1)
        self._held = (height <= _ON * search.room.walls.size) & (self.lines.owner[:, None] == mirrors.owner)
        self._reached = cache(self._find_reached)

    def every_path(self) -> dict[str, Any]:
        """Columns of the paths of all sources and receivers."""
        scene, limit = self._search.scene, self._search.search.path_limit
        found = [self._paths(s, r) for s in range(len(scene.sources)) for r in range(len(scene.receivers))]
        columns: dict[str, Any] = {name: np.concatenate([each[name] for each in found]) for name in found[0]}
        if len(columns["edge"]) > limit:
            raise InputError("body_order", f"must give at most {limit} paths over edges (path_limit), but gives more")
        return {name: read_only(column) for name, column in columns.items()}

    def _paths(self, source: int, receiver: int) -> dict[str, Any]:
        """Columns of the paths between a source and a receiver."""
        pair = self._search.pair(source, receiver)
        chains, evaluations, count = [], [], 0
        for span, met in self._search.cells(pair.times[-1], partial(self._chains, source, receiver)):
            chains.append(met)
            rows = count + np.arange(len(chains[-1].edge))
            inner = pair.times[(pair.times > span[0]) & (pair.times < span[1])]
            evaluations.append((rows, np.unique([span[0], *inner, span[1]])))
            count += len(rows)
        kind = type(chains[0])
        every = kind(*(np.concatenate([getattr(c, f.name) for c in chains]) for f in fields(kind)))
        row, begin, end, code = coded(self._evaluate(pair, every), evaluations, pair.resolution)
        met, begin, end, code = _joined(every.part(row), begin, end, code)
        begin, end = pair.bounded(begin, end)
        return self._columns((source, receiver), met, (begin, end), code)

    def _evaluate(self, pair: PairQuery, chains: Chains) -> Callable[[Rows, Floats], Codes]:
        return partial(self._codes, pair, chains)

    def _codes(self, pair: PairQuery, every: Chains, rows: Rows, times: Floats) -> Codes:
        """Codes (P, T) of paths of a pair at some times: `ABSENT`, or bits for the terms and ends that are seen."""
        solver = EdgeSolver(self._mirrors, self.lines, pair.ends, pair.medium, rounds=ROUNDS)
        chains = every.part(rows)
        events = solver.find(chains, times)
        length, n, end = self.lines.length[chains.edge], self.lines.n[chains.edge], chains.end
        (r_s, t_s, z_s), (r_r, t_r, z_r) = events.source, events.receiver
        on = (end >= 0)[:, None] | (events.along > 0.0) & (events.along < length[:, None])
        for angle in (t_s, t_r):
            on &= (angle > 0.0) & (angle < np.pi * n[:, None])
        p, t = free_legs(self._search, chains, events, times, on)
        code = np.full(times.shape, ABSENT, dtype=np.int8)
        seen = lit_angles(n[p], t_s[p, t], t_r[p, t]) >= 0.0
        apex = path_over_edge(r_s[p, t], z_s[p, t], r_r[p, t], z_r[p, t]).apex
        met = np.sum(chains.before >= 0, axis=1) + np.sum(chains.after >= 0, axis=1)
        seen &= met[p, None] + adjacent_reflections(n[p]) <= self._order
        inside = (end[p] >= 0) & (np.where(end[p] == 1, -apex, apex) >= 0.0)
        code[p, t] = seen @ (1 << np.arange(TERMS)) + END * inside + halves((n[p], n[p]), (t_s[p, t], t_r[p, t]))
        return code

    def _columns(
        self, ends: tuple[int, int], chains: Any, received: tuple[Floats, Floats], code: Codes
    ) -> dict[str, Any]:
        return _with_joined_ends(self._own_columns(ends, chains, received, code))

    def _own_columns(
        self, ends: tuple[int, int], chains: Any, received: tuple[Floats, Floats], code: Codes
    ) -> dict[str, Any]:
        """Columns of paths over one edge, as they are looked for."""
        count, met = len(code), np.sum(chains.before >= 0, axis=1) + np.sum(chains.after >= 0, axis=1)
        lit = np.where(code[:, None] & (1 << np.arange(TERMS)), 1, -1)
        lit[met[:, None] + adjacent_reflections(self.lines.n[chains.edge]) > self._order] = 0
        side = np.where(chains.end < 0, 0, np.where(code & END, 1, -1))
        return {
            "source": np.full(count, ends[0], dtype=np.int32), "receiver": np.full(count, ends[1], dtype=np.int32),
            "order": (met + 1).astype(np.int32), "start": received[0], "end": received[1], "before": chains.before,
            "after": chains.after, "edge": chains.edge, "over_end": chains.end.astype(np.int8),
            "lit": lit.astype(np.int8), "end_side": side.astype(np.int8),
            "beside": np.column_stack([np.where(code & bit, 1, -1) for bit in HALVES]).astype(np.int8),
            "corner": np.full(count, EVEN),
        }  # fmt: skip

    def _chains(self, source: int, receiver: int, span: tuple[float, float]) -> Chains:
        """Objects that paths may meet within an interval of time."""
        sides = self._reached(source, None, span), self._reached(source, receiver, span)
        parts = [(np.empty((0, self.width), np.int32),) * 2 + (np.empty(0, np.int64),) * 2]
        fewest = adjacent_reflections(self.lines.n).min(axis=1)
        for edge in range(len(self.lines)):
            before, after = self._met(sides, (edge, edge), self._order - fewest[edge])
            for end in (-1, *np.flatnonzero(self.lines.free[edge]).tolist()):
                parts.append((before, after, np.full(len(before), edge), np.full(len(before), end)))
        return Chains(*(np.concatenate([part[i] for part in parts]) for i in range(4)))

    def _met(
        self, sides: tuple[Any, Any], edges: tuple[int, int], most: int, at_rest: bool | None = None
    ) -> tuple[Any, Any]:
        """Mirrors (n, order) before the first and after the last of some edges, not more than `most` together."""
        before, after = sides[0][edges[0]], sides[1][edges[1]]
        i, j = np.divmod(np.arange(len(before) * len(after)), max(len(after), 1))
        both = np.concatenate([before[i], after[j]], axis=1)
        kept = np.sum(both >= 0, axis=1) <= most
        if self.lines.owner[edges[0]] == ROOM if at_rest is None else at_rest:
            kept &= np.any(np.append(self._mirrors.owner, ROOM)[both] >= 0, axis=1)
        before, after = np.hsplit(both[kept], 2)
        return before, after

    @property
    def width(self) -> int:
        """Columns of mirrors."""
        return max(self._order, 1)

    def _find_reached(self, source: int, receiver: int | None, span: tuple[float, float]) -> list[NDArray[np.int32]]:
        """Return for each edge the mirrors (n, order) by which one end may reach it, both from the source's side."""
        (query, longest), (begin, end) = self._search.queries[source], span
        row, first = (0, begin - longest) if receiver is None else (1 + receiver, begin - longest)
        given = self._beams(source, query.trajectory_tables.sphere(row, first, end), span)
        return [self._padded(edge, met, receiver is not None) for edge, met in enumerate(given)]

    def _beams(
        self, source: int, ball: tuple[Floats, float], span: tuple[float, float]
    ) -> list[list[NDArray[np.int32]]]:
        """Return for each edge the mirrors (n, N) by which it may be reached from a ball, by their number."""
        (_, longest), (begin, end) = self._search.queries[source], span
        times = np.linspace(begin - longest, end, 9)
        middle = 0.5 * (begin - longest + end)
        slack = 2.0 * (self._order + 1) * self._search.moved(middle, times)
        walls = self._search.posed(middle)
        # What bodies hide in this pose they may not hide in the next: as for `BodySearch`, nothing is.
        spheres = BoundingSpheres(self._middles(middle), 0.5 * self.lines.length + slack)
        tree = BeamTree(walls, ball[0], ball[1] + slack, spheres, BEAM_LIMIT, hides=False)
        found: list[list[Any]] = [[] for _ in range(len(self.lines))]
        for batch in tree.candidates(self._order):
            for edge in np.unique(batch.receiver).tolist():
                found[edge].append(batch.sequence[batch.row[batch.receiver == edge]])
        return found

    def _middles(self, time: float) -> Floats:
        """Middles of all edges (E, 3) at a time, m."""
        everyone, at_rest = np.arange(len(self.lines)), np.full((len(self.lines), 1), time)
        return self.lines.placed(everyone, 0.5 * self.lines.length[:, None], at_rest)[:, 0]

    def _padded(self, edge: int, parts: list[NDArray[np.int32]], backwards: bool) -> NDArray[np.int32]:
        """Return sequences (n, order) but those that meet a mirror at the edge, turned round if they are backwards."""
        padded = [np.empty((0, self.width), dtype=np.int32)]
        for given in parts:
            some = given[~self._held[edge][given[:, -1]]] if given.shape[1] else given
            found = np.full((len(some), self.width), -1, dtype=np.int32)
            found[:, : given.shape[1]] = some[:, ::-1] if backwards else some
            padded.append(found)
        return np.concatenate(padded)


def halves(n: tuple[Floats, Floats], angles: tuple[Floats, Floats]) -> Any:
    """Bits of codes (n,) of both ends' angles about wedges, whose air is from 0 to nπ."""
    return sum(bit * (angle > 0.5 * np.pi * wedge) for bit, wedge, angle in zip(HALVES, n, angles, strict=True))


def free_legs(search: BodySearch, chains: Chains, events: EdgeEvents, times: Floats, on: Any) -> tuple[Rows, Rows]:
    """Paths (n,) and times (n,) of those among `on` (P, T) of which both legs are free."""
    p, t = np.nonzero(on)
    for mirrors, legs, when in ((chains.before, events.first, events.time), (chains.after, events.last, times)):
        there = leg_is_free(search, mirrors[p], legs, when, p, t)
        p, t = p[there], t[there]
    return p, t


def leg_is_free(search: BodySearch, mirrors: NDArray[np.int32], legs: Events, when: Floats, p: Rows, t: Rows) -> Any:
    """Mask (n,) of some paths at times (n,) that meet their mirrors (n, N) and are free of obstacles."""
    some = type(legs)(*(getattr(legs, f.name)[p, t][:, None] for f in fields(legs)))
    there = search.obstacles.there(mirrors, some, when[p, t][:, None])[:, 0]
    share = some.share[:, 0]
    return there & np.all((mirrors < 0) | (share > _INNER) & (share < 1.0 - _INNER), axis=1)


def _with_joined_ends(columns: dict[str, Any]) -> dict[str, Any]:
    """Join the rows over ends of edges, see `joined_over_ends`, in sorted columns."""
    keys = np.column_stack([columns[name] for name in ("edge", "over_end", "before", "after")])
    path = np.cumsum(np.append(True, np.any(keys[1:] != keys[:-1], axis=1))[: len(keys)])
    over = columns["over_end"] >= 0
    some, others = np.flatnonzero(over), np.flatnonzero(~over)
    pieces = path[some], *(columns[name][some] for name in ("start", "end", "lit", "end_side", "beside"))
    kept, *changed = joined_over_ends(*pieces)
    rows = np.concatenate([others, some[kept]])
    found = {name: column[rows] for name, column in columns.items()}
    for name, column in zip(("start", "end", "lit"), changed, strict=True):
        found[name] = np.concatenate([columns[name][others], column])
    rank = np.lexsort((found["start"], path[rows]))
    return {name: column[rank] for name, column in found.items()}


def _joined(chains: Chains, begin: Floats, end: Floats, code: Codes) -> tuple[Chains, Floats, Floats, Codes]:
    """Sort paths by order, edges, mirrors and time, and join what goes on from one stretch of time to the next."""
    met = np.sum(chains.before >= 0, axis=1) + np.sum(chains.after >= 0, axis=1)
    edges = [getattr(chains, f.name) for f in fields(chains)[2:]]
    keys = np.column_stack([met, *edges, chains.before, chains.after])
    first, last = joined(list(keys.T), begin, end, code)
    return chains.part(first), begin[first], end[last], code[first]


def tied(family: Chain, others: Sequence[PathFamily]) -> Chain:
    """Return the paths with the times at which others begin or end where that is the same event."""
    start, end = np.array(family.start), np.array(family.end)
    known: dict[tuple[int, int], list[PairPaths]] = {}
    for other in others:
        for pair in other.pairs():
            known.setdefault((pair.source, pair.receiver), []).append(pair)
    for pair in family.pairs():
        rows = pair.index
        mine = np.concatenate([start[rows], end[rows]])
        which = np.flatnonzero(np.isfinite(mine))
        if not len(which):
            continue
        at, owner = mine[which], np.concatenate([rows, rows])[which]
        near = _events_near(known.get((pair.source, pair.receiver), []), at)
        links: Any = family.links(owner)
        first = links.events(at[:, None], RETARDED)
        delay = (first.first.delay + first.last.delay)[:, 0]
        mine[which] = _converged(at, delay, near)
        start[rows], end[rows] = mine[: len(rows)], mine[len(rows) :]
    family = replace(family, start=read_only(start), end=read_only(end))
    kept = np.flatnonzero(start < end)
    return family if len(kept) == len(start) else family.part(kept)


def _converged(times: Floats, delay: Floats, others: tuple[Floats, Floats, Floats]) -> Floats:
    """Return the times (n,) at which other paths of the delays (n,) begin or end, or the first of the same event."""
    found, order = np.array(times), np.argsort(times, kind="stable")
    theirs, their_delay, their_rate = others
    for place, i in enumerate(order.tolist()):
        near = slice(*np.searchsorted(theirs, (times[i] - _WITHIN, times[i] + _WITHIN)).tolist())
        apart = their_delay[near] + their_rate[near] * (times[i] - theirs[near]) - delay[i]
        same = theirs[near][np.abs(apart) < SAME_DELAY]
        if len(same):
            found[i] = same[np.argmin(np.abs(same - times[i]))]
            continue
        before = order[:place][::-1]
        before = before[: int(np.searchsorted(times[i] - times[before], _WITHIN))]
        mine = before[np.abs(delay[before] - delay[i]) < SAME_DELAY]
        found[i] = found[mine[0]] if len(mine) else times[i]
    return found


def _events_near(pairs: Sequence[PairPaths], near: Floats) -> tuple[Floats, Floats, Floats]:
    """Return when paths begin and end near given times, in order, and their delays and the rates of these, (n,)."""
    found, near = [np.empty((3, 0))], np.sort(near)
    for pair in pairs:
        index = pair.index
        bounds = np.concatenate([pair.family.start[index], pair.family.end[index]])
        rows = np.concatenate([index, index])
        place = np.searchsorted(near, bounds - _WITHIN)
        close = np.isfinite(bounds) & (np.append(near, np.inf)[place] <= bounds + _WITHIN)
        for time in np.unique(bounds[close]):
            here = rows[close & (bounds == time)]
            arrivals = pair.family.arrivals(here, np.array([time]))
            found.append(np.stack([np.full(len(here), time), arrivals.delay[:, 0], arrivals.delay_rate[:, 0]]))
    times, delay, rate = np.concatenate(found, axis=1)
    order = np.argsort(times, kind="stable")
    return times[order], delay[order], rate[order]
