"""Which paths are there: hits on mirrors, and legs that nothing crosses, each at the time when sound is there."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Bools, ByRow, Floats, Rows, by_value
from clsim.paths.legs.events import Events
from clsim.paths.legs.mirrors import ROOM, Mirrors
from clsim.paths.visibility.clearance import edges_apart
from clsim.paths.visibility.occlusion import INNER
from clsim.paths.visibility.rates import FAR, Pace, lasts, middle_of
from clsim.scene.body import Body
from clsim.scene.room.walls import INSIDE, Walls

_ON_PLANE = 1e-6  # m, by which an event may lie off the mirror that it is at, and a leg that runs along a face off this
_IN_PLANE = 1e-10  # m, within which the end of a leg is in the plane of a face
_STEPS = 2  # of the secant's towards where a leg meets a face that turns
_SPARE = 1.01  # of a body's radius, for legs that are curved as it sees them


@dataclass(frozen=True, slots=True, eq=False)
class Legs(ByRow):
    """Straight ways of sound, n of them: from and to where, (n, 3) m, and when, (n,) s."""

    start: Floats
    stop: Floats
    left: Floats
    arrived: Floats


@dataclass(frozen=True, slots=True, eq=False)
class LegDrift(ByRow):
    """Upper bounds of the rates at which n legs change, per time of reception."""

    start: Floats  # (n,) how fast their ends move in the room, m/s
    stop: Floats  # likewise
    dilation: Floats  # (n,) of times at which sound is on them to that of reception
    held: Bools  # (n, B, 2) whether bodies hold their starts and stops where they are
    pace: Pace  # of all that moves


DriftOf = Callable[[int, Rows], LegDrift]


@dataclass(frozen=True, slots=True, eq=False)
class LocalDrift(ByRow):
    """Upper bounds of the rates of n legs in a body's frame, m/s: at their ends, and between them beyond those."""

    start: Floats
    stop: Floats
    extra: Floats
    curved: Floats
    half: Floats


