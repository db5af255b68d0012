"""Smooth curves through measured positions: cubic smoothing splines whose strength is found from the data.

The spline f minimises ``Σ (y_i − f(t_i))² + λ ∫ f″(t)² dt``. With Q and R the banded matrices of the second
differences (Green and Silverman, section 2.1), ``(R + λ QᵀQ) γ = Qᵀy`` and the residual is ``y − f = λ Q γ``.
The matrix has five diagonals, so everything here takes time in proportion to the number of points.

References
----------
P. J. Green, B. W. Silverman, "Nonparametric Regression and Generalized Linear Models", Chapman & Hall, 1994,
sections 2.1 to 2.3 (splines) and 3.1 to 3.3 (cross-validation).
P. Craven, G. Wahba, "Smoothing noisy data with spline functions", Numerische Mathematik 31, 1979.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from clsim.arrays import Floats, as_number, read_only
from clsim.errors import InputError, warn
from clsim.numerics.quaternions import rotate
from clsim.scene.motion.curves import Piecewise, spline_through

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


# ln λ, for times in units of the median step. The least λ leaves the points where they are: it takes 1e-4 of
# the fastest noise.
_LEAST, _STEP = np.log(1e-6), 0.25
# Largest λ QᵀQ, for which rounding is still harmless. With even steps, what is slower than 7000 steps passes.
_STIFFEST = 1e13


@dataclass(frozen=True, slots=True, eq=False)
class Smoothed:
    """Points without their noise.

    Shapes: points (n, k); residual (k,).

    points: values of the smoothing splines at their times; the natural cubic spline through them is the smoothing
    spline.
    """

    points: Floats
    residual: Floats


def smooth_by_cross_validation(times: Floats, values: Floats) -> Smoothed:
    """Smooth each column by the λ that generalised cross-validation chooses.

    Shapes: times (n,); values (n, k).

    λ minimises ``GCV(λ) = n Σ (y − f)² / tr(I − A)²``, A the matrix that turns y into f. The trace needs no inverse:
    ``tr(I − A) = tr(λ QᵀQ (R + λ QᵀQ)⁻¹) = d ln det(R + λ QᵀQ) / d ln λ``.
    """
    system = _system(times)
    grid = _STEP * np.arange(np.floor(_LEAST / _STEP) - 3, np.floor(system.greatest / _STEP) + 1)
    solved = [system.solve(strength, values) for strength in np.exp(grid)]
    freedom = _derivative(np.array([s[0] for s in solved]))
    squares = np.array([np.sum(s[1] ** 2, axis=0) for s in solved])[3:-3]
    residuals = np.empty_like(values)
    for column in range(values.shape[1]):
        score = np.log(np.maximum(squares[:, column], 1e-300)) - 2.0 * np.log(np.maximum(freedom, 1e-300))
        best = _lowest(grid[3:-3], score)
        residuals[:, column] = system.solve(np.exp(best), values[:, column])[1]
    return _smoothed(values, residuals)


def smooth_by_residual(times: Floats, values: Floats, residual: float) -> Smoothed:
    """Smooth each column until the root mean square of its residual is the one given.

    Shapes: times (n,); values (n, k).

    residual: in the unit of the values, above 0. A column that is nearer to a straight line than that becomes the
    straight line (or what is slower than 7000 steps), with the smaller residual it has.
    """
    from scipy.optimize import brentq

    system = _system(times)
    residuals = np.empty_like(values)
    for column in range(values.shape[1]):
        y = values[:, column]

        def excess(log_strength: float, y: Floats = y) -> float:
            left = system.solve(np.exp(log_strength), y)[1]
            return float(np.sqrt(np.mean(left**2))) - residual

        if excess(system.greatest) <= 0.0:
            best = system.greatest
        elif excess(_LEAST) >= 0.0:
            best = _LEAST
        else:
            best = brentq(excess, _LEAST, system.greatest, xtol=1e-6)
        residuals[:, column] = system.solve(np.exp(best), y)[1]
    return _smoothed(values, residuals)


@dataclass(frozen=True, slots=True, eq=False)
class _System:
    """Diagonals of Q (n x n - 2), and of R and QᵀQ in the lower banded form (3, n - 2)."""

    q: Floats
    r: Floats
    qq: Floats

    @property
    def greatest(self) -> float:
        """Largest ln λ that rounding allows."""
        return float(np.log(_STIFFEST / np.max(self.qq[0])))

    def solve(self, strength: float, values: Floats) -> tuple[float, Floats]:
        """Return ``ln det(R + λ QᵀQ)`` and the residual ``λ Q γ`` for values (n,) or (n, k)."""
        from scipy.linalg import cho_solve_banded, cholesky_banded

        factor = cholesky_banded(self.r + strength * self.qq, lower=True, check_finite=False)
        a, b, c = self.q if values.ndim == 1 else self.q[:, :, None]
        bends = a * values[:-2] + b * values[1:-1] + c * values[2:]
        gamma = strength * cho_solve_banded((factor, True), bends, check_finite=False)
        residual = np.zeros_like(values)
        residual[:-2] += a * gamma
        residual[1:-1] += b * gamma
        residual[2:] += c * gamma
        return 2.0 * float(np.sum(np.log(factor[0]))), residual


def _system(times: Floats) -> _System:
    """Set up the equations, with times in units of their median step."""
    step = np.diff(times)
    step = step / np.median(step)
    inverse = 1.0 / step
    a, b, c = q = np.stack([inverse[:-1], -(inverse[:-1] + inverse[1:]), inverse[1:]])
    r, qq = np.zeros((3, len(b))), np.zeros((3, len(b)))
    r[0] = (step[:-1] + step[1:]) / 3.0
    r[1, :-1] = step[1:-1] / 6.0
    qq[0] = a**2 + b**2 + c**2
    qq[1, :-1] = b[:-1] * a[1:] + c[:-1] * b[1:]
    qq[2, :-2] = c[:-2] * a[2:]
    return _System(q, r, qq)


def _derivative(samples: Floats) -> Floats:
    """Return the derivative on the grid, by central differences of sixth order, three fewer at each end."""
    weights = np.array([-1.0, 9.0, -45.0, 0.0, 45.0, -9.0, 1.0]) / (60.0 * _STEP)
    return np.convolve(samples, weights[::-1], mode="valid")


def _lowest(grid: Floats, score: Floats) -> float:
    """Return location of the lowest score: its lowest sample, refined by the parabola through three."""
    i = int(np.argmin(score))
    if i in (0, len(score) - 1):
        return float(grid[i])
    before, at, after = score[i - 1 : i + 2]
    bend = before - 2.0 * at + after
    return float(grid[i] + (0.5 * _STEP * (before - after) / bend if bend > 0.0 else 0.0))


def _smoothed(values: Floats, residuals: Floats) -> Smoothed:
    return Smoothed(values - residuals, np.sqrt(np.mean(residuals**2, axis=0)))
