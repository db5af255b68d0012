"""`clsim check`, `view`, `paths` and `rir`: what a scene file holds, its paths, and responses over them."""

from __future__ import annotations

import argparse
import webbrowser
from itertools import groupby

import numpy as np

from clsim.commands.arguments import add_output, add_scene, as_whole
from clsim.errors import InputError
from clsim.files.atomic import NewFile
from clsim.files.input_files import shown
from clsim.impulse_responses import TAILS, as_response_band, impulse_responses
from clsim.numerics.quaternions import rotate
from clsim.output.result_files import check_table, response_names, write_response_sounds, write_responses, write_table
from clsim.paths.path_set import PathSet
from clsim.paths.path_table import view_scene
from clsim.paths.without_edges import largest_jump_db
from clsim.scene.directivity.patterns import Omni
from clsim.scene.motion.trajectory import Trajectory
from clsim.scene.placement import through_walls
from clsim.scene.scene import Scene, shaded_pairs
from clsim.scene_file import load_scene
from clsim.scene_file.scene import SceneFile
from clsim.tail.design import SCATTERINGS, left_by_images
from clsim.workflow.console import progress
from clsim.workflow.pipeline import find_scene_paths, input_files, plan_scene, shares

_INSTANTS = 10_001  # of a motion at which its speed is looked at


def check_arguments(parser: argparse.ArgumentParser) -> None:
    add_scene(parser)


def check(options: argparse.Namespace) -> int:
    """Print the content of a scene file; return the exit status."""
    file = load_scene(options.scene)
    for line in file.scene.describe():  # before the search, which may take long or give up
        print(line, flush=True)
    if file.paths["diffraction"]:
        print(*file.scene.room.edges().describe(), *_thin(file), sep="\n", flush=True)
    print(*_facing(file.scene), sep="\n", flush=True)
    planned = plan_scene(file, progress)
    scene, plan = file.scene, planned.plan
    if not scene.room.is_convex or scene.bodies:
        print(*_comings_and_goings(planned.paths, file.paths["diffraction"]), sep="\n")
    left = left_by_images(planned.paths, plan.sampling_rate) if plan.options.tail == "off" else None
    # Rays replace the estimate of the plan's note.
    of_plan = [line for line in plan.describe() if left is None or not line.startswith("images leave")]
    if left is not None:
        remedy = ' (tail = "auto" adds it)' if left > -20.0 else ""
        of_plan.append(f"images leave {left:.0f} dB of the energy: higher orders, and what walls scatter{remedy}")
    shaded = [*shaded_pairs(scene, plan.duration), *_unshaded(planned.paths, file.paths.get("scattering_order", 0))]
    for line in [*shaded, *through_walls(scene.room, scene.named_scatterers()), *of_plan]:
        print(line)
    for field, item in [*scene.named_ends(), *scene.named_scatterers(), *scene.named_bodies()]:
        for note in [*_motion(item.trajectory), *item.trajectory.notes]:
            print(f"{field}.trajectory: {note}")
    print("the scene file is valid")
    return 0


def _unshaded(paths: PathSet, order: int) -> list[str]:
    """Return a line about echoes of so many walls that scatterers cast no shadow on them, if there are any."""
    if not any(scatterer.shape.shadows for scatterer in paths.scene.scatterers):
        return []
    count = sum(int(np.count_nonzero(family.order > order)) for family in paths.families if family.is_specular)
    return [f"no shadows: on {count} echoes of more than {order} walls (scattering_order)"] if count else []


def _motion(trajectory: Trajectory) -> list[str]:
    """Return duration and speed of a motion from a file, which reveal wrong units."""
    if not trajectory.notes:
        return []
    t = np.linspace(trajectory.start, trajectory.end, _INSTANTS)
    length = np.linalg.norm(np.diff(trajectory.position(t), axis=0), axis=1).sum()
    speed = np.linalg.norm(trajectory.velocity(t), axis=1).max()
    return [f"{length:.3g} m in {trajectory.end - trajectory.start:.4g} s, at most {speed:.3g} m/s"]


def _facing(scene: Scene) -> list[str]:
    """Return the directions in which sources and receivers face at 0 s, neighbours that face alike in one line."""
    rows = []
    for field, end in scene.named_ends():
        axis = rotate(end.orientation(np.zeros(1)), (1.0, 0.0, 0.0))[0].round(3) + 0.0
        kind = ", omnidirectional" if isinstance(end.directivity, Omni) else ""
        rows.append((field, f"faces ({', '.join(f'{x:g}' for x in axis)}) at 0 s{kind}"))
    lines = []
    for (_, direction), group in groupby(rows, lambda row: (row[0].partition("[")[0], row[1])):
        fields = [field for field, _ in group]
        lines.append(f"{' to '.join(dict.fromkeys((fields[0], fields[-1])))}: {direction}")
    return lines


