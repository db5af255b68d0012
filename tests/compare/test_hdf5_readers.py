"""Recordings that ``clsim run --store hdf5`` writes, read by h5py and by netCDF4 alone."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from late import installed
from scene_texts import along, receiver_at, scene_text, source_at, tone_of

import clsim
from clsim.cli import main
from clsim.scene_file import load_scene

h5py = installed("h5py", "h5py is not installed, with which clsim writes HDF5")
installed("h5netcdf", "h5netcdf is not installed, with which clsim writes HDF5")

SCENE = scene_text(
    source_at("robot", tone_of(10e3, 0.02, 48e3, fade=0.005), along((1, 1, 1), (1.1, 1, 1), 0.05)),
    receiver_at("left", (3.0, 1.0, 2.0)),
    receiver_at("hinten links", (3.0, 2.0, 2.0)),
    rate=48e3,
    render={"duration": 0.03},
)
POSITIONS = [[3.0, 1.0, 2.0], [3.0, 2.0, 2.0]]
BASEBAND = "baseband = { carrier = 10e3, bandwidth = 4e3 }\n"


def with_h5py(path: Path) -> dict[str, Any]:
    with h5py.File(path) as file:
        sound = file["sound"]
        return {
            "sound": sound[:],
            "dimensions": [dimension[0].name.strip("/") for dimension in sound.dims],
            "names": [name.decode() for name in file["receiver"][:]],
            "units": [unit.decode() for unit in file["unit"][:]],
            "positions": file["position"][:],
            **{name: np.ravel(value)[0] for name, value in file.attrs.items()},
        }


def with_netcdf(path: Path) -> dict[str, Any]:
    netcdf = pytest.importorskip("netCDF4", reason="netCDF4 is not installed")
    with netcdf.Dataset(path, auto_complex=True) as file:
        file.set_auto_mask(False)
        sound = file["sound"]
        return {
            "sound": sound[:],
            "dimensions": list(sound.dimensions),
            "names": list(file["receiver"][:]),
            "units": list(file["unit"][:]),
            "positions": file["position"][:],
            **file.__dict__,
        }


@pytest.mark.parametrize("reader", [with_h5py, with_netcdf])
@pytest.mark.parametrize("more", ["", BASEBAND], ids=["sound", "envelopes"])
@pytest.mark.usefixtures("device")
def test_a_store_tells_what_was_heard_by_whom_and_where(tmp_path: Path, reader: Any, more: str) -> None:
    """Sample for sample, what `render` gives of the scene that stands in the store."""
    scene = tmp_path / "scene.toml"
    scene.write_text(SCENE + more, "utf-8")
    assert main(["run", str(scene), "-o", str(tmp_path / "out"), "--store", "hdf5", "--no-plots"]) == 0
    read = reader(tmp_path / "out" / "recording.h5")

    told = tmp_path / "told.toml"
    told.write_text(read["scene"], "utf-8")
    heard = load_scene(told).scene
    paths = clsim.find_paths(heard, max_order=1)
    baseband = (10e3, 4e3) if more else None
    wanted = clsim.render(paths, 48e3, duration=0.03, baseband=baseband)
    assert np.abs(wanted.samples).max(axis=1).min() > 0.1
    assert read["dimensions"] == ["receiver", "time"]
    assert read["sound"].dtype == (np.complex64 if more else np.float32)
    np.testing.assert_array_equal(read["sound"], wanted.samples)
    assert read["sampling_rate"] == wanted.sampling_rate
    assert (read["names"], read["units"]) == (["left", "hinten links"], ["Pa", "Pa"])
    np.testing.assert_array_equal(read["positions"], POSITIONS)
    assert read["clsim_version"] == clsim.__version__
    assert read.get("carrier") == (10e3 if more else None)
