"""`clsim devices`: the OpenCL devices of this machine."""

from __future__ import annotations

from typing import TYPE_CHECKING

from clsim.errors import DeviceError
from clsim.opencl.device import list_devices, no_device

if TYPE_CHECKING:
    import argparse


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command, which has none."""


def execute(options: argparse.Namespace) -> int:
    """List them, the best first; return the exit status."""
    found = list_devices()
    if not found:
        raise DeviceError(no_device())
    for info in found:
        tracks = "float64" if info.fp64 else "no float64: the host computes the tracks, which is slower"
        print(
            f"{info.id}  {info.name}  ({info.kind}, {info.platform}, {info.compute_units} units, "
            f"{info.memory_bytes / 2**30:.1f} GiB, {tracks})"
        )
    return 0
