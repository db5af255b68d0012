"""A scheduler and workers of a Dask cluster on loopback, processes of their own."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

from made_studies import ENVIRONMENT

# Forks a process for each line, from one that has loaded what all of them need, and tells its number.
SERVER = """
import importlib, json, os, signal, sys

for name in ("clsim.study.member", "clsim.workflow.pieces", "xarray", "dask.array", "zarr", "scipy.fft", "pyopencl.invoker"):
    importlib.import_module(name)
from distributed.cli import dask_scheduler, dask_worker

signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # nobody waits for them
for line in sys.stdin:
    name, *arguments = json.loads(line)
    process = os.fork()
    if process == 0:
        signal.signal(signal.SIGCHLD, signal.SIG_DFL)
        null = os.open(os.devnull, os.O_RDWR)
        os.dup2(null, 0), os.dup2(null, 1), os.dup2(null, 2)
        {"scheduler": dask_scheduler, "worker": dask_worker}[name].main(arguments)
        os._exit(0)
    print(process, flush=True)
"""


@dataclass(frozen=True, slots=True)
class Worker:
    """A worker that can be killed."""

    pid: int

    def kill(self) -> None:
        os.kill(self.pid, signal.SIGKILL)


@contextmanager
def made_cluster(
    folder: Path, count: int, more: Sequence[str] = (), settings: Mapping[str, str] = MappingProxyType({})
) -> Iterator[tuple[str, list[Worker]]]:
    """Yield the scheduler's address and the workers, which are not replaced; `settings` are environment variables."""
    note = str(folder / "scheduler.json")
    scheduler = ["scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard", "--scheduler-file", note, *more]
    worker = ["worker", "--scheduler-file", note, "--nthreads", "1", "--no-nanny", "--no-dashboard"]
    worker += ["--host", "127.0.0.1", "--local-directory", str(folder / "space"), *more]
    server = subprocess.Popen(
        [sys.executable, "-c", SERVER], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
        text=True, env=ENVIRONMENT | settings, start_new_session=True,
    )  # fmt: skip
    try:
        begun = []
        for arguments in (scheduler, *[worker] * count):  # workers wait for the note
            server.stdin.write(json.dumps(arguments) + "\n")
            server.stdin.flush()
            begun.append(Worker(int(server.stdout.readline())))
        deadline = time.monotonic() + 60
        while not (Path(note).exists() and Path(note).stat().st_size) and time.monotonic() < deadline:
            time.sleep(0.05)
        yield json.loads(Path(note).read_text("utf-8"))["address"], begun[1:]
    finally:
        os.killpg(server.pid, signal.SIGKILL)
        server.communicate()
