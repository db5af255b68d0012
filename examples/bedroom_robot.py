"""A robot that chirps ten times a second in a furnished room; four receivers find it by matched filters.

With `--mesh` and `--trajectory` the room and the motion are your own (a mesh file with y up, a TUM file); without, a
bedroom with a wardrobe and a made-up tour. The picture shows what the matched filter makes of each chirp, and over it
the true delay of the direct path, where there is one.
"""

import argparse
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from scipy.signal import hilbert, oaconvolve

import clsim

RATE = 192e3
PERIOD = 0.1  # s
LONGEST = 0.03  # s shown


def main() -> None:
    """Render the chirps; draw the matched filters' outputs with the ground truth."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("out"))
    parser.add_argument("--mesh", type=Path, help="mesh file, metres, y up")
    parser.add_argument("--trajectory", type=Path, help="TUM file")
    parser.add_argument("--duration", type=float, default=12.0, help="seconds (default: 12)")
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    wall = clsim.Material.from_reflection(0.7)
    room = clsim.MeshRoom.from_file(options.mesh, up="y", materials=wall) if options.mesh else bedroom(wall)
    low, high = room.extent
    motion = tour(options.trajectory, 0.5 * (low + high))
    chirp = clsim.Signal.chirp(36e3, 44e3, duration=3e-3, sampling_rate=RATE, window="hann")
    signal = clsim.Signal.pulses(chirp, PERIOD, int(min(options.duration, motion.end) / PERIOD))
    places = [(0.15, 0.15), (0.85, 0.15), (0.15, 0.85), (0.85, 0.85), (0.5, 0.85), (0.85, 0.4), (0.5, 0.15)]
    inside = [at for x, y in places if room.contains(at := low + (high - low) * (x, y, 0.9))[0]]
    receivers = [clsim.Receiver(f"receiver {i}", clsim.Trajectory.fixed(at)) for i, at in enumerate(inside[:4])]
    scene = clsim.Scene(room, clsim.Air(), [clsim.Source("robot", signal, motion)], receivers)
    paths = clsim.find_paths(scene, max_order=3)
    print(f"{len(room.walls)} walls, {len(paths)} intervals of paths")
    recording = clsim.render(paths, RATE, duration=signal.duration)
    recording.save(options.output / "bedroom_robot.wav")
    draw(paths, recording.pressure, chirp.read(0, round(3e-3 * RATE)), options.output / "bedroom_robot.png")
    print(options.output / "bedroom_robot.png")


def bedroom(wall: clsim.Material) -> clsim.MeshRoom:
    """Return an L-shaped bedroom with a wardrobe that does not reach the ceiling."""
    room = clsim.MeshRoom.from_plan([(0, 0), (4, 0), (4, 3.2), (2.6, 3.2), (2.6, 6), (0, 6)], 2.6, wall)
    wardrobe = clsim.MeshRoom.from_plan([(1.2, 2.6), (1.8, 2.6), (1.8, 3.8), (1.2, 3.8)], 2.0, wall)
    return clsim.MeshRoom.joined([room, wardrobe])


def tour(file: Path | None, middle: np.ndarray) -> clsim.Trajectory:
    """Return a measured motion moved to the middle of the room, or a made-up one round the wardrobe."""
    if file is None:
        places = [(0.5, 0.6, 0.4), (0.5, 3.2, 0.4), (0.6, 5.0, 0.4), (1.6, 5.2, 0.4), (2.1, 3.4, 0.4), (2.4, 1.2, 0.4)]
        return clsim.Trajectory.waypoints(np.linspace(0.0, 12.5, len(places)), places)
    measured = clsim.Trajectory.from_file(file, "tum", max_gap=0.2)
    places = measured.position(np.linspace(0.0, measured.end, 200))
    shift = middle - 0.5 * (places.min(axis=0) + places.max(axis=0))
    return clsim.Trajectory.from_file(file, "tum", max_gap=0.2, translate=tuple(shift))


def draw(paths: clsim.PathSet, pressure: np.ndarray, chirp: np.ndarray, file: Path) -> None:
    """Draw the matched filter's output after every chirp, one panel per receiver, and the ground truth."""
    figure = Figure(figsize=(12.0, 7.0), layout="constrained")
    FigureCanvasAgg(figure)
    count, step = pressure.shape[1] // round(PERIOD * RATE), round(PERIOD * RATE)
    emitted = np.arange(count) * PERIOD
    truth = clsim.direct_path(paths, emitted=emitted)
    matched = np.conj(hilbert(chirp))[::-1]  # of its output the magnitude is the envelope
    for r, axes in enumerate(figure.subplots(2, 2, sharex=True, sharey=True).flat):
        found = np.abs(oaconvolve(pressure[r].astype(float), matched)[len(chirp) - 1 :])
        image = found[: count * step].reshape(count, step)[:, : round(LONGEST * RATE)]
        level = 20.0 * np.log10(np.maximum(image[:, ::4].T, 1e-9))
        shown = axes.imshow(
            level - level.max(), origin="lower", aspect="auto", cmap="magma", vmin=-50.0, vmax=0.0,
            extent=(0.0, count * PERIOD, 0.0, LONGEST * 1e3),
        )  # fmt: skip
        delay = np.where(truth.line_of_sight[0, r], truth.delay[0, r], np.nan)
        axes.plot(emitted, delay * 1e3, color="#4dd0e1", linewidth=1.2, linestyle="--")
        axes.set(title=f"{truth.receiver_names[r]}; dashed: true delay of the direct sound", ylim=(0.0, LONGEST * 1e3))
    figure.colorbar(shown, ax=figure.axes, pad=0.01, aspect=40, label="level (dB of the receiver's highest)")
    figure.supxlabel("time of the chirp (s)")
    figure.supylabel("delay (ms)")
    figure.savefig(file, dpi=120)


if __name__ == "__main__":
    main()
