"""Reports where reflections alone are wrong: small faces, and paths that begin and end at edges."""

import warnings
from pathlib import Path

import numpy as np
import pytest

import clsim
from clsim.cli import main

SCENE = """
format = 1
[room]
kind = "plan"
outline = [[3, 0], [1.5, 2.6], [-1.5, 2.6], [-3, 0], [-1.5, -2.6], [1.5, -2.6]]
height = 3.0
materials = { default = { reflection = 0.9 } }
[[sources]]
name = "beacon"
signal = { kind = "tone", frequency = 40e3, duration = 0.02, sampling_rate = 192e3, fade = 0.005 }
trajectory = { kind = "fixed", position = [0.4, 1.3, 1.5] }
[[receivers]]
name = "robot"
trajectory = { kind = "line", start = [-1.9, 0.3, 1.2], end = [1.7, -0.8, 1.4], duration = 2.0 }
[paths]
max_order = 2
diffraction = 0
[render]
sampling_rate = 192e3
duration = 0.03
"""


def plate(side: float) -> clsim.Scene:
    """Return a square plate 2 m above a source and a receiver that are 2 m apart, in a large shoebox."""
    hard = clsim.Material.from_reflection(1.0)
    half = 0.5 * side
    corners = [(-half, -half, 0), (half, -half, 0), (half, half, 0), (-half, half, 0)]
    mesh = clsim.MeshRoom(corners, [(0, 1, 2), (0, 2, 3)], hard)
    body = clsim.Body("plate", mesh, clsim.Trajectory.fixed((5.0, 5.0, 4.0)))
    tone = clsim.Signal.tone(40e3, 0.01, 192e3)
    ends = (clsim.Trajectory.fixed((x, 5.0, 2.0)) for x in (4.0, 6.0))
    room = clsim.Shoebox((10.0, 10.0, 8.0), hard)
    return clsim.Scene(
        room, clsim.Air(absorption=False, speed_of_sound=343.0), [clsim.Source("s", tone, next(ends))], [clsim.Receiver("r", next(ends))],
        bodies=[body],
    )  # fmt: skip


def test_a_small_plate_is_warned_of() -> None:
    """The zone is 2 √(λ d/2) wide with d = √5 m to the plate and from it, and the reflection 2 / (2 √5) of the direct sound."""
    zone, level = 2e3 * np.sqrt(343.0 / 40e3 * np.sqrt(5.0) / 2.0), 20.0 * np.log10(1.0 / np.sqrt(5.0))
    told = rf"'plate.*' is 100 mm wide, the Fresnel zone .* {zone:.3g} mm: .*, {level:.0f} dB .*diffraction=1"
    with pytest.warns(clsim.ClsimWarning, match=told):
        clsim.find_paths(plate(0.1), 1)


@pytest.mark.parametrize(("side", "diffraction"), [(0.1, 1), (0.3, 0)])
def test_others_are_not(side: float, diffraction: int) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        clsim.find_paths(plate(side), 1, diffraction=diffraction)


def test_small_faces_that_images_make_whole_are_not() -> None:
    """The back of a recess 10 cm wide has two corners of 90 degrees; its two sides have edges that diffract."""
    plan = [(0, 0), (6, 0), (6, 2), (6.1, 2), (6.1, 2.1), (6, 2.1), (6, 4), (0, 4)]
    room = clsim.MeshRoom.from_plan(plan, 3.0, clsim.Material.from_reflection(0.9))
    tone = clsim.Signal.tone(40e3, 0.01, 192e3)
    near, far = (clsim.Trajectory.fixed((x, 2.05, 1.5)) for x in (4.0, 2.0))
    scene = clsim.Scene(room, clsim.Air(), [clsim.Source("s", tone, near)], [clsim.Receiver("r", far)])
    paths = clsim.find_paths(scene, 1)
    narrow = {"wall 3", "wall 4", "wall 5"} & {paths.object_names[w] for w in np.unique(paths.walls) if w >= 0}
    assert len(narrow) == 1  # the back, of 10 cm in a zone of 22 cm


def test_check_reports_jumps(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A lossy double reflection of 0.9² that ends at an edge is as loud as the direct sound over its length, at most."""
    path = tmp_path / "scene.toml"
    path.write_text(SCENE, "utf-8")
    assert main(["check", str(path)]) == 0
    said = [line for line in capsys.readouterr().out.splitlines() if "jumps" in line]
    assert len(said) == 1
    assert "diffraction = 1" in said[0]
    assert -20.0 < float(said[0].split(" dB")[0].split()[-1]) < -3.0
    path.write_text(SCENE.replace("diffraction = 0", "diffraction = 1"), "utf-8")
    assert main(["check", str(path)]) == 0
    assert "jumps" not in capsys.readouterr().out
