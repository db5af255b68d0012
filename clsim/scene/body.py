"""Rigid things with flat faces that move through the room: doors, plates, robots."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from clsim.arrays import LARGEST_ROOM, Floats, as_floats
from clsim.errors import InputError, check_kind, check_name, counted, inside, settle
from clsim.numerics.quaternions import rotate
from clsim.scene.ends import Receiver, Source, in_face
from clsim.scene.material.material import Material
from clsim.scene.motion.instants import Instants
from clsim.scene.motion.motion import Moved, even_lengths, seen_by
from clsim.scene.motion.trajectory import Trajectory, as_places
from clsim.scene.placement import TOUCHING, Placed, check_lasts, first_refused
from clsim.scene.room.mesh import MeshRoom
from clsim.scene.room.protocol import Room, is_room

End = TypeVar("End", Source, Receiver)
_SHEET = (0, 1, 3, 2)  # corners of the face of a box on one side of an axis, around it
_SIDES = ("min", "max")
_SHORTEST = 1e-5  # m, of a box: faces of less have no area
_STEP = 0.01  # m, which a body goes from one look to the next
_RATE = 1000.0  # Hz, at which speeds are looked at
_AT_A_TIME = 256  # instants
_FRAME = np.concatenate([np.zeros((1, 3)), np.eye(3)])  # origin and axes


@dataclass(frozen=True, slots=True, eq=False)
class Body(Moved):
    """A rigid, moving object of flat faces. It reflects sound, and blocks paths behind it.

    Parameters
    ----------
    name : str
        Unique among the scene's bodies.
    mesh : MeshRoom
        Its faces in its own coordinates, m, with their materials; it may be open, and faces have two sides. Another
        `Room` is kept as its mesh.
    trajectory : Trajectory
        Position of the origin of its coordinates, and their orientation.

    Attributes
    ----------
    radius : float
        Radius of the bounding sphere about the origin of its coordinates, m.
    lever : float
        Bound of the distance of its points from the axes about which it turns, m.
    """

    name: str
    mesh: MeshRoom
    trajectory: Trajectory
    radius: float = field(init=False)
    lever: float = field(init=False)
    flush: ClassVar[bool] = False  # it sits in no wall

    def __post_init__(self) -> None:
        check_name(self.name)
        mesh: Any = self.mesh
        if not is_room(mesh):
            raise InputError("mesh", f"must be a MeshRoom or another Room, but is {self.mesh!r:.80}")
        check_kind("trajectory", self.trajectory, Trajectory, "a Trajectory")
        self.trajectory.check_start()
        settle(self, mesh=mesh.as_mesh())
        corners, turning = self.mesh.vertices, self.trajectory.turning
        radius = float(np.linalg.norm(corners, axis=1).max())
        settle(self, radius=radius, lever=0.0 if turning is None else turning.lever(corners))

    @staticmethod
    def box(
        name: str, size: ArrayLike, material: Material, trajectory: Trajectory, centre: ArrayLike = (0.0, 0.0, 0.0)
    ) -> Body:
        """Return a box, or a sheet.

        Parameters
        ----------
        size : array_like (3,)
            Lengths along its own x, y and z, m, at least 1e-5; one of them may be 0, and then it is a sheet of two
            sides.
        material : Material
            Material of all faces.
        centre : array_like (3,)
            Centre of the box in its own coordinates, m.

        Examples
        --------
        >>> from clsim import Material
        >>> wood = Material.from_reflection(0.9)
        >>> hinge = Trajectory.swing((2, 0, 0), (0, 0, 1), [0.0, 1.5], [0.0, 2.0])
        >>> door = Body.box("door", (0.9, 0.0, 2.0), wood, hinge, centre=(0.5, 0.0, 1.0))
        >>> door.faces, door.radius.__round__(3)
        (('door',), 2.214)
        """
        lengths = as_floats("size", size, (3,), within=LARGEST_ROOM, unit="m")
        thin = np.flatnonzero(lengths == 0.0)
        if np.any((lengths < _SHORTEST) & (lengths != 0.0)) or len(thin) > 1:
            given = ", ".join(f"{x:g}" for x in lengths)
            problem = f"must be at least {_SHORTEST:g} m, or 0 along one axis for a sheet, but is {given} m"
            raise InputError("size", problem)
        corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)]) * lengths
        number = np.arange(8).reshape(2, 2, 2)
        triangles, labels = [], []
        for axis, side in [(int(thin[0]), 0)] if len(thin) else [(a, s) for a in range(3) for s in (0, 1)]:
            face = np.take(number, side, axis=axis).ravel()[list(_SHEET)]
            triangles += [face[[0, 1, 2]], face[[0, 2, 3]]]
            labels += 2 * ["" if len(thin) else f"{'xyz'[axis]}_{_SIDES[side]}"]
        place = as_places("centre", centre, (3,))
        return Body(name, MeshRoom(corners + place, np.array(triangles), material, labels=labels), trajectory)

    @property
    def faces(self) -> tuple[str, ...]:
        """Names of its faces, with its own before them; its own alone where it has one face."""
        names = self.mesh.faces.names
        return (self.name,) if len(names) == 1 else tuple(f"{self.name} {name}" for name in names)

    @property
    def is_static(self) -> bool:
        """Whether it neither moves nor turns."""
        return self.trajectory.is_static and not self.trajectory.turns

    @property
    def peak_speed(self) -> float:
        """Bound of the speed of any point of it, m/s."""
        motion = self.trajectory
        moved = 0.0 if motion.is_static else float(motion.speed_over(np.array([-1e9]), np.array([1e9]))[0])
        return moved + motion.peak_turn * self.lever

    def speed(self, times: Floats) -> Floats:
        """Return bounds of the speed of any point of it at `times` (n,) s, m/s."""
        turning = np.linalg.norm(self.trajectory.angular_velocity(times), axis=-1)
        return np.asarray(np.linalg.norm(self.trajectory.velocity(times), axis=-1) + self.lever * turning)

    def describe(self) -> list[str]:
        """Return a description in one line."""
        low, high = self.mesh.extent
        size = " x ".join(f"{x:.4g}" for x in high - low)
        moves = "at rest" if self.is_static else f"no point of it faster than {self.peak_speed:.3g} m/s"
        return [f"body {self.name!r}: {counted(len(self.mesh.walls), 'face')}, {size} m, {moves}"]

    def placed(self, points: Floats, time: Floats) -> Floats:
        """Return room positions at `time` (...) s of `points` (..., 3) in the body's own coordinates, m."""
        return self.trajectory.position(time) + rotate(self.trajectory.orientation(time), points)

    def seen(self, places: Floats, time: Floats) -> Floats:
        """Return `places` (..., 3) of the room in its own coordinates at `time` (...) s, m."""
        back = self.trajectory.orientation(time) * np.array([-1.0, -1.0, -1.0, 1.0])
        return rotate(back, places - self.trajectory.position(time))


