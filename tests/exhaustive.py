"""Tests of which a few of a kind run at every change, more in the gate, and all of them by `make test-exhaustive`."""

from collections.abc import Container, Iterable
from typing import Any

import pytest

EVERY = 8  # of the many of a kind, one that the gate runs


def few(values: Iterable[Any], kept: Container[Any] = (0,), *, many: bool = False) -> list[Any]:
    """Values of a test's parameters, of which those at the places `kept` run at every change.

    Of `many` the gate runs every eighth.
    """
    return [value if at in kept else exhaustive(value, long=many and at % EVERY > 0) for at, value in enumerate(values)]


def exhaustive(value: Any, *, long: bool = False) -> Any:
    """A value of a test's parameters, several of them as a tuple, with which only `make test-exhaustive` runs it.

    So does the gate, if it is not too long for it.
    """
    given, name = getattr(value, "values", value), getattr(value, "id", None)
    given = given if isinstance(given, tuple) else (given,)
    marks = [*getattr(value, "marks", ()), pytest.mark.exhaustive, *([pytest.mark.long] if long else [])]
    return pytest.param(*given, id=name, marks=marks)
