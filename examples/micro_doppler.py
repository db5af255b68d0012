"""A 40 kHz beacon on a walking robot, as complex envelope: its steps and its motor are sidebands of the carrier.

Writes micro_doppler.png and micro_doppler.wav (I and Q).
"""

import argparse
from pathlib import Path

import numpy as np

import clsim
from clsim.pictures.plots import spectrogram_picture

RATE, CARRIER, DURATION = 192e3, 40e3, 8.0


def walk(t: np.ndarray) -> np.ndarray:
    """Return positions: 0.5 m/s along the room, two steps a second, and from 4 s on a motor that shakes at 22 Hz."""
    step = 2 * np.pi * 2.0 * t
    motor = 0.6e-3 * np.sin(2 * np.pi * 22.0 * t) / (1.0 + np.exp(-(t - 4.0) / 0.1))
    surge = 0.02 * np.sin(step) + motor
    return np.stack([1.5 + 0.5 * t + surge, 3.0 + 0.015 * np.sin(0.5 * step), 0.6 + 0.01 * np.cos(step)], axis=1)


def main() -> None:
    """Render and draw."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("out"))
    folder = parser.parse_args().output
    folder.mkdir(parents=True, exist_ok=True)
    beacon = clsim.Signal.tone(CARRIER, DURATION, RATE, fade=0.05)
    robot = clsim.Source("robot", beacon, clsim.Trajectory.sampled(walk, DURATION + 0.1, 1000.0))
    ear = clsim.Receiver("wall", clsim.Trajectory.fixed((7.5, 3.4, 1.2)))
    walls = {"default": clsim.Material.from_reflection(0.3), "x_min": clsim.Material.from_reflection(0.6)}
    scene = clsim.Scene(clsim.Shoebox((8.0, 6.0, 3.0), walls), clsim.Air(), [robot], [ear])
    paths = clsim.find_paths(scene, max_order=2)
    recording = clsim.render(paths, RATE, baseband=(CARRIER, 1e3), duration=DURATION)
    print("\n".join(recording.notes))
    recording.save(folder / "micro_doppler.wav")
    title = "A 40 kHz beacon on a walking robot; from 4 s on its motor runs at 22 Hz"
    spectrogram_picture(
        recording.pressure[0], recording.sampling_rate, folder / "micro_doppler.png", title=title, carrier=CARRIER,
        segment=512, band=(-250.0, 250.0),
    )  # fmt: skip


if __name__ == "__main__":
    main()
