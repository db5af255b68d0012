"""What is hardly meant is told by name behind every door; ends that sit in walls."""

import json
import tomllib
from pathlib import Path

import numpy as np
import pytest
from made_meshes import box, joined
from scene_texts import receiver_at, scene_text, shoebox_of, source_at, tone_of

import clsim
from clsim.cli import main
from clsim.scene.ends import find_mount
from clsim.scene.placement import through_walls
from clsim.scene.room import mesh as mesh_room
from clsim.scene_file.scene import build_scene, completed_scene
from clsim.study.file import checked, load_study
from clsim.study.member import run_member, study_to_settings

WALL = clsim.Material.from_reflection(0.9)
BOX = clsim.Shoebox((8.0, 6.0, 3.0), WALL)
MESH = clsim.MeshRoom.joined([BOX])
SCREEN = clsim.MeshRoom([(4, 1, 0.5), (4, 3, 0.5), (4, 3, 2), (4, 1, 2)], [(0, 1, 2), (0, 2, 3)], WALL)
PARTED = clsim.MeshRoom.joined([BOX, SCREEN])
TONE = clsim.Signal.tone(40e3, 0.01, 192e3)
SLIDE_OFF = clsim.Trajectory.line((4, 2, 1), (4, 4, 1), 0.1)
ROOMS = {"box": BOX, "mesh": MESH, "parted": PARTED}


def scene_of_flush(room, place, flush=False) -> clsim.Scene:
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
    source = scene_of_flush(room, place, True if told else np.array(side) * 3.0 + 0.1).sources[0]
    mount = find_mount(room, source)
    assert mount is not None
    np.testing.assert_allclose(mount.normal, side, atol=1e-15)
    np.testing.assert_allclose(mount.lifted(np.array([place])), [np.array(place) + 1e-6 * np.array(side)], atol=1e-12)


def test_a_screen_has_two_sides() -> None:
    for side in ((1.0, 0.0, 0.0), (-1.0, 0.0, 0.0)):
        mount = find_mount(PARTED, scene_of_flush(PARTED, (4, 2, 1), side).sources[0])
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
        scene_of_flush(ROOMS[room], place, flush)


def test_an_end_in_a_wall_may_slide_along_it_but_not_through_another() -> None:
    for room in (BOX, MESH):
        scene_of_flush(room, SLIDE, True)
    standing = clsim.MeshRoom([(4, 1, 0), (4, 3, 0), (4, 3, 2), (4, 1, 2)], [(0, 1, 2), (0, 2, 3)], WALL)
    parted = clsim.MeshRoom.joined([BOX, standing])
    with pytest.raises(clsim.InputError, match=r"meets the wall 'wall 1' at \(4, 2, 0\) m at 0\.01 s"):
        scene_of_flush(parted, clsim.Trajectory.line((3, 2, 0), (5, 2, 0), 0.02), (0, 0, 1))


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


FLUSH_SCENE = scene_text(
    source_at("s", tone_of(40e3, 0.01), (2.0, 2.0, 1.0)),
    receiver_at("ceiling", None, positions={"kind": "grid", "x": (1.0, 7.0, 3), "y": 2.0, "z": 3.0}, flush=True),
    receiver_at("side", (0.0, 3.0, 1.0), flush=(1.0, 0.0, 0.0)),
    room=shoebox_of(8.0, 6.0, 3.0),
)


def test_scene_files_say_flush(tmp_path: Path) -> None:
    file = build_scene(tomllib.loads(FLUSH_SCENE), tmp_path)
    flush = [r.flush for r in file.scene.receivers]
    assert flush[:3] == [True] * 3
    assert flush[3].tolist() == [1.0, 0.0, 0.0]
    assert file.scene.sources[0].flush is False
    again = tomllib.loads(completed_scene(file, tmp_path))
    assert [r["flush"] for r in again["receivers"]] == [True, [1.0, 0.0, 0.0]]
    assert again["sources"][0]["flush"] is False
    build_scene(again, tmp_path)
    with pytest.raises(clsim.InputError, match=r"receivers\[1\]\.flush"):
        build_scene(tomllib.loads(FLUSH_SCENE.replace("[1.0, 0.0, 0.0]", '"z_max"')), tmp_path)


