"""Nothing that others made is written over or removed, and no input ever; results that are missing are made again."""

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import soundfile

from clsim.cli import main
from clsim.files.atomic import remove_leftovers, temporary_path
from clsim.files.names import file_names
from clsim.output.record import fingerprint

SCENE = """
format = 1
[room]
kind = "shoebox"
size = [4.0, 3.0, 2.5]
walls = { reflection = 0.9 }
[[sources]]
name = "robot"
signal = %s
trajectory = { kind = "line", start = [1, 1, 1], end = [1.05, 1, 1], duration = 0.05 }
[[receivers]]
name = "left"
trajectory = { kind = "fixed", position = [3.0, 1.0, 2.0] }
[[receivers]]
name = "%s"
trajectory = { kind = "fixed", position = [3.0, 2.0, 2.0] }
[paths]
max_order = 0
[render]
sampling_rate = 16e3
interpolator = { kind = "lagrange", order = 4 }
engine = "reference"
"""
TONE = '{ kind = "tone", frequency = 2e3, duration = 0.02, sampling_rate = 16e3, fade = 0.005 }'
WAV = '{ kind = "wav", path = "%s" }'


def write_scene(path: Path, signal: str = TONE, name: str = "right") -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(SCENE % (signal, name), "utf-8")
    return path


def run(scene: Path, out: Path, *more: str) -> int:
    return main(["run", str(scene), "-o", str(out), "--no-plots", *more])


def everything(folder: Path) -> dict[str, object]:
    """Return all that is under a folder, links as links."""
    return {
        str(p.relative_to(folder)): p.readlink() if p.is_symlink() else p.read_bytes() if p.is_file() else None
        for p in folder.rglob("*")
    }


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


def put(name: str) -> Callable[[Path], None]:
    def make(folder: Path) -> None:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text("mine")

    return make


def put_link(name: str, to: str) -> Callable[[Path], None]:
    def make(folder: Path) -> None:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / "thesis.txt").write_text("mine")
        (folder / "notes").mkdir()
        (folder / name).symlink_to(to)

    return make


def put_second_name_at_work(folder: Path) -> None:
    put("out/.partial/contents.json")(folder)
    (folder / "out" / ".partial" / "contents.json").write_text('["left.wav"]')
    (folder / "out" / ".partial" / "lock").touch()
    (folder / "thesis.txt").write_text("mine")
    os.link(folder / "thesis.txt", folder / "out" / ".partial" / "left.wav")


FOREIGN = [
    "out/left.wav", "out/right.wav/notes.txt", "out/paths.npz", "out/ground_truth.npz", "out/clsim.json", "out/.partial",
    "out/scene.completed.toml", "out/.partial/notes.txt", "out/.partial/left.wav", "out/.partial/lock",
    "out/.partial/contents.json", "out/.partial/journal.npz", "out",
]  # fmt: skip
ATTACKS = {
    **{name: (put(name), []) for name in FOREIGN},
    **{f"{name} with --force": (put(name), ["--force"]) for name in FOREIGN},
    **{f"{name} with --resume": (put(name), ["--resume"]) for name in FOREIGN},
    "picture": (put("out/left_echogram.png"), ["pictures"]),
    "store": (put("out/recording.zarr/notes.txt"), ["--store", "zarr", "--force"]),
    "hdf5": (put("out/recording.h5"), ["--store", "hdf5"]),
    "parquet": (put("out/paths.parquet"), ["--table", "parquet", "--resume"]),
    "link": (put_link("out/left.wav", "../thesis.txt"), ["--force"]),
    "link to nothing": (put_link("out/left.wav", "../nothing"), []),
    "work is a link": (put_link("out/.partial", "../notes"), []),
    "work is a link to nothing": (put_link("out/.partial", "../nothing"), ["--resume"]),
    "lock is a link": (put_link("out/.partial/lock", "../../thesis.txt"), ["--force"]),
    "record is a link": (put_link("out/clsim.json", "../thesis.txt"), ["--force"]),
    "second name at work": (put_second_name_at_work, ["--resume"]),
    "output is a link to nothing": (put_link("out", "nothing"), []),
    "output below a link to nothing": (put_link("link", "nothing"), ["-o", "link/out"]),
    "output below a file": (put("file"), ["-o", "file/out"]),
}


