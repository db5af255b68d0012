"""Whether sources and receivers are where they can be, told with time and place."""

from __future__ import annotations

import math
import warnings
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from clsim.errors import ClsimWarning, InputError
from clsim.scene.flush import find_mount
from clsim.scene.mesh_contact import NEAREST, first_contact, first_off
from clsim.scene.mesh_room import MeshRoom

if TYPE_CHECKING:
    from clsim.arrays import Floats
    from clsim.scene.flush import Mount
    from clsim.scene.scene import Receiver, Scene, Source

_SCAN_RATE = 1000.0  # Hz, at which trajectories are checked against the room and the speed of sound
_SCAN_BLOCK = 65536  # instants checked at a time


def scan_times(start: float, end: float) -> list[Floats]:
    """Return the instants (1 ms apart or closer) from `start` to `end`, in blocks of bounded size."""
    count = max(2, math.ceil((end - start) * _SCAN_RATE) + 1)
    step = (end - start) / (count - 1)
    return [
        start + step * np.arange(i, min(i + _SCAN_BLOCK, count), dtype=np.float64) for i in range(0, count, _SCAN_BLOCK)
    ]


def check_motion(scene: Scene, field_name: str, item: Source | Receiver) -> None:
    """Refuse a trajectory that leaves the room, meets a wall, or is as fast as sound, with time and place."""
    speed_of_sound = scene.air.sound_speed
    try:
        mount = find_mount(scene.room, item)
    except InputError as error:
        raise error.within(field_name) from error
    before = np.empty((0, 3))
    for times in scan_times(*scene.span(item)):
        positions = item.trajectory.position(times)
        check = _check_walls if isinstance(scene.room, MeshRoom) else _check_inside
        check(scene, field_name, item.name, np.concatenate([before, positions]), times, mount)
        before = positions[-1:]
        speed = np.linalg.norm(item.trajectory.velocity(times), axis=1)
        i = int(np.argmax(speed))
        if speed[i] >= speed_of_sound:
            raise InputError(
                f"{field_name}.trajectory",
                f"must stay below the speed of sound, {speed_of_sound:.6g} m/s, "
                f"but {item.name!r} moves at {speed[i]:.6g} m/s at {times[i]:.6g} s",
            )


def check_sides(scene: Scene) -> None:
    """Refuse ends that the walls of a watertight mesh part from the others; warn where all are outside.

    An open mesh has no inside, and a shoebox is left by nobody.

    Warns
    -----
    ClsimWarning
        If all ends are outside: they hear the mesh as a thing in the open.
    """
    room = scene.room
    if not isinstance(room, MeshRoom) or not room.shape.watertight:
        return
    ends = scene.named_ends()
    places = np.array([first_place(scene, item) for _, item in ends])
    inside = room.contains(places)
    if inside.all() or (not inside.any() and room.surrounds(places).all()):  # walls may be solids around the room
        return
    apart = inside if 0 < 2 * inside.sum() < len(ends) else ~inside
    field, item = ends[int(np.argmax(apart))]
    where = ", ".join(f"{x:.6g}" for x in places[int(np.argmax(apart))])
    low, high = (", ".join(f"{x:.4g}" for x in corner) for corner in room.extent)
    side = "inside the mesh, and others are not" if apart is inside else "outside the room or inside a closed obstacle"
    told = (
        f"{item.name!r} at ({where}) m is {side}; the mesh is watertight and reaches from ({low}) to ({high}) m: "
        "check its scale and up, and the position"
    )
    if inside.any():
        raise InputError(f"{field}.trajectory", f"must be where other ends can be heard, but {told}")
    warnings.warn(f"{field}.trajectory: no source or receiver is inside the room: {told}", ClsimWarning, stacklevel=4)


def first_place(scene: Scene, item: Source | Receiver) -> Floats:
    """Return where an end is at 0 s (3,), m; one in a wall a step in front of it."""
    place = np.asarray(item.trajectory.position(np.zeros(1)))
    mount = find_mount(scene.room, item)
    return np.asarray((place if mount is None else mount.lifted(place))[0])


def _check_inside(
    scene: Scene, field_name: str, name: str, positions: Floats, times: Floats, mount: Mount | None
) -> None:
    """Refuse positions outside a shoebox; the last ones are those at `times`."""
    _check_stays(field_name, name, positions, times, mount)
    outside = ~scene.room.contains(positions if mount is None else mount.lifted(positions))
    if outside.any():
        i = int(np.argmax(outside))
        normal, offset = scene.room.planes
        on = np.flatnonzero(np.abs(normal @ positions[i] - offset) < NEAREST)
        hint = (
            f", on the wall {scene.room.wall_names[on[0]]}; an end in a wall needs flush=True" if len(on) == 1 else ""
        )
        raise InputError(
            f"{field_name}.trajectory",
            f"must stay inside the room, but {name!r} is at {_place(positions, times, i)}{hint}",
        )


def _check_walls(
    scene: Scene, field_name: str, name: str, positions: Floats, times: Floats, mount: Mount | None
) -> None:
    """Refuse positions on a wall of a mesh, and motions through one; the last positions are those at `times`."""
    assert isinstance(scene.room, MeshRoom)
    walls = scene.room.walls
    _check_stays(field_name, name, positions, times, mount)
    lifted = positions
    if mount is not None:
        off = first_off(walls, mount.wall, positions)
        if off is not None:
            raise InputError(
                f"{field_name}.trajectory",
                f"must stay on the wall that {name!r} is flush with, {scene.room.wall_names[mount.wall]!r}, "
                f"but is at {_place(positions, times, off)}",
            )
        lifted = replace(mount, step=2.0 * mount.step).lifted(positions)  # clear of this wall, and of no other
    contact = first_contact(walls, lifted)
    if contact is not None:
        i, wall = contact
        hint = "" if mount is not None else "; an end in a wall needs flush="
        raise InputError(
            f"{field_name}.trajectory",
            f"must stay {NEAREST:g} m away from every wall and walk through none, but {name!r} meets the wall "
            f"{scene.room.wall_names[wall]!r} at {_place(positions, times, i)}{hint}",
        )


def _check_stays(field_name: str, name: str, positions: Floats, times: Floats, mount: Mount | None) -> None:
    """Refuse a flush end that moves off the plane of its wall."""
    if mount is None:
        return
    off = np.abs(mount.height(positions)) > NEAREST
    if off.any():
        raise InputError(
            f"{field_name}.trajectory",
            f"must stay in the plane of the wall that {name!r} is flush with, within {NEAREST:g} m, "
            f"but is at {_place(positions, times, int(np.argmax(off)))}",
        )


def _place(positions: Floats, times: Floats, i: int) -> str:
    where = ", ".join(f"{x:.6g}" for x in positions[i])
    return f"({where}) m at {times[max(i - len(positions) + len(times), 0)]:.6g} s"
