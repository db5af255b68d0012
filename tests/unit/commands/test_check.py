"""Lines of `clsim check`: where sources and receivers face, and the energy that images leave."""

import re
from pathlib import Path

import numpy as np
import pytest

import clsim
from clsim.cli import main
from clsim.scene_file import load_scene

C = 343.4  # of the scene's air, m/s
SCENE = """
format = 1
[room]
kind = "shoebox"
size = [4.0, 3.0, 2.5]
walls = { reflection = 0.9 }
[[sources]]
name = "robot"
signal = { kind = "noise", duration = 0.05, sampling_rate = 48e3, seed = 1, band = [5e3, 9e3], fade = 0.01 }
trajectory = { kind = "line", start = [1, 1, 1], end = [1, 2, 1], duration = 1.0 }
directivity = { kind = "piston", radius = 0.02 }
aim = "forward"
[[receivers]]
name = "ceiling"
positions = { kind = "grid", x = [1.0, 3.0, 2.0], y = 2.0, z = 2.4 }
[[receivers]]
name = "ear"
trajectory = { kind = "fixed", position = [3.0, 1.0, 2.0] }
directivity = { kind = "first-order" }
aim_at = [3.0, 1.0, 1.0]
[paths]
max_order = 0
[render]
sampling_rate = 48e3
"""


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
        (tmp_path / "scene.toml").write_text(text, "utf-8")
        assert main(["check", str(tmp_path / "scene.toml")]) == 0
        lines = [line for line in capsys.readouterr().out.splitlines() if line.startswith("shadows: ")]
        assert len(lines) == there
    (tmp_path / "scene.toml").write_text(scene + ball, "utf-8")
    assert main(["check", str(tmp_path / "scene.toml")]) == 0
    line = next(line for line in capsys.readouterr().out.splitlines() if line.startswith("shadows: "))
    begin, end = re.fullmatch(r"shadows: robot to ear by ball from (.*) to (.*) s", line).groups()
    reach = 0.1 + np.sqrt(0.5 * C / 7e3)
    assert float(begin) == pytest.approx(0.5 - reach, abs=2e-3)
    assert float(end) == pytest.approx(0.5 + reach, abs=2e-3)