@pytest.mark.parametrize("name", ATTACKS)
def test_what_others_made_stays(name: str, tmp_path: Path, capsys, monkeypatch) -> None:
    """It is refused before paths are searched for, and nothing is there that was not."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("clsim.workflow.pipeline.find_paths", lambda *a, **k: pytest.fail("the search had begun"))
    scene = write_scene(tmp_path / "s.toml")
    make, more = ATTACKS[name]
    make(tmp_path)
    before = everything(tmp_path)
    plots = [] if "pictures" in more else ["--no-plots"]
    options = [option for option in more if option != "pictures"]
    assert main(["run", str(scene), *([] if "-o" in options else ["-o", "out"]), *plots, *options]) == 2
    err = capsys.readouterr().err
    assert err.startswith("clsim: error: --output: must ")
    assert err.count("\n") == 1
    assert everything(tmp_path) == before


def wav_input(folder: Path, name: str) -> Path:
    (folder / name).parent.mkdir(parents=True, exist_ok=True)
    soundfile.write(folder / name, np.hanning(320) * np.sin(np.arange(320)), 16_000, subtype="FLOAT")
    return write_scene(folder / "s.toml", WAV % name)


def run_over_sound(folder: Path) -> list[str]:
    return ["run", str(wav_input(folder, "right.wav")), "-o", str(folder)]


def run_over_sound_by_another_name(folder: Path) -> list[str]:
    scene = wav_input(folder, "sounds/in.wav")
    (folder / "out").mkdir()
    os.link(folder / "sounds" / "in.wav", folder / "out" / "right.wav")
    return ["run", str(scene), "-o", str(folder / "out")]


def run_over_scene(folder: Path) -> list[str]:
    return ["run", str(write_scene(folder / "scene.completed.toml")), "-o", str(folder)]


def run_over_record(folder: Path) -> list[str]:
    return ["run", str(write_scene(folder / "clsim.json")), "-o", str(folder)]


def run_with_input_at_work(folder: Path) -> list[str]:
    return ["run", str(wav_input(folder, "out/.partial/left.wav")), "-o", str(folder / "out")]


def run_with_input_in_store(folder: Path) -> list[str]:
    return ["run", str(wav_input(folder, "out/recording.zarr/in.wav")), "-o", str(folder / "out"), "--store", "zarr"]


def rerun_completed(folder: Path) -> list[str]:
    assert run(write_scene(folder / "s.toml"), folder / "out") == 0
    return ["run", str(folder / "out" / "scene.completed.toml"), "-o", str(folder / "out")]


def rerun_on_own_sound(folder: Path) -> list[str]:
    assert run(write_scene(folder / "first.toml", name="other"), folder / "out") == 0
    return ["run", str(write_scene(folder / "s.toml", WAV % "out/other.wav")), "-o", str(folder / "out")]


def rir_over_sound(folder: Path) -> list[str]:
    scene = wav_input(folder, "robot_left.wav")
    return ["rir", str(scene), "-o", str(folder)]


def view_over_scene(folder: Path) -> list[str]:
    scene = write_scene(folder / "s.toml")
    return ["view", str(scene), "-o", str(scene)]


def view_beside_a_scene_called_html(folder: Path) -> list[str]:
    return ["view", str(write_scene(folder / "s.html"))]


def paths_over_sound(folder: Path) -> list[str]:
    scene = wav_input(folder, "in.npz.wav")
    os.link(folder / "in.npz.wav", folder / "p.npz")
    return ["paths", str(scene), "-o", str(folder / "p.npz")]


def plot_over_table(folder: Path) -> list[str]:
    (folder / "beam.csv").write_text("angle,1000,2000\n0,0,0\n90,-6,-9\n180,-12,-20\n")
    os.link(folder / "beam.csv", folder / "beam.png")
    return [
        "plot",
        "directivity",
        "--table",
        str(folder / "beam.csv"),
        "--rear",
        "hold",
        "-o",
        str(folder / "beam.png"),
    ]


INPUTS = [
    run_over_sound, run_over_sound_by_another_name, run_over_scene, run_over_record, run_with_input_at_work,
    run_with_input_in_store, rerun_completed, rerun_on_own_sound, rir_over_sound, view_over_scene,
    view_beside_a_scene_called_html, paths_over_sound, plot_over_table,
]  # fmt: skip


@pytest.mark.parametrize("attack", INPUTS, ids=lambda f: f.__name__)
def test_no_input_is_written_over(attack: Callable[[Path], list[str]], tmp_path: Path, capsys) -> None:
    """Not even with --force."""
    arguments = attack(tmp_path)
    before = everything(tmp_path)
    capsys.readouterr()
    assert main([*arguments, "--force"]) == 2
    err = capsys.readouterr().err
    assert err.startswith("clsim: error: --output: must ")
    assert err.count("\n") == 1
    assert everything(tmp_path) == before


SINGLE = {
    "rir": ["rir", "s.toml", "-o", "x.npz"],
    "rir folder": ["rir", "s.toml", "-o", "."],
    "paths": ["paths", "s.toml", "-o", "x.npz"],
    "view": ["view", "s.toml", "--frames", "1"],
    "plot": ["plot", "air", "-o", "x.png"],
    "materials": ["materials", "concrete", "-o", "x.png"],
}
MADE = {"rir folder": "robot_left.wav", "view": "s.html", "plot": "x.png", "materials": "x.png"}


@pytest.mark.parametrize("name", SINGLE)
def test_single_files_are_not_written_over_unasked(name: str, tmp_path: Path, capsys, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    write_scene(tmp_path / "s.toml")
    target = Path(MADE.get(name, "x.npz"))
    target.write_text("mine")
    assert main(SINGLE[name]) == 2
    assert capsys.readouterr().err == (
        f"clsim: error: --output: must not exist yet, but {target} does (--force writes over it)\n"
    )
    assert target.read_text() == "mine"
    assert main([*SINGLE[name], "--force"]) == 0
    assert target.read_bytes() != b"mine"
    target.unlink()
    (tmp_path / "thesis").write_text("mine")
    for wrong in (lambda: target.mkdir(), lambda: target.symlink_to("thesis"), lambda: target.symlink_to("nothing")):
        wrong()
        assert main([*SINGLE[name], "--force"]) == 2
        assert "--output: must be " in capsys.readouterr().err
        target.rmdir() if target.is_dir() else target.unlink()
    assert (tmp_path / "thesis").read_text() == "mine"


def test_what_comes_into_the_way_while_rendering_stays(tmp_path: Path, capsys, monkeypatch) -> None:
    from clsim.workflow import streaming

    scene, out = write_scene(tmp_path / "s.toml"), tmp_path / "out"
    render = streaming.render_chunks

    def meanwhile(*arguments, **options):
        (out / "right.wav").write_text("mine")
        return render(*arguments, **options)

    monkeypatch.setattr(streaming, "render_chunks", meanwhile)
    assert run(scene, out) == 2
    assert "clsim did not write" in capsys.readouterr().err
    assert (out / "right.wav").read_text() == "mine"
    (out / "right.wav").unlink()
    assert run(scene, out, "--resume") == 0  # nothing was lost
    assert soundfile.info(out / "right.wav").frames > 300


def test_results_that_come_while_waiting_for_the_lock_are_seen(done: Path, tmp_path: Path, capsys, monkeypatch) -> None:
    """A run that looked at an empty folder and then got the lock of one that had finished."""
    from clsim.workflow import result_folder

    first, out, locked = tmp_path / "out", tmp_path / "late", result_folder.locked

    def late(path: Path, field: str):
        shutil.copytree(first, out, dirs_exist_ok=True)
        return locked(path, field)

    monkeypatch.setattr(result_folder, "locked", late)
    assert run(done / "s.toml", out) == 2
    assert "must hold no results yet" in capsys.readouterr().err
    assert everything(out) == everything(first)


def test_the_lock_comes_before_the_search(tmp_path: Path, capsys, monkeypatch) -> None:
    pytest.importorskip("fcntl")
    from clsim.commands import run as command

    scene, out, plan = write_scene(tmp_path / "s.toml"), tmp_path / "out", command.plan_scene
    told = []

    def second(*arguments):
        monkeypatch.setattr(command, "plan_scene", plan)
        told.append(run(scene, out, "--force"))
        return plan(*arguments)

    monkeypatch.setattr(command, "plan_scene", second)
    assert run(scene, out) == 0
    assert told == [2]
    assert "one process at a time" in capsys.readouterr().err


def test_a_search_that_fails_leaves_no_folder(tmp_path: Path, monkeypatch) -> None:
    scene = write_scene(tmp_path / "s.toml")
    scene.write_text(scene.read_text().replace("max_order = 0", "max_order = 0\npath_limit = 1"))
    assert run(scene, tmp_path / "new" / "out") == 2
    assert [p.name for p in tmp_path.iterdir()] == ["s.toml"]


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


@pytest.mark.parametrize("name", ["$\\\\frac$", "x" * 240, "CON/" + "é" * 200])
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
def test_wrong_arguments_are_told_in_a_line(arguments: list[str], message: str, tmp_path, capsys, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    write_scene(tmp_path / "s.toml")
    assert main(arguments) == 2
    err = capsys.readouterr().err
    assert err.startswith("clsim: error: ")
    assert message in err
    assert err.count("\n") == 1
    assert [p.name for p in tmp_path.iterdir()] == ["s.toml"]


def test_scene_files_may_begin_with_a_byte_order_mark(tmp_path: Path, capsys) -> None:
    scene = write_scene(tmp_path / "s.toml")
    scene.write_bytes(b"\xef\xbb\xbf" + scene.read_bytes())
    assert main(["check", str(scene)]) == 0
    scene.write_text('"" = 1\n' + (SCENE % (TONE, "right")), "utf-8")
    capsys.readouterr()
    assert main(["check", str(scene)]) == 2
    assert capsys.readouterr().err == f'clsim: error: {scene}: "": is no known key\n'
