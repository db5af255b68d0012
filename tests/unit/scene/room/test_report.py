"""What a diagnosis says of meshes that are odd, and of those that are not."""

import numpy as np
import pytest
from made_meshes import box, cut_box, joined, screen

import clsim

WALL = clsim.Material.from_reflection(0.9)
SOUND = [
    "room: 12 triangles, 6 walls in 6 planes, 8 x 6 x 3 m from (0, 0, 0) m",
    "room: watertight",
]


def told(mesh) -> list[str]:
    return clsim.MeshRoom(*mesh, WALL).describe()


def test_a_sound_room_is_described_and_nothing_else() -> None:
    assert told(box((8, 6, 3))) == SOUND


def test_a_missing_triangle_is_a_hole_with_its_place() -> None:
    vertices, triangles = box((8, 6, 3))
    corners = vertices[triangles[0]]
    centre = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
    across = np.ptp(corners, axis=0)
    lines = told((vertices, triangles[1:]))
    assert lines[1:] == [
        "room: open: 3 edges are not shared by two triangles, around 1 hole",
        "room: a hole of 3 edges at ({:g}, {:g}, {:g}) m, {:g} x {:g} x {:g} m".format(*centre, *across),
    ]


def test_of_many_holes_the_largest_are_listed() -> None:
    vertices, triangles = cut_box((8, 6, 3), 50)  # cells of the floor are 1.6 m by 1.2 m
    middle = vertices[triangles].mean(axis=1)
    cell = np.floor(middle[:, :2] / (1.6, 1.2)).astype(int).tolist()
    cells = [[0, 0], [0, 2], [0, 4], [2, 0], [2, 4], [4, 0], [4, 4], [2, 2], [3, 2]]  # the last two are neighbours
    gone = [i for i in range(len(triangles)) if abs(middle[i, 2]) < 1e-9 and cell[i] in cells]
    lines = told((vertices, np.delete(triangles, gone, axis=0)))
    assert lines[1:3] == [
        "room: open: 34 edges are not shared by two triangles, around 8 holes",
        "room: a hole of 6 edges at (4.8, 3, 0) m, 3.2 x 1.2 x 0 m",
    ]
    assert [line[:24] for line in lines[3:7]] == ["room: a hole of 4 edges "] * 4
    assert lines[7:] == ["room: and 3 holes that are no larger"]


def test_flipped_triangles_are_harmless() -> None:
    vertices, triangles = box((8, 6, 3))
    one = triangles.copy()
    one[3] = one[3][::-1]
    assert told((vertices, one)) == [*SOUND, "room: mixed winding at 3 edges; harmless, since walls are two-sided"]
    assert told((vertices, triangles[:, ::-1])) == [
        *SOUND, "room: all triangles face inwards; harmless, since walls are two-sided",
    ]  # fmt: skip


def test_an_open_mesh_has_no_inside_to_face() -> None:
    vertices, triangles = box((8, 6, 3))
    assert not any("face" in line for line in told((vertices, triangles[1:, ::-1])))


def test_an_open_screen_is_open_all_around() -> None:
    assert told(screen((4, 1, 0), (0, 2, 0), 1.5)) == [
        "room: 2 triangles, 1 walls in 1 planes, 0 x 2 x 1.5 m from (4, 1, 0) m",
        "room: open: 4 edges are not shared by two triangles, around 1 hole",
        "room: a hole of 4 edges at (4, 2, 0.75) m, 0 x 2 x 1.5 m",
    ]


def test_separate_shells_are_counted_and_closed_each_for_itself() -> None:
    vertices, triangles = box((8, 6, 3))
    whole = told(joined((vertices, triangles), (vertices / 4 + 1.0, triangles)))
    assert whole[1:] == ["room: 2 separate shells, 2 of them closed", "room: watertight"]
    open_one = told(joined((vertices, triangles), (vertices / 4 + 1.0, triangles[1:])))
    assert open_one[1:3] == [
        "room: 2 separate shells, 1 of them closed",
        "room: open: 3 edges are not shared by two triangles, around 1 hole",
    ]
    neither = told(joined((vertices, triangles[1:]), (vertices + 20.0, triangles[2:])))
    assert neither[1:3] == [
        "room: 2 separate shells, 0 of them closed",
        "room: open: 9 edges are not shared by two triangles, around 3 holes",
    ]


def test_repairs_are_told() -> None:
    vertices, triangles = box((8, 6, 3))
    lines = told((vertices, np.concatenate([triangles, triangles[:1], [[0, 1, 1]]])))
    assert lines[:2] == SOUND
    assert len(lines) == 4
    assert "1 triangles without area" in lines[2]
    assert "1 triangles that lay on others" in lines[3]


def ends(room: clsim.MeshRoom | clsim.Shoebox, height: float) -> list[str]:
    tone = clsim.Signal.tone(40e3, 0.1, 192e3)
    walk = clsim.Trajectory.line((1, 1, height), (1, 1, height + 0.5), 1.0)
    scene = clsim.Scene(
        room, clsim.Air(), [clsim.Source("robot", tone, walk)],
        [clsim.Receiver("mic", clsim.Trajectory.fixed((3, 2, height)))],
    )  # fmt: skip
    return scene.describe()[len(room.describe()) :]


def test_who_is_inside_is_told_of_watertight_rooms_alone() -> None:
    vertices, triangles = box((8, 6, 2.8))
    mesh = clsim.MeshRoom(vertices, triangles, WALL)
    assert ends(mesh, 1.0) == ["sources[0]: 'robot' is inside at 0 s", "receivers[0]: 'mic' is inside at 0 s"]
    with pytest.warns(clsim.ClsimWarning, match="no source or receiver is inside"):
        assert ends(mesh, 3.0) == ["sources[0]: 'robot' is outside at 0 s", "receivers[0]: 'mic' is outside at 0 s"]
    assert ends(clsim.MeshRoom(vertices, triangles[1:], WALL), 1.0) == []
    assert ends(clsim.Shoebox((8, 6, 3), WALL), 1.0) == []
