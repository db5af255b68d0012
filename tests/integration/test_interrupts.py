"""Ctrl-C at any moment from the first import on: status 130, one line, nothing left behind.

Three interrupts at every change, fifteen in the exhaustive tests; `make kills` does 150, of which 65 come within the first second.
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
from killing import living
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
        "zarr": [*run, "--store", "zarr"],
        "hdf5": [*run, "--store", "hdf5"],
        "paths": ["paths", str(folder / "scene.toml")],
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
        found = living(leader)
        if not found or time.monotonic() > deadline:
            return found
        time.sleep(0.05)


def temporary(folder: Path) -> list[Path]:
    return [path for path in folder.rglob("*") if is_temporary(path.name)]


def without_warnings(err: str) -> list[str]:
    return [line for line in err.splitlines() if not line.startswith("clsim: warning: ")]


@pytest.mark.skipif(not hasattr(os, "killpg"), reason="this system has no groups of processes")
@pytest.mark.parametrize("number", few(range(INTERRUPTS), kept=(0, 1, 2)))
def test_an_interrupt_is_one_line(number: int, folder: Path, rng: np.random.Generator, device: None) -> None:
    installed("zarr")
    what = ("run", "workers", "study", "check", "opencl", "rir", "view", "zarr", "hdf5", "paths")[number % 10]
    early = number < 4 or rng.uniform() < FIRST
    longest = 1.0 if early else 3.5
    for _ in range(20):
        moments = [rng.uniform(0.0, longest)]
        if number % 3 == 1:  # impatience
            moments += list(rng.uniform(0.0, 0.2, rng.integers(1, 4)))
        status, err = interrupted(folder, arguments(folder, what), moments)
        subprocess.run(["rm", "-rf", *map(str, folder.glob("out*"))], check=True)
        if status == 130:
            break
        assert (status, without_warnings(err)) == (0, []), "it was done before"
        longest *= 0.6
    assert status == 130
    lines = without_warnings(err)
    assert lines[-1].startswith(MESSAGE)
    assert [line for line in lines if line.startswith(MESSAGE)] == lines[-1:]
    assert len(lines) == 1
    assert not temporary(folder)


def ended(script: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run a script in a process that is interrupted as a terminal's are, to its end."""
    return subprocess.run(
        [sys.executable, "-c", script, *arguments], env=ENVIRONMENT, capture_output=True, text=True, timeout=60,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )  # fmt: skip


# What a command does as it is interrupted. Some extension modules make an error of their own of what is raised while
# they begin; an interrupt may come before the sockets of an event loop are there.
MADE_OF_IT = {
    "an error": """
    try:
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(1.0)
    except KeyboardInterrupt:
        raise ImportError("numpy must be defined") from None
""",
    "half an event loop": """
    loop = asyncio.SelectorEventLoop.__new__(asyncio.SelectorEventLoop)
    asyncio.BaseEventLoop.__init__(loop)
    del loop
    os.kill(os.getpid(), signal.SIGINT)
    time.sleep(1.0)
""",
    "a coroutine": """
    async def write():
        pass
    made = write()
    os.kill(os.getpid(), signal.SIGINT)
    time.sleep(1.0)
""",
}
COMMAND = """
import asyncio, os, signal, sys, time
from clsim import __main__, cli
def main():%scli.main = main
sys.argv = ["clsim", "check"]
__main__.run()
"""


@pytest.mark.skipif(os.name != "posix", reason="this system has other signals")
@pytest.mark.parametrize("what", MADE_OF_IT)
def test_what_other_packages_make_of_an_interrupt_is_not_reported(what: str) -> None:
    """As of Zarr, which makes a coroutine for each file that it writes, and of Dask's event loops."""
    done = ended(COMMAND % MADE_OF_IT[what])
    assert done.returncode == 130
    assert [line.startswith(MESSAGE) for line in done.stderr.splitlines()] == [True]


