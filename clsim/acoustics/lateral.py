"""Lateral energy and the correlation of both ears, by ISO 3382-1:2009, annexes A.2.6 and B."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from clsim.arrays import Floats

_FIRST, _LAST = 0.005, 0.08  # s from the direct sound, of early lateral sound
_EARS = 1e-3  # s, by which one ear may be late


def lateral_fractions(omni: Floats, eight: Floats, sampling_rate: float, begin: int = 0) -> tuple[float, float]:
    """Early lateral energy fractions LF and LFC of responses (n,) whose direct sound is at a sample, `begin`.

    omni: of an omnidirectional microphone. eight: of a figure of eight, of the same sensitivity on its axis, whose null
    points at the source.

    ``∫ p_L²`` and ``∫ |p_L p|`` from 5 to 80 ms over ``∫ p²`` up to 80 ms (ISO 3382-1:2009, annex A).
    """
    first, last = (begin + round(seconds * sampling_rate) for seconds in (_FIRST, _LAST))
    whole = float(np.sum(np.square(omni[:last])))
    if whole == 0.0:
        return math.nan, math.nan
    lateral = float(np.sum(np.square(eight[first:last])))
    return lateral / whole, float(np.sum(np.abs(eight[first:last] * omni[first:last]))) / whole


def interaural_correlation(left: Floats, right: Floats, sampling_rate: float) -> float:
    """Interaural cross-correlation coefficient IACC of responses (n,) of both ears, 0 to 1.

    ISO 3382-1:2009, annex B: the largest magnitude of the normalised correlation within 1 ms.
    """
    from scipy.fft import irfft, next_fast_len, rfft

    scale = math.sqrt(float(np.sum(np.square(left))) * float(np.sum(np.square(right))))
    if scale == 0.0:
        return math.nan
    size, most = next_fast_len(2 * len(left), real=True), int(_EARS * sampling_rate)
    correlation = irfft(np.conj(rfft(left, size)) * rfft(right, size), size)
    return float(np.abs(np.append(correlation[: most + 1], correlation[size - most :])).max()) / scale
