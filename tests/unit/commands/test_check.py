"""Lines of `clsim check`: directions of ends, missing tails, shadows, corners and what is cut."""

import re
from pathlib import Path

import numpy as np
import pytest
from made_results import read_table
from scene_texts import along, receiver_at, scene_text, source_at, tone_of

import clsim
from clsim.cli import main
from clsim.scene_file import load_scene

CORNER_SCENE = scene_text(
    source_at("robot", tone_of(40e3, 0.2, fade=0.005), along((2.0, -8.0, 1.0), (3.0, -2.0, 1.2), 0.2)),
    receiver_at("corner", (7.0, -1.0, 1.5)),
    room={
        "kind": "mesh",
        "path": "room.obj",
        "up": "y",
        "materials": {"default": {"reflection": 0.9}, "soft": {"reflection": 0.3}},
    },
    max_order=2,
    render={"transition": 0.002},
)
# An L-shaped room, 3 m high, y up; the floor is one concave polygon.
CORNERS = [(0, 0), (8, 0), (8, 5), (4, 5), (4, 9), (0, 9)]


@pytest.fixture
def corner_scene(tmp_path: Path) -> Path:
    lines = [f"v {x} {y} {z}" for y in (0, 3) for x, z in CORNERS]
    lines += ["usemtl soft", "f " + " ".join(str(i + 1) for i in range(6)), "usemtl hard"]
    lines += ["f " + " ".join(str(i + 7) for i in range(6))]
    lines += [f"f {i + 1} {(i + 1) % 6 + 1} {(i + 1) % 6 + 7} {i + 7}" for i in range(6)]
    (tmp_path / "room.obj").write_text("\n".join(lines))
    path = tmp_path / "scene.toml"
    path.write_text(CORNER_SCENE, "utf-8")
    return path


def test_a_concave_floor_is_cut_and_told(corner_scene: Path, capsys) -> None:
    assert main(["check", str(corner_scene)]) == 0
    printed = capsys.readouterr().out
    assert "room: 20 triangles, 8 walls in 8 planes, 8 x 9 x 3 m from (0, -9, 0) m" in printed
    assert "room: watertight" in printed
    assert "room: 2 concave polygons were ear-clipped." in printed
    assert "receivers[0]: 'corner' is inside at 0 s" in printed
    for time, direct in (("0.01", False), ("0.19", True)):
        assert main(["paths", str(corner_scene), "--at", time]) == 0
        printed = capsys.readouterr().out
        assert ("direct" in printed) == direct
        assert "nan" not in printed


def test_a_receiver_that_no_path_reaches_is_told(corner_scene: Path, capsys) -> None:
    hidden = CORNER_SCENE.replace("[7.0, -1.0, 1.5]", "[7.0, -4.0, 1.5]").replace(
        "[3.0, -2.0, 1.2]", "[2.5, -7.0, 1.2]"
    )
    corner_scene.write_text(hidden.replace("max_order = 2", "max_order = 0"), "utf-8")
    assert main(["check", str(corner_scene)]) == 0
    printed = capsys.readouterr()
    assert "receivers[0]: 'corner' is inside at 0 s" in printed.out
    assert printed.err.endswith("clsim: warning: receivers[0]: no path reaches 'corner'; its output is silent\n")
    assert "reaches 0 dB of the strongest path (diffraction = 1 adds it)" in printed.err


@pytest.mark.parametrize("door", ["check", "run", "paths"])
def test_a_receiver_outside_is_refused_by_name_by_every_command(corner_scene: Path, tmp_path, capsys, door: str):
    corner_scene.write_text(CORNER_SCENE.replace("[7.0, -1.0, 1.5]", "[7.0, -8.0, 1.5]"), "utf-8")
    assert main([door, str(corner_scene), *(["-o", str(tmp_path / "out")] if door == "run" else [])]) == 2
    error = capsys.readouterr().err
    assert error.startswith(
        f"clsim: error: {corner_scene}: receivers[0].trajectory: must lie in the same air as the other sources and receivers, but 'corner'"
    )
    assert error.count("\n") == 1


@pytest.mark.usefixtures("device")
def test_run_draws_how_paths_come_and_go(corner_scene: Path, tmp_path: Path, capsys) -> None:
    out = tmp_path / "out"
    assert main(["run", str(corner_scene), "-o", str(out)]) == 0
    names = {p.name for p in out.iterdir()}
    assert {
        "corner.wav",
        "ground_truth.npz",
        "corner_spectrogram.png",
        "corner_echogram.png",
        "corner_paths.png",
        "paths.npz",
        "scene.completed.toml",
        "clsim.json",
    } == names
    assert {Path(line).name for line in capsys.readouterr().out.split()} == names - {"clsim.json"}
    table = read_table(out / "paths.npz")
    assert np.any(np.isnan(table.delay))
    assert main(["check", str(out / "scene.completed.toml")]) == 0, (
        "the completed scene finds the mesh from its own folder"
    )


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("soft = {", "glass = {"), "room.materials.glass: is no group of room.obj, whose groups are 'soft', 'hard'"),
        (("{ reflection = 0.3 }", "{ reflektion = 0.3 }"), "room.materials.soft.reflektion: is no known key"),
        (("[2.0, -8.0, 1.0]", "[6.0, -8.0, 1.0]"), "sources[0].trajectory: must stay 1e-06 m away from every wall"),
        (("transition = 0.002", 'transition = "slow"'), "render.transition: must be"),
        (
            ("max_order = 2", "max_order = 2\ndiffraction = 7"),
            "scene.toml: paths.diffraction: must be from 0 to 3, but is 7",
        ),
        (("max_order = 2", "max_order = 2\npath_limit = 3"), "paths.max_order: must give at most 3 paths (path_limit)"),
    ],
)
def test_errors_of_a_corner_are_one_line(corner_scene: Path, error_of, change: tuple[str, str], message: str) -> None:
    assert change[0] in CORNER_SCENE
    corner_scene.write_text(CORNER_SCENE.replace(*change), "utf-8")
    assert message in error_of("check", corner_scene)


