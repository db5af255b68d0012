"""Studies: members, indices and metrics, and what is damaged of them."""

import errno
import json
import shutil
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from exhaustive import few
from late import installed
from made_studies import METRICS, SCENE, index, runs, write, write_scene

import clsim
from clsim.cli import main
from clsim.study.file import load_study
from clsim.study.member import MemberTasks, as_row, row_of_group, run_member, study_to_settings
from clsim.study.run import Index, create_store, metrics_of, write_summary

installed("distributed")
installed("zarr")
xarray = installed("xarray")

COLUMNS = (
    "source", "receiver", "order", "interactions", "objects", "direct", "delay", "doppler_factor", "doppler_shift", "gain", "departure", "arrival",
)  # fmt: skip


@pytest.fixture
def folder_of_study(tmp_path: Path, device) -> Path:
    return write_scene(tmp_path)


def assert_member_is_what_the_scene_gives(folder_of_study: Path, loudness: float) -> None:
    scene = clsim.scene_file.load_scene(folder_of_study / "scene.toml")
    paths = clsim.find_paths(scene.scene, max_order=2)
    wanted = clsim.render(paths, 192e3)
    with clsim.open_store(folder_of_study / "out" / "study.zarr" / "m000002") as member:
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


def assert_only_what_is_asked_for_runs_again(folder_of_study: Path, arguments: list[str], error_of) -> None:
    """Again: refused; resumed: nothing is run; retried: only what failed."""
    before = runs(folder_of_study)
    assert "must hold no study yet" in error_of(*arguments)
    assert main([*arguments, "--resume"]) == 1
    assert runs(folder_of_study) == before
    (folder_of_study / "scene.toml").write_text(SCENE.replace("0.9", "0.8"), "utf-8")
    assert "content.room.walls.reflection was 0.9 and is 0.8; choose another folder" in error_of(*arguments, "--resume")
    (folder_of_study / "scene.toml").write_text(SCENE, "utf-8")
    (folder_of_study / "judge.py").write_text(METRICS + "\n", "utf-8")
    assert main([*arguments, "--retry", "--workers", "1"]) == 1
    counts = {member: len(processes) for member, processes in runs(folder_of_study).items()}
    assert counts == {(0, 1.0): 1, (0, 1.125): 2, (2, 1.0): 1, (2, 1.125): 2}
    # The index is only a table: without it, and with a torn line, the store is what counts.
    (folder_of_study / "out" / "index.jsonl").write_text('{"member": 1, "status": "fai', "utf-8")
    assert main([*arguments, "--resume", "--workers", "1"]) == 1
    assert {member: len(p) for member, p in runs(folder_of_study).items()} == counts | {(0, 1.125): 3, (2, 1.125): 3}


def test_members_that_failed_are_retried_with_corrected_metrics(folder_of_study: Path, capsys, error_of) -> None:
    """Those that are finished keep theirs, and a line says so; what else has changed is refused as ever."""
    arguments = [*write(folder_of_study, [0], [1.0, 1.125]), "--workers", "1"]
    assert main(arguments) == 1
    (folder_of_study / "judge.py").write_text(METRICS.replace("== 1.125", "== 7.0"), "utf-8")
    assert "judge.py was" in error_of(*arguments, "--resume")
    (folder_of_study / "scene.toml").write_text(SCENE.replace("0.9", "0.8"), "utf-8")
    assert "content.room.walls.reflection was" in error_of(*arguments, "--retry")
    (folder_of_study / "scene.toml").write_text(SCENE, "utf-8")
    assert main([*arguments, "--retry"]) == 0
    assert "metrics of 1 finished member stay those of judge.py before it changed" in capsys.readouterr().err
    assert {member: len(processes) for member, processes in runs(folder_of_study).items()} == {
        (0, 1.0): 1,
        (0, 1.125): 2,
    }
    assert main([*arguments, "--resume"]) == 0  # it is the present module that counts from now on
    assert "stay those" not in capsys.readouterr().err


