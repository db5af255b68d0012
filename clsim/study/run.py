"""Running a study on processes of this machine or on any Dask cluster."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import sys
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clsim.errors import ClsimError, DeviceError, InputError
from clsim.output.atomic import locked, safe_path

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from contextlib import AbstractContextManager

    from clsim.study.file import Study
    from clsim.study.index import Index, MemberRow

    Progress = Callable[[str, float], AbstractContextManager[Callable[[float], None]]]

_PATIENCE = 30.0  # s, for workers of a scheduler to appear
_REACH = "10s"  # for a scheduler to answer


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
        Address of a running Dask scheduler, for example ``"tcp://10.0.0.1:8786"``, instead; its workers must see the
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

    Notes
    -----
    Processes are started anew, so scripts call this behind ``if __name__ == "__main__":``. A worker that dies is
    replaced, and what it was at is done by another. The store holds the truth: a member counts as finished when its
    group is there, and groups appear whole.
    """
    _check_packages()
    from clsim.study.file import DEFAULT_LIMIT, checked, load_study
    from clsim.study.index import Index, write_summary
    from clsim.study.member import STORE

    progress = progress or _no_progress
    study = load_study(path, DEFAULT_LIMIT if limit is None else limit)
    folder = Path(output).absolute()
    resume = resume or retry
    if not resume and (folder / "study.json").exists():
        raise InputError(
            "--output", f"must hold no study yet, but {folder} does (--resume goes on, --retry also with what failed)"
        )
    with progress("checking scenes", len(study.members)) as advance:
        files = checked(study, advance)
    folder.mkdir(parents=True, exist_ok=True)
    with locked(folder / ".lock", "--output"):
        _begin(study, files, folder)
        index = Index(folder, study.members)
        index.rewrite()
        try:
            _run(study, index, folder, index.todo(retry), workers, scheduler, progress)
        except BaseException as error:
            if any((folder / STORE / member.name).exists() for member in study.members):
                error.add_note(f"what is finished is kept in {folder}: --resume goes on with it")
            raise
        index.rewrite()
        rows = [index.rows[n] for n in sorted(index.rows)]
        write_summary(folder, rows)
        shutil.rmtree(folder / ".partial", ignore_errors=True)
    return tuple(rows)


def _check_packages() -> None:
    from importlib.util import find_spec

    missing = [name for name in ("dask", "distributed", "xarray", "zarr") if find_spec(name) is None]
    if missing:
        raise InputError("study", f'a study needs {" and ".join(missing)}: pip install "clsim[study]"')


@contextmanager
def _no_progress(what: str, total: float) -> Iterator[Callable[[float], None]]:
    yield lambda amount: None


def _begin(study: Study, files: set[Path], folder: Path) -> None:
    """Make the folder of a study, or see that it holds this very one."""
    from clsim.output.journal import first_difference
    from clsim.study.index import create_store
    from clsim.study.member import SETTINGS, STORE, metrics_function, study_to_settings

    if study.metrics:
        metrics_function(study.metrics, study.folder)
    settings = study_to_settings(study) | {"made_by": _made_by(study, files)}
    path = folder / SETTINGS
    if path.exists():
        difference = first_difference(json.loads(path.read_text("utf-8")), json.loads(json.dumps(settings)))
        if difference is not None:
            raise InputError("--resume", f"must go on with the same study, but {difference}; choose another folder")
    else:
        with safe_path(path) as temporary:
            temporary.write_text(json.dumps(settings, indent=1), "utf-8")
    if not (folder / STORE / "zarr.json").exists():
        create_store(folder)
    shutil.rmtree(folder / ".partial", ignore_errors=True)
    (folder / ".partial").mkdir()


def _made_by(study: Study, files: set[Path]) -> dict[str, Any]:
    """Return what the results depend on beside the study: versions, and the contents of files."""
    import numpy as np
    import scipy

    import clsim

    module = study.folder / f"{study.metrics.partition(':')[0]}.py"
    named = sorted(files | ({module} if study.metrics and module.exists() else set()))
    return {
        "versions": {"clsim": clsim.__version__, "numpy": np.__version__, "scipy": scipy.__version__},
        "contents": {str(path): hashlib.sha256(path.read_bytes()).hexdigest() for path in named},
    }


def _run(
    study: Study,
    index: Index,
    folder: Path,
    todo: list[int],
    workers: int | None,
    scheduler: str | None,
    progress: Progress,
) -> None:
    """Run members on a cluster, and note what becomes of each."""
    from distributed import as_completed

    from clsim.study.member import run_member

    if not todo:
        return
    with _client(workers, scheduler, len(todo)) as client:
        engine = study.content.get("render", {}).get("engine", "opencl")
        devices = _devices() if scheduler is None and engine == "opencl" else []
        _check_workers(client, folder, engine == "opencl", study.content.get("render", {}).get("device"))
        token = hashlib.sha256(os.urandom(16)).hexdigest()[:12]
        futures = {
            client.submit(_on_worker, run_member, str(folder), n, devices, key=f"clsim-{token}-{n}", pure=False): n
            for n in todo
        }
        with progress("members", len(todo)) as advance:
            for future in as_completed(list(futures), loop=client.loop):
                index.add(_row(future, futures[future]))
                future.release()
                advance(1.0)


