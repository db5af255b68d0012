"""What short scenes cost before they sound: search, plan and rendering, a study of them, a first call, and memory.

Usage: preparation.py [CHECKOUT...] [--renders 1000] [--members 100]: processor time, of studies and first calls with that of
children; each checkout in a process of its own.
"""

import argparse
import ctypes
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
import warnings
from contextlib import suppress
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

REPEATS, WARM = 15, 3
CORNERS = [(1, 1), (7, 1), (1, 5), (7, 5)]
RECEIVER = """
[[receivers]]
name = "r{k}"
trajectory = {{ kind = "fixed", position = [{x}, {y}, 2.9] }}
"""
SCENE = """
format = 1
[room]
kind = "shoebox"
size = [8.0, 6.0, 3.0]
walls = { reflection = 0.9 }
[[sources]]
name = "robot"
trajectory = { kind = "waypoints", times = [0.0, 0.5, 1.0], positions = [[2, 2, 1.2], [2.5, 2.3, 1.2], [3, 2.8, 1.2]] }
[sources.signal]
kind = "pulses"
pulse = { kind = "chirp", start = 30e3, stop = 45e3, duration = 0.01, sampling_rate = 192e3, window = "hann" }
period = 0.05
count = 5
[paths]
max_order = 2
[render]
sampling_rate = 192e3
duration = 0.25
"""
STUDY = """
format = 1
scene = "scene.toml"
draws = {members}
seed = 1
[[vary]]
field = "sources[0].trajectory.positions[0][0]"
name = "x"
random = {{ uniform = [1.5, 2.5] }}
"""
DRAWN_SCENE = """
format = 1
[room]
kind = "shoebox"
size = [6.0, 5.0, 3.0]
walls = {{ reverberation_time = 0.4 }}
[[sources]]
name = "talker"
signal = {{ kind = "noise", duration = 4.0, sampling_rate = 16e3, seed = 1, band = [100.0, 6500.0] }}
trajectory = {{ kind = "line", start = [1, 1, 1.5], end = [2, 1, 1.5], duration = 4.5 }}
[paths]
max_order = 6
[render]
sampling_rate = 16e3
duration = 4.0
tail = "{tail}"
"""
DRAWN_STUDY = """
format = 1
scene = "scene.toml"
keep = ["recording", "ground_truth"]
draws = {members}
seed = 1
shards = {{ members = 50 }}
[[vary]]
field = "room.size"
random = {{ uniform = [[4.0, 4.0, 2.5], [8.0, 7.0, 3.5]] }}
[[vary]]
field = "room.walls.reverberation_time"
name = "reverberation_time"
random = {{ log_uniform = [0.2, 0.6] }}
[[vary]]
field = "sources[0].trajectory.start"
name = "start"
random = {{ inside = 0.5 }}
[[vary]]
field = "sources[0].trajectory.end"
name = "end"
random = {{ inside = 0.5 }}
"""
DRAWN_ARRAY = """
[[vary]]
field = [{fields}]
name = [{names}]
random = {{ inside = {{ margin = 0.5, offsets = [[0, 0, 0], [0.05, 0, 0], [0.1, 0, 0], [0.15, 0, 0]] }} }}
"""


def small(number: int = 0) -> tuple[Any, int, dict[str, float]]:
    """Make a scene of pulses of 0.25 s at 192 kHz to four receivers, its order and how it is rendered."""
    import clsim

    room = clsim.Shoebox(size=(8.0, 6.0, 3.0), walls=clsim.Material.from_reflection(0.9))
    pulse = clsim.Signal.chirp(30e3, 45e3, duration=0.01, sampling_rate=192e3, window="hann")
    signal, x = clsim.Signal.pulses(pulse, period=0.05, count=5), 2.0 + 0.01 * number
    way = clsim.Trajectory.waypoints([0.0, 0.5, 1.0], [(x, 2, 1.2), (x + 0.5, 2.3, 1.2), (x + 1.0, 2.8, 1.2)])
    receivers = [clsim.Receiver(f"r{k}", clsim.Trajectory.fixed((*xy, 2.9))) for k, xy in enumerate(CORNERS)]
    scene = clsim.Scene(room, clsim.Air(20.0, 0.5), [clsim.Source("robot", signal, way)], receivers)
    return scene, 2, {"sampling_rate": 192e3, "duration": 0.25}


