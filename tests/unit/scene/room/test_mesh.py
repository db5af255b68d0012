"""Rooms from triangles: walls, materials, joining, contact, inside."""

from pathlib import Path

import numpy as np
import pytest
from made_meshes import box, cut_box, l_room, screen

import clsim
from clsim.scene.room.healing import clean_mesh

WALL, SOFT = clsim.Material.from_reflection(0.9), clsim.Material.from_reflection(0.1)
TONE = clsim.Signal.tone(40e3, 0.1, 192e3)
OBJ = """
v 0 0 0
v 4 0 0
v 4 3 0
v 0 3 0
v 0 0 2
v 4 0 2
usemtl floor
f 1 2 3 4
usemtl wall
f 1 2 6 5
"""


def scene(room, source, receiver=(1.1, 1.2, 1.3)) -> clsim.Scene:
    if not isinstance(source, clsim.Trajectory):
        source = clsim.Trajectory.fixed(source)
    ear = clsim.Receiver("ear", clsim.Trajectory.fixed(receiver))
    return clsim.Scene(room, clsim.Air(), [clsim.Source("robot", TONE, source)], [ear])


def test_cleaning_welds_and_drops() -> None:
    vertices, triangles = box((2, 2, 2))
    split = vertices[triangles].reshape(-1, 3) + 1e-8 * np.arange(36)[:, None] % 3e-8
    soup = np.arange(36).reshape(-1, 3)
    flat = [[0, 1, 1], [0, 2, 1], [0, 1, 2]]  # no area; the first triangle again, twice
    clean = clean_mesh(split, np.concatenate([soup, flat]))
    assert len(clean.vertices) == 8
    assert clean.kept.tolist() == list(range(12))
    assert [note.split(",")[0][:28] for note in clean.notes] == [
        "1 triangles without area wer",
        "2 triangles that lay on othe",
    ]
    with pytest.raises(clsim.InputError, match="triangles: must have an area"):
        clean_mesh(vertices, np.array([[0, 0, 1]]))


def test_coplanar_neighbours_of_one_material_are_one_wall() -> None:
    vertices, triangles = cut_box((8, 6, 3), 50)
    assert len(clsim.MeshRoom(vertices, triangles, WALL).walls) == 6
    left = vertices[triangles].mean(axis=1)[:, 0] < 4.0
    assert len(clsim.MeshRoom(vertices, triangles, [WALL if x else SOFT for x in left]).walls) == 10
    bent = vertices + np.array([0.0, 0.0, 2e-6]) * (np.abs(vertices[:, :1] - 3.2) < 0.1)
    assert len(clsim.MeshRoom(bent, triangles, WALL).walls) > 6
    assert len(clsim.MeshRoom(bent, triangles, WALL, flatness=1e-5).walls) == 6


def test_concave_walls_hold_what_is_on_them() -> None:
    room = clsim.MeshRoom(*l_room(), WALL)
    floor = next(w for w in range(len(room.walls)) if np.all(np.abs(room.walls.hull_of(w)[:, 2]) < 1e-9))
    points = np.array([(1, 8, 0), (7, 1, 0), (6, 7, 0), (4, 5, 0), (4.001, 5.001, 0), (8.001, 1, 0)], float)
    assert room.walls.holds(floor, points).tolist() == [True, True, False, True, False, False]
    assert len(room.walls.edges_of(floor)) == 6


def test_files_give_materials_by_group(tmp_path: Path) -> None:
    path = tmp_path / "corner.obj"
    path.write_text(OBJ)
    room = clsim.MeshRoom.from_file(path, materials={"floor": SOFT, "default": WALL})
    assert dict(zip(room.faces.names, room.reflections(40e3).tolist(), strict=True)) == {
        "corner floor": 0.1,
        "corner wall": 0.9,
    }
    assert room.extent[1].tolist() == [4.0, 3.0, 2.0]
    turned = clsim.MeshRoom.from_file(path, 0.001, "y", WALL)
    np.testing.assert_allclose(turned.extent, [[0, -0.002, 0], [0.004, 0, 0.003]], atol=1e-12)
    for materials, message in (
        ({"floor": WALL}, "materials: must name the group 'wall' of corner.obj or a default"),
        (
            {"roof": WALL, "default": WALL},
            r"materials\.roof: is no group of corner\.obj, whose groups are 'floor', 'wall'",
        ),
        ({"floor": 0.9, "default": WALL}, r"materials\.floor: must be a Material"),
        (None, "materials: must be a Material or materials by group"),
    ):
        with pytest.raises(clsim.InputError, match=message):
            clsim.MeshRoom.from_file(path, materials=materials)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("vertices", "triangles", "materials", "message"),
    [
        ([(0, 0, 0), (1, 0, 0), (np.nan, 1, 0)], [(0, 1, 2)], WALL, r"vertices\[2\]\[0\]: must be finite"),
        ([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 1, 3)], WALL, r"triangles\[0\]: must be indices of 3 vertices"),
        ([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(0.0, 1.0, 2.0)], WALL, "triangles: must be n x 3 whole numbers"),
        ([(0, 0, 0), (1, 0, 0), (0, 1, 0)], np.empty((0, 3), int), WALL, "triangles: must be n x 3"),
        ([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 1, 2)], [WALL, WALL], "materials: must be one per triangle, 1"),
        ([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 1, 2)], [0.9], r"materials\[0\]: must be a Material"),
    ],
)
def test_what_is_no_mesh_is_refused(vertices, triangles, materials, message: str) -> None:
    with pytest.raises(clsim.InputError, match=message):
        clsim.MeshRoom(vertices, triangles, materials)


