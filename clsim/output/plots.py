"""Pictures: spectrogram, echogram, history of paths, envelope."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import matplotlib
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import BoundaryNorm, LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke

from clsim.files.atomic import atomic_path
from clsim.output.spectrogram import spectrogram

if TYPE_CHECKING:
    import os

    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    from clsim.arrays import Floats
    from clsim.output.spectrogram import Readable
    from clsim.paths.path_table import PathTable

_RANGE_DB = 75.0  # shown below the loudest
_DPI = 130
_REFERENCES = {"Pa": ("20 µPa", 0.0), "V": ("1 V", -93.9794)}  # levels come re 20e-6
_DIRECT = "#c1272d"
_REFLECTED = "#1f77b4"
_OVERLAYS = ("#ffffff", "#4dd0e1", "#a5e887", "#8ab4ff", "#ffe680")  # seen on magma, black below them
# Of many paths the first orders matter most: dark, and the last light but still seen on white.
_ORDERS = LinearSegmentedColormap.from_list("orders", matplotlib.colormaps["viridis"](np.linspace(0.0, 0.88, 64)))


def spectrogram_picture(
    pressure: Readable,
    sampling_rate: float,
    path: str | os.PathLike[str],
    *,
    title: str,
    band: tuple[float, float] | None = None,
    overlay: list[tuple[Floats, Floats, str]] | None = None,
    segment: int | None = None,
    unit: str = "Pa",
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
    unit : {"Pa", "V"}
        Of the samples; levels are re 20 µPa or 1 V.
    """
    low, high = band or (0.0, 0.5 * sampling_rate)
    raster = spectrogram(pressure, sampling_rate, (low, high), segment)
    against, offset = _REFERENCES[unit]
    level = raster.level + np.float32(offset)
    peak = float(level.max())
    figure, axes = _figure(5.0)
    axes.grid(visible=False)
    kilo = 1e3 if high >= 2e3 else 1.0
    milli = 1e3 if raster.duration < 0.5 else 1.0
    shown = axes.imshow(
        level, origin="lower", aspect="auto", cmap="magma", vmin=peak - _RANGE_DB, vmax=peak,
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
        xlabel="time (ms)" if milli > 1.0 else "time (s)", ylabel="frequency (kHz)" if kilo > 1.0 else "frequency (Hz)",
        title=title, xlim=(0.0, raster.duration * milli), ylim=(low / kilo, high / kilo),
    )  # fmt: skip
    figure.colorbar(shown, pad=0.015, aspect=30).set_label(f"level (dB re {against})", fontsize=12)
    _save(figure, path)


def echogram_picture(table: PathTable, receiver: int, index: int, path: str | os.PathLike[str]) -> None:
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
    heard = np.flatnonzero((table.receiver == receiver) & table.heard[:, index])
    level = 20.0 * np.log10(np.abs(table.gain[heard, index]))
    top = float(level.max(initial=-300.0))
    shown = level > top - _RANGE_DB
    rows, level = heard[shown], level[shown]
    figure, axes = _figure(4.5)
    if len(rows):
        floor = float(level.min()) - 4.0
        _stems(figure, axes, table.delay[rows, index] * 1e3, level, table.order[rows], floor)
        direct = table.direct[rows]
        axes.plot(
            table.delay[rows[direct], index] * 1e3, level[direct], "D", color=_DIRECT, markersize=7, zorder=5,
            label="direct path",
        )  # fmt: skip
        axes.set(xlim=(0.0, None), ylim=(floor, top + 4.0))
        if direct.any():
            axes.legend(loc="upper right")
    left_out = len(heard) - len(rows)
    note = f" ({left_out} more than {_RANGE_DB:.0f} dB below the loudest not shown)" if left_out else ""
    axes.set(
        xlabel="delay (ms)", ylabel="gain (dB re 1 m from the source)",
        title=f"{table.receiver_names[receiver]}: {len(heard)} paths at {table.times[index]:.4g} s{note}",
    )  # fmt: skip
    _save(figure, path)