def test_a_mesh_that_is_none_is_one_line(corner_scene: Path, error_of) -> None:
    (corner_scene.parent / "room.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 nan 0\nf 1 2 3\n")
    assert "room.obj" in error_of("check", corner_scene)


C = 343.4  # of the scene's air, m/s
SCENE = scene_text(
    source_at(
        "robot",
        {"kind": "noise", "duration": 0.05, "sampling_rate": 48e3, "seed": 1, "band": (5e3, 9e3), "fade": 0.01},
        along((1, 1, 1), (1, 2, 1), 1.0),
        directivity={"kind": "piston", "radius": 0.02},
        aim="forward",
    ),
    receiver_at("ceiling", None, positions={"kind": "grid", "x": (1.0, 3.0, 2.0), "y": 2.0, "z": 2.4}),
    receiver_at("ear", (3.0, 1.0, 2.0), directivity={"kind": "first-order"}, aim_at=(3.0, 1.0, 1.0)),
    max_order=0,
    rate=48e3,
)


def test_check_lists_where_everybody_faces(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "scene.toml").write_text(SCENE, "utf-8")
    assert main(["check", str(tmp_path / "scene.toml")]) == 0
    lines = [line for line in capsys.readouterr().out.splitlines() if ": faces (" in line]
    assert lines == [
        "sources[0]: faces (0, 1, 0) at 0 s",
        "receivers[0] to receivers[1]: faces (1, 0, 0) at 0 s, omnidirectional",
        "receivers[2]: faces (0, 0, -1) at 0 s",
    ]


def test_a_missing_tail_is_told_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """By `clsim check` and by notes of a recording, with the option's name; not where the tail is there."""
    path = tmp_path / "scene.toml"
    path.write_text(SCENE, "utf-8")
    assert main(["check", str(path)]) == 0
    told = [line for line in capsys.readouterr().out.splitlines() if "images leave" in line]
    assert len(told) == 1
    assert re.match(r'images leave -\d dB of the energy: .* \(tail = "auto" adds it\)$', told[0])
    file = load_scene(path)
    for tail in ("off", "auto"):
        recording = clsim.render(clsim.find_paths(file.scene, 0), 48e3, duration=0.1, tail=tail, tail_error_db=3.0)
        notes = [note for note in recording.notes if 'tail="auto"' in note]
        assert len(notes) == (tail == "off")


def test_check_lists_what_is_shaded_and_when(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A ball of 10 cm at 1 m/s crosses a line of sight of 2 m at 0.5 s; half its way the first Fresnel zone has 15 cm."""
    ball = """
[[scatterers]]
kind = "ellipsoid"
name = "ball"
semi_axes = [0.1, 0.1, 0.1]
shadow = true
trajectory = { kind = "line", start = [2, 0.5, 1], end = [2, 1.5, 1], duration = 1.0 }
"""
    scene = SCENE[: SCENE.index("[[receivers]]")] + SCENE[SCENE.rindex("[[receivers]]") :]
    scene = scene.replace("end = [1, 2, 1], duration = 1.0", "end = [1, 1.001, 1], duration = 1.0").replace(
        "[3.0, 1.0, 2.0]", "[3.0, 1.0, 1.0]"
    )
    scene = scene.replace("aim_at = [3.0, 1.0, 1.0]", "aim_at = [2.0, 1.0, 1.0]").replace(
        "duration = 0.05", "duration = 1.0"
    )
    for text, there in ((scene + ball, True), (scene + ball.replace("true", "false"), False)):
        (tmp_path / "scene.toml").write_text(text.replace("max_order = 0", "max_order = 1"), "utf-8")
        assert main(["check", str(tmp_path / "scene.toml")]) == 0
        lines = capsys.readouterr().out.splitlines()
        assert sum(line.startswith("shadows: ") for line in lines) == there
        assert ("no shadows: on 6 echoes of more than 0 walls (scattering_order)" in lines) == there
    (tmp_path / "scene.toml").write_text(scene + ball, "utf-8")
    assert main(["check", str(tmp_path / "scene.toml")]) == 0
    line = next(line for line in capsys.readouterr().out.splitlines() if line.startswith("shadows: "))
    begin, end = re.fullmatch(r"shadows: robot to ear by ball from (.*) to (.*) s", line).groups()
    reach = 0.1 + np.sqrt(0.5 * C / 7e3)
    assert float(begin) == pytest.approx(0.5 - reach, abs=2e-3)
    assert float(end) == pytest.approx(0.5 + reach, abs=2e-3)
