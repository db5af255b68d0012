"""Which paths are there: hits on mirrors, and legs that nothing crosses, each at the time when sound is there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.paths.moving.mirrors import ROOM, Mirrors
from clsim.paths.specular.occlusion import INNER

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Floats
    from clsim.paths.moving.events import Events
    from clsim.scene.body import Body
    from clsim.scene.room.walls import Walls
    from clsim.scene.scene import Scene

    Bools = NDArray[np.bool_]
    Rows = NDArray[np.int64]

_STEPS = 2  # of the secant's towards where a leg meets a face that turns
_SPARE = 1.01  # of a body's radius, for legs that are curved as it sees them


@dataclass(frozen=True, slots=True, eq=False)
class Legs:
    """Straight ways of sound, n of them: from and to where, (n, 3) m, and when, (n,) s."""

    start: Floats
    stop: Floats
    left: Floats
    arrived: Floats

    def part(self, rows: Rows) -> Legs:
        """Return some of them."""
        return Legs(self.start[rows], self.stop[rows], self.left[rows], self.arrived[rows])


@dataclass(frozen=True, slots=True, eq=False)
class Obstacles:
    """What reflects and hides in a scene.

    Attributes
    ----------
    mirrors : Mirrors
        Walls and faces.
    walls : Walls
        Of the room.
    convex : bool
        Whether no wall of the room hides anything in it.
    """

    mirrors: Mirrors
    walls: Walls
    convex: bool

    @staticmethod
    def of(scene: Scene) -> Obstacles:
        """Return those of a scene."""
        return Obstacles(Mirrors.of(scene), scene.room.as_mesh().walls, scene.room.is_convex)

    def there(self, surfaces: NDArray[np.signedinteger[Any]], events: Events, times: Floats) -> Bools:
        """Return which paths by mirrors (P, N), of what is received at times (P, T), are there, (P, T)."""
        order = np.sum(surfaces >= 0, axis=1)
        inner = (events.share > 0.0) & (events.share < 1.0) | (surfaces < 0)[:, None]
        ok = np.array(np.all(inner, axis=2))
        when = times[..., None] + events.time
        for k in range(surfaces.shape[1]):
            for surface in np.unique(surfaces[:, k][surfaces[:, k] >= 0]).tolist():
                p, t = np.nonzero(ok & (surfaces[:, k] == surface)[:, None])
                ok[p, t] = self._holds(surface, events.place[p, t, k + 1], when[p, t, k + 1])
        for leg in range(surfaces.shape[1] + 1):
            p, t = np.nonzero(ok & (order >= leg)[:, None])
            legs = Legs(*(x[p, t, leg + i] for x in (events.place, when) for i in (0, 1)))
            padded = np.pad(surfaces, ((0, 0), (1, 1)), constant_values=-1)
            ok[p, t] = ~self.blocked(legs, padded[p, leg], padded[p, leg + 1])
        return ok

    def blocked(self, legs: Legs, first: NDArray[Any], last: NDArray[Any]) -> Bools:
        """Return which legs (n,) between mirrors, -1 for none, a wall or a body is in the way of, (n,)."""
        found = np.zeros(len(legs.left), dtype=bool)
        if not self.convex:
            plane = np.append(self.walls.plane, -1)
            ends = [plane[np.where(x < len(self.walls), x, -1)] for x in (first, last)]
            for wall in range(len(self.walls)):
                rows = np.flatnonzero(~found & (ends[0] != plane[wall]) & (ends[1] != plane[wall]))
                rows = rows[_crossed(self.walls, wall, legs.start[rows], legs.stop[rows])]
                found[rows] = self.walls.holds(wall, _met(self.walls, wall, legs.part(rows))) if len(rows) else False
        for body, (thing, face) in enumerate(zip(self.mirrors.bodies, self.mirrors.first.tolist(), strict=True)):
            rows = np.flatnonzero(~found)
            local = [np.where(self.mirrors.owner[x[rows]] == body, x[rows] - face, -1) for x in (first, last)]
            local = [np.where(x[rows] < 0, -1, own) for x, own in zip((first, last), local, strict=True)]
            found[rows] = hidden_by(thing, legs.part(rows), *local)
        return found

    def _holds(self, surface: int, places: Floats, times: Floats) -> Bools:
        """Return which places (n, 3) in the plane of a mirror at times (n,) are on it."""
        body = int(self.mirrors.owner[surface])
        if body == ROOM:
            walls, face = self.walls, surface
        else:
            thing = self.mirrors.bodies[body]
            walls, face = thing.mesh.walls, surface - int(self.mirrors.first[body])
            places = thing.seen(places, times)
        held = walls.holds(face, places)
        for twin in walls.twin[walls.first_twin[face] : walls.first_twin[face + 1]]:
            held &= ~walls.holds(int(twin), places)
        return held


def hidden_by(body: Body, legs: Legs, first: NDArray[Any], last: NDArray[Any]) -> Bools:
    """Return which legs a body is in the way of.

    Parameters
    ----------
    body : Body
        Which.
    legs : Legs
        n of them.
    first, last : ndarray (n,) int
        Faces of the body that they begin and end at, which are in the way of none, -1 for none.

    Notes
    -----
    As the body sees it a leg is straight while the body goes evenly, and curved by ``w d² / (4 c)`` while it turns: on
    which side of a face its ends are is known, and where it passes that is found by the secant's method. What only the
    curve touches, and not the ends, is not seen.
    """
    walls, found = body.mesh.walls, np.zeros(len(legs.left), dtype=bool)
    near = np.flatnonzero(
        _apart(body.trajectory.position(0.5 * (legs.left + legs.arrived)), legs) <= _reach(body, legs)
    )
    some = legs.part(near)
    start, stop = body.seen(some.start, some.left), body.seen(some.stop, some.arrived)
    plane = np.append(walls.plane, -1)
    ends = plane[first[near]], plane[last[near]]
    for face in range(len(walls)):
        rows = np.flatnonzero(~found[near] & (ends[0] != plane[face]) & (ends[1] != plane[face]))
        rows = rows[_crossed(walls, face, start[rows], stop[rows])]
        if not len(rows):
            continue
        ways = Legs(start[rows], stop[rows], some.left[rows], some.arrived[rows])
        places = _met(walls, face, ways)
        if body.trajectory.turns:
            places = _met_turning(body, face, some.part(rows), ways)
        found[near[rows]] = walls.holds(face, places)
    return found


def _reach(body: Body, legs: Legs) -> Floats:
    """Return within which distance of the body's origin half way legs may meet it, m."""
    moved = body.peak_speed * 0.5 * np.abs(legs.arrived - legs.left)
    return np.asarray(_SPARE * body.radius + moved)


