"""One member of a study: found, rendered, judged and written, by whatever process does the work."""

from __future__ import annotations

import json
import os
import shutil
import time
import uuid
import warnings
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import TypeAdapter

from clsim.errors import ClsimWarning, DeviceError, check_packages, in_one_line
from clsim.files.atomic import is_disk_full, naming_full, to_disk, tree_to_disk
from clsim.numerics.blas import with_blas_threads
from clsim.output.columns import write_group
from clsim.output.raw_files import arrays_with_missing_chunks, is_sealed, seal
from clsim.output.stores import STORE_FORMAT
from clsim.study import OF_WORKERS
from clsim.study.content import Computed, computed, metrics_function
from clsim.study.file import Study
from clsim.study.shards import Shards
from clsim.version import __version__
from clsim.workflow.processes import Call, Row, Tasks

STORE = "study.zarr"
INDEX = "index.jsonl"
SETTINGS = "study.json"
PARTIAL = ".partial"
DONE = ("finished", "failed")
ROOT_ATTRIBUTES = {"clsim_store_format": STORE_FORMAT, "clsim_version": __version__}
_STUDY = TypeAdapter(Study)


class MemberTasks(Tasks):
    """The members of a study, as workers do them."""

    kind, several = "member", True
    loads = OF_WORKERS

    def __init__(self, study: Study, folder: Path) -> None:
        render = study.content.get("render", {})
        self._results = results_of(study, folder)
        self.needs_device = render.get("engine", "opencl") == "opencl"
        self._folder, self._device = folder, render.get("device")

    def check(self) -> Call:
        """Return a call of `check_worker`."""
        return check_worker, (str(self._folder), self.needs_device, self._device)

    def call(self, number: int) -> Call:
        """Return a call of `run_member`."""
        return run_member, (str(self._folder), number)

    def found(self, number: int) -> Row | None:
        """Return the row of a member whose results are there."""
        return self._results.row_of(number)

    def failed(self, number: int, error: BaseException) -> Row:
        """Return the row of a member whose call raised an error; a full disk stops all of them."""
        if is_disk_full(error):
            raise error
        return {"member": number, "status": "failed", "error": in_one_line(error), "seconds": 0.0}


def run_member(folder: str, number: int, device: str | None) -> dict[str, Any]:
    """Compute a member and write its results, which appear whole or not at all; return its row of the index."""
    study = _settings(folder)
    member, results = study.members[number], results_of(study, Path(folder))
    found = results.row_of(number)
    if found is not None:  # of a process that died before it could say so
        return found
    begun = time.perf_counter()
    row: dict[str, Any] = {"member": number, "status": "finished", "error": ""}
    with naming_full(Path(folder)), warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("ignore")
        warnings.simplefilter("always", ClsimWarning)
        partial = Path(folder) / PARTIAL / f"{member.name}-{uuid.uuid4().hex}"
        partial.mkdir(parents=True)
        try:
            with with_blas_threads(1):  # on others digits round otherwise, and workers wait for each other
                made = computed(study, member, device, partial)
            row["device"] = made.device
            row["seconds"] = round(time.perf_counter() - begun, 3)
            row["warnings"] = [str(w.message) for w in caught if issubclass(w.category, ClsimWarning)]
            results.write(number, made, row)
        except (Exception, SystemExit) as error:  # of the user's function, too: the others go on
            if is_disk_full(error):
                raise
            if not (isinstance(error, OSError) and results.row_of(number)):  # another worker was faster
                row |= {"status": "failed", "error": in_one_line(error)}
        finally:
            shutil.rmtree(partial, ignore_errors=True)
    row["seconds"] = round(time.perf_counter() - begun, 3)
    row["warnings"] = [str(w.message) for w in caught if issubclass(w.category, ClsimWarning)]
    return row


