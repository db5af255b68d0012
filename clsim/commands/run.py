"""`clsim run`: sound, a path table and pictures from a scene file."""

from __future__ import annotations

import sys
import warnings
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.commands.arguments import add_scene, as_path
from clsim.commands.outputs import COMPLETED, GROUND_TRUTH, MOST_DRAWN, RunOutputs, picture
from clsim.errors import ClsimWarning, InputError
from clsim.files.atomic import safe_path
from clsim.output.envelope_plot import envelope_spectrogram
from clsim.output.plots import echogram_picture, history_picture, spectrogram_picture
from clsim.output.stores import KINDS, StoredSound, check_store, sound_store
from clsim.output.table import check_table, write_ground_truth, write_table
from clsim.render.memory import within_memory
from clsim.scene_file import completed_scene, load_scene
from clsim.version import __version__
from clsim.workflow.checkpoint import render_sound, run_identity
from clsim.workflow.console import progress
from clsim.workflow.pipeline import path_table, planned, read_files
from clsim.workflow.result_folder import ResultFolder

if TYPE_CHECKING:
    import argparse
    from pathlib import Path

    from clsim.arrays import Floats
    from clsim.output.spectrogram import Readable
    from clsim.output.stores import SoundStore
    from clsim.paths.path_set import PathSet
    from clsim.render.plan import Plan
    from clsim.scene_file import SceneFile

_LARGEST_TABLE = 2_000_000  # paths times instants
_MOST_INSTANTS = 3000  # of lines in a picture, more than it has columns


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    add_scene(parser)
    parser.add_argument("-o", "--output", type=as_path, required=True, metavar="FOLDER", help="where the results go")
    parser.add_argument(
        "--force", action="store_true", help="put others in the place of results that clsim wrote there"
    )
    parser.add_argument("--resume", action="store_true", help="go on with a run that was killed, if there is one")
    parser.add_argument(
        "--store", choices=KINDS, default="wav", help="format of the sound: WAV files, Zarr or HDF5 (default: wav)"
    )
    parser.add_argument(
        "--table", choices=("npz", "parquet", "none"), default="npz", help="format of the path table (default: npz)"
    )
    parser.add_argument("--table-rate", type=float, default=100.0, metavar="HZ", help="rows per second (default: 100)")
    parser.add_argument("--no-plots", action="store_true", help="draw no pictures")
    parser.add_argument("--device", help="OpenCL device, by id or part of its name (see `clsim devices`)")
    parser.add_argument("--engine", choices=("opencl", "reference"), help="instead of the scene file's")
    parser.add_argument("--duration", type=float, metavar="SECONDS", help="instead of the scene file's")


def execute(options: argparse.Namespace) -> int:
    """Render a scene file into a folder; return the exit status."""
    file = load_scene(options.scene)
    check_store(options.store, [receiver.name for receiver in file.scene.receivers])
    outputs = RunOutputs.of(file, options)
    check_table(outputs.table, "--table")
    results = ResultFolder(
        options.output, outputs.all(), read_files(options.scene, file), resume=options.resume, force=options.force
    )
    with results.held():
        made = _fill(results, outputs, file, options)
    if not made:
        print(f"clsim: nothing was missing: all results in {options.output} are as they were written", file=sys.stderr)
    for path in made or [options.output / COMPLETED]:
        print(path)
    return 0


def _fill(results: ResultFolder, outputs: RunOutputs, file: SceneFile, options: argparse.Namespace) -> list[Path]:
    """Make what is missing in a folder; return its paths. Sound is moved there first: what fails later costs none."""
    paths, plan = planned(file, _overrides(options))
    times = _table_times(plan, options)
    resolved = {**_overrides(options), "duration": plan.duration, "chunk": plan.chunk}
    text = completed_scene(file, results.folder, **resolved)
    identity = run_identity(file, paths, plan, {"store": options.store, "table_rate": options.table_rate})
    store = sound_store(options.store, results.work, _stored(paths, plan, text), outputs.receivers)
    results.begin(identity)
    with within_memory(plan.largest_field, "rendering", plan.memory_bytes):
        made = render_sound(results, plan, store, identity)
    changing = bool((paths.start > times[0]).any() or (paths.end <= times[-1]).any())
    missing = [name for name in outputs.beside_sound(changing) if not results.is_whole(name)]
    if outputs.table in missing:
        write_table(path_table(paths, plan, times), results.work / outputs.table)
    if any(name.endswith(".png") for name in missing):
        _draw(plan, paths, times, store, results, outputs, missing)
    if GROUND_TRUTH in missing:
        write_ground_truth(paths, times, plan.options.motion, results.work / GROUND_TRUTH)
    if COMPLETED in missing:
        with safe_path(results.work / COMPLETED) as temporary:
            temporary.write_text(text, "utf-8")
    return made + results.take(missing, finished=True)


