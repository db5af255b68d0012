"""Paths over two edges: behind a pillar against the field of its outline, and where they take over from others."""

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest
from corner_oracle import Edge, field_of_both
from edge_fields import field, jumps
from exhaustive import few
from pillar_bem import HEIGHT, PILLAR, RECEIVERS, SIDE, SOURCE, WALLS, C, field_behind
from scipy.special import hankel2

import clsim
from clsim.acoustics.diffraction import double_transition, transition
from clsim.paths.path_set import PathSet
from clsim.paths.response import SceneResponse

RATE, TONE = 192e3, 40e3
TALL = 30.0  # m, to the ends of the pillar


def prism(width: float, height: float, turned: bool = False) -> clsim.MeshRoom:
    """Return a tall prism over a rectangle, or over the rhombus of as wide diagonals."""
    x, y = 0.5 * width, 0.5 * height
    foot = [(-x, 0.0), (0.0, -y), (x, 0.0), (0.0, y)] if turned else [(-x, -y), (x, -y), (x, y), (-x, y)]
    corners = [(*place, z) for z in (-TALL, TALL) for place in foot]
    sides = [(i, (i + 1) % 4, j) for i in range(4) for j in (4 + (i + 1) % 4,)]
    sides += [(i, 4 + (i + 1) % 4, 4 + i) for i in range(4)]
    return clsim.MeshRoom(corners, sides, clsim.Material.from_reflection(1.0))


def closed(room: clsim.MeshRoom) -> clsim.MeshRoom:
    """Return a prism with its ends, as a panel is modelled."""
    ends = [(0, 2, 1), (0, 3, 2), (4, 5, 6), (4, 6, 7)]
    triangles = [*room.triangles.tolist(), *ends]
    return clsim.MeshRoom(room.vertices, triangles, room.faces.materials[0])


def paths_past(receivers: list[clsim.Trajectory], diffraction: int, room: clsim.MeshRoom | None = None) -> PathSet:
    """Return the paths past a room, of a pillar where it is left out."""
    room = room or prism(SIDE, SIDE)
    source = clsim.Source("s", clsim.Signal.tone(TONE, 0.01, RATE), clsim.Trajectory.fixed((*SOURCE, 0.0)))
    ears = [clsim.Receiver(f"r{i}", way) for i, way in enumerate(receivers)]
    scene = clsim.Scene(room, clsim.Air(absorption=False, speed_of_sound=C), [source], ears)
    paths = clsim.find_paths(scene, 1, diffraction=diffraction)
    time = np.zeros(1)
    near = [
        np.concatenate([pair.index[pair.arrivals(time).length[:, 0] < 0.5 * TALL] for pair in family.pairs()])
        for family in paths.families
        if len(family)
    ]
    kept = [family for family in paths.families if len(family)]
    return PathSet(scene, tuple(family.part(rows) for family, rows in zip(kept, near, strict=True)))


def of_kind(paths: PathSet, kind: str) -> Any:
    """Return the one family of a kind."""
    [found] = [family for family in paths.families if family.kind == kind]
    return found


@cache
def at_rest(diffraction: int, room: clsim.MeshRoom | None = None) -> PathSet:
    return paths_past([clsim.Trajectory.fixed((*place, 0.0)) for place in RECEIVERS], diffraction, room)


def error_db(paths: PathSet, exact: np.ndarray) -> float:
    """Return the root mean square over places out of sight, relative to the free field."""
    return float(10.0 * np.log10(np.mean(np.abs(over_free_field(paths) - exact) ** 2)))


def over_free_field(paths: PathSet, places: list[tuple[float, float]] = RECEIVERS) -> np.ndarray:
    """Return totals at the receivers in two dimensions: ways spread as a line's sound does."""
    k, at, time = 2.0 * np.pi * TONE / C, SceneResponse(paths.scene, 0, np.array([TONE])), np.zeros(1)
    total = np.zeros(len(places), dtype=complex)
    for family in paths.families:
        for pair in family.pairs():
            found = pair.arrivals(time)
            length, free = found.length[:, 0], np.linalg.norm(np.subtract(places[pair.receiver], SOURCE))
            made = pair.response(found, time, at)[:, 0, 0] * length
            total[pair.receiver] += np.sum(made * hankel2(0, k * length)) / hankel2(0, k * free)
    return total


