"""Filters from responses over a band."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.polynomial import chebyshev

if TYPE_CHECKING:
    from collections.abc import Callable

    from clsim.arrays import Complexes, Floats

_OUTSIDE_WEIGHT = 1e-4  # of the least squares beyond the band, where the response at its end is wanted
_LONGEST = 2049
_BETWEEN = 4  # places between neighbouring points at which deviations are looked at


class NoFilterError(ValueError):
    """No filter of a sensible length has the response."""


def band_filters(
    coefficients: Floats | Complexes,
    low: float,
    high: float,
    sampling_rate: float,
    importance: Floats,
    error: Callable[[Floats], float],
    allowed: float,
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
    importance : ndarray (m,)
        Weight of deviations at Chebyshev points of the band, from high to low.
    error : callable
        Returns the error that deviations (K, m) about these points amount to.
    allowed : float
        Its bound.

    Returns
    -------
    ndarray (K, L)
        Taps about the middle one; all of one odd length, the shortest tried that is within the bound. Symmetric where
        the response is real, so that nothing is shifted.

    Raises
    ------
    NoFilterError
        If no filter of up to 2049 taps is.

    Notes
    -----
    Weighted least squares over all frequencies, of cosines for the real part and sines for the imaginary one: by
    importance within the band, 1e-4 beyond it, where the values at the ends are continued, so that the filters are
    small there too.
    """
    edges, count = 2.0 * math.pi * np.array([low, high]) / sampling_rate, len(importance)
    points = np.cos(math.pi * (np.arange(count) + 0.5) / count)
    looked_at = np.cos(math.pi * (np.arange(_BETWEEN * count) + 0.5) / (_BETWEEN * count))
    wanted = np.atleast_2d(chebyshev.chebval(looked_at, coefficients.T))
    half = 8
    while 2 * half + 1 <= _LONGEST:
        w = np.union1d(np.linspace(0.0, math.pi, 8 * half + 64), np.linspace(edges[0], edges[1], 4 * half + 64))
        inside = (w >= edges[0]) & (w <= edges[1])
        x = np.clip((2.0 * w - edges.sum()) / max(edges[1] - edges[0], 1e-12), -1.0, 1.0)
        target = np.atleast_2d(chebyshev.chebval(x, coefficients.T))
        weight = np.where(inside, np.interp(x, points[::-1], importance[::-1]), _OUTSIDE_WEIGHT)
        even = _fitted(w, weight, target.real, half, odd=False)
        odd = np.zeros_like(even[:, 1:])
        if np.iscomplexobj(target):
            odd = _fitted(w, weight, target.imag, half, odd=True)
        at = 0.5 * (edges.sum() + looked_at * (edges[1] - edges[0]))
        left = np.abs(even @ _waves(at, half, odd=False).T + 1j * (odd @ _waves(at, half, odd=True).T) - wanted)
        if error(left.reshape(len(left), count, _BETWEEN).max(axis=2)) <= allowed:
            # h[n] + h[-n] = even[n] and h[-n] - h[n] = odd[n]: exp(-jwn) turns sines of positive n to -j.
            before, after = 0.5 * (even[:, 1:] + odd), 0.5 * (even[:, 1:] - odd)
            return np.concatenate([before[:, ::-1], even[:, :1], after], axis=1)
        half = math.ceil(1.3 * half)
    reached = 20.0 * math.log10(allowed)
    raise NoFilterError(f"no filter of up to {_LONGEST} taps is within {reached:.0f} dB from {low:g} to {high:g} Hz")


def _waves(w: Floats, half: int, *, odd: bool) -> Floats:
    """Return sines from 1, or cosines from 0, to `half` times w, (w, n)."""
    angles = np.outer(w, np.arange(int(odd), half + 1))
    return np.asarray(np.sin(angles) if odd else np.cos(angles))


def _fitted(w: Floats, weight: Floats, target: Floats, half: int, *, odd: bool) -> Floats:
    """Return coefficients (K, n) of cosines from 0, or sines from 1, to `half` times w."""
    return _least_squares(w, _waves(w, half, odd=odd), weight**2, target, odd=odd)


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
