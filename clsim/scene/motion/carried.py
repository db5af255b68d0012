"""Motions that follow from others: of points of what swings about an axis, and of what a moving thing carries."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from clsim.arrays import Floats, read_only
from clsim.numerics.quaternions import inverse, rotate
from clsim.scene.motion.curves import CONTINUATION
from clsim.scene.motion.orientation import quaternion_product

if TYPE_CHECKING:
    from clsim.scene.motion.motion import Motion
    from clsim.scene.motion.orientation import Hinge

_SPARE = 1.0 + 1e-12  # for the rounding of bounds


@dataclass(frozen=True, slots=True, eq=False)
class Swung:
    """A point that swings about an axis.

    Shapes: foot, along, across (3,) m.

    foot, along, across: the nearest point of the axis, m; from there to where it is at angle 0, and at a quarter turn,
    m.
    """

    foot: Floats
    along: Floats
    across: Floats
    hinge: Hinge

    def position(self, time: Floats) -> Floats:
        angle = self.hinge.at(time)[..., None]
        return np.asarray(self.foot + np.cos(angle) * self.along + np.sin(angle) * self.across)

    def velocity(self, time: Floats) -> Floats:
        return np.cross(self.hinge.angular_velocity(time), self.position(time) - self.foot)

    def speed_over(self, begin: Floats, end: Floats) -> Floats:
        return np.asarray(np.linalg.norm(self.along) * self.hinge.angle.speed_over(begin, end))


@dataclass(frozen=True, slots=True, eq=False)
class Carried:
    """A point mounted on a moving object, which may move in the object's frame."""

    carrier: Motion
    own: Motion

    def position(self, time: Floats) -> Floats:
        return self.carrier.position(time) + rotate(self.carrier.orientation(time), self.own.position(time))

    def velocity(self, time: Floats) -> Floats:
        turned = self.carrier.orientation(time)
        arm = rotate(turned, self.own.position(time))
        moved = self.carrier.velocity(time) + rotate(turned, self.own.velocity(time))
        return np.asarray(moved + np.cross(self.carrier.angular_velocity(time), arm))

    def speed_over(self, begin: Floats, end: Floats) -> Floats:
        speed = self.own.speed_over(begin, end)
        arm = np.linalg.norm(self.own.position(begin), axis=-1) + speed * (end - begin)
        return np.asarray((self.carrier.speed_over(begin, end) + speed + self.carrier.peak_turn * arm) * _SPARE)


@dataclass(frozen=True, slots=True, eq=False)
class CarriedTurning:
    """Orientation of something mounted on a moving object, which may turn in the object's frame.

    Shapes: aim (4,).
    """

    carrier: Motion
    own: Motion
    aim: Floats

    @property
    def turns(self) -> bool:
        return self.carrier.turns or self.own.turns

    @property
    def peak(self) -> float:
        return self.carrier.peak_turn + self.own.peak_turn

    @property
    def breaks(self) -> Floats:
        """Times at which the angular velocity may jump, s."""
        return np.union1d(*(_turn_breaks(motion) for motion in (self.carrier, self.own)))

    def lever(self, points: Floats) -> float:
        return float(np.linalg.norm(points, axis=-1).max())

    def orientation(self, time: Floats) -> Floats:
        own = quaternion_product(self.own.orientation(time), np.broadcast_to(self.aim, (*time.shape, 4)))
        return quaternion_product(self.carrier.orientation(time), own)

    def angular_velocity(self, time: Floats) -> Floats:
        own = rotate(self.carrier.orientation(time), self.own.angular_velocity(time))
        return np.asarray(self.carrier.angular_velocity(time) + own)


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """A point in the frame of a moving object."""

    frame: Motion
    point: Motion

    def position(self, time: Floats) -> Floats:
        away = self.point.position(time) - self.frame.position(time)
        return rotate(inverse(self.frame.orientation(time)), away)

    def velocity(self, time: Floats) -> Floats:
        away = self.point.position(time) - self.frame.position(time)
        moved = self.point.velocity(time) - self.frame.velocity(time)
        turned = moved - np.cross(self.frame.angular_velocity(time), away)
        return rotate(inverse(self.frame.orientation(time)), turned)

    def speed_over(self, begin: Floats, end: Floats) -> Floats:
        speed = self.point.speed_over(begin, end) + self.frame.speed_over(begin, end)
        away = np.linalg.norm(self.point.position(begin) - self.frame.position(begin), axis=-1) + speed * (end - begin)
        return np.asarray((speed + self.frame.peak_turn * away) * _SPARE)


def _turn_breaks(motion: Motion) -> Floats:
    return np.empty(0) if motion.turning is None else motion.turning.breaks


def velocity_breaks(carrier: Motion, own: Motion) -> Floats:
    """Return times (k,) at which the velocity of a mounted point may jump, s, within both motions."""
    times = np.concatenate([carrier.breaks, own.breaks, _turn_breaks(carrier)])
    first, last = max(carrier.start, own.start) - CONTINUATION, min(carrier.end, own.end) + CONTINUATION
    return read_only(np.unique(times[(times > first) & (times < last)]))


def seen_by(frame: Motion, point: Motion) -> Motion:
    """Return a motion in the frame of a moving object; a motion mounted on that object is returned as defined there."""
    from clsim.scene.motion.motion import Motion

    if isinstance(point.curve, Carried) and point.curve.carrier is frame:
        return point.curve.own
    moving = [motion for motion in (frame, point) if not motion.is_static or motion.turns]
    start, end = max((m.start for m in moving), default=0.0), min((m.end for m in moving), default=0.0)
    return Motion(Seen(frame, point), start, end)


def even_ways(speed: Floats, rate: float, step: float) -> Floats:
    """Return times (n,), s, between which objects move at most a step; first and last instants are included.

    Shapes: speed (m,) m/s.

    speed: bounds of how fast they go about instants so many per second from 0 s on, m/s.
    """
    pace = np.maximum(speed[1:], speed[:-1]) / (rate * step)  # steps from one instant to the next
    way = np.concatenate([[0.0], np.cumsum(pace)])
    instants = np.arange(len(way)) / rate
    steps = np.arange(1, int(np.ceil(way[-1])))
    rising = np.concatenate([[True], np.diff(way) > 0.0])
    between = np.interp(steps, way[rising], instants[rising]) if len(steps) else np.empty(0)
    # What rests from instant to instant is left where it was until it goes on.
    starts = instants[np.flatnonzero(~rising[:-1] & rising[1:])] if len(way) > 1 else np.empty(0)
    return np.unique(np.concatenate([instants[[0, -1]], between, starts]))
