"""Every path by a scatterer: the paths from the source to it and from it to the receiver, in pairs."""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.arrays import read_only
from clsim.errors import InputError
from clsim.paths.chain import Chain
from clsim.paths.family import NONE, SCATTERING, SPECULAR
from clsim.paths.legs.static import StaticLeg, direct_paths
from clsim.paths.propagation import medium_of, straight
from clsim.paths.support import check_support
from clsim.paths.vertices.scatterer import ScattererVertex
from clsim.scene.ends import Receiver, Source
from clsim.scene.scene import Scene

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from clsim.arrays import Floats
    from clsim.paths.options import PathSearch
    from clsim.paths.propagation import Medium
    from clsim.scene.body import Body
    from clsim.scene.motion.motion import Motion

LARGEST_SCATTERING_ORDER = 3
_PROBES = 10.0  # Hz, at which distances from scatterers are looked at
_TOGETHER = 1000  # instants at which they are
_RINGING = 10.0  # s for which transducers and filters may sound on
_STEPS = 100
_FOUND = 1e-13  # s


@dataclass(frozen=True, slots=True, eq=False)
class _Pairs:
    """Paths from one source by one scatterer to one receiver: rows (n,) of both sides, and when they are heard, s."""

    before: NDArray[np.int64]
    after: NDArray[np.int64]
    start: Floats
    end: Floats


def scattered_paths(scene: Scene, search: PathSearch, before: Chain, after: Chain) -> Chain:
    """Return every path by one scatterer with up to `scattering_order` reflections before it and as many after it.

    Both sides are paths by walls with the scatterer's centre as an end: which walls are in the way, and when, is asked
    of the centre. A side that comes or goes when sound meets the scatterer is heard to come or go when that sound is
    received.
    """
    most = len(before) * len(after) // max(len(scene.scatterers), 1)
    rows: list[dict[str, Any]] = []
    count = 0
    for source in range(len(scene.sources)):
        for receiver in range(len(scene.receivers)):
            for which in range(len(scene.scatterers)):
                pairs = _pairs(scene, before, after, (source, which, receiver))
                count += len(pairs.start)
                if count > search.path_limit:
                    raise InputError(
                        "scattering_order",
                        f"must give at most {search.path_limit} paths by scatterers (path_limit), but "
                        f"{search.scattering_order} gives about {most}",
                    )
                rows.append(_columns(before, after, pairs, (source, which, receiver)))
    return _family(scene, rows)


def direct_ways(scene: Scene) -> Chain:
    """Return the paths by no wall by every scatterer, whatever is in the way."""
    before, after = (direct_paths(side) for side in sides(scene))
    rows = [
        _columns(before, after, _pairs(scene, before, after, (source, which, receiver)), (source, which, receiver))
        for source in range(len(scene.sources))
        for receiver in range(len(scene.receivers))
        for which in range(len(scene.scatterers))
    ]
    return _family(scene, rows)


def sides(scene: Scene, bodies: Sequence[Body] = ()) -> tuple[Scene, Scene]:
    """Return the scene with scatterers for receivers, and with scatterers for sources: all else was checked before."""
    check_support("static scatterer", scene.air)
    signal = max((source.signal for source in scene.sources), key=lambda signal: signal.sampling_rate)
    listening = [Receiver(s.name, s.trajectory) for s in scene.scatterers]
    sounding = [Source(s.name, signal, s.trajectory) for s in scene.scatterers]
    with warnings.catch_warnings():  # what there is to say of room and signals was said
        warnings.simplefilter("ignore")
        return (
            Scene(scene.room, scene.air, scene.sources, listening, scene.min_distance, (), bodies),
            Scene(scene.room, scene.air, sounding, scene.receivers, scene.min_distance, (), bodies),
        )


def _pairs(scene: Scene, before: Chain, after: Chain, ends: tuple[int, int, int]) -> _Pairs:
    """Return the pairs of sides by a scatterer that are there at the same time."""
    source, which, receiver = ends
    first = np.flatnonzero((before.source == source) & (before.receiver == which))
    second = np.flatnonzero((after.source == which) & (after.receiver == receiver))
    i, j = np.divmod(np.arange(len(first) * len(second)), max(len(second), 1))
    one, two = first[i], second[j]
    bounds = [_heard(scene, after, two, times[one], ends) for times in (before.start, before.end)]
    start, end = np.maximum(bounds[0], after.start[two]), np.minimum(bounds[1], after.end[two])
    order = np.lexsort((before.order[one] + after.order[two],))
    order = order[start[order] < end[order]]
    return _Pairs(one[order], two[order], start[order], end[order])


def _heard(scene: Scene, after: Chain, rows: NDArray[np.int64], events: Floats, ends: tuple[int, int, int]) -> Floats:
    """Return when the receiver hears (n,) what the scatterer sends at times (n,) by paths after it, s."""
    heard, known = np.array(events), np.flatnonzero(np.isfinite(events))
    if len(known):
        sent = scene.scatterers[ends[1]].trajectory.position(events[known])
        leg = after.legs[0].part(rows[known])
        images = np.einsum("pij,pj->pi", leg.matrix, sent) + leg.offset
        medium = medium_of(scene.air, scene.sources[ends[0]].emitted.centre_frequency)
        heard[known] += _flight(medium, (sent, images), scene.receivers[ends[2]].trajectory, events[known])
    return heard


