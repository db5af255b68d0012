"""OpenCL devices: which there are, which is taken, and how programs are built on it."""

from __future__ import annotations

import logging
import threading
import uuid
import warnings
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.errors import DeviceError
from clsim.opencl.cache import Trial, TriedKernel, prepare
from clsim.opencl.kernels import kernel_source

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

INSTALL = (
    "install a driver: `pip install pocl-binary-distribution` (Linux x86-64), "
    "`apt install pocl-opencl-icd` (Debian, Ubuntu), or the OpenCL driver of your graphics card"
)


@dataclass(frozen=True, slots=True)
class DeviceInfo:
    """One OpenCL device.

    Attributes
    ----------
    id : str
        ``"platform:device"``, two indices, as the ``device`` argument takes it.
    name, platform, version, kind : str
        What the driver says; kind is CPU, GPU or other.
    memory_bytes, compute_units : int
        Its size.
    fp64 : bool
        Whether it computes in float64; where not, the host computes the tracks.
    """

    id: str
    name: str
    platform: str
    version: str
    kind: str
    memory_bytes: int
    compute_units: int
    fp64: bool


def list_devices() -> list[DeviceInfo]:
    """Return all OpenCL devices of this machine; none is an empty list."""
    return [info for info, _ in _devices()]


def find_device(wanted: str | None) -> tuple[DeviceInfo, Any]:
    """Return the device that the user asked for, or the best: GPUs first, then by compute units.

    Parameters
    ----------
    wanted : str or None
        An id such as ``"0:1"``, or part of a name.

    Raises
    ------
    DeviceError
        If there is no device, or none that fits; the message says what to do.
    """
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
    return f"no OpenCL device: {prepare() or INSTALL}"


def _devices() -> list[tuple[DeviceInfo, Any]]:
    trouble = prepare()
    import pyopencl as cl

    try:
        platforms = cl.get_platforms()
    except cl.Error:  # the loader reports no platform as an error
        return []
    found = []
    for p, platform in enumerate(platforms):
        if trouble and platform.name == "Portable Computing Language":
            continue
        try:
            devices = platform.get_devices()
        except cl.Error:  # a platform without a device
            continue
        for d, device in enumerate(devices):
            kinds = ((cl.device_type.GPU, "GPU"), (cl.device_type.CPU, "CPU"))
            kind = next((name for bit, name in kinds if device.type & bit), "other")
            info = DeviceInfo(
                f"{p}:{d}", device.name.strip(), platform.name.strip(), device.version.strip(), kind,
                int(device.global_mem_size), int(device.max_compute_units),
                "cl_khr_fp64" in device.extensions,
            )  # fmt: skip
            found.append((info, device))
    return found


def upload(context: Any, array: NDArray[Any]) -> Any:
    """Return a buffer of a context that holds a copy of an array."""
    import pyopencl as cl

    flags = cl.mem_flags.READ_WRITE | cl.mem_flags.COPY_HOST_PTR
    return cl.Buffer(context, flags, hostbuf=np.ascontiguousarray(array))


def work(count: int, *more: int, group: int = 32) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Return the size of a launch and of its work-groups: `group` items of the first dimension, rounded up to these.

    Left to itself a runtime may choose groups by the divisors of each size, and build the kernel anew for every one.
    """
    return (-(-count // group) * group, *more), (group, *(1 for _ in more))


class Scratch:
    """Buffers of a context that are used again, by name: fresh memory at every step of a run costs time."""

    def __init__(self, context: Any) -> None:
        self._context = context
        self._kept: dict[Any, Any] = {}

    def take(self, name: Any, size: int) -> Any:
        """Return the buffer of a name, of at least `size` bytes; what it held may be lost."""
        import pyopencl as cl

        if name not in self._kept or self._kept[name].size < size:
            self._kept.pop(name, None)
            self._kept[name] = cl.Buffer(self._context, cl.mem_flags.READ_WRITE, size)
        return self._kept[name]


_of_thread = threading.local()


def opened(device: Any) -> tuple[Any, Compiler]:
    """Return a context of a device and the compiler of its kernels.

    They are the same ones at every call from a thread, so that many scenes in one process build a kernel once. Another
    thread has its own, because the arguments of a kernel are set before it is run.
    """
    import pyopencl as cl

    found: dict[Any, tuple[Any, Compiler]] = _of_thread.__dict__.setdefault("opened", {})
    key = device, kernel_source  # kernels of another text are other kernels
    if key not in found:
        context = cl.Context([device])
        found[key] = context, Compiler(context)
    return found[key]


class Compiler:
    """Builds the kernels of one context, each once."""

    def __init__(self, context: Any) -> None:
        self._context = context
        self._kernels: dict[tuple[str, tuple[str, ...]], Any] = {}

    def kernel(self, program: str, constants: Mapping[str, int | str]) -> Any:
        """Return the kernel of a program with compile-time constants.

        Raises
        ------
        DeviceError
            If the device's compiler refuses the program.
        """
        options = tuple(f"-D{name}={value}" for name, value in sorted(constants.items()))
        if (program, options) not in self._kernels:
            self._kernels[program, options] = self._build(program, list(options))
        return self._kernels[program, options]

    def _build(self, program: str, options: list[str]) -> Any:
        device = self._context.devices[0]
        trial = Trial(program, f"{device.name} {device.driver_version}\n{kernel_source(program)}", options)
        with trial.marked():
            return TriedKernel(self._built(program, trial.options), trial)

    def _built(self, program: str, options: list[str]) -> Any:
        import pyopencl as cl

        text = kernel_source(program)
        logging.getLogger("pyopencl").setLevel(logging.ERROR)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # compilers have something to say about every program
            try:
                try:
                    return getattr(cl.Program(self._context, text).build(options=options), program)
                except (cl.Error, AttributeError):
                    # A process that died while building can leave a broken entry in the cache of PyOpenCL or of the
                    # driver: with a constant that nothing uses, the program is another one and is built anew.
                    anew = [*options, f"-DANEW={uuid.uuid4().int % 2**31}"]
                    fresh = cl.Program(self._context, text)
                    return getattr(fresh.build(options=anew, cache_dir=False), program)  # type: ignore[arg-type]
            except (cl.Error, AttributeError) as error:
                device = self._context.devices[0].name.strip()
                raise DeviceError(
                    f"{device} could not build {program}.cl: {str(error)[:2000]}; update its driver, choose another "
                    'device (see `clsim devices`), or use engine="reference"'
                ) from error
