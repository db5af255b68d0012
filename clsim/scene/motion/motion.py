"""Position, velocity and orientation (great arcs, hinges) over time, with a beginning and an end."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clsim.arrays import Floats, as_number, read_only
from clsim.errors import InputError
from clsim.numerics.quaternions import inverse, quaternion_product, rotate, same_hemisphere
from clsim.scene.motion.curves import CONTINUATION, Curve, Piecewise, is_static
from clsim.scene.motion.instants import BATCH, Indices, Instants

SHORTEST, LONGEST = 1e-9, 1e9  # s, bounds of lengths of time
_SAME = 1e-9  # relative difference of speeds that does not matter
_SPARE = 1.0 + 1e-12  # for the rounding of bounds
_LEAST_SINE = 1e-12  # of the angle between quaternions, below which they differ by rounding


class Turning(Protocol):
    """An orientation for every time, in which `time` has any shape."""

    @property
    def turns(self) -> bool:
        """Whether it changes."""

    @property
    def peak(self) -> float:
        """Bound of the angular velocity, rad/s."""

    @property
    def breaks(self) -> Floats:
        """Times (k,) at which the angular velocity may jump, s."""

    def lever(self, points: Floats) -> float:
        """Return a bound of the distance of points (n, 3) of what turns from the axes about which it does, m."""

    def orientation(self, time: Floats) -> Floats:
        """Return unit quaternions x y z w with 4 more columns, whose sign does not jump."""

    def angular_velocity(self, time: Floats) -> Floats:
        """Return angular velocities in the room with 3 more columns, rad/s."""


@dataclass(frozen=True, slots=True, eq=False)
class GreatArcs:
    """Spherical linear interpolation between orientations, held before the first and after the last."""

    # On each piece ``q(u) = base cos(u Ω) + side sin(u Ω)``, u from 0 to 1, with the angle Ω between both quaternions
    # and the unit quaternion `side` at a right angle to `base`; the last piece does not turn. The sign never jumps.
    # Shapes: times (n,) s; base, side (n, 4); angle (n,) rad. K. Shoemake, "Animating rotation with quaternion curves",
    # SIGGRAPH Computer Graphics 19(3), 1985.
    times: Floats
    base: Floats
    side: Floats
    angle: Floats

    @property
    def turns(self) -> bool:
        return bool(np.any(self.angle))

    @property
    def peak(self) -> float:
        return float(np.linalg.norm(self.angular_velocity(self.times), axis=-1).max())

    @property
    def breaks(self) -> Floats:
        return self.times if self.turns else self.times[:0]

    def lever(self, points: Floats) -> float:
        return float(np.linalg.norm(points, axis=-1).max())

    def orientation(self, time: Floats) -> Floats:
        if len(self.times) == 1:
            return np.tile(self.base[0], (*time.shape, 1))
        held = np.clip(time, self.times[0], self.times[-1])
        piece = np.maximum(np.searchsorted(self.times, held, side="right") - 1, 0)
        step = np.append(np.diff(self.times), 1.0)
        angle = ((held - self.times[piece]) / step[piece] * self.angle[piece])[..., None]
        turned: Floats = self.base[piece] * np.cos(angle) + self.side[piece] * np.sin(angle)
        return turned

    def angular_velocity(self, time: Floats) -> Floats:
        """Return angular velocities in the room, rad/s, at `time` of any shape, with 3 more columns."""
        # At the end of a piece it is that of the next one; before the first and from the last orientation on it is 0.
        inverse = self.base * np.array([-1.0, -1.0, -1.0, 1.0])
        step = np.append(np.diff(self.times), np.inf)
        turns = 2.0 * (self.angle / step)[:, None] * quaternion_product(self.side, inverse)[:, :3]
        piece = np.searchsorted(self.times, time, side="right") - 1
        return np.where((piece >= 0)[..., None], turns[piece], 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class Hinge:
    """A turn about one axis, by an angle that is a smooth function of time; axis (3,)."""

    axis: Floats
    angle: Piecewise

    @property
    def turns(self) -> bool:
        return bool(np.any(self.angle.derivative.c))

    @property
    def peak(self) -> float:
        knots = self.angle.derivative.x
        return float(self.angle.speed_over(knots[:1], knots[-1:])[0])

    @property
    def breaks(self) -> Floats:
        return np.empty(0)

    def lever(self, points: Floats) -> float:
        return float(np.linalg.norm(np.cross(self.axis, points), axis=-1).max())

    def at(self, time: Floats) -> Floats:
        """Return angles of the shape of `time`, rad; constant after the end of the motion."""
        return self.angle.position(self._held(time))[..., 0]

    def orientation(self, time: Floats) -> Floats:
        half = 0.5 * self.at(time)[..., None]
        return np.concatenate([np.sin(half) * self.axis, np.cos(half)], axis=-1)

    def angular_velocity(self, time: Floats) -> Floats:
        rate = np.where(time == self._held(time), self.angle.velocity(self._held(time))[..., 0], 0.0)
        return np.asarray(rate[..., None] * self.axis)

    def _held(self, time: Floats) -> Floats:
        knots = self.angle.derivative.x
        return np.clip(time, knots[0], knots[-1])


def turning_between(times: Floats, quaternions: Floats) -> GreatArcs:
    """Return the turning through unit quaternions (n, 4) at strictly increasing `times` (n,) s."""
    base = same_hemisphere(quaternions)
    following = np.concatenate([base[1:], base[-1:]])
    cosine = np.sum(base * following, axis=1, keepdims=True)
    across = following - cosine * base
    sine = np.linalg.norm(across, axis=1, keepdims=True)
    side = np.divide(across, sine, out=np.zeros_like(across), where=sine > 0.0)
    angle = np.arctan2(sine, cosine)[:, 0]
    angle[sine[:, 0] < _LEAST_SINE] = 0.0
    return GreatArcs(read_only(times), read_only(base), read_only(side), read_only(angle))


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """A motion from `start` to `end`, s; its fields are those of `Trajectory`."""

    # Shortly before its start and after its end, by 0.05 s, it goes on smoothly (lines and circles as they are, splines
    # by a parabola with the end's velocity and acceleration), because sound received at the start was emitted before
    # it. Beyond that everything stands still.
    curve: Curve
    start: float
    end: float
    turning: Turning | None = None
    notes: tuple[str, ...] = ()
    breaks: Floats = field(default_factory=lambda: read_only(np.empty(0)))
    residual: Floats | None = None
    # By range and rate: every scene that the motion is in asks, and each of its scatterers' ways.
    _peaks: dict[tuple[float, float, float], tuple[float, float]] = field(default_factory=dict, init=False, repr=False)

    @property
    def duration(self) -> float:
        """`end` less `start`, s; infinite for a fixed point."""
        return self.end - self.start

    @property
    def has_orientation(self) -> bool:
        """Whether the trajectory gives the transducer's orientation."""
        return self.turning is not None

    @property
    def is_static(self) -> bool:
        """Whether it never moves; it may turn."""
        return is_static(self.curve)

    @property
    def turns(self) -> bool:
        """Whether the orientation changes."""
        return self.turning is not None and self.turning.turns

    def check_start(self) -> None:
        """Refuse a motion that begins after 0 s."""
        if self.start > 0.0:
            raise InputError("trajectory", f"must begin at 0 s or before, but begins at {self.start:g} s")

    def position(self, t: ArrayLike) -> Floats:
        """Return positions (..., 3), m: of the shape of `t` with one more axis.

        Parameters
        ----------
        t : array_like
            Times, s, of any shape and in any order.

        Examples
        --------
        >>> from clsim import Trajectory
        >>> Trajectory.line((0, 0, 1), (2, 0, 1), duration=4.0).position([1.0, 3.0])
        array([[0.5, 0. , 1. ],
               [1.5, 0. , 1. ]])
        """
        time = np.asarray(t, dtype=np.float64)
        if self.end < np.inf:
            time = np.clip(time, self.start - CONTINUATION, self.end + CONTINUATION)
        return self.curve.position(time)

    def velocity(self, t: ArrayLike) -> Floats:
        """Return velocities, m/s, at times `t` (...), s, shaped as in `position`; at a break the one after it.

        Examples
        --------
        >>> from clsim import Trajectory
        >>> Trajectory.line((0, 0, 1), (2, 0, 1), duration=4.0).velocity(1.0)
        array([0.5, 0. , 0. ])
        """
        time = np.asarray(t, dtype=np.float64)
        first, last = self.start - CONTINUATION, self.end + CONTINUATION
        velocity = self.curve.velocity(np.clip(time, first, last))
        velocity[(time < first) | (time > last)] = 0.0
        return velocity

    def speed_over(self, begin: Floats, end: Floats) -> Floats:
        """Return upper bounds of the speed from `begin` to `end` (n,), s, in m/s; tighter for shorter intervals.

        Examples
        --------
        >>> from clsim import Trajectory
        >>> push = Trajectory.line((0, 0, 1), (2, 0, 1), duration=4.0)
        >>> push.speed_over(np.array([1.0, 9.0]), np.array([1e6, 1e6]))
        array([0.5, 0. ])
        """
        first, last = self.start - CONTINUATION, self.end + CONTINUATION
        speed = self.curve.speed_over(np.clip(begin, first, last), np.clip(end, first, last))
        return np.where((begin > last) | (end < first), 0.0, speed * (1.0 + 1e-12))

    def orientation(self, t: ArrayLike) -> Floats:
        """Return unit quaternions x y z w (..., 4) whose sign does not jump; identity without orientation.

        Parameters
        ----------
        t : array_like (...)
            Times, s. Before the first and after the last orientation given, that one is held.

        Examples
        --------
        >>> from clsim import Trajectory
        >>> Trajectory.fixed((1, 1, 1)).orientation(0.0)
        array([0., 0., 0., 1.])
        """
        time = np.asarray(t, dtype=np.float64)
        if self.turning is None:
            return np.tile([0.0, 0.0, 0.0, 1.0], (*time.shape, 1))
        return self.turning.orientation(time)

    def angular_velocity(self, t: ArrayLike) -> Floats:
        """Return angular velocities in the room at `t` (...), s, in rad/s, shaped as in `position`; 0 without turning.

        Examples
        --------
        >>> from clsim import Trajectory
        >>> turn = [[0, 0, 0, 1], [0, 0, np.sin(0.5), np.cos(0.5)]]
        >>> Trajectory.waypoints([0, 2], [[1, 1, 1], [2, 1, 1]], turn).angular_velocity(1.0).round(9)
        array([0. , 0. , 0.5])
        """
        time = np.asarray(t, dtype=np.float64)
        if self.turning is None:
            return np.zeros((*time.shape, 3))
        return self.turning.angular_velocity(time)

    @property
    def peak_turn(self) -> float:
        """Bound of the angular velocity, rad/s."""
        return 0.0 if self.turning is None else self.turning.peak

    def peak_speed(self, start: float, end: float, rate: float = 1000.0) -> tuple[float, float]:
        """Return the largest speed at evenly spaced instants to nine digits, m/s, and its time, s.

        Instants between which no speed can be larger are left out, so that long rests and even motions cost nothing.

        Parameters
        ----------
        start, end : float
            First and last instant, s.
        rate : float
            Instants per second, at least; above 0, Hz.

        Examples
        --------
        >>> from clsim import Trajectory
        >>> Trajectory.line((0, 0, 0), (3, 4, 0), duration=2.0).peak_speed(0.0, 2.0)
        (2.5, 0.0)
        """
        start = as_number("start", start, unit="s")
        end = as_number("end", end, at_least=start, unit="s")
        key = (start, end, as_number("rate", rate, above=0.0, unit="Hz"))
        if key not in self._peaks:
            self._peaks[key] = self._peak_at(Instants(*key))
        return self._peaks[key]

    def _peak_at(self, instants: Instants) -> tuple[float, float]:
        """Return the largest speed at some instants to nine digits, m/s, and when it is reached, s."""
        if instants.count <= BATCH:
            speeds = np.linalg.norm(self.velocity(instants.times(np.arange(instants.count))), axis=1)
            first = int(np.argmax(speeds >= speeds.max() * (1.0 - _SAME)))
            return float(speeds[first]), float(instants.times(np.array(first)))
        best = (float(np.linalg.norm(self.velocity(instants.start))), instants.start)

        def probe(first: Indices, middle: Indices, last: Indices) -> tuple[Indices, NDArray[np.bool_]]:
            """Return no hits, and a mask of ranges that may contain a speed above the best so far."""
            nonlocal best
            times = instants.times(middle)
            speed = np.linalg.norm(self.velocity(times), axis=1)
            i = int(np.argmax(speed))
            if speed[i] > best[0] * (1.0 + _SAME):
                best = (float(speed[i]), float(times[i]))
            bound = self.speed_over(instants.times(first), instants.times(last))
            return np.full(len(first), -1), bound > best[0] * (1.0 + _SAME)

        instants.first(probe)
        return best


