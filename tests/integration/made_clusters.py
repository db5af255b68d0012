"""A scheduler and workers of a Dask cluster on loopback, processes of their own."""

import json
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from made_studies import ENVIRONMENT


@contextmanager
def made_cluster(folder: Path, count: int) -> Iterator[tuple[str, list[subprocess.Popen]]]:
    """Yield the scheduler's address and the workers, which are not replaced."""
    base = [sys.executable, "-m"]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "env": ENVIRONMENT}
    note = folder / "scheduler.json"
    scheduler = subprocess.Popen(
        [*base, "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard",
         "--scheduler-file", str(note)], **quiet,
    )  # fmt: skip
    worker = [*base, "distributed.cli.dask_worker", "--scheduler-file", str(note), "--nthreads", "1", "--no-nanny"]
    worker += ["--no-dashboard", "--host", "127.0.0.1", "--local-directory", str(folder / "space")]
    workers = [subprocess.Popen(worker, **quiet) for _ in range(count)]  # they wait for the file
    try:
        deadline = time.monotonic() + 60
        while not (note.exists() and note.stat().st_size) and time.monotonic() < deadline:
            time.sleep(0.05)
        yield json.loads(note.read_text("utf-8"))["address"], workers
    finally:
        for process in [*workers, scheduler]:
            process.kill()
            process.wait()
