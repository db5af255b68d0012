"""Fractional-delay filters as polynomials of the fraction (Farrow banks).

A bank holds the taps ``c[q, k]`` of its branches: the delayed signal is
``y[n] = sum_q mu**q sum_k c[q, k] x[n - D - k + centre]`` and is delayed by ``D + shift + mu`` samples.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache

import numpy as np
import scipy
from numpy.polynomial import chebyshev, polynomial
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Design = tuple[Floats, float]  # taps (branches, length) and the error that they reach, dB

_OUT_OF_BAND_WEIGHT = 1e-6  # of the least squares above the band; 1e-4 stops at -88 dB, see docs/validation.md
_LARGEST_LENGTH = 301
_LENGTH_PER_DB = 0.034  # half lengths of banks a dB of their error and a relative width of the band
_FREQUENCIES = 256  # at which errors are looked at
_DELAYS = np.cos(np.linspace(0.0, math.pi, 65))  # over the largest, likewise
_FIRST_DELAYS = _DELAYS[[0, 16, 20, 24, 28]]  # some of them, beside which errors are mostly largest
_LARGEST_DEGREE = 40
_LAWSON = 12  # times that weights on the edge of complex delays are evened out


def lagrange_taps(order: int, delay: Floats) -> Floats:
    """Return the taps of the Lagrange interpolator of an order, for delays in samples; delay (n,) samples.

    T. I. Laakso, V. Välimäki, M. Karjalainen, U. K. Laine, "Splitting the unit delay", IEEE Signal
    Processing Magazine 13(1), 1996, eq. 42.

    >>> lagrange_taps(1, np.array([0.25]))
    array([[0.75, 0.25]])
    """
    delay = np.asarray(delay, dtype=np.float64)
    taps = np.ones((len(delay), order + 1))
    for k in range(order + 1):
        for j in range(order + 1):
            if j != k:
                taps[:, k] *= (delay - j) / (k - j)
    return taps


def lagrange_bank(order: int, length: int | None = None) -> Floats:
    """Return the Lagrange taps as polynomials of ``mu = delay - order / 2``.

    length: taps that are kept, the middle ones; all of them when left out. Fewer taps widen the band (Välimäki and
    Haghparast, "Fractional delay filter design based on truncated Lagrange interpolation", IEEE Signal Processing
    Letters 14(11), 2007).

    The products of `lagrange_taps` (Laakso et al. 1996, eq. 42), multiplied out.
    """
    middle = order / 2
    columns = []
    for k in range(order + 1):
        others = [j for j in range(order + 1) if j != k]
        scale = math.prod(float(k - j) for j in others)
        columns.append(polynomial.polyfromroots([j - middle for j in others]) / scale if others else np.ones(1))
    bank = np.stack(columns, axis=1)
    if length is None:
        return bank
    dropped = (order + 1 - length) // 2
    return bank[:, dropped : dropped + length]


def chebyshev_degree(cutoff: float, mu_max: float, error: float, importance: tuple[float, ...] = (1.0,)) -> int:
    """Return the smallest degree whose Chebyshev series of a pure delay is within `error`.

    error: largest allowed tail of the series (absolute, a pure delay being 1), times the importance.

    ``exp(-j w mu) = sum_k (2 - [k=0]) (-j)^k J_k(w mu_max) T_k(mu / mu_max)``, the Jacobi-Anger expansion: F. W. J.
    Olver et al., "NIST Handbook of Mathematical Functions", 2010, eq. 10.12.3; its tail is at most ``2 sum_{k > K}
    |J_k(w mu_max)|``.
    """
    terms = _series_terms(cutoff, mu_max, len(importance)) * np.array(importance)
    tail = (2 * np.cumsum(terms[::-1], axis=0)[::-1]).max(axis=1)  # tail[k]: terms k and above
    within = np.flatnonzero(tail[1:] <= error)
    return int(within[0]) if len(within) else _LARGEST_DEGREE


@lru_cache(maxsize=64)  # of some 36 KB each
def _series_terms(cutoff: float, mu_max: float, cells: int) -> Floats:
    """Return the size of each order's term at the end of each cell up to the cutoff, (orders, cells)."""
    ends = cutoff * np.arange(1, cells + 1) / cells
    return np.asarray(np.abs(scipy.special.jv(np.arange(_LARGEST_DEGREE + 30)[:, None], ends * mu_max)))


