"""Curves in space, without a beginning or an end, and those that smooth measured positions."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal, Protocol

import numpy as np
import scipy
from numpy.typing import NDArray

from clsim.arrays import Floats, as_number, read_only, short_repr
from clsim.errors import InputError, settle, warn

if TYPE_CHECKING:
    from scipy.interpolate import PPoly

_SLICE = 65536  # cubics that are bounded at a time
CONTINUATION = 0.05  # s, by which a trajectory goes on before its start and after its end
_BEACON = 40e3  # Hz, at which noise is given as Doppler
_SPEED_OF_SOUND = 343.0  # m/s, for that figure alone
_ROUGH = 50.0  # m/s², acceleration that hands, robots and drones hardly reach
# Speed noise of a cubic spline through white noise of unit deviation and unit step, rms over time: the square
# is the mean over ω of (3 / (2 + cos ω))² (2 − 2 cos ω) (66 + 52 cos ω + 2 cos 2ω) / 120, from B-splines.
_SPEED_NOISE = 1.5731
# ln λ, for times in units of the median step. The least λ leaves the points where they are: it takes 1e-4 of
# the fastest noise.
_LEAST, _STEP = np.log(1e-6), 0.25
# Largest λ QᵀQ, for which rounding is still harmless. With even steps, what is slower than 7000 steps passes.
_STIFFEST = 1e13


class Curve(Protocol):
    """A position for every time; `time` has any shape, results have the same shape and 3 more columns."""

    def position(self, time: Floats) -> Floats:
        """Return positions, m."""

    def velocity(self, time: Floats) -> Floats:
        """Return velocities, m/s."""

    def speed_over(self, begin: Floats, end: Floats) -> Floats:
        """Return upper bounds of the speed between two times (n,), m/s; tighter for shorter intervals."""


@dataclass(frozen=True, slots=True, eq=False)
class Static:
    """A static point at `point` (3,) m."""

    point: Floats

    def position(self, time: Floats) -> Floats:
        out: Floats = np.empty((*time.shape, 3))
        out[...] = self.point
        return out

    def velocity(self, time: Floats) -> Floats:
        return np.zeros((*time.shape, 3))

    def speed_over(self, begin: Floats, end: Floats) -> Floats:
        return np.zeros(len(begin))


@dataclass(frozen=True, slots=True, eq=False)
class Straight:
    """A point that leaves `origin` (3,) m at time 0 with the constant `speed` (3,) m/s."""

    origin: Floats
    speed: Floats

    def position(self, time: Floats) -> Floats:
        return self.origin + time[..., None] * self.speed

    def velocity(self, time: Floats) -> Floats:
        return np.tile(self.speed, (*time.shape, 1))

    def speed_over(self, begin: Floats, end: Floats) -> Floats:
        return np.full(len(begin), np.linalg.norm(self.speed))


@dataclass(frozen=True, slots=True, eq=False)
class Circular:
    """A point on a circle at constant speed: ``center + radius (e1 cos φ + e2 sin φ)``, m, ``φ = phase + rate t``."""

    center: Floats
    e1: Floats
    e2: Floats
    radius: float
    rate: float
    phase: float

    def position(self, time: Floats) -> Floats:
        angle = (self.phase + self.rate * time)[..., None]
        return self.center + self.radius * (np.cos(angle) * self.e1 + np.sin(angle) * self.e2)

    def velocity(self, time: Floats) -> Floats:
        angle = (self.phase + self.rate * time)[..., None]
        return self.radius * self.rate * (np.cos(angle) * self.e2 - np.sin(angle) * self.e1)

    def speed_over(self, begin: Floats, end: Floats) -> Floats:
        return np.full(len(begin), abs(self.radius * self.rate))


@dataclass(frozen=True, slots=True, eq=False)
class Piecewise:
    """Cubics for the position (3,), m, one after the other, and their derivative, m/s, at a kink that after it."""

    polynomial: PPoly
    derivative: PPoly
    _fastest: Floats = field(init=False, repr=False)  # bound of the speed on each cubic, m/s

    __repr__ = short_repr

    def __post_init__(self) -> None:
        knots = self.derivative.x
        slices = np.split(np.arange(len(knots) - 1), range(_SLICE, len(knots) - 1, _SLICE))
        fastest = [self._within(pieces, knots[pieces], knots[pieces + 1]) for pieces in slices]
        settle(self, _fastest=read_only(np.concatenate(fastest)))

    def position(self, time: Floats) -> Floats:
        return np.asarray(self.polynomial(time), dtype=np.float64)

    def velocity(self, time: Floats) -> Floats:
        return np.asarray(self.derivative(time), dtype=np.float64)

    def speed_over(self, begin: Floats, end: Floats) -> Floats:
        knots = self.derivative.x
        first, last = (np.clip(np.searchsorted(knots, t, "right") - 1, 0, len(knots) - 2) for t in (begin, end))
        one = first == last
        bound = np.empty(len(begin))
        bound[one] = self._within(first[one], begin[one], end[one])
        # Every second one of these ranges is between two others, and of no interest.
        pairs = np.stack([first[~one], last[~one] + 1], axis=1).ravel()
        bound[~one] = np.maximum.reduceat(np.append(self._fastest, 0.0), pairs)[::2] if len(pairs) else 0.0
        return bound

    def _within(self, piece: NDArray[np.int64], begin: Floats, end: Floats) -> Floats:
        """Return bounds of the speed between two times (n,) on one cubic each: it stays within its Bézier points."""
        u, v = ((t - self.derivative.x[piece])[:, None] for t in (begin, end))
        c2, c1, c0 = (self.derivative.c[power, piece] for power in range(3))
        points = (c0 + u * (c1 + u * c2), c0 + 0.5 * (u + v) * c1 + u * v * c2, c0 + v * (c1 + v * c2))
        return np.asarray(np.max([np.linalg.norm(point, axis=1) for point in points], axis=0))


def is_static(curve: Curve) -> bool:
    """Whether a curve is bitwise constant."""
    if isinstance(curve, Straight):
        return not np.any(curve.speed)
    if isinstance(curve, Piecewise):
        coefficients = curve.polynomial.c
        return not np.any(coefficients[:-1]) and not np.any(np.ptp(coefficients[-1], axis=0))
    return isinstance(curve, Static)


def frame_about(axis: Floats) -> tuple[Floats, Floats]:
    """Return the unit vectors (3,) from which and towards which a circle about `axis` (3,) turns at angle 0."""
    # The first is +x projected on the plane across the axis (+y where the axis lies along x); both and the axis are a
    # right-handed frame.
    largest = np.abs(axis).max()
    if largest == 0.0:
        raise InputError("axis", "must be a direction, but is 0, 0, 0")
    axis = axis / largest
    axis = axis / np.linalg.norm(axis)
    along_x = np.hypot(axis[1], axis[2]) < 1e-6
    reference = np.array([0.0, 1.0, 0.0] if along_x else [1.0, 0.0, 0.0])
    e1 = reference - axis * np.dot(axis, reference)
    e1 /= np.linalg.norm(e1)
    return e1, np.cross(axis, e1)


def spline_through(times: Floats, positions: Floats, ends: Literal["not-a-knot", "natural"]) -> Piecewise:
    """Return the C2 cubic spline through points (n, 3), m, at times (n,), s, continued at its ends by `CONTINUATION`.

    With the ends "not-a-knot" the error of a smooth motion stays of fourth order up to them; "natural" is what a
    smoothing spline has. It is continued by ``x0 + v0 u + a0 u²/2`` with position, velocity and acceleration of the
    end.
    """
    if len(times) == 3 and ends == "not-a-knot":
        spline = scipy.interpolate.CubicHermiteSpline(
            times, positions, _parabola_slopes(np.asarray(times), np.asarray(positions))
        )
    else:
        spline = scipy.interpolate.CubicSpline(times, positions, bc_type=ends)
    return _continued(np.asarray(spline.c, dtype=np.float64), np.asarray(times))


def _parabola_slopes(times: Floats, positions: Floats) -> Floats:
    """Slopes (3, 3) of the parabola through three points, as `CubicSpline` has them."""
    # SciPy's own solution starts threads of its library, which stay busy for 20 ms: more than the plan of a short
    # scene.
    (first, second), across = np.diff(times), np.diff(positions, axis=0) / np.diff(times)[:, None]
    matrix = np.array([[1.0, 1.0, 0.0], [second, 2 * (first + second), first], [0.0, 1.0, 1.0]])
    wanted = np.stack([2 * across[0], 3 * (first * across[1] + second * across[0]), 2 * across[1]])
    return np.asarray(np.linalg.solve(matrix, wanted))


def legs_through(times: Floats, positions: Floats) -> Piecewise:
    """Return straight legs between points (n, 3) m at `times` (n,) s, continued by `CONTINUATION`."""
    speed = np.diff(positions, axis=0) / np.diff(times)[:, None]
    none = np.zeros_like(speed)
    return _continued(np.stack([none, none, speed, positions[:-1]]), np.asarray(times))


@dataclass(frozen=True, slots=True, eq=False)
class Onward:
    """A curve that goes on straight, at its last velocity, beyond two times, s."""

    curve: Curve
    first: float
    last: float

    def position(self, time: Floats) -> Floats:
        known = np.clip(time, self.first, self.last)
        found, beyond = self.curve.position(known), time != known
        found[beyond] += self.curve.velocity(known[beyond]) * (time - known)[beyond][..., None]
        return found

    def velocity(self, time: Floats) -> Floats:
        return self.curve.velocity(np.clip(time, self.first, self.last))

    def speed_over(self, begin: Floats, end: Floats) -> Floats:
        return self.curve.speed_over(np.clip(begin, self.first, self.last), np.clip(end, self.first, self.last))


def onward(curve: Curve, first: float, last: float) -> Curve:
    """Return a curve that goes on smoothly beyond two times, s: lines and circles as they are."""
    return curve if isinstance(curve, Straight | Circular) else Onward(curve, first, last)


def kinks(times: Floats, positions: Floats) -> Floats:
    """Return those of `times` (n,) at which straight legs between `positions` (n, 3) change velocity."""
    speed = np.diff(positions, axis=0) / np.diff(times)[:, None]
    step = np.linalg.norm(np.diff(speed, axis=0), axis=1)
    scale = np.linalg.norm(speed, axis=1)
    jumps: Floats = times[1:-1][step > 1e-9 * np.maximum(scale[1:], scale[:-1])]
    return jumps


def _continued(coefficients: Floats, knots: Floats) -> Piecewise:
    """Add a parabola before and after cubic pieces (4, n, 3), highest power first, between knots (n + 1,)."""
    inner = scipy.interpolate.PPoly(coefficients, knots)
    outer = []
    for at, shift in ((knots[0], -CONTINUATION), (knots[-1], 0.0)):  # shift of the parabola's own zero
        x, v, a = (np.asarray(inner(at, nu=order), dtype=np.float64) for order in range(3))
        outer.append(np.stack([np.zeros_like(a), a / 2, v + a * shift, x + v * shift + a / 2 * shift**2]))
    wide = np.concatenate([outer[0][:, None], coefficients, outer[1][:, None]], axis=1)
    ends = np.concatenate([[knots[0] - CONTINUATION], knots, [knots[-1] + CONTINUATION]])
    polynomial = scipy.interpolate.PPoly(read_only(wide), read_only(ends))
    return Piecewise(polynomial, polynomial.derivative())


def as_smooth(value: Any) -> bool | float:
    """Return the strength of smoothing: True, False or a residual in m."""
    if isinstance(value, bool | np.bool_):
        return bool(value)
    if isinstance(value, str):
        raise InputError("smooth", f"must be true, false or a residual in m, but is {value!r:.80}")
    return as_number("smooth", value, at_least=1e-9, at_most=1e3, unit="m")


def fit_measured(
    times: Floats, positions: Floats, smooth: bool | float, place: Callable[[Floats], Floats]
) -> tuple[Piecewise, Floats | None, tuple[str, ...]]:
    """Return the spline of points (n, 3), m, measured at times (n,), s, smoothed in the axes of the measurement."""
    # smooth: true removes white noise (generalised cross-validation), a number leaves that rms residual per axis, m,
    # and False goes through the points.
    if smooth is False:
        speed = speed_noise(times, positions)
        doppler = _BEACON * speed / _SPEED_OF_SOUND
        note = (
            f"Not smoothed: noise of the positions makes the speed noisy, by {1e3 * speed:.2g} mm/s rms "
            f"along the noisiest axis, which is about {doppler:.2g} Hz of Doppler noise at 40 kHz."
        )
        warn(f"trajectory: {note}")
        return spline_through(times, place(positions), "not-a-knot"), None, (note,)
    try:
        if smooth is True:
            left, how = smooth_by_cross_validation(times, positions), "generalised cross-validation"
        else:
            left, how = smooth_by_residual(times, positions, smooth), f"a residual of {1e3 * smooth:.4g} mm"
    except np.linalg.LinAlgError as error:
        problem = "cannot be done for these times, whose steps are too uneven; give smooth=false"
        raise InputError("smooth", problem) from error
    residual = np.sqrt(np.mean(left**2, axis=0))
    moved = ", ".join(f"{1e3 * r:.3g}" for r in residual)
    note = f"Smoothed by {how}: points moved by {moved} mm rms along x, y, z of the file."
    curve = spline_through(times, place(positions - left), "natural")
    acceleration = np.linalg.norm(curve.polynomial(times, nu=2), axis=1)
    i = int(np.argmax(acceleration))
    if acceleration[i] > _ROUGH:
        note = f"trajectory: accelerates by {acceleration[i]:.3g} m/s² at {times[i]:.6g} s, more than "
        warn(f"{note}{_ROUGH:g}: the noise may not be white (dropouts, filters); smooth=<metres> smooths more")
    return curve, read_only(residual), (note,)


def speed_noise(times: Floats, positions: Floats) -> float:
    """Return an estimate of the rms speed noise of a cubic spline through measured points, m/s.

    Shapes: times (n,) s; positions (n, 3) m.

    The k-th difference of white noise of variance σ² has the variance ``σ² binom(2k, k)``, while that of a smooth
    motion vanishes as the step to the power k; k = 5 here. The spline turns σ into ``1.573 σ / step`` of speed.

    >>> t = np.linspace(0.0, 10.0, 1001)
    >>> noise = np.random.default_rng(1).normal(scale=1e-4, size=(1001, 3))
    >>> round(speed_noise(t, noise + np.sin(t)[:, None]), 3)  # 1.573 * 1e-4 / 0.01
    0.016
    """
    order = min(5, len(times) - 1)
    variance = np.mean(np.diff(positions, n=order, axis=0) ** 2, axis=0) / math.comb(2 * order, order)
    return _SPEED_NOISE * math.sqrt(float(np.max(variance))) / float(np.median(np.diff(times)))


def smooth_by_cross_validation(times: Floats, values: Floats) -> Floats:
    """Return residuals (n, k) of splines that smooth columns of values (n, k), by generalised cross-validation."""
    # λ minimises ``GCV(λ) = n Σ (y − f)² / tr(I − A)²``, A the matrix that turns y into f. The trace needs no inverse:
    # ``tr(I − A) = tr(λ QᵀQ (R + λ QᵀQ)⁻¹) = d ln det(R + λ QᵀQ) / d ln λ``.
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
    return residuals


def smooth_by_residual(times: Floats, values: Floats, residual: float) -> Floats:
    """Return residuals (n, k) of splines through columns of values (n, k), whose root mean squares are that given."""
    # A column that is nearer to a straight line than that becomes the line (or what is slower than 7000 steps), with
    # the smaller residual it has.
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
            best = scipy.optimize.brentq(excess, _LEAST, system.greatest, xtol=1e-6)
        residuals[:, column] = system.solve(np.exp(best), y)[1]
    return residuals


@dataclass(frozen=True, slots=True, eq=False)
class _System:
    """Diagonals of Q (n x n - 2), and of R and QᵀQ in the lower banded form (3, n - 2)."""

    # The spline f minimises ``Σ (y_i − f(t_i))² + λ ∫ f″(t)² dt``. With Q and R the banded matrices of the second
    # differences, ``(R + λ QᵀQ) γ = Qᵀy`` and the residual is ``y − f = λ Q γ``. The matrix has five diagonals, so that
    # everything takes time in proportion to the number of points. P. J. Green, B. W. Silverman, "Nonparametric
    # Regression and Generalized Linear Models", 1994, sections 2.1 to 2.3 (splines) and 3.1 to 3.3 (cross-validation);
    # P. Craven, G. Wahba, "Smoothing noisy data with spline functions", Numerische Mathematik 31, 1979.
    q: Floats
    r: Floats
    qq: Floats

    @property
    def greatest(self) -> float:
        """Largest ln λ that rounding allows."""
        return float(np.log(_STIFFEST / np.max(self.qq[0])))

    def solve(self, strength: float, values: Floats) -> tuple[float, Floats]:
        """Return ``ln det(R + λ QᵀQ)`` and the residual ``λ Q γ`` for values (n,) or (n, k)."""
        factor = scipy.linalg.cholesky_banded(self.r + strength * self.qq, lower=True, check_finite=False)
        a, b, c = self.q if values.ndim == 1 else self.q[:, :, None]
        bends = a * values[:-2] + b * values[1:-1] + c * values[2:]
        gamma = strength * scipy.linalg.cho_solve_banded((factor, True), bends, check_finite=False)
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
