"""What air that disperses costs: processor time of rendering with it over that without, taken in turn in one run.

    python benchmarks/dispersion.py

A room of 8 x 6 x 3 m, order 5, four receivers, 20 to 80 kHz for 1 s and a tone of 40 kHz for 4 s; a source at rest and
receivers that move, and the other way round, for then paths meet air of other frequencies. Errors are the same: those
asked for by default. The first call of each builds kernels and is left out.
"""

import statistics
import time

import numpy as np

import clsim

RATE = 192e3
REPEATS = 4


def paths(signal: clsim.Signal, *, moving_source: bool, dispersion: bool) -> clsim.PathSet:
    """Return the paths of the room."""
    room = clsim.Shoebox((8.0, 6.0, 3.0), clsim.Material.from_reflection(0.9))
    rng, move = np.random.default_rng(1), np.array([1.0, 0.5, 0.2])

    def way(place: np.ndarray, *, moving: bool) -> clsim.Trajectory:
        if moving:
            return clsim.Trajectory.line(tuple(place), tuple(place + move), 5.0)
        return clsim.Trajectory.fixed(tuple(place))

    source = clsim.Source("s", signal, way(np.array([2.0, 2.0, 1.0]), moving=moving_source))
    places = rng.uniform([0.5, 0.5, 0.5], [6.5, 5.0, 2.5], (4, 3))
    ears = [clsim.Receiver(f"r{i}", way(place, moving=not moving_source)) for i, place in enumerate(places)]
    return clsim.find_paths(clsim.Scene(room, clsim.Air(dispersion=dispersion), [source], ears), 5)


def main() -> None:
    """Print a line for each signal and motion."""
    signals = {
        "20 to 80 kHz": clsim.Signal.chirp(20e3, 80e3, 1.0, RATE, window="hann"),
        "40 kHz": clsim.Signal.tone(40e3, 4.0, RATE, fade=0.01),
    }
    for name, signal in signals.items():
        for moving_source in (False, True):
            plans = [
                clsim.plan_render(paths(signal, moving_source=moving_source, dispersion=d), RATE) for d in (False, True)
            ]
            spent: list[list[float]] = [[], []]
            for _ in range(REPEATS + 1):
                for plan, times in zip(plans, spent, strict=True):
                    begin = time.process_time()
                    for _ in clsim.render_chunks(plan):
                        pass
                    times.append(time.process_time() - begin)
            still, air = ([*times[1:]] for times in spent)
            rows = [int(plan.source_filters[0].rows[-1]) for plan in plans]
            print(
                f"{name}, {'source' if moving_source else 'receivers'} moving: least {min(air) / min(still):.2f}, median "
                f"{statistics.median(air) / statistics.median(still):.2f} times; branch signals {rows[0]} and {rows[1]}",
                flush=True,
            )


if __name__ == "__main__":
    main()