def with_carriers(ends: Sequence[End], bodies: Sequence[Body]) -> tuple[End, ...]:
    """Return sources and receivers with their trajectories in the room; mounted ones follow their bodies."""
    found = {body.name: body for body in bodies}
    carried = []
    for i, end in enumerate(ends):
        kind = "sources" if isinstance(end, Source) else "receivers"
        if end.mounted_on is None:
            carried.append(end)
            continue
        if end.mounted_on not in found:
            known = ", ".join(map(repr, found)) or "there are none"
            raise InputError(f"{kind}[{i}].mounted_on", f"must name a body ({known}), but is {end.mounted_on!r:.80}")
        body = found[end.mounted_on]
        with inside(f"{kind}[{i}]"):
            own = in_face(body.mesh, end)
        motion = Trajectory.carried(body.trajectory, own, end.aim)
        carried.append(replace(end, trajectory=motion, aim=None, mounted_on=None, flush=False))
    return tuple(carried)


def check_bodies(
    room: Room, bodies: Sequence[tuple[str, Body]], others: Sequence[tuple[str, Placed]], slowest: float
) -> None:
    """Refuse bodies that end before a signal, are as fast as sound, or go through walls, each other or other things."""
    # Shapes: bodies (str, Body); others (str, Source or Receiver or Scatterer).
    last = max((item.end for _, item in others if isinstance(item, Source)), default=0.0)
    mesh = room.as_mesh() if bodies else None
    for i, (field_name, body) in enumerate(bodies):
        _check_motion(field_name, body, last, slowest)
        assert mesh is not None
        _check_walls(field_name, body, room, mesh)
        for _, other in bodies[:i]:
            _check_other(field_name, body, other)
        for _, thing in others:
            _check_thing(field_name, body, thing)


def _check_motion(field_name: str, body: Body, last: float, slowest: float) -> None:
    check_lasts(field_name, body.trajectory, last, "all signals, which end")
    if body.peak_speed >= slowest:
        times = np.linspace(*body.time_range, 10_001)
        speed = body.speed(times)
        problem = f"must keep every point below the speed of sound, {slowest:.6g} m/s, but {body.name!r} may move at "
        problem += f"{body.peak_speed:.6g} m/s, about {times[np.argmax(speed)]:.6g} s"
        raise InputError(f"{field_name}.trajectory", problem)