@dataclass(frozen=True, slots=True, eq=False)
class Obstacles:
    """What reflects and hides in a scene."""

    mirrors: Mirrors  # walls and faces
    walls: tuple[Walls, ...]  # faces of each body, and the walls of the room, the last owner
    convex: bool  # whether no wall of the room hides anything in it

    def there(self, surfaces: NDArray[np.signedinteger[Any]], events: Events, times: Floats) -> Bools:
        """Mask (P, T) of valid paths by mirrors (P, N), received at times (P, T)."""
        order = np.sum(surfaces >= 0, axis=1)
        inner = (events.share > 0.0) & (events.share < 1.0) | (surfaces < 0)[:, None]
        ok = np.array(np.all(inner, axis=2))
        when = times[..., None] + events.time
        for k in range(surfaces.shape[1]):
            for surface in np.unique(surfaces[:, k][surfaces[:, k] >= 0]).tolist():
                p, t = np.nonzero(ok & (surfaces[:, k] == surface)[:, None])
                ok[p, t] = self._holds(surface, events.place[p, t, k + 1], when[p, t, k + 1])
        p, t = np.nonzero(ok)
        ok[p, t] = self.free(events.place[p, t], when[p, t], surfaces[p], order[p], None)[0]
        return ok

    def free(
        self, place: Floats, when: Floats, mirrors: NDArray[Any], order: Rows, drift: DriftOf | None
    ) -> tuple[Bools, Floats]:
        """Mask of paths that nothing blocks between their corners, and the time for which that is certain, (n,) s.

        Shapes: place (n, V, 3) m and when (n, V) s, of corners; mirrors (n, V - 2) at them, -1 for none; order (n,) of
        these. drift: takes a leg and rows, and bounds how fast the legs of these rows change.
        """
        free, sure = np.ones(len(when), dtype=bool), np.full(len(when), FAR)
        met = np.pad(mirrors, ((0, 0), (1, 1)), constant_values=-1)
        for leg in range(when.shape[1] - 1):
            some = np.flatnonzero(free & (order >= leg))
            legs = Legs(place[some, leg], place[some, leg + 1], when[some, leg], when[some, leg + 1])
            changes = None if drift is None else drift(leg, some)
            blocked, certain = self.evaluated(legs, met[some, leg], met[some, leg + 1], changes)
            free[some] = ~blocked
            sure[some] = np.where(blocked, certain, np.minimum(sure[some], certain))
        return free, sure

    def evaluated(
        self, legs: Legs, first: NDArray[Any], last: NDArray[Any], drift: LegDrift | None
    ) -> tuple[Bools, Floats]:
        """Mask of legs between mirrors, -1 for none, that something blocks, and for how long that is certain, s."""
        found, sure = np.zeros(len(legs.left), dtype=bool), np.full(len(legs.left), FAR)
        if not self.convex:
            room = self.walls[ROOM]
            plane = np.append(room.plane, -1)
            ends = [plane[np.where(x < len(room), x, -1)] for x in (first, last)]
            local = None if drift is None else local_drift(None, legs, legs.start, legs.stop, drift)
            skipped = (ends[0][:, None] == room.plane) | (ends[1][:, None] == room.plane)
            found, sure = _faced(room, skipped, legs.start, legs.stop, None, local)
        owner = np.append(self.mirrors.owner, ROOM)  # the last row is that of no mirror
        for body, (thing, face) in enumerate(zip(self.mirrors.bodies, self.mirrors.first.tolist(), strict=True)):
            rows = np.flatnonzero(~found)
            one, other = (np.where(owner[x[rows]] == body, x[rows] - face, -1) for x in (first, last))
            slack_of = None if drift is None else (body, drift.part(rows))
            hit, certain = hidden_by(thing, legs.part(rows), one, other, slack_of)
            found[rows], sure[rows] = hit, np.where(hit, certain, np.minimum(sure[rows], certain))
        return found, sure

    def border(self, surface: int, places: Floats, times: Floats) -> tuple[Bools, Floats, Floats]:
        """Mask of places (n, 3) on a mirror at times (n,), and distances from its border and the body's middle, m."""
        walls, face, own = self.walls[self.mirrors.owner[surface]], *self._seen(surface, places, times)
        twins = walls.twin[walls.first_twin[face] : walls.first_twin[face + 1]].tolist()
        apart = np.min([edges_apart(walls.edges_of(each), own, own) for each in (face, *twins)], axis=0)
        body = int(self.mirrors.owner[surface])
        middle = 0.0 if body == ROOM else middle_of(self.mirrors.bodies[body]).place
        return self._holds(surface, places, times), apart, np.linalg.norm(own - middle, axis=1)

    def _seen(self, surface: int, places: Floats, times: Floats) -> tuple[int, Floats]:
        """Return the number of a mirror in the room or on its body, and places at times in the coordinates of that."""
        body = int(self.mirrors.owner[surface])
        if body == ROOM:
            return surface, places
        return surface - int(self.mirrors.first[body]), self.mirrors.bodies[body].seen(places, times)

    def _holds(self, surface: int, places: Floats, times: Floats) -> Bools:
        """Mask of places (n, 3) of events at times (n,) that are on a mirror; events not found lie off its plane."""
        walls, face, places = self.walls[self.mirrors.owner[surface]], *self._seen(surface, places, times)
        held: Bools = walls.holds(face, places) & (
            np.abs(places @ self.mirrors.normal[surface] - self.mirrors.offset[surface]) < _ON_PLANE
        )
        for twin in walls.twin[walls.first_twin[face] : walls.first_twin[face + 1]]:
            held &= ~walls.holds(int(twin), places)
        return held


def hidden_by(
    body: Body, legs: Legs, first: NDArray[Any], last: NDArray[Any], drift: tuple[int, LegDrift] | None = None
) -> tuple[Bools, Floats]:
    """Mask of legs that a body blocks, and the time for which that is certain, (n,) s.

    The `first` and `last` (n,) faces of the body, at which they begin and end, are in the way of none, -1 for none.
    Without a `drift`, the number of the body and how fast legs change, nothing is certain.
    As the body sees it a leg is straight while the body goes evenly, and curved by ``w d² / (4 c)`` while it turns: on
    which side of a face its ends are is known, and where it passes that is found by the secant's method. What only the
    curve touches, and not the ends, is not seen.
    """
    walls, found = body.mesh.walls, np.zeros(len(legs.left), dtype=bool)
    middle = middle_of(body)
    reach = _SPARE * middle.radius + 0.5 * middle.fastest * np.abs(legs.arrived - legs.left)
    passed = body.placed(middle.place, 0.5 * (legs.left + legs.arrived))
    beside = np.linalg.norm(passed - _nearest(passed, legs.start, legs.stop), axis=1) - reach
    sure, around = np.zeros(len(found)), beside <= 0.0
    if drift is not None:
        number, all_drift = drift
        moved = np.maximum(all_drift.start, all_drift.stop) + all_drift.dilation * all_drift.pace.speed[:, number]
        sure = np.where(beside > 0.0, lasts(np.maximum(beside, 0.0), moved), 0.0)  # at rest, too
        around = (beside <= 0.0) | (sure < all_drift.pace.half)
    near = np.flatnonzero(around)
    some = legs.part(near)
    start, stop = body.seen(some.start, some.left), body.seen(some.stop, some.arrived)
    from_middle, local = (start - middle.place, stop - middle.place), None
    if drift is not None:
        local = local_drift(number, some, *from_middle, all_drift.part(near))
    plane = np.append(walls.plane, -1)
    ends = plane[first[near]], plane[last[near]]
    skipped = (ends[0][:, None] == walls.plane) | (ends[1][:, None] == walls.plane)
    turning = (body, some) if body.trajectory.turns else None
    found[near], certain = _faced(walls, skipped, start, stop, turning, local)
    sure[near] = np.where(found[near], certain, np.maximum(sure[near], certain))
    return found, sure