def _apart(points: Floats, legs: Legs) -> Floats:
    """Return the distances (n,) of points from legs, m."""
    along = legs.stop - legs.start
    share = np.sum((points - legs.start) * along, axis=1) / np.maximum(np.sum(along * along, axis=1), 1e-300)
    nearest = legs.start + np.clip(share, 0.0, 1.0)[:, None] * along
    return np.asarray(np.linalg.norm(points - nearest, axis=1))


def _heights(walls: Walls, wall: int, *places: Floats) -> list[Floats]:
    return [x @ walls.normal[wall] - walls.offset[wall] for x in places]


def _crossed(walls: Walls, wall: int, start: Floats, stop: Floats) -> Bools:
    """Return which ways go through the plane of a wall strictly between their ends."""
    first, last = _heights(walls, wall, start, stop)
    crosses = first * last < 0.0
    share = first / np.where(crosses, first - last, 1.0)
    return np.asarray(crosses & (share > INNER) & (share < 1.0 - INNER))


def _met(walls: Walls, wall: int, legs: Legs) -> Floats:
    """Return where straight ways through its plane meet a wall, (n, 3) m."""
    first, last = _heights(walls, wall, legs.start, legs.stop)
    return np.asarray(legs.start + (first / (first - last))[:, None] * (legs.stop - legs.start))


def _met_turning(body: Body, face: int, legs: Legs, own: Legs) -> Floats:
    """Return where legs through its plane meet a face of a body that turns, as the body sees it, (n, 3) m."""
    first, last = _heights(body.mesh.walls, face, own.start, own.stop)
    share = first / (first - last)
    for _ in range(_STEPS):
        time = legs.left + share * (legs.arrived - legs.left)
        place = body.seen(legs.start + share[:, None] * (legs.stop - legs.start), time)
        share = np.clip(share + _heights(body.mesh.walls, face, place)[0] / (first - last), 0.0, 1.0)
    time = legs.left + share * (legs.arrived - legs.left)
    return body.seen(legs.start + share[:, None] * (legs.stop - legs.start), time)
