"""From measured positions to a smooth curve: how much to smooth, and what to tell the user about it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from clsim.arrays import Floats, as_number, read_only
from clsim.errors import InputError, warn
from clsim.numerics.quaternions import rotate
from clsim.scene.motion.curves import Piecewise, spline_through
from clsim.scene.motion.smoothing import smooth_by_cross_validation, smooth_by_residual

_BEACON = 40e3  # Hz, at which noise is given as Doppler
_SPEED_OF_SOUND = 343.0  # m/s, for that figure alone
_ROUGH = 50.0  # m/s², acceleration that hands, robots and drones hardly reach
# Speed noise of a cubic spline through white noise of unit deviation and unit step, rms over time: the square
# is the mean over ω of (3 / (2 + cos ω))² (2 − 2 cos ω) (66 + 52 cos ω + 2 cos 2ω) / 120, from B-splines.
_SPEED_NOISE = 1.5731


@dataclass(frozen=True, slots=True, eq=False)
class Placement:
    """A rigid motion from the file's axes into the room: turned by a quaternion (4,), moved by (3,) m."""

    rotation: Floats
    translation: Floats

    def __call__(self, points: Floats) -> Floats:
        """Return points (n, 3) m in the room."""
        return rotate(self.rotation, points) + self.translation


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """A curve through measured points, the residual rms (3,) m or None, and sentences about it."""

    curve: Piecewise
    residual: Floats | None
    notes: tuple[str, ...]


def as_smooth(value: Any) -> bool | float:
    """Return the strength of smoothing: True, False or a residual in m."""
    if isinstance(value, bool | np.bool_):
        return bool(value)
    if isinstance(value, str):
        raise InputError("smooth", f"must be true, false or a residual in m, but is {value!r:.80}")
    return as_number("smooth", value, at_least=1e-9, at_most=1e3, unit="m")


def fit_measured(times: Floats, positions: Floats, smooth: bool | float, place: Placement) -> Fit:
    """Return the spline of measured points, smoothed in the axes in which they were measured.

    Shapes: times (n,) s; positions (n, 3) m.

    smooth: true removes white noise (generalised cross-validation), a number leaves that rms residual per axis, m, and
    False goes through the points.
    """
    if smooth is False:
        speed = speed_noise(times, positions)
        doppler = _BEACON * speed / _SPEED_OF_SOUND
        note = (
            f"Not smoothed: noise of the positions makes the speed noisy, by {1e3 * speed:.2g} mm/s rms "
            f"along the noisiest axis, which is about {doppler:.2g} Hz of Doppler noise at 40 kHz."
        )
        warn(f"trajectory: {note}")
        return Fit(spline_through(times, place(positions), "not-a-knot"), None, (note,))
    try:
        if smooth is True:
            found, how = smooth_by_cross_validation(times, positions), "generalised cross-validation"
        else:
            found, how = smooth_by_residual(times, positions, smooth), f"a residual of {1e3 * smooth:.4g} mm"
    except np.linalg.LinAlgError as error:
        problem = "cannot be done for these times, whose steps are too uneven; give smooth=false"
        raise InputError("smooth", problem) from error
    moved = ", ".join(f"{1e3 * r:.3g}" for r in found.residual)
    note = f"Smoothed by {how}: points moved by {moved} mm rms along x, y, z of the file."
    curve = spline_through(times, place(found.points), "natural")
    _warn_if_rough(curve, times)
    return Fit(curve, read_only(found.residual), (note,))


def speed_noise(times: Floats, positions: Floats) -> float:
    """Return an estimate of the rms speed noise of a cubic spline through measured points, m/s.

    Shapes: times (n,) s; positions (n, 3) m.

    The k-th difference of white noise of variance σ² has the variance ``σ² binom(2k, k)``, while that of a smooth
    motion vanishes as the step to the power k; k = 5 here. The spline turns σ into ``1.573 σ / step`` of speed.

    Examples
    --------
    >>> import numpy as np
    >>> t = np.linspace(0.0, 10.0, 1001)
    >>> noise = np.random.default_rng(1).normal(scale=1e-4, size=(1001, 3))
    >>> round(speed_noise(t, noise + np.sin(t)[:, None]), 3)  # 1.573 * 1e-4 / 0.01
    0.016
    """
    order = min(5, len(times) - 1)
    variance = np.mean(np.diff(positions, n=order, axis=0) ** 2, axis=0) / math.comb(2 * order, order)
    return _SPEED_NOISE * math.sqrt(float(np.max(variance))) / float(np.median(np.diff(times)))


def _warn_if_rough(curve: Piecewise, times: Floats) -> None:
    acceleration = np.linalg.norm(curve.polynomial(times, nu=2), axis=1)
    i = int(np.argmax(acceleration))
    if acceleration[i] > _ROUGH:
        warn(
            f"trajectory: accelerates by {acceleration[i]:.3g} m/s² at {times[i]:.6g} s, more than "
            f"{_ROUGH:g}: the noise may not be white (dropouts, filters); smooth=<metres> smooths more"
        )
