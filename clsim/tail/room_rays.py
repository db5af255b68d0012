"""Next walls of rays, by the planes of a convex room or by Embree in a mesh, and the energy that walls reflect."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.util import find_spec
from typing import TYPE_CHECKING, Protocol

import numpy as np

from clsim.errors import InputError
from clsim.packages import check_packages
from clsim.paths.response import NEPERS, covered

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Floats
    from clsim.scene.room.mesh import MeshRoom
    from clsim.scene.room.protocol import Room
    from clsim.scene.scene import Scene

    Met = tuple[Floats, NDArray[np.int64]]

ANGLES = 128  # cells of the root of the cosine of incidence


@dataclass(frozen=True, slots=True, eq=False)
class WallEnergies:
    """Energy sent back by kind of wall, angle and band."""

    kind: NDArray[np.int64]  # (walls,) of which material each wall is
    returned: Floats  # (kinds, angles, B) share of energy that comes back
    scattered: Floats  # (kinds, angles, B) share of that which leaves the mirror's direction
    air: Floats  # (B,) absorption of energy by the air, 1/m

    @classmethod
    def of(cls, scene: Scene, centres: Floats) -> WallEnergies:
        """Return those of a scene's walls at frequencies (B,), Hz."""
        materials = list(dict.fromkeys(scene.room.faces.materials))
        cosine = ((np.arange(ANGLES) + 0.5) / ANGLES)[:, None] ** 2
        c = scene.air.speed_of_sound
        made = [
            (
                material.energy_at(covered(centres, material), cosine, c),
                material.scattered_share(covered(centres, material), cosine, c),
            )
            for material in materials
        ]
        kind = np.array([materials.index(material) for material in scene.room.faces.materials])
        returned, scattered = (np.array([pair[i] for pair in made]) for i in range(2))
        return cls(kind, returned, scattered, 2.0 * NEPERS * scene.air.absorption_at(centres))

    def groups(self) -> list[NDArray[np.int64]]:
        """Return groups of bands with equal scattering, whose rays take the same paths."""
        _, which = np.unique(self.scattered.reshape(-1, len(self.air)), axis=1, return_inverse=True)
        return [np.flatnonzero(which.ravel() == i) for i in range(which.max() + 1)]

    def at(self, walls: NDArray[np.int64], cosine: Floats, bands: NDArray[np.int64]) -> tuple[Floats, Floats]:
        """Return the reflected share (n, B) of rays (n,) in bands, and the scattered share (n,) of the first one."""
        angle = np.minimum((ANGLES * np.sqrt(np.abs(cosine))).astype(np.int64), ANGLES - 1)
        row = self.kind[walls] * ANGLES + angle
        returned, scattered = (table.reshape(-1, len(self.air)) for table in (self.returned, self.scattered))
        return returned[:, bands].take(row, axis=0), scattered[:, bands[0]].take(row)


_OFF_WALL = 1e-5  # of the size; Embree's float32 is no judge nearer than this


class RoomRays(Protocol):
    """Interface of the search for the walls that rays meet.

    Attributes
    ----------
    off : float
        How far off a wall rays set out from it, m.
    """

    off: float

    def next(self, origins: Floats, directions: Floats) -> Met:
        """Return distances (n,) m of rays from origins (n, 3) m to the next wall, and its index, -1 for none."""
        ...


def why_no_rays(room: Room) -> str:
    """Name what hinders rays in a room: that it is open, or a missing package; nothing if they can be traced."""
    if room.volume is None:
        return "the room is not closed, and its energy leaves it"
    return "" if room.is_convex or find_spec("embreex") else "embreex is not installed, which traces rays in a mesh"


def room_rays(room: Room) -> RoomRays:
    """Return the search of a closed room."""
    if room.volume is None:
        raise InputError(
            "tail", "must be 'off' in a room that is not closed, for energy leaves it: the mesh is not watertight "
            "(`clsim check` tells where)"
        )  # fmt: skip
    return _PlaneRays(room) if room.is_convex else _MeshRays(room.as_mesh())


class _PlaneRays:
    """Of a convex room, from inside."""

    off = 0.0

    def __init__(self, room: Room) -> None:
        self._normals, self._offsets = room.faces.normals, room.faces.offsets

    def next(self, origins: Floats, directions: Floats) -> Met:
        """Return distances (n,) m of rays to the next wall, and its index, -1 for none."""
        towards = directions @ self._normals.T
        height = np.maximum(origins @ self._normals.T - self._offsets, 0.0)
        with np.errstate(divide="ignore", invalid="ignore"):
            far = np.where(towards < 0.0, height / -towards, np.inf)
        wall = far.argmin(axis=1)
        return far[np.arange(len(far)), wall], wall


class _MeshRays:
    """Of a mesh: Embree says which triangle, the plane of its wall how far."""

    def __init__(self, room: MeshRoom) -> None:
        check_packages("tail", "tracing rays in a mesh", "shooting", "embreex")
        from trimesh import Trimesh
        from trimesh.ray.ray_pyembree import RayMeshIntersector

        self._walls = room.walls
        self._middle = 0.5 * (room.extent[0] + room.extent[1])  # float32 is finest around 0
        mesh = Trimesh(room.vertices - self._middle, room.triangles, process=False)
        self._embree = RayMeshIntersector(mesh)
        self.off = _OFF_WALL * room.walls.size

    def next(self, origins: Floats, directions: Floats) -> Met:
        """Return distances (n,) m of rays to the next wall, and its index, -1 for none."""
        walls = self._walls
        triangle = np.asarray(self._embree.intersects_first(origins - self._middle, directions))
        wall = np.where(triangle >= 0, walls.of_triangle[triangle], -1)
        towards = np.einsum("ni,ni->n", directions, walls.normal[wall])
        with np.errstate(divide="ignore", invalid="ignore"):
            far = (walls.offset[wall] - np.einsum("ni,ni->n", origins, walls.normal[wall])) / towards
        lost = (wall < 0) | ~np.isfinite(far)
        return np.where(lost, 0.0, np.maximum(far, 0.0)), np.where(lost, -1, wall)
