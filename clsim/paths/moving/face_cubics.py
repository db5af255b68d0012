"""Mirrors as cubics between evenly spaced knots: what a device can evaluate at any time of reflection."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.numerics.quaternions import cross_product, rotate
from clsim.paths.moving.mirrors import ROOM, dot
from clsim.paths.trajectory_cubics import KNOT_RATES, LOOKED_AT, cubics_between

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Floats
    from clsim.paths.moving.mirrors import Mirrors
    from clsim.scene.body import Body

FACE_COLUMNS = 16  # coefficients of a normal between two knots, [power][xyz], and of the offset, [power]
_SLICE = 20_000  # knots looked at at a time


def face_rate(mirrors: Mirrors, end: float, tolerance: float) -> float:
    """Return knots per second such that the faces of all bodies are right between them.

    result: 1/s. The largest one there is where turns jump, as between waypoints: that leaves an error over one knot.
    """
    moving = [body for body in mirrors.bodies if not body.is_static]
    if not moving:
        return 1.0
    ends = [min(end, body.time_range[1] or end) for body in moving]
    good = (
        rate
        for rate in KNOT_RATES
        if all(_largest_error(body, last, rate) <= tolerance for body, last in zip(moving, ends, strict=True))
    )
    return next(good, KNOT_RATES[-1])


def face_knots(
    mirrors: Mirrors, faces: NDArray[np.signedinteger[Any]], start: float, end: float, rate: float
) -> tuple[Floats, float]:
    """Return cubics of mirrors from `start` to `end`, and the time of the first knot.

    Shapes: faces (n,); result (n, knots, 16) m.

    knots: of the plane ``normal @ x = offset``, m: coefficients [power][xyz] of the normal in units of the knot's
    length, and [power] of the offset.
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
            columns[row] = _cubics(*poses[owner].plane(normal, offset), rate)
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
        motion = body.trajectory
        return _Poses(
            motion.orientation(times), motion.angular_velocity(times), motion.position(times), motion.velocity(times)
        )

    def plane(self, own: Floats, offset: float) -> tuple[Floats, Floats, Floats, Floats]:
        """Return normals (T, 3) and offsets (T,) of a face, from its own ones, and their derivatives by time."""
        normal = rotate(self.orientation, own)
        turning = cross_product(self.turning, normal)
        rising = dot(turning, self.origin) + dot(normal, self.velocity)
        return normal, offset + dot(normal, self.origin), turning, rising


def _cubics(normal: Floats, offset: Floats, turning: Floats, rising: Floats, rate: float) -> Floats:
    """Return coefficients (T - 1, 16) between values at knots, with derivatives by time."""
    powers = [*cubics_between(normal, turning / rate), *(c[:, None] for c in cubics_between(offset, rising / rate))]
    return np.concatenate(powers, axis=1)


def _largest_error(body: Body, end: float, rate: float) -> float:
    """Errors of planes through a body between knots, at its points, m."""
    largest = 0.0
    for first in range(0, math.ceil(end * rate) + 1, _SLICE):
        times = np.arange(first, min(first + _SLICE, math.ceil(end * rate) + 1) + 1, dtype=np.float64) / rate
        knots = _Poses.of(body, times)
        found = [_cubics(*knots.plane(axis, 0.0), rate) for axis in np.eye(3)]
        for share in LOOKED_AT:
            between, powers = _Poses.of(body, times[:-1] + share / rate), share ** np.arange(4)
            for axis, cubics in zip(np.eye(3), found, strict=True):
                normal, offset, _, _ = between.plane(axis, 0.0)
                tilted = np.einsum("tpx,p->tx", cubics[:, :12].reshape(-1, 4, 3), powers) - normal
                apart = cubics[:, 12:] @ powers - offset - dot(tilted, between.origin)
                largest = max(largest, float((np.abs(apart) + body.radius * np.linalg.norm(tilted, axis=1)).max()))
    return largest
