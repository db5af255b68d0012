"""The walls of a room on an OpenCL device, and which of them beams and segments meet there."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.opencl.compiler import compiler_of
from clsim.opencl.launch import upload, work
from clsim.opencl.limits import FLOAT64, MOST_INDEX, check_buffers, check_group, operations_in_launch
from clsim.paths.specular.intervals import SMALLEST_MOVE
from clsim.paths.specular.occlusion import INNER
from clsim.paths.specular.visibility import PARALLEL
from clsim.scene.room.walls import INSIDE

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Floats
    from clsim.opencl.device import DeviceInfo
    from clsim.paths.specular.wall_lookup import Beams, Ears
    from clsim.scene.room.walls import Walls

    Ints = NDArray[np.int64]

MOST = 8  # crossings of a segment that are told
ELSEWHERE = 'choose another device (see `clsim devices`), or use engine="reference"'
OPERATIONS_PER_BOX = 60.0 * FLOAT64  # of a segment and a box, or a beam and six planes
GROUP = 16  # work-items of a group
_FOUND = 2**18  # pairs of beam and wall that there is room for at first


def room_arguments(context: Any, walls: Walls, info: DeviceInfo) -> dict[str, Any]:
    """Return the arguments of kernels that are the walls of a room, in the memory of a device."""
    check_group(info, GROUP)
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
    check_buffers(info, sizes, f"{len(walls)} walls", f"use fewer walls, {ELSEWHERE}")
    return {name: upload(context, column) for name, column in columns.items()} | {
        "box_count": len(boxes.wall),
        "tolerance": INSIDE * walls.size,
        "thickness": float(np.abs(away).max(initial=0.0)) + SMALLEST_MOVE * walls.size,
    }


class DeviceLookup:
    """What `WallLookup` does, on a device with float64: the host side of ``meetings.cl`` and ``crossings.cl``.

    Shapes: device (DeviceInfo, pyopencl.Device).
    """

    def __init__(self, walls: Walls, device: tuple[DeviceInfo, Any]) -> None:
        import pyopencl as cl

        self._walls, self._info = walls, device[0]
        self._compiler = compiler_of(device[1])
        self._queue = cl.CommandQueue(self._compiler.context)
        self._room = room_arguments(self._compiler.context, walls, self._info)
        self._wall_of_piece = np.repeat(np.arange(len(walls)), np.diff(walls.first_piece))

    def crossings(self, start: Floats, stop: Floats) -> tuple[Ints, Ints, Ints]:
        """Crossings of segments and walls, see `WallLookup.crossings`: at most `MOST` of each segment."""
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
        """Return pairs of a beam and a wall that it may meet; see `WallLookup.meetings`."""
        if ears is not None and not len(ears.radius):
            return (np.empty(0, dtype=np.int64),) * 2
        planes, listening = beams.planes.shape[1] / 6.0, 0 if ears is None else 2 * len(ears.radius)
        operations = planes * (self._tree_operations + OPERATIONS_PER_BOX * listening * len(self._walls))
        step = self._at_a_time(operations, 8 * len(self._walls))
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
        longest = operations_in_launch(self._info) / operations
        return max(1, int(min(longest, self._info.largest_buffer_bytes / size, 8 * MOST_INDEX / size)))

    def _met(self, beams: Beams, sides: Ints, ears: Ears | None) -> tuple[Ints, Ints]:
        """Return those pairs of some beams."""
        import pyopencl as cl

        kernel = self._compiler.kernel("meetings", {"PARALLEL": PARALLEL})
        count, capacity = len(beams.last), min(_FOUND, len(beams.last) * len(self._walls))
        spheres = np.zeros((1, 4)) if ears is None else np.column_stack([ears.centre, ears.radius])
        seen = np.zeros((1, 4)) if ears is None else np.concatenate([ears.plane, np.zeros((1, 4))])
        first_seen = np.zeros(2, dtype=np.int32) if ears is None else ears.first_plane.astype(np.int32)
        check_buffers(
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
                receiver_count=0 if ears is None else len(spheres), wall_count=len(self._walls), capacity=capacity,
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
