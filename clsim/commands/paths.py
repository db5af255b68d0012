"""`clsim paths`: the paths of a scene file at one instant."""

from __future__ import annotations

import argparse

import numpy as np

from clsim.commands.arguments import add_output, add_scene, as_whole
from clsim.errors import InputError
from clsim.files.atomic import NewFile
from clsim.output.result_files import check_table, write_table
from clsim.scene_file import load_scene
from clsim.workflow.console import progress
from clsim.workflow.pipeline import input_files, plan_scene


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_scene(parser)
    parser.add_argument("--at", type=float, default=0.0, metavar="SECONDS", help="time of reception (default: 0)")
    parser.add_argument("--limit", type=as_whole, default=40, metavar="ROWS", help="paths listed at most (default: 40)")
    add_output(parser, "write all of them to a .npz or .parquet file")


def execute(options: argparse.Namespace) -> int:
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
