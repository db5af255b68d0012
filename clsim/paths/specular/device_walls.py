"""The walls of a room on an OpenCL device, and which of them beams and segments meet there."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.opencl.compiler import compiler_of
from clsim.opencl.launch import upload, work
from clsim.paths.specular.intervals import SMALLEST_MOVE
from clsim.paths.specular.occlusion import INNER
from clsim.paths.specular.visibility import PARALLEL
from clsim.scene.room.walls import INSIDE

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Floats
    from clsim.paths.specular.wall_lookup import Beams, Ears
    from clsim.scene.room.walls import Walls

    Ints = NDArray[np.int64]

MOST = 8  # crossings of a segment that are told
_FOUND = 2**18  # pairs of beam and wall that there is room for at first


def room_arguments(context: Any, walls: Walls) -> dict[str, Any]:
    """Return the arguments of kernels that are the walls of a room, in the memory of a context."""
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
    return {name: upload(context, column) for name, column in (columns | whole).items()} | {
        "box_count": len(boxes.wall),
        "tolerance": INSIDE * walls.size,
        "thickness": float(np.abs(away).max(initial=0.0)) + SMALLEST_MOVE * walls.size,
    }


class DeviceLookup:
    """What `WallLookup` does, on a device with float64: the host side of ``meetings.cl`` and ``crossings.cl``.

    Parameters
    ----------
    walls : Walls
        The room.
    device : pyopencl.Device
        Where.
    """

    def __init__(self, walls: Walls, device: Any) -> None:
        import pyopencl as cl

        self._walls = walls
        self._compiler = compiler_of(device)
        self._queue = cl.CommandQueue(self._compiler.context)
        self._room = room_arguments(self._compiler.context, walls)
        self._wall_of_piece = np.repeat(np.arange(len(walls)), np.diff(walls.first_piece))

    def crossings(self, start: Floats, stop: Floats) -> tuple[Ints, Ints, Ints]:
        """Return where segments cross walls; see `WallLookup.crossings`: at most `MOST` of each segment."""
        import pyopencl as cl

        if not len(start):
            return (np.empty(0, dtype=np.int64),) * 3
        found = np.empty((len(start), MOST), dtype=np.int32)
        made = cl.Buffer(self._queue.context, cl.mem_flags.WRITE_ONLY, found.nbytes)
        kernel = self._compiler.kernel("crossings", {"MOST": MOST, "INNER": INNER, "PARALLEL": PARALLEL})
        kernel(
            self._queue, work(len(start), group=16), **self._room, start=np.ascontiguousarray(start),
            stop=np.ascontiguousarray(stop), segments=len(start), found=made,
        )  # fmt: skip
        cl.enqueue_copy(self._queue, found, made)
        segment, place = np.nonzero(found >= 0)
        piece = found[segment, place].astype(np.int64)
        return segment, self._wall_of_piece[piece], piece

    def meetings(self, beams: Beams, sides: Ints, ears: Ears | None) -> tuple[Ints, Ints]:
        """Return pairs of a beam and a wall that it may meet; see `WallLookup.meetings`."""
        import pyopencl as cl

        kernel = self._compiler.kernel("meetings", {"PARALLEL": PARALLEL})
        count, capacity = len(beams.last), _FOUND
        if not count or (ears is not None and not len(ears.radius)):
            return (np.empty(0, dtype=np.int64),) * 2
        spheres = np.zeros((1, 4)) if ears is None else np.column_stack([ears.centre, ears.radius])
        seen = np.zeros((1, 4)) if ears is None else np.concatenate([ears.plane, np.zeros((1, 4))])
        first_seen = np.zeros(2, dtype=np.int32) if ears is None else ears.first_plane.astype(np.int32)
        while True:
            made = cl.Buffer(self._queue.context, cl.mem_flags.WRITE_ONLY, 8 * capacity)
            counter = upload(self._queue.context, np.zeros(1, dtype=np.int32))
            kernel(
                self._queue, work(count, group=16), **self._room,
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
