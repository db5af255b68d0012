"""The OpenCL engine: branch signals, tracks and their sum on the device, chunk by chunk."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Floats
from clsim.errors import DeviceError, warn
from clsim.opencl.device import check_group, find_device
from clsim.opencl.launch import Scratch, WorkItems, compiler_of, upload, work
from clsim.paths.family import PathFamily
from clsim.render.opencl.batches import CPU_LAYOUT, FEW, GPU_LAYOUT, Fades, Layout, equal_runs, in_batches, is_divided
from clsim.render.opencl.block_polynomials import Residual, block_errors, few_paths, promising
from clsim.render.opencl.branch_signals import BranchSignals, Limits, Task
from clsim.render.opencl.environment import has_directivity
from clsim.render.opencl.host_nodes import HostNodeMaker, PairNodeMaker
from clsim.render.opencl.nodes import NodeMaker
from clsim.render.opencl.path_columns import COLUMNS
from clsim.render.plan import BATCH, Plan

Maker = NodeMaker | HostNodeMaker

_TOGETHER = 8  # functions of frequency that are summed at a time
_CHANNELS = 16  # of a receiver that are summed at a time
_PASSING = 0.008  # s, of the longest blocks for shadows, which pass within some 50 ms
_TURN = 4  # segments at a time in which they do


@dataclass(eq=False)
class Run:
    """Carries out a task, choosing the block length for each segment."""

    _engine: OpenclEngine
    _task: Task

    _apart: ClassVar[bool] = False  # whether each path has a row of its own
    _trims: ClassVar[bool] = False  # whether blocks in which paths begin or end are rendered but for the transitions
    _divides: ClassVar[bool] = True  # whether a few paths can be taken out of a batch

    def __post_init__(self) -> None:
        engine, task = self._engine, self._task
        self._plan = engine._plan
        self._source, self._batch, self._branches = task.source, task.batch, task.branches
        self._pressure, self._length, self._start = task.pressure, task.length, task.start
        self._origin, self._stride = 0, task.length  # first sample of the chunk in the pressure, and samples of a row
        self._first_slot = engine._upload(task.batch.first_slot)
        self._rows = task.batch.row
        self._channels = len(self._plan.tracks.pairs[task.batch.pairs[0]].channels)  # of each pair of the batch
        self._bounds = task.batch.bounds
        begin, end = task.first * self._plan.segment, min(task.last * self._plan.segment, task.length)
        self._maker: Any = engine.maker(task.batch.pairs[0])
        self._state = self._maker.prepare(
            task.source, task.batch, self._bounds, task.start + begin, end - begin, task.branches.activity,
            task.branches.first,
        )  # fmt: skip
        self._beside = is_divided(engine.kind(task.batch.pairs[0]))
        self._tolerance = 10 ** (self._plan.motion_error_db / 20) * math.sqrt(task.share)
        self._functions = len(self._plan.source_filters[task.source].basis)
        self._gains = self._functions * self._channels  # of a path

    def render(self, level: int = 0) -> None:
        """Add the batch's paths to the pressure on the device, in blocks of a level or shorter ones."""
        for first, last in self._bounds.stretches(self._start, self._plan.segment, self._task.first, self._task.last):
            self._cover(first, last, level)

    def _cover(self, first: int, last: int, level: int) -> None:
        """Render segments `first` to `last` in blocks of a level, or shorter ones where those are too coarse."""
        plan, segment, filters = self._plan, self._plan.segment, self._plan.source_filters[self._source]
        block = plan.blocks[level]
        node = plan.bytes_per_node(self._source, self._channels)
        limits, count = self._engine.limits, self._batch.count
        step = max(1, limits.node_budget // (node * count * (segment // block)))
        step = min(step, limits.segments_in_launch(count, block))
        for at in range(first, last, step):
            upto = min(at + step, last)
            begin, end = at * segment, min(upto * segment, self._length)
            nodes = self._maker.nodes(
                self._state, self._start + begin, block, (end - begin) // block,
                lambda: self._engine.branch_signals.prefetch(self._source, self._start),
            )  # fmt: skip
            self._branches.check(nodes.shortest, nodes.longest, filters.start, filters.rate)
            number = self._start // segment + at
            is_last = level + 1 == len(plan.blocks) or not self._fits(plan.blocks[level + 1])
            error, few = self._errors(nodes, number, divides=self._beside and self._divides and not is_last)
            wanted = self._levels(np.where(few.any(axis=1), 0.0, error), level)
            if is_last:
                for i in np.flatnonzero(wanted > level).tolist():
                    middle = self._start + (at + i + 0.5) * segment
                    coarse, here = self._engine.coarse, (float(error[i]), middle / plan.sampling_rate)
                    coarse[self._source] = max(coarse[self._source], here)
                wanted[:] = level
            for a, b in equal_runs(wanted):
                if wanted[a] > level:
                    self._cover(at + a, at + b, int(wanted[a]))
                    continue
                for c, d in equal_runs(few[a:b].any(axis=1) * (1 + np.arange(b - a) // _TURN)):
                    self._take(nodes, at, slice(a + c, a + d), level, (error, few))

    def _take(self, nodes: Any, at: int, some: slice, level: int, judged: tuple[Floats, NDArray[Any]]) -> None:
        """Render nodes of some segments, counted from one on, and the few paths among them in shorter blocks."""
        a, b, (error, few), segment = some.start, some.stop, (each[some] for each in judged), self._plan.segment
        squares, block, out = nodes.squares[:, some], self._plan.blocks[level], few.any(axis=0)
        first_block, end = a * segment // block, min((at + b) * segment, self._length)
        if out.any():
            blocks = np.arange(first_block, (end - at * segment) // block, dtype=np.int32)
            slots = np.flatnonzero(out).astype(np.int32).repeat(len(blocks))
            self._clear_gains(nodes, slots, np.resize(blocks, len(slots)), len(slots))
            squares = np.where(out, 0.0, squares)
        of_receivers = np.add.reduceat(squares[2:0:-1], self._batch.first_slot[:-1], axis=2, dtype=np.float64)
        self._engine.residuals[self._source].add(self._start // segment + at + a, self._batch.receiver, of_receivers)
        self._render(nodes, at + a, end, block, first_block)
        if out.any():
            batch, share = self._batch.part(np.asarray(out)), 0.5 * self._task.share
            task = replace(self._task, batch=batch, first=at + a, last=at + b, share=share)
            type(self)(self._engine, task).render(int(self._promising_levels(error, level).min()))

    def _errors(self, nodes: Any, first: int, *, divides: bool) -> tuple[Floats, NDArray[np.bool_]]:
        """Errors (segments,) of blocks relative to the received level, and a mask (segments, slots) of few paths.

        For these alone the others would need shorter blocks. At edges, by scatterers and by bodies the level is also
        that of all that was rendered before: reflections come first.
        """
        level, begins = self._engine.residuals[self._source].level, self._batch.first_slot
        few = np.zeros(nodes.squares.shape[1:], dtype=np.bool_)
        before = np.stack([level(first + i, self._batch.receiver) for i in range(len(few))]) if self._beside else 0.0
        error, received = block_errors(nodes.squares, begins, before, self._plan.tracks.least_level)
        divides &= self._batch.count >= FEW * BATCH  # of fewer slots no part is small enough
        for i in np.flatnonzero(error > self._tolerance).tolist() if divides else []:
            few[i] = few_paths(nodes.squares[0, i], begins, 0.5 * (self._tolerance * received[i]) ** 2)
            few[i] &= FEW * self._batch.part(few[i]).count <= self._batch.count
        return error, few

    def _levels(self, error: Floats, level: int) -> NDArray[np.int64]:
        """Return the levels of blocks to try next for segments with errors (segments,): the same where they will do."""
        wanted = np.full(len(error), level + 1)
        if self._beside and (self._batch.few or self._batch.count < FEW * BATCH):  # too few for a part of them
            wanted = self._promising_levels(error, level)
        return np.where(error > self._tolerance, wanted, level)

    def _promising_levels(self, error: Floats, level: int) -> NDArray[np.int64]:
        """Return the levels of shorter blocks that may do for segments with errors (segments,) at a level."""
        blocks = np.array([b for b in self._plan.blocks if self._fits(b)])
        return promising(blocks, level, error / self._tolerance)

    def _fits(self, block: int) -> bool:
        """Test whether the polynomials of one segment in blocks of a length fit into memory."""
        node = self._plan.bytes_per_node(self._source, self._channels)
        needed = node * self._batch.count * (self._plan.segment // block)
        return not self._plan.is_fine(block) or needed <= 4 * self._engine.limits.node_budget

    def _render(self, nodes: Any, segment: int, end: int, block: int, first_block: int) -> None:
        engine, filters = self._engine, self._plan.source_filters[self._source]
        subblock, fine = self._plan.subblock(self._source, block), self._plan.is_fine(block)
        sparse = nodes.activity is not None
        layout = engine._layout.constants(subblock, sparse=sparse, fine=fine, oversampling=filters.oversampling)
        begin = segment * self._plan.segment
        arguments = self._branch_arguments(begin) | self._block_arguments(nodes, first_block)
        self._render_fades(nodes, segment, end, block, first_block)
        subblocks = (end - begin) // subblock
        size = (-(-subblocks // layout["SUBBLOCKS"]) * layout["WORKERS"], len(self._batch.pairs))
        together = _TOGETHER if sparse and self._functions > 1 and self._channels == 1 else 1
        for first in range(0, self._channels, _CHANNELS):
            channels = min(_CHANNELS, self._channels - first)
            constants = {"FUNCTIONS": together * channels, "CHANNELS": channels, "DELAY_TERMS": self._plan.delay_terms}
            kernel = engine._compiler.kernel("render", layout | constants | {"APART": int(self._apart)})
            for k in range(0, self._functions, together):
                kernel(
                    engine._queue, (size, (layout["WORKERS"], 1)), **arguments, first_row=filters.rows,
                    functions=self._gains, first_gain=k * self._channels + first, first_function=k,
                    functions_here=min(together, self._functions - k), first_slot=self._first_slot,
                    block_subblocks=block // subblock, subblocks=subblocks, pressure_row=self._rows + np.int32(first),
                    pressure=self._pressure, pressure_stride=self._stride, first_sample=begin - self._origin,
                )  # fmt: skip

    def _render_fades(self, nodes: Any, segment: int, end: int, block: int, first_block: int) -> None:
        """Render the blocks in which paths begin or end, and take them out of the polynomials."""
        engine, begin = self._engine, segment * self._plan.segment
        fades = self._fades(self._start + begin, block, -(-(end - begin) // block))
        if fades is None:
            return
        filters = self._plan.source_filters[self._source]
        slot, at = engine._upload(fades.slot), engine._upload(fades.block + np.int32(first_block))
        constants = {"OVERSAMPLING": filters.oversampling, **self._polynomial_constants(nodes)}
        kernel = engine._compiler.kernel("fades", constants | {"TRIMMED": self._trims * constants["SPARSE"]})
        kernel(
            engine._queue, self._fade_work(fades, block), **self._branch_arguments(begin),
            **self._block_arguments(nodes, first_block), **self._fade_arguments(fades, slot, block, end - begin),
            subblock=self._plan.subblock(self._source, block), functions=self._functions, channels=self._channels,
            first_row=filters.rows, pressure=self._pressure, pressure_stride=self._stride,
            first_sample=begin - self._origin,
        )  # fmt: skip
        self._leave(nodes, fades, slot, at, block)

    def _leave(self, nodes: Any, fades: Fades, slot: Any, at: Any, block: int) -> None:
        """Leave nothing of the blocks in which paths begin or end, by slot and block."""
        self._clear_gains(nodes, slot, at, len(fades.slot))

    def _fades(self, start: int, block: int, blocks: int) -> Fades | None:
        """Return the beginnings and ends of paths within some blocks from a sample on."""
        return self._batch.fades(start, block, blocks)

    def _polynomial_constants(self, nodes: Any) -> dict[str, int]:
        """Return the constants of the layout of block polynomials."""
        return {"DELAY_TERMS": self._plan.delay_terms, "SPARSE": int(nodes.activity is not None)}

    def _branch_arguments(self, begin: int) -> dict[str, Any]:
        """Return the branch signals for samples of the chunk from `begin` on, as kernels take them."""
        # Place in a branch signal of the recording's sample `begin` of the chunk, without delay.
        lead = self._start + begin - self._branches.first // self._plan.source_filters[self._source].oversampling
        return {"branches": self._branches.rows, "stride": self._branches.stride, "lead": lead}

    def _block_arguments(self, nodes: Any, first_block: int) -> dict[str, Any]:
        """Return the polynomials of blocks from one on, as kernels take them."""
        return {
            "delay": nodes.delay, "polynomials": nodes.polynomials, "activity": nodes.activity,
            "slots": self._batch.count, "first_block": first_block,
        }  # fmt: skip

    def _fade_arguments(self, fades: Fades, slot: Any, block: int, samples: int) -> dict[str, Any]:
        """Return the blocks in which paths begin or end, as kernels take them."""
        ramp = self._bounds.ramp
        return {
            "slot_of": slot, "start": fades.start, "end": fades.end, "first": fades.first,
            "row": fades.row,
            "block": fades.at, "per_ramp": 1.0 / ramp if ramp else 0.0, "block_samples": block, "samples": samples,
        }  # fmt: skip

    def _fade_work(self, fades: Fades, block: int) -> WorkItems:
        """Return the work-items of blocks in which paths begin or end: samples, places and channels."""
        return work(block, len(fades.row), self._channels, group=math.gcd(block, 32))

    def _clear_gains(self, nodes: Any, slot: Any, at: Any, count: int) -> None:
        """Clear the gains of paths, by slot and block."""
        kernel = self._engine._compiler.kernel("clear_gains", self._polynomial_constants(nodes))
        kernel(
            self._engine._queue, work(count), count=count, slot=slot, block=at, functions=self._gains,
            polynomials=nodes.polynomials, slots=self._batch.count,
        )  # fmt: skip


class OpenclEngine:
    """Carries out a plan on an OpenCL device."""

    parts: ClassVar[int] = 1  # real rows of the sound of each receiver
    run: ClassVar[type[Run]] = Run  # renders a batch of receivers

    def __init__(self, plan: Plan, layout: Layout | None = None) -> None:
        import pyopencl as cl

        self._plan = plan
        self._info, device = find_device(plan.options.device)
        self._layout = layout or (GPU_LAYOUT if self._info.kind == "GPU" else CPU_LAYOUT)
        check_group(self._info, 32)
        self.limits = Limits(plan, self._info, self.parts)
        self._compiler = compiler_of(device)
        context = self._compiler.context
        self._queue, self._scratch = cl.CommandQueue(context), Scratch(context)
        self._upload = partial(upload, context)
        self.branch_signals = BranchSignals(
            plan, self._queue, self._compiler, self._scratch, self._layout.lanes, self.parts, self.limits.most_samples
        )
        self.skips_silence = True
        self.residuals = [Residual(plan.receiver_count) for _ in plan.source_filters]
        self.coarse = [(0.0, 0.0)] * len(plan.source_filters)  # largest error of the shortest blocks, and when, s
        self._makers: dict[PathFamily | None, Maker] = {}  # None: the host, whatever the kind of paths

    def render(self, start: int, stop: int) -> NDArray[Any]:
        """Return the pressure (rows, stop - start) in Pa; `start` is a whole number of segments."""
        pressure = np.zeros((self._plan.row_count, stop - start), dtype=self._plan.sample_type)
        self.add(pressure, start)
        return pressure

    def add(self, pressure: NDArray[Any], start: int) -> None:
        """Add all paths from sample `start` on, a whole number of segments, to the pressure (rows, n), Pa."""
        import pyopencl as cl

        most = self.limits.most_samples
        try:
            for first in range(0, pressure.shape[1], most):
                self._add(pressure[:, first : first + most], start + first)
        except cl.Error as error:
            raise DeviceError(
                f"{self._info.name} ran out of memory or failed ({error}); render with a smaller chunk=, fewer "
                "receivers at a time, or on another device (see `clsim devices`)"
            ) from error

    def until(self, last: int) -> None:
        """Prepare nothing from sample `last` on."""
        self.branch_signals.last = last

    def warn(self) -> None:
        """Warn of responses for which the functions of frequency miss the requested error."""
        for i, filters in enumerate(self._plan.source_filters):
            reached = self.residuals[i].level_db
            if reached > filters.residual_db > -math.inf:
                warn(
                    f"source {i}: air, walls and directivities are approximated to {reached:.1f} dB, not the "
                    f"{filters.basis.requested_db:g} dB asked for; ask for a smaller {filters.basis.option}"
                )
            wrong, time = self.coarse[i]
            wrong_db = 20.0 * math.log10(max(wrong, 1e-15))
            if wrong_db > self._plan.motion_error_db + 6.0:  # that of the delay filters
                warn(
                    f"source {i}: at about {time:.3f} s it passes a receiver so near and fast, or turns so sharply, "
                    f"that even the shortest blocks have an error of {wrong_db:.0f} dB re the received level; "
                    "raise the sampling rate or the distance"
                )

    def shares(self, other: OpenclEngine) -> None:
        """Have `warn` report this engine and another, which renders other paths of the same plan."""
        self.residuals, self.coarse = other.residuals, other.coarse

    def kind(self, pair: int) -> PathFamily | None:
        """Return the kind of paths of a pair for which the device has a program of nodes; None for the host."""
        plan, of_scene = self._plan, self._plan.tracks.of_scene
        if of_scene is None or not plan.tracks.on_device:
            return None
        family, member, scene = of_scene.pair_paths[pair].family, of_scene.pairs[pair], of_scene.paths.scene
        # Without float64 there is none for envelopes, whose delays are septics, and for wind.
        in_pairs = plan.baseband is None and scene.air.wind is None
        known = COLUMNS.keys() if self._info.fp64 else {"images"} if in_pairs else set()
        gains = len(member.channels) * len(plan.source_filters[member.source].basis)
        on_device = family.device in known and has_directivity(scene.receivers[member.receiver].directivity, gains)
        return family if on_device else None

    def _first_level(self, pair: int) -> int:
        """Return the level of blocks to try first for the paths of a pair: shorter ones for shadows that pass."""
        passes = getattr(self.kind(pair), "silent_ends", False)
        longest = _PASSING * self._plan.sampling_rate if passes else math.inf
        return next((i for i, block in enumerate(self._plan.blocks) if block <= longest), 0)

    def maker(self, pair: int) -> Maker:
        """Return the maker of the nodes of a pair: the device, where it has a program for such paths."""
        plan, of_scene, kind = self._plan, self._plan.tracks.of_scene, self.kind(pair)
        if kind not in self._makers:
            device = NodeMaker if self._info.fp64 else PairNodeMaker
            self._makers[kind] = (
                HostNodeMaker(plan, self._queue) if kind is None or of_scene is None
                else device(plan, of_scene, kind, self._queue, self._compiler, self._layout.nodes)
            )  # fmt: skip
        return self._makers[kind]

    def _add(self, pressure: NDArray[Any], start: int) -> None:
        import pyopencl as cl

        plan, length = self._plan, self.branch_signals.whole_blocks(start, start + pressure.shape[1])
        shape = self.parts * plan.row_count, length
        size = 4 * shape[0] * shape[1]
        on_device = None
        for source in range(len(plan.source_filters)):
            feed = self.branch_signals.take(source, start, length)
            if feed is None:
                continue
            if on_device is None:
                on_device = self._scratch.take("pressure", size)
                cl.enqueue_fill_buffer(self._queue, on_device, np.zeros(1, np.float32), 0, size)
            active, branches = feed.active, self.branch_signals.made(feed, self.skips_silence)
            for first, last, here in self.branch_signals.chosen(active, start, length):
                parts = [part for pair in here for part in pair.parts(self.limits.paths_in_launch)]
                for batch in in_batches(plan, parts, self.kind, self.limits.node_budget, plan.shortest_block):
                    task = Task(source, batch, branches, on_device, length, start, first, last)
                    self.run(self, task).render(self._first_level(batch.pairs[0]))
        for residuals in self.residuals:
            residuals.settle((start + length) // plan.segment)
        if on_device is None:
            return
        rows: Any = cl.enqueue_map_buffer(self._queue, on_device, cl.map_flags.READ, 0, shape, np.dtype("f4"))[0]
        self.put(rows[:, : pressure.shape[1]], pressure)
        rows.base.release(self._queue)

    def put(self, rows: NDArray[np.float32], pressure: NDArray[Any]) -> None:
        """Add the rows of all receivers, `parts` of each, to the pressure."""
        pressure += rows
