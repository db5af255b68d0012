"""Edges of bodies from a scene file to the files that come of it: one door, run, stopped and resumed, seen, varied."""

from pathlib import Path

import numpy as np
import pytest
from failing import stopped_and_resumed
from scene_texts import receiver_at, scene_text, shoebox_of, source_at, thing_at, tone_of

import clsim
from clsim.cli import main
from clsim.paths.view import view_scene, viewed
from clsim.scene_file.scene import build_scene
from clsim.study.content import computed
from clsim.study.file import load_study

SCENE = scene_text(
    source_at("beacon", tone_of(24e3, 0.11, 96e3, fade=0.002), (1.0, 1.4, 1.0)),
    receiver_at("ear", (3.0, 1.5, 1.2)),
    thing_at(
        "bodies",
        "door",
        {"kind": "swing", "axis_point": (2.0, 0.6, 0.0), "axis": (0, 0, 1), "angles": (0, -0.1), "times": (0, 0.2)},
        kind="box",
        size=(0.0, 0.9, 2.0),
        centre=(0.0, 0.5, 1.1),
        material={"reflection": 0.9},
    ),
    room=shoebox_of(reflection=0.5),
    max_order=0,
    paths={"diffraction": 1},
    render={"duration": 0.12, "chunk": 18432},
)
STUDY = 'format = 1\nscene = "scene.toml"\nkeep = ["ground_truth"]\n[[vary]]\nfield = "paths.diffraction_model"\nvalues = ["utd", "btm"]\n'


def test_a_door_is_run_and_gone_on_with(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], device: None
) -> None:
    """The line of sight is hidden all the time: all that is heard comes over edges of the door."""
    path = tmp_path / "scene.toml"
    path.write_text(SCENE, "utf-8")
    without = tmp_path / "without.toml"
    without.write_text(SCENE.replace("diffraction = 1", "diffraction = 0"), "utf-8")
    out = stopped_and_resumed(monkeypatch, path, tmp_path, other=without)
    assert "scene.paths.diffraction was 1 and is 0" in capsys.readouterr().err
    assert "diffraction = 1" in (out / "scene.completed.toml").read_text("utf-8")
    with np.load(out / "ground_truth.npz") as found:
        assert not found["line_of_sight"].any()
        assert found["body_names"].tolist() == ["door"]
    recorded = clsim.load_recording(out)
    assert np.abs(recorded.pressure).max() > 0.01 / 2.0, "over the door's near edge"


def test_a_door_in_tables_pages_and_studies(tmp_path: Path, capsys: pytest.CaptureFixture[str], device: None) -> None:
    """Every way by which something is heard is over an edge of the door, and is told so."""
    pytest.importorskip("zarr")
    path = tmp_path / "scene.toml"
    path.write_text(SCENE, "utf-8")
    file = clsim.load_scene(path)
    paths = clsim.find_paths(file.scene, **file.paths)
    assert len(clsim.find_paths(file.scene, 0)) == 0
    table = paths.table(np.array([0.04]))
    ways = [table.name_objects(i) for i in np.flatnonzero(table.audible[:, 0])]
    assert ways
    assert all("edge door" in way for way in ways)
    assert main(["paths", str(path), "--at", "0.04"]) == 0
    assert "edge door" in capsys.readouterr().out
    view = viewed(paths, duration=0.05, frames=2)
    assert any("edge door" in label for label in view.frames[1].labels)
    view_scene(paths, tmp_path / "view.html", duration=0.05, frames=2)
    assert "edge door" in (tmp_path / "view.html").read_text("utf-8")

    (tmp_path / "study.toml").write_text(STUDY, "utf-8")
    study = load_study(tmp_path / "study.toml")
    content = computed(study, study.members[0], None, tmp_path / "member").content
    assert not content.line_of_sight.any()
    assert content.body_visible.values.all(), "its nearest point, from the side of the source"
    models = [build_scene(study.content_of(member), tmp_path).paths["diffraction_model"] for member in study.members]
    assert models == ["utd", "btm"]
    exact = clsim.find_paths(file.scene, **{**file.paths, "diffraction_model": "btm"})
    assert exact.digest() != paths.digest()