def chebyshev_bank(
    degree: int, half: int, cutoff: float, mu_max: float, importance: tuple[float, ...] = (1.0,)
) -> Floats:
    """Return a band-limited bank: least-squares filters whose responses are the Bessel functions.

    Branch k of the Chebyshev series (F. W. J. Olver et al., "NIST Handbook of Mathematical Functions", 2010, eq.
    10.12.3, see `chebyshev_degree`) has the response ``(2 - [k=0]) (-j)^k J_k(w mu_max)`` up to the cutoff and is
    rolled off above it with a small weight, since odd branches would otherwise jump at Nyquist.
    """
    w, inside, even, odd = _branch_shapes(half, cutoff)
    weight = np.where(inside, _importance_at(w, cutoff, importance), _OUT_OF_BAND_WEIGHT)[:, None]
    target = np.stack([_branch_target(k, half, cutoff, mu_max) for k in range(degree + 1)], axis=1)
    taps = _fitted(target, even, odd, weight)
    return (_powers(degree) @ taps) / (mu_max ** np.arange(degree + 1))[:, None]


def _fitted(target: Floats, even: Floats, odd: Floats, weight: Floats) -> Floats:
    """Return taps (branches, length) by weighted least squares from targets (n, branches), see `_branch_shapes`."""
    degree, half = target.shape[1] - 1, odd.shape[1]
    taps = np.zeros((degree + 1, 2 * half + 1))
    solved = _least_squares(even * weight, target[:, ::2] * weight)
    taps[::2, half:] = solved.T
    taps[::2, :half] = solved.T[:, :0:-1]
    if degree > 0 and half > 0:
        solved = _least_squares(odd * weight, target[:, 1::2] * weight)
        taps[1::2, half + 1 :] = solved.T
        taps[1::2, :half] = -solved.T[:, ::-1]
    return taps


def _least_squares(a: Floats, b: Floats) -> Floats:
    """Return x (n, k) with the least squares of ``a x - b``, by Householder's reflections; a (m, n) has full rank.

    It has as each frequency is weighted, those beyond the band by 1e-6. A singular value decomposition takes longer.
    """
    return np.asarray(scipy.linalg.lapack.dgels(a, b, overwrite_a=True, overwrite_b=True)[1][: a.shape[1]])


@lru_cache(maxsize=16)  # of some 200 KB each: banks of one band are tried in one order of lengths
def _branch_shapes(half: int, cutoff: float) -> tuple[Floats, NDArray[np.bool_], Floats, Floats]:
    """Return the frequencies (n,) of the least squares, whether each is in the band, and responses of taps there."""
    # Those are real of even branches, (n, half + 1), and -j times those of odd ones, (n, half).
    count = 4 * (half + 1) + 64
    w = np.linspace(0.0, math.pi, count)
    inside = int(np.searchsorted(w, cutoff))
    # As many within a narrow band, whose end is one of them.
    w = np.union1d(w, np.linspace(0.0, cutoff, count) if 2 * inside < count else np.array([cutoff]))
    turned = np.outer(w, np.arange(1, half + 1))
    even = np.concatenate([np.ones((len(w), 1)), 2 * np.cos(turned)], axis=1)  # h[0], h[m] = h[-m]
    odd = 2 * np.sin(turned)  # h[m] = -h[-m]
    return w, w <= cutoff * (1 + 1e-12), even, odd


@lru_cache(maxsize=1024)  # of some 4 KB each
def _branch_target(k: int, half: int, cutoff: float, mu_max: float) -> Floats:
    """Return the target of branch k at the frequencies of `_branch_shapes`, (n,)."""
    w, inside, _, _ = _branch_shapes(half, cutoff)
    target = np.where(inside, scipy.special.jv(k, w * mu_max) * (1.0 if k == 0 else 2.0), 0.0)
    # (-j)^k J_k against sum h[m] exp(-j w m): real part (-1)^(k/2) for even k, -j times (-1)^((k-1)/2) for odd k.
    return np.asarray(target * (1.0 if k % 4 < 2 else -1.0))


@lru_cache(maxsize=_LARGEST_DEGREE + 1)
def _powers(degree: int) -> Floats:
    """Return the coefficients (degree + 1, degree + 1) of Chebyshev's polynomials, each a column."""
    powers = np.zeros((degree + 1, degree + 1))
    for n in range(degree + 1):
        powers[: n + 1, n] = chebyshev.cheb2poly(np.eye(degree + 1)[n, : n + 1])
    return powers


