"""Polyphase filters: resampling of signals, and sound from its complex envelope."""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from clsim.errors import InputError
from clsim.numerics.kaiser import length_of, low_pass

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Complexes, Floats

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


_IMAGE_STOP_DB = 115.0
_ROWS = 512  # samples of the envelope taken together: their windows stay in cache


@dataclass(frozen=True, slots=True, eq=False)
class Upsampler:
    """Makes sound of complex envelopes at a rate so many times as low.

    ``y[n] = Re sum_m h[n - m every] e[m] exp(2 pi j carrier n / rate)``: with the envelope turned to the carrier's
    phase at its own samples, the rest of the turn is that of ``n - m every`` and part of the taps. So every sample of
    the sound is one product of real numbers with a window of the envelope, and all of them a product of matrices.
    """

    every: int  # samples of the sound in one of the envelope
    turn: Fraction  # part of a turn of the carrier in one sample of the envelope beyond whole ones
    # Samples of the envelope that are looked at: sample 0 of the sound takes those from ``1 - reach`` to ``reach``.
    reach: int
    # (2 reach, 2, every) by sample of the envelope, its real and imaginary part, and sample of the sound.
    taps: NDArray[np.float32]

    @classmethod
    def about(cls, carrier: float, rate: float, every: int, half: float) -> Upsampler:
        """Return the filter for envelopes that hold `half` Hz on either side of a carrier."""
        images = rate / every - half
        reach = -(-length_of((images - half) / (0.5 * rate), _IMAGE_STOP_DB) // (2 * every))
        middle = reach * every - 1  # of an odd number of taps: the window for any sample begins at most `reach` later
        at_rest = every * low_pass(0.5 * (images + half) / (0.5 * rate), 2 * middle + 1, _IMAGE_STOP_DB)
        mixed = at_rest * np.exp(2j * math.pi * (carrier / rate) * np.arange(-middle, middle + 1))
        # Sample n looks at m = 1 - reach ... reach through the tap at n - m every.
        at = np.arange(every) - every * np.arange(1 - reach, reach + 1)[:, None] + middle
        taps = np.where(at >= 0, mixed[np.maximum(at, 0)], 0.0)
        turn = Fraction(carrier) * every / Fraction(rate) % 1
        return cls(every, turn, reach, np.stack([taps.real, -taps.imag], axis=1).astype(np.float32))

    def __call__(self, envelope: Complexes, first: int) -> NDArray[np.float32]:
        """Return samples of the sound from ``first every`` on, (n every,) float32; envelope (n + 2 reach - 1,)."""
        count = len(envelope) - 2 * self.reach + 1
        out = np.zeros((count, self.every), dtype=np.float32)
        begin = first + 1 - self.reach
        whole = begin * self.turn % 1  # exact, however late
        cycles = float(whole) + float(self.turn) * np.arange(len(envelope))
        turned = (envelope * np.exp(2j * math.pi * cycles)).astype(np.complex64).view(np.float32)
        windows = sliding_window_view(turned, 4 * self.reach)[::2]
        taps = self.taps.reshape(-1, self.every)
        for at in range(0, count, _ROWS):
            some = windows[at : at + _ROWS]
            if np.any(turned[2 * at : 2 * (at + len(some)) + 4 * self.reach - 2]):  # silence stays exact silence
                np.matmul(np.ascontiguousarray(some), taps, out=out[at : at + _ROWS])
        return out.reshape(-1)
