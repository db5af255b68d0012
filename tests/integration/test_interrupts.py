"""Ctrl-C at any moment from the first import on: status 130, one line, nothing left behind.

Three interrupts at every change, fifteen in the exhaustive tests; `make kills` does 100, of which 45 come within the first second.
"""

import contextlib
import itertools
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from exhaustive import few
from late import installed
from made_studies import ENVIRONMENT, write, write_scene
from test_kills import RECEIVER, SCENE

from clsim.files.atomic import is_temporary
from clsim.workflow.result_folder import _remove_folder

INTERRUPTS = int(os.environ.get("CLSIM_INTERRUPTS", "15"))
FIRST = 0.45  # share of those within the first second
# As the script that pip installs, which tells that clsim is there: before, Python itself reports the interrupt.
SCRIPT = """
import os, re, signal, sys
sys.argv = ["clsim", *sys.argv[1:]]
def tell(*given):
    signal.signal = set_handler
    before = set_handler(*given)
    os.write(1, b"!")
    return before
set_handler, signal.signal = signal.signal, tell
from clsim.__main__ import run
run()
"""
MESSAGE = "clsim: interrupted"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = write_scene(tmp_path_factory.mktemp("interrupts"))
    (folder / "long.toml").write_text(SCENE.replace("0.2", "20.0") % (0.9, RECEIVER % "left"), "utf-8")
    return folder


def arguments(folder: Path, what: str) -> list[str]:
    run = ["run", str(folder / "long.toml"), "-o", str(folder / "out"), "--no-plots"]
    return {
        "run": run,
        "opencl": ["run", str(folder / "scene.toml"), "-o", str(folder / "out")],
        "check": ["check", str(folder / "scene.toml")],
        "rir": ["rir", str(folder / "scene.toml"), "-o", str(folder / "out.npz")],
        "view": ["view", str(folder / "scene.toml"), "-o", str(folder / "out.html")],
        "study": [*write(folder, [0], [1.75 + 0.001 * i for i in range(20)]), "--workers", "2"],
        "workers": [*run, "--store", "zarr", "--workers", "2"],
    }[what]


def interrupted(folder: Path, line: list[str], moments: list[float]) -> tuple[int, str]:
    """Start a command as a terminal does, press Ctrl-C at some moments, and return its status and what it printed."""
    space = folder / "space"
    space.mkdir(exist_ok=True)
    process = subprocess.Popen(
        [sys.executable, "-c", SCRIPT, *line], env=ENVIRONMENT | {"TMPDIR": str(space), "MPLBACKEND": "agg"}, text=True,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, process_group=0,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )  # fmt: skip
    try:
        assert process.stdout.read(1) == "!"
        for moment in moments:
            time.sleep(moment)
            try:
                os.killpg(process.pid, signal.SIGINT)
            except ProcessLookupError:
                break
        out, err = process.communicate(timeout=60)
        assert "Traceback" not in out + err
        assert not _group(process.pid), "a process is left"
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.communicate()
    left = [path.name for path in space.iterdir()]
    assert not left, "files are left in the temporary folder"
    return process.returncode, err


def _group(leader: int) -> list[int]:
    """Return the processes of a group that live, a second after its leader has ended."""
    deadline = time.monotonic() + 5.0
    while True:
        found = []
        for path in Path("/proc").glob("[0-9]*/stat"):
            try:
                words = path.read_text("utf-8").rpartition(")")[2].split()
            except OSError:
                continue
            if int(words[2]) == leader and words[0] != "Z":
                found.append(int(path.parent.name))
        if not found or time.monotonic() > deadline:
            return found
        time.sleep(0.05)


def temporary(folder: Path) -> list[Path]:
    return [path for path in folder.rglob("*") if is_temporary(path.name)]


