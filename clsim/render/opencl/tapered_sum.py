"""Tapers of paths on the device, and the sum over what they leave: few paths at a time, each for a short while."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, ClassVar

import numpy as np

from clsim.opencl.launch import work
from clsim.render.opencl.batches import Fades, PathBatch
from clsim.render.opencl.engine import OpenclEngine, Run
from clsim.render.plan import Plan
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


class _TaperedRun(Run):
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
        if not self._is_sparse(nodes):
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

    run = _TaperedRun

    def __init__(self, plan: Plan) -> None:
        super().__init__(plan)
        self.branch_signals.of_few = True
