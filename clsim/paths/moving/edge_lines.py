"""Edges of the room and of bodies as lines that move, and points on them as ends of ways."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.arrays import read_only
from clsim.numerics.quaternions import cross_product, rotate
from clsim.paths.moving.mirrors import ROOM, Mirrors
from clsim.scene.room.edges import find_edges

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Floats
    from clsim.scene.body import Body
    from clsim.scene.scene import Scene

    Integers = NDArray[np.signedinteger[Any]]

_ON = 1e-7  # of the room's size; what is nearer to a plane is in it


@dataclass(frozen=True, slots=True, eq=False)
class EdgeLines:
    """All edges of a scene: those of the room, and behind them those of its bodies, E in all.

    Attributes
    ----------
    frames : ndarray (E, 4, 3)
        Start, m, and the vectors `across`, `out` and `along`, see `Edges`; of bodies in their own coordinates.
    """

    frames: Floats
    length: Floats  # (E,) m, and exterior angles over π
    n: Floats  # likewise
    faces: NDArray[np.int64]  # (E, 2) mirrors that are the 0-face and the n-face, see `Mirrors`
    free: NDArray[np.bool_]  # (E, 2) whether start and stop are in the air
    owner: NDArray[np.int64]  # (E,) index of the body, `ROOM` for edges of the room
    names: tuple[str, ...]  # of each
    bodies: tuple[Body, ...]  # of the scene

    @staticmethod
    def of(scene: Scene, of_bodies: bool = True) -> EdgeLines:
        """Collect the edges of a scene, or of its room alone."""
        mirrors, bodies = Mirrors.of(scene), tuple(scene.bodies) if of_bodies else ()
        found = [scene.room.edges()]
        for body in bodies:
            found.append(find_edges(body.mesh.walls, replace(body.mesh.faces, names=body.faces), None))
        first = [0, *mirrors.first.tolist()[: len(bodies)]]
        return EdgeLines(
            read_only(np.concatenate([edges.frames for edges in found])),
            read_only(np.concatenate([edges.length for edges in found])),
            read_only(np.concatenate([edges.n for edges in found])),
            read_only(np.concatenate([edges.faces + f for edges, f in zip(found, first, strict=True)])),
            read_only(np.concatenate([edges.free for edges in found])),
            read_only(np.repeat(np.arange(-1, len(bodies)), [len(edges) for edges in found])),
            tuple(name for edges in found for name in edges.names),
            bodies,
        )

    def __len__(self) -> int:
        return len(self.names)

    def placed(self, edge: Integers, along: Floats, times: Floats) -> Floats:
        """Positions (P, T, 3), m, at times (P, T), s, of points at places (P, T) along edges (P,), m."""
        own = self.frames[edge, None, 0] + along[..., None] * self.frames[edge, None, 3]
        for body, rows in self._of_bodies(edge):
            own[rows] = self.bodies[body].placed(own[rows], times[rows])
        return own

    def velocity(self, edge: Integers, along: Floats, times: Floats) -> Floats:
        """Return the velocities (P, T, 3) of the same points, m/s."""
        found = np.zeros((*times.shape, 3))
        for body, rows in self._of_bodies(edge):
            thing, when = self.bodies[body], times[rows]
            if thing.is_static:
                continue
            motion = thing.trajectory
            arm = self.frames[edge[rows], None, 0] + along[rows, :, None] * self.frames[edge[rows], None, 3]
            turned = cross_product(motion.angular_velocity(when), rotate(motion.orientation(when), arm))
            found[rows] = motion.velocity(when) + turned
        return found

    def axes(self, edge: Integers, times: Floats) -> tuple[Floats, Floats, Floats]:
        """Return `across`, `out` and `along` (P, T, 3) of edges (P,) as they are turned at times (P, T)."""
        own = np.repeat(self.frames[edge, None, 1:], times.shape[1], axis=1)
        for body, rows in self._of_bodies(edge):
            if self.bodies[body].trajectory.has_orientation:
                turn = self.bodies[body].trajectory.orientation(times[rows])
                own[rows] = rotate(turn[..., None, :], own[rows])
        across, out, along = np.moveaxis(own, 2, 0)
        return across, out, along

    def in_planes(self, mirrors: Mirrors, size: float) -> NDArray[np.bool_]:
        """Mask (E, W) of mirrors that hold edges whatever moves: those of the same object."""
        ends = np.stack([self.frames[:, 0], self.frames[:, 0] + self.length[:, None] * self.frames[:, 3]], axis=1)
        height = np.abs(ends @ mirrors.normal.T - mirrors.offset).max(axis=1)
        return np.asarray((height <= _ON * size) & (self.owner[:, None] == mirrors.owner))

    def _of_bodies(self, edge: Integers) -> list[tuple[int, NDArray[np.int64]]]:
        owner = self.owner[edge]
        return [(body, np.flatnonzero(owner == body)) for body in np.unique(owner).tolist() if body != ROOM]


@dataclass(frozen=True, slots=True, eq=False)
class EdgePoint:
    """Points at places (P, T) along edges (P,) as an end of ways: each keeps its place as time goes on."""

    lines: EdgeLines
    edge: Integers
    along: Floats

    def position(self, times: Floats) -> Floats:
        """Return positions (P, T, 3) at times (P, T), m."""
        return self.lines.placed(self.edge, self.along, np.broadcast_to(times, self.along.shape))

    def velocity(self, times: Floats) -> Floats:
        """Return velocities (P, T, 3) at times (P, T), m/s."""
        return self.lines.velocity(self.edge, self.along, np.broadcast_to(times, self.along.shape))
