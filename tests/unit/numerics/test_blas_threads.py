"""How many threads multiply matrices, and how that is bounded."""

import sys
from types import ModuleType

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from clsim.numerics.blas import blas_threads, with_blas_threads


def told() -> list[int]:
    return [pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"]


def test_threads_are_bounded_within_only() -> None:
    """The number of threads that threadpoolctl reports for NumPy's and SciPy's libraries now, not at the first look."""
    np.linalg.svd(np.eye(3))
    __import__("scipy.linalg")
    if max(told(), default=1) == 0:
        pytest.skip("no library of linear algebra is known")
    with threadpool_limits(2, "blas"):
        assert blas_threads() == max(told())
        before = told()
        with with_blas_threads(1):
            assert set(told()) == {1}
            assert blas_threads() == 1
        assert told() == before


def test_libraries_are_looked_for_again_when_modules_were_loaded(monkeypatch: pytest.MonkeyPatch) -> None:
    from clsim.numerics import blas as module

    first = module._libraries()
    assert module._libraries() is first
    monkeypatch.setitem(sys.modules, "another", ModuleType("another"))
    assert module._libraries() is not first
