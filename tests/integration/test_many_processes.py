"""Processes beside each other: a fork after a rendering ends in an error, and the files of the page on them run."""

import multiprocessing
import os
import re
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from exhaustive import few

import clsim

PAGE = Path(clsim.__file__).parents[1] / "docs" / "many_processes.md"
FILES = re.findall(
    r"<!-- a file of its own -->\n```python\n(.*?)^```", PAGE.read_text("utf-8"), re.MULTILINE | re.DOTALL
)
# What PyTorch's loader does about processes: it is 200 MB, of which this is all that the page is about.
LOADER = """
import multiprocessing

def DataLoader(items, batch_size, num_workers, multiprocessing_context):
    with multiprocessing.get_context(multiprocessing_context).Pool(num_workers) as pool:
        yield from pool.imap(items.__getitem__, range(len(items)))
"""
SOON = 20.0  # s, in which a child answers that has to wait for its turn; one that hangs never does
pytestmark = pytest.mark.usefixtures("device")


def rendered(engine: str) -> Any:
    tone = clsim.Signal.tone(40e3, 0.005, 192e3, fade=0.001)
    way = clsim.Trajectory.line((1.0, 1.0, 1.0), (1.1, 1.0, 1.0), 0.1)
    room = clsim.Shoebox((6.0, 5.0, 2.5), clsim.Material.from_reflection(0.8))
    receivers = [clsim.Receiver("r", clsim.Trajectory.fixed((3.0, 2.0, 1.0)))]
    scene = clsim.Scene(room, clsim.Air(), [clsim.Source("s", tone, way)], receivers)
    return clsim.render(clsim.find_paths(scene, 1), 192e3, duration=0.01, engine=engine).pressure


def answer(pipe: Any, engine: str) -> None:
    begun = time.process_time()
    try:
        found: Any = rendered(engine)
    except clsim.ClsimError as error:
        found = error
    pipe.send((found, time.process_time() - begun))


def of_a_fork(engine: str) -> tuple[Any, float]:
    context = multiprocessing.get_context("fork")
    here, there = context.Pipe(duplex=False)
    child = context.Process(target=answer, args=(there, engine))
    child.start()
    there.close()
    try:
        assert here.poll(SOON), "the child hangs"
        return here.recv()
    finally:
        child.kill()
        child.join()
        here.close()


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system does not fork")
@pytest.mark.filterwarnings("ignore:.*multi-threaded, use of fork:DeprecationWarning")
def test_a_fork_after_a_rendering_says_what_to_do() -> None:
    rendered("opencl")
    error, took = of_a_fork("opencl")
    assert isinstance(error, clsim.DeviceError)
    assert '"spawn"' in str(error)
    assert took < 1.0
    assert np.array_equal(of_a_fork("reference")[0], rendered("reference"))
    rendered("opencl")  # the parent goes on


@pytest.mark.parametrize("text", few(FILES, kept=()), ids=["batch", "pool", "loader", "dask"])
def test_the_files_of_the_page_run(text: str, tmp_path: Path) -> None:
    (tmp_path / "many.py").write_text(text, "utf-8")
    (tmp_path / "torch" / "utils").mkdir(parents=True)
    (tmp_path / "torch" / "utils" / "data.py").write_text(LOADER, "utf-8")
    done = subprocess.run([sys.executable, "many.py"], cwd=tmp_path, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    assert len(re.findall(r"\d", done.stdout)) > 4
