"""Rooms over floor plans."""

import numpy as np
import pytest

import clsim

WALL = clsim.Material.from_reflection(0.9)
L = [(0, 0), (8, 0), (8, 5), (4, 5), (4, 9), (0, 9)]
PILLAR = [(1, 1), (2, 1), (2, 2), (1, 2)]


@pytest.mark.parametrize("turn", [1, -1])
def test_a_room_over_a_plan_is_watertight_and_has_its_volume(turn: int) -> None:
    room = clsim.MeshRoom.from_plan(L[::turn], 3.0, WALL, pillars=[PILLAR, np.array(PILLAR)[::-1] + 1.5])
    assert room.shape.watertight
    assert len(room.walls) == 2 + 6 + 8
    corners = room.vertices[room.triangles]
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    assert area.sum() == pytest.approx(2 * (8 * 5 + 4 * 4 - 2) + 3 * (34 + 8), rel=1e-12)
    inside = room.contains(
        [(0.5, 0.5, 1), (1.5, 1.5, 1), (3, 3, 1), (2.2, 2.2, 2), (6, 7, 1), (3, 8, 2.9), (3, 8, 3.1)]
    )
    assert inside.tolist() == [True, False, False, True, False, True, False]


def test_materials_go_by_name_of_wall() -> None:
    carpet, brick = clsim.Material.from_reflection(0.1), clsim.Material.from_reflection(0.5)
    room = clsim.MeshRoom.from_plan(L, 3.0, {"default": WALL, "floor": carpet, "wall 2": brick}, [PILLAR])
    factors = dict(zip(room.faces.names, room.reflections(40e3), strict=True))
    assert factors["floor"] == 0.1
    assert factors["wall 2"] == 0.5
    assert factors["ceiling"] == factors["wall 0"] == factors["pillar 0 wall 3"] == 0.9


def test_a_rectangle_has_the_paths_of_a_shoebox() -> None:
    tone = clsim.Signal.tone(40e3, 0.1, 192e3)
    source = clsim.Source("s", tone, clsim.Trajectory.fixed((1.0, 2.0, 1.1)))
    ear = clsim.Receiver("r", clsim.Trajectory.fixed((6.0, 3.3, 2.2)))
    plan = clsim.MeshRoom.from_plan([(0, 0), (8, 0), (8, 6), (0, 6)], 3.0, WALL)
    delays = [
        np.sort(clsim.find_paths(clsim.Scene(room, clsim.Air(), [source], [ear]), 3).table([0.0]).delay[:, 0])
        for room in (plan, clsim.Shoebox((8, 6, 3), WALL))
    ]
    np.testing.assert_allclose(delays[0], delays[1], atol=1e-14)


@pytest.mark.parametrize(
    ("outline", "height", "pillars", "message"),
    [
        ([(0, 0), (1, 1), (1, 0), (0, 1)], 3.0, [], "outline: must"),
        ([(0, 0), (2, 2), (2, 0), (0, 1)], 3.0, [], "outline: must not cross"),
        ([(0, 0), (1, 0)], 3.0, [], "outline: must be three corners"),
        ([(0, 0), (1, 0), (np.nan, 1)], 3.0, [], r"outline\[2\]\[0\]: must be finite"),
        (L, 0.0, [], "height: must be at least 0.0001 m"),
        (L, 3.0, [[(9, 9), (10, 9), (10, 10)]], "outline: must not cross"),
        (L, 3.0, [PILLAR, PILLAR], "outline: must not cross"),
        (L, 3.0, [[(1, 1), (2, 2)]], r"pillars\[0\]: must be three corners"),
    ],
)
def test_plans_that_are_none_are_refused(outline, height: float, pillars, message: str) -> None:
    with pytest.raises(clsim.InputError, match=message):
        clsim.MeshRoom.from_plan(outline, height, WALL, pillars)


def test_materials_that_name_no_wall_are_refused() -> None:
    with pytest.raises(clsim.InputError, match=r"materials\.wall 6: is no group of the plan, whose groups are 'floor'"):
        clsim.MeshRoom.from_plan(L, 3.0, {"default": WALL, "wall 6": WALL})
    with pytest.raises(clsim.InputError, match="materials: must name the group 'ceiling' of the plan or a default"):
        clsim.MeshRoom.from_plan(L, 3.0, {"floor": WALL})


@pytest.mark.parametrize("pillars", [
    [[(2, 2), (2.2, 2), (2.2, 2.2)]],  # in line with a corner of the outline
    [[(0.5, 1), (0.8, 1), (0.8, 1.3), (0.5, 1.3)], [(1.6, 1), (1.9, 1), (1.9, 1.3), (1.6, 1.3)], [(2.7, 1), (3, 1), (3, 1.3)]],
])  # fmt: skip
def test_pillars_in_line_leave_no_slit(pillars: list[list[tuple[float, float]]]) -> None:
    """Triangulations leave out triangles without an area, and with them the corner in their long side."""
    room = clsim.MeshRoom.from_plan([(0, 0), (4, 0), (4, 3), (0, 3)], 2.0, clsim.Material.from_reflection(0.9), pillars)
    standing = sum(
        0.5 * abs(np.linalg.det(np.column_stack([np.array(p), np.ones(3)]))) if len(p) == 3 else 0.09 for p in pillars
    )
    assert room.is_closed
    assert room.volume == pytest.approx(2.0 * (12.0 - standing), rel=1e-12)
    assert not [name for name in room.edges().names if "pillar" not in name]  # the room's own corners are 90 degrees
