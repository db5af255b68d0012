"""Picture of a measured and a simulated impulse response: decay curves, and early reflections."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from clsim.arrays import Floats

_CLSIM, _MEASURED = "#c1272d", "#111111"
_RANGE_DB = 60.0


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
