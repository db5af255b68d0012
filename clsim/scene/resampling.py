"""Resampling of sampled signals."""

from __future__ import annotations

import math
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.arrays import read_only
from clsim.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import NDArray

_STOP_DB = 110.0
_PASS = 0.9  # of the lower Nyquist frequency
_LARGEST_FACTOR = 10_000


def resample(samples: NDArray[Any], old: float, new: float) -> NDArray[Any]:
    """Return samples at another rate, by a polyphase filter.

    Parameters
    ----------
    samples : ndarray (n,)
        At the rate `old`, Hz.
    old, new : float
        Hz; their ratio must be that of whole numbers up to 10 000.

    Raises
    ------
    InputError
        If the ratio is not.

    Notes
    -----
    A Kaiser window design with 110 dB stop band; flat to 0.9 of the lower of both Nyquist frequencies.
    """
    from scipy.signal import firwin, kaiserord, resample_poly

    ratio = Fraction(new / old).limit_denominator(_LARGEST_FACTOR)
    if ratio.numerator > _LARGEST_FACTOR or abs(float(ratio) * old - new) > 1e-9 * new:
        raise InputError("sampling_rate", f"must be a simple multiple of the signal's, {old:g} Hz, but is {new:g} Hz")
    up, down = ratio.numerator, ratio.denominator
    widest = max(up, down)
    count, beta = kaiserord(_STOP_DB, (1.0 - _PASS) / widest)
    taps = firwin(2 * math.ceil(count / 2) + 1, 0.5 * (1.0 + _PASS) / widest, window=("kaiser", beta))
    resampled: Any = resample_poly(samples, up, down, window=taps)  # type: ignore[call-overload]
    return read_only(np.asarray(resampled))
