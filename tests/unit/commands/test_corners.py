"""What commands say of a room with a corner, round which no path of the search may lead."""

from pathlib import Path

import numpy as np
import pytest
from scene_texts import along, receiver_at, scene_text, source_at, tone_of

from clsim.cli import main
from clsim.output.result_files import read_table

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
def test_a_receiver_outside_is_refused_by_name_by_every_command(
    corner_scene: Path, tmp_path: Path, capsys, door: str
) -> None:
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
        (("max_order = 2", "max_order = 2\npath_limit = 3"), "paths.max_order: must give at most 3 paths (path_limit)"),
    ],
)
def test_errors_of_a_corner_are_one_line(corner_scene: Path, capsys, change: tuple[str, str], message: str) -> None:
    assert change[0] in CORNER_SCENE
    corner_scene.write_text(CORNER_SCENE.replace(*change), "utf-8")
    assert main(["check", str(corner_scene)]) == 2
    printed = capsys.readouterr()
    assert printed.err.startswith("clsim: error: ")
    assert printed.err.count("\n") == 1
    assert message in printed.err


def test_a_mesh_that_is_none_is_one_line(corner_scene: Path, capsys) -> None:
    (corner_scene.parent / "room.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 nan 0\nf 1 2 3\n")
    assert main(["check", str(corner_scene)]) == 2
    assert "room.obj" in capsys.readouterr().err
