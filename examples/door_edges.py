"""A door that opens in an L-room, with and without its edges: the level of a 40 kHz tone behind it, by its angle.

Writes door_edges.png.
"""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
from swinging_door import CARRIER, RATE, door_scene

import clsim

WINDOW = 32  # samples of the envelope, 2 ms, over which levels are means


def levels(scene: clsim.Scene, order: int, edges: int, duration: float) -> tuple[np.ndarray, np.ndarray]:
    """Return times, s, and the level, dB relative to the direct sound in the open and without absorption by air."""
    paths = clsim.find_paths(scene, order, diffraction=edges)
    envelope = clsim.render(paths, RATE, baseband=clsim.Baseband(CARRIER, 8e3, 16e3), duration=duration)
    power = np.abs(envelope.samples[0]) ** 2
    mean = np.convolve(power, np.full(WINDOW, 1.0 / WINDOW), "same")
    source, ear = (end.trajectory.position(0.0) for end in (scene.sources[0], scene.receivers[0]))
    free = 1.0 / np.linalg.norm(source - ear)
    return np.arange(len(mean)) / envelope.sampling_rate, 10.0 * np.log10(mean / free**2 + 1e-9)


def main() -> None:
    """Render and draw."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("out"))
    parser.add_argument("--duration", type=float, default=4.0)
    parser.add_argument("--order", type=int, default=0)
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    scene = door_scene(options.duration)
    scene = replace(scene, receivers=scene.receivers[:1])
    turns = scene.bodies[0].trajectory
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 4.5), layout="constrained")
    axes = figure.subplots()
    for edges, label in ((0, "without edges"), (1, "one edge, of the door or of the wall")):
        times, level = levels(scene, options.order, edges, options.duration)
        kept = (times > 0.15) & (times < options.duration - 0.15)
        angle = np.degrees(2.0 * np.arctan2(*turns.orientation(times[kept]).T[2:]))
        axes.plot(angle, level[kept], linewidth=1.0, label=label)
    axes.set(
        xlabel="angle of the door (degrees)", ylabel="level (dB re 1/r)", ylim=(-60.0, 8.0),
        title="Behind a door that opens: a tone of 40 kHz",
    )  # fmt: skip
    axes.legend(loc="lower right")
    figure.savefig(options.output / "door_edges.png", dpi=110)


if __name__ == "__main__":
    main()
