"""Whether one checkout of clsim is slower than another: the same whole calls in both, in turn.

Each checkout has one process that stays; only one of them works at a time, and which begins changes from round to round.
The first call of each case builds kernels and is not counted.
"""

import argparse
import json
import math
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
RATE = 192e3
ORDERS = {"25 paths": (2, 20.0), "1561 paths": (10, 2.0), "4089 paths": (14, 0.8)}  # order and duration, s
RECEIVERS = {"1 receiver": (1, 1, 20.0), "100 receivers": (100, 1, 0.5), "1000 receivers": (1000, 0, 0.06)}  # and order
CASES = (*ORDERS, *RECEIVERS, "pulses", "baseband", "bedroom")


def room_case(order: int, duration: float, receivers: int = 1, kind: str = "tone", **options: Any) -> Callable[[], Any]:
    """Return a rendering of a source at 6 m/s in a box."""
    import either

    import clsim

    burst = clsim.Signal.tone(40e3, 1e-3, RATE, fade=2e-4)
    signals = {
        "tone": lambda: clsim.Signal.tone(40e3, duration, RATE, fade=0.01),
        "chirp": lambda: clsim.Signal.chirp(39e3, 41e3, duration, RATE, window="tukey"),
        "pulses": lambda: clsim.Signal.pulses(burst, 0.1, round(10 * duration)),
    }
    way = clsim.Trajectory.circle((4.0, 3.0, 1.5), 1.0, 2.0 * math.pi / 6.0, duration)
    side = math.ceil(math.sqrt(receivers))
    places = clsim.grid_positions((1.0, 7.0, side), (1.0, 5.0, side), 2.9) if side > 1 else [(1.0, 1.0, 2.9)]
    room = clsim.Shoebox((8.0, 6.0, 3.0), clsim.Material.from_reflection(0.9))
    sources, ears = [clsim.Source("s", signals[kind](), way)], clsim.receiver_array("r", places[:receivers])
    paths = clsim.find_paths(clsim.Scene(room, clsim.Air(), sources, ears), order)
    return lambda: either.render(paths, RATE, duration=duration, **options)


def bedroom_case(mesh: str, order: int, duration: float) -> Callable[[], Any]:
    """Return a search of paths in a mesh, from a source that wanders about the middle of the room to four receivers."""
    import numpy as np

    import clsim

    room = clsim.MeshRoom.from_file(mesh, up="y", materials=clsim.Material.from_reflection(0.9))
    low, high = room.extent
    times = np.linspace(0.0, duration, round(20 * duration) + 1)
    turns = np.stack([np.sin(1.3 * times), np.sin(1.7 * times + 1.0), np.sin(2.1 * times + 2.0)], axis=1)
    places = low + (high - low) * np.array([0.37, 0.48, 0.52]) + 0.2 * turns
    tone = clsim.Signal.tone(40e3, min(1.0, duration), RATE, fade=0.01)
    source = clsim.Source("s", tone, clsim.Trajectory.waypoints(times, places))
    shares = np.array([(0.3, 0.3, 0.6), (0.6, 0.6, 0.6), (0.7, 0.2, 0.3), (0.2, 0.7, 0.2)])
    ears = low + (high - low) * shares
    receivers = [clsim.Receiver(f"r{i}", clsim.Trajectory.fixed(e)) for i, e in enumerate(ears)]
    scene = clsim.Scene(room, clsim.Air(), [source], receivers)
    return lambda: clsim.find_paths(scene, order)


def case(name: str, mesh: str) -> Callable[[], Any]:
    """Return the call that is timed."""
    if name in ORDERS:
        return room_case(*ORDERS[name])
    if name in RECEIVERS:
        count, order, duration = RECEIVERS[name]
        return room_case(order, duration, count)
    if name == "pulses":
        return room_case(6, 8.0, kind="pulses")
    if name == "baseband":
        return room_case(6, 8.0, kind="chirp", baseband=(40e3, 4e3))
    return bedroom_case(mesh, 4, 20.0)


def work(checkout: str, mesh: str) -> None:
    """Answer lines of names of cases with the seconds of a call, on the wall and of the processor."""
    import warnings

    import clsim

    if not Path(clsim.__file__).is_relative_to(checkout):
        raise SystemExit(f"{clsim.__file__} is not in {checkout}")
    warnings.simplefilter("ignore")
    name, call = "", None
    for line in sys.stdin:
        if line.strip() != name:
            name = line.strip()
            call = case(name, mesh)
        begun, used = time.perf_counter(), time.process_time()
        call()
        print(json.dumps([time.perf_counter() - begun, time.process_time() - used]), flush=True)


class Worker:
    """A process that makes the calls of one checkout."""

    def __init__(self, checkout: Path, mesh: Path) -> None:
        line = [sys.executable, str(HERE / "paired.py"), "--work", str(checkout), str(mesh)]
        environment = {**os.environ, "PYTHONPATH": str(checkout)}
        self._process = subprocess.Popen(
            line, env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )

    def seconds(self, name: str) -> tuple[float, float]:
        """Make a call; return what it took on the wall and of the processor, s."""
        self._process.stdin.write(f"{name}\n")
        self._process.stdin.flush()
        told = self._process.stdout.readline()
        if not told:
            raise SystemExit(f"{name}: {self._process.args[3]} failed")
        wall, used = json.loads(told)
        return wall, used

    def end(self) -> None:
        """Let the process end."""
        self._process.stdin.close()
        self._process.wait()


def compared(name: str, pair: tuple[Worker, Worker], repeat: int) -> str:
    """Return a row of the table."""
    for worker in pair:
        worker.seconds(name)
    spent = ([], [])
    for i in range(repeat):
        for k in (i % 2, 1 - i % 2):
            spent[k].append(pair[k].seconds(name))
    wall, used = ([[call[j] for call in calls] for calls in spent] for j in (0, 1))
    ratios = [f(new) / f(old) for old, new in (wall, used) for f in (min, statistics.median)]
    return f"| {name} | {min(wall[0]):.2f} s | {min(wall[1]):.2f} s | " + " | ".join(f"{r:.3f}" for r in ratios) + " |"


def main() -> None:
    """Time the cases and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("old", type=Path, help="folder that holds the package clsim as it was")
    parser.add_argument("new", type=Path, help="and as it is")
    parser.add_argument("--only", nargs="+", choices=CASES, default=CASES, metavar="NAME", help=", ".join(CASES))
    parser.add_argument("--repeat", type=int, default=3, metavar="N", help="counted calls of each (default: 3)")
    parser.add_argument("--mesh", type=Path, default=HERE.parents[1] / "shared" / "data" / "meshes" / "bedroom.obj")
    options = parser.parse_args()
    mesh = options.mesh.resolve()
    pair = tuple(Worker(checkout.resolve(), mesh) for checkout in (options.old, options.new))
    print("Ratios are new over old, of seconds on the wall and of the processor.\n")
    print("| call | old | new | wall: least | median | processor: least | median |\n" + "|---" * 7 + "|")
    for name in options.only:
        if name == "bedroom" and not mesh.exists():
            print(f"| {name} | skipped: {mesh} is missing | | | | | |")
            continue
        print(compared(name, pair, options.repeat), flush=True)
    for worker in pair:
        worker.end()


if __name__ == "__main__":
    if sys.argv[1:2] == ["--work"]:
        work(*sys.argv[2:])
    else:
        main()
