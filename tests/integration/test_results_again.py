"""Results that are there are made again where they are missing, cut or asked for anew, and not otherwise."""

import json
import os
import shutil
from pathlib import Path

import numpy as np
import pytest
import soundfile
from made_results import everything, run, wav_input, write_scene

from clsim.cli import main


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a scene, and `out` with its results."""
    folder = tmp_path_factory.mktemp("finished")
    assert run(write_scene(folder / "s.toml"), folder / "out") == 0
    return folder


@pytest.fixture
def done(finished: Path, tmp_path: Path) -> Path:
    shutil.copytree(finished, tmp_path, dirs_exist_ok=True)
    return tmp_path


def test_results_that_come_while_waiting_for_the_lock_are_seen(done: Path, tmp_path: Path, capsys, monkeypatch) -> None:
    """A run that looked at an empty folder and then got the lock of one that had finished."""
    from clsim.files import atomic

    first, out, locked = tmp_path / "out", tmp_path / "late", atomic.locked

    def late(path: Path, field: str):
        shutil.copytree(first, out, dirs_exist_ok=True)
        return locked(path, field)

    monkeypatch.setattr(atomic, "locked", late)
    assert run(done / "s.toml", out) == 2
    assert "must hold no results yet" in capsys.readouterr().err
    assert everything(out) == everything(first)


def test_force_puts_results_in_the_place_of_ours_and_of_no_others(done: Path, capsys) -> None:
    """What clsim wrote goes, what was changed since is kept beside, what others put there stays."""
    out = done / "out"
    (out / "notes.txt").write_text("mine")
    (out / "right.wav").write_text("mine")
    (out / "left.wav").write_text("mine")
    write_scene(done / "s.toml", name="other")
    assert run(done / "s.toml", out, "--force") == 0
    assert capsys.readouterr().err.count("was changed since it was written") == 1
    names = {"clsim.json", "left.wav", "other.wav", "paths.npz", "ground_truth.npz", "scene.completed.toml"}
    assert {p.name for p in out.iterdir()} == names | {"notes.txt", "right.wav", "left.wav.changed"}
    assert {(out / name).read_text() for name in ("notes.txt", "right.wav", "left.wav.changed")} == {"mine"}
    assert set(json.loads((out / "clsim.json").read_text())["files"]) == names - {"clsim.json"}


def test_resume_makes_what_is_missing_and_nothing_else(done: Path, finished: Path, capsys) -> None:
    out = done / "out"
    (out / "paths.npz").unlink()
    sound = (out / "left.wav").stat().st_mtime_ns
    assert run(done / "s.toml", out, "--resume") == 0
    assert capsys.readouterr().out == f"{out / 'paths.npz'}\n"
    assert everything(out) == everything(finished / "out")
    assert (out / "left.wav").stat().st_mtime_ns == sound
    (out / "right.wav").unlink()
    assert run(done / "s.toml", out, "--resume") == 0
    assert everything(out) == everything(finished / "out")
    capsys.readouterr()
    assert run(done / "s.toml", out, "--resume") == 0
    assert "already finished" in capsys.readouterr().err


def test_resume_makes_cut_and_changed_results_again_and_keeps_them_beside(done: Path, finished: Path, capsys) -> None:
    out = done / "out"
    os.truncate(out / "left.wav", 100)
    (out / "ground_truth.npz").write_text("mine")
    assert run(done / "s.toml", out, "--resume") == 0
    assert capsys.readouterr().err.count("kept as") == 2
    assert (out / "left.wav.changed").stat().st_size == 100
    assert (out / "ground_truth.npz.changed").read_text() == "mine"
    for name in ("left.wav", "ground_truth.npz"):
        assert (out / name).read_bytes() == (finished / "out" / name).read_bytes()


def test_resume_makes_tables_and_pictures_that_are_asked_for_now(done: Path, capsys) -> None:
    pytest.importorskip("pyarrow")
    out = done / "out"
    assert main(["run", str(done / "s.toml"), "-o", str(out), "--resume", "--table", "parquet"]) == 0
    made = {Path(line).name for line in capsys.readouterr().out.split()}
    pictures = {f"{name}_{kind}.png" for name in ("left", "right") for kind in ("spectrogram", "echogram")}
    assert made == {"paths.parquet", *pictures}
    assert (out / "paths.npz").exists()


@pytest.mark.parametrize(
    ("change", "more", "message"),
    [
        (lambda d: None, ["--store", "hdf5"], "options.store was 'wav' and is 'hdf5'"),
        (lambda d: None, ["--table-rate", "10"], "options.table_rate was 100.0 and is 10.0"),
        (lambda d: soundfile.write(d / "in.wav", np.hanning(320) ** 2, 16_000, "FLOAT"), [], "contents.in.wav was"),
        (lambda d: (d / "out" / "clsim.json").write_text("{}"), [], "clsim.json cannot be read"),
        (lambda d: (d / "out" / "clsim.json").write_text("[" * 5000), [], "clsim.json cannot be read"),
    ],
)
def test_resume_of_finished_results_refuses_other_ones(change, more, message: str, tmp_path: Path, capsys) -> None:
    if "--store" in more:
        pytest.importorskip("h5netcdf")
    scene, out = wav_input(tmp_path, "in.wav"), tmp_path / "out"
    assert run(scene, out) == 0
    change(tmp_path)
    before = everything(tmp_path)
    assert run(scene, out, "--resume", *more) == 2
    assert message in capsys.readouterr().err
    assert everything(tmp_path) == before


@pytest.mark.parametrize("names", [["../../thesis.txt"], ["/etc/hostname"], [".."], [""], ["a/b"], [3]])
def test_a_record_names_nothing_elsewhere(names: list, done: Path, capsys) -> None:
    record = done / "out" / "clsim.json"
    content = json.loads(record.read_text())
    content["replaced"] = [[name, [4, "0"]] for name in names]
    record.write_text(json.dumps(content))
    assert run(done / "s.toml", done / "out", "--force") == 2
    assert "clsim.json cannot be read" in capsys.readouterr().err
