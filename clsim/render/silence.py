"""Where branch signals sound: what engines may leave out without a change of a single bit."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Floats

CELL = 32  # samples
_SPARSE = 0.5  # share of cells that sound, below which it pays to look


@dataclass(frozen=True, slots=True, eq=False)
class Sounding:
    """Cells of `CELL` samples of branch signals in which any of them is not zero.

    Attributes
    ----------
    following, preceding : ndarray (cells,) int32
        The nearest cell that sounds from each one on, or the number of cells; and up to it, or -1.
    """

    following: NDArray[np.int32]
    preceding: NDArray[np.int32]

    @property
    def pays(self) -> bool:
        """Whether so much is silent that it pays to look."""
        cells = np.arange(len(self.following))
        return float(np.mean(self.following == cells)) < _SPARSE


def sounding(streams: Floats, before: int, after: int) -> Sounding:
    """Return which cells sound.

    Parameters
    ----------
    streams : ndarray (K, before + n + after)
        What the branch filters filter; the first sample of the branches is at `before`.
    before, after : int
        Samples that the filters look at to either side.
    """
    heard = np.flatnonzero(np.any(streams != 0.0, axis=0))
    cells = -(-(streams.shape[1] - before - after) // CELL)
    # A sample at i is heard by branches from i - after - before to i.
    begun = np.bincount(np.clip((heard - before - after) // CELL, 0, cells), minlength=cells + 1)
    ended = np.bincount(np.clip(heard // CELL + 1, 0, cells), minlength=cells + 1)
    sounds = np.cumsum(begun - ended)[:-1] > 0
    index = np.arange(cells)
    following = np.minimum.accumulate(np.where(sounds, index, cells)[::-1])[::-1]
    preceding = np.maximum.accumulate(np.where(sounds, index, -1))
    return Sounding(following.astype(np.int32), preceding.astype(np.int32))