@pytest.mark.parametrize(("diffraction", "bound"), [(1, -12.0), (2, -52.0)])
def test_behind_a_pillar(diffraction: int, bound: float, measured: Callable[..., float]) -> None:
    """Relative to the free field, of which all that is heard is -11 dB there."""
    found = error_db(at_rest(diffraction), PILLAR)
    measured(f"behind a pillar, {diffraction} edges", "collocation in two dimensions", found, bound)


@pytest.mark.parametrize(("side", "level", "bound"), [(0.05, -6.6, -52.0), (0.1, -9.4, -56.0)])
def test_deep_shadows_of_pillars_of_a_room(side: float, level: float, bound: float, measured) -> None:
    """Pillars of 5 and 10 cm: the level is within 1.5 dB of that by collocation, as for 20 cm above."""
    places = [(1.5, y * side / SIDE) for y in (-0.13, 0.0, 0.05, 0.11)]
    exact = field_behind((side, side), TONE, 14.0, places)
    paths = paths_past([clsim.Trajectory.fixed((*place, 0.0)) for place in places], 2, prism(side, side))
    found = over_free_field(paths, places)
    rms, made = (10.0 * np.log10(np.mean(np.abs(x) ** 2)) for x in (exact, found))
    assert rms == pytest.approx(level, abs=2.5)
    assert made == pytest.approx(rms, abs=1.5)
    error = float(10.0 * np.log10(np.mean(np.abs(found - exact) ** 2)))
    measured(f"behind a pillar of {100 * side:g} cm, 2 edges", "collocation in two dimensions", error, bound)


@pytest.mark.parametrize(("millimetres", "bound"), few([(2, -49.0), (5, -44.0), (10, -40.0), (20, -36.0)], (0, 3)))
def test_behind_thin_walls(millimetres: int, bound: float, measured: Callable[..., float]) -> None:
    """A wall as a sheet with one edge, as it is with two edges, and (2 mm) as a thin wedge: all agree with collocation."""
    thickness = 1e-3 * millimetres
    wall, exact = prism(thickness, HEIGHT), WALLS[thickness]
    sheet = closed(wall).with_sheets(0.03)
    assert len(sheet.walls) == 1
    error = error_db(at_rest(1, sheet), exact)
    measured("behind walls of 2 to 20 mm as sheets", "collocation in two dimensions", error, bound)
    measured(
        "behind walls of 2 to 20 mm, 2 edges", "collocation in two dimensions", error_db(at_rest(2, wall), exact), -58.0
    )
    if millimetres == 2:
        assert error_db(at_rest(1, prism(thickness, HEIGHT, turned=True)), exact) < bound


def double_integral(a: float, b: float, tie: float) -> complex:
    """Return the transition function of two edges as it is defined, by the rule of trapezoids."""
    x = np.linspace(-6.0, 6.0, 601)
    one, other = np.meshgrid(x, x)
    fall = np.exp(-(one**2 + other**2 + 2.0 * tie * one * other))
    total = np.sum(fall / ((one**2 + 1j * a**2) * (other**2 + 1j * b**2)))
    return complex(1j * a * b / np.pi**2 * total * (x[1] - x[0]) ** 2)


