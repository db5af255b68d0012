"""OpenCL devices: list, choice, limits for all kernels, and the processor for which PoCL compiles."""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Collection, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from io import RawIOBase
from pathlib import Path
from typing import Any

from clsim.errors import DeviceError
from clsim.opencl.kernel_cache import prepare

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
    """Return the requested device, or the best: GPUs first, then by compute units."""
    found = _devices()
    if not found:
        raise DeviceError(f'{no_device()}; or use engine="reference", which needs none but is slow')
    if wanted is None:
        return max(found, key=lambda f: (f[0].kind == "GPU", f[0].fp64, f[0].compute_units))
    for info, device in found:
        if wanted == info.id or (":" not in wanted and wanted.lower() in f"{info.name} {info.platform}".lower()):
            return info, device
    listed = "; ".join(f"{info.id} {info.name}" for info, _ in found)
    raise DeviceError(f"the device must be the id or part of the name of one of {listed}, but is {wanted!r}")


def no_device() -> str:
    """Return the reason for the missing device, and a remedy."""
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


UNKNOWN = "generic"
LATEST = "znver3"  # as LLVM 14 calls all later processors of AMD, and so leaves their AVX-512 unused
_UNSURE = {UNKNOWN, LATEST}
# Processors as PoCL's library of functions is compiled for them, the most able first, and what they must have, as Linux
# calls it. With another name its functions would not be inlined.
_ABLE = (
    ("skylake-avx512", {"avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl", "bmi2", "fma"}),
    ("haswell", {"abm", "avx2", "bmi1", "bmi2", "f16c", "fma", "movbe"}),
    ("x86-64", set[str]()),
)
_TRIPLE = b"x86_64-unknown-linux-gnu"  # what stands before the name in PoCL's description of a device
_DESCRIPTION = range(8, 2048, 8)  # bytes: places at which it can stand
_WORD = 8  # bytes of a pointer

_names: dict[str, Any] = {}  # texts that devices point to, for as long as there are devices


@cache
def name_processor(device: Any) -> None:
    """Make PoCL compile for the features of a processor that it does not know, or takes for an older one; once.

    Nothing is done on other systems than Linux with x86-64, and where a process may not read its own memory.
    """
    with suppress(OSError):
        known = processor(device)
        if known in _UNSURE:
            flags = next(
                line for line in Path("/proc/cpuinfo").read_text("utf-8").splitlines() if line.startswith("flags")
            )
            set_processor(device, better_name(known, flags.split()))


def better_name(known: str, flags: Collection[str]) -> str:
    """Return the name by which PoCL uses all that a processor with these flags can: the known one if that does."""
    able = able_processor(flags)
    return known if known == LATEST and able != _ABLE[0][0] else able


def able_processor(flags: Collection[str]) -> str:
    """Return the ablest processor that PoCL's library is compiled for and that needs nothing but `flags`."""
    return next(name for name, needed in _ABLE if needed <= set(flags))


def processor(device: Any) -> str | None:
    """Return the name of the processor that PoCL compiles for; None where PoCL's description does not tell it."""
    return _named(device)[1]


def set_processor(device: Any, name: str) -> None:
    """Have PoCL compile for the processor of this name."""
    import ctypes

    place, was = _named(device)
    if was is not None:
        text = _names.setdefault(name, ctypes.create_string_buffer(name.encode()))
        with _memory() as memory:
            memory.seek(place)
            memory.write(ctypes.addressof(text).to_bytes(_WORD, sys.byteorder))


def _named(device: Any) -> tuple[int, str | None]:
    """Return the address of the pointer to the processor's name in PoCL's description of a device, and that name."""
    if sys.platform != "linux" or os.uname().machine != "x86_64":
        return 0, None
    with _memory() as memory:
        for offset in _DESCRIPTION:
            place = device.int_ptr + offset
            if _text(memory, place) == _TRIPLE:
                name = _text(memory, place + _WORD)
                return place + _WORD, None if name is None else name.decode()
    return 0, None


def _memory() -> RawIOBase:
    """Open this process's memory: to read where nothing is, is an error there and no crash."""
    return Path("/proc/self/mem").open("r+b", buffering=0)


def _text(memory: RawIOBase, place: int) -> bytes | None:
    """Return the text that the pointer at a place in memory points to; None if it points to none."""
    try:
        memory.seek(place)
        memory.seek(int.from_bytes(memory.read(_WORD) or b"", sys.byteorder))
        text = memory.read(64) or b""
    except (OSError, OverflowError):  # no pointer
        return None
    return text.split(b"\0")[0] if text.split(b"\0")[0].isascii() else None


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
