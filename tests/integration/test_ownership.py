"""Nothing that others made is written over or removed, and no input ever."""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import soundfile
from made_results import WAV, everything, run, wav_input, write_scene

from clsim.cli import main


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
def test_what_others_made_stays(name: str, tmp_path: Path, error_of, monkeypatch) -> None:
    """It is refused before paths are searched for, and nothing is there that was not."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("clsim.workflow.pipeline.find_paths", lambda *a, **k: pytest.fail("the search had begun"))
    scene = write_scene(tmp_path / "s.toml")
    make, more = ATTACKS[name]
    make(tmp_path)
    before = everything(tmp_path)
    plots = [] if "pictures" in more else ["--no-plots"]
    options = [option for option in more if option != "pictures"]
    assert error_of("run", scene, *([] if "-o" in options else ["-o", "out"]), *plots, *options).startswith(
        "--output: must "
    )
    assert everything(tmp_path) == before


def over_sound_by_another_name(folder: Path) -> list[Any]:
    scene = wav_input(folder, "sounds/in.wav")
    (folder / "out").mkdir()
    os.link(folder / "sounds" / "in.wav", folder / "out" / "right.wav")
    return ["run", scene, "-o", folder / "out"]


def completed_again(folder: Path) -> list[Any]:
    assert run(write_scene(folder / "s.toml"), folder / "out") == 0
    return ["run", folder / "out" / "scene.completed.toml", "-o", folder / "out"]


def over_its_own_sound(folder: Path) -> list[Any]:
    assert run(write_scene(folder / "first.toml", name="other"), folder / "out") == 0
    return ["run", write_scene(folder / "s.toml", WAV % "out/other.wav"), "-o", folder / "out"]


def paths_over_sound(folder: Path) -> list[Any]:
    scene = wav_input(folder, "in.npz.wav")
    os.link(folder / "in.npz.wav", folder / "p.npz")
    return ["paths", scene, "-o", folder / "p.npz"]


def plot_over_table(folder: Path) -> list[Any]:
    (folder / "beam.csv").write_text("angle,1000,2000\n0,0,0\n90,-6,-9\n180,-12,-20\n")
    os.link(folder / "beam.csv", folder / "beam.png")
    return ["plot", "directivity", "--table", folder / "beam.csv", "--rear", "hold", "-o", folder / "beam.png"]


# By name: what makes the inputs in a folder, and the command that would write over one of them.
INPUTS: dict[str, Callable[[Path], list[Any]]] = {
    "run over sound": lambda f: ["run", wav_input(f, "right.wav"), "-o", f],
    "run over sound by another name": over_sound_by_another_name,
    "run over scene": lambda f: ["run", write_scene(f / "scene.completed.toml"), "-o", f],
    "run over record": lambda f: ["run", write_scene(f / "clsim.json"), "-o", f],
    "run with input at work": lambda f: ["run", wav_input(f, "out/.partial/left.wav"), "-o", f / "out"],
    "run with input in store": lambda f: ["run", wav_input(f, "out/recording.zarr/in.wav"), "-o", f / "out", "--store", "zarr"],
    "run of the completed scene again": completed_again, "run over its own sound": over_its_own_sound,
    "rir over sound": lambda f: ["rir", wav_input(f, "robot_left.wav"), "-o", f],
    "view over scene": lambda f: ["view", write_scene(f / "s.toml"), "-o", f / "s.toml"],
    "view beside a scene called html": lambda f: ["view", write_scene(f / "s.html")],
    "paths over sound": paths_over_sound, "plot over table": plot_over_table,
}  # fmt: skip


@pytest.mark.parametrize("name", INPUTS)
def test_no_input_is_written_over(name: str, tmp_path: Path, capsys, error_of) -> None:
    """Not even with --force."""
    arguments = INPUTS[name](tmp_path)
    before = everything(tmp_path)
    capsys.readouterr()
    assert error_of(*arguments, "--force").startswith("--output: must ")
    assert everything(tmp_path) == before


SINGLE = {
    "rir": ["rir", "s.toml", "-o", "x.npz"], "rir folder": ["rir", "s.toml", "-o", "."],
    "paths": ["paths", "s.toml", "-o", "x.npz"], "view": ["view", "s.toml", "--frames", "1"],
    "plot": ["plot", "air", "-o", "x.png"], "materials": ["materials", "concrete", "-o", "x.png"],
}  # fmt: skip
MADE = {"rir folder": "robot_left.wav", "view": "s.html", "plot": "x.png", "materials": "x.png"}


@pytest.mark.parametrize("name", SINGLE)
def test_single_files_are_not_written_over_unasked(name: str, tmp_path: Path, capsys, monkeypatch, error_of) -> None:
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
        assert "--output: must be " in error_of(*SINGLE[name], "--force")
        target.rmdir() if target.is_dir() else target.unlink()
    assert (tmp_path / "thesis").read_text() == "mine"


def test_what_comes_into_the_way_while_rendering_stays(tmp_path: Path, capsys, monkeypatch) -> None:
    from clsim.workflow import pipeline as streaming

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