def _thin(file: SceneFile) -> list[str]:
    """Return notes on panels with two edges within two wavelengths, where paths bend round one edge alone."""
    if file.paths["diffraction"] > 1:
        return []
    lowest = min(source.emitted.centre_frequency for source in file.scene.sources)
    wavelengths = 2.0 * file.scene.air.speed_of_sound / lowest
    return [
        f"{name} of {1e3 * thickness:.3g} mm: silent behind, as its edges are two (diffraction = 2), and thinner than "
        f"two wavelengths, {1e3 * wavelengths:.3g} mm: a sheet does as well (sheets_below = {wavelengths:.2g})"
        for name, thickness in file.scene.room.as_mesh().thin_panels(wavelengths)
    ]


def _comings_and_goings(paths: PathSet, diffraction: int) -> list[str]:
    """Report paths that begin and end, and without edges the largest jump of the pressure there."""
    always = np.isneginf(paths.start) & np.isposinf(paths.end)
    others = np.column_stack([paths.source, paths.receiver, paths.objects])[~always]
    count = len(np.unique(others, axis=0))
    lines = [
        f"paths: {always.sum() + count}, of which {always.sum()} are active all the time "
        f"and {count} in intervals ({len(others)} of them; the same walls in another order are another path)"
    ]
    jump = None if diffraction else largest_jump_db(paths)
    if jump is not None:
        jumps = f"paths begin and end at edges: the pressure jumps by up to {jump:.1f} dB of the strongest path"
        lines.append(f"{jumps}; paths over edges make it continuous (diffraction = 1)")
    return lines


_MOST_FRAMES = 10_000
_MOST_PATHS = 100_000  # drawn at a time


def view_arguments(parser: argparse.ArgumentParser) -> None:
    add_scene(parser)
    add_output(parser, "the page (default: beside the scene file)")
    parser.add_argument(
        "--frames", type=as_whole, default=120, metavar="N", help="instants to choose from (default: 120)"
    )
    parser.add_argument("--limit", type=as_whole, default=300, metavar="N", help="strongest paths drawn (default: 300)")
    parser.add_argument("--open", action="store_true", help="open it in a browser")


def view(options: argparse.Namespace) -> int:
    """Write the page; return the exit status."""
    for name, most in (("frames", _MOST_FRAMES), ("limit", _MOST_PATHS)):
        if not 1 <= getattr(options, name) <= most:
            raise InputError(f"--{name}", f"must be 1 to {most}, but is {getattr(options, name)}")
    file = load_scene(options.scene)
    named = options.output or options.scene.with_suffix(".html")
    page = NewFile(named, input_files(options.scene, file), options.force)
    planned = plan_scene(file, progress)
    with progress("drawing", options.frames) as advance:
        view_scene(
            planned.paths, page.ready(), title=shown(options.scene.stem), duration=planned.plan.duration,
            frames=options.frames, limit=options.limit, progress=advance,
            motion=planned.plan.options.motion, amplitude=planned.plan.options.amplitude,
        )  # fmt: skip
    print(page.path)
    if options.open:
        webbrowser.open(page.path.resolve().as_uri())
    return 0


def paths_arguments(parser: argparse.ArgumentParser) -> None:
    add_scene(parser)
    parser.add_argument("--at", type=float, default=0.0, metavar="SECONDS", help="time of reception (default: 0)")
    parser.add_argument("--limit", type=as_whole, default=40, metavar="ROWS", help="paths listed at most (default: 40)")
    add_output(parser, "write all of them to a .npz or .parquet file")


def paths(options: argparse.Namespace) -> int:
    """List paths, or write them to a file; return the exit status."""
    if options.limit < 0:
        raise InputError("--limit", f"must be at least 0, but is {options.limit}")
    file = load_scene(options.scene)
    target = None
    if options.output is not None:
        target = NewFile(options.output, input_files(options.scene, file), options.force)
        check_table(str(target.path), "--output")
    planned = plan_scene(file, progress)
    duration = planned.plan.duration
    if not 0.0 <= options.at <= duration:
        raise InputError("--at", f"must lie within the recording, 0 to {duration:g} s, but is {options.at:g} s")
    table = planned.path_table(np.array([options.at]))
    if target is not None:
        write_table(table, target.ready())
        print(target.path)
        return 0
    rows = np.argsort(table.delay[:, 0], kind="stable")
    rows = rows[np.isfinite(table.delay[rows, 0])]  # those that are there
    head = f"{'receiver':<16} {'source':<16} {'order':>5} {'delay (ms)':>11} {'gain (dB)':>10}"
    print(f"{head} {'doppler factor':>14}  objects")
    for p in rows[: options.limit]:
        gain = f"{20 * np.log10(abs(table.gain[p, 0])):.1f}" if table.audible[p, 0] else "silent"
        objects = table.name_objects(p)
        print(
            f"{table.receiver_names[table.receiver[p]]:<16} {table.source_names[table.source[p]]:<16} "
            f"{table.order[p]:>5} {table.delay[p, 0] * 1e3:>11.4f} {gain:>10} "
            f"{table.doppler_factor[p, 0]:>14.6f}  {objects}"
        )
    if len(rows) > options.limit:
        print(f"and {len(rows) - options.limit} more (--limit)")
    return 0


