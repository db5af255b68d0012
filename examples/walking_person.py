"""A 40 kHz sonar and a person who walks towards it in a room: sonogram and range-Doppler map, with theory over them.

Writes walking_person.png: the echoes of 13 ellipsoids on a walking gait, as a complex envelope, with one image on
either leg. The lines are ``2 f v / c`` exactly, sound's way there and back included, by no wall: of the chest and of
both shanks. And walking_person_map.png: ranges and speeds of all parts within 0.12 s. Pulses that leave time for 8 m
tell speeds but for multiples of 9 cm/s, so the sonar sends noise of 32 to 48 kHz, and what is heard is
compared with what was sent, late by every range and stretched by every speed. In it stand the parts, and, from the path
table, the loudest of their images by a wall on one leg or on either.
"""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

import clsim

RATE, CARRIER, DURATION, SPEED = 192e3, 40e3, 3.5, 1.2
WINDOW = 512  # samples of the envelope
FAINT = 16.0  # dB below the loudest way, above which images are marked
LOOK, BETWEEN, SEEDS = 1.6, 0.12, 6  # s: about when and how long the map is looked at; of so many noises
EVERY = 4  # samples: the noise's envelope needs no more


def main() -> None:
    """Render and draw."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("out"))
    parser.add_argument("--scattering-order", type=int, default=1)
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    from scipy.signal.windows import tukey

    scene = scene_of(clsim.Signal.tone(CARRIER, DURATION, RATE, fade=0.1))
    echoes = clsim.find_paths(scene, max_order=0, scattering_order=options.scattering_order, direct=False)
    heard = clsim.render(echoes, RATE, baseband=(CARRIER, 3.6e3), duration=DURATION)
    truth = clsim.scatterer_truth(scene, np.linspace(0.1, DURATION - 0.05, 400))
    draw(heard, truth, options.output / "walking_person.png")
    sent, heard = [], []
    for seed in range(SEEDS):  # what one noise takes for another range goes down with their number
        noise = clsim.Signal.noise(2.0 * BETWEEN, RATE, seed=seed, band=(32e3, 48e3))
        faded = noise.read(0, noise.count) * tukey(noise.count, 0.1)
        noise = clsim.Signal.from_array(faded, RATE)
        scene = replace(scene, sources=[sonar(noise, LOOK - 1.4 * BETWEEN)])
        echoes = clsim.find_paths(scene, max_order=0, scattering_order=options.scattering_order, direct=False)
        heard.append(clsim.render(echoes, RATE, duration=LOOK + 0.6 * BETWEEN).pressure[0])
        sent.append(np.zeros(len(heard[0])))
        first, values = round((LOOK - 1.4 * BETWEEN) * RATE), faded
        sent[-1][first : first + len(values)] = values[: len(heard[0]) - first]
    draw_map(echoes, heard, sent, options.output / "walking_person_map.png")


def sonar(signal: clsim.Signal, start: float = 0.0) -> clsim.Source:
    """Return a source that emits a signal from a time on, s."""
    return clsim.Source("sonar", signal, clsim.Trajectory.fixed((0.5, 2.4, 1.0)), start=start)


def scene_of(signal: clsim.Signal) -> clsim.Scene:
    """Return the person before a sonar that sends a signal."""
    way = clsim.Trajectory.line((7.0, 2.4, 0.0), (7.0 - SPEED * (DURATION + 0.1), 2.6, 0.0), DURATION + 0.1)
    ear = clsim.Receiver("ear", clsim.Trajectory.fixed((0.5, 2.6, 1.0)))
    room = clsim.Shoebox((9.0, 5.0, 2.6), clsim.Material.from_reflection(0.6))
    person = clsim.walking_person("person", 1.75, way)
    return clsim.Scene(room, clsim.Air(), [sonar(signal)], [ear], scatterers=person)


def range_speed_map(
    heard: list[np.ndarray], sent: list[np.ndarray], speeds: np.ndarray, latest: float, c: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return ranges (n,), m, and the magnitude (speeds, n) of filters that are matched to every speed, about `LOOK`."""
    from scipy.signal import hilbert

    middle, half, late = round(LOOK * RATE), round(0.5 * BETWEEN * RATE / EVERY), round(latest * RATE / EVERY)
    size = 2 ** int(np.ceil(np.log2(2 * half + late)))
    ranges, ago = np.arange(late) * EVERY / RATE * c / 2.0, EVERY * np.arange(-half - late, half)
    both = np.zeros((len(speeds), late), dtype=complex)
    for echo, noise in zip(heard, sent, strict=True):
        count = np.arange(len(noise))
        carrier = np.exp(-2j * np.pi * CARRIER * (count - middle) / RATE)
        envelope = hilbert(noise) * carrier
        part = (hilbert(echo) * carrier)[middle - EVERY * half : middle + EVERY * half : EVERY]
        part = np.fft.fft(part * np.hanning(2 * half), size)
        for row, speed in enumerate(speeds):  # `ago`: samples from the middle at which what is heard now was sent
            shift = -2.0 * speed / c * ago
            copy = np.interp(middle + ago + shift, count, envelope) * np.exp(2j * np.pi * CARRIER * shift / RATE)
            found = np.fft.ifft(part * np.fft.fft(copy[::-1].conj(), size))
            both[row] += found[2 * half - 1 : 2 * half - 1 + late]  # its lag k: sent late + half - 1 - k before
    lags = [np.interp(ranges, (1.0 - 2.0 * v / c) * ranges, x) for v, x in zip(speeds, np.abs(both), strict=True)]
    return ranges, np.array(lags)  # by the lag of what was sent


