"""Limits of devices for all kernels: work-groups, launches and buffers."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from clsim.errors import DeviceError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from clsim.opencl.device import DeviceInfo

SHARE = 0.75  # of the device's memory: the rest is for tables, motion and whatever else uses it
LONGEST_LAUNCH = 0.2  # s, estimated: graphics drivers end what computes for longer than some seconds
FLOAT64 = 16.0  # operations of float32 in the time of one of float64, on most graphics cards more
MOST_INDEX = 2**31 - 1  # of samples, paths and pairs, which kernels count in 32 bits; places in buffers have 64
_OPERATIONS_PER_CYCLE = 4.0  # of a unit, low: 8 lanes, a product and a sum each, a quarter of the time


def operations_in_launch(info: DeviceInfo) -> float:
    """Return the largest number of float32 operations in a launch: `LONGEST_LAUNCH` on GPUs, any number elsewhere."""
    if info.kind != "GPU":
        return math.inf
    return LONGEST_LAUNCH * _OPERATIONS_PER_CYCLE * info.compute_units * info.clock_hz


def check_group(info: DeviceInfo, workers: int) -> None:
    """Refuse a device whose work-groups are too small."""
    if info.largest_group < workers:
        raise DeviceError(
            f"{info.name} has work-groups of at most {info.largest_group} items, but {workers} are needed; choose "
            'another device (see `clsim devices`), or use engine="reference"'
        )


def check_buffers(info: DeviceInfo, sizes: Mapping[str, float], what: str, advice: str) -> None:
    """Refuse a device whose memory does not hold some buffers, each by itself and all of them together."""
    name = max(sizes, key=sizes.__getitem__)
    whole = sum(sizes.values())
    if sizes[name] > info.largest_buffer_bytes or whole > SHARE * info.memory_bytes:
        raise DeviceError(
            f"{info.name} has {info.memory_bytes / 2**20:.0f} MiB, at most "
            f"{info.largest_buffer_bytes / 2**20:.0f} MiB in a buffer, but {what} need {whole / 2**20:.0f} MiB, most "
            f"of it, {sizes[name] / 2**20:.0f} MiB, for {name}: {advice}"
        )