@pytest.mark.skipif(not hasattr(os, "killpg"), reason="this system has no groups of processes")
@pytest.mark.parametrize("number", few(range(INTERRUPTS), kept=(0, 1, 2)))
def test_an_interrupt_is_one_line(number: int, folder: Path, rng: np.random.Generator, device: None) -> None:
    installed("zarr")
    what = ("run", "workers", "study", "check", "opencl", "rir", "view")[number % 7]
    early = number < 4 or rng.uniform() < FIRST
    longest = 1.0 if early else 3.5
    for _ in range(20):
        moments = [rng.uniform(0.0, longest)]
        if number % 3 == 1:  # impatience
            moments += list(rng.uniform(0.0, 0.2, 3))
        status, err = interrupted(folder, arguments(folder, what), moments)
        subprocess.run(["rm", "-rf", *map(str, folder.glob("out*"))], check=True)
        if status == 130:
            break
        assert (status, err) == (0, ""), "it was done before"
        longest *= 0.6
    assert status == 130
    lines = [line for line in err.splitlines() if not line.startswith("clsim: warning: ")]
    assert lines[-1].startswith(MESSAGE)
    assert [line for line in lines if line.startswith(MESSAGE)] == lines[-1:]
    assert len(lines) == 1
    assert not temporary(folder)


SWALLOWED = """
import os, signal, time
from clsim import process
process.end_on_interrupt()
process.raise_on_interrupt()
try:
    os.kill(os.getpid(), signal.SIGINT)
    time.sleep(9.0)
except KeyboardInterrupt:
    pass  # as a library does that catches everything
try:
    time.sleep(9.0)
except KeyboardInterrupt:
    time.sleep(0.4)  # what cleans up is not interrupted
    print("interrupted again")
"""


@pytest.mark.skipif(os.name == "nt", reason="this system sends no signals")
def test_an_interrupt_that_a_library_swallows_comes_again() -> None:
    done = subprocess.run(
        [sys.executable, "-c", SWALLOWED], env=ENVIRONMENT, capture_output=True, text=True, timeout=60,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )  # fmt: skip
    assert (done.returncode, done.stdout, done.stderr) == (0, "interrupted again\n", "")


PUT_BACK = """
import os, signal, sys
from clsim import process
process.end_on_interrupt()
process.raise_on_interrupt()
process.ignore_interrupts()
def interrupt():
    os.kill(os.getpid(), signal.SIGINT)
    return sum(range(1000))
for error in (KeyboardInterrupt(), OSError("Signal 2 ignored due to race condition")):
    sys.unraisablehook(type("", (), {"exc_type": type(error), "exc_value": error, "exc_traceback": None, "err_msg": None, "object": None}))
interrupt()
signal.signal(signal.SIGINT, signal.default_int_handler)
interrupt()
print("done")
"""


@pytest.mark.skipif(not hasattr(signal, "pthread_sigmask"), reason="this system cannot block signals")
def test_a_command_that_is_done_is_not_interrupted_by_a_handler_that_comes_back() -> None:
    done = subprocess.run(
        [sys.executable, "-c", PUT_BACK], env=ENVIRONMENT, capture_output=True, text=True, timeout=60,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )  # fmt: skip
    assert (done.returncode, done.stdout, done.stderr) == (0, "done\n", "")


ABANDONED = """
import asyncio, gc
from clsim import process
loop = asyncio.new_event_loop()
task = loop.create_task(asyncio.sleep(9.0))
loop.run_until_complete(asyncio.sleep(0.0))
process.ignore_interrupts()
del task
loop.close()
del loop
gc.collect()
"""


def test_a_task_that_an_interrupt_left_pending_is_not_reported() -> None:
    """As those of Zarr, which are collected after the command has said that it was interrupted."""
    done = subprocess.run(
        [sys.executable, "-c", ABANDONED], env=ENVIRONMENT, capture_output=True, text=True, timeout=60
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    reported = ABANDONED.replace("process.ignore_interrupts()", "")
    done = subprocess.run([sys.executable, "-c", reported], env=ENVIRONMENT, capture_output=True, text=True, timeout=60)
    assert "Task was destroyed but it is pending" in done.stderr


def test_a_folder_that_is_still_written_into_is_deleted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As by a thread of Zarr, which goes on for a moment after the process was interrupted."""
    folder, rmdir, late = tmp_path / "store", os.rmdir, iter(["first", "second"])
    folder.mkdir()
    (folder / "early").touch()

    def remove(*arguments: Any, **more: Any) -> None:
        """Remove a folder into which a file came meanwhile."""
        for name in itertools.islice(late, 1):
            (folder / name).touch()
        rmdir(*arguments, **more)

    monkeypatch.setattr(os, "rmdir", remove)
    with pytest.raises(OSError, match="not empty"):
        shutil.rmtree(folder)
    _remove_folder(folder)
    assert not folder.exists()
    assert next(late, None) is None