def _flight(medium: Medium, places: tuple[Floats, Floats], receiver: Motion, times: Floats) -> Floats:
    """Travel times (n,) to a receiver that moves on meanwhile, s.

    It is sent from places (n, 3) at times (n,), and comes from images (n, 3) of these, m.
    """
    flight = np.zeros(len(times))
    for _ in range(_STEPS):  # each by the Mach number of the receiver
        at = receiver.position(times + flight)
        step = medium.passage(straight(places[1], at)[0], at - places[0]).time - flight
        flight = flight + step
        if np.abs(step).max() <= _FOUND:
            break
    return flight


def _columns(before: Chain, after: Chain, pairs: _Pairs, ends: tuple[int, int, int]) -> dict[str, Any]:
    """Return the columns of the paths of some pairs of sides."""
    one, two = pairs.before, pairs.after
    width = before.objects.shape[1] + after.objects.shape[1] + 1
    objects = np.full((len(one), width), -1, dtype=np.int32)
    kinds = np.full((len(one), width), NONE, dtype=np.int8)
    n, m = before.order[one], after.order[two]
    step = np.arange(width)
    for walls, first, number in ((before.objects[one], 0 * n, n), (after.objects[two], n + 1, m)):
        row, place = np.nonzero((step >= first[:, None]) & (step < (first + number)[:, None]))
        objects[row, place] = walls[row, place - first[row]]
        kinds[row, place] = SPECULAR
    everyone = np.arange(len(one))
    objects[everyone, n], kinds[everyone, n] = ends[1], SCATTERING
    to, onwards = before.legs[0].part(one), after.legs[0].part(two)
    back = onwards.matrix.transpose(0, 2, 1)  # the image of the receiver, as the scatterer sees it
    return {
        "source": np.full(len(one), ends[0], dtype=np.int32), "receiver": np.full(len(one), ends[2], dtype=np.int32),
        "order": (n + m + 1).astype(np.int32), "start": pairs.start, "end": pairs.end, "interactions": kinds,
        "objects": objects, "before_matrix": to.matrix, "before_offset": to.offset,
        "after_matrix": back, "after_offset": -np.einsum("pij,pj->pi", back, onwards.offset),
        "scatterer": np.full(len(one), ends[1], dtype=np.int32),
    }  # fmt: skip


def _family(scene: Scene, rows: list[dict[str, Any]]) -> Chain:
    """Return paths as columns."""
    columns = {name: read_only(np.concatenate([row[name] for row in rows])) for name in rows[0]}
    names = ("source", "receiver", "order", "start", "end", "interactions", "objects")
    always: dict[str, Any] = {name: columns[name] for name in names}
    legs = tuple(StaticLeg(columns[f"{side}_matrix"], columns[f"{side}_offset"]) for side in ("before", "after"))
    vertex = ScattererVertex.of(scene.scatterers, columns["scatterer"])
    family = Chain(scene=scene, **always, legs=legs, vertex=vertex)
    return replace(family, vertex=replace(vertex, nearest=read_only(_nearest(family))))


def _nearest(family: Chain) -> Floats:
    """Return bounds (paths,) from below of ``1 / (1 / d1 + 1 / d2)``, the distances from scatterers, m.

    They hold for all that is emitted: motions that go on for days after the sound ended take no time.
    """
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
    """Return bounds (P,) from below of the distances of images of an end from a scatterer at any two near times, m.

    They hold for sound that sets out until a time, s; the time by which the last of it has arrived is returned as well.
    """
    end, scatterer, c = ends[0], family.scene.scatterers[ends[1]], family.speed_range.slowest
    moving = [t for t in (end.trajectory, scatterer.trajectory) if not t.is_static]
    last = max((t.end for t in moving), default=0.0)
    speed = sum(1.02 * t.peak_speed(0.0, t.end)[0] for t in moving)
    least, first, under_way = np.full(len(leg), np.inf), 0, True
    while under_way and first <= last * _PROBES + 1.0:
        times = np.arange(first, min(first + _TOGETHER, math.floor(last * _PROBES) + 2)) / _PROBES
        places = leg.image(end.trajectory.position(times)[None])
        apart = np.linalg.norm(places - scatterer.trajectory.position(times), axis=2)
        least, first = np.minimum(least, apart.min(axis=1)), first + len(times)
        flight = float(apart[:, -1].max(initial=0.0)) / max(c - speed, 1e-9)
        under_way = float(times[-1]) < until + flight
    # Sound takes d / c from one to the other, in which either moves on.
    return (least - 0.5 * speed / _PROBES) / (1.0 + speed / c), max(float(times[-1]), until + flight)
