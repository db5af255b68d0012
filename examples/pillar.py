"""A beacon that walks behind a pillar, by three models side by side: a gate, a fade of 1 ms, and sound round the edges.

Without edges all that is left behind the pillar are reflections, and its shadow begins at once: with a click, or within
the fade. Above, the level over the walk; below, the sound itself as sight is lost.
"""

import argparse
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

import clsim

RATE = 192e3
OUTLINE = [(0, 0), (10, 0), (10, 7), (0, 7)]
PILLAR = [(4.85, 3.5), (5.15, 3.5), (5.15, 3.8), (4.85, 3.8)]
DURATION = 2.0  # s
WINDOW = round(0.002 * RATE)
AROUND = 4e-3  # s about the loss of sight
TITLES = {"gate": "gate (transition=0)", "fade": "fade of 1 ms", "edges": "edges (diffraction=2)"}


def main() -> None:
    """Render the walk by each model and draw what is heard."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("out"))
    parser.add_argument("--duration", type=float, default=DURATION, help="s of the walk")
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    duration = min(options.duration, DURATION)
    absorber = clsim.Material.from_reflection(0.1)
    room = clsim.MeshRoom.from_plan(OUTLINE, 3.0, absorber, pillars=[PILLAR])
    walk = clsim.Trajectory.line((4.0, 1.5, 1.2), (6.0, 1.5, 1.2), duration=DURATION)
    beacon = clsim.Source("beacon", clsim.Signal.tone(40e3, DURATION, RATE, fade=0.02), walk)
    receiver = clsim.Receiver("receiver", clsim.Trajectory.fixed((5.0, 6.5, 1.6)))
    scene = clsim.Scene(room, clsim.Air(), [beacon], [receiver])
    paths = clsim.find_paths(scene, max_order=1, diffraction=2)
    specular = clsim.find_paths(scene, max_order=1)
    heard = {}
    for name, found, transition in (("gate", specular, 0.0), ("fade", specular, 1e-3), ("edges", paths, 1e-3)):
        recording = clsim.render(found, RATE, duration=duration, transition=transition)
        recording.save(options.output / f"pillar_{name}.wav")
        heard[name] = recording.pressure[0]
        level = level_of(heard[name])
        print(f"{name}: {level[min(50, len(level) - 1) :].min():.1f} dB at least")  # once the first sound is there
    direct = np.flatnonzero(specular.order == 0)
    for start, end in zip(specular.start[direct], specular.end[direct], strict=True):
        print(f"direct sound from {max(start, 0.0):.4f} to {min(end, duration):.4f} s")
    lost = float(specular.end[direct].min())
    draw(specular, heard, lost, options.output / "pillar.png")
    print(options.output / "pillar.png")


def level_of(pressure: np.ndarray) -> np.ndarray:
    """Return the amplitude of a tone in dB, every few ms."""
    blocks = pressure[: len(pressure) // WINDOW * WINDOW].reshape(-1, WINDOW).astype(float)
    return 10.0 * np.log10(np.maximum(2.0 * np.mean(blocks**2, axis=1), 1e-12))


def draw(paths: clsim.PathSet, heard: dict[str, np.ndarray], lost: float, file: Path) -> None:
    """Draw the plan, and by each model the level over time, and the sound as sight is lost."""
    duration = len(next(iter(heard.values()))) / RATE
    times = np.linspace(0.0, duration, 501)
    table = paths.table(times)
    seen = np.nanmax(np.abs(table.gain[table.direct]), axis=0, initial=0.0) > 0.0
    figure = Figure(figsize=(13.0, 5.6), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplot_mosaic(
        [["plan", *(f"{m} level" for m in heard)], ["plan", *heard]], width_ratios=[1.3, 1, 1, 1]
    )
    plan = axes["plan"]
    for ring, color in ((OUTLINE, "none"), (PILLAR, "0.6")):
        plan.fill(*np.array(ring).T, facecolor=color, edgecolor="black")
    way = paths.scene.sources[0].trajectory.position(times)
    plan.scatter(*way[seen, :2].T, s=6, color="#c1272d", label="beacon, seen")
    plan.scatter(*way[~seen, :2].T, s=6, color="#1f77b4", label="beacon, hidden")
    plan.plot(5.0, 6.5, "k^", markersize=9, label="receiver")
    plan.set(aspect="equal", xlabel="x (m)", ylabel="y (m)", title="a walk behind a pillar of 30 cm")
    plan.legend(loc="upper center", bbox_to_anchor=(0.5, -0.16), fontsize=9)
    first, last = (max(round((lost + side * AROUND) * RATE), 0) for side in (-1.0, 1.0))
    for name, pressure in heard.items():
        level, sound, values = axes[f"{name} level"], axes[name], level_of(pressure)
        level.plot((np.arange(len(values)) + 0.5) * WINDOW / RATE, values, color="#c1272d", linewidth=0.7)
        level.axvline(lost, color="0.5", linewidth=0.8, linestyle="--")
        level.set(xlabel="time (s)", xlim=(0.0, duration), ylim=(-70.0, -10.0), title=TITLES[name])
        part = pressure[first:last]
        sound.plot(((first + np.arange(len(part))) / RATE - lost) * 1e3, part, color="#1f77b4", linewidth=0.5)
        sound.axvline(0.0, color="0.5", linewidth=0.8, linestyle="--")
        sound.set(xlabel="time from the loss of sight (ms)", xlim=(-1e3 * AROUND, 1e3 * AROUND), ylim=(-0.15, 0.15))
        for panel in (level, sound):
            panel.tick_params(labelleft=name == "gate")
    axes["gate level"].set_ylabel("amplitude (dB re 1 Pa)")
    axes["gate"].set_ylabel("pressure (Pa)")
    figure.savefig(file, dpi=110)


if __name__ == "__main__":
    main()
