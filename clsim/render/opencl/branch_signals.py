"""Branch signals: the part of emitted signals that can arrive in a chunk, filtered for all paths; limits of devices."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Floats
from clsim.errors import ClsimError, InputError
from clsim.opencl.device import FLOAT64, MOST_INDEX, SHARE, DeviceInfo, check_buffers, operations_in_launch
from clsim.opencl.launch import Compiler, Scratch, upload, work
from clsim.render.opencl.batches import CELL, ActivePaths, Activity, PathBatch, find_activity
from clsim.render.plan import BATCH, NODE_BUDGET, Plan

_LEVELS = 3  # block lengths whose polynomials are kept at the same time
_OPERATIONS_PER_SAMPLE = 10.0  # of a path, beside two for every branch
_OPERATIONS_PER_NODE = 2000.0 * FLOAT64  # of a path


class Limits:
    """The limits of a device for a plan."""

    def __init__(self, plan: Plan, info: DeviceInfo, parts: int) -> None:
        self._plan, self._info = plan, info
        self.node_budget = int(min(NODE_BUDGET, info.largest_buffer_bytes, info.memory_bytes / 16))
        filters = plan.source_filters
        self._rows = max(f.oversampling * int(f.rows[-1]) for f in filters)
        functions = max(f.oversampling * len(f.banks) for f in filters)
        # Of every buffer that grows with the chunk: bytes for a sample, and for those of the longest delay.
        rows, emitted = 4.3 * parts * self._rows, 4.3 * parts * functions
        self._per_sample = {"branch signals": rows, "emitted signals": emitted}
        self._per_sample["pressure of all receivers"] = 4.0 * parts * plan.row_count
        span = plan.tracks.longest_delay(0.0, plan.duration) * plan.sampling_rate + 256.0  # margins
        self._fixed = {"branch signals": rows * span, "emitted signals": emitted * span}
        self._longest = MOST_INDEX / 1.1 / max(f.oversampling for f in filters) - span  # kernels count them in 32 bits
        most = int(min(plan.chunk, self._most_samples()))
        if most < plan.segment:
            self._refuse()
        self.most_samples = most // plan.segment * plan.segment  # rendered at a time

    @property
    def paths_in_launch(self) -> int:
        """Number of paths in one launch, of which a segment takes about `LONGEST_LAUNCH` at most; at least a batch."""
        paths = operations_in_launch(self._info) / self._operations(self._plan.shortest_block)
        return max(1, int(min(paths, MOST_INDEX)) // BATCH) * BATCH

    def segments_in_launch(self, paths: int, block: int) -> int:
        """Return the number of segments of some paths in one launch, about `LONGEST_LAUNCH` on GPUs; at least one."""
        segments = operations_in_launch(self._info) / (paths * self._operations(block))
        return max(1, int(min(segments, MOST_INDEX)))

    def _operations(self, block: int) -> float:
        """Return those of a path and a segment in blocks of a length, in whichever launch has more of them."""
        rendering = self._plan.segment * (2.0 * self._rows + _OPERATIONS_PER_SAMPLE)
        return max(rendering, self._plan.segment // block * _OPERATIONS_PER_NODE)

    def _most_samples(self) -> float:
        """Return the number of samples at a time for which each buffer, and all of them together, fit."""
        widest = max(bank.taps.size for f in self._plan.source_filters for bank in f.banks)
        launched = max(operations_in_launch(self._info) / (2.0 * widest), self._plan.segment)
        whole = SHARE * self._info.memory_bytes - _LEVELS * self.node_budget - sum(self._fixed.values())
        each = [
            (self._info.largest_buffer_bytes - self._fixed.get(name, 0.0)) / size
            for name, size in self._per_sample.items()
        ]
        return min(whole / sum(self._per_sample.values()), self._longest, launched, *each)

    def _refuse(self) -> None:
        segment = self._plan.segment
        if self._longest < segment:
            raise InputError(
                "max_order",
                f"must leave delays that are counted in 32 bits, but the longest take {MOST_INDEX - self._longest:.3g} "
                "samples; lower it, or the sampling rate",
            )
        needed = {n: s * segment + self._fixed.get(n, 0.0) for n, s in self._per_sample.items()}
        name = max(needed, key=needed.__getitem__)
        less = "fewer receivers" if name.startswith("pressure") else "a lower max_order"
        advice = f"render {less} at a time, or on another device (see `clsim devices`)"
        check_buffers(self._info, needed | {"polynomials": _LEVELS * self.node_budget}, f"{segment} samples", advice)


_CHOSEN_ANEW = 2  # segments for which the active paths are chosen anew, where some begin or end
_VECTORS, _ROWS = 2, 3  # of samples and of branches that a work-item filters: their sums stay in registers
_MARGIN = 64  # samples of branch signal beyond the bounds of the delays


@dataclass(frozen=True, slots=True)
class Feed:
    """Part of a signal that can arrive in a chunk, with its range of delays."""

    source: int
    active: list[ActivePaths]
    places: NDArray[np.int32]  # (n,), what sounds
    values: NDArray[np.float32]  # (functions, parts, n)
    before: int  # samples from the first place to that at which branch signals begin
    after: int
    width: int  # samples of the branch signals
    first: int  # of these, at which they begin
    least: int  # of these, of delay
    most: int
    activity: Activity | None  # where it is worth leaving out what is silent


@dataclass(frozen=True, slots=True)
class Branches:
    """Branch signals on the device, and which delays they cover."""

    rows: Any
    stride: int
    first: int  # of their own samples, at which the rows begin
    least: int  # of these
    most: int
    activity: Activity | None  # where it is worth leaving out what is silent

    def check(self, shortest: float, longest: float, start: float, rate: float) -> None:
        """Refuse delays, s, beyond these signals, which start at a time, s: the bounds of the delays would be wrong."""
        low, high = ((delay + start) * rate for delay in (shortest, longest))
        if not (low > self.least + 1 and high < self.most - 1):
            raise ClsimError(
                f"delays of {shortest:g} to {longest:g} s lie outside the bounds computed for them; "
                "please report this scene as a defect"
            )


@dataclass(frozen=True, slots=True, eq=False)
class Task:
    """The paths of a batch of receivers from one source, over some segments of a chunk."""

    source: int  # index
    batch: PathBatch  # the paths
    branches: Branches  # the source's branch signals for this chunk
    pressure: Any  # (rows, length) to which it is added
    length: int  # samples of the chunk, whole blocks, and the first of them
    start: int  # likewise
    first: int  # segments of the chunk, the last one not among them
    last: int  # likewise
    share: float = field(default=1.0, kw_only=True)  # of the square of the allowed error


def _side_by_side(taps: Floats) -> NDArray[np.float32]:
    """Return taps (rows, L) as the kernel takes them: some rows side by side, the last tap first."""
    filled = np.zeros((-(-len(taps) // _ROWS) * _ROWS, taps.shape[1]), np.float32)
    filled[: len(taps)] = taps[:, ::-1]
    return np.ascontiguousarray(filled.reshape(-1, _ROWS, taps.shape[1]).swapaxes(1, 2))


class BranchSignals:
    """Makes the branch signals of one chunk and source after the other, and looks ahead to the next."""

    def __init__(
        self, plan: Plan, queue: Any, compiler: Compiler, scratch: Scratch, lanes: int, parts: int, chunk: int
    ) -> None:
        self._plan, self._queue, self._compiler, self._scratch = plan, queue, compiler, scratch
        self._lanes, self._parts, self._chunk = lanes, parts, chunk
        self._upload = partial(upload, queue.context)
        self.last = plan.samples  # from which on nothing is prepared
        self._longest_delay = plan.tracks.longest_delay(0.0, plan.duration)
        self.of_few = False  # whether so few paths are active at a time that their activity always pays
        self._emitted: tuple[tuple[int, int], int, Any] | None = None  # rows and samples, and where they are not zero
        self._written: tuple[tuple[int, int], Activity] | None = None  # branches kept in memory, silent elsewhere
        self._ahead: tuple[tuple[int, int, int] | None, Feed | None] = None, None  # prepared: source, start, length

    def whole_blocks(self, start: int, stop: int) -> int:
        """Return the samples of a chunk, rounded up to whole blocks of every length."""
        unit = math.lcm(*self._plan.blocks)
        return -(-(stop - start) // unit) * unit

    def take(self, source: int, start: int, length: int) -> Feed | None:
        """Return the part of a signal that can arrive in a chunk, prepared or not; None if it is zero."""
        wanted = source, start, length
        return self._ahead[1] if self._ahead[0] == wanted else self._feed(*wanted)

    def prefetch(self, source: int, start: int) -> None:
        """Prepare the signal of the next source or chunk while the device computes."""
        plan = self._plan
        self._queue.flush()
        source, start = (source + 1, start) if source + 1 < len(plan.source_filters) else (0, start + self._chunk)
        stop = min(start + self._chunk, plan.samples)
        following = source, start, self.whole_blocks(start, stop)
        if start < min(stop, self.last) and self._ahead[0] != following:
            self._ahead = following, self._feed(*following)

    def active(self, source: int, start: int, length: int) -> list[ActivePaths]:
        """Return the paths of a source that are active within a chunk."""
        plan, rate, pairs = self._plan, self._plan.sampling_rate, self._plan.tracks.pairs
        mine = [i for i, pair in enumerate(pairs) if pair.source == source and i not in plan.allocation.claimed]
        # Nodes lie up to a block before and two after what is rendered.
        begin, end, ramp = start - plan.blocks[0], start + length + 2 * plan.blocks[0], 0.5 * plan.tracks.transition
        bounds = plan.tracks.delay_ranges(mine, begin / rate, end / rate)
        found = [
            ActivePaths(i, np.arange(len(pairs[i])), *bound).during(
                pairs[i], ramp, start / rate, (start + length) / rate
            )
            for i, bound in zip(mine, bounds, strict=True)
        ]
        return [pair for pair in found if len(pair.rows)]

    def chosen(
        self, active: list[ActivePaths], start: int, length: int
    ) -> Iterator[tuple[int, int, list[ActivePaths]]]:
        """Yield the first of some segments from a sample on, the one behind the last, and the paths active in these."""
        plan, ramp, segments = self._plan, 0.5 * self._plan.tracks.transition, -(-length // self._plan.segment)
        always = not any(plan.tracks.pairs[pair.index].fades for pair in active)
        for first in range(0, segments, segments if always else _CHOSEN_ANEW):
            last = min(first + (segments if always else _CHOSEN_ANEW), segments)
            begin, end = ((start + at * plan.segment) / plan.sampling_rate for at in (first, last))
            yield first, last, [pair.during(plan.tracks.pairs[pair.index], ramp, begin, end) for pair in active]

    def _feed(self, source: int, start: int, length: int) -> Feed | None:
        """Return the part of a signal that can arrive in a chunk; None if it is zero."""
        filters, rate = self._plan.source_filters[source], self._plan.sampling_rate
        reach = max(max(bank.before, bank.centre + 1) for bank in filters.banks) + 2 * _MARGIN
        earliest = start - math.ceil((self._longest_delay + filters.start) * rate)
        silent = filters.is_silent(
            filters.oversampling * (earliest - reach), filters.oversampling * (start + length + reach)
        )
        active = [] if silent else self.active(source, start, length)
        if not active:
            return None
        times = filters.oversampling
        delay_samples = filters.start * rate
        least = times * (int(np.floor(min(pair.low.min() for pair in active) * rate + delay_samples)) - _MARGIN)
        most = times * (int(np.ceil(max(pair.high.max() for pair in active) * rate + delay_samples)) + _MARGIN)
        needed = times * length + most - least
        step = max(64, 1 << needed.bit_length() - 5)  # little, but so much that chunk after chunk has the same width
        width = -(-needed // step) * step
        first = times * start - most
        before = max(bank.before for bank in filters.banks)
        after = max(bank.centre for bank in filters.banks) + 1
        places, values = filters.active(first - before, first + width + after)
        if not len(places):
            return None
        found = find_activity(places, width, before, after)
        parts = np.stack([values.real, values.imag][: self._parts], axis=1, dtype=np.float32)
        return Feed(
            source, active, places.astype(np.int32), parts, before, after, width, first, least, most,
            found if (found.is_cheaper or self.of_few) and times == 1 else None,
        )  # fmt: skip

    def made(self, feed: Feed, skips_silence: bool) -> Branches:
        """Filter the part of a signal that can arrive, all of it or its non-zero samples."""
        filters = self._plan.source_filters[feed.source]
        found = feed.activity if skips_silence else None
        # Whole pages apart, rows would fight for the same cache lines.
        stride = feed.width + 16 * filters.oversampling
        out, following = self._rows(self._parts * int(filters.rows[-1]), stride, found)
        emitted, samples = self._emit(feed)
        lanes = 2 * self._lanes if self._lanes > 1 and feed.width % (2 * _VECTORS * self._lanes) == 0 else self._lanes
        constants = {
            "LANES": lanes, "VECTORS": _VECTORS, "ROWS": _ROWS, "PARTS": self._parts, "CELL": CELL,
            "OVERSAMPLING": filters.oversampling,
        }  # fmt: skip
        kernel = self._compiler.kernel("branches", constants)
        own, first_rows = filters.banks_of_stretch, filters.rows[:: 1 + int(filters.basis.paired)]
        stretches, all_rows = len(filters.banks) // len(own), int(first_rows[len(own)])
        for k, bank in enumerate(own):
            rows, taps = bank.taps.shape
            kernel(
                self._queue, work(feed.width // (_VECTORS * lanes), -(-rows // _ROWS), self._parts * stretches),
                emitted=emitted, first_emitted=k * self._parts * samples + feed.before - bank.before, stream=samples,
                stretch=len(own) * self._parts * samples, taps=_side_by_side(bank.taps), tap_count=taps, count=rows,
                width=feed.width, stride=stride, first_row=self._parts * first_rows[k],
                stretch_rows=self._parts * all_rows, rows=out, sparse=found is not None, following=following,
            )  # fmt: skip
        return Branches(out, stride, feed.first, feed.least, feed.most, found)

    def _emit(self, feed: Feed) -> tuple[Any, int]:
        """Return a buffer of the emitted signal, silence included, and the samples of its rows."""
        import pyopencl as cl

        rows, samples = feed.values.shape[0] * feed.values.shape[1], feed.before + feed.width + feed.after
        if len(feed.places) == samples:  # no silence
            return self._upload(np.ascontiguousarray(feed.values)), samples
        out = self._scratch.take("emitted", 4 * rows * samples)

        def emit(count: int, places: Any, values: Any, clear: bool) -> None:
            kernel = self._compiler.kernel("emit", {})
            kernel(
                self._queue, work(count, rows), count=count, places=places, values=values, clear=clear, stride=samples,
                emitted=out,
            )  # fmt: skip

        if self._emitted is not None and self._emitted[0] == (rows, samples):
            emit(*self._emitted[1:], None, clear=True)
        else:
            cl.enqueue_fill_buffer(self._queue, out, np.zeros(1, np.float32), 0, 4 * rows * samples)
        self._emitted = (rows, samples), len(feed.places), self._upload(feed.places)
        emit(*self._emitted[1:], feed.values, clear=False)
        return out, samples

    def _rows(self, count: int, stride: int, found: Activity | None) -> tuple[Any, Any]:
        """Return memory for branch signals, and where they are to be written: where they sound, or did before."""
        import pyopencl as cl

        out, shape = self._scratch.take("rows", 4 * count * stride), (count, stride)
        if found is None:
            self._written = None
            return out, None  # all is written
        if self._written is None or self._written[0] != shape:
            cl.enqueue_fill_buffer(self._queue, out, np.zeros(1, np.float32), 0, 4 * count * stride)
            write = found
        else:
            write = found | self._written[1]
        self._written = shape, found
        return out, self._upload(write.following)
