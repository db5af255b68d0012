"""Wall sequences that rays meet: quick in very large meshes, but small walls can be missed."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from clsim.errors import ClsimError
from clsim.paths.specular.beam_tree import Candidates
from clsim.scene.motion.instants import Instants

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from clsim.arrays import Floats
    from clsim.paths.trajectory_tables import BoundingSpheres
    from clsim.scene.motion.motion import Motion
    from clsim.scene.room.faces import Mount
    from clsim.scene.room.mesh import MeshRoom

RAYS = 1_000_000  # from all positions of a source together, and at least the next number from each
_LEAST_RAYS = 20_000
_RATE = 200.0  # Hz, at which a source's way is measured
_MOST = 2_000_000  # instants of a longer one
_STEP = 0.25  # m between positions from which rays are shot
_OFF_WALL = 1e-4  # of the size; Embree's float32 is no judge nearer than this


class ShotRays:
    """Sequences collected by rays from along a trajectory.

    Parameters
    ----------
    room : MeshRoom
        The room.
    source : Motion
        Where rays start.
    receivers : BoundingSpheres
        Each of which every sequence is a candidate for.
    mount : Mount, optional
        The wall that the source sits in: rays start in front of it.

    Attributes
    ----------
    share : float
        Of the work that is done, 0 to 1.

    Raises
    ------
    ClsimError
        If embreex is not installed.
    """

    def __init__(self, room: MeshRoom, source: Motion, receivers: BoundingSpheres, mount: Mount | None = None) -> None:
        self._room, self._receivers = room, receivers
        self._positions = _positions(source)
        if mount is not None:
            self._positions = self._positions + _OFF_WALL * room.walls.size * mount.normal
        self.share = 0.0
        try:
            from trimesh import Trimesh
            from trimesh.ray.ray_pyembree import RayMeshIntersector
        except ImportError as error:
            raise ClsimError('shooting needs embreex: pip install "clsim[shooting]"') from error
        self._middle = 0.5 * (room.extent[0] + room.extent[1])  # float32 is finest around 0
        mesh = Trimesh(room.vertices - self._middle, room.triangles, process=False)
        self._rays = RayMeshIntersector(mesh)

    def candidates(self, max_order: int) -> Iterator[Candidates]:
        """Yield the sequences of every order that rays have met, for all receivers."""
        everyone = np.arange(len(self._receivers.radius))
        met: list[list[NDArray[np.int32]]] = [[] for _ in range(max_order)]
        directions = _directions(max(_LEAST_RAYS, RAYS // len(self._positions)))
        for i, position in enumerate(self._positions):
            for order, sequences in enumerate(self._bounce(position, directions, max_order)):
                met[order].append(sequences)
            self.share = (i + 1) / len(self._positions)
            if i % 16 == 15:
                met = [[np.unique(np.concatenate(some), axis=0)] if some else [] for some in met]
        found = [np.empty((1, 0), dtype=np.int32)] + [np.unique(np.concatenate(some), axis=0) for some in met if some]
        for sequence in found:
            row, receiver = (x.ravel() for x in np.meshgrid(np.arange(len(sequence)), everyone, indexing="ij"))
            yield Candidates(sequence, row, receiver)

    def _bounce(self, position: Floats, directions: Floats, max_order: int) -> Iterator[NDArray[np.int32]]:
        """Yield the sequences of order 1, 2, … that rays from a position meet."""
        walls = self._room.walls
        origin = np.broadcast_to(position - self._middle, directions.shape)
        offset = walls.offset - walls.normal @ self._middle
        sequence = np.empty((len(directions), 0), dtype=np.int32)
        for _ in range(max_order):
            triangle = self._rays.intersects_first(origin, directions)
            hit = np.flatnonzero(triangle >= 0)
            wall = walls.of_triangle[triangle[hit]]
            origin, directions, sequence = origin[hit], directions[hit], sequence[hit]
            toward = np.einsum("ni,ni->n", directions, walls.normal[wall])
            if sequence.shape[1]:
                fresh = (walls.plane[sequence[:, -1]] != walls.plane[wall]) & (np.abs(toward) > 1e-6)
            else:
                fresh = np.abs(toward) > 1e-6
            origin, directions, sequence, wall, toward = (
                x[fresh] for x in (origin, directions, sequence, wall, toward)
            )
            far = (offset[wall] - np.einsum("ni,ni->n", origin, walls.normal[wall])) / toward
            origin = origin + far[:, None] * directions
            directions = directions - 2.0 * toward[:, None] * walls.normal[wall]
            origin = origin + _OFF_WALL * walls.size * directions
            sequence = np.concatenate([sequence, wall[:, None].astype(np.int32)], axis=1)
            yield np.unique(sequence, axis=0)


def _positions(source: Motion) -> Floats:
    """Return positions along a trajectory, some decimetres apart, (n, 3) m."""
    if source.is_static:
        return np.atleast_2d(source.position(0.0))
    instants = Instants(0.0, source.end, min(_RATE, _MOST / source.end))
    places = source.position(instants.times(np.arange(instants.count)))
    travelled = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(places, axis=0), axis=1))])
    stops = np.linspace(0.0, travelled[-1], max(2, min(math.ceil(travelled[-1] / _STEP), _MOST) + 1))
    return np.asarray(places[np.unique(np.searchsorted(travelled, stops).clip(max=len(places) - 1))])


def _directions(count: int) -> Floats:
    """Return unit vectors spread evenly over the sphere (a Fibonacci lattice), (count, 3)."""
    i = np.arange(count) + 0.5
    z = 1.0 - 2.0 * i / count
    angle = math.pi * (1.0 + math.sqrt(5.0)) * i
    across = np.sqrt(1.0 - z * z)
    return np.stack([across * np.cos(angle), across * np.sin(angle), z], axis=1)
