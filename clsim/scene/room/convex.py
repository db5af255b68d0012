"""What follows from the planes alone in a convex room."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING

import numpy as np

from clsim.scene.room.edges import Edges
from clsim.scene.room.faces import NEAREST, Contact, first_of

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from clsim.arrays import Floats
    from clsim.scene.room.faces import Faces, Mount


class ConvexRoom(ABC):
    """A room that is in front of every one of its walls; a subclass gives the rest of `Room`."""

    __slots__ = ()

    @property
    @abstractmethod
    def faces(self) -> Faces:
        """The walls; their normals point inwards."""

    @property
    def is_convex(self) -> bool:
        """True."""
        return True

    @property
    def is_closed(self) -> bool:
        """True: nothing is outside."""
        return True

    @property
    def scale(self) -> float | None:
        """None: it is from no file."""
        return None

    def _heights(self, positions: ArrayLike) -> Floats:
        """Return how far positions (..., 3) are in front of the nearest wall, (...) m."""
        faces = self.faces
        return np.asarray((np.asarray(positions, dtype=np.float64) @ faces.normals.T - faces.offsets).min(axis=-1))

    def contains(self, positions: ArrayLike, margin: float = 0.0) -> NDArray[np.bool_]:
        """Return which positions lie inside the room, strictly.

        Parameters
        ----------
        positions : array_like (n, 3)
            Positions, m.
        margin : float
            Distance from every wall that is asked for, m.

        Returns
        -------
        ndarray (n,) of bool
            False on a wall, at the margin and for NaN.
        """
        return np.asarray(self._heights(positions) > margin)

    def surrounds(self, positions: ArrayLike) -> NDArray[np.bool_]:
        """Return which positions (n, 3) have walls to all sides: those inside.

        Parameters
        ----------
        positions : array_like (n, 3)
            m.

        Returns
        -------
        ndarray (n,) of bool
            Whether they are inside.
        """
        return self.contains(positions)

    def clearance(self, positions: Floats, mount: Mount | None = None) -> Floats:
        """Return how far positions (n, 3) are inside the room, (n,) m; see `Room.clearance`.

        Parameters
        ----------
        positions : ndarray (n, 3)
            m.
        mount : Mount, optional
            The wall that they sit in.

        Returns
        -------
        ndarray (n,)
            Distance from the nearest wall, m; 0 or less outside.
        """
        if mount is None:
            return self._heights(positions)
        return np.minimum(mount.clearance(positions), self._heights(mount.lifted(positions)))

    def first_contact(self, positions: Floats, mount: Mount | None = None) -> Contact | None:
        """Return where positions (n, 3) first are outside the room, or off the wall they sit in.

        Parameters
        ----------
        positions : ndarray (n, 3)
            In the order of time, m.
        mount : Mount, optional
            The wall that they sit in.

        Returns
        -------
        Contact or None
            The first position that is in the wrong place.
        """
        seen = positions if mount is None else mount.lifted(positions)
        outside = np.flatnonzero(~(self._heights(seen) > 0.0))
        return first_of(
            None if mount is None else mount.first_off(positions),
            self._outside(int(outside[0]), positions[outside[0]]) if len(outside) else None,
        )

    def _outside(self, index: int, position: Floats) -> Contact:
        on = self.walls_at(position)
        hint = f", on the wall {self.faces.names[on[0]]}; an end in a wall needs flush=True" if len(on) == 1 else ""
        return Contact(index, "must stay inside the room", "is", hint)

    def edges(self) -> Edges:
        """Return none: no wall ends in the air, and no corner points inwards.

        Returns
        -------
        Edges
            None of them.
        """
        return Edges.none()

    def walls_at(self, position: Floats) -> NDArray[np.int64]:
        """Return the walls whose planes a position (3,) is on.

        Parameters
        ----------
        position : ndarray (3,)
            m.

        Returns
        -------
        ndarray (k,) of int
            Indices of walls.
        """
        return np.flatnonzero(np.abs(self.faces.normals @ position - self.faces.offsets) < NEAREST)
