"""Paths over two edges with air between: knife edges and posts against other means, jumps, bodies, floors, and screens."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from corner_oracle import Edge, field_of_both
from edge_fields import field, jumps
from exhaustive import few
from pillar_bem import C, field_about
from scipy.optimize import minimize
from scipy.special import hankel2, wofz
from test_body_edges import FIXED, LINE
from test_body_paths import as_it_is

import clsim
from clsim.acoustics.diffraction import double_transition, gap_transition
from clsim.acoustics.edge_gap import EdgeGap
from clsim.paths.path_set import PathSet
from clsim.paths.response import SceneResponse

TONE, TALL = 40e3, 30.0
HARD = clsim.Material.from_reflection(1.0)
SIGNAL = clsim.Signal.tone(TONE, 0.2, 192e3, fade=0.001)
AIR = clsim.Air(speed_of_sound=C, absorption=False)


def decibels(ratio: Any) -> float:
    return float(20.0 * np.log10(np.max(np.abs(ratio)) + 1e-300))


def screen(x: float, y: tuple[float, float], z: tuple[float, float], material: Any = HARD) -> clsim.MeshRoom:
    corners = [(x, y[0], z[0]), (x, y[1], z[0]), (x, y[1], z[1]), (x, y[0], z[1])]
    return clsim.MeshRoom(corners, [(0, 1, 2), (0, 2, 3)], material, labels=[f"at {x}"] * 2)


def prism(foot: list[tuple[float, float]]) -> clsim.MeshRoom:
    """Return a tall prism over a convex outline."""
    count = len(foot)
    corners = [(*place, z) for z in (-TALL, TALL) for place in foot]
    sides = [(i, (i + 1) % count, count + (i + 1) % count) for i in range(count)]
    sides += [(i, count + (i + 1) % count, count + i) for i in range(count)]
    return clsim.MeshRoom(corners, sides, HARD)


def scene_of(room: clsim.MeshRoom, source: Any, ears: list[Any], **more: Any) -> clsim.Scene:
    ways = [way if isinstance(way, clsim.Trajectory) else FIXED(way) for way in (source, *ears)]
    beacon = clsim.Source("s", SIGNAL, ways[0])
    return clsim.Scene(room, AIR, [beacon], [clsim.Receiver(f"r{i}", w) for i, w in enumerate(ways[1:])], **more)


def over_free_field(paths: PathSet, times: np.ndarray, near: float, receiver: int = 0) -> np.ndarray:
    """Return the sum of paths (T,) shorter than `near` over the free field, in two dimensions."""
    k, total = 2.0 * np.pi * TONE / C, np.zeros(len(times), dtype=complex)
    at = SceneResponse(paths.scene, 0, np.array([TONE]))
    for _, pair in paths.at_receiver(receiver).pairs():
        found, family = pair.arrivals(times), pair.family
        start, end = (x[pair.rows][:, None] for x in (family.start, family.end))
        heard = (times >= start) & (times < end) & (found.length < near)
        made = pair.response(found, times, at)[..., 0] * found.length * hankel2(0, k * found.length)
        total += np.sum(np.where(heard, made, 0.0), axis=0)
    source, ear = paths.scene.sources[0].trajectory, paths.scene.receivers[receiver].trajectory
    apart = np.linalg.norm(ear.position(times) - source.position(np.zeros(1)), axis=1)
    return np.asarray(total / hankel2(0, k * apart))


def quarter_plane(a: float, b: float, c: float) -> complex:
    """Return the transition of two edges as it is defined, on paths turned by 45 degrees, by Gauss's rule."""
    turn, (x, w) = np.exp(-0.25j * np.pi), np.polynomial.legendre.leggauss(200)
    u, v = np.meshgrid(4.5 * (x + 1.0), 4.5 * (x + 1.0), indexing="ij")
    linear = 2.0 * np.sqrt(1.0 - c**2) * (a * u + b * v) / turn
    weights = 4.5 * w
    total = weights @ np.exp(-(u**2 + 2.0 * c * u * v + v**2) - linear) @ weights
    return complex(4j * np.sqrt(1.0 - c**2) / np.pi * turn**2 * total)


