"""What all tests share: seeded random numbers, and the engines."""

import zlib
from collections.abc import Iterator

import numpy as np
import pytest

from clsim.opencl.device import list_devices


@pytest.fixture(autouse=True)
def _print_options() -> Iterator[None]:
    """Undo what packages do to NumPy's print options (trimesh does, on writing DXF)."""
    with np.printoptions():
        yield


@pytest.fixture
def rng(request: pytest.FixtureRequest) -> np.random.Generator:
    """Random numbers that are another sequence for every test, and the same in every run."""
    return np.random.default_rng(zlib.crc32(request.node.name.encode()))


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
