"""Assignment of tasks to workers; a task whose worker died is repeated alone before it counts as failed."""

from __future__ import annotations

import time
from collections import Counter, deque
from collections.abc import Callable, Iterator
from typing import Any, Protocol

from clsim.errors import ClsimError

Row = dict[str, Any]  # result of a task: "status" ("finished", "failed"), "error", "seconds", and its own keys
Call = tuple["Callable[..., Any]", tuple[Any, ...]]  # a function and its arguments, for a worker

PATIENCE = 60.0  # s without a worker
_TOGETHER = 2  # times that a task is done beside others though its worker died
_ALONE = 3  # times that it is done alone after that
_TICK = 0.25  # s after which the workers are looked at


class WorkersLostError(ClsimError):
    """There was no worker for too long."""


class Tasks(Protocol):
    """Numbered tasks, each a call that any worker can make."""

    kind: str  # of the tasks, one word
    several: bool  # whether a process does several at a time, if it has threads for them
    loads: tuple[str, ...]  # modules that every worker would load itself: where workers are forked, once for all

    def check(self) -> Call:
        """Return the call that checks a new worker: why it cannot work, or "", and if its device is the reason."""

    def call(self, number: int) -> Call:
        """Return the call of a task, to which the worker appends its device; the call returns the task's row."""

    def found(self, number: int) -> Row | None:
        """Return the row of a task whose results are there, although its worker died before it could say so."""

    def failed(self, number: int, error: BaseException) -> Row:
        """Return the row of a task that raised an error, or raise it."""

    def over(self) -> Call | None:
        """End all tasks; return a call for the workers to wait for, or None."""


class Team(Protocol):
    """Processes that do tasks."""

    def workers(self) -> dict[str, int]:
        """Return the tasks that each available worker does at a time."""

    def begin(self, number: int, worker: str) -> None:
        """Start a task on this worker and no other."""

    def forget(self, number: int) -> None:
        """Drop a task whose worker died."""

    def done(self, seconds: float) -> tuple[int, Row | None] | None:
        """Return a task that is done with and its row, None if its worker died; None if there is none in time."""


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

    def rows(self, team: Team, found: Callable[[int], Row | None]) -> Iterator[tuple[int, Row]]:
        """Do the remaining tasks; yield number and row of each as it ends."""
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
