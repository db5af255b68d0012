"""Trajectories as cubics between evenly spaced knots: what a device can evaluate at any emission time."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from clsim.numerics.quaternions import cross_product, rotate
from clsim.scene.directivity.patterns import Omni

if TYPE_CHECKING:
    from clsim.arrays import Floats
    from clsim.scene.ends import Source

KNOT_RATES = (50.0, 100.0, 200.0, 400.0, 800.0, 1600.0, 3200.0)  # knots per second, tried in this order
CUBIC_COLUMNS = 12  # coefficients of a position or an axis between two knots, [power][xyz]
LOOKED_AT = 0.5, 0.2764  # of the way from knot to knot: what repeats with knots may be right in the middle alone
_AXIS = np.array([1.0, 0.0, 0.0])
_AXIS_TOLERANCE = 1e-6  # rad: narrow beams are steep at their sides, where they are heard 30 dB below the axis
_BESIDE = 1e-9  # of the way from knot to knot: so far from a knot angular velocities are taken, which may jump there
_SLICE = 20_000  # knots looked at at a time


def knot_rate(source: Source, end: float, tolerance: float) -> float:
    """Return knots per second such that positions, and the axis of a directivity, are right between them.

    Orientations between waypoints turn at constant rates that jump; there the largest rate is taken, and what remains
    is an error of the axis over one knot.
    """
    if math.isinf(source.trajectory.end):
        return 1.0
    good = (rate for rate in KNOT_RATES if _largest_error(source, end, rate, tolerance) <= tolerance)
    return next(good, KNOT_RATES[-1])


def motion_knots(
    source: Source, start: float, end: float, rate: float, *, sideways: bool = False
) -> tuple[Floats, float]:
    """Return cubics of position and axis from `start` to `end`, and the time of the first knot.

    Shapes: result (knots, 24 or 36).

    knots: for position and axis, and second axis: coefficients [power][xyz] in units of the knot's length.
    """
    first = math.floor(start * rate)
    times = np.arange(first, math.ceil(end * rate) + 2, dtype=np.float64) / rate
    columns = cubics_between(source.trajectory.position(times), source.trajectory.velocity(times) / rate)
    for axis in np.eye(3)[: 2 if sideways else 1]:
        columns += _axis_cubics(source, times, axis, 1.0 / rate)
    return np.ascontiguousarray(np.concatenate(columns, axis=1)), first / rate


def cubics_between(values: Floats, slopes: Floats) -> list[Floats]:
    """Return the coefficients of the cubics between neighbouring values, lowest power first, from slopes per step."""
    return _from_slopes(values, slopes[:-1], slopes[1:])


def _from_slopes(values: Floats, s0: Floats, s1: Floats) -> list[Floats]:
    """Return the same from slopes at the begin and at the end of every piece."""
    v0, v1 = values[:-1], values[1:]
    return [v0, s0, 3 * (v1 - v0) - 2 * s0 - s1, s0 + s1 - 2 * (v1 - v0)]


def _axis_cubics(source: Source, times: Floats, axis: Floats, step: float) -> list[Floats]:
    """Return the coefficients of a source's axis between knots at `times`, by angular velocities beside them."""
    turned = rotate(source.orientation(times), axis)
    motion, beside = source.trajectory, np.maximum(_BESIDE * step, 4.0 * np.spacing(np.abs(times[1:])))
    after = cross_product(motion.angular_velocity(times[:-1] + beside), turned[:-1])
    before = cross_product(motion.angular_velocity(times[1:] - beside), turned[1:])
    return _from_slopes(turned, after * step, before * step)


def _largest_error(source: Source, end: float, rate: float, tolerance: float) -> float:
    """Return the largest error of the cubics between knots, m; that of the axis on the same scale."""
    largest = 0.0
    trajectory = source.trajectory
    for first in range(0, math.ceil(end * rate) + 1, _SLICE):
        times = np.arange(first, min(first + _SLICE, math.ceil(end * rate)) + 1, dtype=np.float64) / rate
        if len(times) < 2:
            break
        cubic = cubics_between(trajectory.position(times), trajectory.velocity(times) / rate)
        for share in LOOKED_AT:
            there = sum(c * share**power for power, c in enumerate(cubic))
            error = np.linalg.norm(there - trajectory.position(times[:-1] + share / rate), axis=1)
            largest = max(largest, float(error.max()))
        if not isinstance(source.directivity, Omni):
            largest = max(largest, _axis_error(source, times, 1.0 / rate) * tolerance / _AXIS_TOLERANCE)
    return largest


def _axis_error(source: Source, times: Floats, step: float) -> float:
    """Return the largest error of the axis between knots, rad."""
    cubic, largest = _axis_cubics(source, times, _AXIS, step), 0.0
    for share in LOOKED_AT:
        there = sum(c * share**power for power, c in enumerate(cubic))
        error = np.linalg.norm(there - rotate(source.orientation(times[:-1] + share * step), _AXIS), axis=1)
        largest = max(largest, float(error.max()))
    return largest
