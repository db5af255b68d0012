"""What a node costs (delay and gains of a path at an anchor of a block): one checkout of clsim against another.

Each checkout has one process, on one core; only one of them works at a time. Timed are the kernels `coarse_delays` and
`tracks` alone, by the processor time of their launches, and of every launch the least of several renderings is taken: other
work on the machine makes figures larger, never smaller. Nothing else is launched.
"""

import argparse
import inspect
import json
import math
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
RATE = 192e3
SEGMENT = 18432  # samples
SILENT = 4  # segments at the beginning in which not everything is heard, and that are not rendered
# Walls by frequency: with what is sent, and the error that is asked for, they set how many functions there are.
BANDS = {1: ((39e3, 41e3), "centre"), 3: ((39e3, 41e3), -90.0), 6: ((30e3, 50e3), -80.0)}
PROGRAMS = ("coarse_delays", "tracks")


def plan(receivers: int, order: int, functions: int, moving: bool, segments: int) -> Any:
    """Return the plan of a source at 6 m/s in a box, and its number of paths."""
    import numpy as np

    import clsim

    duration = (SILENT + segments) * SEGMENT / RATE
    (low, high), error = BANDS[functions]
    signal = clsim.Signal.chirp(low, high, duration, RATE, window="tukey")
    absorption = [[0.1, 0.2, 0.4, 0.5, 0.5], [0.5, 0.4, 0.3, 0.2, 0.1], [0.2, 0.25, 0.2, 0.3, 0.2]]
    walls = [clsim.Material.from_absorption([20e3, 30e3, 40e3, 50e3, 60e3], absorption[i % 3]) for i in range(6)]
    way = clsim.Trajectory.circle((4.0, 3.0, 1.5), 1.0, 2.0 * math.pi / 6.0, duration)
    side = math.ceil(math.sqrt(receivers))
    shifts = np.array([(i // side, i % side, 0.0) for i in range(receivers)])
    if moving:
        ways = [
            clsim.Trajectory.circle((3.0 + 0.01 * x, 2.0 + 0.01 * y, 2.0), 0.5, 2.0, duration) for x, y, _ in shifts
        ]
    else:
        ways = [clsim.Trajectory.fixed((1.0 + 0.01 * x, 1.0 + 0.01 * y, 2.9)) for x, y, _ in shifts]
    ears = [clsim.Receiver(f"r{i}", w) for i, w in enumerate(ways)]
    source = clsim.Source("s", signal, way, clsim.Piston(0.005))
    paths = clsim.find_paths(clsim.Scene(clsim.Shoebox((8.0, 6.0, 3.0), walls), clsim.Air(), [source], ears), order)
    options: dict[str, Any] = {"responses": error} if error == "centre" else {"response_error_db": error}
    if "narrowband" in inspect.signature(clsim.plan_render).parameters:
        options["narrowband"] = False  # nodes of the sound itself
    return clsim.plan_render(paths, RATE, duration=duration, **options)


def nanoseconds(case: list[Any], repeat: int) -> tuple[float, int]:
    """Return the time per node of a case, ns, and the number of functions of frequency."""
    from clsim.opencl.launch import Launch
    from clsim.render.opencl.engine import OpenclEngine

    receivers, order, functions, moving = case
    # 50 000 paths or so, or half a second.
    segments = max(1, min(4, 50000 // (receivers * (1561 if order == 10 else 63))))
    made = plan(receivers, order, functions, moving, segments)
    engine, launch, spent = OpenclEngine(made), Launch.__call__, []

    def timed(self: Any, queue: Any, *arguments: Any, **named: Any) -> Any:
        if self._name not in PROGRAMS:
            return None
        queue.finish()
        begun = time.process_time()
        event = launch(self, queue, *arguments, **named)
        queue.finish()
        spent.append(time.process_time() - begun)
        return event

    Launch.__call__ = timed
    least: list[float] = []
    for _ in range(repeat):
        spent.clear()
        engine.render(SILENT * SEGMENT, made.samples)
        least = [min(pair) for pair in zip(least, spent, strict=True)] if least else list(spent)
    Launch.__call__ = launch
    nodes = made.path_count * segments * (SEGMENT // made.blocks[0])
    return 1e9 * sum(least) / nodes, len(made.source_filters[0].basis)


def work(checkout: str) -> None:
    """Answer lines of cases with nanoseconds and functions."""
    import warnings

    import clsim

    if not Path(clsim.__file__).is_relative_to(checkout):
        raise SystemExit(f"{clsim.__file__} is not in {checkout}")
    warnings.simplefilter("ignore")
    for line in sys.stdin:
        case, repeat = json.loads(line)
        print(json.dumps(nanoseconds(case, repeat)), flush=True)


class Worker:
    """A process that times the nodes of one checkout, on one core."""

    def __init__(self, checkout: Path) -> None:
        line = [sys.executable, str(HERE / "nodes.py"), "--work", str(checkout)]
        environment = {**os.environ, "PYTHONPATH": str(checkout), "POCL_CPU_MAX_CU_COUNT": "1"}
        self._process = subprocess.Popen(
            line, env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )

    def ask(self, case: list[Any], repeat: int) -> tuple[float, int]:
        """Return nanoseconds and functions of a case."""
        self._process.stdin.write(json.dumps([case, repeat]) + "\n")
        self._process.stdin.flush()
        told = self._process.stdout.readline()
        if not told:
            raise SystemExit(f"{case}: {self._process.args[3]} failed")
        return tuple(json.loads(told))

    def end(self) -> None:
        """Let the process end."""
        self._process.stdin.close()
        self._process.wait()


def main() -> None:
    """Time the cases and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "checkouts", type=Path, nargs="+", help="folders that hold the package clsim: as it was, as it is"
    )
    parser.add_argument("--receivers", type=int, nargs="+", default=[1, 16, 100], metavar="N")
    parser.add_argument("--functions", type=int, nargs="+", default=list(BANDS), choices=list(BANDS), metavar="K")
    parser.add_argument("--orders", type=int, nargs="+", default=[3, 10], metavar="N")
    parser.add_argument("--repeat", type=int, default=5, metavar="N", help="renderings of each (default: 5)")
    options = parser.parse_args()
    workers = [Worker(checkout.resolve()) for checkout in options.checkouts]
    print("ns per node on one core, least of several: " + ", ".join(str(c) for c in options.checkouts) + "\n")
    titles = ["receivers", "move", "order", "functions", *(f"checkout {i}" for i in range(len(workers))), "ratio"]
    print("| " + " | ".join(titles) + " |\n" + "|---" * len(titles) + "|")
    for order in options.orders:
        for receivers in options.receivers:
            for moving in (False, True):
                for functions in options.functions:
                    told = [w.ask([receivers, order, functions, moving], options.repeat) for w in workers]
                    cells = [str(receivers), "yes" if moving else "no", str(order), str(told[-1][1])]
                    cells += [f"{t[0]:.0f}" for t in told] + [f"{told[0][0] / told[-1][0]:.2f}"]
                    print("| " + " | ".join(cells) + " |", flush=True)
    for worker in workers:
        worker.end()


if __name__ == "__main__":
    if sys.argv[1:2] == ["--work"]:
        work(*sys.argv[2:])
    else:
        main()
