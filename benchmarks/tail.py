"""What a diffuse tail costs: processor time over that of images of order 6, in one run.

A hall of some 2 s of reverberation at 48 kHz, one source: one receiver that stands still, one that moves, and arrays of
64 that share a zone, still and moving. Rays and responses are made once a run, whatever its length, and stand apart.
"""

import argparse
import resource
import time

import numpy as np
from scipy.signal import firwin

import clsim
from clsim.render.diffuse_tail import DiffuseTail

RATE, SIZE, SOURCE, EAR = 48e3, (12.0, 9.0, 5.0), (2.0, 2.0, 1.5), np.array([7.0, 5.0, 1.5])


def scene(kind: str, seconds: float) -> clsim.Scene:
    """Return the hall with receivers of a kind."""
    noise = np.random.default_rng(0).standard_normal(round(seconds * RATE))
    signal = clsim.Signal.from_array(
        0.1 * np.convolve(noise, firwin(255, [100.0, 8e3], pass_zero=False, fs=RATE)), RATE
    )
    grid = np.stack(np.meshgrid(np.arange(8), np.arange(8)), axis=-1).reshape(-1, 2) * 0.05
    ways = {
        "one, still": [clsim.Trajectory.fixed(EAR)],
        "one, moving": [clsim.Trajectory.line(EAR, EAR + np.array([1.5, 0.0, 0.0]), seconds + 3.0)],
        "64, still": [clsim.Trajectory.fixed(EAR + np.array([x, y, 0.0])) for x, y in grid],
        "64, moving": [
            clsim.Trajectory.line(EAR + np.array([x, y, 0.0]), EAR + np.array([x + 1.5, y, 0.0]), seconds + 3.0)
            for x, y in grid
        ],
    }[kind]
    wall = clsim.Material.from_absorption([125.0, 1e3, 8e3], [0.11, 0.12, 0.15], scattering=0.2)
    ends = [clsim.Receiver(f"r{i}", way) for i, way in enumerate(ways)]
    source = clsim.Source("s", signal, clsim.Trajectory.fixed(SOURCE))
    return clsim.Scene(clsim.Shoebox(SIZE, wall), clsim.Air(), [source], ends)


def spent(adding: object, plan: clsim.Plan) -> tuple[float, float]:
    """Return processor times of the first chunk and of all others, s."""
    times = []
    for start in range(0, plan.samples, plan.chunk):
        pressure = np.zeros((plan.receiver_count, min(plan.chunk, plan.samples - start)), np.float32)
        begun = time.process_time()
        adding.add(pressure, start)  # type: ignore[attr-defined]
        times.append(time.process_time() - begun)
    return times[0], sum(times[1:])


def many(count: int, seconds: float) -> None:
    """Print time and memory of so many receivers that move all over a room, at 16 kHz."""
    room = clsim.Shoebox((8.0, 6.0, 3.0), clsim.Material.from_reflection(0.9, scattering=0.2))
    chirp = clsim.Signal.chirp(500.0, 4e3, seconds, 16e3, window="tukey")
    places = np.random.default_rng(0).uniform((0.5, 0.5, 0.5), (6.5, 5.5, 2.5), (count, 3))
    ends = [
        clsim.Receiver(f"r{i}", clsim.Trajectory.line(place, place + np.array([1.0, 0.0, 0.0]), 1.0))
        for i, place in enumerate(places)
    ]
    source = clsim.Source("s", chirp, clsim.Trajectory.fixed((1.0, 1.0, 1.6)))
    paths = clsim.find_paths(clsim.Scene(room, clsim.Air(), [source], ends), 2)
    begun = time.process_time()
    recording = clsim.render(paths, 16e3, duration=seconds, tail="auto")
    spent, held = time.process_time() - begun, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    told = next(note for note in recording.notes if "tail" in note)
    print(f"{count} moving, {seconds:g} s: {spent:.1f} s, {1e3 * spent / count:.0f} ms each, {held:.0f} MB; {told}")


def main() -> None:
    """Print a line for each kind of receivers, or of many that move."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--many", type=int, metavar="RECEIVERS", help="that move all over a room, instead")
    options = parser.parse_args()
    seconds = options.seconds
    if options.many:
        many(options.many, seconds)
        return
    for kind in ("one, still", "one, moving", "64, still", "64, moving"):
        paths = clsim.find_paths(scene(kind, seconds), 6)
        begun = time.process_time()
        plain = clsim.plan_render(paths, RATE, duration=seconds, chunk=4 * 18432)
        planned = time.process_time()
        plan = clsim.plan_render(paths, RATE, duration=seconds, chunk=4 * 18432, tail="auto", tail_error_db=1.0)
        rays = (time.process_time() - planned) - (planned - begun)
        images = [spent(c.begin(), plain) for c in plain.contributions]
        first, others = spent(DiffuseTail(plan).begin(), plan)
        of_images = sum(late for _, late in images)
        print(
            f"{kind:12} images {of_images:6.2f} s, tail {others:6.2f} s: {others / of_images:5.2f} times; "
            f"rays {rays:5.2f} s and responses {first - sum(one for one, _ in images):5.2f} s once "
            f"(a tail of {plan.allocation.tails[0].duration:.2f} s)",
            flush=True,
        )


if __name__ == "__main__":
    main()
