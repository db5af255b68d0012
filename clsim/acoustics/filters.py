"""Filters from responses over a band."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.polynomial import chebyshev

if TYPE_CHECKING:
    from clsim.arrays import Complexes, Floats

_OUTSIDE_WEIGHT = 1e-4  # of the least squares beyond the band, where the response at its end is wanted
_LONGEST = 2049


class NoFilterError(ValueError):
    """No filter of a sensible length has the response."""


def band_filters(
    coefficients: Floats | Complexes,
    low: float,
    high: float,
    sampling_rate: float,
    error_db: float,
    importance: Floats,
) -> Floats:
    """Return filters with given responses over a band.

    Parameters
    ----------
    coefficients : ndarray (K, n)
        Of Chebyshev polynomials of frequency over the band, real or complex.
    low, high : float
        The band, Hz.
    sampling_rate : float
        Hz.
    error_db : float
        Bound on the largest deviation within the band, times its importance, dB relative to 1.
    importance : ndarray (m,)
        Of the band's frequencies, at Chebyshev points from high to low; 1 at most.

    Returns
    -------
    ndarray (K, L)
        Taps about the middle one; all of one odd length, the shortest tried that is within the error. Symmetric where
        the response is real, so that nothing is shifted.

    Raises
    ------
    NoFilterError
        If no filter of up to 2049 taps is.

    Notes
    -----
    Weighted least squares over all frequencies, of cosines for the real part and sines for the imaginary one: 1 within
    the band, 1e-4 beyond it, where the values at the ends are continued, so that the filters are small there too.
    """
    edges = 2.0 * math.pi * np.array([low, high]) / sampling_rate
    points = np.cos(math.pi * (np.arange(len(importance)) + 0.5) / len(importance))
    half = 8
    while 2 * half + 1 <= _LONGEST:
        w = np.union1d(np.linspace(0.0, math.pi, 8 * half + 64), np.linspace(edges[0], edges[1], 4 * half + 64))
        inside = (w >= edges[0]) & (w <= edges[1])
        x = np.clip((2.0 * w - edges.sum()) / max(edges[1] - edges[0], 1e-12), -1.0, 1.0)
        target = np.atleast_2d(chebyshev.chebval(x, coefficients.T))
        weight = np.where(inside, np.interp(x, points[::-1], importance[::-1]), _OUTSIDE_WEIGHT)
        even, left = _fitted(w, weight, target.real, half, odd=False)
        odd = np.zeros_like(even[:, 1:])
        if np.iscomplexobj(target):
            odd, left_too = _fitted(w, weight, target.imag, half, odd=True)
            left = np.hypot(left, left_too)
        if (left * weight)[:, inside].max() <= 10 ** (error_db / 20):
            # h[n] + h[-n] = even[n] and h[-n] - h[n] = odd[n]: exp(-jwn) turns sines of positive n to -j.
            before, after = 0.5 * (even[:, 1:] + odd), 0.5 * (even[:, 1:] - odd)
            return np.concatenate([before[:, ::-1], even[:, :1], after], axis=1)
        half = math.ceil(1.3 * half)
    raise NoFilterError(f"no filter of up to {_LONGEST} taps is within {error_db:g} dB from {low:g} to {high:g} Hz")


def _fitted(w: Floats, weight: Floats, target: Floats, half: int, *, odd: bool) -> tuple[Floats, Floats]:
    """Return coefficients (K, n) of cosines from 0, or sines from 1, to `half` times w, and what they leave (K, w)."""
    waves = np.sin(np.outer(w, np.arange(1, half + 1))) if odd else np.cos(np.outer(w, np.arange(half + 1)))
    found = _least_squares(w, waves, weight**2, target, odd=odd)
    return found, np.abs(found @ waves.T - target)


def _least_squares(w: Floats, waves: Floats, weight: Floats, target: Floats, *, odd: bool) -> Floats:
    """Return the coefficients (K, n) of waves (w, n), multiples of `w`, that come nearest to targets (K, w)."""
    from scipy.linalg import cho_factor, cho_solve

    m = np.arange(waves.shape[1]) + int(odd)
    # Products of cosines, or of sines, are cosines of differences and sums: one sum for each multiple up to 2 n.
    sums = weight @ np.cos(np.outer(w, np.arange(2 * m[-1] + 1)))
    normal = 0.5 * (sums[np.abs(m[:, None] - m)] + (-1.0 if odd else 1.0) * sums[m[:, None] + m])
    diagonal = np.arange(len(m))
    normal[diagonal, diagonal] += 1e-14 * np.trace(normal) / len(m)
    return np.asarray(cho_solve(cho_factor(normal), (target * weight @ waves).T).T)
