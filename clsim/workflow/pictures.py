"""Plots of a run: paths over time, echogram, spectrogram."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import matplotlib
import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import BoundaryNorm, ListedColormap, to_rgba
from numpy.typing import NDArray

from clsim.arrays import Floats
from clsim.errors import counted, warn
from clsim.output.stores import SoundStore
from clsim.paths.path_table import PathTable
from clsim.pictures.plots import (
    DIRECT,
    RANGE_DB,
    Readable,
    new_figure,
    save_figure,
    spectrogram_picture,
)
from clsim.recording import sweep_window
from clsim.render.plan import Plan
from clsim.workflow.console import progress
from clsim.workflow.pipeline import MOST_DRAWN, PICTURES, PlannedScene, RunOutputs, picture
from clsim.workflow.result_folder import ResultFolder

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_PURE = 0.02  # band of a tone as a share of its frequency
_MOST_CURVES = 6  # of theory that remain distinguishable
_MOST_INSTANTS = 3000  # of lines in a picture, more than it has columns


def draw_pictures(
    planned: PlannedScene, times: Floats, store: SoundStore, results: ResultFolder, outputs: RunOutputs,
    missing: list[str],
) -> None:  # fmt: skip
    """Draw the missing plots at times (T,), s; one that fails becomes a warning."""
    left_out = len(outputs.receivers) - len(outputs.drawn)
    if left_out:
        print(f"pictures are of the first {MOST_DRAWN} receivers of {len(outputs.receivers)}", file=sys.stderr)
    with progress("drawing", len(outputs.drawn)) as advance:
        for r, name in enumerate(outputs.drawn):
            for kind in PICTURES:
                wanted = picture(name, kind)
                if wanted not in missing:
                    continue
                try:
                    sound = store.row(results.folder, int(planned.plan.first_rows[r]))
                    _draw(kind, planned, times, sound, r, results.work / wanted)
                except Exception as error:  # of whatever draws: the sound is there
                    problem = " ".join(str(error).split())[:300] or type(error).__name__
                    warn(f"{wanted} could not be drawn: {problem}")
            advance(1)


def _draw(kind: str, planned: PlannedScene, times: Floats, sound: Readable, r: int, path: Path) -> None:
    plan = planned.plan
    title, rate = plan.tracks.receiver_names[r], plan.sampling_rate
    if kind == "paths":
        drawn = times[np.linspace(0, len(times) - 1, min(len(times), _MOST_INSTANTS)).round().astype(int)]
        history_picture(planned.path_table(drawn, r), r, path)
    elif kind == "echogram":
        echogram_picture(planned.path_table(times[:1], r), r, 0, path)
    elif plan.carrier is None:
        spectrogram_picture(
            sound, rate, path, title=title, band=_shown_band(plan), unit=plan.units[plan.first_rows[r]],
            segment=sweep_window((filters.signal for filters in plan.source_filters), rate),
            overlay=_theory(planned, times, r),
        )  # fmt: skip
    else:
        spectrogram_picture(sound, rate, path, title=title, carrier=plan.carrier)


def _theory(planned: PlannedScene, times: Floats, r: int) -> list[tuple[Floats, Floats, str]]:
    """Return frequencies over time of the direct path and first reflections, for a tone with few active paths."""
    sources = planned.plan.source_filters
    if len(sources) != 1:
        return []
    low, high = sources[0].signal.band()
    centre = sources[0].signal.centre_frequency
    if high - low > _PURE * centre:
        return []
    drawn = np.linspace(0, len(times) - 1, min(len(times), _MOST_INSTANTS)).round().astype(int)
    table = planned.path_table(times[drawn])
    sounds = np.nan_to_num(np.abs(table.gain)).max(axis=1) > 0.0
    mine = np.flatnonzero((table.receiver == r) & (table.order <= 1) & sounds)
    if len(mine) > _MOST_CURVES:
        return []
    shifted = centre * np.where(table.audible, table.doppler_factor, np.nan)
    return [(table.times, shifted[p], table.name_objects(p)) for p in mine]


def _shown_band(plan: Plan) -> tuple[float, float]:
    """Return the band (Hz) that contains nearly all energy, with a margin for Doppler shifts."""
    low: float = np.inf
    high: float = 0.0
    for filters in plan.source_filters:
        frequencies, energy = filters.signal.energy_spectrum()
        share = np.cumsum(energy) / max(float(energy.sum()), 1e-300)
        low = min(low, float(frequencies[np.searchsorted(share, 1e-3)]))
        high = max(high, float(frequencies[np.minimum(np.searchsorted(share, 1.0 - 1e-3), len(frequencies) - 1)]))
    margin = max(0.15 * (high - low), 3.0 * plan.max_rate * high, 200.0)
    return max(0.0, float(low) - margin), min(0.5 * plan.sampling_rate, float(high) + margin)


def _colours(last: int) -> tuple[ListedColormap, BoundaryNorm]:
    """Return the colours of orders 0 to `last`, the direct path's first: of the others dark, and the last light."""
    rest = matplotlib.colormaps["viridis"](np.linspace(0.15, 0.88, max(last, 1)))
    colours = ListedColormap([to_rgba(DIRECT), *map(tuple, rest)][: last + 1])
    return colours, BoundaryNorm(np.arange(last + 2) - 0.5, last + 1)


