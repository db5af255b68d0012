"""A robot walks round a corner, out of sight of a beacon: the level against the exact one.

The room absorbs all but at the corner. The curve is the exact field of a hard one (Biot, Tolstoy, Medwin, Svensson), by
an integral that shares nothing with what is rendered; the picture shows the level over the walk without edges, with
them, and how far these are off.
"""

import argparse
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

import clsim

RATE, TONE = 192e3, 40e3
OUTLINE = [(0, 0), (8, 0), (8, 4), (4, 4), (4, 9), (0, 9)]
CORNER = np.array([4.0, 4.0])
BEACON = np.array([7.0, 1.5, 1.4])
WALK = np.array([(2.2, 3.4, 1.2), (2.2, 7.4, 1.2)])
DURATION = 4.0  # s
WINDOW = round(0.004 * RATE)
NODES = np.polynomial.legendre.leggauss(200)


def main() -> None:
    """Render the walk without and with edges and draw levels over it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("out"))
    parser.add_argument("--duration", type=float, default=DURATION, help="s of the walk")
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    duration = min(options.duration, DURATION)
    hard, soft = clsim.Material.from_reflection(1.0), clsim.Material.from_reflection(0.0)
    room = clsim.MeshRoom.from_plan(OUTLINE, 3.0, {"wall 2": hard, "wall 3": hard, "default": soft})
    beacon = clsim.Source("beacon", clsim.Signal.tone(TONE, DURATION, RATE, fade=0.02), clsim.Trajectory.fixed(BEACON))
    robot = clsim.Receiver("robot", clsim.Trajectory.line(*WALK, duration=DURATION))
    scene = clsim.Scene(room, clsim.Air(absorption=False), [beacon], [robot])
    times, levels = (np.arange(round(duration * RATE) // WINDOW) + 0.5) * WINDOW / RATE, {}
    for name, edges in (("without edges", 0), ("with edges", 1)):
        recording = clsim.render(clsim.find_paths(scene, 1, diffraction=edges), RATE, duration=duration)
        levels[name] = level_of(recording.pressure[0])[: len(times)]
    way = robot.trajectory.position(times)
    levels["exact"] = 20.0 * np.log10([abs(exact_field(place, scene.air.speed_of_sound)) for place in way])
    settled = times > 0.06
    off = np.abs(levels["with edges"] - levels["exact"])[settled]
    print(f"with edges within {off.max():.3f} dB of the exact level, median {np.median(off):.4f} dB")
    draw(way, levels, settled, options.output / "round_the_corner.png")
    print(options.output / "round_the_corner.png")


def level_of(pressure: np.ndarray) -> np.ndarray:
    """Return the amplitude of a tone in dB, every few ms."""
    blocks = pressure[: len(pressure) // WINDOW * WINDOW].reshape(-1, WINDOW).astype(float)
    return 10.0 * np.log10(np.maximum(2.0 * np.mean(blocks**2, axis=1), 1e-12))


def exact_field(place: np.ndarray, speed_of_sound: float) -> complex:
    """Return the field at a place: what is seen past the corner and by its faces, and what the corner adds."""
    k = 2.0 * np.pi * TONE / speed_of_sound
    (source_r, source_at), (r, at) = (polar(end) for end in (BEACON, place))
    rise, total = BEACON[2] - place[2], 0j
    for angle, seen in ((at - source_at, at - source_at < np.pi), (at + source_at, at + source_at < np.pi),
                        (3.0 * np.pi - at - source_at, at + source_at > 2.0 * np.pi)):  # fmt: skip
        way = np.sqrt(source_r**2 + r**2 - 2.0 * source_r * r * np.cos(angle) + rise**2)
        total += seen * np.exp(-1j * k * way) / way
    # Along the contour on which the way L - jv² falls and does not turn, v over its logarithm.
    length, nu = np.hypot(source_r + r, rise), 2.0 / 3.0
    u, weight = NODES
    v = np.sqrt(40.0 / k) * np.exp(10.0 * (u - 1.0))
    eta = 2.0 * np.arcsinh(np.sqrt(-(2j * length + v**2) * v**2 / (4.0 * source_r * r)))
    turns = nu * (np.pi + np.array([at - source_at, source_at - at, -at - source_at, at + source_at]))[:, None]
    terms = np.sum(np.sin(turns) / (np.cosh(nu * eta) - np.cos(turns)), axis=0)
    rest = terms / (source_r * r * np.sinh(eta)) * np.exp(-k * v**2) * (-2j * v) * 10.0 * v
    return complex(total - nu / (2.0 * np.pi) * np.sum(weight * rest) * np.exp(-1j * k * length))


def polar(place: np.ndarray) -> tuple[float, float]:
    """Return the distance from the corner, and the angle from the wall at its right through the air."""
    x, y = place[:2] - CORNER
    return float(np.hypot(x, y)), float(-np.arctan2(y, x) % (2.0 * np.pi))


def draw(way: np.ndarray, levels: dict[str, np.ndarray], settled: np.ndarray, file: Path) -> None:
    """Draw the plan, levels over the walk, and what is off."""
    figure = Figure(figsize=(12.0, 5.2), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplot_mosaic(
        [["plan", "level"], ["plan", "off"]], width_ratios=[1.0, 1.7], height_ratios=[2.0, 1.0]
    )
    plan = axes["plan"]
    plan.fill(*np.array(OUTLINE).T, facecolor="none", edgecolor="0.6")
    plan.plot([8, 4, 4], [4, 4, 9], "k", linewidth=2.5, label="hard faces")
    beyond = CORNER + (CORNER - BEACON[:2]) * 4.0 / 3.0
    plan.plot(*np.array([BEACON[:2], CORNER, beyond]).T, "--", color="0.5", linewidth=1.0, label="edge of the shadow")
    plan.plot(*WALK[:, :2].T, color="#c1272d", linewidth=2.0, label="walk")
    plan.plot(*BEACON[:2], "k^", markersize=9, label="beacon")
    plan.set(aspect="equal", xlabel="x (m)", ylabel="y (m)", title="round a corner of 270°")
    plan.legend(loc="upper right", fontsize=8)
    y, styles = (
        way[settled, 1],
        {"without edges": ("0.55", 1.0), "exact": ("black", 3.0), "with edges": ("#c1272d", 1.0)},
    )
    for name, (color, width) in styles.items():
        axes["level"].plot(y, levels[name][settled], color=color, linewidth=width, label=name)
    axes["level"].set(
        ylabel="amplitude (dB re 1 Pa)", xlim=(y[0], y[-1]), ylim=(-75.0, 0.0), title="40 kHz over the walk"
    )
    axes["level"].legend(loc="lower left", fontsize=9)
    axes["off"].plot(y, (levels["with edges"] - levels["exact"])[settled], color="#c1272d", linewidth=0.8)
    axes["off"].set(xlabel="y of the robot (m)", ylabel="with edges\nless exact (dB)", xlim=(y[0], y[-1]))
    figure.savefig(file, dpi=110)


if __name__ == "__main__":
    main()
