"""Meshes as they come: damaged rooms are the rooms that they were, and clean ones keep every bit."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from exhaustive import few

import clsim
from clsim.pictures.view_page import ViewedFlaws, ViewedPaths, page_text
from clsim.scene.room.healing import heal_mesh
from clsim.scene.scene import viewed_flaws

WALL = clsim.Material.from_reflection(0.9)
BOX = [(x, y, z) for z in (0, 3) for y in (0, 4) for x in (0, 5)]
SIDES = [(0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5)]
DAMAGES = ("cuts", "flips", "copies", "jitter", "split", "in line")


def rooms() -> list[clsim.MeshRoom]:
    """Ten rooms without a flaw, all of which hold (1, 1, 1) and (2.6, 1.2, 1.4)."""
    plans: list[Any] = [
        [(0, 0), (5, 0), (5, 4), (0, 4)], [(0, 0), (6, 0), (6, 3), (3, 3), (3, 6), (0, 6)],
        [(0, 0), (5, 0), (6, 2.5), (4, 5), (1, 5), (-1, 2)], [(0, 0), (5, 0.3), (4.4, 4), (0.2, 3.5)],
        [(0, 0), (6, 0), (6, 4), (4, 4), (4, 2), (2, 2), (2, 4), (0, 4)],
    ]  # fmt: skip
    made = [clsim.MeshRoom.from_plan(plan, 2.7, WALL) for plan in plans]
    made.append(clsim.MeshRoom.from_plan(plans[0], 2.5, WALL, [[(3, 2.5), (3.5, 2.5), (3.5, 3), (3, 3)]]))
    made.append(clsim.MeshRoom.from_plan(plans[1], 2.5, WALL, [[(1.5, 4), (2, 4), (1.7, 4.4)]]))
    box = clsim.Shoebox((0.7, 0.6, 0.9), WALL).as_mesh()
    crate = clsim.MeshRoom(box.vertices + np.array([3.5, 2.0, 0.6]), box.triangles, WALL)
    made += [clsim.MeshRoom.joined([made[0], crate]), clsim.MeshRoom.joined([made[3], crate])]
    return [*made, clsim.Shoebox((5.0, 4.0, 3.0), WALL).as_mesh()]


def damaged(room: clsim.MeshRoom, damage: str, rng: np.random.Generator) -> tuple[np.ndarray, list[Any], float]:
    """Corners and polygons of a damaged room, and by how much corners were moved at most, m."""
    corners, triangles = [*room.vertices.tolist()], [list(map(int, t)) for t in room.triangles]
    chosen = rng.permutation(len(triangles))[: max(2, len(triangles) // 4)].tolist()
    if damage in ("cuts", "in line"):
        for t in chosen:
            a, b, c = np.roll(triangles[t], rng.integers(3)).tolist()
            share = rng.uniform(0.2, 0.8)
            corners.append([(1.0 - share) * x + share * y for x, y in zip(corners[a], corners[b], strict=True)])
            new = len(corners) - 1
            if damage == "in line":
                triangles[t] = [a, new, b, c]
            else:
                triangles[t] = [a, new, c]
                triangles.append([new, b, c])
    elif damage == "flips":
        for t in chosen:
            triangles[t].reverse()
    elif damage == "copies":
        triangles += [np.roll(triangles[t], 1).tolist() for t in chosen]
    else:
        each = room.vertices[room.triangles].reshape(-1, 3)
        most = 3e-5 if damage == "jitter" else 0.0
        moved = each + rng.uniform(-1.0, 1.0, each.shape) * most / np.sqrt(3.0)
        return moved, np.arange(len(each)).reshape(-1, 3).tolist(), most
    return np.array(corners), triangles, 0.0


def delays(room: clsim.MeshRoom) -> np.ndarray:
    tone = clsim.Signal.tone(40e3, 0.01, 192e3, fade=0.002)
    source = clsim.Source("s", tone, clsim.Trajectory.fixed((1.0, 1.0, 1.0)))
    ear = clsim.Receiver("r", clsim.Trajectory.fixed((2.6, 1.2, 1.4)))
    table = clsim.find_paths(clsim.Scene(room, clsim.Air(), [source], [ear]), 2, diffraction=0).table([0.0])
    return np.sort(table.delay[np.abs(table.gain[:, 0]) > 0.0, 0])


@pytest.mark.filterwarnings("ignore::clsim.errors.ClsimWarning")  # of edges, which are left out
@pytest.mark.parametrize("number", few(range(200), kept=range(0, 12, 2), many=True))
def test_a_damaged_room_is_the_room_that_it_was(number: int, rng: np.random.Generator) -> None:
    room, damage = rooms()[number % 10], DAMAGES[(number + number // 10) % 6]
    corners, polygons, moved = damaged(room, damage, rng)
    healed = clsim.MeshRoom.from_polygons(corners, polygons, WALL, flatness=1e-3)
    assert healed.is_closed, healed.describe()
    assert room.volume is not None
    assert healed.volume == pytest.approx(room.volume, rel=1e-3)
    before, after = delays(room), delays(healed)
    assert len(before) == len(after)
    # Each of two walls, met at up to right angles, moves an image by twice as much.
    np.testing.assert_allclose(after, before, atol=(8.0 * (moved + 1e-4 * (moved > 0.0)) + 1e-9) / 343.0)


@pytest.mark.filterwarnings("ignore::clsim.errors.ClsimWarning")  # of edges, which are left out
@pytest.mark.parametrize("number", few(range(60), kept=(7, 13), many=True))
def test_damages_of_all_kinds_at_once(number: int, tmp_path: Path) -> None:
    """Cuts, flips, copies, split corners and jitter up to 1 mm at default options, as polygons and as a file."""
    rng, room, most = np.random.default_rng(number), rooms()[number % 10], (0.0, 3e-5, 1e-3)[number // 10 % 3]
    corners, triangles, _ = damaged(room, "cuts", rng)
    for t in rng.permutation(len(triangles))[: len(triangles) // 4].tolist():
        triangles[t] = triangles[t][::-1]
    triangles += [np.roll(triangles[t], 1).tolist() for t in rng.permutation(len(triangles))[:3].tolist()]
    each = corners[np.array(triangles)].reshape(-1, 3)
    each += rng.uniform(-1.0, 1.0, each.shape) * most / np.sqrt(3.0)
    faces = np.arange(len(each)).reshape(-1, 3)
    lines = [f"v {x:.9f} {y:.9f} {z:.9f}" for x, y, z in each] + [f"f {a} {b} {c}" for a, b, c in faces + 1]
    (tmp_path / "room.obj").write_text("\n".join(lines))
    before = delays(room)
    for healed in (
        clsim.MeshRoom.from_polygons(each, faces.tolist(), WALL),
        clsim.MeshRoom.from_file(tmp_path / "room.obj", materials=WALL),
    ):
        assert healed.is_closed, healed.describe()
        assert healed.volume == pytest.approx(room.volume, rel=1e-3)
        after = delays(healed)
        assert len(before) == len(after)
        np.testing.assert_allclose(after, before, atol=(16.0 * most + 1e-6) / 343.0)


@pytest.mark.parametrize("number", range(10))
def test_a_clean_room_keeps_every_bit(number: int) -> None:
    room = rooms()[number]
    healed = heal_mesh(room.vertices, room.triangles, "auto")
    np.testing.assert_array_equal(healed.vertices, room.vertices)
    np.testing.assert_array_equal(healed.triangles, room.triangles)
    assert not healed.notes


@pytest.mark.parametrize("tolerance", [1e-3, 5e-3])
def test_no_corner_moves_further_than_it_may(tolerance: float, rng: np.random.Generator) -> None:
    room = rooms()[1]
    each = room.vertices[room.triangles].reshape(-1, 3)
    each = each + rng.uniform(-1.0, 1.0, each.shape) * 0.9 * tolerance
    healed = heal_mesh(each, np.arange(len(each)).reshape(-1, 3), tolerance)
    for place in healed.vertices:
        assert np.linalg.norm(each - place, axis=1).min() == 0.0  # places are corners that were there
    for i, corner in enumerate(each):  # of triangles that are left, whose corners are near
        if i // 3 in healed.origin:
            assert np.linalg.norm(healed.vertices - corner, axis=1).min() <= tolerance


def test_heal_off_and_open_meshes_change_nothing(rng: np.random.Generator) -> None:
    corners, polygons, _ = damaged(rooms()[0], "split", rng)
    moved = corners + rng.uniform(-1e-4, 1e-4, corners.shape)
    raw = clsim.MeshRoom.from_polygons(moved, polygons, WALL, heal="off")
    assert not raw.is_closed
    assert raw.volume is None
    screen = clsim.MeshRoom([(0, 0, 0), (2, 0, 0), (2, 0, 1), (0, 0, 1)], [(0, 1, 2), (0, 2, 3)], WALL)
    healed = heal_mesh(screen.vertices, screen.triangles, "auto")
    np.testing.assert_array_equal(healed.triangles, screen.triangles)


def test_a_window_is_cut_out_of_its_wall() -> None:
    """A smaller polygon wins: its area is of its material, once, and the room stays closed."""
    glass = clsim.Material.from_reflection(0.98)
    window = [(5, 1, 1), (5, 2, 1), (5, 2, 2), (5, 1, 2)]
    room = clsim.MeshRoom.from_polygons([*BOX, *window], [*SIDES, (8, 9, 10, 11)], [WALL] * 6 + [glass])
    assert room.is_closed
    assert room.volume == pytest.approx(60.0, rel=1e-12)
    assert room.surface_area == pytest.approx(2 * (20 + 15 + 12), rel=1e-12)
    corners = room.vertices[room.triangles]
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    of_glass = [material is glass for material in room.triangle_materials]
    assert area[of_glass].sum() == pytest.approx(1.0, rel=1e-12)


@pytest.mark.parametrize("extra", ["flipped", "rolled", "all", "twice", "jitter"])
@pytest.mark.parametrize("heal", ["auto", "off"])
def test_a_copy_with_other_diagonals_is_a_copy(extra: str, heal: str, tmp_path: Path) -> None:
    """A face once more, from another corner or backwards, is dropped: from polygons, OBJ and triangles."""
    if extra == "jitter" and heal == "off":
        return
    corners: list[Any] = list(BOX)
    turned = {
        "flipped": [side[::-1] for side in SIDES[1:2]], "rolled": [(*side[1:], side[0]) for side in SIDES[1:2]],
        "all": [side[::-1] for side in SIDES], "twice": [side[::-1] for side in SIDES[:1]] + [(*SIDES[0][1:], 0)],
        "jitter": [(8, 9, 10, 11)],
    }[extra]  # fmt: skip
    if extra == "jitter":
        corners += [np.add(BOX[i], (3e-4, -2e-4, 3e-4)).tolist() for i in SIDES[1][::-1]]
    glass = clsim.Material.from_reflection(0.98)
    lines = ["v {} {} {}".format(*c) for c in corners]
    lines += ["f " + " ".join(str(i + 1) for i in side) for side in [*SIDES, *turned]]
    (tmp_path / "box.obj").write_text("\n".join(lines))
    rooms_ = [
        clsim.MeshRoom.from_polygons(corners, [*SIDES, *turned], [WALL] * 6 + [glass] * len(turned), heal=heal),
        clsim.MeshRoom.from_file(tmp_path / "box.obj", materials=WALL, heal=heal),
    ]
    for room in rooms_:
        assert room.volume == pytest.approx(60.0, rel=1e-12)
        assert room.surface_area == pytest.approx(94.0, rel=1e-12)
        assert glass not in room.faces.materials


def test_a_concave_floor_twice_is_one_floor() -> None:
    """The polygons share no diagonal: six corners, counted from another one and backwards."""
    plan = clsim.MeshRoom.from_plan([(0, 0), (6, 0), (6, 3), (3, 3), (3, 6), (0, 6)], 2.7, WALL)
    floor = [(0, 0), (6, 0), (6, 3), (3, 3), (3, 6), (0, 6)]
    corners = [*plan.vertices.tolist(), *[(x, y, 0.0) for x, y in floor]]
    first = len(plan.vertices)
    for start in range(6):
        again = np.roll(np.arange(first, first + 6), start)[::-1].tolist()
        room = clsim.MeshRoom.from_polygons(corners, [*plan.triangles.tolist(), again], WALL)
        assert room.volume == pytest.approx(plan.volume, rel=1e-12)
        assert len(room.triangles) == len(plan.triangles)


def test_what_only_touches_is_no_copy() -> None:
    """Crates on each other are two closed shells, and a smaller face covers another region."""
    low = clsim.MeshRoom.from_polygons(BOX, SIDES, WALL)
    high = clsim.MeshRoom.from_polygons(
        [(x, y, z + 3) for x, y, z in BOX], [(1, 3, 2, 0), *SIDES[1:]], WALL
    )  # whose lower face has the other diagonal
    pile = clsim.MeshRoom.joined([low, high])
    assert pile.is_closed
    assert len(pile.triangles) == 24
    for other in ([(8, 9, 10), (8, 10, 11)], [(1, 5, 10)]):  # a door in the wall, and a triangle at its side
        door = [(5, 1, 0), (5, 2, 0), (5, 2, 2), (5, 1, 2)]
        room = clsim.MeshRoom([*BOX, *door], [*low.triangles.tolist(), *other], WALL)
        assert len(room.triangles) == 12 + len(other)


@pytest.mark.parametrize("heal", ["auto", 1e-3, 1e-2])
def test_needles_are_left_out(heal: str | float) -> None:
    """A triangle of corners in line, all split and moved by up to 0.2 mm, has an area but fills no gap."""
    rng = np.random.default_rng(0)
    box = clsim.MeshRoom.from_polygons(BOX, SIDES, WALL)
    each = np.concatenate([box.vertices[box.triangles].reshape(-1, 3), [(5, 4, 0), (0, 4, 0), (2.5, 4, 0)]])
    each += rng.uniform(-1.0, 1.0, each.shape) * 1e-4
    room = clsim.MeshRoom.from_polygons(each, np.arange(len(each)).reshape(-1, 3).tolist(), WALL, heal=heal)
    assert room.volume == pytest.approx(60.0, rel=1e-3)
    assert any("1 triangles thinner than" in note for note in room.notes)


def test_a_tolerance_that_leaves_no_triangle_is_refused() -> None:
    with pytest.raises(clsim.InputError, match="heal: must leave triangles"):
        clsim.MeshRoom.from_polygons([(0, 0, 0), (0.1, 0, 0), (0, 0.1, 0)], [(0, 1, 2)], WALL, heal=0.5)


def test_sheets_hang_in_a_closed_room() -> None:
    curtain = [(4.5, 1, 0.5), (4.5, 3, 0.5), (4.5, 3, 2.5), (4.5, 1, 2.5)]
    room = clsim.MeshRoom.from_polygons([*BOX, *curtain], [*SIDES, (8, 9, 10, 11)], WALL, double_sided=[6])
    assert room.is_closed
    assert room.volume == pytest.approx(60.0, rel=1e-12)
    assert room.contains([(4.7, 2.0, 1.0), (4.0, 2.0, 1.0), (5.5, 2.0, 1.0)]).tolist() == [True, True, False]
    assert len(room.edges()) == 4  # of the curtain alone: the room's have no air outside
    assert "watertight, but for sheets of 2 triangles" in " ".join(room.describe())


@pytest.mark.parametrize(
    ("polygons", "more", "problem"),
    [
        ([], {}, "polygons: must be lists of corner numbers"), ([(0, 1)], {}, r"polygons\[0\]: must be three corner"),
        ([(0, 1, 9)], {}, r"polygons\[0\]: must name corners from 0 to 3"),
        ([(0, 2, 1, 3)], {}, r"polygons\[0\]: must not cross itself"),
        ([(0, 1, 2)], {"double_sided": [1]}, r"double_sided\[0\]: must be from 0 to 0"),
        ([(0, 1, 2)], {"double_sided": [0]}, "double_sided: must leave polygons"),
        ([(0, 1, 2)], {"heal": "yes"}, "heal: must be 'auto', 'off' or a tolerance"),
        ([(0, 1, 2)], {"heal": -1.0}, "heal: must be at least"), ([(0, 1, 2)], {"heal": float("nan")}, "heal: must be"),
        ([(0, 1, 2)], {"labels": []}, "labels: must be one per polygon"),
        ([(0, 1, 2)], {"materials": [WALL] * 2}, "materials: must be one per polygon, 1, but are 2"),
    ],
)  # fmt: skip
def test_polygons_with_something_wrong(polygons: Any, more: dict[str, Any], problem: str) -> None:
    with pytest.raises(clsim.InputError, match=problem):
        clsim.MeshRoom.from_polygons(
            [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], polygons, **{"materials": WALL} | more
        )


def test_the_report_tells_where_and_by_how_much() -> None:
    """A gallery's corner 4 mm off a wall's side, and two corners 2 mm apart: notes and places, also in the viewer."""
    corners = [
        *[(x, y, z) for z in (0.0, 3.0) for y in (0.0, 4.0) for x in (0.0, 5.0)],
        (2.0, 0.004, 0.0),
        (5.0, 4.0, 3.002),
    ]
    sides = [(0, 1, 3, 2), (4, 5, 9, 6), (0, 8, 5, 4), (8, 1, 5), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5)]
    room = clsim.MeshRoom.from_polygons(corners, sides, WALL, heal=0.005, flatness=0.01)
    assert room.is_closed
    text = " ".join(room.notes)
    assert "healed: 1 corners joined to others, moved by 2 mm at most, at (5.000, 4.000, 3.000) m" in text
    assert "healed: sides cut at 1 corners that were on them within 4 mm, at (2.000, 0.004, 0.000) m" in text
    assert room.healed_at is not None
    assert np.linalg.norm(room.healed_at - (2.0, 0.004, 0.0), axis=1).min() == 0.0
    flaws = viewed_flaws(room)
    assert len(flaws.healed_at) == 2
    assert not len(flaws.open_edges)
    door = clsim.MeshRoom.from_polygons(corners[:8], [(0, 1, 3, 2), *sides[4:6], (1, 3, 7, 5), (0, 1, 5, 4)], WALL)
    assert len(viewed_flaws(door).open_edges) == 4
    none = ViewedPaths.none()
    page = page_text(title="t", walls=[], ends=[], times=np.zeros(1), frames=[none], flaws=ViewedFlaws(flaws.healed_at, door.shape.open_edges))  # fmt: skip
    assert "healed here" in page
    assert "energy escapes here" in page
    assert clsim.MeshRoom.joined([room, door]).healed_at is not None
