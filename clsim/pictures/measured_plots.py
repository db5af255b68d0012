"""Pictures of measured rooms: parameters by band, and mean differences of programs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from clsim.arrays import Floats

_COLUMNS = 3
_CLSIM, _MEASURED, _OTHERS = "#c1272d", "#111111", "#9bb7cc"


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
