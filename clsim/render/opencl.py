"""The OpenCL engine: branch signals, tracks and their sum on the device, chunk by chunk."""

from __future__ import annotations

import itertools
import math
import warnings
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.errors import ClsimError, ClsimWarning, DeviceError
from clsim.opencl.device import Scratch, find_device, opened, upload
from clsim.render.device_tracks import DeviceTracks
from clsim.render.edges import boundaries, find_edges
from clsim.render.host_tracks import HostTracks
from clsim.render.plan import NODE_BUDGET, Plan
from clsim.render.silence import CELL, Sounding, sounding
from clsim.render.slots import Active, Slots, fill_slots
from clsim.render.tracks import SceneTracks

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from clsim.arrays import Floats
    from clsim.render.interpolator import Bank

BATCH = 64  # paths expanded at a time, the unit in which slots are filled up
_TILE = 128  # paths whose branch signals stay in cache together
_STRETCH = 2  # segments for which the paths that are heard are chosen anew, where some begin or end
_MARGIN = 64  # samples of branch signal beyond the bounds of the delays


@dataclass(frozen=True, slots=True)
class Layout:
    """How the sum of paths is spread over a device: a group of samples over lanes of vectors, or over work-items."""

    lanes: int
    span: int  # groups to a work-item, or group of them
    sparse_span: int  # the same where signals pause
    sparse_batch: int  # paths that are looked at together there; divides BATCH, and _TILE into at most 31

    def constants(self, group: int, *, sparse: bool) -> dict[str, int]:
        """Return the compile-time constants of the render kernel for a group length."""
        workers = 1 if self.lanes > 1 else group
        return {
            "LANES": self.lanes,
            "VECTORS": group // (workers * self.lanes),
            "WORKERS": workers,
            "BATCH": self.sparse_batch if sparse else BATCH,
            "SPARSE": int(sparse),
            "TILE": _TILE,
            "SPAN": (self.sparse_span if sparse else self.span) * (32 // group),
        }


CPU_LAYOUT = Layout(lanes=8, span=16, sparse_span=48, sparse_batch=8)
GPU_LAYOUT = Layout(lanes=1, span=4, sparse_span=16, sparse_batch=32)


class OpenclEngine:
    """Carries out a plan on an OpenCL device.

    Parameters
    ----------
    plan : Plan
        What to compute.
    layout : Layout, optional
        How to spread it; by the kind of device when left out.

    Raises
    ------
    DeviceError
        If there is no device, or it fails; the message says what to do.
    """

    parts = 1  # rows of what is heard of a receiver

    def __init__(self, plan: Plan, layout: Layout | None = None) -> None:
        import pyopencl as cl

        self._plan = plan
        self._info, device = find_device(plan.device)
        self._layout = layout or (GPU_LAYOUT if self._info.kind == "GPU" else CPU_LAYOUT)
        self._context, self._compiler = opened(device)
        self._queue = cl.CommandQueue(self._context)
        self._scratch = Scratch(self._context)
        self._written: tuple[tuple[int, int], Sounding] | None = None  # branches kept in memory, silent elsewhere
        self.skips_silence = True
        shape = (len(plan.emissions), plan.receiver_count)
        self._strongest, self._unheld = np.zeros(shape), np.zeros(shape)  # arrivals, and what no function holds of any
        self._tracks: DeviceTracks | HostTracks
        if isinstance(plan.tracks, SceneTracks) and self._info.fp64:
            self._tracks = DeviceTracks(plan, plan.tracks, self._queue, self._compiler)
        else:
            self._tracks = HostTracks(plan, self._queue)

    def render(self, start: int, stop: int) -> NDArray[np.float32]:
        """Return the pressure (receivers, stop - start) in Pa; `start` is a whole number of segments."""
        import pyopencl as cl

        try:
            return self._render(start, stop)
        except (cl.MemoryError, cl.RuntimeError) as error:
            raise DeviceError(
                f"{self._info.name} ran out of memory or failed ({error}); render with a smaller chunk=, fewer "
                "receivers at a time, or on another device (see `clsim devices`)"
            ) from error

    def warn(self) -> None:
        """Warn where responses came along that the functions of frequency hold worse than asked."""
        unheld = (self._unheld / np.maximum(self._strongest, 1e-30)).max(axis=1)
        for i, emission in enumerate(self._plan.emissions):
            reached = 20.0 * math.log10(max(float(unheld[i]), 1e-15))
            if reached > emission.basis.asked_db + 1.0 > -math.inf:
                warnings.warn(
                    f"source {i}: air, walls and beams were held within {reached:.1f} dB, not the "
                    f"{emission.basis.asked_db:g} dB asked for; ask for a smaller response_error_db",
                    ClsimWarning,
                    stacklevel=3,
                )

    def note(self, source: int, receivers: NDArray[np.int32], strongest: Floats, unheld: Floats) -> None:
        """Remember the strongest arrivals (n,) at receivers, and the largest part of any that no function holds."""
        for seen, value in ((self._strongest, strongest), (self._unheld, unheld)):
            seen[source, receivers] = np.maximum(seen[source, receivers], value)

    @property
    def run(self) -> type[Run]:
        """What renders a batch of receivers."""
        return Run

    def _render(self, start: int, stop: int) -> NDArray[np.float32]:
        import pyopencl as cl

        plan = self._plan
        unit = math.lcm(*plan.blocks)
        length = -(-(stop - start) // unit) * unit
        pressure = np.empty((self.parts * plan.receiver_count, length), dtype=np.float32)
        on_device = self._scratch.take("pressure", pressure.nbytes)
        cl.enqueue_fill_buffer(self._queue, on_device, np.zeros(1, np.float32), 0, pressure.nbytes)
        for source in range(len(plan.emissions)):
            active = self._active(source, start, length)
            branches = self._branches(source, start, length, active) if active else None
            if branches is None:
                continue
            segments = -(-length // plan.segment)
            always = all(plan.tracks.groups[group.index].always_heard for group in active)
            step = segments if always else _STRETCH
            for first in range(0, segments, step):
                last = min(first + step, segments)
                here = [
                    group.during(plan, start + first * plan.segment, start + last * plan.segment) for group in active
                ]
                node = bytes_per_node(plan, source)
                per_segment = node * (plan.segment // plan.blocks[-1])
                for some in _batches([group for group in here if len(group.rows)], per_segment):
                    slots = fill_slots(plan, some, BATCH)
                    self.run(self, source, slots, branches, on_device, length, start, first, last).render()
        cl.enqueue_copy(self._queue, pressure, on_device)
        return pressure[:, : stop - start]

    def _active(self, source: int, start: int, length: int) -> list[Active]:
        """Return the paths of a source that are heard within a chunk."""
        plan, found = self._plan, []
        for i, group in enumerate(plan.tracks.groups):
            if group.source == source and i not in plan.at_rest.groups:
                low, high = plan.tracks.delay_range(i, *self._seconds(start, start + length))
                found.append(Active(i, np.arange(len(group)), low, high).during(plan, start, start + length))
        return [group for group in found if len(group.rows)]

    def _seconds(self, first: int, last: int) -> tuple[float, float]:
        return first / self._plan.sampling_rate, last / self._plan.sampling_rate

    def _branches(self, source: int, start: int, length: int, active: list[Active]) -> Branches | None:
        """Filter the part of a signal that can be heard in a chunk; None if it is silent."""
        import pyopencl as cl

        emission, rate = self._plan.emissions[source], self._plan.sampling_rate
        late = emission.start * rate
        least = int(np.floor(min(group.low.min() for group in active) * rate + late)) - _MARGIN
        most = int(np.ceil(max(group.high.max() for group in active) * rate + late)) + _MARGIN
        channel = 8 * self._layout.lanes
        needed = length + most - least
        step = max(64, 1 << needed.bit_length() - 5)  # little, but so much that chunk after chunk has the same width
        width = -(-needed // step) * step
        stride = width + 16  # whole pages apart, rows would fight for the same cache lines
        first = start - most
        before, after = (max(side(bank) for bank in emission.banks) for side in (_taps_before, _taps_after))
        places, values = emission.sounding(first - before, first + width + after)
        if not len(places):
            return None
        found = sounding(places, width, before, after)
        sparse = self.skips_silence and found.pays
        out, following = self._rows(self.parts * int(emission.rows[-1]), stride, found if sparse else None)
        emitted = np.zeros((len(emission.banks), self.parts, before + width + after), dtype=np.float32)
        for part, of in enumerate((values.real, values.imag)[: self.parts]):
            emitted[:, part, places] = of
        there = self._scratch.take("emitted", emitted.nbytes)
        cl.enqueue_copy(self._queue, there, emitted)
        for (k, bank), part in itertools.product(enumerate(emission.banks), range(self.parts)):
            rows, taps = bank.taps.shape
            constants = {"LANES": self._layout.lanes, "TAPS": taps, "CELL": CELL, "SPARSE": int(sparse)}
            kernel = self._compiler.kernel("branches", constants)
            kernel(
                self._queue, (width // channel, rows), None, there,
                np.int32((k * self.parts + part) * emitted.shape[2] + before - _taps_before(bank)),
                self._upload(bank.taps.astype(np.float32)), np.int32(stride),
                np.int32(self.parts * emission.rows[k] + part * rows), out,
                following,
            )  # fmt: skip
        return Branches(out, stride, first, least, most, found if sparse else None)

    def _rows(self, count: int, stride: int, found: Sounding | None) -> tuple[Any, Any]:
        """Return memory for branch signals, and where they are to be written: where they sound, or did before."""
        import pyopencl as cl

        out, shape = self._scratch.take("rows", 4 * count * stride), (count, stride)
        if found is None:
            self._written = None
            return out, out  # of no use: all is written
        if self._written is None or self._written[0] != shape:
            cl.enqueue_fill_buffer(self._queue, out, np.zeros(1, np.float32), 0, 4 * count * stride)
            write = found
        else:
            write = found | self._written[1]
        self._written = shape, found
        return out, self._upload(write.following)

    def _upload(self, array: NDArray[Any]) -> Any:
        return upload(self._context, array)


@dataclass(frozen=True, slots=True)
class Branches:
    """Branch signals on the device, and which delays they cover."""

    rows: Any
    stride: int
    first: int  # sample at which the rows begin
    least: int  # samples
    most: int
    sounding: Sounding | None  # where it is worth leaving out what is silent


class Run:
    """Renders one batch of receivers over some segments of a chunk, choosing the block length for each."""

    def __init__(
        self,
        engine: OpenclEngine,
        source: int,
        slots: Slots,
        branches: Branches,
        pressure: Any,
        length: int,
        start: int,
        first: int,
        last: int,
    ) -> None:
        self._engine, self._plan = engine, engine._plan
        self._source, self._slots, self._branches = source, slots, branches
        self._pressure, self._length, self._start = pressure, length, start
        self._first_slot, self._row = engine._upload(slots.first_slot), engine._upload(slots.receiver)
        self._bounds = boundaries(self._plan, slots)
        self._first, self._last = first, last
        begin, end = first * self._plan.segment, min(last * self._plan.segment, length)
        self._state: Any = engine._tracks.prepare(
            source, slots, self._bounds, start + begin, end - begin, branches.sounding, branches.first
        )
        error_db = getattr(self._plan.interpolator, "error_db", -90.0)
        self._tolerance = 10 ** ((error_db - 6.0) / 20)
        self._functions = len(self._plan.emissions[source].basis)

    def render(self) -> None:
        """Add what is heard to the pressure on the device."""
        self._cover(self._first, self._last, 0)

    def _cover(self, first: int, last: int, level: int) -> None:
        """Render segments `first` to `last` in blocks of a level, or shorter ones where those are too coarse."""
        plan, segment = self._plan, self._plan.segment
        block = plan.blocks[level]
        node = bytes_per_node(plan, self._source)
        step = max(1, NODE_BUDGET // (node * self._slots.count * (segment // block)))
        for at in range(first, last, step):
            upto = min(at + step, last)
            begin, end = at * segment, min(upto * segment, self._length)
            nodes = self._engine._tracks.nodes(self._state, self._start + begin, block, (end - begin) // block)
            self._check(nodes.shortest, nodes.longest)
            self._engine.note(self._source, self._slots.receiver, nodes.strongest, nodes.unheld)
            coarse = nodes.error > self._tolerance
            coarse &= level + 1 < len(plan.blocks)
            for a, b in _runs(coarse):
                if coarse[a]:
                    self._cover(at + a, at + b, level + 1)
                else:
                    self._render(nodes, at + a, min((at + b) * segment, self._length), block, a * segment // block)

    def _check(self, shortest: float, longest: float) -> None:
        """Refuse to read beyond the branch signals: it would mean that the bounds of the delays are wrong."""
        late = self._plan.emissions[self._source].start * self._plan.sampling_rate
        low, high = (delay * self._plan.sampling_rate + late for delay in (shortest, longest))
        if not (low > self._branches.least + 1 and high < self._branches.most - 1):
            raise ClsimError(
                f"delays of {shortest:g} to {longest:g} s lie outside the bounds computed for them; "
                "please report this scene as a defect"
            )

    def _render(self, nodes: Any, segment: int, end: int, block: int, first_block: int) -> None:
        engine, emission = self._engine, self._plan.emissions[self._source]
        self._render_edges(nodes, segment, end, block, first_block)
        constants = engine._layout.constants(emission.bank.group, sparse=nodes.spans is not None)
        spans = nodes.delay if nodes.spans is None else nodes.spans
        begin = segment * self._plan.segment
        groups = (end - begin) // emission.bank.group
        size = (-(-groups // constants["SPAN"]) * constants["WORKERS"], len(self._slots.groups))
        counts = [len(bank.taps) for bank in emission.banks]
        for k, upto in _runs(counts):
            kernel = engine._compiler.kernel("render", constants | {"BRANCHES": counts[k]})
            kernel(
                engine._queue, size, (constants["WORKERS"], 1), self._branches.rows, np.int32(self._branches.stride),
                np.int32(emission.rows[k]), np.int32(self._functions), np.int32(k), np.int32(upto),
                np.int32(self._start + begin - self._branches.first), nodes.delay, nodes.cubics, self._first_slot,
                np.int32(self._slots.count), np.int32(block // emission.bank.group), np.int32(first_block),
                np.int32(groups), self._row, self._pressure, np.int32(self._length), np.int32(begin), spans,
            )  # fmt: skip

    def _render_edges(self, nodes: Any, segment: int, end: int, block: int, first_block: int) -> None:
        """Render the blocks in which paths begin or end, and take them out of the polynomials."""
        engine, slots, begin = self._engine, self._slots, segment * self._plan.segment
        edges = find_edges(self._bounds, slots, self._start + begin, block, -(-(end - begin) // block))
        if edges is None:
            return
        per_ramp, rows = self._bounds.ramp, self._plan.emissions[self._source].rows.astype(np.int32)
        slot, at = engine._upload(edges.slot), engine._upload(edges.block + np.int32(first_block))
        kernel = engine._compiler.kernel("edges", {})
        kernel(
            engine._queue, (block, len(edges.row)), None, self._branches.rows, np.int32(self._branches.stride),
            np.int32(self._functions), engine._upload(rows), np.int32(self._start + begin - self._branches.first),
            nodes.delay, nodes.cubics, np.int32(slots.count), np.int32(block), np.int32(first_block),
            np.float32(1.0 / per_ramp if per_ramp else 0.0), slot,
            *(engine._upload(column) for column in (edges.start, edges.end, edges.first, edges.row, edges.at)),
            self._pressure, np.int32(self._length), np.int32(begin), np.int32(end - begin),
            np.int32(nodes.spans is not None), nodes.delay if nodes.spans is None else nodes.spans,
        )  # fmt: skip
        self._mute(nodes, slot, at)

    def _mute(self, nodes: Any, slot: Any, at: Any) -> None:
        """Take paths, by slot and block, out of the polynomials."""
        kernel = self._engine._compiler.kernel("mute", {"DELAY_TERMS": self._plan.delay_terms})
        kernel(
            self._engine._queue, (slot.size // 4,), None, slot, at, np.int32(self._functions), nodes.cubics,
            np.int32(self._slots.count),
        )  # fmt: skip


def _taps_before(bank: Bank) -> int:
    """Return how many samples before the first one the branch filters read."""
    return int(bank.taps.shape[1]) - 1 - bank.centre


def _taps_after(bank: Bank) -> int:
    return bank.centre + 1


def _runs(values: Sequence[int] | NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return the maximal ranges of equal values."""
    edges = (np.flatnonzero(np.diff(values)) + 1).tolist()
    return list(zip([0, *edges], [*edges, len(values)], strict=True))


def bytes_per_node(plan: Plan, source: int) -> int:
    """Return the size of a block of a path: whole delay, and polynomials of its rest and of every gain."""
    return 4 + 4 * plan.delay_terms + 16 * len(plan.emissions[source].basis)


def _batches(active: list[Active], per_segment: int) -> list[list[Active]]:
    """Cut groups into batches whose polynomials fit the budget for one segment of the shortest blocks, bytes a path."""
    most = max(BATCH, NODE_BUDGET // per_segment)
    batches: list[list[Active]] = []
    count = most
    for group in active:
        slots = -(-len(group.rows) // BATCH) * BATCH
        if count + slots > most:
            batches.append([])
            count = 0
        batches[-1].append(group)
        count += slots
    return batches
