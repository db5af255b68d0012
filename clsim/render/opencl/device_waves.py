"""Sums of the plane waves of diffuse tails on an OpenCL device."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from clsim.errors import DeviceError
from clsim.opencl.device import find_device
from clsim.opencl.launch import Scratch, compiler_of, upload, work
from clsim.render.opencl.batches import CPU_LAYOUT, GPU_LAYOUT
from clsim.tail.streams import NEIGHBOURS, NODE, Between, Motion

assert CPU_LAYOUT.lanes <= NEIGHBOURS


class DeviceWaves:
    """Sums streams on an OpenCL device; `HostWaves` is its twin."""

    def __init__(self, between: Between, device: str | None, lanes: int | None = None) -> None:
        import pyopencl as cl

        self._info, found = find_device(device)
        compiler = compiler_of(found)
        self._queue, self._scratch = cl.CommandQueue(compiler.context), Scratch(compiler.context)
        self._lanes = lanes or (GPU_LAYOUT if self._info.kind == "GPU" else CPU_LAYOUT).lanes
        powers, taps = between.bank.shape
        constants = {"LANES": self._lanes, "NODE": NODE, "POWERS": powers, "TAPS": taps}
        self._kernel = compiler.kernel("plane_waves", constants)
        self._bank = upload(compiler.context, np.pad(between.bank.ravel(), (0, self._lanes)))

    def received(
        self, streams: NDArray[np.float32], first: int, motion: Motion, start: int, stop: int
    ) -> NDArray[np.float32]:
        """Return the pressure at listeners (R, n), see `Waves`."""
        import pyopencl as cl

        listeners, nodes, count = motion.ahead[:, :-1].shape
        begin = start // NODE * NODE
        whole = np.floor(motion.ahead[:, :-1])
        packed = np.empty((listeners, nodes, count, 4), np.float32)
        packed[..., 0] = motion.ahead[:, :-1] - whole
        packed[..., 1] = np.diff(motion.ahead, axis=1) / NODE
        packed[..., 2] = motion.gains[:, :-1]
        packed[..., 3] = np.diff(motion.gains, axis=1) / NODE
        received = np.empty((listeners, nodes * NODE), np.float32)
        try:
            out = self._scratch.take("received", received.nbytes)
            self._kernel(
                self._queue, work(nodes * NODE // self._lanes, listeners), streams=streams, count=count,
                total=len(streams), stride=streams.shape[1], lead=begin - first, whole=whole.astype(np.int32),
                motion=packed, nodes=nodes, bank=self._bank, received=out,
            )  # fmt: skip
            cl.enqueue_copy(self._queue, received, out)
        except cl.Error as error:
            raise DeviceError(f"{self._info.name} ran out of memory or failed ({error}) at a diffuse tail") from error
        return received[:, start - begin : stop - begin]
