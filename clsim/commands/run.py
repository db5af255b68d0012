"""`clsim run`: sound files, a path table and pictures from a scene file."""

from __future__ import annotations

import re
import warnings
from contextlib import ExitStack
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.commands.console import progress
from clsim.commands.planning import path_table, planned
from clsim.errors import ClsimWarning, InputError
from clsim.output.atomic import atomic_path
from clsim.output.envelope_plot import envelope_spectrogram
from clsim.output.plots import echogram, history, spectrogram
from clsim.output.table import write_table
from clsim.output.wav import EnvelopeFile, SoundFile, WavWriter, as_frames
from clsim.render.render import render_chunks
from clsim.scene_file import completed_scene, load_scene

if TYPE_CHECKING:
    import argparse
    from pathlib import Path

    from clsim.paths.path_table import PathTable
    from clsim.render.plan import Plan

_LARGEST_TABLE = 2_000_000  # paths times instants


def execute(options: argparse.Namespace) -> int:
    """Render a scene file into a folder; return the exit status."""
    file = load_scene(options.scene)
    paths, plan = planned(file, _overrides(options))
    folder: Path = options.output
    names = file_names(plan.tracks.receiver_names)
    if not options.force and (folder / "scene.toml").exists():
        raise InputError(
            "--output", f"must hold no results yet, but {folder / 'scene.toml'} exists (--force writes over)"
        )
    folder.mkdir(parents=True, exist_ok=True)
    sounds = [folder / f"{name}.wav" for name in names]
    _write_sounds(plan, sounds)
    made = [*sounds]
    table = path_table(paths, plan, _table_times(plan, options.table_rate))
    if options.table != "none":
        made.append(folder / f"paths.{options.table}")
        write_table(table, made[-1])
    if not options.no_plots:
        made += _draw(plan, table, sounds, folder, names)
    made.append(folder / "scene.toml")
    resolved = {**_overrides(options), "duration": plan.duration, "chunk": plan.chunk}
    with atomic_path(made[-1]) as temporary:
        temporary.write_text(completed_scene(file, folder, **resolved), "utf-8")
    for path in made:
        print(path)
    return 0


def _overrides(options: argparse.Namespace) -> dict[str, Any]:
    """Return what the command line says instead of the scene file's ``[render]``."""
    names = ("device", "engine", "duration")
    return {name: getattr(options, name) for name in names if getattr(options, name) is not None}


def _write_sounds(plan: Plan, sounds: list[Path]) -> None:
    """Render into one file per receiver, piece by piece; none of them appears before all are whole."""
    work = plan.path_count * plan.samples
    with ExitStack() as stack:
        channels = 1 if plan.baseband is None else 2
        writers = [stack.enter_context(WavWriter(path, plan.sampling_rate, channels, plan.samples)) for path in sounds]
        with progress("rendering", work) as advance:
            for _, pressure in render_chunks(plan):
                for writer, samples in zip(writers, pressure, strict=True):
                    writer.write(as_frames(samples[None]))
                advance(plan.path_count * pressure.shape[1])


def _table_times(plan: Plan, rate: float) -> Any:
    """Return the table's times; fewer than asked where the table would grow beyond all use."""
    if not 0.0 < rate <= plan.sampling_rate:
        raise InputError("--table-rate", f"must be above 0 and at most {plan.sampling_rate:g} Hz, but is {rate:g} Hz")
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


def _draw(plan: Plan, table: PathTable, sounds: list[Path], folder: Path, names: list[str]) -> list[Path]:
    """Draw a spectrogram and an echogram for each receiver; return their paths."""
    made = []
    with progress("drawing", len(names)) as advance:
        for r, (sound, name) in enumerate(zip(sounds, names, strict=True)):
            made += [folder / f"{name}_spectrogram.png", folder / f"{name}_echogram.png"]
            if not bool(np.isfinite(table.delay).all()):
                made.append(folder / f"{name}_paths.png")
                history(table, r, made[-1])
                made[-3:] = made[-1:] + made[-3:-1]
            title = plan.tracks.receiver_names[r]
            if plan.baseband is None:
                read, rate, band = SoundFile(sound), plan.sampling_rate, _shown_band(plan)
                spectrogram(read, rate, made[-2], title=title, band=band, unit=plan.units[r])
            else:
                carrier, rate = plan.baseband.carrier, plan.sampling_rate
                envelope_spectrogram(EnvelopeFile(sound)[0 : plan.samples], rate, carrier, made[-2], title=title)
            echogram(table, r, 0, made[-1])
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


def file_names(receivers: tuple[str, ...]) -> list[str]:
    """Return names that any file system takes, each once."""
    names: list[str] = []
    for receiver in receivers:
        name = base = re.sub(r"[^A-Za-z0-9_-]+", "_", receiver).strip("_") or "receiver"
        count = 2
        while name.lower() in (n.lower() for n in names):
            name, count = f"{base}-{count}", count + 1
        names.append(name)
    return names
