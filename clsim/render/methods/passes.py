"""Ends that pass each other so near that what is heard changes faster than their Doppler shifts."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterator

    from clsim.arrays import Floats
    from clsim.scene.motion.trajectory import Trajectory
    from clsim.tracks.tracks import SceneTracks

_COARSE, _FINE = 0.02, 5e-4  # s between places at which ends are looked at


def passes(
    tracks: SceneTracks, index: int, receivers: list[int]
) -> Iterator[tuple[str, tuple[Trajectory, Trajectory], float, float]]:
    """Yield endpoints of direct legs: name, both motions, sum of their speeds in m/s, and radius in m."""
    scene, speeds = tracks.scene, tracks.speeds
    source = scene.sources[index].trajectory, float(speeds.source[index])
    ears = [(scene.receivers[i].trajectory, float(speeds.receiver[i])) for i in receivers]
    for i, (ear, speed) in zip(receivers, ears, strict=True):
        yield f"receiver {i}", (source[0], ear), source[1] + speed, 0.0
    for i, scatterer in enumerate(scene.scatterers):
        fast, radius = scatterer.peak_speeds()[1], scatterer.shape.radius
        for end, speed in (source, *ears):
            yield f"scatterer {i}", (end, scatterer.trajectory), speed + fast, radius


def is_passed(ends: tuple[Trajectory, Trajectory], until: float, needed: float, most: float, radius: float) -> bool:
    """Test whether two ends come within `radius` m plus the distance that they cover in `needed` s at up to `most` m/s.

    Sound that is heard until the end was emitted before. Ends that are carried together do not pass each other.
    """

    def apart(times: Floats) -> Floats:
        return np.asarray(ends[0].position(times) - ends[1].position(times))

    times = np.arange(0.0, until + _COARSE, _COARSE)
    bound = np.linalg.norm(apart(times), axis=-1) - 0.5 * most * _COARSE
    near = times[bound < radius + needed * most]
    within = np.arange(-0.5 * _COARSE, 0.5 * _COARSE + _FINE, _FINE)
    places = apart((near[:, None] + within).ravel()).reshape(len(near), len(within), 3)
    moved = np.linalg.norm(np.diff(places, axis=1), axis=-1)
    distance = np.linalg.norm(places, axis=-1)[:, :-1] - radius
    return bool(np.any(distance < (0.5 + needed / _FINE) * moved))
