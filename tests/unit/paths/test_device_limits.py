"""Limits of devices in the search for paths, by a description that is set: each holds, or it is said what to do."""

import dataclasses
import os
from collections.abc import Callable

import numpy as np
import pyopencl as cl
import pytest
from made_meshes import hall, l_room

import clsim
from clsim.opencl.device import DeviceInfo, find_device, operations_in_launch
from clsim.opencl.launch import Compiler
from clsim.paths.search import mesh as mesh_module
from clsim.paths.visibility.device import GROUP, OPERATIONS_PER_BOX, DeviceSearch
from clsim.paths.visibility.intervals import TrajectoryTables

pytestmark = pytest.mark.usefixtures("device")
GIB = 2**30
LAPTOP = {
    "kind": "GPU", "memory_bytes": GIB, "largest_buffer_bytes": GIB // 4, "compute_units": 8, "clock_hz": 0.5e9,
    "largest_group": 64,
}  # fmt: skip
WALL = clsim.Material.from_reflection(0.9)


@pytest.fixture
def described(monkeypatch: pytest.MonkeyPatch) -> Callable:
    """Return a function that gives the device of the search another description."""
    info, handle = find_device(None)

    def give(**limits) -> DeviceInfo:
        said = dataclasses.replace(info, **limits)
        monkeypatch.setattr(mesh_module, "find_device", lambda _: (said, handle))
        return said

    return give


@pytest.fixture
def watched(monkeypatch: pytest.MonkeyPatch) -> tuple[list[int], list[tuple[str, tuple, dict]]]:
    """Return sizes of buffers, and program, size and arguments of launches, both as they come."""
    sizes, launches, make, kernel = [], [], cl.Buffer, Compiler.kernel

    def buffer(*arguments, **options):
        made = make(*arguments, **options)
        sizes.append(made.size)
        return made

    def noted(compiler, program, constants):
        launch = kernel(compiler, program, constants)

        def call(queue, items, **arguments):
            launches.append((program, items, constants | arguments))
            return launch(queue, items, **arguments)

        return call

    monkeypatch.setattr(cl, "Buffer", buffer)
    monkeypatch.setattr(Compiler, "kernel", noted)
    return sizes, launches


def columns(paths: clsim.PathSet) -> list[np.ndarray]:
    family = paths.families[0]
    return [family.objects, family.receiver, family.start, family.end]


def scene(corners: np.ndarray, faces: np.ndarray, places: list) -> clsim.Scene:
    tone = clsim.Signal.tone(40e3, 0.5, 192e3)
    source = clsim.Source("s", tone, clsim.Trajectory.line(places[0], places[1], 1.0))
    ears = clsim.receiver_array("r", places[2:])
    return clsim.Scene(clsim.MeshRoom(corners, faces, WALL), clsim.Air(), [source], ears)


SCENES = {
    "an L": (scene(*l_room(), [(2, 8, 1.4), (2.2, 2, 1.3), (6.4, 2.2, 1.9), (7.2, 1.2, 2.0)]), 2),
    "a hall": (scene(*hall(5), [(11.3, -2.9, 3.6), (11.6, -2.7, 3.6), (8.7, 1.4, 4.6)]), 2),
}


def searched(launches: list, order: int) -> int:
    """Number of launches for the highest order: those of the warning of edges, of lower orders, are short anyway."""
    return sum(told.get("ORDER") == order for *_, told in launches)


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("slow", [False, True], ids=["a laptop's", "the slowest"])
def test_a_small_gpu_finds_the_same_in_short_launches(name: str, slow: bool, described, watched) -> None:
    of, order = SCENES[name]
    whole = columns(clsim.find_paths(of, order))
    ever = searched(watched[1], order)
    watched[0].clear()
    watched[1].clear()
    info = described(**LAPTOP | ({"compute_units": 1, "clock_hz": 1e7} if slow else {}))
    for got, wanted in zip(columns(clsim.find_paths(of, order)), whole, strict=True):
        np.testing.assert_array_equal(got, wanted)
    sizes, launches = watched
    assert max(sizes) <= GIB // 4
    assert sum(sizes) <= GIB
    assert not slow or searched(launches, order) > 4 * ever
    launches = [launch for launch in launches if launch[0] != "edge_intervals"]  # of the warning of edges
    programs = {program for program, *_ in launches}
    assert programs == {"intervals"} | ({"meetings", "crossings"} if name == "a hall" else set())
    for program, (size, group), told in launches:
        assert np.prod(group) <= GROUP
        boxes = OPERATIONS_PER_BOX * (told["box_count"] + 1)
        if program == "intervals":
            items, each = told["active_count"] * told["budget"], 2 * (told["ORDER"] + 1) * boxes
        else:
            items, each = told.get("segments", told.get("beams")), boxes
        assert items == 1 or items * each <= operations_in_launch(info), (program, size)


