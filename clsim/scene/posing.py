"""Trajectories of parts of bodies through poses that follow each other closely."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from clsim.arrays import read_only
from clsim.scene.motion.curves import spline_through
from clsim.scene.motion.orientation import turning_between
from clsim.scene.motion.trajectory import Trajectory

if TYPE_CHECKING:
    from clsim.arrays import Floats

_TURNS, _EVERY = 1000.0, 4  # Hz of orientations; positions are splines through every fourth


def pose_times(start: float, end: float) -> Floats:
    """Return the instants (n,) at which poses are wanted, s: one a millisecond and 17 at least.

    Examples
    --------
    >>> len(pose_times(0.0, 2.0))
    2001
    """
    count = _EVERY * max(4, math.ceil((end - start) * _TURNS / _EVERY))
    return np.linspace(start, end, count + 1)


def through_poses(times: Floats, places: Floats, quaternions: Floats) -> Trajectory:
    """Return the motion through poses.

    Shapes: times (n,) s; places (n, 3) m; quaternions (n, 4).
    """
    curve = spline_through(times[::_EVERY], places[::_EVERY], "not-a-knot")
    turning = turning_between(read_only(times), quaternions)
    return Trajectory(curve, float(times[0]), float(times[-1]), turning)


def quaternions_along(along: Floats, aside: Floats | None = None) -> Floats:
    """Return orientations (n, 4), x y z w, whose z goes along directions and whose y goes aside.

    Shapes: along (n, 3); aside (n, 3).

    aside: what is not along it counts. Left out for what is round: it then turns about itself as little as it can.

    Examples
    --------
    >>> quaternions_along(np.array([[0.0, 0.0, 2.0]]), np.array([[0.0, 1.0, 0.5]])).tolist()
    [[0.0, 0.0, 0.0, 1.0]]
    """
    from scipy.spatial.transform import Rotation

    z = along / np.linalg.norm(along, axis=1, keepdims=True)
    if aside is None:
        y = np.empty_like(z)
        side = np.eye(3)[np.argmin(np.abs(z[0]))]
        for i, direction in enumerate(z):  # carried along from one to the next
            side = side - direction * (direction @ side)
            side = side / np.linalg.norm(side)
            y[i] = side
    else:
        y = aside - z * np.sum(aside * z, axis=1, keepdims=True)
        y = y / np.linalg.norm(y, axis=1, keepdims=True)
    return np.asarray(Rotation.from_matrix(np.stack([np.cross(y, z), y, z], axis=2)).as_quat())
