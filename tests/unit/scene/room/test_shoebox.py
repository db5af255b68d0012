import dataclasses
import pickle

import numpy as np
import pytest

from clsim.errors import ClsimWarning, InputError
from clsim.scene.material.material import Material
from clsim.scene.room.shoebox import WALLS, Shoebox

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
        ((8, 0, 3), "size[1]"),
        ((8, 6, -3), "size[2]"),
        ((8, np.nan, 3), "size[1]"),
        ((8, 6), "size"),
        (8, "size"),
        ("room", "size"),
        (None, "size"),
    ],
)
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
