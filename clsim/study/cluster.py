"""Processes of this machine, or workers of any Dask cluster, as a team that runs members of a study."""

from __future__ import annotations

import os
import queue
import sys
import uuid
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from clsim.errors import ClsimError, DeviceError, InputError
from clsim.study.dispatch import WorkersLostError
from clsim.study.member import STORE, check_worker, in_one_line, is_disk_full, row_of_group, run_member

if TYPE_CHECKING:
    from collections.abc import Iterator

    from clsim.study.file import Study

_REACH = 10  # s, for a scheduler to answer


class DaskTeam:
    """Workers of a Dask scheduler, none of which is given a member before it can begin.

    Left to itself Dask gives workers members in advance, and if one dies counts it against all that it was given.

    Parameters
    ----------
    client : distributed.Client
        Of the scheduler.
    folder : Path
        Of the study.
    devices : list of str
        Over which workers of this machine are spread; empty elsewhere.
    needs_device, device : bool, str or None
        Whether members need an OpenCL device, and which.
    """

    def __init__(self, client: Any, folder: Path, devices: list[str], needs_device: bool, device: str | None) -> None:
        self._client, self._folder, self._devices = client, str(folder), devices
        self._needs = needs_device, device
        self._known: set[str] = set()
        self._futures: dict[int, Any] = {}
        self._done: queue.SimpleQueue[tuple[int, Any]] = queue.SimpleQueue()

    def workers(self) -> dict[str, int]:
        """Return the workers that are there and have been seen to work, and the threads of each.

        Raises
        ------
        InputError, DeviceError
            If one cannot work.
        ClsimError
            If the scheduler was lost.
        """
        with _scheduler_there():
            there = self._client.nthreads()
            new = sorted(there.keys() - self._known)
            answers = (
                self._client.run(check_worker, self._folder, *self._needs, workers=new, on_error="return")
                if new
                else {}
            )
        for address, found in answers.items():
            if isinstance(found, ImportError):
                raise InputError("--scheduler", f"its workers must have clsim installed, but: {found}")
            if isinstance(found, Exception):  # it died meanwhile
                continue
            problem, is_device = found
            if is_device:
                raise DeviceError(f"worker {address}: {problem}")
            if problem:
                raise InputError(f"worker {address}", problem)
            self._known.add(address)
        return {address: threads for address, threads in there.items() if address in self._known}

    def begin(self, number: int, worker: str) -> None:
        """Have a worker run a member."""
        with _scheduler_there():
            future = self._client.submit(
                _on_worker, self._folder, number, self._devices, key=f"clsim-{number}-{uuid.uuid4().hex}", pure=False,
                workers=[worker], allow_other_workers=False,
            )  # fmt: skip
        self._futures[number] = future
        future.add_done_callback(lambda done: self._done.put((number, done)))

    def forget(self, number: int) -> None:
        """Want nothing more of a member."""
        with _scheduler_there():
            self._futures.pop(number).cancel()

    def done(self, seconds: float) -> tuple[int, dict[str, Any] | None] | None:
        """Return a member that is done with and its row, None if its worker died; None if there is none in time.

        Raises
        ------
        OSError
            If the disk is full.
        """
        try:
            number, future = self._done.get(timeout=seconds)
        except queue.Empty:
            return None
        if self._futures.get(number) is not future:  # it was forgotten
            return None
        try:
            row = _row(future, number, Path(self._folder, STORE, f"m{number:06d}"))
        except TimeoutError:  # its worker died before it could tell; if not, it will
            self._done.put((number, future))
            return None
        self._futures.pop(number).release()
        return number, row


@contextmanager
def _scheduler_there() -> Iterator[None]:
    try:
        yield
    except (OSError, RuntimeError, ValueError) as error:
        if isinstance(error, ClsimError):
            raise
        raise ClsimError(f"the connection to the scheduler was lost: {in_one_line(error)}") from error


def _on_worker(folder: str, number: int, devices: list[str]) -> dict[str, Any]:
    """Run a member on the device of this worker: workers of this machine are called 0, 1, 2, ..."""
    from distributed import get_worker

    name = get_worker().name
    device = devices[name % len(devices)] if devices and isinstance(name, int) else None
    return run_member(folder, number, device)


