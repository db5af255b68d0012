"""Convolution by blocks, impulses between samples, arrival times; Kaiser's window and the filters made with it."""

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


def convolved(signal: NDArray[Any], filters: NDArray[Any]) -> NDArray[Any]:
    """Return a signal through filters; signal (n,); filters (..., L); result (... n + L - 1).

    result: from the first sample on that a filter makes of the signal, to the last one.

    Blocks are as long as makes a sample cheapest; for filters longer than half the signal there is one. Rounding leaves
    noise of some 1e-16 of the loudest where nothing sounds. The same as ``scipy.signal.oaconvolve`` to the last bit,
    without importing all that stands beside it. Overlap-add: A. V. Oppenheim, R. W. Schafer, "Discrete-Time Signal
    Processing", 3rd ed., 2010, section 8.7.3.
    """
    count, length = len(signal), filters.shape[-1]
    if length == 1:
        return np.asarray(signal * filters)
    whole, size = count + length - 1, _block(count, length)
    if size >= count:
        real = not (np.iscomplexobj(signal) or np.iscomplexobj(filters))
        return _product(signal, filters, scipy.fft.next_fast_len(whole, real))[..., :whole]
    step = size - length + 1
    blocks = -(-whole // step)
    padded = np.zeros(blocks * step, dtype=signal.dtype)
    padded[:count] = signal
    parts = _product(padded.reshape(blocks, step), filters[..., None, :], size)
    out = parts[..., :step]
    out[..., 1:, : length - 1] += parts[..., :-1, step:]
    return out.reshape(*filters.shape[:-1], blocks * step)[..., :whole]


def _product(signal: NDArray[Any], filters: NDArray[Any], size: int) -> NDArray[Any]:
    """Return the cyclic convolution over `size` samples, the last axis."""
    if np.iscomplexobj(signal) or np.iscomplexobj(filters):
        return np.asarray(scipy.fft.ifft(scipy.fft.fft(signal, size) * scipy.fft.fft(filters, size), size))
    return np.asarray(scipy.fft.irfft(scipy.fft.rfft(signal, size) * scipy.fft.rfft(filters, size), size))


def _block(count: int, length: int) -> int:
    """Return the size N of transforms at which ``N log(2 N)`` for ``N - L + 1`` samples is least; `count` for one."""
    if 2 * length >= count:
        return count
    overlap = length - 1
    return int(
        scipy.fft.next_fast_len(
            math.ceil(-overlap * scipy.special.lambertw(-1.0 / (2.0 * math.e * overlap), k=-1).real)
        )
    )


class StreamFilter:
    """Filters what comes in blocks of a fixed length by taps (n,), the last one perhaps shorter."""

    # `ringing` (n - 1,) is what it remembers: the part of its output so far that is still to come. The rounding is the
    # same whatever the length of the pieces that it is given.
    def __init__(self, taps: Floats, block: int) -> None:
        self._block, self._size = block, scipy.fft.next_fast_len(block + len(taps) - 1, real=True)
        self._spectrum = scipy.fft.rfft(taps, self._size)
        self.ringing = np.zeros(len(taps) - 1)

    def __call__(self, samples: Floats) -> Floats:
        """Return filtered samples (n,); n is a whole number of blocks but for the last piece."""
        out = np.empty_like(samples)
        for first in range(0, len(samples), self._block):
            part = samples[first : first + self._block]
            whole = scipy.fft.irfft(scipy.fft.rfft(part, self._size) * self._spectrum, self._size)[
                : self._block + len(self.ringing)
            ]
            whole[: len(self.ringing)] += self.ringing
            self.ringing = whole[self._block :].copy()
            out[first : first + self._block] = whole[: len(part)]
        return out


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
    place = 2.0 * delays
    near = np.floor(place).astype(np.int64)[:, None] + np.arange(1 - _WIDTH // 2, _WIDTH // 2 + 1)
    across = np.sqrt(np.maximum(1.0 - np.square(2.0 * (near - place[:, None]) / _WIDTH), 0.0))
    window = scipy.special.i0e(_SHAPE * across) * np.exp(_SHAPE * (across - 1.0))
    starts = np.arange(len(delays) + 1) * _WIDTH
    spread = scipy.sparse.csr_array(
        (window.ravel(), (near % (2 * size)).ravel(), starts), shape=(len(delays), 2 * size)
    ).T
    root = np.sqrt(_SHAPE**2 - np.square(math.pi * _WIDTH * np.arange(size // 2 + 1) / (2 * size)))
    own = _WIDTH * np.sinh(root) / root * math.exp(-_SHAPE)
    out = np.empty((gains.shape[1], size // 2 + 1), dtype=np.complex128)
    for k in range(0, len(out), _COLUMNS):
        out[k : k + _COLUMNS] = scipy.fft.rfft((spread @ gains[:, k : k + _COLUMNS]).T)[:, : size // 2 + 1] / own
    return out


def band_taper(frequencies: Floats, low: float, high: float, below: float, above: float) -> Floats:
    """Return the weight (n,) of frequencies: 1 in a band, falling smoothly to 0 outside.

    below, above: widths over which the weight falls below `low` and above `high`; where `below` is 0 it stays 1 down to
    0.

    The skirts are regularised incomplete beta functions, so that an arrival dies away fast; see `ringing`.
    """
    weight = scipy.special.betainc(_EXPONENT, _EXPONENT, np.clip((high + above - frequencies) / above, 0.0, 1.0))
    if below > 0.0:
        weight = weight * scipy.special.betainc(
            _EXPONENT, _EXPONENT, np.clip((frequencies - low + below) / below, 0.0, 1.0)
        )
    return np.asarray(weight)


def ringing(below: float, above: float) -> float:
    """Return the time for which an arrival rings to either side, cut to a band with these skirts.

    Within 5 / 7 of that its skirts have fallen below -100 dB of its peak.
    """
    return _REACH / (min(below, above) if below > 0.0 else above)


_UPSAMPLED = 8  # places of the correlation to a sample, between which a parabola is put
_TOGETHER = 256  # responses
_SHIFTED = 0.85  # of half the sampling rate, up to which responses are shifted by parts of samples
_FLOOR = 1e-5  # of a spectrum's largest value, below which its logarithm is not asked for


def arrival_times(responses: Floats) -> Floats:
    """Return the delays (...) at which responses (..., n) are most like their minimum-phase versions, samples.

    The largest correlation of both, between samples as well (J. Nam, J. S. Abel and J. O. Smith, AES Convention 125,
    2008, paper 7612, section 2).
    """
    flat = responses.reshape(-1, responses.shape[-1])
    found = [_lags(flat[first : first + _TOGETHER]) for first in range(0, len(flat), _TOGETHER)]
    return np.concatenate(found).reshape(responses.shape[:-1])


def advanced(responses: Floats, samples: Floats) -> Floats:
    """Return responses (..., N) earlier by so many samples (...), N at least twice as long; the end is before time 0.

    Towards half the sampling rate the shift becomes one by whole samples: a part of one would ring throughout.
    """
    size = scipy.fft.next_fast_len(2 * responses.shape[-1], real=True)
    size += size % 2
    place = np.arange(size // 2 + 1) / (0.5 * size)
    share = np.sin(0.5 * np.pi * np.clip((place - _SHIFTED) / (1.0 - _SHIFTED), 0.0, 1.0)) ** 2
    shift = samples[..., None] + (np.rint(samples) - samples)[..., None] * share
    return np.asarray(scipy.fft.irfft(scipy.fft.rfft(responses, size) * np.exp(1j * np.pi * place * shift), size))


def _lags(rows: Floats) -> Floats:
    """Return the lags (n,) of rows (n, m) behind their minimum-phase versions, samples."""
    size = scipy.fft.next_fast_len(4 * rows.shape[1], real=True)
    size += size % 2
    spectrum: Any = scipy.fft.rfft(rows, size)
    magnitude = np.abs(spectrum)
    logarithm = np.log(np.maximum(magnitude, _FLOOR * magnitude.max(axis=1, keepdims=True)))
    cepstrum = scipy.fft.irfft(logarithm, size)
    cepstrum[:, 1 : size // 2] *= 2.0
    cepstrum[:, size // 2 + 1 :] = 0.0
    least: Any = np.exp(scipy.fft.rfft(cepstrum, size))
    alike = scipy.fft.irfft(spectrum * np.conj(least), _UPSAMPLED * size)
    best = alike.argmax(axis=1)
    before, here, after = (np.take_along_axis(alike, (best[:, None] + i) % alike.shape[1], 1)[:, 0] for i in (-1, 0, 1))
    bend = before - 2.0 * here + after
    between = np.where(bend < 0.0, 0.5 * (before - after) / np.where(bend < 0.0, bend, 1.0), 0.0)
    offset = np.where(best > alike.shape[1] // 2, best - alike.shape[1], best) + between
    return np.asarray(offset / _UPSAMPLED)


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


def turns(turn: Fraction, first: int, last: int) -> Complexes:
    """Return ``exp(2 pi j turn n)`` for n from `first` to `last`, exact however late, (last - first,)."""
    cycles = float(first * turn % 1) + float(turn) * np.arange(min(last - first, turn.denominator))
    return np.resize(np.exp(2j * math.pi * cycles), last - first)


_IMAGE_STOP_DB = 115.0
_COLUMNS = 96  # samples of the sound in a row of a product at least
_WINDOWED = 2**15  # numbers of windows that are multiplied at a time


@dataclass(frozen=True, slots=True, eq=False)
class Upsampler:
    """Makes sound of complex envelopes at a rate so many times as low.

    ``y[n] = Re sum_m h[n - m every] e[m] exp(2 pi j carrier n / rate)``: with the envelope turned to the carrier's
    phase at its own samples, the rest of the turn is that of ``n - m every`` and part of the taps. So every sample of
    the sound is one product of real numbers with a window of the envelope, and all of them a product of matrices. A
    window is that of a few samples of the envelope, lest matrices be narrow.
    """

    every: int  # samples of the sound in one of the envelope
    turn: Fraction  # part of a turn of the carrier in one sample of the envelope beyond whole ones
    # Samples of the envelope that are looked at: sample 0 of the sound takes those from ``1 - reach`` to ``reach``.
    reach: int
    # (2 reach + n - 1, 2, n every) by sample of the envelope, its real and imaginary part, and sample of the sound.
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
        samples = -(-_COLUMNS // every) * every
        at = np.arange(samples) - every * np.arange(1 - reach, reach + samples // every)[:, None] + middle
        taps = np.where((at >= 0) & (at < len(mixed)), mixed[np.clip(at, 0, 2 * middle)], 0.0)
        turn = Fraction(carrier) * every / Fraction(rate) % 1
        return cls(every, turn, reach, np.stack([taps.real, -taps.imag], axis=1).astype(np.float32))

    def add(self, envelopes: Complexes, first: int, sound: NDArray[Any], skipped: int) -> None:
        """Add the sound of envelopes (rows, m) to samples (rows, n), from its sample ``first every + skipped`` on."""
        # The envelopes begin with their sample ``first + 1 - reach``.
        count = envelopes.shape[1] - 2 * self.reach + 1
        begin = first + 1 - self.reach
        turned_by = turns(self.turn, begin, begin + envelopes.shape[1]).astype(np.complex64)
        taps = self.taps.reshape(-1, self.taps.shape[2])
        step, rows = 2 * taps.shape[1] // self.every, -(-count * self.every // taps.shape[1])
        some_rows = _WINDOWED // len(taps) + 1
        beyond = (rows - 1) * step + len(taps) - 2 * envelopes.shape[1]
        out = np.empty((rows, taps.shape[1]), dtype=np.float32)
        for row, envelope in zip(sound, envelopes, strict=True):
            turned = np.pad((envelope.astype(np.complex64, copy=False) * turned_by).view(np.float32), (0, beyond))
            windows = sliding_window_view(turned, len(taps))[::step]
            for at in range(0, rows, some_rows):
                some = windows[at : at + some_rows]
                if np.any(turned[step * at : step * (at + len(some) - 1) + len(taps)]):
                    np.matmul(np.ascontiguousarray(some), taps, out=out[at : at + some_rows])
                else:  # silence stays exact silence
                    out[at : at + some_rows] = 0.0
            row += out.reshape(-1)[skipped : skipped + len(row)]
