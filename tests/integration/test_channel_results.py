"""Runs of scene files with receivers of several channels: every store, workers, and damaged files of heads."""

from __future__ import annotations

import numpy as np
import pytest
import soundfile

import clsim
from clsim.cli import main

SCENE = """format = 1

[room]
kind = "shoebox"
size = [8.0, 6.0, 3.0]
walls = { reflection = 0.8 }

[[sources]]
name = "s"
trajectory = { kind = "line", start = [2.0, 2.0, 1.5], end = [3.0, 3.0, 1.6], duration = 1.0 }
signal = { kind = "tone", frequency = 1000.0, duration = 0.2, sampling_rate = 16000.0, fade = 0.02 }

[[receivers]]
name = "hoa"
trajectory = { kind = "fixed", position = [5.0, 4.0, 1.2] }
directivity = { kind = "ambisonic", order = 1 }
electronics = { self_noise_db = 20.0, low_cut = 20.0 }

[[receivers]]
name = "omni"
trajectory = { kind = "fixed", position = [6.0, 4.0, 1.2] }

[paths]
max_order = 1

[render]
sampling_rate = 16000.0
duration = 0.25
"""


@pytest.fixture
def scene(tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text(SCENE)
    return path


@pytest.mark.parametrize(("store", "more"), [("wav", []), ("zarr", []), ("hdf5", []), ("zarr", ["--workers", "2"])])
def test_runs_keep_all_channels(scene, tmp_path, store, more):
    folder = tmp_path / "results"
    assert main(["run", str(scene), "-o", str(folder), "--store", store, "--no-plots", *more]) == 0
    file = clsim.load_scene(scene)
    expected = clsim.render(clsim.find_paths(file.scene, max_order=1), 16e3, duration=0.25)
    found = clsim.load_recording(folder)
    assert found.channels == (*(("hoa", f"ACN{i}") for i in range(4)), ("omni", ""))
    np.testing.assert_array_equal(found.samples, expected.samples)
    np.testing.assert_array_equal(clsim.load_recording(folder, ["omni"]).samples, expected.samples[4:])
    if store == "wav":
        frames, rate = soundfile.read(folder / "hoa.wav", dtype="float32")
        assert rate == 16e3
        np.testing.assert_array_equal(frames.T, expected.samples[:4])
        assert b"<NAME>ACN3</NAME>" in (folder / "hoa.wav").read_bytes()[:2000]


def test_a_damaged_head_is_one_line_and_status_2(scene, tmp_path, capsys):
    pytest.importorskip("sofar")
    (tmp_path / "head.sofa").write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(100))
    scene.write_text(SCENE.replace('{ kind = "ambisonic", order = 1 }', '{ kind = "head", path = "head.sofa" }'))
    assert main(["check", str(scene)]) == 2
    said = capsys.readouterr().err.strip().splitlines()
    assert len(said) == 1
    assert "head.sofa" in said[0]
