"""Parts of a member's sound, and labels of its direct sound and room."""

from __future__ import annotations

import warnings
import zlib
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Floats
from clsim.errors import ClsimWarning, InputError
from clsim.impulse_responses import impulse_responses
from clsim.paths.ground_truth import DirectPath
from clsim.paths.path_set import PathSet
from clsim.recording import Recording
from clsim.render.planning import plan_paths
from clsim.render.render import record
from clsim.room_measures import room_measures
from clsim.study.file import PARTS, Member, Study
from clsim.study.noise import NoiseModel
from clsim.workflow.pipeline import PlannedScene

_OVER = ("source", "receiver", "times")


def with_parts(
    study: Study, member: Member, planned: PlannedScene, recording: Recording, noise: NoiseModel | None
) -> tuple[Recording, dict[str, NDArray[Any]]]:
    """Return a member's recording with its noise, and all sounds that are kept, by their word in `keep`.

    The recording is the sum of its direct sound, what is reverberant, and noise.
    """
    clean, found = recording.samples, dict[str, Any]()
    if PARTS & set(study.keep):
        direct = _direct_sound(planned)
        found = {"direct": direct, "reverberant": clean - direct}
    if noise is not None:
        if planned.plan.carrier is not None:
            raise InputError("noise", "must be left out in baseband")
        scene, first = planned.paths.scene, [0.0]
        places = np.concatenate([receiver.trajectory.position(first) for receiver in scene.receivers])
        seed = study.seed, zlib.crc32(b"noise"), member.number
        found["noise"] = noise.samples(clean, recording.sampling_rate, places, scene.air.speed_of_sound, seed)
        recording = replace(recording, samples=clean + found["noise"])
    found["recording"] = recording.samples
    return recording, {name: found[name] for name in study.keep if name in found}


def _direct_paths(paths: PathSet) -> PathSet:
    return PathSet(paths.scene, tuple(family.part(np.flatnonzero(family.order == 0)) for family in paths.families))


def _direct_sound(planned: PlannedScene) -> NDArray[Any]:
    """Render the direct sound alone, (rows, n)."""
    plan, paths = planned.plan, _direct_paths(planned.paths)
    if not len(paths):
        return np.zeros((plan.row_count, plan.samples), plan.sample_type)
    duration = plan.samples / plan.sampling_rate
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ClsimWarning)  # the whole sound has told the same
        return record(plan_paths(paths, replace(plan.options, duration=duration, tail="off"))).samples


def add_direct_labels(content: Any, found: DirectPath, planned: PlannedScene) -> None:
    """Add distance, direction in the receiver's axes, speeds and gain of the direct sound, by time of reception."""
    scene = planned.paths.scene
    apart = found.receiver_position - found.source_position
    x, y, z = np.moveaxis(found.local_arrival, -1, 0)
    emitted = found.reception_time - found.delay
    columns = {
        "distance": (np.linalg.norm(apart, axis=-1), "m"),
        "azimuth": (np.arctan2(y, x), "rad"),
        "elevation": (np.arcsin(np.clip(z, -1.0, 1.0)), "rad"),
        "source_speed": (_speeds([s.trajectory for s in scene.sources], emitted, 0), "m/s"),
        "receiver_speed": (_speeds([r.trajectory for r in scene.receivers], found.reception_time, 1), "m/s"),
        "direct_gain": (_direct_gain(found, planned), "1/m"),
    }
    content.update({name: (_OVER, values, {"units": units}) for name, (values, units) in columns.items()})


def _speeds(motions: list[Any], times: Floats, axis: int) -> Floats:
    """Return speeds (sources, receivers, T) of the ends along an axis, m/s."""
    speeds = np.empty(times.shape)
    for i, motion in enumerate(motions):
        at = np.moveaxis(times, axis, 0)[i]
        np.moveaxis(speeds, axis, 0)[i] = np.linalg.norm(motion.velocity(at.ravel()), axis=-1).reshape(at.shape)
    return speeds


def _direct_gain(found: DirectPath, planned: PlannedScene) -> Floats:
    """Return the magnitude of the direct sound's gain; NaN where a wall is in the way."""
    gain, paths = np.full(found.delay.shape, np.nan), _direct_paths(planned.paths)
    if len(paths):
        options = planned.plan.options
        table = paths.table(found.times, options.motion, options.amplitude)
        for row, (source, receiver) in enumerate(zip(table.source, table.receiver, strict=True)):
            there = (found.times >= paths.start[row]) & (found.times < paths.end[row])
            gain[source, receiver, there] = np.abs(table.gain[row, there])
    return gain


def add_room_measures(content: Any, planned: PlannedScene) -> None:
    """Add the room's measures at 0 s by octave, as ``room_t20`` and so on."""
    plan = planned.plan
    tail = "off" if plan.options.tail == "off" else "auto"
    rate, seed = plan.sampling_rate, plan.options.tail_seed
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ClsimWarning)  # NaN says the same
        found = room_measures(impulse_responses(planned.paths, rate, tail=tail, tail_seed=seed)).to_xarray()
    content.coords["frequency"] = found.coords["frequency"]
    content.update({f"room_{name}": (values.dims, values.values, values.attrs) for name, values in found.items()})