def test_parts_are_joined() -> None:
    board = clsim.MeshRoom(*screen((4, 1, 0), (0, 2, 0), 1.5), SOFT)
    room = clsim.MeshRoom.joined([clsim.Shoebox((8, 6, 3), {"default": WALL, "z_min": SOFT}), board])
    assert room.faces.names[:6] == ("x_min", "x_max", "y_min", "y_max", "z_min", "z_max")
    assert room.reflections(40e3).tolist() == [0.9, 0.9, 0.9, 0.9, 0.1, 0.9, 0.1]
    with pytest.raises(clsim.InputError, match="parts: must be a list of at least one room"):
        clsim.MeshRoom.joined([])
    with pytest.raises(clsim.InputError, match=r"parts\[0\]: must be a room"):
        clsim.MeshRoom.joined(["room"])  # type: ignore[list-item]


ROOM = clsim.MeshRoom.joined([clsim.Shoebox((8, 6, 3), WALL), clsim.MeshRoom(*screen((4, 1, 0), (0, 2, 0), 1.5), WALL)])


@pytest.mark.parametrize(
    ("source", "message"),
    [
        ((4.0, 2.0, 0.7), r"'robot' meets the wall 'wall 1' at \(4, 2, 0\.7\) m at 0 s"),
        ((2.0, 2.0, 5e-7), "meets the wall 'z_min'"),
        (
            clsim.Trajectory.line((3, 2, 1), (5, 2, 1), 1.0),
            r"meets the wall 'wall 1' at \((3\.99|4).*\) m at 0\.(49|5)",
        ),
        (clsim.Trajectory.line((3, 2, 1), (3, 2, 4), 1.0), r"meets the wall 'z_max'"),
        (clsim.Trajectory.line((7, 5, 1), (9, 5, 1), 1.0), r"meets the wall 'x_max' at .* at 0\.(49|5)"),
    ],
)
def test_ends_on_walls_or_through_them_are_refused(source, message: str) -> None:
    with pytest.raises(clsim.InputError, match=r"sources\[0\]\.trajectory: must stay 1e-06 m away.*" + message):
        scene(ROOM, source)


@pytest.mark.parametrize(
    "source",
    [
        (4.0, 4.0, 1.0),  # in the screen's plane, beside it
        clsim.Trajectory.line((3, 2, 1.6), (5, 2, 1.6), 1.0),  # over it
        clsim.Trajectory.line((3.99999, 1.2, 1), (3.99999, 2.8, 1), 1.0),  # along it, 10 um away
    ],
)
def test_ends_near_walls_are_not_refused(source) -> None:
    scene(ROOM, source)


def test_receivers_are_held_to_the_same() -> None:
    scene(ROOM, (1.0, 1.0, 1.0), (4.0, 4.0, 1.0))  # in the screen's plane, beside it
    with pytest.raises(
        clsim.InputError,
        match=r"receivers\[0\]\.trajectory: must stay 1e-06 m away.*'ear' meets the wall 'wall 1' at .* m at 0 s",
    ):
        scene(ROOM, (1.0, 1.0, 1.0), (4.0, 2.0, 1.0))
    with pytest.raises(clsim.InputError, match="'ear' meets the wall 'x_max'"):
        scene(ROOM, (1.0, 1.0, 1.0), (8.0, 3.0, 1.0))


def test_joined_parts_keep_what_they_are() -> None:
    vertices, triangles = box((2, 2, 2))
    repaired = clsim.MeshRoom(vertices, np.concatenate([triangles, triangles[:1]]), SOFT, labels=["crate"] * 13)
    room = clsim.MeshRoom.joined([clsim.MeshRoom(*box((8, 6, 3)), WALL, flatness=1e-4), repaired])
    assert room.flatness == 1e-4
    assert room.notes == repaired.notes != ()
    assert room.shape.watertight
    crate = [name.startswith("crate") for name in room.faces.names]
    assert room.reflections(40e3).tolist() == [0.1 if c else 0.9 for c in crate]
    assert room.contains([(4, 4, 1), (1, 1.3, 1.1), (9, 1, 1)]).tolist() == [True, False, False]


def test_inside_is_told_whatever_the_winding(rng) -> None:
    vertices, triangles = l_room()
    flipped = np.where((rng.random(len(triangles)) < 0.5)[:, None], triangles, triangles[:, ::-1])
    room = clsim.MeshRoom(vertices, flipped, WALL)
    points = rng.uniform(-1, 10, (400, 3))
    x, y, z = points.T
    wanted = (x > 0) & (y > 0) & (z > 0) & (z < 3) & (((x < 8) & (y < 5)) | ((x < 4) & (y < 9)))
    assert room.contains(points).tolist() == wanted.tolist()
