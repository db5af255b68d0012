"""Whether sources and receivers are where they can be; errors give time and place."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from clsim.errors import InputError, warn
from clsim.scene.flush import find_mount
from clsim.scene.motion.instants import Instants
from clsim.scene.places import first_approach, first_refused, nearest_within

if TYPE_CHECKING:
    from collections.abc import Sequence

    from clsim.arrays import Floats
    from clsim.scene.ends import End, Receiver, Source
    from clsim.scene.room.protocol import Room

_SCAN_RATE = 1000.0  # Hz, at which trajectories are checked against the room and the speed of sound
_SCAN_BLOCK = 65536  # instants among which the nearest approach is sought


def check_motions(room: Room, ends: Sequence[tuple[str, End]], slowest: float) -> None:
    """Refuse trajectories that leave the room, meet a wall, or are as fast as sound, with time and place."""
    static = [i for i, (_, item) in enumerate(ends) if item.trajectory.is_static and item.flush is False]
    checked = set(range(len(ends)))
    if static:  # all of them together: they may be very many
        free = room.clearance(_places([ends[i][1] for i in static])) > 0.0
        checked -= {static[i] for i in np.flatnonzero(free)}
    for i in sorted(checked):
        _check_motion(room, *ends[i], slowest)


def _check_motion(room: Room, field_name: str, item: End, slowest: float) -> None:
    try:
        mount = find_mount(room, item)
    except InputError as error:
        raise error.within(field_name) from error
    start, end = item.time_range
    instants = Instants(start, start if item.trajectory.is_static else end, _SCAN_RATE)
    refused = first_refused(room, item.trajectory, instants, mount)
    if refused is not None:
        times = instants.times(np.arange(refused, min(refused + 2, instants.count)))
        positions = item.trajectory.position(times)
        contact = room.first_contact(positions, mount)
        if contact is not None:
            raise InputError(
                f"{field_name}.trajectory",
                f"{contact.rule}, but {item.name!r} {contact.event} at "
                f"{_place(positions, times, contact.index)}{contact.hint}",
            )
    speed, time = item.trajectory.peak_speed(start, end, _SCAN_RATE)
    if speed >= slowest:
        raise InputError(
            f"{field_name}.trajectory",
            f"must stay below the speed of sound, {slowest:.6g} m/s, "
            f"but {item.name!r} moves at {speed:.6g} m/s at {time:.6g} s",
        )


def _places(ends: Sequence[End]) -> Floats:
    """Return the positions (n, 3) of ends that never move, m."""
    return np.stack([end.trajectory.position(0.0) for end in ends])


def check_distances(field_name: str, source: Source, receivers: Sequence[Receiver], nearest: float) -> None:
    """Refuse a source that comes closer to a receiver than allowed, in m, with the time."""
    last = source.time_range[1]
    static = [r for r in receivers if r.trajectory.is_static]
    if static:
        instants = Instants(0.0, last, _SCAN_RATE)
        met = first_approach(source.trajectory, _places(static), nearest, instants)
        if met is not None:
            raise _too_close(field_name, source, static[met[1]], nearest, instants, met[0])
    for receiver in receivers:
        if not receiver.trajectory.is_static:
            instants = Instants(0.0, min(last, receiver.trajectory.end), _SCAN_RATE)
            met = first_approach(source.trajectory, receiver.trajectory, nearest, instants)
            if met is not None:
                raise _too_close(field_name, source, receiver, nearest, instants, met[0])


def _too_close(
    field_name: str, source: Source, receiver: Receiver, nearest: float, instants: Instants, first: int
) -> InputError:
    """Return the error of a source that is too close to a receiver at an instant, and perhaps closer soon after."""
    times = instants.times(np.arange(first, min(first + _SCAN_BLOCK, instants.count)))
    apart = receiver.trajectory.position(times) - source.trajectory.position(times)
    moving = receiver.trajectory.velocity(times) - source.trajectory.velocity(times)
    distance, shift = nearest_within(apart, moving, 0.5 * instants.step)
    i = int(np.argmin(distance))
    return InputError(
        f"{field_name}.trajectory",
        f"must stay at least {nearest:g} m away from every receiver (min_distance), "
        f"but {source.name!r} comes within {distance[i]:.3g} m of {receiver.name!r} "
        f"at {times[i] + shift[i]:.6g} s",
    )


def check_sides(room: Room, ends: Sequence[tuple[str, End]]) -> None:
    """Refuse ends that the walls of a watertight mesh part from the others; warn where all are outside.

    An open mesh has no inside, and a convex room is left by nobody.

    Warns
    -----
    ClsimWarning
        If all ends are outside: they hear the mesh as a thing in the open.
    """
    if room.is_convex or not room.is_closed:
        return
    places = np.array([first_place(room, item) for _, item in ends])
    inside = room.contains(places)
    if inside.all() or (not inside.any() and room.surrounds(places).all()):  # walls may be solids around the room
        return
    apart = inside if 0 < 2 * inside.sum() < len(ends) else ~inside
    field, item = ends[int(np.argmax(apart))]
    where = ", ".join(f"{x:.6g}" for x in places[int(np.argmax(apart))])
    low, high = (", ".join(f"{x:.4g}" for x in corner) for corner in room.extent)
    side = "inside the mesh, and others are not" if apart is inside else "outside the room or inside a closed obstacle"
    where = (
        f"{item.name!r} at ({where}) m is {side}; the mesh is watertight and reaches from ({low}) to ({high}) m: "
        "check its scale and up, and the position"
    )
    if inside.any():
        raise InputError(f"{field}.trajectory", f"must be where other ends can be heard, but {where}")
    warn(f"{field}.trajectory: no source or receiver is inside the room: {where}")


def first_place(room: Room, item: End) -> Floats:
    """Return where an end is at 0 s (3,), m; one in a wall a step in front of it."""
    place = np.asarray(item.trajectory.position(np.zeros(1)))
    mount = find_mount(room, item)
    return np.asarray((place if mount is None else mount.lifted(place))[0])


def _place(positions: Floats, times: Floats, i: int) -> str:
    where = ", ".join(f"{x:.6g}" for x in positions[i])
    return f"({where}) m at {times[i]:.6g} s"
