"""`clsim study`: a scene rendered many times, by processes that start while this one still loads its modules."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from clsim.commands.arguments import as_path, as_whole
from clsim.study import OF_WORKERS
from clsim.workflow.console import progress
from clsim.workflow.processes import start_server

_SHOWN = 10  # failed members that are printed


def study_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("study", type=Path, help="study file (TOML)")
    parser.add_argument("-o", "--output", type=as_path, required=True, metavar="FOLDER", help="folder of the results")
    parser.add_argument("--resume", action="store_true", help="continue a study that was stopped or killed")
    parser.add_argument("--retry", action="store_true", help="continue, and repeat failed members")
    parser.add_argument(
        "--limit", type=as_whole, default=1000, metavar="N", help="largest number of members (default: 1000)"
    )
    parser.add_argument(
        "--workers", type=as_whole, metavar="N", help="processes (default: one per GPU, else per two cores)"
    )
    parser.add_argument("--scheduler", metavar="ADDRESS", help="Dask scheduler whose workers do the work instead")


def study(options: argparse.Namespace) -> int:
    """Run the study; return the exit status, 1 if members failed."""
    if options.scheduler is None:
        start_server(OF_WORKERS)  # while this process loads what it needs itself
    from clsim.study.run import run_study

    rows = run_study(
        options.study, options.output, resume=options.resume, retry=options.retry, limit=options.limit,
        workers=options.workers, scheduler=options.scheduler, progress=progress,
    )  # fmt: skip
    results = "shards" if (options.output / "shards").exists() else "study.zarr"
    failed = [row for row in rows if row.status == "failed"]
    for row in failed[:_SHOWN]:
        print(f"clsim: member {row.member} failed: {row.error}", file=sys.stderr)
    if len(failed) > _SHOWN:
        print(f"clsim: and {len(failed) - _SHOWN} more", file=sys.stderr)
    print(f"{len(rows) - len(failed)} of {len(rows)} members finished in {options.output / results}")
    print(options.output / "index.jsonl")
    return 1 if failed else 0
