"""The command line on rooms of any shape, and its pages."""

import re
import tomllib
from pathlib import Path

import numpy as np
import pytest
import soundfile
from made_meshes import box
from made_results import read_table

import clsim
from clsim.cli import main
from clsim.paths.path_table import viewed
from clsim.render.planning import plan_render
from clsim.scene_file import load_scene

MESH_SCENE = """
format = 1
[room]
kind = "mesh"
path = "meshes/room.obj"
scale = 0.001
up = "y"
materials = { default = { reflection = 0.9 }, "hard floor" = { reflection = 0.5 } }
[[room.obstacles]]
path = "meshes/screen.ply"
materials = { named = "rigid" }
[[sources]]
name = "robot"
signal = { kind = "tone", frequency = 10e3, duration = 0.3, sampling_rate = 48e3, fade = 0.005 }
trajectory = { kind = "waypoints", smooth = false, times = [0.0, 0.1, 0.2, 0.3], positions = [[1, 4.5, 1], [1, 4.5, 1], [1, 2, 1], [1, 2, 1]] }
[[receivers]]
name = "mic"
trajectory = { kind = "fixed", position = [7, 2, 1] }
[paths]
max_order = 1
[render]
sampling_rate = 48e3
engine = "reference"
"""  # the robot walks behind the screen between 0.1 and 0.2 s
SCREEN = """ply
format ascii 1.0
element vertex 4
property float x
property float y
property float z
element face 1
property list uchar int vertex_indices
end_header
4 1 0
4 3 0
4 3 1.5
4 1 1.5
4 0 1 2 3
"""


def write_room(path: Path, triangles: slice = slice(None)) -> None:
    """Write a room of 8 m x 6 m and 3 m high as an OBJ file in millimetres, y up, its floor a group of its own."""
    vertices, faces = box((8.0, 6.0, 3.0))
    floor = np.all(vertices[faces][:, :, 2] == 0.0, axis=1)
    lines = [f"v {1e3 * x:g} {1e3 * z:g} {-1e3 * y:g}" for x, y, z in vertices]
    for group, chosen in (("hard floor", floor), ("side", ~floor)):
        lines += [f"usemtl {group}", *(f"f {a} {b} {c}" for a, b, c in (faces[chosen] + 1)[triangles])]
    path.write_text("\n".join(lines))


@pytest.fixture
def mesh_scene(tmp_path: Path) -> Path:
    """Return a scene of a mesh with a screen in it; both are files in a folder beside it."""
    (tmp_path / "meshes").mkdir()
    write_room(tmp_path / "meshes" / "room.obj")
    (tmp_path / "meshes" / "screen.ply").write_text(SCREEN)
    (tmp_path / "mesh.toml").write_text(MESH_SCENE)
    return tmp_path / "mesh.toml"


def without_screen(scene: Path) -> None:
    text = scene.read_text("utf-8")
    scene.write_text(text.replace(text[text.index("[[room.obs") : text.index("[[sources")], ""), "utf-8")


