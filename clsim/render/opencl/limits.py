"""What a device takes: how much memory at a time, how large work-groups, and how long it may compute at a stretch."""

from __future__ import annotations

from typing import TYPE_CHECKING

from clsim.errors import DeviceError
from clsim.render.plan import NODE_BUDGET, Plan

if TYPE_CHECKING:
    from clsim.opencl.device import DeviceInfo

_SHARE = 0.75  # of the device's memory: the rest is for tables, motion and whatever else uses it
_LEVELS = 3  # block lengths whose polynomials are kept at the same time
LONGEST_LAUNCH = 0.2  # s, estimated: graphics drivers end what computes for longer than some seconds
_OPERATIONS_PER_CYCLE = 4.0  # of a unit, low: 8 lanes, a product and a sum each, a quarter of the time
_OPERATIONS_PER_SAMPLE = 10.0  # of a path, beside two for every branch
_OPERATIONS_PER_NODE = 32_000.0  # of a path: 2000 in float64, a sixteenth of the rate or less


class Limits:
    """The limits of a device for a plan.

    Parameters
    ----------
    plan : Plan
        What is to be rendered.
    info : DeviceInfo
        Where.
    parts : int
        Rows of what is heard of a receiver.

    Raises
    ------
    DeviceError
        If not even a segment fits; the message says what to do.
    """

    def __init__(self, plan: Plan, info: DeviceInfo, parts: int) -> None:
        self._plan, self._info = plan, info
        self.node_budget = int(min(NODE_BUDGET, info.largest_buffer_bytes, info.memory_bytes / 16))
        filters = plan.source_filters
        self._rows = max(f.oversampling * int(f.rows[-1]) for f in filters)
        functions = max(f.oversampling * len(f.basis) for f in filters)
        # Of every buffer that grows with the chunk: bytes for a sample, and for those of the longest delay.
        rows, emitted = 4.3 * parts * self._rows, 4.3 * parts * functions
        self._per_sample = {"branch signals": rows, "emitted signals": emitted}
        self._per_sample["pressure of all receivers"] = 4.0 * parts * plan.receiver_count
        span = plan.tracks.longest_delay(0.0, plan.duration) * plan.sampling_rate + 256.0  # margins
        self._fixed = {"branch signals": rows * span, "emitted signals": emitted * span}
        most = int(min(plan.chunk, self._most_samples()))
        if most < plan.segment:
            raise DeviceError(self._refusal())
        self.most_samples = most // plan.segment * plan.segment  # rendered at a time

    def segments_in_launch(self, paths: int, block: int) -> int:
        """Return how many segments of some paths may be computed by one launch.

        Parameters
        ----------
        paths : int
            How many.
        block : int
            Samples in a block.

        Returns
        -------
        int
            So many that GPUs are estimated to need `LONGEST_LAUNCH` at most; at least one.
        """
        if self._info.kind != "GPU":
            return 2**31
        segment = self._plan.segment
        rendering = segment * (2.0 * self._rows + _OPERATIONS_PER_SAMPLE)
        nodes = segment // block * _OPERATIONS_PER_NODE
        rate = _OPERATIONS_PER_CYCLE * self._info.compute_units * self._info.clock_hz
        return max(1, int(LONGEST_LAUNCH * rate / (paths * max(rendering, nodes))))

    def _most_samples(self) -> float:
        """Return how many samples fit at a time, each buffer by itself and all of them together."""
        whole = _SHARE * self._info.memory_bytes - _LEVELS * self.node_budget - sum(self._fixed.values())
        each = [
            (self._info.largest_buffer_bytes - self._fixed.get(name, 0.0)) / size
            for name, size in self._per_sample.items()
        ]
        return min(whole / sum(self._per_sample.values()), *each)

    def _refusal(self) -> str:
        needed = {n: s * self._plan.segment + self._fixed.get(n, 0.0) for n, s in self._per_sample.items()}
        name = max(needed, key=needed.__getitem__)
        less = "fewer receivers" if name.startswith("pressure") else "a lower max_order"
        return (
            f"{self._info.name} has {self._info.memory_bytes / 2**20:.0f} MiB, at most "
            f"{self._info.largest_buffer_bytes / 2**20:.0f} MiB in a buffer, but {self._plan.segment} samples "
            f"need {sum(needed.values()) / 2**20:.0f} MiB, most of it, {needed[name] / 2**20:.0f} MiB, for "
            f"{name}: render {less} at a time, or on another device (see `clsim devices`)"
        )


def check_group(info: DeviceInfo, workers: int) -> None:
    """Refuse a device whose work-groups are too small.

    Parameters
    ----------
    info : DeviceInfo
        Where.
    workers : int
        Items of the largest group.

    Raises
    ------
    DeviceError
        If its groups hold fewer.
    """
    if info.largest_group < workers:
        raise DeviceError(
            f"{info.name} has work-groups of at most {info.largest_group} items, but {workers} are needed; choose "
            'another device (see `clsim devices`), or use engine="reference"'
        )
