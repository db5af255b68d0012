"""Positions of eight microphones from one recording of a moving beacon, beginning 5 cm off.

A wavelength at 40 kHz is 8.6 mm: a fit of the waveform that begins further off than a quarter of it stops at a wrong
cycle. So the recording and its simulation are compressed by the chirp, and compared coarse to fine: first their energy
in wide windows of time, then in narrow ones, at last the waveform itself. Each step is Gauss-Newton with the
derivatives of `clsim.sensitivities`.
"""

import argparse
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

import clsim

RATE, LENGTH, OFF = 192e3, 0.46, 0.05  # Hz, s, m
PERIOD, COUNT, SEARCHED = 0.05, 9, 2.2e-4  # s, of chirps; how many; s, about an arrival
PEAKS = 2  # steps by times of peaks
WIDTHS = (2e-5,)  # s, of the windows of energies; then the waveform
STEPS = (2, 3)  # of Gauss-Newton at each
NOISE = 0.02  # Pa, of a sample
DRAWS = 25  # recordings with noise, of eight microphones each
CHIRP = clsim.Signal.chirp(33e3, 47e3, 0.001, sampling_rate=RATE, fade=0.0003, amplitude=1.0)
BEACON = clsim.Trajectory.waypoints(
    np.linspace(0.0, 1.2, 6),
    [(1.2, 1.0, 0.6), (1.7, 1.4, 1.0), (2.3, 1.3, 1.5), (2.8, 1.8, 1.3), (3.0, 2.3, 0.9), (2.6, 2.7, 0.7)],
)
MICROPHONES = np.array(
    [
        (0.7, 0.8, 2.0), (2.5, 0.6, 1.8), (4.2, 0.8, 1.9), (4.3, 2.1, 0.9),
        (4.2, 3.3, 2.0), (2.4, 3.4, 1.8), (0.8, 3.2, 1.1), (0.6, 1.9, 1.9),
    ]
)  # fmt: skip


def paths_to(places: np.ndarray) -> clsim.PathSet:
    """Return the paths from the beacon to microphones at places (8, 3), m."""
    pulses = clsim.Signal.pulses(CHIRP, period=PERIOD, count=COUNT)
    scene = clsim.Scene(
        clsim.Shoebox((5.0, 4.0, 2.6), clsim.Material.from_reflection(0.6)), clsim.Air(),
        [clsim.Source("beacon", pulses, BEACON)],
        [clsim.Receiver(f"m{i}", clsim.Trajectory.fixed(place)) for i, place in enumerate(places)],
    )  # fmt: skip
    return clsim.find_paths(scene, max_order=1)


def heard_at(places: np.ndarray) -> np.ndarray:
    """Return the recording (8, n) of microphones at places, Pa."""
    return np.asarray(clsim.render(paths_to(places), RATE, duration=LENGTH, narrowband=False).pressure, dtype=float)


def slopes_at(places: np.ndarray) -> np.ndarray:
    """Return derivatives (8, 3, n) of each microphone's recording by its own place, Pa/m."""
    names = [f"receivers[{i}].position" for i in range(len(places))]
    found = clsim.sensitivities(paths_to(places), names, RATE, duration=LENGTH).jacobian
    return np.stack([found[3 * i : 3 * i + 3, i] for i in range(len(places))])


