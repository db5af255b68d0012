"""A beacon that walks behind a pillar: its direct sound vanishes and comes back, and reflections do too.

The picture shows the way, where the receiver sees the beacon, and the level that it hears against the ground truth.
"""

import argparse
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

import clsim

RATE = 192e3
OUTLINE = [(0, 0), (10, 0), (10, 7), (0, 7)]
PILLAR = [(4.6, 3.0), (5.4, 3.0), (5.4, 3.8), (4.6, 3.8)]


def main() -> None:
    """Render the walk and draw what is heard."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("out"))
    folder = parser.parse_args().output
    folder.mkdir(parents=True, exist_ok=True)
    room = clsim.MeshRoom.from_plan(OUTLINE, 3.0, clsim.Material.from_reflection(0.6), pillars=[PILLAR])
    walk = clsim.Trajectory.line((2.0, 1.5, 1.2), (8.0, 1.5, 1.2), duration=5.0)
    beacon = clsim.Source("beacon", clsim.Signal.tone(40e3, 5.0, RATE, fade=0.02), walk)
    receiver = clsim.Receiver("receiver", clsim.Trajectory.fixed((5.0, 6.5, 1.6)))
    scene = clsim.Scene(room, clsim.Air(), [beacon], [receiver])
    paths = clsim.find_paths(scene, max_order=2)
    recording = clsim.render(paths, RATE, duration=5.0)
    recording.save(folder / "pillar.wav")
    direct = np.flatnonzero(paths.order == 0)
    for start, end in zip(paths.start[direct], paths.end[direct], strict=True):
        print(f"direct sound from {max(start, 0.0):.4f} to {min(end, 5.0):.4f} s")
    draw(paths, recording.pressure[0], folder / "pillar.png")
    print(folder / "pillar.png")


def draw(paths: clsim.PathSet, pressure: np.ndarray, file: Path) -> None:
    """Draw the plan, and the level over time with the direct path's own."""
    times = np.linspace(0.0, 5.0, 501)
    table = paths.table(times)
    direct = np.nanmax(np.abs(table.gain[table.direct]), axis=0, initial=0.0)
    seen = direct > 0.0
    figure = Figure(figsize=(11.0, 4.6), layout="constrained")
    FigureCanvasAgg(figure)
    plan, level = figure.subplots(1, 2, width_ratios=[1.0, 1.5])
    for ring, color in ((OUTLINE, "none"), (PILLAR, "0.6")):
        plan.fill(*np.array(ring).T, facecolor=color, edgecolor="black")
    way = paths.scene.sources[0].trajectory.position(times)
    plan.scatter(*way[seen, :2].T, s=6, color="#c1272d", label="beacon, seen")
    plan.scatter(*way[~seen, :2].T, s=6, color="#1f77b4", label="beacon, hidden")
    plan.plot(5.0, 6.5, "k^", markersize=9, label="receiver")
    plan.set(aspect="equal", xlabel="x (m)", ylabel="y (m)", title="a walk behind a pillar")
    plan.legend(loc="center left", fontsize=9)
    window = round(0.005 * RATE)
    blocks = pressure[: len(pressure) // window * window].reshape(-1, window).astype(float)
    rms = np.sqrt(2.0 * np.mean(blocks**2, axis=1))
    decibel = 20.0 * np.log10(np.maximum(rms, 1e-9))
    level.plot((np.arange(len(rms)) + 0.5) * window / RATE, decibel, color="black", linewidth=0.7, label="all paths")
    with np.errstate(divide="ignore"):
        level.plot(times, 20.0 * np.log10(direct), color="#c1272d", linewidth=2.0, label="direct path alone (truth)")
    level.set(
        xlabel="time (s)", ylabel="amplitude (dB re 1 Pa)", xlim=(0.0, 5.0), ylim=(-60.0, None),
        title="40 kHz, order 2: what is left behind the pillar are reflections",
    )  # fmt: skip
    level.legend(loc="lower left", fontsize=9)
    figure.savefig(file, dpi=130)


if __name__ == "__main__":
    main()
