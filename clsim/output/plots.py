"""Pictures: spectrogram, echogram, envelope."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Protocol

import matplotlib
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from clsim.output.atomic import atomic_path

if TYPE_CHECKING:
    import os

    from numpy.typing import NDArray

    from clsim.arrays import Floats
    from clsim.paths.path_table import PathTable

_COLUMNS = 1200  # of a spectrogram's raster
_RANGE_DB = 75.0
_DPI = 110
_DIRECT = "#d62728"
_REFLECTED = "#1f77b4"


class Readable(Protocol):
    """Samples that can be cut: an array, or a sound file behind one."""

    def __len__(self) -> int: ...

    def __getitem__(self, part: slice) -> NDArray[Any]: ...


def spectrogram(
    pressure: Readable,
    sampling_rate: float,
    path: str | os.PathLike[str],
    *,
    title: str,
    band: tuple[float, float] | None = None,
    overlay: list[tuple[Floats, Floats, str]] | None = None,
    segment: int | None = None,
) -> None:
    """Draw level over time and frequency.

    Parameters
    ----------
    pressure : array (n,)
        Anything that can be cut, Pa; it is read piece by piece.
    sampling_rate : float
        Hz.
    path : path-like
        Of the PNG.
    title : str
        Above the picture.
    band : (low, high), optional
        Frequencies shown, Hz; all when left out.
    overlay : list of (times, frequencies, label), optional
        Curves drawn over it, s and Hz.
    segment : int, optional
        Samples of a window; chosen from the band when left out.
    """
    low, high = band or (0.0, 0.5 * sampling_rate)
    if segment is None:
        segment = _segment(len(pressure), sampling_rate, high - low)
    level, first, step = _levels(pressure, segment, sampling_rate, low, high)
    peak = float(level.max()) if level.size else 0.0
    figure = Figure(figsize=(10, 5), layout="constrained")
    axes = figure.add_subplot()
    edges = (0.0, len(pressure) / sampling_rate, first / 1e3, (first + step * level.shape[0]) / 1e3)
    shown = axes.imshow(
        level, origin="lower", aspect="auto", extent=edges, cmap="magma", vmin=peak - _RANGE_DB, vmax=peak,
        interpolation="nearest",
    )  # fmt: skip
    for times, frequencies, label in overlay or []:
        axes.plot(times, np.asarray(frequencies) / 1e3, "--", color="white", linewidth=0.9, alpha=0.8, label=label)
    if overlay:
        axes.legend(loc="upper right", framealpha=0.4, facecolor="black", labelcolor="white")
    axes.set(xlabel="time (s)", ylabel="frequency (kHz)", title=title, xlim=edges[:2], ylim=(low / 1e3, high / 1e3))
    figure.colorbar(shown, label="level (dB re 20 µPa in a window)")
    _save(figure, path)


def echogram(table: PathTable, receiver: int, index: int, path: str | os.PathLike[str]) -> None:
    """Draw the gain of every path to a receiver over its delay, at one of the table's times.

    Parameters
    ----------
    table : PathTable
        The paths.
    receiver, index : int
        Which receiver, and which of the table's times.
    path : path-like
        Of the PNG.
    """
    rows = np.flatnonzero((table.receiver == receiver) & np.isfinite(table.delay[:, index]))
    figure = Figure(figsize=(10, 4.5), layout="constrained")
    axes = figure.add_subplot()
    gain = np.abs(table.gain[rows, index])
    if len(rows) and gain.max() > 0.0:
        level = 20 * np.log10(np.maximum(gain, 1e-12))
        floor = max(level.max() - 100.0, level.min()) - 5.0
        delay = table.delay[rows, index] * 1e3
        order = table.order[rows]
        colours = matplotlib.colormaps["viridis"](order / max(1, order.max()))
        axes.vlines(delay, floor, np.maximum(level, floor), colors=colours, linewidth=1.0)
        dots = axes.scatter(delay, np.maximum(level, floor), c=order, cmap="viridis", s=14, zorder=3)
        axes.set_ylim(floor, level.max() + 5.0)
        if order.max() > 0:
            figure.colorbar(dots, label="order (number of reflections)")
    axes.set(
        xlabel="delay (ms)", ylabel="gain (dB re 1 m from the source)",
        title=f"{table.receiver_names[receiver]}: {len(rows)} paths at {table.times[index]:.4g} s",
    )  # fmt: skip
    axes.grid(alpha=0.3)
    _save(figure, path)


def envelope(
    pressure: NDArray[Any],
    sampling_rate: float,
    path: str | os.PathLike[str],
    *,
    title: str,
    arrivals: list[tuple[float, str, bool]],
) -> None:
    """Draw the Hilbert envelope over time, with the predicted arrivals.

    Parameters
    ----------
    pressure : ndarray (n,)
        Pa.
    sampling_rate : float
        Hz.
    path : path-like
        Of the PNG.
    title : str
        Above the picture.
    arrivals : list of (time, label, direct)
        Predicted times, s.
    """
    from scipy.signal import hilbert

    figure = Figure(figsize=(10, 4.5), layout="constrained")
    axes = figure.add_subplot()
    times = np.arange(len(pressure)) / sampling_rate * 1e3
    axes.plot(times, np.abs(hilbert(np.asarray(pressure, dtype=np.float64))), color="black", linewidth=0.9)
    seen = set()
    for time, label, direct in arrivals:
        axes.axvline(
            time * 1e3, color=_DIRECT if direct else _REFLECTED, linewidth=1.0, alpha=0.8,
            linestyle="-" if direct else "--", label=label if label not in seen else None,
        )  # fmt: skip
        seen.add(label)
    axes.set(xlabel="time (ms)", ylabel="envelope (Pa)", title=title, xlim=(times[0], times[-1]), ylim=(0.0, None))
    axes.grid(alpha=0.3)
    if arrivals:
        axes.legend(loc="upper right")
    _save(figure, path)


def _segment(count: int, sampling_rate: float, width: float) -> int:
    """Return a window's length: about as many bins across the band as columns over time, a power of two."""
    fine = 2.0 * math.sqrt(max(count, 1) * sampling_rate / max(width, 1.0))
    return int(min(max(2 ** round(math.log2(max(fine, 64.0))), 128), 65536))


def _levels(
    pressure: Readable, segment: int, sampling_rate: float, low: float, high: float
) -> tuple[Floats, float, float]:
    """Return levels (bins, columns) in dB, the lower edge of the first bin and the bins' width in Hz."""
    count = len(pressure)
    columns = int(min(_COLUMNS, max(1, math.ceil(4 * count / segment))))
    window = np.hanning(segment)
    scale = math.sqrt(2.0) / window.sum() / 20e-6
    step = sampling_rate / segment
    bins = slice(max(0, int(low / step)), min(segment // 2, math.ceil(high / step)) + 1)
    centres = (np.arange(columns) + 0.5) * count / columns
    level = np.empty((bins.stop - bins.start, columns))
    for i, centre in enumerate(centres):
        first = round(centre) - segment // 2
        part = np.zeros(segment)
        a, b = max(0, first), min(count, first + segment)
        part[a - first : b - first] = pressure[a:b]
        spectrum = np.abs(np.fft.rfft(part * window)[bins]) * scale
        level[:, i] = 20 * np.log10(np.maximum(spectrum, 1e-9))
    return level, (bins.start - 0.5) * step, step


def _save(figure: Figure, path: str | os.PathLike[str]) -> None:
    FigureCanvasAgg(figure)
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=_DPI, format="png")
