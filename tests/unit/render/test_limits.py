"""Limits of devices, by a description that is set: each holds, or it is said what to do."""

import dataclasses
import tracemalloc
from collections.abc import Callable

import numpy as np
import pytest

import clsim
from clsim.opencl import device as device_module
from clsim.opencl.device import LONGEST_LAUNCH, check_group
from clsim.opencl.launch import Compiler
from clsim.render.opencl import batches as batches_module
from clsim.render.opencl import engine as engine_module
from clsim.render.opencl.batches import fill_batch
from clsim.render.opencl.branch_signals import Limits
from clsim.render.opencl.engine import CPU_LAYOUT, GPU_LAYOUT, OpenclEngine
from clsim.render.plan import BATCH, NODE_BUDGET, SEGMENT, Plan
from clsim.render.planning import plan_render

RATE = 192e3
TONE = clsim.Signal.tone(40e3, 0.25, RATE, fade=0.005)
GIB = 2**30
LAPTOP = device_module.DeviceInfo(
    "0:0", "A small GPU", "made up", "OpenCL 3.0", "GPU", GIB, 8, GIB // 4, 256, 0.5e9, "1", fp64=False
)


def plan(receivers: int = 2, order: int = 1, duration: float = 0.3, **options) -> Plan:
    way = clsim.Trajectory.line((2.0, 2.0, 1.0), (2.5, 2.2, 1.1), 0.5)
    ears = clsim.receiver_array("r", clsim.grid_positions((1.0, 5.0, receivers), 3.0, 2.0))
    room = clsim.Shoebox((6, 5, 3), clsim.Material.from_reflection(0.8))
    scene = clsim.Scene(room, clsim.Air(), [clsim.Source("s", TONE, way)], ears)
    options = {"interpolator": clsim.Bandlimited(-60.0), "narrowband": False} | options
    return plan_render(clsim.find_paths(scene, order), RATE, responses="centre", duration=duration, **options)


@pytest.fixture
def described(monkeypatch: pytest.MonkeyPatch) -> Callable:
    """Return a function that gives the device another description."""

    def give(**limits) -> None:
        info, handle = device_module.find_device(None)
        monkeypatch.setattr(engine_module, "find_device", lambda _: (dataclasses.replace(info, **limits), handle))

    return give


def test_a_small_memory_is_rendered_in_pieces(device: None, described: Callable) -> None:
    made = plan()
    whole = OpenclEngine(made).render(0, made.samples)
    described(memory_bytes=32 * 2**20, largest_buffer_bytes=2**20)
    engine = OpenclEngine(made)
    assert engine.limits.most_samples < made.samples
    pieces = engine.render(0, made.samples)
    assert np.linalg.norm(pieces - whole) < 1e-6 * np.linalg.norm(whole)
    for buffer in engine._scratch._kept.values():
        assert buffer.size <= 2**20


