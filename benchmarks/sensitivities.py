"""What derivatives cost, in processor time of whole calls over that of a render path by path.

``python benchmarks/sensitivities.py``, with an order (3 where left out): 8 receivers, 192 kHz, 0.5 s.
"""

import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np

import clsim

RATE, DURATION = 192e3, 0.5
PLAIN: dict[str, Any] = {"convolve_static": False, "narrowband": False, "channels": False, "prune_below_db": None}
RECEIVERS = [f"receivers[{i}].position" for i in range(8)]
WALLS = ("x_min", "x_max", "y_min", "y_max", "z_min", "z_max")
ALL = [
    "sources[0].trajectory", *RECEIVERS, "air.temperature_celsius", "sources[0].start", "sources[0].gain_db",
    *(f"room.walls.{wall}.{what}" for wall in WALLS for what in ("reflection", "displacement")),
]  # fmt: skip


def paths(order: int, points: int) -> clsim.PathSet:
    """Return the paths from a source on a curved way through some points."""
    t = np.linspace(0.0, DURATION, points)
    way = np.array([2.0, 2.0, 1.2]) + 0.5 * np.stack([t, np.sin(3.0 * t), 0.3 * np.cos(5.0 * t)], axis=1)
    chirp = clsim.Signal.chirp(30e3, 50e3, 0.48, sampling_rate=RATE, fade=0.002)
    places = [(1.0 + 0.7 * i, 1.0 + 0.3 * i, 2.5 - 0.1 * i) for i in range(8)]
    room = clsim.Shoebox((8.0, 6.0, 3.0), clsim.Material.from_reflection(0.7))
    source = clsim.Source("s", chirp, clsim.Trajectory.waypoints(t, way))
    return clsim.find_paths(clsim.Scene(room, clsim.Air(), [source], clsim.receiver_array("r", places)), order)


def cost(call: Callable[[], Any]) -> tuple[float, Any]:
    """Return the least processor time of a call out of three, s, and its result."""
    least = np.inf
    for _ in range(3):
        begun = time.process_time()
        result = call()
        least = min(least, time.process_time() - begun)
    return least, result


def main(order: int) -> None:
    """Print the costs."""
    still = ["sources[0].position", *ALL[1:]]
    for points, names in ((11, ["sources[0].gain_db"]), (11, still), (7, ALL), (21, ALL), (54, ALL)):
        found = paths(order, points)
        render, sound = cost(lambda p=found: clsim.render(p, RATE, duration=DURATION, **PLAIN))  # type: ignore[misc]
        weights = np.asarray(sound.pressure, dtype=np.float64)
        gradient, by = cost(lambda p=found, w=weights, n=names: clsim.gradient(p, w, n, RATE))  # type: ignore[misc]
        print(f"gradient, {sum(np.size(v) for v in by.values())} parameters: {gradient / render:.2f}")
    one, two, some = RECEIVERS[:1], ["sources[0].position"], ["sources[0].trajectory"]
    for points, names in ((8, one), (8, RECEIVERS), (8, two), (8, some), (21, ALL)):
        found = paths(order, points)
        render, _ = cost(lambda p=found: clsim.render(p, RATE, duration=DURATION, **PLAIN))  # type: ignore[misc]
        forward, by = cost(lambda p=found, n=names: clsim.sensitivities(p, n, RATE, duration=DURATION))  # type: ignore[misc]
        count = len(by.parameters)
        print(f"sensitivities by {names[0]}, {count} parameters: {forward / render / count:.2f} each, all included")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 3)
