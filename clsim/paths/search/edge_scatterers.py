"""Every path over one edge of the room and by one scatterer, in either order."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.arrays import read_only
from clsim.errors import InputError
from clsim.paths.chain import Chain
from clsim.paths.family import DIFFRACTION, NONE, SCATTERING, SPECULAR
from clsim.paths.search.scatterers import as_heard, heard_after
from clsim.paths.support import check_support
from clsim.paths.vertices.edge_scatterer import EdgeScattererVertex, ScattererEdgeVertex
from clsim.scene.scatterer import Scatterer

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Floats
    from clsim.paths.search.scatterers import Side
    from clsim.scene.scene import Scene

    Rows = NDArray[np.int64]

_WIDE = 0.5  # of the least distance from scatterers: half the harmonic mean of two of them
_STEPS, _FOUND = 100, 1e-13  # of a travel time, and s
_TOGETHER = 16  # paths at as many times of which the diagonal is used


def edge_scatterer_paths(
    scene: Scene, sides: tuple[Side, Side], over_edges: tuple[Chain, Chain], limit: int
) -> list[Chain]:
    """Find the paths that meet the edge first, and those that meet the scatterer first.

    `sides` and `over_edges` are the paths by walls, and over edges, from sources to scatterers and from there to
    receivers. Between edge and scatterer sound goes straight.
    """
    check_support("static edge scatterer", scene.air)
    found = [_chain(scene, over_edges[0], sides[1], True), _chain(scene, over_edges[1], sides[0], False)]
    if sum(map(len, found)) > limit:
        raise InputError("edge_scattering", f"must give at most {limit} paths (path_limit), but gives more")
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
        asked = np.isfinite(times) & (vertex.radius > 0.0)
        new = {keys[row]: row for row in np.flatnonzero(asked).tolist() if keys[row] not in known}
        first = np.array(list(new.values()), dtype=np.int64)
        for pair in chain.pairs():
            mine = np.intersect1d(first, pair.index)
            for rows in np.array_split(mine, -(-len(mine) // _TOGETHER) or 1):
                found = _met(chain, centres, rows, times[rows]).tolist()
                known.update({keys[row]: time for row, time in zip(rows.tolist(), found, strict=True)})
        for row in np.flatnonzero(asked).tolist():
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


def _chain(scene: Scene, edges: Chain, side: Side, edge_first: bool) -> Chain:
    """Pair paths over edges with a side of the scatterer's other end."""
    last = np.maximum(np.sum(edges.interactions != NONE, axis=1) - 1, 0)
    next_to = last if edge_first else np.zeros(len(edges), dtype=np.int64)  # what is met next to the scatterer
    straight_on = edges.interactions[np.arange(len(edges)), next_to] == DIFFRACTION
    rows: list[tuple[Rows, Rows]] = []
    met = (edges.receiver, side.source) if edge_first else (edges.source, side.receiver)
    for thing in range(len(scene.scatterers)):
        one, two = np.flatnonzero(straight_on & (met[0] == thing)), np.flatnonzero(met[1] == thing)
        i, j = (each.ravel() for each in np.meshgrid(one, two, indexing="ij"))
        rows.append((i, j))
    i, j = (np.concatenate([each[n] for each in rows]) for n in range(2))
    which = met[0][i]
    source, receiver = (edges.source[i], side.receiver[j]) if edge_first else (side.source[j], edges.receiver[i])
    start, end = _times(scene, (edges, side), (i, j), (source, which, receiver), edge_first)
    order = edges.order[i] + 1 + np.sum(side.surfaces[j] >= 0, axis=1)
    kept = np.flatnonzero(start < end)
    kept = kept[np.lexsort((order[kept], receiver[kept], source[kept]))]
    i, j, which = i[kept], j[kept], which[kept].astype(np.int32)
    columns = {"source": source, "receiver": receiver, "order": order.astype(np.int32), "start": start, "end": end}
    columns = {name: read_only(column[kept]) for name, column in columns.items()}
    kinds, objects = _interactions(edges, side, (i, j, which), edge_first)
    speeds = np.array([scatterer.peak_speeds() for scatterer in scene.scatterers])
    kind = EdgeScattererVertex if edge_first else ScattererEdgeVertex
    nearest = read_only(np.full(len(which), _WIDE * scene.min_distance))
    vertex = kind(read_only(which), nearest, speeds, tuple(scene.scatterers), edges.vertex.part(i))
    assert side.leg is not None
    other, over = side.leg.part(j), edges.legs[0 if edge_first else 1].part(i)
    legs = (over, as_heard(other)) if edge_first else (other, over)
    all_columns: dict[str, Any] = columns
    return Chain(scene=scene, **all_columns, interactions=kinds, objects=objects, legs=legs, vertex=vertex)


def _interactions(edges: Chain, side: Side, rows: tuple[Any, Any, Any], edge_first: bool) -> tuple[Any, Any]:
    """Interactions and objects (n, N) of paths; scatterers are numbered behind edges and their ends."""
    i, j, which = rows
    surfaces, scatterer = side.surfaces[j], len(edges.vertex.names) + which[:, None]
    by_walls = np.where(surfaces >= 0, SPECULAR, NONE)
    parts = [
        (edges.interactions[i], edges.objects[i]),
        (np.full((len(i), 1), SCATTERING), scatterer),
        (by_walls, surfaces),
    ]
    kinds, objects = (
        np.concatenate([part[n] for part in (parts if edge_first else parts[::-1])], axis=1) for n in (0, 1)
    )
    order = np.argsort(kinds == NONE, axis=1, kind="stable")
    kinds, objects = (np.take_along_axis(each, order, axis=1) for each in (kinds, objects))
    return read_only(kinds.astype(np.int8)), read_only(objects.astype(np.int32))


def _times(
    scene: Scene, sides: tuple[Chain, Side], rows: tuple[Rows, Rows], ends: tuple[Any, Any, Any], edge_first: bool
) -> tuple[Floats, Floats]:
    """Find when (n,) paths begin and end to be received, s."""
    (edges, side), (i, j), found = sides, rows, []
    for name, latest in (("start", np.maximum), ("end", np.minimum)):
        over, other = getattr(edges, name)[i], getattr(side, name)[j]
        times = np.array(over if edge_first else other)
        for met in np.unique(np.stack(ends), axis=1).T.tolist():
            mine = np.flatnonzero(np.all(np.stack(ends) == np.array(met)[:, None], axis=0))
            frequency = scene.sources[met[0]].emitted.centre_frequency
            motions = scene.scatterers[met[1]].trajectory, scene.receivers[met[2]].trajectory
            if edge_first:
                times[mine] = heard_after(scene, frequency, motions, side, j[mine], times[mine])
            else:
                times[mine] = _heard_over(edges, i[mine], motions, times[mine])
        found.append(latest(times, other if edge_first else over))
    return found[0], found[1]


def _heard_over(edges: Chain, rows: Rows, motions: tuple[Any, Any], events: Floats) -> Floats:
    """Find when (n,) the second motion hears over edges what the first one sends at times (n,), s."""
    heard, known = np.array(events), np.flatnonzero(np.isfinite(events))
    if not len(known):
        return heard
    sent, flight, c = motions[0].position(events[known]), np.zeros(len(known)), edges.scene.air.speed_of_sound
    for _ in range(_STEPS):  # each by the Mach number of the receiver
        step = edges.lengths(rows[known], sent, motions[1].position(events[known] + flight)) / c - flight
        flight = flight + step
        if np.abs(step).max() <= _FOUND:
            break
    heard[known] += flight
    return heard
