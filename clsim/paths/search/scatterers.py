"""Every path by a scatterer: the paths from the source to it and from it to the receiver, in pairs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Floats, read_only
from clsim.errors import InputError
from clsim.paths.chain import Chain, check_support
from clsim.paths.family import TRANSMISSION, ends_at, met_in_order
from clsim.paths.legs.events import find_events
from clsim.paths.legs.legs import StaticLeg, direct_paths, moving_paths
from clsim.paths.legs.mirrors import Mirrors
from clsim.paths.propagation import mean_medium_of, medium_of, straight
from clsim.paths.vertices.scatterer import ScattererVertex
from clsim.scene.body import Body
from clsim.scene.ends import End, Receiver, Source
from clsim.scene.motion.motion import Motion
from clsim.scene.scatterer import Scatterer
from clsim.scene.scene import Scene

Ends = tuple[int, int, int]  # source, scatterer, receiver


_PROBES = 10.0  # Hz, at which distances from scatterers are looked at
_TOGETHER = 1000  # instants at which they are
_RINGING = 10.0  # s for which transducers and filters may sound on
_AT_A_TIME = 20_000  # legs and times
_STEPS = 100  # of a travel time
_FOUND = 1e-13  # s
_MOVING_STEPS, _MOVING_FOUND = 30, 1e-12  # the same by mirrors that move


@dataclass(frozen=True, slots=True, eq=False)
class Side:
    """Paths between endpoints and scatterers, n of them."""

    surfaces: NDArray[np.int32]  # (n, N) from where sound comes, -1 behind the last
    source: NDArray[np.int32]  # (n,) between which
    receiver: NDArray[np.int32]  # likewise
    start: Floats  # (n,) interval of reception, s
    end: Floats  # likewise
    by_body: NDArray[np.bool_]  # (n,) whether any surface is a face of a body
    leg: StaticLeg | None  # their images; None where bodies are among their surfaces

    @staticmethod
    def of(walls: Chain, faces: Chain | None = None) -> Side:
        """Take the paths by walls, together with those by bodies if there are any; through panels there are none."""
        if walls.passes:
            walls = walls.part(np.flatnonzero(~np.any(walls.interactions == TRANSMISSION, axis=1)))
        chains = [walls] if faces is None else [walls, faces]
        met = [walls.objects.astype(np.int32), *(chain.legs[0].surfaces for chain in chains[1:])]
        width = max(each.shape[1] for each in met)
        met = [np.pad(each, ((0, 0), (0, width - each.shape[1])), constant_values=-1) for each in met]
        names = ("source", "receiver", "start", "end")
        columns: dict[str, Any] = {name: np.concatenate([getattr(chain, name) for chain in chains]) for name in names}
        by_body = np.repeat(np.arange(len(chains)) > 0, [len(chain) for chain in chains])
        leg = walls.legs[0] if faces is None else None
        return Side(surfaces=np.concatenate(met), **columns, by_body=by_body, leg=leg)

    def __len__(self) -> int:
        return len(self.source)


def scattered_paths(scene: Scene, before: Side, after: Side, order: int, limit: int) -> Chain:
    """Find every path by one scatterer with up to `order` reflections before it and as many after it."""
    found: list[dict[str, Any]] = []
    count, most = 0, len(before) * len(after) // max(len(scene.scatterers), 1)
    counts = (len(x) for x in (scene.sources, scene.receivers, scene.scatterers))
    for source, receiver, which in product(*map(range, counts)):
        found.append(_pairs(scene, before, after, (source, which, receiver)))
        count += len(found[-1]["start"])
        if count > limit:
            bound = f"must give at most {limit} paths by scatterers (path_limit)"
            raise InputError("scattering_order", f"{bound}, but {order} gives about {most}")
    columns = {name: read_only(np.concatenate([each[name] for each in found])) for name in found[0]}
    vertex = ScattererVertex.of(scene.scatterers, columns["scatterer"])
    if before.leg is None:
        family = moving_paths(scene, Mirrors.of(scene.room, scene.bodies), columns, ("before", "after"), vertex)
        return replace(family, vertex=replace(vertex, nearest=read_only(_nearest_moving(family))))
    walls, at = len(scene.room.faces), (vertex.interaction, vertex.objects)
    kinds, objects = met_in_order((walls, walls), columns["before"], at, columns["after"])
    kinds, objects = read_only(kinds), read_only(objects.astype(np.int32))
    always: dict[str, Any] = {name: columns[name] for name in ("source", "receiver", "order", "start", "end")}
    legs = tuple(StaticLeg(columns[f"{side}_matrix"], columns[f"{side}_offset"]) for side in ("before", "after"))
    family = Chain(scene=scene, **always, interactions=kinds, objects=objects, legs=legs, vertex=vertex)
    return replace(family, vertex=replace(vertex, nearest=read_only(_nearest_static(family))))


def direct_legs(scene: Scene) -> Chain:
    """Make the paths by no wall by every scatterer, whatever is in the way."""
    before, after = (Side.of(direct_paths(side)) for side in sides(scene))
    return scattered_paths(scene, before, after, 0, len(before) * len(after))


def sides(scene: Scene, bodies: Sequence[Body] = ()) -> tuple[Scene, Scene]:
    """Return the scene with scatterers for receivers, and with scatterers for sources, both without scatterers."""
    check_support("static scatterer", scene.air)
    signal = max((source.signal for source in scene.sources), key=lambda signal: signal.sampling_rate)
    receivers = tuple(Receiver(s.name, s.trajectory) for s in scene.scatterers)
    sources = tuple(Source(s.name, signal, s.trajectory) for s in scene.scatterers)
    before, after = copy(scene), copy(scene)  # without the checks of a scene, which this one has passed
    for side, name, ends in ((before, "receivers", receivers), (after, "sources", sources)):
        for field, value in ((name, ends), ("scatterers", ()), ("bodies", tuple(bodies))):
            object.__setattr__(side, field, value)
    return before, after


def _pairs(scene: Scene, before: Side, after: Side, ends: Ends) -> dict[str, Any]:
    """Columns of the paths from a source by a scatterer to a receiver: pairs of sides that are there together."""
    source, which, receiver = ends
    first = np.flatnonzero((before.source == source) & (before.receiver == which))
    second = np.flatnonzero((after.source == which) & (after.receiver == receiver))
    i, j = np.divmod(np.arange(len(first) * len(second)), max(len(second), 1))
    one, two = first[i], second[j]
    if before.leg is None:
        some = before.by_body[one] | after.by_body[two]
        one, two = one[some], two[some]
    frequency = scene.sources[source].emitted.centre_frequency
    motions = scene.scatterers[which].trajectory, scene.receivers[receiver].trajectory
    bounds = [received_after(scene, frequency, motions, after, two, times[one]) for times in (before.start, before.end)]
    start, end = np.maximum(bounds[0], after.start[two]), np.minimum(bounds[1], after.end[two])
    met = np.sum(before.surfaces[one] >= 0, axis=1) + np.sum(after.surfaces[two] >= 0, axis=1)
    rank = np.lexsort((met,))
    rank = rank[start[rank] < end[rank]]
    one, two, count = one[rank], two[rank], len(rank)
    columns = {
        "source": np.full(count, source, dtype=np.int32), "receiver": np.full(count, receiver, dtype=np.int32),
        "order": (met[rank] + 1).astype(np.int32), "start": start[rank], "end": end[rank],
        "before": before.surfaces[one], "after": after.surfaces[two],
        "scatterer": np.full(count, which, dtype=np.int32),
    }  # fmt: skip
    if before.leg is None or after.leg is None:
        return columns
    to, back = before.leg.part(one), at_receivers(after.leg.part(two))
    return columns | {
        "before_matrix": to.matrix, "before_offset": to.offset, "after_matrix": back.matrix,
        "after_offset": back.offset,
    }  # fmt: skip


def at_receivers(leg: StaticLeg) -> StaticLeg:
    """Turn images of scatterers into those of the receiver, as scatterers see it."""
    back = leg.matrix.transpose(0, 2, 1)
    return StaticLeg(back, -np.einsum("pij,pj->pi", back, leg.offset))


def received_after(
    scene: Scene, frequency: float, motions: tuple[Motion, Motion], after: Side, rows: NDArray[np.int64], events: Floats
) -> Floats:
    """Find when (n,) the second motion hears what the first one sends at times (n,) by paths of a side, s."""
    received, known = np.array(events), np.flatnonzero(np.isfinite(events))
    if not len(known):
        return received
    if after.leg is not None:
        sent, leg = motions[0].position(events[known]), after.leg.part(rows[known])
        images = np.einsum("pij,pj->pi", leg.matrix, sent) + leg.offset
        air, flight = medium_of(scene.air, frequency), np.zeros(len(known))
        for _ in range(_STEPS):  # each by the Mach number of the receiver
            at = motions[1].position(events[known] + flight)
            step = air.passage(straight(images, at)[0], at - sent).time - flight
            flight = flight + step
            if np.abs(step).max() <= _FOUND:
                break
        received[known] += flight
        return received
    mirrors, times = Mirrors.of(scene.room, scene.bodies), received[known, None]
    medium = mean_medium_of(scene.air, frequency)
    for _ in range(_MOVING_STEPS):
        found = find_events(mirrors, after.surfaces[rows[known]], motions, medium, times)
        step = (times - found.delay - events[known, None]) / (1.0 - found.rate)
        times = times - step
        if np.abs(step).max() <= _MOVING_FOUND:
            break
    received[known] = times[:, 0]
    return received


def _nearest_static(family: Chain) -> Floats:
    """Return bounds (paths,) from below of ``1 / (1 / d1 + 1 / d2)``, the distances from scatterers, m."""
    found, scene = np.empty(len(family)), family.scene
    for pair in family.pairs():
        source, receiver = scene.sources[pair.source], scene.receivers[pair.receiver]
        for which in np.unique(family.vertex.scatterer[pair.rows]):
            mine, scatterer = pair.index[family.vertex.scatterer[pair.rows] == which], scene.scatterers[which]
            sides, until = [], source.end + _RINGING
            ends: tuple[Source | Receiver, ...] = (source, receiver)
            for leg, end in zip(family.legs, ends, strict=True):
                apart, until = _apart(family, leg.part(mine), (end, which), until)
                sides.append(np.maximum(apart - scatterer.shape.radius, scene.min_distance))
            found[mine] = 1.0 / (1.0 / sides[0] + 1.0 / sides[1])
    return found


def _apart(family: Chain, leg: StaticLeg, ends: tuple[Source | Receiver, int], until: float) -> tuple[Floats, float]:
    """Lower bounds of distances (P,) of an end's images from a scatterer, m, and when the last sound arrives, s."""
    end, scatterer, c = ends[0], family.scene.scatterers[ends[1]], family.speed_range.slowest
    moving = [t for t in (end.trajectory, scatterer.trajectory) if not t.is_static]
    last = max((t.end for t in moving), default=0.0)
    speed = sum(1.02 * t.peak_speed(0.0, t.end)[0] for t in moving)
    least, first, unfinished = np.full(len(leg), np.inf), 0, True
    while unfinished and first <= last * _PROBES + 1.0:
        times = np.arange(first, min(first + _TOGETHER, math.floor(last * _PROBES) + 2)) / _PROBES
        places = leg.image(end.trajectory.position(times)[None])
        apart = np.linalg.norm(places - scatterer.trajectory.position(times), axis=2)
        least, first = np.minimum(least, apart.min(axis=1)), first + len(times)
        flight = float(apart[:, -1].max(initial=0.0)) / max(c - speed, 1e-9)
        unfinished = float(times[-1]) < until + flight
    # Sound takes d / c from one to the other, in which either moves on.
    return (least - 0.5 * speed / _PROBES) / (1.0 + speed / c), max(float(times[-1]), until + flight)


