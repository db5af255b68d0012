"""Paths over two edges of a body: earliest ways, pillars against collocation, bodies at rest, slow, in wind, periodic."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from edge_fields import field
from exhaustive import exhaustive, few
from pillar_bem import SOURCE, C, field_behind
from scipy.special import hankel2
from test_body_edges import FIXED, HARD, LINE, MIDDLE, at, earliest, far_scene
from test_body_paths import as_it_is

import clsim
from clsim.paths.legs.mirrors import EdgeLines, Mirrors
from clsim.paths.path_set import PathSet
from clsim.paths.propagation import UniformAir
from clsim.paths.response import SceneResponse
from clsim.paths.search import edge_levels
from clsim.paths.vertices.edge_events import TWO_ENDS, EdgePairs, EdgePairSolver
from clsim.scene.motion.trajectory import Trajectory

TONE = 40e3
KINDS = "edge pair", "edge and end"
LONG = clsim.Signal.tone(TONE, 0.2, 192e3, fade=0.001)
ENDS = FIXED(at(-1.0, 0.013, 0.02)), FIXED(at(0.9, 0.03, -0.05))


def decibels(ratio: Any) -> float:
    return float(20.0 * np.log10(np.max(ratio) + 1e-300))


def pillar(way: Trajectory, side: float = 0.2, height: float = 1.0, material: Any = HARD) -> clsim.Body:
    return clsim.Body.box("pillar", (side, side, height), material, way)


def pairs_of(paths: PathSet, kind: str = "edge pair") -> PathSet:
    """Return the paths over two edges, or over one and an end of another one."""
    found = tuple(f for f in paths.families if f.kind.endswith(kind) and len(f))
    assert found
    return PathSet(paths.scene, found)


def on_edge(body: clsim.Body, lines: EdgeLines, edge: int) -> Any:
    """Return the place of a point on an edge of a body, by its place along it, m, and time."""
    start, _, _, along = lines.frames[edge]
    return lambda p, t: body.placed(start + p[0] * along, np.array(t))


def test_drawn_ways_over_two_edges_are_the_earliest() -> None:
    """A pillar that swings or slides, and a wall that does the other, before and after: earliest over places and times.

    Rates are derivatives of the delays, to the 1e-8 that differences of 1e-16 s over 20 us leave.
    """
    rng, compared = np.random.default_rng(3), 0
    for draw in range(16):
        turn = np.array([0.0, 0.1, 0.2])
        motions = [
            Trajectory.swing(MIDDLE, (0.1, -0.2, 1.0), rng.uniform(-3.0, 3.0) * turn, turn),
            LINE(MIDDLE, MIDDLE + 0.6 * rng.standard_normal(3), 0.2),
        ][:: 1 - 2 * (draw // 4 % 2)]
        body = clsim.Body.box("pillar", (0.2, 0.3, 3.0), HARD, motions[0])
        wall = clsim.Body.box("wall", (0.0, 8.0, 8.0), HARD, motions[1], centre=(4.0, 0.0, 0.0))
        places = (np.array([-1.0, 0.1, 0.2]), np.array([0.9, -0.1, 0.0]))
        ends = tuple(LINE(*(MIDDLE + place + rng.uniform(-0.1, 0.1, (2, 3))), 0.2) for place in places)
        scene = far_scene((FIXED(MIDDLE + 7.5), FIXED(MIDDLE - 7.5)), [body, wall])
        lines = EdgeLines.of(scene.room, scene.bodies)
        pairs, faces = lines.pairs()
        upright = np.flatnonzero(np.all(lines.length[pairs] == 3.0, axis=1))
        one = upright[[rng.integers(len(upright))]]
        mirrored = [draw % 4 in (1, 3), draw % 4 >= 2]
        met = (np.array([[len(scene.room.faces) + 6 if m else -1]], np.int32) for m in mirrored)
        chains = EdgePairs(*met, pairs[one, 0], np.array([-1]), pairs[one, 1], faces[one])
        times = 0.12 + 1e-5 * np.array([-1.0, 0.0, 1.0])
        found = EdgePairSolver(Mirrors.of(scene.room, scene.bodies), lines, ends, UniformAir(C)).find(chains, times)
        if not np.all((found.along > 0.0) & (found.along < 3.0)):
            continue
        delay = (found.first.delay + found.last.delay)[0]

        walls = [lambda p, t, wall=wall: wall.placed(np.array([4.0, *p]), np.array(t))]
        surfaces = walls * mirrored[0] + [on_edge(body, lines, edge) for edge in pairs[one[0]]] + walls * mirrored[1]
        first = int(mirrored[0])
        guess = np.zeros((len(surfaces), 2))
        guess[first : first + 2, 0] = found.along[0, :, 1] + 0.02
        way, points = earliest(surfaces, ends, times[1] - delay[1], guess.ravel())
        assert abs(way - C * delay[1]) < 1e-7, draw
        np.testing.assert_allclose(points[first : first + 2, 0], found.along[0, :, 1], atol=1e-4)
        before, after = found.first.rate[0, 1], found.last.rate[0, 1]
        assert before + after - before * after == pytest.approx((delay[2] - delay[0]) / 2e-5, abs=1e-8)
        compared += 1
    assert compared >= 8


@pytest.mark.parametrize(
    ("side", "level", "bound"),
    [
        exhaustive((0.1, -9.4, -45.0)),
        exhaustive((0.05, -6.6, -38.0)),
        exhaustive((0.2, -10.5, -50.0)),
    ],
)
def test_deep_shadows_of_pillars_that_move(
    side: float, level: float, bound: float, measured: Callable[..., float]
) -> None:
    """A body that goes by at 1 m/s along its own axis: the field behind it, by collocation in two dimensions."""
    receivers = [(1.5, y * side / 0.2) for y in (-0.13, 0.0, 0.05, 0.11)]
    exact = field_behind((side, side), TONE, 14.0, receivers)
    body = pillar(LINE((0, 0, -0.02), (0, 0, 0.02), 0.04), side, 60.0)
    floor = clsim.MeshRoom([(-9, -9, -50), (9, -9, -50), (0, 9, -50)], [(0, 1, 2)], clsim.Material.from_reflection(0.0))
    source = clsim.Source("s", clsim.Signal.tone(TONE, 0.03, 192e3), FIXED((*SOURCE, 0.0)))
    ears = [clsim.Receiver(f"r{i}", FIXED((*place, 0.0))) for i, place in enumerate(receivers)]
    scene = clsim.Scene(floor, clsim.Air(absorption=False, speed_of_sound=C), [source], ears, bodies=[body])
    paths = clsim.find_paths(scene, 1, diffraction=2)
    time, response = np.array([0.03]), SceneResponse(scene, 0, np.array([TONE]))
    k, total = 2.0 * np.pi * TONE / C, np.zeros(len(receivers), dtype=complex)
    for family in paths.families:
        heard = (family.start <= time) & (family.end > time)
        for pair in family.pairs() if len(family) else ():
            found, free = pair.arrivals(time), np.linalg.norm(np.subtract(receivers[pair.receiver], SOURCE))
            length = C * found.delay[:, 0]
            near = heard[pair.index] & (length < 15.0)  # in the plane across: not over the pillar's far ends
            made = pair.response(found, time, response)[:, 0, 0] * length
            total[pair.receiver] += np.sum((made * hankel2(0, k * length))[near]) / hankel2(0, k * free)
    rms = float(10.0 * np.log10(np.mean(np.abs(exact) ** 2)))
    assert rms == pytest.approx(level, abs=2.5)
    error = float(10.0 * np.log10(np.mean(np.abs(total - exact) ** 2)))
    made_rms = float(10.0 * np.log10(np.mean(np.abs(total) ** 2)))
    assert made_rms == pytest.approx(rms, abs=1.5)
    name = f"behind a pillar of {100 * side:g} cm that moves, two edges"
    measured(name, "collocation in two dimensions", error, bound)


def in_a_room(ends: tuple, body: clsim.Body, built: bool) -> clsim.Scene:
    """Return an anechoic room with a pillar as a body, or as part of the room."""
    walls, bodies = clsim.Shoebox(2.0 * MIDDLE, clsim.Material.from_reflection(0.0)).as_mesh(), [body]
    if built:
        corners = body.placed(body.mesh.vertices, np.zeros(1))
        walls = clsim.MeshRoom.joined(
            [walls, clsim.MeshRoom(corners, body.mesh.triangles, body.mesh.faces.materials[0])]
        )
        bodies = []
    air = clsim.Air(speed_of_sound=C, absorption=False)
    return clsim.Scene(walls, air, [clsim.Source("s", LONG, ends[0])], [clsim.Receiver("r", ends[1])], bodies=bodies)


def test_a_pillar_at_rest_is_that_of_the_room_both_ways(measured: Callable[..., float]) -> None:
    """Real faces and oblique ones, with reflections: the same sums to -100 dB, also with source and receiver exchanged."""
    turn = np.array([0.0, 0.02, np.sin(0.1), np.cos(0.1)])
    body = pillar(FIXED(MIDDLE, turn / np.linalg.norm(turn)), material=clsim.Material.from_reflection(0.8))
    time, sums = np.array([0.05]), []
    for ends in (ENDS, ENDS[::-1]):
        built, placed = (clsim.find_paths(in_a_room(ends, body, built), 1, diffraction=2) for built in (True, False))
        sums += [field(paths, time, TONE)[0] for paths in (built, placed)]
        assert len(pairs_of(built)) == len(pairs_of(placed)) > 8
    assert abs(sums[0]) > 0.05
    error = float(decibels(np.abs(np.subtract(sums, sums[0])) / abs(sums[0])))
    measured("a pillar as a body, both ways", "the pillar built into the room", error, -100.0)


@pytest.mark.parametrize("turned", few([False, True]))
def test_a_box_at_rest_is_that_of_the_room_on_every_side_of_its_boundaries(
    turned: bool, measured: Callable[..., float]
) -> None:
    """Past a turned box, from the line of sight into its shadow and behind two corners: 2 and 40 kHz, both ways."""
    turn = np.array([0.1, 0.02, 0.3, 1.0])
    body = clsim.Body.box("box", (0.5, 0.4, 0.6), HARD, FIXED(MIDDLE, turn / np.linalg.norm(turn)))
    ends, times = (
        (FIXED(at(-1.25, -0.9, 0.6)), LINE(at(0.9, -0.9, -0.7), at(0.8, 1.0, 0.9), 1.0)),
        np.arange(0.02, 1.0, 0.016),
    )
    ends = ends[::-1] if turned else ends
    paths = [clsim.find_paths(in_a_room(ends, body, built), 0, diffraction=2) for built in (True, False)]
    assert min(len(pairs_of(found, "edge and end")) for found in paths) > 50
    for tone in (2e3, TONE):
        built, placed = (field(found, times, tone) for found in paths)
        name = f"a box as a body, {tone / 1e3:g} kHz"
        measured(name, "the box built into the room", decibels(np.abs(placed - built)), -100.0)


BESIDE = FIXED(at(0.01, 0.0, 0.3)), FIXED(at(-0.01, 0.0, 0.3))


def test_echoes_of_plates_are_those_of_the_room(measured: Callable[..., float]) -> None:
    """A plate of 10 cm at rest, built into the room: with ends of both edges."""
    turn = np.array([0.05, 0.12, 0.02, 1.0])
    body = clsim.Body.box("plate", (0.1, 0.1, 0.0), HARD, FIXED(MIDDLE, turn / np.linalg.norm(turn)))
    options: Any = {"diffraction": 2, "direct": False}
    built, placed = (clsim.find_paths(in_a_room(BESIDE, body, built), 0, **options) for built in (True, False))
    for paths in (built, placed):
        assert sum(np.sum(f.vertex.over_end >= TWO_ENDS) for f in pairs_of(paths, "edge and end").families) > 8
    one, other = (field(paths, np.array([0.05]), TONE)[0] for paths in (placed, built))
    error = decibels(np.abs(one - other) / abs(other))
    measured("the echo of a plate as a body", "the plate built into the room", error, -100.0)


@pytest.mark.exhaustive
def test_echoes_of_slow_plates_are_the_room_as_it_is(monkeypatch, measured: Callable[..., float]) -> None:
    """A plate of 10 cm at 0.5 mm/s, with ends of both edges."""
    options: Any = {"diffraction": 2, "direct": False}
    monkeypatch.setattr(edge_levels, "QUIET_ECHO", 0.0)  # a path that is quiet now may be loud at another time
    slow = clsim.Body.box("plate", (0.1, 0.1, 0.0), HARD, LINE(at(0.0, -0.25, -0.125), at(0.0, 0.25, 0.125), 1000.0))
    scene, times = far_scene(BESIDE, [slow], LONG), np.array([450.0, 530.0, 580.0, 700.0])
    for time, one in zip(times, field(clsim.find_paths(scene, 0, **options), times, TONE), strict=True):
        still = clsim.find_paths(as_it_is(scene, float(time) - 0.3 / C), 0, **options)
        error = decibels(np.abs(one - field(still, np.array([0.05]), TONE)[0]) * 0.6)
        measured("the echo of a plate at 0.5 mm/s", "the room as it is", error, -110.0)


def test_slow_pillars_are_the_room_as_it_is(monkeypatch: pytest.MonkeyPatch, measured: Callable[..., float]) -> None:
    """At 5 mm/s into the line of sight: all paths together are those of the room with the pillar where it was then."""
    monkeypatch.setattr(edge_levels, "QUIET", 0.0)  # a path that is quiet now may be loud at another time
    body = pillar(LINE(at(0.0, -0.25, 0.0), at(0.0, 0.25, 0.0), 100.0))
    scene = far_scene(ENDS, [body], LONG)
    moving = clsim.find_paths(scene, 0, diffraction=2)
    times = np.array([11.0, 23.0, 37.0, 52.0, 63.0, 81.0])
    for time, one in zip(times, field(moving, times, TONE), strict=True):
        still = as_it_is(scene, float(time) - 0.9 / C)
        there = field(clsim.find_paths(still, 0, diffraction=2), np.array([0.05]), TONE)[0]
        measured(
            "a pillar that moves at 5 mm/s", "the room as it is", float(decibels(np.abs(one - there) * 1.9)), -80.0
        )


def test_pillars_that_move_with_everything_are_at_rest_in_wind() -> None:
    """All at 17 m/s along an oblique line: delays and pressures of a pillar at rest in wind the other way."""
    u, places = np.array([12.0, -9.0, 8.0]), [ends.position(0.0).ravel() for ends in ENDS] + [MIDDLE]
    tone = clsim.Signal.tone(TONE, 0.02, 192e3, fade=0.001)
    ways = [[LINE(x, x + 0.02 * u, 0.02) for x in places], [FIXED(x) for x in places]]
    found = [
        clsim.find_paths(far_scene((w[0], w[1]), [pillar(w[2])], tone, **wind), 0, diffraction=2)
        for w, wind in zip(ways, ({}, {"wind": tuple(-u)}), strict=True)
    ]
    for kind in KINDS:
        tables = [pairs_of(paths, kind).table([0.016]) for paths in found]
        assert len(tables[0].delay) == len(tables[1].delay) >= 4
        for name, within in (("delay", 1e-13), ("doppler_factor", 1e-11), ("gain", 1e-9)):
            moved, still = (getattr(table, name)[:, 0] for table in tables)
            np.testing.assert_allclose(moved, still, rtol=0.0, atol=within)


def test_a_whole_period_later_all_is_the_same() -> None:
    """A pillar that shakes 50 times a second before a wall: sums of its paths over two edges, to -100 dB."""

    def shaken(t: Any) -> Any:
        return MIDDLE + np.sin(100.0 * np.pi * np.asarray(t))[..., None] * np.array([0.001, 0.003, 0.001])

    body = pillar(Trajectory.sampled(shaken, 0.2, 5e3))
    paths = clsim.find_paths(far_scene(ENDS, [body], LONG), 0, diffraction=2)
    times = 0.08 + 0.02 * np.linspace(0.0, 1.0, 20)
    for kind in KINDS:
        one, other = (field(pairs_of(paths, kind), t, TONE) for t in (times, times + 0.02))
        assert np.ptp(np.abs(one)) > 0.05 * np.abs(one).max()
        assert decibels(np.abs(one - other) / np.abs(one).max()) < -100.0


def test_pillars_in_tables_and_both_engines(device: None) -> None:
    """Names of both edges, corners of the way, and samples of both engines."""
    body = pillar(LINE(at(0.0, -0.05, 0.0), at(0.0, 0.05, 0.0), 0.1))
    tone = clsim.Signal.tone(TONE, 0.02, 192e3, fade=0.002)
    paths = clsim.find_paths(far_scene(ENDS, [body], tone), 0, diffraction=2)
    for kind in KINDS:
        [family], table = pairs_of(paths, kind).families, pairs_of(paths, kind).table([0.02])
        names = [table.name_objects(i) for i in np.flatnonzero(table.audible[:, 0])]
        assert names
        assert all(name.count("edge ") == 2 for name in names)
        assert all(("end of " in name or "start of " in name) == (kind != "edge pair") for name in names)
        [pair] = family.pairs()
        corners = pair.family.vertices(pair.index, 0.02)[:, :4]
        legs = np.linalg.norm(np.diff(corners, axis=1), axis=2).sum(axis=1)
        np.testing.assert_allclose(legs, C * pair.arrivals(np.array([0.02])).delay[:, 0], atol=1e-5)
        assert np.all(family.order == 2)
    some = [family.part(np.arange(0, len(family), 3)) for family in paths.families if family.kind.endswith(KINDS)]
    paths = PathSet(paths.scene, tuple(some))
    one, other = (clsim.render(paths, 192e3, duration=0.012, engine=name).pressure for name in ("opencl", "reference"))
    assert decibels(np.abs(one - other) / np.abs(other).max()) < -85.0


def test_what_stands_on_the_face_hides_one_edge_from_the_other() -> None:
    """A rib of 5 cm along a side of a pillar: no way over this face, as in a room."""
    side = pillar(FIXED(MIDDLE))
    foot = [(-0.01, 0.1), (0.01, 0.1), (0.01, 0.15), (-0.01, 0.15)]
    corners = [(*place, height) for height in (-0.5, 0.5) for place in foot]
    faces = [(0, 1, 5), (0, 5, 4), (1, 2, 6), (1, 6, 5), (2, 3, 7), (2, 7, 6), (3, 0, 4), (3, 4, 7)]
    mesh = clsim.MeshRoom.joined([side.mesh, clsim.MeshRoom(corners, faces, HARD)])
    counts = {}
    for name, body in (("plain", side), ("ribbed", clsim.Body("pillar", mesh, FIXED(MIDDLE)))):
        paths = pairs_of(clsim.find_paths(far_scene(ENDS, [body], LONG), 0, diffraction=2))
        turned = [paths.families[0].vertices(np.array([i]), 0.05)[0, 1:3, 1] for i in range(len(paths))]
        counts[name] = sum(np.allclose(y, 8.1, atol=1e-9) for y in turned)
    assert counts["plain"] > 0
    assert counts["ribbed"] == 0
