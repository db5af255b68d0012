"""`clsim check` lists where sources and receivers face."""

from pathlib import Path

import pytest

from clsim.cli import main

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
