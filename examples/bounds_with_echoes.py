"""How exactly a beacon can be located in a room by three receivers, with its echoes and without.

Two of three receivers stand in a corner, so that ranges alone say little about the height. A receiver that simulates
the echoes has images of itself behind all walls. The picture shows the bounds of the position by noise over the room.
"""

import argparse
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

import clsim

RATE, NOISE = 192e3, 0.01  # Hz, Pa of a sample
ACROSS, ALONG, HEIGHT = np.linspace(0.5, 5.5, 11), np.linspace(0.5, 3.5, 7), 1.0  # m
RECEIVERS = ((0.2, 0.2, 2.3), (0.6, 0.2, 2.4), (5.7, 3.6, 2.35))
CHIRP = clsim.Signal.chirp(35e3, 45e3, 0.002, sampling_rate=RATE, fade=0.0005)


def bounds_at(place: tuple[float, float, float]) -> clsim.score.EchoBounds:
    """Return the bounds of a beacon's position, m."""
    scene = clsim.Scene(
        clsim.Shoebox((6.0, 4.0, 2.6), clsim.Material.from_reflection(0.7)), clsim.Air(),
        [clsim.Source("beacon", CHIRP, clsim.Trajectory.fixed(place))],
        [clsim.Receiver(f"r{i}", clsim.Trajectory.fixed(p)) for i, p in enumerate(RECEIVERS)],
    )  # fmt: skip
    return clsim.score.echo_bounds(clsim.find_paths(scene, 2), ["sources[0].position"], NOISE, RATE, duration=0.05)


def main() -> None:
    """Draw the bounds over the room."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("out"))
    folder = parser.parse_args().output
    folder.mkdir(parents=True, exist_ok=True)
    found = [[bounds_at((x, y, HEIGHT)) for x in ACROSS] for y in ALONG]
    maps = [
        1e6 * np.array([[np.linalg.norm(getattr(b, name)) for b in row] for row in found])
        for name in ("free_field", "with_echoes")
    ]
    print(f"median bound: {np.median(maps[0]):.1f} µm by the direct sound, {np.median(maps[1]):.1f} µm with echoes")
    figure = Figure(figsize=(11.0, 3.6), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(1, 2)
    scale = LogNorm(min(m.min() for m in maps), max(m.max() for m in maps))
    for axis, values, title in zip(
        axes, maps, ("the direct sound alone", "all echoes up to the second order"), strict=True
    ):
        drawn = axis.pcolormesh(ACROSS, ALONG, values, norm=scale, shading="nearest")
        axis.plot(*np.array(RECEIVERS).T[:2], "k^")
        axis.set(xlabel="x, m", ylabel="y, m", title=title, aspect="equal")
    figure.colorbar(drawn, ax=axes, label="bound of the position, µm")
    figure.savefig(folder / "bounds_with_echoes.png", dpi=110)
    print(folder / "bounds_with_echoes.png")


if __name__ == "__main__":
    main()
