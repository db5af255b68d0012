"""Places in buffers beyond 2^31: every launch of some scenes with its rows far up in memory that is mostly not there.

Rows are moved by what counts them (blocks, rows of branch signals, receivers) or by where a launch begins. The memory is as
large as so many rows would make it, but has pages only where something stands.
"""

import dataclasses
import mmap
import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pyopencl as cl
import pytest
from driver_scenes import CURTAIN, REAL, SCENES, partly, plan, world

import clsim
from clsim.opencl.device import find_device
from clsim.opencl.launch import NUMBERS, PROGRAMS, Compiler, Launch, kernel_folder
from clsim.render.opencl.baseband_engine import BasebandEngine
from clsim.render.opencl.engine import CPU_LAYOUT, OpenclEngine
from clsim.render.plan import Plan
from clsim.render.planning import BUILDERS

pytestmark = [pytest.mark.usefixtures("device"), pytest.mark.filterwarnings("ignore::clsim.ClsimWarning")]
POCL = "Portable Computing Language"
FAR = 2**31 + 2**22  # elements
NO_PAGES = 0x4000  # MAP_NORESERVE of Linux
TYPES = NUMBERS | {"float4": np.dtype("4f4"), "double4": np.dtype("4f8"), "int2": np.dtype("2i4")}


