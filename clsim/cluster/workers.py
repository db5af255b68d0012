"""Who does the work: processes of this machine, or the workers of a Dask scheduler."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from clsim.cluster.dispatch import WorkersLostError
from clsim.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Generator, Sequence

    from clsim.cluster.dispatch import Dispatch, Row, Tasks

PACKAGES = ("dask", "distributed", "xarray", "zarr")  # that workers need
_STARTS = 3  # of the processes of this machine, without any task done with in between


@dataclass(frozen=True, slots=True)
class Workers:
    """Workers that are asked for.

    Attributes
    ----------
    number : int or None
        Processes on this machine: one per GPU, else one per two cores where None.
    scheduler : str or None
        Address of a running Dask scheduler, whose workers do the work instead.

    Raises
    ------
    InputError
        If both are given, or the number is below 1.

    Examples
    --------
    >>> Workers(number=0)
    Traceback (most recent call last):
        ...
    clsim.errors.InputError: --workers: must be at least 1, but is 0
    """

    number: int | None = None
    scheduler: str | None = None

    def __post_init__(self) -> None:
        if self.number is not None and self.scheduler is not None:
            raise InputError("--workers", "must be left out, because the scheduler has its own")
        if self.number is not None and self.number < 1:
            raise InputError("--workers", f"must be at least 1, but is {self.number}")

    def check_reach(self) -> None:
        """See that there is somebody to do the work, before there is any.

        Raises
        ------
        InputError
            If a scheduler cannot be reached.
        """
        from clsim.cluster.team import check_reach

        if self.scheduler is not None:
            check_reach(self.scheduler)

    def count(self) -> int:
        """Return how many processes are wanted on this machine; 0 where others do the work."""
        from clsim.cluster.team import worker_count

        return 0 if self.scheduler else worker_count(self.number)

    def at_most(self, number: int) -> Workers:
        """Return these, but no more processes of this machine than there is work for."""
        return self if self.scheduler else Workers(max(1, min(self.count(), number)))

    def rows(self, dispatch: Dispatch, tasks: Tasks, devices: Sequence[str]) -> Generator[tuple[int, Row], None, None]:
        """Have tasks done; yield number and row of each. If all processes of this machine are lost, start new ones.

        Parameters
        ----------
        dispatch : Dispatch
            What is to be done.
        tasks : Tasks
            How.
        devices : sequence of str
            Of this machine, over which its workers are spread.

        Raises
        ------
        InputError
            If a scheduler cannot be reached, or has no workers, or one that cannot work.
        DeviceError
            If a worker has no device.
        WorkersLostError
            If no worker of this machine starts, or none comes back.
        """
        from clsim.cluster.team import local_team, remote_team

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