@pytest.mark.parametrize("receivers", [2, 64])
def test_a_gibibyte_and_quarters_of_it_hold_long_chunks_of_many_receivers(receivers: int) -> None:
    made = plan(receivers, duration=0.3, chunk=10**9)
    long = dataclasses.replace(made, chunk=10**9 // SEGMENT * SEGMENT, builders=())
    limits = Limits(long, LAPTOP, 1)
    needed = {name: size * limits.most_samples for name, size in limits._per_sample.items()}
    assert max(needed.values()) <= GIB // 4
    assert sum(needed.values()) + 3 * limits.node_budget <= GIB
    assert limits.most_samples >= SEGMENT


def test_what_cannot_fit_says_what_to_do() -> None:
    small = dataclasses.replace(LAPTOP, memory_bytes=2**24, largest_buffer_bytes=2**22)
    with pytest.raises(clsim.DeviceError, match=r"pressure of all receivers: render fewer receivers at a time"):
        Limits(plan(64, 0), small, 1)


def test_launches_are_short_by_estimate() -> None:
    made = plan()
    limits, paths = Limits(made, LAPTOP, 1), 1600
    segments = limits.segments_in_launch(paths, 768)
    operations = segments * paths * SEGMENT * (2 * int(made.source_filters[0].rows[-1]) + 10)
    assert operations <= LONGEST_LAUNCH * 4 * 8 * 0.5e9
    assert limits.segments_in_launch(10**7, 768) == 1
    assert Limits(made, dataclasses.replace(LAPTOP, kind="CPU"), 1).segments_in_launch(paths, 8) > 10**6


@pytest.mark.parametrize(
    ("clock_hz", "least"), [(3e6, {"branches": 2, "render": 4}), (1.5e8, {"branches": 1, "render": 3})]
)
def test_no_launch_is_longer_than_its_estimate(device, described, monkeypatch, clock_hz, least) -> None:
    """Launches of a whole rendering: operations by their own arguments, against those of 0.2 s, but for one segment."""
    made = plan(order=3, duration=0.4)
    described(kind="GPU", compute_units=1, clock_hz=clock_hz)
    launches, kernel = [], Compiler.kernel

    def noted(compiler, program, constants):
        launch = kernel(compiler, program, constants)

        def call(queue, items, **arguments):
            launches.append((program, items[0][0], constants | arguments))
            return launch(queue, items, **arguments)

        return call

    monkeypatch.setattr(Compiler, "kernel", noted)
    OpenclEngine(made, CPU_LAYOUT).render(0, made.samples)
    rows, longest = int(made.source_filters[0].rows[-1]), made.tracks.longest_delay(0.0, made.duration) * RATE
    for program, size, told in launches:
        if program == "branches":  # beside the chunk's samples there are those of the longest delay, rounded up
            samples, operations = told["width"] - 1.4 * longest, 2 * told["tap_count"] * rows
        elif program == "render":
            samples = size // told["WORKERS"] * told["SUBBLOCKS"] * made.subblock(0, made.blocks[0])
            operations = 2 * rows * made.path_count
        else:
            continue
        assert samples <= SEGMENT or samples * operations <= LONGEST_LAUNCH * 4 * clock_hz, (program, samples)
    for program, count in least.items():
        assert sum(name == program for name, *_ in launches) >= count


def test_paths_are_parted_where_one_launch_of_all_is_too_long(device, described: Callable, monkeypatch) -> None:
    made = plan(duration=0.1, order=5)
    whole = OpenclEngine(made, CPU_LAYOUT).render(0, made.samples)
    described(kind="GPU", compute_units=1, clock_hz=1e6)
    engine = OpenclEngine(made, CPU_LAYOUT)
    assert engine.limits.paths_in_launch == BATCH < made.path_count // 4
    batches = []
    monkeypatch.setattr(batches_module, "fill_batch", lambda *given: batches.append(fill_batch(*given)) or batches[-1])
    parts = engine.render(0, made.samples)
    assert len(batches) > 4
    assert all(len(set(b.receiver.tolist())) == len(b.receiver) for b in batches), "launches of the same samples race"
    assert np.linalg.norm(parts - whole) < 1e-6 * np.linalg.norm(whole)
    few = Limits(made, LAPTOP, 1)
    for paths in (few.paths_in_launch, few.paths_in_launch + BATCH):
        operations = paths * SEGMENT // made.shortest_block * 32_000
        assert (operations <= LONGEST_LAUNCH * 4 * 8 * 0.5e9) == (paths == few.paths_in_launch)


def test_samples_of_a_chunk_are_counted_in_32_bits() -> None:
    large = dataclasses.replace(LAPTOP, kind="CPU", memory_bytes=2**42, largest_buffer_bytes=2**42)
    made = plan(64)
    long = dataclasses.replace(made, chunk=2**36, builders=())
    limits = Limits(long, large, 1)
    span = made.tracks.longest_delay(0.0, made.duration) * RATE
    assert 0.8 * 2**31 < 1.07 * (limits.most_samples + span) < 2**31, "width of branch signals, rounded up by 1/16"
    # Places in rows of these pass 2^31, and are counted in 64 bits: see tests/unit/opencl/test_large_indices.py.
    assert limits.most_samples * int(made.source_filters[0].rows[-1]) > 2**33
    assert limits.most_samples * 64 > 2**36


def test_memory_of_a_plan_is_what_is_taken(device: None) -> None:
    sweep = clsim.Signal.chirp(36e3, 44e3, 0.9, RATE, window="tukey")
    absorbing = clsim.Material.from_absorption([20e3, 40e3, 60e3], [0.1, 0.4, 0.5])
    way = clsim.Trajectory.circle((3.0, 2.5, 1.5), 1.0, 1.047, 1.2)
    moving = clsim.Scene(clsim.Shoebox((6, 5, 3), absorbing), clsim.Air(), [clsim.Source("s", sweep, way)],
                         clsim.receiver_array("r", clsim.grid_positions((1.0, 5.0, 6), 3.0, 2.0)))  # fmt: skip
    plans = {
        "small": plan(1 + 1, 2, 0.7), "chunks": plan(4, 1, 1.2), "paths": plan(2, 9, 0.3), "many ears": plan(40, 1, 0.8),
        "functions": plan_render(clsim.find_paths(moving, 3), RATE, duration=0.9),
    }  # fmt: skip
    for name, made in plans.items():
        most = min(made.chunk, made.samples)
        OpenclEngine(made).render(0, most)  # builds
        engine = OpenclEngine(made)
        tracemalloc.start()
        for first in range(0, made.samples, most):
            engine.render(first, min(first + most, made.samples))
        taken = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        for scratch in (engine._scratch, *(maker._scratch for maker in engine._makers.values())):
            taken += sum(buffer.size for buffer in scratch._kept.values())
        # Nodes are counted in blocks of 768 and of 384 samples, three times those that this motion needs.
        assert 0.9 * taken < made.memory_bytes < 3.1 * taken, (name, taken, made.memory_bytes, made._memory())
    assert plans["small"].memory_bytes < NODE_BUDGET


def test_delays_that_cannot_be_counted_say_what_to_do() -> None:
    made = plan()
    endless = dataclasses.replace(made, sampling_rate=1e12, builders=())
    with pytest.raises(clsim.InputError, match=r"max_order: must leave delays that are counted in 32 bits, but the"):
        Limits(endless, dataclasses.replace(LAPTOP, memory_bytes=2**60, largest_buffer_bytes=2**60), 1)


def test_short_launches_change_nothing(device: None, described: Callable) -> None:
    made = plan(duration=0.2)
    whole = OpenclEngine(made, CPU_LAYOUT).render(0, made.samples)
    described(kind="GPU", compute_units=1, clock_hz=1.0)
    np.testing.assert_array_equal(OpenclEngine(made, CPU_LAYOUT).render(0, made.samples), whole)


@pytest.mark.parametrize("group", [64, 256, 1024])
def test_work_groups_of_any_device_do(group: int) -> None:
    check_group(dataclasses.replace(LAPTOP, largest_group=group), 32)


def test_smaller_work_groups_are_refused() -> None:
    with pytest.raises(clsim.DeviceError, match=r"at most 16 items, but 32 are needed; choose another"):
        check_group(dataclasses.replace(LAPTOP, largest_group=16), 32)


@pytest.mark.parametrize("layout", [CPU_LAYOUT, GPU_LAYOUT])
@pytest.mark.parametrize("sparse", [False, True])
@pytest.mark.parametrize("subblock", [8, 32])
def test_groups_and_local_memory_are_small(layout, sparse: bool, subblock: int) -> None:
    constants = layout.constants(subblock, sparse=sparse, fine=True, oversampling=1)
    assert constants["WORKERS"] <= 32
    # Of render.cl: the expanded batch, nine numbers a path with one function; and which paths sound in each subblock.
    local = constants["SUBBLOCKS"] * (constants["TILE"] + 4) if sparse else 4 * 9 * BATCH
    assert local <= 2**15
