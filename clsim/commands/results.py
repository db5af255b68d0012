"""`clsim score` and `verify`: ranges found in results, and whether results are as written."""

from __future__ import annotations

import argparse
import csv

import numpy as np

from clsim.commands.arguments import add_output, as_path
from clsim.errors import InputError
from clsim.files.atomic import NewFile, atomic_path
from clsim.scene_file import load_scene
from clsim.score.ranging import METHODS, RangingScore, ranging, source_index
from clsim.workflow import result_folder as runs
from clsim.workflow.load_recording import load_recording
from clsim.workflow.result_folder import COMPLETED

_COLUMNS = ("delay", "exact", "error", "crlb", "line_of_sight")


def score_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("folder", type=as_path, help="results of clsim run")
    parser.add_argument("--source", metavar="NAME", help="source of the pulses (default: the first)")
    parser.add_argument("--method", choices=METHODS, default="matched-filter", help="default: matched-filter")
    parser.add_argument("--max-range", type=float, metavar="M", help="largest range at which pulses are sought, m")
    add_output(parser, "CSV file with one row per range")


def score(options: argparse.Namespace) -> int:
    """Print the scores; return the exit status."""
    target = None if options.output is None else NewFile(options.output, [], options.force)
    recording = load_recording(options.folder, paths=True)
    assert recording.paths is not None
    try:
        source = source_index(recording.paths, 0 if options.source is None else options.source)
        score = ranging(
            recording, recording.paths.scene.sources[source].signal.pulse, options.method, source=source,
            max_range=options.max_range, motion=load_scene(options.folder / COMPLETED).render["motion"],
        )  # fmt: skip
    except InputError as error:
        raise InputError(f"--{error.field.replace('_', '-')}", error.problem) from error
    sources = recording.paths.scene.sources
    if len(sources) > 1:
        print(f"pulses of {sources[source].name!r}, one of {len(sources)} sources (--source)")
    print(f"{'receiver':<16} {'found':>7} {'in sight':>9} {'outliers':>9} {'median (mm)':>12} {'75 % (mm)':>11}")
    for r, name in enumerate(score.receiver_names):
        print(_row(name, score, slice(r, r + 1)))
    print(_row("all", score, slice(None)))
    if target is not None:
        _write_scores(score, target)
        print(target.path)
    return 0


def _row(name: str, score: RangingScore, rows: slice) -> str:
    """Return a line of the table."""
    error = np.abs(score.error[rows])
    found = error[np.isfinite(error)]
    seen = float(np.mean(score.line_of_sight[rows]))
    head = f"{name:<16} {100 * len(found) / error.size:>5.1f} % {100 * seen:>7.1f} %"
    if not len(found):
        return f"{head} {'-':>9} {'-':>12} {'-':>11}"
    half, most = (1e3 * np.percentile(found, p) for p in (50, 75))
    return f"{head} {100 * float(np.mean(found >= score.outlier)):>7.1f} % {half:>12.3f} {most:>11.3f}"


def _write_scores(score: RangingScore, target: NewFile) -> None:
    with atomic_path(target.ready()) as temporary, temporary.open("w", encoding="utf-8", newline="") as out:
        writer = csv.writer(out)
        writer.writerow(("receiver", "emission", "emission_time", *_COLUMNS))
        for r, name in enumerate(score.receiver_names):
            for k, time in enumerate(score.emission_times.tolist()):
                writer.writerow((name, k, time, *(getattr(score, column)[r, k].item() for column in _COLUMNS)))


def verify_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("folder", type=as_path, help="results of clsim run or clsim study")


def verify(options: argparse.Namespace) -> int:
    """Print the results that have changed; return the exit status, 1 if there are any."""
    from clsim.study import member as studies
    from clsim.study import shards

    folder = options.folder
    record = runs.load_record(folder, "folder")
    if record.files:
        changed, count = runs.changed_results(folder, record), len(record.files)
    elif (folder / studies.STORE).is_dir():
        changed, count = studies.changed_results(folder / studies.STORE)
    elif (folder / shards.FOLDER).is_dir():
        changed, count = shards.changed_shards(folder)
    else:
        raise InputError("folder", f"must hold results of clsim run or clsim study, but {folder} does not")
    for name in changed:
        print(f"{folder / name}: has changed since it was written, or is missing")
    print(f"{count - len(changed)} of {count} results are as they were written")
    return int(bool(changed))