@pytest.mark.parametrize("group", [64, 256, 1024])
def test_work_groups_of_any_device_do(group: int, described) -> None:
    described(**LAPTOP | {"largest_group": group})
    assert len(clsim.find_paths(SCENES["a hall"][0], 0)) > 0


@pytest.mark.parametrize(
    ("limits", "message"),
    [
        ({"largest_group": 8}, r"groups of at most 8 items, but 16 are needed; choose another device"),
        ({"largest_buffer_bytes": 2**10}, r"walls need .* for the column .*: use fewer walls, choose another device"),
        ({"memory_bytes": 2**12, "largest_buffer_bytes": 2**12}, r"walls need .*or use engine=\"reference\""),
    ],
)
def test_what_is_too_small_says_what_to_do(limits: dict, message: str, described) -> None:
    described(**LAPTOP | limits)
    with pytest.raises(clsim.DeviceError, match=message):
        clsim.find_paths(SCENES["an L"][0], 1)


def test_long_tables_of_motion_say_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    info, handle = find_device(None)
    room, times = clsim.MeshRoom(*l_room(), WALL), np.linspace(0.0, 1.0, 400)
    way = clsim.Trajectory.waypoints(times, np.column_stack([2 + times, 8 - times, 1 + 0.1 * np.sin(9 * times)]))
    query, _ = mesh_module.visibility_query(
        clsim.Scene(room, clsim.Air(), [clsim.Source("s", clsim.Signal.tone(40e3, 0.5, 192e3), way)],
                    clsim.receiver_array("r", [(6.4, 2.2, 1.9)])),
        room, clsim.Source("s", clsim.Signal.tone(40e3, 0.5, 192e3), way), 1, None,
    )  # fmt: skip
    assert isinstance(query.trajectory_tables, TrajectoryTables)
    small = dataclasses.replace(info, largest_buffer_bytes=query.trajectory_tables.knots.nbytes - 1)
    with pytest.raises(
        clsim.DeviceError, match=r"for the knots of trajectories: look for the paths of fewer receivers"
    ):
        DeviceSearch(query, (small, handle)).find(np.empty((1, 0), dtype=np.int32), np.zeros(1, dtype=np.int64))


def test_without_float64_paths_are_searched_for_by_numpy(described, watched) -> None:
    of, _ = SCENES["an L"]
    wanted = columns(clsim.find_paths(of, 1, engine="reference"))
    described(fp64=False)
    watched[1].clear()
    with pytest.warns(clsim.ClsimWarning, match="has no float64: paths are validated by NumPy"):
        got = columns(clsim.find_paths(of, 1))
    assert not watched[1]
    for one, other in zip(got, wanted, strict=True):
        np.testing.assert_array_equal(one, other)


def test_after_a_fork_paths_are_searched_for_by_numpy(monkeypatch: pytest.MonkeyPatch) -> None:
    """The warning names the fork, and the way to start processes that keeps the device."""
    monkeypatch.setattr("clsim.opencl.device._openers", [os.getpid() + 1])  # as in a child
    with pytest.warns(clsim.ClsimWarning, match='forked from .* "spawn" .*: paths are validated by NumPy'):
        clsim.find_paths(SCENES["an L"][0], 1)
