"""How long it takes to build large made halls and to find their paths, and how much memory, in this checkout and others.

``large_rooms.py [CHECKOUT …]`` prints a table: a process for each checkout, hall and order, in turn; this checkout last.
Times are processor time of both cores, kernels included, after a first search that builds the kernels; `paths` has a hash of
what was found, so that the same hash is the same paths and intervals.
"""

import argparse
import hashlib
import json
import os
import resource
import subprocess
import sys
import time
import warnings
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
BAYS = {480: 20, 960: 40, 3840: 160}


def measure(bays: int, order: int) -> dict[str, object]:
    """Build a hall, find the paths from one source to two receivers, and return what that took."""
    sys.path.insert(0, str(ROOT / "tests" / "physics"))
    import numpy as np
    from made_meshes import hall

    import clsim

    wall, mesh = clsim.Material.from_reflection(0.9), hall(bays)
    clsim.MeshRoom(*hall(3), wall)  # imports
    begun = time.process_time()
    room = clsim.MeshRoom(*mesh, wall)
    built = time.process_time() - begun
    points = np.random.default_rng(1).uniform(*room.extent, (64, 3))
    points = points[room.contains(points)][:3]
    tone = clsim.Signal.tone(40e3, 1.0, 192e3, fade=0.01)
    ends = [clsim.Trajectory.fixed(p) for p in points]
    receivers = [clsim.Receiver(f"r{i}", end) for i, end in enumerate(ends[1:])]
    scene = clsim.Scene(room, clsim.Air(), [clsim.Source("s", tone, ends[0])], receivers)
    small = clsim.Scene(clsim.MeshRoom(*hall(5), wall), clsim.Air(), *_inside(clsim, tone))
    clsim.find_paths(small, order, finder="beam-tree")
    begun = time.process_time()
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        paths = clsim.find_paths(scene, order)
    seconds = time.process_time() - begun
    rows = [*zip(paths.receiver.tolist(), paths.walls.tolist(), paths.start.tolist(), paths.end.tolist(), strict=True)]
    return {
        "walls": len(room.walls), "order": order, "room": built, "search": seconds, "paths": len(rows),
        "hash": hashlib.sha256(repr(rows).encode()).hexdigest()[:8], "shot": any("rays" in str(t.message) for t in told),
        "memory": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0,
    }  # fmt: skip


def _inside(clsim: object, tone: object) -> tuple[list[object], list[object]]:
    """Return a source and a receiver in the smallest hall."""
    source = clsim.Source("s", tone, clsim.Trajectory.fixed((6.0, 0.5, 2.0)))  # type: ignore[attr-defined]  # no stubs
    receiver = clsim.Receiver("r", clsim.Trajectory.fixed((9.0, 1.0, 3.0)))  # type: ignore[attr-defined]  # no stubs
    return [source], [receiver]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("checkouts", nargs="*", type=Path, help="others to compare with")
    parser.add_argument("--walls", type=int, nargs="*", default=sorted(BAYS), choices=sorted(BAYS))
    parser.add_argument("--orders", type=int, nargs="*", default=[1, 2, 3])
    parser.add_argument("--one", type=int, nargs=2, help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.one:
        print(json.dumps(measure(*asked.one)))
        return
    print("| checkout | walls | order | room | search | memory | paths |\n|---|---|---|---|---|---|---|")
    for walls in asked.walls:
        for order in asked.orders:
            for checkout in (*asked.checkouts, ROOT):
                line = [sys.executable, __file__, "--one", str(BAYS[walls]), str(order)]
                environment = {**os.environ, "PYTHONPATH": str(checkout)}
                done = subprocess.run(line, env=environment, capture_output=True, text=True, check=True)
                got = json.loads(done.stdout.splitlines()[-1])
                by = ", by rays" if got["shot"] else ""
                print(
                    f"| {checkout.name} | {walls} | {order} | {got['room']:.2f} s | {got['search']:.2f} s "
                    f"| {got['memory']:.0f} MiB | {got['paths']} ({got['hash']}){by} |",
                    flush=True,
                )


if __name__ == "__main__":
    main()
