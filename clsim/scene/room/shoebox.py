"""Rectangular rooms with six walls, what convex rooms have in common, and the volume and walls of any room."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clsim.arrays import LARGEST_ROOM, SMALLEST_ROOM, Complexes, Floats, as_floats, as_number, read_only, short_repr
from clsim.errors import InputError, check_kind, meant, settle
from clsim.scene.material.material import Material
from clsim.scene.room.edges import Edges
from clsim.scene.room.faces import NEAREST, Contact, Faces, Mount, first_of
from clsim.scene.room.mesh import MeshRoom
from clsim.scene.room.mesh_cleaning import cross_products
from clsim.scene.room.protocol import Room

WALLS = ("x_min", "x_max", "y_min", "y_max", "z_min", "z_max")  # a wall's index is its place here


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
        """Return distances (...) of positions (..., 3) in front of the nearest wall, m."""
        faces = self.faces
        return np.asarray((np.asarray(positions, dtype=np.float64) @ faces.normals.T - faces.offsets).min(axis=-1))

    def contains(self, positions: ArrayLike, margin: float = 0.0) -> NDArray[np.bool_]:
        """Return a mask (n,) of `positions` (n, 3), m, inside by more than a `margin`, m; False for NaN."""
        return np.asarray(self._heights(positions) > margin)

    def surrounds(self, positions: ArrayLike) -> NDArray[np.bool_]:
        """Return a mask of positions inside; see `Room.surrounds`."""
        return self.contains(positions)

    def clearance(self, positions: Floats, mount: Mount | None = None) -> Floats:
        """Return distances (n,) of positions (n, 3) from the nearest wall, positive inside, m; see `Room.clearance`."""
        if mount is None:
            return self._heights(positions)
        return np.minimum(mount.clearance(positions), self._heights(mount.lifted(positions)))

    def first_contact(self, positions: Floats, mount: Mount | None = None) -> Contact | None:
        """Return the first contact: outside the room, or off its own wall; see `Room.first_contact`."""
        seen = positions if mount is None else mount.lifted(positions)
        found = None if mount is None else mount.first_off(positions)
        for i in np.flatnonzero(~(self._heights(seen) > 0.0))[:1].tolist():
            on = self.walls_at(positions[i])
            hint = f", on the wall {self.faces.names[on[0]]}; an end in a wall needs flush=True" if len(on) == 1 else ""
            found = first_of(found, Contact(i, "must stay inside the room", "is", hint))
        return found

    def edges(self) -> Edges:
        """Return none: no wall ends in the air, and no corner points inwards."""
        return Edges.none()

    def walls_at(self, position: Floats) -> NDArray[np.int64]:
        """Return the walls whose planes a position is on; see `Room.walls_at`."""
        return np.flatnonzero(np.abs(self.faces.normals @ position - self.faces.offsets) < NEAREST)


@dataclass(frozen=True, slots=True, eq=False)
class Shoebox(ConvexRoom):
    """A box-shaped room from the origin to its size.

    Parameters
    ----------
    size : array_like (3,)
        Lengths along x, y, z, m.
    walls : Material or mapping or sequence of 6
        One material for all walls; or materials by the names ``x_min x_max y_min y_max z_min z_max``, where
        ``default`` stands for those not named; or six of them in this order. Kept as the six.

    Attributes
    ----------
    faces : Faces
        Planes, names and materials of the six walls, in this order.

    Examples
    --------
    >>> floor = Material.from_reflection(0.2)
    >>> room = Shoebox((8.0, 6.0, 3.0), {"default": Material.from_reflection(0.9), "z_min": floor})
    >>> room.reflections(40e3).tolist()
    [0.9, 0.9, 0.9, 0.9, 0.2, 0.9]
    """

    size: Floats
    walls: Material | Mapping[str, Material] | Sequence[Material]

    faces: Faces = field(init=False)

    __repr__ = short_repr

    def __post_init__(self) -> None:
        size = as_floats("size", self.size, (3,))
        for i, length in enumerate(size):
            as_number(f"size[{i}]", length, at_least=SMALLEST_ROOM, at_most=LARGEST_ROOM, unit="m")
        walls = _checked_walls(self.walls)
        inwards = np.stack([np.eye(3), -np.eye(3)], axis=1).reshape(6, 3)
        offsets = np.stack([np.zeros(3), -size], axis=1).ravel()
        settle(self, size=size, walls=walls, faces=Faces(inwards, offsets, WALLS, walls))

    @property
    def extent(self) -> tuple[Floats, Floats]:
        """Lowest and highest corner, (3,) m each."""
        return read_only(np.zeros(3)), self.size

    @property
    def volume(self) -> float:
        """Volume of the air, m³."""
        return float(self.size.prod())

    @property
    def surface_area(self) -> float:
        """Area of all walls, m²."""
        return float(2.0 * self.size @ np.roll(self.size, 1))

    def reflections(self, frequency: ArrayLike) -> Floats | Complexes:
        """Return every wall's factor (6, ...) at normal incidence by `frequency` (...) above 0 Hz, as in `WALLS`."""
        return self.faces.reflections(frequency)

    def as_mesh(self) -> MeshRoom:
        """Return the box as twelve triangles, turning outwards, with the same names and materials of walls."""
        corner = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)]) * self.size
        sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]  # as in WALLS
        triangles = [t for a, b, c, d in sides for t in ((a, b, c), (a, c, d))]
        materials = [m for m in self.faces.materials for _ in range(2)]
        return MeshRoom(corner, np.array(triangles), materials, labels=[name for name in WALLS for _ in range(2)])

    def describe(self) -> list[str]:
        """Return the room's size in a line."""
        x, y, z = self.size
        return [f"room: a shoebox of {x:.4g} x {y:.4g} x {z:.4g} m"]


