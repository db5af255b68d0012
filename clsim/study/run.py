"""Running a study on processes of this machine or on the workers of any Dask scheduler."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from contextlib import closing, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clsim.cluster.workers import Workers
from clsim.errors import InputError
from clsim.files.atomic import locked, safe_path
from clsim.version import __version__
from clsim.workflow.console import no_progress

if TYPE_CHECKING:
    from clsim.cluster.dispatch import Dispatch
    from clsim.study.file import Study
    from clsim.study.index import Index, MemberRow
    from clsim.study.member import MemberTasks
    from clsim.workflow.console import Progress


def run_study(
    path: str | os.PathLike[str],
    output: str | os.PathLike[str],
    *,
    resume: bool = False,
    retry: bool = False,
    limit: int | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    progress: Progress | None = None,
) -> tuple[MemberRow, ...]:
    """Render a scene many times with other values of some of its fields.

    Parameters
    ----------
    path : path-like
        Of the study file.
    output : path-like
        Folder for the store ``study.zarr``, with a group per member and a group ``summary``, and the index
        ``index.jsonl``.
    resume : bool
        Go on with the same study in this folder: members that are finished are not run again.
    retry : bool
        The same, and run members that failed again.
    limit : int, optional
        Largest number of members, 1000 when left out.
    workers : int, optional
        Processes on this machine: one per GPU, else one per two cores when left out.
    scheduler : str, optional
        Address of a running Dask scheduler, for example ``"tls://10.0.0.1:8786"``, instead; its workers must see the
        output folder under the same path.
    progress : callable, optional
        Called with a text and a total for each stage of the work; returns a context manager that yields a function
        to be called with every amount of work that is done.

    Returns
    -------
    tuple of MemberRow
        What became of every member.

    Raises
    ------
    InputError
        If the study file, or a member's scene, breaks a rule; nothing was run then.
    DeviceError
        If a worker has no OpenCL device.
    OSError
        If the disk is full; what is finished stays.
    ClsimError
        If the scheduler is lost, or workers do not come back; what is finished stays.

    Notes
    -----
    Processes are started anew, so scripts call this behind ``if __name__ == "__main__":``. A worker that dies is
    replaced, and what it was at is done by another; a member whose workers go on dying fails, and no other one with it.
    What the store holds counts: a member counts as finished when its group is there, and groups appear whole.
    """
    progress = progress or no_progress
    doing = Workers(workers, scheduler)
    doing.check("study", "a study")
    from clsim.cluster.dispatch import Dispatch
    from clsim.study.content import metrics_function
    from clsim.study.file import DEFAULT_LIMIT, checked, load_study
    from clsim.study.index import Index, write_summary
    from clsim.study.member import PARTIAL, STORE, MemberTasks

    study = load_study(path, DEFAULT_LIMIT if limit is None else limit)
    folder = Path(output).absolute()
    new = not (resume or retry)
    if new:
        _refuse_begun(folder)
    with progress("checking scenes", len(study.members)) as advance:
        files = checked(study, advance)
    if study.metrics:
        metrics_function(study.metrics, study.folder)
    folder.mkdir(parents=True, exist_ok=True)
    with locked(folder / ".lock", "--output"):
        begun = _begin(study, files, folder, new)
        index = Index(folder, study.members)
        dispatch = Dispatch(index.todo(retry))
        try:
            index.rewrite()
            _run(MemberTasks(study, folder), dispatch, index, doing, progress)
        except BaseException as error:
            if any((folder / STORE / member.name).exists() for member in study.members):
                error.add_note(f"what is finished is kept in {folder}: --resume goes on with it")
            elif begun and index.untouched and (scheduler is None or not dispatch.begun):
                _undo(folder)
            raise
        write_summary(folder, index)
        index.rewrite()
        shutil.rmtree(folder / PARTIAL, ignore_errors=True)
    return tuple(index.rows[n] for n in sorted(index.rows))


def _refuse_begun(folder: Path) -> None:
    """See that a folder holds no study, and nothing else of the names that one takes."""
    from clsim.study.index import INDEX
    from clsim.study.member import PARTIAL, SETTINGS, STORE

    if (folder / SETTINGS).exists():
        raise InputError(
            "--output", f"must hold no study yet, but {folder} does (--resume goes on, --retry also with what failed)"
        )
    for name in (STORE, INDEX, PARTIAL):
        if os.path.lexists(folder / name):
            raise InputError("--output", f"must not hold {name} that is of no study, but {folder} does")


def _begin(study: Study, files: set[Path], folder: Path, new: bool) -> bool:
    """Make the folder of a study, or see that it holds this very one; return whether it was made."""
    from clsim.study.index import create_store
    from clsim.study.member import PARTIAL, SETTINGS, study_to_settings

    if new or not (folder / SETTINGS).exists():
        _refuse_begun(folder)  # another process may have made it meanwhile
    settings = study_to_settings(study) | {"made_by": _made_by(study, files)}
    path = folder / SETTINGS
    begun = not path.exists()
    if begun:
        with safe_path(path) as temporary:
            temporary.write_text(json.dumps(settings, indent=1), "utf-8")
    else:
        _check_same(path, json.loads(json.dumps(settings)))
    create_store(folder)
    shutil.rmtree(folder / PARTIAL, ignore_errors=True)
    (folder / PARTIAL).mkdir()
    return begun


def _check_same(path: Path, settings: dict[str, Any]) -> None:
    from clsim.workflow.journal import first_difference

    try:
        old = json.loads(path.read_bytes())
    except (ValueError, RecursionError) as error:
        raise InputError("--resume", f"must go on with a study, but {path} is broken; choose another folder") from error
    difference = first_difference(old, settings)
    if difference is not None:
        raise InputError("--resume", f"must go on with the same study, but {difference}; choose another folder")


def _undo(folder: Path) -> None:
    """Delete what `_begin` made, because nothing could be run: the same command will do when the reason is gone."""
    from clsim.study.index import INDEX
    from clsim.study.member import PARTIAL, SETTINGS, STORE

    shutil.rmtree(folder / PARTIAL, ignore_errors=True)
    for name in (INDEX, f"{STORE}/zarr.json", SETTINGS, ".lock"):
        (folder / name).unlink(missing_ok=True)
    for empty in (folder / STORE, folder):
        with suppress(OSError):  # it holds something else
            empty.rmdir()


def _made_by(study: Study, files: set[Path]) -> dict[str, Any]:
    """Return what the results depend on beside the study: versions, and the contents of files."""
    import numpy as np
    import scipy

    module = study.folder / f"{study.metrics.partition(':')[0]}.py"
    named = sorted(files | ({module} if study.metrics and module.exists() else set()))
    return {
        "versions": {"clsim": __version__, "numpy": np.__version__, "scipy": scipy.__version__},
        "contents": {str(path): hashlib.sha256(path.read_bytes()).hexdigest() for path in named},
    }


def _run(tasks: MemberTasks, dispatch: Dispatch, index: Index, workers: Workers, progress: Progress) -> None:
    """Run members on workers, and note what becomes of each."""
    from clsim.cluster.processes import local_devices

    if not dispatch.left:
        return
    devices = local_devices() if tasks.needs_device and workers.scheduler is None else []
    with (
        progress("members", dispatch.left) as advance,
        closing(workers.at_most(dispatch.left).rows(dispatch, tasks, devices)) as rows,
    ):
        for number, row in rows:
            index.add({"member": number} | row)
            advance(1.0)
