"""Ends that sit in a wall: transducers mounted flush."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from clsim.arrays import Floats
from clsim.errors import InputError
from clsim.scene.ends import End
from clsim.scene.motion.trajectory import Trajectory
from clsim.scene.room.faces import NEAREST, Mount
from clsim.scene.room.mesh import MeshRoom
from clsim.scene.room.protocol import Room
from clsim.scene.scatterer import Scatterer

_ALONG = 1e-6  # cosine below which a direction runs along a wall


def find_mount(room: Room, end: End | Scatterer) -> Mount | None:
    """Return wall and side of a flush-mounted source or receiver; None if it is not flush."""
    if end.flush is False:
        return None
    place = np.asarray(end.trajectory.position(np.zeros(1)))
    where = f"{end.name!r} at ({', '.join(f'{x:.6g}' for x in place[0])}) m"
    low, high = room.extent
    wall, size = _only(room.walls_at(place[0]), room.faces.names, where), float(np.linalg.norm(high - low))
    sides = [Mount.on(room.faces, wall, sign, size) for sign in (1.0, -1.0)]
    if isinstance(end.flush, bool):
        return sides[0] if room.is_convex else _inside(room, sides, place, where)
    return _facing(room, sides, end.flush)


def in_face(mesh: MeshRoom, end: End) -> Trajectory:
    """Return the trajectory of an end in a body's coordinates two steps in front of the face that it sits in."""
    own = end.trajectory
    if end.flush is False:
        return own
    if not own.is_static:
        raise InputError("flush", f"must be left out where {end.name!r} moves in its body's coordinates")
    place = own.position(np.zeros(1))
    where = f"{end.name!r} at ({', '.join(f'{x:.6g}' for x in place[0])}) m of its body"
    low, high = mesh.extent
    wall, size = _only(mesh.walls_at(place[0]), mesh.faces.names, where), float(np.linalg.norm(high - low))
    sides = [Mount.on(mesh.faces, wall, sign, size) for sign in (1.0, -1.0)]
    if isinstance(end.flush, bool):
        outside = [side for side in sides if mesh.is_closed and not mesh.contains(side.lifted(place))[0]]
        if len(outside) != 1:
            raise InputError("flush", f"must be a direction off the face for {where}, which has no inside")
        side = outside[0]
    else:
        side = _facing(mesh, sides, end.flush)
    return replace(Trajectory.fixed(side.lifted(place, 2.0)[0]), turning=own.turning)


def _inside(room: Room, sides: list[Mount], place: Floats, where: str) -> Mount:
    """Return the one side of a wall that is inside the room."""
    inside = [side for side in sides if room.is_closed and room.contains(side.lifted(place))[0]]
    if len(inside) != 1:
        name = room.faces.names[sides[0].wall]
        reason = "both sides are inside" if inside else "the mesh is open, or neither side is inside"
        raise InputError("flush", f"must be a direction off the wall {name!r} for {where}, because {reason}")
    return inside[0]


def _facing(room: Room, sides: list[Mount], direction: Floats) -> Mount:
    """Return the side of a wall that a direction (3,) points to."""
    cosine, name = float(sides[0].normal @ direction), room.faces.names[sides[0].wall]
    given = ", ".join(f"{x:.3g}" for x in direction)
    if room.is_convex and not cosine > 0.0:
        raise InputError("flush", f"must point into the room from {name}, but is {given}")
    if not room.is_convex and abs(cosine) < _ALONG:
        raise InputError("flush", f"must point off the wall {name!r}, but {given} runs along it")
    return sides[0] if cosine > 0.0 else sides[1]


def _only(found: Any, names: Sequence[str], where: str) -> int:
    """Return the one wall that is met."""
    if not len(found):
        raise InputError("flush", f"must be left out, because {where} is on no wall (within {NEAREST:g} m)")
    if len(found) > 1:
        listed = " and ".join(repr(names[w]) for w in found)
        raise InputError("flush", f"must be on one wall, but {where} is on an edge of {listed}")
    return int(found[0])