# Threads of Zarr are slow: to write, so that an interrupt comes meanwhile; to end, once the command has.
SLOW_ZARR = """
import os, signal, sys, time
import zarr.core.sync, zarr.storage._local as local
from clsim import __main__, cli
written, put, main = [], local._put, cli.main
def slow_put(path, *given, **more):
    if "{where}" in str(path):
        written.append(path)
        if len(written) == {number}:
            for _ in range(3):
                os.kill(os.getpid(), signal.SIGINT)
                time.sleep(0.2)
    return put(path, *given, **more)
def slow_main():
    status = main()
    for _ in range(2):
        zarr.core.sync.loop[0].call_soon_threadsafe(time.sleep, {seconds})
    return status
local._put, cli.main = slow_put, slow_main
sys.argv = ["clsim", *sys.argv[1:]]
__main__.run()
"""


def slow_zarr(folder: Path, out: Path, where: str, number: int, seconds: float) -> tuple[int, str]:
    """Run a command into a Zarr store that an interrupt hits while its number-th file is written."""
    script = SLOW_ZARR.replace("{where}", where).replace("{number}", str(number)).replace("{seconds}", str(seconds))
    line = ["run", str(folder / "long.toml"), "-o", str(out), "--store", "zarr", "--no-plots", "--duration", "4"]
    done = ended(script, *line)
    return done.returncode, without_warnings(done.stderr)


@pytest.mark.parametrize(("where", "number"), few([("sound/c", 1), ("zarr.json", 2), ("sound/c", 3)], ()))
def test_an_interrupt_waits_for_threads_that_write(where: str, number: int, folder: Path, tmp_path: Path) -> None:
    installed("zarr")
    status, err = slow_zarr(folder, tmp_path / "out", where, number, 0.0)
    assert status == 130
    if "is kept" in err[0]:  # of chunks that were written before
        shutil.rmtree(tmp_path / "out" / ".partial" / "recording.zarr")
        left = {path.name for path in (tmp_path / "out" / ".partial").iterdir()}
        assert (len(err), left) == (1, {"contents.json", "journal.npz", "lock"})
    else:
        assert err == ["clsim: interrupted; nothing half-written was left"]
        assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("number", few([1, -1]))
def test_threads_that_do_not_end_are_not_reported(number: int, folder: Path, tmp_path: Path) -> None:
    """A loaded machine: an exit callback of Zarr gives its threads 0.2 s, and fails; an interrupt waits for them, too."""
    installed("zarr")
    status, err = slow_zarr(folder, tmp_path / "out", "sound/c", number, 1.0)
    assert status == (130 if number == 1 else 0)
    assert err == (["clsim: interrupted; nothing half-written was left"] if number == 1 else [])


HANDLED = """
import os, signal, sys, time
from clsim import process
process.end_on_interrupt()
process.raise_on_interrupt()
"""
SWALLOWED = """try:
    os.kill(os.getpid(), signal.SIGINT)
    time.sleep(9.0)
except KeyboardInterrupt:
    pass  # as a library does that catches everything
try:
    time.sleep(9.0)
except KeyboardInterrupt:
    time.sleep(0.4)  # what cleans up is not interrupted
    print("interrupted again")
"""  # as by a library that catches everything: it comes again
PUT_BACK = """process.ignore_interrupts()
def interrupt():
    os.kill(os.getpid(), signal.SIGINT)
    return sum(range(1000))
for error in (KeyboardInterrupt(), OSError("Signal 2 ignored due to race condition")):
    sys.unraisablehook(type("", (), {"exc_type": type(error), "exc_value": error, "exc_traceback": None, "err_msg": None, "object": None}))
interrupt()
signal.signal(signal.SIGINT, signal.default_int_handler)
interrupt()
print("done")
"""  # by a library, once a command is done: it is not interrupted any more


@pytest.mark.skipif(not hasattr(signal, "pthread_sigmask"), reason="this system cannot block signals")
@pytest.mark.parametrize(("script", "told"), [(SWALLOWED, "interrupted again\n"), (PUT_BACK, "done\n")])
def test_interrupts_and_handlers_that_libraries_take_are_as_asked(script: str, told: str) -> None:
    done = ended(HANDLED + script)
    assert (done.returncode, done.stdout, done.stderr) == (0, told, "")


def test_a_folder_that_is_still_written_into_is_deleted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A thread like that of Zarr, which goes on for a moment after the process was interrupted."""
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
