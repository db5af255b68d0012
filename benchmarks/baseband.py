"""Complex baseband against passband: whole renderings of the same scenes, in turn, in one run. Writes baseband.md."""

import math
import statistics
import time
from pathlib import Path

import numpy as np
from scipy.signal import firwin, kaiserord, oaconvolve

import clsim
from clsim.render.plan import Plan
from clsim.render.planning import plan_render
from clsim.render.render import render_chunks

RATE, ORDER, DURATION, CARRIER = 192e3, 10, 20.0, 40e3


def scene(signal: clsim.Signal, trajectory: clsim.Trajectory) -> clsim.Scene:
    """Return a room with one source and one receiver."""
    source = clsim.Source("s", signal, trajectory)
    room = clsim.Shoebox((8.0, 6.0, 3.0), clsim.Material.from_reflection(0.9))
    return clsim.Scene(room, clsim.Air(), [source], [clsim.Receiver("r", clsim.Trajectory.fixed((1.0, 1.0, 2.9)))])


def shaking(amplitude: float, frequency: float) -> clsim.Trajectory:
    """Return the motion of a beacon that circles at 1 m/s and shakes."""

    def position(t: np.ndarray) -> np.ndarray:
        ring = np.stack([4.0 + np.cos(t), 3.0 + np.sin(t), np.full_like(t, 1.5)], axis=1)
        return ring + amplitude * np.sin(2 * math.pi * frequency * t)[:, None] * np.array([0.6, 0.64, 0.48])

    return clsim.Trajectory.sampled(position, DURATION, 2000.0)


def scenes() -> dict[str, tuple[clsim.Scene, float]]:
    """Return scenes and bandwidths by name; the bandwidths hold signals and Doppler shifts and little more."""
    chirp = clsim.Signal.chirp(39e3, 41e3, DURATION, RATE, window="tukey")
    tone = clsim.Signal.tone(CARRIER, DURATION, RATE, fade=0.05)
    slow = clsim.Trajectory.circle((4.0, 3.0, 1.5), 1.0, 2 * math.pi, DURATION)
    fast = clsim.Trajectory.circle((4.0, 3.0, 1.5), 1.0, 2 * math.pi / 6.0, DURATION)
    return {
        "39 to 41 kHz chirp, 1 m/s": (scene(chirp, slow), 2.4e3),
        "39 to 41 kHz chirp, 6 m/s": (scene(chirp, fast), 3.8e3),
        "40 kHz beacon, 1 m/s and 10 mm at 2 Hz": (scene(tone, shaking(0.01, 2.0)), 1e3),
        "40 kHz beacon, 1 m/s and 1 mm at 25 Hz": (scene(tone, shaking(0.001, 25.0)), 1e3),
    }


def rendered(plan: Plan) -> tuple[float, np.ndarray]:
    """Return the processor time that a plan takes on all cores, s, and the samples (n,).

    Others on the machine do not count.
    """
    begun = time.process_time()
    pieces = [piece[0] for _, piece in render_chunks(plan)]
    return time.process_time() - begun, np.concatenate(pieces)


def planned(*arguments: object, **options: object) -> tuple[float, Plan]:
    """Return the processor time of planning, s, and the plan."""
    begun = time.process_time()
    plan = plan_render(*arguments, duration=DURATION, **options)  # type: ignore[arg-type]
    return time.process_time() - begun, plan


def mixed_down(sound: np.ndarray, every: int, half: float) -> np.ndarray:
    """Return the sound (n,) mixed with exp(-2 pi j carrier t), low-passed from `half` Hz on, every so many samples."""
    turned = 2.0 * sound * np.exp(-2j * np.pi * (np.arange(len(sound)) * CARRIER / RATE % 1.0))
    stop = RATE / every - half
    length, beta = kaiserord(115.0, (stop - half) / (0.5 * RATE))
    low_pass = firwin(length + 1 - length % 2, 0.5 * (half + stop), window=("kaiser", beta), fs=RATE)
    return oaconvolve(turned, low_pass, mode="same")[::every]


def row(name: str, one: clsim.Scene, bandwidth: float) -> str:
    """Return a scene's row of the table."""
    paths = clsim.find_paths(one, ORDER)
    planning, plans = zip(
        planned(one, paths, RATE), planned(one, paths, RATE, baseband=(CARRIER, bandwidth)), strict=True
    )
    envelope = plans[1]
    first = [rendered(plan) for plan in plans]
    runs = [[rendered(plan)[0] for plan in plans] for _ in range(3)]
    spent = [statistics.median(run[i] for run in runs) for i in (0, 1)]
    ratio = statistics.median(a / b for a, b in runs)
    whole = [a + b for a, b in zip(planning, (taken for taken, _ in first), strict=True)]
    every = round(RATE / envelope.sampling_rate)
    wanted = mixed_down(first[0][1].astype(float), every, 0.5 * bandwidth)
    inside = slice(0, -round(0.1 * envelope.sampling_rate))  # the low-pass of this file reaches beyond the end
    apart_db = 20.0 * np.log10(np.linalg.norm((first[1][1] - wanted)[inside]) / np.linalg.norm(wanted[inside]))
    built = [max(taken - usual, 0.0) for (taken, _), usual in zip(first, spent, strict=True)]
    return (
        f"| {name} | {len(envelope.emissions[0].basis)} | {envelope.sampling_rate:g} Hz | {spent[0]:.2f} s | "
        f"{spent[1]:.2f} s | {ratio:.1f} | {planning[0]:.2f}, {planning[1]:.2f} s | {built[0]:.2f}, {built[1]:.2f} s | "
        f"{whole[0] / whole[1]:.1f} | {apart_db:.0f} dB |\n"
    )


def main() -> None:
    """Measure, print, and write baseband.md."""
    text = (
        "| scene | functions | rate | passband | baseband | ratio | planning | building kernels | ratio with both | "
        "apart |\n" + "|---" * 10 + "|\n"
    )
    for name, (one, bandwidth) in scenes().items():
        text += row(name, one, bandwidth)
        print(text.splitlines()[-1], flush=True)
    (Path(__file__).parent / "baseband.md").write_text(text)


if __name__ == "__main__":
    main()
