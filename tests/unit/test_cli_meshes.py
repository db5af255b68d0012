"""The command line on rooms of any shape."""

from pathlib import Path

import numpy as np
import pytest

from clsim.cli import main
from clsim.output.table import read_table

SCENE = """
format = 1
[room]
kind = "mesh"
path = "room.obj"
up = "y"
materials = { default = { reflection = 0.9 }, soft = { reflection = 0.3 } }
[[sources]]
name = "robot"
signal = { kind = "tone", frequency = 40e3, duration = 0.2, sampling_rate = 192e3, fade = 0.005 }
trajectory = { kind = "line", start = [2.0, -8.0, 1.0], end = [3.0, -2.0, 1.2], duration = 0.2 }
[[receivers]]
name = "corner"
trajectory = { kind = "fixed", position = [7.0, -1.0, 1.5] }
[paths]
max_order = 2
[render]
sampling_rate = 192e3
transition = 0.002
"""
# An L-shaped room, 3 m high, y up; the floor is one concave polygon.
CORNERS = [(0, 0), (8, 0), (8, 5), (4, 5), (4, 9), (0, 9)]


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    lines = [f"v {x} {y} {z}" for y in (0, 3) for x, z in CORNERS]
    lines += ["usemtl soft", "f " + " ".join(str(i + 1) for i in range(6)), "usemtl hard"]
    lines += ["f " + " ".join(str(i + 7) for i in range(6))]
    lines += [f"f {i + 1} {(i + 1) % 6 + 1} {(i + 1) % 6 + 7} {i + 7}" for i in range(6)]
    (tmp_path / "room.obj").write_text("\n".join(lines))
    path = tmp_path / "scene.toml"
    path.write_text(SCENE, "utf-8")
    return path


def test_check_tells_what_the_mesh_is_like(scene: Path, capsys) -> None:
    assert main(["check", str(scene)]) == 0
    printed = capsys.readouterr().out
    assert "room: 20 triangles, 8 walls in 8 planes, 8 x 9 x 3 m from (0, -9, 0) m" in printed
    assert "room: watertight" in printed
    assert "room: 2 concave polygons were ear-clipped." in printed
    assert "receivers[0]: 'corner' is inside at 0 s" in printed
    assert "come and go" in printed


def test_paths_lists_those_that_are_heard(scene: Path, tmp_path: Path, capsys) -> None:
    assert main(["paths", str(scene), "--at", "0.01"]) == 0
    first = capsys.readouterr().out
    assert main(["paths", str(scene), "--at", "0.19"]) == 0
    last = capsys.readouterr().out
    assert "direct" not in first
    assert "direct" in last
    assert "room soft" in last
    assert "nan" not in first + last


@pytest.mark.usefixtures("device")
def test_run_draws_how_paths_come_and_go(scene: Path, tmp_path: Path, capsys) -> None:
    out = tmp_path / "out"
    assert main(["run", str(scene), "-o", str(out)]) == 0
    names = {p.name for p in out.iterdir()}
    assert {
        "corner.wav",
        "corner_spectrogram.png",
        "corner_echogram.png",
        "corner_paths.png",
        "paths.npz",
        "scene.toml",
    } == names
    assert {Path(line).name for line in capsys.readouterr().out.split()} == names
    table = read_table(out / "paths.npz")
    assert np.any(np.isnan(table.delay))
    assert main(["check", str(out / "scene.toml")]) == 0, "the completed scene finds the mesh from its own folder"


def test_view_writes_a_page(scene: Path, capsys) -> None:
    assert main(["view", str(scene), "--frames", "5"]) == 0
    page = scene.with_suffix(".html")
    assert capsys.readouterr().out.split() == [str(page)]
    assert "window.clsim" in page.read_text("utf-8")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (('path = "room.obj"', 'path = "none.obj"'), "none.obj: "),
        (('up = "y"', 'up = "w"'), "room.up: must be 'x', 'y' or 'z'"),
        (("soft = {", "glass = {"), "room.materials.glass: is no group of room.obj, whose groups are 'soft', 'hard'"),
        (("[2.0, -8.0, 1.0]", "[6.0, -8.0, 1.0]"), "sources[0].trajectory: must stay 1e-06 m away from every wall"),
        (("transition = 0.002", 'transition = "slow"'), "render.transition: must be"),
        (("max_order = 2", "max_order = 2\npath_limit = 3"), "paths.max_order: must give at most 3 paths (path_limit)"),
        (("max_order = 2", 'max_order = 2\nfinder = "guess"'), "paths.finder: must be"),
        (("max_order = 2", "max_order = 21"), "paths.max_order: must be from 0 to 20"),
    ],
)
def test_errors_are_one_line_and_status_2(scene: Path, capsys, change: tuple[str, str], message: str) -> None:
    scene.write_text(SCENE.replace(*change), "utf-8")
    assert main(["check", str(scene)]) == 2
    printed = capsys.readouterr()
    assert printed.err.startswith("clsim: error: ")
    assert printed.err.count("\n") == 1
    assert message in printed.err


def test_a_mesh_that_is_none_is_one_line(scene: Path, capsys) -> None:
    (scene.parent / "room.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 nan 0\nf 1 2 3\n")
    assert main(["check", str(scene)]) == 2
    assert "room.obj" in capsys.readouterr().err
