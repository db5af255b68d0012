"""Ends that sit in a wall: transducers mounted flush."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.arrays import Floats, as_floats
from clsim.errors import InputError
from clsim.scene.room.contact import NEAREST, walls_at
from clsim.scene.room.shoebox import Shoebox

if TYPE_CHECKING:
    from collections.abc import Sequence

    from clsim.scene.room.mesh import MeshRoom
    from clsim.scene.scene import Receiver, Source

_FINEST = 1e-8  # of the room's size: less could not be told from rounding where a wall blocks


@dataclass(frozen=True, slots=True, eq=False)
class Mount:
    """The wall that an end sits in.

    Attributes
    ----------
    wall : int
        Its index; in a mesh one of its plane.
    normal : ndarray (3,)
        Unit vector off the wall, to the side of the air that the end is heard in.
    offset : float
        The wall's plane is ``normal @ x = offset``, m.
    step : float
        How far in front of the wall the end is taken to be where that decides what reaches it, m.
    """

    wall: int
    normal: Floats
    offset: float
    step: float

    def height(self, positions: Floats) -> Floats:
        """Return how far in front of the wall positions (n, 3) are, (n,) m."""
        return np.asarray(positions @ self.normal - self.offset)

    def lifted(self, positions: Floats, steps: float = 1.0) -> Floats:
        """Return positions (n, 3) a step, or some, in front of the wall."""
        return np.asarray(positions + (steps * self.step - self.height(positions))[:, None] * self.normal)


def checked_flush(value: Any) -> bool | Floats:
    """Return False, True, or a unit vector.

    Raises
    ------
    InputError
        If it is nothing of that.
    """
    if isinstance(value, bool | np.bool_):
        return bool(value)
    side = as_floats("flush", value, (3,))
    length = float(np.linalg.norm(side))
    if not length > 0.0:
        raise InputError("flush", "must be True, False or a direction off the wall, but is 0, 0, 0")
    return np.asarray(side / length)


def find_mount(room: Shoebox | MeshRoom, end: Source | Receiver) -> Mount | None:
    """Return the wall that an end sits in, and on which side; None for one that is not flush.

    Raises
    ------
    InputError
        If it is on no wall or on an edge of two, or the side is not told or not that of the room.
    """
    if end.flush is False:
        return None
    place = np.asarray(end.trajectory.position(np.zeros(1)))
    where = f"{end.name!r} at ({', '.join(f'{x:.6g}' for x in place[0])}) m"
    if isinstance(room, Shoebox):
        return _in_box(room, end.flush, place, where)
    return _in_mesh(room, end.flush, place, where)


def _in_box(room: Shoebox, flush: bool | Floats, place: Floats, where: str) -> Mount:
    normal, offset = room.planes
    inward = np.where(offset[:, None] > 0.0, -normal, normal)
    height = place @ inward.T + np.where(offset > 0.0, offset, 0.0)
    wall = _only(np.flatnonzero(np.abs(height[0]) < NEAREST), room.wall_names, where)
    if not isinstance(flush, bool) and not inward[wall] @ flush > 0.0:
        raise InputError("flush", f"must point into the room from {room.wall_names[wall]}, but is {_told(flush)}")
    return Mount(wall, inward[wall], -float(offset[wall]), _step(float(np.linalg.norm(room.size))))


def _in_mesh(room: MeshRoom, flush: bool | Floats, place: Floats, where: str) -> Mount:
    walls = room.walls
    found = walls_at(walls, place[0])
    first = found[np.unique(walls.plane[found], return_index=True)[1]]  # walls of one plane are one
    wall = _only(first, room.wall_names, where)
    name, normal, step = room.wall_names[wall], walls.normal[wall], _step(walls.size)
    sides = [Mount(wall, sign * normal, sign * float(walls.offset[wall]), step) for sign in (1.0, -1.0)]
    if not isinstance(flush, bool):
        if abs(normal @ flush) < 1e-6:
            raise InputError("flush", f"must point off the wall {name!r}, but {_told(flush)} runs along it")
        return sides[0] if normal @ flush > 0.0 else sides[1]
    inside = [side for side in sides if room.shape.watertight and room.contains(side.lifted(place))[0]]
    if len(inside) != 1:
        reason = "both sides are inside" if inside else "the mesh is open, or neither side is inside"
        raise InputError("flush", f"must be a direction off the wall {name!r} for {where}, because {reason}")
    return inside[0]


def _only(found: Any, names: Sequence[str], where: str) -> int:
    """Return the one wall that is met."""
    if not len(found):
        raise InputError("flush", f"must be left out, because {where} is on no wall (within {NEAREST:g} m)")
    if len(found) > 1:
        listed = " and ".join(repr(names[w]) for w in found)
        raise InputError("flush", f"must be on one wall, but {where} is on an edge of {listed}")
    return int(found[0])


def _step(size: float) -> float:
    return max(NEAREST, _FINEST * size)


def _told(direction: Floats) -> str:
    return ", ".join(f"{x:.3g}" for x in direction)
