"""Slots: the paths of a batch of receivers as the device sees them, sorted by delay and filled up to whole batches."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Floats
    from clsim.render.plan import Plan


@dataclass(frozen=True, slots=True, eq=False)
class ActivePaths:
    """The active paths of one pair in an interval."""

    index: int  # of the pair, in `Tracks.pairs`
    rows: NDArray[np.int64]  # (n,) its paths
    low: Floats  # (n,) bounds of their delays over the chunk, s
    high: Floats  # likewise

    def during(self, plan: Plan, first: int, last: int) -> ActivePaths:
        """Return those active within samples `first` to `last`."""
        pair, ramp = plan.tracks.pairs[self.index], 0.5 * plan.tracks.transition
        begin, end = first / plan.sampling_rate, last / plan.sampling_rate
        heard = (pair.start[self.rows] - ramp <= end) & (pair.end[self.rows] + ramp >= begin)
        return ActivePaths(self.index, self.rows[heard], self.low[heard], self.high[heard])

    def parts(self, most: int) -> list[ActivePaths]:
        """Return them in parts of at most so many, neighbours by delay; none of none."""
        if len(self.rows) <= most:
            return [self] if len(self.rows) else []
        order = np.argsort(self.low + self.high, kind="stable")
        pieces = (order[first : first + most] for first in range(0, len(order), most))
        return [ActivePaths(self.index, self.rows[i], self.low[i], self.high[i]) for i in pieces]


@dataclass(frozen=True, slots=True, eq=False)
class PathBatch:
    """Paths in the order in which the device walks them."""

    pairs: tuple[int, ...]  # indices in `Tracks.pairs`, one per receiver of the batch
    receiver: NDArray[np.int32]  # (pairs,) receiver of each pair
    row: NDArray[np.int32]  # (pairs,) first row of the pressure that has the pair's paths
    first_slot: NDArray[np.int32]  # (pairs + 1,) where the slots of each pair begin; whole batches
    path: NDArray[np.int64]  # (slots,) row of each slot in its pair
    padding: NDArray[np.bool_]  # (slots,) slots that only fill up a batch: silent copies of a path
    shortest: float  # bounds of all delays over the chunk, s
    longest: float  # likewise

    @property
    def count(self) -> int:
        """Number of slots."""
        return len(self.path)

    def of_pair(self, i: int) -> slice:
        """Return the slots of the batch's i-th pair."""
        return slice(int(self.first_slot[i]), int(self.first_slot[i + 1]))


def fill_batch(plan: Plan, active: list[ActivePaths], batch: int, apart: int = 1) -> PathBatch:
    """Return the slots of some pairs' active paths, sorted by the middle of their delays.

    apart: slots side by side that are dealt from so many equal stretches of that order.
    """
    path, padding, first = [], [], [0]
    for pair in active:
        order = pair.rows[np.argsort(pair.low + pair.high, kind="stable")]
        extra = -len(order) % batch
        dealt = np.arange(len(order) + extra).reshape(apart, -1).T.ravel()
        path.append(np.concatenate([order, np.full(extra, order[-1])])[dealt])
        padding.append(dealt >= len(order))
        first.append(first[-1] + len(order) + extra)
    receivers = [plan.tracks.pairs[pair.index].receiver for pair in active]
    return PathBatch(
        tuple(pair.index for pair in active),
        np.array(receivers, dtype=np.int32),
        np.array([plan.rows_of_pair(pair.index).start for pair in active], dtype=np.int32),
        np.array(first, dtype=np.int32),
        np.concatenate(path),
        np.concatenate(padding),
        min(float(pair.low.min()) for pair in active),
        max(float(pair.high.max()) for pair in active),
    )
