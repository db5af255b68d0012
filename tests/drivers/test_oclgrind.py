"""Every kernel with every option in Oclgrind, which simulates a GPU and reports invalid, racing and uninitialised reads.

Three of its reports are false, each shown here by a kernel of its own; `driver_runs.py` does without their causes.
"""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from driver_runs import rendered
from driver_scenes import SCENES
from drivers import (
    EVERYTHING,
    FEW_ON_GPUS,
    OCLGRIND,
    OPTIONS,
    PARITY_DB,
    POCL,
    apart_db,
    difference_db,
    launched,
    need_pocl,
    render,
    run,
)
from exhaustive import exhaustive, few

from clsim.opencl.launch import PROGRAMS

# Scenes of `scatter`, in whose transforms of vectors of 16 Oclgrind itself ends (signal 11): Intel's runtime runs them,
# and PoCL. Every other kernel, with every option, is in FEW, but for those of tapers. `doubled` does what `plain` does.
ENDS = {"channels", "tapered"}
FEW = [name for name in SCENES if name not in ENDS and (EVERYTHING or name != "plain")]
BY_CPU = [f"{name}.cpu" for name in FEW]
BY_GPU = [f"{name}.gpu" for name in (FEW if EVERYTHING else FEW_ON_GPUS)]
# Those of programs that share files with others, in which the same options have run.
OPTIONS_OF = {
    "tracks": {
        "WIND": {"0", "1"},
        "AIR_TERMS": {"0", "2"},
        "SPARSE": {"0", "1"},
        "NODES_AT_ONCE": {"1", "4"},
        "LEG": {"0", "1"},
        "VERTEX": {"0", "1", "2", "3"},
        "MIRRORS": {"0", "2"},
    },
    "pair_tracks": {"AIR_TERMS": {"0", "2"}, "SPARSE": {"0", "1"}, "STATIC_RECEIVERS": {"0", "1"}},
    "coarse_delays": {
        "WIND": {"0", "1"},
        "NODES_AT_ONCE": {"1", "4"},
        "LEG": {"0", "1"},
        "VERTEX": {"0", "1", "2", "3"},
        "MIRRORS": {"0", "2"},
    },
    "intervals": {"WIND": {"0", "1"}, "ORDER": {"0", "1"}},
    "edge_intervals": {"WIND": {"1"}, "ORDER": {"0", "1"}, "GAP": {"0", "1"}},  # without wind it computes less
}
# Constants that no code is chosen by, or, as by COUNTS of branches, a quicker form of the same.
NUMBERS = {
    "ALONG", "ANGLES", "AT_CORNER", "AXIAL", "BANDS", "BATCH", "BEYOND_LEG", "BOTH", "CAPSULE", "CELL", "CELLS", "CERTAIN",
    "CHANNELS", "CONTRACTED", "CONTRACTIONS", "COUNTS", "COSINE_NONE", "COSINE_WHOLE", "CUBIC_COLUMNS", "DEPTH", "EDGE",
    "ELLIPSOID", "ELONGATED", "END_CELLS", "END_TERMS", "EVER", "FACE_CELLS", "FACE_COLUMNS", "FAINT", "FARTHEST",
    "CAP_FADE", "FLATTEST", "FOCK_COUNT", "FOCK_FIRST", "FOCK_LAST", "FOUND", "FUNCTIONS", "GAINS", "GAIN_ERROR", "GRAZED",
    "GRAZE_TIME", "GRAZING", "GROUPS", "HALF_TURN", "HARMONIC", "INNER", "IN_AIR", "KNOT_COLUMNS", "KNOWN_AT", "LEAST_SHARE", "LEFT_OUT", "LONGEST_STEP",
    "MOST", "MOST_REFLECTIONS", "MOVING", "NEAREST_END", "NEAR_AXIS", "NEAR_JUNCTION", "NEAR_NONE", "NEAR_ROUNDS", "NEAR_WHOLE", "NEWTON", "NODE", "NOT_ESCAPED", "NO_PATH",
    "OMNI", "ON_BOUNDARY", "ON_LINE", "OUTWARD_STEPS", "OVERLAP", "PARALLEL", "PATIENCE", "PENUMBRA", "PHASES", "PI", "POINT",
    "POSE_COLUMNS", "POWERS", "RECEIVER_PERTURBATION", "ROWS", "SCATTERER", "SETTLED", "SHADE", "SHARP", "SHORTEST", "SIDE", "SLOTS", "SMALL",
    "SMOOTH_ERROR", "SOURCE_PERTURBATION", "SPECULAR_FAR", "SPECULAR_FOUND", "SPHERE", "SPARE", "SPHERICAL", "STATIC", "STEPS",
    "SUBBLOCK", "SUBBLOCKS", "TAPER_TERMS", "TAPS", "TILE", "TOGETHER", "TOUCHING", "VECTORS", "WITHIN",
}  # fmt: skip


# Mutants, and what is reported of them.
MUTANTS = {
    "plain.cpu.off_by_one": "Invalid read",
    "plain.cpu.not_cleared": "Uninitialized",
    "plain.gpu.no_barrier": "data race",  # the last one, as so many races may be all that Oclgrind reports
}
EVERYDAY = ("plain.cpu", "plain.cpu.off_by_one")


