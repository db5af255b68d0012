"""A phone that sends chirps from 17 to 23 kHz, and a hand 20 to 40 cm before it: range profiles, phase against truth.

Writes phone_hand.png: above what comes back by range and time, with what never changes taken away (the leak past the
phone's body, 20 dB below the direct sound, and the walls), below the way there and back by the phase of the strongest
echo and the true one by the palm, and by how much they differ. The hand comes nearer, closes to a fist, opens and
goes away again.

Last, the level of the echo over that of a large mirror: of this hand of an ellipsoid and capsules, and of a flat one, a
hard plate of 9 by 18 cm as a moving body with its edges. As the plate moves, its edges come into phase with its middle
and out again: the ripple of Fresnel zones, with theory drawn over it.
"""

import argparse
from pathlib import Path

import numpy as np

import clsim

RATE, DURATION, PERIOD = 96e3, 2.0, 5e-3  # Hz, s, s
CENTRE = 20e3  # Hz
ERROR_DB = -70.0  # of responses, less than what matters here
NEAREST, FARTHEST = 0.2, 0.4  # m
FLAT = (0.09, 0.18)  # sides of the flat hand, m


def reach(t: np.ndarray) -> np.ndarray:
    """Return positions of the palm (n, 3), m: from far to near and back."""
    away = FARTHEST - (FARTHEST - NEAREST) * np.sin(np.pi * t / (DURATION + 0.1)) ** 2
    return np.stack([1.0 + away, 2.0 + 0.0 * t, 1.2 + 0.0 * t], axis=1)


def scene_of() -> tuple[clsim.Scene, clsim.Signal]:
    """Return the phone and the hand in a room, and one chirp."""
    t = np.linspace(0.0, DURATION + 0.1, 400)
    facing = np.tile([0.0, 0.0, 1.0, 0.0], (len(t), 1))  # the palm looks back along x
    way = clsim.Trajectory.waypoints(t, reach(t), facing)
    # Nothing is behind the hand: shadows would only cost time.
    hand = clsim.hand("hand", way, opening=[(0.7, 1.0), (1.0, 0.3), (1.1, 0.3), (1.4, 1.0)], shadow=False)
    chirp = clsim.Signal.chirp(17e3, 23e3, PERIOD, RATE, window="tukey")
    train = clsim.Signal.pulses(chirp, PERIOD, round(DURATION / PERIOD))
    phone = clsim.Source("speaker", train, clsim.Trajectory.fixed((1.0, 1.99, 1.2)))
    microphone = clsim.Receiver("microphone", clsim.Trajectory.fixed((1.0, 2.01, 1.2)))
    room = clsim.Shoebox((4.0, 3.5, 2.5), clsim.Material.from_reflection(0.7))
    return clsim.Scene(room, clsim.Air(), [phone], [microphone], scatterers=hand), chirp


def flat_scene(scene: clsim.Scene) -> clsim.Scene:
    """Return the same with a flat hand, which faces the phone all the time."""
    t = np.linspace(0.0, DURATION + 0.1, 400)
    way = clsim.Trajectory.waypoints(t, reach(t))
    plate = clsim.Body.box("flat hand", (0.0, *FLAT), clsim.Material.from_reflection(1.0), way)
    return clsim.Scene(scene.room, scene.air, list(scene.sources), list(scene.receivers), bodies=[plate])


def ripple(way: np.ndarray, c: float) -> np.ndarray:
    """Return the echo of the flat hand over that of a large mirror by the way there and back, (n,) m.

    Kirchhoff's integral over the plate by Fresnel integrals, (1 - j) (C + j S) of either side, at the mean of the band.
    """
    from scipy.special import fresnel

    wave = 2.0 * np.pi * np.linspace(17e3, 23e3, 61)[:, None] / c
    total = np.ones((len(wave), len(way)), dtype=complex)
    for side in FLAT:
        sine, cosine = fresnel(0.5 * side * np.sqrt(4.0 * wave / (np.pi * way)))
        total *= (1.0 + 1j) * (cosine - 1j * sine)
    return np.asarray(np.abs(total.mean(axis=0)))


def profiles(heard: np.ndarray, chirp: clsim.Signal, count: int) -> np.ndarray:
    """Return the matched filter's output (chirps, lags), without its carrier: its phase is that of the way."""
    from scipy.signal import hilbert

    pulse, step = chirp.read(0, chirp.count), round(PERIOD * RATE)
    rows = np.stack([heard[i * step : (i + 1) * step] for i in range(count)])
    size = 2 * step
    found = np.fft.ifft(np.fft.fft(hilbert(rows, axis=1), size) * np.fft.fft(hilbert(pulse), size).conj(), axis=1)
    lags = np.arange(step)
    return np.asarray((found[:, lags] + found[:, lags - step]) * np.exp(-2j * np.pi * CENTRE * lags / RATE))


