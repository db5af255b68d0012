"""What tests of drivers share."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from driver_scenes import SCENES
from drivers import EVERYTHING, FEW_ON_GPUS, POCL, render


@pytest.fixture(scope="session")
def by_pocl(once: Callable[[str, Callable[[], Any]], Any], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of all scenes as PoCL renders them, in both layouts, once in a run of the tests."""

    def make() -> str:
        folder = tmp_path_factory.mktemp("pocl")
        on_gpus = SCENES if EVERYTHING else FEW_ON_GPUS
        render(POCL, folder, *(f"{name}.cpu" for name in SCENES), *(f"{name}.gpu" for name in on_gpus))
        return str(folder)

    return Path(once("scenes of drivers by PoCL", make))
