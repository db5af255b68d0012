"""Assignment of tasks to workers; processes of this machine, reached by pipes that no other user can open."""

from __future__ import annotations

import multiprocessing
import os
import pickle
import queue
import signal
import sys
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing import connection as pipes
from typing import Any

from clsim.errors import ClsimError, DeviceError, InputError, in_one_line

_STARTS = 3  # starts of a process in a row that fail before it is ready
_LONGEST = 60.0  # s that a task is waited for which is writing: a chunk takes less
_GRACE = 5.0  # s for an ended process to leave its task: calls into C finish first


@dataclass(slots=True, eq=False)
class _Worker:
    """A process, the pipe to it, and the task that it does."""

    slot: int
    process: Any
    pipe: Any
    ready: bool = False
    number: int | None = None
    closed: bool = False  # the other end of the pipe is

    def send(self, *call: Any) -> None:
        """Send a call; a dead process is detected later."""
        with suppress(OSError):
            self.pipe.send_bytes(pickle.dumps(call, pickle.HIGHEST_PROTOCOL))

    def receive(self) -> tuple[bool, Any] | None:
        """Return an answer as (is an error, value), or None if the process has died."""
        try:
            answer: tuple[bool, Any] = self.pipe.recv()
        except (EOFError, OSError):
            self.closed, self.number = True, None
            self.process.kill()  # it has died, or is about to
            return None
        return answer


class ProcessTeam:
    """Processes of this machine with one task each at a time; dead ones are replaced."""

    def __init__(self, number: int, tasks: Tasks, devices: list[str]) -> None:
        self._tasks, self._devices = tasks, devices
        self._environment = _environment(number)
        self._context: Any = multiprocessing.get_context(_start_method())
        self._unready = [0] * number  # processes in a row that died before they were ready
        self._count = 0
        self._workers: dict[str, _Worker] = {}
        start_server([tasks.check()[0].__module__, *tasks.loads])

    def start(self) -> None:
        """Start the processes."""
        for slot in range(len(self._unready)):
            self._start(slot)

    def _start(self, slot: int) -> None:
        device = self._devices[slot % len(self._devices)] if self._devices else None
        ours, theirs = self._context.Pipe()
        process = self._context.Process(target=_serve, args=(theirs, device, self._environment), daemon=True)
        try:
            with _heirs(self._environment):
                process.start()
        except (OSError, RuntimeError, EOFError) as error:
            raise WorkersLostError(f"no worker could be started: {in_one_line(error)}") from error
        finally:
            theirs.close()
        worker = self._workers[f"{slot}.{self._count}"] = _Worker(slot, process, ours)
        self._count += 1
        worker.send(*self._tasks.check(), False)

    def workers(self) -> dict[str, int]:
        """Return the ready processes, each for one task at a time; replace dead ones."""
        for name, worker in list(self._workers.items()):
            if not worker.closed and (worker.process.is_alive() or worker.pipe.poll()):
                continue  # it lives, or sent what was not received yet
            del self._workers[name]
            worker.process.join()
            worker.pipe.close()
            self._unready[worker.slot] = 0 if worker.ready else self._unready[worker.slot] + 1
            if self._unready[worker.slot] < _STARTS:
                self._start(worker.slot)
        if not self._workers:
            raise WorkersLostError(f"no worker could be started: each died before it was ready, {_STARTS} times")
        return {name: 1 for name, worker in self._workers.items() if worker.ready}

    def begin(self, number: int, worker: str) -> None:
        """Send a task to a process."""
        self._workers[worker].number = number
        self._workers[worker].send(*self._tasks.call(number), True)

    def forget(self, number: int) -> None:
        """Want nothing more of a task: its process has died, and is not among the workers any more."""

    def done(self, seconds: float) -> tuple[int, Row | None] | None:
        """Return a task that is done with and its row; None if there is none in time."""
        by_pipe = {worker.pipe: worker for worker in self._workers.values()}
        for pipe in pipes.wait(list(by_pipe), seconds):
            worker = by_pipe[pipe]
            answer = worker.receive()
            if answer is None:  # it is replaced when workers are looked at
                continue
            failed, value = answer
            if worker.ready:
                number, worker.number = worker.number, None
                assert number is not None
                return number, (self._tasks.found(number) or self._tasks.failed(number, value) if failed else value)
            problem, is_device = (in_one_line(value), False) if failed else value
            if is_device:
                raise DeviceError(problem)
            if problem:
                raise InputError("--workers", problem)
            worker.ready = True
        return None

    def end(self) -> None:
        """End the processes; wait only for tasks that must finish, others are interrupted and clean up."""
        workers = list(self._workers.values())
        if self._tasks.over() is not None:
            deadline = time.monotonic() + _LONGEST
            while (busy := {w.pipe: w for w in workers if w.number is not None}) and time.monotonic() < deadline:
                for pipe in pipes.wait(list(busy), 1.0):
                    busy[pipe].receive()
                    busy[pipe].number = None
        for worker in workers:
            worker.process.terminate()
        for worker in workers:
            worker.process.join(_GRACE)
            worker.process.kill()
            worker.process.join()
            worker.pipe.close()


