"""How long it takes to find the paths in meshes, and how that grows. Needs the meshes and motions of ../shared/data.

Writes paths.md and paths.png beside itself. See README.md for what is timed and what is not.
"""

import argparse
import json
import logging
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

import clsim
from clsim.opencl import launch as compiler_module
from clsim.paths.search import beam_tree
from clsim.paths.visibility import device as device_intervals
from clsim.paths.visibility.intervals import trajectory_tables

HERE = Path(__file__).parent
DATA = HERE.parents[1] / "shared" / "data"
sys.path.insert(0, str(HERE.parent / "tests" / "physics"))
NODES_A_SECOND = 100.0  # of the plain way
WALL = clsim.Material.from_reflection(0.9)
MOTIONS = {"tum": ("freiburg1_xyz-groundtruth.txt", "tum"), "v102": ("V102_groundtruth.csv", "euroc")}
EARS = ((0.3, 0.3, 0.6), (0.6, 0.6, 0.6), (0.7, 0.2, 0.3), (0.35, 0.55, 0.3))
CASES = {
    "bedroom, order 4, 30 s hand-held, 4 receivers": ("bedroom", 4, "tum", 1.0, 10.0),
    "concert hall, order 3, 30 s hand-held, 4 receivers": ("concert", 3, "tum", 1.0, 2.0),
    "concert hall, order 3, 83 s drone, 4 receivers": ("concert", 3, "v102", 1.0, 10.0),
    "made hall of 1208 faces, order 2, 3 x 6 fixed": ("hall 7", 2, "fixed", 1.0, 5.0),
}
GROWTH = {
    "walls (made hall, order 2, 3 x 6 fixed)": [(f"hall {b}", 2, "fixed", 1.0) for b in (3, 5, 10, 20, 40)],
    "order (bedroom, 30 s)": [("bedroom", n, "tum", 1.0) for n in (1, 2, 3, 4, 5)],
    "length of the run (bedroom, order 4)": [("bedroom", 4, "tum", s) for s in (0.1, 0.25, 0.5, 1.0)],
}


def make_scene(name: str, motion: str, share: float) -> clsim.Scene:
    """Return a room with a source that moves about its middle, for a share of the motion, and receivers."""
    if name.startswith("hall"):
        from made_meshes import hall

        room = clsim.MeshRoom(*hall(int(name.split()[1])), WALL)
    else:
        room = clsim.MeshRoom.from_file(DATA / "meshes" / f"{name}.obj", up="y", materials=WALL)
    low, high = room.extent
    middle = low + (high - low) * np.array([0.37, 0.48, 0.52])
    tone = clsim.Signal.tone(40e3, 1.0, 192e3, fade=0.01)
    if motion == "fixed":
        rng = np.random.default_rng(1)
        points = rng.uniform(low, high, (400, 3))
        points = points[room.contains(points)][:9]
        sources = [clsim.Source(f"s{i}", tone, clsim.Trajectory.fixed(p)) for i, p in enumerate(points[:3])]
        ears = points[3:]
    else:
        file, kind = MOTIONS[motion]
        file = DATA / "trajectories" / file
        whole = clsim.Trajectory.from_file(file, kind, max_gap=0.2)
        shift = middle - trajectory_tables(whole, []).sphere(0)[0]
        times = np.linspace(0.0, share * whole.end, round(share * whole.end * 100.0))
        part = clsim.Trajectory.waypoints(times, whole.position(times) + shift)
        sources = [clsim.Source("s", tone, part)]
        ears = [low + (high - low) * np.array(e) for e in EARS]
    receivers = [clsim.Receiver(f"r{i}", clsim.Trajectory.fixed(e)) for i, e in enumerate(ears)]
    return clsim.Scene(room, clsim.Air(), sources, receivers)


def measure(name: str, order: int, motion: str, share: float) -> dict[str, float]:
    """Find the paths twice, the first time to build the kernels; return what the second took."""
    scene = make_scene(name, motion, share)
    clsim.find_paths(scene, order)
    counts = {"beams": 0, "rows": 0, "looks": 0, "search": 0.0}
    asked: list[tuple] = []
    find, candidates = device_intervals.DeviceSearch.find, beam_tree.BeamTree.candidates

    def counted_find(self, sequence, receiver):
        asked.append((self._query, sequence, receiver))
        begun = time.perf_counter()
        found = find(self, sequence, receiver)
        counts["search"] += time.perf_counter() - begun
        counts["rows"] += len(sequence)
        counts["looks"] += found.evaluations
        return found

    def counted_candidates(self, max_order):
        yield from candidates(self, max_order)
        counts["beams"] += self.beams

    device_intervals.DeviceSearch.find, beam_tree.BeamTree.candidates = counted_find, counted_candidates
    begun = time.perf_counter()
    paths = clsim.find_paths(scene, order)
    seconds = time.perf_counter() - begun
    device_intervals.DeviceSearch.find, beam_tree.BeamTree.candidates = find, candidates
    plain = plain_seconds(asked)
    last = max((s.trajectory.end for s in scene.sources if np.isfinite(s.trajectory.end)), default=0.0)
    return {
        "seconds": seconds, **counts, "walls": len(scene.room.walls), "intervals": len(paths),
        "paths": len({(s, r, *w) for s, r, w in zip(paths.source, paths.receiver, paths.walls.tolist(), strict=True)}),
        "length": last, "plain": plain, "memory": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0,
    }  # fmt: skip


