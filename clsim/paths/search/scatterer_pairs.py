"""Every path by two scatterers in a row: paths to the first one, straight on to the second, and on from there."""

from __future__ import annotations

import warnings
from itertools import permutations, product
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.arrays import read_only
from clsim.errors import InputError
from clsim.paths.chain import Chain
from clsim.paths.family import NONE, SCATTERING, SPECULAR
from clsim.paths.search.scatterers import as_heard, heard_after
from clsim.paths.support import check_support
from clsim.paths.vertices.scatterer_pair import ScattererPairVertex
from clsim.scene.ends import Receiver, Source
from clsim.scene.scene import Scene

if TYPE_CHECKING:
    from collections.abc import Callable

    from clsim.paths.search.scatterers import Side

_WIDE = 0.5  # of the least distance from scatterers: half the harmonic mean of two of them


def scatterer_pair_paths(
    scene: Scene, sides: tuple[Side, Side], straight_on: Callable[[Scene], Side], limit: int
) -> Chain:
    """Find every path by two scatterers, with the walls that sides have before the first and after the second.

    What is in the way, and when, is asked of the centres. `straight_on` finds the paths by nothing of a scene.
    """
    check_support("static scatterer pair", scene.air)
    found: list[dict[str, Any]] = []
    between = [straight_on(_others(scene, which)) for which in range(len(scene.scatterers))]
    ends = product(range(len(scene.sources)), range(len(scene.receivers)))
    for (source, receiver), pair in product(ends, permutations(range(len(scene.scatterers)), 2)):
        found.append(_columns(scene, (sides[0], between[pair[0]], sides[1]), (source, receiver), pair))
        if sum(len(each["start"]) for each in found) > limit:
            raise InputError("scatterers_in_row", f"must give at most {limit} paths (path_limit), but 2 gives more")
    if not found:
        found = [_columns(scene, (sides[0], sides[0], sides[1]), (0, 0), (-1, -1))]
    columns = {name: read_only(np.concatenate([each[name] for each in found])) for name in found[0]}
    which = columns.pop("scatterer")
    nearest = read_only(np.full(len(which), _WIDE * scene.min_distance))
    speeds = np.array([scatterer.peak_speeds() for scatterer in scene.scatterers])
    vertex = ScattererPairVertex(which, nearest, speeds, tuple(scene.scatterers))
    legs = sides[0].leg, sides[1].leg
    assert legs[0] is not None
    assert legs[1] is not None
    before, after = columns.pop("before"), columns.pop("after")
    return Chain(scene=scene, **columns, legs=(legs[0].part(before), as_heard(legs[1].part(after))), vertex=vertex)


def _others(scene: Scene, which: int) -> Scene:
    """Return the scene in which one scatterer sounds and all others listen."""
    signal = max((source.signal for source in scene.sources), key=lambda signal: signal.sampling_rate)
    one = scene.scatterers[which]
    listening = [Receiver(s.name, s.trajectory) for s in scene.scatterers if s is not one]
    with warnings.catch_warnings():  # what there is to say of room and signals was said
        warnings.simplefilter("ignore")
        source = Source(one.name, signal, one.trajectory)
        return Scene(scene.room, scene.air, [source], listening, scene.min_distance, (), scene.bodies)


def _columns(
    scene: Scene, sides: tuple[Side, Side, Side], ends: tuple[int, int], pair: tuple[int, int]
) -> dict[str, Any]:
    """Columns of the paths from a source by two scatterers to a receiver: sides that are there together."""
    (before, between, after), (source, receiver), (first, second) = sides, ends, pair
    rows = (
        np.flatnonzero((before.source == source) & (before.receiver == first)),
        np.flatnonzero(between.receiver == second - (second > first)),
        np.flatnonzero((after.source == second) & (after.receiver == receiver)),
    )
    i, j, k = (each.ravel() for each in np.meshgrid(*rows, indexing="ij"))
    start, end = (_known(scene, sides, (i, j, k), (source, first, second, receiver), name) for name in ("start", "end"))
    kept = np.flatnonzero(start < end)
    i, k, count = i[kept], k[kept], len(kept)
    met = np.concatenate(
        [
            before.surfaces[i],
            np.tile(np.array([-2 - first, -2 - second], dtype=np.int32), (count, 1)),
            after.surfaces[k],
        ],
        axis=1,
    )
    met = np.take_along_axis(met, np.argsort(met == -1, axis=1, kind="stable"), axis=1)
    return {
        "source": np.full(count, source, dtype=np.int32), "receiver": np.full(count, receiver, dtype=np.int32),
        "order": np.sum(met != -1, axis=1).astype(np.int32), "start": start[kept], "end": end[kept],
        "interactions": np.select([met < -1, met >= 0], [SCATTERING, SPECULAR], NONE).astype(np.int8),
        "objects": np.where(met < -1, -2 - met, met), "before": i, "after": k,
        "scatterer": np.tile(np.array(pair, dtype=np.int32), (count, 1)),
    }  # fmt: skip


def _known(
    scene: Scene, sides: tuple[Side, Side, Side], rows: tuple[Any, Any, Any], met: tuple[int, int, int, int], name: str
) -> Any:
    """Find the times of reception (n,) of the last start, or first end, of the three sides of paths, s."""
    places = [scene.scatterers[which].trajectory for which in met[1:3]] + [scene.receivers[met[3]].trajectory]
    latest = np.maximum if name == "start" else np.minimum
    frequency, times = scene.sources[met[0]].emitted.centre_frequency, getattr(sides[0], name)[rows[0]]
    for n in (1, 2):
        motions = places[n - 1], places[n]
        times = heard_after(scene, frequency, motions, sides[n], rows[n], times)
        times = latest(times, getattr(sides[n], name)[rows[n]])
    return times
