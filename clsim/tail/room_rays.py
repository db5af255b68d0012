"""Where rays next meet a wall: by the planes of a convex room, by Embree in a mesh."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

import numpy as np

from clsim.errors import InputError
from clsim.packages import check_packages

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Floats
    from clsim.scene.room.mesh import MeshRoom
    from clsim.scene.room.protocol import Room

    Met = tuple[Floats, NDArray[np.int64]]

_OFF_WALL = 1e-5  # of the size; Embree's float32 is no judge nearer than this


class RoomRays(Protocol):
    """What finds the walls that rays meet.

    Attributes
    ----------
    off : float
        How far off a wall rays set out from it, m.
    """

    off: float

    def next(self, origins: Floats, directions: Floats) -> Met:
        """Return how far (n,) m rays from origins (n, 3) m go, and which wall they meet, -1 for none."""
        ...


def room_rays(room: Room) -> RoomRays:
    """Return what finds the walls of a closed room."""
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
        """Return how far (n,) m rays go, and which wall they meet, -1 for none."""
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
        """Return how far (n,) m rays go, and which wall they meet, -1 for none."""
        walls = self._walls
        triangle = np.asarray(self._embree.intersects_first(origins - self._middle, directions))
        wall = np.where(triangle >= 0, walls.of_triangle[triangle], -1)
        towards = np.einsum("ni,ni->n", directions, walls.normal[wall])
        with np.errstate(divide="ignore", invalid="ignore"):
            far = (walls.offset[wall] - np.einsum("ni,ni->n", origins, walls.normal[wall])) / towards
        lost = (wall < 0) | ~np.isfinite(far)
        return np.where(lost, 0.0, np.maximum(far, 0.0)), np.where(lost, -1, wall)
