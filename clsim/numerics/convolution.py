"""Convolution by overlapping blocks, spectra of impulses between samples, and arrival times in responses."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from clsim.arrays import Complexes, Floats


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
