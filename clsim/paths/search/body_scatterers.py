"""Every path by a scatterer and by bodies: the paths to it and on from it, in pairs of which one meets a body."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.arrays import read_only
from clsim.errors import InputError
from clsim.paths.family import ends_at
from clsim.paths.legs.events import find_events
from clsim.paths.legs.mirrors import Mirrors
from clsim.paths.legs.moving import moving_paths
from clsim.paths.propagation import mean_medium_of
from clsim.paths.vertices.scatterer import ScattererVertex

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from clsim.arrays import Floats
    from clsim.paths.chain import Chain
    from clsim.paths.options import PathSearch
    from clsim.scene.body import Body
    from clsim.scene.ends import End, Receiver, Source
    from clsim.scene.scatterer import Scatterer
    from clsim.scene.scene import Scene

    Rows = NDArray[np.int64]

_PROBES = 10.0  # Hz, at which lengths of legs are looked at
_AT_A_TIME = 20_000  # legs and times
_STEPS = 30
_FOUND = 1e-12  # s


@dataclass(frozen=True, slots=True, eq=False)
class _Legs:
    """Paths from one kind of ends to another."""

    surfaces: NDArray[np.int32]  # (n, N) mirrors from where sound comes, filled up with -1
    source: NDArray[np.int32]  # (n,) between which
    receiver: NDArray[np.int32]  # likewise
    start: Floats  # (n,) when they are there, by reception, s
    end: Floats  # likewise
    by_body: NDArray[np.bool_]  # (n,) whether any mirror is a face of a body


def body_scattered_paths(
    scene: Scene, search: PathSearch, before: tuple[Chain, Chain], after: tuple[Chain, Chain]
) -> Chain:
    """Return every path by one scatterer with up to `scattering_order` mirrors on either leg, of bodies at least one.

    before, after: the paths by walls alone, behind bodies, and by bodies, of both `sides` of the scene.

    Both legs are paths among walls and bodies with the scatterer's centre as an end. A leg to the scatterer that comes
    or goes when sound meets it is heard to come or go when that sound is received.
    """
    legs = _legs(*before), _legs(*after)
    found: list[dict[str, Any]] = []
    count = 0
    for source in range(len(scene.sources)):
        for receiver in range(len(scene.receivers)):
            for which in range(len(scene.scatterers)):
                found.append(_pairs(scene, *legs, (source, which, receiver)))
                count += len(found[-1]["start"])
                if count > search.path_limit:
                    raise InputError(
                        "scattering_order",
                        f"must give at most {search.path_limit} paths by scatterers and bodies (path_limit), but gives "
                        "more",
                    )
    columns = {name: read_only(np.concatenate([each[name] for each in found])) for name in found[0]}
    vertex = ScattererVertex.of(scene.scatterers, columns["scatterer"])
    family = moving_paths(scene, Mirrors.of(scene), columns, ("before", "after"), vertex)
    return replace(family, vertex=replace(vertex, nearest=read_only(_nearest(family))))


def _legs(walls: Chain, faces: Chain) -> _Legs:
    """Return paths by walls and by bodies together."""
    met = [walls.objects.astype(np.int32), faces.legs[0].surfaces]
    width = max(each.shape[1] for each in met)
    met = [np.pad(each, ((0, 0), (0, width - each.shape[1])), constant_values=-1) for each in met]
    ends = [np.concatenate([getattr(walls, name), getattr(faces, name)]) for name in ("source", "receiver")]
    times = [np.concatenate([getattr(walls, name), getattr(faces, name)]) for name in ("start", "end")]
    by_body = np.repeat([False, True], [len(walls), len(faces)])
    return _Legs(np.concatenate(met), ends[0], ends[1], times[0], times[1], by_body)


def _pairs(scene: Scene, before: _Legs, after: _Legs, ends: tuple[int, int, int]) -> dict[str, Any]:
    """Return the columns of the paths from a source by a scatterer to a receiver."""
    source, which, receiver = ends
    first = np.flatnonzero((before.source == source) & (before.receiver == which))
    second = np.flatnonzero((after.source == which) & (after.receiver == receiver))
    one, two = (each.ravel() for each in np.meshgrid(first, second, indexing="ij"))
    some = before.by_body[one] | after.by_body[two]
    one, two = one[some], two[some]
    bounds = [_heard(scene, after.surfaces[two], times[one], ends) for times in (before.start, before.end)]
    start, end = np.maximum(bounds[0], after.start[two]), np.minimum(bounds[1], after.end[two])
    met = np.sum(before.surfaces[one] >= 0, axis=1) + np.sum(after.surfaces[two] >= 0, axis=1)
    order = np.lexsort((met,))
    order = order[start[order] < end[order]]
    count = len(order)
    return {
        "source": np.full(count, source, dtype=np.int32), "receiver": np.full(count, receiver, dtype=np.int32),
        "order": (met[order] + 1).astype(np.int32), "start": start[order], "end": end[order],
        "before": before.surfaces[one[order]], "after": after.surfaces[two[order]],
        "scatterer": np.full(count, which, dtype=np.int32),
    }  # fmt: skip


def _heard(scene: Scene, surfaces: NDArray[np.int32], events: Floats, ends: tuple[int, int, int]) -> Floats:
    """Return when the receiver hears (n,) what the scatterer sends at times (n,) by mirrors (n, N), s."""
    heard, known = np.array(events), np.flatnonzero(np.isfinite(events))
    motion = scene.scatterers[ends[1]].trajectory, scene.receivers[ends[2]].trajectory
    medium = mean_medium_of(scene.air, scene.sources[ends[0]].emitted.centre_frequency)
    mirrors, times = Mirrors.of(scene), heard[known, None]
    for _ in range(_STEPS if len(known) else 0):
        found = find_events(mirrors, surfaces[known], motion, medium, times)
        step = (times - found.delay - events[known, None]) / (1.0 - found.rate)
        times = times - step
        if np.abs(step).max() <= _FOUND:
            break
    heard[known] = times[:, 0]
    return heard


def _nearest(family: Chain) -> Floats:
    """Return bounds (paths,) from below of ``1 / (1 / d1 + 1 / d2)``, the lengths of both legs, m.

    They are looked at now and then: meanwhile, and while sound is on its way, all moves on.
    """
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