def talker(number: int = 0) -> tuple[Any, int, dict[str, float]]:
    """Make a scene of 4 s of noise at 16 kHz to four microphones, order 6, its order and how it is rendered."""
    import clsim

    room = clsim.Shoebox(size=(6.0, 5.0, 3.0), walls=clsim.Material.from_reflection(0.9))
    noise = np.convolve(np.random.default_rng(number).standard_normal(64000), [0.25, 0.5, 0.25], "same")
    signal, x = clsim.Signal.from_array(noise, sampling_rate=16e3), 2.0 + 0.01 * number
    way = clsim.Trajectory.waypoints([0.0, 2.5, 5.0], [(x, 2, 1.2), (x + 1.0, 2.3, 1.4), (x + 2.0, 2.8, 1.5)])
    receivers = [clsim.Receiver(f"m{k}", clsim.Trajectory.fixed((3.0 + 0.05 * k, 2.5, 1.0))) for k in range(4)]
    scene = clsim.Scene(room, clsim.Air(20.0, 0.5), [clsim.Source("talker", signal, way)], receivers)
    return scene, 6, {"sampling_rate": 16e3, "duration": 4.0}


def steps(make: Any) -> list[float]:
    """Return the median processor times of making a scene, search, plan and rendering, ms, each scene another one."""
    import clsim
    from clsim.render.render import record

    taken = []
    for number in range(WARM + REPEATS):
        at = [time.process_time()]
        scene, order, how = make(number)
        at.append(time.process_time())
        paths = clsim.find_paths(scene, order)
        at.append(time.process_time())
        plan = clsim.plan_render(paths, **how)
        at.append(time.process_time())
        record(plan)
        at.append(time.process_time())
        taken.append(np.diff(at) * 1e3)
    return [median(column) for column in np.array(taken[WARM:]).T.tolist()]


def resident() -> float:
    """Memory of this process, MiB."""
    return int(Path("/proc/self/statm").read_text("ascii").split()[1]) * resource.getpagesize() / 2**20


def memory(renders: int) -> list[float]:
    """Return the memory of this process after 50 renders and after all of them, MiB."""
    import clsim

    held = []
    for number in range(renders):
        scene, order, how = small(number % 100)
        clsim.render(clsim.find_paths(scene, order), **how)
        if number + 1 in (50, renders):
            held.append(resident())
    return held


def study(members: int) -> list[float]:
    """Return wall clock and processor time of a study on two processes, s."""
    receivers = "".join(RECEIVER.format(k=k, x=x, y=y) for k, (x, y) in enumerate(CORNERS))
    return of_files(SCENE + receivers, STUDY.format(members=members))


def drawn(members: int, tail: str) -> list[float]:
    """Return wall clock and processor time of a study that draws rooms, walks and places of four microphones, s."""
    receivers = "".join(RECEIVER.format(k=k, x=3.0 + 0.05 * k, y=2.0) for k in range(4))
    fields = ", ".join(f'"receivers[{k}].trajectory.position"' for k in range(4))
    names = ", ".join(f'"r{k}"' for k in range(4))
    varied = DRAWN_STUDY.format(members=members) + DRAWN_ARRAY.format(fields=fields, names=names)
    return of_files(DRAWN_SCENE.format(tail=tail) + receivers, varied)


def of_files(scene: str, study: str) -> list[float]:
    """Return wall clock and processor time of a study from such files on two processes, s."""
    with tempfile.TemporaryDirectory() as folder:
        Path(folder, "scene.toml").write_text(scene, "utf-8")
        Path(folder, "study.toml").write_text(study, "utf-8")
        return process("-m", "clsim", "study", f"{folder}/study.toml", "-o", f"{folder}/out", "--workers", "2")