def main() -> None:
    """Render, find the way out of the phase, and draw."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("out"))
    folder = parser.parse_args().output
    folder.mkdir(parents=True, exist_ok=True)
    scene, chirp = scene_of()
    times, c = (np.arange(round(DURATION / PERIOD)) + 0.5) * PERIOD, scene.air.speed_of_sound
    truth = clsim.scatterer_truth(scene, times)
    palm = c * truth.delay[truth.scatterer_names.index("hand palm"), 0, 0]
    flat = 2.0 * np.hypot(reach(times)[:, 0] - 1.0, 0.01)
    levels, shown = [], []
    for kind, way, options in ((scene, palm, {}), (flat_scene(scene), flat, {"diffraction": 1})):
        paths = clsim.find_paths(kind, max_order=1, direct=-20.0, **options)
        output = profiles(
            clsim.render(paths, RATE, duration=DURATION, response_error_db=ERROR_DB).pressure[0], chirp, len(times)
        )
        moving = np.abs(output - output.mean(axis=0))
        ranges = np.arange(output.shape[1]) / RATE * c / 2.0
        near = np.flatnonzero((ranges > 0.12) & (ranges < 0.5))
        peak = near[np.argmax(moving[:, near], axis=1)]
        sent = 2.0 * np.sum(chirp.read(0, chirp.count) ** 2)  # that of analytic signals
        levels.append((way, moving.max(axis=1, initial=0.0, where=(ranges > 0.12) & (ranges < 0.5)) / sent * way))
        shown.append((output - output.mean(axis=0), peak))
    moving, peak = shown[0]
    phase = np.unwrap(np.angle(moving[np.arange(len(moving)), peak]))
    way = -phase * c / (2.0 * np.pi * CENTRE)
    way += np.median(palm - way)  # a phase tells no whole waves
    error = 1e3 * (way - palm)
    expected = ripple(flat, c)
    off = 20.0 * np.log10(levels[1][1] / expected)[1:]  # the first echo is not whole
    print(
        f"way by phase less the true way: {np.sqrt(np.mean(error**2)):.2f} mm rms, {np.abs(error).max():.2f} mm at most"
    )
    print(
        f"echo of the flat hand less theory: {np.sqrt(np.mean(off**2)):.2f} dB rms, {np.abs(off).max():.2f} dB at most"
    )
    draw(
        np.abs(moving), (times, ranges), (way, palm), (levels[0][1], levels[1][1], expected), folder / "phone_hand.png"
    )


def draw(
    level: np.ndarray, axes_of: tuple[np.ndarray, np.ndarray], ways: tuple[np.ndarray, np.ndarray],
    over_mirror: tuple[np.ndarray, np.ndarray, np.ndarray], path: Path,
) -> None:  # fmt: skip
    """Draw the profiles, both ways, and levels of the hand, the flat one and theory over a mirror's."""
    from matplotlib.figure import Figure

    times, ranges = axes_of
    decibels = 20.0 * np.log10(level.T / level.max() + 1e-9)
    figure = Figure(figsize=(9.0, 10.0), layout="constrained")
    above, below, between, lowest = figure.subplots(4, 1, sharex=True, height_ratios=(6, 4, 3, 4))
    image = above.imshow(
        decibels, aspect="auto", origin="lower", vmin=-40.0, vmax=0.0, extent=(0.0, DURATION, ranges[0], ranges[-1])
    )  # fmt: skip
    above.plot(times, 0.5 * ways[1], color="white", linewidth=1.0, linestyle="--", label="palm, true")
    above.set(ylim=(0.0, 0.8), ylabel="range (m)", title="A hand before a phone: chirps from 17 to 23 kHz")
    above.legend(loc="upper right", facecolor="0.3", labelcolor="white")
    figure.colorbar(image, ax=above, label="level (dB)")
    below.plot(times, 1e2 * ways[1], color="black", linewidth=1.0, linestyle="--", label="palm, true")
    below.plot(times, 1e2 * ways[0], color="#c1272d", linewidth=1.0, label="by the phase")
    below.set(ylabel="way there and back (cm)")
    between.plot(times, 1e3 * (ways[0] - ways[1]), color="#c1272d", linewidth=1.0)
    between.set(ylabel="difference (mm)")
    lines = (("hand", "#c1272d", "-"), ("flat hand", "#0066aa", "-"), ("flat hand, theory", "black", "--"))
    for echo, (label, color, style) in zip(over_mirror, lines, strict=True):
        lowest.plot(times, 20.0 * np.log10(echo), color=color, linewidth=1.0, linestyle=style, label=label)
    lowest.set(xlabel="time (s)", ylabel="echo over a mirror's (dB)", ylim=(-24.0, 6.0))
    lowest.legend(loc="lower center", ncols=3)
    below.legend(loc="upper center")
    figure.savefig(path, dpi=110)


if __name__ == "__main__":
    main()