def test_the_transition_across_air() -> None:
    """Against its double integral on either side of both boundaries, on both, and the mean over the signs of the tie."""
    one = np.ones((1, 1, 1))
    for a, b, tie in ((0.5, 0.8, 0.3), (1.0, 1.0, 0.8), (-0.3, 0.8, 0.7), (0.3, -0.5, 0.6), (-0.3, -0.4, 0.5)):
        for sign in (1.0, -1.0):
            first, last, tied = (np.array([[[x]]]) for x in (a, b, sign * tie))
            assert abs(gap_transition(first, last, tied, one)[0, 0, 0, 0] - quarter_plane(a, b, -sign * tie)) < 1e-7
    for tie in (-0.9, 0.0, 0.4, 0.99):
        none, tied = np.zeros((1, 1, 1)), np.full((1, 1, 1), tie)
        wanted = 1.0 + 2.0 / np.pi * np.arcsin(tie)
        assert abs(gap_transition(none, none, tied, one)[0, 0, 0, 0] - wanted) < 2e-4
    first, last, tie = np.array([[[0.4, 0.4]]]), np.array([[[0.9, 0.9]]]), np.array([[[0.7, -0.7]]])
    both = gap_transition(first, last, tie, one)[0, 0, :, 0].mean()
    assert abs(both - double_transition(*(x[0, 0, :1] for x in (first, last, tie)), one[0])[0, 0]) < 1e-6


def test_ways_across_air() -> None:
    """Drawn skew, parallel and opposite edges: no other places on them make the way shorter."""
    rng, count = np.random.default_rng(1), 60
    first, last = np.zeros((2, count, 4, 3))
    first[:, 3], last[:, 3], last[:, 0] = rng.standard_normal((3, count, 3))
    last[:20, 3] = first[:20, 3]
    last[20:40, 3] = -first[20:40, 3] + 1e-7 * last[20:40, 3]
    for frame in (first, last):
        frame[:, 3] /= np.linalg.norm(frame[:, 3], axis=1)[:, None]
    (r_s, r_r), (z_s, z_r) = rng.uniform(0.02, 3.0, (2, count)), rng.standard_normal((2, count))
    found = EdgeGap(first, last, (np.full(count, 1.5), np.full(count, 2.0))).cross((r_s, z_s), (r_r, z_r))
    for i in range(count):

        def length(places: Any, i: int = i) -> float:
            between = last[i, 0] + places[1] * last[i, 3] - places[0] * first[i, 3]
            ends = np.hypot(r_s[i], places[0] - z_s[i]) + np.hypot(r_r[i], places[1] - z_r[i])
            return float(ends + np.linalg.norm(between))

        assert length([found.places[0][i], found.places[1][i]]) == pytest.approx(found.length[i], abs=1e-14)
        assert minimize(length, [0.1, 0.1], method="BFGS").fun > found.length[i] - 1e-12


def knife_edges(source: tuple[float, float], receiver: tuple[float, float], planes: tuple[float, float]) -> complex:
    """Return the field behind two half-planes y < 0 over the free field, by Kirchhoff and Fresnel: a bivariate erfc."""
    k, (a, b) = 2.0 * np.pi * TONE / C, planes
    legs = a - source[0], b - a, receiver[0] - b
    scales = [np.sqrt(0.5 * k * (1.0 / legs[i] + 1.0 / legs[i + 1])) for i in (0, 1)]
    slope = (receiver[1] - source[1]) / sum(legs)
    low = [-scale * (source[1] + slope * (x - source[0])) for scale, x in zip(scales, planes, strict=True)]
    c = -np.sqrt(legs[0] * legs[2] / ((legs[0] + legs[1]) * (legs[1] + legs[2])))
    turn, (x, w) = np.exp(-0.25j * np.pi), np.polynomial.legendre.leggauss(400)
    v = low[1] + 5.0 * (x + 1.0) * turn
    inner = (low[0] + c * v) / turn
    inside = 0.5 * np.sqrt(np.pi) * turn * np.exp(1j * (c * v) ** 2 - inner**2) * wofz(1j * inner)
    return complex(1j * np.sqrt(1.0 - c**2) / np.pi * np.sum(5.0 * w * turn * np.exp(-1j * v**2) * inside))


