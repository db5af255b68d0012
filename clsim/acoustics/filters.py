"""Filters from responses over a band."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from clsim.arrays import Complexes, Floats

_OUTSIDE_WEIGHT = 1e-4  # of the least squares beyond the band, where the response at its end is wanted
LONGEST = 2049  # taps
_SHORTEST = 17
_NOTHING = 1e-9  # of the largest coefficient
_FAR_DB = 20.0  # from the asked error, beyond which lengths are tried in longer steps
_SLIGHT = 0.1  # importance below which sound beneath the band counts by its energy, see band_filters


@dataclass(frozen=True, slots=True, eq=False)
class BandFilters:
    """Filters and what they reach.

    Attributes
    ----------
    taps : ndarray (K, L)
        About the middle one; all of one odd length.
    error_db : float
        Largest deviation of any, times its importance, dB relative to 1.
    worst : float
        Where that is, Hz.
    """

    taps: Floats
    error_db: float
    worst: float


def band_filters(
    coefficients: Floats | Complexes,
    low: float,
    high: float,
    sampling_rate: float,
    error_db: float,
    importance: Floats,
    late: int = 0,
) -> BandFilters:
    """Return filters with given responses over a band: the shortest tried within an error, or the best.

    Parameters
    ----------
    coefficients : ndarray (K, n)
        Of Chebyshev polynomials of frequency over the band, real or complex.
    low, high : float
        The band, Hz.
    sampling_rate : float
        Hz.
    error_db : float
        Asked bound on the largest deviation within the band, times its importance, dB relative to 1.
    importance : ndarray (m,)
        Of the band's frequencies, at Chebyshev points from high to low; 1 at most.
    late : int
        Samples by which the filters delay in addition.

    Returns
    -------
    BandFilters
        Of up to 2049 taps, and as many more as make room for the delay. Symmetric where the response is real and there
        is no delay, so that nothing is shifted.

    Notes
    -----
    Weighted least squares over all frequencies, of cosines for the real part and sines for the imaginary one: 1 within
    the band, 1e-4 beyond it, where the values at the ends are continued, so that the filters are small there too.

    A real filter has no phase at 0 Hz, so complex responses ask for a transition there, and for a longer filter the
    nearer to 0 Hz the band begins. Where a signal that begins abruptly has hardly any sound (an importance below 0.1,
    from `low` on), deviations of such responses count by their energy: the root of the mean square over Chebyshev
    points.
    """
    edges = 2.0 * math.pi * np.array([low, high]) / sampling_rate
    points = np.cos(math.pi * (np.arange(len(importance)) + 0.5) / len(importance))
    loud = points[::-1][np.argmax(importance[::-1] >= _SLIGHT * importance.max())]
    slight = loud if np.iscomplexobj(coefficients) else -math.inf
    half, best = _SHORTEST // 2, BandFilters(np.zeros((len(coefficients), 1)), math.inf, low)
    while best.error_db > error_db and 2 * half + 1 <= LONGEST:
        w = np.union1d(np.linspace(0.0, math.pi, 8 * half + 64), np.linspace(edges[0], edges[1], 4 * half + 64))
        inside = (w >= edges[0]) & (w <= edges[1])
        x = np.clip((2.0 * w - edges.sum()) / max(edges[1] - edges[0], 1e-12), -1.0, 1.0)
        target = _polynomials(coefficients, x)
        weight = np.where(inside, np.interp(x, points[::-1], importance[::-1]), _OUTSIDE_WEIGHT)
        taps, left = _fitted(w, weight, target, half)
        reached, at = _largest((left * weight)[:, inside], x[inside], slight)
        if reached < best.error_db:
            best = BandFilters(taps, reached, float(w[inside][at]) * sampling_rate / (2.0 * math.pi))
        step = 1.7 if reached > error_db + _FAR_DB else 1.3
        half = min(math.ceil(step * half), max(LONGEST // 2, half + 1))
    return replace(best, taps=np.pad(best.taps, ((0, 0), (abs(late) + late, abs(late) - late))))


def _largest(wrong: Floats, x: Floats, slight: float) -> tuple[float, int]:
    """Return the largest of errors (K, n) in dB, those below `slight` by their energy, and where among x (n,) it is."""
    most, beneath = wrong.max(axis=0), x < slight
    at = int(np.argmax(np.where(beneath, 0.0, most)))
    largest = float(most[at])
    if beneath.any():
        cells = np.abs(np.gradient(np.arccos(x))) / math.pi  # of Chebyshev points, which lie evenly over the angle
        together = math.sqrt(float((wrong[:, beneath] ** 2 @ cells[beneath]).max()))
        if together > largest:
            largest, at = together, int(np.argmax(np.where(beneath, most, 0.0)))
    return 20.0 * math.log10(max(largest, 1e-15)), at


def _polynomials(coefficients: Floats | Complexes, x: Floats) -> Floats | Complexes:
    """Return the values (K, w) of Chebyshev polynomials, without terms that are next to nothing."""
    size = np.abs(coefficients).max(axis=0)
    kept = int(np.flatnonzero(size >= _NOTHING * size.max())[-1]) + 1
    terms = np.cos(np.outer(np.arange(kept), np.arccos(x)))
    values: Floats = coefficients[:, :kept].real @ terms
    return values + 1j * (coefficients[:, :kept].imag @ terms) if np.iscomplexobj(coefficients) else values


def _fitted(w: Floats, weight: Floats, target: Floats | Complexes, half: int) -> tuple[Floats, Floats]:
    """Return taps (K, 2 half + 1) whose responses come nearest to targets (K, w), and what they leave (K, w)."""
    # Products of cosines, or of sines, are cosines of differences and sums: one sum for each multiple up to 2 half.
    cosines = np.cos(np.outer(w, np.arange(2 * half + 1)))
    sums = weight**2 @ cosines
    waves = cosines[:, : half + 1]
    even = _solved(sums, 0, (target.real * weight**2) @ waves)
    left = np.abs(even @ waves.T - target.real)
    odd = np.zeros_like(even[:, 1:])
    if np.iscomplexobj(target):
        waves = np.sin(np.outer(w, np.arange(1, half + 1)))
        odd = _solved(sums, 1, (target.imag * weight**2) @ waves)
        left = np.hypot(left, odd @ waves.T - target.imag)
    # h[n] + h[-n] = even[n] and h[-n] - h[n] = odd[n]: exp(-jwn) turns sines of positive n to -j.
    before, after = 0.5 * (even[:, 1:] + odd), 0.5 * (even[:, 1:] - odd)
    return np.concatenate([before[:, ::-1], even[:, :1], after], axis=1), left


def _solved(sums: Floats, first: int, products: Floats) -> Floats:
    """Return the coefficients (K, n) of cosines from 0, or sines from 1, by their products (K, n) with targets."""
    from scipy.linalg import cho_factor, cho_solve

    m = np.arange(products.shape[1]) + first
    normal = 0.5 * (sums[np.abs(m[:, None] - m)] + (-1.0 if first else 1.0) * sums[m[:, None] + m])
    diagonal = np.arange(len(m))
    normal[diagonal, diagonal] += 1e-14 * np.trace(normal) / len(m)
    return np.asarray(cho_solve(cho_factor(normal), products.T).T)
