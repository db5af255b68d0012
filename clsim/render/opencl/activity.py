"""Active samples of branch signals; engines skip the others without changing a bit."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

CELL = 16  # samples
_SPARSE = 0.5  # share of active cells, below which it pays to look


@dataclass(frozen=True, slots=True, eq=False)
class Activity:
    """Cells of `CELL` samples of branch signals in which any of them is not zero."""

    cells: NDArray[np.bool_]  # (cells,) whether they are active

    def __or__(self, other: Activity) -> Activity:
        """Return the union of both."""
        return Activity(self.cells | other.cells)

    @property
    def pays(self) -> bool:
        """Whether few enough cells are active for skipping to be cost-effective."""
        return float(np.mean(self.cells)) < _SPARSE

    @property
    def following(self) -> NDArray[np.int32]:
        """The nearest active cell from each one on, or the number of cells, (cells,)."""
        count = len(self.cells)
        index = np.where(self.cells, np.arange(count, dtype=np.int32), np.int32(count))
        return np.asarray(np.minimum.accumulate(index[::-1])[::-1])

    @property
    def preceding(self) -> NDArray[np.int32]:
        """The nearest active cell up to each one, or -1, (cells,)."""
        index = np.where(self.cells, np.arange(len(self.cells), dtype=np.int32), np.int32(-1))
        return np.asarray(np.maximum.accumulate(index))


def find_activity(active: NDArray[np.int64], count: int, before: int, after: int) -> Activity:
    """Find the active cells of branch signals; active (n,).

    active: samples that are not zero of what the branch filters filter; the first sample of the branches is at
    `before`.
    """
    cells = -(-count // CELL)
    # A sample at i is heard by branches from i - after - before to i.
    begun = np.bincount(np.clip((active - before - after) // CELL, 0, cells), minlength=cells + 1)
    ended = np.bincount(np.clip(active // CELL + 1, 0, cells), minlength=cells + 1)
    return Activity(np.cumsum(begun - ended)[:-1] > 0)
