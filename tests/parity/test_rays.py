"""Rays of energy on the device against their twin on the host: the same whole numbers."""

from dataclasses import replace
from typing import Any

import numpy as np
import pyopencl as cl
import pytest
from exhaustive import few
from made_rays import WALL, box, many_triangles, run_in, traced, with_a_door, with_a_sheet

import clsim
from clsim.numerics.sphere import fibonacci_sphere
from clsim.opencl.device import find_device
from clsim.tail.device_rays import DeviceRays
from clsim.tail.host_rays import HostRays, _Traced, next_wall, philox
from clsim.tail.ray_room import Energies, RayRoom, has_free_edges


@pytest.mark.parametrize("sized", [False, True])
@pytest.mark.parametrize("make", few([box, with_a_sheet, with_a_door, many_triangles], (1, 2)))
def test_the_device_adds_up_the_same_whole_numbers(device: None, make: Any, sized: bool) -> None:
    """All tables, for groups of any size: every sum, in any order of the work-items."""
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


def test_images_lose_nothing_to_limited_size() -> None:
    """Walls scatter by their size where images end: what images hold is the same to the last bit, all else is not."""
    run, layout = run_in(with_a_sheet(), sized=True)
    run = replace(run, scattered=np.zeros_like(run.scattered))
    by_size, endless = (traced(HostRays(), replace(run, sized=sized), layout) for sized in (True, False))
    np.testing.assert_array_equal(by_size.images, endless.images)
    assert np.any(by_size.windows != endless.windows)


def test_the_share_scattered_by_size_is_that_of_the_paper() -> None:
    """Frequencies f_w and f_l of Christensen and Rindel (2005), for the side that the ray runs along and the other."""
    run, layout = run_in(with_a_sheet(), sized=True)
    rays = _Traced(run, layout, layout.empty(), 1, np.arange(len(run.directions)))
    rays._far, after = np.full_like(rays._far, 2.0), np.full_like(rays._far, 3.0)
    room, frequency, distance = run.room, 343.0 / 0.7, 2.0 * 2.0 * 3.0 / (2.0 + 3.0)
    cosine = np.abs(np.sum(rays._d * room.plane[rays._wall, :3], axis=1))
    sides = np.stack([room.along[rays._wall], room.across[rays._wall]]).astype(np.float64)
    way = np.abs(np.einsum("sni,ni->sn", sides[..., :3], rays._d))
    pick = np.arange(len(cosine))
    width, length = sides[way.argmax(axis=0), pick, 3], sides[way.argmin(axis=0), pick, 3]
    f_w, f_l = 343.0 * distance / (2.0 * (width * cosine) ** 2), 343.0 * distance / (2.0 * length**2)
    expected = 1.0 - np.minimum(frequency / f_w, 1.0) * np.minimum(frequency / f_l, 1.0)
    assert 0.0 == expected.min() < 0.5 < expected.max()
    np.testing.assert_allclose(rays._share_by_size(cosine, after), expected, atol=1e-5)


def test_walls_are_as_large_as_their_planes_and_convex_rooms_have_no_free_edges() -> None:
    box, glass = [(x, y, z) for z in (0, 3) for y in (0, 4) for x in (0, 5)], clsim.Material.from_reflection(0.98)
    sides = [(0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5)]
    window = [(5, 1, 1), (5, 2, 1), (5, 2, 2), (5, 1, 2)]
    room = clsim.MeshRoom.from_polygons([*box, *window], [*sides, (8, 9, 10, 11)], [WALL] * 6 + [glass])
    rays = RayRoom.of(room)
    flush = np.abs(rays.plane[:, 0]) > 0.5
    assert np.count_nonzero(flush) == 2 + 1  # both walls across x, and the window
    np.testing.assert_allclose(np.sort([rays.along[flush, 3], rays.across[flush, 3]], axis=0).T, [[3.0, 4.0]] * 3)
    assert not has_free_edges(room)
    assert not has_free_edges(clsim.Shoebox((5.0, 4.0, 3.0), WALL))
    assert has_free_edges(with_a_sheet())


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
