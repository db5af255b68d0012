"""Ranging with one speed of sound: what a heated room, a draught and the frequency make of distances to a ceiling grid.

A tag at table height is ranged by receivers all over the ceiling, with the speed of sound of the temperature at the tag
and at zero frequency. The picture shows by how much the distances are wrong.
"""

import argparse
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

import clsim

SIZE = (8.0, 6.0, 3.2)
TAG = (2.0, 1.5, 0.8)
ACROSS, ALONG = np.linspace(0.2, 7.8, 39), np.linspace(0.2, 5.8, 29)  # m, of the grid
FLOOR, CEILING = 19.0, 25.0  # °C
DRAUGHT = (0.3, 0.0, 0.0)  # m/s


def main() -> None:
    """Range the tag in three airs and draw the errors."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("out"))
    folder = parser.parse_args().output
    folder.mkdir(parents=True, exist_ok=True)
    at_tag = FLOOR + (CEILING - FLOOR) * TAG[2] / SIZE[2]
    believed = clsim.Air(at_tag)
    heated = clsim.Air((FLOOR, CEILING), dispersion=False)
    draught = clsim.Air(at_tag, dispersion=False, wind=DRAUGHT)
    figure = Figure(figsize=(15.0, 4.4), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(1, 3)
    draw_grid(axes[0], bias(heated, believed), f"heated: {FLOOR:g} °C at the floor, {CEILING:g} °C at the ceiling")
    draw_grid(axes[1], bias(draught, believed), f"a draught of {DRAUGHT[0]:g} m/s along x")
    draw_frequencies(axes[2], believed)
    figure.suptitle(f"too long or too short, mm, with the speed of {at_tag:g} °C at zero frequency")
    figure.savefig(folder / "ranging_bias.png", dpi=110)
    print(folder / "ranging_bias.png")


def bias(air: clsim.Air, believed: clsim.Air) -> np.ndarray:
    """Return the error of the range over the grid (rows, columns), mm."""
    grid = np.stack(np.meshgrid(ACROSS, ALONG), axis=-1).reshape(-1, 2)
    places = [(x, y, SIZE[2] - 0.02) for x, y in grid]
    ears = [clsim.Receiver(f"r{i}", clsim.Trajectory.fixed(place)) for i, place in enumerate(places)]
    tag = clsim.Source("tag", clsim.Signal.tone(40e3, 0.01, 192e3), clsim.Trajectory.fixed(TAG))
    room = clsim.Shoebox(SIZE, clsim.Material.from_reflection(0.9))
    truth = clsim.direct_path(clsim.find_paths(clsim.Scene(room, air, [tag], ears), 0), emitted=[0.0])
    distance = np.linalg.norm(np.subtract(places, TAG), axis=1)
    wrong = believed.speed_of_sound * truth.delay[0, :, 0] - distance
    return np.asarray(1e3 * wrong.reshape(len(ALONG), len(ACROSS)))


def draw_grid(axes: Axes, wrong: np.ndarray, title: str) -> None:
    """Draw errors over the ceiling."""
    largest = np.abs(wrong).max()
    drawn = axes.pcolormesh(ACROSS, ALONG, wrong, cmap="RdBu_r", vmin=-largest, vmax=largest)
    lines = axes.contour(ACROSS, ALONG, wrong, colors="black", linewidths=0.6)
    axes.clabel(lines, fontsize=8)
    axes.plot(*TAG[:2], "k^", markersize=8)
    axes.set(aspect="equal", xlabel="x (m)", ylabel="y (m)", title=title)
    axes.figure.colorbar(drawn, ax=axes, label="mm", shrink=0.8)


def draw_frequencies(axes: Axes, air: clsim.Air) -> None:
    """Draw the errors of phase and of envelopes over the frequency, over 8 m."""
    frequencies, distance = np.geomspace(1e3, 200e3, 200), 8.0
    for speed_at, label in ((air.speed_at, "phase"), (air.group_speed_at, "envelope")):
        speeds = np.array([speed_at(float(f)) for f in frequencies])
        axes.semilogx(frequencies / 1e3, 1e3 * distance * (air.speed_of_sound / speeds - 1.0), label=label)
    axes.set(xlabel="frequency (kHz)", ylabel="mm", title=f"dispersion over {distance:g} m")
    axes.axvline(40.0, color="0.5", linewidth=0.8)
    axes.grid(alpha=0.3)
    axes.legend()


if __name__ == "__main__":
    main()
