"""Threads of linear algebra: how many there are can change the rounding of results."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache

from threadpoolctl import ThreadpoolController


def blas_threads() -> int:
    """Return the number of threads that multiply matrices; it can change the rounding of results."""
    return max(
        (int(pool["num_threads"]) for pool in _libraries(len(sys.modules)).info() if pool["user_api"] == "blas"),
        default=1,
    )


@contextmanager
def with_blas_threads(count: int) -> Iterator[None]:
    """Have matrices multiplied by so many threads within a ``with``.

    Where they are small, threads would wait for each other, the longer the busier the machine. SciPy has a library of
    its own: one that is loaded within the ``with`` would have as many threads as it likes, and a process's first
    rendering other bits than its second.
    """
    import scipy.linalg  # noqa: F401

    with _libraries(len(sys.modules)).limit(limits=count, user_api="blas"):
        yield


@lru_cache(maxsize=1)
def _libraries(modules: int) -> ThreadpoolController:
    """Return the libraries of this process; the search takes milliseconds and is repeated after new imports."""
    return ThreadpoolController()
