"""Which member of a study is run when and by which worker, so that none is blamed for what another one did."""

from __future__ import annotations

import time
from collections import Counter, deque
from typing import TYPE_CHECKING, Any, Protocol

from clsim.errors import ClsimError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

PATIENCE = 60.0  # s without a worker
_TOGETHER = 2  # times that a member is run beside others though its worker died
_ALONE = 3  # times that it is run alone after that
_TICK = 0.25  # s after which the workers are looked at


class WorkersLostError(ClsimError):
    """There was no worker for too long."""


class Team(Protocol):
    """Processes that run members."""

    def workers(self) -> dict[str, int]:
        """Return the workers that are there, and how many members each runs at a time."""

    def begin(self, number: int, worker: str) -> None:
        """Have a worker, and no other, run a member."""

    def forget(self, number: int) -> None:
        """Want nothing more of a member whose worker died."""

    def done(self, seconds: float) -> tuple[int, dict[str, Any] | None] | None:
        """Return a member that is done with and its row, None if its worker died; None if there is none in time."""


class Dispatch:
    """Members that are still to be run.

    A worker is given only what it begins at once. If it dies, what it was at is run again; a member whose workers go on
    dying is run with nothing else beside it, when all others are done with. Only what dies then too is given up: it
    needs more than there is, or ends its process.

    Parameters
    ----------
    todo : list of int
        Numbers of members.
    patience : float
        Longest time without a worker, s.

    Attributes
    ----------
    left : int
        How many members are not done with.
    begun : bool
        Whether any was given to a worker.
    """

    def __init__(self, todo: list[int], patience: float = PATIENCE) -> None:
        self.left = len(todo)
        self.begun = False
        self._waiting, self._suspects = deque(todo), deque[int]()
        self._running: dict[int, str] = {}
        self._deaths: Counter[int] = Counter()
        self._patience = patience

    def rows(self, team: Team, found: Callable[[int], dict[str, Any] | None]) -> Iterator[dict[str, Any]]:
        """Run the members that are left; yield the row of each as soon as it is known.

        Parameters
        ----------
        team : Team
            That runs them.
        found : callable
            Returns the row of a member whose results are there, although its worker died before it could say so.

        Raises
        ------
        WorkersLostError
            If there is no worker for too long; another team can go on.
        """
        seen = time.monotonic()
        while self.left:
            there = team.workers()
            seen = time.monotonic() if there else seen
            for number in [n for n, worker in self._running.items() if worker not in there]:
                team.forget(number)
                yield from self._died(number, found)
            if not there and time.monotonic() - seen > self._patience:
                raise WorkersLostError(f"there was no worker for {self._patience:g} s")
            for number, worker in self._chosen(there):
                self._running[number], self.begun = worker, True
                team.begin(number, worker)
            done = team.done(_TICK)
            if done is None:
                continue
            number, row = done
            if row is None:
                yield from self._died(number, found)
            else:
                yield self._settled(number, row)

    def _chosen(self, there: dict[str, int]) -> Iterator[tuple[int, str]]:
        """Yield what is to be begun, and by whom: members on all free workers, or a suspect on one of them."""
        busy = Counter(self._running.values())
        free = [worker for worker, count in there.items() for _ in range(count - busy[worker])]
        if self._waiting:
            for worker in free[: len(self._waiting)]:
                yield self._waiting.popleft(), worker
        elif self._suspects and not self._running and free:
            yield self._suspects.popleft(), free[0]

    def _died(self, number: int, found: Callable[[int], dict[str, Any] | None]) -> Iterator[dict[str, Any]]:
        """Have a member whose worker died run again, or yield its row if it is done with."""
        row = found(number)
        if row is not None:
            yield self._settled(number, row)
            return
        del self._running[number]
        self._deaths[number] += 1
        if self._deaths[number] < _TOGETHER:
            self._waiting.append(number)
        elif self._deaths[number] < _TOGETHER + _ALONE:
            self._suspects.append(number)
        else:
            deaths = f"its worker died {self._deaths[number]} times, the last {_ALONE} while it ran nothing else"
            yield self._settled(
                number, {"member": number, "status": "failed", "error": f"{deaths} (out of memory?)", "seconds": 0.0}
            )

    def _settled(self, number: int, row: dict[str, Any]) -> dict[str, Any]:
        self._running.pop(number, None)
        self.left -= 1
        return row
