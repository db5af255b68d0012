"""Orientations that follow from a motion: towards a point of the room, or along the motion itself."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from clsim.errors import InputError
from clsim.numerics.quaternions import normalised, rotate
from clsim.scene.motion.curves import CONTINUATION
from clsim.scene.motion.orientation import quaternion_product, turning_between

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from clsim.arrays import Floats
    from clsim.scene.motion.trajectory import Trajectory

    Directions = Callable[[Floats], tuple[Floats, NDArray[np.bool_]]]

_STEP = 1.0 / 32.0  # s, between the orientations that are tried first
_TOLERANCE = 1e-4  # rad, of the axis between two orientations
_WIDEST = 0.3  # rad, from one orientation to the next
_ROUNDS = 8  # halvings of the step
_SLOW = 0.02  # share of the top speed below which a motion has no direction: noise of measured rests is slower
_PAUSE = 0.2  # s, in which a motion may turn as it likes
_NEAREST = 1e-3  # m, to a point that is aimed at


def towards(motion: Trajectory, point: Floats) -> Trajectory:
    """Return a motion whose +x axis points at a point (3,) of its frame, m."""

    def directions(times: Floats) -> tuple[Floats, NDArray[np.bool_]]:
        """Return directions (T, 3) of any length, and that all of them are known."""
        away = point - motion.position(times)
        near = np.flatnonzero(np.linalg.norm(away, axis=1) < _NEAREST)
        if len(near):
            raise InputError(
                "aim_at", f"must be {_NEAREST:g} m away at least, but is where it aims from at {times[near[0]]:g} s"
            )
        return away, np.ones(len(times), dtype=bool)

    if motion.is_static:
        return replace(motion, turning=turning_between(np.zeros(1), _level(directions(np.zeros(1))[0])))
    return replace(motion, turning=turning_between(*_sampled(motion, directions)))


def forward(motion: Trajectory) -> Trajectory:
    """Return a motion whose +x axis points where it goes; in a rest it turns evenly from one direction to the next."""
    if motion.is_static:
        raise InputError("aim", 'must be a direction, or aim_at given, where nothing moves, but is "forward"')
    top = motion.peak_speed(motion.start, motion.end)[0]

    def directions(times: Floats) -> tuple[Floats, NDArray[np.bool_]]:
        """Return velocities (T, 3), and a mask of those that are no rest."""
        velocity = motion.velocity(np.clip(times, motion.start, motion.end))
        return velocity, np.linalg.norm(velocity, axis=1) > _SLOW * top

    times, turned = _sampled(motion, directions)
    axes = rotate(turned, (1.0, 0.0, 0.0))
    angle = _angle(axes[:-1], axes[1:])
    jumps = np.flatnonzero((angle > 2.0 * _WIDEST) & (np.diff(times) < _PAUSE))
    if len(jumps):
        raise InputError(
            "aim",
            'must not be "forward" where the direction of motion jumps, but it turns by '
            f"{np.degrees(angle[jumps[0]]):.0f} degrees at {times[jumps[0]]:.3f} s: "
            "join the points smoothly, or give orientations",
        )
    return replace(motion, turning=turning_between(times, turned))


def _sampled(motion: Trajectory, directions: Directions) -> tuple[Floats, Floats]:
    """Return times (n,) and orientations (n, 4) between which great arcs hold the axis within `_TOLERANCE`."""
    inner = np.linspace(motion.start, motion.end, int(np.ceil(motion.duration / _STEP)) + 1)
    times = np.concatenate([[motion.start - CONTINUATION], inner, [motion.end + CONTINUATION]])
    found, known = directions(times)
    for _ in range(_ROUNDS):
        middle = 0.5 * (times[:-1] + times[1:])
        there, clear = directions(middle)
        bent = _angle(_axis_between(found[:-1], found[1:]), _unit(there)) > _TOLERANCE
        wide = _angle(_unit(found[:-1]), _unit(found[1:])) > _WIDEST
        new = ((bent | wide) & clear & known[:-1] & known[1:]) | (known[:-1] != known[1:])
        if not new.any():
            break
        order = np.argsort(np.concatenate([times, middle[new]]), kind="stable")
        times = np.concatenate([times, middle[new]])[order]
        found = np.concatenate([found, there[new]])[order]
        known = np.concatenate([known, clear[new]])[order]
    return times[known], _level(found[known])


def _level(directions: Floats) -> Floats:
    """Return quaternions (n, 4) that turn +x to directions (n, 3) and leave +y horizontal: no roll."""
    x, y, z = np.moveaxis(directions, -1, 0)
    heading, elevation, none = 0.5 * np.arctan2(y, x), 0.5 * np.arctan2(z, np.hypot(x, y)), np.zeros_like(x)
    about_z = np.stack([none, none, np.sin(heading), np.cos(heading)], axis=-1)
    about_y = np.stack([none, -np.sin(elevation), none, np.cos(elevation)], axis=-1)
    return quaternion_product(about_z, about_y)


def _axis_between(before: Floats, after: Floats) -> Floats:
    """Return the axes (n, 3) in the middle of the great arcs between the orientations of directions (n, 3)."""
    first, second = _level(before), _level(after)
    sign = np.where(np.sum(first * second, axis=-1, keepdims=True) < 0.0, -1.0, 1.0)
    return rotate(normalised(first + sign * second), (1.0, 0.0, 0.0))


def _unit(directions: Floats) -> Floats:
    return np.asarray(directions / np.maximum(np.linalg.norm(directions, axis=-1, keepdims=True), 1e-300))


def _angle(first: Floats, second: Floats) -> Floats:
    """Return the angles (n,) between unit vectors (n, 3), rad."""
    return np.asarray(2.0 * np.arcsin(np.minimum(0.5 * np.linalg.norm(first - second, axis=-1), 1.0)))
