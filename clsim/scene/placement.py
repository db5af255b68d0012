"""Whether sources and receivers are where they can be, told with time and place."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING

import numpy as np

from clsim.errors import ClsimWarning, InputError
from clsim.scene.flush import find_mount
from clsim.scene.motion.instants import Instants
from clsim.scene.places import CLEAR, clearance, first_approach, first_refused, nearest_within
from clsim.scene.room.contact import NEAREST, first_contact, first_off
from clsim.scene.room.mesh import MeshRoom

if TYPE_CHECKING:
    from collections.abc import Sequence

    from clsim.arrays import Floats
    from clsim.scene.flush import Mount
    from clsim.scene.scene import Receiver, Scene, Source

_SCAN_RATE = 1000.0  # Hz, at which trajectories are checked against the room and the speed of sound
_SCAN_BLOCK = 65536  # instants among which the nearest approach is told


def check_motions(scene: Scene) -> None:
    """Refuse trajectories that leave the room, meet a wall, or are as fast as sound, with time and place."""
    ends = scene.named_ends()
    still = [i for i, (_, item) in enumerate(ends) if item.trajectory.is_static and item.flush is False]
    if still:  # one look at all of them: they may be very many
        free = clearance(scene.room, _places([ends[i][1] for i in still])) > 0.0
        ends = [ends[i] for i in sorted({*range(len(ends))} - {still[i] for i in np.flatnonzero(free)})]
    for field_name, item in ends:
        _check_motion(scene, field_name, item)


def _check_motion(scene: Scene, field_name: str, item: Source | Receiver) -> None:
    try:
        mount = find_mount(scene.room, item)
    except InputError as error:
        raise error.within(field_name) from error
    speed_of_sound, (start, end) = scene.air.speed_of_sound, scene.span(item)
    instants = Instants(start, start if item.trajectory.is_static else end, _SCAN_RATE)
    refused = first_refused(scene.room, item.trajectory, instants, mount)
    if refused is not None:
        times = instants.times(np.arange(refused, min(refused + 2, instants.count)))
        check = _check_walls if isinstance(scene.room, MeshRoom) else _check_inside
        check(scene, field_name, item.name, item.trajectory.position(times), times, mount)
    speed, time = item.trajectory.peak_speed(start, end, _SCAN_RATE)
    if speed >= speed_of_sound:
        raise InputError(
            f"{field_name}.trajectory",
            f"must stay below the speed of sound, {speed_of_sound:.6g} m/s, "
            f"but {item.name!r} moves at {speed:.6g} m/s at {time:.6g} s",
        )


def _places(ends: Sequence[Source | Receiver]) -> Floats:
    """Return the positions (n, 3) of ends that never move, m."""
    return np.stack([end.trajectory.position(0.0) for end in ends])


def check_distances(scene: Scene, index: int, source: Source) -> None:
    """Refuse a source that comes closer to a receiver than the scene allows, with the time."""
    last, nearest = scene.span(source)[1], scene.min_distance
    still = [r for r in scene.receivers if r.trajectory.is_static]
    if still:
        instants = Instants(0.0, last, _SCAN_RATE)
        met = first_approach(source.trajectory, _places(still), nearest, instants)
        if met is not None:
            raise _too_close(scene, index, still[met[1]], instants, met[0])
    for receiver in scene.receivers:
        if not receiver.trajectory.is_static:
            instants = Instants(0.0, min(last, receiver.trajectory.end), _SCAN_RATE)
            met = first_approach(source.trajectory, receiver.trajectory, nearest, instants)
            if met is not None:
                raise _too_close(scene, index, receiver, instants, met[0])


def _too_close(scene: Scene, index: int, receiver: Receiver, instants: Instants, first: int) -> InputError:
    """Return the error of a source that is too close to a receiver at an instant, and perhaps closer soon after."""
    source = scene.sources[index]
    times = instants.times(np.arange(first, min(first + _SCAN_BLOCK, instants.count)))
    apart = receiver.trajectory.position(times) - source.trajectory.position(times)
    moving = receiver.trajectory.velocity(times) - source.trajectory.velocity(times)
    distance, shift = nearest_within(apart, moving, 0.5 * instants.step)
    i = int(np.argmin(distance))
    return InputError(
        f"sources[{index}].trajectory",
        f"must stay at least {scene.min_distance:g} m away from every receiver (min_distance), "
        f"but {source.name!r} comes within {distance[i]:.3g} m of {receiver.name!r} "
        f"at {times[i] + shift[i]:.6g} s",
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
    """Refuse positions (n, 3) outside a shoebox, at so many times."""
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
    """Refuse positions (n, 3) on a wall of a mesh, at so many times, and motions through one."""
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
        lifted = mount.lifted(positions, CLEAR)
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
    off = np.abs(mount.height(positions)) >= NEAREST
    if off.any():
        raise InputError(
            f"{field_name}.trajectory",
            f"must stay in the plane of the wall that {name!r} is flush with, within {NEAREST:g} m, "
            f"but is at {_place(positions, times, int(np.argmax(off)))}",
        )


def _place(positions: Floats, times: Floats, i: int) -> str:
    where = ", ".join(f"{x:.6g}" for x in positions[i])
    return f"({where}) m at {times[i]:.6g} s"
