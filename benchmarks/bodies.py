"""What moving bodies cost: the search over steps, and nodes of paths by a door against those of paths by walls.

Processor time, least of some runs in turn: ``python benchmarks/bodies.py``. Nodes of both are made on the host, by the same calls.
"""

import time

import numpy as np

import clsim
from clsim.paths.family import PathFamily

RATE = 192e3
NODES = np.arange(0.1, 0.9, 768 / RATE)
ROUNDS = 5


def scene(swings: bool) -> clsim.Scene:
    """Return a room with a door, and a source that moves."""
    wood = clsim.Material.from_reflection(0.9)
    tone = clsim.Signal.tone(40e3, duration=1.0, sampling_rate=RATE, fade=0.01)
    way = clsim.Trajectory.line((1.0, 0.7, 1.2), (1.4, 0.8, 1.2), 1.0)
    source, ear = clsim.Source("s", tone, way), clsim.Receiver("r", clsim.Trajectory.fixed((3.0, 0.6, 1.3)))
    hinge = clsim.Trajectory.swing((2.0, 2.0, 0.0), (0, 0, 1), [0.0, 0.2, 0.5], [0.0, 0.5, 1.0])
    door = clsim.Body.box("door", (0.9, 0.0, 2.0), wood, hinge, centre=(0.5, 0.0, 1.1))
    return clsim.Scene(
        clsim.Shoebox((4.0, 3.0, 2.5), wood), clsim.Air(), [source], [ear], bodies=[door] if swings else []
    )


def seconds_of(paths: PathFamily) -> float:
    """Return the processor time of a node of a path, s."""
    count = len(paths) * len(NODES)
    times = []
    for _ in range(ROUNDS):
        begun = time.process_time()
        paths.arrivals(np.arange(len(paths)), NODES)
        times.append((time.process_time() - begun) / count)
    return min(times)


def main() -> None:
    """Print all figures."""
    for order in (1, 2, 3):
        begun = time.process_time()
        walls = clsim.find_paths(scene(swings=False), order)
        plain, begun = time.process_time() - begun, time.process_time()
        both = clsim.find_paths(scene(swings=True), order)
        search = time.process_time() - begun
        still, moving = walls.families[0], both.families[-1]
        ratio = seconds_of(moving) / seconds_of(still) if len(moving) else float("nan")
        print(
            f"order {order}: search {search:.2f} s of processor time, without the door {plain:.2f} s; "
            f"{len(moving)} rows by the door, a node {ratio:.1f} times one of paths by walls"
        )


if __name__ == "__main__":
    main()