def _evaluations(bodies: Sequence[Body]) -> Floats:
    """Return sampling times between which bodies move at most `_STEP`, s."""
    last = min((b.trajectory.end for b in bodies if not b.is_static and math.isfinite(b.trajectory.end)), default=0.0)
    instants = np.arange(math.ceil(max(last, 0.0) * _RATE) + 1) / _RATE
    speed = sum(body.speed(instants) for body in bodies)
    return np.minimum(even_lengths(np.asarray(speed), _RATE, _STEP), max(last, 0.0))


def _check_walls(field_name: str, body: Body, room: Room, mesh: MeshRoom) -> None:
    """Refuse a body that goes through a wall of the room."""
    times = _evaluations([body])
    for some in np.array_split(times, -(-len(times) // _AT_A_TIME)):
        corners = body.placed(body.mesh.vertices[None], some[:, None])
        if room.is_convex:
            faces = room.faces
            deep = (faces.offsets - corners @ faces.normals.T).max(axis=1)
            if deep.max() > TOUCHING:
                i = int(np.argmax(deep.max(axis=1) > TOUCHING))
                wall = int(np.argmax(deep[i]))
                name = f"the wall {faces.names[wall]!r} by {deep[i, wall]:.3g} m"
                raise _met(field_name, body, name, float(some[i]))
            continue
        low, high = corners.min(axis=1), corners.max(axis=1)
        centre, reach = 0.5 * (low + high), 0.5 * np.linalg.norm(high - low, axis=1)
        for time in some[mesh.clearance(centre) <= reach]:
            met = _crossing(mesh, body, body.placed(_FRAME, np.array(time)))
            if met is not None:
                raise _met(field_name, body, f"the wall {mesh.faces.names[met]!r}", float(time))


def _check_other(field_name: str, body: Body, other: Body) -> None:
    """Refuse a body that goes through another one."""
    reach = body.radius + other.radius
    for time in _evaluations([body, other]):
        frame = other.seen(body.placed(_FRAME, np.array(time)), np.array(time))
        if np.linalg.norm(frame[0]) <= reach and _crossing(other.mesh, body, frame) is not None:
            raise _met(field_name, body, repr(other.name), float(time))


def _crossing(mesh: MeshRoom, body: Body, frame: Floats) -> int | None:
    """Return the wall of a mesh that runs through a body whose `_FRAME` is at places (4, 3) of the mesh; or None."""
    axes = frame[1:] - frame[0]
    met = _first_through(mesh, frame[0] + body.mesh.walls.edge @ axes)
    if met is not None:
        return met
    own = (mesh.walls.edge - frame[0]) @ axes.T
    if _first_through(body.mesh, own) is None:
        return None
    through = [_first_through(body.mesh, edge[None]) is not None for edge in own]
    return int(np.searchsorted(mesh.walls.first_edge, through.index(True), side="right") - 1)


def _first_through(mesh: MeshRoom, edges: Floats) -> int | None:
    """Return the first wall that any of some edges (n, 2, 3) goes through by more than touching it."""
    walls = mesh.walls
    height = edges @ walls.normal.T - walls.offset
    deep = (height[:, 0] * height[:, 1] < 0.0) & (np.abs(height).min(axis=1) > TOUCHING)
    for wall in np.flatnonzero(deep.any(axis=0)):
        mine = deep[:, wall]
        share = height[mine, 0, wall] / (height[mine, 0, wall] - height[mine, 1, wall])
        hits = edges[mine, 0] + share[:, None] * (edges[mine, 1] - edges[mine, 0])
        if walls.holds(int(wall), hits).any():
            return int(wall)
    return None


def _met(field_name: str, body: Body, what: str, time: float) -> InputError:
    return InputError(
        f"{field_name}.trajectory",
        f"must keep it out of walls and other bodies, by {TOUCHING:g} m or less, but {body.name!r} goes through {what} "
        f"at {time:.6g} s",
    )


def _check_thing(field_name: str, body: Body, thing: Placed) -> None:
    """Refuse a source, a receiver or the centre of a scatterer that is in a body, or that a face of it passes."""
    own = seen_by(body.trajectory, thing.trajectory)
    last = own.end if math.isfinite(own.end) and not own.is_static else 0.0
    instants = Instants(0.0, max(last, 0.0), _RATE)
    met = first_refused(body.mesh, own, instants)
    inside = body.mesh.is_closed and bool(body.mesh.contains(own.position(np.zeros(1)))[0])
    if met is not None or inside:
        time = 0.0 if inside else float(instants.times(np.array([met]))[0])
        raise InputError(
            f"{field_name}.trajectory",
            f"must keep off sources, receivers and scatterers, but {thing.name!r} is in {body.name!r} or meets a face "
            f"of it at {time:.6g} s",
        )
