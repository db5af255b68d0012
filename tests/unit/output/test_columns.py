"""Named arrays in Zarr groups that xarray reads: kinds of values, chunks, checksums, coordinates, arrays of xarray."""

from pathlib import Path

import numpy as np
import pytest
from late import installed

from clsim.arrays import texts
from clsim.output import columns
from clsim.output.columns import Columns, write_group
from clsim.output.raw_files import arrays_with_missing_chunks, is_sealed, seal

VALUES = {
    "singles": np.array([[1.5, np.nan], [0.0, -np.inf], [3.0, 4.0]], np.float32),
    "doubles": np.arange(6.0).reshape(3, 2),
    "swapped": np.arange(6, dtype=">i4").reshape(3, 2),
    "transposed": np.arange(6).reshape(2, 3).T,
    "complexes": np.array([[1 + 2j, 0], [np.nan, 4], [5, 6]]),
    "masks": np.array([[True, False], [False, False], [True, True]]),
    "bytes": np.arange(6, dtype=np.uint8).reshape(3, 2),
    "words": np.array([["", "ä"], ["日本", "\0"], ["x" * 99, "y"]], dtype=object),
    "number": np.array(2.5),
    "nothing": np.empty((0, 2)),
}


def made() -> Columns:
    found = Columns({"format": np.int64(1), "about": "all\nof it"})
    found.add("row", "row", texts("abc"))
    found.add("place", ("row", "column"), np.ones((3, 2)), {"units": "m"}, coord=True)
    for name, values in VALUES.items():
        dims = (
            {0: (), 2: ("row", "column")}[values.ndim] if len(values.shape) == 0 or len(values) else ("none", "column")
        )
        found.add(name, dims, values, {"scale": np.array([1.0, 2.0])})
    return found


@pytest.mark.parametrize("largest", [2**24, 40])
def test_groups_are_read_as_they_were(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, largest: int) -> None:
    xarray = installed("xarray")
    monkeypatch.setattr(columns, "_LARGEST", largest)
    content = made()
    write_group(content, tmp_path / "g")
    seal(tmp_path / "g")
    assert is_sealed(tmp_path / "g")
    assert not arrays_with_missing_chunks(tmp_path / "g")
    with xarray.open_zarr(tmp_path / "g", chunks=None) as found:
        assert {"row", "place"} == set(found.coords)
        assert found.attrs["about"] == "all\nof it"
        for name, column in content.variables.items():
            assert found[name].dims == column.dims
            assert found[name].dtype.kind in {column.values.dtype.kind, "T"}
            np.testing.assert_array_equal(found[name].values, column.values)
    chunks = len([file for file in (tmp_path / "g" / "doubles" / "c").rglob("*") if file.is_file()])
    assert chunks == (1 if largest == 2**24 else 2)


def test_changed_chunks_are_refused_and_missing_ones_are_counted(tmp_path: Path) -> None:
    zarr = installed("zarr")
    write_group(made(), tmp_path / "g")
    chunk = tmp_path / "g" / "doubles" / "c" / "0" / "0"
    content = bytearray(chunk.read_bytes())
    content[-6] ^= 1
    chunk.write_bytes(content)
    with pytest.raises(ValueError, match="checksum"):
        zarr.open_array(tmp_path / "g" / "doubles", mode="r")[:]
    chunk.unlink()
    assert arrays_with_missing_chunks(tmp_path / "g") == ["doubles"]


def test_lengths_agree() -> None:
    content = made()
    with pytest.raises(ValueError, match="wrong has 4 along 'row', where others have 3"):
        content.add("wrong", "row", np.zeros(4))
    assert "wrong" not in content.variables


def test_arrays_of_xarray_are_put_at_the_coordinates_that_are_there(tmp_path: Path) -> None:
    xarray = installed("xarray")
    content = made()
    when = np.array(["2026-01-01", "2026-01-03"], "datetime64[ns]")
    one = xarray.DataArray([[1.0, 2.0], [3.0, 4.0]], [("row", ["c", "a"]), ("when", when)], attrs={"units": "s"})
    content.add_xarray("one", one)
    write_group(content, tmp_path / "g")
    with xarray.open_zarr(tmp_path / "g", chunks=None) as found:
        np.testing.assert_array_equal(found["one"], [[3.0, 4.0], [np.nan, np.nan], [1.0, 2.0]])
        np.testing.assert_array_equal(found["when"], when)
        assert found["one"].attrs["units"] == "s"