def process(*line: str) -> list[float]:
    """Return wall clock and processor time of a process with its children, s.

    Workers of studies are forked by a server that ends after the command: it is adopted, so that their time counts.
    """
    ctypes.CDLL(None).prctl(36, 1, 0, 0, 0)  # PR_SET_CHILD_SUBREAPER
    before, begun = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    elsewhere = tempfile.gettempdir()  # a module is looked for in the working folder first
    subprocess.run([sys.executable, *line], check=True, capture_output=True, cwd=elsewhere)
    wall = time.perf_counter() - begun
    with suppress(ChildProcessError):
        while True:
            os.wait()
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return [wall, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime]


def measured(renders: int, members: int) -> dict[str, Any]:
    """Measure the checkout on the path of this process."""
    warnings.simplefilter("ignore")
    found: dict[str, Any] = {"small": steps(small), "talker": steps(talker)}
    once = f"import sys; sys.path.insert(0, {str(Path(__file__).parent)!r}); import clsim, preparation as p; "
    once += "scene, order, how = p.small(); clsim.render(clsim.find_paths(scene, order), **how)"
    process("-c", once)
    found["first"] = np.median([process("-c", once) for _ in range(3)], axis=0).tolist()
    study(1)  # compiles modules
    found["study"] = study(members) if members else [float("nan")] * 2
    for tail in ("off", "auto"):
        found[f"drawn {tail}"] = drawn(members, tail) if members else [float("nan")] * 2
    found["memory"] = memory(renders) if renders else [float("nan")] * 2
    return found


def report(found: dict[str, dict[str, Any]], renders: int, members: int) -> None:
    """Print a table with a column for each checkout."""
    rows = [
        *((f"{name}: {step}", key, i, "ms") for key, name in (("small", "0.25 s at 192 kHz, order 2"),
          ("talker", "4 s at 16 kHz, order 6")) for i, step in enumerate(("making the scene", "search", "plan", "rendering"))),
        *((f"first call of a process: {what}", "first", i, "s") for i, what in enumerate(("wall", "processor"))),
        *((f"study of {members} members, two processes: {what}", "study", i, "s") for i, what in enumerate(("wall", "processor"))),
        *((f"drawn study of {members} members, tail {tail}, two processes: {what}", f"drawn {tail}", i, "s")
          for tail in ("off", "auto") for i, what in enumerate(("wall", "processor"))),
        *((f"memory after {count} renders", "memory", i, "MiB") for i, count in enumerate((50, renders))),
    ]  # fmt: skip
    print("| |" + "|".join(f" {name} " for name in found) + "|\n|---" * 1 + "|---" * len(found) + "|")
    for label, key, i, unit in rows:
        print(f"| {label} |" + "|".join(f" {of[key][i]:.3g} {unit} " for of in found.values()) + "|")


def main() -> None:
    """Measure checkouts, each in a process of its own, and print their figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("checkouts", nargs="*", default=[str(Path(__file__).resolve().parents[1])])
    parser.add_argument("--renders", type=int, default=1000)
    parser.add_argument("--members", type=int, default=100)
    parser.add_argument("--inside", action="store_true", help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.inside:
        print(json.dumps(measured(asked.renders, asked.members)))
        return
    found = {}
    # Modules are compiled once, as those of installed packages are.
    compiled = tempfile.TemporaryDirectory()
    inherited = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    inherited |= {"OPENBLAS_NUM_THREADS": "1", "PYTHONPYCACHEPREFIX": compiled.name}
    for checkout in asked.checkouts:
        environment = inherited | {"PYTHONPATH": str(Path(checkout).resolve())}
        line = [sys.executable, __file__, "--inside", "--renders", str(asked.renders), "--members", str(asked.members)]
        done = subprocess.run(line, env=environment, capture_output=True, text=True, check=True)
        found[checkout] = json.loads(done.stdout)
    report(found, asked.renders, asked.members)


if __name__ == "__main__":
    main()
