"""The transpose of the sum over paths on an OpenCL device: moments of what arrives on each path, block by block."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Floats
from clsim.render.opencl.batches import PathBatch
from clsim.render.opencl.engine import OpenclEngine, Run
from clsim.render.plan import BLOCKS
from clsim.sensitivity.images import has_beams
from clsim.tracks.basis import flat_basis

Take = Callable[[int, NDArray[np.int64], int, int, NDArray[np.float32]], None]

_TOGETHER = 4  # long blocks between the nodes of tangents of images, whose directions change slowly
_FAR = 2.0**23  # samples, up to which float32 counts


class MomentEngine(OpenclEngine):
    """Multiplies what arrives by weights of the received samples, instead of adding it up."""

    take: Take
    weights: Any  # on the device, of a chunk

    @property
    def run(self) -> type[Run]:
        """Class that takes a batch of paths."""
        return _MomentRun

    def taken(self, weights: Floats, take: Take) -> None:
        """Pass the moments of all paths on, piece by piece, of weights (rows, samples)."""
        self.take, self.skips_silence = take, False
        for start in range(0, weights.shape[1], self._plan.chunk):
            self.add(weights[:, start : start + self._plan.chunk], start)

    def maker(self, pair: int) -> Any:
        """Return the maker of the nodes of a pair, with one gain in place of those of all functions."""
        plan = self._plan
        one = (replace(f, basis=flat_basis(f.signal.centre_frequency)) for f in plan.source_filters)
        self._plan = replace(plan, source_filters=tuple(one), builders=[])
        try:
            return super().maker(pair)
        finally:
            self._plan = plan

    def together(self, batch: PathBatch, block: int) -> int:
        """Return the number of blocks of a length whose moments are added up, where responses change slowly."""
        tracks = self._plan.tracks.of_scene
        assert tracks is not None
        paths = tracks.pair_paths[batch.pairs[0]]
        slow = block == BLOCKS[0] == self._plan.blocks[0] and not paths.family.costly and not has_beams(paths)
        return _TOGETHER if slow else 1

    def put(self, rows: NDArray[np.float32], pressure: NDArray[Any]) -> None:
        """Leave the weights as they are."""

    def _add(self, pressure: NDArray[Any], start: int) -> None:
        length = self.branch_signals.whole_blocks(start, start + pressure.shape[1])
        padded = np.zeros((len(pressure), length), dtype=np.float32)
        padded[:, : pressure.shape[1]] = pressure
        self.weights = self._upload(padded)
        super()._add(pressure, start)


class _MomentRun(Run):
    """Takes the moments of a batch of paths, in blocks as they would be rendered."""

    _engine: MomentEngine
    _divides = False

    def _render(self, nodes: Any, segment: int, end: int, block: int, first_block: int) -> None:
        import pyopencl as cl

        engine, batch, plan = self._engine, self._batch, self._plan
        begin, subblock = segment * plan.segment, plan.subblock(self._source, block)
        together = engine.together(batch, block)
        blocks, filters, ramp = (end - begin) // block, plan.source_filters[self._source], batch.bounds.ramp
        out = np.empty((self._channels, -(-blocks // together), batch.count, self._functions, 4), dtype=np.float32)
        on_device = engine._scratch.take("moments", out[0].nbytes)
        bounds = [np.clip(x - (self._start + begin), -_FAR, _FAR) for x in (batch.bounds.start, batch.bounds.end)]
        constants = {"SUBBLOCK": subblock, "FUNCTIONS": self._functions, "OVERSAMPLING": filters.oversampling}
        layout = {"LANES": engine._layout.lanes, "TOGETHER": together, **self._polynomial_constants(nodes)}
        layout["GAINS"] = self._channels
        for channel in range(self._channels):
            engine._compiler.kernel("moments", constants | layout)(
                engine._queue, ((batch.count, out.shape[1]), (1, 1)), **self._branch_arguments(begin),
                **self._block_arguments(nodes, first_block), first_row=filters.rows,
                start=np.where(batch.padding, _FAR, bounds[0]).astype(np.float32), end=bounds[1].astype(np.float32),
                per_ramp=1.0 / ramp if ramp else 0.0, block_subblocks=block // subblock, blocks=blocks,
                row=np.repeat(batch.row, np.diff(batch.first_slot)) + np.int32(channel), weights=engine.weights,
                weight_stride=self._length, first_sample=begin, taken=on_device,
            )  # fmt: skip
            cl.enqueue_copy(engine._queue, out[channel], on_device)
        for i, pair in enumerate(batch.pairs):
            mine = np.flatnonzero(~batch.padding[batch.of_pair(i)]) + batch.of_pair(i).start
            engine.take(pair, batch.path[mine], self._start + begin, together * block, out[:, :, mine])