class Groups:
    """Results of a study in a Zarr store with a group per member."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def _group(self, number: int) -> Path:
        return self._folder / STORE / f"m{number:06d}"

    def holds(self, number: int) -> bool:
        """Test whether a member has results, whole or not."""
        return self._group(number).exists()

    def row_of(self, number: int) -> dict[str, Any] | None:
        """Return the row of a member whose results are there and whole."""
        return row_of_group(self._group(number))

    def discard(self, number: int) -> None:
        """Delete the group of a member; it goes as a whole, so that nobody takes a part of it for all."""
        group = self._group(number)
        if not group.exists():
            return
        gone = self._folder / PARTIAL / f"{group.name}-{uuid.uuid4().hex}"
        gone.parent.mkdir(exist_ok=True)
        group.replace(gone)
        if gone.is_dir():
            shutil.rmtree(gone, ignore_errors=True)
        else:
            gone.unlink()

    def write(self, number: int, made: Computed, row: dict[str, Any]) -> None:
        """Write the results of a member."""
        content = made.content
        content.attrs["study_row"] = json.dumps(row)
        for name, samples in made.sounds.items():
            content.add("sound" if name == "recording" else name, ("receiver", "time"), samples, made.attributes)
        write_group(content, made.group)
        seal(made.group)
        tree_to_disk(made.group)  # the group gets its name when all is on the disk
        target = self._group(number)
        if row_of_group(target) is None:
            self.discard(number)  # what is there is broken
            os.rename(made.group, target)  # noqa: PTH104  (fails where another worker was faster)
        to_disk(target.parent)

    def decided(self, number: int, rows: Mapping[int, Any]) -> None:
        """Note that a member is done with: nothing is to be done."""


def results_of(study: Study, folder: Path) -> Groups | Shards:
    """Return the results of a study in a folder."""
    return Groups(folder) if study.shards is None else Shards(folder, study)


def row_of_group(group: Path) -> dict[str, Any] | None:
    """Return the row that a finished member wrote beside its results; None if they are not there or broken."""
    try:
        metadata = json.loads((group / "zarr.json").read_bytes())
        row = as_row(metadata["attributes"]["study_row"])
        whole = is_sealed(group) and not arrays_with_missing_chunks(group, metadata)
    except (FileNotFoundError, NotADirectoryError, AttributeError, ValueError, KeyError, TypeError, RecursionError):
        return None
    good = whole and row is not None and row["status"] == "finished" and f"m{row['member']:06d}" == group.name
    return row if good else None


def as_row(text: str | bytes) -> dict[str, Any] | None:
    """Return a row of the index from its JSON, or None if it is none."""
    try:
        row = json.loads(text)
    except (ValueError, TypeError, RecursionError):
        return None
    kinds: dict[str, Any] = dict.fromkeys(("status", "error", "device"), str)
    kinds |= {"member": int, "seconds": int | float, "warnings": list}
    if not isinstance(row, dict) or not {"member", "status"} <= row.keys() or row["status"] not in DONE:
        return None
    of_kind = (isinstance(row[n], kind) and not isinstance(row[n], bool) for n, kind in kinds.items() if n in row)
    return row if all(of_kind) and all(isinstance(text, str) for text in row.get("warnings", ())) else None


def check_worker(folder: str, needs_device: bool, device: str | None) -> tuple[str, bool]:
    """Return the reason why a worker cannot work, or an empty text, and whether its device is the reason."""
    from clsim.opencl.device import find_device

    if not (Path(folder) / SETTINGS).exists():
        return f"does not see {folder}: workers on other machines need it under the same path", False
    try:
        study = _settings(folder)
        if study.metrics:
            metrics_function(study.metrics, study.folder)
        if needs_device:
            find_device(device)
    except Exception as error:
        return in_one_line(error), isinstance(error, DeviceError)
    return "", False


def _settings(folder: str) -> Study:
    return _read_settings(folder, (Path(folder) / SETTINGS).stat().st_mtime_ns)


@lru_cache(maxsize=4)
def _read_settings(folder: str, changed: int) -> Study:
    """Return the study of a folder; `changed` makes a file that is another one now be read again."""
    settings = json.loads((Path(folder) / SETTINGS).read_text("utf-8"))
    members = [member | {"number": n} for n, member in enumerate(settings["members"])]
    return _STUDY.validate_python(settings | {"members": members})


def study_to_settings(study: Study) -> dict[str, Any]:
    """Return a study as values for JSON."""
    settings: dict[str, Any] = _STUDY.dump_python(study, mode="json", exclude={"members": {"__all__": {"number"}}})
    return settings


def changed_results(store: Path) -> tuple[list[str], int]:
    """List groups whose metadata and arrays whose chunks have changed or are missing, and count all of both."""
    check_packages("folder", "zarr", "store", "zarr")
    index = store.parent / INDEX
    rows = map(as_row, index.read_bytes().splitlines() if index.is_file() else [])
    members = {store / f"m{row['member']:06d}" for row in rows if row and row["status"] == "finished"}
    groups = {store, *members, *(path for path in store.iterdir() if path.is_dir())}
    sealed = {group for group in groups if is_sealed(group)}
    arrays = {path.parent for group in sealed - {store} for path in group.glob("*/zarr.json")}
    missing = {group / name for group in sealed for name in arrays_with_missing_chunks(group)}
    changed = (groups - sealed) | missing | {path for path in arrays - missing if not _is_readable(path)}
    names = [path.relative_to(store.parent).as_posix() for path in sorted(changed)]
    return names, len(groups | arrays)


def _is_readable(path: Path) -> bool:
    """Test whether all chunks of an array that are there can be read."""
    import zarr

    try:
        found = zarr.open_array(path, mode="r")
        for part in range(found.nchunks):
            place = np.unravel_index(part, found.cdata_shape) if found.cdata_shape else ()
            found.get_block_selection(tuple(map(int, place)))
    except (OSError, ValueError, RuntimeError, KeyError, TypeError, AttributeError):
        return False
    return True
