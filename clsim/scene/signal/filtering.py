"""Filtering by long impulse responses in blocks, such that the result does not depend on how it is cut."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Protocol

import numpy as np

if TYPE_CHECKING:
    from clsim.arrays import Floats
    from clsim.scene.signal.waveforms import Waveform

_BLOCK = 8192  # samples of a filtered signal that are made at a time
_CACHED = 64  # blocks kept


class Response(Protocol):
    """Anything with an impulse response at every sampling rate."""

    def impulse_response(self, sampling_rate: float) -> Floats:
        """Return the causal impulse response, (n,)."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class Filtered:
    """A waveform after a filter: longer by the filter's impulse response."""

    waveform: Waveform
    response: Response
    centre_frequency: float | None

    def count(self, sampling_rate: float) -> int:
        """Return the number of samples."""
        return self.waveform.count(sampling_rate) + len(self.response.impulse_response(sampling_rate)) - 1

    def read(self, first: int, last: int, sampling_rate: float) -> Floats:
        """Return samples."""
        start = first // _BLOCK
        blocks = [_filtered_block(self, k, sampling_rate) for k in range(start, -(-last // _BLOCK))]
        return np.concatenate(blocks)[first - start * _BLOCK : last - start * _BLOCK]

    def at_rate(self, old: float, new: float) -> Filtered:
        """Return the waveform at the new rate after the filter at the new rate."""
        return Filtered(self.waveform.at_rate(old, new), self.response, self.centre_frequency)


class StreamFilter:
    """Filters what comes in blocks of a fixed length, the last one perhaps shorter, and remembers what rings on.

    Shapes: taps (n,).

    block: samples that are filtered at a time, whatever the length of the pieces: the rounding is the same.

    Attributes
    ----------
    ringing : ndarray (n - 1,)
        What it remembers: the part of its output so far that is still to come.
    """

    def __init__(self, taps: Floats, block: int) -> None:
        from scipy.fft import next_fast_len, rfft

        self._block, self._size = block, next_fast_len(block + len(taps) - 1, real=True)
        self._spectrum = rfft(taps, self._size)
        self.ringing = np.zeros(len(taps) - 1)

    def __call__(self, samples: Floats) -> Floats:
        """Return filtered samples (n,); n is a whole number of blocks but for the last piece."""
        out = np.empty_like(samples)
        for first in range(0, len(samples), self._block):
            out[first : first + self._block] = self._filter(samples[first : first + self._block])
        return out

    def _filter(self, samples: Floats) -> Floats:
        from scipy.fft import irfft, rfft

        whole = irfft(rfft(samples, self._size) * self._spectrum, self._size)
        whole = whole[: self._block + len(self.ringing)]
        whole[: len(self.ringing)] += self.ringing
        self.ringing = whole[self._block :].copy()
        return np.asarray(whole[: len(samples)], dtype=np.float64)


@lru_cache(maxsize=_CACHED)
def _filtered_block(filtered: Filtered, k: int, sampling_rate: float) -> Floats:
    """Return the k-th block of a filtered waveform: overlap-save with everything that reaches into it."""
    from scipy.fft import irfft, next_fast_len, rfft

    taps = filtered.response.impulse_response(sampling_rate)
    before, count = len(taps) - 1, filtered.waveform.count(sampling_rate)
    size = next_fast_len(_BLOCK + before, real=True)
    emitted = np.zeros(size)
    start = k * _BLOCK - before
    first, last = max(start, 0), min((k + 1) * _BLOCK, count)
    if first < last:
        emitted[first - start : last - start] = filtered.waveform.read(first, last, sampling_rate)
    made = irfft(rfft(emitted) * rfft(taps, size), size)
    return np.asarray(made[before : before + _BLOCK], dtype=np.float64)
