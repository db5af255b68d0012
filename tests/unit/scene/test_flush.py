"""What a flush end may be, and what is refused, by name; in constructors and scene files."""

import tomllib
from pathlib import Path

import numpy as np
import pytest

import clsim
from clsim.scene.flush import find_mount
from clsim.scene_file.scene import build_scene, completed_scene

WALL = clsim.Material.from_reflection(0.9)
BOX = clsim.Shoebox((8.0, 6.0, 3.0), WALL)
MESH = clsim.MeshRoom.joined([BOX])
SCREEN = clsim.MeshRoom([(4, 1, 0.5), (4, 3, 0.5), (4, 3, 2), (4, 1, 2)], [(0, 1, 2), (0, 2, 3)], WALL)
PARTED = clsim.MeshRoom.joined([BOX, SCREEN])
TONE = clsim.Signal.tone(40e3, 0.01, 192e3)
SLIDE_OFF = clsim.Trajectory.line((4, 2, 1), (4, 4, 1), 0.1)
ROOMS = {"box": BOX, "mesh": MESH, "parted": PARTED}


def scene(room, place, flush=False) -> clsim.Scene:
    way = place if isinstance(place, clsim.Trajectory) else clsim.Trajectory.fixed(place)
    return clsim.Scene(
        room, clsim.Air(), [clsim.Source("s", TONE, way, flush=flush)],
        [clsim.Receiver("r", clsim.Trajectory.fixed((1.0, 1.0, 1.0)))],
    )  # fmt: skip


@pytest.mark.parametrize("room", [BOX, MESH], ids=["shoebox", "mesh"])
@pytest.mark.parametrize(
    ("place", "side"),
    [((3, 2, 3), (0, 0, -1)), ((3, 2, 0), (0, 0, 1)), ((0, 2, 1), (1, 0, 0)), ((8, 2, 1), (-1, 0, 0))],
)
@pytest.mark.parametrize("told", [True, False])
def test_the_side_is_that_of_the_room(room, place, side, told: bool) -> None:
    source = scene(room, place, True if told else np.array(side) * 3.0 + 0.1).sources[0]
    mount = find_mount(room, source)
    assert mount is not None
    np.testing.assert_allclose(mount.normal, side, atol=1e-15)
    np.testing.assert_allclose(mount.lifted(np.array([place])), [np.array(place) + 1e-6 * np.array(side)], atol=1e-12)


def test_a_screen_has_two_sides() -> None:
    for side in ((1.0, 0.0, 0.0), (-1.0, 0.0, 0.0)):
        mount = find_mount(PARTED, scene(PARTED, (4, 2, 1), side).sources[0])
        assert mount is not None
        np.testing.assert_allclose(mount.normal, side)


SLIDE = clsim.Trajectory.line((3, 2, 3), (4, 3, 3), 0.02)


