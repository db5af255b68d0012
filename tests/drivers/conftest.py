"""What tests of drivers share."""

from collections.abc import Callable
from pathlib import Path

import pytest
from driver_scenes import SCENES
from drivers import EVERYTHING, FEW_ON_GPUS, POCL, render

ALL = [f"{name}.cpu" for name in SCENES] + [f"{name}.gpu" for name in (SCENES if EVERYTHING else FEW_ON_GPUS)]


@pytest.fixture(scope="session")
def by_pocl(once, tmp_path_factory) -> Callable[..., Path]:
    """Return a function to the folder of scenes rendered by PoCL, each scene and layout once in a run of the tests."""

    def folder(*names: str) -> Path:
        def make() -> str:
            made = tmp_path_factory.mktemp("pocl")
            render(POCL, made, *names)
            return str(made)

        return Path(once(f"scenes of drivers by PoCL: {names}", make))

    return lambda *names: folder(*(names or ALL))
