"""Diffuse tails in runs: killed and gone on with, in stores, in studies, by both engines."""

import signal
from pathlib import Path

import numpy as np
import pytest
import soundfile
from killing import Killer
from scene_texts import along, chirp_of, receiver_at, scene_text, source_at

import clsim
from clsim.cli import main

SCENE = scene_text(
    source_at("moving", chirp_of(1e3, 3e3, 3.0, 16e3, window="tukey"), along((1, 1, 1), (2, 1, 1), 5.0)),
    source_at("still", chirp_of(3e3, 1e3, 3.0, 16e3, window="tukey"), (3.0, 1.0, 1.5)),
    receiver_at(
        "turning",
        {
            "kind": "waypoints",
            "times": (0, 5),
            "positions": [(2, 2, 1), (2.3, 1.7, 1.2)],
            "orientations": [(0, 0, 0, 1), (0, 0, 0.8, 0.6)],
            "smooth": False,
        },
        directivity={"kind": "first-order", "weight": 0.5},
    ),
    receiver_at("fixed", (3.0, 2.0, 2.0)),
    room={"kind": "shoebox", "size": (4.0, 3.0, 2.5), "walls": {"reflection": 0.6, "scattering": 0.3}},
    rate=16e3,
    render={"chunk": 18432, "tail": "auto", "tail_directions": 16, "tail_error_db": 3.0},
)


STUDY = """
format = 1
scene = "scene.toml"
metrics = "judge:level"
keep = ["recording", "metrics"]
[[vary]]
field = "render.tail_seed"
name = "seed"
values = [0, 1]
"""
JUDGE = """
import numpy as np


def level(recording, paths, parameters):
    return {"rms": np.sqrt(np.mean(recording.samples**2, axis=1))}
"""
NAMES = ("turning.wav", "fixed.wav")


def command(scene: Path, out: Path, *more: str) -> list[str]:
    return ["run", str(scene), "-o", str(out), "--no-plots", "--table", "none", *more]


def sound(out: Path) -> np.ndarray:
    return np.stack([soundfile.read(out / name, dtype="float32")[0] for name in NAMES])


def error_db(found: np.ndarray, wanted: np.ndarray) -> float:
    return float(10.0 * np.log10(np.mean((found - wanted) ** 2) / np.mean(wanted**2)))


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    path = tmp_path / "scene.toml"
    path.write_text(SCENE, "utf-8")
    return path


def test_runs_are_gone_on_with_to_the_last_bit(killer: Killer, scene: Path, tmp_path: Path, device: None) -> None:
    """Two sources, one of which moves, a receiver that turns with its beam, and one that stands still."""
    pytest.importorskip("zarr")
    out = tmp_path / "out"
    assert main(command(scene, tmp_path / "whole")) == 0
    assert killer.run(command(scene, out, "--store", "zarr"), out, event=3, of="journal.npz") == -signal.SIGKILL
    assert killer.run(command(scene, out, "--store", "zarr", "--resume"), out) == 0, killer.log
    with clsim.open_store(out) as found:
        np.testing.assert_array_equal(found.sound.values, sound(tmp_path / "whole"))


@pytest.mark.exhaustive
def test_both_engines_and_studies_hear_the_same(scene: Path, tmp_path: Path, device: None) -> None:
    """The tails of both are the same within -60 dB (filters of -70 dB each); a seed's is the same everywhere."""
    zarr = pytest.importorskip("zarr")
    (tmp_path / "study.toml").write_text(STUDY, "utf-8")
    (tmp_path / "judge.py").write_text(JUDGE, "utf-8")
    assert main(command(scene, tmp_path / "opencl")) == 0
    assert main(command(scene, tmp_path / "reference", "--engine", "reference")) == 0
    heard = sound(tmp_path / "opencl")
    assert error_db(sound(tmp_path / "reference"), heard) < -60.0
    scene.write_text(SCENE.replace('tail = "auto"', 'tail = "off"'), "utf-8")
    assert main(command(scene, tmp_path / "off")) == 0
    images = sound(tmp_path / "off")
    images = np.pad(images, ((0, 0), (0, heard.shape[1] - images.shape[1])))
    assert -10.0 < error_db(images, heard) < -1.0  # it is heard
    scene.write_text(SCENE, "utf-8")
    assert main(["study", str(tmp_path / "study.toml"), "-o", str(tmp_path / "study")]) == 0
    members = [zarr.open(tmp_path / "study" / "study.zarr")[f"m00000{i}/sound"][:] for i in range(2)]
    np.testing.assert_array_equal(members[0], heard)
    assert error_db(members[1][:, :49_000], heard[:, :49_000]) > -20.0  # another seed, another tail
