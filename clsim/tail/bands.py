"""Bands of frequency in which a tail's energy is followed."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Floats

_LOWEST = 31.25  # Hz, of a band's centre
_FEW_OCTAVES = 2.5  # width of a signal's band, up to which thirds of octaves are followed


def band_centres(low: float, high: float) -> Floats:
    """Return centres (B,) of octaves or, for a narrow band, thirds of octaves that hold a band, Hz."""
    low = max(low, _LOWEST)
    high = max(high, low)
    parts = 3 if math.log2(high / low) <= _FEW_OCTAVES else 1
    first, last = (round(parts * math.log2(f / 1000.0)) for f in (low, high))
    return np.asarray(1000.0 * 2.0 ** (np.arange(first, last + 1) / parts))


def band_shares(frequencies: NDArray[Any], centres: Floats) -> Floats:
    """Return the amplitude (B, F) of each band's part at frequencies (F,), Hz: together 1 everywhere.

    At a centre a band is alone; between two of them one fades into the other over the logarithm of frequency, so that
    the amplitude of noise shaped in bands goes smoothly from one centre's to the next; it is held beyond the ends.
    """
    at = np.interp(np.log(np.maximum(frequencies, 1e-3)), np.log(centres), np.arange(len(centres), dtype=np.float64))
    away = np.abs(at - np.arange(len(centres))[:, None])
    return np.asarray(np.where(away < 1.0, np.cos(0.5 * np.pi * np.minimum(away, 1.0)) ** 2, 0.0))
