"""A 40 kHz sonar and a person who walks towards it in a room: the sonogram of the echoes, with theory drawn over it.

Writes walking_person.png: the echoes of 13 ellipsoids on a walking gait, as a complex envelope, with one image on
either leg. The lines are ``2 f v / c`` exactly, sound's way there and back included, by no wall: of the chest and of
both shanks.
"""

import argparse
from pathlib import Path

import numpy as np

import clsim

RATE, CARRIER, DURATION, SPEED = 192e3, 40e3, 3.5, 1.2
WINDOW = 512  # samples of the envelope


def main() -> None:
    """Render and draw."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("out"))
    parser.add_argument("--scattering-order", type=int, default=1)
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    way = clsim.Trajectory.line((7.0, 2.4, 0.0), (7.0 - SPEED * (DURATION + 0.1), 2.6, 0.0), DURATION + 0.1)
    person = clsim.walking_person("person", 1.75, way)
    tone = clsim.Signal.tone(CARRIER, DURATION, RATE, fade=0.1)
    sonar = clsim.Source("sonar", tone, clsim.Trajectory.fixed((0.5, 2.4, 1.0)))
    ear = clsim.Receiver("ear", clsim.Trajectory.fixed((0.5, 2.6, 1.0)))
    room = clsim.Shoebox((9.0, 5.0, 2.6), clsim.Material.from_reflection(0.6))
    scene = clsim.Scene(room, clsim.Air(), [sonar], [ear], scatterers=person)
    echoes = clsim.find_paths(scene, max_order=0, scattering_order=options.scattering_order, direct=False)
    heard = clsim.render(echoes, RATE, baseband=(CARRIER, 3.6e3), duration=DURATION)
    truth = clsim.scatterer_truth(scene, np.linspace(0.1, DURATION - 0.05, 400))
    draw(heard, truth, options.output / "walking_person.png")


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
        level - level.max(), aspect="auto", origin="lower", vmin=-50.0, vmax=0.0, extent=(*times, *shift)
    )  # fmt: skip
    for name, style in (("chest", "-"), ("left shank", "--"), ("right shank", ":")):
        which = truth.scatterer_names.index(f"person {name}")
        line = (truth.doppler_factor[which, 0, 0] - 1.0) * CARRIER
        axes.plot(truth.times, line, color="white", linewidth=1.0, linestyle=style, label=f"theory, {name}")
    axes.set(
        xlim=times, xlabel="time (s)", ylabel="Doppler shift (Hz)", ylim=(-600.0, 1200.0),
        title="A person walking towards a sonar at 40 kHz",
    )  # fmt: skip
    axes.legend(loc="upper right", facecolor="0.3", labelcolor="white")
    figure.colorbar(image, label="level (dB)")
    figure.savefig(path, dpi=110)


if __name__ == "__main__":
    main()
