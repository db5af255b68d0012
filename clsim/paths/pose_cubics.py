"""Where things are and how they are turned, as cubics between knots: what a device can evaluate at any time."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from clsim.numerics.quaternions import cross_product, rotate
from clsim.paths.trajectory_cubics import KNOT_RATES, LOOKED_AT
from clsim.scene.motion.curves import CONTINUATION

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from clsim.arrays import Floats
    from clsim.scene.motion.motion import Motion

POSE_COLUMNS = 38  # time of the knot, knots per second until the next one, and cubics of a position and two axes
_BESIDE = 1e-9  # of a piece: so far from its ends velocities are taken, which may jump there
_CORNERS = 4  # corners of a motion in a cell, about
_SLICE = 2048  # cells looked at at a time


def pose_rate(motions: Sequence[Motion], radii: Sequence[float], end: float, tolerance: float) -> float:
    """Return cells per second such that what is at most a radius from the centre of each thing is where it should be.

    The least rate of `KNOT_RATES` whose cubics are right between knots; where a motion has more corners than a few in a
    cell, more.
    """
    least = KNOT_RATES[0]
    for motion, radius in zip(motions, radii, strict=True):
        many = len(_corners(motion, 0.0, end)) / (_CORNERS * max(end, 1e-3))
        good = (r for r in KNOT_RATES if r >= max(least, many) and _is_right(motion, radius, end, r, tolerance))
        least = next(good, KNOT_RATES[-1])
    return least


def pose_knots(
    motions: Sequence[Motion], start: float, end: float, rate: float
) -> tuple[Floats, NDArray[np.int32], float]:
    """Return cubics of positions and axes of things from `start` to `end`, and where to find them.

    Shapes: result (knots, 38) s, (things, cells + 1).

    knots: at the beginning of every cell and wherever the motion has a corner: time, s, and knots per second until the
    next one, and for the position, m, and the first two axes of the thing in the room coefficients [power][xyz] in
    units of the piece's length.
    """
    first, last = math.floor(start * rate), math.ceil(end * rate)
    grid = np.arange(first, max(last, first + 1) + 1) / rate
    rows, cells, known = [], np.empty((len(motions), len(grid)), dtype=np.int32), 0
    for i, motion in enumerate(motions):
        times = np.union1d(grid, _corners(motion, grid[0], grid[-1]))
        cells[i] = known + np.searchsorted(times, grid)
        rows.append(_pieces(motion, times))
        known += len(times) - 1
    return np.concatenate(rows), cells, first / rate


def _corners(motion: Motion, start: float, end: float) -> Floats:
    """Return when velocities of a motion may jump between two times, s."""
    turning = np.empty(0) if motion.turning is None else motion.turning.breaks
    ends = np.array([motion.start - CONTINUATION, motion.end + CONTINUATION])
    corners = np.concatenate([motion.breaks, turning, ends])
    return np.asarray(corners[(corners > start) & (corners < end)])


def _pieces(motion: Motion, times: Floats) -> Floats:
    """Return the rows of the knots (n - 1, 38) at times (n,) but the last, s."""
    length = np.diff(times)
    beside = np.minimum(np.maximum(_BESIDE * length, 4.0 * np.spacing(np.abs(times[1:]))), 0.5 * length)
    after, before = times[:-1] + beside, times[1:] - beside
    step, place = length[:, None], motion.position(times)
    columns = [times[:-1, None], 1.0 / step]
    columns += _cubics(place, motion.velocity(after) * step, motion.velocity(before) * step)
    turned = motion.orientation(times)
    turn = [motion.angular_velocity(t) * step for t in (after, before)]
    for axis in np.eye(3)[:2]:
        way = rotate(turned, axis)
        columns += _cubics(way, cross_product(turn[0], way[:-1]), cross_product(turn[1], way[1:]))
    return np.concatenate(columns, axis=1)


def _cubics(values: Floats, after: Floats, before: Floats) -> list[Floats]:
    """Return coefficients between neighbouring values (n, 3), lowest power first, from slopes at both ends of each."""
    v0, v1 = values[:-1], values[1:]
    return [v0, after, 3.0 * (v1 - v0) - 2.0 * after - before, after + before - 2.0 * (v1 - v0)]


def _is_right(motion: Motion, radius: float, end: float, rate: float, tolerance: float) -> bool:
    """Test if cubics are right within a tolerance, m, in the middle of all pieces."""
    if motion.is_static and not motion.turns:
        return True
    last = math.ceil(end * rate) + 1
    for first in range(0, last, _SLICE):
        grid = np.arange(first, min(first + _SLICE, last) + 1) / rate
        times = np.union1d(grid, _corners(motion, grid[0], grid[-1]))
        pieces = _pieces(motion, times)[:, 2:].reshape(-1, 3, 4, 3)
        for share in LOOKED_AT:
            at = np.einsum("p,napx->nax", share ** np.arange(4), pieces)
            now = times[:-1] + share * np.diff(times)
            wrong = np.linalg.norm(at[:, 0] - motion.position(now), axis=1)
            for i, axis in enumerate(np.eye(3)[:2]):
                wrong += radius * np.linalg.norm(at[:, 1 + i] - rotate(motion.orientation(now), axis), axis=1)
            if wrong.max() > tolerance:
                return False
    return True
