"""Evenly spaced instants, evaluated only as closely as the motion asks for."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from clsim.arrays import Floats

    Indices = NDArray[np.int64]
    Probe = Callable[[Indices, Indices, Indices], tuple[Indices, NDArray[np.bool_]]]

_BATCH = 8192  # ranges evaluated at a time


@dataclass(frozen=True, slots=True)
class Instants:
    """Times from `start` to `end`, evenly spaced, at least `rate` a second; however many, they take no memory."""

    start: float
    end: float
    rate: float

    @property
    def count(self) -> int:
        return max(math.ceil((self.end - self.start) * self.rate), 1 if self.end > self.start else 0) + 1

    @property
    def step(self) -> float:
        """From one to the next, s."""
        return (self.end - self.start) / max(self.count - 1, 1)

    def times(self, index: Indices) -> Floats:
        """Return the times of some of them, s."""
        return np.asarray(self.start + self.step * index)

    def margin(self, first: Indices, middle: Indices, last: Indices) -> Floats:
        """Return largest distance in time from an instant to the ends of its range, s."""
        return np.asarray(self.step * np.maximum(middle - first, last - middle))

    def first(self, probe: Probe) -> int | None:
        """Return the first instant for which `probe` reports a hit, the same as by evaluating every instant.

        probe: takes the first, the middle and the last instants of ranges (n,), in the order of time. Returns the first
        that is surely met in each, or -1, and whether others of the range may be: then its halves before and behind the
        middle are evaluated as well.
        """
        met, waiting = None, [np.array([[0, self.count - 1]])]
        while waiting:
            ranges = waiting.pop()
            if len(ranges) > _BATCH:
                waiting.append(ranges[_BATCH:])
            ranges = ranges[:_BATCH]
            first, last = ranges.T
            middle = (first + last) // 2
            hit, unsure = probe(first, middle, last)
            hits = np.flatnonzero(hit >= 0)
            if len(hits):  # what is later does not matter any more
                i, waiting = int(hits[0]), []
                met = int(hit[i])
                first, middle, last, unsure = first[: i + 1], middle[: i + 1], last[: i + 1].copy(), unsure[: i + 1]
                last[i] = met - 1
            halves = _halves(first[unsure], middle[unsure], last[unsure])
            if len(halves):
                waiting.append(halves)
        return met


def _halves(first: Indices, middle: Indices, last: Indices) -> Any:
    """Return ranges before and behind their middles, (2 n, 2) at most, in the order of time."""
    halves = np.stack([first, np.minimum(middle - 1, last), middle + 1, last], axis=1).reshape(-1, 2)
    return halves[halves[:, 0] <= halves[:, 1]]
