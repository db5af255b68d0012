"""Runs that are killed go on, and end like those that are not; stores hold the same sound."""

import os
import shutil
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import soundfile
from killing import Killer, content
from scene_texts import along, chirp_of, receiver_at, scene_text, source_at

import clsim
from clsim.cli import main
from clsim.files.atomic import locked
from clsim.output.stores import STORES, StoredSound
from clsim.workflow.result_folder import Journal

SCENE = scene_text(
    source_at("robot", chirp_of(30e3, 50e3, "%s", 192e3), along((1, 1, 1), (2, 1, 1), 2.0)),
    receiver_at(
        "über/left",
        (3.0, 1.0, 2.0),
        transducer={"kind": "named", "name": "MA40S4R"},
        electronics={
            "ambient_noise_db": 10.0, "self_noise_db": 20.0, "seed": 3, "low_cut": 20e3, "high_cut": 80e3, "order": 4,
            "gain_db": 40.0, "adc_bits": 12, "adc_full_scale": 0.25, "clock_ppm": 50.0, "clock_offset": 0.001,
        },
    ),
    receiver_at("right", (3.0, 2.0, 2.0)),
    max_order="%d",
    render={"chunk": 18432},
)  # fmt: skip
LONG = SCENE % (0.6, 2)  # seven chunks
SHORT = SCENE % (1.2, 1)
AIR = """
[air]
temperature_celsius = [19.0, 22.0]
dispersion = true
wind = [0.3, -0.2, 0.0]
fluctuation = { rms = 2e-6, correlation_time = 0.2, correlation_length = 0.3, seed = 3 }
[room]
"""
KINDS = ("wav", "zarr", "hdf5")
FILES = {"wav": ["ber_left.wav", "right.wav"], "zarr": ["recording.zarr"], "hdf5": ["recording.h5"]}


def skip_without(kind: str) -> None:
    for name in {"wav": (), "zarr": ("zarr", "xarray"), "hdf5": ("h5netcdf", "xarray")}[kind]:
        pytest.importorskip(name)


def command(scene: Path, out: Path, kind: str, *more: str) -> list[str]:
    return ["run", str(scene), "-o", str(out), "--store", kind, "--no-plots", "--table", "none", *more]


def done(out: Path) -> int:
    journal = Journal(out / ".partial")
    return journal.load()[1] if journal.exists() else 0


def sound(out: Path, kind: str) -> np.ndarray:
    if kind == "wav":
        return np.stack([soundfile.read(out / name, dtype="float32")[0] for name in FILES["wav"]])
    with clsim.open_store(out) as found:
        return found.sound.values


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    path = tmp_path / "scene.toml"
    path.write_text(SHORT, "utf-8")
    return path