def start_server(modules: Sequence[str]) -> None:
    """Start the process that workers are forked from, where they are; it loads modules while this one goes on."""
    if _start_method() != "forkserver":
        return
    from multiprocessing import forkserver

    forkserver.set_forkserver_preload([__name__, *modules])  # of no effect where it runs already
    with suppress(OSError, RuntimeError), _heirs(_environment(1)):  # who starts a worker is told
        forkserver.ensure_running()


@contextmanager
def local_team(number: int, tasks: Tasks, devices: list[str]) -> Iterator[ProcessTeam]:
    """Yield processes of this machine that end with the block."""
    team = ProcessTeam(number, tasks, devices)
    try:
        team.start()
        yield team
    finally:
        team.end()


def _start_method() -> str:
    # The fork server of Python 3.11.0 listens on a socket that every user of the machine can open.
    return "forkserver" if sys.platform == "linux" and sys.version_info >= (3, 11, 1) else "spawn"


def _environment(number: int) -> dict[str, str]:
    """Environment variables of each process: those of this one, with its share of the cores for PoCL."""
    threads = str(max(1, (os.cpu_count() or 1) // number))
    return os.environ | {
        "POCL_MAX_PTHREAD_COUNT": threads, "POCL_CPU_MAX_CU_COUNT": threads,
        "PYTHONPATH": os.pathsep.join(p for p in sys.path if p),
    }  # fmt: skip


@contextmanager
def _heirs(environment: dict[str, str]) -> Iterator[None]:
    """Have processes that start here find the packages of this one, and never see Ctrl-C: this process ends them."""
    # A terminal sends Ctrl-C to all processes. Blocked, it waits for this one until the block ends; ignored, it was
    # lost.
    before = os.environ.get("PYTHONPATH")
    os.environ["PYTHONPATH"] = environment["PYTHONPATH"]
    mask = None
    if hasattr(signal, "pthread_sigmask"):
        from multiprocessing import resource_tracker

        resource_tracker.ensure_running()  # unblocks the signal when it starts
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        if before is None:
            os.environ.pop("PYTHONPATH", None)
        else:
            os.environ["PYTHONPATH"] = before
        if mask is not None:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)


def _serve(pipe: Any, device: str | None, environment: dict[str, str]) -> None:
    """Execute calls from a pipe until it is closed or the process receives the signal to end."""
    status = 1
    try:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        signal.signal(signal.SIGTERM, _leave)
        os.environ.update(environment)
        calls: queue.SimpleQueue[bytes | None] = queue.SimpleQueue()
        threading.Thread(target=_listen, args=(pipe, calls), daemon=True).start()
        while (call := calls.get()) is not None:
            answer: tuple[bool, Any]  # whether it is an error, and a value or the error
            try:
                function, arguments, on_device = pickle.loads(call)
                answer = False, function(*arguments, *((device,) if on_device else ()))
            except (Exception, SystemExit) as error:
                answer = True, error
            _send(pipe, answer)
        status = 0
    except (KeyboardInterrupt, OSError):  # signalled to end, or the pipe is closed
        status = 0
    finally:
        os._exit(status)  # threads of drivers and of the listener would be waited for


def _leave(number: int, frame: Any) -> None:
    """Raise out of the current task so that open resources clean up."""
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    raise KeyboardInterrupt


def _listen(pipe: Any, calls: queue.SimpleQueue[bytes | None]) -> None:
    """Take calls as they come; when the team's process is gone, leave the task that is being done."""
    while True:
        try:
            calls.put(pipe.recv_bytes())
        except (EOFError, OSError):
            calls.put(None)
            os.kill(os.getpid(), signal.SIGTERM)
            return


def _send(pipe: Any, answer: tuple[bool, Any]) -> None:
    """Send an answer, as text if it cannot be pickled."""
    try:
        content = pickle.dumps(answer, pickle.HIGHEST_PROTOCOL)
        if answer[0]:
            pickle.loads(content)  # some errors can be written and not read
    except Exception as error:
        content = pickle.dumps((True, RuntimeError(in_one_line(answer[1] if answer[0] else error))))
    pipe.send_bytes(content)


def local_devices() -> list[str]:
    """Return the devices for workers that are to be started: GPUs, else all of the usual platform."""
    from clsim.opencl.device import find_device, list_devices

    found = list_devices()
    gpus = [info.id for info in found if info.kind == "GPU"]
    if gpus or not found:
        return gpus
    usual, _ = find_device(None)
    return [info.id for info in found if info.platform == usual.platform and info.kind == usual.kind]


def worker_count(workers: int | None) -> int:
    """Return the number of processes on this machine: as given, else one per GPU, else one per two cores."""
    from clsim.opencl.device import list_devices

    if workers is not None:
        return workers
    gpus = sum(info.kind == "GPU" for info in list_devices())
    return gpus or max(1, (os.cpu_count() or 1) // 2)


Row = dict[str, Any]  # result of a task: "status" ("finished", "failed"), "error", "seconds", and its own keys
Call = tuple["Callable[..., Any]", tuple[Any, ...]]  # a function and its arguments, for a worker

PATIENCE = 60.0  # s without a worker
_TOGETHER = 2  # times that a task is done beside others though its worker died
_ALONE = 3  # times that it is done alone after that
_TICK = 0.25  # s after which the workers are looked at


class WorkersLostError(ClsimError):
    """There was no worker for too long."""


class Tasks:
    """Numbered tasks, each a call that any worker can make."""

    kind: str  # of the tasks, one word
    several = False  # whether a process does several at a time, if it has threads for them
    loads: tuple[str, ...] = ()  # modules that every worker would load itself: where workers are forked, once for all

    def check(self) -> Call:
        """Return the call that checks a new worker: why it cannot work, or "", and if its device is the reason."""
        return _is_good, ()

    def call(self, number: int) -> Call:
        """Return the call of a task, to which the worker appends its device; the call returns the task's row."""
        raise NotImplementedError

    def found(self, number: int) -> Row | None:
        """Return the row of a task whose results are there, although its worker died before it could say so."""
        return None

    def failed(self, number: int, error: BaseException) -> Row:
        """Return the row of a task that raised an error, or raise it."""
        raise error

    def over(self) -> Call | None:
        """End all tasks; return a call for the workers to wait for, or None."""
        return None


def _is_good() -> tuple[str, bool]:
    return "", False


class Dispatch:
    """Tasks that are still to be done."""

    # A worker is given only what it begins at once. If it dies, what it was at is done again; a task whose workers go
    # on dying is done with nothing else beside it, when all others are done with. Only what dies then too is given up:
    # it needs more than there is, or ends its process.
    def __init__(self, todo: list[int], patience: float = PATIENCE) -> None:
        self.left = len(todo)  # unfinished tasks
        self.begun = False  # whether any was given to a worker
        self._waiting, self._suspects = deque(todo), deque[int]()
        self._running: dict[int, str] = {}
        self._deaths: Counter[int] = Counter()
        self._patience = patience

    def add(self, number: int) -> None:
        """Take one more task, to be done before those that wait: between two rows, too."""
        self._waiting.appendleft(number)
        self.left += 1

    def rows(self, team: Any, found: Callable[[int], Row | None]) -> Iterator[tuple[int, Row]]:
        """Do the remaining tasks by a `ProcessTeam` or a `DaskTeam`; yield number and row of each as it ends."""
        seen = time.monotonic()
        while self.left:
            there = team.workers()
            seen = time.monotonic() if there else seen
            for number in [n for n, worker in self._running.items() if worker not in there]:
                team.forget(number)
                yield from self._died(number, found)
            if not there and time.monotonic() - seen > self._patience:
                raise WorkersLostError(f"there was no worker for {self._patience:g} s")
            busy = Counter(self._running.values())
            free = [worker for worker, count in there.items() for _ in range(count - busy[worker])]
            tasks, free = (self._waiting, free) if self._waiting else (self._suspects, [] if busy else free[:1])
            for worker in free[: len(tasks)]:
                number = tasks.popleft()
                self._running[number], self.begun = worker, True
                team.begin(number, worker)
            done = team.done(_TICK)
            if done is None:
                continue
            number, row = done
            if row is None:
                yield from self._died(number, found)
            else:
                yield self._decided(number, row)

    def _died(self, number: int, found: Callable[[int], Row | None]) -> Iterator[tuple[int, Row]]:
        """Repeat a task whose worker died, or yield its row if the results exist."""
        row = found(number)
        if row is not None:
            yield self._decided(number, row)
            return
        del self._running[number]
        self._deaths[number] += 1
        if self._deaths[number] < _TOGETHER:
            self._waiting.appendleft(number)
        elif self._deaths[number] < _TOGETHER + _ALONE:
            self._suspects.append(number)
        else:
            deaths = f"its worker died {self._deaths[number]} times, the last {_ALONE} while it ran nothing else"
            row = {"status": "failed", "error": f"{deaths} (out of memory?)", "seconds": 0.0}
            yield self._decided(number, row)

    def _decided(self, number: int, row: Row) -> tuple[int, Row]:
        self._running.pop(number, None)
        self.left -= 1
        return number, row
