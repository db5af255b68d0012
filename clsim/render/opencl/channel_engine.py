"""Impulse responses of receivers at instants on the device, and the sum over what tapers leave beside them."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Floats
from clsim.opencl.launch import work
from clsim.render.channel_grid import (
    COARSER,
    FINER,
    PHASES,
    TAPS,
    ChannelFilters,
    ChannelFrames,
    ChannelGrid,
    nodes_of,
    window_table,
)
from clsim.render.envelope import EnvelopeFilters
from clsim.render.opencl.batches import ActivePaths, Fades, PathBatch, in_batches
from clsim.render.opencl.branch_signals import Branches, Task
from clsim.render.opencl.engine import OpenclEngine, Run
from clsim.render.opencl.host_nodes import thread_count
from clsim.render.plan import Plan
from clsim.render.source_filters import SourceFilters
from clsim.tracks.splines import TAPER_TERMS, Tapers, taper_terms

TERMS = taper_terms().astype(np.float32)
CONSTANTS = {"TAPER_TERMS": TAPER_TERMS}
_FAR = 2.0**23  # samples, up to which float32 is exact


class BatchTapers:
    """Tapers of a batch's slots."""

    def __init__(self, plan: Plan, batch: PathBatch) -> None:
        tapers = [plan.tracks.pairs[pair].tapers for pair in batch.pairs]
        rows = [batch.path[batch.of_pair(i)] for i in range(len(batch.pairs))]
        lengths = [taper.length for taper in tapers if taper is not None]
        self.there = len(lengths) > 0
        if self.there:
            rate = plan.sampling_rate
            always = Tapers(np.array([-np.inf]), np.array([np.inf]), lengths[0], rest=False)  # of pairs without tapers
            found = [
                always.part(np.zeros(len(some), np.int64)) if taper is None else taper.part(some)
                for taper, some in zip(tapers, rows, strict=True)
            ]
            self.rise, self.fall = (
                np.concatenate([getattr(t, name) for t in found]) * rate for name in ("rise", "fall")
            )
            self._per_half = 2.0 / (lengths[0] * rate)

    def arguments(self, start: int) -> dict[str, Any]:
        """Return tapers as kernels take them, from a sample on."""
        if not self.there:
            return {"rise": None, "fall": None, "terms": None, "per_half": 0.0}
        rise, fall = (np.clip(x - start, -_FAR, _FAR).astype(np.float32) for x in (self.rise, self.fall))
        return {"rise": rise, "fall": fall, "terms": TERMS, "per_half": self._per_half}


