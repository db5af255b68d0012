"""Walls and faces as mirrors, and their edges as lines, with where they are and how fast at any event."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import ByRow, Floats, by_value, read_only
from clsim.numerics.quaternions import cross_product, rotate
from clsim.scene.body import Body
from clsim.scene.room.edges import Edges, find_edges
from clsim.scene.room.protocol import Room

Integers = NDArray[np.signedinteger[Any]]


ROOM = -1  # owner of the walls of the room
FARTHEST = 2.0  # radii of a body from its origin, beyond which its velocity is not continued


def dot(a: Floats, b: Floats) -> Floats:
    """Return the products (...) of vectors (..., 3)."""
    return np.asarray(np.einsum("...i,...i->...", a, b))


@dataclass(frozen=True, slots=True, eq=False)
class Planes:
    """Flat mirrors, each as it is about one event, of any shape (...).

    The mirror is where ``normal @ x = offset + speed t``, with times counted from some instant.
    """

    normal: Floats  # (..., 3) unit vectors; zero for no mirror
    offset: Floats  # (...) m
    speed: Floats  # (...) along the normal, m/s

    def height(self, time: Floats, place: Floats) -> Floats:
        """Distances in front of them, m, of events at times (...), s, and places (..., 3), m."""
        return np.asarray(dot(self.normal, place) - self.speed * time - self.offset)


@dataclass(frozen=True, slots=True, eq=False)
class Mirrors:
    """All mirrors of a scene: the walls of the room, and behind them the faces of its bodies."""

    normal: Floats  # (W, 3) planes ``normal @ x = offset``, of faces in the coordinates of their bodies, m
    offset: Floats  # likewise
    owner: NDArray[np.int64]  # (W,) index of the body, `ROOM` for walls of the room
    first: NDArray[np.int64]  # (bodies,) first face of each body
    bodies: tuple[Body, ...]  # of the scene

    @staticmethod
    def of(room: Room, bodies: Sequence[Body]) -> Mirrors:
        """Collect the mirrors of a room and of bodies."""
        faces = [room.faces, *(body.mesh.faces for body in bodies)]
        counts = [len(each) for each in faces]
        return Mirrors(
            read_only(np.concatenate([each.normals for each in faces])),
            read_only(np.concatenate([each.offsets for each in faces])),
            read_only(np.repeat(np.arange(-1, len(bodies)), counts)), read_only(np.cumsum(counts)[:-1]), tuple(bodies),
        )  # fmt: skip

    def planes(self, walls: Integers, now: Floats, event: Floats, place: Floats | None) -> Planes:
        """Return mirrors (P,) as they are about the events (P, T) in which sound meets them, s, at places (P, T, 3).

        A face n(t) x = h(t) that turns is taken as its tangent about the event, a plane of the constant normal n and
        the speed ``h' - n' x``, which is that of the body's own point there.
        """
        met = walls >= 0
        normal = np.empty((*event.shape, 3))
        offset, speed = np.empty(event.shape), np.zeros(event.shape)
        normal[...] = np.where(met[:, None], self.normal[walls], 0.0)[:, None]
        offset[...] = np.where(met, self.offset[walls], 0.0)[:, None]
        for body, mine in by_value(np.where(met, self.owner[walls], ROOM)):
            if body != ROOM:
                where = None if place is None else place[mine]
                self._pose(self.bodies[body], walls[mine], now[mine], event[mine], where, (normal, offset, speed), mine)
        return Planes(normal, offset, speed)

    def distances(self, walls: Integers, start: Floats, stop: Floats, times: Any) -> Floats:
        """Lengths of paths (P,) by mirrors at rest where they are at a time, or at times (P,), m."""
        now, none = np.broadcast_to(times, len(walls))[:, None], np.zeros((len(walls), 1))
        image = start[:, None]
        for met in walls.T:
            plane = self.planes(met, now, none, None)
            image = image - 2.0 * plane.height(none, image)[..., None] * plane.normal
        return np.asarray(np.linalg.norm(image[:, 0] - stop, axis=1))

    def speeds(self, walls: Integers) -> Floats:
        """Sum the bounds (P,) of the speeds of the bodies that own mirrors (P, N), m/s."""
        peak = np.array([*(body.peak_speed for body in self.bodies), 0.0])
        return np.asarray(peak[np.append(self.owner, ROOM)[walls]].sum(axis=1))

    def _pose(
        self, body: Body, walls: Integers, now: Floats, event: Floats, place: Floats | None,
        out: tuple[Floats, Floats, Floats], mine: NDArray[np.int64],
    ) -> None:  # fmt: skip
        """Write planes (P, T) of faces (P,) of a body into rows of others."""
        motion, time = body.trajectory, now + event
        own = np.broadcast_to(self.normal[walls][:, None], (*time.shape, 3))
        normal = rotate(motion.orientation(time), own) if motion.has_orientation else own
        origin = motion.position(time)
        speed = np.zeros(time.shape)
        if place is not None and not body.is_static:
            arm = place - origin
            far = np.linalg.norm(arm, axis=-1, keepdims=True)
            arm = arm * np.minimum(FARTHEST * body.radius / np.maximum(far, 1e-300), 1.0)
            moved = motion.velocity(time) + cross_product(motion.angular_velocity(time), arm)
            speed = dot(normal, moved)
        out[0][mine], out[2][mine] = normal, speed
        out[1][mine] = self.offset[walls][:, None] + dot(normal, origin) - speed * event


@dataclass(frozen=True, slots=True, eq=False)
class EdgeLines:
    """All edges of a scene: those of the room, and behind them those of its bodies, E in all."""

    # (E, 4, 3) start, m, and the vectors `across`, `out` and `along`, see `Edges`; of bodies in their own
    # coordinates.
    frames: Floats
    length: Floats  # (E,) m, and exterior angles over π
    n: Floats  # likewise
    faces: NDArray[np.int64]  # (E, 2) mirrors that are the 0-face and the n-face, see `Mirrors`
    free: NDArray[np.bool_]  # (E, 2) whether start and stop are in the air
    owner: NDArray[np.int64]  # (E,) index of the body, `ROOM` for edges of the room
    names: tuple[str, ...]  # of each
    bodies: tuple[Body, ...]  # of the scene
    parts: tuple[Edges, ...]  # edges of the room, and of each body

    @staticmethod
    def of(room: Room, bodies: Sequence[Body] = ()) -> EdgeLines:
        """Collect the edges of a room and of bodies."""
        named = ((body.mesh.walls, replace(body.mesh.faces, names=body.faces)) for body in bodies)
        found = [room.edges(), *(find_edges(walls, faces, None) for walls, faces in named)]
        first = np.cumsum([0, len(room.faces), *(len(body.mesh.faces) for body in bodies)])
        return EdgeLines(
            read_only(np.concatenate([edges.frames for edges in found])),
            read_only(np.concatenate([edges.length for edges in found])),
            read_only(np.concatenate([edges.n for edges in found])),
            read_only(np.concatenate([edges.faces + f for edges, f in zip(found, first, strict=False)])),
            read_only(np.concatenate([edges.free for edges in found])),
            read_only(np.repeat(np.arange(-1, len(bodies)), [len(edges) for edges in found])),
            tuple(name for edges in found for name in edges.names), tuple(bodies), tuple(found),
        )  # fmt: skip

    def __len__(self) -> int:
        return len(self.names)

    def pairs(self) -> tuple[Integers, Integers]:
        """Edges (n, 2) of one object that share a face, in either order, and which face of each that is, 0 or 1."""
        first = np.cumsum([0, *(len(edges) for edges in self.parts)])
        found = [edges.pairs() for edges in self.parts]
        return (
            np.concatenate([pair + f for (pair, _), f in zip(found, first[:-1], strict=True)]),
            np.concatenate([face for _, face in found]),
        )

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

    def _of_bodies(self, edge: Integers) -> list[tuple[int, NDArray[np.int64]]]:
        return [(body, rows) for body, rows in by_value(self.owner[edge]) if body != ROOM]


@dataclass(frozen=True, slots=True, eq=False)
class EdgePoint(ByRow):
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