def _checked_walls(walls: object) -> tuple[Material, ...]:
    if isinstance(walls, Material):
        return (walls,) * len(WALLS)
    if isinstance(walls, Mapping):
        for name in walls:
            if name not in (*WALLS, "default"):
                problem = f"is no wall; the walls are {', '.join(WALLS)} and default{meant(name, WALLS)}"
                raise InputError(f"walls.{name}", problem)
        missing = [name for name in WALLS if name not in walls]
        if missing and "default" not in walls:
            raise InputError(f"walls.{missing[0]}", "is missing, and there is no default")
        for name, material in walls.items():
            check_kind(f"walls.{name}", material, Material, "a Material")
        return tuple(walls[name] if name in walls else walls["default"] for name in WALLS)
    if isinstance(walls, Sequence) and not isinstance(walls, str):
        if len(walls) != len(WALLS):
            raise InputError("walls", f"must be {len(WALLS)} materials, but are {len(walls)}")
        for i, material in enumerate(walls):
            check_kind(f"walls[{i}]", material, Material, "a Material")
        return tuple(walls)
    raise InputError("walls", f"must be a Material or materials by name of wall, but is {walls!r:.80}")


def enclosure_of(room: Room) -> tuple[float | None, Floats, tuple[Material, ...]]:
    """Return the enclosed volume, m³, None of a room that is not closed, and areas, m², and materials of its walls."""
    if isinstance(room, Shoebox):  # every plan asks: no mesh is made
        x, y, z = room.size.tolist()
        return x * y * z, np.array([y * z, y * z, x * z, x * z, x * y, x * y]), room.faces.materials
    mesh = room.as_mesh()
    triangles = 0.5 * np.linalg.norm(cross_products(mesh.vertices[mesh.triangles]), axis=1)
    materials = mesh.faces.materials
    areas: Floats = np.bincount(mesh.walls.of_triangle, triangles, minlength=len(materials)).astype(np.float64)
    return mesh.volume, areas, materials