class TaperedRun(Run):
    """Multiplies gains by what tapers leave before they are summed."""

    _trims: ClassVar[bool] = True

    def __post_init__(self) -> None:
        super().__post_init__()
        self._tapers = BatchTapers(self._plan, self._batch)
        # Where a taper ends nothing is left, so that no transition is needed there.
        start = np.where(np.isinf(self._tapers.fall), self._bounds.start, -np.inf)
        end = np.where(np.isfinite(self._tapers.rise), np.inf, self._bounds.end)
        self._sudden = replace(self._batch, bounds=replace(self._bounds, start=start, end=end))

    def _fades(self, start: int, block: int, blocks: int) -> Fades | None:
        """Return the beginnings and ends of paths that are no ends of tapers."""
        return self._sudden.fades(start, block, blocks)

    def _leave(self, nodes: Any, fades: Fades, slot: Any, at: Any, block: int) -> None:
        """Leave what is active without a transition of the blocks in which paths begin or end, where that is known."""
        if nodes.activity is None:
            return super()._leave(nodes, fades, slot, at, block)
        ramp, subblock = self._bounds.ramp, self._plan.subblock(self._source, block)
        self._engine._compiler.kernel("trim_activity", {})(
            self._engine._queue, work(len(fades.slot)), count=len(fades.slot), slot_of=slot, block=at,
            start=fades.start, end=fades.end, per_ramp=1.0 / ramp if ramp else 0.0, subblock=subblock,
            activity=nodes.activity, slots=self._batch.count,
        )  # fmt: skip

    def _render(self, nodes: Any, segment: int, end: int, block: int, first_block: int) -> None:
        begin = segment * self._plan.segment
        constants = {"LANES": 1, **CONSTANTS, **self._polynomial_constants(nodes)}
        self._engine._compiler.kernel("taper_gains", constants)(
            self._engine._queue, work(self._batch.count), functions=self._gains, activity=nodes.activity,
            slots=self._batch.count, first_block=first_block, blocks=-(-(end - begin) // block), block_samples=block,
            ramp=float(self._bounds.ramp),
            **self._tapers.arguments(self._start + begin), polynomials=nodes.polynomials,
        )  # fmt: skip
        super()._render(nodes, segment, end, block, first_block)


class TaperedEngine(OpenclEngine):
    """Renders what tapers leave of the paths of a plan."""

    run = TaperedRun

    def __init__(self, plan: Plan) -> None:
        super().__init__(plan)
        self.branch_signals.of_few = True


_APART = 8  # neighbouring slots whose delays lie far apart, see scatter.cl
_AT_ONCE = 8 * 2**20  # bytes of received samples, or of factors, that are made at a time
_CACHED = 640 * 2**10  # bytes of grids of a thread: the second cache holds them
_UNITS, _FUNCTIONS = (2, 1), (8, 4, 2, 1)  # that are taken at a time where their grids do not take more
_MARGIN = 64  # samples beside the bounds of delays


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
        self.branch_signals.last = -(2**62)  # there are none to prepare
        self._filters = [ChannelFilters.of(filters) for filters in plan.source_filters]
        self._tables: dict[ChannelGrid, dict[str, Any]] = {}

    def tables(self, frames: ChannelFrames) -> dict[str, Any]:
        """Return the tables of transforms of frames, and the weights of their samples, on the device."""
        if frames.grid not in self._tables:
            names = "radix", "turns", "lane_turns", "back_turns"
            window = np.pad(frames.window, FINER).astype(np.float32)
            made = {name: getattr(frames.transform, name) for name in names} | {"weights": window}
            self._tables = {frames.grid: {name: self._upload(table) for name, table in made.items()}}
        return self._tables[frames.grid]

    def until(self, last: int) -> None:
        """Prepare nothing anyway."""

    def add(self, pressure: NDArray[Any], start: int) -> None:
        block = self._plan.blocks[0]
        nodes = nodes_of(start, start + pressure.shape[1], self._spacing)
        first, last = ((node * self._spacing // block + i) * block for i, node in enumerate((nodes[0], nodes[-1])))
        for source, filters in enumerate(self._filters):
            active = self.branch_signals.active(source, first, last - first)
            if active:
                grid = self._grid(filters, active)
                frames = ChannelFrames(filters, grid, pressure, start)
                self._add_source(source, active, frames, (first, last - first))
        for residuals in self.residuals:
            residuals.settle(first // self._plan.segment)

    def _grid(self, filters: ChannelFilters, active: list[ActivePaths]) -> ChannelGrid:
        low, high = min(pair.low.min() for pair in active), max(pair.high.max() for pair in active)
        return filters.grid(float(low), float(high), self._spacing)

    def _add_source(self, source: int, active: list[ActivePaths], frames: ChannelFrames, span: tuple[int, int]) -> None:
        plan, (start, length) = self._plan, span
        rate, begin = plan.sampling_rate, plan.source_filters[source].start
        least = round((min(float(pair.low.min()) for pair in active) + begin) * rate)
        most = round((max(float(pair.high.max()) for pair in active) + begin) * rate)
        branches = Branches(None, 0, start - most, least - _MARGIN, most + _MARGIN, None)
        budget, block, most_paths = self.limits.node_budget, plan.blocks[0], self.limits.paths_in_launch
        for first, last, here in self.branch_signals.chosen(active, start, length):
            received = [part for pair in here for part in pair.parts(most_paths)]
            for batch in in_batches(plan, received, self.kind, budget, block, apart=_APART):
                task = ChannelTask(source, batch, branches, None, length, start, first, last, frames)
                self.run(self, task).render()


class ChannelRun(Run):
    """Makes the responses of one batch of receivers at the nodes of some segments, and adds their sound."""

    _task: ChannelTask
    _engine: ChannelEngine

    def __post_init__(self) -> None:
        super().__post_init__()
        self._tapers = BatchTapers(self._plan, self._batch)

    @staticmethod
    def _turns(filters: SourceFilters) -> dict[str, Any]:
        """Return the turn of the carrier of envelopes over a sample, as the kernel takes it."""
        if not isinstance(filters, EnvelopeFilters):
            return {"turn_per_sample": 0, "half_turns_per_sample": 0.0}
        turn = round(filters.mixer.turn * 2**64) % 2**64
        return {"turn_per_sample": turn, "half_turns_per_sample": 2.0 * filters.cycles}

    def _levels(self, error: Floats, level: int) -> NDArray[np.int64]:
        """Return the levels of blocks that may do: for paths that begin and end the longest ones are tried in vain."""
        if not self._tapers.there:
            return super()._levels(error, level)
        return np.where(error > self._tolerance, self._promising_levels(error, level), level)

    def _render(self, nodes: Any, segment: int, end: int, block: int, first_block: int) -> None:
        begin, frames = segment * self._plan.segment, self._task.frames
        spacing, first, last = frames.grid.spacing, self._start + begin, self._start + end
        wanted = frames.active_nodes(range(-(-first // spacing), -(-last // spacing)))
        rows, plane = self._batch.row, 4 * len(frames.transform.lane_turns) * FINER
        together = next((n for n in _UNITS if 2 * n * self._gains * plane <= _CACHED), 1)
        of_unit = np.arange(2 if frames.is_real else 1)
        first_nodes, there = _units(wanted, len(of_unit), together)
        of_receiver = 8 * self._channels * (len(frames.window) + 2 * FINER)
        beside = min(max(1, _AT_ONCE // (together * of_receiver)), len(rows))
        step = together * max(1, _AT_ONCE // (together * max(beside * of_receiver, 4 * plane)))
        for i in range(0, len(first_nodes), step):
            some = first_nodes[i : i + step], there[i : i + step]
            at = (some[0][:, None] + of_unit).ravel() * spacing - first
            where = self._where(at, first, block, first_block) | frames.factors(some[0].tolist())
            where["node_block"] = np.where(some[1].ravel(), where["node_block"], -1).astype(np.int32)
            for k in range(0, len(rows), beside):
                self._received(nodes, some, where, together, slice(k, min(k + beside, len(rows))))

    def _where(self, at: NDArray[np.int64], first: int, block: int, first_block: int) -> dict[str, Any]:
        """Return nodes, samples from the first one on, by their blocks and places there, as kernels take them."""
        return {
            "node_block": (at // block + first_block).astype(np.int32), "nodes": len(at),
            "node_place": (2.0 * (at % block) / block - 1.0).astype(np.float32),
            "node_sample": at.astype(np.float32), **self._tapers.arguments(first),
        }  # fmt: skip

    def _spreading(self) -> dict[str, Any]:
        """Places of paths on grids, as arguments of kernels."""
        first, shift = self._task.frames.grid.first, self._plan.source_filters[self._source].bank.shift
        whole = math.floor(shift)
        return {"window": self._engine.window, "first": first - whole, "shift": shift - whole}

    def _spread_constants(self, nodes: Any, functions: int) -> dict[str, int]:
        """Return the constants of kernels that spread so many functions at a time."""
        return {
            "LANES": 8, "FUNCTIONS": functions, "PHASES": PHASES, "TAPS": TAPS, "TAPERED": int(self._tapers.there),
            **CONSTANTS, **self._polynomial_constants(nodes),
        }  # fmt: skip

    def _received(
        self, nodes: Any, units: tuple[NDArray[Any], NDArray[Any]], where: dict[str, Any], together: int,
        receivers: slice,
    ) -> None:  # fmt: skip
        """Add the sound of some receivers by their responses at the nodes of units, by blocks and places there."""
        import pyopencl as cl

        engine, frames, rows = self._engine, self._task.frames, self._batch.row[receivers]
        filters, grid, nodes_in_unit = self._plan.source_filters[self._source], frames.grid, 2 if frames.is_real else 1
        positions = len(frames.transform.lane_turns)
        of_function = 8 * together * positions * FINER
        some = next((n for n in _FUNCTIONS if n < 2 * self._gains and n * of_function <= _CACHED), 1)
        of_worker = 2 * together * positions * (some * FINER + self._channels * COARSER)
        workers = min(2 * thread_count(), len(units[0]) // together * len(rows))
        shape = len(units[0]), len(rows), self._channels, 2, len(frames.window) + 2 * FINER
        received = engine._scratch.take("received", 4 * math.prod(shape))
        constants = self._spread_constants(nodes, some) | {"TOGETHER": together * nodes_in_unit}
        engine._compiler.kernel("scatter", constants)(
            engine._queue, work(workers, group=1), delay=nodes.delay, polynomials=nodes.polynomials,
            slots=self._batch.count, functions=self._functions, channels=self._channels, **where,
            first_slot=self._batch.first_slot[receivers.start : receivers.stop + 1], receivers=len(rows),
            **self._spreading(), **self._turns(filters), count=grid.size // COARSER, **engine.tables(frames),
            first_sample=grid.span, apart=grid.spacing * (nodes_in_unit - 1), length=len(frames.window),
            stride=shape[-1], scratch=engine._scratch.take("grids", 4 * workers * of_worker), of_worker=of_worker,
            received=received,
        )  # fmt: skip
        mapped: Any = cl.enqueue_map_buffer(engine._queue, received, cl.map_flags.READ, 0, shape, np.dtype("f4"))[0]
        into = (rows[:, None] + np.arange(self._channels)).ravel()
        made = np.moveaxis(mapped.reshape(len(units[0]), len(into), 2, -1)[..., FINER:-FINER], 2, 1)
        for first, there, parts in zip(units[0].tolist(), units[1], made, strict=True):
            for i in np.flatnonzero(there).tolist():
                frames.add(first + i, into, parts[i] if frames.is_real else parts[0] + 1j * parts[1])
        mapped.base.release(engine._queue)


def _units(nodes: list[int], in_unit: int, together: int) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Return the first nodes (units,) of units of up to so many neighbours, and which nodes (units, in_unit) there are.

    The number of units is a multiple of those that are taken together.
    """
    first, counts = list[int](), list[int]()
    for node in nodes:
        if first and counts[-1] < in_unit and node == first[-1] + counts[-1]:
            counts[-1] += 1
        else:
            first.append(node)
            counts.append(1)
    spare = -len(first) % together
    units, there = np.array(first + first[:1] * spare, np.int64), np.array(counts + [0] * spare)
    return units, np.arange(in_unit) < there[:, None]


ChannelEngine.run = ChannelRun
