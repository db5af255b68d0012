"""One member of a study: found, rendered, judged and written, by whatever process does the work."""

from __future__ import annotations

import errno
import importlib
import importlib.util
import json
import os
import shutil
import sys
import time
import uuid
import warnings
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.errors import ClsimWarning, DeviceError, InputError, in_one_line
from clsim.files.atomic import to_disk, tree_to_disk
from clsim.output.stores import STORE_FORMAT, consolidate, texts
from clsim.study.file import TAKEN, Member, Study
from clsim.version import __version__

if TYPE_CHECKING:
    from collections.abc import Callable

    from clsim.cluster.dispatch import Call, Row
    from clsim.paths.ground_truth import DirectPath
    from clsim.paths.path_table import PathTable
    from clsim.recording import Recording
    from clsim.scene.scene import Scene

STORE = "study.zarr"
SETTINGS = "study.json"
_OF_RECEPTION = {"units": "s", "long_name": "time of reception"}
PARTIAL = ".partial"
DONE = ("finished", "failed")
_DISK_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


class MemberTasks:
    """The members of a study, as workers do them.

    Parameters
    ----------
    study : Study
        Which.
    folder : Path
        Where its results go.
    """

    kind, several = "member", True

    def __init__(self, study: Study, folder: Path) -> None:
        render = study.content.get("render", {})
        self.needs_device = render.get("engine", "opencl") == "opencl"
        self._folder, self._device = folder, render.get("device")

    def check(self) -> Call:
        """Return a call of `check_worker`."""
        return check_worker, (str(self._folder), self.needs_device, self._device)

    def call(self, number: int) -> Call:
        """Return a call of `run_member`."""
        return run_member, (str(self._folder), number)

    def found(self, number: int) -> Row | None:
        """Return the row of a member whose group is in the store."""
        return row_of_group(self._folder / STORE / f"m{number:06d}")

    def failed(self, number: int, error: BaseException) -> Row:
        """Return the row of a member whose call raised an error; a full disk stops all of them."""
        if is_disk_full(error):
            raise error
        return {"member": number, "status": "failed", "error": in_one_line(error), "seconds": 0.0}

    def over(self) -> None:
        """Let workers be: a group appears whole or not at all."""


def run_member(folder: str, number: int, device: str | None) -> dict[str, Any]:
    """Compute a member and write its group into the study's store; return its row of the index.

    A member whose group is there already is not computed again: it was finished by a process that died before it could
    say so. The group appears whole or not at all.

    Raises
    ------
    OSError
        If the disk is full: then all others would fail too. Whatever else goes wrong is said in the row.
    """
    study = _settings(folder)
    member = study.members[number]
    target = Path(folder) / STORE / member.name
    found = row_of_group(target)
    if found is not None:
        return found
    begun = time.perf_counter()
    row: dict[str, Any] = {"member": number, "status": "finished", "error": ""}
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("ignore")
        warnings.simplefilter("always", ClsimWarning)
        try:
            content, row["device"] = _computed(study, member, device)
            row["seconds"] = round(time.perf_counter() - begun, 3)
            row["warnings"] = [str(w.message) for w in caught if issubclass(w.category, ClsimWarning)]
            content.attrs["study_row"] = json.dumps(row)
            _write(content, Path(folder), target)
        except (Exception, SystemExit) as error:  # of the user's function, too: the others go on
            if is_disk_full(error):
                raise
            row |= {"status": "failed", "error": in_one_line(error)}
    row["seconds"] = round(time.perf_counter() - begun, 3)
    row["warnings"] = [str(w.message) for w in caught if issubclass(w.category, ClsimWarning)]
    return row


def row_of_group(group: Path) -> dict[str, Any] | None:
    """Return the row that a finished member wrote beside its results; None if they are not there or broken."""
    try:
        metadata = json.loads((group / "zarr.json").read_bytes())
        arrays = metadata["consolidated_metadata"]["metadata"]
        row = as_row(metadata["attributes"]["study_row"])
        whole = all((group / name / "zarr.json").exists() for name in arrays)
    except (FileNotFoundError, NotADirectoryError, ValueError, KeyError, TypeError, RecursionError):
        return None
    good = whole and row is not None and row["status"] == "finished" and f"m{row['member']:06d}" == group.name
    return row if good else None


