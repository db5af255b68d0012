"""Filters from responses over a band, band-limited impulses between samples, and resonances."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from clsim.arrays import Complexes, Floats, read_only
from clsim.numerics.convolution import band_taper, ringing


def chebyshev_points(low: float, high: float, count: int) -> Floats:
    """Chebyshev points (count,) of the first kind of an interval, from high to low."""
    return np.asarray(0.5 * (low + high) + 0.5 * (high - low) * _points(count))


@lru_cache(maxsize=16)
def _points(count: int) -> Floats:
    """Return those of the interval from -1 to 1, read-only."""
    return read_only(np.cos(math.pi * (np.arange(count) + 0.5) / count))


def interpolation(low: float, high: float, count: int, x: Floats) -> Floats:
    """Weights (count, n) of values at the Chebyshev points of an interval for those of the polynomial at x (n,)."""
    from numpy.polynomial.chebyshev import chebvander

    at_points = chebvander(chebyshev_points(-1.0, 1.0, count), count - 1) * (2.0 / count)
    at_points[:, 0] *= 0.5
    return np.asarray(at_points @ chebvander((2.0 * x - high - low) / max(high - low, 1e-300), count - 1).T)


_OUTSIDE_WEIGHT = 1e-4  # of the least squares beyond the band, where the response at its end is wanted
LONGEST = 4097  # taps
_SHORTEST = 17
_NOTHING = 1e-9  # of the largest coefficient
_FAR = 10.0  # times the allowed error, beyond which lengths are tried in longer steps
_LONG = 512  # taps on either side, from which on likewise: the design costs more than what they take to apply
_FALLS = 1.3  # times as fast as from one length to the next, at most, errors are taken to fall over those after it
_BETWEEN, _EVALUATED = 4, 512  # places between neighbouring points, and in all at least, where errors are evaluated
_MANY, _SPLINE = 256, 5  # cosines, of which sums are evaluated by splines of an order: terms so high are weak
_AT_ONCE = 512  # taps for which exponentials are worked out; those of others follow
_FEW = 64  # multiples of an angle whose cosines are evaluated; those of others follow from the sums of angles
_FACTORED, _REFINED = (
    255,
    2,
)  # rows, up to which a matrix is factored; and times that others are solved, for what rounding leaves
_MOST = (63, 255, 1023, LONGEST // 2)  # taps on either side for which what is wanted is summed at once


@dataclass(frozen=True, slots=True, eq=False)
class BandFilters:
    """Filters and what they reach."""

    taps: Floats  # (K, L) about the middle one; all of one odd length
    error_db: float  # what their deviations amount to, dB relative to 1
    worst: float  # where the largest is, by importance, Hz


def band_filters(
    coefficients: Floats | Complexes,
    low: float,
    high: float,
    sampling_rate: float,
    importance: Floats,
    error: Callable[[Floats], float],
    allowed: float,
    delay_samples: int = 0,
) -> BandFilters:
    """Return filters with given responses over a band: the shortest tried within an error, or the best.

    Shapes: coefficients (K, n); importance (m,).

    result: of up to 4097 taps, and as many more as make room for the delay. Symmetric where the response is real and
    there is no delay, so that nothing is shifted.

    Our own derivation: with taps about the middle one the response is ``sum_m even[m] cos(m w) + j odd[m] sin(m w)``,
    linear in the coefficients, whose normal equations are solved. Weighted least squares over all frequencies, of
    cosines for the real part and sines for the imaginary one: by importance within the band, 1e-4 beyond it, where the
    values at the ends are continued, so that the filters are small there too. A real filter has no phase at 0 Hz, so
    complex responses ask for a transition there, and for a longer filter the nearer to 0 Hz the band begins.
    """
    edges, count = 2.0 * math.pi * np.array([low, high]) / sampling_rate, len(importance)
    points, between = _points(count), max(_BETWEEN, -(-_EVALUATED // count))
    at, wanted = (
        0.5 * (edges.sum() + _points(between * count) * np.ptp(edges)),
        _at_points(coefficients, between * count),
    )
    half, best, least = _SHORTEST // 2, BandFilters(np.zeros((len(coefficients), 1)), math.inf, low), math.inf
    known: list[tuple[int, float]] = []  # half lengths and errors, the last two

    def wanted_at(w: Floats) -> tuple[Floats, Floats | Complexes]:
        """Return squared weights (n,) and responses (K, n) at rising angular frequencies, in the band or continued."""
        x = np.clip((2.0 * w - edges.sum()) / max(edges[1] - edges[0], 1e-12), -1.0, 1.0)
        inside = (w >= edges[0]) & (w <= edges[1])
        weight = np.where(inside, np.interp(x, points[::-1], importance[::-1]), _OUTSIDE_WEIGHT)
        new = np.append(True, x[1:] != x[:-1])  # all beyond the band is at an end
        return weight**2, _polynomials(coefficients, x[new])[:, np.cumsum(new) - 1]

    fit: _Fit | None = None
    while least > allowed and 2 * half + 1 <= LONGEST:
        if fit is None or half > fit.most:
            fit = _Fit.of(wanted_at, edges, next(most for most in _MOST if half <= most))
            turns = _turns(at, fit.most // _FEW + 1)
        even, odd = fit.solved(half)
        made: Floats | Complexes = _series(even, turns)
        if np.any(odd):
            made = made + 1j * _series(odd, turns, 1)
        left = np.abs(made - wanted).reshape(len(even), count, between).max(axis=2)
        reached = error(left)
        if reached < least:
            worst = 0.5 * (low + high + points[int(np.argmax((left * importance).max(axis=0)))] * (high - low))
            best, least = BandFilters(_taps(even, odd), 20.0 * math.log10(max(reached, 1e-15)), worst), reached
        known, half = [*known[-1:], (half, reached)], _next_half(half, reached, allowed)
        while half < LONGEST // 2 and _expected(known, half) > allowed:
            half = _next_half(half, reached, allowed)
    size = abs(delay_samples)
    return replace(best, taps=np.pad(best.taps, ((0, 0), (size + delay_samples, size - delay_samples))))


def _next_half(half: int, reached: float, allowed: float) -> int:
    """Return the half length to try behind one that reaches an error."""
    longer = 1.7 if reached > _FAR * allowed or half > _LONG else 1.3
    return min(math.ceil(longer * half), max(LONGEST // 2, half + 1))


def _expected(known: list[tuple[int, float]], half: int) -> float:
    """Return the error of long filters of a half length, as small as the last two that are known let expect."""
    if len(known) < 2 or half < _LONG // 2:
        return 0.0
    (shorter, before), (last, reached) = known
    power = _FALLS * math.log(before / reached) / math.log(last / shorter)
    return float(reached * (last / half) ** max(power, 0.0))


def _polynomials(coefficients: Floats | Complexes, x: Floats) -> Floats | Complexes:
    """Return the values (K, w) of Chebyshev polynomials, without terms that are next to nothing."""
    size = np.abs(coefficients).max(axis=0)
    kept = int(np.flatnonzero(size >= _NOTHING * size.max())[-1]) + 1
    if kept > _MANY and len(x) > kept:
        return _between(coefficients[:, :kept], np.arccos(x))
    turns = _turns(np.arccos(x), -(-kept // _FEW))
    values = _series(coefficients[:, :kept].real, turns)
    return values + 1j * _series(coefficients[:, :kept].imag, turns) if np.iscomplexobj(coefficients) else values


def _between(coefficients: Floats | Complexes, angles: Floats) -> Floats | Complexes:
    """Return sums (K, w) of many cosines by splines between angles four times as dense as these ask for."""
    intervals = scipy.fft.next_fast_len(4 * coefficients.shape[1], real=True)
    padded: Any = np.pad(coefficients, ((0, 0), (0, intervals + 1 - coefficients.shape[1])))
    padded[:, 0] *= 2.0
    beside = np.arange(-_SPLINE, intervals + _SPLINE + 1)  # cosines are even about 0 and pi
    values = 0.5 * scipy.fft.dct(padded, type=1, axis=1)[:, intervals - np.abs(intervals - np.abs(beside))]
    return np.asarray(scipy.interpolate.make_interp_spline(beside * (math.pi / intervals), values.T, _SPLINE)(angles).T)


def _at_points(coefficients: Floats | Complexes, count: int) -> Floats | Complexes:
    """Return the values (K, count) of Chebyshev polynomials at as many Chebyshev points, from high to low."""
    if coefficients.shape[1] > count:
        return _polynomials(coefficients, _points(count))
    padded: Any = np.pad(coefficients, ((0, 0), (0, count - coefficients.shape[1])))
    padded[:, 0] *= 2.0
    return np.asarray(0.5 * scipy.fft.dct(padded, type=3, axis=1))


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    """Least squares of filters of up to `most` taps on either side: what normal equations of all lengths are made of.

    Frequencies lie evenly from 0 to pi, where the sums are a Fourier transform, and closer within a narrow band. Those
    for the longest filters do for shorter ones, whose equations are the first of those.
    """

    most: int
    sums: Floats  # (2 most + 1,) of squared weights times cosines of all multiples of the frequencies
    even: Floats  # (K, most + 1) the same of what is wanted, and (K, most) with sines of its imaginary parts
    odd: Floats  # likewise
    turns: bool  # whether any is wanted with a phase

    @staticmethod
    def of(wanted_at: Callable[[Floats], tuple[Floats, Floats | Complexes]], edges: Floats, most: int) -> _Fit:
        intervals = scipy.fft.next_fast_len(8 * most + 63, real=True)
        square, target = wanted_at(np.linspace(0.0, math.pi, intervals + 1))
        # Products of cosines, or of sines, are cosines of differences and sums: one sum for each multiple up to 2 most.
        sums = scipy.fft.rfft(square, 2 * intervals)[: 2 * most + 1].real
        even = scipy.fft.rfft(target.real * square, 2 * intervals)[:, : most + 1].real
        turns, odd = np.iscomplexobj(target), np.zeros((len(even), most))
        if turns:
            odd = -scipy.fft.rfft(target.imag * square, 2 * intervals)[:, 1 : most + 1].imag
        inside = 4 * most + 64
        if np.ptp(edges) * intervals < math.pi * inside:
            w = np.linspace(edges[0], edges[1], inside)
            square, target = wanted_at(w)
            sums = sums + _sums(square[None], w, 2 * most + 1)[0]
            even = even + _sums(target.real * square, w, most + 1)
            if turns:
                odd = odd + _sums(target.imag * square, w, most, 1)
        return _Fit(most, sums, even, odd, turns)

    def solved(self, half: int) -> tuple[Floats, Floats]:
        """Return coefficients of cosines (K, half + 1) and of sines (K, half) that come nearest to what is wanted."""
        # Half the sum and half the difference of both are those of `exp(j m w)` of m from `half` down to `-half`.
        even, odd = self.even[:, : half + 1], self.odd[:, :half]
        wanted = np.concatenate([even[:, :0:-1], even], axis=1)
        wanted[:, :half] -= odd[:, ::-1]
        wanted[:, half + 1 :] += odd
        found = _of_toeplitz(self.sums[: 2 * half + 1], wanted)
        before, middle, after = found[:, :half][:, ::-1], found[:, half : half + 1], found[:, half + 1 :]
        return np.concatenate([middle, after + before], axis=1), (after - before) * self.turns


def _of_toeplitz(column: Floats, wanted: Floats) -> Floats:
    """Return the solutions x (K, n) of a positive definite symmetric Toeplitz matrix by its first column (n,).

    The first column of the inverse, by Levinson's recursion, tells all of it: differences of products of triangular
    Toeplitz matrices (I. C. Gohberg, A. A. Semencul, 1972), which are convolutions. What rounding leaves is solved for
    again.
    """
    count = len(column)
    column = column * np.append(1.0 + 1e-14, np.ones(count - 1))
    if count <= _FACTORED:
        factors = scipy.linalg.cho_factor(scipy.linalg.toeplitz(column), check_finite=False)
        return np.asarray(scipy.linalg.cho_solve(factors, wanted.T, check_finite=False).T)
    first = scipy.linalg.solve_toeplitz(column, np.eye(1, count)[0], check_finite=False)
    size = scipy.fft.next_fast_len(2 * count, real=True)
    around = np.concatenate([column, np.zeros(size + 1 - 2 * count), column[:0:-1]])
    matrix, *parts = scipy.fft.rfft([around, np.pad(first, (0, size - count)), np.pad(first[:0:-1], (1, size - count))])

    def times(spectrum: Complexes, x: Floats) -> Floats:
        return np.asarray(scipy.fft.irfft(spectrum * scipy.fft.rfft(x, size), size)[:, :count])

    x, left = np.zeros(wanted.shape), wanted
    for _ in range(_REFINED):
        lower, upper = (times(part, times(part.conj(), left)) for part in parts)
        x = x + (lower - upper) / first[0]
        left = wanted - times(matrix, x)
    return x


def _series(coefficients: Floats, turns: list[tuple[Floats, Floats]], first: int = 0) -> Floats:
    """Return sums (K, w) of cosines of 0, 1, ... times w by coefficients (K, n), or of sines of 1, 2, ... times w."""
    # The multiples are 64 p + q, and the sums over q are products of matrices. turns: of w, for at least so many p.
    count = coefficients.shape[1] + first
    groups = -(-count // _FEW)
    given = np.pad(coefficients, ((0, 0), (first, groups * _FEW - count))).reshape(-1, groups, _FEW)
    (coarse, coarse_sines), (fine, fine_sines) = turns
    if groups == 1:
        return np.asarray(given[:, 0] @ (fine_sines if first else fine).T)
    coarse, coarse_sines = coarse[:, :groups], coarse_sines[:, :groups]
    if first:
        coarse, coarse_sines = coarse_sines, -coarse
    return np.stack([
        np.einsum("wp,wp->w", coarse, fine @ one.T) - np.einsum("wp,wp->w", coarse_sines, fine_sines @ one.T)
        for one in given
    ])  # fmt: skip


def _sums(weights: Floats, w: Floats, count: int, first: int = 0) -> Floats:
    """Return the products (K, count) of weights (K, w) with the cosines, or sines, of `_series`: its transpose."""
    (coarse, coarse_sines), (fine, fine_sines) = _turns(w, -(-(count + first) // _FEW))
    if first:
        coarse, coarse_sines = coarse_sines, -coarse
    made = [(coarse.T * row) @ fine - (coarse_sines.T * row) @ fine_sines for row in weights]
    return np.stack(made).reshape(len(weights), -1)[:, first : first + count]


def _turns(w: Floats, groups: int) -> list[tuple[Floats, Floats]]:
    """Return cosines and sines of 0, 64, ... times w, (w, groups), and of 0 to 63 times w, (w, 64)."""
    return [(turn.real.copy(), turn.imag.copy()) for turn in (_powers(_FEW * w, groups), _powers(w, _FEW))]


def _powers(w: Floats, count: int) -> Complexes:
    """Return ``exp(j n w)`` (w, count) of n from 0, as products of two exponentials."""
    few = math.isqrt(count - 1) + 1
    fine, coarse = (np.exp(1j * np.outer(w, step * np.arange(few))) for step in (1, few))
    return np.asarray((coarse[:, :, None] * fine[:, None]).reshape(len(w), -1)[:, :count])


def _taps(even: Floats, odd: Floats) -> Floats:
    """Return the taps (K, 2 half + 1) with such coefficients of cosines and sines."""
    # h[n] + h[-n] = even[n] and h[-n] - h[n] = odd[n]: exp(-jwn) turns sines of positive n to -j.
    before, after = 0.5 * (even[:, 1:] + odd), 0.5 * (even[:, 1:] - odd)
    return np.concatenate([before[:, ::-1], even[:, :1], after], axis=1)


def magnitudes(taps: Floats, w: Floats) -> Floats:
    """Return the magnitudes (K, w) of the responses of filters (K, L) at angular frequencies, from a few taps at once.

    A. V. Oppenheim and R. W. Schafer, "Discrete-Time Signal Processing", 3rd ed. 2010, section 2.6.1.
    """
    length = min(taps.shape[1], _AT_ONCE)
    parts = np.pad(taps, ((0, 0), (0, -taps.shape[1] % length))).reshape(-1, length)
    turns = _powers(w, length).T
    made = (parts @ turns.real + 1j * (parts @ turns.imag)).reshape(len(taps), -1, len(w))
    return np.asarray(np.abs(np.sum(made * _powers(length * w, made.shape[1]).T, axis=1)))


_STEPS = 64  # of a sample, at which impulses are tabulated
_NODES = 4  # steps between which they are cubic


class BandKernels:
    """Impulses ``w_k(x) = 1/2 ∫ W(u) T_k(u) exp(j pi u x) du`` over u from -1 to 1, x in samples.

    W is 1 in the band and falls smoothly to 0 at half the sampling rate, as `band_taper` does.

    Each is tabulated at 64 steps of a sample, by the trapezoidal rule, which is exact for what falls smoothly to 0 (L.
    N. Trefethen, J. A. C. Weideman, "The exponentially convergent trapezoidal rule", SIAM Rev. 56(3), 2014, theorem
    3.2), and cubic through four steps: within 2e-7 of the impulse of a whole band.

    >>> out = np.zeros((1, 200), dtype=complex)
    >>> BandKernels(0.5).add(out, np.array([100.25]), np.array([[1.0 + 0j]]))
    >>> tone = np.exp(2j * np.pi * 0.2 * np.arange(200))
    >>> bool(abs(out[0] @ tone - np.exp(2j * np.pi * 0.2 * 100.25)) < 1e-6)
    True

    Attributes
    ----------
    reach : int
        Samples to either side over which an impulse is laid.
    """

    def __init__(self, share: float) -> None:
        self._share = share
        self.reach = math.ceil(ringing(0.0, 0.5 * (1.0 - share)))
        self._tables = np.empty((_STEPS + _NODES, 0, 2 * self.reach), dtype=np.complex128)

    def add(self, out: Complexes, late: Floats, weights: Complexes) -> None:
        """Add impulses at places (T,), in samples from the first, to rows of samples (T, L), in place."""
        # `weights` (T, K) are those of the polynomials. What lies beyond the ends is left out.
        self._tabulate(weights.shape[1])
        audible = np.flatnonzero(np.any(weights != 0.0, axis=1))
        whole = np.floor(late[audible]).astype(np.int64)
        place = (late[audible] - whole) * _STEPS
        step = np.minimum(place.astype(np.int64), _STEPS - 1)
        t = place - step
        cubic = np.stack([
            -t * (t - 1.0) * (t - 2.0) / 6.0, (t + 1.0) * (t - 1.0) * (t - 2.0) / 2.0,
            -(t + 1.0) * t * (t - 2.0) / 2.0, (t + 1.0) * t * (t - 1.0) / 6.0,
        ])  # fmt: skip
        made = np.zeros((len(audible), 2 * self.reach), dtype=np.complex128)
        for one in np.unique(step):
            mine = np.flatnonzero(step == one)
            for node in range(_NODES):
                table = self._tables[one + node, : weights.shape[1]]
                made[mine] += (weights[audible[mine]] * cubic[node, mine, None]) @ table
        taps = whole[:, None] + np.arange(1 - self.reach, self.reach + 1)
        inside = (taps >= 0) & (taps < out.shape[1])
        rows = np.broadcast_to(audible[:, None], taps.shape)
        out[rows[inside], taps[inside]] += made[inside]

    def _tabulate(self, count: int) -> None:
        """Make the tables of polynomials up to `count`: [step + 1, k, tap], the tap's distance less step / 64."""
        if count <= self._tables.shape[1]:
            return
        points = 4 * (self.reach + count)
        u = (np.arange(points) + 0.5) * (2.0 / points) - 1.0
        weight = band_taper(np.abs(u), 0.0, self._share, 0.0, 1.0 - self._share)
        chebyshev = np.cos(np.outer(np.arccos(u), np.arange(count)))
        taps = np.arange(1 - self.reach, self.reach + 1)
        turned = np.exp(1j * np.pi * np.outer(taps, u)) * (weight / points)
        back = np.exp(-1j * np.pi * np.outer(np.arange(-1, _STEPS + _NODES - 1) / _STEPS, u))
        made = [turned @ (chebyshev * row[:, None]) for row in back]
        self._tables = np.ascontiguousarray(np.swapaxes(np.array(made), 1, 2))


