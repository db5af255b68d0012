"""The command line."""

from __future__ import annotations

import argparse
import json
import os
import re
import sys
import time
import warnings
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.errors import ClsimError, ClsimWarning, InputError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from clsim.paths.path_set import PathSet
    from clsim.paths.path_table import PathTable
    from clsim.render.plan import Plan
    from clsim.scene_file import SceneFile

_LARGEST_TABLE = 2_000_000  # paths times instants
_PATIENCE = 2.0  # s after which progress is shown


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; return the exit status: 0, 2 for an error, 130 when interrupted."""
    options = _parser().parse_args(arguments)
    try:
        with _one_line_warnings():
            command: Callable[[argparse.Namespace], int] = options.command
            status = command(options)
            sys.stdout.flush()
            return status
    except BrokenPipeError:  # who reads has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except (ClsimError, OSError) as error:
        print(f"clsim: error: {' '.join(str(error).split())}", file=sys.stderr)
        return 2
    except MemoryError:
        print("clsim: error: not enough memory; choose a smaller [render] chunk or max_order", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("clsim: interrupted; nothing half-written was left", file=sys.stderr)
        return 130


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="clsim", description="Simulate what receivers hear in a room while sources and receivers move."
    )
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    run = _command(commands, "run", _run, "render a scene file into a folder of sound files, tables and pictures")
    run.add_argument("-o", "--output", type=Path, required=True, metavar="FOLDER", help="where the results go")
    run.add_argument("--force", action="store_true", help="write over results that are already there")
    run.add_argument(
        "--table",
        choices=("npz", "parquet", "none"),
        default="npz",
        help="format of the path table (default: npz)",
    )
    run.add_argument("--table-rate", type=float, default=100.0, metavar="HZ", help="rows per second (default: 100)")
    run.add_argument("--no-plots", action="store_true", help="draw no pictures")
    run.add_argument("--device", help="OpenCL device, by id or part of its name (see `clsim devices`)")
    run.add_argument("--engine", choices=("opencl", "reference"), help="instead of the scene file's")
    run.add_argument("--duration", type=float, metavar="SECONDS", help="instead of the scene file's")

    _command(commands, "check", _check, "check a scene file and say what would be computed")

    paths = _command(commands, "paths", _paths, "list the paths of a scene file")
    paths.add_argument("--at", type=float, default=0.0, metavar="SECONDS", help="time of reception (default: 0)")
    paths.add_argument("--limit", type=int, default=40, metavar="ROWS", help="paths listed at most (default: 40)")
    paths.add_argument("-o", "--output", type=Path, metavar="FILE", help="write all of them to a .npz or .parquet file")

    view = _command(commands, "view", _view, "write an interactive page: room, motion, and the paths over time")
    view.add_argument("-o", "--output", type=Path, metavar="FILE", help="the page (default: beside the scene file)")
    view.add_argument("--frames", type=int, default=120, metavar="N", help="instants to choose from (default: 120)")
    view.add_argument("--limit", type=int, default=300, metavar="N", help="strongest paths drawn (default: 300)")
    view.add_argument("--open", action="store_true", help="open it in a browser")

    devices = commands.add_parser("devices", help="list the OpenCL devices of this machine")
    devices.set_defaults(command=_devices)
    schema = commands.add_parser("schema", help="print the JSON schema of scene files, for editors")
    schema.set_defaults(command=_schema)
    return parser


def _command(commands: Any, name: str, command: Callable[[argparse.Namespace], int], text: str) -> Any:
    parser = commands.add_parser(name, help=text, description=text[0].upper() + text[1:] + ".")
    parser.add_argument("scene", type=Path, help="scene file (TOML)")
    parser.set_defaults(command=command)
    return parser


def _run(options: argparse.Namespace) -> int:
    from clsim.output.atomic import atomic_path
    from clsim.scene_file import completed_scene

    file = _loaded(options.scene)
    paths, plan = _planned(file, _overrides(options))
    folder: Path = options.output
    names = _file_names(plan.tracks.receiver_names)
    if not options.force and (folder / "scene.toml").exists():
        raise InputError(
            "--output", f"must hold no results yet, but {folder / 'scene.toml'} exists (--force writes over)"
        )
    folder.mkdir(parents=True, exist_ok=True)
    sounds = [folder / f"{name}.wav" for name in names]
    _write_sounds(plan, sounds)
    made = [*sounds]
    table = _table(paths, plan, _table_times(plan, options.table_rate))
    if options.table != "none":
        from clsim.output.table import write_table

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


def _check(options: argparse.Namespace) -> int:
    from clsim.scene.mesh_diagnosis import diagnose, diagnose_ends
    from clsim.scene.mesh_room import MeshRoom

    file = _loaded(options.scene)
    room = file.scene.room
    if isinstance(room, MeshRoom):  # before the search, which may take long or give up
        for line in [*diagnose(room, file.model.room.common_scale()), *diagnose_ends(file.scene)]:
            print(line, flush=True)
    paths, plan = _planned(file, {})
    for line in [*([_comings_and_goings(paths)] if isinstance(room, MeshRoom) else []), *plan.describe()]:
        print(line)
    for field, item in file.scene.named_ends():
        for note in item.trajectory.notes:
            print(f"{field}.trajectory: {note}")
    print("the scene file is valid")
    return 0


def _comings_and_goings(paths: PathSet) -> str:
    always = np.isneginf(paths.start) & np.isposinf(paths.end)
    others = np.column_stack([paths.source, paths.receiver, paths.walls])[~always]
    count = len(np.unique(others, axis=0))
    return (
        f"paths: {always.sum() + count}, of which {always.sum()} are heard all the time "
        f"and {count} come and go ({len(others)} intervals; the same walls in another order are another path)"
    )


def _view(options: argparse.Namespace) -> int:
    import webbrowser

    from clsim.output.view import view_scene

    for name in ("frames", "limit"):
        if getattr(options, name) < 1:
            raise InputError(f"--{name}", f"must be at least 1, but is {getattr(options, name)}")
    paths, plan = _planned(_loaded(options.scene), {})
    page: Path = options.output or options.scene.with_suffix(".html")
    with _progress("drawing", options.frames) as advance:
        view_scene(
            paths, page, duration=plan.duration, frames=options.frames, limit=options.limit, title=options.scene.stem,
            motion=plan.tracks.motion, amplitude=plan.tracks.amplitude, progress=advance,  # type: ignore[attr-defined]
        )  # fmt: skip
    print(page)
    if options.open:
        webbrowser.open(page.resolve().as_uri())
    return 0


def _paths(options: argparse.Namespace) -> int:
    from clsim.output.table import write_table

    paths, plan = _planned(_loaded(options.scene), {})
    if not 0.0 <= options.at <= plan.duration:
        raise InputError("--at", f"must lie within the recording, 0 to {plan.duration:g} s, but is {options.at:g} s")
    table = _table(paths, plan, np.array([options.at]))
    if options.output is not None:
        write_table(table, options.output)
        print(options.output)
        return 0
    rows = np.argsort(table.delay[:, 0], kind="stable")
    rows = rows[np.isfinite(table.delay[rows, 0])]  # those that are heard
    print(f"{'receiver':<16} {'source':<16} {'order':>5} {'delay (ms)':>11} {'gain (dB)':>10} {'doppler':>9}  walls")
    most = max(options.limit, 0)
    for p in rows[:most]:
        gain = 20 * np.log10(max(abs(table.gain[p, 0]), 1e-30))
        walls = ", ".join(table.wall_names[w] for w in table.walls[p] if w >= 0) or "direct"
        print(
            f"{table.receiver_names[table.receiver[p]]:<16} {table.source_names[table.source[p]]:<16} "
            f"{table.order[p]:>5} {table.delay[p, 0] * 1e3:>11.4f} {gain:>10.1f} {table.doppler[p, 0]:>9.6f}  {walls}"
        )
    if len(rows) > most:
        print(f"and {len(rows) - most} more (--limit)")
    return 0


def _devices(options: argparse.Namespace) -> int:
    from clsim.errors import DeviceError
    from clsim.opencl.device import INSTALL, list_devices

    found = list_devices()
    if not found:
        raise DeviceError(f"no OpenCL device: {INSTALL}")
    for info in found:
        tracks = "float64" if info.fp64 else "no float64: the host computes the tracks, which is slower"
        print(
            f"{info.id}  {info.name}  ({info.kind}, {info.platform}, {info.compute_units} units, "
            f"{info.memory_bytes / 2**30:.1f} GiB, {tracks})"
        )
    return 0


def _schema(options: argparse.Namespace) -> int:
    from clsim.scene_file import scene_schema

    print(json.dumps(scene_schema(), indent=1))
    return 0


def _overrides(options: argparse.Namespace) -> dict[str, Any]:
    """Return what the command line says instead of the scene file's ``[render]``."""
    names = ("device", "engine", "duration")
    return {name: getattr(options, name) for name in names if getattr(options, name) is not None}


