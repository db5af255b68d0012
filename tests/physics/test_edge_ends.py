"""Paths over an edge and an end of another one: against integrals along both edges, jumps, and both ways."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from corner_oracle import Edge, field_of_both, field_of_meeting
from edge_fields import field, terms
from exhaustive import few

import clsim
from clsim.paths.path_set import PathSet
from clsim.paths.search import edge_levels
from clsim.paths.vertices.edge_events import TWO_ENDS

TONE, C, TALL = 40e3, 343.0, 30.0
WAVE = 2.0 * np.pi * TONE / C
HARD = clsim.Material.from_reflection(1.0)
SIGNAL = clsim.Signal.tone(TONE, 0.01, 192e3)
AIR = clsim.Air(speed_of_sound=C, absorption=False)
KIND = "static edge and end"


def decibels(ratio: Any) -> float:
    return float(20.0 * np.log10(np.max(np.abs(ratio)) + 1e-300))


def quad(*corners: Any) -> clsim.MeshRoom:
    return clsim.MeshRoom(np.array(corners, float), [(0, 1, 2), (0, 2, 3)], HARD)


def paths_of(room: clsim.MeshRoom, source: Any, way: Any, order: int = 0, **more: Any) -> PathSet:
    """Return the paths from a place to a way, a trajectory or a place."""
    ways = [x if isinstance(x, clsim.Trajectory) else clsim.Trajectory.fixed(tuple(x)) for x in (source, way)]
    scene = clsim.Scene(room, AIR, [clsim.Source("s", SIGNAL, ways[0])], [clsim.Receiver("r", ways[1])])
    return clsim.find_paths(scene, order, diffraction=2, **more)


def over(paths: PathSet, edges: tuple[int, int], face: int = 2) -> tuple[complex, complex]:
    """Return the sum of the paths over two edges, and of those over an end of one of them."""
    sums = [0.0j, 0.0j]
    for family in paths.families:
        if not family.kind.startswith("static edge ") or not len(family):
            continue
        v: Any = family.vertex
        mine = (v.edge == edges[0]) & (v.last.edge == edges[1]) & (v.shared[:, 0] == face)
        rows = np.flatnonzero(mine & (family.order == 2))
        if len(rows):
            sums[int(family.kind == KIND)] += field(PathSet(paths.scene, (family.part(rows),)), np.zeros(1), TONE)[0]
    return sums[0], sums[1]


@pytest.mark.parametrize(
    ("slope", "off"), few([(slope, off) for slope in (0.0, 0.5) for off in (0.03, -0.03, 0.1)], (0, 4))
)
def test_an_end_across_air(
    slope: float, off: float, monkeypatch: pytest.MonkeyPatch, measured: Callable[..., float]
) -> None:
    """Behind a screen that ends, from the shadow of a leaning one, as near the end as the shortest path is to it."""
    monkeypatch.setattr(edge_levels, "QUIET", 0.0)
    source, ear = np.array([-1.0, -0.6, 0.8]), np.array([1.2, -0.9 - 0.3 * slope, 1.2])
    lean = np.array([0.0, slope, 1.0]) / np.hypot(slope, 1.0)
    start = np.array([0.3, 0.1 - 0.9 * slope, 0.0]) - TALL * lean
    stop = start + 2.0 * TALL * lean
    leaning = quad(start, stop, stop - [0, 5 * TALL, 0], start - [0, 5 * TALL, 0])

    def paths(end: float) -> tuple[PathSet, Any]:
        ends = quad((-0.3, 0, -TALL), (-0.3, 0, end), (-0.3, -5 * TALL, end), (-0.3, -5 * TALL, -TALL))
        found = paths_of(clsim.MeshRoom.joined([ends, leaning]), source, ear, 2)
        edges = found.scene.room.edges()
        upright = [
            int(np.flatnonzero((np.abs(edges.along @ unit) > 0.9999) & (np.abs(edges.start[:, 1]) < 20.0)
                               & (np.abs(edges.start[:, 0] - x) < 1e-6))[0])
            for unit, x in (((0, 0, 1), -0.3), (lean, 0.3))
        ]  # fmt: skip
        return found, upright

    tall, pair = paths(TALL)
    gap = next(f for f in tall.families if f.kind == "static edge gap")
    row = np.flatnonzero((gap.vertex.edge == pair[0]) & (gap.vertex.last.edge == pair[1]) & (gap.order == 2))[:1]
    met = gap.vertices(row, 0.0)[0, 1:3]
    both, of_end = over(*paths(float(met[0, 2]) + off))
    edges, zero = [], np.array([1.0, 0.0, 0.0])
    for along, place in zip((np.array([0.0, 0.0, 1.0]), lean), met, strict=True):
        across = np.cross(along, zero) * -np.sign(np.cross(along, zero)[1])
        edges.append(Edge(place, place + along, across, np.cross(along, across), 2.0 * np.pi))
    exact = field_of_both((edges[0], edges[1]), (source, ear), WAVE, (0.0, 0.0), 0.6, (off, np.inf))
    free = np.linalg.norm(ear - source)
    assert (both == 0.0) == (off < 0.0)
    assert decibels((both - exact) * free) > -90.0
    error = decibels((both + of_end - exact) * free)
    measured("an end and an edge across air", "an integral along both", error, -92.0)


@pytest.mark.parametrize(
    ("width", "height", "worst"),
    few([(0.02, 0.15, -56.0), (0.02, 0.5, -104.0), (-0.02, 0.15, -56.0), (0.3, 0.15, -69.0)], (0, 1)),
)
def test_a_corner_at_which_both_edges_end(
    width: float, height: float, worst: float, monkeypatch: pytest.MonkeyPatch, measured: Callable[..., float]
) -> None:
    """Past the corner of a sheet, close to its plane, against an integral along both edges from the corner on."""
    monkeypatch.setattr(edge_levels, "QUIET", 0.0)
    source, ear = np.array([0.5, -0.8, height]), np.array([-0.4 - width, 0.7, 0.8 * height])
    paths = paths_of(quad((0, 0, 0), (8, 0, 0), (8, 8, 0), (0, 8, 0)), source, ear, 2)
    edges, found = paths.scene.room.edges(), []
    for axis in (0, 1):
        [number] = np.flatnonzero((np.abs(edges.along[:, axis]) > 0.5) & (np.abs(edges.start[:, 1 - axis]) < 1e-9))
        found.append(int(number))
    [row] = np.flatnonzero((edges.pairs()[0] == found).all(axis=1) & (edges.pairs()[1][:, 0] == 0))
    faces = 2.0 * np.pi * edges.pairs()[1][row]
    both, of_end = over(paths, (found[0], found[1]), 0)
    made = [
        Edge(np.zeros(3), np.eye(3)[axis], edges.across[e], edges.out[e], 2.0 * np.pi) for axis, e in enumerate(found)
    ]
    exact = field_of_meeting((made[0], made[1]), (source, ear), (faces[0], faces[1]), WAVE, 0.6)
    free = np.linalg.norm(ear - source)
    error = decibels((both + of_end - exact) * free)
    assert error < decibels((both - exact) * free) - 7.0
    measured("a corner at which both edges end", "an integral along both", error, worst)


def in_the_open(size: tuple[float, float, float]) -> clsim.MeshRoom:
    """Return a hard box from (0, 0, 0) on among walls that reflect nothing."""
    shell, box = clsim.Shoebox((20, 20, 20), clsim.Material.from_reflection(0.0)).as_mesh(), clsim.Shoebox(size, HARD)
    walls = clsim.MeshRoom(shell.vertices - 10.0, shell.triangles, shell.faces.materials[0])
    return clsim.MeshRoom.joined([walls, box.as_mesh()])


def walks() -> dict[str, tuple[clsim.MeshRoom, Any, Any, float]]:
    """Return rooms, sources, ways, and the largest jump re the free field, dB."""
    line = clsim.Trajectory.line
    corner = clsim.MeshRoom.joined([quad((0, 0, 0), (0, -1, 0), (0, -1, 1), (0, 0, 1)),
                                    quad((0, 0, 0), (-1, 0, 0), (-1, 0, 1), (0, 0, 1))])  # fmt: skip
    row = clsim.MeshRoom.joined([quad((-0.3, -1, 0), (-0.3, 0, 0), (-0.3, 0, 1), (-0.3, -1, 1)),
                                 quad((0.3, -0.9, 0), (0.3, 0.1, 0), (0.3, 0.1, 1.1), (0.3, -0.9, 1.1))])  # fmt: skip
    sheet = quad((0, 0, 0), (0, -0.3, 0), (0, -0.3, -0.4), (0, 0, -0.4))
    inside = in_the_open((0.5, 0.4, 0.6))
    return {
        "a sheet": (sheet, (-0.3, 0.13, -0.1), line((0.1, -0.4, -0.3), (0.2, 0.2, 0.3), 1.0), -58.0),
        "screens at 90 degrees": (corner, (-0.8, -0.6, 0.8), line((0.5, 0.1, 0.7), (0.1, 0.6, 0.9), 1.0), -70.0),
        "screens in a row": (row, (-1.0, -0.3, 0.8), line((1.1, -0.8, 0.6), (1.0, 0.5, 0.9), 1.0), -54.0),
        "a box": (inside, (-1.0, -0.7, 0.9), line((0.9, 0.3, 0.5), (0.6, 0.9, 0.2), 1.0), -50.0),
    }  # fmt: skip


def around_events(paths: PathSet, apart: float = 2e-6) -> np.ndarray:
    """Return times just before and after all beginnings and ends of paths, in pairs; one pair for all within `apart`."""
    times = np.unique(np.concatenate([x for f in paths.families for x in (f.start, f.end)]))
    times = times[np.isfinite(times)]
    first = np.flatnonzero(np.append(True, np.diff(times) > apart))  # events of different tests at one place
    begin, end = times[first], times[np.append(first[1:], len(times)) - 1]
    return np.stack([begin - 1e-7, end + 1e-7], axis=1).ravel()


@pytest.mark.parametrize("name", ["a sheet", "screens at 90 degrees", "screens in a row", "a box"])
def test_no_jump_past_corners(name: str, measured: Callable[..., float]) -> None:
    """Walks that jump by -35 to -49 dB re the free field without these paths."""
    room, source, way, least = walks()[name]
    paths = paths_of(room, source, way)
    free, around, sums = np.linalg.norm(way.position(np.array([0.5]))[0] - source), around_events(paths), []
    for families in (paths.families, tuple(f for f in paths.families if f.kind != KIND)):
        sums.append(decibels(np.diff(terms(PathSet(paths.scene, families), around, TONE).sum(0).reshape(-1, 2)) * free))
    assert sums[1] > least + 8.0
    measured(f"a walk past {name}", "no jump", sums[0], least)


def test_both_ways(device: None, measured: Callable[..., float]) -> None:
    """Source and receiver exchanged: the same sum, by as many paths; on the device and by NumPy."""
    room, source, way, _ = walks()["screens in a row"]
    ear, sums, counts = way.position(np.array([0.8]))[0], [], []
    for ends, engine in (((source, ear), "reference"), ((ear, source), "reference"), ((source, ear), "opencl")):
        paths = paths_of(room, *ends, engine=engine)
        [family] = [f for f in paths.families if f.kind == KIND]
        counts.append(len(family))
        sums.append(field(PathSet(paths.scene, (family,)), np.zeros(1), TONE)[0])
    assert counts[0] == counts[1] == counts[2] > 3
    error = decibels(np.array(sums) / sums[0] - 1.0)
    measured("an end and an edge, both ways", "the same", error, -120.0)


def test_paths_without_walls_are_found_at_any_order(device: None) -> None:
    """Candidates with different numbers of walls are looked for together: those without any stay as they are alone."""
    room, source, way, _ = walks()["a box"]
    found: list[dict[tuple[int, ...], tuple[float, float]]] = []
    for order in (0, 1):
        [family] = [f for f in paths_of(room, source, way, order).families if f.kind == KIND]
        plain = np.flatnonzero(family.order == 2)
        assert (len(plain) < len(family)) == (order > 0)
        found.append({})
        for row in plain.tolist():
            key = tuple(family.objects[row, :2].tolist())
            first, last = found[-1].get(key, (np.inf, -np.inf))
            found[-1][key] = min(first, family.start[row]), max(last, family.end[row])
    assert found[0].keys() == found[1].keys()
    assert len(found[0]) > 10
    np.testing.assert_allclose(list(found[1].values()), [found[0][key] for key in found[1]], atol=1e-6)


def test_an_end_takes_over_from_two_edges(measured: Callable[..., float]) -> None:
    """Where the shortest path over both screens in a row runs off an end, the sum goes on as it was."""
    room, source, way, _ = walks()["screens in a row"]
    paths = paths_of(room, source, way)
    [gaps], [ends] = ([f for f in paths.families if f.kind == kind] for kind in ("static edge gap", KIND))
    times = np.intersect1d(np.append(gaps.start, gaps.end), np.append(ends.start, ends.end))
    times, sums = times[np.isfinite(times)], []
    for families in (paths.families, tuple(f for f in paths.families if f.kind != KIND)):
        around = (times[:, None] + np.array([-1e-8, 1e-8])).ravel()
        sums.append(np.abs(np.diff(terms(PathSet(paths.scene, families), around, TONE).sum(0).reshape(-1, 2))))
    lone = np.flatnonzero(sums[1][:, 0] > 3e-3)  # nothing else makes up for the path that ends
    assert len(lone)
    jump = decibels(sums[0][lone] / sums[1][lone])
    measured("an end takes over from two edges", "no jump", jump, -70.0)


def test_ends_of_both_edges_take_over(monkeypatch: pytest.MonkeyPatch, measured: Callable[..., float]) -> None:
    """Behind a sheet, where the path over an end of one of two opposite edges runs off the other, the sum goes on."""
    monkeypatch.setattr(edge_levels, "QUIET", 1e-5)
    sheet = quad((-0.1, -0.1, 0), (0.1, -0.1, 0), (0.1, 0.1, 0), (-0.1, 0.1, 0))
    way = clsim.Trajectory.line((0.3, -0.02, -0.3), (0.25, 0.4, -0.1), 1.0)
    paths = paths_of(sheet, (-0.3, 0.05, 0.25), way)
    [ends] = [f for f in paths.families if f.kind == KIND]
    vertex: Any = ends.vertex
    both = vertex.over_end >= TWO_ENDS
    times = np.append(ends.start[both], ends.end[both])
    around, sums = times[np.isfinite(times)].max() + np.array([-1e-6, 1e-6]), []
    one = tuple(f if f.kind != KIND else f.part(np.flatnonzero(~both)) for f in paths.families)
    for families in (paths.families, one):
        sums.append(np.abs(np.diff(terms(PathSet(paths.scene, families), around, TONE).sum(0))))
    assert decibels(sums[1]) > -66.0
    jump = decibels(sums[0] / sums[1])
    measured("ends of both edges take over from one", "no jump", jump, -25.0)
