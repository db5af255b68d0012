"""Angles of a table that go a little beyond the axis and its opposite."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.errors import warn

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Floats

SAME_ANGLE = 1e-6  # degrees
OVERHANG = 15.0  # degrees beyond 0° or 180° that are taken for those of the other side


def overhangs(angles: Floats) -> bool:
    """Return whether angles (a,) in degrees go beyond 0° or 180°, but not far, and are not those of both sides."""
    beyond = angles[0] < -SAME_ANGLE or angles[-1] > 180.0 + SAME_ANGLE
    far = angles[0] < -OVERHANG - SAME_ANGLE or angles[-1] > 180.0 + OVERHANG + SAME_ANGLE
    return bool(beyond and not far and abs(angles[0] + angles[-1]) > SAME_ANGLE)


def within_half_turn(angles: Floats, values: NDArray[Any], unit: str) -> tuple[Floats, NDArray[Any]]:
    """Return the angles from 0° to 180°, and their values, of a table that overhangs.

    Shapes: angles (a,); values (a, f).

    Where no angle lies on the axis, or opposite, its values are those of a cubic spline through all angles.
    """
    from scipy.interpolate import CubicSpline

    made = [a for a in (0.0, 180.0) if angles[0] < a < angles[-1] and np.abs(angles - a).min() > SAME_ANGLE]
    if made and len(angles) > 1:
        joined = CubicSpline(angles, values)(made)
        order = np.argsort(np.concatenate([angles, made]), kind="stable")
        angles, values = np.concatenate([angles, made])[order], np.concatenate([values, joined])[order]
    kept = (angles >= -SAME_ANGLE) & (angles <= 180.0 + SAME_ANGLE)
    mirrored = np.where(angles < 90.0, -angles, 360.0 - angles)
    near = np.abs(angles[:, None] - mirrored[~kept]) <= 100.0 * SAME_ANGLE
    pairs = np.argwhere(near & kept[:, None])
    difference = ""
    if len(pairs):
        apart = float(np.abs(values[pairs[:, 0]] - values[~kept][pairs[:, 1]]).max())
        most = float(np.abs(values).max()) or 1.0
        difference = f" within {apart:.3g} dB" if unit else f" within {apart / most:.2g} of the largest value"
    warn(
        f"angles_degrees: go from {angles[0]:.6g}° to {angles[-1]:.6g}°; what lies beyond 0° and 180° is left out, for "
        f"the angles on the other side are there{difference and ', and the same'}{difference}"
    )
    return np.clip(angles[kept], 0.0, 180.0), values[kept]
