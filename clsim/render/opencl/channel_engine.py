"""The OpenCL engine for sampled channels: the same tracks, spread over the impulse responses of nodes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.opencl.launch import work
from clsim.render.channel_frames import ChannelFilters, ChannelFrames
from clsim.render.channel_grid import PHASES, TAPS, ChannelGrid, nodes_of, window_table
from clsim.render.opencl.batches import ActivePaths, fill_batch
from clsim.render.opencl.branch_signals import Branches
from clsim.render.opencl.engine import OpenclEngine, Run, Task
from clsim.render.opencl.host_nodes import side_by_side, thread_count
from clsim.render.plan import BATCH

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.render.plan import Plan

_APART = 8  # neighbouring slots whose delays lie far apart, see scatter.cl
_AT_ONCE = 8 * 2**20  # bytes of grids that are made at a time: what is transformed at once should stay in cache
_ROWS = 4  # of float32 that SciPy transforms side by side; those that are left over take three times as long each
_MARGIN = 64  # samples beside the bounds of delays
_NEVER = -(2**62)


@dataclass(frozen=True, slots=True, eq=False)
class ChannelTask(Task):
    """The paths of a batch of receivers from one source, and the frames of the nodes of a chunk."""

    frames: ChannelFrames


class ChannelEngine(OpenclEngine):
    """Renders pairs of a plan by their impulse responses at nodes that are a number of samples apart."""

    def __init__(self, plan: Plan, spacing: int) -> None:
        super().__init__(plan)
        self._spacing = spacing
        self.window = self._upload(window_table().astype(np.float32))
        self.branch_signals.last = _NEVER  # there are none to prepare
        self._filters = [ChannelFilters.of(filters) for filters in plan.source_filters]

    def add(self, pressure: NDArray[Any], start: int) -> None:
        """Add all pairs of the plan from sample `start` on to the pressure (receivers, n), Pa."""
        block = self._plan.blocks[0]
        nodes = nodes_of(start, start + pressure.shape[1], self._spacing)
        first, last = ((node * self._spacing // block + i) * block for i, node in enumerate((nodes[0], nodes[-1])))
        for source, filters in enumerate(self._filters):
            active = self.branch_signals.active(source, first, last - first)
            if active:
                grid = self._grid(filters, active)
                frames = ChannelFrames(filters, grid, pressure, start)
                self._add_source(source, active, frames, first, last - first)
        for unheld in self.unheld:
            unheld.settle(first // self._plan.segment)

    def _grid(self, filters: ChannelFilters, active: list[ActivePaths]) -> ChannelGrid:
        low, high = min(pair.low.min() for pair in active), max(pair.high.max() for pair in active)
        return filters.grid(float(low), float(high), self._spacing)

    def _add_source(
        self, source: int, active: list[ActivePaths], frames: ChannelFrames, start: int, length: int
    ) -> None:
        plan, rate, begin = self._plan, self._plan.sampling_rate, self._plan.source_filters[source].start
        least = round((min(float(pair.low.min()) for pair in active) + begin) * rate)
        most = round((max(float(pair.high.max()) for pair in active) + begin) * rate)
        branches = Branches(None, 0, start - most, least - _MARGIN, most + _MARGIN, None)
        heard = [part for pair in active for part in pair.parts(self.limits.paths_in_launch)]
        for some in self._batches(heard, source, plan.blocks[0]):
            batch = fill_batch(plan, some, BATCH, apart=_APART)
            task = ChannelTask(source, batch, branches, None, length, start, 0, -(-length // plan.segment), frames)
            _ChannelRun(self, task).render()


class _ChannelRun(Run):
    """Makes the responses of one batch of receivers at the nodes of some segments, and adds what is heard by them."""

    _task: ChannelTask
    _engine: ChannelEngine

    def _render(self, nodes: Any, segment: int, end: int, block: int, first_block: int) -> None:
        begin, frames, rows = segment * self._plan.segment, self._task.frames, self._batch.row
        spacing, first, last = frames.grid.spacing, self._start + begin, self._start + end
        wanted = frames.sounding(range(-(-first // spacing), -(-last // spacing)))
        size = 4 * len(rows) * self._functions * frames.grid.points
        unit = thread_count() * (_ROWS // math.gcd(_ROWS, len(rows)))
        step = unit * max(1, _AT_ONCE // (unit * size))
        for some in (wanted[i : i + step] for i in range(0, len(wanted), step)):
            at = np.array(some) * spacing - first
            place = 2.0 * (at % block) / block - 1.0
            self._scattered(nodes, some, (at // block + first_block).astype(np.int32), place.astype(np.float32))

    def _scattered(self, nodes: Any, some: list[int], block: NDArray[np.int32], place: NDArray[np.float32]) -> None:
        """Make the responses of some nodes, and add what is heard by them."""
        import pyopencl as cl

        engine, frames, rows = self._engine, self._task.frames, self._batch.row
        shape = len(some), len(rows), self._functions, frames.grid.points
        grids = engine._scratch.take("grids", 4 * math.prod(shape))
        bank = self._plan.source_filters[self._source].bank
        room = 1 if self._functions == 1 else -(-self._functions // 8) * 8
        constants = {"LANES": 8, "FUNCTIONS": room, "PHASES": PHASES, "TAPS": TAPS, **self._polynomial_constants(nodes)}
        engine._compiler.kernel("scatter", constants)(
            engine._queue, work(len(some), len(rows), group=1), delay=nodes.delay, polynomials=nodes.polynomials,
            slots=self._batch.count, functions=self._functions, node_block=block, node_place=place, nodes=len(some),
            first_slot=self._first_slot, receivers=len(rows), window=engine.window,
            first=frames.grid.first - math.floor(bank.shift), shift=bank.shift - math.floor(bank.shift),
            points=shape[3], grids=grids,
        )  # fmt: skip
        made: Any = cl.enqueue_map_buffer(engine._queue, grids, cl.map_flags.READ, 0, shape, np.dtype("f4"))[0]
        parts = np.array_split(np.arange(len(some)), min(thread_count(), len(some)))
        heard = side_by_side(lambda part: frames.heard([some[i] for i in part], made[part[0] : part[-1] + 1]), parts)
        made.base.release(engine._queue)
        for part, samples in zip(parts, heard, strict=True):
            for i, of_node in zip(part, samples, strict=True):
                frames.add(some[i], rows, of_node)
