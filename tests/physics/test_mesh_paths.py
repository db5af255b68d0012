"""Paths in meshes against closed forms and against a brute force that shares no code with them."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from edge_fields import terms
from exhaustive import few
from made_meshes import box, cut_box, hall, joined, l_room, pillar_room, screen
from mesh_oracle import Oracle
from scenes import DATA

import clsim
from clsim.numerics.quaternions import rotate
from clsim.paths.path_set import PathSet
from clsim.paths.visibility import edge_intervals, intervals
from clsim.paths.visibility.edges import EdgeVisibility
from clsim.scene.room.mesh_files import read_mesh

PLAN = [(0, 0), (8, 0), (8, 4), (4, 4), (4, 8), (0, 8)]
MOST = 40_000  # evaluations; 0.5 s at 1 ms are 1500 of each path on a boundary, at the resolution of 0.3 us 3 million


def on_the_diagonal(aside: float) -> PathSet:
    """Find the paths of a walk along the diagonal through the corner of an L, of which the source is so far aside, m."""
    room = clsim.MeshRoom.from_plan(PLAN, 3.0, clsim.Material.from_reflection(0.9))
    beacon = clsim.Source("s", clsim.Signal.tone(40e3, 1.0, 192e3), clsim.Trajectory.fixed((2.0 + aside, 2.0, 1.5)))
    walker = clsim.Receiver("r", clsim.Trajectory.line((1.0, 1.0, 1.2), (3.5, 3.5, 1.3), 0.5))
    return clsim.find_paths(clsim.Scene(room, clsim.Air(), [beacon], [walker]), 3, diffraction=1)


@pytest.fixture
def counted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fail where sides of paths are asked for too often."""
    asked, sides = [0], EdgeVisibility.sides

    def counting(self, which, time, half):
        asked[0] += len(which)
        assert asked[0] < MOST
        return sides(self, which, time, half)

    monkeypatch.setattr(EdgeVisibility, "sides", counting)


def test_a_walk_on_the_diagonal_of_an_l(counted: None) -> None:
    """A source 2 um aside, whose paths are on one side of each boundary, gives the same pressure."""
    times = np.linspace(0.01, 0.49, 49)
    one, other = (terms(on_the_diagonal(aside), times, 40e3) for aside in (0.0, 2e-6))
    apart = np.abs(one.sum(axis=0) - other.sum(axis=0)) / np.abs(other).max(axis=0)
    assert apart.max() < 0.02  # 2 um of 130 paths and more: 1.5e-3 rad each, added as their squares


def test_endless_searches_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    few = SimpleNamespace(**vars(intervals) | {"MOST_EVALUATIONS": 500})
    monkeypatch.setattr(edge_intervals, "intervals", few)  # reflections take more than these
    with pytest.raises(clsim.InputError, match=r"diffraction: must let .* 500 .*lower max_order, or give a larger res"):
        on_the_diagonal(0.0)


MESHES = DATA / "meshes"
WALL = clsim.Material.from_reflection(0.9)
TONE = clsim.Signal.tone(40e3, 0.05, 192e3, fade=0.01)


@pytest.fixture(params=["opencl", "reference"])
def validated_by(request: pytest.FixtureRequest) -> str:
    if request.param == "opencl":
        request.getfixturevalue("device")
    return str(request.param)


def scene_of(room, source, *receivers, signal=TONE) -> clsim.Scene:
    def path(at):
        return at if isinstance(at, clsim.Trajectory) else clsim.Trajectory.fixed(at)

    ears = [clsim.Receiver(f"r{i}", path(r)) for i, r in enumerate(receivers)]
    return clsim.Scene(room, clsim.Air(), [clsim.Source("s", signal, path(source))], ears)


def by_planes(paths: PathSet, oracle: Oracle) -> dict[tuple[int, int, tuple[int, ...]], np.ndarray]:
    """Return corners by source, receiver and sequence of the oracle's planes."""
    plane = np.empty(len(paths.scene.room.walls), dtype=int)
    plane[paths.scene.room.walls.of_triangle] = oracle.plane_of
    found = {}
    for s, r, walls, corners in zip(paths.source, paths.receiver, paths.walls, paths.vertices(0.0), strict=True):
        key = (int(s), int(r), tuple(plane[walls[walls >= 0]].tolist()))
        assert key not in found, "counted twice"
        found[key] = corners[np.isfinite(corners[:, 0])]
    return found


