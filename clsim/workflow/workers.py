"""Who does the work: processes of this machine, or the workers of a Dask scheduler."""

from __future__ import annotations

import queue
import uuid
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any
from urllib.parse import urlsplit

from clsim.errors import ClsimError, DeviceError, InputError, check_packages, in_one_line, warn
from clsim.workflow.processes import Call, Dispatch, Row, Tasks, WorkersLostError, local_team, worker_count

_STORES = ("xarray", "zarr")  # packages by which workers write together
_SCHEDULERS = ("dask", "distributed")  # packages by which a scheduler is reached
_STARTS = 3  # of the processes of this machine, without any task done with in between
_REACH = 10  # s, for a scheduler to answer


@dataclass(frozen=True, slots=True)
class Workers:
    """Requested workers: processes of this machine or a Dask scheduler."""

    number: int | None = None  # processes on this machine: one per GPU, else one per two cores where None
    scheduler: str | None = None  # address of a running Dask scheduler to use instead

    def __post_init__(self) -> None:
        if self.number is not None and self.scheduler is not None:
            raise InputError("--workers", "must be left out, because the scheduler has its own")
        if self.number is not None and self.number < 1:
            raise InputError("--workers", f"must be at least 1, but is {self.number}")

    def check(self, field: str, what: str) -> None:
        """See that the packages are installed that these workers need, and that a scheduler can be reached."""
        # A scheduler of another machine that asks for no certificates is warned of: it runs what anybody sends.
        check_packages(field, what, "study", *_STORES, *(_SCHEDULERS if self.scheduler else ()))
        if self.scheduler is None:
            return
        check_reach(self.scheduler)
        if is_open(self.scheduler):
            warn(
                f"--scheduler: {self.scheduler} is reached without encryption: whoever reaches it, or reads along, can "
                "run programs on it, its workers and this machine; use tls:// with certificates"
            )

    def count(self) -> int:
        """Return the number of processes on this machine; 0 with a scheduler."""
        return 0 if self.scheduler else worker_count(self.number)

    def at_most(self, number: int) -> Workers:
        """Return these, but no more processes of this machine than there is work for."""
        return self if self.scheduler else Workers(max(1, min(self.count(), number)))

    def rows(self, dispatch: Dispatch, tasks: Tasks, devices: Sequence[str]) -> Generator[tuple[int, Row], None, None]:
        """Do tasks; yield number and row of each. If all processes of this machine die, start new ones."""
        number, tries = self.count(), 0
        while dispatch.left:
            team = remote_team(self.scheduler, tasks) if self.scheduler else local_team(number, tasks, list(devices))
            done = False
            try:
                with team as there:
                    for found in dispatch.rows(there, tasks.found):
                        done = True
                        yield found
            except WorkersLostError as error:
                if self.scheduler:
                    raise InputError("--scheduler", f"must have workers, but {error}") from error
                tries = 0 if done else tries + 1
                if tries == _STARTS:
                    raise
            else:
                return


def is_open(scheduler: str) -> bool:
    """Return True if a scheduler is on another machine and requires no certificates.

    Examples
    --------
    >>> [is_open(f"{kind}://{host}:8786") for kind in ("tcp", "tls") for host in ("127.0.0.1", "[::1]", "10.0.0.1")]
    [False, False, True, False, False, False]
    """
    parts = urlsplit(scheduler if "://" in scheduler else f"tcp://{scheduler}")
    host = (parts.hostname or "").rstrip(".")
    here = host in ("", "localhost", "::1") or host.startswith("127.")
    return parts.scheme != "tls" and not here


class DaskTeam:
    """Workers of a Dask scheduler, none of which is given a task before it can begin."""

    # Left to itself Dask gives workers tasks in advance, and if one dies counts it against all that it was given.
    def __init__(self, client: Any, tasks: Tasks) -> None:
        self._client, self._tasks = client, tasks
        self._known: set[str] = set()
        self._futures: dict[int, Any] = {}
        self._done: queue.SimpleQueue[tuple[int, Any]] = queue.SimpleQueue()

    def workers(self) -> dict[str, int]:
        """Return the checked workers that are connected, and the tasks that each does at a time."""
        with _scheduler_there():
            there = self._client.nthreads()
            new = sorted(there.keys() - self._known)
            answers = self._request(self._tasks.check(), new, "return") if new else {}
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
        """Submit a task to this worker alone."""
        with _scheduler_there():
            future = self._client.submit(
                _on_worker, *self._tasks.call(number),
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
        except TimeoutError:  # its worker died before it reported, or reports later
            self._done.put((number, future))
            return None
        self._futures.pop(number).release()
        return number, row

    def end(self) -> None:
        """Cancel all tasks, and wait for workers that are still writing."""
        for future in self._futures.values():
            future.cancel()
        last_call = self._tasks.over()
        if last_call is not None:
            there = self._client.nthreads()  # one that died would be waited for half a minute
            self._request(last_call, sorted(self._known & there.keys()), "ignore")

    def _request(self, call: Call, workers: list[str], on_error: str) -> dict[str, Any]:
        """Return the workers' results of a call, by address."""
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


def _on_worker(function: Callable[..., Row], arguments: tuple[Any, ...]) -> Row:
    """Do a task on the worker's own device."""
    return function(*arguments, None)


def row_of(future: Any, number: int, tasks: Tasks) -> Row | None:
    """Return the row of a task that ended, None if its worker died before it reported one."""
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
    """Yield the workers of a running scheduler."""
    with _quiet(), _client(scheduler) as client:
        team = DaskTeam(client, tasks)
        try:
            yield team
        finally:
            with suppress(OSError, RuntimeError, ValueError):  # the scheduler may be lost
                team.end()


def check_reach(scheduler: str) -> None:
    """Raise an InputError if a scheduler cannot be reached."""
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
def _quiet() -> Iterator[None]:
    """Silence Dask's log of errors that clsim reports itself."""
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
