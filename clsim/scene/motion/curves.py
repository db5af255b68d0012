"""Curves in space: positions and velocities as functions of time, without a beginning or an end."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal, Protocol

import numpy as np

from clsim.arrays import Floats, read_only, short_repr
from clsim.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from scipy.interpolate import PPoly

_SLICE = 65536  # cubics that are bounded at a time
CONTINUATION = 0.05  # s, by which a trajectory goes on before its start and after its end


class Curve(Protocol):
    """A position for every time; `time` has any shape, results have the same shape and 3 more columns."""

    def position(self, time: Floats) -> Floats:
        """Return positions, m."""
        ...

    def velocity(self, time: Floats) -> Floats:
        """Return velocities, m/s."""
        ...

    def speed_over(self, begin: Floats, end: Floats) -> Floats:
        """Return upper bounds of the speed between two times (n,), m/s; tighter for shorter intervals."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class Static:
    """A static point at `point` (3,) m."""

    point: Floats

    def position(self, time: Floats) -> Floats:
        out: Floats = np.empty((*time.shape, 3))
        out[...] = self.point
        return out

    def velocity(self, time: Floats) -> Floats:
        return np.zeros((*time.shape, 3))

    def speed_over(self, begin: Floats, end: Floats) -> Floats:
        return np.zeros(len(begin))


@dataclass(frozen=True, slots=True, eq=False)
class Straight:
    """A point that leaves `origin` (3,) m at time 0 with the constant `speed` (3,) m/s."""

    origin: Floats
    speed: Floats

    def position(self, time: Floats) -> Floats:
        return self.origin + time[..., None] * self.speed

    def velocity(self, time: Floats) -> Floats:
        return np.tile(self.speed, (*time.shape, 1))

    def speed_over(self, begin: Floats, end: Floats) -> Floats:
        return np.full(len(begin), np.linalg.norm(self.speed))


@dataclass(frozen=True, slots=True, eq=False)
class Circular:
    """A point on a circle at constant speed.

    ``x(t) = center + radius (e1 cos φ + e2 sin φ)`` with ``φ = phase + rate t``.

    Shapes: center, e1, e2 (3,) m.
    """

    center: Floats
    e1: Floats
    e2: Floats
    radius: float
    rate: float
    phase: float

    def position(self, time: Floats) -> Floats:
        angle = (self.phase + self.rate * time)[..., None]
        return self.center + self.radius * (np.cos(angle) * self.e1 + np.sin(angle) * self.e2)

    def velocity(self, time: Floats) -> Floats:
        angle = (self.phase + self.rate * time)[..., None]
        return self.radius * self.rate * (np.cos(angle) * self.e2 - np.sin(angle) * self.e1)

    def speed_over(self, begin: Floats, end: Floats) -> Floats:
        return np.full(len(begin), abs(self.radius * self.rate))


@dataclass(frozen=True, slots=True, eq=False)
class Piecewise:
    """Cubics, one after the other; at a kink the velocity is the one after it.

    polynomial, derivative: positions, m, and velocities, m/s, (3,) for each time, on the same range of times.
    """

    polynomial: PPoly
    derivative: PPoly
    _fastest: Floats = field(init=False, repr=False)  # bound of the speed on each cubic, m/s

    __repr__ = short_repr

    def __post_init__(self) -> None:
        knots = self.derivative.x
        slices = np.split(np.arange(len(knots) - 1), range(_SLICE, len(knots) - 1, _SLICE))
        fastest = [self._within(pieces, knots[pieces], knots[pieces + 1]) for pieces in slices]
        object.__setattr__(self, "_fastest", read_only(np.concatenate(fastest)))

    def position(self, time: Floats) -> Floats:
        return np.asarray(self.polynomial(time), dtype=np.float64)

    def velocity(self, time: Floats) -> Floats:
        return np.asarray(self.derivative(time), dtype=np.float64)

    def speed_over(self, begin: Floats, end: Floats) -> Floats:
        knots = self.derivative.x
        first, last = (np.clip(np.searchsorted(knots, t, "right") - 1, 0, len(knots) - 2) for t in (begin, end))
        one = first == last
        bound = np.empty(len(begin))
        bound[one] = self._within(first[one], begin[one], end[one])
        # Every second one of these ranges is between two others, and of no interest.
        pairs = np.stack([first[~one], last[~one] + 1], axis=1).ravel()
        bound[~one] = np.maximum.reduceat(np.append(self._fastest, 0.0), pairs)[::2] if len(pairs) else 0.0
        return bound

    def _within(self, piece: NDArray[np.int64], begin: Floats, end: Floats) -> Floats:
        """Return bounds of the speed between two times (n,) on one cubic each: it stays within its Bézier points."""
        u, v = ((t - self.derivative.x[piece])[:, None] for t in (begin, end))
        c2, c1, c0 = (self.derivative.c[power, piece] for power in range(3))
        points = (c0 + u * (c1 + u * c2), c0 + 0.5 * (u + v) * c1 + u * v * c2, c0 + v * (c1 + v * c2))
        return np.asarray(np.max([np.linalg.norm(point, axis=1) for point in points], axis=0))


