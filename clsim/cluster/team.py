"""Processes of this machine, or workers of any Dask cluster, as a team that does tasks."""

from __future__ import annotations

import os
import queue
import sys
import uuid
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any

from clsim.cluster.dispatch import WorkersLostError
from clsim.errors import ClsimError, DeviceError, InputError, in_one_line

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from clsim.cluster.dispatch import Call, Row, Tasks

_REACH = 10  # s, for a scheduler to answer


class DaskTeam:
    """Workers of a Dask scheduler, none of which is given a task before it can begin.

    Left to itself Dask gives workers tasks in advance, and if one dies counts it against all that it was given.

    Parameters
    ----------
    client : distributed.Client
        Of the scheduler.
    tasks : Tasks
        What is to be done.
    devices : list of str
        Over which workers of this machine are spread; empty elsewhere.
    """

    def __init__(self, client: Any, tasks: Tasks, devices: list[str]) -> None:
        self._client, self._tasks, self._devices = client, tasks, devices
        self._known: set[str] = set()
        self._futures: dict[int, Any] = {}
        self._done: queue.SimpleQueue[tuple[int, Any]] = queue.SimpleQueue()

    def workers(self) -> dict[str, int]:
        """Return the workers that are there and have been seen to work, and how many tasks each does at a time.

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
            answers = self._ask(self._tasks.check(), new, "return") if new else {}
        for address, found in answers.items():
            if isinstance(found, ImportError) and found.name in (None, "clsim"):
                raise InputError("--scheduler", f"its workers must have clsim installed, but: {found}")
            if isinstance(found, ImportError | AttributeError):
                raise InputError(f"worker {address}", f"must have the version of clsim that is here, but: {found}")
            if isinstance(found, Exception):  # it died meanwhile
                continue
            problem, is_device = found
            if is_device:
                raise DeviceError(f"worker {address}: {problem}")
            if problem:
                raise InputError(f"worker {address}", problem)
            self._known.add(address)
        return {a: threads if self._tasks.several else 1 for a, threads in there.items() if a in self._known}

    def begin(self, number: int, worker: str) -> None:
        """Have a worker do a task."""
        with _scheduler_there():
            future = self._client.submit(
                _on_worker, *self._tasks.call(number), self._devices,
                key=f"clsim-{self._tasks.kind}-{number}-{uuid.uuid4().hex}", pure=False, workers=[worker],
                allow_other_workers=False,
            )  # fmt: skip
        self._futures[number] = future
        future.add_done_callback(lambda done: self._done.put((number, done)))

    def forget(self, number: int) -> None:
        """Want nothing more of a task."""
        with _scheduler_there():
            self._futures.pop(number).cancel()

    def done(self, seconds: float) -> tuple[int, Row | None] | None:
        """Return a task that is done with and its row, None if its worker died; None if there is none in time."""
        try:
            number, future = self._done.get(timeout=seconds)
        except queue.Empty:
            return None
        if self._futures.get(number) is not future:  # it was forgotten
            return None
        try:
            row = row_of(future, number, self._tasks)
        except TimeoutError:  # its worker died before it could tell; if not, it will
            self._done.put((number, future))
            return None
        self._futures.pop(number).release()
        return number, row

    def end(self) -> None:
        """Want nothing more at all, and wait for workers that have to be waited for."""
        for future in self._futures.values():
            future.cancel()
        asked = self._tasks.over()
        if asked is not None:
            there = self._client.nthreads()  # one that died would be waited for half a minute
            self._ask(asked, sorted(self._known & there.keys()), "ignore")

    def _ask(self, call: Call, workers: list[str], on_error: str) -> dict[str, Any]:
        """Return what workers answer to a call, by their addresses."""
        function, arguments = call
        answers: dict[str, Any] = self._client.run(function, *arguments, workers=workers, on_error=on_error)
        return answers


@contextmanager
def _scheduler_there() -> Iterator[None]:
    try:
        yield
    except (OSError, RuntimeError, ValueError) as error:
        if isinstance(error, ClsimError):
            raise
        raise ClsimError(f"the connection to the scheduler was lost: {in_one_line(error)}") from error


def _on_worker(function: Callable[..., Row], arguments: tuple[Any, ...], devices: list[str]) -> Row:
    """Do a task on the device of this worker: workers of this machine are called 0, 1, 2, ..."""
    from distributed import get_worker

    name = get_worker().name
    device = devices[name % len(devices)] if devices and isinstance(name, int) else None
    return function(*arguments, device)


def row_of(future: Any, number: int, tasks: Tasks) -> Row | None:
    """Return the row of a task that is done with, None if its worker died before it could tell.

    Parameters
    ----------
    future : distributed.Future
        Of its call.
    number : int
        Of the task.
    tasks : Tasks
        Among which it is.
    """
    from distributed import KilledWorker

    row = tasks.found(number)
    if row is None and future.status == "finished":
        row = future.result(timeout=_REACH)
    if row is not None or future.status != "error":
        return row
    error = future.exception(timeout=_REACH)
    return None if isinstance(error, KilledWorker) else tasks.failed(number, error)


@contextmanager
def remote_team(scheduler: str, tasks: Tasks) -> Iterator[DaskTeam]:
    """Yield the workers of a running scheduler.

    Raises
    ------
    InputError
        If it cannot be reached.
    """
    with _quiet(), _client(scheduler) as client:
        team = DaskTeam(client, tasks, [])
        try:
            yield team
        finally:
            with suppress(OSError, RuntimeError, ValueError):  # the scheduler may be lost
                team.end()


def check_reach(scheduler: str) -> None:
    """See that a scheduler can be reached, before there is anything to do.

    Raises
    ------
    InputError
        If it cannot.
    """
    with _quiet(), _client(scheduler):
        pass


@contextmanager
def _client(scheduler: str) -> Iterator[Any]:
    from distributed import Client

    try:
        client = Client(scheduler, timeout=_REACH, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        raise InputError("--scheduler", f"{scheduler} cannot be reached: {in_one_line(error)}") from error
    with client:
        yield client


@contextmanager
def local_team(number: int, tasks: Tasks, devices: list[str]) -> Iterator[DaskTeam]:
    """Yield processes of this machine that end with the block.

    Parameters
    ----------
    number : int
        How many.
    tasks : Tasks
        What they do.
    devices : list of str
        Over which they are spread.

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
        "distributed.worker.multiprocessing-method": "forkserver" if sys.platform == "linux" else "spawn",
        "distributed.nanny.pre-spawn-environ": dask.config.get("distributed.nanny.pre-spawn-environ", {}) | environment,
        "distributed.deploy.lost-worker-timeout": "1h",  # else one that takes 15 s to start again is given up
    }
    with dask.config.set(settings), _quiet():
        _load_ahead(tasks)
        try:
            with _deaf_to_interrupts():
                cluster = LocalCluster(
                    n_workers=number, threads_per_worker=1, processes=True, host="127.0.0.1",
                    dashboard_address="127.0.0.1:0", silence_logs=logging.CRITICAL,
                )  # fmt: skip
        except (OSError, RuntimeError) as error:
            raise WorkersLostError(f"no worker could be started: {in_one_line(error)}") from error
        with cluster, Client(cluster, set_as_default=False) as client:
            yield DaskTeam(client, tasks, devices)


def _load_ahead(tasks: Tasks) -> None:
    """Where workers are forked, have the process that they are forked from load what tasks need, once for all."""
    from distributed.utils import get_mp_context

    function, _ = tasks.check()
    context = get_mp_context()
    if context.get_start_method() == "forkserver":
        context.set_forkserver_preload(["distributed", function.__module__, *tasks.loads])


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


def local_devices() -> list[str]:
    """Return the devices over which workers of this machine are to be spread: GPUs, else all of the usual platform.

    To be asked for before workers are started, so that they keep kernels where this process does.
    """
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