def test_two_screens_in_line(measured: Callable[..., float]) -> None:
    """Out of the shadow of both, source and edges in line: -9.1 dB in line, no jump, and all along what Kirchhoff says.

    What screens send back, which Kirchhoff leaves out, is -40 dB.
    """
    room = clsim.MeshRoom.joined([screen(x, (-6.0, 0.0), (-TALL, TALL)) for x in (-0.5, 0.5)])
    paths = clsim.find_paths(scene_of(room, (-2.0, 0.0, 0.0), [LINE((2, -0.5, 0), (2, 0.5, 0), 1.0)]), 1, diffraction=2)
    times = np.linspace(0.3, 0.7, 17) + 1e-4
    found = over_free_field(paths, times, 4.6)
    exact = [knife_edges((-2.0, 0.0), (2.0, time - 0.5), (-0.5, 0.5)) for time in times]
    assert abs(knife_edges((-2.0, 0.0), (2.0, 0.0), (-0.5, 0.5))) == pytest.approx(0.25 + np.arcsin(0.6) / 2 / np.pi)
    error = decibels(found - exact)
    measured("behind two screens in line", "a bivariate error function", error, -39.0)
    beside = over_free_field(paths, 0.5 + np.array([-3e-6, -1e-6, 1e-6, 3e-6]), 4.6)
    assert decibels((beside[2] - beside[1] - 0.5 * (beside[1] - beside[0] + beside[3] - beside[2])) / beside[1]) < -80.0
    without = PathSet(paths.scene, tuple(f for f in paths.families if f.kind != "static edge gap"))
    assert decibels(over_free_field(without, times, 4.6) - exact) > -20.0


POSTS = [[(x - 0.02, y), (x, y - 0.08), (x + 0.02, y), (x, y + 0.08)] for x, y in ((-0.4, -0.05), (0.3, 0.0))]
BEHIND = [(1.2, y) for y in (-0.3, -0.2, -0.12, -0.06, 0.0, 0.04, 0.09, 0.15, 0.22, 0.3)]


def test_behind_two_posts(measured: Callable[..., float]) -> None:
    """Rhombi of 16 cm, one behind the other, in shadow and light, and with source and receivers exchanged."""
    exact, source = field_about(POSTS, (-1.5, 0.0), BEHIND, TONE, 10.0), (-1.5, 0.0, 0.0)
    room, ears = clsim.MeshRoom.joined([prism(foot) for foot in POSTS]), [(*place, 0.0) for place in BEHIND]
    paths, now = clsim.find_paths(scene_of(room, source, ears), 1, diffraction=2), np.zeros(1)
    found = np.array([over_free_field(paths, now, 15.0, i)[0] for i in range(len(ears))])
    error = decibels(np.sqrt(np.mean(np.abs(found - exact) ** 2)))
    measured("behind two posts", "collocation in two dimensions", error, -50.0)
    without = PathSet(paths.scene, tuple(f for f in paths.families if f.kind != "static edge gap"))
    silent = [over_free_field(without, now, 15.0, i)[0] for i in range(len(ears))]
    assert decibels(np.sqrt(np.mean(np.abs(silent - exact) ** 2))) > -25.0
    for i in (0, 5):
        back = clsim.find_paths(scene_of(room, ears[i], [source]), 1, diffraction=2)
        assert decibels(over_free_field(back, now, 15.0)[0] / found[i] - 1.0) < -100.0