def scene(room, places=((1, 1, 1), (3, 2, 1)), frequency: float = 40e3) -> clsim.Scene:
    source, receiver = (clsim.Trajectory.fixed(p) for p in places)
    tone = clsim.Signal.tone(frequency, 0.005, 192e3)
    return clsim.Scene(room, clsim.Air(), [clsim.Source("s", tone, source)], [clsim.Receiver("r", receiver)])


def mesh(size: float, scale: float | None) -> clsim.MeshRoom:
    vertices, triangles = box((size, size / 2, size / 4))
    return clsim.MeshRoom(vertices, triangles, WALL, scale=scale)


@pytest.mark.parametrize(
    ("room", "line"),
    [
        (clsim.Shoebox((8000, 6000, 3000), WALL), "8000 m is large for a room; for millimetres, try 0.001 times its lengths"),
        (mesh(8000.0, 1.0), "8000 m is large for a room; for a file in millimetres, try scale = 0.001"),
        (mesh(8000.0, 1000.0), "8000 m is large for a room; try scale = 1"),
        (mesh(8000.0, None), "8000 m is large for a room; for millimetres, try 0.001 times its lengths"),
        (mesh(301.0, 1.0), "301 m is large for a room; for a file in millimetres, try scale = 0.001"),
        (mesh(8e6, 1.0), "8e+06 m is large for a room; try scale = 1e-06"),
        (mesh(0.19, 0.001), "0.19 m is small for a room; try scale = 1"),
        (clsim.Shoebox((0.1, 0.1, 0.1), WALL), "0.1 m is small for a room; try 1000 times its lengths"),
    ],
    ids=str,
)  # fmt: skip
def test_an_absurd_size_comes_with_what_to_try(room, line: str) -> None:
    size = room.extent[1][0]
    places = ((0.1 * size, 0.1 * size, 0.1 * size), (0.8 * size, 0.3 * size, 0.15 * size))
    with pytest.warns(clsim.ClsimWarning) as caught:
        scene(room, places)
    assert [str(w.message) for w in caught] == [f"room: {line}"]
    assert caught[0].filename == __file__


@pytest.mark.parametrize("size", [0.2, 8.0, 300.0])
def test_a_usual_size_is_not_remarked_on(size: float) -> None:
    places = ((0.1 * size, 0.1 * size, 0.1 * size), (0.8 * size, 0.3 * size, 0.15 * size))
    scene(mesh(size, 1.0), places)
    scene(clsim.Shoebox((size, size, size), WALL), places)


def test_hertz_for_kilohertz_is_told() -> None:
    with pytest.warns(clsim.ClsimWarning, match=r"sources\[0\]\.signal: 40 Hz is low .* for 40 kHz, try 40e3"):
        scene(clsim.Shoebox((8, 6, 3), WALL), frequency=40.0)
    scene(clsim.Shoebox((8, 6, 3), WALL), frequency=125.0)


def test_an_end_outside_a_watertight_mesh_is_refused_by_name() -> None:
    vertices, triangles = box((8, 6, 3))
    room = clsim.MeshRoom(vertices, triangles, WALL)
    message = r"'{}' at \(3, 2, 4\) m is outside the room .* from \(0, 0, 0\) to \(8, 6, 3\) m"
    with pytest.raises(clsim.InputError, match=message.format("r")) as error:
        scene(room, ((1, 1, 1), (3, 2, 4)))
    assert error.value.field == "receivers[0].trajectory"
    with pytest.raises(clsim.InputError, match=message.format("s")) as error:
        scene(room, ((3, 2, 4), (1, 1, 1)))
    assert error.value.field == "sources[0].trajectory"
    with pytest.warns(clsim.ClsimWarning, match=r"sources\[0\]\.trajectory: no source or receiver is inside .* 's' at"):
        scene(room, ((3, 2, 4), (1, 1, 4)))
    # Within a closed cupboard nothing is heard either.
    cupboard = joined((vertices, triangles), (0.25 * np.asarray(vertices) + 2.0, triangles))
    with pytest.raises(clsim.InputError, match="inside a closed obstacle"):
        scene(clsim.MeshRoom(*cupboard, WALL), ((1, 1, 1), (2.5, 2.5, 2.5)))


