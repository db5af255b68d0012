"""Many renders in one process: no growth of memory one after the other, and the same bits in threads.

A few at every change; `make attacks` does 570 and 96.
"""

import gc
import os
import resource
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import clsim

RENDERS = int(os.environ.get("CLSIM_RENDERS", "60"))
IN_THREADS = int(os.environ.get("CLSIM_THREADS", "16"))
KINDS = 10  # scenes
GROWTH = (
    8e6  # bytes: pages that allocators keep, whatever the number of renders; a render of 10 ms holds more than 40 kB
)
pytestmark = pytest.mark.usefixtures("device")


def rendered(kind: int) -> Any:
    """Render one of ten scenes: moving or at rest, both engines, with tail and directivity, or noise."""
    order, moving = kind % 3, kind % 2 == 0
    signal = (
        clsim.Signal.tone(40e3, 0.005, 192e3, fade=0.001) if kind < 5 else clsim.Signal.noise(0.005, 192e3, seed=kind)
    )
    start = (1.0, 1.0 + 0.05 * kind, 1.0)
    way = clsim.Trajectory.line(start, (1.1, *start[1:]), 0.1) if moving else clsim.Trajectory.fixed(start)
    room = clsim.Shoebox((6.0, 5.0, 2.5), clsim.Material.from_reflection(0.8))
    receivers = [clsim.Receiver(f"r{n}", clsim.Trajectory.fixed((3.0, 2.0 + n, 1.0))) for n in range(1 + kind % 2)]
    scene = clsim.Scene(room, clsim.Air(), [clsim.Source("s", signal, way)], receivers)
    engine = "reference" if kind == 3 else "opencl"
    return clsim.render(clsim.find_paths(scene, order), 192e3, duration=0.02, engine=engine).pressure


def resident() -> int:
    """Bytes of this process in memory."""
    gc.collect()
    return int(Path("/proc/self/statm").read_text("ascii").split()[1]) * resource.getpagesize()


@pytest.mark.skipif(sys.platform != "linux", reason="/proc tells on Linux how much memory a process holds")
@pytest.mark.filterwarnings("ignore::clsim.ClsimWarning")
def test_memory_does_not_grow_with_renders() -> None:
    first = [rendered(kind) for kind in range(KINDS)]
    for number in range(max(KINDS, RENDERS // 4)):
        rendered(number % KINDS)
    before = resident()
    for number in range(RENDERS - RENDERS // 4 - KINDS):
        assert np.array_equal(rendered(number % KINDS), first[number % KINDS])
    assert resident() - before < GROWTH


@pytest.mark.filterwarnings("ignore::clsim.ClsimWarning")
def test_renders_in_threads_have_the_same_bits() -> None:
    wanted = [rendered(kind) for kind in range(KINDS)]
    with ThreadPoolExecutor(8) as threads:
        found = list(threads.map(rendered, [number % KINDS for number in range(IN_THREADS)]))
    for number, pressure in enumerate(found):
        assert np.array_equal(pressure, wanted[number % KINDS]), number
