"""Spectra of impulses that lie between samples, and the band to which responses are cut."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from clsim.arrays import Complexes, Floats

_WIDTH = 12  # half samples over which an impulse is spread; the error is about 10 ** (1 - _WIDTH)
_SHAPE = 0.98 * 0.75 * math.pi * _WIDTH  # of the Kaiser-Bessel window, for twice as many points as needed
_COLUMNS = 8  # transformed at a time
_EXPONENT = 8  # of the taper
_REACH = 7.0  # over the width of a skirt, s: beyond, what is left of an arrival's spectrum is below -120 dB


def delayed_sums(delays: Floats, gains: Floats, size: int) -> Complexes:
    """Return the spectra of sums of delayed impulses; delays (P,) samples; gains (P, K).

    result: ``sum_p gains[p, k] exp(-2j pi f delays[p] / N)`` for f from 0, within 1e-10 of the gains.

    A nonuniform Fourier transform: impulses are spread by a Kaiser-Bessel window over a grid twice as fine, which is
    transformed, and divided by the window's own transform (J. A. Fessler, B. P. Sutton, "Nonuniform fast Fourier
    transforms using min-max interpolation", IEEE Trans. Signal Processing 51(2), 2003). The window's transform is that
    of R. M. Lewitt, "Multidimensional digital image representations using generalized Kaiser-Bessel window functions",
    J. Opt. Soc. Am. A 7 (10), 1834-1846, 1990, eq. A3, in one dimension.
    """
    from scipy.fft import rfft
    from scipy.sparse import csr_array
    from scipy.special import i0e

    place = 2.0 * delays
    near = np.floor(place).astype(np.int64)[:, None] + np.arange(1 - _WIDTH // 2, _WIDTH // 2 + 1)
    across = np.sqrt(np.maximum(1.0 - np.square(2.0 * (near - place[:, None]) / _WIDTH), 0.0))
    window = i0e(_SHAPE * across) * np.exp(_SHAPE * (across - 1.0))
    starts = np.arange(len(delays) + 1) * _WIDTH
    spread = csr_array((window.ravel(), (near % (2 * size)).ravel(), starts), shape=(len(delays), 2 * size)).T
    root = np.sqrt(_SHAPE**2 - np.square(math.pi * _WIDTH * np.arange(size // 2 + 1) / (2 * size)))
    own = _WIDTH * np.sinh(root) / root * math.exp(-_SHAPE)
    out = np.empty((gains.shape[1], size // 2 + 1), dtype=np.complex128)
    for k in range(0, len(out), _COLUMNS):
        out[k : k + _COLUMNS] = rfft((spread @ gains[:, k : k + _COLUMNS]).T)[:, : size // 2 + 1] / own
    return out


def band_taper(frequencies: Floats, low: float, high: float, below: float, above: float) -> Floats:
    """Return the weight (n,) of frequencies: 1 in a band, falling smoothly to 0 outside.

    below, above: widths over which the weight falls below `low` and above `high`; where `below` is 0 it stays 1 down to
    0.

    The skirts are regularised incomplete beta functions, so that an arrival dies away fast; see `ringing`.
    """
    from scipy.special import betainc

    weight = betainc(_EXPONENT, _EXPONENT, np.clip((high + above - frequencies) / above, 0.0, 1.0))
    if below > 0.0:
        weight = weight * betainc(_EXPONENT, _EXPONENT, np.clip((frequencies - low + below) / below, 0.0, 1.0))
    return np.asarray(weight)


def ringing(below: float, above: float) -> float:
    """Return the time for which an arrival rings to either side, cut to a band with these skirts.

    Within 5 / 7 of that its skirts have fallen below -100 dB of its peak.
    """
    return _REACH / (min(below, above) if below > 0.0 else above)
