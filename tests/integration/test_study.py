"""Studies run by real worker processes: what comes out, and what is told of what cannot run."""

import json
from pathlib import Path

import numpy as np
import pytest
from late import installed
from made_studies import METRICS, SCENE, index, runs, write, write_scene

import clsim
from clsim.cli import main

installed("distributed")
installed("zarr")
xarray = installed("xarray")

COLUMNS = (
    "source", "receiver", "order", "interactions", "objects", "direct", "delay", "doppler_factor", "doppler_shift", "gain", "departure", "arrival",
)  # fmt: skip


@pytest.fixture
def folder(tmp_path: Path, device) -> Path:
    return write_scene(tmp_path)


def assert_member_is_what_the_scene_gives(folder: Path, loudness: float) -> None:
    scene = clsim.scene_file.load_scene(folder / "scene.toml")
    paths = clsim.find_paths(scene.scene, max_order=2)
    wanted = clsim.render(paths, 192e3)
    with clsim.open_store(folder / "out" / "study.zarr" / "m000002") as member:
        # Within rounding: a worker has fewer threads, on which linear algebra makes other last digits of filters.
        np.testing.assert_allclose(
            member.sound.values, wanted.pressure, rtol=0, atol=1e-6 * np.abs(wanted.pressure).max()
        )
        assert loudness == pytest.approx(np.sqrt(np.mean(wanted.pressure[0].astype(float) ** 2)), rel=1e-5)
        table, truth = paths.table(member.times.values), clsim.direct_path(paths, member.times.values)
        for name in ("delay", "doppler_factor", "line_of_sight", "radial_speed", "times"):
            np.testing.assert_array_equal(member[name].values, getattr(truth, name))
        for name in COLUMNS:
            np.testing.assert_array_equal(member[f"path_{name}"].values, getattr(table, name))
        np.testing.assert_array_equal(member.delay.values[0], table.delay[table.direct])
        np.testing.assert_array_equal(member.doppler_factor.values[0], table.doppler_factor[table.direct])
        assert json.loads(member.attrs["parameters"]) == {"order": 2, "length": 1.0}


def assert_only_what_is_asked_for_runs_again(folder: Path, arguments: list[str], capsys) -> None:
    """Again: refused; resumed: nothing is run; retried: only what failed."""
    before = runs(folder)
    assert main(arguments) == 2
    assert "must hold no study yet" in capsys.readouterr().err
    assert main([*arguments, "--resume"]) == 1
    assert runs(folder) == before
    (folder / "scene.toml").write_text(SCENE.replace("0.9", "0.8"), "utf-8")
    assert main([*arguments, "--resume"]) == 2
    assert "content.room.walls.reflection was 0.9 and is 0.8; choose another folder" in capsys.readouterr().err
    (folder / "scene.toml").write_text(SCENE, "utf-8")
    (folder / "judge.py").write_text(METRICS + "\n", "utf-8")
    assert main([*arguments, "--retry"]) == 2
    assert "judge.py was" in capsys.readouterr().err
    (folder / "judge.py").write_text(METRICS, "utf-8")
    assert main([*arguments, "--retry", "--workers", "1"]) == 1
    counts = {member: len(processes) for member, processes in runs(folder).items()}
    assert counts == {(0, 1.0): 1, (0, 1.125): 2, (2, 1.0): 1, (2, 1.125): 2}
    # The index is only a table: without it, and with a torn line, the store is what counts.
    (folder / "out" / "index.jsonl").write_text('{"member": 1, "status": "fai', "utf-8")
    assert main([*arguments, "--resume", "--workers", "1"]) == 1
    assert {member: len(p) for member, p in runs(folder).items()} == counts | {(0, 1.125): 3, (2, 1.125): 3}


