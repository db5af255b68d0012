"""What all tests share: seeded random numbers, and the engines."""

import gc
import hashlib
import itertools
import json
import os
import pickle
import shutil
import sys
import zlib
from collections.abc import Callable, Generator, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from clsim.cli import main
from clsim.opencl.device import list_devices


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Leave what stays until the end, a million objects of modules and tests, out of each search for garbage.

    Searches are rare: after every 700 new objects, as by default, they took 1.5 s of the 2.4 s that parse the package.
    """
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.set_threshold(50_000, 20, 20)
        gc.enable()


@pytest.hookimpl(wrapper=True)
def pytest_make_collect_report() -> Generator[None, pytest.CollectReport, pytest.CollectReport]:
    """Have every other process load a folder's files from its end: what one has rewritten to tell more, others read."""
    report = yield
    if int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw")) % 2:
        for file in (node for node in reversed(report.result) if isinstance(node, pytest.Module)):
            try:
                _ = file.obj
            except (Exception, pytest.skip.Exception):
                # It is loaded again in its turn, and skipped or told then: not half of it as it is.
                for name in [n for n, m in sys.modules.items() if getattr(m, "__file__", None) == str(file.path)]:
                    del sys.modules[name]
    return report


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--measuring", action="store_true", help="only the tests that note a figure for the page of validation"
    )


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Run the longest tests first: then no process waits for another at the end."""
    if config.getoption("--measuring"):
        others = [item for item in items if "measured" not in getattr(item, "fixturenames", ())]
        config.hook.pytest_deselected(items=others)
        items[:] = [item for item in items if item not in others]
    items.sort(key=lambda item: item.get_closest_marker("slow") is None)


@pytest.fixture(autouse=True)
def _print_options() -> Iterator[None]:
    """Undo what packages do to NumPy's print options (trimesh does, on writing DXF)."""
    with np.printoptions():
        yield


@pytest.fixture
def rng(request: pytest.FixtureRequest) -> np.random.Generator:
    """Random numbers that are another sequence for every test, and the same in every run."""
    return np.random.default_rng(zlib.crc32(request.node.name.encode()))


@pytest.fixture(scope="session")
def once(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str, Callable[[], Any]], Any]:
    """Return a cache by name for a run of the tests: one process makes a value, all others read it."""
    fcntl = pytest.importorskip("fcntl", reason="this system has no locks of files as POSIX has them")
    folder = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        folder = folder.parent  # that of the run

    def made(name: str, make: Callable[[], Any]) -> Any:
        file = folder / f"{hashlib.sha256(name.encode()).hexdigest()[:24]}.pickle"
        with file.with_suffix(".lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if not file.exists():
                file.write_bytes(pickle.dumps(make()))
            return pickle.loads(file.read_bytes())

    return made


@pytest.fixture
def measured(request: pytest.FixtureRequest) -> Callable[..., float]:
    """Demand that a figure is within what is allowed, and note it in the folder CLSIM_MEASURED for the page of validation."""
    folder, count = os.environ.get("CLSIM_MEASURED"), itertools.count()

    def note(claim: str, oracle: str, value: float, allowed: float, unit: str = "dB") -> float:
        if folder:
            file = f"{request.node.path.parent.relative_to(Path(__file__).parent).as_posix()}/{request.node.path.name}"
            row = {
                "test": file, "case": request.node.name, "claim": claim, "oracle": oracle,
                "allowed": float(allowed), "measured": float(value), "unit": unit,
            }  # fmt: skip
            digest = hashlib.sha256(f"{file} {request.node.name} {claim} {next(count)}".encode()).hexdigest()[:24]
            path = Path(folder) / f"{digest}.json"
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(json.dumps(row), "utf-8")
        assert value <= allowed, f"{claim}, against {oracle}: {value:.6g} {unit}, where {allowed:.6g} is allowed"
        return value

    return note


@pytest.fixture
def error_of(capsys: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """Run a command that must end with status 2 and one line of error, and return what that says."""

    def run(*arguments: Any) -> str:
        capsys.readouterr()
        assert main([str(argument) for argument in arguments]) == 2
        said = capsys.readouterr().err
        assert said.startswith("clsim: error: "), said
        assert said.count("\n") == 1, said
        return said.removeprefix("clsim: error: ").removesuffix("\n")

    return run


@pytest.fixture(params=["opencl", "reference"])
def engine(request: pytest.FixtureRequest) -> str:
    """Each engine in turn; without an OpenCL device its tests are a visible skip."""
    if request.param == "opencl" and not list_devices():
        pytest.skip("no OpenCL device on this machine")
    return str(request.param)


@pytest.fixture
def device() -> None:
    """Skip visibly without an OpenCL device."""
    if not list_devices():
        pytest.skip("no OpenCL device on this machine")


@pytest.fixture(scope="session")
def browser() -> Iterator[Any]:
    """Start headless Chromium; a visible skip where that is missing."""
    api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    chromium = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if chromium is None:
        pytest.skip("no Chromium on this machine")
    flags = [
        "--no-sandbox", "--no-first-run", "--disable-background-networking", "--disable-component-update",
        "--disable-sync", "--disable-quic", "--use-gl=angle", "--use-angle=swiftshader-webgl", "--enable-unsafe-swiftshader",
        "--ignore-gpu-blocklist", "--disable-gpu-compositing",  # only what pages draw themselves is drawn by the GPU's stand-in
    ]  # fmt: skip
    with api.sync_playwright() as playwright:
        started = playwright.chromium.launch(executable_path=chromium, args=flags)
        yield started
        started.close()
