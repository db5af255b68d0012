"""Rays of energy on the device against their twin on the host: the same whole numbers."""

from dataclasses import replace
from typing import Any

import numpy as np
import pyopencl as cl
import pytest

import clsim
from clsim.numerics.sphere import fibonacci_sphere
from clsim.opencl.device import find_device
from clsim.tail.device_rays import DeviceRays
from clsim.tail.host_rays import HostRays, next_wall, philox
from clsim.tail.ray_room import RayRoom
from clsim.tail.ray_run import SLOTS, Energies, Layout, RayRun

C, RADIUS, BANDS = 343.0, 0.5, 4
WALL = clsim.Material.from_reflection(0.9)
CORNER = [(0, 0), (7, 0), (7, 3), (4, 3), (4, 6), (0, 6)]


def box() -> clsim.Shoebox:
    return clsim.Shoebox((6.2, 4.7, 3.1), WALL)


def with_a_sheet() -> clsim.MeshRoom:
    """A room with a corner and a sheet that hangs in it."""
    room = clsim.MeshRoom.from_plan(CORNER, 3.0, WALL)
    sheet = clsim.MeshRoom([(1, 1, 0.5), (1, 2, 0.5), (1, 2, 2.0), (1, 1, 2.0)], [(0, 1, 2), (0, 2, 3)], WALL)
    return clsim.MeshRoom.joined([room, sheet])


def with_a_door() -> clsim.MeshRoom:
    """A box one of whose triangles is missing."""
    mesh = box().as_mesh()
    return clsim.MeshRoom(mesh.vertices, mesh.triangles[:-1], WALL)


def many_triangles() -> clsim.MeshRoom:
    """Boxes in a box: a tree of three levels."""
    rng, parts = np.random.default_rng(4), [box().as_mesh()]
    for place in rng.uniform(0.4, [5.4, 3.9, 2.4], (40, 3)):
        crate = clsim.Shoebox(rng.uniform(0.05, 0.3, 3), WALL).as_mesh()
        parts.append(clsim.MeshRoom(crate.vertices + place, crate.triangles, WALL))
    return clsim.MeshRoom.joined(parts)


def run_in(room: Any, *, sized: bool, each: int = 8) -> tuple[RayRun, Layout]:
    """Rays in two groups of bands, walls of two materials, three zones of which two share late energies."""
    rays, rng = RayRoom.of(room), np.random.default_rng(1)
    directions = fibonacci_sphere(each * SLOTS)[rng.permutation(each * SLOTS)].astype(np.float32)
    walls, count = len(rays.plane), len(directions)
    zones = np.column_stack([rng.uniform(-0.8, 0.8, (3, 3)), np.full(3, 1.0 / (4.0 / 3.0 * np.pi * RADIUS**3))])
    returned = rng.uniform(0.7, 0.99, (2, 128, BANDS)).astype(np.float32)
    scattered = rng.uniform(0.0, 0.5, (2, 128, 2)).astype(np.float32)
    run = RayRun(
        rays, sized, rng.integers(0, 2, walls).astype(np.int32), returned, scattered, np.array([0, 1, BANDS], np.int32),
        np.array([2.7, 0.7], np.float32), np.array([150.0, 90.0], np.float32), 2,
        np.array([-1.7, -0.4, 0.3], np.float32), directions, rng.uniform(0.5, 1.0, (count, BANDS)).astype(np.float32),
        rng.integers(0, 8, count).astype(np.int32), 5, 3, (7, 2**32 - 9),
    )  # fmt: skip
    arrivals = np.pad(fibonacci_sphere(16), ((0, 0), (0, 1))).astype(np.float32)
    layout = Layout(
        zones.astype(np.float32), RADIUS, np.array([0, 1, 0], np.int32), 2, arrivals, 8, 1e-3 * C, 0.02 * C, 400, 100,
        20, 0.1 * C, 2.0**34, BANDS, walls,
    )  # fmt: skip
    return run, layout


