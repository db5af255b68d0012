"""What tests of processes share."""

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

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


@pytest.fixture(scope="session")
def installed_plugins(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Install the example package of plugins; the folder is to be put on the path of modules."""
    folder = tmp_path_factory.mktemp("plugins")
    example = Path(__file__).parents[2] / "examples" / "plugin"
    shutil.copytree(example, folder / "source", ignore=shutil.ignore_patterns("__pycache__"))
    pip = [sys.executable, "-m", "pip", "--isolated", "--disable-pip-version-check", "install", "--quiet"]
    options = ["--no-deps", "--no-build-isolation", "--target", str(folder / "installed"), str(folder / "source")]
    done = subprocess.run([*pip, *options], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return folder / "installed"