def as_row(text: str | bytes) -> dict[str, Any] | None:
    """Return a row of the index from its JSON, or None if it is none."""
    try:
        row = json.loads(text)
    except (ValueError, TypeError, RecursionError):
        return None
    kinds: dict[str, Any] = {
        "member": int,
        "status": str,
        "seconds": (int, float),
        "error": str,
        "device": str,
        "warnings": list,
    }
    if not isinstance(row, dict) or not {"member", "status"} <= row.keys() or row["status"] not in DONE:
        return None
    if any(
        name in row and (not isinstance(row[name], kind) or isinstance(row[name], bool)) for name, kind in kinds.items()
    ):
        return None
    return row if all(isinstance(text, str) for text in row.get("warnings", ())) else None


def check_worker(folder: str, needs_device: bool, device: str | None) -> tuple[str, bool]:
    """Return what keeps a worker from doing its work, or an empty text, and whether that is its device."""
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


def is_disk_full(error: BaseException) -> bool:
    """Return whether an error is one that all other members would meet, too."""
    return isinstance(error, OSError) and error.errno in _DISK_FULL


def _settings(folder: str) -> Study:
    path = Path(folder) / SETTINGS
    return _read_settings(folder, path.stat().st_mtime_ns)


@lru_cache(maxsize=4)
def _read_settings(folder: str, changed: int) -> Study:
    """Return the study of a folder; `changed` makes a file that is another one now be read again."""
    return settings_to_study(json.loads((Path(folder) / SETTINGS).read_text("utf-8")))


def study_to_settings(study: Study) -> dict[str, Any]:
    """Return a study as what JSON holds."""
    members = [{"parameters": m.parameters, "changes": m.changes} for m in study.members]
    return {
        "content": study.content, "base": str(study.base), "folder": str(study.folder), "keep": list(study.keep),
        "metrics": study.metrics, "table_rate": study.table_rate, "members": members,
    }  # fmt: skip


def settings_to_study(settings: dict[str, Any]) -> Study:
    """Return the study again."""
    members = tuple(Member(n, **member) for n, member in enumerate(settings["members"]))
    return Study(
        settings["content"], Path(settings["base"]), Path(settings["folder"]), tuple(settings["keep"]),
        settings["metrics"], settings["table_rate"], members,
    )  # fmt: skip


def metrics_function(name: str, folder: Path) -> Callable[..., dict[str, Any]]:
    """Return the function ``"module:function"``; a module beside the study file comes before installed ones.

    Raises
    ------
    InputError
        If there is none, or its module fails.
    """
    module, _, function = name.partition(":")
    file = folder / f"{module}.py"
    try:
        found: Callable[..., dict[str, Any]] = getattr(
            _module(module, file, file.stat().st_mtime_ns if file.exists() else 0), function
        )
    except Exception as error:
        raise InputError("metrics", f"{name!r} cannot be loaded: {type(error).__name__}: {error}") from error
    if not callable(found):
        raise InputError("metrics", f"must be a function, but {name!r} is {found!r:.80}")
    return found


@lru_cache(maxsize=8)
def _module(name: str, file: Path, changed: int) -> Any:
    """Return a module from a file of its own, else the installed one."""
    if not changed:
        return importlib.import_module(name)
    spec = importlib.util.spec_from_file_location(name, file)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


def _computed(study: Study, member: Member, device: str | None) -> tuple[Any, str]:
    """Return all that is kept of a member, an xarray Dataset, and the device that made it."""
    from clsim.opencl.device import find_device
    from clsim.scene_file.scene import build_scene
    from clsim.workflow.checkpoint import run_identity
    from clsim.workflow.pipeline import plan_scene

    file = build_scene(study.content_of(member), study.base)
    planned = plan_scene(file if device is None else file.on_device(device))
    recording = planned.record()
    sound = planned.stored_sound(study.base)
    content = sound.coordinates()
    content.attrs |= {
        "parameters": json.dumps(member.parameters), "identity": json.dumps(run_identity(planned)),
    }  # fmt: skip
    if "recording" in study.keep:
        content["sound"] = (("receiver", "time"), recording.samples, sound.sound_attributes)
    times = _instants(study.table_rate, recording)
    if "ground_truth" in study.keep:
        _add_ground_truth(content, planned.ground_truth(times), planned.paths.scene)
    if "paths" in study.keep:
        _add_paths(content, planned.path_table(times))
    if study.metrics:
        function = metrics_function(study.metrics, study.folder)
        metrics = function(recording, planned.paths, dict(member.parameters))
        _add_metrics(content, metrics, {*TAKEN, *member.parameters})
    if planned.plan.options.engine != "opencl":
        return content, ""
    used, _ = find_device(planned.plan.options.device)
    return content, f"{used.id} {used.name}"


