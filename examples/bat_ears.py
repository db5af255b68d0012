"""A horseshoe bat flies past a moth and calls at 80 kHz: the echo at its two ears, as a complex envelope.

Writes bat_ears.png: the Doppler shift of the moth's echo, and the differences of level and phase between the ears, with
theory over them. Mouth and ears fly together; the head is a rigid sphere of 7 mm radius, the moth one of 10 mm.
"""

import argparse
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

import clsim

RATE, CARRIER, DURATION, SPEED = 384e3, 80e3, 0.5, 5.0
MOTH = np.array([4.2, 2.6, 1.6])


def main() -> None:
    """Render the flight, and draw what the ears receive."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("out"))
    folder = parser.parse_args().output
    folder.mkdir(parents=True, exist_ok=True)
    start = np.array([1.0, 2.0, 1.5])
    flight = clsim.Trajectory.line(start, start + np.array([SPEED * (DURATION + 0.1), 0.0, 0.0]), DURATION + 0.1)
    ears = clsim.SphericalHead(radius=0.007, ear_azimuth=60.0)
    bat = clsim.Receiver.binaural("bat", flight, ears, aim=(1.0, 0.0, 0.0))
    call = clsim.Source("call", clsim.Signal.tone(CARRIER, DURATION, RATE, fade=0.01), flight)
    moth = clsim.Scatterer.sphere("moth", 0.01, clsim.Trajectory.fixed(MOTH))
    cave = clsim.Shoebox((6.0, 4.0, 3.0), clsim.Material.from_reflection(0.3))
    scene = clsim.Scene(cave, clsim.Air(), [call], [bat], scatterers=[moth])
    paths = clsim.find_paths(scene, max_order=0, scattering_order=0, direct=False)
    heard = clsim.render(paths, RATE, baseband=(CARRIER, 8e3), duration=DURATION)
    print("\n".join(heard.notes))
    draw(heard, flight, ears, scene.air.speed_of_sound, folder / "bat_ears.png")
    print(folder / "bat_ears.png")


def draw(heard: clsim.Recording, flight: clsim.Trajectory, ears: clsim.SphericalHead, c: float, path: Path) -> None:
    """Draw shifts, levels and phases over time."""
    every = 32
    left, right = heard.samples[:, ::every]
    times = np.arange(len(left)) * every / heard.sampling_rate
    loud = (times > 0.04) & (times < DURATION - 0.02)
    phase = np.unwrap(np.angle(heard.samples[0].astype(complex)))[::every]
    shift = np.gradient(phase, times) / (2.0 * np.pi)
    away = MOTH - flight.position(times)
    unit = away / np.linalg.norm(away, axis=1)[:, None]
    sent = times
    for _ in range(5):  # the way to the moth began at the time of the call
        sent = times - (np.linalg.norm(away, axis=1) + np.linalg.norm(MOTH - flight.position(sent), axis=1)) / c
    there = MOTH - flight.position(sent)
    mach = SPEED / c * there[:, 0] / np.linalg.norm(there, axis=1)
    frequency = CARRIER * (1.0 + SPEED / c * unit[:, 0]) / (1.0 - mach)
    gain = ears.gain_towards(unit, frequency, c)
    figure = Figure(figsize=(13.0, 3.8), layout="constrained")
    FigureCanvasAgg(figure)
    ratio = left[loud] / right[loud]
    theory = gain[loud, 0] / gain[loud, 1]
    off = np.degrees(np.angle(ratio / theory))  # of the phase, without whole turns
    found = shift[loud], 20.0 * np.log10(np.abs(ratio)), np.degrees(np.angle(theory)) + off
    expected = frequency[loud] - CARRIER, 20.0 * np.log10(np.abs(theory)), np.degrees(np.angle(theory))
    titles = "Doppler shift of the echo (Hz)", "left over right ear (dB)", "left before right ear (degrees)"
    for axis, values, line, title in zip(figure.subplots(1, 3), found, expected, titles, strict=True):
        axis.plot(times[loud], values, label="rendered")
        axis.plot(times[loud], line, "--", label="theory")
        axis.set(xlabel="time (s)", title=title)
        axis.legend()
        print(f"{title}: largest difference {np.abs(values - line).max():.3g}")
    figure.savefig(path, dpi=110)


if __name__ == "__main__":
    main()
