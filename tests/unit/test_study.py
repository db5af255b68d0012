"""Studies run by real worker processes: nothing is lost, nothing is run twice, what fails is told."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import clsim
from clsim.cli import main

pytest.importorskip("distributed")
pytest.importorskip("zarr")
xarray = pytest.importorskip("xarray")

ENVIRONMENT = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
SCENE = """
format = 1
[room]
kind = "shoebox"
size = [4.0, 3.0, 2.5]
walls = { reflection = 0.9 }
[[sources]]
name = "robot"
signal = { kind = "tone", frequency = 40e3, duration = 0.02, sampling_rate = 192e3, fade = 0.005 }
trajectory = { kind = "line", start = [1, 1, 1], end = [2, 1, 1], duration = 1.0 }
[[receivers]]
name = "left"
trajectory = { kind = "fixed", position = [3.0, 1.0, 2.0] }
[[receivers]]
name = "right"
trajectory = { kind = "fixed", position = [3.0, 2.0, 2.0] }
[paths]
max_order = 1
[render]
sampling_rate = 192e3
"""
# What ran is noted beside the study, a file per run and member.
METRICS = """
import os
import time
import uuid
from pathlib import Path

import numpy as np


def level(recording, paths, parameters):
    note = Path(__file__).parent / "ran"
    note.mkdir(exist_ok=True)
    (note / f"{parameters['order']}-{parameters['length']}-{os.getpid()}-{uuid.uuid4().hex}").touch()
    time.sleep(parameters["length"] % 1)
    if parameters["length"] == 1.125:
        raise ValueError("not this one")
    return {"rms": np.sqrt(np.mean(recording.samples**2, axis=1)), "paths_found": len(paths)}
