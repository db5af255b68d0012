"""Scene files to begin with, scores of a run's folder, completion, and what the command line says of itself."""

import csv
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from exhaustive import few

import clsim
from clsim.cli import main

BOX = "".join(
    f"v {x} {y} {z}\n" for z in (0, 2500) for x, y in ((0, 0), (6000, 0), (6000, 2000), (2000, 2000), (2000, 5000), (0, 5000))
) + "f 6 5 4 3 2 1\nf 7 8 9 10 11 12\n" + "".join(f"f {i + 1} {(i + 1) % 6 + 1} {(i + 1) % 6 + 7} {i + 7}\n" for i in range(6))  # fmt: skip
WALK = "".join(f"{k / 10} {-3 + 0.02 * k} {7 + 0.01 * k} 1.2 0 0 0 1\n" for k in range(40))

PULSES = """
format = 1
room = { kind = "shoebox", size = [4.0, 3.0, 2.5], walls = { reflection = 0.3 } }
[[sources]]
name = "robot"
trajectory = { kind = "fixed", position = [1, 1, 1] }
[sources.signal]
kind = "pulses"
period = 0.03
count = 3
pulse = { kind = "chirp", start = 30e3, stop = 50e3, duration = 2e-3, sampling_rate = 192e3, window = "hann" }
[[receivers]]
name = "ceiling"
trajectory = { kind = "fixed", position = [3.0, 1.0, 2.0] }
[paths]
max_order = 1
[render]
sampling_rate = 192e3
engine = "reference"
"""


def test_a_new_scene_can_be_rendered_as_it_is(tmp_path: Path, capsys: pytest.CaptureFixture[str], error_of) -> None:
    assert main(["new", str(tmp_path / "scene.toml")]) == 0
    file = clsim.load_scene(tmp_path / "scene.toml")
    assert len(clsim.find_paths(file.scene, **file.paths)) == 63
    assert "# A scene of clsim." in (tmp_path / "scene.toml").read_text("utf-8")
    capsys.readouterr()
    assert "must not exist yet" in error_of("new", tmp_path / "scene.toml")
    assert main(["new", str(tmp_path / "scene.toml"), "--force"]) == 0


def test_a_gap_in_a_trajectory_is_told_and_bridged_where_it_is_asked_for(tmp_path: Path, capsys) -> None:
    lines = WALK.splitlines(keepends=True)
    (tmp_path / "walk.tum").write_text("".join(lines[:4] + lines[-4:]), "utf-8")
    asked = ["new", str(tmp_path / "walk.toml"), "--trajectory", str(tmp_path / "walk.tum")]
    assert main(asked) == 2
    assert capsys.readouterr().err.rstrip().endswith("; bridge it by --max-gap")
    assert main([*asked, "--max-gap", "100"]) == 0
    assert "max_gap = 100," in (tmp_path / "walk.toml").read_text("utf-8")
    capsys.readouterr()
    assert main(["check", str(tmp_path / "walk.toml")]) == 0
    told = re.search(
        r"^sources\[0\].trajectory: \S+ m in (\S+) s, at most \S+ m/s$", capsys.readouterr().out, re.MULTILINE
    )
    trajectory = clsim.load_scene(tmp_path / "walk.toml").scene.sources[0].trajectory
    assert told is not None
    assert float(told[1]) == pytest.approx(trajectory.end - trajectory.start, rel=1e-3)


def test_a_mesh_and_a_trajectory_are_filled_in(tmp_path: Path) -> None:
    inside = tmp_path / "models"
    inside.mkdir()
    (inside / 'l "room".obj').write_text(BOX, "utf-8")
    (tmp_path / "walk.tum").write_text(WALK, "utf-8")
    mesh = ["--mesh", str(inside / 'l "room".obj'), "--scale", "0.001"]
    assert main(["new", str(tmp_path / "hall.toml"), *mesh]) == 0
    hall = clsim.load_scene(tmp_path / "hall.toml").scene
    np.testing.assert_allclose(hall.room.extent[1], [6.0, 5.0, 2.5])
    ends = np.stack([end.trajectory.position(0.0) for _, end in hall.named_ends()])
    assert hall.room.contains(ends).all()  # the L's middle is not in it
    assert main(["new", str(tmp_path / "walk.toml"), "--trajectory", str(tmp_path / "walk.tum")]) == 0
    walk = clsim.load_scene(tmp_path / "walk.toml").scene
    np.testing.assert_allclose(walk.sources[0].trajectory.position(0.0), [1.0, 1.0, 1.0], atol=1e-3)
    np.testing.assert_allclose(walk.room.extent[1], [2.8, 2.4, 2.0])


