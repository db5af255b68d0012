"""Tests of which a few of a kind run at every change, and all of them by `make test-exhaustive`."""

from collections.abc import Container, Iterable
from typing import Any

import pytest


def few(values: Iterable[Any], kept: Container[Any] = (0,)) -> list[Any]:
    """Return the values of a test's parameters: at every change it runs with those at the places `kept`."""
    return [value if at in kept else exhaustive(value) for at, value in enumerate(values)]


def exhaustive(value: Any) -> Any:
    """Return a value of a test's parameters, several of them as a tuple, with which only `make test-exhaustive` runs it."""
    given, name = getattr(value, "values", value), getattr(value, "id", None)
    given = given if isinstance(given, tuple) else (given,)
    return pytest.param(*given, id=name, marks=[*getattr(value, "marks", ()), pytest.mark.exhaustive])