def check_against_brute_force(room, sources, receivers, order: int, **options) -> int:
    """Compare all pairs; return how many paths there are."""
    oracle = Oracle(room.vertices, room.triangles)
    ears = [clsim.Receiver(f"r{i}", clsim.Trajectory.fixed(r)) for i, r in enumerate(receivers)]
    mouths = [clsim.Source(f"s{i}", TONE, clsim.Trajectory.fixed(s)) for i, s in enumerate(sources)]
    scene = clsim.Scene(room, clsim.Air(), mouths, ears)
    got = by_planes(clsim.find_paths(scene, order, **options), oracle)
    count = 0
    for i, s in enumerate(sources):
        for j, r in enumerate(receivers):
            wanted = oracle.paths(np.asarray(s), np.asarray(r), order)
            mine = {key[2]: corners for key, corners in got.items() if key[:2] == (i, j)}
            assert mine.keys() == wanted.keys()
            for key, corners in wanted.items():
                np.testing.assert_allclose(mine[key], corners, atol=1e-9 * max(1.0, float(np.ptp(room.vertices))))
            count += len(wanted)
    return count


def points_inside(room, rng: np.random.Generator, count: int) -> np.ndarray:
    low, high = room.extent
    found = np.empty((0, 3))
    while len(found) < count:
        points = rng.uniform(low, high, (count, 3))
        found = np.concatenate([found, points[room.contains(points)]])
    return found[:count]


def read(name: str) -> clsim.MeshRoom:
    path = MESHES / name
    if not path.exists():
        pytest.skip(f"no {name} to test against")
    mesh = read_mesh(path)
    return clsim.MeshRoom(mesh.vertices, mesh.triangles, WALL)


@pytest.mark.parametrize("mesh", [box((8, 6, 3)), cut_box((8, 6, 3), 50)], ids=["12 triangles", "300 triangles"])
def test_a_shoebox_as_a_mesh_has_the_closed_forms_paths(mesh, validated_by) -> None:
    room = clsim.MeshRoom(*mesh, WALL)
    assert len(room.walls) == 6
    source, receiver = (2.0, 2.5, 1.2), (6.1, 3.3, 1.9)
    order = 5 if validated_by == "opencl" else 3
    mine = clsim.find_paths(scene_of(room, source, receiver), order, engine=validated_by)
    closed = clsim.find_paths(scene_of(clsim.Shoebox((8, 6, 3), WALL), source, receiver), order)
    assert len(mine) == len(closed) == {5: 231, 3: 63}[order]
    images = [np.round(f.legs[0].matrix @ source + f.legs[0].offset, 12) for p in (mine, closed) for f in p.families]
    ordered = [i[np.lexsort(np.round(i, 6).T)] for i in images]
    np.testing.assert_allclose(ordered[0], ordered[1], atol=1e-9)
    assert np.all(np.isneginf(mine.start))
    assert np.all(np.isposinf(mine.end))


@pytest.mark.usefixtures("device")
@pytest.mark.parametrize(
    ("source", "receiver"),
    [
        ((4, 3, 1.5), (6.1, 3.3, 1.9)),  # a centre
        ((4, 3, 1.5), (4, 3, 2.0)),  # both on axes of symmetry
        ((2, 1.5, 0.75), (4, 3, 1.5)),  # on a diagonal of the box: hits on edges and in corners
        ((2, 2, 1), (6, 4, 2)),  # a mirror pair
        ((1.2, 1.2, 1.0), (2.4, 2.4, 1.0)),  # in the mirror plane of an edge
    ],
)
def test_symmetric_positions_lose_and_double_no_path(source, receiver) -> None:
    scene = scene_of(clsim.MeshRoom(*box((8, 6, 3)), WALL), source, receiver)
    closed = scene_of(clsim.Shoebox((8, 6, 3), WALL), source, receiver)
    mine, wanted = clsim.find_paths(scene, 5), clsim.find_paths(closed, 5)
    assert len(mine) == len(wanted)
    images = [
        f.legs[0].matrix @ np.asarray(source, float) + f.legs[0].offset for p in (mine, wanted) for f in p.families
    ]
    ordered = [i[np.lexsort(np.round(i, 6).T)] for i in images]
    np.testing.assert_allclose(ordered[0], ordered[1], atol=1e-9)


