"""Limits of a device for a plan: samples rendered at a time, and the length of one launch."""

from __future__ import annotations

from typing import TYPE_CHECKING

from clsim.errors import InputError
from clsim.opencl.device import FLOAT64, MOST_INDEX, SHARE, check_buffers, operations_in_launch
from clsim.render.plan import BATCH, NODE_BUDGET, Plan

if TYPE_CHECKING:
    from clsim.opencl.device import DeviceInfo

_LEVELS = 3  # block lengths whose polynomials are kept at the same time
_OPERATIONS_PER_SAMPLE = 10.0  # of a path, beside two for every branch
_OPERATIONS_PER_NODE = 2000.0 * FLOAT64  # of a path


class Limits:
    """The limits of a device for a plan."""

    def __init__(self, plan: Plan, info: DeviceInfo, parts: int) -> None:
        self._plan, self._info = plan, info
        self.node_budget = int(min(NODE_BUDGET, info.largest_buffer_bytes, info.memory_bytes / 16))
        filters = plan.source_filters
        self._rows = max(f.oversampling * int(f.rows[-1]) for f in filters)
        functions = max(f.oversampling * len(f.basis) for f in filters)
        # Of every buffer that grows with the chunk: bytes for a sample, and for those of the longest delay.
        rows, emitted = 4.3 * parts * self._rows, 4.3 * parts * functions
        self._per_sample = {"branch signals": rows, "emitted signals": emitted}
        self._per_sample["pressure of all receivers"] = 4.0 * parts * plan.row_count
        span = plan.tracks.longest_delay(0.0, plan.duration) * plan.sampling_rate + 256.0  # margins
        self._fixed = {"branch signals": rows * span, "emitted signals": emitted * span}
        self._longest = MOST_INDEX / 1.1 / max(f.oversampling for f in filters) - span  # kernels count them in 32 bits
        most = int(min(plan.chunk, self._most_samples()))
        if most < plan.segment:
            self._refuse()
        self.most_samples = most // plan.segment * plan.segment  # rendered at a time

    @property
    def paths_in_launch(self) -> int:
        """Number of paths in one launch, of which a segment takes at most `LONGEST_LAUNCH`.

        By estimate, in the shortest blocks for which room is made beforehand; at least a batch of 64.
        """
        paths = operations_in_launch(self._info) / self._operations(self._plan.shortest_block)
        return max(1, int(min(paths, MOST_INDEX)) // BATCH) * BATCH

    def segments_in_launch(self, paths: int, block: int) -> int:
        """Return the number of segments of some paths in one launch.

        result: so many that GPUs are estimated to need `LONGEST_LAUNCH` at most; at least one.
        """
        segments = operations_in_launch(self._info) / (paths * self._operations(block))
        return max(1, int(min(segments, MOST_INDEX)))

    def _operations(self, block: int) -> float:
        """Return those of a path and a segment in blocks of a length, in whichever launch has more of them."""
        rendering = self._plan.segment * (2.0 * self._rows + _OPERATIONS_PER_SAMPLE)
        return max(rendering, self._plan.segment // block * _OPERATIONS_PER_NODE)

    def _most_samples(self) -> float:
        """Return the number of samples at a time for which each buffer, and all of them together, fit."""
        widest = max(bank.taps.size for f in self._plan.source_filters for bank in f.banks)
        launched = max(operations_in_launch(self._info) / (2.0 * widest), self._plan.segment)
        whole = SHARE * self._info.memory_bytes - _LEVELS * self.node_budget - sum(self._fixed.values())
        each = [
            (self._info.largest_buffer_bytes - self._fixed.get(name, 0.0)) / size
            for name, size in self._per_sample.items()
        ]
        return min(whole / sum(self._per_sample.values()), self._longest, launched, *each)

    def _refuse(self) -> None:
        segment = self._plan.segment
        if self._longest < segment:
            raise InputError(
                "max_order",
                f"must leave delays that are counted in 32 bits, but the longest take {MOST_INDEX - self._longest:.3g} "
                "samples; lower it, or the sampling rate",
            )
        needed = {n: s * segment + self._fixed.get(n, 0.0) for n, s in self._per_sample.items()}
        name = max(needed, key=needed.__getitem__)
        less = "fewer receivers" if name.startswith("pressure") else "a lower max_order"
        advice = f"render {less} at a time, or on another device (see `clsim devices`)"
        check_buffers(self._info, needed | {"polynomials": _LEVELS * self.node_budget}, f"{segment} samples", advice)
