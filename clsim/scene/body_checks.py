"""Checks that moving bodies stay apart from walls, from each other and from sources and receivers."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from clsim.errors import InputError
from clsim.scene.ends import Source
from clsim.scene.motion.carried import even_ways, seen_by
from clsim.scene.motion.instants import Instants
from clsim.scene.placement import first_refused

if TYPE_CHECKING:
    from collections.abc import Sequence
    from typing import TypeVar

    from clsim.arrays import Floats
    from clsim.scene.body import Body
    from clsim.scene.placement import Placed
    from clsim.scene.room.mesh import MeshRoom
    from clsim.scene.room.protocol import Room

    T = TypeVar("T")
    Named = Sequence[tuple[str, T]]

TOUCHING = 1e-3  # m; a body may be so deep in a wall, as a door is on the floor or at its hinge
_STEP = 0.01  # m, which a body goes from one look to the next
_RATE = 1000.0  # Hz, at which speeds are looked at
_AT_A_TIME = 256  # instants
_FRAME = np.concatenate([np.zeros((1, 3)), np.eye(3)])  # origin and axes


def check_bodies(
    room: Room, bodies: Sequence[tuple[str, Body]], others: Sequence[tuple[str, Placed]], slowest: float
) -> None:
    """Refuse bodies that end before a signal, are as fast as sound, or go through walls, each other or other things.

    Shapes: bodies (str, Body); others (str, Source or Receiver or Scatterer).
    """
    last = max((item.end for _, item in others if isinstance(item, Source)), default=0.0)
    mesh = room.as_mesh() if bodies else None
    for i, (field_name, body) in enumerate(bodies):
        _check_motion(field_name, body, last, slowest)
        assert mesh is not None
        _check_walls(field_name, body, room, mesh)
        for _, other in bodies[:i]:
            _check_other(field_name, body, other)
        for _, thing in others:
            _check_thing(field_name, body, thing)


def _check_motion(field_name: str, body: Body, last: float, slowest: float) -> None:
    if last > body.trajectory.end * (1 + 1e-12) + 1e-9:
        raise InputError(
            f"{field_name}.trajectory",
            f"must last as long as all signals, which end at {last:g} s, but ends at {body.trajectory.end:g} s",
        )
    if body.peak_speed >= slowest:
        times = np.linspace(*body.time_range, 10_001)
        speed = body.speed(times)
        raise InputError(
            f"{field_name}.trajectory",
            f"must keep every point below the speed of sound, {slowest:.6g} m/s, but {body.name!r} may move at "
            f"{body.peak_speed:.6g} m/s, about {times[np.argmax(speed)]:.6g} s",
        )


def _looks(bodies: Sequence[Body]) -> Floats:
    """Return sampling times between which bodies move at most `_STEP`, s."""
    last = min((b.trajectory.end for b in bodies if not b.is_static and math.isfinite(b.trajectory.end)), default=0.0)
    instants = np.arange(math.ceil(max(last, 0.0) * _RATE) + 1) / _RATE
    speed = sum(body.speed(instants) for body in bodies)
    return np.minimum(even_ways(np.asarray(speed), _RATE, _STEP), max(last, 0.0))


def _check_walls(field_name: str, body: Body, room: Room, mesh: MeshRoom) -> None:
    """Refuse a body that goes through a wall of the room."""
    times = _looks([body])
    for some in np.array_split(times, -(-len(times) // _AT_A_TIME)):
        corners = body.placed(body.mesh.vertices[None], some[:, None])
        if room.is_convex:
            faces = room.faces
            deep = corners @ faces.normals.T - faces.offsets < -TOUCHING
            if deep.any():
                i = int(np.argmax(deep.any(axis=(1, 2))))
                wall = faces.names[int(np.argmax(deep[i].any(axis=0)))]
                raise _met(field_name, body, f"the wall {wall!r}", float(some[i]))
            continue
        low, high = corners.min(axis=1), corners.max(axis=1)
        centre, reach = 0.5 * (low + high), 0.5 * np.linalg.norm(high - low, axis=1)
        for time in some[mesh.clearance(centre) <= reach]:
            met = _crossing(mesh, body, body.placed(_FRAME, np.array(time)))
            if met is not None:
                raise _met(field_name, body, f"the wall {mesh.faces.names[met]!r}", float(time))


def _check_other(field_name: str, body: Body, other: Body) -> None:
    """Refuse a body that goes through another one."""
    reach = body.radius + other.radius
    for time in _looks([body, other]):
        frame = other.seen(body.placed(_FRAME, np.array(time)), np.array(time))
        if np.linalg.norm(frame[0]) <= reach and _crossing(other.mesh, body, frame) is not None:
            raise _met(field_name, body, repr(other.name), float(time))


def _crossing(mesh: MeshRoom, body: Body, frame: Floats) -> int | None:
    """Return the wall of a mesh that runs through a body whose `_FRAME` is at places (4, 3) of the mesh; or None."""
    axes = frame[1:] - frame[0]
    met = _first_through(mesh, frame[0] + body.mesh.walls.edge @ axes)
    if met is not None:
        return met
    own = (mesh.walls.edge - frame[0]) @ axes.T
    if _first_through(body.mesh, own) is None:
        return None
    through = [_first_through(body.mesh, edge[None]) is not None for edge in own]
    return int(np.searchsorted(mesh.walls.first_edge, through.index(True), side="right") - 1)


def _first_through(mesh: MeshRoom, edges: Floats) -> int | None:
    """Return the first wall that any of some edges (n, 2, 3) goes through by more than touching it."""
    walls = mesh.walls
    height = edges @ walls.normal.T - walls.offset
    deep = (height[:, 0] * height[:, 1] < 0.0) & (np.abs(height).min(axis=1) > TOUCHING)
    for wall in np.flatnonzero(deep.any(axis=0)):
        mine = deep[:, wall]
        share = height[mine, 0, wall] / (height[mine, 0, wall] - height[mine, 1, wall])
        hits = edges[mine, 0] + share[:, None] * (edges[mine, 1] - edges[mine, 0])
        if walls.holds(int(wall), hits).any():
            return int(wall)
    return None


def _met(field_name: str, body: Body, what: str, time: float) -> InputError:
    return InputError(
        f"{field_name}.trajectory",
        f"must keep it out of walls and other bodies, by {TOUCHING:g} m or less, but {body.name!r} goes through {what} "
        f"at {time:.6g} s",
    )


def _check_thing(field_name: str, body: Body, thing: Placed) -> None:
    """Refuse a source, a receiver or the centre of a scatterer that is in a body, or that a face of it passes."""
    own = seen_by(body.trajectory, thing.trajectory)
    last = own.end if math.isfinite(own.end) and not own.is_static else 0.0
    instants = Instants(0.0, max(last, 0.0), _RATE)
    met = first_refused(body.mesh, own, instants)
    inside = body.mesh.is_closed and bool(body.mesh.contains(own.position(np.zeros(1)))[0])
    if met is not None or inside:
        time = 0.0 if inside else float(instants.times(np.array([met]))[0])
        raise InputError(
            f"{field_name}.trajectory",
            f"must keep off sources, receivers and scatterers, but {thing.name!r} is in {body.name!r} or meets a face "
            f"of it at {time:.6g} s",
        )
