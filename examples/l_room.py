"""A source that walks round the corner of an L-shaped room, past a receiver in the other arm.

Every path is active exactly while its walls and the corner allow it: lines begin and end in the picture of delays, and
the spectrogram shows each of them with its own Doppler shift. `--animate` draws the plan with all paths as a GIF.
"""

import argparse
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.animation import FuncAnimation, PillowWriter
from matplotlib.collections import LineCollection

import clsim
from clsim.pictures.plots import spectrogram_picture
from clsim.workflow.pictures import history_picture

RATE = 192e3
DURATION = 6.0
_COLORS = ("C3", "C0", "0.6", "0.85")  # by the number of reflections
CORNERS = [(0, 0), (8, 0), (8, 4), (4, 4), (4, 9), (0, 9)]


def animate(paths: clsim.PathSet, recording: clsim.Recording, file: Path, frames: int = 60) -> None:
    """Draw the plan with the paths of each moment, and the level that the receiver gets up to then."""
    times = np.linspace(0.0, DURATION, frames, endpoint=False)
    count = int(RATE * DURATION / frames)
    block = recording.pressure[0, : frames * count].reshape(frames, count)
    level = 20.0 * np.log10(np.sqrt(np.mean(block**2, axis=1)) / 20e-6 + 1.0)
    figure, (plan, right) = plt.subplots(1, 2, figsize=(7.2, 3.4), dpi=80, width_ratios=(1, 1.3), layout="constrained")
    plan.fill(*zip(*CORNERS, strict=True), fc="0.95", ec="0.2")
    lines = plan.add_collection(LineCollection([], lw=0.8))
    (beacon,) = plan.plot([], [], "o", color="C3", label="source")
    receiver = paths.scene.receivers[0].trajectory.position(0.0)
    plan.plot(*receiver[:2], "s", color="k", label="receiver")
    plan.set(aspect="equal", xlabel="x (m)", ylabel="y (m)")
    plan.legend(loc="upper right", fontsize=8)
    right.set(xlim=(0.0, DURATION), ylim=(0.0, level.max() + 5.0), xlabel="time (s)", ylabel="level (dB)")
    (curve,) = right.plot([], [], color="C0")

    def draw(frame: int) -> None:
        """Draw one moment."""
        t = float(times[frame])
        active = np.flatnonzero((paths.start <= t) & (t < paths.end))
        active = active[np.argsort(-paths.order[active])]
        points = paths.vertices(t)[active]
        lines.set_segments([each[np.isfinite(each).all(axis=1)][:, :2] for each in points])
        lines.set_color([_COLORS[k] for k in paths.order[active]])
        beacon.set_data(*paths.scene.sources[0].trajectory.position(t)[:2, None])
        curve.set_data(times[: frame + 1], level[: frame + 1])
        right.set_title(f"{len(active)} paths")

    FuncAnimation(figure, draw, frames).save(file, PillowWriter(fps=10))
    plt.close(figure)


def main() -> None:
    """Render the walk; draw delays over time and the spectrogram."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("out"))
    parser.add_argument("--animate", action="store_true", help="draw l_room.gif, too")
    options = parser.parse_args()
    folder = options.output
    folder.mkdir(parents=True, exist_ok=True)
    room = clsim.MeshRoom.from_plan(CORNERS, 3.0, clsim.Material.from_reflection(0.8))
    walk = clsim.Trajectory.waypoints(
        [0.0, 2.0, 3.0, 4.0, DURATION], [(2, 8, 1.4), (2, 4, 1.4), (2.4, 2.6, 1.4), (3.8, 2.0, 1.4), (6.5, 2.0, 1.4)]
    )
    source = clsim.Source("robot", clsim.Signal.tone(40e3, DURATION, RATE, fade=0.02), walk)
    receiver = clsim.Receiver("receiver", clsim.Trajectory.fixed((7.2, 1.2, 2.0)))
    scene = clsim.Scene(room, clsim.Air(), [source], [receiver])
    paths = clsim.find_paths(scene, max_order=3)
    recording = clsim.render(paths, RATE, duration=DURATION)
    recording.save(folder / "l_room.wav")
    active = [int(np.sum((paths.start <= t) & (t < paths.end))) for t in range(int(DURATION))]
    print(f"{len(paths)} intervals; active paths at 0, 1, 2 ... s: {active}")
    history_picture(paths.table(np.linspace(0.0, DURATION, 1201)), 0, folder / "l_room_paths.png")
    spectrogram_picture(
        recording.pressure[0], RATE, folder / "l_room.png", title="a 40 kHz source round a corner",
        band=(39.5e3, 40.5e3),
    )  # fmt: skip
    if options.animate:
        animate(paths, recording, folder / "l_room.gif")
    for name in ("l_room_paths.png", "l_room.png", *(["l_room.gif"] if options.animate else [])):
        print(folder / name)


if __name__ == "__main__":
    main()
