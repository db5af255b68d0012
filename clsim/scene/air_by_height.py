"""Temperatures and humidities that depend on the height, and what follows from them, as polynomials."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.arrays import as_floats, as_number
from clsim.errors import InputError

if TYPE_CHECKING:
    from clsim.arrays import Floats

ByHeight = float | tuple[float, float] | Callable[["Floats"], Any]  # a number, (lower, upper), or a function of heights
UNPLACED = (0.0, 1.0)  # m, heights of air that is in no room yet
MOST_TERMS = 33  # of polynomials


def told_by_height(field: str, value: Any, **rule: Any) -> ByHeight:
    """Return a number, a pair of numbers, or a function of heights; pairs of the same number are that."""
    if callable(value):
        function: Callable[[Floats], Any] = value
        return function
    if isinstance(value, (list, tuple, np.ndarray)):
        low, high = (
            as_number(f"{field}[{i}]", v, **rule) for i, v in enumerate(as_floats(field, value, (2,)).tolist())
        )
        return low if low == high else (low, high)
    return as_number(field, value, **rule)


def at_heights(field: str, told: ByHeight, where: tuple[float, float], heights: Floats) -> Floats:
    """Return values at heights (n,) in m of what was told; pairs hold at two heights, and on a straight line."""
    if isinstance(told, tuple):
        return told[0] + (told[1] - told[0]) * (heights - where[0]) / (where[1] - where[0])
    if not callable(told):
        return np.full(len(heights), told)
    found = np.asarray(told(heights), dtype=np.float64)
    if found.shape not in ((), heights.shape) or not np.all(np.isfinite(found)):
        raise InputError(
            field,
            f"must return a finite number for each of {len(heights)} heights, but returns {found!r:.80}",
        )
    return np.broadcast_to(found, heights.shape)


def places(extent: tuple[float, float], count: int) -> Floats:
    """Return Chebyshev's points (count,) of a range of heights, m."""
    return 0.5 * (extent[0] + extent[1]) + 0.5 * (extent[1] - extent[0]) * np.cos(_angles(count))


def coefficients(values: Floats) -> Floats:
    """Return Chebyshev's coefficients (n, ...) of the polynomial with values (n, ...) at `places`."""
    count = len(values)
    turns = np.cos(np.arange(count)[:, None] * _angles(count))
    turns[0] *= 0.5
    return np.asarray(np.tensordot(2.0 / count * turns, values, axes=1))


def _angles(count: int) -> Floats:
    return np.asarray(np.pi * (np.arange(count) + 0.5) / count)
