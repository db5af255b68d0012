"""Every snippet of README and of docs runs as it stands, page by page, in a process of its own."""

import multiprocessing
from multiprocessing.context import ForkServerContext
from pathlib import Path

import pytest
from exhaustive import few
from snippets import PAGES, run_page, snippets

_LOADED = [
    "snippets",
    "clsim.cli",
    "scipy.signal",
    "pandas",
    "xarray",
    "matplotlib.pyplot",
    "trimesh",
    "clsim.pictures.plots",
]


@pytest.fixture(scope="module")
def forked() -> ForkServerContext:
    """Return what forks processes from one that has loaded everything, so that each is cheap."""
    if "forkserver" not in multiprocessing.get_all_start_methods():
        pytest.skip("this system does not fork")
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(_LOADED)
    return context


@pytest.mark.usefixtures("device")
@pytest.mark.parametrize("page", few([page for page in PAGES if snippets(page)]), ids=lambda page: page.name)
def test_the_snippets_of_a_page_run(page: Path, tmp_path: Path, forked: ForkServerContext) -> None:
    ours, theirs = forked.Pipe()
    process = forked.Process(target=run_page, args=(str(page), str(tmp_path), theirs))
    process.start()
    theirs.close()  # so that a process that dies is seen at once
    problem = ours.recv()
    process.join()
    assert problem == ""