def _stored(paths: PathSet, plan: Plan, text: str) -> StoredSound:
    """Return what a store says of the sound."""
    positions = np.concatenate([r.trajectory.position(np.zeros(1)) for r in paths.scene.receivers])
    return StoredSound(
        plan.tracks.receiver_names, plan.units, positions, plan.sampling_rate, plan.samples, plan.chunk, text,
        __version__, plan.carrier,
    )  # fmt: skip


def _overrides(options: argparse.Namespace) -> dict[str, Any]:
    """Return what the command line says instead of the scene file's ``[render]``."""
    names = ("device", "engine", "duration")
    return {name: getattr(options, name) for name in names if getattr(options, name) is not None}


def _table_times(plan: Plan, options: argparse.Namespace) -> Any:
    """Return the times of table and ground truth; fewer than asked where the table would grow beyond all use."""
    rate = options.table_rate
    if not 0.0 < rate <= plan.sampling_rate:
        raise InputError("--table-rate", f"must be above 0 and at most {plan.sampling_rate:g} Hz, but is {rate:g} Hz")
    if options.table != "none" and 2 * plan.path_count > _LARGEST_TABLE:
        raise InputError(
            "--table",
            f"must be none for more than {_LARGEST_TABLE // 2} paths, but is {options.table} for {plan.path_count}",
        )
    count = int(plan.duration * rate) + 1
    most = max(2, _LARGEST_TABLE // max(plan.path_count, 1))
    if count > most:
        warnings.warn(
            f"--table-rate: {plan.path_count} paths at {rate:g} Hz are too much for one table; "
            f"{most} instants are written, {most / plan.duration:.3g} a second",
            ClsimWarning,
            stacklevel=2,
        )
    return np.linspace(0.0, (count - 1) / rate, min(count, most))


def _draw(
    plan: Plan,
    paths: PathSet,
    times: Floats,
    store: SoundStore,
    results: ResultFolder,
    outputs: RunOutputs,
    missing: list[str],
) -> None:
    """Draw the missing pictures; one that fails is a warning, and the others are drawn."""
    left_out = len(outputs.receivers) - len(outputs.drawn)
    if left_out:
        print(f"pictures are of the first {MOST_DRAWN} receivers of {len(outputs.receivers)}", file=sys.stderr)
    with progress("drawing", len(outputs.drawn)) as advance:
        for r, name in enumerate(outputs.drawn):
            for kind in ("paths", "spectrogram", "echogram"):
                wanted = picture(name, kind)
                if wanted not in missing:
                    continue
                try:
                    _draw_one(kind, plan, paths, times, store.row(results.folder, r), r, results.work / wanted)
                except Exception as error:  # of whatever draws: the sound is there
                    told = " ".join(str(error).split())[:300] or type(error).__name__
                    warnings.warn(f"{wanted} could not be drawn: {told}", ClsimWarning, stacklevel=2)
            advance(1)


def _draw_one(kind: str, plan: Plan, paths: PathSet, times: Floats, sound: Readable, r: int, path: Path) -> None:
    title, rate = plan.tracks.receiver_names[r], plan.sampling_rate
    if kind == "paths":
        drawn = times[np.linspace(0, len(times) - 1, min(len(times), _MOST_INSTANTS)).round().astype(int)]
        history_picture(path_table(paths.heard_by(r), plan, drawn), r, path)
    elif kind == "echogram":
        echogram_picture(path_table(paths.heard_by(r), plan, times[:1]), r, 0, path)
    elif plan.carrier is None:
        spectrogram_picture(sound, rate, path, title=title, band=_shown_band(plan), unit=plan.units[r])
    else:
        envelope_spectrogram(sound[0 : plan.samples], rate, plan.carrier, path, title=title)


def _shown_band(plan: Plan) -> tuple[float, float]:
    """Return the frequencies worth showing: those that hold nearly all energy, with a margin for Doppler."""
    low: float = np.inf
    high: float = 0.0
    for filters in plan.source_filters:
        frequencies, energy = filters.signal.energy_spectrum()
        share = np.cumsum(energy) / max(float(energy.sum()), 1e-300)
        low = min(low, float(frequencies[np.searchsorted(share, 1e-3)]))
        high = max(high, float(frequencies[np.minimum(np.searchsorted(share, 1.0 - 1e-3), len(frequencies) - 1)]))
    margin = max(0.15 * (high - low), 3.0 * plan.max_rate * high, 200.0)
    return max(0.0, float(low) - margin), min(0.5 * plan.sampling_rate, float(high) + margin)