class KernelTime:
    """Seconds in kernels while this is entered, transfers and builds left out."""

    def __enter__(self) -> "KernelTime":
        self.seconds = 0.0
        self._original = original = compiler_module.Compiler.kernel

        def kernel(compiler: object, program: str, constants: dict) -> Callable[..., None]:
            found = original(compiler, program, constants)

            def call(queue: object, items: tuple, **arguments: object) -> None:
                queue.finish()
                begun = time.perf_counter()
                found(queue, items, **arguments)
                queue.finish()
                self.seconds += time.perf_counter() - begun

            return call

        compiler_module.Compiler.kernel = kernel
        return self

    def __exit__(self, *_: object) -> None:
        compiler_module.Compiler.kernel = self._original


def plain_seconds(asked: list[tuple]) -> float:
    """Return the time of the same candidates at fixed nodes: measured at five, times their number.

    A run no longer than the resolution is settled by one evaluation at its middle: that is a node. Only the kernel is
    timed, so the plain way has its transfers for nothing. In 1 µs the ends hardly move: clearance is looked for nearby only.
    """
    total = 0.0
    for query, sequence, receiver in asked:
        last = float(query.last.max())
        with KernelTime() as kernel:
            for at in (np.arange(5) + 0.5) / 5 * last:
                first, until = np.full_like(query.first, at), np.full_like(query.last, at + 1e-6)
                instant = replace(query, first=first, last=until, resolution=1e-6)
                evaluations = device_intervals.DeviceSearch(instant).find(sequence, receiver).evaluations
                assert evaluations == len(sequence)
        total += max(1.0, last * NODES_A_SECOND) * kernel.seconds / 5
    return total


def in_a_process(*case: object) -> dict[str, float]:
    """Measure in a process of its own, so that its memory is its own."""
    command = [sys.executable, __file__, "--case", json.dumps(case)]
    return json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()[-1])


def main() -> None:
    """Measure all cases and write table and picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--case", type=json.loads, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.case:
        print(json.dumps(measure(*options.case)))
        return
    if not DATA.is_dir():
        print(f"skipped: no {DATA}")
        return
    lines = [
        "| case | time | asked | beams | candidates | validation | evaluations | paths | intervals | memory | every 10 ms instead |",
        "|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    for title, (*case, asked) in CASES.items():
        m = in_a_process(*case)
        plain = m["rows"] * m["length"] * NODES_A_SECOND
        instead = "the same: nothing moves"
        if m["length"]:
            instead = f"{m['plain']:.0f} s, {m['plain'] / m['search']:.1f} times ({plain / m['looks']:.0f} times the evaluations)"
        lines.append(
            f"| {title} ({m['walls']} walls) | {m['seconds']:.2f} s | {asked:g} s | {m['beams']:.0f} | {m['rows']:.0f} | {m['search']:.2f} s | "
            f"{m['looks']:.3g} | {m['paths']:.0f} | {m['intervals']:.0f} | {m['memory']:.0f} MiB | {instead} |"
        )
        print(lines[-1], flush=True)
    grown = {title: [in_a_process(*case) for case in cases] for title, cases in GROWTH.items()}
    draw(grown)
    for title, found in grown.items():
        axis = axis_of(title)
        lines.append("")
        lines.append(
            f"By {title}: "
            + ", ".join(f"{f[axis] if axis else i + 1:.3g}: {f['seconds']:.2f} s" for i, f in enumerate(found))
        )
    (HERE / "paths.md").write_text("\n".join(lines) + "\n", "utf-8")


def axis_of(title: str) -> str:
    """Return the abscissa of a growth curve; None for the order, which counts from 1."""
    return {"walls": "walls", "order": "", "length": "length"}[title.split()[0]]


def draw(grown: dict[str, list[dict[str, float]]]) -> None:
    """Draw time over walls, order and length."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    logging.getLogger("matplotlib.font_manager").setLevel(logging.ERROR)
    figure = Figure(figsize=(12.0, 3.8), layout="constrained")
    FigureCanvasAgg(figure)
    for axes, (title, found) in zip(figure.subplots(1, 3), grown.items(), strict=True):
        axis = axis_of(title)
        x = [f[axis] if axis else i + 1 for i, f in enumerate(found)]
        axes.plot(x, [f["seconds"] for f in found], "o-", color="#c1272d", label="all")
        axes.plot(x, [f["search"] for f in found], "s--", color="#1f77b4", label="validation and intervals")
        axes.set(xlabel=title, ylabel="time (s)", yscale="log", xscale="log" if axis == "walls" else "linear")
        axes.grid(alpha=0.3, which="both")
        axes.legend(fontsize=9)
    figure.savefig(HERE / "paths.png", dpi=120)


if __name__ == "__main__":
    main()
