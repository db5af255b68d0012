"""Walls on an OpenCL device: which of them beams and segments meet there, and when paths are valid."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Floats, Ints
from clsim.errors import DeviceError, InputError
from clsim.opencl import device as devices
from clsim.opencl.launch import compiler_of, upload, work
from clsim.paths.cubics import CUBIC_COLUMNS
from clsim.paths.visibility import intervals
from clsim.paths.visibility.clearance import EVER, PARALLEL, TOUCHING
from clsim.paths.visibility.occlusion import INNER, Beams, Ears, WallLookup
from clsim.scene.room.walls import INSIDE, Walls

_PATHS = 16_384  # searched at a time
_EVALUATIONS = 2**19  # evaluations in one launch
_DEPTH = 96  # intervals that can wait: two for each of 45 times that the run is halved, and a few
# Structures of intervals.cl.
SPAN = np.dtype([("begin", "f8"), ("end", "f8"), ("known", "i4"), ("valid", "i4")])
INTERVAL = np.dtype([("begin", "f8"), ("end", "f8"), ("path", "i4"), ("unused", "i4")])
MOST = 8  # crossings of a segment that are told
ELSEWHERE = 'choose another device (see `clsim devices`), or use engine="reference"'
OPERATIONS_PER_BOX = 60.0 * devices.FLOAT64  # of a segment and a box, or a beam and six planes
GROUP = 16  # work-items of a group
_FOUND = 2**18  # pairs of beam and wall that there is room for at first


def progress(depth: int) -> np.dtype[np.void]:
    """Return the structure of a search: the interval that is put together, and a stack of so many spans."""
    fields = [("begin", "f8"), ("end", "f8"), ("depth", "i4"), ("evaluations", "i4"), ("stack", SPAN, (depth,))]
    return np.dtype(fields)


@dataclass(frozen=True, eq=False)
class DeviceSearch:
    """Answers one query on a device (DeviceInfo, pyopencl.Device) with float64."""

    query: intervals.VisibilityQuery
    device: tuple[devices.DeviceInfo, Any] = field(default_factory=partial(devices.find_device, None))

    @cached_property
    def _arguments(self) -> dict[str, Any]:
        """Arguments of kernels that are the same for all paths, in the memory of the device."""
        query, context = self.query, compiler_of(self.device[1]).context
        walls, ends, tables = query.walls, query.trajectory_tables, ("places", "scales", "knots", "speeds", "mounts")
        sizes = {f"the {name} of trajectories": float(getattr(ends, name).nbytes) for name in tables}
        remedy = f"look for the paths of fewer receivers at a time, {ELSEWHERE}"
        found = room_arguments(context, walls, self.device[0])
        devices.check_buffers(self.device[0], sizes, "source and receivers", remedy)
        wind = None if query.medium.wind is None else upload(context, np.array(query.medium.wind))
        return found | {name: upload(context, getattr(ends, name)) for name in tables} | {
            "smallest_move": intervals.SMALLEST_MOVE * walls.size, "graze": intervals.GRAZE * walls.size,
            "resolution": query.resolution,
            "speed_of_sound": query.medium.speed_of_sound, "slowest": query.medium.slowest, "wind": wind,
        }  # fmt: skip

    def find(self, sequence: NDArray[np.int32], receiver: NDArray[np.int64]) -> intervals.Intervals:
        """Return the intervals in which paths are valid; arguments as in `find_intervals`."""
        spans = self.query.first[receiver], self.query.last[receiver]
        columns = {"sequences": sequence, "receiver_of": receiver.astype(np.int32)}
        return self.settle("intervals", {"AT_EDGE": 0}, columns, spans, {})

    def settle(
        self, program: str, constants: dict[str, Any], columns: dict[str, NDArray[Any]], spans: tuple[Floats, Floats],
        others: dict[str, Any],
    ) -> intervals.Intervals:  # fmt: skip
        """Return the intervals that a program finds."""
        import pyopencl as cl

        parts = []
        order = columns["sequences"].shape[1]
        paths = min(_PATHS, self._evaluations(order), self._room_for(progress(_DEPTH).itemsize))
        try:
            for first in range(0, len(spans[0]), paths):
                here = slice(first, first + paths)
                some = {name: column[here] for name, column in columns.items()}
                begin, end = spans[0][here], spans[1][here]
                states = np.zeros(len(end), dtype=progress(_DEPTH))
                states["begin"], states["end"], states["depth"] = 1.0, -1.0, begin < end  # nothing yet; all is left
                states["stack"]["begin"][:, 0], states["stack"]["end"][:, 0] = begin, end
                parts.append(self._search(program, constants, some, states, others))
                parts[-1][0]["path"] += first
        except (cl.MemoryError, cl.RuntimeError) as error:
            raise DeviceError(f"the device failed while paths were validated: {error}") from error
        found = np.concatenate([np.empty(0, dtype=INTERVAL), *(some for some, _ in parts)])
        path, evaluations = found["path"].astype(np.int64), sum(count for _, count in parts)
        return intervals.merged(path, found["begin"], found["end"], evaluations)

    def _evaluations(self, order: int) -> int:
        """Largest number of evaluations of paths of an order in a launch: legs are near all boxes, twice."""
        each = 2.0 * (order + 1) * OPERATIONS_PER_BOX * (1.0 + float(self._arguments["box_count"]))
        most = min(_EVALUATIONS, self._room_for(2 * INTERVAL.itemsize))
        return max(1, int(min(most, devices.operations_in_launch(self.device[0]) / each)))

    def _room_for(self, size: int) -> int:
        """Return the number of structures of a size kept in a buffer, which is an eighth of the memory at most."""
        return max(1, int(min(self.device[0].largest_buffer_bytes, self.device[0].memory_bytes / 8)) // size)

    def _search(
        self, program: str, own: dict[str, Any], columns: dict[str, NDArray[Any]], states: NDArray[Any],
        others: dict[str, Any],
    ) -> tuple[NDArray[Any], int]:  # fmt: skip
        """Search some paths in launches of bounded length; return their intervals and the evaluations."""
        import pyopencl as cl

        compiler, flags, sequence = compiler_of(self.device[1]), cl.mem_flags, columns["sequences"]
        queue, put = cl.CommandQueue(compiler.context), partial(upload, compiler.context)
        constants = {
            "ORDER": sequence.shape[1], "DEPTH": _DEPTH, "KNOT_COLUMNS": CUBIC_COLUMNS, "RETARDED": 1,
            "STATIC_RECEIVERS": 0, "NODES_AT_ONCE": 1, "WIND": int(self.query.medium.wind is not None),
            "GROUPED": int(self.query.walls.tree.has_groups), "EVER": EVER, "INNER": INNER, "PARALLEL": PARALLEL,
            **{name: getattr(intervals, name) for name in ("GRAZE_TIME", "ALONG", "CERTAIN", "LEAST_SHARE")},
            "TOUCHING": TOUCHING, "SOURCE_PERTURBATION": _triple(intervals.PERTURBATIONS[0]),
            "RECEIVER_PERTURBATION": _triple(intervals.PERTURBATIONS[1]),
        }  # fmt: skip
        kernel = compiler.kernel(program, constants | own)
        # No buffer is empty, also of paths without walls.
        paths = {name: put(np.append(column, 0).astype(np.int32)) for name, column in columns.items()}
        on_device = put(states)
        active = np.flatnonzero(states["depth"]).astype(np.int32)
        parts = []
        while len(active):
            budget = max(1, self._evaluations(sequence.shape[1]) // len(active))
            room = (budget + 1) * len(active)
            found = cl.Buffer(compiler.context, flags.READ_WRITE, INTERVAL.itemsize * room)
            count = put(np.zeros(1, dtype=np.int32))
            kernel(
                queue, work(len(active), group=GROUP), **self._arguments, **paths, **others, active=active,
                active_count=len(active), budget=budget, states=on_device, found=found, found_count=count,
            )  # fmt: skip
            made = np.empty(1, dtype=np.int32)
            cl.enqueue_copy(queue, made, count)
            if made[0]:
                parts.append(np.empty(made[0], dtype=INTERVAL))
                cl.enqueue_copy(queue, parts[-1], found)
            cl.enqueue_copy(queue, states, on_device)
            active = active[states["depth"][active] > 0]
            self._refuse_endless(states["evaluations"], sequence)
        return np.concatenate(parts) if parts else np.empty(0, dtype=INTERVAL), int(states["evaluations"].sum())

    def _refuse_endless(self, evaluations: NDArray[np.int32], sequence: NDArray[np.int32]) -> None:
        worst = int(np.argmax(evaluations))
        if evaluations[worst] > intervals.MOST_EVALUATIONS:
            path = f"the path by the walls {sequence[worst].tolist()} needs more; it runs along an edge"
            bound = f"must let every path be settled within {intervals.MOST_EVALUATIONS} evaluations"
            raise InputError("resolution", f"{bound}, but {path}: move an end, or ask less finely")


def _triple(vector: Floats) -> str:
    """Return a vector as OpenCL C initialises one."""
    return f"{{{','.join(map(repr, vector.tolist()))}}}"


def room_arguments(context: Any, walls: Walls, info: devices.DeviceInfo) -> dict[str, Any]:
    """Return the arguments of kernels that are the walls of a room, in the memory of a device."""
    devices.check_group(info, GROUP)
    owner = np.repeat(np.arange(len(walls)), np.diff(walls.first_edge))
    away = np.einsum("eci,ei->ec", walls.edge, walls.normal[owner]) - walls.offset[owner, None]
    boxes = walls.tree.in_depth()
    columns = {
        "plane": np.concatenate([walls.normal, walls.offset[:, None]], axis=1),
        "sphere": np.concatenate([walls.centre, walls.radius[:, None]], axis=1),
        "same": walls.plane, "first_edge": walls.first_edge, "first_piece": walls.first_piece,
        "first_line": walls.first_line, "first_twin": walls.first_twin, "edge": walls.edge, "line": walls.line,
        "twin": np.append(walls.twin, 0),
        "box_middle": np.pad(boxes.middle, ((0, 0), (0, 1))), "box_extent": np.pad(boxes.half, ((0, 0), (0, 1))),
        "box_wall": boxes.wall, "box_skip": boxes.skip,
    }  # fmt: skip
    whole = {name: column.astype(np.int32) for name, column in columns.items() if column.dtype.kind == "i"}
    columns |= whole
    sizes = {f"the column {name} of walls": float(column.nbytes) for name, column in columns.items()}
    devices.check_buffers(info, sizes, f"{len(walls)} walls", f"use fewer walls, {ELSEWHERE}")
    return {name: upload(context, column) for name, column in columns.items()} | {
        "box_count": len(boxes.wall),
        "tolerance": INSIDE * walls.size,
        "thickness": float(np.abs(away).max(initial=0.0)) + intervals.SMALLEST_MOVE * walls.size,
    }


class DeviceLookup(WallLookup):
    """Looks up walls on a device with float64, by ``meetings.cl`` and ``crossings.cl``."""

    def __init__(self, walls: Walls, device: tuple[devices.DeviceInfo, Any]) -> None:
        import pyopencl as cl

        super().__init__(walls)
        self._info = device[0]
        self._compiler = compiler_of(device[1])
        self._queue = cl.CommandQueue(self._compiler.context)
        self._room = room_arguments(self._compiler.context, walls, self._info)
        self._wall_of_piece = np.repeat(np.arange(len(walls)), np.diff(walls.first_piece))

    def crossings(self, start: Floats, stop: Floats) -> tuple[Ints, Ints, Ints]:
        """Return at most `MOST` crossings of each segment."""
        step = self._at_a_time(self._tree_operations, 4 * MOST)
        parts = [self._crossed(start[i : i + step], stop[i : i + step]) for i in range(0, len(start), step)]
        found = np.concatenate([np.empty((0, MOST), dtype=np.int32), *parts])
        segment, place = np.nonzero(found >= 0)
        piece = found[segment, place].astype(np.int64)
        return segment, self._wall_of_piece[piece], piece

    def _crossed(self, start: Floats, stop: Floats) -> NDArray[np.int32]:
        """Return the pieces of walls that segments cross, (n, MOST), -1 for none."""
        import pyopencl as cl

        found = np.empty((len(start), MOST), dtype=np.int32)
        made = cl.Buffer(self._queue.context, cl.mem_flags.READ_WRITE, found.nbytes)  # it puts what it found in order
        kernel = self._compiler.kernel("crossings", {"MOST": MOST, "INNER": INNER, "PARALLEL": PARALLEL})
        kernel(
            self._queue, work(len(start), group=GROUP), **self._room, start=np.ascontiguousarray(start),
            stop=np.ascontiguousarray(stop), segments=len(start), found=made,
        )  # fmt: skip
        cl.enqueue_copy(self._queue, found, made)
        return found

    def meetings(self, beams: Beams, sides: Ints, ears: Ears | None) -> tuple[Ints, Ints]:
        """Return pairs of a beam and a wall, see `WallLookup.meetings`."""
        if ears is not None and not len(ears.radius):
            return (np.empty(0, dtype=np.int64),) * 2
        planes, listening = beams.planes.shape[1] / 6.0, 0 if ears is None else 2 * len(ears.radius)
        operations = planes * (self._tree_operations + OPERATIONS_PER_BOX * listening * len(self.walls))
        step = self._at_a_time(operations, 8 * len(self.walls))
        found = [np.empty((2, 0), dtype=np.int64)]
        for first in range(0, len(beams.last), step):
            beam, wall = self._met(beams.part(slice(first, first + step)), sides, ears)
            found.append(np.stack([beam + first, wall]))
        beam, wall = np.concatenate(found, axis=1)
        return beam, wall

    @property
    def _tree_operations(self) -> float:
        """Operations for a segment, if it is near every box."""
        return OPERATIONS_PER_BOX * float(self._room["box_count"])

    def _at_a_time(self, operations: float, size: int) -> int:
        """Largest number of work-items in a launch, each of so many operations that finds up to so many bytes."""
        longest = devices.operations_in_launch(self._info) / operations
        return max(1, int(min(longest, self._info.largest_buffer_bytes / size, 8 * devices.MOST_INDEX / size)))

    def _met(self, beams: Beams, sides: Ints, ears: Ears | None) -> tuple[Ints, Ints]:
        """Return those pairs of some beams."""
        import pyopencl as cl

        kernel = self._compiler.kernel("meetings", {"PARALLEL": PARALLEL})
        count, capacity = len(beams.last), min(_FOUND, len(beams.last) * len(self.walls))
        spheres = np.zeros((1, 4)) if ears is None else np.column_stack([ears.centre, ears.radius])
        seen = np.zeros((1, 4)) if ears is None else np.concatenate([ears.plane, np.zeros((1, 4))])
        first_seen = np.zeros(2, dtype=np.int32) if ears is None else ears.first_plane.astype(np.int32)
        devices.check_buffers(
            self._info, {"what receivers see in walls": float(seen.nbytes)}, f"{len(spheres)} receivers",
            f"look for the paths of fewer receivers at a time, {ELSEWHERE}",
        )  # fmt: skip
        while True:
            made = cl.Buffer(self._queue.context, cl.mem_flags.WRITE_ONLY, 8 * capacity)
            counter = upload(self._queue.context, np.zeros(1, dtype=np.int32))
            kernel(
                self._queue, work(count, group=GROUP), **self._room,
                half_spaces=upload(self._queue.context, beams.planes), half_space_count=beams.planes.shape[1],
                beams=count, centre=beams.centre, radius=beams.radius, slack=beams.slack,
                last_wall=beams.last.astype(np.int32), side=sides.astype(np.int32),
                receivers=upload(self._queue.context, spheres), seen=upload(self._queue.context, seen),
                first_seen=first_seen,
                receiver_count=0 if ears is None else len(spheres), wall_count=len(self.walls), capacity=capacity,
                found=made, found_count=counter,
            )  # fmt: skip
            total = np.empty(1, dtype=np.int32)
            cl.enqueue_copy(self._queue, total, counter)
            if total[0] <= capacity:
                break
            capacity = int(total[0])
        pairs = np.empty((int(total[0]), 2), dtype=np.int32)
        if len(pairs):
            cl.enqueue_copy(self._queue, pairs, made)
        beam, wall = pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))].T.astype(np.int64)
        return beam, wall
