"""What speed makes of coded pulses: the main peak of a Kasami code's correlation against the receiver's speed.

After J. A. Paredes, T. Aguilera, F. J. Álvarez, J. Lozano, J. Morera, "Analysis of Doppler effect on the pulse
compression of different codes emitted by an ultrasonic LPS", Sensors 11(11), 10765-10784, 2011: codes of 63, 255 and
1023 chips of two cycles of 41.67 kHz, and a receiver that recedes. Across a code of N chips, the Doppler shift turns
the carrier once at c / (2 N): there the peak is gone, at 2.72, 0.67 and 0.17 m/s.

That is so of a receiver that takes the middle cycle of each chip. A filter matched to whole chips loses its peak 12 to
20 per cent later: the code is stretched, too, by a quarter of a chip at either end, where neighbours are mixed up, so
the ends, which would cancel the middle, count less. Both are drawn.
"""

import argparse
from pathlib import Path

import numpy as np
from scipy.signal import max_len_seq

import clsim
from clsim.score.ranging import MatchedFilter

RATE = 500e3
CARRIER = RATE / 12  # 41.67 kHz
CYCLES = 2  # a chip
BITS = (6, 8, 10)
PUBLISHED = (2.72, 0.67, 0.17)  # m/s, of the nulls
C = 343.0
DISTANCE = 1.0  # m, at first


def kasami(bits: int) -> np.ndarray:
    """Return a code of the small Kasami set, ``2**bits - 1`` chips of +1 and -1; bits are even."""
    sequence = max_len_seq(bits)[0].astype(int)
    decimated = sequence[(np.arange(len(sequence)) * (2 ** (bits // 2) + 1)) % len(sequence)]
    return 1.0 - 2.0 * (sequence ^ decimated)


def pulse(bits: int, share: float = 1.0) -> clsim.Signal:
    """Return a code on its carrier (BPSK), without what lies beyond 150 kHz; of each chip the middle share alone."""
    places = (np.arange(round(CYCLES * RATE / CARRIER)) + 0.5) / round(CYCLES * RATE / CARRIER)
    chip = np.sin(2.0 * np.pi * CYCLES * places) * (np.abs(places - 0.5) < 0.5 * share)
    samples = np.pad(np.kron(kasami(bits), chip), 64)
    spectrum = np.fft.rfft(samples)
    frequencies = np.fft.rfftfreq(len(samples), 1.0 / RATE)
    kept = 0.5 * (1.0 + np.cos(np.pi * np.clip((frequencies - 130e3) / 20e3, 0.0, 1.0)))
    return clsim.Signal.from_array(np.fft.irfft(spectrum * kept, len(samples)), RATE)


def peaks(bits: int, speeds: np.ndarray, share: float = 0.5) -> np.ndarray:
    """Return the correlation at the direct sound's delay (n,) of receivers that recede at speeds (n,), m/s.

    They take a share of each chip, about its middle; a receiver at rest finds 1.
    """
    code = pulse(bits)
    far, length = 20.0, code.duration + 0.05
    room = clsim.Shoebox((far, 4.0, 3.0), clsim.Material.from_reflection(0.0))
    source = clsim.Source("beacon", code, clsim.Trajectory.fixed((1.0, 2.0, 1.5)))
    start = np.array([1.0 + DISTANCE, 2.0, 1.5])
    ears = [
        clsim.Receiver(f"{v:g} m/s", clsim.Trajectory.line(start, start + np.array([v * length, 0.0, 0.0]), length))
        for v in speeds
    ]
    scene = clsim.Scene(room, clsim.Air(speed_of_sound=C, absorption=False), [source], ears)
    paths = clsim.find_paths(scene, max_order=0)
    recording = clsim.render(paths, sampling_rate=RATE, duration=code.duration + 0.02)
    output = np.abs(MatchedFilter.of(pulse(bits, share), RATE).outputs(recording.pressure))
    middle = 0.5 * code.duration
    found = []
    for r, v in enumerate(speeds):
        # The code's middle is received when c (t - middle) is the distance at t.
        late = (DISTANCE + v * middle) / (C - v)
        found.append(output[r, round(late * RATE)] * (DISTANCE + v * (middle + late)))
    return np.array(found)


def null(bits: int, share: float = 0.5) -> float:
    """Return the speed at which a code's peak is gone, m/s: where a parabola through its least squares is least."""
    speeds = C / (CYCLES * (2**bits - 1)) * np.linspace(0.9, 1.26, 9)
    level = np.square(peaks(bits, speeds, share))
    least = int(np.clip(np.argmin(level), 2, len(speeds) - 3))
    near = slice(least - 2, least + 3)
    return float(np.polynomial.Polynomial.fit(speeds[near], level[near], 2).deriv().roots()[0])


def main() -> None:
    """Draw the peaks over speed, and print where they are gone."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--output", type=Path, default=Path("out"))
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 4.3), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    for bits, published, colour in zip(BITS, PUBLISHED, ("#1f3b73", "#2a788e", "#d9a404"), strict=True):
        chips = 2**bits - 1
        speeds = np.linspace(0.0, min(4.0, 3.0 * published), 60)
        axes.plot(speeds, peaks(bits, speeds), color=colour, label=f"{chips} chips")
        axes.plot(speeds, peaks(bits, speeds, 1.0), "--", color=colour, linewidth=0.8)
        axes.axvline(published, color=colour, linestyle=":")
        print(f"{chips:>5} chips: gone at {null(bits):.3f} m/s, published {published:.2f} m/s")
        print(f"{'':>12} matched to whole chips at {null(bits, 1.0):.3f} m/s")
    axes.set(xlabel="speed of the receiver (m/s)", ylabel="peak, relative to rest", ylim=(0.0, 1.05), xlim=(0.0, 4.0))
    axes.legend()
    axes.grid(alpha=0.25, linewidth=0.6)
    axes.set_title("Correlation of Kasami codes; dashed: matched to whole chips; dotted: nulls as published")
    file = options.output / "moving_codes.png"
    figure.savefig(file, dpi=90)
    print(file)


if __name__ == "__main__":
    main()
