"""The walls of a room as planes, the wall that an end sits in, and where a motion meets one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from clsim.arrays import Complexes, Floats, as_floats, read_only
from clsim.errors import InputError, check_kind, settle
from clsim.scene.material.material import Material

NEAREST = 1e-6  # m; what is nearer to a wall is on it
_UNIT = 1e-9  # by which the length of a normal may differ from 1
_FINEST = 1e-8  # of the room's size: less could not be distinguished from rounding where a wall blocks


@dataclass(frozen=True, slots=True, eq=False)
class Faces:
    """The F walls of a room, in the order of their indices: unit normals (F, 3) and offsets (F,), m."""

    # Normals point inwards in a room that `Room.is_convex`; elsewhere their sign means nothing.
    normals: Floats
    offsets: Floats
    names: tuple[str, ...]
    materials: tuple[Material, ...]

    def __post_init__(self) -> None:
        normals = as_floats("faces.normals", self.normals, (None, 3))
        count = len(normals)
        offsets = as_floats("faces.offsets", self.offsets, (count,))
        length = np.linalg.norm(normals, axis=1)
        for i in np.flatnonzero(np.abs(length - 1.0) > _UNIT)[:1]:
            raise InputError(f"faces.normals[{i}]", f"must be a unit vector, but has the length {length[i]:.9g}")
        for field in ("names", "materials"):
            given = tuple(getattr(self, field))
            settle(self, **{field: given})
            if len(given) != count:
                raise InputError(f"faces.{field}", f"must be one per wall, {count}, but are {len(given)}")
        for i, material in enumerate(self.materials):
            check_kind(f"faces.materials[{i}]", material, Material, "a Material")
        settle(self, normals=read_only(normals), offsets=read_only(offsets))

    def __len__(self) -> int:
        return len(self.names)

    def reflections(self, frequency: ArrayLike) -> Floats | Complexes:
        """Return every wall's reflection factor of sound pressure at normal incidence (F, ...)."""
        # Each material once, so that one that warns does so once.
        factors = {id(m): m.reflection_at(frequency) for m in dict.fromkeys(self.materials)}
        return np.array([factors[id(m)] for m in self.materials])


@dataclass(frozen=True, slots=True, eq=False)
class Contact:
    """Contact of a motion with a wall, with the parts of the error "rule, but NAME event at PLACE hint"."""

    index: int  # of the position
    rule: str  # what is asked for: "must stay inside the room"
    event: str  # what happens instead: "is", "meets the wall 'x_min'"
    hint: str = ""  # what to do about it, with its comma or semicolon


@dataclass(frozen=True, slots=True, eq=False)
class Mount:
    """The wall that an end sits in."""

    wall: int  # its index; in a mesh one of its plane
    normal: Floats  # (3,) unit vector off the wall, to the side of the air that the end is heard in
    offset: float  # the wall's plane is ``normal @ x = offset``, m
    step: float  # how far in front of the wall the end is taken to be where that decides what reaches it, m

    @staticmethod
    def on(faces: Faces, wall: int, sign: float, size: float) -> Mount:
        """Return the mount on a side of a wall, 1 that of its normal and -1 the other, in a room of a size, m."""
        return Mount(wall, sign * faces.normals[wall], sign * float(faces.offsets[wall]), max(NEAREST, _FINEST * size))

    def height(self, positions: Floats) -> Floats:
        """Return distances (n,) of positions (n, 3) in front of the wall, m."""
        return np.asarray(positions @ self.normal - self.offset)

    def lifted(self, positions: Floats, steps: float = 1.0) -> Floats:
        """Return positions (n, 3) a step, or some, in front of the wall."""
        return np.asarray(positions + (steps * self.step - self.height(positions))[:, None] * self.normal)

    def clearance(self, positions: Floats) -> Floats:
        """Return distances (n,) that positions (n, 3) may leave the wall's plane, m; at most 0 off it."""
        return np.asarray(NEAREST - np.abs(self.height(positions)))

    def first_off(self, positions: Floats) -> Contact | None:
        """Return index of the first of positions (n, 3) off the wall's plane."""
        off = np.flatnonzero(self.clearance(positions) <= 0.0)
        rule = f"must stay in the plane of the wall that it is flush with, within {NEAREST:g} m"
        return Contact(int(off[0]), rule, "is") if len(off) else None


def first_of(*contacts: Contact | None) -> Contact | None:
    """Return the contact that comes first; of several at one position the one that is named first."""
    return min((contact for contact in contacts if contact), key=lambda contact: contact.index, default=None)
