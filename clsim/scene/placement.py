"""Checks of positions, motions and plausibility of sources, receivers and scatterers; errors give time and place."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Floats
from clsim.errors import InputError, inside, warn
from clsim.numerics.quaternions import rotate
from clsim.scene.directivity.patterns import Omni
from clsim.scene.ends import End, Receiver, Source, find_mount
from clsim.scene.motion.instants import Indices, Instants
from clsim.scene.motion.motion import Motion
from clsim.scene.room.faces import Mount
from clsim.scene.room.mesh_cleaning import held_by_rooms
from clsim.scene.room.protocol import Room
from clsim.scene.scatterer import Scatterer, SphereShape
from clsim.scene.transducer import TRANSDUCER_NAMES, Transducer

Placed = End | Scatterer

_SCAN_RATE = 1000.0  # Hz, at which trajectories are checked against the room and the speed of sound
_SCAN_BLOCK = 65536  # instants among which the nearest approach is sought
_SEEN_AT = 301  # instants at which ellipsoids and capsules are
_DEPTHS = 4096  # instants at which scatterers are compared with walls
TOUCHING = 1e-3  # m; what is less deep in a wall touches it
_SAME = 1e-9  # m, up to which two places count as one


def check_motions(room: Room, ends: Sequence[tuple[str, Placed]], slowest: float) -> None:
    """Refuse trajectories that leave the room, meet a wall, or are as fast as sound, with time and place."""
    static = [i for i, (_, item) in enumerate(ends) if item.trajectory.is_static and item.flush is False]
    checked = set(range(len(ends)))
    if static:  # all of them together: they may be very many
        free = room.clearance(_places([ends[i][1] for i in static])) > 0.0
        checked -= {static[i] for i in np.flatnonzero(free)}
    for i in sorted(checked):
        _check_motion(room, *ends[i], slowest)


def _check_motion(room: Room, field_name: str, item: Placed, slowest: float) -> None:
    with inside(field_name):
        mount = find_mount(room, item)
    start, end = item.time_range
    instants = Instants(start, start if item.trajectory.is_static else end, _SCAN_RATE)
    refused = first_refused(room, item.trajectory, instants, mount)
    if refused is not None:
        times = instants.times(np.arange(refused, min(refused + 2, instants.count)))
        positions = item.trajectory.position(times)
        contact = room.first_contact(positions, mount)
        if contact is not None:
            problem = f"{contact.rule}, but {item.name!r} {contact.event} at "
            problem += f"{_place(positions, times, contact.index)}{contact.hint}"
            raise InputError(f"{field_name}.trajectory", problem)
    speed, time = item.trajectory.peak_speed(start, end, _SCAN_RATE)
    if speed >= slowest:
        problem = f"must stay below the speed of sound, {slowest:.6g} m/s, "
        problem += f"but {item.name!r} moves at {speed:.6g} m/s at {time:.6g} s"
        raise InputError(f"{field_name}.trajectory", problem)


def _places(ends: Sequence[Placed]) -> Floats:
    """Return the positions (n, 3) of ends that never move, m."""
    return np.stack([end.trajectory.position(0.0) for end in ends])


def together(source: Source, receiver: Receiver) -> bool:
    """Test whether a source and a receiver are at the same place all the time, as one transducer is that does both."""
    last = min(source.time_range[1], receiver.trajectory.end)
    static = source.trajectory.is_static and receiver.trajectory.is_static
    for times in (np.zeros(1), np.linspace(0.0, last, 1 if static else _SCAN_BLOCK)):
        apart = receiver.trajectory.position(times) - source.trajectory.position(times)
        if np.abs(apart).max() > _SAME:
            return False
    return True


def check_distances(field_name: str, source: Source, receivers: Sequence[Receiver], nearest: float) -> None:
    """Refuse a source that comes closer to a receiver than allowed, m, with the time; both may be at one place."""
    last = source.time_range[1]
    receivers = [r for r in receivers if not together(source, r)]
    static = [r for r in receivers if r.trajectory.is_static]
    groups: list[tuple[list[Receiver], Motion | Floats, float]] = [(static, _places(static), last)] if static else []
    groups += [([r], r.trajectory, min(last, r.trajectory.end)) for r in receivers if not r.trajectory.is_static]
    for those, where, until in groups:
        instants = Instants(0.0, until, _SCAN_RATE)
        met = first_approach(source.trajectory, where, nearest, instants)
        if met is not None:
            raise _too_close(field_name, source, those[met[1]], nearest, instants, met[0])


def _too_close(
    field_name: str, source: Source, receiver: Receiver, nearest: float, instants: Instants, first: int
) -> InputError:
    """Return the error of a source that is too close to a receiver at an instant, and perhaps closer soon after."""
    times = instants.times(np.arange(first, min(first + _SCAN_BLOCK, instants.count)))
    apart = receiver.trajectory.position(times) - source.trajectory.position(times)
    moving = receiver.trajectory.velocity(times) - source.trajectory.velocity(times)
    distance, shift = nearest_within(apart, moving, 0.5 * instants.step)
    i = int(np.argmin(distance))
    problem = f"must stay at least {nearest:g} m away from every receiver (min_distance), "
    problem += f"but {source.name!r} comes within {distance[i]:.3g} m of {receiver.name!r} "
    return InputError(f"{field_name}.trajectory", f"{problem}at {times[i] + shift[i]:.6g} s")


def check_lasts(field_name: str, motion: Motion, last: float, what: str) -> None:
    """Refuse a motion that ends before a time, s, at which a signal or all of them end."""
    if last > motion.end * (1 + 1e-12) + 1e-9:
        problem = f"must last as long as {what} at {last:g} s, but ends at {motion.end:g} s"
        raise InputError(f"{field_name}.trajectory", problem)


def check_scatterers(
    scatterers: Sequence[tuple[str, Scatterer]], ends: Sequence[tuple[str, End]], nearest: float, slowest: float
) -> None:
    """Refuse scatterers that end before a signal, turn as fast as sound, or come to ends nearer than a distance, m."""
    last = max((item.end for _, item in ends if isinstance(item, Source)), default=0.0)
    for field_name, scatterer in scatterers:
        check_lasts(field_name, scatterer.trajectory, last, "all signals, which end")
        surface = scatterer.peak_speeds()[1]
        if surface >= slowest:
            motion, (start, stop) = scatterer.trajectory, scatterer.time_range
            times = np.linspace(start, stop, min(max(int((stop - start) * _SCAN_RATE), 1), _SCAN_BLOCK) + 1)
            turn = np.linalg.norm(motion.angular_velocity(times), axis=1)
            speed = np.linalg.norm(motion.velocity(times), axis=1) + scatterer.shape.radius * turn
            problem = f"must keep the surface below the speed of sound, {slowest:.6g} m/s, but that of "
            problem += f"{scatterer.name!r} may move at {surface:.6g} m/s, about {times[np.argmax(speed)]:.6g} s"
            raise InputError(f"{field_name}.trajectory", problem)
        for _, end in ends:
            _check_apart(field_name, scatterer, end, nearest)


def warn_of_walls(room: Room, scatterers: Sequence[tuple[str, Scatterer]]) -> None:
    """Warn of spheres that reach into a wall by more than bodies may, with the time and depth where it is deepest."""
    for field_name, scatterer in scatterers:
        motion, (start, stop) = scatterer.trajectory, scatterer.time_range
        if not isinstance(scatterer.shape, SphereShape):
            continue
        count = 1 if motion.is_static else min(int((stop - start) * _SCAN_RATE) + 2, _DEPTHS)
        times = np.linspace(start, stop, count)
        deep = scatterer.shape.radius - room.clearance(motion.position(times))
        i = int(np.argmax(deep))
        if deep[i] > TOUCHING:
            warn(
                f"{field_name}.trajectory: {scatterer.name!r} reaches {deep[i]:.3g} m into a wall at {times[i]:.6g} s; "
                f"its sound is that of a sphere in the open air"
            )


def through_walls(room: Room, scatterers: Sequence[tuple[str, Scatterer]]) -> list[str]:
    """Describe ellipsoids and capsules whose middle line reaches through a wall, with the time and depth.

    The line goes along the longest axis, as far as a sphere about it with the shortest one fits inside.
    """
    notes = []
    for field_name, scatterer in scatterers:
        axes, motion, (start, stop) = scatterer.shape.semi_axes, scatterer.trajectory, scatterer.time_range
        if isinstance(scatterer.shape, SphereShape) or not axes.any() or not (room.is_convex or room.is_closed):
            continue
        times = np.linspace(start, stop, 1 if motion.is_static else _SEEN_AT)
        line = np.zeros((3, 1, 3))
        line[[0, 2], 0, int(axes.argmax())] = np.array([-1.0, 1.0]) * float(np.ptp(axes))
        turned = rotate(motion.orientation(times)[None], line) if motion.has_orientation else line
        flat = (motion.position(times) + turned).reshape(-1, 3)
        outside = ~room.contains(flat)
        deep = np.where(outside, np.abs(room.clearance(flat)), 0.0).reshape(3, -1).max(axis=0)
        i = int(np.argmax(deep))
        if deep[i] > TOUCHING:
            depth = deep[i] + axes.min()
            notes.append(
                f"{field_name}.trajectory: {scatterer.name!r} reaches {depth:.3g} m through a wall at {times[i]:.6g} s"
            )
    return notes


def _check_apart(field_name: str, scatterer: Scatterer, end: End, nearest: float) -> None:
    motion, other = scatterer.trajectory, end.trajectory
    moving = [t.end for t in (motion, other) if not t.is_static]
    instants = Instants(0.0, min(moving, default=0.0), _SCAN_RATE)
    whom = _places([end]) if other.is_static else other
    if first_approach(motion, whom, scatterer.shape.radius + nearest, instants) is None:
        return  # the whole of a sphere about it stays away
    for first in range(0, instants.count, _SCAN_BLOCK):
        times = instants.times(np.arange(first, min(first + _SCAN_BLOCK, instants.count)))
        away, turned = other.position(times) - motion.position(times), motion.orientation(times)
        own = np.stack([np.sum(rotate(turned, axis) * away, axis=-1) for axis in np.eye(3)], axis=-1)
        inside = np.flatnonzero(scatterer.shape.holds(own, nearest))
        if len(inside):
            raise InputError(
                f"{field_name}.trajectory",
                f"must stay at least {nearest:g} m away from sources and receivers (min_distance), but {end.name!r} is "
                f"in {scatterer.name!r} or nearer to it at {_place(other.position(times), times, int(inside[0]))}",
            )


def check_sides(room: Room, ends: Sequence[tuple[str, End]]) -> None:
    """Refuse sources and receivers that walls separate from the others; warn of those connected by a hole alone."""
    # An open mesh, or one with large holes, has no inside; positions in a convex room are checked elsewhere.
    if room.is_convex:
        return
    places = np.array([first_place(room, item) for _, item in ends])
    mesh = room.as_mesh()
    found = (room.contains(places), True) if room.is_closed else held_by_rooms(mesh.vertices, mesh.triangles, places)
    if found is None:
        return
    inside, closed = found
    if not inside.any() and not room.is_closed:  # around a thing in the open
        return
    if inside.all() or (not inside.any() and room.surrounds(places).all()):  # walls may be solids around the room
        return
    apart = inside if 0 < 2 * inside.sum() < len(ends) else ~inside
    field, item = ends[int(np.argmax(apart))]
    where = ", ".join(f"{x:.6g}" for x in places[int(np.argmax(apart))])
    low, high = (", ".join(f"{x:.4g}" for x in corner) for corner in room.extent)
    side = "inside the mesh, and others are not" if apart is inside else "outside the room or inside a closed obstacle"
    kind = "is closed" if closed else "has holes, which alone join both sides,"
    where = (
        f"{item.name!r} at ({where}) m is {side}; the mesh {kind} and reaches from ({low}) to ({high}) m: "
        "check its scale and up, and the position"
    )
    if not inside.any():
        warn(f"{field}.trajectory: no source or receiver is inside the room: {where}")
    elif closed:
        problem = f"must lie in the same air as the other sources and receivers, but {where}"
        raise InputError(f"{field}.trajectory", problem)
    else:
        warn(f"{field}.trajectory: {where}")


def first_place(room: Room, item: End) -> Floats:
    """Return position of a source or receiver at 0 s (3,), m; one in a wall is moved a step in front of it."""
    place = np.asarray(item.trajectory.position(np.zeros(1)))
    mount = find_mount(room, item)
    return np.asarray((place if mount is None else mount.lifted(place))[0])


def _place(positions: Floats, times: Floats, i: int) -> str:
    where = ", ".join(f"{x:.6g}" for x in positions[i])
    return f"({where}) m at {times[i]:.6g} s"


_RANGE = 64  # instants between which walls are sought from one to the next
_PAIRS = 500_000  # of positions and others at a time
_SPARE = 1.0 + 1e-9  # for the rounding of distances


def first_refused(room: Room, motion: Motion, instants: Instants, mount: Mount | None = None) -> int | None:
    """Return the first instant at which a motion is outside the room, in a wall, or about to pass through one."""
    # mount: its wall, if flush; positions off this wall or beyond its edges are then refused too.

    def probe(first: Indices, middle: Indices, last: Indices) -> tuple[Indices, NDArray[np.bool_]]:
        """Return instants at which the room refuses a position, and a mask of ranges that may contain one."""
        after = np.minimum(last + 1, instants.count - 1)  # the way to the next instant belongs to each
        free = room.clearance(motion.position(instants.times(middle)), mount)
        speed = motion.speed_over(instants.times(first), instants.times(after))
        unsure = ~(free > _SPARE * speed * instants.margin(first, middle, after))
        if room.is_convex:
            return np.where(free > 0.0, -1, middle), unsure
        hit = np.full(len(first), -1)
        for i in np.flatnonzero(unsure & (last - first < _RANGE)):
            instants_of = instants.times(np.arange(first[i], after[i] + 1))
            met = room.first_contact(motion.position(instants_of), mount)
            hit[i], unsure[i] = -1 if met is None else min(first[i] + met.index, last[i]), False
        return hit, unsure

    return instants.first(probe)


def first_approach(
    motion: Motion, others: Motion | Floats, nearest: float, instants: Instants
) -> tuple[int, int] | None:
    """Return the first instant at which a motion comes too near to one of the others, and the index of that one."""
    # Shapes: others (n, 3) m.
    to_whom: dict[int, int] = {}
    half = 0.5 * instants.step

    def probe(first: Indices, middle: Indices, last: Indices) -> tuple[Indices, NDArray[np.bool_]]:
        """Return instants at which the other is too near, and a mask of ranges that may contain one."""
        speed, times = motion.speed_over(instants.times(first), instants.times(last)), instants.times(middle)
        at, velocity = motion.position(times)[:, None], motion.velocity(times)
        if isinstance(others, Motion):
            speed = speed + others.speed_over(instants.times(first), instants.times(last))
            places, velocity = others.position(times)[:, None], others.velocity(times) - velocity
        else:
            places, velocity = others[None], -velocity
        margin = _SPARE * speed * (instants.margin(first, middle, last) + half)
        hit, unsure = np.full(len(first), -1), np.empty(len(first), dtype=bool)
        step = max(1, _PAIRS // max(places.shape[1], 1))
        for some in (slice(i, min(i + step, len(first))) for i in range(0, len(first), step)):
            apart = (places[some] if len(places) > 1 else places) - at[some]
            distance = np.linalg.norm(apart, axis=2)
            unsure[some] = ~(distance.min(axis=1) - nearest > margin[some])
            fast = np.linalg.norm(velocity[some], axis=1)
            row, other = np.nonzero(distance < nearest + _SPARE * fast[:, None] * half)
            approach = nearest_within(apart[row, other], velocity[some][row], half)[0]
            for i, which in zip(row[approach < nearest], other[approach < nearest], strict=True):
                hit[some.start + i] = middle[some.start + i]
                to_whom.setdefault(int(middle[some.start + i]), int(which))
        return hit, unsure

    met = instants.first(probe)
    return None if met is None else (met, to_whom[met])


def nearest_within(apart: Floats, velocity: Floats, half: float) -> tuple[Floats, Floats]:
    """Return least distances (n,), m, of straight motions within ±`half` s, and their times relative to now, s."""
    # Shapes: apart, velocity (n, 3) m.
    speed_squared = np.maximum(np.sum(velocity**2, axis=1), 1e-300)
    shift = np.clip(-np.sum(apart * velocity, axis=1) / speed_squared, -half, half)
    return np.linalg.norm(apart + shift[:, None] * velocity, axis=1), shift


_LARGEST, _SMALLEST = 300.0, 0.2  # m, beyond which a room is likely to be in other units
_USUAL = 5.0  # m, size of a room
_LOWEST = 100.0  # Hz, below which paths are no picture of sound in a room


def warn_of_units(room: Room, sources: Sequence[Source]) -> None:
    """Warn of a room of implausible size, and of signals too low in frequency for paths."""
    low, high = room.extent
    size = float((high - low).max())
    if not _SMALLEST <= size <= _LARGEST:
        steps = round(math.log(size / _USUAL, 1000.0)) or (1 if size > _USUAL else -1)
        factor = 1000.0**-steps
        scale = room.scale
        advice = f"{factor:g} times its lengths" if scale is None else f"scale = {scale * factor:g}"
        unit = {None: "for millimetres, ", 1.0: "for a file in millimetres, "}.get(scale, "") if steps == 1 else ""
        warn(f"room: {size:.4g} m is {'large' if steps > 0 else 'small'} for a room; {unit}try {advice}")
    for i, source in enumerate(sources):
        frequency = source.signal.centre_frequency
        if frequency < _LOWEST:
            note = f"sources[{i}].signal: {frequency:.4g} Hz is low for paths in a room; "
            warn(f"{note}frequencies are in Hz: for {frequency:.4g} kHz, try {frequency:.4g}e3")


def warn_of_roles(sources: Sequence[Source], receivers: Sequence[Receiver]) -> None:
    """Warn of the first source that has a receiver's transducer, and of the first receiver that has a transmitter's."""
    sender, ear = TRANSDUCER_NAMES
    roles: tuple[tuple[str, Sequence[Source | Receiver], str, str], ...] = (
        ("sources", sources, ear, f"is a receiving transducer, given in V/Pa; the transmitter is {sender}"),
        ("receivers", receivers, sender, f"is a transmitting transducer, given in Pa/V; the receiver is {ear}"),
    )
    for field, ends, wrong, what in roles:
        known = Transducer.named(wrong)
        for i, end in enumerate(ends):
            given = end.transducer
            if given is not None and (given.name, given.sensitivity) == (wrong, known.sensitivity):
                warn(f"{field}[{i}].transducer: {wrong} {what}")
                break


def warn_of_facing(ends: Sequence[tuple[str, End]]) -> None:
    """Warn of the first directional source or receiver that moves but always faces +x for lack of an orientation."""
    for field, end in ends:
        motion = end.trajectory
        if end.aim is None and not (motion.is_static or motion.has_orientation or isinstance(end.directivity, Omni)):
            warn(
                f"{field}: {end.name!r} moves and is directional, but faces +x all the time, as its trajectory has no "
                'orientations; give aim = "forward", aim_at = [x, y, z], or a direction such as aim = [1, 0, 0]'
            )
            break
