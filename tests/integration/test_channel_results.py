"""Runs of scene files with receivers of several channels: every store, workers, and damaged files of heads."""

from __future__ import annotations

import numpy as np
import pytest
import soundfile
from exhaustive import few
from scene_texts import along, receiver_at, scene_text, shoebox_of, source_at, tone_of
from test_heads import sofa_file

import clsim
from clsim.cli import main

SCENE = scene_text(
    source_at("s", tone_of(1e3, 0.2, 16e3, fade=0.02), along((2.0, 2.0, 1.5), (3.0, 3.0, 1.6), 1.0)),
    receiver_at(
        "hoa", (5.0, 4.0, 1.2), directivity={"kind": "ambisonic", "order": 1},
        electronics={"self_noise_db": 20.0, "low_cut": 20.0},
    ),
    receiver_at("omni", (6.0, 4.0, 1.2)),
    receiver_at("head", (6.0, 3.0, 1.2), directivity={"kind": "spherical-head"}),
    room=shoebox_of(8.0, 6.0, 3.0, reflection=0.8),
    rate=16e3,
    render={"duration": 0.25},
)  # fmt: skip


@pytest.fixture
def scene(tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text(SCENE)
    return path


@pytest.mark.parametrize(
    ("store", "more"), few([("wav", []), ("zarr", []), ("hdf5", []), ("zarr", ["--workers", "2"])], kept=(0, 2))
)  # the array is in Zarr, by workers
def test_runs_keep_all_channels(scene, tmp_path, store, more):
    folder = tmp_path / "results"
    assert main(["run", str(scene), "-o", str(folder), "--store", store, "--no-plots", *more]) == 0
    file = clsim.load_scene(scene)
    expected = clsim.render(clsim.find_paths(file.scene, max_order=1), 16e3, duration=0.25)
    found = clsim.load_recording(folder)
    ears = ("head", "left"), ("head", "right")
    assert found.channels == (*(("hoa", f"ACN{i}") for i in range(4)), ("omni", ""), *ears)
    np.testing.assert_array_equal(found.samples, expected.samples)
    np.testing.assert_array_equal(clsim.load_recording(folder, ["omni"]).samples, expected.samples[4:5])
    if store == "wav":
        frames, rate = soundfile.read(folder / "hoa.wav", dtype="float32")
        assert rate == 16e3
        np.testing.assert_array_equal(frames.T, expected.samples[:4])
        assert b"<NAME>ACN3</NAME>" in (folder / "hoa.wav").read_bytes()[:2000]


ARRAY = """
[[receivers]]
name = "array"
positions = { kind = "grid", x = [-0.1, 0.1, 3], y = 0.0, z = 0.0 }
trajectory = { kind = "line", start = [4.0, 2.0, 1.5], end = [4.4, 2.0, 1.5], duration = 1.0 }
electronics = { self_noise_db = 20.0, low_cut = 20.0 }

[paths]
"""


@pytest.mark.parametrize(("store", "more"), [("wav", []), ("zarr", ["--workers", "2"])])
def test_an_array_is_one_file_of_as_many_channels(scene, tmp_path, store, more):
    """Elements are found by the name of the array, and alone."""
    scene.write_text(SCENE.replace("\n[paths]\n", ARRAY))
    folder = tmp_path / "results"
    assert main(["run", str(scene), "-o", str(folder), "--store", store, "--no-plots", *more]) == 0
    expected = clsim.render(clsim.find_paths(clsim.load_scene(scene).scene, max_order=1), 16e3, duration=0.25)
    found = clsim.load_recording(folder)
    assert found.channels == expected.channels
    assert found.channels[-3:] == (("array", "0"), ("array", "1"), ("array", "2"))
    np.testing.assert_array_equal(found.samples, expected.samples)
    np.testing.assert_array_equal(clsim.load_recording(folder, ["array"]).samples, expected.samples[7:])
    np.testing.assert_array_equal(clsim.load_recording(folder, ["array 1"]).samples, expected.samples[8:9])
    if store == "wav":
        assert sorted(path.name for path in folder.glob("*.wav")) == ["array.wav", "head.wav", "hoa.wav", "omni.wav"]
        frames, _ = soundfile.read(folder / "array.wav", dtype="float32")
        np.testing.assert_array_equal(frames.T, expected.samples[7:])
        assert b"<NAME>2</NAME>" in (folder / "array.wav").read_bytes()[:2000]
    else:
        with clsim.open_store(folder) as opened:
            assert opened["channel"].values.tolist()[-3:] == ["0", "1", "2"]


def test_rows_of_channels_lie_where_their_receiver_does(scene, tmp_path):
    """Impulse responses and MATLAB files name a place for each row: seven of three receivers."""
    sofar, loadmat = pytest.importorskip("sofar"), pytest.importorskip("scipy.io").loadmat
    file = clsim.load_scene(scene)
    paths = clsim.find_paths(file.scene, max_order=1)
    places = np.array([end.trajectory.position(0.0) for end in file.scene.receivers])[[0, 0, 0, 0, 1, 2, 2]]
    for kind in ("npz", "sofa"):
        assert main(["rir", str(scene), "-o", str(tmp_path / f"a.{kind}"), "--tail", "off"]) == 0
    with np.load(tmp_path / "a.npz") as found:
        np.testing.assert_array_equal(found["receiver_positions"], places)
        samples = found["samples"]
    sofa = sofar.read_sofa(str(tmp_path / "a.sofa"), verbose=False)
    np.testing.assert_array_equal(sofa.ListenerPosition, np.tile(places, (samples.shape[0], 1)))
    np.testing.assert_array_equal(sofa.Data_IR[:, 0], samples.reshape(-1, samples.shape[2]))
    clsim.write_mat(clsim.render(paths, 16e3, duration=0.05), tmp_path / "a.mat")
    assert loadmat(tmp_path / "a.mat")["receivers"].ravel().tolist() == [1, 1, 1, 1, 2, 3, 3]


def damaged(kind, path):
    """Write a file of head-related responses that is not what it should be."""
    if kind in ("huge", "unfilled"):
        netcdf = pytest.importorskip("netCDF4")
        with netcdf.Dataset(path, "w") as file:
            file.Conventions, file.SOFAConventions, file.DataType = "SOFA", "SimpleFreeFieldHRIR", "FIR"
            for name, size in (("M", 40_000 if kind == "huge" else 1), ("R", 2), ("N", 1000), ("C", 3), ("I", 1)):
                file.createDimension(name, size)
            file.createVariable("Data.IR", "f8", ("M", "R", "N"), zlib=True)
            file.createVariable("SourcePosition", "f8", ("M", "C"))
        return
    sofa_file(path, "SimpleFreeFieldHRIR", **({"Data_IR": np.full((200, 2, 256), np.nan)} if kind == "numbers" else {}))
    content = path.read_bytes()
    if kind == "text":
        path.write_text("no head at all")
    elif kind == "truncated":
        path.write_bytes(content[: len(content) // 2])
    elif kind == "header":
        path.write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(100))
    elif kind == "unknown":
        with pytest.importorskip("netCDF4").Dataset(path, "a") as file:
            file.SOFAConventions = "SingleRoomSRIR"
    elif kind == "folder":
        path.unlink()
        path.mkdir()


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        ("header", "must be a SOFA file"), ("truncated", "must be a SOFA file"), ("text", "must be a SOFA file"),
        ("huge", "must unpack to at most 512 MiB, but to"), ("unfilled", "must hold finite real numbers"),
        ("unknown", "must be of the convention SimpleFreeFieldHRIR, "), ("numbers", "must hold finite real numbers"),
        ("folder", "cannot be read"),
    ],
)  # fmt: skip
def test_a_damaged_head_is_one_line_and_status_2(scene, tmp_path, capsys, kind, message):
    pytest.importorskip("sofar")
    damaged(kind, tmp_path / "head.sofa")
    scene.write_text(SCENE.replace('{ kind = "ambisonic", order = 1 }', '{ kind = "head", path = "head.sofa" }'))
    assert main(["check", str(scene)]) == 2
    said = capsys.readouterr().err.strip().splitlines()
    assert len(said) == 1
    assert "head.sofa" in said[0]
    assert message in said[0]
