"""Edges of the room and faces of bodies on one path, in any order: both ways alike, built in, and after a period."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from edge_fields import field

import clsim
from clsim.paths.path_set import PathSet

TONE, C = 40e3, 343.0
AIR = clsim.Air(absorption=False, speed_of_sound=C)
FIXED = clsim.Trajectory.fixed
SOFT = clsim.Material.from_reflection(0.8)
SCREEN = clsim.MeshRoom([(0, 0, -3), (0, 0, 3), (-6, 0, 3), (-6, 0, -3)], [(0, 1, 2), (0, 2, 3)], SOFT)
ENDS = FIXED((-1.0, -1.2, 0.1)), FIXED((-0.8, 1.5, 0.3))
ORDERS = {(3, 1), (1, 3), (3, 1, 3)}  # interactions: a face of a body, an edge


def crates(swings: bool = False) -> list[clsim.Body]:
    """Return a crate on either side of the screen, at rest or swinging 50 times a second."""
    places = [np.array([1.3, -1.0, 0.2]), np.array([1.2, 1.1, 0.0])]
    turn = np.array([0.0, 0.0, np.sin(0.01), np.cos(0.01)])

    def way(n: int) -> clsim.Trajectory:
        if not swings:
            return FIXED(places[n], turn)
        shift = np.array([0.003, 0.002 - 0.004 * n, 0.001])
        return clsim.Trajectory.sampled(
            lambda t: places[n] + np.sin(100.0 * np.pi * np.asarray(t))[..., None] * shift, 0.2, 5e3
        )

    return [clsim.Body.box(f"crate {n}", (0.5, 0.6, 1.5), SOFT, way(n)) for n in range(2)]


def scene(room: clsim.MeshRoom, ends: tuple, bodies: list[clsim.Body]) -> clsim.Scene:
    tone = clsim.Signal.tone(TONE, 0.2, 192e3, fade=0.001)
    return clsim.Scene(room, AIR, [clsim.Source("s", tone, ends[0])], [clsim.Receiver("r", ends[1])], bodies=bodies)


def of_both(paths: PathSet) -> PathSet:
    """Return the paths over an edge of the room and by faces of bodies, of all three orders."""
    found, seen = [], set()
    for family in paths.families:
        if family.kind == "moving edge":
            met = [tuple(kind for kind in row if kind >= 0) for row in family.interactions.tolist()]
            names = [[family.object_names[i] for i in row if i >= 0] for row in family.objects.tolist()]
            rows = [
                row
                for row, (kinds, things) in enumerate(zip(met, names, strict=True))
                if kinds in ORDERS and all("crate" not in t for k, t in zip(kinds, things, strict=True) if k == 1)
            ]
            seen |= {met[row] for row in rows}
            found.append(family.part(np.array(rows, dtype=np.int64)))
    assert seen == ORDERS
    return PathSet(paths.scene, tuple(found))


def decibels(ratio: float) -> float:
    return 20.0 * math.log10(max(ratio, 1e-300))


def test_both_ways_are_one(measured: Callable[..., float]) -> None:
    sums = [
        field(of_both(clsim.find_paths(scene(SCREEN, ends, crates()), 2, diffraction=1)), np.array([0.05]), TONE)[0]
        for ends in (ENDS, ENDS[::-1])
    ]
    error = decibels(abs(sums[0] - sums[1]) / abs(sums[0]))
    measured("an edge of the room and a body's face, both ways", "reciprocity", error, -100.0)


def test_bodies_at_rest_are_the_room() -> None:
    """All paths of order 2 with crates as bodies, and with the same crates as walls, to -100 dB of the sum."""
    bodies = crates()
    meshes = [
        clsim.MeshRoom(body.placed(body.mesh.vertices, np.zeros(1)), body.mesh.triangles, SOFT) for body in bodies
    ]
    built = clsim.find_paths(scene(clsim.MeshRoom.joined([SCREEN, *meshes]), ENDS, []), 2, diffraction=1)
    placed = clsim.find_paths(scene(SCREEN, ENDS, bodies), 2, diffraction=1)
    sums = [field(paths, np.array([0.05]), TONE)[0] for paths in (placed, built)]
    assert len(of_both(placed)) > 4
    assert decibels(abs(sums[0] - sums[1]) / abs(sums[1])) < -100.0


@pytest.mark.exhaustive
def test_a_whole_period_later_all_is_the_same() -> None:
    """Crates that swing 3 mm 50 times a second: sums of the paths by both, to -100 dB."""
    paths = of_both(clsim.find_paths(scene(SCREEN, ENDS, crates(swings=True)), 2, diffraction=1))
    times = 0.08 + 0.02 * np.linspace(0.0, 1.0, 20)
    one, other = (field(paths, t, TONE) for t in (times, times + 0.02))
    assert np.ptp(np.abs(one)) > 0.01 * np.abs(one).max()
    assert decibels(np.abs(one - other).max() / np.abs(one).max()) < -100.0
