"""Every kernel with every option in Oclgrind, which simulates a GPU and reports invalid, racing and uninitialised reads.

Three of its reports are false, each shown here by a kernel of its own; `driver_scenes.py` does without their causes.
"""

from collections.abc import Callable
from pathlib import Path

import pytest
from driver_scenes import SCENES
from drivers import EVERYTHING, FEW_ON_GPUS, OCLGRIND, PARITY_DB, apart_db, launched, render, run
from exhaustive import exhaustive, few

from clsim.opencl.kernels import PROGRAMS

# Every kernel with every option is in these: `doubled` does what `plain` does.
FEW = [name for name in SCENES if EVERYTHING or name != "plain"]
BY_CPU = [f"{name}.cpu" for name in FEW]
BY_GPU = [f"{name}.gpu" for name in (SCENES if EVERYTHING else FEW_ON_GPUS)]
OPTIONS = {
    "LANES": {"1", "8"}, "SPARSE": {"0", "1"}, "FINE": {"0", "1"}, "OVERSAMPLING": {"1", "2"}, "PARTS": {"1", "2"},
    "RETARDED": {"0", "1"}, "STATIC_RECEIVERS": {"0", "1"}, "MACH_EXPONENT": {"0", "1", "2"}, "DELAY_TERMS": {"4", "8"},
    "SOURCE_DIRECTIVITY": {"0", "1", "2"}, "RECEIVER_DIRECTIVITY": {"0", "1", "2"}, "NODES_AT_ONCE": {"1", "4"},
    "WIND": {"0", "1"}, "AIR_TERMS": {"0", "2"}, "AT_EDGE": {"0", "1"}, "GROUPED": {"0", "1"}, "ORDER": {"0", "1"},
    "EDGES": {"0", "1"}, "SCATTERERS": {"0", "1"}, "BODIES": {"0", "2"}, "MORE": {"0", "6", "8"},
    "FREQUENCIES": {"1", "8"}, "WORKERS": {"1", "32"},
}  # fmt: skip
# Those of programs that share files with others, in which the same options have run.
OPTIONS_OF = {
    "tracks": {
        "WIND": {"0", "1"},
        "AIR_TERMS": {"0", "2"},
        "SPARSE": {"0", "1"},
        "NODES_AT_ONCE": {"1", "4"},
        "EDGES": {"0", "1"},
        "SCATTERERS": {"0", "1"},
        "BODIES": {"0", "2"},
    },
    "pair_tracks": {"AIR_TERMS": {"0", "2"}, "SPARSE": {"0", "1"}, "STATIC_RECEIVERS": {"0", "1"}},
    "coarse_delays": {
        "WIND": {"0", "1"},
        "NODES_AT_ONCE": {"1", "4"},
        "EDGES": {"0", "1"},
        "SCATTERERS": {"0", "1"},
        "BODIES": {"0", "2"},
    },
    "intervals": {"WIND": {"0", "1"}, "ORDER": {"0", "1"}},
    "edge_intervals": {"WIND": {"1"}, "ORDER": {"0", "1"}},  # without wind it computes less
}
# Constants that no code is chosen by.
NUMBERS = {
    "AXIAL", "BATCH", "BEYOND_LEG", "CAPSULE", "CELL", "CELLS", "CERTAIN", "CONTRACTED", "CONTRACTIONS",
    "CUBIC_COLUMNS", "DEPTH", "EVER", "FACE_CELLS", "FACE_COLUMNS", "FLATTEST", "FUNCTIONS", "GAIN_ERROR",
    "GLINT_FAR", "GLINT_FOUND", "GRAZE_TIME", "HALF_TURN", "INNER", "KNOT_COLUMNS", "LEAST_SHARE", "LONGEST_STEP",
    "MOST", "NEAR_JUNCTION", "NODE", "NO_WAY", "OMNI", "ON_BOUNDARY", "PARALLEL", "PATIENCE", "PENUMBRA", "POINT", "POSE_COLUMNS",
    "POWERS", "RECEIVER_PERTURBATION", "SETTLED", "SIDE", "SMOOTH_ERROR", "SOURCE_PERTURBATION", "SPHERE",
    "SPHERICAL", "SUBBLOCK", "SUBBLOCKS", "TAPS", "TILE", "TOUCHING", "VECTORS",
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("names", [exhaustive(BY_CPU), exhaustive(BY_GPU)], ids=["layout for CPUs", "layout for GPUs"])
def test_not_one_report(names: list[str], tmp_path: Path, by_pocl: Callable[..., Path]) -> None:
    check(names, tmp_path, by_pocl())


def test_not_one_report_of_one_scene(tmp_path: Path, by_pocl: Callable[..., Path]) -> None:
    check(["plain.cpu"], tmp_path, by_pocl("plain.cpu"))


def check(names: list[str], folder: Path, by_pocl: Path) -> None:
    simulated = folder / "oclgrind"
    assert render(OCLGRIND, simulated, *names) == ""
    assert {name: db for name in names if (db := apart_db(simulated, by_pocl, name)) > PARITY_DB} == {}


@pytest.mark.exhaustive
def test_scenes_run_every_kernel_with_every_option(by_pocl: Callable[..., Path]) -> None:
    ran = launched(by_pocl(), *BY_CPU, *BY_GPU)
    assert {program for program, _ in ran} == set(PROGRAMS)
    assert unseen(ran, OPTIONS) == {}
    for program, options in OPTIONS_OF.items():
        assert unseen([row for row in ran if row[0] == program], options) == {}, program


def unseen(ran: list[tuple[str, dict[str, str]]], options: dict[str, set[str]]) -> dict[str, set[str]]:
    """Return the values of options with which nothing ran."""
    return {o: rest for o, wanted in options.items() if (rest := wanted - {given.get(o) for _, given in ran})}


def test_all_constants_are_options_or_numbers() -> None:
    assert set.union(*(set(program.constants) for program in PROGRAMS.values())) == OPTIONS.keys() | NUMBERS


MUTANTS = {
    "an index off by one": ("plain.cpu", ("branches", "tap_count - 1 - k]", "tap_count - k]"), "Invalid read"),
    "a barrier left out": (
        "plain.gpu",
        ("render", "subblock_sum);\n                }\n                SYNCHRONISE;", "subblock_sum);\n                }"),
        "data race",
    ),
    "a buffer not cleared": ("plain.cpu", ("", "", ""), "Uninitialized"),
}  # fmt: skip


@pytest.mark.parametrize("name", few(MUTANTS))
def test_mutants_are_reported(name: str, tmp_path: Path) -> None:
    scene, mutant, reported = MUTANTS[name]
    assert reported in render(OCLGRIND, tmp_path, scene, mutant=mutant)


FALSE_REPORTS = """
import sys
import numpy as np, pyopencl as cl

device, = next(p for p in cl.get_platforms() if p.name == "Oclgrind").get_devices()
context = cl.Context([device])
queue, flags, ones = cl.CommandQueue(context), cl.mem_flags, np.ones(64, np.float32)

def kernel(body):
    text = "__kernel void f(__global const float* x, __global float* y) {%s}" % body
    return cl.Kernel(cl.Program(context, text).build(), "f")

copy, y = kernel("y[get_global_id(0)] = x[get_global_id(0)];"), cl.Buffer(context, flags.READ_WRITE, 256)
if sys.argv[1] == "written":
    x = cl.Buffer(context, flags.READ_WRITE, 256)
    cl.enqueue_copy(queue, x, ones)
    copy(queue, (64,), (32,), x, y)
elif sys.argv[1] == "filled":
    x = cl.Buffer(context, flags.READ_WRITE, 256)
    cl.enqueue_fill_buffer(queue, x, ones[:1], 0, 256)
    copy(queue, (64,), (32,), x, y)
elif sys.argv[1] == "in place of others":
    live, order = [], np.random.default_rng(1)
    for _ in range(40):
        count = int(order.choice([64, 128, 256, 512]))
        x = cl.Buffer(context, flags.READ_WRITE | flags.COPY_HOST_PTR, hostbuf=np.ones(count, np.float32))
        y = cl.Buffer(context, flags.READ_WRITE, 4 * count)
        copy(queue, (count,), (32,), x, y)
        copy(queue, (count,), (32,), y, x)
        queue.finish()
        live += [x, y]
        if len(live) > 6:
            order.shuffle(live)
            live = live[:3]
elif sys.argv[1] == "one of eight":
    x = cl.Buffer(context, flags.READ_WRITE, 32)
    cl.enqueue_copy(queue, x, ones[:7])
    first = kernel("float8 v = *(__global const float8*)x; y[0] = ((const float*)&v)[0];")
    first(queue, (1,), (1,), x, y)
queue.finish()
"""


@pytest.mark.parametrize("cause", ["written", "filled", "in place of others", "one of eight"])
def test_false_reports(cause: str, tmp_path: Path) -> None:
    """All that is read was written; only what was written by `enqueue_copy`, by whole numbers, into a new buffer, is seen."""
    reports = run(OCLGRIND, tmp_path, "-c", FALSE_REPORTS, cause)
    assert ("Uninitialized value" in reports) == (cause != "written")
