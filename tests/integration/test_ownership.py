"""Nothing that others made is written over or removed, and no input ever."""

import os
from collections.abc import Callable
from pathlib import Path

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
        "plot", "directivity", "--table", str(folder / "beam.csv"), "--rear", "hold", "-o", str(folder / "beam.png"),
    ]  # fmt: skip


INPUTS = [
    run_over_sound, run_over_sound_by_another_name, run_over_scene, run_over_record, run_with_input_at_work,
    run_with_input_in_store, rerun_completed, rerun_on_own_sound, rir_over_sound, view_over_scene,
    view_beside_a_scene_called_html, paths_over_sound, plot_over_table,
]  # fmt: skip


@pytest.mark.parametrize("attack", INPUTS, ids=lambda f: f.__name__)
def test_no_input_is_written_over(attack: Callable[[Path], list[str]], tmp_path: Path, capsys, error_of) -> None:
    """Not even with --force."""
    arguments = attack(tmp_path)
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