def is_static(curve: Curve) -> bool:
    """Whether a curve is bitwise constant."""
    if isinstance(curve, Straight):
        return not np.any(curve.speed)
    if isinstance(curve, Piecewise):
        coefficients = curve.polynomial.c
        return not np.any(coefficients[:-1]) and not np.any(np.ptp(coefficients[-1], axis=0))
    return isinstance(curve, Static)


def frame_about(axis: Floats) -> tuple[Floats, Floats]:
    """Return the unit vectors from which and towards which a circle about `axis` turns at angle 0.

    Shapes: axis (3,); result (3,).

    e1, e2: e1 is +x projected on the plane across the axis (+y where the axis lies along x); e1, e2 and the axis are a
    right-handed frame.
    """
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


def spline_through(times: Floats, positions: Floats, ends: Literal["not-a-knot", "natural"]) -> Piecewise:
    """Return the C2 cubic spline through points, continued at its ends by `CONTINUATION`.

    Shapes: times (n,) s; positions (n, 3) m.

    ends: condition at both ends. With "not-a-knot" the error of a smooth motion stays of fourth order up to the ends;
    "natural" (second derivative zero) is what a smoothing spline has.

    result: continued by ``x0 + v0 u + a0 u²/2`` with the position, velocity and acceleration of the end.
    """
    from scipy.interpolate import CubicSpline

    spline = CubicSpline(times, positions, bc_type=ends)
    return _continued(np.asarray(spline.c, dtype=np.float64), np.asarray(times))


def legs_through(times: Floats, positions: Floats) -> Piecewise:
    """Return straight legs between points (n, 3) m at `times` (n,) s, continued by `CONTINUATION`."""
    speed = np.diff(positions, axis=0) / np.diff(times)[:, None]
    none = np.zeros_like(speed)
    return _continued(np.stack([none, none, speed, positions[:-1]]), np.asarray(times))


@dataclass(frozen=True, slots=True, eq=False)
class Onward:
    """A curve that goes on straight, at its last velocity, beyond two times, s."""

    curve: Curve
    first: float
    last: float

    def position(self, time: Floats) -> Floats:
        known = np.clip(time, self.first, self.last)
        return np.asarray(self.curve.position(known) + self.curve.velocity(known) * (time - known)[..., None])

    def velocity(self, time: Floats) -> Floats:
        return self.curve.velocity(np.clip(time, self.first, self.last))

    def speed_over(self, begin: Floats, end: Floats) -> Floats:
        return self.curve.speed_over(np.clip(begin, self.first, self.last), np.clip(end, self.first, self.last))


def onward(curve: Curve, first: float, last: float) -> Curve:
    """Return a curve that goes on smoothly beyond two times, s: lines and circles as they are."""
    return curve if isinstance(curve, Straight | Circular) else Onward(curve, first, last)


def kinks(times: Floats, positions: Floats) -> Floats:
    """Return those of `times` (n,) at which straight legs between `positions` (n, 3) change velocity."""
    speed = np.diff(positions, axis=0) / np.diff(times)[:, None]
    step = np.linalg.norm(np.diff(speed, axis=0), axis=1)
    scale = np.linalg.norm(speed, axis=1)
    jumps: Floats = times[1:-1][step > 1e-9 * np.maximum(scale[1:], scale[:-1])]
    return jumps


def _continued(coefficients: Floats, knots: Floats) -> Piecewise:
    """Add a parabola before and after cubic pieces (4, n, 3), highest power first, between knots (n + 1,)."""
    from scipy.interpolate import PPoly

    inner = PPoly(coefficients, knots)
    outer = []
    for at, shift in ((knots[0], -CONTINUATION), (knots[-1], 0.0)):  # shift of the parabola's own zero
        x, v, a = (np.asarray(inner(at, nu=order), dtype=np.float64) for order in range(3))
        outer.append(np.stack([np.zeros(3), a / 2, v + a * shift, x + v * shift + a / 2 * shift**2]))
    wide = np.concatenate([outer[0][:, None], coefficients, outer[1][:, None]], axis=1)
    ends = np.concatenate([[knots[0] - CONTINUATION], knots, [knots[-1] + CONTINUATION]])
    polynomial = PPoly(read_only(wide), read_only(ends))
    return Piecewise(polynomial, polynomial.derivative())