def strongest_images(paths: clsim.PathSet) -> list[tuple[tuple[np.ndarray, np.ndarray], str, str]]:
    """Return ranges and speeds about `LOOK` of what is loud by one wall and by two, with markers and names."""
    table, c = paths.table(np.linspace(LOOK - 0.5 * BETWEEN, LOOK + 0.5 * BETWEEN, 9)), paths.scene.air.speed_of_sound
    level = np.abs(table.gain).mean(axis=1)
    loud, found = level > 10.0 ** (-FAINT / 20.0) * level.max(), []
    for walls, marker in ((1, "s"), (2, "^")):
        rows = np.flatnonzero(loud & (table.order == walls + 1))
        delay, speed = table.delay[rows].mean(axis=1), 0.5 * c * (1.0 - table.doppler_factor[rows].mean(axis=1))
        found.append(((0.5 * c * delay, speed), marker, f"theory, by {walls} wall{'s' * (walls > 1)}"))
    return found


def draw_map(paths: clsim.PathSet, heard: list[np.ndarray], sent: list[np.ndarray], path: Path) -> None:
    """Draw the range-Doppler map of what is heard, and where every part and its loud images are expected."""
    from matplotlib.figure import Figure

    c, speeds, truth = (
        paths.scene.air.speed_of_sound,
        np.linspace(-2.5, 0.5, 121),
        clsim.scatterer_truth(paths.scene, [LOOK]),
    )
    ranges, output = range_speed_map(heard, sent, speeds, 0.05, c)
    level = 20.0 * np.log10(output + 1e-30)
    figure = Figure(figsize=(9.0, 4.5), layout="constrained")
    axes = figure.subplots()
    image = axes.imshow(
        level - level.max(), aspect="auto", origin="lower", vmin=-20.0, vmax=0.0, interpolation="nearest",
        extent=(ranges[0], ranges[-1], speeds[0], speeds[-1]),
    )  # fmt: skip
    at = 0.5 * c * truth.delay[:, 0, 0, 0], truth.radial_speed[:, 0, 0, 0]
    axes.plot(*at, "o", markerfacecolor="none", color="white", label="theory, each part")
    for part, aside in (("chest", (-44, 2)), ("left shank", (10, -12)), ("right shank", (10, -4))):
        which = truth.scatterer_names.index(f"person {part}")
        axes.annotate(part, (at[0][which], at[1][which]), aside, textcoords="offset points", color="white")
    for ways, marker, name in strongest_images(paths):
        axes.plot(*ways, marker, markerfacecolor="none", color="white", label=name)
    axes.set(
        xlim=(4.2, 5.8), ylim=(-2.5, 0.5), xlabel="range (m)", ylabel="speed at which it grows (m/s)",
        title=f"A person walking towards a sonar at 40 kHz, within {1e3 * BETWEEN:g} ms",
    )  # fmt: skip
    axes.legend(loc="upper right", facecolor="0.3", labelcolor="white")
    figure.colorbar(image, label="level (dB)")
    figure.savefig(path, dpi=110)


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
