"""A door that opens between the arms of an L-room: level of a 40 kHz tone behind it, and Doppler shifts of its echoes.

Writes swinging_door.png and swinging_door.html, the page in which the door moves with the slider.
"""

import argparse
from pathlib import Path

import numpy as np

import clsim
from clsim.paths.path_set import PathSet
from clsim.paths.path_table import view_scene

RATE, CARRIER, DURATION = 192e3, 40e3, 4.0
CORNERS = [(0, 0), (6, 0), (6, 3), (3, 3), (3, 6), (0, 6)]


def door_scene(duration: float) -> clsim.Scene:
    """Return an L-room with a partition across one arm, a doorway in it, and a door that opens by 75 degrees."""
    plaster, wood = clsim.Material.from_reflection(0.5), clsim.Material.from_reflection(0.9)
    sheets = [((0.02, 3.0), (1.0, 3.0)), ((2.0, 3.0), (2.98, 3.0))]
    walls = [
        clsim.MeshRoom([(*a, 0.02), (*b, 0.02), (*b, 2.48), (*a, 2.48)], [(0, 1, 2), (0, 2, 3)], plaster)
        for a, b in sheets
    ]
    room = clsim.MeshRoom.joined([clsim.MeshRoom.from_plan(CORNERS, 2.5, plaster), *walls])
    times = np.linspace(0.0, duration + 0.1, 21)
    angles = np.radians(75.0) * 0.5 * (1.0 - np.cos(np.pi * times / times[-1]))
    hinge = clsim.Trajectory.swing((1.0, 3.0, 0.0), (0, 0, 1), angles, times)
    door = clsim.Body.box("door", (0.98, 0.0, 2.44), wood, hinge, centre=(0.5, 0.0, 1.25))
    tone = clsim.Signal.tone(CARRIER, duration, RATE, fade=0.1)
    speaker = clsim.Source("speaker", tone, clsim.Trajectory.fixed((2.2, 4.6, 1.2)))
    ears = [clsim.Receiver("beyond", clsim.Trajectory.fixed((1.6, 1.0, 1.4))),
            clsim.Receiver("before", clsim.Trajectory.fixed((1.2, 4.4, 1.3)))]  # fmt: skip
    return clsim.Scene(room, clsim.Air(), [speaker], ears, bodies=[door])


def main() -> None:
    """Render and draw."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("out"))
    parser.add_argument("--duration", type=float, default=DURATION)
    parser.add_argument("--order", type=int, default=2)
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    paths = clsim.find_paths(door_scene(options.duration), options.order)
    heard = clsim.render(paths, RATE, baseband=(CARRIER, 4e3), duration=options.duration)
    by_door = PathSet(paths.scene, paths.families[-1:])
    echoes = clsim.render(by_door, RATE, baseband=(CARRIER, 4e3), duration=options.duration)
    draw(heard, echoes, by_door, options.output / "swinging_door.png")
    view_scene(paths, options.output / "swinging_door.html", duration=options.duration, frames=60)


def draw(heard: clsim.Recording, echoes: clsim.Recording, paths: PathSet, path: Path) -> None:
    """Draw levels on both sides of the door, and the short-time spectrum of its echoes with the path table over it."""
    from matplotlib.figure import Figure

    rate, window = heard.sampling_rate, 512
    figure = Figure(figsize=(9.0, 7.0), layout="constrained")
    levels, shifts = figure.subplots(2, sharex=True, height_ratios=(2, 3))
    mean = np.hanning(64) / np.hanning(64).sum()
    for ear, name in enumerate(heard.receiver_names):
        power = np.convolve(np.abs(heard.pressure[ear]) ** 2, mean, "same")
        levels.plot(
            np.arange(len(power)) / rate, 10.0 * np.log10(power + 1e-9), linewidth=0.8, label=f"{name} the door"
        )
    levels.set(ylabel="level (dB re 1 Pa)", ylim=(-50.0, 12.0), title="A door opens: a tone of 40 kHz")
    levels.legend(loc="lower right")
    envelope = echoes.pressure[list(echoes.receiver_names).index("before")]
    starts = np.arange(0, len(envelope) - window, window // 8)
    frames = np.stack([envelope[i : i + window] * np.hanning(window) for i in starts])
    level = 20.0 * np.log10(np.abs(np.fft.fftshift(np.fft.fft(frames, 8 * window, axis=1), axes=1)).T + 1e-12)
    times = (starts[[0, -1]] + 0.5 * window) / rate
    extent = (*times, -0.5 * rate, 0.5 * rate)
    image = shifts.imshow(level - level.max(), aspect="auto", origin="lower", vmin=-50.0, vmax=0.0, extent=extent)
    table = paths.table(np.linspace(0.0, times[1], 400))
    first = np.flatnonzero((table.receiver == 1) & (table.order == 1))
    for i in first:
        label = "door alone, by the path table" if i == first[0] else None
        shifts.plot(table.times, table.doppler_shift[i], color="white", linewidth=1.0, label=label)
    shifts.set(
        xlabel="time (s)", ylabel="Doppler shift (Hz)", ylim=(-300.0, 300.0), title="Echoes of the door, before it"
    )
    shifts.legend(loc="upper right", facecolor="0.3", labelcolor="white")
    figure.colorbar(image, label="level (dB)")
    figure.savefig(path, dpi=110)


if __name__ == "__main__":
    main()
