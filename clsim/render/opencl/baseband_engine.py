"""The OpenCL engine for complex envelopes: the same tracks and branch signals, another sum over paths."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.opencl.device import work
from clsim.render.baseband import WIDEST_SUBBLOCK
from clsim.render.envelope import EnvelopeFilters
from clsim.render.opencl.engine import OpenclEngine, Run
from clsim.render.opencl.fades import find_fades

if TYPE_CHECKING:
    from numpy.typing import NDArray

_PLACES = 8  # segments in which blocks are looked at before any is rendered
_FEW = 2  # blocks that are looked at in each
_FAR = 30.0  # times the tolerance: an error from which on the next shorter blocks will not do either


class BasebandEngine(OpenclEngine):
    """Carries out a plan of complex envelopes on an OpenCL device."""

    parts = 2

    @property
    def run(self) -> type[Run]:
        """What renders a batch of receivers."""
        return _BasebandRun

    def render(self, start: int, stop: int) -> NDArray[Any]:
        """Return the envelopes (receivers, stop - start) in Pa, complex64; `start` is a whole number of segments."""
        rows = super().render(start, stop)
        out = np.empty((len(rows) // 2, rows.shape[1]), dtype=np.complex64)
        out.real, out.imag = rows[::2], rows[1::2]
        return out


@dataclass(frozen=True, slots=True)
class _Launch:
    """What both kernels take alike."""

    constants: dict[str, int]
    branches: tuple[Any, ...]
    envelope: tuple[Any, ...]


class _BasebandRun(Run):
    """Renders one batch of receivers over some segments of a chunk."""

    def _cover(self, first: int, last: int, level: int) -> None:
        """Render segments `first` to `last` in blocks of a level or below, beginning with those that may do."""
        super()._cover(first, last, self._promising(first, last, level))

    def _promising(self, first: int, last: int, level: int) -> int:
        """Return the blocks, from a level down, with which the fewest nodes are made, judged by a few of them."""
        plan = self._plan
        if last - first < _PLACES:
            return level
        places = [first + (last - first) * (2 * i + 1) // (2 * _PLACES) for i in range(_PLACES)]
        while level < len(plan.blocks) - 1:
            block, shorter = plan.blocks[level : level + 2]
            errors = []
            for at in places:
                begin = at * plan.segment
                few = min(_FEW, (self._length - begin) // block)
                nodes = self._maker.nodes(self._state, self._start + begin, block, few)
                errors.append(float(nodes.error.max()))
            # Where they are too long, shorter ones are made as well: one after the other 1 + share * block / shorter.
            if np.mean(np.array(errors) > self._tolerance) <= 1.0 - shorter / block:
                return level
            far = float(np.median(errors)) > _FAR * self._tolerance and shorter > 0.7 * block
            level += 2 if far else 1
        return min(level, len(plan.blocks) - 1)

    def _render(self, nodes: Any, segment: int, end: int, block: int, first_block: int) -> None:
        engine, begin = self._engine, segment * self._plan.segment
        self._render_fades(nodes, segment, end, block, first_block)
        lanes = engine._layout.lanes
        vectors = min(block, WIDEST_SUBBLOCK) // lanes if lanes > 1 else 1
        spans = (end - begin) // (vectors * lanes)
        size = work(spans, len(self._slots.groups), group=1 if lanes > 1 else math.gcd(spans, 32))
        launch = self._launch(nodes, begin, block, first_block)
        kernel = engine._compiler.kernel(
            "baseband",
            launch.constants | {"VECTORS": vectors, "SPARSE": int(nodes.spans is not None)},
        )
        kernel(
            engine._queue, *size, *launch.branches[:6], self._first_slot, *launch.branches[6:], self._row,
            *launch.envelope, nodes.delay if nodes.spans is None else nodes.spans,
        )  # fmt: skip

    def _render_fades(self, nodes: Any, segment: int, end: int, block: int, first_block: int) -> None:
        """Render the blocks in which paths begin or end, and take them out of the polynomials."""
        engine, begin = self._engine, segment * self._plan.segment
        fades = find_fades(self._bounds, self._slots, self._start + begin, block, -(-(end - begin) // block))
        if fades is None:
            return
        launch, ramp = self._launch(nodes, begin, block, first_block), self._bounds.ramp
        slot = engine._upload(fades.slot)
        columns = (fades.start, fades.end, fades.first, fades.row, fades.at)
        kernel = engine._compiler.kernel("baseband_edges", launch.constants | {"LANES": 1})
        kernel(
            engine._queue, *work(block, len(fades.row), group=math.gcd(block, 32)), *launch.branches,
            np.float32(1.0 / ramp if ramp else 0.0), slot, *(engine._upload(column) for column in columns),
            *launch.envelope, np.int32(end - begin), np.int32(nodes.spans is not None),
            nodes.delay if nodes.spans is None else nodes.spans,
        )  # fmt: skip
        self._mute(nodes, slot, engine._upload(fades.block + np.int32(first_block)))

    def _launch(self, nodes: Any, begin: int, block: int, first_block: int) -> _Launch:
        filters = self._plan.source_filters[self._source]
        assert isinstance(filters, EnvelopeFilters)
        constants = {
            "LANES": self._engine._layout.lanes,
            "DELAY_TERMS": self._plan.delay_terms,
            "FUNCTIONS": self._functions,
            "GROUP": filters.bank.subblock,
        }
        turn = round(filters.mixer.turn * 2**64) % 2**64
        return _Launch(
            constants,
            (
                self._branches.rows, np.int32(self._branches.stride),
                self._engine._upload(filters.rows.astype(np.int32)),
                np.int32(self._start + begin - self._branches.first), nodes.delay, nodes.cubics,
                np.int32(self._slots.count), np.int32(block), np.int32(first_block),
            ),
            (
                self._pressure, np.int32(self._length), np.int32(begin), np.uint64(turn),
                np.float32(2.0 * filters.cycles),
            ),
        )  # fmt: skip
