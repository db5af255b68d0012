"""`clsim verify`: whether results are still what was written."""

from __future__ import annotations

import argparse

from clsim.commands.arguments import as_path
from clsim.errors import InputError
from clsim.study import member as studies
from clsim.study import shards
from clsim.workflow import result_folder as runs


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("folder", type=as_path, help="results of clsim run or clsim study")


def execute(options: argparse.Namespace) -> int:
    """Print the results that have changed; return the exit status, 1 if there are any."""
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
