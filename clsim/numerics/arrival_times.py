"""Times of arrival of impulse responses, and responses without them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from clsim.arrays import Floats

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
    from scipy.fft import irfft, next_fast_len, rfft

    size = next_fast_len(2 * responses.shape[-1], real=True)
    size += size % 2
    place = np.arange(size // 2 + 1) / (0.5 * size)
    share = np.sin(0.5 * np.pi * np.clip((place - _SHIFTED) / (1.0 - _SHIFTED), 0.0, 1.0)) ** 2
    shift = samples[..., None] + (np.rint(samples) - samples)[..., None] * share
    return np.asarray(irfft(rfft(responses, size) * np.exp(1j * np.pi * place * shift), size))


def _lags(rows: Floats) -> Floats:
    """Return the lags (n,) of rows (n, m) behind their minimum-phase versions, samples."""
    from scipy.fft import irfft, next_fast_len, rfft

    size = next_fast_len(4 * rows.shape[1], real=True)
    size += size % 2
    spectrum: Any = rfft(rows, size)
    magnitude = np.abs(spectrum)
    logarithm = np.log(np.maximum(magnitude, _FLOOR * magnitude.max(axis=1, keepdims=True)))
    cepstrum = irfft(logarithm, size)
    cepstrum[:, 1 : size // 2] *= 2.0
    cepstrum[:, size // 2 + 1 :] = 0.0
    least: Any = np.exp(rfft(cepstrum, size))
    alike = irfft(spectrum * np.conj(least), _UPSAMPLED * size)
    best = alike.argmax(axis=1)
    before, here, after = (np.take_along_axis(alike, (best[:, None] + i) % alike.shape[1], 1)[:, 0] for i in (-1, 0, 1))
    bend = before - 2.0 * here + after
    between = np.where(bend < 0.0, 0.5 * (before - after) / np.where(bend < 0.0, bend, 1.0), 0.0)
    lag = np.where(best > alike.shape[1] // 2, best - alike.shape[1], best) + between
    return np.asarray(lag / _UPSAMPLED)
