"""Impulse responses of receivers at instants on the device, and the sum over what tapers leave beside them."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Floats
from clsim.opencl.launch import work
from clsim.render.channel_grid import PHASES, TAPS, ChannelFilters, ChannelFrames, ChannelGrid, nodes_of, window_table
from clsim.render.envelope import EnvelopeFilters
from clsim.render.opencl.batches import ActivePaths, Fades, PathBatch, in_batches
from clsim.render.opencl.branch_signals import Branches, Task
from clsim.render.opencl.engine import OpenclEngine, Run
from clsim.render.opencl.host_nodes import side_by_side, thread_count
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
_TOGETHER = 4  # nodes to a thread at a time. SciPy transforms four side by side; others take three times as long each
_AT_ONCE = 32 * 2**20  # bytes of grids that are made at a time: a launch takes as long as some hundred thousand places
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
        self.reached: dict[tuple[int, ...], int] = {}  # points of grids of a shape (1:) that were ever written

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
                frames = filters.frames(grid, pressure, start)
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
    """Makes the responses of one batch of receivers at the nodes of some segments, and adds what is heard by them."""

    _task: ChannelTask
    _engine: ChannelEngine

    def __post_init__(self) -> None:
        super().__post_init__()
        self._tapers = BatchTapers(self._plan, self._batch)

    @property
    def _parts(self) -> int:
        """Return the number of grids of a function: real and imaginary parts of envelopes."""
        return 1 if self._plan.baseband is None else 2

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
        begin, frames, rows = segment * self._plan.segment, self._task.frames, self._batch.row
        spacing, first, last = frames.grid.spacing, self._start + begin, self._start + end
        wanted = frames.active_nodes(range(-(-first // spacing), -(-last // spacing)))
        beside, step = self._at_a_time(4 * frames.grid.points)
        for some in (wanted[i : i + step] for i in range(0, len(wanted), step)):
            at = np.array(some) * spacing - first
            place = 2.0 * (at % block) / block - 1.0
            where = {
                "node_block": (at // block + first_block).astype(np.int32), "node_place": place.astype(np.float32),
                "node_sample": at.astype(np.float32), **self._tapers.arguments(first),
            }  # fmt: skip
            spectra = frames.spectra(some)
            for i in range(0, len(rows), beside):
                self._scattered(nodes, some, where, spectra, slice(i, min(i + beside, len(rows))))

    def _at_a_time(self, of_grid: int) -> tuple[int, int]:
        """Return the number of receivers and nodes of which responses are made at a time, by the bytes of a grid."""
        unit, of_receiver = _TOGETHER * thread_count(), self._parts * self._gains * of_grid
        beside = min(max(1, _AT_ONCE // (unit * of_receiver)), len(self._batch.row))
        return beside, unit * max(1, _AT_ONCE // (unit * beside * of_receiver))

    def _scattered(
        self, nodes: Any, some: list[int], where: dict[str, Any], spectra: NDArray[Any], receivers: slice
    ) -> None:
        """Make responses of some nodes, by their blocks and places there, to some receivers, and add their sound."""
        import pyopencl as cl

        engine, frames, rows = self._engine, self._task.frames, self._batch.row[receivers]
        shape = len(some), len(rows), self._parts * self._gains, frames.grid.points
        grids = engine._scratch.take(("grids", shape[1:]), 4 * math.prod(shape), zeros=True)
        reached = engine.reached[shape[1:]] = max(frames.grid.reached, engine.reached.get(shape[1:], 0))
        self._scatter(nodes, len(some), where, receivers, reached, grids)
        mapped: Any = cl.enqueue_map_buffer(engine._queue, grids, cl.map_flags.READ, 0, shape, np.dtype("f4"))[0]
        # Of each function the channels of a receiver come side by side.
        made = mapped.reshape(len(some), len(rows), self._functions, self._channels, self._parts, shape[3])
        made = made.swapaxes(2, 3).reshape(len(some), -1, self._functions, self._parts, shape[3])
        made = made[..., 0, :] if self._parts == 1 else made
        rows = (rows[:, None] + np.arange(self._channels)).ravel()
        parts = np.array_split(np.arange(len(some)), min(thread_count(), len(some)))
        received = side_by_side(lambda part: frames.received(spectra[part], made[part[0] : part[-1] + 1]), parts)
        mapped.base.release(engine._queue)
        for part, samples in zip(parts, received, strict=True):
            for i, of_node in zip(part, samples, strict=True):
                frames.add(some[i], rows, of_node)

    def _scatter(
        self, nodes: Any, count: int, where: dict[str, Any], receivers: slice, reached: int, grids: Any,
        components: dict[str, Any] | None = None,
    ) -> None:  # fmt: skip
        """Spread paths of some receivers over grids of some nodes, or over those of a receiver's components."""
        engine, filters, grid = self._engine, self._plan.source_filters[self._source], self._task.frames.grid
        bank, each, together = filters.bank, self._parts * self._gains, 1 if components else _TOGETHER
        constants = {
            "LANES": 8, "FUNCTIONS": 1 if each == 1 else -(-each // 8) * 8, "PHASES": PHASES, "TAPS": TAPS,
            "TOGETHER": together, "TAPERED": int(self._tapers.there), "COMPONENTS": int(components is not None),
            **CONSTANTS, **self._polynomial_constants(nodes),
        }  # fmt: skip
        engine._compiler.kernel("scatter", constants)(
            engine._queue, work(-(-count // together), receivers.stop - receivers.start, group=1), delay=nodes.delay,
            polynomials=nodes.polynomials, slots=self._batch.count, functions=self._gains, nodes=count, **where,
            first_slot=self._batch.first_slot[receivers.start : receivers.stop + 1],
            receivers=receivers.stop - receivers.start, window=engine.window, first=grid.first - math.floor(bank.shift),
            shift=bank.shift - math.floor(bank.shift), points=grid.points, reached=reached, grids=grids,
            **(components or {"weights": None, "room": 0, "vectors": None}), **self._turns(filters),
        )  # fmt: skip


ChannelEngine.run = ChannelRun