def history_picture(table: PathTable, receiver: int, path: str | os.PathLike[str], *, title: str | None = None) -> None:
    """Draw the delay of every path to a receiver over time: lines begin and end where paths do.

    Parameters
    ----------
    table : PathTable
        The ground truth.
    receiver : int
        Whose paths.
    path : path-like
        Of the PNG.
    title : str, optional
        Above the picture; the receiver's name and its number of paths when left out.
    """
    rows = np.flatnonzero((table.receiver == receiver) & np.isfinite(table.delay).any(axis=1))
    level = 20.0 * np.log10(np.maximum(np.abs(np.nan_to_num(table.gain[rows])), 1e-15))
    top = float(level.max(initial=-300.0))
    rows = rows[(level > top - _RANGE_DB).any(axis=1)]
    figure, axes = _figure(5.5)
    last = int(table.order[rows].max(initial=0))
    norm = BoundaryNorm(np.arange(last + 2) - 0.5, _ORDERS.N)
    for p in rows[np.argsort(-table.order[rows], kind="stable")]:
        direct = bool(table.direct[p])
        axes.plot(
            table.times, table.delay[p] * 1e3, color=_DIRECT if direct else _ORDERS(norm(table.order[p])),
            linewidth=2.4 if direct else 1.2 if table.order[p] < 2 else 0.6, zorder=3 if direct else 2,
        )  # fmt: skip
    if last > 0:
        figure.colorbar(
            ScalarMappable(norm, _ORDERS), ax=axes, ticks=np.arange(0, last + 1), pad=0.015, aspect=30
        ).set_label("order (reflections); the direct path is red", fontsize=12)
    axes.set(
        xlabel="time (s)", ylabel="delay (ms)", xlim=(table.times[0], table.times[-1]),
        title=title or f"{table.receiver_names[receiver]}: {len(rows)} intervals in which a path is heard",
    )  # fmt: skip
    _save(figure, path)


def envelope_picture(
    pressure: NDArray[Any],
    sampling_rate: float,
    path: str | os.PathLike[str],
    *,
    title: str,
    arrivals: list[tuple[float, str, bool]],
    unit: str = "Pa",
    beside: tuple[str, NDArray[Any]] | None = None,
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
    unit : str
        Of the samples.
    beside : (label, ndarray (n,)), optional
        Another signal, whose envelope is filled behind.
    """
    figure, axes = _figure(4.5)
    times = np.arange(len(pressure)) / sampling_rate * 1e3
    axes.plot(times, _magnitude(pressure), color="black", linewidth=1.0, zorder=3)
    if beside is not None:
        axes.fill_between(times, _magnitude(beside[1]), color="#c6c6c6", linewidth=0.0, zorder=1, label=beside[0])
    seen = set()
    for time, label, direct in arrivals:
        axes.axvline(
            time * 1e3, color=_DIRECT if direct else _REFLECTED, linewidth=1.3, zorder=2,
            linestyle="-" if direct else "--", label=label if label not in seen else None,
        )  # fmt: skip
        seen.add(label)
    axes.set(xlabel="time (ms)", ylabel=f"envelope ({unit})", title=title, xlim=(times[0], times[-1]), ylim=(0.0, None))
    if arrivals or beside:
        axes.legend(loc="upper right", framealpha=0.9)
    _save(figure, path)


def _magnitude(samples: NDArray[Any]) -> Floats:
    """Return the Hilbert envelope of samples (n,)."""
    from scipy.fft import next_fast_len
    from scipy.signal import hilbert

    analytic: Any = hilbert(np.asarray(samples, dtype=np.float64), next_fast_len(2 * len(samples)))  # far from its end
    return np.asarray(np.abs(analytic[: len(samples)]))


def _figure(height: float) -> tuple[Figure, Axes]:
    figure = Figure(figsize=(10.0, height), layout="constrained")
    axes = figure.add_subplot()
    axes.title.set_fontsize(13)
    axes.title.set_parse_math(False)  # names may hold what looks like a formula
    axes.xaxis.label.set_fontsize(12)
    axes.yaxis.label.set_fontsize(12)
    axes.grid(alpha=0.25, linewidth=0.6)
    axes.set_axisbelow(True)
    return figure, axes


def _stems(figure: Figure, axes: Axes, delay: Floats, level: Floats, order: NDArray[np.int32], floor: float) -> None:
    """Draw a stem per path, low orders in front, with a key of the orders."""
    draw = np.argsort(-order, kind="stable")
    last = int(order.max())
    norm = BoundaryNorm(np.arange(last + 2) - 0.5, _ORDERS.N)
    delay, level, order = delay[draw], level[draw], order[draw]
    axes.vlines(delay, floor, level, colors=_ORDERS(norm(order)), linewidth=0.7, alpha=0.6)
    dots = axes.scatter(delay, level, c=order, cmap=_ORDERS, norm=norm, s=16, zorder=3)
    if last > 0:
        ticks = np.arange(0, last + 1, max(1, -(-last // 12)))
        figure.colorbar(dots, ticks=ticks, pad=0.015, aspect=30).set_label("order (reflections)", fontsize=12)


def _save(figure: Figure, path: str | os.PathLike[str]) -> None:
    FigureCanvasAgg(figure)
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=_DPI, format="png")