def test_check_says_what_a_mesh_is_like(mesh_scene: Path, capsys) -> None:
    assert main(["check", str(mesh_scene)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[:3] == [
        "room: 14 triangles, 7 walls in 7 planes, 8 x 6 x 3 m from (0, 0, 0) m",
        "room: 2 separate shells, 1 of them closed",
        "room: watertight, but for sheets of 2 triangles in it",
    ]
    # The screen ends 1.5 m below the ceiling and 3 m from the far wall: those two reflect over and past it all the time.
    file = load_scene(mesh_scene)
    found = clsim.find_paths(file.scene, **file.paths)
    rows = list(zip(found.walls[:, 0].tolist(), found.start.tolist(), found.end.tolist(), strict=True))
    always = {wall for wall, start, end in rows if start == -np.inf and end == np.inf}
    passing = [wall for wall, _, _ in rows if wall not in always]
    centres = file.scene.room.walls.centre[sorted(always)]
    assert {tuple(centre) for centre in centres.tolist()} == {(4.0, 3.0, 3.0), (4.0, 6.0, 1.5)}
    assert -1 in passing
    assert (
        f"paths: {len(always) + len(set(passing))}, of which {len(always)} are active all the time "
        f"and {len(set(passing))} in intervals ({len(passing)} of them; the same walls in another order are another path)"
    ) in lines
    assert lines[-1] == "the scene file is valid"
    assert sum("is inside at 0 s" in line for line in lines) == 2

    without_screen(mesh_scene)
    assert main(["check", str(mesh_scene)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line for line in lines if "faces (" not in line][1:5] == [
        "room: watertight",
        "sources[0]: 'robot' is inside at 0 s",
        "receivers[0]: 'mic' is inside at 0 s",
        "paths: 7, of which 7 are active all the time and 0 in intervals (0 of them; the same walls in another order are another path)",
    ]


def test_check_says_which_scale_to_try_before_the_search_gives_up(mesh_scene: Path, capsys) -> None:
    without_screen(mesh_scene)
    text = mesh_scene.read_text("utf-8")
    mesh_scene.write_text(text.replace("scale = 0.001", "").replace("max_order = 1", "max_order = 1\npath_limit = 1"))
    assert main(["check", str(mesh_scene)]) == 2
    printed = capsys.readouterr()
    warned, error = printed.err.splitlines()
    assert warned == "clsim: warning: room: 8000 m is large for a room; for a file in millimetres, try scale = 0.001"
    assert error.startswith(f"clsim: error: {mesh_scene}: paths.max_order: must give at most 1 paths")


def test_paths_of_a_mesh_are_those_heard_at_a_time(mesh_scene: Path, tmp_path: Path, capsys) -> None:
    listed = {}
    for time_ in ("0", "0.3"):
        assert main(["paths", str(mesh_scene), "--at", time_]) == 0
        header, *rows = capsys.readouterr().out.splitlines()
        listed[time_] = {row[header.index("objects") :] for row in rows}
        assert len(listed[time_]) == len(rows)
    assert "direct" in listed["0"]
    assert "direct" not in listed["0.3"]
    names = load_scene(mesh_scene).scene.room.faces.names
    assert {"room hard floor", "screen"} < set(names)
    assert listed["0"] | listed["0.3"] <= {"direct", *names}
    # By the floor, too, the way past the screen is free before the walk and barred behind it.
    assert "room hard floor" in listed["0"]
    assert "room hard floor" not in listed["0.3"]
    assert main(["paths", str(mesh_scene), "--at", "0.3", "-o", str(tmp_path / "p.npz")]) == 0
    delay = read_table(tmp_path / "p.npz").delay[:, 0]
    assert np.isfinite(delay).sum() == len(listed["0.3"]) < len(delay)
    capsys.readouterr()
    assert main(["paths", str(mesh_scene), "--limit", "2"]) == 0
    assert capsys.readouterr().out.splitlines()[-1] == f"and {len(listed['0']) - 2} more (--limit)"


def test_run_of_a_mesh_can_be_repeated_from_its_results(mesh_scene: Path, tmp_path: Path, capsys) -> None:
    out = tmp_path / "out" / "deep"
    assert main(["run", str(mesh_scene), "-o", str(out)]) == 0
    assert {p.name for p in out.iterdir()} == {
        "mic.wav", "paths.npz", "ground_truth.npz", "mic_spectrogram.png", "mic_echogram.png", "mic_paths.png", "clsim.json",
        "scene.completed.toml",
    }  # fmt: skip
    completed = tomllib.loads((out / "scene.completed.toml").read_text("utf-8"))
    assert completed["room"]["path"] == "../../meshes/room.obj"
    assert completed["room"]["obstacles"][0]["path"] == "../../meshes/screen.ply"
    assert completed["paths"]["finder"] == "auto"
    samples, _ = soundfile.read(out / "mic.wav")
    assert np.any(samples)
    again = ["run", str(out / "scene.completed.toml"), "-o", str(tmp_path / "again"), "--no-plots", "--table", "none"]
    assert main(again) == 0
    np.testing.assert_array_equal(soundfile.read(tmp_path / "again" / "mic.wav")[0], samples)
    capsys.readouterr()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("meshes/room.obj", "meshes/none.obj"), "room.path: {folder}/meshes/none.obj: cannot be read: "),
        (("meshes/screen.ply", "meshes"), "room.obstacles[0].path: {folder}/meshes: cannot be read: "),
        (("meshes/screen.ply", "mesh.toml"), "room.obstacles[0].path: {folder}/mesh.toml: must be of a known format"),
        (
            ('{ named = "rigid" }', "{ glass = { reflection = 0.9 } }"),
            "room.obstacles[0].materials.glass: is no group of screen.ply, ",
        ),
        (('"hard floor" =', '"soft floor" ='), "room.materials.soft floor: is no group of room.obj, whose groups are "),
        (("default = { reflection = 0.9 }, ", ""), "room.materials: must name the group 'side' of room.obj"),
        (('up = "y"', 'up = "up"'), 'room.up: must be one of "x", "y", "z"'),
        (("scale = 0.001", "scale = -1.0"), "room.scale: must be at least 1e-09"),
        (("position = [7, 2, 1]", "position = [4, 2, 1]"), "receivers[0].trajectory: must stay 1e-06 m away"),
        (("[1, 2, 1], [1, 2, 1]]", "[6, 2, 1], [6, 2, 1]]"), "meets the wall 'screen' at (4, 3, 1) m"),
        (("max_order = 1", "max_order = 21"), "paths.max_order: must be from 0 to 20"),
        (("max_order = 1", "max_order = 1\nresolution = -1.0"), "paths.resolution: must be"),
        (("max_order = 1", 'max_order = 1\nfinder = "luck"'), 'paths.finder: must be one of "auto", "beam-tree", "shooting"'),
    ],
)  # fmt: skip
def test_errors_of_meshes_are_one_line_and_status_2(mesh_scene: Path, error_of, change: tuple[str, str], message: str):
    text = mesh_scene.read_text("utf-8")
    assert change[0] in text
    mesh_scene.write_text(text.replace(*change), "utf-8")
    assert message.format(folder=mesh_scene.parent) in error_of("check", mesh_scene)


