"""Measured processor time of the rendering methods, from `costs.toml`, and ends that pass too near for some of them."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from clsim.arrays import Floats
from clsim.errors import DeviceError
from clsim.opencl.device import find_device
from clsim.render.options import RenderOptions
from clsim.scene.motion.trajectory import Trajectory
from clsim.tracks.tracks import SceneTracks

FILE = Path(__file__).with_name("costs.toml")


@dataclass(frozen=True, slots=True)
class Costs:
    """Processor time, ns, and the speed of a GPU relative to a CPU; each entry is explained in `costs.toml`."""

    plain: float
    wide: float
    rest: float
    nodes: float
    envelope: float
    branches: float
    upsampled: float
    split: float
    planned: float
    second: float
    function: float
    channel_path: float
    channel_function: float
    channel_point: float
    channel_nodes: float
    stretch: float
    ear: float
    ear_component: float
    ear_point: float
    ear_filter: float
    ear_planned: float
    gpu: float


@cache
def measured_costs() -> Costs:
    """Return the costs of this installation."""
    content = tomllib.loads(FILE.read_text("utf-8"))
    return Costs(**content["nanoseconds"], **content["ears"], **content["narrow"], **content["times"])


def on_gpu(options: RenderOptions) -> bool:
    """Test whether the device that is requested, or found, is a GPU."""
    try:
        return find_device(options.device)[0].kind == "GPU"
    except DeviceError:  # reported when it is needed
        return False


_COARSE, _FINE = 0.02, 5e-4  # s between places at which ends are looked at


def passes(
    tracks: SceneTracks, index: int, receivers: list[int]
) -> Iterator[tuple[str, tuple[Trajectory, Trajectory], float, float]]:
    """Yield endpoints of direct legs: name, both motions, sum of their speeds in m/s, and radius in m."""
    scene, speeds = tracks.paths.scene, tracks.speeds
    source = scene.sources[index].trajectory, float(speeds.source[index])
    ears = [(scene.receivers[i].trajectory, float(speeds.receiver[i])) for i in receivers]
    for i, (ear, speed) in zip(receivers, ears, strict=True):
        yield f"receiver {i}", (source[0], ear), source[1] + speed, 0.0
    for i, scatterer in enumerate(scene.scatterers):
        fast, radius = scatterer.peak_speeds()[1], scatterer.shape.radius
        for end, speed in (source, *ears):
            yield f"scatterer {i}", (end, scatterer.trajectory), speed + fast, radius


def passing_times(
    ends: tuple[Trajectory, Trajectory], until: float, needed: float, most: float, radius: float
) -> Floats:
    """Return times (n,) at which ends are within `radius` m plus what they cover in `needed` s at up to `most` m/s."""

    def apart(times: Floats) -> Floats:
        return np.asarray(ends[0].position(times) - ends[1].position(times))

    times = np.arange(0.0, until + _COARSE, _COARSE)
    bound = np.linalg.norm(apart(times), axis=-1) - 0.5 * most * _COARSE
    near = times[bound < radius + needed * most]
    within = np.arange(-0.5 * _COARSE, 0.5 * _COARSE + _FINE, _FINE)
    places = apart((near[:, None] + within).ravel()).reshape(len(near), len(within), 3)
    moved = np.linalg.norm(np.diff(places, axis=1), axis=-1)
    distance = np.linalg.norm(places, axis=-1)[:, :-1] - radius
    return np.asarray((near[:, None] + within[:-1])[distance < (0.5 + needed / _FINE) * moved])
