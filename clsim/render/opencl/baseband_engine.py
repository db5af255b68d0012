"""The OpenCL engine for complex envelopes: the same tracks and branch signals, another sum over paths."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.opencl.launch import work
from clsim.render.baseband import WIDEST_SUBBLOCK
from clsim.render.envelope import EnvelopeFilters
from clsim.render.opencl.batches import Layout
from clsim.render.opencl.engine import OpenclEngine, Run
from clsim.render.plan import BATCH, Plan

_GROUPS = 8  # of samples with one whole delay, for which a batch of paths is summed together
_PLACES = 8  # segments in which blocks are looked at before any is rendered
_FEW = 2  # blocks that are looked at in each
_FAR = 30.0  # times the tolerance: an error from which on the next shorter blocks will not do either


class _BasebandRun(Run):
    """Renders one batch of receivers over some segments of a chunk."""

    _engine: BasebandEngine

    def render(self, level: int = 0) -> None:
        """Add the batch's paths to the envelopes, and remember the longest blocks in which it was rendered."""
        self._rendered = len(self._plan.blocks)
        super().render(level)
        if level == 0:
            self._engine.levels[self._source] = self._rendered

    def _cover(self, first: int, last: int, level: int) -> None:
        """Render segments `first` to `last` in blocks of a level or below, beginning with those that may do."""
        level = max(level, self._engine.levels.get(self._source, 0))
        super()._cover(first, last, self._promising(first, last, level))

    def _promising(self, first: int, last: int, level: int) -> int:
        """Return the blocks, from a level down, with which the fewest nodes are made, judged by a few of them."""
        plan = self._plan
        if last - first < _PLACES:
            return level
        places = [first + (last - first) * (2 * i + 1) // (2 * _PLACES) for i in range(_PLACES)]
        while level < len(plan.blocks) - 1:
            block, shorter = plan.blocks[level : level + 2]
            errors: list[float] = []
            for at in places:
                begin = at * plan.segment
                blocks = min(_FEW, (self._length - begin) // block)
                nodes = self._maker.nodes(self._state, self._start + begin, block, blocks)
                number = self._start // plan.segment + at
                error, few = self._errors(nodes, number, divides=self._beside)
                errors.append(0.0 if few.any() else float(error.max()))
            # Where they are too long, shorter ones are made as well: one after the other 1 + share * block / shorter.
            if np.mean(np.array(errors) > self._tolerance) <= 1.0 - shorter / block:
                return level
            far = float(np.median(errors)) > _FAR * self._tolerance and shorter > 0.7 * block
            level += 2 if far else 1
        return min(level, len(plan.blocks) - 1)

    def _render(self, nodes: Any, segment: int, end: int, block: int, first_block: int) -> None:
        engine, begin = self._engine, segment * self._plan.segment
        self._rendered = min(self._rendered, self._plan.blocks.index(block))
        self._render_fades(nodes, segment, end, block, first_block)
        on_cpu = engine._layout.lanes > 1
        lanes = min(block, WIDEST_SUBBLOCK) if on_cpu else 1
        groups, together = (end - begin) // lanes, _GROUPS if on_cpu else 1
        spans = -(-groups // together)
        size = work(spans, len(self._batch.pairs), self._channels, group=1 if on_cpu else math.gcd(spans, 32))
        filters = self._filters
        constants = {
            "LANES": lanes, "GROUPS": together, "BATCH": BATCH if on_cpu else 1,
            "FINE": int(not (on_cpu and self._plan.left_out_over(self._source, block, few=self._batch.few))),
            "COUNTS": filters.counts, "SUBBLOCK": filters.bank.subblock,
            "TILTED": int(filters.stretches.per_sample != 0.0),
        }  # fmt: skip
        kernel = engine._compiler.kernel("baseband", constants | self._constants(nodes))
        kernel(
            engine._queue, size, **self._branch_arguments(begin), **self._block_arguments(nodes, first_block),
            **self._envelope_arguments(begin), first_slot=self._first_slot, block_samples=block, groups=groups,
            envelope_row=self._rows,
        )  # fmt: skip

    def _render_fades(self, nodes: Any, segment: int, end: int, block: int, first_block: int) -> None:
        engine, begin = self._engine, segment * self._plan.segment
        fades = self._batch.fades(self._start + begin, block, -(-(end - begin) // block))
        if fades is None:
            return
        slot = engine._upload(fades.slot)
        kernel = engine._compiler.kernel("baseband_fades", self._constants(nodes) | {"LANES": 1})
        kernel(
            engine._queue, self._fade_work(fades, block), **self._branch_arguments(begin),
            **self._block_arguments(nodes, first_block), **self._fade_arguments(fades, slot, block, end - begin),
            **self._envelope_arguments(begin),
        )  # fmt: skip
        self._clear_gains(nodes, slot, fades.block + np.int32(first_block), len(fades.slot))

    def _constants(self, nodes: Any) -> dict[str, int]:
        of_functions = {"FUNCTIONS": self._functions, "PAIRED": int(self._filters.basis.paired)}
        return self._polynomial_constants(nodes) | of_functions | {"CHANNELS": self._channels}

    @property
    def _filters(self) -> EnvelopeFilters:
        filters = self._plan.source_filters[self._source]
        assert isinstance(filters, EnvelopeFilters)
        return filters

    def _envelope_arguments(self, begin: int) -> dict[str, Any]:
        """Return the envelopes for samples of the chunk from `begin` on, as kernels take them."""
        stretches = self._filters.stretches
        return {
            "first_row": self._filters.rows[: self._functions + 1], "envelope": self._pressure,
            "envelope_stride": self._length, "first_sample": begin,
            "turn_per_sample": round(self._filters.mixer.turn * 2**64) % 2**64,
            "half_turns_per_sample": 2.0 * self._filters.cycles, "tilt_per_sample": stretches.per_sample,
            "stretch": stretches.length, "per_stretch": 1.0 / stretches.length, "first_stretch": stretches.origin,
            "stretches": stretches.count,
        }  # fmt: skip


class BasebandEngine(OpenclEngine):
    """Carries out a plan of complex envelopes on an OpenCL device."""

    parts, run = 2, _BasebandRun

    def __init__(self, plan: Plan, layout: Layout | None = None) -> None:
        super().__init__(plan, layout)
        # By source: the longest blocks in which any batch of a chunk was rendered, with which the next ones begin.
        self.levels: dict[int, int] = {}

    def _add(self, pressure: NDArray[Any], start: int) -> None:
        self.levels.clear()
        super()._add(pressure, start)

    def put(self, rows: NDArray[np.float32], pressure: NDArray[Any]) -> None:
        pressure.real += rows[::2]
        pressure.imag += rows[1::2]