def planned(scene: Path) -> tuple[clsim.PathSet, float]:
    """Return the paths of a scene file, and how long its recording lasts."""
    file = load_scene(scene)
    paths = clsim.find_paths(file.scene, **file.paths)
    return paths, plan_render(paths, **file.render).duration


def test_view_writes_a_page_beside_the_scene(mesh_scene: Path, tmp_path: Path, capsys) -> None:
    paths, duration = planned(mesh_scene)
    capsys.readouterr()
    assert main(["view", str(mesh_scene), "--frames", "3"]) == 0
    assert capsys.readouterr().out == f"{tmp_path / 'mesh.html'}\n"
    text = (tmp_path / "mesh.html").read_text("utf-8")
    for frame in viewed(paths, duration=duration, frames=3)["frames"]:
        assert len(frame.labels) > 2
        for label in frame.labels:
            assert label in text
    assert main(["view", str(mesh_scene), "--frames", "1", "--limit", "1", "-o", str(tmp_path / "v.html")]) == 0
    assert capsys.readouterr().out == f"{tmp_path / 'v.html'}\n"
    assert (tmp_path / "v.html").read_text("utf-8").count("robot to mic, ") == 1
    for name in ("--frames", "--limit"):
        assert main(["view", str(mesh_scene), name, "0"]) == 2
        assert capsys.readouterr().err.startswith(f"clsim: error: {name}: must be 1 to ")
    assert main(["view", str(mesh_scene), "-o", str(tmp_path / "none" / "v.html")]) == 2
    assert capsys.readouterr().err.splitlines()[-1].startswith("clsim: error: ")


def test_view_shows_walls_and_what_is_heard(mesh_scene: Path) -> None:
    paths, duration = planned(mesh_scene)
    view = viewed(paths, duration=duration, frames=41)
    room = paths.scene.room
    assert [wall.name for wall in view["walls"]] == list(room.faces.names)
    assert {(w.name, w.material) for w in view["walls"]} >= {("room hard floor", "reflection 0.5"), ("screen", "rigid")}
    area = {
        w.name: 0.5 * np.linalg.norm(np.cross(*(w.triangles[:, i] - w.triangles[:, 0] for i in (1, 2))))
        for w in view["walls"]
    }
    np.testing.assert_allclose(area["screen"], np.sqrt(2) / 2 * 3.0)  # two triangles of 1.5 m² each
    assert [(end.name, end.kind, len(end.trail)) for end in view["ends"]] == [
        ("robot", "source", 400),
        ("mic", "receiver", 1),
    ]

    table = paths.table(np.array([0.0]))
    heard = np.flatnonzero(np.isfinite(table.delay[:, 0]))
    level = 20.0 * np.log10(np.abs(table.gain[heard, 0]) / np.nanmax(np.abs(table.gain)))
    assert set(view["frames"][0].labels) == {
        f"robot to mic, {table.name_objects(p)}: {table.delay[p, 0] * 1e3:.3f} ms, {decibels:.1f} dB"
        for p, decibels in zip(heard, level, strict=True)
    }
    first, last = view["frames"][0], view["frames"][-1]
    assert re.fullmatch(r"robot to mic, direct: [\d.]+ ms, 0\.0 dB", first.labels[0])
    np.testing.assert_allclose(first.vertices[0], [[1, 4.5, 1], [7, 2, 1]], atol=1e-9)
    assert not any("direct" in label for label in last.labels)  # it is behind the screen
    for corners, order in zip(last.vertices, last.order, strict=True):
        assert corners.shape == (order + 2, 3)
        np.testing.assert_allclose(corners[[0, -1]], [[1, 2, 1], [7, 2, 1]], atol=1e-9)
    two = viewed(paths, duration=duration, frames=1, limit=2)
    assert two["frames"][0].labels == first.labels[:2] != first.labels
    assert two["notes"] == ("Only the 2 strongest paths are drawn and counted.",)
    assert view["notes"] == ()


def test_view_keeps_one_of_the_instants_between_which_nothing_moves(mesh_scene: Path) -> None:
    paths, duration = planned(mesh_scene)
    every, ticks = np.linspace(0.0, duration, 41), []
    view = viewed(paths, duration=duration, frames=41, progress=ticks.append)
    times = view["times"]
    assert len(ticks) == 41
    assert len(view["frames"]) == len(times) < 41
    way = paths.scene.sources[0].trajectory
    np.testing.assert_allclose(view["ends"][0].positions, way.position(np.minimum(times, way.end)), atol=1e-12)
    np.testing.assert_array_equal(view["ends"][1].positions, np.tile([7.0, 2.0, 1.0], (len(times), 1)))
    longest = (8.0 + 6.0 + 3.0) / 340.0 * 2  # s, which no reflection in this room takes
    assert duration > 0.2 + longest
    resting = (every > 0.0) & (every <= 0.1) | (every > 0.2 + longest + every[1])
    assert resting.sum() > 10
    assert not set(every[resting]) & set(times)
    assert set(every[(every == 0.0) | (every > 0.1) & (every < 0.2)]) <= set(times)
