"""Blocks in which paths begin or end: found on the host, rendered sample by sample on the device."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.tracks.transition import heard_samples

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Floats
    from clsim.render.opencl.batches import PathBatch
    from clsim.render.plan import Plan

_NEVER = 2**40  # samples


@dataclass(frozen=True, slots=True, eq=False)
class Boundaries:
    """Active intervals of the paths of a batch.

    Attributes
    ----------
    first, last : ndarray (slots,) int64
        First sample with a weight, and the one after the last; of slots that fill up a batch the last is the lower.
    """

    start: Floats  # (slots,) boundaries in samples from time 0; infinite where there is none
    end: Floats  # likewise
    first: NDArray[np.int64]
    last: NDArray[np.int64]
    ramp: float  # length of a transition, samples; 0 where paths begin and end at once

    def samples_from(self, start: int) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        """Return first and last as counted from a sample on, bounded to 31 bits."""
        most = 2**30
        first, last = (np.clip(x - start, -most, most).astype(np.int32) for x in (self.first, self.last))
        return first, last


@dataclass(frozen=True, slots=True, eq=False)
class Fades:
    """Slots and blocks with a transition weight, grouped by receiver and block."""

    slot: NDArray[np.int32]  # (n,) which
    block: NDArray[np.int32]  # likewise
    start: NDArray[np.float32]  # (n,) boundaries in samples from the block's start
    end: NDArray[np.float32]  # likewise
    first: NDArray[np.int32]  # (places + 1,) where each receiver and block begins in the columns above
    row: NDArray[np.int32]  # (places,) row of its receiver's first channel in the output
    at: NDArray[np.int32]  # (places,) its block


def boundaries(plan: Plan, batch: PathBatch) -> Boundaries:
    """Return the times at which the paths of a batch begin and end."""
    rate, transition = plan.sampling_rate, plan.tracks.transition
    pairs = [plan.tracks.pairs[i] for i in batch.pairs]
    rows = [batch.path[batch.of_pair(i)] for i in range(len(pairs))]
    start = np.concatenate([g.start[r] for g, r in zip(pairs, rows, strict=True)])
    end = np.concatenate([g.end[r] for g, r in zip(pairs, rows, strict=True)])
    first, last = heard_samples(start, end, transition, rate)
    # Ends before it begins: an empty interval would lie within a block that begins before 0 s and count as heard there.
    first[batch.padding], last[batch.padding] = _NEVER, -_NEVER
    if transition == 0.0:  # at once: between samples
        return Boundaries(first.astype(np.float64), last.astype(np.float64), first, last, 0.0)
    return Boundaries(start * rate, end * rate, first, last, transition * rate)


def find_fades(bounds: Boundaries, batch: PathBatch, start: int, block: int, blocks: int) -> Fades | None:
    """Return the beginnings and ends of paths within some blocks from a sample on; None if there are none."""
    found = []
    for place in (bounds.start, bounds.end):
        half = 0.5 * bounds.ramp
        low = np.clip((place - half - start) / block, -1.0, blocks)
        high = np.clip((place + half - start) / block, -1.0, blocks)
        low, high = np.floor(low).astype(np.int64), np.floor(high).astype(np.int64)
        if bounds.ramp == 0.0:
            high = np.where(place - start == high * block, low - 1, high)  # at once and between blocks: nothing to do
        high = np.minimum(high, blocks - 1)
        low = np.maximum(low, 0)
        count = np.where(batch.padding, 0, np.maximum(high - low + 1, 0))
        which = np.repeat(np.arange(batch.count), count)
        found.append((which, low[which] + np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count)))
    slot, at = (np.concatenate([f[i] for f in found]) for i in range(2))
    if not len(slot):
        return None
    slot, at = np.unique(np.stack([slot, at]), axis=1)
    pair = np.searchsorted(batch.first_slot, slot, side="right") - 1
    order = np.lexsort((slot, at, pair))
    slot, at, pair = slot[order], at[order], pair[order]
    new = np.flatnonzero(np.diff(pair * np.int64(blocks) + at, prepend=-1))
    begin = (start + at * block).astype(np.float64)
    far = 2.0**23

    def here(place: Floats) -> NDArray[Any]:
        """Return sample indices of the run from its beginning, bounded to the exact range of float32."""
        return np.asarray(np.clip(place[slot] - begin, -far, far), dtype=np.float32)

    return Fades(
        slot.astype(np.int32), at.astype(np.int32), here(bounds.start), here(bounds.end),
        np.append(new, len(slot)).astype(np.int32), batch.row[pair[new]], at[new].astype(np.int32),
    )  # fmt: skip