def test_a_room_whose_walls_are_solids_is_a_room() -> None:
    """Between an inner and an outer shell is the wall: the room inside is not within the mesh."""
    vertices, triangles = box((8, 6, 3))
    outer = np.asarray(vertices) * [8.4 / 8, 6.4 / 6, 3.4 / 3] - 0.2
    house = clsim.MeshRoom(*joined((vertices, triangles), (outer, triangles)), WALL)
    assert house.shape.watertight
    scene(house)
    for places, name in ((((1, 1, 1), (3, 2, 3.1)), "sources"), (((1, 1, 3.1), (3, 2, 1)), "receivers")):
        with pytest.raises(
            clsim.InputError, match="must lie in the same air as the other sources and receivers"
        ) as error:
            scene(house, places)
        assert error.value.field == f"{name}[0].trajectory"
    two = [clsim.Receiver(n, clsim.Trajectory.fixed(p)) for n, p in (("a", (3, 2, 1)), ("b", (4, 2, 3.1)))]
    with pytest.raises(clsim.InputError, match=r"'b' at .* is inside the mesh, and others are not"):
        clsim.Scene(house, clsim.Air(), scene(house).sources, two)
    with pytest.warns(clsim.ClsimWarning, match="no source or receiver is inside"):
        scene(house, ((1, 1, 4), (3, 2, 4)))


def test_no_ray_through_an_edge_makes_an_inside(rng: np.random.Generator) -> None:
    """Places on round coordinates and on the lines of rays through edges are inside all the same."""
    vertices, triangles = box((8, 6, 3))
    room = clsim.MeshRoom(vertices, triangles, WALL)
    grid = np.stack(np.meshgrid(np.arange(0.1, 8, 0.5), np.arange(0.1, 6, 0.5), np.arange(0.1, 3, 0.5)), -1)
    assert room.contains(grid.reshape(-1, 3)).all()
    for ray in mesh_room._RAYS:
        hits = np.array([8.0, 6.0, 3.0]) * [1.0, 0.5, 1.0]  # the middle of an edge
        assert room.contains([hits - np.sign(ray @ [1, 0, 1]) * 0.7 * ray])[0] == (ray[0] * ray[2] > 0)


SCENE = scene_text(
    source_at("s", tone_of(40.0, 0.002), (4.0, 3.0, 1.5)), receiver_at("r", (4.5, 3.0, 1.5)),
    room=shoebox_of(8e3, 6e3, 3e3), max_order=0, render={"engine": "reference", "responses": "centre"},
)  # fmt: skip
STUDY = """
format = 1
scene = "scene.toml"
keep = ["ground_truth"]
[[vary]]
field = "paths.max_order"
values = [0]
"""
TOLD = ("room: 8000 m is large for a room", "sources[0].signal: 40 Hz is low")


@pytest.mark.parametrize("door", ["check", "run"])
def test_commands_tell_it(door: str, tmp_path: Path, capsys) -> None:
    (tmp_path / "scene.toml").write_text(SCENE, "utf-8")
    more = ["-o", str(tmp_path / "out"), "--no-plots", "--table", "none"] if door == "run" else []
    assert main([door, str(tmp_path / "scene.toml"), *more]) == 0
    warned = capsys.readouterr().err.splitlines()
    for text in TOLD:
        assert sum(line.startswith(f"clsim: warning: {text}") for line in warned) == 1