def test_no_jump_behind_two_screens(measured: Callable[..., float]) -> None:
    """Walks at 0.5 m/s behind two tall screens, far from their ends: where edges take over, and where all are in line."""
    room, worst = clsim.MeshRoom.joined([screen(-0.5, (-9.0, 0.0), (-TALL, TALL)),
                                         screen(0.5, (-9.0, 0.1), (-TALL, TALL))]), []  # fmt: skip
    for source, last in (((-1.5, -0.3, 0.0), 0.7), ((-1.5, 0.05, 0.1), 0.6), ((-1.0, -0.1, 0.0), 1.0)):
        way = LINE((1.6, -0.6, 0.02), (1.5, last, 0.0), 2.0)
        paths = clsim.find_paths(scene_of(room, source, [way]), 1, diffraction=2)
        near = [family.part(np.flatnonzero(short(family))) for family in paths.families if len(family)]
        paths = PathSet(paths.scene, tuple(family for family in near if len(family)))
        events = np.unique(np.concatenate([x for f in paths.families for x in (f.start, f.end)]))
        events = events[np.isfinite(events)]
        assert len(events) >= 2
        worst.append(decibels(jumps(paths, events, TONE)))
    measured("walks behind two screens", "no jump", max(worst), -66.0)


@pytest.mark.parametrize("slope", few([-0.5, 0.2, 1.0]))
def test_behind_skew_edges(slope: float, measured: Callable[..., float]) -> None:
    """Edges at up to 45 degrees to each other, from the shadow of either into that of the other."""
    lean = np.array([0.0, slope, 1.0]) / np.hypot(slope, 1.0)
    start = np.array([0.3, 0.1 - 0.9 * slope, 0.0]) - TALL * lean
    stop = start + 2.0 * TALL * lean
    corners = [start, stop, stop - [0.0, 5.0 * TALL, 0.0], start - [0.0, 5.0 * TALL, 0.0]]
    leaning = clsim.MeshRoom(np.array(corners), [(0, 1, 2), (0, 2, 3)], HARD, labels=["leaning"] * 2)
    room = clsim.MeshRoom.joined([screen(-0.3, (-5.0 * TALL, 0.0), (-TALL, TALL)), leaning])
    source, ear = (-1.0, -0.6, 0.8), (1.2, -0.9 - 0.3 * abs(slope), 1.2)
    scene = scene_of(room, source, [ear])
    paths = clsim.find_paths(scene, 2, diffraction=2)  # with the terms by faces of both
    family = next(f for f in paths.families if f.kind == "static edge gap")
    rows = np.flatnonzero(short(family) & (family.order == 2))
    assert len(rows) == 1
    found = field(PathSet(scene, (family.part(rows),)), np.array([1.0]), TONE)[0]
    met = family.vertices(rows, 1.0)[0, 1:3]
    ends = [np.array(end) for end in (source, ear)]
    edges, zero = [], np.array([1.0, 0.0, 0.0])
    for along, place in zip((np.array([0.0, 0.0, 1.0]), lean), met, strict=True):
        across = np.cross(along, zero) * -np.sign(np.cross(along, zero)[1])
        edges.append(Edge(place, place + along, across, np.cross(along, across), 2.0 * np.pi))
    exact = field_of_both((edges[0], edges[1]), (ends[0], ends[1]), 2.0 * np.pi * TONE / C, (0.0, 0.0), 0.6)
    error = decibels((found - exact) * np.linalg.norm(ends[1] - ends[0]))
    assert decibels(exact * np.linalg.norm(ends[1] - ends[0])) > -63.0
    measured("behind two skew edges", "an integral along both", error, -105.0)


def short(family: Any) -> np.ndarray:
    """Mask of paths of a family that do not go round the far ends of a screen."""
    kept = np.zeros(len(family), dtype=bool)
    for pair in family.pairs():
        kept[pair.index] = pair.arrivals(np.array([1.0])).length[:, 0] < 6.0
    return kept


def test_no_jump_where_inner_corners_send_past_others(measured: Callable[..., float]) -> None:
    """Drawn walks in a hexagonal room, twice reflected: two inner corners of one wall, and of none; with walls of 1 and 0.7."""
    plan = [(2.0 * np.cos(a), 2.0 * np.sin(a)) for a in np.pi / 3.0 * np.arange(6)]
    rng, worst, fewer = np.random.default_rng(3), [], []
    for draw in range(4):
        room = clsim.MeshRoom.from_plan(plan, 2.5, clsim.Material.from_reflection((1.0, 0.7)[draw % 2]))
        source, first, last = (np.append(rng.uniform(-1.2, 1.2, 2), rng.uniform(0.5, 2.0)) for _ in range(3))
        paths = clsim.find_paths(scene_of(room, source, [LINE(first, last, 3.0)]), 2, diffraction=2)
        events = np.unique(np.concatenate([x for f in paths.families for x in (f.start, f.end)]))
        events = events[np.isfinite(events)]
        worst.append(decibels(jumps(paths, events, TONE)))
        fewer.append(decibels(jumps(PathSet(paths.scene, paths.families[:3]), events, TONE)))
    assert max(fewer) > -45.0  # without the paths across the air there are jumps: nothing passes for want of events
    measured("walks in a hexagon, order 2", "no jump", max(worst), -140.0)


