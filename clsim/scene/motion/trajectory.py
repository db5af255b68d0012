"""Where a source or receiver is, and how it is turned, at every time."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from clsim.arrays import FARTHEST, Floats, as_choice, as_floats, as_number, read_only
from clsim.errors import InputError, check_rising, warn
from clsim.numerics.quaternions import quaternion_from_direction, quaternion_product
from clsim.numerics.quaternions import rotate as rotated
from clsim.scene.motion import curves
from clsim.scene.motion import motion as motions
from clsim.scene.motion.motion import LONGEST, SHORTEST, Motion, turning_between

_MOST_SAMPLES = 2e7  # of a function
_NO_LENGTH = 1e-100  # of a direction
_TWO_TURNS = 4.0 * np.pi + 1e-9  # rad
_UNIT_TOLERANCE = 1e-2  # largest error of a quaternion's norm that counts as rounding


def as_span(field_name: str, value: Any) -> float:
    """Return a length of time, s."""
    as_number(field_name, value, above=0.0, unit="s")
    return as_number(field_name, value, at_least=SHORTEST, at_most=LONGEST, unit="s")


def as_places(field_name: str, value: Any, shape: tuple[int | None, ...]) -> Floats:
    """Return positions, m."""
    return as_floats(field_name, value, shape, within=FARTHEST, unit="m")


def as_direction(field_name: str, value: Any) -> Floats:
    """Return a direction (3,) of any length."""
    direction = as_floats(field_name, value, (3,), within=1.0 / _NO_LENGTH)
    if not np.linalg.norm(direction) > _NO_LENGTH:
        raise InputError(field_name, f"must be a direction, but is {', '.join(f'{x:g}' for x in direction)}")
    return direction


def question_turns(field_name: str, largest: float) -> None:
    """Warn of angles above two turns, rad, which are more often degrees than a spinning object."""
    if largest > _TWO_TURNS:
        note = f"{field_name}: {largest:.6g} rad are {largest / (2.0 * np.pi):.3g} turns; angles are in radians: "
        warn(f"{note}{largest:.6g} degrees are {np.radians(largest):.6g} rad")


def as_increasing(times: Any) -> Floats:
    """Return the field ``times`` (n,) s."""
    t = as_floats("times", times, (None,))
    if len(t) < 2:
        raise InputError("times", f"must hold at least two, but holds {len(t)}")
    as_floats("times", t, (None,), within=2.0 * LONGEST, unit="s")  # seconds since 1970 pass
    check_rising("times", t, np.diff(t) >= SHORTEST, " s", ".12g")
    return t


def as_path(value: Any) -> Path:
    """Return the field ``path``."""
    if not isinstance(value, str | PathLike) or not str(value).strip():
        raise InputError("path", f"must be the path of a file, but is {value!r:.80}")
    return Path(value)


def as_columns(value: Any, known: tuple[str, ...]) -> dict[str, str] | None:
    """Names of a file's columns by what stands in them, some of `known`."""
    if value is None:
        return None
    if not isinstance(value, Mapping) or not all(isinstance(name, str) for name in value.values()):
        raise InputError("columns", f"must be a mapping to names of columns, but is {value!r:.80}")
    for name in value:
        as_choice("columns", name, known)
    return dict(value)