def echogram_picture(table: PathTable, receiver: int, index: int, path: str | os.PathLike[str]) -> None:
    """Draw the gain of every path to a receiver over its delay, at one of the table's times."""
    audible = np.flatnonzero((table.receiver == receiver) & table.audible[:, index])
    level = 20.0 * np.log10(np.abs(table.gain[audible, index]))
    top = float(level.max(initial=-300.0))
    shown = level > top - RANGE_DB
    rows, level = audible[shown], level[shown]
    figure, axes = new_figure(4.5)
    if len(rows):
        floor = float(level.min()) - 4.0
        _stems(figure, axes, table.delay[rows, index] * 1e3, level, table.order[rows], floor)
        direct = table.direct[rows]
        axes.plot(
            table.delay[rows[direct], index] * 1e3, level[direct], "D", color=DIRECT, markersize=7, zorder=5,
            label="direct path",
        )  # fmt: skip
        axes.set(xlim=(0.0, None), ylim=(floor, top + 4.0))
        if direct.any():
            figure.legend(loc="outside lower right")
    left_out = len(audible) - len(rows)
    note = f" ({left_out} more than {RANGE_DB:.0f} dB below the loudest not shown)" if left_out else ""
    axes.set(
        xlabel="delay (ms)", ylabel="gain (dB re 1 m from the source)",
        title=f"{table.receiver_names[receiver]}: {counted(len(audible), 'path')} at {table.times[index]:.4g} s{note}",
    )  # fmt: skip
    save_figure(figure, path)


def history_picture(table: PathTable, receiver: int, path: str | os.PathLike[str]) -> None:
    """Draw the delay of every path to a receiver over time: lines begin and end where paths do."""
    rows = np.flatnonzero((table.receiver == receiver) & np.isfinite(table.delay).any(axis=1))
    level = 20.0 * np.log10(np.maximum(np.abs(np.nan_to_num(table.gain[rows])), 1e-15))
    top = float(level.max(initial=-300.0))
    rows = rows[(level > top - RANGE_DB).any(axis=1)]
    figure, axes = new_figure(5.5)
    last = int(table.order[rows].max(initial=0))
    colours, norm = _colours(last)
    for p in rows[np.argsort(-table.order[rows], kind="stable")]:
        direct = bool(table.direct[p])
        axes.plot(
            table.times, table.delay[p] * 1e3, color=colours(norm(table.order[p])),
            linewidth=2.4 if direct else 1.2 if table.order[p] < 2 else 0.6, zorder=3 if direct else 2,
        )  # fmt: skip
    if last > 0:
        figure.colorbar(
            ScalarMappable(norm, colours), ax=axes, ticks=np.arange(0, last + 1), pad=0.015, aspect=30
        ).set_label("order (reflections)", fontsize=12)
    axes.set(
        xlabel="time (s)", ylabel="delay (ms)", xlim=(table.times[0], table.times[-1]),
        title=f"{table.receiver_names[receiver]}: {len(rows)} intervals in which a path is heard",
    )  # fmt: skip
    save_figure(figure, path)


def _stems(figure: Figure, axes: Axes, delay: Floats, level: Floats, order: NDArray[np.int32], floor: float) -> None:
    """Draw a stem per path, low orders in front, with a key of the orders."""
    draw = np.argsort(-order, kind="stable")
    last = int(order.max())
    colours, norm = _colours(last)
    delay, level, order = delay[draw], level[draw], order[draw]
    axes.vlines(delay, floor, level, colors=colours(norm(order)), linewidth=0.7, alpha=0.6)
    dots = axes.scatter(delay, level, c=order, cmap=colours, norm=norm, s=16, zorder=3)
    if last > 0:
        ticks = np.arange(0, last + 1, max(1, -(-last // 12)))
        figure.colorbar(dots, ticks=ticks, pad=0.015, aspect=30).set_label("order (reflections)", fontsize=12)