@pytest.mark.slow
def test_a_study_is_a_store_of_its_members(folder_of_study: Path, capsys, error_of) -> None:
    arguments = write(folder_of_study, [0, 2], [1.0, 1.125])
    assert main([*arguments, "--workers", "2"]) == 1
    printed = capsys.readouterr()
    assert "2 of 4 members finished" in printed.out
    assert "member 1 failed: ValueError: not this one (judge.py, line 16)" in printed.err
    rows = index(folder_of_study)
    assert [rows[n]["status"] for n in range(4)] == ["finished", "failed", "finished", "failed"]
    assert rows[2]["parameters"] == {"order": 2, "length": 1.0}
    with xarray.open_zarr(folder_of_study / "out" / "study.zarr" / "summary") as summary:
        assert summary.order.values.tolist() == [0, 0, 2, 2]
        assert summary.status.values.tolist() == ["finished", "failed", "finished", "failed"]
        assert summary.paths_found.values[[0, 2]].tolist() == [2, 50]
        assert np.isnan(summary.rms.values[1]).all()
        loudness = summary.rms.sel(receiver="left").values
    assert_member_is_what_the_scene_gives(folder_of_study, loudness[2])
    assert_only_what_is_asked_for_runs_again(folder_of_study, arguments, error_of)


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (["--scheduler", "tcp://127.0.0.1:9"], "--scheduler: tcp://127.0.0.1:9 cannot be reached"),
        (["--scheduler", "nonsense://a:b"], "--scheduler: nonsense://a:b cannot be reached"),
        (["--workers", "0"], "--workers: must be at least 1, but is 0"),
        (["--limit", "1"], "vary: must give at most 1 members, but gives 2 (--limit 2 allows them)"),
    ],
)
def test_what_cannot_run_is_one_line(folder_of_study: Path, error_of, monkeypatch, more: list[str], message: str):
    monkeypatch.setattr("clsim.workflow.workers._REACH", 0.5)
    assert message in error_of(*write(folder_of_study, [0, 1], [1.0]), *more)
    assert not (folder_of_study / "out").exists(), "nothing was begun"


def test_a_worker_without_a_device_is_one_line(folder_of_study: Path, capfd) -> None:
    old = "sampling_rate = 192e3\n"
    assert SCENE.count(old) == 1
    (folder_of_study / "scene.toml").write_text(SCENE.replace(old, f'{old}device = "no such thing"\n'), "utf-8")
    assert main([*write(folder_of_study, [0], [1.0]), "--workers", "1"]) == 2
    err = capfd.readouterr().err
    assert err.startswith("clsim: error: ")
    assert "the device must be the id or part of the name of one of" in err
    assert err.count("\n") == 1
    assert not (folder_of_study / "out").exists(), "nothing was begun"


@pytest.mark.parametrize(
    ("body", "message"),
    [
        ("def other(): pass", "'judge:level' cannot be loaded: AttributeError"),
        ("level = 3", "must be a function, but 'judge:level' is 3"),
        ("import no_such_module", "'judge:level' cannot be loaded: ModuleNotFoundError"),
        ("def level(", "'judge:level' cannot be loaded: SyntaxError"),
    ],
)
def test_functions_that_cannot_be_used_are_one_line(folder_of_study: Path, error_of, body: str, message: str) -> None:
    arguments = write(folder_of_study, [0], [1.0])
    (folder_of_study / "judge.py").write_text(body, "utf-8")
    assert f"metrics: {message}" in error_of(*arguments)
    assert not (folder_of_study / "out").exists(), "nothing was begun"


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
def test_what_functions_return_is_checked(folder_of_study: Path, value: str, message: str) -> None:
    write(folder_of_study, [0], [1.0])
    (folder_of_study / "judge.py").write_text(
        f"def level(recording, paths, parameters):\n    return {value}\n", "utf-8"
    )
    (folder_of_study / "study.json").write_text(
        json.dumps(study_to_settings(load_study(folder_of_study / "study.toml"))), "utf-8"
    )
    row = run_member(str(folder_of_study), 0, None)
    assert row["status"] == "failed"
    assert message in row["error"]
    assert not (folder_of_study / "study.zarr").exists()


