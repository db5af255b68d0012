"""`clsim run`: sound, a path table and pictures from a scene file."""

from __future__ import annotations

import sys
import warnings
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.commands.console import progress
from clsim.commands.planning import path_table, planned
from clsim.commands.unfinished import Unfinished, run_identity
from clsim.errors import ClsimWarning, InputError
from clsim.output.atomic import safe_path
from clsim.output.envelope_plot import envelope_spectrogram
from clsim.output.names import file_names
from clsim.output.plots import echogram, history, spectrogram
from clsim.output.stores import StoredSound, sound_store
from clsim.output.table import write_table, write_truth
from clsim.render.memory import within_memory
from clsim.scene_file import completed_scene, load_scene

if TYPE_CHECKING:
    import argparse
    from pathlib import Path

    from clsim.output.levels import Readable
    from clsim.paths.path_set import PathSet
    from clsim.render.plan import Plan

_LARGEST_TABLE = 2_000_000  # paths times instants
_MOST_DRAWN = 16  # receivers
_MOST_INSTANTS = 3000  # of lines in a picture, more than it has columns


def execute(options: argparse.Namespace) -> int:
    """Render a scene file into a folder; return the exit status."""
    folder: Path = options.output
    unfinished = Unfinished(folder)
    unfinished.check(options)
    file = load_scene(options.scene)
    paths, plan = planned(file, _overrides(options))
    times = _table_times(plan, options)
    resolved = {**_overrides(options), "duration": plan.duration, "chunk": plan.chunk}
    text = completed_scene(file, folder, **resolved)
    if options.resume and unfinished.already_whole(text):
        print(folder / "scene.toml")
        return 0
    names = file_names(plan.tracks.receiver_names)
    identity = run_identity(file, paths, plan, {"store": options.store})
    with unfinished.opened() as place:
        store = sound_store(options.store, place, _stored(paths, plan, text), names)
        with within_memory(plan.largest_field, "rendering", plan.memory_bytes):
            unfinished.render(plan, store, identity)
        made = unfinished.move(store)
        if options.table != "none":
            made.append(folder / f"paths.{options.table}")
            write_table(path_table(paths, plan, times), made[-1])
        made.append(folder / "truth.npz")
        write_truth(paths, times, plan.tracks.motion, made[-1])  # type: ignore[attr-defined]
        if not options.no_plots:
            drawn = range(min(len(names), _MOST_DRAWN))
            made += _draw(plan, paths, times, [store.row(folder, r) for r in drawn], folder, names[: len(drawn)])
            if len(drawn) < len(names):
                print(f"pictures are of the first {_MOST_DRAWN} receivers of {len(names)}", file=sys.stderr)
        made.append(folder / "scene.toml")
        with safe_path(made[-1]) as temporary:
            temporary.write_text(text, "utf-8")
    for path in made:
        print(path)
    return 0


def _stored(paths: PathSet, plan: Plan, text: str) -> StoredSound:
    """Return what a store says of the sound."""
    import clsim

    positions = np.concatenate([r.trajectory.position(np.zeros(1)) for r in paths.scene.receivers])
    return StoredSound(
        plan.tracks.receiver_names, plan.units, positions, plan.sampling_rate, plan.samples, plan.chunk, text,
        clsim.__version__, plan.carrier,
    )  # fmt: skip


def _overrides(options: argparse.Namespace) -> dict[str, Any]:
    """Return what the command line says instead of the scene file's ``[render]``."""
    names = ("device", "engine", "duration")
    return {name: getattr(options, name) for name in names if getattr(options, name) is not None}


def _table_times(plan: Plan, options: argparse.Namespace) -> Any:
    """Return the times of table and truth; fewer than asked where the table would grow beyond all use."""
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


def _draw(plan: Plan, paths: PathSet, times: Any, sounds: list[Readable], folder: Path, names: list[str]) -> list[Path]:
    """Draw a spectrogram and an echogram for each receiver; return their paths."""
    made: list[Path] = []
    changing = bool(np.any((paths.start > times[0]) | (paths.end <= times[-1])))
    drawn = times[np.linspace(0, len(times) - 1, min(len(times), _MOST_INSTANTS)).round().astype(int)]
    with progress("drawing", len(names)) as advance:
        for r, (sound, name) in enumerate(zip(sounds, names, strict=True)):
            heard = paths.heard_by(r)
            if changing:
                made.append(folder / f"{name}_paths.png")
                history(path_table(heard, plan, drawn), r, made[-1])
            made += [folder / f"{name}_spectrogram.png", folder / f"{name}_echogram.png"]
            title = plan.tracks.receiver_names[r]
            rate = plan.sampling_rate
            if plan.carrier is None:
                spectrogram(sound, rate, made[-2], title=title, band=_shown_band(plan), unit=plan.units[r])
            else:
                envelope_spectrogram(sound[0 : plan.samples], rate, plan.carrier, made[-2], title=title)
            echogram(path_table(heard, plan, times[:1]), r, 0, made[-1])
            advance(1)
    return made


def _shown_band(plan: Plan) -> tuple[float, float]:
    """Return the frequencies worth showing: those that hold nearly all energy, with a margin for Doppler."""
    low: float = np.inf
    high: float = 0.0
    for emission in plan.emissions:
        frequencies, energy = emission.signal.energy_spectrum()
        share = np.cumsum(energy) / max(float(energy.sum()), 1e-300)
        low = min(low, float(frequencies[np.searchsorted(share, 1e-3)]))
        high = max(high, float(frequencies[np.minimum(np.searchsorted(share, 1.0 - 1e-3), len(frequencies) - 1)]))
    margin = max(0.15 * (high - low), 3.0 * plan.max_rate * high, 200.0)
    return max(0.0, float(low) - margin), min(0.5 * plan.sampling_rate, float(high) + margin)