def test_a_killed_run_ends_like_one_that_was_not(killer: Killer, tmp_path: Path, device) -> None:
    """On a device, in air of every kind; `test_kills` has more moments, and all stores."""
    scene, out = tmp_path / "scene.toml", tmp_path / "out"
    scene.write_text(LONG.replace("[room]", AIR), "utf-8")
    assert main(command(scene, tmp_path / "whole", "wav")) == 0
    reached = []
    for moment in (2, 4):  # when one chunk is noted, and when another one is; going on reads the journal twice
        arguments = command(scene, out, "wav", "--resume")
        assert killer.run(arguments, out, event=moment, of="journal.npz") == -signal.SIGKILL
        assert [p.name for p in out.iterdir()] == [".partial"]  # nothing looks whole
        reached.append(done(out) // 18_432)
    assert reached == [1, 2]
    assert killer.run(arguments, out) == 0, killer.log
    assert content(out) == content(tmp_path / "whole")
    assert "clipped" in killer.log  # those before the kills are counted too


@pytest.fixture(scope="module")
def killed(killer: Killer, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a scene and a run of it that was killed."""
    folder = tmp_path_factory.mktemp("killed")
    scene, out = folder / "scene.toml", folder / "out"
    scene.write_text(LONG, "utf-8")
    assert killer.run(command(scene, out, "wav"), out, event=3, of="journal.npz") == -signal.SIGKILL
    return folder


@pytest.fixture
def unfinished(killed: Path, tmp_path: Path, device) -> Path:
    shutil.copytree(killed, tmp_path, dirs_exist_ok=True)
    return tmp_path


def change_version(folder: Path) -> None:
    journal = Journal(folder / "out" / ".partial")
    identity, samples, state = journal.load()
    identity["versions"]["clsim"] = "0.0.9"
    journal.save(identity, samples, state)


@pytest.mark.parametrize(
    ("change", "more", "message"),
    [
        (("reflection = 0.9", "reflection = 0.8"), (), "scene.room.walls.reflection was 0.9 and is 0.8"),
        (("seed = 3", "seed = 4"), (), "scene.receivers[0].electronics.seed was 3 and is 4"),
        (None, ("--store", "hdf5"), "options.store was 'wav' and is 'hdf5'"),
        (None, ("--duration", "0.7"), "scene.render.duration was 0.6"),
        (None, ("--engine", "reference"), "scene.render.engine was 'opencl' and is 'reference'"),
        (change_version, (), "versions.clsim was '0.0.9' and is "),
    ],
)
def test_another_run_is_not_gone_on_with(unfinished: Path, change, more, message: str, error_of) -> None:
    path = unfinished / "scene.toml"
    if isinstance(change, tuple):
        path.write_text(path.read_text("utf-8").replace(*change), "utf-8")
    elif change is not None:
        change(unfinished)
    error = error_of(*command(path, unfinished / "out", "wav", "--resume", *more))
    assert error.startswith("--resume: must go on with the same run, but ")
    assert message in error
    assert done(unfinished / "out") > 0


def test_changed_files_are_noticed(tmp_path: Path, killer: Killer, error_of, device) -> None:
    chirp = 'signal = { kind = "chirp", start = 30e3, stop = 50e3, duration = 0.6, sampling_rate = 192e3 }'
    assert chirp in LONG
    scene, out = tmp_path / "scene.toml", tmp_path / "out"
    scene.write_text(LONG.replace(chirp, 'signal = { kind = "wav", path = "s.wav" }'), "utf-8")
    samples = np.sin(0.2 * np.pi * np.arange(115_200)).astype(np.float32)
    soundfile.write(tmp_path / "s.wav", samples, 192_000, subtype="FLOAT")
    assert killer.run(command(scene, out, "wav"), out, event=2, of="journal.npz") == -signal.SIGKILL
    samples[-1] += 1e-6
    soundfile.write(tmp_path / "s.wav", samples, 192_000, subtype="FLOAT")
    assert "contents.s.wav was" in error_of(*command(scene, out, "wav", "--resume"))


def test_an_unfinished_run_must_be_told_what_becomes_of_it(unfinished: Path, capsys) -> None:
    arguments = command(unfinished / "scene.toml", unfinished / "out", "wav")
    assert main(arguments) == 2
    err = capsys.readouterr().err
    assert "--resume goes on, --force begins anew" in err
    assert main([*arguments, "--resume", "--force"]) == 2
    short = command(unfinished / "scene.toml", unfinished / "out", "wav", "--force", "--duration", "0.1")
    assert main(short) == 0
    assert len(sound(unfinished / "out", "wav")[0]) == 19_200


def test_a_bad_scene_with_force_loses_nothing(unfinished: Path, capsys) -> None:
    path = unfinished / "scene.toml"
    path.write_text(LONG.replace("reflection", "reflektion"), "utf-8")
    assert main(command(path, unfinished / "out", "wav", "--force")) == 2
    assert done(unfinished / "out") > 0
    assert 'did you mean "reflection"?' in capsys.readouterr().err
    path.write_text(LONG, "utf-8")
    assert main(command(path, unfinished / "out", "hdf5", "--resume")) == 2
    assert "; " not in capsys.readouterr().err  # what to do is told once
    assert done(unfinished / "out") > 0


def test_resume_begins_where_there_is_nothing_and_leaves_what_is_whole(scene: Path, tmp_path, error_of, device) -> None:
    arguments = command(scene, tmp_path / "out", "wav", "--resume", "--duration", "0.2")
    assert main(arguments) == 0
    before = {p: p.stat().st_mtime_ns for p in (tmp_path / "out").iterdir()}
    assert main(arguments) == 0
    assert {p: p.stat().st_mtime_ns for p in (tmp_path / "out").iterdir()} == before
    assert "render.duration was 0.2 and is 0.3" in error_of(*arguments[:-1], "0.3")


def test_a_broken_journal_is_told(unfinished: Path, error_of) -> None:
    journal = unfinished / "out" / ".partial" / "journal.npz"
    for text in (b"", b"PK\x03\x04", journal.read_bytes()[:-100]):
        journal.write_bytes(text)
        assert "journal.npz cannot be read" in error_of(
            *command(unfinished / "scene.toml", unfinished / "out", "wav", "--resume")
        )


def test_two_runs_into_one_folder(unfinished: Path, error_of) -> None:
    pytest.importorskip("fcntl")
    out = unfinished / "out"
    with locked(out / ".partial" / "lock", "--output"):
        for more in ("--resume", "--force"):
            assert "one process at a time" in error_of(*command(unfinished / "scene.toml", out, "wav", more))
    assert done(out) > 0


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of 1 MiB of its own."""
    place = tmp_path / "disk"
    place.mkdir()
    if os.name == "nt" or os.geteuid() != 0:
        pytest.skip("only root may mount a small disk")
    mount = ["mount", "-t", "tmpfs", "-o", "size=1m", "tmpfs", str(place)]
    if shutil.which("mount") is None or subprocess.run(mount, capture_output=True).returncode:
        pytest.skip("a small disk cannot be mounted here")
    yield place
    subprocess.run(["umount", str(place)], check=True)


@pytest.mark.parametrize("kind", KINDS)
def test_a_full_disk_loses_nothing(kind: str, scene: Path, small_disk: Path, tmp_path: Path, capsys, device) -> None:
    skip_without(kind)
    out = small_disk / "out"
    assert main(command(scene, out, kind)) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert "No space left on device" in err
    if kind == "zarr":  # what is compressed cannot be reserved: it fills up in mid-run
        assert "--resume goes on" in err
        assert done(out) > 0
        assert [p.name for p in out.iterdir()] == [".partial"]
    else:  # told before anything was rendered, and nothing is left
        assert "MiB are needed" in err
        assert not out.exists()
    subprocess.run(["mount", "-o", "remount,size=64m", str(small_disk)], check=True)
    assert main(command(scene, out, kind, "--resume")) == 0
    assert main(command(scene, tmp_path / "whole", kind)) == 0
    assert content(out) == content(tmp_path / "whole")


def test_stores_hold_the_same_sound(scene: Path, tmp_path: Path, device) -> None:
    xarray = pytest.importorskip("xarray")
    skip_without("zarr")
    skip_without("hdf5")
    for kind in KINDS:
        assert main(command(scene, tmp_path / kind, kind, "--duration", "0.5")) == 0
    wanted = sound(tmp_path / "wav", "wav")
    for kind in ("zarr", "hdf5"):
        with clsim.open_store(tmp_path / kind) as found:
            np.testing.assert_array_equal(found.sound.values, wanted)
            assert found.sound.dims == ("receiver", "time")
            assert list(found.receiver.values) == ["über/left", "right"]
            assert list(found.unit.values) == ["V", "Pa"]
            np.testing.assert_array_equal(found.position.values, [[3, 1, 2], [3, 2, 2]])
            np.testing.assert_allclose(found.time.values, np.arange(96_000) / 192e3, rtol=1e-15)
            assert found.attrs["sampling_rate"] == 192e3
            assert found.attrs["clsim_version"] == clsim.__version__
            assert 'kind = "shoebox"' in found.attrs["scene"]
            part = found.sound.sel(receiver="right").sel(time=slice(0.1, 0.2), method="nearest")
            assert 19_200 <= part.size <= 19_201
    # Readable without clsim.
    with xarray.open_zarr(tmp_path / "zarr" / "recording.zarr") as plain:
        np.testing.assert_array_equal(plain.sound.values, wanted)
    with xarray.open_dataset(tmp_path / "hdf5" / "recording.h5", engine="h5netcdf") as plain:
        np.testing.assert_array_equal(plain.sound.values, wanted)


def test_open_store_refuses_others(tmp_path: Path) -> None:
    zarr = pytest.importorskip("zarr")
    skip_without("zarr")
    with pytest.raises(clsim.InputError, match="must be a store of clsim"):
        clsim.open_store(tmp_path / "missing.zarr")
    (tmp_path / "no.h5").write_bytes(b"nothing")
    with pytest.raises(clsim.InputError, match="must be a store of clsim"):
        clsim.open_store(tmp_path / "no.h5")
    zarr.open_group(tmp_path / "other.zarr", mode="w")
    with pytest.raises(clsim.InputError, match="does not say so"):
        clsim.open_store(tmp_path / "other.zarr")
    about = StoredSound((("a", ""),), ("Pa",), np.zeros((1, 3)), 48e3, 10, 10, "", "9.9")
    store = STORES["zarr"](tmp_path, about, ["a"])
    store.create()
    group = zarr.open_group(tmp_path / "recording.zarr", mode="r+")
    group.attrs["clsim_store_format"] = 2
    with pytest.raises(clsim.InputError, match=r"store of format 1, but .* has format 2 \(clsim 9\.9 wrote it\)"):
        clsim.open_store(tmp_path)


@pytest.mark.parametrize(("rate", "channels", "samples"), [(44_100, 1, 0), (192_000, 1, 7), (500_000, 3, 1000)])
def test_wav_headers_are_read_by_others(rate: int, channels: int, samples: int, tmp_path: Path, rng) -> None:
    from clsim.files.sound import wav_header

    data = rng.normal(size=(samples, channels)).astype("<f4")
    (tmp_path / "a.wav").write_bytes(wav_header(rate, channels, samples) + data.tobytes())
    read, found = soundfile.read(tmp_path / "a.wav", dtype="float32", always_2d=True)
    assert found == rate
    np.testing.assert_array_equal(read, data)
    assert soundfile.info(tmp_path / "a.wav").subtype == "FLOAT"
