"""Complex envelopes of sound through filters, by transforms of blocks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Complexes, Floats
from clsim.numerics.convolution import turns

if TYPE_CHECKING:
    from fractions import Fraction

_LEAST_TRANSFORM = 1024  # samples of envelopes in a transform at least
_SOUND_TRANSFORM = 2**16  # samples of the sound in one, where that is more
_STOPPED = 3e-6  # of the largest gain of filters, -110 dB, below which they are not applied
_KEPT = 2  # transforms, which reach over the longest delays
_SPANS = 8  # half lengths of the filters in one at least


@dataclass(frozen=True, slots=True, eq=False)
class Mixer:
    """Mixes sound down, low-passes it, applies filters, and keeps every so many-th sample."""

    every: int  # samples of the sound in one of the envelope
    turn: Fraction  # part of a turn of the carrier in one sample of the envelope beyond whole ones
    half_length: int  # samples of the envelope that are looked at to either side
    taps: Complexes  # (K, L) of each filter about the carrier, of odd length about the middle one
    count: int  # samples of the envelope in a transform
    lowest: int  # frequency of a transform of the sound from which on the band is taken
    gains: Complexes  # (K, n count) of the filters at the frequencies from there on, over `every`
    # The last transforms of the signal by float32, by number: the next call begins with these.
    kept: dict[int, NDArray[Any]] = field(default_factory=dict, init=False)

    @classmethod
    def of(
        cls, taps: Complexes, every: int, carrier: Fraction, alike: Complexes | None = None,
        acting: Callable[[Floats], Floats] = lambda frequencies: np.ones((1, len(frequencies))),
    ) -> Mixer:  # fmt: skip
        """Return the mixer with filters (K, L) that turn sound about the carrier's frequency, turns in a sample.

        Filters that are `alike` but for factors (S, F) of frequencies, turns in a sample, are transformed once.
        """
        from scipy.fft import ifft, next_fast_len

        half, own = taps.shape[1] // 2, taps if alike is None else alike
        half_length = half // every + 1
        count = next_fast_len(max(_LEAST_TRANSFORM, _SOUND_TRANSFORM // every, _SPANS * half_length))
        length = count * every
        placed, places = np.zeros((len(own), length), dtype=np.complex128), np.arange(own.shape[1]) - own.shape[1] // 2
        placed[:, places % length] = own
        gains, middle = count * ifft(placed, axis=1, overwrite_x=True), round(float(carrier) * length)
        passed = np.abs(gains).max(axis=0)
        apart = (np.flatnonzero(passed > _STOPPED * passed.max()) - middle + length // 2) % length - length // 2
        folded = min(-(-(2 * int(np.abs(apart).max()) + 1) // count), every)
        lowest = middle - folded * count // 2
        band = np.arange(lowest, lowest + folded * count)
        gains = (acting(band / length)[:, None] * gains[:, band % length]).reshape(len(taps), -1)
        return cls(every, carrier * every % 1, half_length, taps, count, lowest, gains)

    def __call__(
        self, read: Callable[[int, int], Floats], first: int, last: int, *, single: bool = False
    ) -> NDArray[Any]:
        """Return samples `first` to `last` of the envelope through each filter, (K, n), `single` by float32 transforms.

        `read` returns the samples of the sound from one to another, if single those of the signal and no others.
        Transforms begin at multiples of their length, so that a sample is the same to the bit in whichever call.
        """
        size = self.count - 2 * self.half_length
        blocks = range(first // size, -(-last // size))
        gains = self.gains.astype(np.complex64) if single else self.gains
        kept = dict(self.kept) if single else {}
        out = np.empty((len(gains), last - first), dtype=gains.dtype)
        turned_by = np.conj(turns(self.turn, first, last)).astype(gains.dtype)
        for k in blocks:
            made = kept.get(k)
            if made is None:
                made = self._made(read, k * size, size, gains)
            if single:
                kept[k] = made
            begin, end = max(k * size, first), min((k + 1) * size, last)
            here = slice(begin - first, end - first)
            np.multiply(made[:, begin - k * size : end - k * size], turned_by[here], out=out[:, here])
        if single:
            self.kept.clear()
            self.kept.update((k, kept[k]) for k in blocks[-_KEPT:])
        return out

    def _made(self, read: Callable[[int, int], Floats], first: int, size: int, gains: NDArray[Any]) -> NDArray[Any]:
        """Return samples of the filtered sound before it is turned, (K, size)."""
        from scipy.fft import ifft, rfft

        length = self.count * self.every
        begin = (first - self.half_length) * self.every
        sound = read(begin, begin + length)
        if not np.any(sound):
            return np.zeros((len(self.taps), size), dtype=gains.dtype)
        # Every so many-th sample folds the spectrum; what the low-pass stops is left out.
        spectrum, last = rfft(sound.astype(gains.real.dtype, copy=False)), self.lowest + self.gains.shape[1]
        if self.lowest >= 0 and last <= len(spectrum):
            spectrum = spectrum[self.lowest : last]
        else:
            places = np.arange(self.lowest, last) % length
            spectrum = spectrum[np.minimum(places, length - places)]
            np.conj(spectrum, out=spectrum, where=places > length // 2)
        folded = np.zeros((len(self.taps), self.count), dtype=gains.dtype)
        for at in range(0, len(spectrum), self.count):
            folded += gains[:, at : at + self.count] * spectrum[at : at + self.count]
        out = ifft(np.roll(folded, self.lowest % self.count, axis=1), axis=1)
        out = out[:, self.half_length : self.half_length + size]
        if not sound.all():  # what no sound reaches is silent, without the rounding of transforms
            reached, half = np.cumsum(np.append(0, sound != 0.0)), self.taps.shape[1] // 2
            middle = (np.arange(size) + self.half_length) * self.every
            out[:, reached[middle + half + 1] == reached[middle - half]] = 0.0
        return np.asarray(out)
