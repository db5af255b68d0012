"""Pictures of measurements beside simulations: decays and early reflections, parameters, differences of programs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from clsim.arrays import Floats

_COLUMNS = 3
_CLSIM, _MEASURED, _OTHERS = "#c1272d", "#111111", "#9bb7cc"
_RANGE_DB = 60.0


@dataclass(frozen=True, slots=True, eq=False)
class ParameterPanel:
    """A parameter by band: means over pairs."""

    title: str
    unit: str
    measured: Floats  # (bands,)
    deviation: Floats | None  # (bands,) standard deviation of measurements
    clsim: Floats  # (bands,)
    others: Floats  # (programs, bands)


def parameters_picture(frequencies: Floats, panels: Sequence[ParameterPanel], path: Path, title: str) -> None:
    """Draw measured parameters by band, clsim's, and those of other programs behind them."""
    from matplotlib.figure import Figure

    from clsim.pictures.plots import save_figure

    rows = -(-len(panels) // _COLUMNS)
    figure = Figure(figsize=(10.0, 0.6 + 2.5 * rows), layout="constrained")
    figure.suptitle(title, fontsize=13)
    every: Any = figure.subplots(rows, _COLUMNS, squeeze=False).ravel()
    for axes, panel in zip(every, panels, strict=False):
        for i, other in enumerate(panel.others):
            axes.semilogx(
                frequencies, other, color=_OTHERS, lw=0.8, label=None if i else f"{len(panel.others)} other programs"
            )
        axes.errorbar(
            frequencies, panel.measured, panel.deviation, color=_MEASURED, marker="o", ms=4, lw=1.2, capsize=3,
            label="measured" if panel.deviation is None else "measured, with standard deviation",
        )  # fmt: skip
        axes.semilogx(frequencies, panel.clsim, color=_CLSIM, marker="s", ms=4, lw=1.8, label="clsim")
        axes.set_title(panel.title, fontsize=11)
        axes.set_ylabel(panel.unit)
        ticks = frequencies[:: max(1, len(frequencies) // 6)]
        axes.set_xticks(ticks, [f"{f:g}" if f < 1000 else f"{f / 1000:.3g}k" for f in ticks.round()])
        axes.minorticks_off()
        axes.grid(alpha=0.25, linewidth=0.6)
    for axes in every[len(panels) :]:
        axes.axis("off")
    for axes in every[max(0, len(panels) - _COLUMNS) : len(panels)]:
        axes.set_xlabel("Hz")
    figure.legend(*every[0].get_legend_handles_labels(), loc="outside lower center", ncols=3, fontsize=10)
    save_figure(figure, path)


def ranks_picture(panels: Sequence[tuple[str, float, Floats]], path: Path, title: str) -> None:
    """Draw clsim's mean difference among those of other programs, a panel each: title, clsim's, others' (n,)."""
    from matplotlib.figure import Figure

    from clsim.pictures.plots import save_figure

    figure = Figure(figsize=(10.0, 4.2), layout="constrained")
    figure.suptitle(title, fontsize=13)
    every: Any = figure.subplots(1, len(panels), squeeze=False).ravel()
    for axes, (name, own, others) in zip(every, panels, strict=True):
        heights = np.append(others, own)
        order = np.argsort(heights, kind="stable")
        colours = [_CLSIM if i == len(others) else _OTHERS for i in order]
        axes.bar(np.arange(len(order)) + 1, heights[order], color=colours)
        place = int(np.flatnonzero(order == len(others))[0])
        axes.annotate("clsim", (place + 1, own), ha="center", va="bottom", color=_CLSIM, fontsize=11)
        for share, word in ((0.25, "quartile of the others"), (0.5, "their median")):
            level = float(np.quantile(others, share))
            axes.axhline(level, color="#555555", lw=0.8, ls="--" if share == 0.5 else ":", label=f"{word}, {level:.2f}")
        axes.set_title(name, fontsize=10)
        axes.set_xlabel("rank")
        axes.set_ylim(0.0, 1.25 * heights.max())
        axes.legend(loc="upper left", fontsize=8)
    every[0].set_ylabel("mean difference (JND)")
    save_figure(figure, path)


def comparison_picture(
    decays: Sequence[tuple[str, Floats, Floats]], times: Sequence[Floats], early: Sequence[Floats], paths: Floats,
    path: Path, title: str,
) -> None:  # fmt: skip
    """Draw decay curves by band and early levels over time.

    Shapes: decays (title, measured (n,) dB, simulated (m,) dB) at times (n,), (m,) s of measured and simulated; early:
    measured (k,), simulated (k,) dB at times (k,) s, the last of them; paths (p,) s.
    """
    from matplotlib.figure import Figure

    from clsim.pictures.plots import save_figure

    columns = 4
    rows = -(-len(decays) // columns)
    figure = Figure(figsize=(11.0, 3.2 + 2.4 * rows), layout="constrained")
    figure.suptitle(title, fontsize=13, parse_math=False)
    grid = figure.add_gridspec(rows + 1, columns)
    for i, (name, *levels) in enumerate(decays):
        axes: Any = figure.add_subplot(grid[i // columns, i % columns])
        for level, time, colour, word in zip(
            levels, times, (_MEASURED, _CLSIM), ("measured", "simulated"), strict=False
        ):  # fmt: skip
            axes.plot(time[: len(level)], level, color=colour, lw=1.4, label=word)
        axes.set(title=name, ylim=(-_RANGE_DB, 2.0), xlabel="s", ylabel="dB" if i % columns == 0 else "")
        axes.grid(alpha=0.25, linewidth=0.6)
        if i == 0:
            axes.legend(fontsize=9)
    axes = figure.add_subplot(grid[rows, :])
    for level, colour, word in zip(early, (_MEASURED, _CLSIM), ("measured", "simulated"), strict=True):
        axes.plot(1e3 * times[-1], level, color=colour, lw=1.0, label=word, alpha=0.85)
    for delay in paths:
        axes.axvline(1e3 * delay, color="#1f77b4", lw=0.6, alpha=0.6, zorder=0)
    axes.plot([], [], color="#1f77b4", lw=0.8, label="delays of paths")
    axes.set(title="Early reflections", ylim=(-45.0, 3.0), xlabel="ms", ylabel="dB re largest")
    axes.set_xlim(float(1e3 * times[-1][0]), float(1e3 * times[-1][-1]))
    axes.legend(fontsize=9, ncols=3, loc="upper right")
    axes.grid(alpha=0.25, linewidth=0.6)
    save_figure(figure, path)
