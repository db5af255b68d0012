"""Orientations over time: great arcs, hinges, and checks of what is given of a motion."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from clsim.arrays import FARTHEST, Floats, as_choice, as_floats, as_number, read_only
from clsim.errors import InputError, check_rising, warn
from clsim.numerics.quaternions import same_hemisphere
from clsim.scene.motion.curves import Piecewise

SHORTEST, LONGEST = 1e-9, 1e9  # s, bounds of lengths of time
_NO_LENGTH = 1e-100  # of a direction
_TWO_TURNS = 4.0 * np.pi + 1e-9  # rad


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


def as_choices(field_name: str, values: Any, choices: tuple[str, ...]) -> tuple[str, ...]:
    """Return a tuple of names."""
    if not isinstance(values, list | tuple):
        raise InputError(field_name, f"must be a list of names, but is {values!r:.80}")
    return tuple(as_choice(f"{field_name}[{i}]", value, choices) for i, value in enumerate(values))


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


def as_topic(value: Any) -> str:
    """Return the field ``topic``."""
    if not isinstance(value, str) or not value.strip():
        raise InputError("topic", f"must name the topic of a bag, such as '/robot/pose', but is {value!r:.80}")
    return value


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
    return GreatArcs(read_only(times), read_only(base), read_only(side), read_only(angle))


def as_quaternions(field: str, value: object, shape: tuple[int | None, ...]) -> Floats:
    """Return unit quaternions x y z w, freed of rounding in their norm."""
    quaternions = as_floats(field, value, shape, within=1e100)  # whose squares are numbers
    norm = np.linalg.norm(quaternions, axis=-1, keepdims=True)
    for index in np.argwhere(np.abs(norm[..., 0] - 1.0) > _UNIT_TOLERANCE)[:1].tolist():
        name = field + "".join(f"[{i}]" for i in index)
        raise InputError(name, f"must be a unit quaternion x y z w, but its norm is {norm[tuple(index)][0]:.6g}")
    unit: Floats = quaternions / norm
    return unit


def quaternion_product(left: Floats, right: Floats) -> Floats:
    """Return the Hamilton product of quaternions x y z w: turning by `right` first, then by `left`."""
    a, b = left[..., :3], right[..., :3]
    w, v = left[..., 3:], right[..., 3:]
    vector = w * b + v * a + np.cross(a, b)
    return np.concatenate([vector, w * v - np.sum(a * b, axis=-1, keepdims=True)], axis=-1)
