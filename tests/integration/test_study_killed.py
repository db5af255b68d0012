"""Studies whose workers die, whose disk fills or that are stopped: nothing is lost, nothing is run twice."""

import contextlib
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from late import installed
from made_clusters import Worker, made_cluster
from made_studies import ENVIRONMENT, METRICS, index, runs, write, write_scene

from clsim.cli import main
from clsim.workflow import processes as dispatch

psutil = installed("psutil")  # comes with distributed
installed("distributed")
installed("zarr")
installed("xarray")


@pytest.fixture
def folder(tmp_path: Path, device) -> Path:
    return write_scene(tmp_path)


@pytest.fixture
def cluster(folder: Path) -> Iterator[tuple[str, list[Worker]]]:
    """Start a scheduler and two workers."""
    with made_cluster(folder, 2) as made:
        yield made


def workers_of(study: subprocess.Popen) -> list[int]:
    """Return the worker processes of a study, those that are only starting too: forked by one that has loaded all."""
    with contextlib.suppress(psutil.Error):
        return [p.pid for child in psutil.Process(study.pid).children() for p in child.children()]
    return []


INTERRUPTED = [1.25 + 0.001 * i for i in range(40)]  # lengths of the members of a study that is interrupted


def members_of_processes(folder: Path) -> dict[int, list[int]]:
    """Return the members that each process ran to their metrics."""
    found: dict[int, list[int]] = {}
    for (_, length), processes in runs(folder).items():
        for process in processes:
            found.setdefault(process, []).append(round((length - INTERRUPTED[0]) / 0.001))
    return found


def kill_at_random(study: subprocess.Popen, store: Path, kills: int, chance: random.Random) -> int:
    """Kill workers of a study until it ends, the first as soon as there is one, others as members go by; count them."""
    killed, members = 0, 0
    while study.poll() is None:
        time.sleep(chance.uniform(0.0, 0.05))
        found = workers_of(study)
        if killed == kills:
            study.wait(timeout=1200)
        elif found and len(list(store.glob("m*"))) >= members:
            time.sleep(chance.uniform(0.0, 0.5) if killed else 0.0)
            with contextlib.suppress(ProcessLookupError):
                os.kill(chance.choice(found), signal.SIGKILL)
                killed, members = killed + 1, members + chance.randint(1, 8)
    return killed