LENGTHS = [1.0, 1.001, 1.002]


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A study with all members in its store, made without a cluster."""
    folder = write_scene(tmp_path_factory.mktemp("study"))
    scene = (folder / "scene.toml").read_text("utf-8")
    (folder / "scene.toml").write_text(
        scene.replace("max_order = 1", "max_order = 0") + 'engine = "reference"\n', "utf-8"
    )
    arguments = write(folder, [0], LENGTHS)
    out = Path(arguments[-1])
    out.mkdir()
    settings = study_to_settings(load_study(folder / "study.toml"))
    (out / "study.json").write_text(json.dumps(settings), "utf-8")
    create_store(out)
    for number in range(len(LENGTHS)):
        row = run_member(str(out), number, None)
        assert row["status"] == "finished", row["error"]
    return folder


@pytest.fixture
def folder(finished: Path, tmp_path: Path) -> Path:
    copied = shutil.copytree(finished, tmp_path / "study")
    settings = study_to_settings(load_study(copied / "study.toml"))  # they name the folder of the function
    (copied / "out" / "study.json").write_text(json.dumps(settings), "utf-8")
    return copied


def members(folder: Path) -> Any:
    return load_study(folder / "study.toml").members


@pytest.mark.parametrize(
    "line",
    [
        b"3", b"null", b"[]", b'"failed"', b"{}", b'{"member": 1}', b'{"status": "failed"}', b"\xff\xfe\x00",
        b'{"member": [1], "status": "failed"}', b'{"member": {}, "status": "failed"}',
        b'{"member": true, "status": "failed"}', b'{"member": 1.0, "status": "failed"}',
        b'{"member": 1, "status": ["failed"]}', b'{"member": 1, "status": "no such"}',
        b'{"member": 1, "status": "failed", "seconds": "long"}', b'{"member": 1, "status": "failed", "error": 3}',
        b'{"member": 1, "status": "failed", "warnings": 3}', b'{"member": 1, "status": "failed", "warnings": [3]}',
        b'{"member": 1, "status": "failed", "device": null}', b'{"member": 99, "status": "failed"}',
        b'{"member": -1, "status": "failed"}', b"[" * 100_000, b'{"member": 1, "status": "fai',
    ],
)  # fmt: skip
def test_lines_of_the_index_that_are_no_rows_are_passed_over(tmp_path: Path, line: bytes) -> None:
    wanted = b'{"member": 2, "status": "failed", "error": "this one"}\n'
    (tmp_path / "index.jsonl").write_bytes(line + b"\n" + wanted)
    made = Index(tmp_path, tuple(SimpleNamespace(number=n, name=f"m{n:06d}", parameters={}) for n in range(3)))
    assert [row.status for row in made.rows.values()] == ["waiting", "waiting", "failed"]
    assert made.rows[2].error == "this one"


@pytest.mark.parametrize("content", ["", "{", "[]", "3", '{"content": ', "\0" * 100, "[" * 100_000, "{}"])
def test_settings_that_are_broken_are_one_line(folder: Path, error_of, content: str) -> None:
    (folder / "out" / "study.json").write_text(content, "utf-8")
    error = error_of("study", folder / "study.toml", "-o", folder / "out", "--resume")
    assert error.startswith("--resume: must go on with ")
    assert "choose another folder" in error


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-20])


def without_row(path: Path) -> None:
    metadata = json.loads(path.read_text("utf-8"))
    del metadata["attributes"]["study_row"]
    path.write_text(json.dumps(metadata), "utf-8")


def of_another(path: Path) -> None:
    path.write_bytes((path.parents[1] / "m000002" / "zarr.json").read_bytes())


@pytest.mark.parametrize(
    "damage",
    few([
        lambda group: cut(group / "zarr.json"),
        lambda group: (group / "zarr.json").write_bytes(b""),
        lambda group: (group / "zarr.json").write_bytes(b"[]"),
        lambda group: (group / "zarr.json").unlink(),
        lambda group: without_row(group / "zarr.json"),
        lambda group: of_another(group / "zarr.json"),
        lambda group: shutil.rmtree(group / "sound"),
        lambda group: shutil.rmtree(group) or group.write_text("a file", "utf-8"),
    ], (0, 4, 5, 6)),
    ids=["cut", "empty", "another kind", "missing", "no row", "of another member", "an array is missing", "a file"],
)  # fmt: skip
def test_a_broken_member_is_run_again(folder: Path, damage: Any) -> None:
    out = folder / "out"
    group = out / "study.zarr" / "m000001"
    damage(group)
    with pytest.warns(clsim.ClsimWarning, match=r"member 1 is run again: what .*m000001 holds is broken"):
        index = Index(out, members(folder))
    assert [row.status for row in index.rows.values()] == ["finished", "waiting", "finished"]
    assert index.todo(retry=False) == [1]
    assert not group.exists()
    assert list((out / ".partial").iterdir()) == []
    shutil.copytree(
        group.with_name("m000002"), group
    )  # broken while another process runs: it belongs to another member
    assert run_member(str(out), 1, None)["status"] == "finished"
    assert row_of_group(group)["member"] == 1


def test_metrics_that_cannot_be_read_fail_one_member(folder: Path) -> None:
    out = folder / "out"
    group = out / "study.zarr" / "m000001"
    chunks = [path for path in (group / "rms").rglob("*") if path.is_file() and path.name != "zarr.json"]
    for path in chunks:
        path.write_bytes(b"broken")
    index = Index(out, members(folder))
    (out / ".partial").mkdir(exist_ok=True)
    write_summary(out, index)
    assert [row.status for row in index.rows.values()] == ["finished", "failed", "finished"]
    assert "m000001 cannot be read: " in index.rows[1].error
    with xarray.open_zarr(out / "study.zarr" / "summary") as summary:
        assert np.isnan(summary.rms.values).tolist() == [[False, False], [True, True], [False, False]]
        assert summary.status.values.tolist() == ["finished", "failed", "finished"]
    assert isinstance(metrics_of(group), str)
    with pytest.warns(clsim.ClsimWarning, match="member 1 is run again"):
        assert Index(out, members(folder)).todo(retry=False) == [1]


@pytest.mark.parametrize("content", [b"", b"{", b"[]"])
def test_a_broken_root_of_the_store_is_made_again(folder: Path, content: bytes) -> None:
    out = folder / "out"
    (out / "study.zarr" / "zarr.json").write_bytes(content)
    create_store(out)
    with clsim.open_store(out / "study.zarr" / "m000001") as member:
        assert member.sound.values.any()
    assert json.loads((out / "study.zarr" / "zarr.json").read_bytes())["attributes"]["clsim_version"]


@pytest.mark.parametrize("name", ["study.zarr", "index.jsonl", ".partial"])
@pytest.mark.parametrize("more", [[], ["--resume"], ["--retry"]])
@pytest.mark.parametrize("kind", ["file", "folder", "link"])
def test_what_is_of_no_study_is_left_alone(tmp_path: Path, error_of, name: str, more: list[str], kind: str) -> None:
    arguments = [*write(write_scene(tmp_path), [0], [1.0]), *more]
    out = tmp_path / "out"
    out.mkdir()
    if kind == "file":
        (out / name).write_text("mine", "utf-8")
    elif kind == "folder":
        (out / name).mkdir()
        (out / name / "zarr.json").write_text("mine", "utf-8")
    else:
        (out / name).symlink_to(tmp_path / "elsewhere")
    assert error_of(*arguments).startswith(f"--output: must not hold {name} that is of no study")
    assert (kind, (out / name).is_symlink()) in (("file", False), ("folder", False), ("link", True))
    if kind != "link":
        assert next(p for p in (out / name, out / name / "zarr.json") if p.is_file()).read_text("utf-8") == "mine"


@pytest.mark.parametrize(
    ("body", "error"),
    [
        ("import sys; sys.exit(3)", "SystemExit: 3"),
        ("raise MemoryError", "MemoryError"),
        ("raise PermissionError(13, 'no')", "PermissionError: [Errno 13] no"),
        ("f = lambda: f(); f()", "RecursionError"),
    ],
)
def test_functions_that_end_the_process_fail_their_member(folder: Path, body: str, error: str) -> None:
    (folder / "judge.py").write_text(f"def level(recording, paths, parameters):\n    {body}\n", "utf-8")
    shutil.rmtree(folder / "out" / "study.zarr" / "m000001")
    row = run_member(str(folder / "out"), 1, None)
    assert row["status"] == "failed"
    assert row["error"].startswith(error)


def test_a_full_disk_stops_all_members(folder: Path) -> None:
    (folder / "judge.py").write_text(
        f"def level(recording, paths, parameters):\n    raise OSError({errno.ENOSPC}, 'full')\n", "utf-8"
    )
    shutil.rmtree(folder / "out" / "study.zarr" / "m000001")
    with pytest.raises(OSError, match="full"):
        run_member(str(folder / "out"), 1, None)


class Future(SimpleNamespace):
    def exception(self, timeout: float) -> Any:
        return self.error


def test_what_dask_tells_of_a_member_is_its_row(finished: Path, tmp_path: Path) -> None:
    from distributed import KilledWorker

    from clsim.workflow.workers import row_of

    tasks = MemberTasks(load_study(finished / "study.toml"), finished / "out")
    waiting = MemberTasks(load_study(finished / "study.toml"), tmp_path)
    killed = KilledWorker("clsim-3", SimpleNamespace(name="w", address="tcp://w"), 3)
    assert row_of(Future(status="error", error=killed), 3, waiting) is None
    row = row_of(Future(status="error", error=AttributeError("no such function")), 3, waiting)
    assert row == {"member": 3, "status": "failed", "error": "AttributeError: no such function", "seconds": 0.0}
    with pytest.raises(OSError, match="full"):
        row_of(Future(status="error", error=OSError(errno.ENOSPC, "full")), 3, waiting)
    for status in ("lost", "cancelled", "pending"):  # its worker died while the result was fetched
        assert row_of(Future(status=status), 3, waiting) is None
        assert row_of(Future(status=status), 1, tasks)["status"] == "finished"


def test_a_row_is_itself() -> None:
    row = {"member": 1, "status": "failed", "seconds": 1.5, "error": "x", "device": "0:0", "warnings": ["y"], "more": 1}
    assert as_row(json.dumps(row)) == row