def test_the_transition_of_two_edges() -> None:
    """Against its double integral, its limits, and across its boundaries, where partners over one edge join in."""
    one = np.ones((1, 1))
    for a, b, tie in ((0.5, 0.8, 0.3), (1.0, 1.0, 0.8), (2.0, 0.4, 0.9), (3.0, 4.0, 0.6), (0.3, 0.3, 0.0)):
        roots, wave = (np.array([x / np.sqrt(700.0)]) for x in (a, b)), np.array([[140.0, 700.0]])
        found = double_transition(*roots, np.array([tie]), wave)[0, 1]
        assert abs(found - double_integral(a, b, tie)) < 2e-6
    for tie in (0.0, 0.5, 0.99):
        w, b, nothing = np.array([tie]), np.array([0.7]), np.zeros(1)
        np.testing.assert_allclose(double_transition(nothing, nothing, w, one), 1.0, atol=2e-4)
        np.testing.assert_allclose(double_transition(nothing, b, w, one)[:, 0], transition(b), atol=2e-5)
        far = transition(b * np.sqrt(1.0 - w**2)) * transition(np.array([400.0]))
        np.testing.assert_allclose(double_transition(b, np.array([400.0]), w, one)[:, 0], far, rtol=1e-2)
        root = np.linspace(-0.4, 0.4, 41)
        for other in (0.7, -0.3):
            across = double_transition(root, np.full(41, other), np.full(41, tie), np.ones((41, 1)))[:, 0]
            assert np.abs(np.diff(across, 5)).max() < 1e-4, "a step or a kink"
            back = double_transition(np.full(41, other), root, np.full(41, tie), np.ones((41, 1)))[:, 0]
            np.testing.assert_allclose(across, back, atol=1e-12)


def test_ways_over_two_edges() -> None:
    """Delays are those of the legs, both edges are told, and both ends are alike."""
    paths = at_rest(2)
    double, half = of_kind(paths, "static edge pair"), 0.5 * SIDE
    assert np.all(double.order == 2 + np.sum(double.interactions == 0, axis=1))
    for pair in double.pairs():
        found, (x, y) = pair.arrivals(np.zeros(1)), RECEIVERS[pair.receiver]
        corners = double.vertices(pair.rows, 0.0)[:, :4, :2]
        legs = np.linalg.norm(np.diff(corners, axis=1), axis=2).sum(axis=1)
        np.testing.assert_allclose(found.length[:, 0], legs, rtol=1e-12)
        np.testing.assert_allclose(found.delay[:, 0] * C, legs, rtol=1e-12)
        np.testing.assert_allclose(np.abs(corners[:, 1:3]), half, atol=1e-12)
        np.testing.assert_allclose(corners[:, 3], np.tile((x, y), (len(legs), 1)), atol=1e-12)


def test_no_jump_where_the_second_edge_takes_over(measured: Callable[..., float]) -> None:
    """A walk out of the deep shadow: what one edge sends begins as two edges have half of it, and the sight comes."""
    way = clsim.Trajectory.line((1.5, 0.06, 0.02), (1.48, 0.19, 0.03), 0.1)
    paths = paths_past([way], 2)
    single = of_kind(paths, "static edge")
    events = np.unique(np.concatenate([single.start, single.end, paths.families[0].start, paths.families[0].end]))
    events = events[np.isfinite(events)]
    assert len(events) >= 2
    measured(
        "where the second edge takes over", "no jump", float(20.0 * np.log10(jumps(paths, events, TONE).max())), -58.0
    )
    without = PathSet(paths.scene, tuple(f for f in paths.families if f.kind != "static edge pair"))
    assert 20.0 * np.log10(jumps(without, events, TONE).max()) > -10.0


