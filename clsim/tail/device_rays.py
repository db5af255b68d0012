"""Rays of energy on an OpenCL device: the host side of kernel `rays`."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.errors import DeviceError
from clsim.opencl.device import DeviceInfo, check_buffers, find_device, operations_in_launch
from clsim.opencl.launch import compiler_of, upload, work
from clsim.tail.host_rays import FLOOR, PI, HostRays
from clsim.tail.ray_room import (
    ANGLES,
    ESCAPE_SCALE,
    FAINT,
    FARTHEST,
    MOST_REFLECTIONS,
    NOT_ESCAPED,
    SLOTS,
    Energies,
    Layout,
    RayEngine,
    RayRun,
)

_OPERATIONS = 3000.0  # of a reflection
_OPERATIONS_OF_ZONE = 30.0
_SHORTEST = 1.0  # m, a way between reflections by which launches are bounded
GROUP = 16  # work-items of a group
_PLACES = 64  # of escaping rays that are kept of a launch


def ray_engine(wanted: str | None = None) -> RayEngine:
    """Return the device that is asked for, or the best one; the host where there is none."""
    try:
        return DeviceRays(find_device(wanted))
    except DeviceError:
        return HostRays()


class DeviceRays:
    """Traces rays on a device. Shapes: device (DeviceInfo, pyopencl.Device)."""

    def __init__(self, device: tuple[DeviceInfo, Any], group: int = GROUP) -> None:
        import pyopencl as cl

        self._info, self._group = device[0], group
        self._compiler = compiler_of(device[1])
        self._queue = cl.CommandQueue(self._compiler.context)

    def trace(self, run: RayRun, layout: Layout, energies: Energies) -> None:
        """Trace a run's rays and add up their energies."""
        import pyopencl as cl

        groups = len(run.until)
        kernel = self._compiler.kernel("rays", self._constants(run))
        context = self._queue.context
        tables = {name: getattr(energies, name) for name in Energies.TABLES}
        sizes = {f"the {name} energies of rays": float(table.nbytes) for name, table in tables.items()}
        check_buffers(self._info, sizes, f"{len(layout.zones)} zones", "use fewer receivers at a time")
        held = {name: self._held(table if table.size else np.zeros(1, np.uint64)) for name, table in tables.items()}
        given = {name: upload(context, value) for name, value in _arrays(run, layout).items()}
        step = self._at_a_time(run, layout)
        for first in range(0, len(run.directions), step):
            rays = slice(first, min(first + step, len(run.directions)))
            count = rays.stop - first
            ends = np.empty((groups, count, 2, 4), np.float32)
            made = cl.Buffer(context, cl.mem_flags.READ_WRITE, ends.nbytes)
            kernel(
                self._queue, work(count, groups, group=self._group), **given, **held,
                **_numbers(run, layout, count, first), directions=run.directions[rays], emitted=run.emitted[rays],
                departure=run.departure[rays], ends=made,
            )  # fmt: skip
            cl.enqueue_copy(self._queue, ends, made)
            gone = ends[ends[:, :, 0, 3] != NOT_ESCAPED][:_PLACES, :, :3].reshape(-1, 6)
            energies.places = np.concatenate([energies.places, gone])
        for name, table in tables.items():
            if not table.size:
                continue
            if self._info.kind == "CPU":  # what is mapped is the table itself
                mapped, _ = cl.enqueue_map_buffer(
                    self._queue, held[name], cl.map_flags.READ, 0, table.shape, table.dtype
                )
                mapped.base.release(self._queue)
            else:
                cl.enqueue_copy(self._queue, table, held[name])

    def _held(self, table: NDArray[np.uint64]) -> Any:
        """Return a buffer with the energies of a table: on a CPU the table's own memory."""
        import pyopencl as cl

        if self._info.kind != "CPU":
            return upload(self._queue.context, table)
        return cl.Buffer(self._queue.context, cl.mem_flags.READ_WRITE | cl.mem_flags.USE_HOST_PTR, hostbuf=table)

    def _constants(self, run: RayRun) -> dict[str, Any]:
        return {
            "CONVEX": int(run.room.convex), "SIZED": int(run.sized), "BANDS": int(np.diff(run.first_band).max()),
            "SLOTS": SLOTS, "ANGLES": ANGLES, "MOST_REFLECTIONS": MOST_REFLECTIONS, "FAINT": FAINT,
            "NOT_ESCAPED": NOT_ESCAPED, "PI": PI, "FARTHEST": FARTHEST,
        }  # fmt: skip

    def _at_a_time(self, run: RayRun, layout: Layout) -> int:
        """Rays of a launch: whole slots, as many as graphics drivers let compute."""
        each = _OPERATIONS + _OPERATIONS_OF_ZONE * len(layout.zones)
        of_ray = each * float(np.sum(np.minimum(run.until, FARTHEST))) / _SHORTEST
        most = min(operations_in_launch(self._info) / of_ray, float(len(run.directions)))
        return max(SLOTS, int(most) // SLOTS * SLOTS)


def _arrays(run: RayRun, layout: Layout) -> dict[str, Any]:
    """Return the arrays that all launches of a run share."""
    room = {f.name: getattr(run.room, f.name) for f in fields(run.room) if f.name not in ("convex", "middle", "off")}
    directions = np.pad(layout.arrivals[:, :3], ((0, -len(layout.arrivals) % 8), (0, 0)))
    return room | {
        "first_band": run.first_band, "until": run.until, "wavelength": run.wavelength, "kind": run.kind,
        # Eight bands are read at a time: those behind a group's are not looked at.
        "returned": np.pad(run.returned.ravel(), (0, int(np.diff(run.first_band).max()) + 8)),
        "scattered": run.scattered, "zones": layout.zones, "late_row": layout.late_row,
        "arrivals": directions.reshape(-1, 8, 3).swapaxes(1, 2),
    }  # fmt: skip


def _numbers(run: RayRun, layout: Layout, count: int, first: int) -> dict[str, Any]:
    """Return the numbers of a launch."""
    return {
        "radius": layout.radius, "off": run.room.off, "scale": layout.scale, "escape_scale": ESCAPE_SCALE,
        "rain": layout.rain, "floor_share": FLOOR, "bins_per_metre": 1.0 / layout.per_bin,
        "windows_per_metre": 1.0 / layout.per_window, "origin": run.origin, "count": count,
        "first_ray": run.first_ray + first, "groups": len(run.until), "bands": layout.bands,
        "zone_count": len(layout.zones), "bins": layout.bins, "early_bins": layout.early,
        "window_count": layout.windows,
        "arrival_count": len(layout.arrivals), "departure_count": layout.departures, "walls": len(run.room.plane),
        "max_order": run.max_order, "stream": run.stream,
        "key": np.array(run.key, np.uint32),
    }  # fmt: skip