def test_a_floor_is_a_mirror(measured: Callable[..., float]) -> None:
    """Two screens that stand on a rigid floor, which is met before, between or behind their edges: images say the same."""
    floor = clsim.MeshRoom([(-9, -9, 0), (9, -9, 0), (9, 9, 0), (-9, 9, 0)], [(0, 1, 2), (0, 2, 3)], HARD)
    low, tall = (
        clsim.MeshRoom.joined([screen(-0.5, (-3.0, 0.0), z), screen(0.6, (-4.0, 0.1), z)])
        for z in ((0.0, TALL), (-TALL, TALL))
    )
    for source, ear in (((-1.5, -0.4, 1.0), (1.9, -0.5, 0.4)), ((-0.7, -0.6, 0.3), (0.9, -0.2, 1.5))):
        ends, image, sums = (source, [ear]), (*source[:2], -source[2]), []
        standing = clsim.MeshRoom.joined([floor, low])
        for room, start, order in ((standing, source, 1), (tall, source, 1), (tall, image, 0)):
            paths = clsim.find_paths(scene_of(room, start, ends[1]), order, diffraction=2)
            kept = [f for f in paths.families if f.kind == "static edge gap"]
            rows = [f.part(np.flatnonzero(short(f))) for f in kept]
            sums.append(field(PathSet(paths.scene, tuple(rows)), np.array([1.0]), TONE)[0])
        error = decibels(sums[0] / (sums[1] + sums[2]) - 1.0)
        assert abs(sums[2]) > 0.01 * abs(sums[1])
        measured("edges on a floor", "images", error, -140.0)


def boards(motions: list[Any]) -> tuple[list[clsim.Body], list[clsim.MeshRoom]]:
    """Return two boards as bodies, and as parts of a room where they are at rest."""
    dull, sizes = clsim.Material.from_reflection(0.8), ((0.0, 0.7, 1.2), (0.0, 0.6, 1.3))
    bodies = [clsim.Body.box(f"board {i}", sizes[i], dull, motions[i]) for i in range(2)]
    parts = []
    for body in bodies:
        corners = body.placed(body.mesh.vertices, np.zeros(1))
        parts.append(clsim.MeshRoom(corners, body.mesh.triangles, dull))
    return bodies, parts


def test_boards_at_rest_are_those_of_the_room_both_ways(measured: Callable[..., float]) -> None:
    """One or both of two boards as bodies or as parts of a room, with reflections, and with both ends exchanged."""
    walls = clsim.Shoebox((6.0, 4.0, 3.0), clsim.Material.from_reflection(0.7)).as_mesh()
    turn = np.array([0.02, 0.0, np.sin(0.1), np.cos(0.1)])
    still = [FIXED((2.0, 1.55, 1.1)), FIXED((3.5, 1.4, 1.05), turn / np.linalg.norm(turn))]
    bodies, parts = boards(still)
    ends, sums = ((1.0, 1.53, 1.1), (4.7, 1.47, 0.93)), []
    for moved, ways in (([], (ends, ends[::-1])), ([1], (ends,)), ([0, 1], (ends[::-1],))):
        room = clsim.MeshRoom.joined([walls, *(part for i, part in enumerate(parts) if i not in moved)])
        for one, other in ways:
            scene = scene_of(room, one, [other], bodies=[bodies[i] for i in moved])
            paths = clsim.find_paths(scene, 1, diffraction=2)
            gaps = [family for family in paths.families if family.kind.endswith("edge gap")]
            assert sum(len(family) for family in gaps) > 20
            sums.append(field(PathSet(scene, tuple(f for f in gaps if len(f))), np.array([0.05]), TONE)[0])
    error = decibels(np.array(sums) / sums[0] - 1.0)
    measured("boards as bodies, both ways", "boards built into the room", error, -140.0)