def traced(engine: Any, run: RayRun, layout: Layout) -> Energies:
    found = layout.empty()
    engine.trace(run, layout, found)
    return found


@pytest.mark.parametrize("sized", [False, True])
@pytest.mark.parametrize("make", [box, with_a_sheet, with_a_door, many_triangles])
def test_the_device_adds_up_the_same_whole_numbers(device: None, make: Any, sized: bool) -> None:
    """Of all tables, for groups of any size: every sum, whatever the order in which work-items come to it."""
    run, layout = run_in(make(), sized=sized)
    expected = traced(HostRays(), run, layout)
    for group in (1, 16, 64):
        found = traced(DeviceRays(find_device(None), group), run, layout)
        for name in Energies.TABLES:
            np.testing.assert_array_equal(getattr(found, name), getattr(expected, name), err_msg=name)
    for name in ("early", "late", "images", "windows", "departures"):
        assert getattr(expected, name).any(), name
    assert expected.escaped.any() == (make is with_a_door)
    changed = replace(run, key=(8, 1))
    assert np.any(traced(HostRays(), changed, layout).early != expected.early)


def test_threads_change_nothing(device: None) -> None:
    """The units of a device are its threads: part of them, all, and one after another find the same."""
    info, whole = find_device(None)
    run, layout = run_in(with_a_sheet(), sized=False, each=32)
    expected = traced(DeviceRays((info, whole)), run, layout)
    kinds = cl.device_partition_property
    if info.compute_units < 2 or kinds.EQUALLY not in whole.get_info(cl.device_info.PARTITION_PROPERTIES):
        pytest.skip("the device has one unit, or cannot be divided")
    one = whole.create_sub_devices([kinds.EQUALLY, 1])[0]
    found = traced(DeviceRays((replace(info, compute_units=1), one)), run, layout)
    for name in Energies.TABLES:
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name), err_msg=name)


def test_the_tree_finds_what_all_triangles_do() -> None:
    """The nearest triangle of all, by float64 and the textbook's formula."""
    mesh, rng = many_triangles(), np.random.default_rng(2)
    room = RayRoom.of(mesh)
    d = fibonacci_sphere(500).astype(np.float32)
    o = rng.uniform(-0.3, 0.3, (500, 3)).astype(np.float32)
    far, wall = next_wall(room, o, d, np.full(500, 3e38, np.float32))
    a, b, c = np.moveaxis(mesh.vertices[mesh.triangles] - room.middle, 1, 0)
    p = np.cross(d[:, None].astype(float), c - a)
    det = np.einsum("ntk,tk->nt", p, b - a)
    s = o[:, None] - a
    with np.errstate(divide="ignore", invalid="ignore"):
        u = np.einsum("ntk,ntk->nt", p, s) / det
        q = np.cross(s, b - a)
        v, t = np.einsum("nk,ntk->nt", d, q) / det, np.einsum("tk,ntk->nt", c - a, q) / det
    t = np.where((u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0), t, np.inf)
    np.testing.assert_allclose(far, t.min(axis=1), rtol=1e-5)
    assert np.mean(wall == mesh.walls.of_triangle[t.argmin(axis=1)]) > 0.995


def test_random_words_are_those_of_the_paper() -> None:
    """Known answers of Philox-4x32 with ten rounds, as published with the generator."""
    ones = 2**32 - 1
    counters = np.array([[0, 0, 0, 0], [ones] * 4, [0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344]], np.uint64)
    keys = ((0, 0), (ones, ones), (0xA4093822, 0x299F31D0))
    wanted = [
        "6627e8d5 e169c58d bc57ac4c 9b00dbd8", "408f276d 41c83b0e a20bc7c6 6d5451fd", "d16cfe09 94fdcceb 5001e420 24126ea1",
    ]  # fmt: skip
    for counter, key, words in zip(counters, keys, wanted, strict=True):
        assert " ".join(f"{word:08x}" for word in philox(counter[None], key)[0]) == words
