"""`clsim study`: one scene file rendered many times with other values of some of its fields."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from clsim.study.run import run_study
from clsim.workflow.console import progress

if TYPE_CHECKING:
    import argparse

_SHOWN = 10  # failed members that are told


def execute(options: argparse.Namespace) -> int:
    """Run the study; return the exit status, 1 if members failed."""
    rows = run_study(
        options.study, options.output, resume=options.resume, retry=options.retry, limit=options.limit,
        workers=options.workers, scheduler=options.scheduler, progress=progress,
    )  # fmt: skip
    failed = [row for row in rows if row.status == "failed"]
    for row in failed[:_SHOWN]:
        print(f"clsim: member {row.member} failed: {row.error}", file=sys.stderr)
    if len(failed) > _SHOWN:
        print(f"clsim: and {len(failed) - _SHOWN} more", file=sys.stderr)
    print(f"{len(rows) - len(failed)} of {len(rows)} members finished in {options.output / 'study.zarr'}")
    print(options.output / "index.jsonl")
    return 1 if failed else 0