def _row(future: Any, number: int, group: Path) -> dict[str, Any] | None:
    """Return the row of a member that is done with, None if its worker died before it could tell.

    Raises
    ------
    OSError
        If the disk is full.
    """
    from distributed import KilledWorker

    row: dict[str, Any] | None = row_of_group(group)
    if row is None and future.status == "finished":
        row = future.result(timeout=_REACH)
    if row is not None or future.status != "error":
        return row
    error = future.exception(timeout=_REACH)
    if isinstance(error, KilledWorker):
        return None
    if is_disk_full(error):
        raise error
    return {"member": number, "status": "failed", "error": in_one_line(error), "seconds": 0.0}


@contextmanager
def remote_team(scheduler: str, study: Study, folder: Path) -> Iterator[DaskTeam]:
    """Yield the workers of a running scheduler.

    Raises
    ------
    InputError
        If it cannot be reached.
    """
    from distributed import Client

    with _quiet():
        try:
            client = Client(scheduler, timeout=_REACH, set_as_default=False)
        except (OSError, ValueError, TypeError) as error:
            raise InputError("--scheduler", f"{scheduler} cannot be reached: {in_one_line(error)}") from error
        with client:
            yield DaskTeam(client, folder, [], *_needs(study))


@contextmanager
def local_team(number: int, study: Study, folder: Path) -> Iterator[DaskTeam]:
    """Yield processes of this machine that end with the block.

    Raises
    ------
    WorkersLostError
        If they do not start.
    """
    import logging

    import dask
    from distributed import Client, LocalCluster

    threads = max(1, (os.cpu_count() or 1) // number)
    environment = {
        "POCL_MAX_PTHREAD_COUNT": str(threads), "POCL_CPU_MAX_CU_COUNT": str(threads),
        "PYTHONPATH": os.pathsep.join(p for p in sys.path if p),
    }  # fmt: skip
    settings = {
        "distributed.nanny.pre-spawn-environ": dask.config.get("distributed.nanny.pre-spawn-environ", {}) | environment,
        "distributed.deploy.lost-worker-timeout": "1h",  # else one that takes 15 s to start again is given up
    }
    needs_device, device = _needs(study)
    devices = _devices() if needs_device else []  # first, so that workers keep kernels where this process does
    with dask.config.set(settings), _quiet():
        try:
            with _deaf_to_interrupts():
                cluster = LocalCluster(
                    n_workers=number, threads_per_worker=1, processes=True, host="127.0.0.1",
                    dashboard_address="127.0.0.1:0", silence_logs=logging.CRITICAL,
                )  # fmt: skip
        except (OSError, RuntimeError) as error:
            raise WorkersLostError(f"no worker could be started: {in_one_line(error)}") from error
        with cluster, Client(cluster, set_as_default=False) as client:
            yield DaskTeam(client, folder, devices, needs_device, device)


@contextmanager
def _quiet() -> Iterator[None]:
    """Have Dask say nothing of what is said in one line anyway."""
    import logging

    from distributed.utils import silence_logging_cmgr

    loop = logging.getLogger("asyncio")
    old = loop.level
    loop.setLevel(logging.CRITICAL)
    try:
        with silence_logging_cmgr(logging.CRITICAL):
            yield
    finally:
        loop.setLevel(old)


def _needs(study: Study) -> tuple[bool, str | None]:
    """Return whether the members of a study need an OpenCL device, and which the scene asks for."""
    render = study.content.get("render", {})
    return render.get("engine", "opencl") == "opencl", render.get("device")


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


def _devices() -> list[str]:
    """Return the devices over which workers of this machine are to be spread: GPUs, else all of the usual platform."""
    from clsim.opencl.device import find_device, list_devices

    found = list_devices()
    gpus = [info.id for info in found if info.kind == "GPU"]
    if gpus or not found:
        return gpus
    usual, _ = find_device(None)
    return [info.id for info in found if info.platform == usual.platform and info.kind == usual.kind]


def worker_count(workers: int | None) -> int:
    """Return how many processes are wanted on this machine: as asked, else one per GPU, else one per two cores."""
    from clsim.opencl.device import list_devices

    if workers is not None:
        return workers
    gpus = sum(info.kind == "GPU" for info in list_devices())
    return gpus or max(1, (os.cpu_count() or 1) // 2)
