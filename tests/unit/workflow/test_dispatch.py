"""Which task is done when: none is blamed for another, none waits for ever. The workers are make-believe."""

import itertools
import random
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any

import pytest

from clsim.errors import InputError
from clsim.workflow import processes as dispatch_module
from clsim.workflow.processes import Dispatch, WorkersLostError
from clsim.workflow.workers import Workers


class MadeTeam:
    """Workers that run members, one step of work for each look at them, and die of some.

    Parameters
    ----------
    count : int
        Workers, of `threads` each; one that dies is replaced by one of another name after three looks.
    kills : function
        Says whether a member ends its worker, from its number and those that run in the same process.
    outside : function
        Returns workers that die of something else, from those that are there.
    """

    def __init__(
        self, count: int, threads: int = 1, kills=lambda number, beside: False, outside=lambda there: []
    ) -> None:
        self._names = itertools.count()
        self._threads, self._kills, self._outside = threads, kills, outside
        self.there = {f"w{next(self._names)}": 0 for _ in range(count)}  # looks until it is there
        self.running: dict[int, str] = {}
        self.begun: list[tuple[int, set[int]]] = []
        self.finished: list[int] = []
        self.stored: set[int] = set()

    def workers(self) -> dict[str, int]:
        self.there = {name: max(0, evaluations - 1) for name, evaluations in self.there.items()}
        up = [name for name, evaluations in self.there.items() if not evaluations]
        for name in self._outside(up):
            self._die(name)
        return {name: self._threads for name in up if name in self.there}

    def _die(self, name: str) -> None:
        del self.there[name]
        self.there[f"w{next(self._names)}"] = 3

    def begin(self, number: int, worker: str) -> None:
        assert number not in self.running
        assert list(self.running.values()).count(worker) < self._threads, "nothing is given in advance"
        self.begun.append((number, set(self.running)))
        self.running[number] = worker

    def forget(self, number: int) -> None:
        assert self.running.pop(number) not in self.there

    def done(self, seconds: float) -> tuple[int, dict[str, Any] | None] | None:
        for number, worker in list(self.running.items()):
            if worker not in self.there:
                continue
            if self._kills(number, {n for n, w in self.running.items() if w == worker}):
                self._die(worker)
                return None
            del self.running[number]
            self.finished.append(number)
            return number, {"status": "finished"}
        return None


def run(team: MadeTeam, members: int, **options: Any) -> dict[int, dict[str, Any]]:
    def found(number: int) -> dict[str, Any] | None:
        return {"status": "finished"} if number in team.stored else None

    rows = list(Dispatch(list(range(members)), **options).rows(team, found))
    assert sorted(number for number, _ in rows) == list(range(members)), "each has one row"
    return dict(rows)


@pytest.mark.parametrize("threads", [1, 4])
@pytest.mark.parametrize("count", [1, 2, 3])
@pytest.mark.parametrize("killers", [{0}, {1}, {2}, {0, 2}, {0, 1, 2, 3, 4}])
def test_only_what_kills_alone_fails(count: int, threads: int, killers: set[int]) -> None:
    team = MadeTeam(count, threads, kills=lambda number, beside: number in killers)
    rows = run(team, 5)
    assert {n for n, row in rows.items() if row["status"] == "failed"} == killers
    for number in killers:
        assert rows[number]["error"].startswith("its worker died 5 times, the last 3 while it ran nothing else")
        assert sum(n == number for n, _ in team.begun) == 5
        assert [beside for n, beside in team.begun if n == number][2:] == [set()] * 3


@pytest.mark.parametrize("count", [1, 2])
def test_what_needs_all_memory_runs_alone(count: int) -> None:
    team = MadeTeam(count, 4, kills=lambda number, beside: number in (1, 2) and len(beside) > 1)
    assert {row["status"] for row in run(team, 6).values()} == {"finished"}


