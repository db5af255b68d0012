"""Checksums of chunks are those that the HDF5 library computes."""

from pathlib import Path

import numpy as np
import pytest

from clsim.output.raw_files import fletcher32

h5py = pytest.importorskip("h5py")


@pytest.mark.parametrize("size", [4, 720, 724, 73_728, 300_000])
@pytest.mark.parametrize("kind", ["zeros", "ones", "one", "noise", "carry"])
def test_checksums_are_those_of_the_library(kind: str, size: int, tmp_path: Path, rng: np.random.Generator) -> None:
    """Also where sums are multiples of 65535, and over several blocks."""
    data = np.zeros(size, np.uint8)
    if kind == "ones":
        data[:] = 255
    elif kind == "one":
        data[-1] = 1
    elif kind == "noise":
        data[:] = rng.integers(256, size=size)
    elif kind == "carry":
        data[:4] = 0, 1, 255, 254
    with h5py.File(tmp_path / "a.h5", "w") as file:
        found = file.create_dataset("a", data=data, chunks=(size,), fletcher32=True).id.read_direct_chunk((0,))[1]
    assert bytes(found) == data.tobytes() + fletcher32(data).tobytes()