"""
STUDY = """
format = 1
scene = "scene.toml"
metrics = "judge:level"
keep = ["recording", "truth", "paths", "metrics"]
[[vary]]
field = "paths.max_order"
name = "order"
values = %s
[[vary]]
field = "sources[0].trajectory.duration"
name = "length"
values = %s
"""


@pytest.fixture
def folder(tmp_path: Path, device) -> Path:
    (tmp_path / "scene.toml").write_text(SCENE, "utf-8")
    (tmp_path / "judge.py").write_text(METRICS, "utf-8")
    return tmp_path


def write(folder: Path, orders: list[int], seconds: list[float]) -> list[str]:
    (folder / "study.toml").write_text(STUDY % (orders, seconds), "utf-8")
    return ["study", str(folder / "study.toml"), "-o", str(folder / "out")]


def runs(folder: Path) -> dict[tuple[int, float], list[int]]:
    """Return the processes that ran each member to its metrics."""
    found: dict[tuple[int, float], list[int]] = {}
    for path in (folder / "ran").iterdir() if (folder / "ran").exists() else []:
        order, seconds, process, _ = path.name.split("-")
        found.setdefault((int(order), float(seconds)), []).append(int(process))
    return found


def index(folder: Path) -> dict[int, dict]:
    rows = [json.loads(line) for line in (folder / "out" / "index.jsonl").read_text("utf-8").splitlines()]
    assert len({row["member"] for row in rows}) == len(rows)
    return {row["member"]: row for row in rows}


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
    # What the store holds is what the scene gives.
    scene = clsim.scene_file.load_scene(folder / "scene.toml")
    paths = clsim.find_paths(scene.scene, max_order=2)
    wanted = clsim.render(scene.scene, paths, 192e3)
    with clsim.open_store(folder / "out" / "study.zarr" / "m000002") as member:
        # Within rounding: a worker has fewer threads, on which linear algebra makes other last digits of filters.
        np.testing.assert_allclose(
            member.sound.values, wanted.pressure, rtol=0, atol=1e-6 * np.abs(wanted.pressure).max()
        )
        assert loudness[2] == pytest.approx(np.sqrt(np.mean(wanted.pressure[0].astype(float) ** 2)), rel=1e-5)
        table = paths.table(member.instant.values)
        np.testing.assert_array_equal(member.path_delay.values, table.delay)
        np.testing.assert_array_equal(member.direct_delay.values[0], table.delay[table.direct])
        assert member.line_of_sight.values.all()
        c = scene.scene.air.sound_speed
        np.testing.assert_allclose(member.radial_speed.values[0], c * (1 - table.doppler[table.direct]), atol=1e-9)
        assert json.loads(member.attrs["parameters"]) == {"order": 2, "length": 1.0}
    # Again: refused; resumed: nothing is run; retried: only what failed.
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
    assert main([*arguments, "--resume"]) == 1
    assert {member: len(p) for member, p in runs(folder).items()} == counts | {(0, 1.125): 3, (2, 1.125): 3}


@pytest.fixture
def cluster(folder: Path) -> Iterator[tuple[str, list[subprocess.Popen]]]:
    """A scheduler and two workers on loopback, processes of their own; the workers are not replaced."""
    base = [sys.executable, "-m"]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "env": ENVIRONMENT}
    note = folder / "scheduler.json"
    scheduler = subprocess.Popen(
        [*base, "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard",
         "--scheduler-file", str(note)], **quiet,
    )  # fmt: skip
    deadline = time.monotonic() + 60
    while not (note.exists() and note.stat().st_size) and time.monotonic() < deadline:
        time.sleep(0.05)
    address = json.loads(note.read_text("utf-8"))["address"]
    worker = [*base, "distributed.cli.dask_worker", address, "--nthreads", "1", "--no-nanny", "--no-dashboard"]
    worker += ["--host", "127.0.0.1", "--local-directory", str(folder / "space")]
    workers = [subprocess.Popen(worker, **quiet) for _ in range(2)]
    yield address, workers
    for process in [*workers, scheduler]:
        process.kill()
        process.wait()


@pytest.mark.slow
def test_a_worker_of_this_machine_that_dies_is_replaced(folder: Path) -> None:
    seconds = [1.25 + 0.001 * i for i in range(12)]
    arguments = [sys.executable, "-m", "clsim.cli", *write(folder, [0], seconds), "--workers", "2"]
    study = subprocess.Popen(arguments, env=ENVIRONMENT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    while study.poll() is None and len(runs(folder)) < 4:
        time.sleep(0.02)
    first = {p for processes in runs(folder).values() for p in processes}
    os.kill(min(first), signal.SIGKILL)
    out, err = study.communicate(timeout=300)
    assert study.returncode == 0, err
    assert "12 of 12 members finished" in out
    assert len({p for processes in runs(folder).values() for p in processes}) == 3


@pytest.mark.slow
def test_each_worker_has_a_device_of_its_own(folder: Path) -> None:
    arguments = [sys.executable, "-m", "clsim.cli", *write(folder, [0], [1.25 + 0.001 * i for i in range(6)])]
    two = ENVIRONMENT | {"POCL_DEVICES": "pthread pthread"}
    done = subprocess.run([*arguments, "--workers", "2"], env=two, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    processes: dict[str, set[int]] = {}
    for n, row in index(folder).items():
        processes.setdefault(row["device"].split()[0], set()).update(runs(folder)[0, 1.25 + 0.001 * n])
    listed = subprocess.run(
        [sys.executable, "-m", "clsim.cli", "devices"], env=two, capture_output=True, text=True, check=True
    )
    assert sorted(processes) == [line.split()[0] for line in listed.stdout.splitlines() if "Portable" in line]
    assert all(len(found) == 1 for found in processes.values())


@pytest.mark.slow
def test_a_killed_worker_loses_nothing(folder: Path, cluster) -> None:
    address, workers = cluster
    seconds = [1.25 + 0.001 * i for i in range(12)]
    arguments = [sys.executable, "-m", "clsim.cli", *write(folder, [0], seconds), "--scheduler", address]
    study = subprocess.Popen(arguments, env=ENVIRONMENT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    while study.poll() is None and len(runs(folder)) < 4:
        time.sleep(0.02)
    workers[0].kill()  # kill -9, in the middle of a member
    finished = {p.name for p in (folder / "out" / "study.zarr").glob("m*")}
    out, err = study.communicate(timeout=300)
    assert study.returncode == 0, err
    assert "12 of 12 members finished" in out
    ran = runs(folder)
    assert len(ran) == 12
    again = [member for member, processes in ran.items() if len(processes) > 1]
    assert len(again) <= 1, "only what the killed worker was at is run again"
    assert not {f"m{seconds.index(member[1]):06d}" for member in again} & finished
    assert {p for processes in ran.values() for p in processes} == {w.pid for w in workers}


@pytest.mark.slow
def test_a_killed_study_goes_on(folder: Path) -> None:
    arguments = [*write(folder, [0], [1.25 + 0.001 * i for i in range(10)]), "--workers", "2"]
    study = subprocess.Popen(
        [sys.executable, "-m", "clsim.cli", *arguments], env=ENVIRONMENT, start_new_session=True,
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    store = folder / "out" / "study.zarr"
    while study.poll() is None and len(list(store.glob("m*"))) < 3:
        time.sleep(0.02)
    os.killpg(study.pid, signal.SIGKILL)  # the power fails: workers die too
    study.wait()
    finished = {p.name for p in store.glob("m*")}
    assert 3 <= len(finished) < 10
    stamps = {name: (store / name / "zarr.json").stat().st_mtime_ns for name in finished}
    assert main([*arguments, "--resume"]) == 0
    assert stamps == {name: (store / name / "zarr.json").stat().st_mtime_ns for name in finished}
    assert {row["status"] for row in index(folder).values()} == {"finished"}
    assert len(list(store.glob("m*"))) == 10
    assert not (folder / "out" / ".partial").exists()


def test_a_full_disk_stops_a_study(folder: Path, capsys) -> None:
    disk = folder / "disk"
    disk.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=2m", "tmpfs", str(disk)]
    if os.geteuid() != 0 or shutil.which("mount") is None or subprocess.run(mount, capture_output=True).returncode:
        pytest.skip("only root may mount a small disk")
    try:
        lengths = [1.0 + 0.001 * i for i in range(30)]
        arguments = [*write(folder, [0], lengths)[:-1], str(disk / "out"), "--workers", "1"]
        assert main(arguments) == 2
        err = capsys.readouterr().err
        assert err.startswith("clsim: error: [Errno 28] No space left on device")
        assert "--resume goes on" in err
        assert err.count("\n") == 1
        finished = {p.name for p in (disk / "out" / "study.zarr").glob("m*")}
        assert 0 < len(finished) < 30
        subprocess.run(["mount", "-o", "remount,size=64m", str(disk)], check=True)
        assert main([*arguments, "--resume"]) == 0
        again = {i for i, length in enumerate(lengths) if len(runs(folder)[0, length]) > 1}
        assert again  # at least the one that found the disk full
        assert not again & {int(name[1:]) for name in finished}
    finally:
        subprocess.run(["umount", str(disk)], check=True)


def test_an_interrupted_study_is_one_line(folder: Path) -> None:
    arguments = [sys.executable, "-m", "clsim.cli", *write(folder, [0], [1.5 + 0.001 * i for i in range(40)])]
    study = subprocess.Popen(
        arguments,
        env=ENVIRONMENT,
        start_new_session=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # where the tests themselves ignore it, too
    )
    while study.poll() is None and not list((folder / "out" / "study.zarr").glob("m*")):
        time.sleep(0.02)
    os.killpg(study.pid, signal.SIGINT)  # Ctrl-C goes to all processes of a terminal
    _, err = study.communicate(timeout=120)
    assert study.returncode == 130, err
    assert err == f"clsim: interrupted; what is finished is kept in {folder / 'out'}: --resume goes on with it\n"


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (["--scheduler", "tcp://127.0.0.1:9"], "--scheduler: tcp://127.0.0.1:9 cannot be reached"),
        (["--scheduler", "nonsense://a:b"], "--scheduler: nonsense://a:b cannot be reached"),
        (["--workers", "0"], "--workers: must be at least 1, but is 0"),
        (["--limit", "1"], "vary: must give at most 1 members, but gives 2 (--limit 2 allows them)"),
    ],
)
def test_what_cannot_run_is_one_line(folder: Path, capsys, more: list[str], message: str) -> None:
    assert main([*write(folder, [0, 1], [1.0]), *more]) == 2
    err = capsys.readouterr().err
    assert err.startswith(f"clsim: error: {message}")
    assert err.count("\n") == 1


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "sampling_rate = 192e3\n",
            'sampling_rate = 192e3\ndevice = "no such thing"\n',
            "no OpenCL device is or is called",
        ),
    ],
)
def test_a_worker_without_a_device_is_one_line(folder: Path, capfd, old: str, new: str, message: str) -> None:
    assert SCENE.count(old) == 1
    (folder / "scene.toml").write_text(SCENE.replace(old, new), "utf-8")
    assert main([*write(folder, [0], [1.0]), "--workers", "1"]) == 2
    err = capfd.readouterr().err
    assert err.startswith("clsim: error: worker tcp://127.0.0.1:")
    assert message in err
    assert err.count("\n") == 1


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
