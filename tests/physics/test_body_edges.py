"""Edges of bodies that move: brute force, bodies at rest, wind, and no step where sound is hidden."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from edge_fields import field, jumps
from scipy.optimize import minimize
from test_body_paths import as_it_is

import clsim
from clsim.paths.legs.mirrors import EdgeLines, Mirrors
from clsim.paths.propagation import UniformAir
from clsim.paths.response import SceneResponse
from clsim.paths.vertices.edge_events import Chains, EdgeSolver
from clsim.scene.motion.trajectory import Trajectory

C = 343.0
HARD = clsim.Material.from_reflection(1.0)
TONE = clsim.Signal.tone(40e3, duration=0.15, sampling_rate=96e3)
FIXED, LINE = clsim.Trajectory.fixed, clsim.Trajectory.line
MIDDLE = np.array([8.0, 8.0, 8.0])  # of a room whose walls send nothing back


def at(*place: float) -> Any:
    """Return a place from the middle of the room, m."""
    return MIDDLE + np.array(place)


def far_scene(ends: tuple[Trajectory, Trajectory], bodies: list[clsim.Body], signal: Any = TONE, **more: Any) -> Any:
    """Return a scene far from the walls of its room."""
    return clsim.Scene(
        clsim.Shoebox(2.0 * MIDDLE, clsim.Material.from_reflection(0.0)),
        clsim.Air(speed_of_sound=C, absorption=False, **more), [clsim.Source("s", signal, ends[0])],
        [clsim.Receiver("r", ends[1])], bodies=bodies,
    )  # fmt: skip


def earliest(surfaces: list[Any], ends: tuple[Trajectory, Trajectory], emission: float, start: Any) -> tuple[Any, Any]:
    """Return the shortest distance by a point of each surface, m, for an emission time, and the points (n, 2)."""

    def hop(place: Any, where: Any, time: float) -> tuple[float, Any]:
        flight = 0.0
        for _ in range(80):
            step = np.linalg.norm(place(time + flight) - where) / C - flight
            flight += step
            if abs(step) < 1e-16:
                break
        return time + flight, place(time + flight)

    def arrival(points: Any) -> float:
        time, where = emission, ends[0].position(emission)
        for point, surface in zip(points.reshape(-1, 2), surfaces, strict=True):
            time, where = hop(lambda t, p=point, s=surface: s(p, t), where, time)  # type: ignore[misc]
        return C * (hop(ends[1].position, where, time)[0] - emission)

    found = minimize(arrival, start, method="BFGS", options={"gtol": 1e-8})
    return found.fun, found.x.reshape(-1, 2)


def test_drawn_ways_over_an_edge_are_the_earliest(rng: np.random.Generator) -> None:
    """A plate that swings or slides, and a wall that does the other, before and after: earliest over places and times.

    Doppler factors are derivatives of the delays, to the 1e-8 that differences of 1e-16 s over 20 us leave.
    """
    compared = 0
    for draw in range(5):
        turn = np.array([0.0, 0.1, 0.2])
        motions = [
            clsim.Trajectory.swing(MIDDLE, rng.standard_normal(3), rng.uniform(-3.0, 3.0) * turn, turn),
            LINE(MIDDLE, MIDDLE + 0.6 * rng.standard_normal(3), 0.2),
        ][:: 1 - 2 * (draw % 2)]
        plate = clsim.Body.box("plate", (3.0, 0.0, 3.0), HARD, motions[0], centre=(0.0, 1.5, 0.0))
        wall = clsim.Body.box("wall", (0.0, 8.0, 8.0), HARD, motions[1], centre=(4.0, 0.0, 0.0))
        ends = tuple(LINE(*(MIDDLE + rng.uniform(-1.0, 1.0, (2, 3))), 0.2) for _ in range(2))
        scene = far_scene((FIXED(MIDDLE + 7.5), FIXED(MIDDLE - 7.5)), [plate, wall])
        lines = EdgeLines.of(scene.room, scene.bodies)
        mirrored = [draw % 4 in (1, 3), draw % 4 >= 2]
        edge = int(rng.integers(4))
        chains = Chains(*(np.array([[7 if m else -1]], np.int32) for m in mirrored), np.array([edge]), np.array([-1]))
        solver = EdgeSolver(Mirrors.of(scene.room, scene.bodies), lines, ends, UniformAir(C))
        times = 0.12 + 1e-5 * np.array([-1.0, 0.0, 1.0])
        found = solver.find(chains, times)
        if not 0.0 < found.along[0, 1] < 3.0:
            continue
        delay = (found.first.delay + found.last.delay)[0]
        start, _, _, along = lines.frames[edge]

        def on_edge(p: Any, t: float, plate: Any = plate, start: Any = start, along: Any = along) -> Any:
            return plate.placed(start + p[0] * along, np.array(t))

        def on_wall(p: Any, t: float, wall: Any = wall) -> Any:
            return wall.placed(np.array([4.0, *p]), np.array(t))

        surfaces = [on_wall] * mirrored[0] + [on_edge] + [on_wall] * mirrored[1]
        guess = np.zeros((len(surfaces), 2))
        guess[int(mirrored[0]), 0] = 1.5
        way, points = earliest(surfaces, ends, times[1] - delay[1], guess.ravel())
        assert abs(way - C * delay[1]) < 1e-7, draw
        assert points[int(mirrored[0]), 0] == pytest.approx(found.along[0, 1], abs=1e-4)
        first, last = found.first.rate[0, 1], found.last.rate[0, 1]
        assert first + last - first * last == pytest.approx((delay[2] - delay[0]) / 2e-5, abs=1e-8)
        compared += 1
    assert compared >= 3


def sheet(corners: Any, material: clsim.Material) -> clsim.MeshRoom:
    """Return a wall of four corners, (4, 3) m."""
    return clsim.MeshRoom(corners, [(0, 1, 2), (0, 2, 3)], material)


def test_a_body_at_rest_diffracts_as_walls_do() -> None:
    """Edges of a screen and of a corner of the room, with a reflection by either before or after, in both rooms."""
    walls, screen = clsim.Material.from_porous(20e3, 0.05), clsim.Material.from_reflection(0.8)
    floor = sheet([(0, 0, 0), (9, 0, 0), (9, 9, 0), (0, 9, 0)], walls)
    partition = sheet([(2.6, 2.2, 0.3), (3.4, 4.0, 0.3), (3.4, 4.0, 2.2), (2.6, 2.2, 2.2)], walls)
    room = clsim.MeshRoom.joined([floor, partition])
    mesh = sheet([(1.5, 1.0, 0.4), (1.5, 2.0, 0.4), (1.7, 2.0, 1.9), (1.7, 1.0, 1.9)], screen)
    pose = FIXED((0.1, -0.2, 0.3), np.array([0.0, 0.0, np.sin(0.2), np.cos(0.2)]))
    seen = clsim.Body("other", mesh, pose).seen(mesh.vertices, np.zeros(4))
    body = clsim.Body("screen", clsim.MeshRoom(seen, mesh.triangles, screen), pose)
    ends = (
        [clsim.Source("s", TONE, LINE((0.7, 1.9, 1.1), (1.1, 2.1, 0.9), 0.2))],
        [clsim.Receiver("r", FIXED((3.1, 1.9, 1.2))), clsim.Receiver("between", FIXED((2.2, 1.5, 1.2)))],
    )
    air, times = clsim.Air(speed_of_sound=C), np.array([0.05, 0.1])
    scenes = clsim.Scene(clsim.MeshRoom.joined([room, mesh]), air, *ends), clsim.Scene(room, air, *ends, bodies=[body])
    found = [clsim.find_paths(scene, 1, diffraction=1) for scene in scenes]
    one, other = (paths.table(times) for paths in found)
    largest, met = np.nanmax(np.abs(one.gain)), 0
    for receiver in range(2):
        for i in range(len(times)):
            rows = [np.flatnonzero((t.receiver == receiver) & np.isfinite(t.delay[:, i])) for t in (one, other)]
            (delay, doppler, gain), theirs = (
                (t.delay[r, i], t.doppler_factor[r, i], t.gain[r, i]) for t, r in zip((one, other), rows, strict=True)
            )
            apart = np.maximum(np.abs(delay[:, None] - theirs[0]) / 1e-12, np.abs(doppler[:, None] - theirs[1]) / 1e-11)
            apart = np.maximum(apart, np.abs(gain[:, None] - theirs[2]) / (1e-7 * largest))  # fades, by their ends
            assert apart.min(axis=1).max() < 1.0
            assert np.array_equal(np.sort(apart.argmin(axis=1)), np.arange(len(theirs[0])))
            met += len(delay)
    assert met > 60
    names = set(map(other.name_objects, range(len(found[1]))))
    assert any(name.startswith("edge wall 1") and name.endswith(", screen") for name in names)
    assert any(", edge screen" in name for name in names)


def sweeping(speed: float, length: float) -> clsim.Scene:
    """Return a plate that slides into the line of sight, a tone that lasts as long, and an ear behind it."""
    way = LINE(at(-1.0 - 0.5 * speed * length, 0.0, 0.0), at(0.6 * speed * length - 1.0, 0.0, 0.0), 1.1 * length)
    plate = clsim.Body.box("plate", (2.0, 0.0, 2.0), HARD, way)
    ends = FIXED(at(0.02, -1.5, 0.1)), FIXED(at(-0.03, 1.2, -0.15))
    return far_scene(ends, [plate], clsim.Signal.tone(40e3, length, 192e3, fade=0.002))


def test_a_plate_that_sweeps_through_the_line_of_sight_makes_no_step() -> None:
    """At 1 m/s: no sample of the envelope differs from the next as much as where sound breaks off.

    The plate shades the ear within some 10 cm, 0.1 s, of way: steps of 1/16 ms are thousandths of the level. Without
    edges a raised cosine of 1 ms is as steep as pi / 32 of the level.
    """
    scene = sweeping(1.0, 0.12)
    band = clsim.Baseband(40e3, 8e3, 16e3)
    steps, paths = [], {edges: clsim.find_paths(scene, 0, diffraction=edges) for edges in (0, 1)}
    for each in paths.values():
        envelope = clsim.render(each, 192e3, baseband=band, duration=0.12).samples[0][250:-100]
        level = np.abs(envelope)
        steps.append(np.abs(np.diff(envelope)).max() / level.max())
    assert steps[0] > 0.09
    assert steps[1] < 0.003
    assert 0.05 < level.min() / level.max() < 0.2  # -6 dB on the boundary, -20 dB 6 cm into the shadow
    # Edge paths go over into others without a jump, those of the plate's corners as at rest.
    family = paths[1].families[-1]
    events = np.unique(np.concatenate([family.start, family.end])[np.tile(family.vertex.over_end < 0, 2)])
    events = events[np.isfinite(events)]
    assert len(events) == 3  # one of the line of sight, two of corners
    assert 20.0 * np.log10(jumps(paths[1], events, 40e3).max()) < -75.0


@pytest.mark.exhaustive
@pytest.mark.parametrize("side", ["before", "behind"])
def test_paths_by_fast_bodies_change_over_without_a_jump(side: str, measured: Callable[..., float]) -> None:
    """At 17 m/s, before a plate that comes nearer, where its echo begins; behind it, where it hides that of a wall.

    A wall behind it moves at 20 m/s: what it sends back comes past the edge at last, or from it.
    """
    way = LINE(at(-1.2, -0.1, 0.0), at(-0.25, 0.6, 0.0), 0.07)
    bodies = [clsim.Body.box("plate", (2.0, 0.0, 2.0), HARD, way)]
    ear = LINE(at(0.2, -1.2, 0.0), at(0.3, -1.1, 0.0), 0.07)
    if side == "behind":
        ear = LINE(at(0.5, 1.6, 0.0), at(0.6, 1.7, 0.0), 0.07)
        back = LINE(at(0.0, 4.0, 0.0), at(0.0, 2.6, 0.0), 0.07)
        bodies.append(clsim.Body.box("wall", (6.0, 0.0, 6.0), HARD, back))
    scene = far_scene((FIXED(at(0.02, -1.5, 0.1)), ear), bodies, clsim.Signal.tone(40e3, 0.06, 96e3))
    paths = clsim.find_paths(scene, 1, diffraction=1)
    echo, edges = paths.families[-2:]
    bounds = np.concatenate([x[np.isfinite(x)] for x in (echo.start, echo.end)])
    assert len(bounds) == 1
    assert set(bounds) <= set(edges.start[np.isfinite(edges.start)])
    jump_db = 20.0 * np.log10(jumps(paths, bounds, 40e3).max())
    measured(f"{side} a plate at 17 m/s, where an echo begins or ends", "no jump", jump_db, -75.0)


def test_slow_bodies_are_the_room_as_it_is(measured: Callable[..., float]) -> None:
    """At 5 mm/s: the sum of all paths is that of the room with the plate as it was when sound was there.

    What is left is of the order of V / c, 2e-5, of the phase that the plate's echo gains (-80 dB).
    """
    scene = sweeping(5e-3, 8.0)
    moving = clsim.find_paths(scene, 0, diffraction=1, body_step=0.002)
    times = np.array([1.0, 2.6, 3.9, 4.4, 6.0])
    found = field(moving, times, 40e3)
    for time, one in zip(times, found, strict=True):
        still = as_it_is(scene, float(time) - 1.2 / C)
        there = field(clsim.find_paths(still, 0, diffraction=1), np.array([0.05]), 40e3)[0]
        error = float(20.0 * np.log10(np.abs(one - there) * 2.7))
        measured("a plate that moves at 5 mm/s, with its edges", "the room as it is", error, -80.0)


def test_edges_that_move_with_everything_are_at_rest_in_wind() -> None:
    """All at 17 m/s along an oblique line: delays and pressures of a plate at rest in wind the other way."""
    u, places = np.array([12.0, -9.0, 8.0]), [at(0.1, -1.5, 0.1), at(-0.2, 1.2, -0.15), at(-0.9, 0.0, 0.2)]
    one, other = ([way(x) for x in places] for way in (lambda x: LINE(x, x + 0.15 * u, 0.15), FIXED))
    scenes = [
        far_scene((ways[0], ways[1]), [clsim.Body.box("plate", (2.0, 0.0, 2.0), HARD, ways[2])], **wind)
        for ways, wind in ((one, {}), (other, {"wind": tuple(-u)}))
    ]
    tables = [clsim.find_paths(scene, 0, diffraction=1).table([0.05]) for scene in scenes]
    edges = [np.flatnonzero(table.interactions[:, 0] == 1) for table in tables]
    assert len(edges[0]) == len(edges[1]) >= 4
    for name, within in (("delay", 1e-13), ("doppler_factor", 1e-11), ("gain", 1e-9)):
        moved, still = (getattr(table, name)[rows, 0] for table, rows in zip(tables, edges, strict=True))
        np.testing.assert_allclose(moved, still, rtol=0.0, atol=within)


def test_angles_go_on_where_an_end_passes_the_plane_of_a_sheet() -> None:
    """A door whose plane passes the source: each piece of a path goes on smoothly beyond it, up to the transition."""
    angles, times = np.radians([80.0, 90.0, 100.0]), np.array([0.0, 0.1, 0.2])
    hinge = clsim.Trajectory.swing(MIDDLE, (0, 0, 1), angles, times)
    door = clsim.Body.box("door", (1.0, 0.0, 2.0), HARD, hinge, centre=(0.7, 0.0, 0.0))
    paths = clsim.find_paths(
        far_scene((FIXED(at(0.0, 2.5, 0.1)), FIXED(at(0.9, -0.6, -0.15))), [door]), 0, diffraction=1, edge_fades=False
    )
    family = paths.families[-1]
    passing = np.flatnonzero(
        (np.abs(family.start - 0.105) < 0.02) & (family.vertex.over_end < 0) & np.isfinite(family.start)
    )
    passing = np.array([row for row in passing if np.any(family.vertex.beside[row] != family.vertex.beside[row - 1])])
    apart = []
    for row in passing:
        around = family.start[row] + np.linspace(-2e-3, 2e-3, 9)
        found = family.arrivals(np.array([row]), around)
        at_tone = SceneResponse(paths.scene, 0, np.array([40e3]))
        gain, before = (family.response(np.array([r]), found, around, at_tone)[0, :, 0] for r in (row, row - 1))
        assert np.abs(np.diff(gain, 2)).max() < 1e-2 * np.abs(gain).max()
        apart.append(np.abs(before[4] - gain[4]) / np.abs(gain[4]))
    assert max(apart) > 0.5  # of those of which the source passes both faces


@pytest.mark.exhaustive
def test_edges_in_tables_pictures_and_both_engines(device: None) -> None:
    """A plate that slides: names, corners of paths, samples that do not depend on chunks."""
    short = clsim.Signal.tone(40e3, 0.02, 192e3, fade=0.002)
    slide = LINE((1.0, 1.4, 1.0), (1.03, 1.4, 1.0), 0.03)
    plate = clsim.Body.box("plate", (1.0, 0.0, 1.2), HARD, slide)
    ends = [clsim.Source("s", short, FIXED((1.2, 0.6, 1.1)))], [clsim.Receiver("r", FIXED((1.4, 2.2, 1.0)))]
    floor = sheet([(0, 0, 0), (4, 0, 0), (4, 4, 0), (0, 4, 0)], HARD)
    paths = clsim.find_paths(clsim.Scene(floor, clsim.Air(), *ends, bodies=[plate]), 0, diffraction=1)
    table = paths.table([0.015])
    ways = {table.name_objects(i): i for i in np.flatnonzero(table.audible[:, 0])}
    over = [name for name in ways if name.startswith("edge plate") and "," not in name]
    assert len(over) >= 3
    turned = paths.vertices(0.015)[[ways[name] for name in over], 1]
    assert turned[:, 1] == pytest.approx(1.4, abs=1e-12)
    moved = slide.position(0.015 - 0.8 / C)[0]  # when sound is there, within 1 m of way and 1 m/s
    sides = np.array([moved - 0.5, moved + 0.5, 0.4, 1.6])
    assert np.abs(turned[:, [0, 0, 2, 2]] - sides).min(axis=1).max() < 3e-3
    one, other = (clsim.render(paths, 192e3, duration=0.029, engine=name).pressure for name in ("opencl", "reference"))
    level = 20.0 * np.log10(np.abs(one - other).max() / np.abs(other).max())
    assert level < -85.0
    again = clsim.render(paths, 192e3, duration=0.029, chunk=1536).pressure
    np.testing.assert_array_equal(one, again)
    assert paths.families[-1].digest() != paths.families[-1].part(slice(1, None)).digest()
