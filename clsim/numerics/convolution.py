"""Convolution of long signals with filters, by overlapping blocks."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray


def convolved(signal: NDArray[Any], filters: NDArray[Any]) -> NDArray[Any]:
    """Return a signal through filters; signal (n,); filters (..., L); result (... n + L - 1).

    result: from the first sample on that a filter makes of the signal, to the last one.

    Blocks are as long as makes a sample cheapest; for filters longer than half the signal there is one. Rounding leaves
    noise of some 1e-16 of the loudest where nothing sounds. The same as ``scipy.signal.oaconvolve`` to the last bit,
    without importing all that stands beside it. Overlap-add: A. V. Oppenheim, R. W. Schafer, "Discrete-Time Signal
    Processing", 3rd ed., 2010, section 8.7.3.
    """
    from scipy.fft import next_fast_len

    count, length = len(signal), filters.shape[-1]
    if length == 1:
        return np.asarray(signal * filters)
    whole, size = count + length - 1, _block(count, length)
    if size >= count:
        real = not (np.iscomplexobj(signal) or np.iscomplexobj(filters))
        return _product(signal, filters, next_fast_len(whole, real))[..., :whole]
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
    from scipy.fft import fft, ifft, irfft, rfft

    if np.iscomplexobj(signal) or np.iscomplexobj(filters):
        return np.asarray(ifft(fft(signal, size) * fft(filters, size), size))
    return np.asarray(irfft(rfft(signal, size) * rfft(filters, size), size))


def _block(count: int, length: int) -> int:
    """Return the size N of transforms at which ``N log(2 N)`` for ``N - L + 1`` samples is least; `count` for one."""
    from scipy.fft import next_fast_len
    from scipy.special import lambertw

    if 2 * length >= count:
        return count
    overlap = length - 1
    return int(next_fast_len(math.ceil(-overlap * lambertw(-1.0 / (2.0 * math.e * overlap), k=-1).real)))
