"""A picture of what materials send back."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING

import numpy as np

from clsim.errors import ClsimWarning
from clsim.files.atomic import atomic_path

if TYPE_CHECKING:
    import os
    from collections.abc import Sequence

    from matplotlib.axes import Axes

    from clsim.arrays import Floats
    from clsim.scene.material.material import Material

_LOW, _HIGH = 100.0, 100e3  # Hz
_STEEPEST = 89.0  # degrees
_SHOWN = (0.01, 40.0)  # dB of reflection loss
_DPI = 130


def reflection_loss(material: Material, frequency: Floats, cosine: Floats) -> Floats:
    """Return ``-20 log10 |R|``, dB; NaN where the material is not known, and no warning where it is held.

    frequency, cosine: hz, and cosine of the angle of incidence; one of them may be a single number.
    """
    f, cosine = np.broadcast_arrays(frequency, cosine)
    loss = np.full(f.shape, np.nan)
    low, high = material.band
    known = (f >= low) & (f <= high) if not material.model.beyond else np.ones(f.shape, dtype=bool)
    with warnings.catch_warnings(), np.errstate(divide="ignore"):
        warnings.simplefilter("ignore", ClsimWarning)
        if known.any():
            loss[known] = -20.0 * np.log10(np.abs(material.reflection_at(f[known], cosine[known])))
    return loss


def reflection_losses(materials: Sequence[Material], path: str | os.PathLike[str], *, frequency: float = 40e3) -> None:
    """Draw the reflection loss of materials, by frequency at normal incidence and by angle at one frequency.

    materials: each a line, called by its name; dashed where a table is held beyond its end, left out where it is not
    known.
    """
    from matplotlib import colormaps
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.0, 4.8 + 0.22 * (len(materials) // 4)), layout="constrained")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2, sharey=True)
    colours = colormaps["tab10" if len(materials) <= 10 else "tab20"]
    frequencies = np.geomspace(_LOW, _HIGH, 2001)
    degrees = np.linspace(0.0, _STEEPEST, 891)
    cosines = np.cos(np.radians(degrees))
    for i, material in enumerate(materials):
        again, at = divmod(i, colours.N)
        colour, label = colours(at), material.name or material.describe()
        wide = 1.8 if again == 0 else 0.8  # of materials that share a colour, the later ones are thinner
        loss = np.maximum(reflection_loss(material, frequencies, np.ones(1)), _SHOWN[0])
        low, high = material.band
        held = (frequencies < low) | (frequencies > high)
        left.plot(frequencies / 1e3, np.where(held, np.nan, loss), color=colour, linewidth=wide, label=label)
        left.plot(frequencies / 1e3, np.where(held, loss, np.nan), "--", color=colour, linewidth=0.7 * wide)
        style = "-" if low <= frequency <= high else "--"
        by_angle = np.maximum(reflection_loss(material, np.array([frequency]), cosines), _SHOWN[0])
        right.plot(degrees, by_angle, style, color=colour, linewidth=wide if style == "-" else 0.7 * wide)
    left.set(xscale="log", yscale="log")
    left.set(xlim=(_LOW / 1e3, _HIGH / 1e3), xlabel="frequency (kHz)", ylabel="reflection loss (dB)")
    left.set_title("normal incidence; dashed: held beyond a table's end")
    left.set_ylim(_SHOWN[1], _SHOWN[0])  # loud is high
    right.set(xlim=(0.0, 90.0), xlabel="angle of incidence (degrees)", title=f"{frequency / 1e3:g} kHz")
    for axes in (left, right):
        _dress(axes)
    figure.legend(loc="outside lower center", ncols=4, fontsize=9, frameon=False)
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=_DPI, format="png")


def _dress(axes: Axes) -> None:
    axes.grid(alpha=0.25, linewidth=0.6)
    axes.title.set_fontsize(11)
    losses = [0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0]
    axes.set_yticks(losses, [f"{t:g}" for t in losses])
    if axes.get_xscale() == "log":
        frequencies = [0.125, 0.5, 2.0, 8.0, 40.0]
        axes.set_xticks(frequencies, [f"{t:g}" for t in frequencies])
    axes.minorticks_off()