def test_studies_tell_it_before_and_of_each_member(tmp_path: Path) -> None:
    pytest.importorskip("xarray")
    pytest.importorskip("zarr")
    (tmp_path / "scene.toml").write_text(SCENE, "utf-8")
    (tmp_path / "study.toml").write_text(STUDY, "utf-8")
    study = load_study(tmp_path / "study.toml")
    with pytest.warns(clsim.ClsimWarning) as caught:
        checked(study, lambda share: None)
    (tmp_path / "study.json").write_text(json.dumps(study_to_settings(study)), "utf-8")
    (tmp_path / "study.zarr").mkdir()
    row = run_member(str(tmp_path), 0, None)
    assert row["status"] == "finished", row["error"]
    for messages in ([str(w.message) for w in caught], row["warnings"]):
        for text in TOLD:
            assert any(message.startswith(text) for message in messages)


def test_a_transmitter_that_hears_and_a_receiver_that_sounds_are_told() -> None:
    tone, place = clsim.Signal.tone(40e3, 0.005, 192e3), clsim.Trajectory.fixed((1, 1, 1))
    sender, ear = clsim.Transducer.named("MA40S4S"), clsim.Transducer.named("MA40S4R")

    def built(of_source: clsim.Transducer, of_receivers: clsim.Transducer) -> None:
        ears = clsim.receiver_array("r", np.array([[3.0, 2.0, 1.0], [3.0, 2.0, 2.0]]), transducer=of_receivers)
        source = clsim.Source("s", tone, place, transducer=of_source)
        clsim.Scene(clsim.Shoebox((8, 6, 3), WALL), clsim.Air(), [source], ears)

    built(sender, ear)
    with pytest.warns(clsim.ClsimWarning) as caught:
        built(ear, sender)
    assert [str(w.message) for w in caught] == [
        "sources[0].transducer: MA40S4R is a receiving transducer, given in V/Pa; the transmitter is MA40S4S",
        "receivers[0].transducer: MA40S4S is a transmitting transducer, given in Pa/V; the receiver is MA40S4R",
    ]
    built(clsim.Transducer.resonance(40e3, 2.4e3, 0.01, "MA40S4R"), ear)  # a measured one, by the same name


def test_a_sphere_in_a_wall_is_told_with_time_and_depth() -> None:
    ends = (
        [clsim.Source("s", TONE, clsim.Trajectory.fixed((4, 3, 1)))],
        [clsim.Receiver("r", clsim.Trajectory.fixed((1, 1, 1)))],
    )
    for room in (BOX, MESH):
        for last, told in ((7.5, r"'ball' reaches 0\.1 m into a wall at 0\.2 s"), (7.4, None)):
            ball = clsim.Scatterer.sphere("ball", 0.6, clsim.Trajectory.line((6, 3, 1), (last, 3, 1), 0.2))
            if told is None:
                clsim.Scene(room, clsim.Air(), *ends, scatterers=[ball])
                continue
            with pytest.warns(clsim.ClsimWarning, match=r"scatterers\[0\]\.trajectory: " + told):
                clsim.Scene(room, clsim.Air(), *ends, scatterers=[ball])


@pytest.mark.parametrize(("height", "told"), [(0.3, "'pole' reaches 0.25 m through a wall at 0 s"), (0.56, None)])
def test_capsules_through_walls_are_told(height: float, told: str | None) -> None:
    """A pole of 1 m, 5 cm thick, upright: its middle line ends 20 cm below the floor, or 6 cm above it."""
    pole = clsim.Scatterer.capsule("pole", 0.05, 1.0, clsim.Trajectory.fixed((2.0, 1.5, height)))
    hall = clsim.Shoebox((4.0, 3.0, 2.5), clsim.Material.from_reflection(0.8))
    for room in (hall, hall.as_mesh()):
        notes = through_walls(room, [("scatterers[0]", pole)])
        assert notes == ([] if told is None else [f"scatterers[0].trajectory: {told}"])