@pytest.mark.parametrize(
    ("room", "place", "flush", "message"),
    [
        ("box", (3, 2, 3), False, r"sources\[0\]\.trajectory: .*on the wall z_max; .* flush=True"),
        ("mesh", (3, 2, 3), False, r"sources\[0\]\.trajectory: .*meets the wall 'z_max' .* flush="),
        ("box", (3, 2, 2.9), True, r"sources\[0\]\.flush: must be left out, because 's' at \(3, 2, 2\.9\) m is on no"),
        ("mesh", (3, 2, 2.9), True, r"sources\[0\]\.flush: must be left out, because 's' at \(3, 2, 2\.9\) m is on no"),
        ("box", (0, 2, 3), True, r"flush: must be on one wall, but 's' .* on an edge of 'x_min' and 'z_max'"),
        ("mesh", (0, 2, 3), True, r"flush: must be on one wall, but 's' .* on an edge of 'x_min' and 'z_max'"),
        ("box", (3, 2, 3), (0, 0, 1), r"flush: must point into the room from z_max"),
        ("mesh", (3, 2, 3), (0, 0, 1), r"sources\[0\]\.trajectory: .*outside the room"),
        ("mesh", (3, 2, 3), (1, 0, 0), r"flush: must point off the wall 'z_max', but 1, 0, 0 runs along it"),
        ("parted", (4, 2, 1), True, r"flush: must be a direction off the wall .* because both sides are inside"),
        ("box", clsim.Trajectory.line((3, 2, 3), (3, 2, 2), 0.02), True, r"stay in the plane of the wall .*\(3, 2, 2\."),
        ("mesh", clsim.Trajectory.line((3, 2, 3), (3, 2, 2), 0.02), True, r"stay in the plane of the wall .*\(3, 2, 2\."),
        ("box", clsim.Trajectory.line((3, 2, 3), (9, 2, 3), 0.1), True, r"must stay inside the room"),
        ("mesh", clsim.Trajectory.line((3, 2, 3), (9, 2, 3), 0.1), True, r"walk through none, but 's' meets the wall 'x_max'"),
        ("parted", SLIDE_OFF, (1, 0, 0), r"stay on the wall that it is flush with, '.*', but 's' is at \(4, 3\.0"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_refused_by_name(room: str, place, flush, message: str) -> None:
    with pytest.raises(clsim.InputError, match=message):
        scene(ROOMS[room], place, flush)


def test_an_end_in_a_wall_may_slide_along_it_but_not_through_another() -> None:
    for room in (BOX, MESH):
        scene(room, SLIDE, True)
    standing = clsim.MeshRoom([(4, 1, 0), (4, 3, 0), (4, 3, 2), (4, 1, 2)], [(0, 1, 2), (0, 2, 3)], WALL)
    parted = clsim.MeshRoom.joined([BOX, standing])
    with pytest.raises(clsim.InputError, match=r"meets the wall 'wall 1' at \(4, 2, 0\) m at 0\.01 s"):
        scene(parted, clsim.Trajectory.line((3, 2, 0), (5, 2, 0), 0.02), (0, 0, 1))


@pytest.mark.parametrize(
    ("value", "message"), [((0, 0, 0), "is 0, 0, 0"), ("z_max", "must be numbers"), ((0, 1), "shape 3")]
)
def test_bad_sides_are_refused(value, message: str) -> None:
    with pytest.raises(clsim.InputError, match=message) as error:
        clsim.Receiver("r", clsim.Trajectory.fixed((0, 1, 1)), flush=value)
    assert error.value.field.startswith("flush")


def test_a_path_along_the_wall_of_both_its_ends_has_corners() -> None:
    source = clsim.Source("s", TONE, clsim.Trajectory.fixed((3, 2, 3)), flush=True)
    receiver = clsim.Receiver("r", clsim.Trajectory.fixed((5, 4, 3)), flush=True)
    paths = clsim.find_paths(clsim.Scene(BOX, clsim.Air(), [source], [receiver]), 1)
    corners = paths.vertices(0.0)
    for row, order in zip(corners, paths.order, strict=True):
        assert np.isfinite(row[: order + 2]).all()
    ceiling = next(c for c, w in zip(corners, paths.walls, strict=True) if w[0] == 5)
    np.testing.assert_allclose(ceiling[1], (4, 3, 3))


SCENE = """
format = 1
[room]
kind = "shoebox"
size = [8.0, 6.0, 3.0]
walls = { reflection = 0.9 }
[[sources]]
name = "s"
signal = { kind = "tone", frequency = 40e3, duration = 0.01, sampling_rate = 192e3 }
trajectory = { kind = "fixed", position = [2.0, 2.0, 1.0] }
[[receivers]]
name = "ceiling"
positions = { kind = "grid", x = [1.0, 7.0, 3], y = 2.0, z = 3.0 }
flush = true
[[receivers]]
name = "side"
trajectory = { kind = "fixed", position = [0.0, 3.0, 1.0] }
flush = [1.0, 0.0, 0.0]
[paths]
max_order = 1
[render]
sampling_rate = 192e3
"""


def test_scene_files_say_flush(tmp_path: Path) -> None:
    file = build_scene(tomllib.loads(SCENE), tmp_path)
    flush = [r.flush for r in file.scene.receivers]
    assert flush[:3] == [True] * 3
    assert flush[3].tolist() == [1.0, 0.0, 0.0]
    assert file.scene.sources[0].flush is False
    again = tomllib.loads(completed_scene(file, tmp_path))
    assert [r["flush"] for r in again["receivers"]] == [True, [1.0, 0.0, 0.0]]
    assert again["sources"][0]["flush"] is False
    build_scene(again, tmp_path)
    with pytest.raises(clsim.InputError, match=r"receivers\[1\]\.flush"):
        build_scene(tomllib.loads(SCENE.replace("[1.0, 0.0, 0.0]", '"z_max"')), tmp_path)
