"""From a scene file to a recording there is one way: a run and a study's member differ in nothing but where results go."""

import json
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
import soundfile

import clsim
from clsim.cli import main
from clsim.study.file import load_study
from clsim.study.member import run_member, study_to_settings
from clsim.workflow.checkpoint import run_identity
from clsim.workflow.pipeline import plan_scene

# Round the corner of an L no path of order 0 leads; the converter clips, so that there is another warning.
SCENE = """
format = 1
[room]
kind = "plan"
outline = [[0, 0], [8, 0], [8, 2], [2, 2], [2, 6], [0, 6]]
height = 3.0
materials = { default = { reflection = 0.8 } }
[[sources]]
name = "robot"
signal = { kind = "tone", frequency = 40e3, duration = 0.01, sampling_rate = 192e3, fade = 0.002, amplitude = 5.0 }
trajectory = { kind = "line", start = [1.0, 5.0, 1.4], end = [1.1, 4.6, 1.5], duration = 0.2 }
[[receivers]]
name = "near"
trajectory = { kind = "fixed", position = [1.5, 3.0, 1.0] }
transducer = { kind = "resonance", frequency = 40e3, width = 3e3, sensitivity = 0.01 }
electronics = { adc_bits = 12, adc_full_scale = 0.005 }
[[receivers]]
name = "far"
trajectory = { kind = "fixed", position = [7.0, 1.0, 1.0] }
[paths]
max_order = 0
[render]
sampling_rate = 192e3
engine = "%s"
"""
STUDY = """
format = 1
scene = "scene.toml"
keep = ["recording", "ground_truth", "paths"]
[[vary]]
field = "sources[0].trajectory.end[0]"
name = "end"
values = [1.1]
"""


@pytest.fixture
def folder(tmp_path: Path, engine: str) -> Path:
    (tmp_path / "scene.toml").write_text(SCENE % engine, "utf-8")
    (tmp_path / "study.toml").write_text(STUDY, "utf-8")
    return tmp_path


def test_a_member_is_a_run(folder: Path, capsys) -> None:
    xarray = pytest.importorskip("xarray")
    pytest.importorskip("zarr")
    assert main(["run", str(folder / "scene.toml"), "-o", str(folder / "out"), "--no-plots"]) == 0
    warned = [line.removeprefix("clsim: warning: ") for line in capsys.readouterr().err.splitlines()]
    assert any("no path reaches 'far'" in line for line in warned)
    assert any("clip" in line for line in warned)

    study = load_study(folder / "study.toml")
    (folder / "study.json").write_text(json.dumps(study_to_settings(study)), "utf-8")
    (folder / "study.zarr").mkdir()
    row = run_member(str(folder), 0, None)
    assert row["status"] == "finished", row["error"]
    told = [" ".join(text.split()).replace("diffraction=1", "diffraction = 1") for text in row["warnings"]]
    assert told == warned  # but for the words of scene files
    with xarray.open_zarr(folder / "study.zarr" / "m000000") as member:
        identity = json.loads(member.attrs["identity"])
        for name, sound in zip(member.receiver.values, member.sound.values, strict=True):
            np.testing.assert_array_equal(soundfile.read(folder / "out" / f"{name}.wav", dtype="float32")[0], sound)
        assert np.abs(member.sound.values[0]).max() > 0.0
        # The text of the scene is the same, too, but for where it stands.
        assert member.attrs["scene"] == (folder / "out" / "scene.completed.toml").read_text("utf-8")
    record = json.loads((folder / "out" / "clsim.json").read_text("utf-8"))["identity"]
    assert record.pop("options") == {"store": "wav", "table_rate": 100.0}
    assert record == identity


@pytest.mark.filterwarnings("ignore::clsim.ClsimWarning")
def test_identity_changes_with_what_samples_depend_on(folder: Path) -> None:
    def identity(old: str = "", new: str = "") -> dict:
        text = (folder / "scene.toml").read_text("utf-8")
        assert old in text
        (folder / "other.toml").write_text(text.replace(old, new) if old else text, "utf-8")
        return json.loads(json.dumps(run_identity(plan_scene(clsim.load_scene(folder / "other.toml")))))

    same, again = identity(), identity()
    assert same == again
    for old, new in (("0.8", "0.7"), ("[1.1, 4.6", "[1.2, 4.6"), ("[render]", '[render]\namplitude = "static"')):
        assert identity(old, new) != same


def test_errors_of_members_name_the_field_of_the_scene_file(folder: Path) -> None:
    pytest.importorskip("xarray")
    (folder / "study.toml").write_text(
        STUDY.replace("sources[0].trajectory.end[0]", "paths.max_order").replace("1.1", "-1")
    )
    study = load_study(folder / "study.toml")
    (folder / "study.json").write_text(json.dumps(study_to_settings(study)), "utf-8")
    row = run_member(str(folder), 0, None)
    assert row["status"] == "failed"
    assert row["error"].startswith("paths.max_order: must be ")


def test_a_device_of_this_machine_is_not_part_of_the_scene(tmp_path: Path) -> None:
    (tmp_path / "scene.toml").write_text(SCENE % "opencl", "utf-8")
    file = clsim.load_scene(tmp_path / "scene.toml")
    here = file.on_device("0:0")
    assert (here.render["device"], here.paths["device"], here.model.render.device) == ("0:0", "0:0", None)
    asked = file.with_render(device="some", duration=0.125)
    assert asked.on_device("0:0") is asked
    assert (asked.render["device"], asked.paths["device"], asked.model.render.device) == ("some", "some", "some")
    assert (asked.render["duration"], asked.model.render.duration) == (0.125, 0.125)
    assert (file.render["device"], file.model.render.device, file.render["duration"]) == (None, None, None)


@pytest.mark.filterwarnings("ignore::clsim.ClsimWarning")
def test_members_are_rendered_in_bounded_memory(tmp_path: Path, device) -> None:
    """Sound goes chunk by chunk into the store, and into the file that metrics read."""
    xarray = pytest.importorskip("xarray")
    pytest.importorskip("zarr")
    scene = (SCENE % "opencl").replace("[render]", "[render]\nchunk = 18432\nduration = 8.0")
    (tmp_path / "scene.toml").write_text(scene, "utf-8")
    (tmp_path / "judge.py").write_text(
        "def last(recording, paths, parameters):\n    return {'last': recording.samples[:, -1], 'peak': abs(recording.samples[0, :9999]).max()}\n",
        "utf-8",
    )
    study = STUDY.replace('"ground_truth", "paths"]', '"metrics"]\nmetrics = "judge:last"').replace("1.1]", "1.1, 1.2]")
    (tmp_path / "study.toml").write_text(study, "utf-8")
    (tmp_path / "study.json").write_text(json.dumps(study_to_settings(load_study(tmp_path / "study.toml"))), "utf-8")
    (tmp_path / "study.zarr").mkdir()
    assert run_member(str(tmp_path), 0, None)["status"] == "finished"  # which loads and builds what stays
    tracemalloc.start()
    row = run_member(str(tmp_path), 1, None)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert row["status"] == "finished", row["error"]
    with xarray.open_zarr(tmp_path / "study.zarr" / "m000001") as member:
        assert member.sound.shape == (2, 8 * 192_000)
        assert member["peak"] == np.abs(member.sound.values[0, :9999]).max() > 0.0
        np.testing.assert_array_equal(member["last"].values, member.sound.values[:, -1])
    assert peak < 0.5 * 4 * 2 * 8 * 192_000
    assert list((tmp_path / ".partial").iterdir()) == []
