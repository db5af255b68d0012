"""Level over time and frequency, as a raster of bounded size."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

_COLUMNS = 1200
_ROWS = 600
_OVERLAP = 16  # columns that share a sample, where time is spread out
_PADDING = 4  # of a window with zeros, where frequency is spread out
_BUDGET = 2**26  # samples transformed; of longer sound, a part of the windows is taken
_SHORTEST = 8  # of a window at an end of the sound, as a part of the others
_FLOOR = 1e-18  # mean square below which there is silence, Pa²
_REFERENCE = 20e-6  # Pa


class Readable(Protocol):
    """Samples that can be sliced: an array or an open sound file."""

    def __len__(self) -> int: ...

    def __getitem__(self, part: slice) -> NDArray[Any]: ...


@dataclass(frozen=True, slots=True, eq=False)
class Spectrogram:
    """Level (rows, columns) in dB re 20 µPa; rows and columns cover `low` to `high` (Hz) and `duration` (s) evenly."""

    level: NDArray[np.float32]
    low: float
    high: float
    duration: float


def spectrogram(
    pressure: Readable, sampling_rate: float, band: tuple[float, float], segment: int | None = None
) -> Spectrogram:
    """Return the level of pressure (n,), Pa, over time and frequency in a band (low, high), Hz.

    segment: samples of a window. When left out, time and frequency are resolved to the same share of the picture.

    A sine of root mean square `p` has the level ``20 log10(p / 20 µPa)``, whatever the window. A pixel is the mean over
    the windows inside it and the largest of the frequencies inside it, so that neither moves a line's level.
    """
    count = len(pressure)
    width = max(band[1] - band[0], 1e-3)
    if segment is None:
        segment = _segment(count, sampling_rate, width)
    padded = segment
    while padded < _PADDING * segment and width / sampling_rate * padded < _ROWS:
        padded *= 2
    step = sampling_rate / padded
    first = max(0, math.floor(band[0] / step))
    bins = slice(first, max(first, min(padded // 2, math.ceil(band[1] / step))) + 1)
    pool = math.ceil((bins.stop - bins.start) / _ROWS)
    columns = max(1, min(_COLUMNS, math.ceil(_OVERLAP * count / segment)))
    rows = -(-(bins.stop - bins.start) // pool)
    level = np.empty((rows, columns), dtype=np.float32)
    for column in range(columns):
        span = (column * count / columns, (column + 1) * count / columns)
        power = _power(pressure, segment, span, padded)
        peaks = np.maximum.reduceat(power[bins], np.arange(0, bins.stop - bins.start, pool))
        level[:, column] = 10.0 * np.log10(np.maximum(peaks, _FLOOR) / _REFERENCE**2)
    low = (bins.start - 0.5) * step
    return Spectrogram(level, low, low + rows * pool * step, count / sampling_rate)


def _power(pressure: Readable, segment: int, span: tuple[float, float], padded: int) -> NDArray[np.float64]:
    """Return the mean power spectrum, Pa² of a sine in each bin, of the windows centred in a span of samples."""
    from scipy.fft import rfft

    count = len(pressure)
    most = max(1, _BUDGET // (_COLUMNS * padded))
    number = min(most, max(1, round(2.0 * (span[1] - span[0]) / segment)))
    total = np.zeros(padded // 2 + 1)
    for k in range(number):
        centre = span[0] + (k + 0.5) * (span[1] - span[0]) / number
        # Near the ends windows are shorter: they stay about their centre, and inside the sound.
        length = min(segment, max(int(2.0 * min(centre, count - centre)), segment // _SHORTEST, 1))
        start = min(max(0, round(centre - 0.5 * length)), max(0, count - length))
        window = _window(length)
        part = np.asarray(pressure[start : start + length], dtype=np.float32)
        spectrum: Any = rfft(part * window[: len(part)], padded)
        total += (np.square(spectrum.real) + np.square(spectrum.imag)) * (2.0 / float(window.sum()) ** 2)
    return total / number


@lru_cache(maxsize=4)
def _window(length: int) -> NDArray[np.float32]:
    """Return a Hann window without its zeros."""
    return np.asarray(np.sin(np.pi * (np.arange(length) + 0.5) / length) ** 2, dtype=np.float32)


def _segment(count: int, sampling_rate: float, width: float) -> int:
    """Return a window's length, a power of two: as many resolved steps over time as over frequency, or a row each."""
    even = math.sqrt(max(count, 1) * sampling_rate / width)
    enough = 2.0 * _ROWS * sampling_rate / width
    return int(min(max(2 ** round(math.log2(max(min(1.5 * even, enough), 1.0))), 128), 65536))
