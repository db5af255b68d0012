"""Scene and study files with something wrong: an error that names its field, in time and in memory.

As many as are asked for by `CLSIM_FUZZ` (``make fuzz``), from the seed `CLSIM_FUZZ_SEED`; a tenth of them at every change.
"""

import argparse
import os
import resource
import signal
import traceback
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType

import fuzzing
import numpy as np
import pytest
import tomli_w
from exhaustive import few

import clsim
from clsim.commands import scenes
from clsim.errors import ClsimError, InputError
from clsim.scene_file import load_scene
from clsim.study.file import checked, load_study

COUNT = int(os.environ.get("CLSIM_FUZZ", "1000"))  # four scenes to a study
SEED = int(os.environ.get("CLSIM_FUZZ_SEED", "11"))
PARTS = 10
LONGEST, WAITED = 20.0, 600.0  # s, of computing and altogether: other processes may take the rest of the time
MEMORY = 2**31  # bytes beyond what is there before
RENDERED = 5  # of so many scenes that are right, one is heard


class OutOfTime(BaseException):
    """No clsim code catches it."""


@contextmanager
def bounded() -> Iterator[None]:
    """Raise OutOfTime, or MemoryError, where the work takes too much."""

    def ring(number: int, frame: FrameType | None) -> None:
        raise OutOfTime

    clocks = ((signal.ITIMER_PROF, signal.SIGPROF, LONGEST), (signal.ITIMER_REAL, signal.SIGALRM, WAITED))
    handlers = [signal.signal(number, ring) for _, number, _ in clocks]
    for timer, _, limit in clocks:
        signal.setitimer(timer, limit)
    try:
        yield
    finally:
        for (timer, number, _), handler in zip(clocks, handlers, strict=True):
            signal.setitimer(timer, 0.0)
            signal.signal(number, handler)


@pytest.fixture
def folder(tmp_path: Path) -> Iterator[Path]:
    """Return a folder with the files that scenes name, while memory is bounded."""
    fuzzing.write_files(tmp_path)
    os.mkfifo(tmp_path / "pipe")
    old = resource.getrlimit(resource.RLIMIT_AS)
    there = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (there + MEMORY, old[1]))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", clsim.ClsimWarning)
        yield tmp_path
    resource.setrlimit(resource.RLIMIT_AS, old)


def complaint(work: Callable[[], object]) -> str:
    """Return the fault of an outcome; empty if the work succeeds or its error names a field."""
    try:
        with bounded():
            work()
    except InputError as error:
        return "" if error.field.strip() else f"no field: {error}"
    except ClsimError:
        return ""
    except (Exception, OutOfTime):
        return "".join(traceback.format_exc().splitlines(keepends=True)[-12:])
    return ""


def check(path: Path, number: int) -> None:
    """Do what `clsim check` does, and now and then render the beginning; at round places until echoes have arrived."""
    scenes.check(argparse.Namespace(scene=path))
    if number // 2 % RENDERED:
        return
    file = load_scene(path)
    paths = clsim.find_paths(file.scene, **file.paths)
    part = {"engine": "reference", "duration": 1e-3}
    if fuzzing.is_round(number):
        part = {"engine": "opencl", "duration": 0.015}
    plan = clsim.plan_render(paths, **file.render | part)
    try:
        for _, samples in clsim.render_chunks(plan):
            assert np.isfinite(samples).all()
    except InputError as error:  # of what was found to be right before
        raise AssertionError(f"valid, but refused: {error}") from error


@pytest.mark.parametrize("part", few(range(PARTS)))
def test_scenes_with_something_wrong(part: int, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = []
    for number in range(part, COUNT * 4 // 5, PARTS):
        text = fuzzing.scene_text(SEED, number)
        path = folder / "scene.toml"
        path.write_bytes(text)
        with damaged(folder, text, number):
            said = complaint(lambda path=path, number=number: check(path, number))
        if said:
            found.append(f"fuzzing.py {SEED} {number}:\n{said}")
    assert not found, "\n".join(found)


@pytest.mark.parametrize("part", few(range(PARTS)))
def test_studies_with_something_wrong(part: int, folder: Path) -> None:
    found = []
    for number in range(part, COUNT // 5, PARTS):
        scene = fuzzing.scene(np.random.default_rng([SEED, number]))
        (folder / "scene.toml").write_text(tomli_w.dumps(scene))
        (folder / "study.toml").write_bytes(fuzzing.study_text(SEED, number, "scene.toml"))
        said = complaint(lambda: checked(load_study(folder / "study.toml", 20), lambda share: None))
        if said:
            found.append(f"fuzzing.py {SEED} {number} study:\n{said}")
    assert not found, "\n".join(found)


@contextmanager
def damaged(folder: Path, text: bytes, number: int) -> Iterator[None]:
    """Damage one of the files that every fourth scene names, if it names any."""
    random = np.random.default_rng([SEED, number, 2])
    named = [name for name in fuzzing.DAMAGED if name.encode() in text]
    if number % 4 or not named:
        yield
        return
    path = folder / str(random.choice(named))
    whole = path.read_bytes()
    path.write_bytes(fuzzing.damage(random, whole))
    try:
        yield
    finally:
        path.write_bytes(whole)


def test_the_bounds_hold() -> None:
    def endless() -> None:
        while True:
            pass

    global LONGEST
    old, LONGEST = LONGEST, 0.1
    try:
        assert "OutOfTime" in complaint(endless)
    finally:
        LONGEST = old
    assert "ZeroDivisionError" in complaint(lambda: 1 / 0)
    assert complaint(lambda: clsim.Air(speed_of_sound=3e8)) == ""