@pytest.mark.parametrize("ends", [((-1.0, 0.1, -0.4), (1.1, -0.1, -0.5)), ((-0.6, 0.3, -0.5), (1.3, -0.3, -0.2))])
def test_over_the_top_of_a_wedge_shaped_block(ends: Any, measured: Callable[..., float]) -> None:
    """Edges of one face at 15 degrees to each other, against one integral along both."""
    slope = np.tan(np.radians(15.0))
    foot = [(-0.2, -0.4 / slope), (0.2 + TALL * slope, TALL), (-0.2, TALL)]
    corners = [(*place, z) for z in (-TALL, 0.0) for place in foot]
    sides = [(i, (i + 1) % 3, 3 + (i + 1) % 3) for i in range(3)] + [(i, 3 + (i + 1) % 3, 3 + i) for i in range(3)]
    block = clsim.MeshRoom(corners, [*sides, (3, 4, 5)], clsim.Material.from_reflection(1.0))
    source, ear = (clsim.Trajectory.fixed(end) for end in ends)
    scene = clsim.Scene(
        block, clsim.Air(absorption=False, speed_of_sound=C),
        [clsim.Source("s", clsim.Signal.tone(TONE, 0.01, RATE), source)], [clsim.Receiver("r", ear)],
    )  # fmt: skip
    double = of_kind(clsim.find_paths(scene, 2, diffraction=2), "static edge pair")
    [pair] = double.pairs()
    rows = np.flatnonzero((double.order == 2) & (pair.arrivals(np.zeros(1)).length[:, 0] < 4.0))
    assert len(rows) == 1
    found = field(PathSet(scene, (double.part(rows),)), np.zeros(1), TONE)[0]
    edges, up = [], np.array([0.0, 0.0, 1.0])
    for along, place, turn in (((0.0, 1.0), (-0.2, 0.0), 1.0), ((slope, 1.0), (0.2, 0.0), -1.0)):
        unit = np.append(along, 0.0) / np.hypot(*along)
        edges.append(
            Edge(np.append(place, 0.0), np.append(place, 0.0) + unit, turn * np.cross(unit, up), up, 1.5 * np.pi)
        )
    near = [float((met[:2] - edge.start[:2]) @ (edge.stop - edge.start)[:2])
            for met, edge in zip(double.vertices(rows, 0.0)[0, 1:3], edges, strict=True)]  # fmt: skip
    both = field_of_both(
        (edges[0], edges[1]), (np.array(ends[0]), np.array(ends[1])), 2.0 * np.pi * TONE / C, (near[0], near[1]), 0.5
    )
    # Along the face either edge sends twice as much as off it.
    error = 20.0 * np.log10(abs(found - 0.5 * both) * np.linalg.norm(np.subtract(*ends)))
    measured("over two edges of a face at 15 degrees", "an integral along both", error, -103.0)


@pytest.mark.parametrize("standing", [0.0005, 0.002, 0.5])
def test_what_stands_between_two_edges_hides_one_from_the_other(standing: float, device: None) -> None:
    """A fin on top of a thick screen: the way over both edges ends where it meets the fin, and is back behind it.

    One of less than 1 mm is not in the way.
    """
    box = clsim.Shoebox((0.4, 4.0, 1.0), clsim.Material.from_reflection(0.9)).as_mesh()
    screen = clsim.MeshRoom(box.vertices - (0.2, 2.0, 0.0), box.triangles, box.faces.materials[0])
    corners = [(0.1, -0.3, 1), (0.1, 0.3, 1), (0.1, 0.3, 1 + standing), (0.1, -0.3, 1 + standing)]
    fin = clsim.MeshRoom(corners, [(0, 1, 2), (0, 2, 3)], box.faces.materials[0], labels=["fin"] * 2)
    screen = clsim.MeshRoom.joined([screen, fin])
    source = clsim.Source("s", clsim.Signal.tone(TONE, 0.01, RATE), clsim.Trajectory.fixed((-1.5, 0.0, 0.8)))
    ear = clsim.Receiver("r", clsim.Trajectory.line((1.5, -1.5, 0.8), (1.5, 1.5, 0.8), 1.0))
    scene = clsim.Scene(screen, clsim.Air(speed_of_sound=C), [source], [ear])
    double = of_kind(clsim.find_paths(scene, 0, diffraction=2, resolution=1e-5), "static edge pair")
    # On the rolled-out way from r_s = √(1.3² + 0.2²) before the first edge to as much behind the last, the fin is 0.3 m on.
    edges = screen.edges()
    top = np.flatnonzero(
        (np.abs(edges.start[:, 2] - 1.0) < 1e-9) & (np.abs(edges.along[:, 1]) > 0.9) & (edges.n == 1.5)
    )
    over = [row for row in range(len(double)) if set(double.objects[row, :2].tolist()) == set(top.tolist())]
    rows = np.array(over)[np.argsort(double.start[over])]
    r = np.hypot(1.3, 0.2)
    passed = 0.5 + np.array([-0.1, 0.1]) * (2.0 * r + 0.4) / (r + 0.3)
    wanted = [(-np.inf, passed[0]), (passed[1], np.inf)] if standing > 0.001 else [(-np.inf, np.inf)]
    heard = np.column_stack([double.start[rows], double.end[rows]])
    joined = np.delete(heard.ravel(), [i for i in range(1, heard.size - 1) if heard.ravel()[i] in np.delete(heard, i)])
    np.testing.assert_allclose(joined, np.ravel(wanted), atol=2e-5)
