"""Paths of one source by walls, as a search in a mesh finds them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Floats


@dataclass(frozen=True, slots=True, eq=False)
class FoundPaths:
    """Paths of one source, sorted by receiver, order, walls and time."""

    receiver: NDArray[np.int64]  # (P,) which, and number of reflections
    order: NDArray[np.int64]  # likewise
    walls: NDArray[np.int32]  # (P, max_order) from the source's side, filled up with -1
    begin: Floats  # (P,) interval in which it is heard, s; infinite where it reaches an end of what matters
    end: Floats  # likewise
    met: NDArray[np.int32] | None = None  # (P, N) of walls and panels, see `divided`; None for walls alone

    @staticmethod
    def none(max_order: int) -> FoundPaths:
        """Return no paths."""
        no = np.empty(0, dtype=np.int64)
        return FoundPaths(no, no, np.empty((0, max_order), dtype=np.int32), np.empty(0), np.empty(0))

    @staticmethod
    def joined(parts: list[FoundPaths]) -> FoundPaths:
        """Return the paths of several parts."""
        names = ("receiver", "order", "walls", "begin", "end")
        return FoundPaths(*(np.concatenate([getattr(p, name) for p in parts]) for name in names))