@pytest.fixture
def simulated(once, tmp_path_factory) -> Callable[..., Path]:
    """Return a function to the folder of scenes and mutants of one process of Oclgrind, made once in a run of the tests."""

    def folder(*names: str) -> Path:
        def make() -> str:
            made = tmp_path_factory.mktemp("oclgrind")
            render(OCLGRIND, made, *names)
            return str(made)

        return Path(once(f"scenes of drivers by Oclgrind: {names}", make))

    return folder


@pytest.mark.slow
@pytest.mark.parametrize("names", [exhaustive(BY_CPU), exhaustive(BY_GPU)], ids=["layout for CPUs", "layout for GPUs"])
def test_not_one_report(names: list[str], tmp_path: Path, by_pocl: Callable[..., Path]) -> None:
    assert render(OCLGRIND, tmp_path, *names) == ""
    wanted = by_pocl()
    assert {name: db for name in names if (db := apart_db(tmp_path, wanted, name)) > PARITY_DB} == {}


def test_not_one_report_of_one_scene(simulated: Callable[..., Path]) -> None:
    need_pocl()
    of_one = np.load(simulated(*EVERYDAY) / "plain.cpu.npz")
    assert of_one["reported"] == ""
    assert difference_db(of_one["heard"], rendered(POCL.platform, "plain.cpu")) < PARITY_DB


@pytest.mark.exhaustive
def test_scenes_run_every_kernel_with_every_option(by_pocl: Callable[..., Path]) -> None:
    ran = launched(by_pocl(), *BY_CPU, *BY_GPU, *(f"{name}.cpu" for name in sorted(ENDS)))
    assert {program for program, _ in ran} == set(PROGRAMS)
    assert unseen(ran, OPTIONS) == {}
    for program, options in OPTIONS_OF.items():
        assert unseen([row for row in ran if row[0] == program], options) == {}, program


def unseen(ran: list[tuple[str, dict[str, str]]], options: dict[str, set[str]]) -> dict[str, set[str]]:
    """Return the values of options with which nothing ran."""
    return {o: rest for o, wanted in options.items() if (rest := wanted - {given.get(o) for _, given in ran})}


def test_all_constants_are_options_or_numbers() -> None:
    assert set.union(*(set(program.constants) for program in PROGRAMS.values())) == OPTIONS.keys() | NUMBERS


@pytest.mark.parametrize("name", few(MUTANTS))
def test_mutants_are_reported(name: str, simulated: Callable[..., Path]) -> None:
    folder = simulated(*(EVERYDAY if name in EVERYDAY else [*MUTANTS][1:]))
    assert MUTANTS[name] in str(np.load(folder / f"{name}.npz")["reported"])


FALSE_REPORTS = """
import json, os, sys
from pathlib import Path
import numpy as np, pyopencl as cl

device, = next(p for p in cl.get_platforms() if p.name == "Oclgrind").get_devices()
context = cl.Context([device])
queue, flags, ones = cl.CommandQueue(context), cl.mem_flags, np.ones(64, np.float32)
log, reported = Path(os.environ["OCLGRIND_LOG"]), {}

def kernel(body):
    text = "__kernel void f(__global const float* x, __global float* y) {%s}" % body
    return cl.Kernel(cl.Program(context, text).build(), "f")

def note(cause, before=[0]):
    queue.finish()
    now = log.read_text()
    reported[cause] = now[before[0]:]
    before[0] = len(now)

copy, y = kernel("y[get_global_id(0)] = x[get_global_id(0)];"), cl.Buffer(context, flags.READ_WRITE, 256)
first = kernel("float8 v = *(__global const float8*)x; y[0] = ((const float*)&v)[0];")

written = cl.Buffer(context, flags.READ_WRITE, 256)
cl.enqueue_copy(queue, written, ones)
copy(queue, (64,), (32,), written, y)
note("written")

of_eight = cl.Buffer(context, flags.READ_WRITE, 32)
cl.enqueue_copy(queue, of_eight, ones[:7])
first(queue, (1,), (1,), of_eight, y)
note("one of eight")

filled = cl.Buffer(context, flags.READ_WRITE, 256)
cl.enqueue_fill_buffer(queue, filled, ones[:1], 0, 256)
copy(queue, (64,), (32,), filled, y)
note("filled")

live, order = [], np.random.default_rng(1)
for _ in range(40):
    count = int(order.choice([32, 64, 96, 128]))
    x = cl.Buffer(context, flags.READ_WRITE | flags.COPY_HOST_PTR, hostbuf=np.ones(count, np.float32))
    y = cl.Buffer(context, flags.READ_WRITE, 4 * count)
    copy(queue, (count,), (32,), x, y)
    copy(queue, (count,), (32,), y, x)
    queue.finish()
    live += [x, y]
    if len(live) > 6:
        order.shuffle(live)
        live = live[:3]
note("in place of others")
Path(sys.argv[1]).write_text(json.dumps(reported))
"""


def test_false_reports(tmp_path: Path) -> None:
    """All that is read was written; only what was written by `enqueue_copy`, by whole numbers, into a new buffer, is seen."""
    run(OCLGRIND, tmp_path, "-c", FALSE_REPORTS, str(tmp_path / "reported.json"))
    reported = json.loads((tmp_path / "reported.json").read_text())
    assert {cause for cause, said in reported.items() if "Uninitialized value" in said} == {
        "one of eight", "filled", "in place of others",
    }  # fmt: skip
    assert reported["written"] == ""