class Moved:
    """Base class of what has a trajectory."""

    __slots__ = ()
    trajectory: Motion

    @property
    def time_range(self) -> tuple[float, float]:
        """The finite part of the trajectory that matters, s: from 0 to its end, or to 0 at a fixed point."""
        return 0.0, 0.0 if math.isinf(self.trajectory.end) else self.trajectory.end


@dataclass(frozen=True, slots=True, eq=False)
class Swung:
    """A point that swings about an axis, whose nearest point is `foot` (3,) m."""

    # `along` and `across` (3,) m lead from there to the point at angle 0, and at a quarter turn.
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
    """Orientation of something mounted on a moving object, which may turn in the object's frame; aim (4,)."""

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
    if isinstance(point.curve, Carried) and point.curve.carrier is frame:
        return point.curve.own
    moving = [motion for motion in (frame, point) if not motion.is_static or motion.turns]
    start, end = max((m.start for m in moving), default=0.0), min((m.end for m in moving), default=0.0)
    return Motion(Seen(frame, point), start, end)


def even_lengths(speed: Floats, rate: float, step: float) -> Floats:
    """Return times (n,), s, between which objects move at most a step, m; first and last instants are included."""
    # speed: bounds (m,) of how fast they go about instants so many per second from 0 s on, m/s.
    pace = np.maximum(speed[1:], speed[:-1]) / (rate * step)  # steps from one instant to the next
    length = np.concatenate([[0.0], np.cumsum(pace)])
    instants = np.arange(len(length)) / rate
    steps = np.arange(1, int(np.ceil(length[-1])))
    rising = np.concatenate([[True], np.diff(length) > 0.0])
    between = np.interp(steps, length[rising], instants[rising]) if len(steps) else np.empty(0)
    # What rests from instant to instant is left where it was until it goes on.
    starts = instants[np.flatnonzero(~rising[:-1] & rising[1:])] if len(length) > 1 else np.empty(0)
    return np.unique(np.concatenate([instants[[0, -1]], between, starts]))
