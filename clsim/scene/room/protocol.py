"""What a scene asks of its room."""

from __future__ import annotations

from typing import Any, Protocol, TypeGuard

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Floats
from clsim.errors import InputError
from clsim.scene.room.edges import Edges
from clsim.scene.room.faces import Contact, Faces, Mount
from clsim.scene.room.mesh import MeshRoom


class Room(Protocol):
    """A room: flat walls, and what is inside."""

    # `Shoebox` and `MeshRoom` are rooms; a class of one's own needs no base, and a convex one finds most of this in
    # `ConvexRoom`. Its package names the class by an entry point of `clsim.rooms`.
    @property
    def faces(self) -> Faces:
        """The walls: planes, names and materials."""

    @property
    def extent(self) -> tuple[Floats, Floats]:
        """Lowest and highest corner, (3,) m each."""

    @property
    def volume(self) -> float | None:
        """Volume of the air, m³; None where the room is open."""

    @property
    def surface_area(self) -> float:
        """Area of all walls, m²."""

    @property
    def scale(self) -> float | None:
        """Metres per unit of the files that the room is from; None without files, or where they differ."""

    @property
    def is_convex(self) -> bool:
        """Whether `clearance` above 0 at two positions places the whole segment between them in the room."""

    @property
    def is_closed(self) -> bool:
        """Whether the walls separate an inside from an outside, so that `contains` is defined."""

    def contains(self, positions: Floats) -> NDArray[np.bool_]:
        """Return mask (n,) of positions (n, 3), m, that lie inside."""

    def surrounds(self, positions: Floats) -> NDArray[np.bool_]:
        """Return mask (n,) of `positions` (n, 3), m, with walls on all sides, inside or not."""

    def clearance(self, positions: Floats, mount: Mount | None = None) -> Floats:
        """Return lower bounds of the distance that sources and receivers can move before a contact.

        Parameters
        ----------
        positions : ndarray (n, 3)
            m.
        mount : Mount, optional
            The wall that they sit in.

        Returns
        -------
        ndarray (n,)
            m; 0 or less where a contact cannot be excluded, in a convex room where there is one.
        """

    def first_contact(self, positions: Floats, mount: Mount | None = None) -> Contact | None:
        """Return the first contact of a motion: where it leaves the room or meets a wall.

        Parameters
        ----------
        positions : ndarray (n, 3)
            In the order of time, m; between them the motion is straight.
        mount : Mount, optional
            The wall that the end sits in: it may not go off its plane or beyond its edges.

        Returns
        -------
        Contact or None
            The first position that is in the wrong place or after which a wall is walked through.
        """

    def walls_at(self, position: Floats) -> NDArray[np.int64]:
        """Return indices (k,) of the walls that a `position` (3,), m, is on, one for each plane."""

    def edges(self) -> Edges:
        """Return the diffracting edges."""

    def as_mesh(self) -> MeshRoom:
        """Return the same walls made of triangles."""

    def describe(self) -> list[str]:
        """Return description of the room, a line per fact."""


ROOM_MEMBERS = tuple(sorted(name for name in vars(Room) if not name.startswith("_")))


def is_room(value: Any) -> TypeGuard[Room]:
    """Whether a value has all members of `Room`."""
    return not isinstance(value, type) and all(hasattr(value, name) for name in ROOM_MEMBERS)


def checked_room(value: Any) -> Room:
    """Return a room."""
    if is_room(value):
        if not isinstance(value.faces, Faces):
            raise InputError("room.faces", f"must be Faces, but is {value.faces!r:.80}")
        return value
    lacking = [name for name in ROOM_MEMBERS if not hasattr(value, name)]
    if isinstance(value, type) or len(lacking) == len(ROOM_MEMBERS):
        raise InputError("room", f"must be a room (a Shoebox, a MeshRoom or another Room), but is {value!r:.80}")
    raise InputError("room", f"must have all that a Room has, but {type(value).__name__} lacks {', '.join(lacking)}")
