"""Scatterers that cannot be, in scenes and in scene files; people in files."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from made_sonar import SCENE, sonar, sonar_paths

import clsim
from clsim.cli import main
from clsim.paths.path_set import PathSet
from clsim.scene_file.scene import SceneFile, completed_scene


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> SceneFile:
    """Return the scene file, read."""
    return sonar(tmp_path_factory.mktemp("sonar"))


@pytest.fixture(scope="module")
def paths(file: SceneFile) -> PathSet:
    """Return its paths."""
    return sonar_paths(file)


BAD = [
    (lambda t: clsim.Scatterer.sphere("a", 0.0, t), "radius: must be above 0 m, but is 0"),
    (lambda t: clsim.Scatterer.sphere("a", 0.1, t, model="exact"), "model"),
    (lambda t: clsim.Scatterer.ellipsoid("a", (0.1, -0.1, 0.1), t), r"semi_axes\[1\]: must be above 0 m, but is -0.1"),
    (lambda t: clsim.Scatterer.point("a", 61.0, t), "target_strength_db: must be at most 60 dB, but is 61"),
    (lambda t: clsim.Scatterer.capsule("a", 0.1, 0.0, t), "length: must be above 0 m, but is 0"),
    (lambda t: clsim.Scatterer.capsule("a", -0.1, 0.1, t), "radius: must be above 0 m, but is -0.1"),
    (lambda t: clsim.Scatterer.point(" ", 0.0, t), "name: must be a text"),
    (lambda t: clsim.Scatterer.point("a", 0.0, (1, 2, 3)), "trajectory: must be a Trajectory"),
]


@pytest.mark.parametrize(("make", "message"), BAD)
def test_what_is_no_scatterer(make: Any, message: str) -> None:
    with pytest.raises(clsim.InputError, match=message):
        make(clsim.Trajectory.fixed((3.0, 2.0, 1.0)))


FIXED, LINE = clsim.Trajectory.fixed, clsim.Trajectory.line
REFUSED = [
    ([clsim.Scatterer.sphere("b", 1.0, FIXED((1.5, 2.0, 1.0)))], r"scatterers\[0\].*'sonar' is in 'b' or nearer.* at 0 s"),
    ([clsim.Scatterer.ellipsoid("b", (0.5, 0.1, 0.1), LINE((3, 2.05, 1), (1.2, 2.05, 1), 0.2))], "'sonar' is in 'b'"),
    ([clsim.Scatterer.capsule("b", 0.1, 0.5, LINE((3, 2, 1.2), (1, 2, 1.3), 0.2))], r"'sonar' is in 'b' or nearer.* at 0\.\d+ s"),
    ([clsim.Scatterer.point("b", 0.0, LINE((3, 2, 1), (7, 2, 1), 0.2))], r"scatterers\[0\].trajectory: must stay inside"),
    ([clsim.Scatterer.point("b", 0.0, LINE((1.5, 4, 1), (2.5, 4, 1), 0.01))], "must last as long as all signals"),
    ([clsim.Scatterer.point("b", 0.0, clsim.Trajectory.circle((3, 2.5, 1.5), 1.0, 0.015, 0.2))], "speed of sound"),
    ([clsim.Scatterer.capsule("b", 0.1, 0.9, clsim.Trajectory.waypoints(
        [0.0, 0.1, 0.102, 0.2], [(3, 2, 1.0)] * 4, [(0, 0, 0, 1), (0, 0, 0, 1), (0, 0.9, 0, 0.4358898943540674), (0, 1, 0, 0)],
    ))], r"scatterers\[0\].trajectory: must keep the surface below .*'b' may move at .* m/s, about 0.1(0[0-2])? s"),
    ([clsim.Scatterer.point("b", 0.0, FIXED((3, 2, 1)))] * 2, r"scatterers\[1\].name: must be unique"),
    ("b", "scatterers: must be a list"), ([3], r"scatterers\[0\]: must be a Scatterer"),
]  # fmt: skip


@pytest.mark.parametrize(("scatterers", "message"), REFUSED)
def test_what_cannot_be_in_a_scene(paths: PathSet, scatterers: Any, message: str) -> None:
    with pytest.raises(clsim.InputError, match=message):
        clsim.Scene(
            paths.scene.room, clsim.Air(), paths.scene.sources, paths.scene.receivers, scatterers=scatterers
        )  # fmt: skip
    # Beside the flat side of an ellipsoid there is room within its longest semi-axis.
    flat = clsim.Scatterer.ellipsoid("b", (0.02, 0.5, 0.5), FIXED((1.1, 2.0, 1.0)))
    clsim.Scene(paths.scene.room, clsim.Air(), paths.scene.sources, paths.scene.receivers, scatterers=[flat])


@pytest.mark.parametrize(
    "air",
    [
        clsim.Air(temperature_celsius=(20.0, 24.0), heights=(0.0, 3.0)),
        clsim.Air(fluctuation=clsim.Fluctuation(2e-6, 0.5, 0.3)),
    ],
)
def test_air_that_no_leg_knows_is_refused(paths: PathSet, air: clsim.Air) -> None:
    scene = clsim.Scene(
        paths.scene.room, air, paths.scene.sources, paths.scene.receivers, scatterers=paths.scene.scatterers
    )  # fmt: skip
    with pytest.raises(clsim.InputError, match="scatterers: must be left out where the air depends on the height"):
        clsim.find_paths(scene, 0)
    with pytest.raises(clsim.InputError, match="scatterers: must be left out where the air depends on the height"):
        clsim.scatterer_truth(scene, [0.1])


PEOPLE = """
[[scatterers]]
kind = "person"
name = "Ada"
height = 1.7
trajectory = { kind = "line", start = [4.0, 2.0, 0.0], end = [3.8, 2.0, 0.0], duration = 0.2 }
[[scatterers]]
kind = "captured-person"
name = "Bob"
path = "arm.csv"
segments = [{ start = "elbow", end = "wrist", radius = 0.04 }]
shape = "capsule"
translate = [1.0, 0.0, 0.0]
[[scatterers]]
kind = "hand"
name = "fist"
trajectory = { kind = "fixed", position = [2.0, 2.0, 1.5] }
opening = [[0.0, 1.0], [0.2, 0.0]]
"""


def test_people_in_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """They are those from Python; the completed scene is the same one from elsewhere; what is wrong has its field."""
    rows = "\n".join(f"{t / 10},2,3,1,2.3,3,{1 + t / 30}" for t in range(4))
    (tmp_path / "arm.csv").write_text("t,elbow x,elbow y,elbow z,wrist x,wrist y,wrist z\n" + rows, "utf-8")
    text = SCENE.replace("[paths]", PEOPLE + "[paths]")
    (tmp_path / "scene.toml").write_text(text, "utf-8")
    file = clsim.load_scene(tmp_path / "scene.toml")
    people = [s for s in file.scene.scatterers if s.name not in ("hand", "ball", "bat")]
    way = clsim.Trajectory.line((4.0, 2.0, 0.0), (3.8, 2.0, 0.0), 0.2)
    arm = clsim.captured_person(
        "Bob", tmp_path / "arm.csv", segments=[("elbow", "wrist", 0.04)], shape="capsule", translate=(1.0, 0.0, 0.0)
    )
    fist = clsim.hand("fist", clsim.Trajectory.fixed((2.0, 2.0, 1.5)), opening=[(0.0, 1.0), (0.2, 0.0)])
    wanted = [*clsim.walking_person("Ada", 1.7, way), *arm, *fist]
    assert [s.name for s in people] == [s.name for s in wanted]
    for one, other in zip(people, wanted, strict=True):
        np.testing.assert_array_equal(one.trajectory.position(0.13), other.trajectory.position(0.13))
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "again.toml").write_text(completed_scene(file, tmp_path / "other"), "utf-8")
    assert 'path = "../arm.csv"' in (tmp_path / "other" / "again.toml").read_text("utf-8")
    again = clsim.load_scene(tmp_path / "other" / "again.toml")
    assert [s.name for s in again.scene.scatterers] == [s.name for s in file.scene.scatterers]
    for old, new, message in (
        ("end = [3.8, 2.0, 0.0]", "end = [-99.0, 2.0, 0.0]", "scatterers[3].trajectory: must walk at 0.0901 to 2.7 m/s, but is at 515 m/s at 0 s"),
        ('end = "wrist"', 'end = "toe"', "scatterers[4].segments[0]: must name joints of the file (elbow, wrist), but names 'toe'"),
        ("opening = [[0.0, 1.0]", "opening = [[0.0, 2.0]", "scatterers[5].opening[0][1]: must be at most 1, but is 2"),
        ('path = "arm.csv"', 'path = "leg.csv"', "scatterers[4].path: cannot read"),
        ("position = [2.0, 2.0, 1.5]", "position = [1.0, 2.0, 1.05]", "'sonar' is in 'fist palm' or nearer to it at (1, 2, 1) m at 0 s"),
    ):  # fmt: skip
        (tmp_path / "scene.toml").write_text(text.replace(old, new), "utf-8")
        assert main(["check", str(tmp_path / "scene.toml")]) == 2
        assert message in capsys.readouterr().err


def test_files_name_what_is_wrong(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for old, new, message in (
        ("radius = 0.03", "radius = -0.03", "scatterers[1].radius"), ('kind = "sphere"', 'kind = "cube"', "scatterers[1].kind"),
        ("correlation_time = 0.05", "correlation_time = 0.0", "scatterers[2].fluctuation.correlation_time"),
        ("scattering_order = 1", "scattering_order = 4", "paths.scattering_order"),
        ("scattering_order = 1", 'direct = [{ source = "sonar", receiver = "nose" }]', "paths.direct: must name a receiver"),
        ("[paths]", "[air]\ntemperature_celsius = [20.0, 24.0]\n[paths]", "error: scatterers: must be left out where the air depends on"),
        ("scattering_order = 1", "direct = 0", "paths.direct: must be true, false or a level below 0 dB"),
        ("scattering_order = 1", 'direct = [{ source = "sonar" }]', "paths.direct[0].receiver: must be given"),
    ):  # fmt: skip
        (tmp_path / "scene.toml").write_text(SCENE.replace(old, new), "utf-8")
        assert main(["check", str(tmp_path / "scene.toml")]) == 2
        assert message in capsys.readouterr().err
