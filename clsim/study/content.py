"""Stored content of a member of a study: sound, ground truth, paths, and the user's metrics."""

from __future__ import annotations

import importlib
import importlib.util
import json
import sys
import warnings
import zlib
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Floats, texts
from clsim.errors import ClsimWarning, InputError
from clsim.impulse_responses import impulse_responses
from clsim.opencl.device import find_device
from clsim.output.columns import Columns
from clsim.output.raw_files import SampleFile
from clsim.output.stores import MemberStore, SoundStore
from clsim.paths.ground_truth import SCALARS, VECTORS, DirectPath, EchoTruth
from clsim.paths.path_set import PathSet
from clsim.paths.path_table import ATTRIBUTES, PathTable
from clsim.recording import Recording
from clsim.render.planning import plan_paths
from clsim.render.render import Rendering, record
from clsim.room_measures import room_measures
from clsim.scene.scene import Scene
from clsim.study.draws import NoiseModel
from clsim.study.file import LABELS, PARTS, SOUNDS, TAKEN, Member, Study
from clsim.workflow.checkpoint import run_identity
from clsim.workflow.pipeline import PlannedScene, check_table_size, plan_scene, render_into, table_times

_OF_RECEPTION = {"units": "s", "long_name": "time of reception"}


@dataclass(frozen=True, slots=True, eq=False)
class Computed:
    """Results of a member that are not written yet."""

    content: Columns  # all but the sound
    sounds: dict[str, NDArray[Any]]  # (rows, n) by their word in `keep`, but for a recording that is in `group`
    attributes: dict[str, Any]  # of each sound in a store
    group: Path  # that holds the sound of a recording which is written as it is rendered
    device: str  # by id and name


def computed(study: Study, member: Member, device: str | None, folder: Path) -> Computed:
    """Render a member, the sound into a group of a folder if it is kept alone and in no shards."""
    file, noise = study.parts_of(member)
    planned = plan_scene(file if device is None else file.on_device(device))
    plan, sound = planned.plan, planned.stored_sound(study.base)
    content = sound.columns()
    content.attrs |= {
        "parameters": json.dumps(member.parameters), "identity": json.dumps(run_identity(planned)),
    }  # fmt: skip
    store = MemberStore(folder, sound, ())
    wanted = set(study.keep) & SOUNDS
    streamed = wanted == {"recording"} and noise is None and study.shards is None
    whole = bool(study.metrics or (wanted and not streamed))
    recording = _recorded(planned, store if streamed else None, folder if whole else None)
    sounds: dict[str, NDArray[Any]] = {}
    if recording is not None and not streamed:
        recording, sounds = with_parts(study, member, planned, recording, noise)
    _add_tables(content, study, planned)
    if study.metrics:
        function = metrics_function(study.metrics, study.folder)
        metrics = function(recording, planned.paths, dict(member.parameters))
        of_labels = () if study.shards is None else (*LABELS, *content.attrs)
        _add_metrics(content, metrics, {*TAKEN, *member.parameters, *wanted, "sound", *of_labels})
    used = None if plan.options.engine != "opencl" else find_device(plan.options.device)[0]
    return Computed(
        content, sounds, sound.sound_attributes, store.paths[0], "" if used is None else f"{used.id} {used.name}"
    )


def _recorded(planned: PlannedScene, store: SoundStore | None, folder: Path | None) -> Recording | None:
    """Render into a store, and into a file of a folder from which the recording is read; either may be None."""
    plan, rendering = planned.plan, Rendering(planned.plan)
    sinks: list[SampleFile | SoundStore] = []
    if store is not None:
        store.create()
        sinks.append(store)
    file = None
    if folder is not None:
        shape = plan.row_count, plan.samples
        file = SampleFile(folder / "samples", shape, np.dtype(plan.sample_type).str)
        sinks.append(file)
    if sinks:
        deque(render_into(sinks, plan, rendering), maxlen=0)
    if file is None:
        return None
    notes = (*plan.describe(), *rendering.describe())
    return Recording(
        file.samples(), plan.sampling_rate, plan.row_names, planned.paths, notes, plan.units,
        rendering.clipped, plan.carrier, plan.recorded,
    )  # fmt: skip


def _add_tables(content: Columns, study: Study, planned: PlannedScene) -> None:
    kept = set(study.keep)
    if "room_measures" in kept:
        add_room_measures(content, planned)
    if "paths" in kept:
        check_table_size(planned.plan, "keep", 'must leave out "paths"')
    if not kept & {"ground_truth", "paths"}:
        return
    times = table_times(planned.plan, study.table_rate, "table_rate")
    if "ground_truth" in study.keep:
        found = planned.ground_truth(times)
        _add_ground_truth(content, found, planned.paths.scene)
        if study.shards is not None:
            add_direct_labels(content, found, planned)
        for echo in planned.echo_truths(times):
            _add_echo_truth(content, echo)
    if "paths" in study.keep:
        _add_paths(content, planned.path_table(times))


