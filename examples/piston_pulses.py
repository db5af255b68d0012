"""What a piston makes of a chirp off its axis: where the correlation's peak leaves the true time.

After R. Carotenuto, M. Merenda, D. Iero, F. G. Della Corte, "Simulating signal aberration and ranging error for
ultrasonic indoor positioning", Sensors 20(12), 3548, 2020, figure 3: a chirp from 30 to 50 kHz, circular pistons of 25,
20, 16, 13.1, 8.5 and 6 mm across, and receivers on a semicircle of 1 m. A piston that has a null within the band at
some angle splits the chirp there: on one side of the null it is turned upside down. Of the four largest, the peak is
off by more than a centimetre at some angles, as published.
"""

import argparse
from pathlib import Path

import numpy as np

import clsim

RATE = 500e3
C = 343.0
DIAMETERS = (25.0, 20.0, 16.0, 13.1, 8.5, 6.0)  # mm
ANGLES = np.arange(0.0, 91.0, 5.0)  # degrees off the axis; the other side is the same
RADIUS = 1.0  # m


def errors(diameter: float) -> np.ndarray:
    """Return errors of the range (angles,) by a piston so many millimetres across, m."""
    chirp = clsim.Signal.chirp(30e3, 50e3, 5e-3, RATE, window="tukey")
    room = clsim.Shoebox((6.0, 6.0, 4.0), clsim.Material.from_reflection(0.0))
    places = np.stack([np.cos(np.deg2rad(ANGLES)), np.sin(np.deg2rad(ANGLES)), np.zeros(len(ANGLES))], axis=1)
    ears = [
        clsim.Receiver(f"{angle:g} degrees", clsim.Trajectory.fixed(np.array([3.0, 3.0, 2.0]) + RADIUS * place))
        for angle, place in zip(ANGLES, places, strict=True)
    ]
    piston = clsim.Piston(0.5e-3 * diameter)
    source = clsim.Source("piston", chirp, clsim.Trajectory.fixed((3.0, 3.0, 2.0)), directivity=piston, aim=(1, 0, 0))
    scene = clsim.Scene(room, clsim.Air(speed_of_sound=C), [source], ears)
    recording = clsim.render(clsim.find_paths(scene, max_order=0), sampling_rate=RATE, duration=0.012)
    return clsim.score.ranging(recording, chirp).error[:, 0]


def main() -> None:
    """Draw the errors over the angle."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("out"))
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 6.5), layout="constrained")
    FigureCanvasAgg(figure)
    for axes, diameter in zip(figure.subplots(3, 2, sharex=True, sharey=True).ravel(), DIAMETERS, strict=True):
        error = 1e3 * errors(diameter)
        axes.plot(ANGLES, error, "o-", markersize=3.0, linewidth=0.8)
        axes.set(title=f"{diameter:g} mm", ylim=(-16.0, 16.0))
        axes.grid(alpha=0.25, linewidth=0.6)
        print(f"{diameter:>5} mm: at most {np.abs(error).max():.3f} mm off")
    figure.supxlabel("angle off the axis (degrees)")
    figure.supylabel("error of the range (mm)")
    file = options.output / "piston_pulses.png"
    figure.savefig(file, dpi=80)
    print(file)


if __name__ == "__main__":
    main()
