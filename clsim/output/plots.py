"""Plots of directivities, of absorption and dispersion in air, and of reflection losses of materials."""

from __future__ import annotations

import os
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.acoustics.air import absorption_iso9613
from clsim.arrays import Floats
from clsim.errors import ClsimWarning, InputError
from clsim.scene.air import Air
from clsim.scene.directivity.directivity import AxisymmetricDirectivity, Directivity
from clsim.scene.material.material import Material

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_FLOOR_DB = -40.0
_COLUMNS = 3
_DPI = 90
_ANGLES = np.radians(np.arange(-180.0, 180.01, 0.5))
_BEACON = 40e3  # Hz
_LOW, _HIGH = 100.0, 100e3  # Hz, of reflection losses
_STEEPEST = 89.0  # degrees
_SHOWN = (0.01, 40.0)  # dB of reflection loss
_FINE = 130  # dpi, of thin lines close to each other


@dataclass(frozen=True, slots=True, eq=False)
class DirectivityDiagram:
    """Content of one polar diagram, with frequencies (f,) in Hz."""

    title: str
    directivity: Directivity
    frequencies: Floats
    speed_of_sound: float


def directivity_levels(diagram: DirectivityDiagram, angles: Floats, *, upright: bool = False) -> Floats:
    """Return levels (n, f), -40 to 0 dB re 1 or the largest gain, at angles (n,), rad, to the left or upwards."""
    gain = _gain(diagram, angles, upright)
    level = 20.0 * np.log10(np.maximum(np.abs(gain), 1e-30))
    return np.asarray(np.maximum(level - max(_loudest(diagram), 0.0), _FLOOR_DB))


def directivity_picture(diagrams: list[DirectivityDiagram], path: str | os.PathLike[str]) -> None:
    """Draw polar diagrams, 0 to -40 dB, a curve per frequency; dashed the vertical plane if it differs."""
    import matplotlib as mpl

    from clsim.pictures import plots

    columns = min(len(diagrams), _COLUMNS)
    rows = -(-len(diagrams) // columns)
    figure = plots.empty_figure(4.6 * columns, 5.0 * rows)
    figure.set_layout_engine("constrained", w_pad=0.1, h_pad=0.1)
    for k, diagram in enumerate(diagrams):
        axes: Any = figure.add_subplot(rows, columns, k + 1, projection="polar")
        colours = mpl.colormaps["viridis"](np.linspace(0.0, 0.85, len(diagram.frequencies)))
        level = directivity_levels(diagram, _ANGLES)
        even = isinstance(diagram.directivity, AxisymmetricDirectivity)
        above = None if even else directivity_levels(diagram, _ANGLES, upright=True)
        widths = np.linspace(2.6, 1.2, len(diagram.frequencies))  # so that curves that coincide are seen
        for i, frequency in enumerate(diagram.frequencies):
            axes.plot(_ANGLES, level[:, i], color=colours[i], linewidth=widths[i], label=_in_words(float(frequency)))
            if above is not None:
                axes.plot(_ANGLES, above[:, i], "--", color=colours[i], linewidth=1.1)
        axes.set_theta_zero_location("N")
        axes.set_rlim(_FLOOR_DB, 0.0)
        axes.set_rgrids([-30.0, -20.0, -10.0, 0.0], ["-30", "-20", "-10", "0 dB"], angle=112.0, fontsize=8)
        axes.set_thetagrids(np.arange(0, 360, 30), [f"{a if a <= 180 else a - 360}°" for a in range(0, 360, 30)])
        axes.tick_params(labelsize=8)
        axes.grid(alpha=0.4, linewidth=0.6)
        loudest = _loudest(diagram)
        notes = [f"0 dB is a gain of {loudest:.1f} dB"] if loudest > 0.05 else []
        notes += ["solid: to the left, dashed: upwards"] if above is not None else []
        axes.set_title("\n".join([diagram.title, *notes]), fontsize=11, parse_math=False)
        axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.07), ncols=4, fontsize=8, frameon=False)
    plots.save_figure(figure, path, _DPI)


def _draw_speed(axes: Axes, air: Air, frequencies: Floats, colour: Any) -> None:
    """Draw the dispersion of air: speed of sound minus its value at 0 Hz."""
    dispersing = replace(air, dispersion=True)
    raised = [1e3 * (dispersing.speed_at(f) - air.speed_of_sound) for f in frequencies]
    label = f"{100 * air.state[1]:g} %: {air.speed_of_sound:.3f} m/s"
    axes.semilogx(frequencies / 1e3, raised, color=colour, label=label)
    axes.set(xlabel="frequency (kHz)", ylabel="above the speed at 0 Hz (mm/s)", title="speed of sound by frequency")
    axes.set(xlim=(1.0, 200.0), ylim=(0.0, None))
    axes.legend(title="relative humidity: speed at 0 Hz", fontsize=9, loc="lower right")