def _on_worker(run: Callable[..., dict[str, Any]], folder: str, number: int, devices: list[str]) -> dict[str, Any]:
    """Run a member on the device of this worker: workers of this machine are called 0, 1, 2, ..."""
    from distributed import get_worker

    name = get_worker().name
    device = devices[name % len(devices)] if devices and isinstance(name, int) else None
    return run(folder, number, device)


def _row(future: Any, number: int) -> dict[str, Any]:
    """Return the row of a member that is done with.

    Raises
    ------
    OSError
        If the disk is full.
    ClsimError
        If the scheduler was lost.
    """
    from distributed import KilledWorker

    if future.status == "finished":
        row: dict[str, Any] = future.result()
        return row
    if future.status == "error":
        error = future.exception()
        if isinstance(error, KilledWorker):
            return {"member": number, "status": "failed", "error": "every worker that ran it died", "seconds": 0.0}
        raise error
    raise ClsimError("the connection to the scheduler was lost")


@contextmanager
def _client(workers: int | None, scheduler: str | None, count: int) -> Iterator[Any]:
    """Yield a client of a scheduler, or of processes of this machine that end with it."""
    import logging

    import dask
    from distributed import Client, LocalCluster

    if scheduler is not None:
        if workers is not None:
            raise InputError("--workers", "must be left out, because the scheduler has its own")
        try:
            client = Client(scheduler, timeout=_REACH, set_as_default=False)
        except (OSError, ValueError, TypeError) as error:
            raise InputError(
                "--scheduler", f"{scheduler} cannot be reached: {error or type(error).__name__}"
            ) from error
        with client:
            yield client
        return
    number = min(_worker_count() if workers is None else _checked_workers(workers), count)
    threads = max(1, (os.cpu_count() or 1) // number)
    environment = {
        "POCL_MAX_PTHREAD_COUNT": str(threads), "POCL_CPU_MAX_CU_COUNT": str(threads),
        "PYTHONPATH": os.pathsep.join(p for p in sys.path if p),
    }  # fmt: skip
    old = dask.config.get("distributed.nanny.pre-spawn-environ", {})
    with dask.config.set({"distributed.nanny.pre-spawn-environ": old | environment}):
        with _deaf_to_interrupts():
            cluster = LocalCluster(
                n_workers=number, threads_per_worker=1, processes=True, host="127.0.0.1",
                dashboard_address="127.0.0.1:0", silence_logs=logging.CRITICAL,
            )  # fmt: skip
        with cluster, Client(cluster, set_as_default=False) as client:
            yield client


@contextmanager
def _deaf_to_interrupts() -> Iterator[None]:
    """Have processes that are started here ignore Ctrl-C, which a terminal sends to all: this process ends them."""
    import signal
    import threading

    if threading.current_thread() is not threading.main_thread():  # where Python lets nobody change signals
        yield
        return
    old = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, old)


def _checked_workers(workers: int) -> int:
    if workers < 1:
        raise InputError("--workers", f"must be at least 1, but is {workers}")
    return workers


def _devices() -> list[str]:
    """Return the devices over which workers of this machine are to be spread: GPUs, else all of the usual platform."""
    from clsim.opencl.device import find_device, list_devices

    found = list_devices()
    gpus = [info.id for info in found if info.kind == "GPU"]
    if gpus or not found:
        return gpus
    usual, _ = find_device(None)
    return [info.id for info in found if info.platform == usual.platform and info.kind == usual.kind]


def _worker_count() -> int:
    from clsim.opencl.device import list_devices

    gpus = sum(info.kind == "GPU" for info in list_devices())
    return gpus or max(1, (os.cpu_count() or 1) // 2)


def _check_workers(client: Any, folder: Path, needs_device: bool, device: str | None) -> None:
    """See that workers are there, and that each has what it needs.

    Raises
    ------
    InputError
        If there is none, or one that cannot work.
    DeviceError
        If one has no OpenCL device.
    """
    from clsim.study.member import check_worker

    try:
        client.wait_for_workers(1, timeout=_PATIENCE)
        found = client.run(check_worker, str(folder), needs_device, device)
    except TimeoutError as error:
        raise InputError("--scheduler", f"must have workers, but has none after {_PATIENCE:g} s") from error
    except ImportError as error:
        raise InputError("--scheduler", f"its workers must have clsim installed, but: {error}") from error
    for address, (problem, is_device) in found.items():
        if is_device:
            raise DeviceError(f"worker {address}: {problem}")
        if problem:
            raise InputError(f"worker {address}", problem)
