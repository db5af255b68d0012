"""Where a source or receiver is, and how it is turned, at every time."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from clsim.arrays import Floats, as_floats, as_number, read_only
from clsim.errors import InputError
from clsim.scene.curves import (
    CONTINUATION,
    Circular,
    Curve,
    Still,
    Straight,
    kinks,
    legs_through,
    spline_through,
)
from clsim.scene.turning import Turning, as_quaternions, turning_between

if TYPE_CHECKING:
    from collections.abc import Sequence
    from os import PathLike

_SCAN_BLOCK = 65536  # instants looked at at a time
_FARTHEST = 1e6  # m, bound of coordinates
_SHORTEST, _LONGEST = 1e-9, 1e9  # s, bounds of times and of their steps
_MOST_SAMPLES = 2e7  # of a function


def _no_breaks() -> Floats:
    return read_only(np.empty(0))


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory:
    """A motion from `start` to `end`; made by one of the constructors below.

    Shortly before its start and after its end, by 0.05 s, a trajectory goes on smoothly (lines and circles as
    they are, splines by a parabola with the end's velocity and acceleration), because sound received at the
    start was emitted before it. Beyond that everything stands still.

    Parameters
    ----------
    curve : Curve
        Position and velocity.
    start, end : float
        First and last time, s; -inf and inf for a fixed point.
    turning : Turning, optional
        Orientation over time; identity where left out.
    notes : tuple of str
        What was found, smoothed or repaired in the making, a sentence each.
    breaks : ndarray (k,)
        Times at which the velocity jumps, s; empty for smooth trajectories.
    residual : ndarray (3,), optional
        Root mean square by which smoothing moved the points along x, y and z, m.
    """

    curve: Curve
    start: float
    end: float
    turning: Turning | None = None
    notes: tuple[str, ...] = ()
    breaks: Floats = field(default_factory=_no_breaks)
    residual: Floats | None = None

    @property
    def duration(self) -> float:
        """Time from start to end, s; infinite for a fixed point."""
        return self.end - self.start

    @property
    def has_orientation(self) -> bool:
        """Whether the trajectory says how the transducer is turned."""
        return self.turning is not None

    def position(self, t: ArrayLike) -> Floats:
        """Return positions, m.

        Parameters
        ----------
        t : array_like
            Times, s, of any shape and in any order.

        Returns
        -------
        ndarray
            Shape of `t` and 3 more columns: ``(n, 3)`` for ``(n,)``, ``(3,)`` for a number.

        Examples
        --------
        >>> Trajectory.line((0, 0, 1), (2, 0, 1), duration=4.0).position([1.0, 3.0])
        array([[0.5, 0. , 1. ],
               [1.5, 0. , 1. ]])
        """
        time = np.asarray(t, dtype=np.float64)
        return self.curve.position(np.clip(time, self.start - CONTINUATION, self.end + CONTINUATION))

    def velocity(self, t: ArrayLike) -> Floats:
        """Return velocities, m/s, shaped as in `position`; at a break the one after it.

        Parameters
        ----------
        t : array_like
            Times, s.

        Returns
        -------
        ndarray
            Shape of `t` and 3 more columns.

        Examples
        --------
        >>> Trajectory.line((0, 0, 1), (2, 0, 1), duration=4.0).velocity(1.0)
        array([0.5, 0. , 0. ])
        """
        time = np.asarray(t, dtype=np.float64)
        first, last = self.start - CONTINUATION, self.end + CONTINUATION
        velocity = self.curve.velocity(np.clip(time, first, last))
        velocity[(time < first) | (time > last)] = 0.0
        return velocity

    def orientation(self, t: ArrayLike) -> Floats:
        """Return unit quaternions x y z w whose sign does not jump; identity without orientation.

        Parameters
        ----------
        t : array_like
            Times, s. Before the first and after the last known orientation, that one is held.

        Returns
        -------
        ndarray
            Shape of `t` and 4 more columns.

        Examples
        --------
        >>> Trajectory.fixed((1, 1, 1)).orientation(0.0)
        array([0., 0., 0., 1.])
        """
        time = np.asarray(t, dtype=np.float64)
        if self.turning is None:
            return np.tile([0.0, 0.0, 0.0, 1.0], (*time.shape, 1))
        return self.turning.orientation(time)

    def peak_speed(self, start: float, end: float, rate: float = 1000.0) -> tuple[float, float]:
        """Return the largest speed at evenly spaced instants, and when it is reached.

        Parameters
        ----------
        start, end : float
            First and last instant, s.
        rate : float
            Instants per second, at least.

        Returns
        -------
        speed, time : float
            m/s and s.

        Raises
        ------
        InputError
            If the range is not finite or ends before it starts.

        Examples
        --------
        >>> Trajectory.line((0, 0, 0), (3, 4, 0), duration=2.0).peak_speed(0.0, 2.0)
        (2.5, 0.0)
        """
        start = as_number("start", start, unit="s")
        end = as_number("end", end, at_least=start, unit="s")
        count = math.ceil((end - start) * as_number("rate", rate, above=0.0, unit="Hz")) + 1
        step = (end - start) / max(count - 1, 1)
        best = (-1.0, start)
        for first in range(0, count, _SCAN_BLOCK):
            times = start + step * np.arange(first, min(first + _SCAN_BLOCK, count))
            speed = np.linalg.norm(self.velocity(times), axis=1)
            i = int(np.argmax(speed))
            if speed[i] > best[0]:
                best = (float(speed[i]), float(times[i]))
        return best

    @staticmethod
    def fixed(position: ArrayLike, orientation: ArrayLike | None = None) -> Trajectory:
        """Return a point that never moves.

        Parameters
        ----------
        position : array_like (3,)
            m.
        orientation : array_like (4,), optional
            Unit quaternion x y z w.

        Returns
        -------
        Trajectory
            From -inf to inf.

        Raises
        ------
        InputError
            If a value is not finite or the quaternion's norm is not 1.

        Examples
        --------
        >>> Trajectory.fixed((1.0, 1.0, 2.9)).position(7.0)
        array([1. , 1. , 2.9])
        """
        turning = None
        if orientation is not None:
            turning = turning_between(np.zeros(1), as_quaternions("orientation", orientation, (4,))[None])
        return Trajectory(Still(_places("position", position, (3,))), -math.inf, math.inf, turning)

    @staticmethod
    def line(start: ArrayLike, end: ArrayLike, duration: float) -> Trajectory:
        """Return a straight motion at constant speed, from time 0.

        Parameters
        ----------
        start, end : array_like (3,)
            First and last position, m.
        duration : float
            s, above 0.

        Returns
        -------
        Trajectory
            From 0 to `duration`.

        Raises
        ------
        InputError
            If a value is not finite or the duration not above 0.

        Examples
        --------
        >>> Trajectory.line((0, 0, 0), (1, 2, 3), duration=2.0).position(1.0)
        array([0.5, 1. , 1.5])
        """
        first, last = _places("start", start, (3,)), _places("end", end, (3,))
        duration = _span("duration", duration)
        return Trajectory(Straight(first, read_only((last - first) / duration)), 0.0, duration)

    @staticmethod
    def circle(
        center: ArrayLike,
        radius: float,
        period: float,
        duration: float,
        axis: ArrayLike = (0.0, 0.0, 1.0),
        phase: float = 0.0,
    ) -> Trajectory:
        """Return a circle at constant speed, counterclockwise about its axis, from time 0.

        Parameters
        ----------
        center : array_like (3,)
            m.
        radius : float
            m, above 0.
        period : float
            Time of one turn, s, above 0.
        duration : float
            s, above 0.
        axis : array_like (3,)
            Direction about which it turns by the right-hand rule, of any length.
        phase : float
            Angle at time 0, rad, from e1: the +x direction turned into the circle's plane (its projection),
            or +y where the axis lies along x. With the axis +z, phase 0 begins at ``center + (radius, 0, 0)``.

        Returns
        -------
        Trajectory
            From 0 to `duration`.

        Raises
        ------
        InputError
            If a value is not finite or out of range, or the axis is zero.

        Examples
        --------
        >>> circle = Trajectory.circle((4, 3, 1.5), radius=1.0, period=1.0, duration=2.0)
        >>> circle.position([0.0, 0.25]).round(12)
        array([[5. , 3. , 1.5],
               [4. , 4. , 1.5]])
        """
        e1, e2 = _plane(as_floats("axis", axis, (3,)))
        curve = Circular(
            _places("center", center, (3,)),
            read_only(e1),
            read_only(e2),
            as_number("radius", radius, above=0.0, at_most=_FARTHEST, unit="m"),
            2.0 * math.pi / _span("period", period),
            as_number("phase", phase, at_least=-_LONGEST, at_most=_LONGEST, unit="rad"),
        )
        return Trajectory(curve, 0.0, _span("duration", duration))

    @staticmethod
    def waypoints(
        times: ArrayLike, positions: ArrayLike, orientations: ArrayLike | None = None, smooth: bool = True
    ) -> Trajectory:
        """Return a motion through given points.

        Parameters
        ----------
        times : array_like (n,)
            Strictly increasing, s, at least two.
        positions : array_like (n, 3)
            m; they are met exactly.
        orientations : array_like (n, 4), optional
            Unit quaternions x y z w, joined by great arcs (slerp).
        smooth : bool
            Whether to join the points by a C2 cubic spline (not-a-knot at its ends, so two points give a
            line and three a parabola) or by straight legs with a sudden change of velocity at each point.

        Returns
        -------
        Trajectory
            From the first to the last time.

        Raises
        ------
        InputError
            If shapes differ, a value is not finite, times do not increase or a quaternion's norm is not 1.

        Examples
        --------
        >>> legs = Trajectory.waypoints([0, 1, 2], [(0, 0, 0), (1, 0, 0), (1, 2, 0)], smooth=False)
        >>> legs.position([0.5, 1.5]), legs.breaks
        (array([[0.5, 0. , 0. ],
               [1. , 1. , 0. ]]), array([1.]))
        """
        t = _increasing_times(times)
        x = _places("positions", positions, (len(t), 3))
        if not isinstance(smooth, bool | np.bool_):
            raise InputError("smooth", f"must be true or false, but is {smooth!r:.80}")
        turning = None
        if orientations is not None:
            turning = turning_between(t, as_quaternions("orientations", orientations, (len(t), 4)))
        if smooth:
            return Trajectory(spline_through(t, x, "not-a-knot"), float(t[0]), float(t[-1]), turning)
        return Trajectory(
            legs_through(t, x), float(t[0]), float(t[-1]), turning, breaks=read_only(kinks(t, x))
        )

    @staticmethod
    def sampled(function: Callable[[Floats], ArrayLike], duration: float, rate: float) -> Trajectory:
        """Return the motion that a function describes, as a C2 cubic spline through samples of it.

        The spline is wrong by at most about ``x⁗ / (384 rate⁴)``: 2.6e-9 m for a circle of 1 m at one turn
        per second and 200 Hz.

        Parameters
        ----------
        function : callable
            Takes times (n,) s, gives positions (n, 3) m.
        duration : float
            s, above 0.
        rate : float
            Samples per second, at least (raised so that the last sample falls on `duration`).

        Returns
        -------
        Trajectory
            From 0 to `duration`.

        Raises
        ------
        InputError
            If the function's result has another shape or is not finite.

        Examples
        --------
        >>> import numpy as np
        >>> sway = Trajectory.sampled(lambda t: np.stack([np.sin(t), 0 * t, 0 * t], axis=1), 2.0, rate=100.0)
        >>> round(float(sway.velocity(1.0)[0] - np.cos(1.0)), 8)
        0.0
        """
        if not callable(function):
            raise InputError("function", f"must be callable, but is {function!r:.80}")
        duration = _span("duration", duration)
        rate = as_number("rate", rate, above=0.0, at_most=_MOST_SAMPLES / duration, unit="Hz")
        times = np.linspace(0.0, duration, max(3, math.ceil(duration * rate * (1 - 1e-12))) + 1)
        positions = _places("function", function(times.copy()), (len(times), 3))
        return Trajectory(spline_through(times, positions, "not-a-knot"), 0.0, duration)


def _plane(axis: Floats) -> tuple[Floats, Floats]:
    """Return e1 and e2 such that e1, e2 and the direction `axis` (3,) are a right-handed frame."""
    largest = np.abs(axis).max()
    if largest == 0.0:
        raise InputError("axis", "must be a direction, but is 0, 0, 0")
    axis = axis / largest
    axis = axis / np.linalg.norm(axis)
    along_x = np.hypot(axis[1], axis[2]) < 1e-6
    reference = np.array([0.0, 1.0, 0.0] if along_x else [1.0, 0.0, 0.0])
    e1 = reference - axis * np.dot(axis, reference)
    e1 /= np.linalg.norm(e1)
    return e1, np.cross(axis, e1)


def _span(field_name: str, value: Any) -> float:
    """Return a length of time, s, refused where it is not above 0 or absurd."""
    as_number(field_name, value, above=0.0, unit="s")
    return as_number(field_name, value, at_least=_SHORTEST, at_most=_LONGEST, unit="s")


def _places(field_name: str, value: Any, shape: tuple[int | None, ...]) -> Floats:
    """Return positions, m, refused where a coordinate is absurd."""
    places = as_floats(field_name, value, shape)
    far = np.argwhere(np.abs(places) > _FARTHEST)
    if len(far):
        index = "".join(f"[{i}]" for i in far[0])
        raise InputError(
            field_name + index, f"must be within {_FARTHEST:g} m, but is {places[tuple(far[0])]:g} m"
        )
    return places


def _increasing_times(times: Any) -> Floats:
    """Return times (n,) s, refused unless there are two or more and they increase strictly."""
    t = as_floats("times", times, (None,))
    if len(t) < 2:
        raise InputError("times", f"must hold at least two, but holds {len(t)}")
    if np.abs(t).max() > _LONGEST * 2.0:  # the Unix epoch's seconds pass
        i = int(np.argmax(np.abs(t)))
        raise InputError(f"times[{i}]", f"must be within {_LONGEST * 2.0:g} s, but is {t[i]:g} s")
    late = np.flatnonzero(np.diff(t) < _SHORTEST)
    if len(late):
        i = int(late[0])
        raise InputError(
            "times", f"must increase strictly, but [{i + 1}] = {t[i + 1]:.12g} s follows [{i}] = {t[i]:.12g} s"
        )
    return t
