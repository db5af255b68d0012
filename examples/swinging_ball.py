"""A 40 kHz sonar and a ball that swings before it in a room: the Doppler shifts of its echo, with theory drawn over it.

Writes swinging_ball.png: the echoes of the ball alone, as a complex envelope, with one image on either leg. The line is
``2 f v / c`` exactly, sound's way there and back included, of the way by no wall.
"""

import argparse
from pathlib import Path

import numpy as np

import clsim

RATE, CARRIER, DURATION = 192e3, 40e3, 4.0
LENGTH, SWING = 1.0, 0.6  # m of the string, rad
WINDOW = 256  # samples of the envelope


def swing(t: np.ndarray) -> np.ndarray:
    """Return positions of a pendulum that hangs from the ceiling, towards the sonar and away from it."""
    angle = SWING * np.cos(np.sqrt(9.81 / LENGTH) * t)
    return np.stack([3.0 + LENGTH * np.sin(angle), 2.5 + 0.0 * t, 2.4 - LENGTH * np.cos(angle)], axis=1)


def main() -> None:
    """Render and draw."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("out"))
    folder = parser.parse_args().output
    folder.mkdir(parents=True, exist_ok=True)
    tone = clsim.Signal.tone(CARRIER, DURATION, RATE, fade=0.05)
    sonar = clsim.Source("sonar", tone, clsim.Trajectory.fixed((1.0, 2.4, 1.4)))
    ear = clsim.Receiver("ear", clsim.Trajectory.fixed((1.0, 2.6, 1.4)))
    ball = clsim.Scatterer.sphere("ball", 0.05, clsim.Trajectory.sampled(swing, DURATION + 0.1, 500.0))
    room = clsim.Shoebox((7.0, 5.0, 2.5), clsim.Material.from_reflection(0.7))
    scene = clsim.Scene(room, clsim.Air(), [sonar], [ear], scatterers=[ball])
    echoes = clsim.find_paths(scene, max_order=0, scattering_order=1, direct=False)
    heard = clsim.render(echoes, RATE, baseband=(CARRIER, 1.5e3), duration=DURATION)
    draw(heard, clsim.scatterer_truth(scene, np.linspace(0.05, DURATION - 0.05, 400)), folder / "swinging_ball.png")


def draw(heard: clsim.Recording, truth: clsim.ScattererTruth, path: Path) -> None:
    """Draw the short-time spectra of an envelope, and the shifts that are expected."""
    from matplotlib.figure import Figure

    envelope, rate = heard.pressure[0], heard.sampling_rate
    starts = np.arange(0, len(envelope) - WINDOW, WINDOW // 8)
    frames = np.stack([envelope[i : i + WINDOW] * np.hanning(WINDOW) for i in starts])
    level = 20.0 * np.log10(np.abs(np.fft.fftshift(np.fft.fft(frames, 4 * WINDOW, axis=1), axes=1)).T + 1e-12)
    shift, times = 0.5 * rate * np.array([-1.0, 1.0]), (starts[[0, -1]] + 0.5 * WINDOW) / rate
    figure = Figure(figsize=(9.0, 4.5), layout="constrained")
    axes = figure.subplots()
    image = axes.imshow(
        level - level.max(), aspect="auto", origin="lower", vmin=-60.0, vmax=0.0, extent=(*times, *shift)
    )  # fmt: skip
    line = (truth.doppler_factor[0, 0, 0] - 1.0) * CARRIER
    axes.plot(truth.times, line, color="white", linewidth=1.0, linestyle="--", label="theory, by no wall")
    axes.set(
        xlim=times,
        xlabel="time (s)",
        ylabel="Doppler shift (Hz)",
        ylim=(-800.0, 800.0),
        title="A ball on a string at 40 kHz",
    )
    axes.legend(loc="upper right")
    figure.colorbar(image, label="level (dB)")
    figure.savefig(path, dpi=110)


if __name__ == "__main__":
    main()
