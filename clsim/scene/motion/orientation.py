"""Orientation over time: unit quaternions x y z w, joined by great arcs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from clsim.arrays import Floats, as_floats, read_only
from clsim.errors import InputError
from clsim.numerics.quaternions import same_hemisphere
from clsim.scene.motion.curves import Piecewise

_UNIT_TOLERANCE = 1e-2  # largest error of a quaternion's norm that counts as rounding


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
    """Spherical linear interpolation between orientations, held before the first and after the last.

    On each piece ``q(u) = base cos(u Ω) + side sin(u Ω)``, u from 0 to 1, with the angle Ω between both quaternions and
    the unit quaternion `side` at a right angle to `base`; the last piece does not turn. The sign never jumps. Shapes:
    times (n,) s; base, side (n, 4); angle (n,) rad. K. Shoemake, "Animating rotation with quaternion curves", SIGGRAPH
    Computer Graphics 19(3), 1985.
    """

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
        """Return angular velocities in the room, rad/s, at `time` of any shape, with 3 more columns.

        At the end of a piece it is that of the next one; before the first and from the last orientation on it is 0.
        """
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
    return GreatArcs(read_only(times), read_only(base), read_only(side), read_only(angle))


def as_quaternions(field: str, value: object, shape: tuple[int | None, ...]) -> Floats:
    """Return unit quaternions x y z w, freed of rounding in their norm."""
    quaternions = as_floats(field, value, shape, within=1e100)  # whose squares are numbers
    norm = np.linalg.norm(quaternions, axis=-1, keepdims=True)
    bad = np.argwhere(np.abs(norm[..., 0] - 1.0) > _UNIT_TOLERANCE)
    if len(bad):
        index = tuple(bad[0])
        name = field + "".join(f"[{i}]" for i in index)
        raise InputError(name, f"must be a unit quaternion x y z w, but its norm is {norm[index][0]:.6g}")
    unit: Floats = quaternions / norm
    return unit


def quaternion_product(left: Floats, right: Floats) -> Floats:
    """Return the Hamilton product of quaternions x y z w: turning by `right` first, then by `left`."""
    a, b = left[..., :3], right[..., :3]
    w, v = left[..., 3:], right[..., 3:]
    vector = w * b + v * a + np.cross(a, b)
    return np.concatenate([vector, w * v - np.sum(a * b, axis=-1, keepdims=True)], axis=-1)