def _nearest_moving(family: Chain) -> Floats:
    """Return bounds (paths,) from below of ``1 / (1 / d1 + 1 / d2)``, the lengths of both legs, m."""
    scene, c = family.scene, family.speed_range.slowest
    speed = 2.0 * family.speeds + _fastest(scene.sources) + _fastest(scene.receivers)
    ends: list[End | Body | Scatterer] = [*scene.sources, *scene.receivers, *scene.bodies, *scene.scatterers]
    last = max((thing.trajectory.end for thing in ends if math.isfinite(thing.trajectory.end)), default=0.0)
    times = np.arange(0.0, last + 1.0 / _PROBES, 1.0 / _PROBES)
    radius = np.array([scatterer.shape.radius for scatterer in scene.scatterers])[family.vertex.scatterer]
    least = np.full((2, len(family)), np.inf)
    for some in np.array_split(np.arange(len(family)), -(-len(family) * len(times) // _AT_A_TIME) or 1):
        rows, now = np.repeat(some, len(times)), np.tile(times, len(some))
        places = ends_at(scene.sources, family.source[rows], now), ends_at(scene.receivers, family.receiver[rows], now)
        links = family.links(rows)
        for leg, length in enumerate(links.vertex.leg_lengths(links, places, now)):
            least[leg, some] = length.reshape(len(some), len(times)).min(axis=1)
    nearest = (least - 0.5 * speed / _PROBES) / (1.0 + speed / c) - radius
    first, second = np.maximum(nearest, scene.min_distance)
    return np.asarray(1.0 / (1.0 / first + 1.0 / second))


def _fastest(ends: Sequence[Source] | Sequence[Receiver]) -> float:
    """Return the largest speed of any end, sampled and 2 % larger, m/s."""
    moving = [end.trajectory for end in ends if not end.trajectory.is_static]
    return max((1.02 * motion.peak_speed(0.0, motion.end)[0] for motion in moving), default=0.0)