def resonance_response(frequency: ArrayLike, centre: float, width: float) -> NDArray[np.complex128]:
    """Return the response of a second-order band-pass, 1 at its centre.

    Our own derivation, from ``H = 1 / (1 + j Q (f/f0 - f0/f))``: where ``|H| = 1/2``, ``Q |f/f0 - f0/f| = sqrt(3)``;
    these two frequencies have the product f0² and the difference ``sqrt(3) f0 / Q``, so that ``Q = sqrt(3) f0 /
    width``. Oscillations decay as ``exp(-pi f0 t / Q)``: with the time constant ``sqrt(3) / (pi width)``.
    """
    f = np.asarray(frequency, dtype=np.float64)
    quality = math.sqrt(3.0) * centre / width
    with np.errstate(divide="ignore"):
        detuning = f / centre - centre / f
    return np.where(f > 0.0, 1.0 / (1.0 + 1j * quality * np.where(f > 0.0, detuning, 0.0)), 0.0)


def resonance_taps(centre: float, width: float, sampling_rate: float) -> Floats:
    """Return the impulse response of `resonance_response` at a sampling rate, until it is -130 dB.

    Our own derivation: a recursive filter with the band-pass's poles, ``exp(s / sampling_rate)``, so that it rings
    exactly as long, and five zeros: one at 0 Hz, and the others such that the complex response is right at both
    frequencies where its magnitude is 1/2. With five samples in a period it is right within 0.7 dB and 8 degrees from
    0.25 to 1.5 times the centre, and within 2.5 dB below 0.95 of half the sampling rate.
    """
    decay = math.pi * width / math.sqrt(3.0)  # 1/s
    pole = np.exp((-decay + 1j * math.sqrt((2.0 * math.pi * centre) ** 2 - decay**2)) / sampling_rate)
    recursion = np.array([1.0, -2.0 * pole.real, abs(pole) ** 2])
    middle = math.hypot(centre, 0.5 * width)
    sides = np.array([middle - 0.5 * width, middle + 0.5 * width])
    z = np.exp(-2j * math.pi * sides / sampling_rate)
    wanted = (z[:, None] ** np.arange(3) @ recursion) * resonance_response(sides, centre, width)
    powers = (1.0 - z[:, None]) * z[:, None] ** np.arange(4)
    rest = np.linalg.solve(np.concatenate([powers.real, powers.imag]), np.concatenate([wanted.real, wanted.imag]))
    impulse = np.zeros(math.ceil(15.0 * sampling_rate / decay) + 8)
    impulse[0] = 1.0
    return np.asarray(scipy.signal.lfilter(np.convolve([1.0, -1.0], rest), recursion, impulse), dtype=np.float64)


def minimum_phase(magnitude: Floats) -> Floats:
    """Return the minimum-phase impulse response with given magnitudes; magnitude (n / 2 + 1,).

    magnitude: above 0, from 0 Hz to half the sampling rate, evenly spaced; n a power of two.

    result: its spectrum has exactly these magnitudes; it is causal as far as n is long enough.

    The cepstrum is folded: A. V. Oppenheim and R. W. Schafer, "Discrete-Time Signal Processing", 3rd ed. 2010, chapter
    13.
    """
    cepstrum = scipy.fft.irfft(np.log(magnitude))
    half = len(cepstrum) // 2
    cepstrum[1:half] *= 2.0
    cepstrum[half + 1 :] = 0.0
    return np.asarray(scipy.fft.irfft(np.exp(scipy.fft.rfft(cepstrum)), len(cepstrum)), dtype=np.float64)
