"""Every path over one edge of the room and by one scatterer, in either order."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from clsim.arrays import Floats, Rows, read_only
from clsim.errors import InputError
from clsim.paths.chain import Chain, check_support
from clsim.paths.family import NONE, SCATTERING, SPECULAR
from clsim.paths.legs.legs import StaticLeg
from clsim.paths.search.scatterers import Side, at_receivers, received_after
from clsim.paths.vertices.edge_scatterer import EdgeBeside, EdgeScattererVertex
from clsim.scene.scatterer import Scatterer
from clsim.scene.scene import Scene

_WIDE = 0.5  # of the least distance from scatterers: half the harmonic mean of two of them
_STEPS, _FOUND = 100, 1e-13  # of a travel time, and s
_TOGETHER = 16  # paths at as many times of which the diagonal is used


def edge_scatterer_paths(
    scene: Scene, sides: tuple[Side, Side], over_edges: tuple[Chain, Chain], both: bool, limit: int
) -> list[Chain]:
    """Find the paths that meet the edge first, those that meet the scatterer first, and those between two edges."""
    check_support("static edge scatterer", scene.air)
    plain = _Half.straight(sides[0], True), _Half.straight(sides[1], False)
    bent = _Half.over(over_edges[0], True), _Half.over(over_edges[1], False)
    kinds = [(bent[0], plain[1]), (plain[0], bent[1]), *([bent] if both else [])]
    found = []
    for halves in kinds:
        found.append(_chain(scene, halves, limit))
        limit -= len(found[-1])
    return found


def as_met(chains: list[Any]) -> list[Chain]:
    """Make paths by scatterers begin and end as those are met where their centres come out of a shadow or go into it.

    Surfaces are met earlier than centres would be, by up to some 0.1 ms for things of 5 cm, in which they move on. The
    path that takes over is the same where both are on the boundary: what was one time for several paths stays one.
    """
    known: dict[tuple[float, ...], float] = {}
    return [_as_met(chain, known) for chain in chains]


def _as_met(chain: Chain, known: dict[tuple[float, ...], float]) -> Chain:
    """Make paths of one kind do so; `known` has the times by source, receiver, scatterer and time of the centre."""
    vertex, bounds = chain.vertex, {name: np.array(getattr(chain, name)) for name in ("start", "end")}
    points = tuple(Scatterer.point(s.name, 0.0, s.trajectory) for s in vertex.scatterers)
    centres = replace(chain, vertex=replace(vertex, scatterers=points))
    columns = chain.source, chain.receiver, vertex.scatterer
    for times in bounds.values():
        keys = list(zip(*(column.tolist() for column in (*columns, times)), strict=True))
        requested = np.isfinite(times) & (vertex.radius > 0.0)
        new = {keys[row]: row for row in np.flatnonzero(requested).tolist() if keys[row] not in known}
        first = np.array(list(new.values()), dtype=np.int64)
        for pair in chain.pairs():
            mine = np.intersect1d(first, pair.index)
            for rows in np.array_split(mine, -(-len(mine) // _TOGETHER) or 1):
                found = _met(chain, centres, rows, times[rows]).tolist()
                known.update({keys[row]: time for row, time in zip(rows.tolist(), found, strict=True)})
        for row in np.flatnonzero(requested).tolist():
            times[row] = known[keys[row]]
    kept = np.flatnonzero(bounds["start"] < bounds["end"])
    moved: Any = {name: read_only(times) for name, times in bounds.items()}
    return replace(chain, **moved).part(kept)


def _met(chain: Chain, centres: Chain, rows: Rows, times: Floats) -> Floats:
    """Find when (n,) scatterers are heard that were met as the centres were that are heard at times (n,), s."""
    met, found = _event_times(centres, rows, times), times
    for _ in range(_STEPS):  # each by the Mach number of the scatterer
        step = met - _event_times(chain, rows, found)
        found = found + step
        if np.abs(step).max(initial=0.0) <= _FOUND:
            break
    return found


def _event_times(chain: Chain, rows: Rows, times: Floats) -> Floats:
    """Find when (n,) scatterers are met on paths that are received at times (n,), s."""
    if not len(rows):
        return times
    return np.array(np.diagonal(chain.arrivals(rows, times).more["event_time"]))


@dataclass(frozen=True, slots=True, eq=False)
class _Half:
    """Paths between ends and scatterers, n of them, before these or after them."""

    chain: Any  # `Side` or `Chain` with columns source, receiver, start, end
    kinds: Any  # (n, N) interactions
    objects: Any  # likewise
    leg: StaticLeg  # of the end, as what is next to it sees it
    edge: EdgeBeside | None

    @staticmethod
    def straight(side: Side, first: bool) -> _Half:
        """Take those by walls alone."""
        assert side.leg is not None
        leg = side.leg if first else at_receivers(side.leg)
        return _Half(side, np.where(side.surfaces >= 0, SPECULAR, NONE), side.surfaces, leg, None)

    @staticmethod
    def over(edges: Chain, first: bool) -> _Half:
        """Take those over edges."""
        end, between = edges.legs if first else edges.legs[::-1]
        walls = edges.links(slice(None)).surfaces[1 if first else 0]
        return _Half(edges, edges.interactions, edges.objects, end, EdgeBeside(edges.vertex, between, walls))

    def received(self, scene: Scene, frequency: float, motions: tuple[Any, Any], rows: Rows, events: Floats) -> Floats:
        """Find when (n,) the second motion hears what the first one sends at times (n,), s."""
        if self.edge is None:
            return received_after(scene, frequency, motions, self.chain, rows, events)
        return _audible_over(self.chain, rows, motions, events)


def _chain(scene: Scene, halves: tuple[_Half, _Half], limit: int) -> Chain:
    """Pair what comes to scatterers with what goes on from them."""
    first, second = halves
    rows: list[Any] = [np.empty((2, 0), dtype=np.int64)]
    for thing in range(len(scene.scatterers)):
        one, two = np.flatnonzero(first.chain.receiver == thing), np.flatnonzero(second.chain.source == thing)
        rows.append(np.stack([each.ravel() for each in np.meshgrid(one, two, indexing="ij")]))
        if sum(each.shape[1] for each in rows) > limit:
            raise InputError("edge_scattering", f"must give at most {limit} paths (path_limit), but gives more")
    i, j = np.concatenate(rows, axis=1)
    source, which, receiver = first.chain.source[i], first.chain.receiver[i], second.chain.receiver[j]
    start, end = _times(scene, halves, (i, j), np.stack([source, which, receiver]))
    order = np.sum(first.kinds[i] != NONE, axis=1) + 1 + np.sum(second.kinds[j] != NONE, axis=1)
    columns = {"source": source, "receiver": receiver, "order": order.astype(np.int32), "start": start, "end": end}
    kept = np.flatnonzero(start < end)
    kept = kept[np.lexsort((order[kept], receiver[kept], source[kept]))]
    i, j, which = i[kept], j[kept], which[kept].astype(np.int32)
    edges = [half.edge if half.edge is None else half.edge.part(n) for half, n in zip(halves, (i, j), strict=True)]
    vertex = EdgeScattererVertex.of(scene.scatterers, read_only(which), edges)
    vertex = replace(vertex, nearest=read_only(np.full(len(which), _WIDE * scene.min_distance)))
    numbers = (len(vertex.names) - len(scene.scatterers) + which)[:, None]  # behind edges and their ends
    kinds = np.concatenate([first.kinds[i], np.full((len(i), 1), SCATTERING), second.kinds[j]], axis=1)
    objects = np.concatenate([first.objects[i], numbers, second.objects[j]], axis=1)
    rank = np.argsort(kinds == NONE, axis=1, kind="stable")
    kinds, objects = (np.take_along_axis(each, rank, axis=1) for each in (kinds, objects))
    held: dict[str, Any] = {name: read_only(column[kept]) for name, column in columns.items()}
    held |= {"interactions": read_only(kinds.astype(np.int8)), "objects": read_only(objects.astype(np.int32))}
    return Chain(scene=scene, **held, legs=(first.leg.part(i), second.leg.part(j)), vertex=vertex)


def _times(scene: Scene, halves: tuple[_Half, _Half], rows: tuple[Rows, Rows], ends: Any) -> tuple[Floats, Floats]:
    """Find when (n,) paths begin and end to be received, s; ends (3, n) are source, scatterer and receiver."""
    (first, second), (i, j), found = halves, rows, []
    for name, latest in (("start", np.maximum), ("end", np.minimum)):
        times = np.array(getattr(first.chain, name)[i])
        for met in np.unique(ends, axis=1).T.tolist():
            mine = np.flatnonzero(np.all(ends == np.array(met)[:, None], axis=0))
            frequency = scene.sources[met[0]].emitted.centre_frequency
            motions = scene.scatterers[met[1]].trajectory, scene.receivers[met[2]].trajectory
            times[mine] = second.received(scene, frequency, motions, j[mine], times[mine])
        found.append(latest(times, getattr(second.chain, name)[j]))
    return found[0], found[1]


def _audible_over(edges: Chain, rows: Rows, motions: tuple[Any, Any], events: Floats) -> Floats:
    """Find when (n,) the second motion hears over edges what the first one sends at times (n,), s."""
    received, known = np.array(events), np.flatnonzero(np.isfinite(events))
    if not len(known):
        return received
    sent, flight, c = motions[0].position(events[known]), np.zeros(len(known)), edges.scene.air.speed_of_sound
    for _ in range(_STEPS):  # each by the Mach number of the receiver
        step = edges.lengths(rows[known], sent, motions[1].position(events[known] + flight)) / c - flight
        flight = flight + step
        if np.abs(step).max() <= _FOUND:
            break
    received[known] += flight
    return received
