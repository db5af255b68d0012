"""The command line as a user meets it."""

import os
import signal
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
import soundfile
from made_results import read_table
from scene_texts import along, receiver_at, scene_text, source_at, tone_of

from clsim.cli import main

SCENE = scene_text(
    source_at("robot", tone_of(40e3, "%s", fade=0.005), along((1, 1, 1), (2, 1, 1), 40.0)),
    receiver_at("über/left", (3.0, 1.0, 2.0)),
    receiver_at("right", (3.0, 2.0, 2.0)),
    max_order=2,
)


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    path = tmp_path / "scene.toml"
    path.write_text(SCENE % "0.05", "utf-8")
    return path


def test_run_writes_all_it_promises(scene: Path, tmp_path: Path, capsys, device) -> None:
    out = tmp_path / "out"
    assert main(["run", str(scene), "-o", str(out)]) == 0
    printed = capsys.readouterr()
    names = {
        "ber_left.wav", "right.wav", "paths.npz", "ber_left_spectrogram.png", "right_spectrogram.png",
        "ber_left_echogram.png", "right_echogram.png", "ground_truth.npz", "scene.completed.toml", "clsim.json",
    }  # fmt: skip
    assert {p.name for p in out.iterdir()} == names
    assert {Path(line).name for line in printed.out.split()} == names - {"clsim.json"}
    assert printed.err == ""
    samples, rate = soundfile.read(out / "right.wav")
    assert rate == 192_000
    assert np.any(samples)
    table = read_table(out / "paths.npz")
    assert table.receiver_names == ("über/left", "right")
    # The completed scene gives the same sound.
    assert (
        main(["run", str(out / "scene.completed.toml"), "-o", str(tmp_path / "again"), "--no-plots", "--table", "none"])
        == 0
    )
    np.testing.assert_array_equal(soundfile.read(tmp_path / "again" / "right.wav")[0], samples)
    assert tomllib.loads((out / "scene.completed.toml").read_text("utf-8"))["render"]["duration"] > 0.05


def test_check_and_paths_say_what_there_is(scene: Path, tmp_path: Path, capsys) -> None:
    assert main(["check", str(scene)]) == 0
    out = capsys.readouterr().out
    assert "50 paths from 1 source to 2 receivers" in out
    assert "valid" in out
    assert main(["paths", str(scene), "--limit", "3"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 5
    assert "direct" in lines[1]
    assert main(["paths", str(scene), "-o", str(tmp_path / "p.npz")]) == 0
    assert read_table(tmp_path / "p.npz").delay.shape == (50, 1)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("max_order = 2", "max_order = 99"), "scene.toml: paths.max_order: must be from 0 to 60, but is 99"),
        (("max_order = 2", "max_order = -2"), "scene.toml: paths.max_order: must be at least 0, but is -2"),
        (
            ("sampling_rate = 192e3\n", "sampling_rate = 192e3\nchunk = 0\n"),
            "scene.toml: render.chunk: must be at least 1",
        ),
        (("[3.0, 1.0, 2.0]", "[3.0, 1.0, 2.6]"), "receivers[0].trajectory"),
        (("[3.0, 1.0, 2.0]", "[3.0, 1.0, nan]"), "receivers[0].trajectory.position[2]"),
        (("reflection", "reflektion"), "room.walls.reflektion"),
        (("max_order", "max_ordre"), 'scene.toml: paths.max_ordre: is no known key; did you mean "max_order"?'),
        (("format = 1", "format = "), "scene.toml"),
        (("sampling_rate = 192e3\n", "sampling_rate = 70e3\n"), "frequency"),
    ],
)
def test_errors_are_one_line_and_status_2(scene: Path, error_of, change: tuple[str, str], message: str) -> None:
    text = scene.read_text("utf-8")
    assert change[0] in text
    scene.write_text(text.replace(*change), "utf-8")
    assert message in error_of("check", scene)


def test_unwritable_output_is_one_line(scene: Path, tmp_path: Path, error_of, device) -> None:
    (tmp_path / "file").write_text("in the way")
    assert "file" in error_of("run", scene, "-o", tmp_path / "file" / "out")


def test_full_disk_leaves_nothing(scene: Path, tmp_path: Path, device) -> None:
    resource = pytest.importorskip("resource")
    code = (
        "import resource, signal, sys; signal.signal(signal.SIGXFSZ, signal.SIG_IGN);"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (2_000_000, 2_000_000));"
        f"from clsim.cli import main; sys.exit(main(['run', {str(scene)!r}, '-o', {str(tmp_path / 'out')!r}]))"
    )
    assert resource
    scene.write_text(SCENE % "3.0", "utf-8")
    done = subprocess.run([sys.executable, "-B", "-c", code], capture_output=True, text=True)  # no bytecode cut short
    assert done.returncode == 2, done.stderr
    assert "Traceback" not in done.stderr
    assert done.stderr.splitlines()[-1].startswith("clsim: error: ")
    assert "MiB are needed" in done.stderr
    assert not (tmp_path / "out").exists()


def test_interrupt_leaves_nothing_that_looks_whole(scene: Path, tmp_path: Path, capsys, monkeypatch, device) -> None:
    from clsim.workflow import pipeline as streaming

    render = streaming.render_chunks

    def interrupted(*arguments, **options):
        for number, piece in enumerate(render(*arguments, **options)):
            if number == 2:
                os.kill(os.getpid(), signal.SIGINT)
            yield piece

    monkeypatch.setattr(streaming, "render_chunks", interrupted)
    scene.write_text((SCENE % "0.5").replace("[render]\n", "[render]\nchunk = 18432\n"), "utf-8")
    out = tmp_path / "out"
    deaf = signal.signal(signal.SIGINT, signal.default_int_handler)  # as tests run in the background are
    try:
        assert main(["run", str(scene), "-o", str(out)]) == 130
    finally:
        signal.signal(signal.SIGINT, deaf)
    told = f"clsim: interrupted; what was rendered is kept in {out / '.partial'}: --resume goes on with it\n"
    assert capsys.readouterr().err == told
    assert [p.name for p in out.iterdir()] == [".partial"]


def test_devices_lists_or_tells_what_to_install(capsys, monkeypatch: pytest.MonkeyPatch) -> None:
    status = main(["devices"])
    printed = capsys.readouterr()
    assert status == (0 if printed.out else 2)
    assert printed.out.startswith("0:0") or "install" in printed.err


def test_a_full_disk_names_the_file(scene: Path, tmp_path: Path, error_of, monkeypatch: pytest.MonkeyPatch) -> None:
    if not Path("/dev/full").exists():
        pytest.skip("no /dev/full on this machine")
    target = tmp_path / "page.html"
    monkeypatch.setattr("clsim.files.atomic.temporary_path", lambda path: Path("/dev/full"))
    monkeypatch.setattr(Path, "unlink", lambda self, missing_ok=False: None)
    said = error_of("view", scene, "--frames", "1", "-o", target)
    assert said == f"[Errno 28] No space left on device: {str(target)!r}"
    assert not target.exists()