def _add_ground_truth(content: Columns, found: DirectPath, scene: Scene) -> None:
    content.add("times", "times", found.times, _OF_RECEPTION)
    content.add("source", "source", texts(source.name for source in scene.sources))
    for name in SCALARS + VECTORS:
        column = getattr(found, name)
        content.add(name, ("source", "receiver", "times", "axis")[: column.ndim], column, ATTRIBUTES[name])


def _add_echo_truth(content: Columns, found: EchoTruth) -> None:
    kind, units = found.KIND, {"delay": "s", "range": "m", "radial_speed": "m/s"}
    content.add(kind, kind, texts(found.names))
    for name in found.MEASURES:
        over = (kind, "source", "receiver", "times", "axis")[: getattr(found, name).ndim]
        content.add(f"{kind}_{name}", over, getattr(found, name), {"units": units[name]} if name in units else {})


def _add_paths(content: Columns, table: PathTable) -> None:
    content.add("times", "times", table.times, _OF_RECEPTION)
    over = "path", "interaction"
    content.add("path_interactions", over, table.interactions)
    content.add("path_objects", over, table.objects, {"names": list(table.object_names)})
    for name in ("source", "receiver", "order", "direct"):
        content.add(f"path_{name}", "path", getattr(table, name))
    for name in ("delay", "doppler_factor", "doppler_shift", "gain"):
        content.add(f"path_{name}", ("path", "times"), getattr(table, name))
    for name in ("departure", "arrival"):
        content.add(f"path_{name}", ("path", "times", "axis"), getattr(table, name))


def _add_metrics(content: Columns, found: Any, taken: set[str]) -> None:
    """Add the metrics that the user's function returned: numbers, arrays, or arrays with own dimensions."""
    if not isinstance(found, dict):
        raise InputError("metrics", f"must return a dict, but returned {found!r:.80}")
    receivers = content.sizes["receiver"]
    for name, value in found.items():
        if not isinstance(name, str) or not name.isidentifier() or name in taken | set(content.variables):
            raise InputError("metrics", f"must return names that are not taken yet, but returned {name!r:.80}")
        if hasattr(value, "to_dataset"):  # of xarray
            content.add_xarray(name, value)
            continue
        array = np.asarray(value)
        if array.dtype.kind not in "biufc":
            raise InputError("metrics", f"must return numbers, but {name} is {value!r:.80}")
        over = [f"{name}_{i}" for i in range(array.ndim)]
        if array.ndim and array.shape[0] == receivers:
            over[0] = "receiver"
        content.add(name, over, array)
    content.attrs["metrics"] = list(found)


def metrics_function(name: str, folder: Path) -> Callable[..., dict[str, Any]]:
    """Return the function ``"module:function"``; a module beside the study file comes before installed ones."""
    module, _, function = name.partition(":")
    file = folder / f"{module}.py"
    try:
        found: Callable[..., dict[str, Any]] = getattr(
            _module(module, file, file.stat().st_mtime_ns if file.exists() else 0), function
        )
    except Exception as error:
        raise InputError("metrics", f"{name!r} cannot be loaded: {type(error).__name__}: {error}") from error
    if not callable(found):
        raise InputError("metrics", f"must be a function, but {name!r} is {found!r:.80}")
    return found


@lru_cache(maxsize=8)
def _module(name: str, file: Path, changed: int) -> Any:
    """Return a module from a file of its own, else the installed one."""
    if not changed:
        return importlib.import_module(name)
    spec = importlib.util.spec_from_file_location(name, file)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


_OF_PAIRS = ("source", "receiver", "times")


def with_parts(
    study: Study, member: Member, planned: PlannedScene, recording: Recording, noise: NoiseModel | None
) -> tuple[Recording, dict[str, NDArray[Any]]]:
    """Return a member's recording with its noise, and all sounds that are kept, by their word in `keep`."""
    # The recording is the sum of its direct sound, what is reverberant, and noise.
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
        warnings.simplefilter("ignore", ClsimWarning)  # the whole sound has warned of the same
        return record(plan_paths(paths, replace(plan.options, duration=duration, tail="off"))).samples


def add_direct_labels(content: Columns, found: DirectPath, planned: PlannedScene) -> None:
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
    for name, (values, units) in columns.items():
        content.add(name, _OF_PAIRS, values, {"units": units})


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


def add_room_measures(content: Columns, planned: PlannedScene) -> None:
    """Add the room's measures at 0 s by octave, as ``room_t20`` and so on."""
    plan = planned.plan
    tail = "off" if plan.options.tail == "off" else "auto"
    rate, seed = plan.sampling_rate, plan.options.tail_seed
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ClsimWarning)  # NaN says the same
        found = room_measures(impulse_responses(planned.paths, rate, tail=tail, tail_seed=seed)).to_xarray()
    frequency = found.coords["frequency"]
    content.add("frequency", "frequency", frequency.values, frequency.attrs)
    for name, values in found.items():
        content.add(f"room_{name}", values.dims, values.values, values.attrs)