class FarLaunch:
    """Launches a kernel with rows of its buffers moved up, and puts what it wrote back to where it belongs."""

    def __init__(self, program: str, launch: Launch, constants: dict) -> None:
        self.program, self.constants, self.kernel = program, constants, launch._kernel._kernel
        self.arguments = PROGRAMS[program].arguments
        self.moved: set[str] = set()

    def __call__(self, queue: Any, items: tuple, **given: Any) -> Any:
        told = dict(given)
        offset = [0] * len(items[0])
        moves = MOVES[self.program](told, self.constants | {"slots": items[0][0]}, offset)
        regions = {
            name: self.place(queue, name, told[name], by) for name, by in moves.items() if told[name] is not None
        }
        self.moved.update(regions)
        told |= {name: cl.SVM(base) for name, (base, _, _) in regions.items()}

        def launch(queue: Any, size: tuple, group: tuple, *arguments: Any) -> Any:
            return self.kernel(queue, size, group, *arguments, global_offset=tuple(offset))

        event = Launch(self.program, launch, self.arguments)(queue, items, **told)
        queue.finish()
        for name, (_, here, _) in regions.items():
            if "out" in self.arguments[name].access:
                if name == "found" and self.program == "meetings":
                    here[:, 0] -= offset[0]
                cl.enqueue_copy(queue, given[name], np.ascontiguousarray(here))
        return event

    def place(self, queue: Any, name: str, what: Any, by: int) -> tuple[np.ndarray, np.ndarray, mmap.mmap]:
        """Return memory, where a buffer stands in it, so many elements up, and what holds it."""
        kind = np.dtype(TYPES[self.arguments[name].type])
        if isinstance(what, cl.Buffer):
            content = np.empty(what.size // kind.itemsize, kind)
            cl.enqueue_copy(queue, content, what)
        else:
            content = np.ascontiguousarray(what, kind.base).reshape(-1, *kind.shape)
        below = 2**32 * kind.itemsize  # where places that wrap around would be
        size = below + (by + len(content)) * kind.itemsize
        region = mmap.mmap(-1, size, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS | NO_PAGES)
        base = np.frombuffer(region, np.uint8)[below:]
        here = np.frombuffer(base.data[by * kind.itemsize :], kind.base).reshape(content.shape)
        here[:] = content
        return base, here, region


def up(queue_array: Any, by: int) -> np.ndarray:
    """Return an array of int with a number added to all of it, read from a buffer if it is one."""
    if isinstance(queue_array, cl.Buffer):
        with cl.CommandQueue(queue_array.get_info(cl.mem_info.CONTEXT)) as queue:
            found = np.empty(queue_array.size // 4, np.int32)
            cl.enqueue_copy(queue, found, queue_array)
        queue_array = found
    return np.asarray(queue_array, np.int32) + np.int32(by)


def rendering(row: str) -> Callable:
    """Return a function that moves blocks, branch signals and samples; `row` counts receivers."""

    def moves(told: dict, constants: dict, offset: list[int]) -> dict[str, int]:
        parts = 2 if "envelope" in told else 1
        slots, functions = told["slots"], told.get("functions", constants.get("FUNCTIONS"))
        blocks, rows = FAR // slots + 1, FAR // told["stride"] // parts + 1
        heard, length = ("envelope", "envelope_stride") if parts == 2 else ("pressure", "pressure_stride")
        ears = FAR // told[length] // parts + 1
        told["first_block"] += blocks
        told["first_row"] = up(told["first_row"], rows)
        told[row] = up(told[row], ears)
        per_block = blocks * slots
        return {
            "delay": per_block, "activity": per_block,
            "polynomials": per_block * (constants["DELAY_TERMS"] + 4 * functions),
            "branches": parts * rows * told["stride"], heard: parts * ears * told[length],
        }  # fmt: skip

    return moves


def clear_gains(told: dict, constants: dict, offset: list[int]) -> dict[str, int]:
    blocks = FAR // told["slots"] + 1
    told["block"] = up(told["block"], blocks)
    return {"polynomials": blocks * told["slots"] * (constants["DELAY_TERMS"] + 4 * told["functions"])}


def emit(told: dict, constants: dict, offset: list[int]) -> dict[str, int]:
    offset[1] = FAR // min(told["stride"], told["count"]) + 1
    return {"emitted": offset[1] * told["stride"], "values": offset[1] * told["count"]}


def branches(told: dict, constants: dict, offset: list[int]) -> dict[str, int]:
    rows = FAR // told["stride"] + 1
    told["first_row"] += rows
    told["first_emitted"] += FAR
    return {"emitted": FAR, "rows": rows * told["stride"]}


def coarse_delays(told: dict, constants: dict, offset: list[int]) -> dict[str, int]:
    groups = FAR // (2 * constants["slots"] * constants["NODES_AT_ONCE"]) + 1
    ends = groups * constants["NODES_AT_ONCE"]
    offset[1] = groups
    told["start"] -= ends * told["segment_time"]
    return {"delays": 2 * ends * constants["slots"]}


def tracks(told: dict, constants: dict, offset: list[int]) -> dict[str, int]:
    """Receivers are at rest here, so that they have one row."""
    slots = constants["slots"]
    offset[1] = FAR // (slots * told["segment_blocks"]) + 1
    blocks = offset[1] * told["segment_blocks"]
    samples = blocks * told["block_samples"]
    assert samples < 2**30
    told["active_from"], told["active_until"] = (np.clip(x.astype(np.int64) + samples, -(2**30), 2**31 - 1).astype(np.int32)
                                               for x in (told["active_from"], told["active_until"]))  # fmt: skip
    told["start"] -= samples / told["sampling_rate"]
    told["origin"] -= samples
    told["first_segment"] -= offset[1]
    told["blocks"] += blocks
    of_blocks, of_segments = blocks * slots, offset[1] * slots
    terms = constants["DELAY_TERMS"] + 4 * told["function_count"]
    return {
        "delay": of_blocks, "activity": of_blocks, "polynomials": of_blocks * terms, "found": of_segments,
        "residual": of_segments,
    }  # fmt: skip


def crossings(told: dict, constants: dict, offset: list[int]) -> dict[str, int]:
    offset[0] = 2**30
    told["segments"] += 2**30
    return {"start": 3 * 2**30, "stop": 3 * 2**30, "found": constants["MOST"] * 2**30}


def meetings(told: dict, constants: dict, offset: list[int]) -> dict[str, int]:
    offset[0] = 2**30
    told["beams"] += 2**30
    return {"half_spaces": 2**30 * told["half_space_count"], "centre": 3 * 2**30, "last_wall": 2**30, "found": 0}


MOVES = {
    "render": rendering("pressure_row"), "fades": rendering("row"), "baseband": rendering("envelope_row"),
    "baseband_fades": rendering("row"), "clear_gains": clear_gains, "emit": emit, "branches": branches,
    "coarse_delays": coarse_delays, "tracks": tracks, "crossings": crossings, "meetings": meetings,
}  # fmt: skip


def dense(device: str) -> Plan:
    """Paths that come and go, in blocks so short that the samples of so many are counted in 32 bits."""
    return plan(partly(world(still=True), 0.001), device, blocks=(24,), responses="centre")


def sparse(device: str) -> Plan:
    """Silence, and several functions."""
    pulse = clsim.Signal.pulses(clsim.Signal.chirp(38e3, 42e3, 0.2e-3, 192e3, window="hann"), 1.5e-3, 2)
    return plan(partly(world(pulse, [CURTAIN, *REAL[1:]], still=True), 0.0012), device, blocks=(24,), duration=0.003)


def envelopes(device: str) -> Plan:
    made = plan(partly(world(still=True), 0.0012), device, blocks=(), baseband=(40e3, 12e3), duration=0.005)
    return dataclasses.replace(made, blocks=(24,), builders=BUILDERS)


COMMON = {"coarse_delays", "tracks", "emit", "branches", "clear_gains"}
RENDERED = {
    dense: COMMON | {"fades", "render"}, sparse: COMMON | {"fades", "render"},
    envelopes: COMMON | {"baseband_fades", "baseband"},
}  # fmt: skip


@pytest.fixture
def moving(monkeypatch: pytest.MonkeyPatch) -> Callable[[], dict[str, set[str]]]:
    """Return a function that moves the buffers of all later launches, and a list of the moved buffers by program."""
    if find_device(None)[0].platform != POCL:
        pytest.skip("only PoCL takes memory of the host as it is")

    def move() -> dict[str, set[str]]:
        moved: dict[str, set[str]] = {}
        compiled = Compiler.kernel

        def kernel(compiler: Compiler, program: str, constants: dict) -> Any:
            launch = compiled(compiler, program, constants)
            if program not in MOVES:
                return launch
            far = FarLaunch(program, launch, constants)
            far.moved = moved.setdefault(program, set())
            return far

        monkeypatch.setattr(Compiler, "kernel", kernel)
        return moved

    return move


@pytest.mark.parametrize("make", RENDERED)
def test_what_is_heard_does_not_depend_on_where_rows_stand(make: Callable, moving: Callable) -> None:
    made = make(None)
    engine = OpenclEngine if made.baseband is None else BasebandEngine
    whole = engine(made, CPU_LAYOUT).render(0, made.samples)
    moved = moving()
    far = engine(made, CPU_LAYOUT).render(0, made.samples)
    assert moved.keys() == RENDERED[make]
    for program, buffers in moved.items():
        written = {n for n, a in PROGRAMS[program].arguments.items() if "out" in a.access} - {
            "residual",
            "activity",
            "states",
        }
        assert written <= buffers, program
    assert np.any(whole)
    # Nodes are made at instants some thousand seconds away, whose rounding is 1e-12 s.
    assert np.linalg.norm(far - whole) < 1e-5 * np.linalg.norm(whole)


def test_paths_do_not_depend_on_where_rows_stand(moving: Callable) -> None:
    whole = SCENES["crowd"](None).tracks.of_scene.pair_paths[0].family
    moved = moving()
    far = SCENES["crowd"](None).tracks.of_scene.pair_paths[0].family
    assert {"crossings", "meetings"} <= moved.keys()
    for name in ("objects", "start", "end"):
        np.testing.assert_array_equal(getattr(far, name), getattr(whole, name))
    np.testing.assert_array_equal(far.legs[0].offset, whole.legs[0].offset)


# What there is no bound of but memory: places are counted by them in 64 bits. Compilers may widen what overflows, or not.
UNBOUNDED = "slots|stride|pressure_stride|envelope_stride|nodes|ends|segment|beam|path(?!->)|wall_count"


def test_products_that_count_places_have_64_bits() -> None:
    for file in [*kernel_folder().rglob("*.cl"), *kernel_folder().rglob("*.h")]:
        text = re.sub(r"//[^\n]*", "", file.read_text("utf-8"))
        wide = set(re.findall(r"\blong (\w+)", text))
        narrow = [name for name in UNBOUNDED.split("|") if name not in wide]
        assert not re.findall(rf"[\w\])] \* (?:{'|'.join(narrow)})\b(?!\[)", text), file.name
