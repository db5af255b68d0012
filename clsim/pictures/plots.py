"""Plots of sound: waveform, and spectrogram of pressure or of a complex envelope."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
from numpy.typing import NDArray

from clsim.arrays import Floats
from clsim.files.atomic import atomic_path

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_RASTER_COLUMNS = 1200
_RASTER_ROWS = 600
_OVERLAP = 16  # columns that share a sample, where time is spread out
_PADDING = 4  # of a window with zeros, where frequency is spread out
_BUDGET = 2**26  # samples transformed; of longer sound, a part of the windows is taken
_SHORTEST = 8  # of a window at an end of the sound, as a part of the others
_FLOOR = 1e-18  # mean square below which there is silence, Pa²
RANGE_DB = 75.0  # shown below the loudest
_PIECES = 4000  # of a waveform that are drawn
_REFERENCES = {"Pa": ("20 µPa", 0.0), "V": ("1 V", -93.9794)}  # levels come re 20e-6
DIRECT = "#c1272d"
_REFLECTED = "#1f77b4"
_OVERLAYS = ("#ffffff", "#4dd0e1", "#a5e887", "#8ab4ff", "#ffe680")  # seen on magma, black below them
_TURNING = 0.1  # s of an envelope in a window
_REFERENCE = 20e-6  # Pa, of the envelope's rms


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
    """Return the level of pressure (n,), Pa, over time and frequency in a band (low, high), Hz, dB re 20 µPa rms."""
    # Frequencies of a complex envelope are offsets from the carrier.
    # A pixel is the mean over the windows inside it and the largest of the frequencies inside it, so that neither
    # moves a line's level.
    count = len(pressure)
    width = max(band[1] - band[0], 1e-3)
    if segment is None:  # as many resolved steps over time as over frequency, or a row each
        even = math.sqrt(max(count, 1) * sampling_rate / width)
        enough = 2.0 * _RASTER_ROWS * sampling_rate / width
        segment = int(min(max(2 ** round(math.log2(max(min(1.5 * even, enough), 1.0))), 128), 65536))
    padded = segment
    while padded < _PADDING * segment and width / sampling_rate * padded < _RASTER_ROWS:
        padded *= 2
    step = sampling_rate / padded
    zero = padded // 2 if np.iscomplexobj(pressure[0:1]) else 0  # bin of frequency 0
    first = max(0, math.floor(band[0] / step) + zero)
    bins = slice(first, max(first, min(padded // 2 + max(zero - 1, 0), math.ceil(band[1] / step) + zero)) + 1)
    pool = math.ceil((bins.stop - bins.start) / _RASTER_ROWS)
    columns = max(1, min(_RASTER_COLUMNS, math.ceil(_OVERLAP * count / segment)))
    rows = -(-(bins.stop - bins.start) // pool)
    level = np.empty((rows, columns), dtype=np.float32)
    for column in range(columns):
        span = (column * count / columns, (column + 1) * count / columns)
        power = _power(pressure, segment, span, padded)
        peaks = np.maximum.reduceat(power[bins], np.arange(0, bins.stop - bins.start, pool))
        level[:, column] = 10.0 * np.log10(np.maximum(peaks, _FLOOR) / _REFERENCE**2)
    low = (bins.start - zero - 0.5) * step
    return Spectrogram(level, low, low + rows * pool * step, count / sampling_rate)


def _power(pressure: Readable, segment: int, span: tuple[float, float], padded: int) -> NDArray[np.float64]:
    """Return the mean power spectrum, Pa² of a sine in each bin, of the windows centred in a span of samples."""
    from scipy.fft import fft, fftshift, rfft

    count, two_sided = len(pressure), np.iscomplexobj(pressure[0:1])
    most = max(1, _BUDGET // (_RASTER_COLUMNS * padded))
    number = min(most, max(1, round(2.0 * (span[1] - span[0]) / segment)))
    total = np.zeros(padded if two_sided else padded // 2 + 1)
    for k in range(number):
        centre = span[0] + (k + 0.5) * (span[1] - span[0]) / number
        # Near the ends windows are shorter: they stay about their centre, and inside the sound.
        length = min(segment, max(int(2.0 * min(centre, count - centre)), segment // _SHORTEST, 1))
        start = min(max(0, round(centre - 0.5 * length)), max(0, count - length))
        window = _window(length)
        part: Any = np.asarray(pressure[start : start + length], dtype=np.complex64 if two_sided else np.float32)
        windowed = part * window[: len(part)]
        spectrum: Any = fftshift(fft(windowed, padded)) if two_sided else rfft(windowed, padded)
        share = (0.5 if two_sided else 2.0) / float(window.sum()) ** 2
        total += (np.square(spectrum.real) + np.square(spectrum.imag)) * share
    return total / number


@lru_cache(maxsize=4)
def _window(length: int) -> NDArray[np.float32]:
    """Return a Hann window without its zeros."""
    return np.asarray(np.sin(np.pi * (np.arange(length) + 0.5) / length) ** 2, dtype=np.float32)


def spectrogram_picture(pressure: Readable, sampling_rate: float, path: str | os.PathLike[str], **options: Any) -> None:
    """Draw level over time and frequency into a file; the options are those of `draw_spectrogram`."""
    figure, axes = new_figure(5.0)
    draw_spectrogram(figure, axes, pressure, sampling_rate, **options)
    save_figure(figure, path)


def draw_spectrogram(
    figure: Figure, axes: Axes, pressure: Readable, sampling_rate: float, *, title: str,
    band: tuple[float, float] | None = None, overlay: list[tuple[Floats, Floats, str]] | None = None,
    segment: int | None = None, unit: str = "Pa", carrier: float | None = None,
) -> None:  # fmt: skip
    """Draw the level of pressure (n,), Pa, into axes, over it lines of times, s, and frequencies, Hz, with labels."""
    # carrier: of a complex envelope, Hz; the band is then about it.
    if carrier is not None:
        segment = min(segment or max(16, round(_TURNING * sampling_rate)), max(16, len(pressure)))
    low, high = band or (0.0 if carrier is None else -0.5 * sampling_rate, 0.5 * sampling_rate)
    raster = spectrogram(pressure, sampling_rate, (low, high), segment)
    against, offset = _REFERENCES[unit]
    level = raster.level + np.float32(offset)
    peak = float(level.max())
    axes.grid(visible=False)
    axes.title.set_parse_math(False)  # names may hold what looks like a formula
    kilo = 1e3 if high >= 2e3 and carrier is None else 1.0
    shown_frequency = "frequency" if carrier is None else f"frequency - {carrier / 1e3:g} kHz"
    milli = 1e3 if raster.duration < 0.5 else 1.0
    shown = axes.imshow(
        level, origin="lower", aspect="auto", cmap="magma", vmin=peak - RANGE_DB, vmax=peak,
        extent=(0.0, raster.duration * milli, raster.low / kilo, raster.high / kilo),
    )  # fmt: skip
    for k, (times, frequencies, label) in enumerate(overlay or []):
        axes.plot(
            np.asarray(times) * milli, np.asarray(frequencies) / kilo, "--", linewidth=1.4, label=label,
            color=_OVERLAYS[k % len(_OVERLAYS)], path_effects=[withStroke(linewidth=3.0, foreground="black")],
        )  # fmt: skip
    if overlay:
        figure.legend(loc="outside lower center", ncols=8, framealpha=1.0, facecolor="#222222", labelcolor="white")
    axes.set(
        xlabel="time (ms)" if milli > 1.0 else "time (s)", ylabel=f"{shown_frequency} ({'k' * (kilo > 1.0)}Hz)",
        title=title, xlim=(0.0, raster.duration * milli), ylim=(low / kilo, high / kilo),
    )  # fmt: skip
    figure.colorbar(shown, ax=axes, pad=0.015, aspect=30).set_label(f"level (dB re {against})", fontsize=12)


def draw_waveform(axes: Axes, samples: Readable, sampling_rate: float, *, title: str, unit: str) -> None:
    """Draw samples (n,) over time into axes: of many, least and largest of each of some thousand pieces."""
    count = len(samples)
    step = max(1, -(-count // _PIECES))
    if step == 1:
        times, ends = np.arange(count) / sampling_rate, np.asarray(samples[0:count])
    else:
        parts = [samples[i : min(i + step, count)] for i in range(0, count, step)]
        times = np.repeat(np.arange(len(parts)) * step / sampling_rate, 2)
        ends = np.array([end for part in parts for end in (part.min(), part.max())])
    milli = count / sampling_rate < 0.5
    axes.plot(times * (1e3 if milli else 1.0), ends, linewidth=0.6, color=_REFLECTED)
    axes.set(xlabel="time (ms)" if milli else "time (s)", ylabel=unit, title=title)
    axes.title.set_parse_math(False)
    axes.margins(x=0.0)


def empty_figure(width: float, height: float) -> Figure:
    """Return a figure of a size, inches, without axes."""
    return Figure(figsize=(width, height), layout="constrained")


def new_figure(height: float) -> tuple[Figure, Axes]:
    """Return a figure of its own, 10 inches wide, and its axes."""
    figure = empty_figure(10.0, height)
    axes = figure.add_subplot()
    axes.title.set_fontsize(13)
    axes.title.set_parse_math(False)  # names may hold what looks like a formula
    axes.xaxis.label.set_fontsize(12)
    axes.yaxis.label.set_fontsize(12)
    axes.grid(alpha=0.25, linewidth=0.6)
    axes.set_axisbelow(True)
    return figure, axes


def save_figure(figure: Figure, path: str | os.PathLike[str], dpi: int = 130) -> None:
    """Write a figure as PNG, whole or not at all."""
    figure.set_dpi(dpi)
    canvas: Any = FigureCanvasAgg(figure)
    with atomic_path(path) as temporary:
        canvas.print_png(temporary)  # `savefig` would draw all of it twice, first without colours to lay it out
