"""A tag walks from an open door out of a beacon's sight: how far the first arrival still gives a range, and its bias.

A chirp every 50 ms from the next room, a microphone with noise, the first peak of the matched filter. What comes first
is the sound round the door's edge, late by its detour; without edges it is some echo, or nothing.
"""

import argparse
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

import clsim

RATE = 192e3
SIZE = (8.0, 6.0, 3.0)
DOOR = (4.0, 4.9)  # m, from and to which the wall at x = 4 m is open
BEACON = np.array([2.0, 4.9, 1.6])
WALK = np.array([(5.5, 4.6, 1.3), (5.5, 0.6, 1.3)])
DURATION, PERIOD = 4.0, 0.05  # s
NOISE_DB = 5.0  # re 20 µPa/√Hz
FIRST_DB = -20.0  # of the largest peak, how soft the first one may be
GOOD = 0.1  # m by which a range may be off what comes first
CORNER = np.array([4.0, DOOR[0]])
NOISY = clsim.Electronics(ambient_noise_db=NOISE_DB, seed=1)


def main() -> None:
    """Render the walk without and with edges and draw the errors of ranges over it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("out"))
    parser.add_argument("--duration", type=float, default=DURATION, help="s of the walk")
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    duration = min(options.duration, DURATION)
    plaster = clsim.Material.from_reflection(0.6)
    walls = [
        clsim.MeshRoom([(4, a, 0), (4, b, 0), (4, b, 3), (4, a, 3)], [(0, 1, 2), (0, 2, 3)], plaster)
        for a, b in ((0.0, DOOR[0]), (DOOR[1], SIZE[1]))
    ]
    room = clsim.MeshRoom.joined([clsim.Shoebox(SIZE, plaster), *walls])
    pulse = clsim.Signal.chirp(20e3, 45e3, 5e-3, RATE, window="hann")
    signal = clsim.Signal.pulses(pulse, period=PERIOD, count=round(duration / PERIOD) - 1)
    beacon = clsim.Source("beacon", signal, clsim.Trajectory.fixed(BEACON))
    tag = clsim.Receiver("tag", clsim.Trajectory.line(*WALK, duration=DURATION), electronics=NOISY)
    scene = clsim.Scene(room, clsim.Air(), [beacon], [tag])
    scores = {}
    for name, edges in (("without edges", 0), ("with edges", 1)):
        recording = clsim.render(clsim.find_paths(scene, 1, diffraction=edges), RATE, duration=duration)
        scores[name] = clsim.score.ranging(recording, pulse, "first-peak", max_range=14.0, first_peak_db=FIRST_DB)
    places = tag.trajectory.position(scores["with edges"].emission_times)
    far, late = behind(places), detour(places)
    hidden = far > 0.0
    for name, score in scores.items():
        error = score.error[0]
        good = hidden & (np.abs(error - late) < GOOD)
        told = f"{far[good].max():.2f} m behind the edge of the shadow at most" if good.any() else "never out of sight"
        print(f"{name}: what comes first is found {told}, for {good[hidden].mean():.0%} of pulses out of sight")
        if good.any():
            off = np.abs(error - late)[good].max()
            print(f"  late by {late[good].min():.3f} to {late[good].max():.3f} m, the detour within {off:.3f} m")
    draw(places, far, late, scores, options.output / "behind_a_door.png")
    print(options.output / "behind_a_door.png")


def behind(places: np.ndarray) -> np.ndarray:
    """Return the distance of places behind the shadow boundary along the walk, m; negative in sight."""
    slope = (CORNER[1] - BEACON[1]) / (CORNER[0] - BEACON[0])
    return np.asarray(BEACON[1] + slope * (places[:, 0] - BEACON[0]) - places[:, 1])


def detour(places: np.ndarray) -> np.ndarray:
    """Return the detour round the door's edge over the straight line, m; 0 in sight."""
    across = np.linalg.norm(BEACON[:2] - CORNER) + np.linalg.norm(places[:, :2] - CORNER, axis=1)
    longer = np.hypot(across, places[:, 2] - BEACON[2]) - np.linalg.norm(places - BEACON, axis=1)
    return np.where(behind(places) > 0.0, longer, 0.0)


def draw(places: np.ndarray, far: np.ndarray, late: np.ndarray, scores: dict, file: Path) -> None:
    """Draw the plan, and the errors of ranges over the way into the shadow."""
    figure = Figure(figsize=(12.0, 4.8), layout="constrained")
    FigureCanvasAgg(figure)
    plan, errors = figure.subplots(1, 2, width_ratios=[1.0, 1.5])
    plan.fill([0, SIZE[0], SIZE[0], 0], [0, 0, SIZE[1], SIZE[1]], facecolor="none", edgecolor="black")
    for a, b in ((0.0, DOOR[0]), (DOOR[1], SIZE[1])):
        plan.plot([4.0, 4.0], [a, b], "k", linewidth=2.5)
    beyond = CORNER + 2.0 * (CORNER - BEACON[:2])
    plan.plot(*np.array([BEACON[:2], CORNER, beyond]).T, "--", color="0.5", linewidth=1.0, label="edge of the shadow")
    plan.plot(*places[:, :2].T, ".", color="#c1272d", markersize=4, label="tag, at every pulse")
    plan.plot(*BEACON[:2], "k^", markersize=9, label="beacon")
    plan.set(aspect="equal", xlabel="x (m)", ylabel="y (m)", title="a door of 0.9 m")
    plan.legend(loc="lower left", fontsize=8)
    errors.plot(far, late, color="black", linewidth=2.0, label="detour round the door's edge")
    styles = {"without edges": ("x", "0.5"), "with edges": (".", "#c1272d")}
    for name, score in scores.items():
        marker, color = styles[name]
        errors.plot(far, score.error[0], marker, color=color, markersize=6, label=f"range found {name}")
    errors.axvline(0.0, color="0.5", linewidth=0.8, linestyle="--")
    errors.set(
        xlabel="way into the shadow (m)",
        ylabel="error of the range (m)",
        ylim=(-0.4, 5.6),
        title="first peak of a 20 to 45 kHz chirp",
    )
    errors.legend(loc="upper left", fontsize=9)
    figure.savefig(file, dpi=110)


if __name__ == "__main__":
    main()
