"""The absorption of a floor and a ceiling from three recordings with noise, by Gauss-Newton on the waveforms.

The reflection factors of both enter the sound of every echo that meets them. Starting from hard walls, a few steps with
the derivatives of `clsim.sensitivities` find them; the same derivatives bound how exactly that is possible.
"""

import argparse
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

import clsim

RATE, NOISE, STEPS = 96e3, 5e-4, 6  # Hz, Pa of a sample
WALLS, TRUTH, START = ("z_min", "z_max"), np.array([0.55, 0.8]), np.array([0.98, 0.98])
PLACES = ((1.0, 1.2, 1.1), (3.9, 0.8, 1.6), (2.2, 3.1, 0.9))  # m, of the source in each recording
NAMES = [f"room.walls.{wall}.reflection" for wall in WALLS]
CHIRP = clsim.Signal.chirp(2e3, 20e3, 0.05, sampling_rate=RATE, fade=0.005)


def paths_from(place: tuple[float, ...], factors: np.ndarray) -> clsim.PathSet:
    """Return the paths from a place, m, with reflection factors of floor and ceiling."""
    sides = dict.fromkeys(("x_min", "x_max", "y_min", "y_max"), clsim.Material.from_reflection(0.9))
    walls = sides | {w: clsim.Material.from_reflection(float(r)) for w, r in zip(WALLS, factors, strict=True)}
    scene = clsim.Scene(
        clsim.Shoebox((5.0, 4.0, 2.6), walls), clsim.Air(),
        [clsim.Source("speaker", CHIRP, clsim.Trajectory.fixed(place))],
        [clsim.Receiver("microphone", clsim.Trajectory.fixed((3.1, 2.3, 1.3)))],
    )  # fmt: skip
    return clsim.find_paths(scene, 4)


def heard(factors: np.ndarray) -> np.ndarray:
    """Return the three recordings (3, n), Pa."""
    rows = [clsim.render(paths_from(place, factors), RATE, duration=0.12).pressure[0] for place in PLACES]
    return np.array(rows, dtype=float)


def slopes(factors: np.ndarray) -> np.ndarray:
    """Return their derivatives by both factors (2, 3, n), Pa."""
    found = [clsim.sensitivities(paths_from(place, factors), NAMES, RATE, duration=0.12).jacobian for place in PLACES]
    return np.concatenate(found, axis=1)


def main() -> None:
    """Find the factors and draw the absorption after each step."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("out"))
    folder = parser.parse_args().output
    folder.mkdir(parents=True, exist_ok=True)
    recorded = heard(TRUTH)
    recorded = recorded + NOISE * np.random.default_rng(0).standard_normal(recorded.shape)
    found = [START]
    for _ in range(STEPS):
        by = slopes(found[-1]).reshape(len(NAMES), -1)
        step = np.linalg.lstsq(by.T, (recorded - heard(found[-1])).ravel(), rcond=None)[0]
        found.append(np.clip(found[-1] + step, 0.0, 1.0))
    bounds = NOISE * np.sqrt(np.diag(np.linalg.inv(by @ by.T)))
    for name, value, truth, bound in zip(WALLS, found[-1], TRUTH, bounds, strict=True):
        print(f"{name}: reflection {value:.5f}, {truth:g} is right, bound {bound:.5f}")
    figure = Figure(figsize=(6.0, 3.6), layout="constrained")
    FigureCanvasAgg(figure)
    axis = figure.subplots()
    for i, name in enumerate(WALLS):
        (line,) = axis.plot(1.0 - np.array(found)[:, i] ** 2, marker="o", label=name)
        axis.axhline(1.0 - TRUTH[i] ** 2, color=line.get_color(), linestyle=":")
    axis.set(xlabel="step of Gauss-Newton", ylabel="absorption coefficient")
    axis.legend()
    figure.savefig(folder / "wall_absorption.png", dpi=110)
    print(folder / "wall_absorption.png")


if __name__ == "__main__":
    main()