def air_picture(airs: list[Air], path: str | os.PathLike[str]) -> None:
    """Draw absorption and speed of sound in air by frequency for some humidities, and absorption by humidity."""
    import matplotlib as mpl

    from clsim.pictures import plots

    for i, air in enumerate(airs):
        if not air.absorption:
            raise InputError(f"airs[{i}].absorption", "must be True to be drawn, but is False")
    figure = plots.empty_figure(15.0, 4.6)
    left, right, speeds = figure.subplots(1, 3)
    temperature, _, pressure = airs[0].state
    figure.suptitle(
        f"Absorption and dispersion of air by ISO 9613-1, {temperature:g} °C, {pressure / 1e3:g} kPa", fontsize=12
    )
    frequencies = np.geomspace(1e3, 200e3, 400)
    colours = mpl.colormaps["viridis"](np.linspace(0.0, 0.85, len(airs)))
    for air, colour in zip(airs, colours, strict=True):
        left.loglog(frequencies / 1e3, air.absorption_at(frequencies), color=colour, label=f"{100 * air.state[1]:g} %")
        _draw_speed(speeds, air, frequencies, colour)
    left.set(xlabel="frequency (kHz)", ylabel="absorption (dB/m)", title="absorption by frequency", xlim=(1.0, 200.0))
    left.legend(title="relative humidity", fontsize=9)
    for axis in (left.xaxis, left.yaxis, speeds.xaxis):
        axis.set_major_formatter("{x:g}")
    humidity = np.linspace(0.0, 1.0, 401)
    shown = (20e3, _BEACON, 80e3)
    for frequency, colour in zip(shown, mpl.colormaps["plasma"](np.linspace(0.0, 0.75, len(shown))), strict=True):
        absorption = np.array([float(absorption_iso9613(frequency, temperature, h, pressure)) for h in humidity])
        width = 2.4 if frequency == _BEACON else 1.3
        right.plot(100 * humidity, absorption, color=colour, label=_in_words(frequency), linewidth=width)
    right.set(
        xlabel="relative humidity (%)", ylabel="absorption (dB/m)", title="absorption by humidity", xlim=(0.0, 100.0)
    )
    right.set_ylim(0.0, None)
    right.legend(fontsize=9)
    for axes in (left, right, speeds):
        axes.grid(which="both", alpha=0.25, linewidth=0.6)
    plots.save_figure(figure, path, _DPI)


def _gain(diagram: DirectivityDiagram, angles: Floats, upright: bool) -> Any:
    """Return the gain (n, f) in a plane through the axis."""
    cosine, sine = np.cos(angles), np.sin(angles)
    if isinstance(diagram.directivity, AxisymmetricDirectivity):
        gain = diagram.directivity.gain(cosine[:, None], diagram.frequencies, diagram.speed_of_sound)
        return np.broadcast_to(gain, (len(angles), len(diagram.frequencies)))
    none = np.zeros_like(angles)
    towards = np.column_stack([cosine, none, sine] if upright else [cosine, sine, none])
    return diagram.directivity.gain_towards(towards[:, None, :], diagram.frequencies, diagram.speed_of_sound)


def _loudest(diagram: DirectivityDiagram) -> float:
    """Return the largest level in either plane, dB."""
    gains = [_gain(diagram, _ANGLES, upright) for upright in (False, True)]
    return 20.0 * float(np.log10(max(float(np.abs(gain).max()) for gain in gains) + 1e-30))


def _in_words(frequency: float) -> str:
    return f"{frequency / 1e3:.4g} kHz" if frequency >= 1e3 else f"{frequency:.4g} Hz"


def reflection_loss(material: Material, frequency: Floats, cosine: Floats) -> Floats:
    """Return ``-20 log10 |R|``, dB, without warnings; NaN where the material is unknown."""
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
    """Draw the reflection loss of materials, by frequency at normal incidence and by angle at one frequency."""
    from matplotlib import colormaps

    from clsim.pictures import plots

    figure = plots.empty_figure(10.0, 4.8 + 0.22 * (len(materials) // 4))
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
        axes.grid(alpha=0.25, linewidth=0.6)
        axes.title.set_fontsize(11)
        losses = [0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0]
        axes.set_yticks(losses, [f"{t:g}" for t in losses])
    ticks = [0.125, 0.5, 2.0, 8.0, 40.0]
    left.set_xticks(ticks, [f"{t:g}" for t in ticks])
    for axes in (left, right):
        axes.minorticks_off()
    figure.legend(loc="outside lower center", ncols=4, fontsize=9, frameon=False)
    plots.save_figure(figure, path, _FINE)
