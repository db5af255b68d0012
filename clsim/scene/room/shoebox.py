"""Rooms: a box with six walls."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from clsim.arrays import LARGEST_ROOM, SMALLEST_ROOM, Complexes, Floats, as_floats, as_number, read_only
from clsim.errors import InputError
from clsim.scene.material.material import Material

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

WALLS = ("x_min", "x_max", "y_min", "y_max", "z_min", "z_max")  # a wall's index is its place here


@dataclass(frozen=True, slots=True, eq=False)
class Shoebox:
    """A box-shaped room from the origin to its size.

    Parameters
    ----------
    size : array_like (3,)
        Lengths along x, y, z, m.
    walls : Material or mapping or sequence of 6
        One material for all walls; or materials by the names ``x_min x_max y_min y_max z_min z_max``, where
        ``default`` stands for those not named; or six of them in this order. Kept as the six.

    Raises
    ------
    InputError
        If a length is not from 0.1 mm to 100 km, or a wall is unknown or missing.

    Examples
    --------
    >>> floor = Material.from_reflection(0.2)
    >>> room = Shoebox((8.0, 6.0, 3.0), {"default": Material.from_reflection(0.9), "z_min": floor})
    >>> room.reflections(40e3).tolist()
    [0.9, 0.9, 0.9, 0.9, 0.2, 0.9]
    """

    size: Floats
    walls: Material | Mapping[str, Material] | Sequence[Material]

    def __post_init__(self) -> None:
        size = as_floats("size", self.size, (3,))
        for i, length in enumerate(size):
            as_number(f"size[{i}]", length, at_least=SMALLEST_ROOM, at_most=LARGEST_ROOM, unit="m")
        object.__setattr__(self, "size", size)
        object.__setattr__(self, "walls", _checked_walls(self.walls))

    @property
    def wall_materials(self) -> tuple[Material, ...]:
        """The six materials, in the order of `WALLS`."""
        assert isinstance(self.walls, tuple)
        return self.walls

    @property
    def planes(self) -> tuple[Floats, Floats]:
        """Unit normals (6, 3) and offsets (6,) of the walls: ``normal @ x = offset``, m."""
        return np.repeat(np.eye(3), 2, axis=0), np.stack([np.zeros(3), self.size], axis=1).ravel()

    @property
    def wall_names(self) -> tuple[str, ...]:
        """Names of the six walls."""
        return WALLS

    @property
    def extent(self) -> tuple[Floats, Floats]:
        """Lowest and highest corner, (3,) m each."""
        return read_only(np.zeros(3)), self.size

    def reflections(self, frequency: ArrayLike) -> Floats | Complexes:
        """Return the reflection factor of sound pressure of every wall at normal incidence.

        Parameters
        ----------
        frequency : array_like
            Positive, Hz.

        Returns
        -------
        ndarray (6, ...)
            Factors in the order of `WALLS` for every frequency, complex where a wall is.
        """
        # Each material once, so that one that warns does so once.
        factors = {id(m): m.reflection_at(frequency) for m in dict.fromkeys(self.wall_materials)}
        return np.array([factors[id(m)] for m in self.wall_materials])

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

        Examples
        --------
        >>> room = Shoebox((8.0, 6.0, 3.0), Material.from_reflection(0.9))
        >>> room.contains([(1.0, 1.0, 1.0), (1.0, 1.0, 3.0)]).tolist()
        [True, False]
        """
        x = np.asarray(positions, dtype=np.float64)
        inside: NDArray[np.bool_] = np.all((x > margin) & (x < self.size - margin), axis=-1)
        return inside


def _checked_walls(walls: object) -> tuple[Material, ...]:
    if isinstance(walls, Material):
        return (walls,) * len(WALLS)
    if isinstance(walls, Mapping):
        for name in walls:
            if name not in (*WALLS, "default"):
                raise InputError(f"walls.{name}", f"is no wall; the walls are {', '.join(WALLS)} and default")
        missing = [name for name in WALLS if name not in walls]
        if missing and "default" not in walls:
            raise InputError(f"walls.{missing[0]}", "is missing, and there is no default")
        for name, material in walls.items():
            _check_material(f"walls.{name}", material)
        return tuple(walls[name] if name in walls else walls["default"] for name in WALLS)
    if isinstance(walls, Sequence) and not isinstance(walls, str):
        if len(walls) != len(WALLS):
            raise InputError("walls", f"must be {len(WALLS)} materials, but are {len(walls)}")
        for i, material in enumerate(walls):
            _check_material(f"walls[{i}]", material)
        return tuple(walls)
    raise InputError("walls", f"must be a Material or materials by name of wall, but is {walls!r:.80}")


def _check_material(field: str, material: object) -> None:
    if not isinstance(material, Material):
        raise InputError(field, f"must be a Material, but is {material!r:.80}")
