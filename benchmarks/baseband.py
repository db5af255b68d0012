"""Complex baseband against passband: whole renderings of the same scenes, in turn, in one run. Writes baseband.md."""

import math
import statistics
import time
from pathlib import Path

import numpy as np

import clsim
from clsim.render.plan import plan_render
from clsim.render.render import render_chunks

RATE, ORDER, DURATION = 192e3, 10, 30.0


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
    """Return scenes and bandwidths by name."""
    chirp = clsim.Signal.chirp(39e3, 41e3, DURATION, RATE, window="tukey")
    tone = clsim.Signal.tone(40e3, DURATION, RATE, fade=0.05)
    slow = clsim.Trajectory.circle((4.0, 3.0, 1.5), 1.0, 2 * math.pi, DURATION)
    fast = clsim.Trajectory.circle((4.0, 3.0, 1.5), 1.0, 2 * math.pi / 6.0, DURATION)
    return {
        "39 to 41 kHz chirp, 1 m/s": (scene(chirp, slow), 2.4e3),
        "39 to 41 kHz chirp, 6 m/s": (scene(chirp, fast), 3.8e3),
        "40 kHz beacon, 1 m/s and 10 mm at 2 Hz": (scene(tone, shaking(0.01, 2.0)), 1e3),
        "40 kHz beacon, 1 m/s and 1 mm at 25 Hz": (scene(tone, shaking(0.001, 25.0)), 1e3),
    }


def seconds(plan: object) -> float:
    """Return the processor time that a plan takes on all cores, kernels built: others on the machine do not count."""
    begun = time.process_time()
    for _ in render_chunks(plan):
        pass
    return time.process_time() - begun


def main() -> None:
    """Measure, print, and write baseband.md."""
    text = "| scene | functions | passband | baseband | ratio | with planning |\n|---|---|---|---|---|---|\n"
    for name, (one, bandwidth) in scenes().items():
        paths = clsim.find_paths(one, ORDER)
        begun = time.process_time()
        sound = plan_render(one, paths, RATE, duration=DURATION)
        planned = time.process_time()
        envelope = plan_render(one, paths, RATE, duration=DURATION, baseband=(40e3, bandwidth))
        planning = (planned - begun, time.process_time() - planned)
        seconds(sound), seconds(envelope)
        runs = [(seconds(sound), seconds(envelope)) for _ in range(5)]
        spent = [statistics.median(run[i] for run in runs) for i in (0, 1)]
        ratio = statistics.median(a / b for a, b in runs)
        whole = (spent[0] + planning[0]) / (spent[1] + planning[1])
        text += (
            f"| {name} | {len(envelope.emissions[0].basis)} | {spent[0]:.2f} s | {spent[1]:.2f} s at "
            f"{envelope.sampling_rate:g} Hz | {ratio:.1f} | {whole:.1f} |\n"
        )
        print(text.splitlines()[-1], flush=True)
    (Path(__file__).parent / "baseband.md").write_text(text)


if __name__ == "__main__":
    main()
