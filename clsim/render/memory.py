"""The machine's memory, with errors that name the field that needs more, and threads of linear algebra."""

from __future__ import annotations

import os
import sys
from contextlib import contextmanager
from functools import lru_cache
from typing import TYPE_CHECKING

from threadpoolctl import ThreadpoolController

from clsim.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Iterator


@contextmanager
def within_memory(field: str, what: str, wanted: float) -> Iterator[None]:
    """Refuse what needs more memory than the machine has, and tell what needed it where less than that is free."""
    rule = f"must ask for less memory: {what} needs about {wanted / 2**20:.0f} MiB"
    there = machine_memory()
    if wanted > there:
        raise InputError(field, f"{rule}, but the machine has {there / 2**20:.0f} MiB")
    try:
        yield
    except MemoryError as error:
        raise InputError(field, f"{rule}, but there is not enough memory left") from error


def machine_memory() -> float:
    """Return the machine's memory, bytes; infinite where the system does not say."""
    try:
        return float(os.sysconf("SC_PHYS_PAGES")) * float(os.sysconf("SC_PAGE_SIZE"))
    except (AttributeError, ValueError, OSError):
        return float("inf")


def blas_threads() -> int:
    """Return the number of threads that multiply matrices; it can change the rounding of results."""
    return max((int(pool["num_threads"]) for pool in _libraries().info() if pool["user_api"] == "blas"), default=1)


@contextmanager
def with_blas_threads(count: int) -> Iterator[None]:
    """Have matrices multiplied by so many threads within a ``with``.

    Where they are small, threads would wait for each other, the longer the busier the machine. SciPy has a library of
    its own: one that is loaded within the ``with`` would have as many threads as it likes, and a process's first
    rendering other bits than its second.
    """
    import scipy.linalg  # noqa: F401

    with _libraries().limit(limits=count, user_api="blas"):
        yield


def _libraries() -> ThreadpoolController:
    """Return the libraries of this process; the search takes milliseconds and is repeated after new imports."""
    return _found(len(sys.modules))


@lru_cache(maxsize=1)
def _found(modules: int) -> ThreadpoolController:
    return ThreadpoolController()