def local_drift(body: int | None, legs: Legs, start: Floats, stop: Floats, drift: LegDrift) -> LocalDrift:
    """Rates of legs between places (n, 3) as seen from a body's middle; None is the room.

    A point x of a leg at a fixed share moves by no more than the shares of its ends. The body's own field of velocities
    is linear in x, but for how it changes while sound is on the leg, by its accelerations, and for what it is faster at
    one end by the dilation of time. Seen from the body the leg is curved by ``(2 w d T + T² (a + 2 w v + (w² + l) y)) /
    8`` at the most.
    """
    pace, late = drift.pace, drift.dilation
    if body is None:
        return LocalDrift(drift.start, drift.stop, np.zeros(len(late)), np.zeros(len(late)), pace.half)
    speed, turn, gain, lift, jolt, twist = (
        x[:, body] for x in (pace.speed, pace.turn, pace.gain, pace.lift, pace.jolt, pace.twist)
    )
    ends, far = [], np.zeros(len(late))
    for i, (place, moved) in enumerate(((start, drift.start), (stop, drift.stop))):
        away = np.linalg.norm(place, axis=1) + pace.half * (moved + late * speed)
        ends.append(np.where(drift.held[:, body, i], 0.0, moved + late * (speed + turn * away)))
        far = np.maximum(far, away)
    length = np.linalg.norm(legs.stop - legs.start, axis=1) + pace.half * (drift.start + drift.stop)
    while_on = np.abs(legs.arrived - legs.left) + 2.0 * pace.half * (late - 1.0)
    uneven = jolt + twist * far
    extra = while_on * (gain + lift * far) + uneven + 2.0 * (late - 1.0) * (speed + turn * far)
    curved = 2.0 * turn * length * while_on + while_on**2 * (gain + 2.0 * turn * speed + (lift + turn**2) * far)
    return LocalDrift(ends[0], ends[1], extra, 0.125 * curved + 0.25 * while_on * uneven, pace.half)


def _faced(
    walls: Walls, skipped: Bools, start: Floats, stop: Floats, turning: tuple[Body, Legs] | None,
    drift: LocalDrift | None,
) -> tuple[Bools, Floats]:  # fmt: skip
    """Mask of legs (n,), in their own coordinates, that faces block, and the time for which that is certain, s.

    Those that are `skipped` (n, faces) are in the way of none.
    What blocks does so while both ends keep their sides and the place where the way meets the face does not cross its
    border. What is free stays so while both ends keep to one side; or while a way that goes beside the face does not
    touch its border, in the plane or in space.
    """
    heights = [x @ walls.normal.T - walls.offset for x in (start, stop)]
    hit, crossed = np.zeros(skipped.shape, dtype=bool), _crossed(*heights) & ~skipped
    crossed_leg, face = np.nonzero(crossed)
    share = heights[0][crossed_leg, face] / (heights[0][crossed_leg, face] - heights[1][crossed_leg, face])
    places = start[crossed_leg] + share[:, None] * (stop[crossed_leg] - start[crossed_leg])
    if turning is not None and len(crossed_leg):
        places = _met_turning(walls, turning, crossed_leg, face, share, [h[crossed_leg, face] for h in heights])
    along = np.any(np.maximum(*np.abs(heights)) < _ON_PLANE, axis=1)  # a face: no other hides what passes its border
    for each, grazes in product(np.unique(face).tolist(), (False, True)):
        these = np.flatnonzero((face == each) & (along[crossed_leg] == grazes))
        hit[crossed_leg[these], each] = walls.holds(each, places[these], 0.0 if grazes else INSIDE)
    found = np.any(hit, axis=1)
    if drift is None:
        return found, np.zeros(len(found))
    sides = np.minimum(*(lasts(np.abs(h), x[:, None]) for h, x in zip(heights, (drift.start, drift.stop), strict=True)))
    sure = _past(walls, heights, (start, stop), drift, sides, skipped | found[:, None])
    used = ~found[crossed_leg] | hit[crossed_leg, face]
    crossed_leg, face, places, share = crossed_leg[used], face[used], places[used], share[used]
    border = np.empty(len(crossed_leg))
    for each, these in by_value(face):
        border[these] = edges_apart(walls.edges_of(each), places[these], places[these])
    high, ends = [h[crossed_leg, face] for h in heights], (start[crossed_leg], stop[crossed_leg])
    border = lasts(border, _slides(high, ends, share, drift.part(crossed_leg)))
    kept, past = np.minimum(border, sides[crossed_leg, face]), np.maximum(sure[crossed_leg, face], border)
    sure[crossed_leg, face] = np.where(hit[crossed_leg, face], kept, past)
    blocked = np.where(hit, sure, 0.0).max(axis=1, initial=0.0)
    return found, np.where(found, blocked, np.where(skipped, FAR, sure).min(axis=1, initial=FAR))


