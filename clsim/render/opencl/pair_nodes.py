"""Tracks computed on devices without float64, from the images of a scene: positions and times as pairs of floats."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.opencl.launch import work
from clsim.paths.cubics import CUBIC_COLUMNS
from clsim.render.opencl.nodes import NodeMaker

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Floats
    from clsim.render.opencl.batches import PathBatch
    from clsim.render.opencl.nodes import DeviceChunk

# A receiver at a node, as in nodes/pair_delay.h.
PAIR_RECEIVER = np.dtype(
    [("position", "f4", (3, 2)), ("clock_error", "f4", 2), ("velocity", "f4", 3), ("axes", "f4", (2, 3)),
     ("clock_drift", "f4")]
)  # fmt: skip


def pairs(values: Floats) -> NDArray[np.float32]:
    """Return numbers (...) as pairs of floats (..., 2), the second one what the first leaves."""
    large = np.asarray(values).astype(np.float32)
    return np.stack([large, (values - large).astype(np.float32)], axis=-1)


class PairNodeMaker(NodeMaker):
    """Makes block polynomials with ``pair_tracks.cl``: every node has its gains."""

    most_counted = 2**23  # samples that floats count to the half

    def _views(self, source: int, rows: NDArray[np.int64]) -> dict[str, Any]:
        image = self._family.legs[0].part(rows)
        return self._uploaded(image_matrix=pairs(image.matrix.reshape(-1, 9).T), image_offset=pairs(image.offset.T))

    def _trajectory(self, knots: Floats) -> dict[str, Any]:
        both = pairs(knots)
        return self._uploaded(knots=both[..., 0], rests=both[:, :CUBIC_COLUMNS, 1])

    def _coarse_delays(
        self, source: int, batch: PathBatch, paths: dict[str, Any], start: int, ends: int
    ) -> dict[str, Any]:
        """Return nothing: nodes are predicted from those before."""
        return {}

    def _launch(
        self, chunk: DeviceChunk, start: int, segments: int, receivers: NDArray[Any], more: dict[str, Any]
    ) -> None:
        rate, filters, block = self._plan.sampling_rate, self._plan.source_filters[chunk.source], more["block_samples"]
        trajectory = chunk.trajectory.copy()
        origin = trajectory.pop("first_knot")
        first, last = filters.emitted_between(rate)
        c, times = self._media[chunk.source]["speed_of_sound"], filters.oversampling
        numbers = [
            start / rate - origin,
            block / rate,
            1.0 / c,
            times * rate,
            filters.delay_samples,
            0.5 * times * block,
        ]
        told = np.zeros(receivers.shape, PAIR_RECEIVER)
        for name in ("velocity", "axes"):
            told[name] = receivers[name]
        for name in ("position", "clock_error"):
            told[name] = pairs(receivers[name])
        told["clock_drift"] = receivers["clock_rate"] - 1.0
        constants = self._constants(chunk.source, chunk.batch) | {"SPARSE": int(more["activity"] is not None)}
        kernel = self._compiler.kernel("pair_tracks", constants)
        kernel(
            self._queue, work(chunk.batch.count, segments), **chunk.images, **chunk.columns, **trajectory, **more,
            receivers=told, numbers=pairs(np.array(numbers)), speed_of_sound=c, emitted_first=first - origin,
            emitted_last=last - origin,
        )  # fmt: skip
