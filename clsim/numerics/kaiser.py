"""Filters by Kaiser's window, and how long they have to be.

What ``scipy.signal`` has of the same gives the same to the last bit, but takes as long to import as a short scene takes
to render.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from clsim.arrays import Floats


def length_of(width: float, ripple_db: float) -> int:
    """Return the number of taps with which a filter falls within a width.

    width: from what is passed to what is stopped, as a share of half the sampling rate.

    J. F. Kaiser, "Nonrecursive digital filter design using the I0-sinh window function", Proc. IEEE Int. Symp. Circuits
    and Systems, 20-23, 1974; A. V. Oppenheim, R. W. Schafer, "Discrete-Time Signal Processing", 3rd ed., 2010, eq.
    7.76.
    """
    return math.ceil((ripple_db - 7.95) / 2.285 / (math.pi * width) + 1)


def shape_of(ripple_db: float) -> float:
    """Return the window's parameter for a ripple of more than 21 dB (Oppenheim and Schafer, 2010, eq. 7.75)."""
    if ripple_db > 50.0:
        return 0.1102 * (ripple_db - 8.7)
    return float(0.5842 * (ripple_db - 21.0) ** 0.4 + 0.07886 * (ripple_db - 21.0))


def low_pass_between(passed: float, stopped: float, rate: float, ripple_db: float) -> Floats:
    """Return a low-pass without delay, of odd length, from frequencies that are passed to those stopped, Hz.

    Both ripples are equal, so many dB below 1 (Oppenheim and Schafer, 2010, section 7.5.3).
    """
    length = length_of((stopped - passed) / (0.5 * rate), ripple_db) | 1
    return low_pass(0.5 * (stopped + passed) / (0.5 * rate), length, ripple_db)


def low_pass(cutoff: float, length: int, ripple_db: float) -> Floats:
    """Return a low-pass of `length` taps about their middle, whose gain at 0 Hz is 1.

    References
    ----------
    A. V. Oppenheim, R. W. Schafer, "Discrete-Time Signal Processing", 3rd ed., 2010, section 7.5.3.
    """
    return band_pass(0.0, cutoff, length, shape_of(ripple_db))


def band_pass(low: float, high: float, length: int, shape: float) -> Floats:
    """Return a filter between two cut-offs, shares of half the sampling rate, whose gain in their middle is 1.

    The ideal filter's response through the window (Oppenheim and Schafer, 2010, eq. 7.72).
    """
    from scipy.special import i0

    middle = 0.5 * (length - 1)
    places = np.arange(length) - middle
    taps = high * np.sinc(high * places) - low * np.sinc(low * places)
    taps *= i0(shape * np.sqrt(1.0 - (places / middle) ** 2.0)) / i0(shape)
    centre = 0.5 * (low + high) if low > 0.0 else 0.0
    return np.asarray(taps / np.sum(taps * np.cos(np.pi * places * centre)))
