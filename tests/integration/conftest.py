"""What tests of processes share."""

import os
from collections.abc import Iterator

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