def _instants(rate: float, recording: Recording) -> Any:
    count = int(recording.samples.shape[1] / recording.sampling_rate * rate) + 1
    return np.arange(count) / rate


def _add_ground_truth(content: Any, found: DirectPath, scene: Scene) -> None:
    over = ("source", "receiver", "times")
    content.coords["times"] = ("times", found.times, _OF_RECEPTION)
    content.coords["source"] = texts(s.name for s in scene.sources)
    content["delay"] = (over, found.delay, {"units": "s"})
    content["doppler_factor"] = (over, found.doppler_factor)
    content["line_of_sight"] = (over, found.line_of_sight)
    content["radial_speed"] = (over, found.radial_speed, {"units": "m/s", "long_name": "positive where they part"})


def _add_paths(content: Any, table: PathTable) -> None:
    content.coords["times"] = ("times", table.times, _OF_RECEPTION)
    for name in ("source", "receiver", "order", "direct"):
        content[f"path_{name}"] = ("path", getattr(table, name))
    content["path_interactions"] = (("path", "interaction"), table.interactions)
    content["path_objects"] = (("path", "interaction"), table.objects, {"names": list(table.object_names)})
    for name in ("delay", "doppler_factor", "doppler_shift", "gain"):
        content[f"path_{name}"] = (("path", "times"), getattr(table, name))
    for name in ("departure", "arrival"):
        content[f"path_{name}"] = (("path", "times", "axis"), getattr(table, name))


def _add_metrics(content: Any, found: Any, taken: set[str]) -> None:
    """Add what the user's function returned: numbers, arrays, or arrays with dimensions of their own.

    Raises
    ------
    InputError
        If it is no dict of such.
    """
    import xarray

    if not isinstance(found, dict):
        raise InputError("metrics", f"must return a dict, but returned {found!r:.80}")
    receivers = content.sizes["receiver"]
    for name, value in found.items():
        if not isinstance(name, str) or not name.isidentifier() or name in taken | set(content.variables):
            raise InputError("metrics", f"must return names that are not taken yet, but returned {name!r:.80}")
        if isinstance(value, xarray.DataArray):
            content[name] = value
            continue
        array = np.asarray(value)
        if array.dtype.kind not in "biufc":
            raise InputError("metrics", f"must return numbers, but {name} is {value!r:.80}")
        over = [f"{name}_{i}" for i in range(array.ndim)]
        if array.ndim and array.shape[0] == receivers:
            over[0] = "receiver"
        content[name] = (over, array)
    content.attrs["metrics"] = list(found)


def _write(content: Any, folder: Path, target: Path) -> None:
    """Write a group under another name, and give it its own when all is on the disk."""
    partial = folder / PARTIAL / f"{target.name}-{uuid.uuid4().hex}"
    partial.parent.mkdir(exist_ok=True)
    try:
        encoding = {"sound": {"chunks": (1, content.sizes["time"])}} if "sound" in content else {}
        content.to_zarr(partial, mode="w-", consolidated=False, zarr_format=3, encoding=encoding)
        consolidate(partial)
        tree_to_disk(partial)
        if row_of_group(target) is None:
            discard(target)  # what is there is broken
            os.rename(partial, target)  # noqa: PTH104  (fails where another worker was faster)
        to_disk(target.parent)
    except OSError:
        if row_of_group(target) is None:
            raise
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def discard(group: Path) -> None:
    """Delete the group of a member; it goes as a whole, so that nobody takes a part of it for all."""
    if not group.exists():
        return
    gone = group.parents[1] / PARTIAL / f"{group.name}-{uuid.uuid4().hex}"
    gone.parent.mkdir(exist_ok=True)
    group.replace(gone)
    if gone.is_dir():
        shutil.rmtree(gone, ignore_errors=True)
    else:
        gone.unlink()


def root_attributes() -> dict[str, Any]:
    """Return what stands at the root of a study's store."""
    return {"clsim_store_format": STORE_FORMAT, "clsim_version": __version__}
