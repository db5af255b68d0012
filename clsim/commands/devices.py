"""`clsim devices`: the OpenCL devices of this machine, and whether one computes as it should."""

from __future__ import annotations

import argparse

from clsim.errors import DeviceError
from clsim.opencl.device import list_devices, no_device


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.add_argument(
        "--test", nargs="?", const="", metavar="DEVICE",
        help="compare a device, by id or part of its name, with the reference engine, and measure its rates; the "
        "best one when none is named",
    )  # fmt: skip


def execute(options: argparse.Namespace) -> int:
    """List the devices, or test one; return the exit status, 1 if a test fails."""
    if options.test is not None:
        return _test(options.test or None)
    found = list_devices()
    if not found:
        raise DeviceError(no_device())
    for info in found:
        tracks = "float64" if info.fp64 else "no float64: pairs of floats take its place"
        print(
            f"{info.id}  {info.name}  ({info.kind}, {info.platform}, {info.compute_units} units, "
            f"{info.memory_bytes / 2**30:.1f} GiB, {tracks})"
        )
    return 0


def _test(wanted: str | None) -> int:
    from clsim.workflow.device_test import PROMISED_DB, put_to_test

    report = put_to_test(wanted, lambda text: print(text, flush=True))
    print(report.line())
    if not report.passed:
        print(f"the device is not within {PROMISED_DB:g} dB: please report the line above")
    return 0 if report.passed else 1