@pytest.mark.exhaustive
@pytest.mark.slow
def test_workers_killed_at_random_lose_nothing(folder: Path) -> None:
    """STUDY_KILLS says how many are killed, over as many studies as it takes."""
    left, chance = int(os.environ.get("STUDY_KILLS", "3")), random.Random(1)
    while left > 0:
        shutil.rmtree(folder / "out", ignore_errors=True)
        shutil.rmtree(folder / "ran", ignore_errors=True)
        seconds = [1.125 + 0.0005 * (i + 1) for i in range(min(60, 5 * left))]
        arguments = [sys.executable, "-m", "clsim", *write(folder, [0], seconds), "--workers", "2"]
        study = subprocess.Popen(arguments, env=ENVIRONMENT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        left -= kill_at_random(study, folder / "out" / "study.zarr", left, chance)
        out, err = study.communicate(timeout=10)
        assert study.returncode == 0, err
        assert err == ""
        assert f"{len(seconds)} of {len(seconds)} members finished" in out
        assert {row["status"] for row in index(folder).values()} == {"finished"}
        assert not (folder / "out" / ".partial").exists()


@pytest.mark.slow
def test_a_member_that_kills_its_worker_fails_alone(folder: Path, monkeypatch: pytest.MonkeyPatch, capfd) -> None:
    monkeypatch.setattr(dispatch, "_TOGETHER", 1)  # fewer tries, for time
    monkeypatch.setattr(dispatch, "_ALONE", 1)
    arguments = write(folder, [0, 1, 2], [1.0])
    killer = METRICS.replace("    time.sleep", "    parameters['order'] or os.kill(os.getpid(), 9)\n    time.sleep")
    (folder / "judge.py").write_text(killer, "utf-8")
    assert main([*arguments, "--workers", "1"]) == 1
    assert [index(folder)[n]["status"] for n in range(3)] == ["failed", "finished", "finished"]
    assert {order: len(processes) for (order, _), processes in runs(folder).items()} == {0: 2, 1: 1, 2: 1}
    err = capfd.readouterr().err
    assert err == (
        "clsim: member 0 failed: its worker died 2 times, the last 1 while it ran nothing else (out of memory?)\n"
    )


@pytest.mark.exhaustive
@pytest.mark.slow
def test_a_killed_worker_loses_nothing(folder: Path, cluster) -> None:
    address, workers = cluster
    seconds = [1.25 + 0.001 * i for i in range(8)]
    arguments = [sys.executable, "-m", "clsim", *write(folder, [0], seconds), "--scheduler", address]
    study = subprocess.Popen(arguments, env=ENVIRONMENT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    while study.poll() is None and len(runs(folder)) < 4:
        time.sleep(0.02)
    workers[0].kill()  # kill -9, in the middle of a member
    finished = {p.name for p in (folder / "out" / "study.zarr").glob("m*")}
    out, err = study.communicate(timeout=300)
    assert study.returncode == 0, err
    assert "8 of 8 members finished" in out
    ran = runs(folder)
    assert len(ran) == 8
    again = [member for member, processes in ran.items() if len(processes) > 1]
    assert len(again) <= 1, "only what the killed worker was at is run again"
    assert not {f"m{seconds.index(member[1]):06d}" for member in again} & finished
    assert {p for processes in ran.values() for p in processes} == {w.pid for w in workers}


@pytest.mark.exhaustive
@pytest.mark.slow
def test_a_killed_study_goes_on(folder: Path) -> None:
    arguments = [*write(folder, [0], [1.25 + 0.001 * i for i in range(7)]), "--workers", "2"]
    study = subprocess.Popen(
        [sys.executable, "-m", "clsim", *arguments], env=ENVIRONMENT, start_new_session=True,
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    store = folder / "out" / "study.zarr"
    while study.poll() is None and len(list(store.glob("m*"))) < 3:
        time.sleep(0.02)
    os.killpg(study.pid, signal.SIGKILL)  # the power fails: workers die too
    study.wait()
    finished = {p.name for p in store.glob("m*")}
    assert 3 <= len(finished) < 7
    stamps = {name: (store / name / "zarr.json").stat().st_mtime_ns for name in finished}
    assert main([*arguments, "--resume"]) == 0
    assert stamps == {name: (store / name / "zarr.json").stat().st_mtime_ns for name in finished}
    assert {row["status"] for row in index(folder).values()} == {"finished"}
    assert len(list(store.glob("m*"))) == 7
    assert not (folder / "out" / ".partial").exists()


@pytest.mark.exhaustive
@pytest.mark.slow
def test_a_full_disk_stops_a_study(folder: Path, error_of) -> None:
    disk = folder / "disk"
    disk.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=1m", "tmpfs", str(disk)]
    if os.geteuid() != 0 or shutil.which("mount") is None or subprocess.run(mount, capture_output=True).returncode:
        pytest.skip("only root may mount a small disk")
    try:
        lengths = [1.0 + 0.001 * i for i in range(8)]  # for about three of which there is room
        arguments = [*write(folder, [0], lengths)[:-1], str(disk / "out"), "--workers", "1"]
        error = error_of(*arguments)
        assert error.startswith("[Errno 28] No space left on device")
        assert "--resume goes on" in error
        finished = {p.name for p in (disk / "out" / "study.zarr").glob("m*")}
        assert 0 < len(finished) < 8
        subprocess.run(["mount", "-o", "remount,size=64m", str(disk)], check=True)
        assert main([*arguments, "--resume"]) == 0
        again = {i for i, length in enumerate(lengths) if len(runs(folder)[0, length]) > 1}
        assert len(list((disk / "out" / "study.zarr").glob("m*"))) == 8
        assert not again & {int(name[1:]) for name in finished}
    finally:
        subprocess.run(["umount", str(disk)], check=True)


@pytest.mark.exhaustive
@pytest.mark.slow
def test_an_interrupted_study_is_one_line_and_its_workers_had_devices_of_their_own(folder: Path) -> None:
    arguments = [sys.executable, "-m", "clsim", *write(folder, [0], INTERRUPTED), "--workers", "2"]
    two = ENVIRONMENT | {"POCL_DEVICES": "pthread pthread"}
    study = subprocess.Popen(
        arguments,
        env=two,
        start_new_session=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # where the tests themselves ignore it, too
    )
    # Until each worker has finished two.
    while study.poll() is None and [len(m) >= 2 for m in members_of_processes(folder).values()] != [True, True]:
        time.sleep(0.02)
    os.killpg(study.pid, signal.SIGINT)  # Ctrl-C goes to all processes of a terminal
    _, err = study.communicate(timeout=120)
    assert study.returncode == 130, err
    assert err == f"clsim: interrupted; what is finished is kept in {folder / 'out'}: --resume goes on with it\n"
    devices: dict[int, set[str]] = {}
    for process, members in members_of_processes(folder).items():
        devices[process] = {index(folder)[n]["device"].split()[0] for n in members if n in index(folder)}
    listed = subprocess.run(
        [sys.executable, "-m", "clsim", "devices"], env=two, capture_output=True, text=True, check=True
    )
    there = [line.split()[0] for line in listed.stdout.splitlines() if "Portable" in line]
    assert sorted(d for found in devices.values() for d in found) == there
    assert len(there) == len(devices) == 2
