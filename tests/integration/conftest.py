"""What tests of processes share."""

import os
from collections.abc import Iterator
from importlib.util import find_spec

import pytest
from killing import Killer


@pytest.fixture(scope="session")
def killer(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Killer]:
    """Start what runs commands that may be killed, once for all files of a process."""
    if not hasattr(os, "fork"):
        pytest.skip("this system does not fork")
    started = Killer(tmp_path_factory.mktemp("killer"))
    yield started
    started.close()


@pytest.fixture(autouse=True, scope="session")
def _quick_workers() -> None:
    """Fork the workers of studies that tests run in their own process from one that has loaded Dask's packages.

    Studies that are commands of their own start their workers as users do: `made_studies.ENVIRONMENT` knows none of this.
    """
    if find_spec("dask"):  # else its tests skip themselves, and no others
        import dask

        dask.config.set({"distributed.worker.multiprocessing-method": "forkserver"})