def as_quaternions(field: str, value: object, shape: tuple[int | None, ...]) -> Floats:
    """Return unit quaternions x y z w, freed of rounding in their norm."""
    quaternions = as_floats(field, value, shape, within=1e100)  # whose squares are numbers
    norm = np.linalg.norm(quaternions, axis=-1, keepdims=True)
    for index in np.argwhere(np.abs(norm[..., 0] - 1.0) > _UNIT_TOLERANCE)[:1].tolist():
        name = field + "".join(f"[{i}]" for i in index)
        raise InputError(name, f"must be a unit quaternion x y z w, but its norm is {norm[tuple(index)][0]:.6g}")
    unit: Floats = quaternions / norm
    return unit


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory(Motion):
    """A motion, made by `fixed`, `line`, `circle`, `swing`, `waypoints`, `sampled` or `from_file`.

    Its functions of time are those of `Motion`.

    Parameters
    ----------
    curve : Curve
        Position and velocity.
    start, end : float
        First and last time, s; -inf and inf for a fixed point.
    turning : Turning, optional
        Orientation over time; identity where left out.
    notes : tuple of str
        What the constructor found, smoothed or repaired, one sentence each.
    breaks : ndarray (k,)
        Times at which the velocity jumps, s; empty for smooth trajectories.
    residual : ndarray (3,), optional
        Root mean square by which smoothing moved the points along x, y and z, m.

    Examples
    --------
    >>> lap = Trajectory.circle(center=(4, 3, 1.5), radius=1.0, period=1.0, duration=2.0)
    >>> lap.start, lap.end, lap.has_orientation
    (0.0, 2.0, False)
    """

    @staticmethod
    def fixed(position: ArrayLike, orientation: ArrayLike | None = None) -> Trajectory:
        """Return a point that never moves, from -inf to inf.

        Parameters
        ----------
        position : array_like (3,)
            m.
        orientation : array_like (4,), optional
            Unit quaternion x y z w.

        Examples
        --------
        >>> Trajectory.fixed((1.0, 1.0, 2.9)).position(7.0)
        array([1. , 1. , 2.9])
        """
        turning = None
        if orientation is not None:
            turning = turning_between(np.zeros(1), as_quaternions("orientation", orientation, (4,))[None])
        return Trajectory(curves.Static(as_places("position", position, (3,))), -math.inf, math.inf, turning)

    @staticmethod
    def line(start: ArrayLike, end: ArrayLike, duration: float) -> Trajectory:
        """Return a straight motion at constant speed, from time 0 to `duration`.

        Parameters
        ----------
        start, end : array_like (3,)
            First and last position, m.
        duration : float
            s, above 0.

        Examples
        --------
        >>> Trajectory.line((0, 0, 0), (1, 2, 3), duration=2.0).position(1.0)
        array([0.5, 1. , 1.5])
        """
        first, last = as_places("start", start, (3,)), as_places("end", end, (3,))
        duration = as_span("duration", duration)
        return Trajectory(curves.Straight(first, read_only((last - first) / duration)), 0.0, duration)

    @staticmethod
    def circle(
        center: ArrayLike, radius: float, period: float, duration: float, axis: ArrayLike = (0.0, 0.0, 1.0),
        phase: float = 0.0,
    ) -> Trajectory:  # fmt: skip
        """Return a circle at constant speed, counterclockwise about its axis, from time 0 to `duration`.

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
            A direction about which it turns by the right-hand rule, of any length and without a unit.
        phase : float
            Angle at time 0, rad, from e1: the +x direction turned into the circle's plane (its projection),
            or +y where the axis lies along x. With the axis +z, phase 0 begins
            at ``center + (radius, 0, 0)``. More than two turns, more often degrees, give a warning.

        Examples
        --------
        >>> circle = Trajectory.circle((4, 3, 1.5), radius=1.0, period=1.0, duration=2.0)
        >>> circle.position([0.0, 0.25]).round(12)
        array([[5. , 3. , 1.5],
               [4. , 4. , 1.5]])
        """
        e1, e2 = curves.frame_about(as_direction("axis", axis))
        phase = as_number("phase", phase, at_least=-LONGEST, at_most=LONGEST, unit="rad")
        question_turns("phase", abs(phase))
        curve = curves.Circular(
            as_places("center", center, (3,)),
            read_only(e1),
            read_only(e2),
            as_number("radius", radius, above=0.0, at_most=FARTHEST, unit="m"),
            2.0 * math.pi / as_span("period", period),
            phase,
        )
        return Trajectory(curve, 0.0, as_span("duration", duration))

    @staticmethod
    def swing(
        axis_point: ArrayLike, axis: ArrayLike, angles: ArrayLike, times: ArrayLike, origin: ArrayLike | None = None
    ) -> Trajectory:
        """Return a swing about an axis, such as that of a door: position and orientation turn together.

        Parameters
        ----------
        axis_point : array_like (3,)
            A point of the axis, m.
        axis : array_like (3,)
            Its direction, of any length and without a unit; angles follow the right-hand rule.
        angles : array_like (n,)
            rad; the cubic spline through them is the motion, so that no velocity jumps. More than two turns, more often
            degrees, give a warning.
        times : array_like (n,)
            Strictly increasing, s, at least two.
        origin : array_like (3,), optional
            Position of the swinging thing at angle 0, m; the axis point where left out. For a body it is the origin of
            its mesh. With 0, 0, 0 a mesh has coordinates of the room, as it is at angle 0.

        Examples
        --------
        >>> door = Trajectory.swing((2, 0, 0), (0, 0, 1), [0.0, 1.5], [0.0, 2.0], origin=(3, 0, 0))
        >>> door.position([0.0, 2.0]).round(3), door.angular_velocity(1.0).round(9)
        (array([[3.   , 0.   , 0.   ],
               [2.071, 0.997, 0.   ]]), array([0.  , 0.  , 0.75]))
        """
        t = as_increasing(times)
        theta = as_floats("angles", angles, (len(t),), within=LONGEST, unit="rad")
        question_turns("angles", float(np.abs(theta).max()))
        point = as_places("axis_point", axis_point, (3,))
        unit = as_direction("axis", axis)
        unit = unit / np.abs(unit).max()
        unit = unit / np.linalg.norm(unit)
        hinge = motions.Hinge(read_only(unit), curves.spline_through(t, theta[:, None] * np.eye(3)[0], "not-a-knot"))
        arm = (point if origin is None else as_places("origin", origin, (3,))) - point
        along = arm - (arm @ unit) * unit
        foot = point + (arm @ unit) * unit
        still = np.linalg.norm(along) == 0.0
        curve = curves.Static(read_only(foot)) if still else motions.Swung(foot, along, np.cross(unit, along), hinge)
        return Trajectory(curve, float(t[0]), float(t[-1]), hinge)

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
            Whether to join the points by a C2 cubic spline. It is not-a-knot at its ends, so two points give a line and
            three a parabola. Otherwise straight legs join them, and the velocity jumps at each point.

        Examples
        --------
        >>> legs = Trajectory.waypoints([0, 1, 2], [(0, 0, 0), (1, 0, 0), (1, 2, 0)], smooth=False)
        >>> legs.position([0.5, 1.5]), legs.breaks
        (array([[0.5, 0. , 0. ],
               [1. , 1. , 0. ]]), array([1.]))
        """
        t = as_increasing(times)
        x = as_places("positions", positions, (len(t), 3))
        if not isinstance(smooth, bool | np.bool_):
            raise InputError("smooth", f"must be true or false, but is {smooth!r:.80}")
        turning = None
        if orientations is not None:
            turning = turning_between(t, as_quaternions("orientations", orientations, (len(t), 4)))
        if smooth:
            return Trajectory(curves.spline_through(t, x, "not-a-knot"), float(t[0]), float(t[-1]), turning)
        return Trajectory(
            curves.legs_through(t, x), float(t[0]), float(t[-1]), turning, breaks=read_only(curves.kinks(t, x))
        )

    @staticmethod
    def sampled(function: Callable[[Floats], ArrayLike], duration: float, rate: float) -> Trajectory:
        """Return the motion that a function describes from 0 to `duration`, a C2 cubic spline through samples of it.

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

        Examples
        --------
        >>> sway = Trajectory.sampled(lambda t: np.stack([np.sin(t), 0 * t, 0 * t], axis=1), 2.0, rate=100.0)
        >>> bool(abs(sway.velocity(1.0)[0] - np.cos(1.0)) < 1e-8)
        True
        """
        if not callable(function):
            raise InputError("function", f"must be callable, but is {function!r:.80}")
        duration = as_span("duration", duration)
        rate = as_number("rate", rate, above=0.0, at_most=_MOST_SAMPLES / duration, unit="Hz")
        times = np.linspace(0.0, duration, max(3, math.ceil(duration * rate * (1 - 1e-12))) + 1)
        positions = as_places("function", function(times.copy()), (len(times), 3))
        return Trajectory(curves.spline_through(times, positions, "not-a-knot"), 0.0, duration)

    @staticmethod
    def carried(carrier: Motion, own: Motion, aim: ArrayLike | None = None) -> Trajectory:
        """Return the motion in the room of something that a moving thing carries.

        Parameters
        ----------
        carrier : Motion
            Trajectory of the carrier.
        own : Motion
            Trajectory in the carrier's own frame.
        aim : array_like (3,), optional
            A direction in that frame in which the axis of what is carried points.

        Examples
        --------
        >>> robot = Trajectory.line((0, 0, 0), (1, 0, 0), duration=1.0)
        >>> Trajectory.carried(robot, Trajectory.fixed((0.0, 0.1, 0.3))).position(0.5)
        array([0.5, 0.1, 0.3])
        """
        towards = np.array([0.0, 0.0, 0.0, 1.0]) if aim is None else quaternion_from_direction(aim)
        curve, turning = motions.Carried(carrier, own), motions.CarriedTurning(carrier, own, towards)
        if carrier.is_static and own.is_static and not turning.turns:
            return Trajectory.fixed(curve.position(np.zeros(())), turning.orientation(np.zeros(())))
        start, end = max(carrier.start, own.start), min(carrier.end, own.end)
        return Trajectory(curve, start, end, turning, breaks=motions.velocity_breaks(carrier, own))

    @staticmethod
    def from_file(
        path: str | PathLike[str], format: str = "tum", *, topic: str | None = None,
        columns: Mapping[str, str] | None = None, time_scale: float = 1.0, smooth: bool | float = True,
        time_offset: float = 0.0, rotate: ArrayLike = (0.0, 0.0, 0.0, 1.0), scale: float = 1.0,
        translate: ArrayLike = (0.0, 0.0, 0.0), repair: Sequence[str] = (), max_speed: float = 20.0,
        max_gap: float | None = None,
    ) -> Trajectory:  # fmt: skip
        r"""Return a measured motion, placed into the room by ``x' = rotate(scale x) + translate``.

        Parameters
        ----------
        path : path-like
            A text file, or a ROS bag.
        format : {"tum", "euroc", "csv", "rosbag"}
            TUM: ``t x y z qx qy qz qw``. EuRoC: nanoseconds, x, y, z, qw, qx, qy, qz. CSV: a header names
            ``t,x,y,z`` and perhaps ``qx,qy,qz,qw``, in any order; ``time``, ``timestamp``, ``pos_x``, ``position_x``,
            ``px``, ``q_x``, ``quat_x`` and ``orientation_x`` are known as well, in any case. A bag is of ROS 2 (a
            folder, ``.mcap``, ``.db3``) or ROS 1 (``.bag``), and read without ROS (``clsim[ros]``); times are those
            of the messages' headers.
        topic : str, optional
            Topic of a bag, whose messages are PoseStamped, PoseWithCovarianceStamped, Odometry or TransformStamped.
        columns : mapping, optional
            Names of a CSV file's columns for some of ``t x y z qx qy qz qw``, such as ``{"t": "time (ms)"}``.
        time_scale : float
            Unit of time of a TUM or CSV file in s, such as 1e-3 for milliseconds.
        smooth : bool or float
            True removes the noise and no more: cubic smoothing spline per axis by generalised cross-validation, see
            `residual`. A number is the rms residual to leave per axis, m. False is the C2 spline through the points.
        time_offset : float
            Time that the file's first row gets, s.
        rotate, scale, translate : array_like (4,), float, array_like (3,)
            Unit quaternion x y z w, metres in the file's unit of length, m.
        repair : sequence of {"times", "gaps", "nan", "jumps"}
            Faults to repair rather than refuse; `notes` says what was done. "nan" drops rows with a value that is no
            finite number. "times" drops rows whose time is not above all before. "jumps" drops rows out of reach from
            the last good one. "gaps" lets the spline bridge gaps.
        max_speed : float
            Speed from row to row above which it is a jump, m/s.
        max_gap : float, optional
            Step of time above which it is a gap, s; five median steps where left out.

        Warns
        -----
        ClsimWarning
            Without smoothing, of the Doppler noise to expect; with it, of accelerations above 50 m/s².

        Examples
        --------
        >>> import pathlib, tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = pathlib.Path(folder) / "push.csv"
        ...     _ = path.write_text("t,x,y,z\n10,0,0,0\n11,1,0,0\n12,2,0,0\n13,3,0,0\n")
        ...     push = Trajectory.from_file(path, "csv", translate=(1, 1, 1))
        >>> push.end, push.position(1.5).round(9)
        (3.0, array([2.5, 1. , 1. ]))
        """
        from clsim.scene.motion import files

        strength = curves.as_smooth(smooth)
        if not isinstance(repair, list | tuple):
            raise InputError("repair", f"must be a list of names, but is {repair!r:.80}")
        if format == "rosbag" and not (isinstance(topic, str) and topic.strip()):
            raise InputError("topic", f"must name the topic of a bag, such as '/robot/pose', but is {topic!r:.80}")
        poses = files.read_poses(
            as_path(path),
            as_choice("format", format, files.FORMATS),
            topic=topic,
            columns=as_columns(columns, files.POSE),
            time_scale=as_number("time_scale", time_scale, at_least=1e-12, at_most=1e6, unit="s"),
            scale=as_number("scale", scale, at_least=1e-9, at_most=1e9),
            repair=tuple(as_choice(f"repair[{i}]", one, files.REPAIRS) for i, one in enumerate(repair)),
            max_speed=as_number("max_speed", max_speed, above=0.0, at_most=FARTHEST, unit="m/s"),
            max_gap=None if max_gap is None else as_span("max_gap", max_gap),
        )
        turn, shift = as_quaternions("rotate", rotate, (4,)), as_places("translate", translate, (3,))
        times = poses.times + as_number("time_offset", time_offset, at_least=-LONGEST, at_most=LONGEST, unit="s")
        curve, residual, notes = curves.fit_measured(
            times, poses.positions, strength, lambda points: rotated(turn, points) + shift
        )
        turning = None
        if poses.orientations is not None:
            turning = turning_between(times, quaternion_product(turn, poses.orientations))
        notes = (*poses.notes, *notes)
        return Trajectory(curve, float(times[0]), float(times[-1]), turning, notes, residual=residual)
