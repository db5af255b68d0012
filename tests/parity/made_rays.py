"""Runs of rays in small rooms, and engines that trace them."""

from typing import Any

import numpy as np

import clsim
from clsim.numerics.sphere import fibonacci_sphere
from clsim.tail.ray_room import SLOTS, Energies, Layout, RayRoom, RayRun

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
