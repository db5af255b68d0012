"""Evenly spaced times, and the first of them at which something is met, found without looking at all."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Floats

Indices = NDArray[np.int64]
Probe = Callable[[Indices, Indices, Indices], tuple[Indices, NDArray[np.bool_]]]

BATCH = 8192  # ranges evaluated at a time


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
        """Return the first instant for which `probe` reports a hit, the same as by evaluating every instant."""
        # It takes the first, middle and last instants of ranges (n,), in the order of time. It returns the first that
        # is surely met in each, or -1, and whether others of the range may be met: its halves are then evaluated as
        # well.
        met, waiting = None, [np.array([[0, self.count - 1]])]
        while waiting:
            ranges = waiting.pop()
            if len(ranges) > BATCH:
                waiting.append(ranges[BATCH:])
            ranges = ranges[:BATCH]
            first, last = ranges.T
            middle = (first + last) // 2
            hit, unsure = probe(first, middle, last)
            hits = np.flatnonzero(hit >= 0)
            if len(hits):  # what is later does not matter any more
                i, waiting = int(hits[0]), []
                met = int(hit[i])
                first, middle, last, unsure = first[: i + 1], middle[: i + 1], last[: i + 1].copy(), unsure[: i + 1]
                last[i] = met - 1
            ends = first, np.minimum(middle - 1, last), middle + 1, last
            halves = np.stack([end[unsure] for end in ends], axis=1).reshape(-1, 2)
            halves = halves[halves[:, 0] <= halves[:, 1]]  # before and behind middles, in the order of time
            if len(halves):
                waiting.append(halves)
        return met