def _past(
    walls: Walls, heights: list[Floats], ends: tuple[Floats, Floats], drift: LocalDrift, sides: Floats, done: Bools
) -> Floats:
    """Return for how long ways surely go past faces (n, faces), but for those that are done, s."""
    start, stop = ends
    fast = (np.maximum(drift.start, drift.stop) + drift.extra)[:, None]
    apart = np.linalg.norm(_nearest(walls.centre, start[:, None], stop[:, None]) - walls.centre, axis=2)
    sure = lasts(np.maximum(apart - walls.radius - drift.curved[:, None], 0.0), np.broadcast_to(fast, apart.shape))
    sure = np.where(heights[0] * heights[1] > 0.0, np.maximum(sure, sides), sure)
    crossed_leg, face = np.nonzero((sure < drift.half[:, None]) & ~done)
    for each, these in by_value(face):
        p = crossed_leg[these]
        reach = _beside(walls, each, start[p], stop[p], [h[p, each] for h in heights]) - drift.curved[p]
        sure[p, each] = np.maximum(sure[p, each], lasts(np.maximum(reach, 0.0), fast[p, 0]))
    return sure


def _beside(walls: Walls, face: int, start: Floats, stop: Floats, heights: list[Floats]) -> Floats:
    """Return distances (n,) of straight ways that do not meet a face from it, m."""
    apart = edges_apart(walls.edges_of(face), start, stop)
    for place, height in zip((start, stop), heights, strict=True):
        foot = place - height[:, None] * walls.normal[face]
        apart = np.where(walls.holds(face, foot), np.minimum(apart, np.abs(height)), apart)
    return apart


def _slides(heights: list[Floats], ends: tuple[Floats, Floats], share: Floats, drift: LocalDrift) -> Floats:
    """Largest speeds of the points where legs meet the planes of faces, (n,) m/s."""
    moved = (1.0 - share) * drift.start + share * drift.stop + drift.extra
    length = np.linalg.norm(ends[1] - ends[0], axis=1)
    slope = np.abs(heights[0] - heights[1]) - 4.0 * drift.curved
    return np.asarray(np.where(slope > 0.0, moved * (1.0 + length / np.where(slope > 0.0, slope, 1.0)), FAR))


def _nearest(points: Floats, start: Floats, stop: Floats) -> Floats:
    """Return the places (..., 3) of ways that are nearest to points, m."""
    along = stop - start
    share = np.sum((points - start) * along, axis=-1) / np.maximum(np.sum(along * along, axis=-1), 1e-300)
    return np.asarray(start + np.clip(share, 0.0, 1.0)[..., None] * along)


def _crossed(first: Floats, last: Floats) -> Bools:
    """Mask of legs that cross planes strictly between their endpoints, at these heights over them.

    A leg to an edge ends in the planes of its faces but for rounding, and along one of them it is as near all the way.
    """
    crosses = (first * last < 0.0) & (np.minimum(np.abs(first), np.abs(last)) > _IN_PLANE)
    share = first / np.where(crosses, first - last, 1.0)
    return np.asarray(crosses & (share > INNER) & (share < 1.0 - INNER))


def _met_turning(
    walls: Walls, turning: tuple[Body, Legs], crossed_leg: Rows, face: Rows, share: Floats, heights: list[Floats]
) -> Floats:
    """Points where legs meet the planes of a turning body's faces, in the body's axes, (n, 3) m."""
    body, legs = turning[0], turning[1].part(crossed_leg)
    normal, offset, apart = walls.normal[face], walls.offset[face], heights[0] - heights[1]
    for step in range(_STEPS + 1):
        place = legs.start + share[:, None] * (legs.stop - legs.start)
        own = body.seen(place, legs.left + share * (legs.arrived - legs.left))
        if step < _STEPS:
            share = np.clip(share + (np.sum(own * normal, axis=1) - offset) / apart, 0.0, 1.0)
    return own
