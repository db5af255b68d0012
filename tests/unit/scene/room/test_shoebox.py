"""Shoeboxes and rooms over floor plans: walls by name, sizes, inside, what is refused."""

import dataclasses
import pickle

import numpy as np
import pytest

import clsim
from clsim.errors import ClsimWarning, InputError
from clsim.scene.material.material import Material
from clsim.scene.room.shoebox import WALLS, Shoebox

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


HARD = Material.from_reflection(0.9)
SOFT = Material.from_reflection(-0.2)


def test_walls_by_name_go_to_their_places():
    factors = np.linspace(0.1, 0.6, 6)
    named = {name: Material.from_reflection(f) for name, f in zip(WALLS, factors, strict=True)}
    backwards = dict(reversed(named.items()))
    for walls in (named, backwards, tuple(named.values())):
        room = Shoebox((8, 6, 3), walls)
        np.testing.assert_array_equal(room.reflections(40e3), factors)
        assert room.faces.materials == tuple(named.values())


def test_default_stands_for_the_rest():
    room = Shoebox((8, 6, 3), {"default": HARD, "z_min": SOFT})
    np.testing.assert_array_equal(room.reflections(1e3), [0.9, 0.9, 0.9, 0.9, -0.2, 0.9])
    np.testing.assert_array_equal(Shoebox((8, 6, 3), SOFT).reflections(1e3), [-0.2] * 6)


def test_a_material_on_several_walls_warns_once():
    room = Shoebox((8, 6, 3), Material.named("concrete"))
    with pytest.warns(ClsimWarning) as caught:
        room.reflections(40e3)
    assert len(caught) == 1


@pytest.mark.parametrize(
    ("walls", "field", "problem"),
    [
        ({"x_min": HARD}, "walls.x_max", "missing"),
        ({}, "walls.x_min", "missing"),
        ({"default": HARD, "floor": SOFT}, "walls.floor", "z_min"),
        ({"default": HARD, 3: SOFT}, "walls.3", "no wall"),
        ({"default": 0.9}, "walls.default", "must be a Material"),
        ({"default": HARD, "y_min": "carpet"}, "walls.y_min", "must be a Material"),
        ([HARD] * 5, "walls", "6 materials, but are 5"),
        ([HARD] * 5 + [0.9], "walls[5]", "must be a Material"),
        (0.9, "walls", "must be a Material"),
        ("carpet", "walls", "must be a Material"),
        (None, "walls", "must be a Material"),
    ],
)
def test_bad_walls_are_refused_by_name(walls, field, problem):
    with pytest.raises(InputError, match=problem) as error:
        Shoebox((8, 6, 3), walls)
    assert error.value.field == field


@pytest.mark.parametrize(
    ("size", "field"),
    [
        ((8, 0, 3), "size[1]"), ((8, 6, -3), "size[2]"), ((8, np.nan, 3), "size[1]"), ((8, 6), "size"), (8, "size"),
        ("room", "size"), (None, "size"),
    ],
)  # fmt: skip
def test_bad_sizes_are_refused_by_name(size, field):
    with pytest.raises(InputError) as error:
        Shoebox(size, HARD)
    assert error.value.field == field


def test_inside_is_strict():
    room = Shoebox((8, 6, 3), HARD)
    inside = [(1, 1, 1), (1e-9, 1, 1), (8 - 1e-9, 1, 1)]
    outside = [(0, 1, 1), (8, 1, 1), (1, 6, 1), (1, 1, 3), (1, 1, -1), (1, 7, 1), (np.nan, 1, 1)]
    assert room.contains(inside).tolist() == [True] * len(inside)
    assert room.contains(outside).tolist() == [False] * len(outside)


def test_margin_moves_every_wall_inwards():
    room = Shoebox((8, 6, 3), HARD)
    near = [(0.4, 1, 1), (7.6, 1, 1), (1, 0.4, 1), (1, 5.6, 1), (1, 1, 0.4), (1, 1, 2.6)]
    assert not room.contains(near, margin=0.5).any()
    assert room.contains(near, margin=0.3).all()


def test_extent_and_size_are_read_only():
    size = np.array([8.0, 6.0, 3.0])
    room = Shoebox(size, HARD)
    size[0] = 1.0
    low, high = room.extent
    assert low.tolist() == [0, 0, 0]
    assert high.tolist() == [8, 6, 3]
    with pytest.raises(ValueError, match="read-only"):
        room.size[0] = 1.0


def test_a_room_can_be_replaced_in_part_and_pickled():
    room = dataclasses.replace(Shoebox((8, 6, 3), {"default": HARD, "z_min": SOFT}), size=(4, 4, 4))
    again = pickle.loads(pickle.dumps(room))
    assert again.size.tolist() == [4, 4, 4]
    np.testing.assert_array_equal(again.reflections(1e3), room.reflections(1e3))