@pytest.mark.parametrize("seed", range(20))
def test_workers_killed_at_random_blame_nobody(seed: int) -> None:
    chance, kills = random.Random(seed), itertools.count()

    def outside(there: list[str]) -> list[str]:
        return [name for name in there if chance.random() < 0.1 and next(kills) < 50]

    team = MadeTeam(2, chance.choice([1, 2]), outside=outside)
    rows = run(team, 100)
    assert next(kills) >= 10
    assert {row["status"] for row in rows.values()} == {"finished"}
    assert set(Counter(team.finished).values()) == {1}


def test_what_becomes_ready_comes_before_what_waits() -> None:
    team, dispatch = MadeTeam(1), Dispatch([0, 10, 20])
    for number, _ in dispatch.rows(team, lambda number: None):
        if number % 10 < 2:
            dispatch.add(number + 1)
    assert team.finished == [0, 1, 2, 10, 11, 12, 20, 21, 22]
    assert dispatch.left == 0


def test_what_was_stored_before_its_worker_died_is_done() -> None:
    team = MadeTeam(1, kills=lambda number, beside: team.stored.add(number) or number == 1)
    assert {row["status"] for row in run(team, 3).values()} == {"finished"}
    assert [n for n, _ in team.begun] == [0, 1, 2]


def test_deaths_that_dask_counts_are_deaths() -> None:
    class Killed(MadeTeam):
        def done(self, seconds: float) -> Any:
            found = super().done(seconds)
            return found if found is None or found[0] != 1 else (1, None)

    rows = run(Killed(2), 3)
    assert [rows[n]["status"] for n in range(3)] == ["finished", "failed", "finished"]


@pytest.mark.parametrize("left", [0, 2])
def test_nothing_waits_for_ever_without_workers(monkeypatch: pytest.MonkeyPatch, left: int) -> None:
    clock = itertools.count()
    monkeypatch.setattr(dispatch_module, "time", SimpleNamespace(monotonic=lambda: float(next(clock))))
    dispatch, rows = Dispatch([0, 1, 2], patience=20.0), []
    team = MadeTeam(min(left, 1))

    def until_they_leave() -> None:
        for row in dispatch.rows(team, lambda number: None):
            rows.append(row)
            if len(rows) == left:
                team.there = {}

    with pytest.raises(WorkersLostError, match=r"there was no worker for 20 s"):
        until_they_leave()
    assert dispatch.left == 3 - len(rows)
    rows += dispatch.rows(MadeTeam(1), lambda number: None)  # another team goes on
    assert sorted(number for number, _ in rows) == [0, 1, 2]


class Leaving(MadeTeam):
    """Workers that finish one member each and do not come back."""

    def workers(self) -> dict[str, int]:
        return {} if self.finished else super().workers()


def run_with(monkeypatch: pytest.MonkeyPatch, teams: Iterator[MadeTeam | None], scheduler: str | None) -> list[int]:
    """Do three tasks by team after team, None for one that does not start; return what was done with."""

    @contextmanager
    def made(*_: Any) -> Iterator[MadeTeam]:
        team = next(teams)
        if team is None:
            raise WorkersLostError("no worker could be started")
        yield team

    monkeypatch.setattr("clsim.workflow.workers.local_team", made)
    monkeypatch.setattr("clsim.workflow.workers.remote_team", made)
    tasks: Any = SimpleNamespace(found=lambda number: None)
    workers = Workers(None if scheduler else 1, scheduler)
    return [number for number, _ in workers.rows(Dispatch([0, 1, 2], patience=0.0), tasks, [])]


def test_processes_that_do_not_come_back_are_started_again(monkeypatch: pytest.MonkeyPatch) -> None:
    teams = [None, None, Leaving(1), None, Leaving(1), None, None, Leaving(1)]
    assert sorted(run_with(monkeypatch, iter(teams), None)) == [0, 1, 2]


def test_processes_that_never_start_are_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    teams = iter([None] * 10)
    with pytest.raises(WorkersLostError, match="no worker could be started"):
        run_with(monkeypatch, teams, None)
    assert len(list(teams)) == 7


def test_workers_of_a_scheduler_are_not_ours_to_start(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match="--scheduler: must have workers, but there was no worker for 0 s"):
        run_with(monkeypatch, iter([Leaving(1)]), "tcp://127.0.0.1:1")
