"""Slots: the paths of a batch of receivers on the device, blocks in which they begin or end, and active samples."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Floats, ranges
from clsim.paths.family import PathFamily
from clsim.render.plan import BATCH, Plan
from clsim.tracks.splines import audible_samples
from clsim.tracks.tracks import PairTracks

_TILE = 128  # paths whose branch signals stay in cache together


@dataclass(frozen=True, slots=True)
class Layout:
    """Layout of the sum of paths on a device: a subblock of samples over lanes of vectors, or over work-items."""

    lanes: int
    subblocks: int  # subblocks to a work-item, or to a group of them
    sparse_subblocks: int  # the same where signals pause
    nodes: int  # of a path, whose delays are solved side by side

    def constants(self, subblock: int, *, sparse: bool, fine: bool, oversampling: int) -> dict[str, int]:
        """Return the compile-time constants of the render kernel for a subblock's length."""
        workers = 1 if self.lanes > 1 else subblock
        return {
            "LANES": self.lanes, "VECTORS": subblock // (workers * self.lanes), "WORKERS": workers,
            "SPARSE": int(sparse), "FINE": int(fine), "OVERSAMPLING": oversampling, "BATCH": 1 if sparse else BATCH,
            "TILE": _TILE, "SUBBLOCKS": (self.sparse_subblocks if sparse else self.subblocks) * (32 // subblock),
        }  # fmt: skip


CPU_LAYOUT = Layout(lanes=8, subblocks=16, sparse_subblocks=48, nodes=4)
GPU_LAYOUT = Layout(lanes=1, subblocks=4, sparse_subblocks=16, nodes=1)


_NEVER = 2**40  # samples


@dataclass(frozen=True, slots=True, eq=False)
class ActivePaths:
    """The active paths of one pair in an interval."""

    index: int  # of the pair, in `Tracks.pairs`
    rows: NDArray[np.int64]  # (n,) its paths
    low: Floats  # (n,) bounds of their delays over the chunk, s
    high: Floats  # likewise

    def during(self, pair: PairTracks, ramp: float, begin: float, end: float) -> ActivePaths:
        """Return those active from a time to another, s, where half of a transition takes `ramp`, s."""
        audible = (pair.start[self.rows] - ramp <= end) & (pair.end[self.rows] + ramp >= begin)
        return ActivePaths(self.index, self.rows[audible], self.low[audible], self.high[audible])

    def parts(self, most: int) -> list[ActivePaths]:
        """Return them in parts of at most so many, neighbours by delay; none of none."""
        if len(self.rows) <= most:
            return [self] if len(self.rows) else []
        order = np.argsort(self.low + self.high, kind="stable")
        pieces = (order[first : first + most] for first in range(0, len(order), most))
        return [ActivePaths(self.index, self.rows[i], self.low[i], self.high[i]) for i in pieces]


@dataclass(frozen=True, slots=True, eq=False)
class Boundaries:
    """Active intervals of the paths of a batch."""

    start: Floats  # (slots,) boundaries in samples from time 0; infinite where there is none
    end: Floats  # likewise
    # (slots,) first sample with a weight, and the one after the last; of slots that fill up a batch the last is the
    # lower.
    first: NDArray[np.int64]
    last: NDArray[np.int64]  # (slots,) likewise
    ramp: float  # length of a transition, samples; 0 where paths begin and end at once

    def samples_from(self, start: int) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        """Return first and last as counted from a sample on, bounded to 31 bits."""
        most = 2**30
        first, last = (np.clip(x - start, -most, most).astype(np.int32) for x in (self.first, self.last))
        return first, last

    def stretches(self, start: int, segment: int, first: int, last: int) -> list[tuple[int, int]]:
        """Return the stretches of segments, from `first` to `last` of those from a sample on, with any active path."""
        begin, end = (np.clip(x - start, first * segment, last * segment) for x in (self.first, self.last))
        some, changes = end > begin, np.zeros(last - first + 1, dtype=np.int64)
        np.add.at(changes, begin[some] // segment - first, 1)
        np.add.at(changes, -(-end[some] // segment) - first, -1)
        active = (np.cumsum(changes)[:-1] > 0).astype(np.int64)
        return [(first + a, first + b) for a, b in equal_runs(active) if active[a]]


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
    bounds: Boundaries  # active intervals of the slots
    few: bool = False  # of a batch, which need shorter blocks

    @property
    def count(self) -> int:
        return len(self.path)

    def of_pair(self, i: int) -> slice:
        """Return the slots of the batch's i-th pair."""
        return slice(int(self.first_slot[i]), int(self.first_slot[i + 1]))

    def part(self, chosen: NDArray[np.bool_]) -> PathBatch:
        """Return some slots, at least one, of the pairs that have any, each filled up to whole batches."""
        found = [np.flatnonzero(chosen[self.of_pair(i)]) + self.first_slot[i] for i in range(len(self.pairs))]
        pairs = [i for i, slots in enumerate(found) if len(slots)]
        filled = [np.append(found[i], np.full(-len(found[i]) % BATCH, found[i][-1])) for i in pairs]
        slots, bounds = np.concatenate(filled), self.bounds
        padding = np.append(False, slots[1:] == slots[:-1])
        first, last = (np.where(padding, far, x[slots]) for far, x in ((_NEVER, bounds.first), (-_NEVER, bounds.last)))
        return replace(
            self, few=True, pairs=tuple(self.pairs[i] for i in pairs), receiver=self.receiver[pairs],
            row=self.row[pairs], path=self.path[slots], padding=padding,
            first_slot=np.cumsum([0, *map(len, filled)], dtype=np.int32),
            bounds=replace(bounds, start=bounds.start[slots], end=bounds.end[slots], first=first, last=last),
        )  # fmt: skip

    def fades(self, start: int, block: int, blocks: int) -> Fades | None:
        """Return the beginnings and ends of paths within some blocks from a sample on; None if there are none."""
        found, bounds = [], self.bounds
        reach, stop = 0.5 * bounds.ramp, start + blocks * block
        if not any(np.any((x + reach >= start) & (x - reach <= stop)) for x in (bounds.start, bounds.end)):
            return None
        for place in (bounds.start, bounds.end):
            half = 0.5 * bounds.ramp
            low = np.clip((place - half - start) / block, -1.0, blocks)
            high = np.clip((place + half - start) / block, -1.0, blocks)
            begin, last = np.floor(low).astype(np.int64), np.floor(high).astype(np.int64)
            if bounds.ramp == 0.0:
                last = np.where(place - start == last * block, begin - 1, last)  # between blocks: nothing to do
            begin = np.maximum(begin, 0)
            found.append(ranges(begin, np.where(self.padding, begin, np.clip(last + 1, begin, blocks))))
        slot, at = np.concatenate(found, axis=1)
        if not len(slot):
            return None
        slot, at = np.unique(np.stack([slot, at]), axis=1)
        pair = np.searchsorted(self.first_slot, slot, side="right") - 1
        order = np.lexsort((slot, at, pair))
        slot, at, pair = slot[order], at[order], pair[order]
        new = np.flatnonzero(np.diff(pair * np.int64(blocks) + at, prepend=-1))
        origin = (start + at * block).astype(np.float64)
        far = 2.0**23

        def here(place: Floats) -> NDArray[Any]:
            """Return sample indices of the run from its beginning, bounded to the exact range of float32."""
            return np.asarray(np.clip(place[slot] - origin, -far, far), dtype=np.float32)

        return Fades(
            slot.astype(np.int32), at.astype(np.int32), here(bounds.start), here(bounds.end),
            np.append(new, len(slot)).astype(np.int32), self.row[pair[new]], at[new].astype(np.int32),
        )  # fmt: skip


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


FEW = 4  # times fewer paths than in a batch take shorter blocks without the others


def is_divided(family: PathFamily | None) -> bool:
    """Test whether a few paths of a kind may need shorter blocks than others: at edges, by scatterers and by bodies."""
    at_vertex = getattr(family, "vertex", None) is not None
    return family is not None and (at_vertex or (family.moves and not family.is_specular))


def in_batches(
    plan: Plan, active: list[ActivePaths], kind: Callable[[int], PathFamily | None], budget: float, block: int,
    apart: int = 1,
) -> list[PathBatch]:  # fmt: skip
    """Cut a source's pairs into batches of slots: as many as fit the budget of nodes in blocks of a length, bytes.

    All pairs of a batch have the same maker of nodes, which the kind stands for, and as many channels. No receiver is
    in it twice: work-groups that add to the same samples would race.
    """
    batches = list[list[ActivePaths]]()
    count, last, there = 0, None, set[int]()
    for pair in active:
        member, row = plan.tracks.pairs[pair.index], plan.rows_of_pair(pair.index).start
        channels, slots = len(member.channels), -(-len(pair.rows) // BATCH) * BATCH
        family = kind(pair.index)
        alike = family, channels
        a_segment = plan.bytes_per_node(member.source, channels) * (plan.segment // block)
        most = budget * (FEW if is_divided(family) else 1) // a_segment
        if count + slots > max(BATCH, most) or alike != last or row in there:
            batches.append([])
            count, last, there = 0, alike, set()
        batches[-1].append(pair)
        there.add(row)
        count += slots
    return [fill_batch(plan, some, apart) for some in batches]


def fill_batch(plan: Plan, active: list[ActivePaths], apart: int = 1) -> PathBatch:
    """Return the slots of pairs' active paths by their middle delays, dealt from `apart` stretches of that order."""
    path, padding, first = [], [], [0]
    for pair in active:
        order = pair.rows[np.argsort(pair.low + pair.high, kind="stable")]
        extra = -len(order) % BATCH
        dealt = np.arange(len(order) + extra).reshape(apart, -1).T.ravel()
        path.append(np.concatenate([order, np.full(extra, order[-1])])[dealt])
        padding.append(dealt >= len(order))
        first.append(first[-1] + len(order) + extra)
    receivers = [plan.tracks.pairs[pair.index].receiver for pair in active]
    return PathBatch(
        tuple(pair.index for pair in active), np.array(receivers, dtype=np.int32),
        np.array([plan.rows_of_pair(pair.index).start for pair in active], dtype=np.int32),
        np.array(first, dtype=np.int32), np.concatenate(path), np.concatenate(padding),
        min(float(pair.low.min()) for pair in active), max(float(pair.high.max()) for pair in active),
        _boundaries(plan, [pair.index for pair in active], path, np.concatenate(padding)),
    )  # fmt: skip


def _boundaries(plan: Plan, pairs: list[int], rows: list[NDArray[np.int64]], padding: NDArray[np.bool_]) -> Boundaries:
    """Find the times at which paths, rows of some pairs, begin and end."""
    rate, transition = plan.sampling_rate, plan.tracks.transition
    members = [(plan.tracks.pairs[i], r) for i, r in zip(pairs, rows, strict=True)]
    start, end = (np.concatenate(x) for x in zip(*((m.start[r], m.end[r]) for m, r in members), strict=True))
    first, last = audible_samples(start, end, transition, rate)
    # Ends before it begins: an empty interval within a block that begins before 0 s would count as active.
    first[padding], last[padding] = _NEVER, -_NEVER
    if transition == 0.0:  # at once: between samples
        return Boundaries(first.astype(np.float64), last.astype(np.float64), first, last, 0.0)
    return Boundaries(start * rate, end * rate, first, last, transition * rate)


CELL = 16  # samples
_SPARSE = 0.5  # share of active cells, below which it pays to look


@dataclass(frozen=True, slots=True, eq=False)
class Activity:
    """Cells of `CELL` samples of branch signals in which any of them is not zero."""

    cells: NDArray[np.bool_]  # (cells,) whether they are active

    def __or__(self, other: Activity) -> Activity:
        return Activity(self.cells | other.cells)

    @property
    def is_cheaper(self) -> bool:
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
    """Find active cells of branch signals, whose first sample is `before`, by the `active` (n,) samples."""
    cells = -(-count // CELL)
    # A sample at i is heard by branches from i - after - before to i.
    begun = np.bincount(np.clip((active - before - after) // CELL, 0, cells), minlength=cells + 1)
    ended = np.bincount(np.clip(active // CELL + 1, 0, cells), minlength=cells + 1)
    return Activity(np.cumsum(begun - ended)[:-1] > 0)


def equal_runs(values: Sequence[int] | NDArray[np.int64]) -> list[tuple[int, int]]:
    """Return the maximal ranges of equal values."""
    changes = (np.flatnonzero(np.diff(values)) + 1).tolist()
    return list(zip([0, *changes], [*changes, len(values)], strict=True))
