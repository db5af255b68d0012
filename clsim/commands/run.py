"""`clsim run`: sound, a path table and pictures from a scene file."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from clsim.commands.arguments import add_render_option, add_scene, as_path, as_whole
from clsim.errors import InputError, check_packages
from clsim.files.atomic import safe_path
from clsim.output.result_files import check_table, write_ground_truth, write_table
from clsim.output.stores import check_store, store_kinds
from clsim.scene_file import load_scene
from clsim.scene_file.scene import SceneFile
from clsim.workflow.checkpoint import render_sound, run_identity
from clsim.workflow.console import progress
from clsim.workflow.pipeline import GROUND_TRUTH, RunOutputs, check_table_size, input_files, plan_scene, table_times
from clsim.workflow.result_folder import COMPLETED, ResultFolder
from clsim.workflow.workers import Workers

_OVERRIDES = {  # of the scene file's [render]
    "device": "OpenCL device, by id or part of its name (see `clsim devices`)",
    "engine": "engine, instead of the scene file's",
    "duration": "length, instead of the scene file's",
}


def run_arguments(parser: argparse.ArgumentParser) -> None:
    add_scene(parser)
    parser.add_argument("-o", "--output", type=as_path, required=True, metavar="FOLDER", help="folder of the results")
    parser.add_argument("--force", action="store_true", help="overwrite results that clsim wrote there")
    parser.add_argument("--resume", action="store_true", help="continue an interrupted run, if there is one")
    parser.add_argument(
        "--store",
        choices=tuple(store_kinds()),
        default="wav",
        help="format of the sound: WAV files, Zarr or HDF5 (default: wav)",
    )
    parser.add_argument(
        "--table", choices=("npz", "parquet", "none"), default="npz", help="format of the path table (default: npz)"
    )
    parser.add_argument("--table-rate", type=float, default=100.0, metavar="HZ", help="rows per second (default: 100)")
    parser.add_argument("--no-plots", action="store_true", help="draw no pictures")
    parser.add_argument(
        "--workers", type=as_whole, metavar="N", help="processes of this machine that render (default: this one)"
    )
    parser.add_argument("--scheduler", metavar="ADDRESS", help="Dask scheduler whose workers render instead")
    for name, text in _OVERRIDES.items():
        add_render_option(parser, name, text)


def run(options: argparse.Namespace) -> int:
    """Render a scene file into a folder; return the exit status."""
    workers = _workers(options)
    file = load_scene(options.scene)
    check_store(options.store, [receiver.name for receiver in file.scene.receivers])
    outputs = RunOutputs.of(file, options.store, options.table, pictures=not options.no_plots)
    check_table(outputs.table, "--table")
    if outputs.drawn:
        check_packages("--no-plots", "without it, a run", "pictures", "matplotlib")
    results = ResultFolder(
        options.output, outputs.all(), input_files(options.scene, file), resume=options.resume, force=options.force
    )
    given = {name: getattr(options, name) for name in _OVERRIDES if getattr(options, name) is not None}
    with results.held():
        made = _fill(results, outputs, file.with_render(**given), options, workers)
    if not made:
        print(f"clsim: already finished: all results in {options.output} are as they were written", file=sys.stderr)
    for path in made or [options.output / COMPLETED]:
        print(path)
    return 0


def _workers(options: argparse.Namespace) -> Workers | None:
    """Return who renders, None for this process, once it is sure that they can be reached and can write the store."""
    if options.workers is None and options.scheduler is None:
        return None
    workers = Workers(options.workers, options.scheduler)
    field = "--scheduler" if options.scheduler else "--workers"
    by_regions = [name for name, store in store_kinds().items() if store.by_regions]
    if options.store not in by_regions:
        raise InputError(
            "--store", f"must be {' or '.join(by_regions)} for {field}, written by regions, but is {options.store}"
        )
    workers.check(field, "a run on workers")
    return workers


def _fill(
    results: ResultFolder, outputs: RunOutputs, file: SceneFile, options: argparse.Namespace, workers: Workers | None
) -> list[Path]:
    """Create missing results in a folder; return their paths. Sound comes first: a later failure does not lose it."""
    planned = plan_scene(file, progress)
    paths, plan = planned.paths, planned.plan
    if options.table != "none":
        check_table_size(plan, "--table", "must be none")
    times = table_times(plan, options.table_rate, "--table-rate")
    identity = run_identity(planned) | {"options": {"store": options.store, "table_rate": options.table_rate}}
    sound = planned.stored_sound(results.folder)
    store = store_kinds()[options.store](results.work, sound, outputs.sounds)
    results.begin(identity)
    made = render_sound(results, plan, store, identity, workers)
    changing = bool((paths.start > times[0]).any() or (paths.end <= times[-1]).any())
    missing = [name for name in outputs.beside_sound(changing) if not results.is_whole(name)]
    if outputs.table in missing:
        write_table(planned.path_table(times), results.work / outputs.table)
    if any(name.endswith(".png") for name in missing):
        from clsim.workflow.pictures import draw_pictures  # late: matplotlib takes longer to import than all else

        draw_pictures(planned, times, store, results, outputs, missing)
    if GROUND_TRUTH in missing:
        write_ground_truth(planned.ground_truth(times), results.work / GROUND_TRUTH, planned.echo_truths(times))
    if COMPLETED in missing:
        with safe_path(results.work / COMPLETED) as temporary:
            temporary.write_text(sound.scene, "utf-8")
    return made + results.take(missing, finished=True)