@lru_cache(maxsize=512)  # of some 10 KB each: scenes of studies take turns
def design_bandlimited(
    error_db: float, cutoff: float, mu_max: float, importance: tuple[float, ...] = (1.0,)
) -> tuple[Floats, float]:
    """Return the smallest band-limited bank within an error, and the error that it reaches.

    Shapes: result (branches, length).
    """
    degree = chebyshev_degree(cutoff, mu_max, 10 ** ((error_db - 6.0) / 20), importance)
    halves = [max(2, (degree + 1) // 2)]
    while (longer := halves[-1] + max(1, halves[-1] // 6)) <= _LARGEST_LENGTH // 2:
        halves.append(longer)

    def tried(index: int) -> Design | None:
        """Return the bank of a length and its error, None above the bound."""
        half = halves[index]
        taps = chebyshev_bank(degree, half, cutoff, mu_max, importance)
        enough = (1.0 + 1e-9) * 10 ** (error_db / 20)
        if bank_error(taps, half, 0.0, cutoff, mu_max, importance, few=True) > enough:
            return None
        reached = 20 * math.log10(bank_error(taps, half, 0.0, cutoff, mu_max, importance))
        return (taps, reached) if reached <= error_db else None

    about = halves[0] + _length_beyond(error_db, cutoff, importance)
    # It takes one more try than that beyond the length which does, and that length is mostly the next one.
    found = _first(tried, len(halves), max(int(np.searchsorted(halves, about)) - 1, 0))
    if found is None:
        raise ValueError(f"no filter of up to {_LARGEST_LENGTH} taps reaches {error_db:g} dB up to {cutoff:.4g} rad")
    found[0].flags.writeable = False
    return found


@lru_cache(maxsize=512)
def design_tilted(
    error_db: float, cutoff: float, mu_max: float, nu_max: float, importance: tuple[float, ...] = (1.0,)
) -> tuple[Floats, float]:
    """Return a band-limited bank for complex delays ``mu - j nu`` within an error, and the error that it reaches.

    Shapes: result (branches, length). Delays lie in a rectangle, up to `mu_max` and `nu_max`, samples. What errs is
    analytic in them, so that it is most on the rectangle's edge. There powers of the delay are fitted by Lawson's
    weights (C. L. Lawson, 1961), which even out the largest errors.
    """
    delays = _rectangle(mu_max, nu_max)
    delays = delays[: len(delays) // 2]  # the others mirror these
    allowed, w = 10 ** (error_db / 20), _test_frequencies(cutoff, _FREQUENCIES // 4)
    weight = _importance_at(w, cutoff, importance)
    wanted = np.exp(-1j * np.outer(delays, w))

    def error(coefficients: NDArray[np.complex128]) -> float:
        """Return the largest error of coefficients (degree + 1, frequencies) of the powers of delays."""
        return float(np.max(np.abs(polynomial.polyval(delays, coefficients).T - wanted) * weight))

    degree = max(chebyshev_degree(cutoff, mu_max, 2.0 * allowed, importance), 1)
    while error(_powers_of(degree, mu_max, nu_max, cutoff, w)) > 0.9 * allowed and degree < _LARGEST_DEGREE:
        degree += 1

    def tried(half: int) -> Design | None:
        """Return the bank of a length and its error, None above the bound."""
        grid, inside, even, odd = _branch_shapes(half, cutoff)
        target = np.zeros((len(grid), degree + 1))
        powers = np.arange(degree + 1)[:, None]
        target[inside] = (_powers_of(degree, mu_max, nu_max, cutoff, grid[inside]) * 1j ** (powers % 2)).real.T
        weights = np.where(inside, _importance_at(grid, cutoff, importance), _OUT_OF_BAND_WEIGHT * max(importance))
        taps = _fitted(target, even, odd, weights[:, None])
        response = np.exp(-1j * np.outer(np.arange(-half, half + 1), w))
        reached = error(taps @ response)
        return (taps, 20 * math.log10(reached)) if reached <= allowed else None

    shortest = max(2, (degree + 1) // 2)
    about = max(degree, int(_length_beyond(error_db, cutoff, importance)))
    found = _first(lambda i: tried(shortest + i), _LARGEST_LENGTH // 2, about)
    assert found is not None
    found[0].flags.writeable = False
    return found


@lru_cache(maxsize=16)
def _rectangle(mu_max: float, nu_max: float) -> NDArray[np.complex128]:
    """Return complex delays on the edge of a rectangle, dense in its corners, (n,)."""
    across = np.cos(np.linspace(0.0, math.pi, 33))
    sides = [mu_max * across + 1j * nu_max, mu_max + 1j * nu_max * across]
    return np.concatenate([s * side for s in (1.0, -1.0) for side in sides])


@lru_cache(maxsize=64)
def _lawson(degree: int, mu_max: float, nu_max: float, cutoff: float) -> NDArray[np.complex128]:
    """Return the matrix (degree + 1, n) from values on the edge of a rectangle of delays to coefficients of powers."""
    delays, scale = _rectangle(mu_max, nu_max), math.hypot(mu_max, nu_max)
    powers, wanted = np.vander(delays / scale, degree + 1, increasing=True), np.exp(-1j * cutoff * delays)
    weight = best = np.ones(len(delays))
    least = math.inf
    for _ in range(_LAWSON):
        root = np.sqrt(weight)
        solved = np.linalg.lstsq(powers * root[:, None], wanted * root, rcond=1e-14)[0]
        wrong = np.abs(powers @ solved - wanted)
        if wrong.max() < least:
            best, least = root, wrong.max()
        weight = weight * wrong / np.mean(weight * wrong)
    matrix = np.linalg.pinv(powers * best[:, None]) * best
    return np.asarray(matrix / scale ** np.arange(degree + 1)[:, None])


def _powers_of(degree: int, mu_max: float, nu_max: float, cutoff: float, w: Floats) -> NDArray[np.complex128]:
    """Return the coefficients (degree + 1, frequencies) of powers of a delay in its response at w (n,)."""
    delays = _rectangle(mu_max, nu_max)
    return np.asarray(_lawson(degree, mu_max, nu_max, cutoff) @ np.exp(-1j * np.outer(delays, w)))


def _length_beyond(error_db: float, cutoff: float, importance: tuple[float, ...]) -> float:
    """Half length about which to search, beyond the shortest one: that of the cell which asks for most."""
    # Measured over bands of 0.2 to 2.9 rad and errors of -60 to -110 dB.
    ends = cutoff * np.arange(1, len(importance) + 1) / len(importance)
    requested = 20.0 * np.log10(np.maximum(importance, 1e-15)) - error_db  # dB
    most = float(np.max(np.maximum(requested, 0.0) * np.maximum(ends - 0.2, 0.0)))
    return _LENGTH_PER_DB * most / (math.pi - cutoff)


def _first(tried: Callable[[int], Design | None], count: int, start: int) -> Design | None:
    """First result that is not None of a function that gives None up to some index below `count`, searched from one."""
    low, high, best, step, before = -1, count, None, 1, 0  # None at `low`, a result at `high`
    at = min(start, count - 1)
    while high - low > 1:
        result = tried(at)
        if result is None:
            low = at
        else:
            high, best = at, result
        inside = low >= 0 and high < count
        at = (low + high) // 2 if inside else high - step if high < count else low + step
        at, step, before = min(max(at, low + 1), high - 1), step + before, step  # 1, 1, 2, 3, 5, ...
    return best


def bank_error(
    taps: Floats, centre: int, shift: float, cutoff: float, mu_max: float, importance: tuple[float, ...] = (1.0,),
    *, few: bool = False,
) -> float:  # fmt: skip
    """Return the largest deviation of a bank from a pure delay (which is 1), over all delays, or a few, and the band.

    Shapes: taps (branches, length).
    """
    response, w = _turns(cutoff, taps.shape[1], centre) @ taps.T, _test_frequencies(cutoff)
    powers = np.vander(mu_max * (_FIRST_DELAYS if few else _DELAYS), len(taps), increasing=True)
    left = np.abs(response @ powers.T - _delayed(cutoff, mu_max, shift, few))
    return float(np.max(left * _importance_at(w, cutoff, importance)[:, None]))


def _test_frequencies(cutoff: float, count: int = _FREQUENCIES) -> Floats:
    """Return frequencies (count,) from 0 to a cutoff, the closer the nearer to it, where errors change fastest."""
    return np.asarray(cutoff * np.sin(np.linspace(0.0, 0.5 * math.pi, count)))


@lru_cache(maxsize=16)  # of some 270 KB each
def _delayed(cutoff: float, mu_max: float, shift: float, few: bool) -> NDArray[np.complex128]:
    """Return the responses of pure delays up to the cutoff, (frequencies, delays)."""
    delays = mu_max * (_FIRST_DELAYS if few else _DELAYS) + shift
    return np.asarray(np.exp(-1j * np.outer(_test_frequencies(cutoff), delays)))


@lru_cache(maxsize=16)  # of some 150 KB each
def _turns(cutoff: float, length: int, centre: int) -> NDArray[np.complex128]:
    """Return the responses of single taps up to the cutoff, (frequencies, length)."""
    return np.asarray(np.exp(-1j * np.outer(_test_frequencies(cutoff), np.arange(length) - centre)))


def _importance_at(w: Floats, cutoff: float, importance: tuple[float, ...]) -> Floats:
    """Return the importance at angular frequencies (n,), that of the last cell beyond the cutoff."""
    cell = np.clip((w / cutoff * len(importance)).astype(np.int64), 0, len(importance) - 1)
    return np.array(importance)[cell]
