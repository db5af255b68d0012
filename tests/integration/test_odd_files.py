"""Names that are odd, files that fail, what dead processes left, and arguments that are wrong."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
import soundfile
from exhaustive import few
from made_results import run, write_scene

from clsim.cli import main
from clsim.files.atomic import remove_leftovers, temporary_path
from clsim.files.input_files import file_names
from clsim.workflow.result_folder import fingerprint


def test_pictures_and_tables_that_fail_cost_no_sound(tmp_path: Path, capsys, monkeypatch) -> None:
    scene, out = write_scene(tmp_path / "s.toml"), tmp_path / "out"

    def broken(*_: object, **__: object) -> None:
        raise ValueError("no font")

    monkeypatch.setattr("clsim.workflow.pictures.spectrogram_picture", broken)
    monkeypatch.setattr("clsim.workflow.pictures.echogram_picture", broken)
    monkeypatch.setattr("clsim.commands.run.write_table", broken)
    with pytest.raises(ValueError, match="no font"):
        main(["run", str(scene), "-o", str(out)])
    assert soundfile.info(out / "left.wav").frames > 300
    monkeypatch.undo()
    monkeypatch.setattr("clsim.workflow.pictures.spectrogram_picture", broken)
    monkeypatch.setattr("clsim.workflow.pictures.echogram_picture", broken)
    assert main(["run", str(scene), "-o", str(out), "--resume"]) == 0
    err = capsys.readouterr().err
    assert "left_spectrogram.png could not be drawn: no font" in err
    assert not list(out.glob("*.png"))
    assert not (out / ".partial").exists()


@pytest.mark.parametrize("name", few(["CON/$\\\\frac$" + "é" * 200, "x" * 240]))
def test_odd_names_are_written_and_drawn(name: str, tmp_path: Path, capsys) -> None:
    scene, out = write_scene(tmp_path / "s.toml", name=name), tmp_path / "out"
    assert main(["run", str(scene), "-o", str(out)]) == 0
    assert "could not" not in capsys.readouterr().err.replace("Glyph", "")
    assert len(list(out.glob("*.png"))) == 4


def test_nul_in_names_is_refused_where_hdf5_cannot_hold_it(tmp_path: Path, capsys) -> None:
    pytest.importorskip("h5netcdf")
    scene = write_scene(tmp_path / "s.toml", name="a\\u0000b")
    assert run(scene, tmp_path / "out", "--store", "hdf5") == 2
    assert "receivers[1]: must have no NUL" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_file_names_fit_and_differ() -> None:
    names = file_names(("a" * 300, "a" * 301, "A" * 300, "b", "B", "b-2", "b"))
    assert len({name.lower() for name in names}) == 7
    assert max(map(len, names)) < 210
    assert len(set(file_names(("x",) * 20_000))) == 20_000  # at once, not after minutes


def test_leftovers_of_dead_processes_are_removed(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    dead = subprocess.Popen([sys.executable, "-c", ""])
    dead.wait()
    alive = temporary_path(tmp_path / "x.npz")
    with monkeypatch.context() as patch:
        patch.setattr(os, "getpid", lambda: dead.pid)
        left = temporary_path(tmp_path / "x.npz")
    foreign = tmp_path / ".clsim-notes.partial.npz"
    elsewhere = tmp_path / f".clsim-00000000-{dead.pid}-00000000.partial.npz"
    for path in (alive, left, foreign, elsewhere):
        path.touch()
    assert main(["plot", "air", "-o", "air.png"]) == 0
    assert not left.exists()
    assert alive.exists()
    assert foreign.exists()
    assert elsewhere.exists()  # of another machine that has the same disk
    remove_leftovers(tmp_path)


def test_fingerprints_tell_files_folders_and_links(tmp_path: Path) -> None:
    folder = tmp_path / "a"
    (folder / "b").mkdir(parents=True)
    (folder / "b" / "c").write_text("1")
    before = fingerprint(folder)
    assert before is not None
    assert before[0] == 1
    (folder / "b" / "d").touch()
    assert fingerprint(folder) != before
    (folder / "b" / "d").unlink()
    assert fingerprint(folder) == before
    (folder / "b" / "d").symlink_to("c")
    assert fingerprint(folder) is None
    assert fingerprint(tmp_path / "none") is None


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["run", "s.toml", "-o", ""], "-o/--output: must name a file or a folder, but is empty"),
        (["paths", "s.toml", "-o", ""], "-o/--output: must name a file or a folder, but is empty"),
        (["view", "s.toml", "--frames", "1e9"], "--frames: must be 1 to 10000, but is 1000000000"),
        (["view", "s.toml", "--frames", "0"], "--frames: must be 1 to 10000, but is 0"),
        (["view", "s.toml", "--frames", "1e999"], "--frames: must be a whole number, but is '1e999'"),
        (["view", "s.toml", "--limit", "1e300"], "--limit: must be 1 to 100000, but is 1"),
        (["view", "s.toml", "--limit", "2.5"], "--limit: must be a whole number, but is '2.5'"),
        (["paths", "s.toml", "--limit", "-5"], "--limit: must be at least 0, but is -5"),
        (["paths", "s.toml", "-o", "p.csv"], "--output: must end in .npz or .parquet, but is 'p.csv'"),
        (["run", "s.toml"], "the following arguments are required: -o/--output"),
        (["run", "s.toml", "-o", "s.toml"], "must be a folder or lie in one, but "),
        (["rir", "s.toml", "-o", "s.toml/x"], "must be a folder or lie in one, but "),
    ],
)
def test_wrong_arguments_are_told_in_a_line(arguments: list[str], message: str, tmp_path, error_of, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_scene(tmp_path / "s.toml")
    assert message in error_of(*arguments)
    assert [p.name for p in tmp_path.iterdir()] == ["s.toml"]
