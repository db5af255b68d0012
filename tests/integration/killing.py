"""Runs of clsim in processes that may be killed: forked from one that has loaded everything, so that each is cheap."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

# Reads a job a line, forks, and says how the child ended. Between two events that touch the folder nothing changes in it
# but what is in open files, so that killing at the n-th reaches every state; killing at a time reaches those within.
SERVER = """
import importlib, json, os, signal, sys, threading

for name in sys.argv[1:]:
    importlib.import_module(name)
import clsim
import clsim.workflow.checkpoint
from clsim.cli import main

for name in clsim.__all__:
    getattr(clsim, name)

clsim.workflow.checkpoint._PERIOD = 0.0  # every chunk is noted
EVENTS = {"open", "os.rename", "os.remove", "os.mkdir", "os.rmdir", "os.truncate", "os.listdir", "os.scandir"}


def child(job):
    log = os.open(job["log"], os.O_CREAT | os.O_WRONLY | os.O_TRUNC)
    os.dup2(log, 1), os.dup2(log, 2)
    seen = 0

    def count(event, arguments):
        nonlocal seen
        if event in EVENTS and any(job["under"] in str(a) and job["of"] in str(a) for a in arguments[:2]):
            seen += 1
            if seen == job["event"]:
                os.kill(os.getpid(), signal.SIGKILL)

    sys.addaudithook(count)
    if job["seconds"]:
        signal.setitimer(signal.ITIMER_REAL, job["seconds"])  # nobody handles its signal
    status = main(job["arguments"])
    sys.stdout.flush(), sys.stderr.flush()
    os.write(log, f"\\nevents {seen}".encode())
    os._exit(status)


for line in sys.stdin:
    job = json.loads(line)
    process = os.fork()
    if process == 0:
        child(job)
    status = os.waitpid(process, 0)[1]
    print(-os.WTERMSIG(status) if os.WIFSIGNALED(status) else os.WEXITSTATUS(status), flush=True)
"""
_LOADED = (
    "clsim.commands.run", "clsim.workflow.pictures", "clsim.commands.scenes", "soundfile", "zarr",
    "xarray", "h5netcdf", "h5py", "scipy.signal", "pydantic", "tomli_w",
)  # fmt: skip


class Killer:
    """Runs commands of clsim one after the other, each in a process of its own.

    `events` and `log` tell of the last that was not killed: how often it touched the folder, and what it printed.
    """

    def __init__(self, folder: Path) -> None:
        self._log = folder / "log"
        self.events, self.log = 0, ""
        installed = [name for name in _LOADED if _is_installed(name)]
        self._server = subprocess.Popen(
            [sys.executable, "-c", SERVER, *installed], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
            env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path), "MPLBACKEND": "agg"},
        )  # fmt: skip

    def run(self, arguments: list[Any], under: Path, *, event: int = 0, of: str = "", seconds: float = 0.0) -> int:
        """Run a command; return its status, or the negative number of the signal that ended it.

        It is killed at the `event`-th time that it touches a path under `under` that has `of` in it, or after a time.
        """
        job = {
            "arguments": [str(a) for a in arguments], "under": str(under), "event": event, "of": of, "seconds": seconds,
            "log": str(self._log),
        }  # fmt: skip
        self._server.stdin.write(json.dumps(job) + "\n")
        self._server.stdin.flush()
        status = int(self._server.stdout.readline())
        self.log = self._log.read_text("utf-8")
        if status >= 0:
            self.log, _, count = self.log.rpartition("\nevents ")
            self.events = int(count)
        return status

    def close(self) -> None:
        self._server.stdin.close()
        self._server.wait(60)
        self._server.stdout.close()


def _is_installed(name: str) -> bool:
    from importlib.util import find_spec

    return find_spec(name) is not None


def content(folder: Path) -> dict[str, bytes]:
    """Return all that a folder holds: empty folders too."""
    return {str(p.relative_to(folder)): p.read_bytes() if p.is_file() else b"" for p in folder.rglob("*")}


def living(leader: int) -> list[int]:
    """Return the processes of a group that live, on Linux."""
    found = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            words = path.read_text("utf-8").rpartition(")")[2].split()
        except OSError:
            continue
        if int(words[2]) == leader and words[0] != "Z":
            found.append(int(path.parent.name))
    return found