def test_a_slow_board_is_the_room_as_it_is(measured: Callable[..., float]) -> None:
    """One board slides at 5 mm/s before another: all paths together are those of the room as it was then."""
    walls = clsim.Shoebox((6.0, 4.0, 3.0), clsim.Material.from_reflection(0.0)).as_mesh()
    bodies, _ = boards([LINE((2.0, 1.5, 1.1), (2.0, 2.0, 1.1), 100.0), FIXED((3.5, 1.4, 1.05))])
    scene, times = scene_of(walls, (1.0, 1.53, 1.1), [(4.7, 1.47, 0.93)], bodies=bodies), np.array([11.0, 37.0, 63.0])
    paths = clsim.find_paths(scene, 0, diffraction=2)
    for time, one in zip(times, field(paths, times, TONE), strict=True):
        still = as_it_is(scene, float(time) - 2.7 / C)
        room = clsim.find_paths(still, 0, diffraction=2)
        kept = tuple(f for f in room.families if f.kind != "static edge and end")  # bodies have no such paths
        there = field(PathSet(still, kept), np.array([0.05]), TONE)[0]
        error = decibels(one - there) + 20.0 * np.log10(3.7)
        measured("a board that moves at 5 mm/s", "the room as it is", error, -88.0)


@pytest.mark.exhaustive
def test_boards_in_tables_and_both_engines(device: None) -> None:
    """Names and corners of the ways, and samples of both engines."""
    walls = clsim.Shoebox((6.0, 4.0, 3.0), clsim.Material.from_reflection(0.7)).as_mesh()
    bodies, _ = boards([LINE((2.0, 1.5, 1.1), (2.0, 1.6, 1.1), 0.2), FIXED((3.5, 1.4, 1.05))])
    paths = clsim.find_paths(scene_of(walls, (1.0, 1.53, 1.1), [(4.7, 1.47, 0.93)], bodies=bodies), 1, diffraction=2)
    [family] = [f for f in paths.families if f.kind == "moving edge gap"]
    between = np.flatnonzero((family.interactions[:, 1] != 3) & (family.order == 3))
    for pair in family.pairs():
        corners, now = pair.family.vertices(pair.index, 0.05), np.array([0.05])
        legs = np.nansum(np.linalg.norm(np.diff(corners, axis=1), axis=2), axis=1)
        np.testing.assert_allclose(legs, C * pair.arrivals(now).delay[:, 0], atol=2e-4)  # the board moves meanwhile
    assert len(between)
    one, other = (clsim.render(paths, 192e3, duration=0.03, engine=name).pressure for name in ("opencl", "reference"))
    assert decibels((one - other) / np.abs(other).max()) < -85.0


def test_what_stands_between_hides_one_edge_from_the_other() -> None:
    """A third screen higher than both, between two: nothing goes over these two alone; a lower one is not in the way."""
    for height, wanted in ((0.3, False), (-0.3, True)):
        parts = [screen(-0.5, (-6.0, 0.0), (-1.0, 1.0)), screen(0.5, (-6.0, 0.1), (-1.0, 1.0))]
        room = clsim.MeshRoom.joined([*parts, screen(0.0, (-6.0, height), (-2.0, 2.0))])
        paths = clsim.find_paths(scene_of(room, (-2.0, -0.5, 0.0), [(2.0, -0.4, 0.0)]), 0, diffraction=2)
        [gaps] = [family for family in paths.families if family.kind == "static edge gap"]
        edges, both = room.edges(), {}
        for i, (start, length) in enumerate(zip(edges.start, edges.length, strict=True)):
            if length == 2.0 and start[1] > -1.0:
                both[start[0]] = i
        assert ([both[-0.5], both[0.5]] in gaps.objects[:, :2].tolist()) == wanted
