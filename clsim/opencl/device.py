"""OpenCL devices: which there are, and which is taken."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Any

from clsim.errors import DeviceError
from clsim.opencl.kernel_cache import prepare
from clsim.opencl.processor import name_processor

INSTALL = (
    "install a driver: `pip install pocl-binary-distribution` (Linux x86-64), "
    "`apt install pocl-opencl-icd` (Debian, Ubuntu), or the OpenCL driver of your graphics card"
)

_openers: list[int] = []  # the processes that have opened devices: this one, and those that it was forked from


@dataclass(frozen=True, slots=True)
class DeviceInfo:
    """One OpenCL device."""

    id: str  # ``"platform:device"``, two indices, as the ``device`` argument takes it
    name: str  # what the driver says; kind is CPU, GPU or other
    platform: str  # likewise
    version: str  # likewise
    kind: str  # likewise
    memory_bytes: int  # its size
    compute_units: int  # likewise
    largest_buffer_bytes: int  # of its memory, in one piece
    largest_group: int  # work-items
    clock_hz: float  # of its units, at most
    driver: str  # version of the driver
    fp64: bool  # whether it computes in float64; where not, pairs of floats take its place in the tracks


def list_devices() -> list[DeviceInfo]:
    """Return all OpenCL devices of this machine.

    Returns
    -------
    list of DeviceInfo
        In the order of the drivers, ``id`` as the argument ``device`` of `render` takes it; empty where there is none,
        or no driver.

    Examples
    --------
    >>> import clsim
    >>> all(info.memory_bytes > 0 for info in clsim.list_devices())
    True
    """
    return [info for info, _ in _devices()]


def find_device(wanted: str | None) -> tuple[DeviceInfo, Any]:
    """Return the device that the user asked for, or the best: GPUs first, then by compute units."""
    found = _devices()
    if not found:
        raise DeviceError(f'{no_device()}; or use engine="reference", which needs none but is slow')
    if wanted is None:
        return max(found, key=lambda f: (f[0].kind == "GPU", f[0].fp64, f[0].compute_units))
    for info, device in found:
        if wanted == info.id or (":" not in wanted and wanted.lower() in f"{info.name} {info.platform}".lower()):
            return info, device
    listed = "; ".join(f"{info.id} {info.name}" for info, _ in found)
    raise DeviceError(f"no OpenCL device is or is called {wanted!r}; there are: {listed}")


def no_device() -> str:
    """Return why there is no device, and what to do."""
    trouble = prepare()
    return f"OpenCL cannot be used: {trouble}" if trouble else f"no OpenCL device: {INSTALL}"


def refuse_after_fork() -> None:
    """Refuse devices in a process forked from one that had opened them.

    Drivers keep threads, which a fork does not copy: the first kernel of the child would wait for them for ever. As a
    process has each driver once, the child cannot open it anew either.
    """
    if any(opener != os.getpid() for opener in _openers):
        raise DeviceError(
            "this process was forked from one that had used OpenCL devices, whose drivers do not work after a fork: "
            'start processes by "spawn" or "forkserver" (multiprocessing.get_context("spawn")), or fork before the '
            'first device is used; see the page "Many processes"'
        )


def _devices() -> list[tuple[DeviceInfo, Any]]:
    refuse_after_fork()
    trouble = prepare()
    import pyopencl as cl

    try:
        platforms = cl.get_platforms()
    except cl.Error:  # the loader reports no platform as an error
        return []
    if os.getpid() not in _openers:
        _openers.append(os.getpid())
    found = []
    for p, platform in enumerate(platforms):
        pocl = platform.name == "Portable Computing Language"
        if trouble and pocl:
            continue
        try:
            devices = platform.get_devices()
        except cl.Error:  # a platform without a device
            continue
        for d, device in enumerate(devices):
            if pocl:
                name_processor(device)
            kinds = ((cl.device_type.GPU, "GPU"), (cl.device_type.CPU, "CPU"))
            kind = next((name for bit, name in kinds if device.type & bit), "other")
            info = DeviceInfo(
                f"{p}:{d}", device.name.strip(), platform.name.strip(), device.version.strip(), kind,
                int(device.global_mem_size), int(device.max_compute_units),
                int(device.max_mem_alloc_size), int(device.max_work_group_size), 1e6 * device.max_clock_frequency,
                device.driver_version.strip(), "cl_khr_fp64" in device.extensions,
            )  # fmt: skip
            found.append((info, device))
    return found