@pytest.mark.usefixtures("device")
@pytest.mark.parametrize("mesh", [l_room(), pillar_room(), hall(3)], ids=["L", "pillar", "hall"])
def test_made_rooms_have_the_paths_of_brute_force(mesh, rng) -> None:
    room = clsim.MeshRoom(*mesh, WALL)
    points = points_inside(room, rng, 6)
    assert check_against_brute_force(room, points[:3], points[3:], 3 if len(room.walls) < 20 else 2) > 100


@pytest.mark.usefixtures("device")
@pytest.mark.parametrize("boxes", [3, 7])  # looked up by NumPy, and on the device
def test_rooms_full_of_things_have_the_paths_of_brute_force(boxes: int, rng) -> None:
    things = [box((8, 6, 3))]
    for i in range(boxes):  # apart from each other, and turned
        turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        corners, triangles = box(rng.uniform(0.3, 0.9, 3))
        things.append((corners @ turn.T + (1.2 + 2.0 * (i % 4), 1.5 + 2.6 * (i // 4), 1.5), triangles))
    slats = [screen((1.0 + 0.9 * i, 2.8, 0.3), (0.5, 0.2, 0.0), 2.0) for i in range(3 * boxes)]
    room = clsim.MeshRoom(*joined(*things, *(slats[:7])), WALL)
    assert (len(room.walls) > 50) == (boxes == 7)
    points = points_inside(room, rng, 5)
    assert check_against_brute_force(room, points[:2], points[2:], 2) > 60


def test_numpy_finds_the_paths_of_brute_force(rng) -> None:
    room = clsim.MeshRoom(*l_room(), WALL)
    points = points_inside(room, rng, 4)
    assert check_against_brute_force(room, points[:2], points[2:], 3, engine="reference") > 50


@pytest.mark.usefixtures("device")
@pytest.mark.parametrize(
    "name", ["small_square", "small_triangle", "small_pentagon", "small_heptagon", "medium_triangle", "echo_tunnel"]
)
def test_prisms_have_the_paths_of_brute_force(name: str, rng) -> None:
    room = read(f"{name}.obj")
    points = points_inside(room, rng, 8)
    assert check_against_brute_force(room, points[:3], points[3:], 3) > 15 * 20


@pytest.mark.usefixtures("device")
@pytest.mark.filterwarnings("ignore:.*Fresnel zone:clsim.ClsimWarning")  # of furniture
@pytest.mark.parametrize(("name", "order", "pairs"), few([("bedroom", 3, 4), ("bedroom", 2, 20), ("concert", 2, 20)]))
def test_real_rooms_have_the_paths_of_brute_force(name: str, order: int, pairs: int, rng) -> None:
    room = read(f"{name}.obj")
    if name == "bedroom":
        assert len(room.walls) == 26
    points = points_inside(room, rng, 2 * pairs)
    for i in range(0, pairs, 5):
        here = slice(i, min(i + 5, pairs))
        assert check_against_brute_force(room, points[here], points[pairs:][here], order) > 20


@pytest.mark.usefixtures("device")
def test_screens_in_a_box_have_the_paths_of_brute_force(rng) -> None:
    parts = [read(n) for n in ("box__box.ply", "box_two_screens__screen_1.ply", "box_two_screens__screen_2.ply")]
    room = clsim.MeshRoom.joined(parts)
    low, high = parts[0].extent
    points = rng.uniform(low + 0.1, high - 0.1, (8, 3))
    assert check_against_brute_force(room, points[:2], points[2:5], 4) > 300


@pytest.mark.usefixtures("device")
def test_a_screen_in_a_shoebox_works_as_one_room(rng) -> None:
    box_room = clsim.Shoebox((8, 6, 3), WALL)
    board = clsim.MeshRoom(*screen((4.0, 1.0, 0.0), (0.3, 3.0, 0.0), 2.0), WALL)
    room = clsim.MeshRoom.joined([box_room, board])
    assert len(room.walls) == 7
    points = rng.uniform((0.2, 0.2, 0.2), (7.8, 5.8, 2.8), (4, 3))
    assert check_against_brute_force(room, points[:2], points[2:], 3) > 60


@pytest.mark.usefixtures("device")
def test_walls_of_two_materials_in_one_plane_share_no_path(rng) -> None:
    vertices, triangles = cut_box((8, 6, 3), 8)
    half = vertices[triangles].mean(axis=1)[:, 0] < 4.0
    other = clsim.Material.from_reflection(-0.5)
    room = clsim.MeshRoom(vertices, triangles, [WALL if h else other for h in half])
    assert len(room.walls) == 10
    points = rng.uniform((0.2, 0.2, 0.2), (7.8, 5.8, 2.8), (4, 3))
    assert check_against_brute_force(room, points[:2], points[2:], 3) == 4 * 63


@pytest.mark.usefixtures("device")
def test_walls_that_lie_on_each_other_are_heard_once(rng) -> None:
    # A carpet on the floor, in its very plane: the wall of lower index owns what both hold.
    floor = (np.array([[2, 1, 0], [6, 1, 0], [6, 5, 0], [2, 5, 0]], float), np.array([[0, 1, 2], [0, 2, 3]]))
    carpet = clsim.MeshRoom(*floor, clsim.Material.from_reflection(0.2))
    room = clsim.MeshRoom.joined([clsim.Shoebox((8, 6, 3), WALL), carpet])
    points = rng.uniform((0.2, 0.2, 0.2), (7.8, 5.8, 2.8), (4, 3))
    assert check_against_brute_force(room, points[:2], points[2:], 3) == 4 * 63


@pytest.mark.usefixtures("device")
def test_walls_that_run_through_each_other(rng) -> None:
    # A board that leans through the floor and through another board.
    leaning = screen((3.0, 1.0, -0.5), (0.0, 3.0, 0.0), 2.0)
    leaning[0][2:, 0] += 1.5
    room = clsim.MeshRoom(*joined(box((8, 6, 3)), leaning, screen((2.0, 2.5, 0.5), (4.0, 0.2, 0.0), 1.5)), WALL)
    points = rng.uniform((0.2, 0.2, 0.2), (7.8, 5.8, 2.8), (6, 3))
    assert check_against_brute_force(room, points[:3], points[3:], 3) > 9 * 20


@pytest.mark.usefixtures("device")
def test_receivers_behind_a_closed_door_hear_nothing() -> None:
    room = clsim.MeshRoom(*joined(box((4, 4, 3)), (box((4, 4, 3))[0] + [10, 0, 0], box((4, 4, 3))[1])), WALL)
    paths = clsim.find_paths(scene_of(room, (1, 1, 1), (12, 2, 1)), 3)
    assert len(paths) == 0
    assert paths.walls.shape == (0, 3)


@pytest.mark.usefixtures("device")
def test_turning_the_room_turns_nothing_else(rng) -> None:
    vertices, triangles = l_room()
    turn = rng.normal(size=4)
    turn /= np.linalg.norm(turn)
    ends = np.array([(1.0, 2.0, 1.1), (6.5, 3.9, 2.0)])
    tables = []
    for quaternion, shift in ((np.array([0.0, 0, 0, 1]), 0.0), (turn, 7.0)):
        room = clsim.MeshRoom(rotate(quaternion, vertices) + shift, triangles, WALL)
        placed = rotate(quaternion, ends) + shift
        table = clsim.find_paths(scene_of(room, *placed), 4).table([0.0])
        tables.append(np.sort(table.delay[:, 0]))
    np.testing.assert_allclose(tables[0], tables[1], rtol=0, atol=1e-13)


@pytest.mark.parametrize("per_face", [2, 50])
def test_a_shoebox_as_a_mesh_sounds_like_the_shoebox(per_face: int, engine, once, measured) -> None:
    source = clsim.Trajectory.circle((3.0, 2.5, 1.2), 0.6, 0.5, 0.2)
    signal = clsim.Signal.chirp(20e3, 60e3, 0.1, 192e3, window="tukey")
    order, duration = (5, 0.12) if engine == "opencl" else (2, 0.05)  # the reference engine is slow
    # As the source moves, pairs of walls swap their order: one path ends where another with the same image begins. What is
    # compared is two roundings of one sum, so the filters' own error must be below.
    exact = clsim.Bandlimited(error_db=-115)

    def heard(room: Any) -> np.ndarray:
        scene = scene_of(room, source, (6.1, 3.3, 1.9), signal=signal)
        paths = clsim.find_paths(scene, order, engine=engine)
        made = clsim.render(paths, 192e3, duration=duration, engine=engine, interpolator=exact, responses="centre")
        return made.pressure[0].astype(float)

    mesh = heard(clsim.MeshRoom(*cut_box((8, 6, 3), per_face), WALL))
    closed = once(f"the shoebox that a mesh sounds like, {engine}", lambda: heard(clsim.Shoebox((8, 6, 3), WALL)))
    found = 20 * np.log10(max(np.linalg.norm(mesh - closed) / np.linalg.norm(closed), 1e-15))
    measured("a shoebox as a mesh", "the shoebox", found, -110.0)