def compressed(rows: np.ndarray) -> np.ndarray:
    """Return analytic signals (..., n) of recordings behind the matched filter of the chirp."""
    length = rows.shape[-1] + CHIRP.count
    spectrum = np.fft.fft(rows, length) * np.conj(np.fft.fft(CHIRP.read(0, CHIRP.count), length))
    spectrum[..., length // 2 :] = 0.0
    return np.asarray(2.0 * np.fft.ifft(spectrum)[..., : rows.shape[-1]])


def smoothed(rows: np.ndarray, width: float) -> np.ndarray:
    """Return real signals (..., n) behind a Gaussian window of a standard deviation, s."""
    frequency = np.fft.rfftfreq(rows.shape[-1], 1.0 / RATE)
    gain = np.exp(-0.5 * (2.0 * np.pi * frequency * width) ** 2)
    return np.asarray(np.fft.irfft(np.fft.rfft(rows) * gain, rows.shape[-1]))


def peaks(rows: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Return the times (8, 9) at which direct arrivals peak, each near where microphones at places expect it, s."""
    level, emitted = np.abs(compressed(rows)), PERIOD * np.arange(COUNT)
    distance = np.linalg.norm(BEACON.position(emitted) - places[:, None], axis=2)
    first = np.rint((emitted + distance / clsim.Air().speed_of_sound - SEARCHED) * RATE).astype(int)
    windows = first[..., None] + np.arange(round(2.0 * SEARCHED * RATE))
    near = np.take_along_axis(level[:, None], windows, axis=2)
    top = np.clip(np.argmax(near, axis=2), 1, near.shape[2] - 2)[..., None]
    before, at, after = np.moveaxis(np.take_along_axis(near, top + np.arange(-1, 2), axis=2), 2, 0)
    return np.asarray((first + top[..., 0] + 0.5 * (before - after) / (before - 2.0 * at + after)) / RATE)


def step_by_peaks(recorded: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Return places after a step by the times of peaks, those in the simulation against those in the recording."""
    late = peaks(recorded, places) - peaks(heard_at(places), places)
    towards = places[:, None] - BEACON.position(PERIOD * np.arange(COUNT))
    towards /= np.linalg.norm(towards, axis=2, keepdims=True)
    further = clsim.Air().speed_of_sound * late
    spread = np.median(np.abs(further), axis=1, keepdims=True)
    weight = 1.0 / (1.0 + (further / (2.0 * spread + 1e-6)) ** 2)  # some peaks are those of echoes
    fits = zip(weight[..., None] * towards, weight * further, strict=True)
    return np.asarray(places + [np.linalg.lstsq(a, b, rcond=None)[0] for a, b in fits])


def step(recorded: np.ndarray, places: np.ndarray, width: float | None, slopes: np.ndarray | None = None) -> np.ndarray:
    """Return places after a step of Gauss-Newton, on energies in windows of a width, or on the waveform."""
    simulated, slopes = heard_at(places), slopes_at(places) if slopes is None else slopes
    if width is not None:
        wanted, analytic = compressed(recorded), compressed(simulated)
        slopes = smoothed(2.0 * (np.conj(analytic)[:, None] * compressed(slopes)).real, width)
        recorded, simulated = (smoothed(np.abs(a) ** 2, width) for a in (wanted, analytic))
    moved = [np.linalg.lstsq(s.T, r - y, rcond=None)[0] for s, r, y in zip(slopes, recorded, simulated, strict=True)]
    length = np.linalg.norm(moved, axis=1, keepdims=True)
    return np.asarray(places + moved * np.minimum(1.0, 0.005 / np.maximum(length, 1e-12)))


def calibrate(recorded: np.ndarray, places: np.ndarray) -> list[np.ndarray]:
    """Return the places after each step."""
    found = [places]
    for _ in range(PEAKS):
        found.append(step_by_peaks(recorded, found[-1]))
    for width, count in zip((*WIDTHS, None), STEPS, strict=True):
        for _ in range(count):
            found.append(step(recorded, found[-1], width))
    return found


def against_bound(places: np.ndarray, recorded: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return errors (draws, 8, 3) of fits to noisy recordings from places nearby, and their bounds (8, 3), m."""
    slopes, rng = slopes_at(places), np.random.default_rng(1)
    bounds = NOISE * np.sqrt([np.diag(np.linalg.inv(s @ s.T)) for s in slopes])
    errors = []
    for _ in range(DRAWS):
        noisy, found = recorded + NOISE * rng.standard_normal(recorded.shape), places
        for _ in range(2):
            found = step(noisy, found, None, slopes)
        errors.append(found - MICROPHONES)
    return np.array(errors), bounds


def main() -> None:
    """Calibrate without and with noise, and draw how the errors fall."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("out"))
    folder = parser.parse_args().output
    folder.mkdir(parents=True, exist_ok=True)
    off = np.random.default_rng(0).standard_normal(MICROPHONES.shape)
    begin = MICROPHONES + OFF * off / np.linalg.norm(off, axis=1, keepdims=True)
    recorded = heard_at(MICROPHONES)
    found = calibrate(recorded, begin)
    wrong = np.linalg.norm(np.array(found) - MICROPHONES, axis=2)
    print(f"largest error without noise: {1e3 * wrong[-1].max():.4f} mm")
    errors, bounds = against_bound(found[-1], recorded)
    ratio = np.sqrt(np.mean((errors / bounds) ** 2))
    print(f"bounds {1e3 * bounds.min():.4f} to {1e3 * bounds.max():.4f} mm; error over bound with noise: {ratio:.3f}")
    figure = Figure(figsize=(11.0, 4.0), layout="constrained")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2)
    left.semilogy(1e3 * wrong, marker=".")
    for last in PEAKS + np.cumsum((0, *STEPS[:-1])):
        left.axvline(last, color="0.8")
    left.set(xlabel="step", ylabel="error, mm", title="peaks, energies, the waveform; eight microphones")
    right.loglog(1e3 * bounds.ravel(), 1e3 * np.sqrt(np.mean(errors**2, axis=0)).ravel(), "o")
    limits = 1e3 * np.array([bounds.min(), bounds.max()])
    right.loglog(limits, limits, color="0.5")
    right.set(xlabel="bound, mm", ylabel=f"error of {DRAWS} draws, mm", title=f"with {1e3 * NOISE:g} mPa of noise")
    figure.savefig(folder / "calibrate_microphones.png", dpi=110)
    print(folder / "calibrate_microphones.png")


if __name__ == "__main__":
    main()
