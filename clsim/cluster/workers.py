"""Who does the work: processes of this machine, or the workers of a Dask scheduler."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

from clsim.cluster.dispatch import WorkersLostError
from clsim.errors import InputError, warn
from clsim.packages import check_packages

if TYPE_CHECKING:
    from collections.abc import Generator, Sequence

    from clsim.cluster.dispatch import Dispatch, Row, Tasks

_STORES = ("xarray", "zarr")  # packages by which workers write together
_SCHEDULERS = ("dask", "distributed")  # packages by which a scheduler is reached
_STARTS = 3  # of the processes of this machine, without any task done with in between


@dataclass(frozen=True, slots=True)
class Workers:
    """Workers that are asked for."""

    number: int | None = None  # processes on this machine: one per GPU, else one per two cores where None
    scheduler: str | None = None  # address of a running Dask scheduler, whose workers do the work instead

    def __post_init__(self) -> None:
        if self.number is not None and self.scheduler is not None:
            raise InputError("--workers", "must be left out, because the scheduler has its own")
        if self.number is not None and self.number < 1:
            raise InputError("--workers", f"must be at least 1, but is {self.number}")

    def check(self, field: str, what: str) -> None:
        """See that the packages are installed that these workers need, and that a scheduler can be reached.

        A scheduler of another machine that asks for no certificates is warned of: it runs what anybody sends.
        """
        check_packages(field, what, "study", *_STORES, *(_SCHEDULERS if self.scheduler else ()))
        if self.scheduler is None:
            return
        from clsim.cluster.team import check_reach

        check_reach(self.scheduler)
        if is_open(self.scheduler):
            warn(
                f"--scheduler: {self.scheduler} is reached without encryption: whoever reaches it, or reads along, can "
                "run programs on it, its workers and this machine; use tls:// with certificates"
            )

    def count(self) -> int:
        """Return how many processes are wanted on this machine; 0 where others do the work."""
        from clsim.cluster.processes import worker_count

        return 0 if self.scheduler else worker_count(self.number)

    def at_most(self, number: int) -> Workers:
        """Return these, but no more processes of this machine than there is work for."""
        return self if self.scheduler else Workers(max(1, min(self.count(), number)))

    def rows(self, dispatch: Dispatch, tasks: Tasks, devices: Sequence[str]) -> Generator[tuple[int, Row], None, None]:
        """Have tasks done; yield number and row of each. If all processes of this machine are lost, start new ones."""
        from clsim.cluster.processes import local_team
        from clsim.cluster.team import remote_team

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
    """Return whether a scheduler is on another machine and asks its clients for no certificate.

    Examples
    --------
    >>> [is_open(f"{kind}://{host}:8786") for kind in ("tcp", "tls") for host in ("127.0.0.1", "[::1]", "10.0.0.1")]
    [False, False, True, False, False, False]
    """
    parts = urlsplit(scheduler if "://" in scheduler else f"tcp://{scheduler}")
    host = (parts.hostname or "").rstrip(".")
    here = host in ("", "localhost", "::1") or host.startswith("127.")
    return parts.scheme != "tls" and not here