@pytest.mark.slow
def test_a_study_is_a_store_of_its_members(folder: Path, capsys) -> None:
    arguments = write(folder, [0, 2], [1.0, 1.125])
    assert main([*arguments, "--workers", "2"]) == 1
    printed = capsys.readouterr()
    assert "2 of 4 members finished" in printed.out
    assert "member 1 failed: ValueError: not this one (judge.py, line 16)" in printed.err
    rows = index(folder)
    assert [rows[n]["status"] for n in range(4)] == ["finished", "failed", "finished", "failed"]
    assert rows[2]["parameters"] == {"order": 2, "length": 1.0}
    with xarray.open_zarr(folder / "out" / "study.zarr" / "summary") as summary:
        assert summary.order.values.tolist() == [0, 0, 2, 2]
        assert summary.status.values.tolist() == ["finished", "failed", "finished", "failed"]
        assert summary.paths_found.values[[0, 2]].tolist() == [2, 50]
        assert np.isnan(summary.rms.values[1]).all()
        loudness = summary.rms.sel(receiver="left").values
    assert_member_is_what_the_scene_gives(folder, loudness[2])
    assert_only_what_is_asked_for_runs_again(folder, arguments, capsys)


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (["--scheduler", "tcp://127.0.0.1:9"], "--scheduler: tcp://127.0.0.1:9 cannot be reached"),
        (["--scheduler", "nonsense://a:b"], "--scheduler: nonsense://a:b cannot be reached"),
        (["--workers", "0"], "--workers: must be at least 1, but is 0"),
        (["--limit", "1"], "vary: must give at most 1 members, but gives 2 (--limit 2 allows them)"),
    ],
)
def test_what_cannot_run_is_one_line(
    folder: Path, capsys, monkeypatch: pytest.MonkeyPatch, more: list[str], message: str
) -> None:
    monkeypatch.setattr("clsim.cluster.workers._REACH", 0.5)
    assert main([*write(folder, [0, 1], [1.0]), *more]) == 2
    err = capsys.readouterr().err
    assert err.startswith(f"clsim: error: {message}")
    assert err.count("\n") == 1
    assert not (folder / "out").exists(), "nothing was begun"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "sampling_rate = 192e3\n",
            'sampling_rate = 192e3\ndevice = "no such thing"\n',
            "the device must be the id or part of the name of one of",
        ),
    ],
)
def test_a_worker_without_a_device_is_one_line(folder: Path, capfd, old: str, new: str, message: str) -> None:
    assert SCENE.count(old) == 1
    (folder / "scene.toml").write_text(SCENE.replace(old, new), "utf-8")
    assert main([*write(folder, [0], [1.0]), "--workers", "1"]) == 2
    err = capfd.readouterr().err
    assert err.startswith("clsim: error: ")
    assert message in err
    assert err.count("\n") == 1
    assert not (folder / "out").exists(), "nothing was begun"


@pytest.mark.parametrize(
    ("body", "message"),
    [
        ("def other(): pass", "'judge:level' cannot be loaded: AttributeError"),
        ("level = 3", "must be a function, but 'judge:level' is 3"),
        ("import no_such_module", "'judge:level' cannot be loaded: ModuleNotFoundError"),
        ("def level(", "'judge:level' cannot be loaded: SyntaxError"),
    ],
)
def test_functions_that_cannot_be_used_are_one_line(folder: Path, capsys, body: str, message: str) -> None:
    arguments = write(folder, [0], [1.0])
    (folder / "judge.py").write_text(body, "utf-8")
    assert main(arguments) == 2
    err = capsys.readouterr().err
    assert f"clsim: error: metrics: {message}" in err
    assert err.count("\n") == 1
    assert not (folder / "out").exists(), "nothing was begun"


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ("3", "must return a dict, but returned 3"),
        ("{'a': 'b'}", "must return numbers, but a is 'b'"),
        ("{'sound': 1}", "must return names that are not taken yet, but returned 'sound'"),
        ("{'order': 1}", "must return names that are not taken yet, but returned 'order'"),
        ("{'seconds': 1}", "must return names that are not taken yet, but returned 'seconds'"),
        ("{'a b': 1}", "must return names that are not taken yet, but returned 'a b'"),
        ("[][0]", "IndexError: list index out of range (judge.py, line 2)"),
    ],
)
def test_what_functions_return_is_checked(folder: Path, value: str, message: str) -> None:
    from clsim.study.file import load_study
    from clsim.study.member import run_member, study_to_settings

    write(folder, [0], [1.0])
    (folder / "judge.py").write_text(f"def level(recording, paths, parameters):\n    return {value}\n", "utf-8")
    (folder / "study.json").write_text(json.dumps(study_to_settings(load_study(folder / "study.toml"))), "utf-8")
    row = run_member(str(folder), 0, None)
    assert row["status"] == "failed"
    assert message in row["error"]
    assert not (folder / "study.zarr").exists()
