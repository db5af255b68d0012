"""Paths over three edges: against collocation in two dimensions, jumps on walks past corners, and both ways."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from edge_fields import field, terms
from exhaustive import few
from pillar_bem import field_about
from test_edge_ends import AIR, HARD, C, around_events, decibels, in_the_open

import clsim
from clsim.paths.path_set import PathSet

KIND = "static three edges"


def paths_of(room: clsim.MeshRoom, source: Any, ears: list[Any], frequency: float, order: int = 0) -> PathSet:
    """Return the paths from a place to places, or to a trajectory."""
    ways = [x if isinstance(x, clsim.Trajectory) else clsim.Trajectory.fixed(tuple(x)) for x in (source, *ears)]
    signal = clsim.Signal.tone(frequency, 0.01, 192e3)
    receivers = [clsim.Receiver(f"r{i}", way) for i, way in enumerate(ways[1:])]
    scene = clsim.Scene(room, AIR, [clsim.Source("s", signal, ways[0])], receivers)
    return clsim.find_paths(scene, order, diffraction=3)


def without(paths: PathSet) -> PathSet:
    return PathSet(paths.scene, tuple(f for f in paths.families if f.kind != KIND))


@pytest.mark.parametrize(("frequency", "worst", "plain"), few([(40e3, -45.0, -36.0), (10e3, -38.5, -31.0)], (1,)))
def test_beyond_the_far_face_of_a_pillar(
    frequency: float, worst: float, plain: float, measured: Callable[..., float]
) -> None:
    """Either side of the plane of the far face of a hard pillar, in whose plane paths over two edges end."""
    half, source = 0.05, (-0.4, 0.052)
    places = [(half + x, -half - 0.03) for x in (-0.001, 0.001)]
    corners: Any = [[(-half, -half), (half, -half), (half, half), (-half, half)]]
    exact = field_about(corners, source, places, frequency, 12.0)
    shell, box = (
        clsim.Shoebox((40, 40, 40), clsim.Material.from_reflection(0.0)).as_mesh(),
        clsim.Shoebox((0.1, 0.1, 8.0), HARD).as_mesh(),
    )
    room = clsim.MeshRoom.joined(
        [
            clsim.MeshRoom(shell.vertices - 20.0, shell.triangles, shell.faces.materials[0]),
            clsim.MeshRoom(box.vertices - [half, half, 4.0], box.triangles, HARD),
        ]
    )
    paths = paths_of(room, (*source, 0.0), [(*place, 0.0) for place in places], frequency, 1)
    errors = []
    for some in (paths, without(paths)):
        found = [field(some, np.zeros(1), frequency, i)[0] for i in range(len(places))]
        apart = np.linalg.norm(np.array(places) - source, axis=1)
        errors.append(decibels(np.array(found) * apart * np.exp(2j * np.pi * frequency / C * apart) - exact))
    assert errors[1] > plain
    assert measured("three edges, beyond a pillar's far face", "collocation", errors[0], worst) < worst


def walk(name: str) -> tuple[clsim.MeshRoom, Any, clsim.Trajectory]:
    """Return a room, a source and a way."""
    line = clsim.Trajectory.line
    if name == "a box":
        return (
            in_the_open((0.5, 0.4, 0.6)),
            (0.508, 0.015, -0.514),
            line((-0.463, 0.473, 0.958), (0.569, 0.287, 1.205), 1.0),
        )
    return (
        in_the_open((0.9, 0.6, 0.04)),
        (0.694, 0.038, 0.627),
        line((0.776, -0.149, -0.37), (1.026, 0.641, -0.37), 1.0),
    )


@pytest.mark.parametrize(
    ("name", "frequency", "worst"),
    few([("a box", 40e3, -29.0), ("a table", 40e3, -40.0), ("a table", 2e3, -26.0)], (0, 1)),
)
def test_walks_beyond_planes_of_faces(
    name: str, frequency: float, worst: float, measured: Callable[..., float]
) -> None:
    """Walks across planes in which paths over two edges end jump by less, re the strongest path.

    Bounds are 1 to 6 dB above what was measured; there is no other field to compare with.
    """
    room, source, way = walk(name)
    paths = paths_of(room, source, [way], frequency)
    around, jumps = around_events(paths), []
    for some in (paths, without(paths)):
        every = terms(some, around, frequency)
        strongest = np.abs(every).max(axis=0).reshape(-1, 2).max(axis=1)
        jumps.append(decibels(np.diff(every.sum(axis=0).reshape(-1, 2))[:, 0] / strongest))
    assert jumps[1] > jumps[0] + 4.0
    assert measured(f"a walk past {name} at {frequency / 1e3:g} kHz", "no jump", jumps[0], worst) < worst


def test_both_ways(measured: Callable[..., float]) -> None:
    """Source and receiver exchanged: the same sum by as many paths."""
    room, source, way = walk("a table")
    ear, found = way.position(np.array([0.8]))[0], []
    for ends in ((source, ear), (ear, source)):
        [family] = [f for f in paths_of(room, ends[0], [ends[1]], 40e3).families if f.kind == KIND]
        found.append((len(family), field(PathSet(family.scene, (family,)), np.zeros(1), 40e3)[0]))
    assert found[0][0] == found[1][0] > 3
    error = decibels(found[1][1] / found[0][1] - 1.0)
    assert measured("three edges, both ways", "the same", error, -100.0) < -100.0


def test_all_other_paths_are_those_of_two_edges() -> None:
    """`diffraction=3` adds paths over three edges of the room, also beside a body, and changes no other."""
    room, source, way = walk("a table")
    still = [clsim.Trajectory.fixed(tuple(x)) for x in (source, way.position(np.array([0.8]))[0], (0.3, -0.7, -0.2))]
    ends = [clsim.Source("s", clsim.Signal.tone(40e3, 0.01, 192e3), still[0])], [clsim.Receiver("r", still[1])]
    scene = clsim.Scene(room, AIR, *ends, bodies=[clsim.Body.box("crate", (0.2, 0.2, 0.2), HARD, still[2])])
    two, three = (clsim.find_paths(scene, 0, diffraction=n).families for n in (2, 3))
    assert [f.kind for f in three if f.kind not in {g.kind for g in two}] == [KIND]
    assert len(next(f for f in three if f.kind == KIND)) > 3
    for before, after in zip(two, (f for f in three if f.kind != KIND), strict=True):
        assert np.array_equal(before.objects, after.objects)
        assert np.array_equal(before.start, after.start)