@pytest.mark.parametrize(
    ("text", "form"),
    [
        ("# t\n1.5 0 0 0 0 0 0 1\n", "tum"), ("t,x,y,z\n1,2,3,4\n", "csv"), ("1403636579763555584,1,2,3,1,0,0,0\n", "euroc"),
    ],
)  # fmt: skip
def test_formats_of_trajectories_are_told_apart(text: str, form: str, tmp_path: Path) -> None:
    from clsim.commands.new import _format

    (tmp_path / "x").write_text(text, "utf-8")
    assert _format(tmp_path / "x") == form


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the results of a source of three pulses."""
    folder = tmp_path_factory.mktemp("run")
    (folder / "scene.toml").write_text(PULSES, "utf-8")
    assert main(["run", str(folder / "scene.toml"), "-o", str(folder / "out"), "--no-plots", "--table", "none"]) == 0
    return folder / "out"


def test_a_run_is_scored(run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    capsys.readouterr()
    assert main(["score", str(run), "-o", str(tmp_path / "ranges.csv")]) == 0
    head, one, everything, written = capsys.readouterr().out.splitlines()
    assert head.split()[0] == "receiver"
    assert one.split()[:5] == ["ceiling", "100.0", "%", "100.0", "%"]
    assert everything.split()[1:] == one.split()[1:]
    assert written == str(tmp_path / "ranges.csv")
    with (tmp_path / "ranges.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [float(row["emission_time"]) for row in rows] == [0.0, 0.03, 0.06]
    assert all(abs(float(row["error"])) < 1e-3 and row["line_of_sight"] == "True" for row in rows)


def test_of_several_sources_it_is_told_whose_pulses_are_scored(tmp_path: Path, capsys) -> None:
    first, second = PULSES.index("[[sources]]"), PULSES.index("[[receivers]]")
    other = PULSES[first:second].replace('"robot"', '"drone"').replace("[1, 1, 1]", "[2, 2, 1]")
    text = (PULSES[:second] + other + PULSES[second:]).replace("count = 3", "count = 1")
    (tmp_path / "scene.toml").write_text(text, "utf-8")
    out = str(tmp_path / "out")
    assert main(["run", str(tmp_path / "scene.toml"), "-o", out, "--no-plots", "--table", "none"]) == 0
    capsys.readouterr()
    for asked, told in (([], "robot"), (["--source", "drone"], "drone")):
        assert main(["score", out, *asked]) == 0
        assert capsys.readouterr().out.splitlines()[0] == f"pulses of '{told}', one of 2 sources (--source)"


def test_what_cannot_be_scored_is_a_line(run: Path, tmp_path, capsys, error_of) -> None:
    assert "--source: must be one of \"robot\", but is 'x'" in error_of("score", run, "--source", "x")
    assert "--max-range: must be above 0" in error_of("score", run, "--max-range", "-1")
    assert main(["-v", "score", str(tmp_path)]) == 2
    told = capsys.readouterr().err
    assert "Traceback" in told
    assert told.splitlines()[-1].startswith("clsim: error: folder: must hold the results of a finished")


@pytest.mark.parametrize(
    ("line", "wanted"),
    few([
        ("clsim sc", {"schema", "score"}), ("clsim plot --he", {"--help "}), ("clsim run --st", {"--store "}),
        ("clsim run --engine ", {"opencl", "reference"}), ("clsim completion f", {"fish "}),
    ], (0, 3, 4)),
)  # fmt: skip
def test_a_shell_completes_commands_options_and_choices(line: str, wanted: set[str], tmp_path: Path) -> None:
    """The process is started as the script of ``clsim completion bash`` starts it."""
    found = tmp_path / "found"
    asked = {"_ARGCOMPLETE": "1", "_ARGCOMPLETE_STDOUT_FILENAME": str(found), "_ARGCOMPLETE_IFS": "\n"}
    asked |= {"COMP_LINE": line, "COMP_POINT": str(len(line)), "_ARGCOMPLETE_SHELL": "bash"}
    subprocess.run([sys.executable, "-m", "clsim"], env=os.environ | asked, check=True)
    assert set(found.read_text("utf-8").splitlines()) == wanted


def test_completion_prints_a_script_for_each_shell(capsys: pytest.CaptureFixture[str]) -> None:
    for shell in ("bash", "zsh", "fish"):
        assert main(["completion", shell]) == 0
        script = capsys.readouterr().out
        assert "_ARGCOMPLETE" in script
        assert "clsim" in script


def test_version_and_exit_statuses_are_told(capsys: pytest.CaptureFixture[str]) -> None:
    for flag, said in (("--version", f"clsim {clsim.__version__}"), ("--help", "exit status: 0 done; 1 members")):
        with pytest.raises(SystemExit) as ended:
            main([flag])
        assert ended.value.code == 0
        assert said in " ".join(capsys.readouterr().out.split())