_FIELDS = {"band[0]": "--band", "band[1]": "--band", "path": "--output", "tail_seed": "--tail-seed"}
_FIELDS |= {name: f"--{name}" for name in ("at", "band", "tail")}
# Of what is meant as a file, where WAV files need a folder.
_ENDINGS_OF_FILES = ("npz", "sofa", "wav", "mat", "h5", "hdf5", "csv", "txt", "flac", "json", "parquet")


def rir_arguments(parser: argparse.ArgumentParser) -> None:
    add_scene(parser)
    text = "a folder for a WAV file per source and receiver, or a .npz or .sofa file"
    add_output(parser, text, required=True, metavar="PATH")
    parser.add_argument("--at", type=float, default=0.0, metavar="SECONDS", help="time of reception (default: 0)")
    parser.add_argument(
        "--format", choices=("wav", "npz", "sofa"), help="default: by the ending of the output, else wav"
    )
    parser.add_argument(
        "--band", type=float, nargs=2, metavar=("LOW", "HIGH"),
        help="band of exact responses, Hz (default: 0 to 0.95 of half the sampling rate)",
    )  # fmt: skip
    parser.add_argument(
        "--lead", choices=("cut", "keep"), default="cut",
        help="ringing before time 0: cut, so that sample 0 is time 0 (default), or kept",
    )  # fmt: skip
    parser.add_argument(
        "--tail", choices=TAILS, default="auto",
        help="energy beyond the images as a diffuse tail: auto (default), in closed rooms and below 40 kHz, or off",
    )  # fmt: skip
    parser.add_argument(
        "--tail-scattering", choices=SCATTERINGS, default=SCATTERINGS[0],
        help="size (default): walls of the tail also scatter by their limited size; material: by their materials alone",
    )  # fmt: skip
    parser.add_argument(
        "--tail-seed", type=as_whole, default=0, metavar="N", help="of the tail's rays and noise (default: 0)"
    )


def rir(options: argparse.Namespace) -> int:
    """Write impulse responses to files; return the exit status."""
    kind = _kind(options)
    file = load_scene(options.scene)
    rate = file.render["sampling_rate"]
    read = input_files(options.scene, file)
    sounds = response_names([s.name for s in file.scene.sources], [r.name for r in file.scene.receivers])
    files = [options.output / name for name in sounds] if kind == "wav" else [options.output]
    targets = [NewFile(path, read, options.force, new_folder=kind == "wav") for path in files]
    try:
        as_response_band(rate, options.band)  # before paths are searched for
        paths = find_scene_paths(file, progress)
        with progress("impulse responses", 1.0) as advance:
            found = impulse_responses(
                paths, rate, options.at, options.band, lead=options.lead, tail=options.tail,
                tail_seed=options.tail_seed, tail_scattering=options.tail_scattering, progress=shares(advance),
            )  # fmt: skip
        made = [target.ready() for target in targets]
        if kind == "wav":
            write_response_sounds(found, options.output)
        else:
            write_responses(found, options.output)
    except InputError as error:
        raise InputError(_FIELDS.get(error.field, error.field), error.problem) from error
    for path in made:
        print(path)
    count = found.samples.shape[2]
    print(f"{count} samples at {rate:g} Hz, exact from {found.band[0]:g} to {found.band[1]:g} Hz")
    for line in found.describe():
        print(line)
    return 0


def _kind(options: argparse.Namespace) -> str:
    """Return the format: as given, by the output's ending, or WAV files in a folder."""
    ending = options.output.suffix.removeprefix(".")
    kind: str = options.format or (ending if ending in ("npz", "sofa") else "wav")
    if kind != "wav" and ending != kind:
        raise InputError("--output", f"must end in .{kind}, but is {options.output}")
    if kind == "wav" and (ending.lower() in _ENDINGS_OF_FILES or options.output.is_file()):
        raise InputError("--output", f"must be a folder for WAV files, but is {options.output}")
    return kind