def _loaded(path: Path) -> SceneFile:
    from clsim.scene_file import load_scene

    return load_scene(path)


def _planned(file: SceneFile, overrides: dict[str, Any]) -> tuple[PathSet, Plan]:
    from clsim.paths.find_paths import find_paths
    from clsim.render.plan import plan_render

    search = file.paths | {name: overrides[name] for name in ("engine", "device") if name in overrides}
    try:
        with _progress("finding paths", 1.0) as advance:
            done = 0.0

            def report(share: float) -> None:
                nonlocal done
                advance(share - done)
                done = share

            paths = find_paths(file.scene, **search, progress=report)
    except InputError as error:
        raise error.within("paths") from error
    for i in np.setdiff1d(np.arange(len(file.scene.receivers)), paths.receiver):
        name = file.scene.receivers[i].name
        warnings.warn(f"receivers[{i}]: no path reaches {name!r}; it will hear nothing", ClsimWarning, stacklevel=2)
    try:
        return paths, plan_render(file.scene, paths, **(file.render | overrides))
    except InputError as error:
        raise error.within("render") from error


def _write_sounds(plan: Plan, sounds: list[Path]) -> None:
    """Render into one file per receiver, piece by piece; none of them appears before all are whole."""
    from clsim.output.wav import WavWriter
    from clsim.render.render import render_chunks

    work = plan.path_count * plan.samples
    with ExitStack() as stack:
        writers = [stack.enter_context(WavWriter(path, plan.sampling_rate, samples=plan.samples)) for path in sounds]
        with _progress("rendering", work) as advance:
            for _, pressure in render_chunks(plan):
                for writer, samples in zip(writers, pressure, strict=True):
                    writer.write(samples)
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


