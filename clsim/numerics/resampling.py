"""Kaiser's window, and the polyphase filters made with it: resampling, and sound from its complex envelope."""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from typing import Any

import numpy as np
import scipy
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from clsim.arrays import Complexes, Floats
from clsim.errors import InputError


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

    A. V. Oppenheim, R. W. Schafer, "Discrete-Time Signal Processing", 3rd ed., 2010, section 7.5.3.
    """
    return band_pass(0.0, cutoff, length, shape_of(ripple_db))


def band_pass(low: float, high: float, length: int, shape: float) -> Floats:
    """Return a filter between two cut-offs, shares of half the sampling rate, whose gain in their middle is 1.

    The ideal filter's response through the window (Oppenheim and Schafer, 2010, eq. 7.72).
    """
    middle = 0.5 * (length - 1)
    places = np.arange(length) - middle
    taps = high * np.sinc(high * places) - low * np.sinc(low * places)
    taps *= scipy.special.i0(shape * np.sqrt(1.0 - (places / middle) ** 2.0)) / scipy.special.i0(shape)
    centre = 0.5 * (low + high) if low > 0.0 else 0.0
    return np.asarray(taps / np.sum(taps * np.cos(np.pi * places * centre)))


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
            problem = f"must be a simple multiple of the signal's, {old:g} Hz, but is {new:g} Hz"
            raise InputError("sampling_rate", problem)
        return cls(ratio.numerator, ratio.denominator)

    def count(self, samples: int) -> int:
        """Return the number of resampled samples."""
        return -(-samples * self.up // self.down)

    def read(self, samples: NDArray[Any], first: int, last: int) -> Floats:
        """Return resampled samples `first` to `last`, from those that the filter reaches; samples (n,)."""
        taps = _taps(self.up, self.down)
        half = len(taps) // 2  # a multiple of `down`, so that all filtered samples wanted lie on its grid
        # The first old sample used is a multiple of `down` as well: then it lies on the new grid.
        start = ((first * self.down - half) // self.up) // self.down * self.down
        stop = ((last - 1) * self.down + half) // self.up + 1
        part = np.zeros(stop - start)
        a, b = max(start, 0), min(stop, len(samples))
        part[a - start : b - start] = samples[a:b]
        skipped = first + half // self.down - start // self.down * self.up
        filtered: Any = scipy.signal.upfirdn(taps, part, self.up, self.down)
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

    def add(self, envelopes: Complexes, first: int, sound: NDArray[Any], skipped: int) -> None:
        """Add the sound of envelopes (rows, m) to samples (rows, n), from its sample ``first every + skipped`` on.

        The envelopes begin with their sample ``first + 1 - reach``.
        """
        count = envelopes.shape[1] - 2 * self.reach + 1
        begin = first + 1 - self.reach
        whole = begin * self.turn % 1  # exact, however late
        cycles = float(whole) + float(self.turn) * np.arange(envelopes.shape[1])
        turns = np.exp(2j * math.pi * cycles).astype(np.complex64)
        taps, out = self.taps.reshape(-1, self.every), np.empty((count, self.every), dtype=np.float32)
        for row, envelope in zip(sound, envelopes, strict=True):
            turned = (envelope.astype(np.complex64, copy=False) * turns).view(np.float32)
            windows = sliding_window_view(turned, 4 * self.reach)[::2]
            for at in range(0, count, _ROWS):
                some = windows[at : at + _ROWS]
                if np.any(turned[2 * at : 2 * (at + len(some)) + 4 * self.reach - 2]):
                    np.matmul(np.ascontiguousarray(some), taps, out=out[at : at + _ROWS])
                else:  # silence stays exact silence
                    out[at : at + _ROWS] = 0.0
            row += out.reshape(-1)[skipped : skipped + len(row)]
