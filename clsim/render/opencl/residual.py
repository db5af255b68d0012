"""Residual of the functions of frequency, of all paths together, relative to the received signal at that time."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Floats


class Residual:
    """Residual of one source's paths that no function represents, by segment and receiver, over their level.

    Functions are designed for the sum of a receiver's paths of all kinds, relative to its level over 40 ms. A
    segment with only the last echoes of a pulse is therefore compared with the level of its neighbours too.
    """

    def __init__(self, receivers: int) -> None:
        self._receivers = receivers
        self._squares: dict[int, Floats] = {}  # by segment, (2, receivers): what no function holds, and what is heard
        self._worst = 0.0

    def add(self, first: int, receiver: NDArray[np.int32], squares: Floats) -> None:
        """Add squares (2, segments, n) of residual and level of paths to some receivers (n,), from a segment on."""
        for i in range(squares.shape[1]):
            here = self._squares.setdefault(first + i, np.zeros((2, self._receivers)))
            here[:, receiver] += squares[:, i]

    def settle(self, before: int) -> None:
        """Close the segments before one: take their maximum and drop their sums."""
        self._worst = max(self._worst, self._largest([s for s in self._squares if s < before - 1]))
        self._squares = {s: here for s, here in self._squares.items() if s >= before - 2}

    @property
    def level_db(self) -> float:
        """The largest residual relative to the received level, dB."""
        return 10.0 * math.log10(max(self._worst, self._largest(list(self._squares)), 1e-30))

    def _largest(self, segments: list[int]) -> float:
        """Return the largest squared residual of some segments."""
        largest = 0.0
        for s in segments:
            about = [self._squares[n][1] for n in (s - 1, s, s + 1) if n in self._squares]
            part = self._squares[s][0] / np.maximum(np.max(about, axis=0), 1e-30)
            largest = max(largest, float(part.max()))
        return largest
