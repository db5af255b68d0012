"""What building kernels costs: README's script with empty caches and again, as processes and as calls, and each program.

Usage: first_call.py [CHECKOUT...]: seconds of wall clock and of processor time (children included), ratios of the first to
the second, and of every program what the compiler takes, and what the first launch takes, in which a runtime may build more.
"""

import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

SCRIPT = """
import json, time
begun = time.perf_counter(), time.process_time()
import clsim

spent, programs = [], []


def watched(kind, of, method, name):
    original = getattr(of, method)

    def call(self, *given):
        before = time.process_time()
        result = original(self, *given)
        took = time.process_time() - before
        if took > 0.02:
            programs.append((name(self, given), kind, took))
        return result

    setattr(of, method, call)


from clsim.opencl import kernel_cache, launch

watched("build", launch.Compiler, "_build", lambda self, given: given[0])
watched("first launch", kernel_cache.TriedKernel, "__call__", lambda self, given: self._kernel.function_name)
for _ in range(3):
    room = clsim.Shoebox(size=(8.0, 6.0, 3.0), walls=clsim.Material.from_reflection(0.9))
    signal = clsim.Signal.tone(40e3, duration=2.0, sampling_rate=192e3)
    way = clsim.Trajectory.circle(center=(4, 3, 1.5), radius=1.0, period=1.0, duration=2.0)
    receiver = clsim.Receiver("ceiling", trajectory=clsim.Trajectory.fixed((1.0, 1.0, 2.9)))
    scene = clsim.Scene(room, clsim.Air(20.0, 0.5), [clsim.Source("robot", signal=signal, trajectory=way)], [receiver])
    now = time.perf_counter(), time.process_time()
    clsim.render(clsim.find_paths(scene, max_order=3), sampling_rate=192e3)
    spent.append([time.perf_counter() - now[0], time.process_time() - now[1]])
    if len(spent) == 1:
        first = list(programs)
print(json.dumps({"calls": spent, "programs": first, "one": [time.perf_counter() - begun[0] - sum(s[0] for s in spent[1:]),
                  time.process_time() - begun[1] - sum(s[1] for s in spent[1:])]}))
"""


def measured(checkout: Path, cache: Path) -> dict:
    """Run the script in a process of its own with a cache; return its figures, those of the process among them."""
    environment = os.environ | {"PYTHONPATH": str(checkout), "POCL_CACHE_DIR": str(cache), "PYOPENCL_NO_CACHE": "1"}
    before, begun = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    line = [sys.executable, "-c", SCRIPT]  # which would find clsim in the working directory first
    done = subprocess.run(line, env=environment, cwd=cache, capture_output=True, text=True, check=True)
    after, wall = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter() - begun
    figures = json.loads(done.stdout)
    later = [sum(s[i] for s in figures["calls"][1:]) for i in range(2)]  # a script has one call
    processor = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return figures | {"process": [wall - later[0], processor - later[1]]}


def report(checkout: Path) -> None:
    """Print the figures of a checkout."""
    with tempfile.TemporaryDirectory() as folder:
        empty, again = (measured(checkout, Path(folder)) for _ in range(2))
    print(f"{checkout}\n")
    print("| | empty caches: wall, processor | again | ratio |\n|---|---|---|---|")
    calls = "a call, the process's first, then its second", empty["calls"][0], empty["calls"][1]
    for name, first, second in (("a process with one call", empty["process"], again["process"]), calls):
        ratios = ", ".join(f"{a / b:.1f}" for a, b in zip(first, second, strict=True))
        print(f"| {name} | {first[0]:.1f} s, {first[1]:.1f} s | {second[0]:.1f} s, {second[1]:.1f} s | {ratios} |")
    print(f"\n{len([p for p in empty['programs'] if p[1] == 'build'])} programs, processor time:\n")
    print("| program | step | s |\n|---|---|---|")
    for name, step, took in empty["programs"]:
        print(f"| `{name}` | {step} | {took:.2f} |")
    print()


if __name__ == "__main__":
    for given in sys.argv[1:] or [str(Path(__file__).resolve().parents[1])]:
        report(Path(given).resolve())
