"""A person walks through the line between a beacon and a receiver: level and error of the range over time.

Writes person_between.png: the level of the strongest arrival over that without the person, and the range it gives less
the true one, in free air and over a hard floor. The beacon sends chirps of 38 to 42 kHz, 1 m above the floor, 4 m from
the receiver; the person crosses at 1.2 m/s in the middle. A matched filter finds the strongest arrival, as a receiver
does. In free air what bends round the body is late by the way round it; over the floor its echo, past the legs, can be
the louder one.
"""

import argparse
from pathlib import Path

import numpy as np

import clsim

RATE, DURATION, PERIOD = 192e3, 0.9, 25e-3  # Hz, s, s
PULSE, SPEED = 4e-3, 1.2  # s, m/s
ERROR_DB = -50.0  # of responses: less than what matters here, and quicker than the default
BEACON, EAR = np.array([1.0, 2.5, 1.0]), np.array([5.0, 2.5, 1.0])


def chirp() -> clsim.Signal:
    """Return one chirp."""
    return clsim.Signal.chirp(38e3, 42e3, PULSE, RATE, window="hann")


def scene_of(floor: float, person: bool) -> clsim.Scene:
    """Return beacon and receiver over a floor with that reflection factor, with or without the person."""
    silent = clsim.Material.from_reflection(0.0)
    walls = [silent] * 4 + [clsim.Material.from_reflection(floor), silent]
    train = clsim.Signal.pulses(chirp(), PERIOD, round(DURATION / PERIOD))
    half = 0.5 * SPEED * DURATION
    way = clsim.Trajectory.line((3.0, 2.5 - half, 0.0), (3.0, 2.5 + half + 0.1, 0.0), DURATION + 0.1 / SPEED)
    return clsim.Scene(
        clsim.Shoebox((6.0, 5.0, 2.6), walls), clsim.Air(),
        [clsim.Source("beacon", train, clsim.Trajectory.fixed(BEACON))],
        [clsim.Receiver("ear", clsim.Trajectory.fixed(EAR))],
        scatterers=clsim.walking_person("person", 1.75, way) if person else (),
    )  # fmt: skip


def arrivals(heard: np.ndarray, c: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the range (n,), m, of each chirp's strongest arrival, and its level (n,), Pa."""
    from scipy.signal import hilbert

    pulse, step = chirp().read(0, chirp().count), round(PERIOD * RATE)
    rows = np.stack([heard[begin : begin + step] for begin in range(0, len(heard) - step + 1, step)])
    output = np.abs(hilbert(np.stack([np.correlate(row, pulse, "full")[len(pulse) - 1 :] for row in rows]), axis=1))
    peak, row = output.argmax(axis=1), np.arange(len(rows))
    before, at, behind = (output[row, peak + i] for i in (-1, 0, 1))
    part = 0.5 * (before - behind) / (before - 2.0 * at + behind)  # of a parabola through three samples
    return (peak + part) / RATE * c, at / (pulse @ pulse)


def main() -> None:
    """Render with and without the person, and draw."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("out"))
    folder = parser.parse_args().output
    folder.mkdir(parents=True, exist_ok=True)
    results = {}
    for name, floor, order in (("free air", 0.0, 0), ("over a hard floor", 0.95, 1)):
        found = []
        for person in (False, True):
            scene = scene_of(floor, person)
            paths = clsim.find_paths(scene, max_order=order, scattering_order=order)
            pressure = clsim.render(paths, RATE, duration=DURATION, response_error_db=ERROR_DB).pressure[0]
            found.append(arrivals(pressure, scene.air.speed_of_sound))
        (_, alone), (ranges, level) = found
        error, loss = ranges - np.linalg.norm(EAR - BEACON), 20.0 * np.log10(level / alone)
        results[name] = error, loss
        print(f"{name}: {loss.min():.1f} dB at least, the range wrong by {1e3 * np.abs(error).max():.0f} mm at most")
    draw(results, folder / "person_between.png")


def draw(results: dict[str, tuple[np.ndarray, np.ndarray]], path: Path) -> None:
    """Draw levels and errors of the range over where the person is."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 6.5), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True)
    for (name, (error, loss)), color in zip(results.items(), ("black", "#c1272d"), strict=True):
        place = 1e2 * SPEED * ((np.arange(len(loss))) * PERIOD + np.linalg.norm(EAR - BEACON) / 686.0 - 0.5 * DURATION)
        above.plot(place, loss, "o-", markersize=3, linewidth=1.0, color=color, label=name)
        below.plot(place, 1e3 * error, "o-", markersize=3, linewidth=1.0, color=color)
    above.set(ylabel="level over that without (dB)", title="A person crosses the line from a beacon to a receiver")
    above.legend(loc="lower left")
    below.set(xlabel="person beside the line (cm)", ylabel="error of the range (mm)")
    below.set_yscale("symlog", linthresh=10.0)
    for axes in (above, below):
        axes.axvspan(-20.0, 20.0, color="0.92", zorder=0)
        axes.grid(alpha=0.3)
    figure.savefig(path, dpi=110)


if __name__ == "__main__":
    main()
