"""Motions of endpoints, scatterers and faces as cubics between knots, which a device can evaluate at any time."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Floats, read_only
from clsim.numerics.quaternions import cross_product, rotate
from clsim.paths.legs.mirrors import ROOM, Mirrors, dot
from clsim.scene.body import Body
from clsim.scene.directivity.patterns import Omni
from clsim.scene.ends import Source
from clsim.scene.motion.curves import CONTINUATION
from clsim.scene.motion.motion import Motion

KNOT_RATES = (50.0, 100.0, 200.0, 400.0, 800.0, 1600.0, 3200.0)  # knots per second, tried in this order
CUBIC_COLUMNS = 12  # coefficients of a position or an axis between two knots, [power][xyz]
EVALUATED_AT = 0.5, 0.2764  # of the way from knot to knot: what repeats with knots may be right in the middle alone
_AXIS = np.array([1.0, 0.0, 0.0])
_AXIS_TOLERANCE = 1e-6  # rad: narrow beams are steep at their sides, where they are heard 30 dB below the axis
_BESIDE = 1e-9  # of the way from knot to knot: so far from a knot angular velocities are taken, which may jump there
_KNOTS_AT_A_TIME = 20_000  # knots looked at at a time
POSE_COLUMNS = 38  # time of the knot, knots per second until the next one, and cubics of a position and two axes
_CORNERS = 4  # corners of a motion in a cell, about
_CELLS_AT_A_TIME = 2048  # cells looked at at a time
_CELLS = 16  # cells of which whole numbers are made: kinds of paths that ask for about the same have the same ones
_KNOWN = 4  # scenes and chunks whose poses are kept
FACE_COLUMNS = 16  # coefficients of a normal between two knots, [power][xyz], and of the offset, [power]


def knot_rate(source: Source, end: float, tolerance: float) -> float:
    """Return knots per second such that positions, and the axis of a directivity, are right between them."""
    if math.isinf(source.trajectory.end):
        return 1.0
    good = (rate for rate in KNOT_RATES if _knot_error(source, end, rate, tolerance) <= tolerance)
    return next(good, KNOT_RATES[-1])


def motion_knots(
    source: Source, start: float, end: float, rate: float, *, sideways: bool = False
) -> tuple[Floats, float]:
    """Cubics (knots, 24 or 36) of position and axes, [power][xyz] in knots' lengths, and the first knot's time."""
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


def _knot_error(source: Source, end: float, rate: float, tolerance: float) -> float:
    """Return the largest error of the cubics between knots, m; that of the axis on the same scale."""
    largest, trajectory, step = 0.0, source.trajectory, 1.0 / rate
    for first in range(0, math.ceil(end * rate), _KNOTS_AT_A_TIME):
        times = np.arange(first, min(first + _KNOTS_AT_A_TIME, math.ceil(end * rate)) + 1, dtype=np.float64) / rate
        cubic = cubics_between(trajectory.position(times), trajectory.velocity(times) / rate)
        axis = [] if isinstance(source.directivity, Omni) else _axis_cubics(source, times, _AXIS, step)
        for share in EVALUATED_AT:
            there, aimed = (sum(c * share**power for power, c in enumerate(cubics)) for cubics in (cubic, axis))
            error = np.linalg.norm(there - trajectory.position(times[:-1] + share / rate), axis=1)
            largest = max(largest, float(error.max()))
            if axis:
                off = np.linalg.norm(aimed - rotate(source.orientation(times[:-1] + share * step), _AXIS), axis=1)
                largest = max(largest, float(off.max()) * tolerance / _AXIS_TOLERANCE)
    return largest


@lru_cache(maxsize=_KNOWN)
def pose_rate(motions: tuple[Motion, ...], radii: tuple[float, ...], end: float, tolerance: float) -> float:
    """Return cells per second such that what is at most a radius from the centre of each thing is in its place."""
    least = KNOT_RATES[0]
    for motion, radius in zip(motions, radii, strict=True):
        many = len(_corners(motion, 0.0, end)) / (_CORNERS * max(end, 1e-3))
        good = (r for r in KNOT_RATES if r >= max(least, many) and _is_right(motion, radius, end, r, tolerance))
        least = next(good, KNOT_RATES[-1])
    return least


@lru_cache(maxsize=_KNOWN)
def pose_knots(
    motions: tuple[Motion, ...], start: float, end: float, rate: float
) -> tuple[Floats, NDArray[np.int32], float]:
    """Return knots (n, 38) of things from `start` to `end`, s, which of them begin cells (things, cells + 1), and when.

    Knots are at the beginning of every cell and wherever the motion has a corner: time, s, knots per second until the
    next one, and coefficients [power][xyz] of position, m, and first two axes in units of the piece's length.
    """
    first, last = (_CELLS * round_to(at * rate / _CELLS) for round_to, at in ((math.floor, start), (math.ceil, end)))
    grid = np.arange(first, max(last, first + 1) + 1) / rate
    rows, cells, known = [], np.empty((len(motions), len(grid)), dtype=np.int32), 0
    for i, motion in enumerate(motions):
        times = np.union1d(grid, _corners(motion, grid[0], grid[-1]))
        cells[i] = known + np.searchsorted(times, grid)
        rows.append(_pieces(motion, times))
        known += len(times) - 1
    return read_only(np.concatenate(rows)), read_only(cells), first / rate


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
    columns += _from_slopes(place, motion.velocity(after) * step, motion.velocity(before) * step)
    if not motion.turns:
        held = np.zeros((2, 4, 3))
        held[:, 0] = rotate(motion.orientation(times[0]), np.eye(3)[:2])
        return np.concatenate([*columns, np.broadcast_to(held.ravel(), (len(length), held.size))], axis=1)
    turned = motion.orientation(times)
    turn = [motion.angular_velocity(t) * step for t in (after, before)]
    for axis in np.eye(3)[:2]:
        moved = rotate(turned, axis)
        columns += _from_slopes(moved, cross_product(turn[0], moved[:-1]), cross_product(turn[1], moved[1:]))
    return np.concatenate(columns, axis=1)


def _is_right(motion: Motion, radius: float, end: float, rate: float, tolerance: float) -> bool:
    """Test if cubics are right within a tolerance, m, in the middle of all pieces."""
    if motion.is_static and not motion.turns:
        return True
    last = math.ceil(end * rate) + 1
    for first in range(0, last, _CELLS_AT_A_TIME):
        grid = np.arange(first, min(first + _CELLS_AT_A_TIME, last) + 1) / rate
        times = np.union1d(grid, _corners(motion, grid[0], grid[-1]))
        pieces = _pieces(motion, times)[:, 2:].reshape(-1, 3, 4, 3)
        for share in EVALUATED_AT:
            at = np.einsum("p,napx->nax", share ** np.arange(4), pieces)
            now = times[:-1] + share * np.diff(times)
            wrong = np.linalg.norm(at[:, 0] - motion.position(now), axis=1)
            for i, axis in enumerate(np.eye(3)[: 2 if motion.turns else 0]):
                wrong += radius * np.linalg.norm(at[:, 1 + i] - rotate(motion.orientation(now), axis), axis=1)
            if wrong.max() > tolerance:
                return False
    return True


def face_rate(mirrors: Mirrors, end: float, tolerance: float) -> float:
    """Return knots per second such that the faces of all bodies are right between them."""
    moving = [body for body in mirrors.bodies if not body.is_static]
    if not moving:
        return 1.0
    ends = [min(end, body.time_range[1] or end) for body in moving]
    for rate in KNOT_RATES:
        if all(_face_error(body, last, rate) <= tolerance for body, last in zip(moving, ends, strict=True)):
            break
    return rate


def face_knots(
    mirrors: Mirrors, faces: NDArray[np.signedinteger[Any]], start: float, end: float, rate: float
) -> tuple[Floats, float]:
    """Return cubics (n, knots, 16) of faces (n,) from `start` to `end`, s, and the time of the first knot.

    They are coefficients [power][xyz] of normals, in units of the knot's length, and [power] of offsets, m.
    """
    first = math.floor(start * rate)
    times = np.arange(first, math.ceil(end * rate) + 2, dtype=np.float64) / rate
    columns = np.zeros((len(faces), len(times) - 1, FACE_COLUMNS))
    poses = {owner: _Poses.of(mirrors.bodies[owner], times) for owner in set(mirrors.owner[faces].tolist()) - {ROOM}}
    for row, face in enumerate(faces.tolist()):
        owner, normal, offset = int(mirrors.owner[face]), mirrors.normal[face], float(mirrors.offset[face])
        if owner == ROOM:
            columns[row, :, :3], columns[row, :, 12] = normal, offset
        else:
            columns[row] = _face_cubics(*poses[owner].plane(normal, offset), rate)
    return columns, first / rate


@dataclass(frozen=True, slots=True, eq=False)
class _Poses:
    """A body at T times: how it is turned (T, 4), where its origin is (T, 3), m, and both velocities."""

    orientation: Floats
    turning: Floats
    origin: Floats
    velocity: Floats

    @staticmethod
    def of(body: Body, times: Floats) -> _Poses:
        own = body.trajectory
        return _Poses(own.orientation(times), own.angular_velocity(times), own.position(times), own.velocity(times))

    def plane(self, own: Floats, offset: float) -> tuple[Floats, Floats, Floats, Floats]:
        """Return normals (T, 3) and offsets (T,) of a face, from its own ones, and their derivatives by time."""
        normal = rotate(self.orientation, own)
        turning = cross_product(self.turning, normal)
        rising = dot(turning, self.origin) + dot(normal, self.velocity)
        return normal, offset + dot(normal, self.origin), turning, rising


def _face_cubics(normal: Floats, offset: Floats, turning: Floats, rising: Floats, rate: float) -> Floats:
    """Return coefficients (T - 1, 16) between values at knots, with derivatives by time."""
    powers = [*cubics_between(normal, turning / rate), *(c[:, None] for c in cubics_between(offset, rising / rate))]
    return np.concatenate(powers, axis=1)


def _face_error(body: Body, end: float, rate: float) -> float:
    """Errors of planes through a body between knots, at its points, m."""
    largest = 0.0
    for first in range(0, math.ceil(end * rate) + 1, _KNOTS_AT_A_TIME):
        times = np.arange(first, min(first + _KNOTS_AT_A_TIME, math.ceil(end * rate) + 1) + 1, dtype=np.float64) / rate
        knots = _Poses.of(body, times)
        found = [_face_cubics(*knots.plane(axis, 0.0), rate) for axis in np.eye(3)]
        for share in EVALUATED_AT:
            between, powers = _Poses.of(body, times[:-1] + share / rate), share ** np.arange(4)
            for axis, cubics in zip(np.eye(3), found, strict=True):
                normal, offset, _, _ = between.plane(axis, 0.0)
                tilted = np.einsum("tpx,p->tx", cubics[:, :12].reshape(-1, 4, 3), powers) - normal
                apart = cubics[:, 12:] @ powers - offset - dot(tilted, between.origin)
                largest = max(largest, float((np.abs(apart) + body.radius * np.linalg.norm(tilted, axis=1)).max()))
    return largest