def _table(paths: PathSet, plan: Plan, times: Any) -> PathTable:
    return paths.table(times, plan.tracks.motion, plan.tracks.amplitude)  # type: ignore[attr-defined]


def _draw(plan: Plan, table: PathTable, sounds: list[Path], folder: Path, names: list[str]) -> list[Path]:
    """Draw a spectrogram and an echogram for each receiver; return their paths."""
    from clsim.output.plots import echogram, history, spectrogram

    made = []
    with _progress("drawing", len(names)) as advance:
        for r, (sound, name) in enumerate(zip(sounds, names, strict=True)):
            made += [folder / f"{name}_spectrogram.png", folder / f"{name}_echogram.png"]
            if not bool(np.isfinite(table.delay).all()):
                made.append(folder / f"{name}_paths.png")
                history(table, r, made[-1])
                made[-3:] = made[-1:] + made[-3:-1]
            title = plan.tracks.receiver_names[r]
            spectrogram(
                _SoundFile(sound), plan.sampling_rate, made[-2], title=title, band=_shown_band(plan), unit=plan.units[r]
            )
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


class _SoundFile:
    """Samples of a mono sound file, read where they are cut."""

    def __init__(self, path: Path) -> None:
        import soundfile

        self._path = path
        self._count = int(soundfile.info(path).frames)

    def __len__(self) -> int:
        return self._count

    def __getitem__(self, part: slice) -> Any:
        import soundfile

        return soundfile.read(self._path, start=part.start, stop=part.stop, dtype="float32")[0]


def _file_names(receivers: tuple[str, ...]) -> list[str]:
    """Return names that any file system takes, each once."""
    names: list[str] = []
    for receiver in receivers:
        name = base = re.sub(r"[^A-Za-z0-9_-]+", "_", receiver).strip("_") or "receiver"
        count = 2
        while name.lower() in (n.lower() for n in names):
            name, count = f"{base}-{count}", count + 1
        names.append(name)
    return names


@contextmanager
def _progress(what: str, total: float) -> Iterator[Callable[[float], None]]:
    """Yield a function that advances a bar on a terminal, shown once the work has taken two seconds."""
    if not sys.stderr.isatty():
        yield lambda amount: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    bar = Progress(
        TextColumn("{task.description}"), BarColumn(), TextColumn("{task.percentage:3.0f} %"),
        TextColumn("{task.fields[rate]}"), TimeRemainingColumn(), console=Console(stderr=True), transient=True,
    )  # fmt: skip
    task = bar.add_task(what, total=total, rate="")
    begun = time.monotonic()
    shown = False

    def advance(amount: float) -> None:
        nonlocal shown
        bar.advance(task, amount)
        spent = time.monotonic() - begun
        done = bar.tasks[0].completed
        bar.update(task, rate=f"{done / max(spent, 1e-3) / 1e9:.2f}e9 path-samples/s" if total > 1e6 else "")
        if spent > _PATIENCE and not shown:
            bar.start()
            shown = True

    try:
        yield advance
    finally:
        if shown:
            bar.stop()


@contextmanager
def _one_line_warnings() -> Iterator[None]:
    """Print each of clsim's warnings once, on one line."""
    seen: set[str] = set()

    def show(message: Any, *_: Any, **__: Any) -> None:
        text = " ".join(str(message).split())
        if text not in seen:
            seen.add(text)
            print(f"clsim: warning: {text}", file=sys.stderr)

    with warnings.catch_warnings():
        warnings.simplefilter("always", ClsimWarning)
        warnings.showwarning = show
        yield


if __name__ == "__main__":
    sys.exit(main())
