"""Filters from responses over a band."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.polynomial import chebyshev

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

_OUTSIDE_WEIGHT = 1e-4  # of the least squares beyond the band, where the response at its end is wanted
_LONGEST = 8193


def linear_phase_filters(
    coefficients: Floats, low: float, high: float, sampling_rate: float, error_db: float, importance: Floats
) -> Floats:
    """Return symmetric filters with real responses over a band.

    Parameters
    ----------
    coefficients : ndarray (K, n)
        Of Chebyshev polynomials of frequency over the band.
    low, high : float
        The band, Hz.
    sampling_rate : float
        Hz.
    error_db : float
        Bound on the largest deviation within the band, times its importance, dB relative to 1.
    importance : ndarray (n,)
        Of the band's frequencies, at Chebyshev points from high to low; 1 at most.

    Returns
    -------
    ndarray (K, L)
        Taps about the middle one; all of one odd length, the shortest tried that is within the error.

    Raises
    ------
    ValueError
        If no filter of up to 8193 taps is.

    Notes
    -----
    Weighted least squares over all frequencies: 1 within the band, 1e-4 beyond it, where the values at the band's ends
    are continued, so that the filters are small there too.
    """
    edges = 2.0 * math.pi * np.array([low, high]) / sampling_rate
    half = 8
    while 2 * half + 1 <= _LONGEST:
        w = np.union1d(np.linspace(0.0, math.pi, 8 * half + 64), np.linspace(edges[0], edges[1], 4 * half + 64))
        inside = (w >= edges[0]) & (w <= edges[1])
        x = np.clip((2.0 * w - edges.sum()) / max(edges[1] - edges[0], 1e-12), -1.0, 1.0)
        target = np.atleast_2d(chebyshev.chebval(x, coefficients.T))
        points = np.cos(math.pi * (np.arange(len(importance)) + 0.5) / len(importance))
        weight = np.where(inside, np.interp(x, points[::-1], importance[::-1]), _OUTSIDE_WEIGHT)[:, None]
        cosines = np.cos(np.outer(w, np.arange(half + 1)))
        taps = _least_squares(w, cosines, weight[:, 0] ** 2, target)
        wrong = (np.abs(cosines @ taps.T - target.T) * weight)[inside].max()
        if wrong <= 10 ** (error_db / 20):
            return np.concatenate([0.5 * taps[:, :0:-1], taps[:, :1], 0.5 * taps[:, 1:]], axis=1)
        half = math.ceil(1.3 * half)
    raise ValueError(f"no filter of up to {_LONGEST} taps is within {error_db:g} dB from {low:g} to {high:g} Hz")


def _least_squares(w: Floats, cosines: Floats, weight: Floats, target: Floats) -> Floats:
    """Return the coefficients (K, n) of cosines of n multiples of `w` that come nearest to targets (K, w)."""
    from scipy.linalg import cho_factor, cho_solve

    count = cosines.shape[1]
    # Products of cosines are cosines of sums and differences: one sum for each multiple up to 2 n.
    sums = np.concatenate([weight @ cosines, weight @ np.cos(np.outer(w, np.arange(count, 2 * count)))])
    m = np.arange(count)
    normal = 0.5 * (sums[np.abs(m[:, None] - m)] + sums[m[:, None] + m])
    normal[m, m] += 1e-14 * np.trace(normal) / count
    return np.asarray(cho_solve(cho_factor(normal), (target * weight @ cosines).T).T)
