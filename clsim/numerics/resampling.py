"""Resampling of sampled signals."""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.errors import InputError
from clsim.numerics.kaiser import length_of, low_pass

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Floats

_STOP_DB = 110.0
_PASS = 0.9  # of the lower Nyquist frequency
_LARGEST_FACTOR = 10_000


@dataclass(frozen=True, slots=True)
class Resampler:
    """A polyphase filter from one sampling rate to another, ``up / down`` times as fast.

    A Kaiser window design with 110 dB stop band; flat to 0.9 of the lower of both Nyquist frequencies.
    """

    up: int
    down: int

    @classmethod
    def between(cls, old: float, new: float) -> Resampler:
        """Return the filter from the rate `old` to the rate `new`, Hz."""
        ratio = Fraction(new / old).limit_denominator(_LARGEST_FACTOR)
        if not 0 < ratio.numerator <= _LARGEST_FACTOR or abs(float(ratio) * old - new) > 1e-9 * new:
            raise InputError(
                "sampling_rate", f"must be a simple multiple of the signal's, {old:g} Hz, but is {new:g} Hz"
            )
        return cls(ratio.numerator, ratio.denominator)

    def count(self, samples: int) -> int:
        """Return the number of resampled samples."""
        return -(-samples * self.up // self.down)

    def read(self, samples: NDArray[Any], first: int, last: int) -> Floats:
        """Return resampled samples `first` to `last`, from those that the filter reaches; samples (n,)."""
        from scipy.signal import upfirdn

        taps = _taps(self.up, self.down)
        half = len(taps) // 2  # a multiple of `down`, so that all filtered samples wanted lie on its grid
        # The first old sample used is a multiple of `down` as well: then it lies on the new grid.
        start = ((first * self.down - half) // self.up) // self.down * self.down
        stop = ((last - 1) * self.down + half) // self.up + 1
        part = np.zeros(stop - start)
        a, b = max(start, 0), min(stop, len(samples))
        part[a - start : b - start] = samples[a:b]
        skipped = first + half // self.down - start // self.down * self.up
        filtered: Any = upfirdn(taps, part, self.up, self.down)
        return np.asarray(filtered[skipped : skipped + last - first])


@lru_cache(maxsize=8)
def _taps(up: int, down: int) -> Floats:
    """Return the filter at ``up`` times the old rate; its half length is a multiple of `down`."""
    widest = max(up, down)
    if up == down:
        return np.ones(1)
    half = math.ceil(length_of((1.0 - _PASS) / widest, _STOP_DB) / 2)
    taps = up * low_pass(0.5 * (1.0 + _PASS) / widest, 2 * half + 1, _STOP_DB)
    return np.pad(taps, -half % down)
