"""Intervals in which paths are valid, on an OpenCL device: the host side of ``intervals.cl``."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.errors import DeviceError, InputError
from clsim.opencl.compiler import compiler_of
from clsim.opencl.device import find_device
from clsim.opencl.launch import upload, work
from clsim.opencl.limits import check_buffers, operations_in_launch
from clsim.paths.specular.device_walls import ELSEWHERE, GROUP, OPERATIONS_PER_BOX, room_arguments
from clsim.paths.specular.intervals import (
    CERTAIN,
    GRAZE,
    GRAZE_TIME,
    LEAST_SHARE,
    MOST_EVALUATIONS,
    SMALLEST_MOVE,
    Intervals,
    VisibilityQuery,
    merged,
)
from clsim.paths.specular.occlusion import INNER
from clsim.paths.specular.visibility import EVER, PARALLEL, TOUCHING
from clsim.paths.trajectory_cubics import CUBIC_COLUMNS
from clsim.paths.trajectory_tables import PERTURBATIONS

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Floats
    from clsim.opencl.device import DeviceInfo

_PATHS = 16_384  # searched at a time
_EVALUATIONS = 2**19  # evaluations in one launch
_DEPTH = 96  # intervals that can wait: two for each of 45 times that the run is halved, and a few
# Structures of intervals.cl.
SPAN = np.dtype([("begin", "f8"), ("end", "f8"), ("known", "i4"), ("valid", "i4")])
INTERVAL = np.dtype([("begin", "f8"), ("end", "f8"), ("path", "i4"), ("unused", "i4")])


def progress(depth: int) -> np.dtype[np.void]:
    """Return the structure of a search: the interval that is put together, and a stack of so many spans."""
    fields = [("begin", "f8"), ("end", "f8"), ("depth", "i4"), ("evaluations", "i4"), ("stack", SPAN, (depth,))]
    return np.dtype(fields)


class DeviceSearch:
    """Answers one query on a device with float64.

    Shapes: device (DeviceInfo, pyopencl.Device).
    """

    def __init__(self, query: VisibilityQuery, device: tuple[DeviceInfo, Any] | None = None) -> None:
        import pyopencl as cl

        self._query = query
        self._info, handle = device or find_device(None)
        self._compiler = compiler_of(handle)
        self._queue = cl.CommandQueue(self._compiler.context)
        walls, ends = query.walls, query.trajectory_tables
        tables = ("places", "scales", "knots", "speeds", "mounts")
        self._arguments = room_arguments(self._queue.context, walls, self._info)
        sizes = {f"the {name} of trajectories": float(getattr(ends, name).nbytes) for name in tables}
        check_buffers(
            self._info, sizes, "source and receivers", f"look for the paths of fewer receivers at a time, {ELSEWHERE}"
        )
        self._arguments |= {name: self._upload(getattr(ends, name)) for name in tables}
        self._arguments |= {
            "smallest_move": SMALLEST_MOVE * walls.size, "graze": GRAZE * walls.size, "resolution": query.resolution,
            "speed_of_sound": query.medium.speed_of_sound, "slowest": query.medium.slowest, "wind": None,
        }  # fmt: skip
        if query.medium.wind is not None:
            self._arguments["wind"] = self._upload(np.array(query.medium.wind))

    def find(self, sequence: NDArray[np.int32], receiver: NDArray[np.int64]) -> Intervals:
        """Return the intervals in which paths are valid; arguments as in `find_intervals`."""
        spans = self._query.first[receiver], self._query.last[receiver]
        columns = {"sequences": sequence, "receiver_of": receiver.astype(np.int32)}
        return self.settle("intervals", {"AT_EDGE": 0}, columns, spans, {})

    def settle(
        self, program: str, constants: dict[str, Any], columns: dict[str, NDArray[Any]], spans: tuple[Floats, Floats],
        others: dict[str, Any],
    ) -> Intervals:  # fmt: skip
        """Return the intervals that a program finds."""
        import pyopencl as cl

        parts = []
        order = columns["sequences"].shape[1]
        paths = min(_PATHS, self._evaluations(order), self._room_for(progress(_DEPTH).itemsize))
        try:
            for first in range(0, len(spans[0]), paths):
                here = slice(first, first + paths)
                some = {name: column[here] for name, column in columns.items()}
                states = _beginning(spans[0][here], spans[1][here])
                parts.append((first, *self._search(program, constants, some, states, others)))
        except (cl.MemoryError, cl.RuntimeError) as error:
            raise DeviceError(f"the device failed while paths were validated: {error}") from error
        no = np.empty(0, dtype=INTERVAL)
        path = np.concatenate([no["path"], *(p["path"].astype(np.int64) + first for first, p, _ in parts)])
        begin, end = (np.concatenate([no[name], *(p[name] for _, p, _ in parts)]) for name in ("begin", "end"))
        return merged(path.astype(np.int64), begin, end, sum(evaluations for _, _, evaluations in parts))

    def _evaluations(self, order: int) -> int:
        """Largest number of evaluations of paths of an order in a launch: legs are near all boxes, twice."""
        each = 2.0 * (order + 1) * OPERATIONS_PER_BOX * (1.0 + float(self._arguments["box_count"]))
        most = min(_EVALUATIONS, self._room_for(2 * INTERVAL.itemsize))
        return max(1, int(min(most, operations_in_launch(self._info) / each)))

    def _room_for(self, size: int) -> int:
        """Return the number of structures of a size kept in a buffer, which is an eighth of the memory at most."""
        return max(1, int(min(self._info.largest_buffer_bytes, self._info.memory_bytes / 8)) // size)

    def _search(
        self, program: str, own: dict[str, Any], columns: dict[str, NDArray[Any]], states: NDArray[Any],
        others: dict[str, Any],
    ) -> tuple[NDArray[Any], int]:  # fmt: skip
        """Search some paths in launches of bounded length; return their intervals and the evaluations."""
        import pyopencl as cl

        context, flags, sequence = self._queue.context, cl.mem_flags, columns["sequences"]
        constants = {
            "ORDER": sequence.shape[1], "DEPTH": _DEPTH, "KNOT_COLUMNS": CUBIC_COLUMNS, "RETARDED": 1,
            "STATIC_RECEIVERS": 0, "NODES_AT_ONCE": 1, "WIND": int(self._query.medium.wind is not None),
            "GROUPED": int(self._query.walls.tree.has_groups), "GRAZE_TIME": GRAZE_TIME, "CERTAIN": CERTAIN,
            "LEAST_SHARE": LEAST_SHARE, "EVER": EVER, "INNER": INNER, "PARALLEL": PARALLEL, "TOUCHING": TOUCHING,
            "SOURCE_PERTURBATION": _triple(PERTURBATIONS[0]),
            "RECEIVER_PERTURBATION": _triple(PERTURBATIONS[1]),
        }  # fmt: skip
        kernel = self._compiler.kernel(program, constants | own)
        # No buffer is empty, also of paths without walls.
        paths = {name: self._upload(np.append(column, 0).astype(np.int32)) for name, column in columns.items()}
        on_device = self._upload(states)
        active = np.flatnonzero(states["depth"]).astype(np.int32)
        parts = []
        while len(active):
            budget = max(1, self._evaluations(sequence.shape[1]) // len(active))
            room = (budget + 1) * len(active)
            found = cl.Buffer(context, flags.READ_WRITE, INTERVAL.itemsize * room)
            count = self._upload(np.zeros(1, dtype=np.int32))
            kernel(
                self._queue, work(len(active), group=GROUP), **self._arguments, **paths, **others, active=active,
                active_count=len(active), budget=budget, states=on_device, found=found, found_count=count,
            )  # fmt: skip
            made = np.empty(1, dtype=np.int32)
            cl.enqueue_copy(self._queue, made, count)
            if made[0]:
                parts.append(np.empty(made[0], dtype=INTERVAL))
                cl.enqueue_copy(self._queue, parts[-1], found)
            cl.enqueue_copy(self._queue, states, on_device)
            active = active[states["depth"][active] > 0]
            self._refuse_endless(states["evaluations"], sequence)
        return np.concatenate(parts) if parts else np.empty(0, dtype=INTERVAL), int(states["evaluations"].sum())

    def _refuse_endless(self, evaluations: NDArray[np.int32], sequence: NDArray[np.int32]) -> None:
        worst = int(np.argmax(evaluations))
        if evaluations[worst] > MOST_EVALUATIONS:
            raise InputError(
                "resolution",
                f"must let every path be settled within {MOST_EVALUATIONS} evaluations, but the path by the walls "
                f"{sequence[worst].tolist()} needs more; it runs along an edge: move an end, or ask less finely",
            )

    def _upload(self, array: NDArray[Any]) -> Any:
        return upload(self._queue.context, array)


def _beginning(first: Floats, last: Floats) -> NDArray[Any]:
    """Return the initial interval of each path: the whole time."""
    states = np.zeros(len(last), dtype=progress(_DEPTH))
    states["begin"], states["end"] = 1.0, -1.0
    states["depth"] = first < last
    states["stack"]["begin"][:, 0], states["stack"]["end"][:, 0] = first, last
    return states


def _triple(vector: Floats) -> str:
    """Return a vector as OpenCL C initialises one."""
    return f"{{{','.join(map(repr, vector.tolist()))}}}"
