"""Volumes and insides of meshes, whatever the winding of their triangles, and what is reported of them."""

import warnings

import numpy as np
import pytest
from made_meshes import box, cut_box, joined, screen

import clsim

REPORT_WALL = clsim.Material.from_reflection(0.9)
SOUND = ["room: 12 triangles, 6 walls in 6 planes, 8 x 6 x 3 m from (0, 0, 0) m", "room: watertight"]


def told(mesh) -> list[str]:
    return clsim.MeshRoom(*mesh, REPORT_WALL).describe()


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
    mesh = clsim.MeshRoom(vertices, triangles, REPORT_WALL)
    assert ends(mesh, 1.0) == ["sources[0]: 'robot' is inside at 0 s", "receivers[0]: 'mic' is inside at 0 s"]
    with pytest.warns(clsim.ClsimWarning, match="no source or receiver is inside"):
        assert ends(mesh, 3.0) == ["sources[0]: 'robot' is outside at 0 s", "receivers[0]: 'mic' is outside at 0 s"]
    assert ends(clsim.MeshRoom(vertices, triangles[1:], REPORT_WALL), 1.0) == []
    assert ends(clsim.Shoebox((8, 6, 3), REPORT_WALL), 1.0) == []


WALL = clsim.Material.from_absorption([100.0, 100e3], [0.1, 0.1])
SIZE = (6.0, 5.0, 3.0)
L_ROOM = [(0, 0), (8, 0), (8, 5), (4, 5), (4, 9), (0, 9)]  # 56 m²
MESHES = {
    "box": (box(SIZE), 90.0),
    "away from the origin": ((box(SIZE)[0] + 100.0, box(SIZE)[1]), 90.0),
    "crate in the air": (joined(box(SIZE), (box((1, 2, 1))[0] + [2, 2, 1], box((1, 2, 1))[1])), 88.0),
    "crate on the floor": (joined(box(SIZE), (box((1, 2, 1))[0] + [2, 2, 0], box((1, 2, 1))[1])), 88.0),
    "crate in a corner": (joined(box(SIZE), box((1, 2, 1))), 88.0),
    "box in a crate": (
        joined(box(SIZE), (box((2, 2, 2))[0] + [2, 2, 0.5], box((2, 2, 2))[1]), (box((1, 1, 1))[0] + [2.5, 2.5, 1], box((1, 1, 1))[1])),
        83.0,
    ),
}  # fmt: skip


def flipped(triangles: np.ndarray, rng: np.random.Generator, share: float) -> np.ndarray:
    triangles = np.array(triangles)
    some = rng.random(len(triangles)) < share
    triangles[some] = triangles[some, ::-1]
    return triangles


@pytest.mark.parametrize("name", MESHES)
def test_volume_whatever_the_winding(name: str, rng: np.random.Generator) -> None:
    (vertices, triangles), volume = MESHES[name]
    for share in (0.0, 0.1, 0.5, 0.9, 1.0):
        room = clsim.MeshRoom(vertices, flipped(triangles, rng, share), WALL)
        assert room.volume == pytest.approx(volume, rel=1e-9), share


def test_an_l_room_with_a_pillar(rng: np.random.Generator) -> None:
    plan = clsim.MeshRoom.from_plan(L_ROOM, 2.5, WALL, pillars=[[(1, 1), (1.5, 1), (1.5, 1.5), (1, 1.5)]])
    for share in (0.0, 0.3, 0.7):
        room = clsim.MeshRoom(plan.vertices, flipped(plan.triangles, rng, share), WALL)
        assert room.volume == pytest.approx((56.0 - 0.25) * 2.5, rel=1e-9)


def test_shells_that_run_through_each_other_are_measured_by_rays(rng: np.random.Generator) -> None:
    """A crate that is sunk into the floor by half: what is below the floor is no air."""
    crate = box((2, 2, 2))
    vertices, triangles = joined(box(SIZE), (crate[0] + [2, 2, -1], crate[1]))
    room = clsim.MeshRoom(vertices, flipped(triangles, rng, 0.4), WALL)
    assert room.volume == pytest.approx(90.0 - 4.0, rel=3e-3)


HALL = (8.0, 6.0, 3.0)


def hall_with_a_door(rng: np.random.Generator, *more: tuple) -> clsim.MeshRoom:
    """Return a hall whose wall at x = 8 has a hole from y = 2 to 3, 2 m high, wound at random."""
    corners, faces = [], []

    def rectangle(*ring: tuple[float, float, float]) -> None:
        faces.extend(
            [(len(corners), len(corners) + 1, len(corners) + 2), (len(corners), len(corners) + 2, len(corners) + 3)]
        )
        corners.extend(ring)

    x, y, z = HALL
    for h in (0.0, z):
        rectangle((0, 0, h), (x, 0, h), (x, 2, h), (0, 2, h))
        rectangle((0, 2, h), (x, 2, h), (x, 3, h), (0, 3, h))
        rectangle((0, 3, h), (x, 3, h), (x, y, h), (0, y, h))
    for low, high in ((0.0, 2.0), (2.0, z)):
        rectangle((0, 0, low), (x, 0, low), (x, 0, high), (0, 0, high))
        rectangle((0, y, low), (x, y, low), (x, y, high), (0, y, high))
        for a, b in ((0, 2), (2, 3), (3, y)):
            rectangle((0, a, low), (0, b, low), (0, b, high), (0, a, high))
            if (low, a) != (0.0, 2):
                rectangle((x, a, low), (x, b, low), (x, b, high), (x, a, high))
    mesh = joined((np.array(corners, dtype=float), np.array(faces)), *more)
    return clsim.MeshRoom(mesh[0], flipped(mesh[1], rng, 0.4), WALL)


