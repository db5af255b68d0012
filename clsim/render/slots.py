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
class Slots:
    """Paths in the order in which the device walks them.

    Attributes
    ----------
    groups : tuple of int
        Track groups, one per receiver of the batch.
    receiver : ndarray (groups,) int32
        Receiver of each group.
    first_slot : ndarray (groups + 1,) int32
        Where the slots of each group begin; whole batches.
    path : ndarray (slots,) int64
        Row of each slot in its group.
    filling : ndarray (slots,) bool
        Slots that only fill up a batch: silent copies of a path.
    """

    groups: tuple[int, ...]
    receiver: NDArray[np.int32]
    first_slot: NDArray[np.int32]
    path: NDArray[np.int64]
    filling: NDArray[np.bool_]

    @property
    def count(self) -> int:
        """Number of slots."""
        return len(self.path)

    def of_group(self, i: int) -> slice:
        """Return the slots of the batch's i-th group."""
        return slice(int(self.first_slot[i]), int(self.first_slot[i + 1]))


def fill_slots(plan: Plan, groups: list[int], ranges: list[tuple[Floats, Floats]], batch: int) -> Slots:
    """Return the slots of some groups; `ranges` bound their delays (paths,), by whose middle they are sorted."""
    path, filling, first = [], [], [0]
    for low, high in ranges:
        order = np.argsort(low + high, kind="stable")
        extra = -len(order) % batch
        path.append(np.concatenate([order, np.full(extra, order[-1])]))
        filling.append(np.arange(len(order) + extra) >= len(order))
        first.append(first[-1] + len(order) + extra)
    receivers = [plan.tracks.groups[i].receiver for i in groups]
    return Slots(
        tuple(groups),
        np.array(receivers, dtype=np.int32),
        np.array(first, dtype=np.int32),
        np.concatenate(path),
        np.concatenate(filling),
    )