def warned(room: clsim.MeshRoom, *places: tuple[float, float, float]) -> list[str]:
    tone, at = clsim.Signal.tone(40e3, 0.01, 192e3), [clsim.Trajectory.fixed(p) for p in places]
    ears = [clsim.Receiver(f"r{i}", p) for i, p in enumerate(at[1:])]
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        clsim.Scene(room, clsim.Air(), [clsim.Source("s", tone, at[0])], ears)
    return [str(w.message) for w in found]


INSIDE = [(4, 3, 1), (7.99, 2.5, 1), (7.9, 2.1, 0.1), (7.7, 2.9, 1.9), (0.01, 0.01, 0.01), (7.999, 5.9, 2.9)]
OUTSIDE = [(8.01, 2.5, 1), (8.1, 2.1, 0.1), (8.3, 2.9, 1.9), (8.01, 1.0, 2.5), (9, 2.5, 1), (4, 3, 3.01), (-0.01, 3, 1)]


def test_who_is_outside_of_a_hall_with_a_door_is_told(rng: np.random.Generator) -> None:
    room = hall_with_a_door(rng)
    assert not room.is_closed
    assert warned(room, *INSIDE) == []
    for place in OUTSIDE:
        where = ", ".join(f"{x:g}" for x in place)
        (message,) = warned(room, INSIDE[0], INSIDE[1], place)
        assert message.startswith(f"receivers[1].trajectory: 'r1' at ({where}) m is outside the room")
        assert "the mesh has holes, which alone join both sides, and reaches from (0, 0, 0) to (8, 6, 3) m" in message
        assert warned(room, place, *INSIDE)[0].startswith(f"sources[0].trajectory: 's' at ({where}) m is outside")
    assert warned(room, (9, 2.5, 1), (10, 2.5, 1)) == []  # as around a pillar without lids


def test_obstacles_and_sheets_in_a_hall_with_a_door(rng: np.random.Generator) -> None:
    crate = box((1, 1, 1))
    table = np.array([(2, 4, 0.7), (4, 4, 0.7), (4, 5, 0.7), (2, 5, 0.7)]), np.array([(0, 1, 2), (0, 2, 3)])
    room = hall_with_a_door(rng, (crate[0] + [5, 2, 0.5], crate[1]), table)
    assert warned(room, *INSIDE, (3, 4.5, 0.69), (3, 4.5, 0.71)) == []
    assert (
        "'r0' at (5.5, 2.5, 1) m is outside the room or inside a closed obstacle"
        in warned(room, INSIDE[0], (5.5, 2.5, 1))[0]
    )


def test_a_closed_room_with_a_sheet_in_it_is_closed() -> None:
    sheet = np.array([(2, 1, 0.5), (4, 1, 0.5), (4, 1, 1.5), (2, 1, 1.5)]), np.array([(0, 1, 2), (0, 2, 3)])
    room = clsim.MeshRoom(*joined(box(HALL), sheet), WALL)
    assert room.is_closed
    assert room.volume == pytest.approx(np.prod(HALL), rel=1e-12)
    assert warned(room, *INSIDE, (3, 0.99, 1), (3, 1.01, 1)) == []
    with pytest.raises(
        clsim.InputError,
        match=r"receivers\[1\].trajectory: must lie in the same air as the other sources and receivers",
    ):
        warned(room, *INSIDE[:2], (4, 3, 3.01))


def test_what_is_open_has_no_inside(rng: np.random.Generator) -> None:
    """A hall without a wall, a floor with a crate on it, and a tunnel."""
    vertices, triangles = box(HALL)
    middle = vertices[triangles].mean(axis=1)
    stage = clsim.MeshRoom(vertices, triangles[middle[:, 0] < 7.9], WALL)
    tunnel = clsim.MeshRoom(vertices, triangles[np.abs(middle[:, 0] - 4.0) < 3.9], WALL)
    floor = np.array([(0, 0, 0), (8, 0, 0), (8, 6, 0), (0, 6, 0)]), np.array([(0, 1, 2), (0, 2, 3)])
    crate = clsim.MeshRoom(*joined(floor, (box((1, 1, 1))[0] + [5, 2, 0.01], triangles)), WALL)
    for room in (stage, tunnel, crate):
        assert warned(room, (4, 3, 1), (9, 3, 1), (4, 3, 3.5)) == []
