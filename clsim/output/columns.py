"""Named arrays of results, and a Zarr group of them: many small arrays, for which libraries take longer than disks."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from clsim.output.raw_files import ALL_CHUNKS

_LARGEST = 2**24  # bytes of a chunk
_COMPRESSION = {"level": 0, "checksum": False}
_KINDS = "biufc"  # of NumPy, which Zarr has the same names for; all else is text


class Column(NamedTuple):
    """An array with the names of its dimensions."""

    dims: tuple[str, ...]
    values: NDArray[Any]
    attrs: dict[str, Any]


@dataclass(slots=True, eq=False)
class Columns:
    """Named arrays over common dimensions: coordinates, and what is known there."""

    attrs: dict[str, Any] = field(default_factory=dict)
    variables: dict[str, Column] = field(default_factory=dict)
    coords: set[str] = field(default_factory=set)  # names of coordinates

    @property
    def sizes(self) -> dict[str, int]:
        """Length of each dimension."""
        columns = self.variables.values()
        return {dim: n for column in columns for dim, n in zip(column.dims, column.values.shape, strict=True)}

    def add(
        self, name: str, dims: str | Sequence[str], values: Any, attrs: dict[str, Any] | None = None, *,
        coord: bool = False,
    ) -> None:  # fmt: skip
        """Add an array, or put it in the place of one; raise a ValueError where a length is not that of a dimension."""
        column = Column((dims,) if isinstance(dims, str) else tuple(dims), np.asarray(values), dict(attrs or {}))
        sizes = self.sizes
        for dim, count in zip(column.dims, column.values.shape, strict=True):
            if sizes.setdefault(dim, count) != count:
                raise ValueError(f"{name} has {count} along {dim!r}, where others have {sizes[dim]}")
        self.variables[name] = column
        if coord or column.dims == (name,):
            self.coords.add(name)

    def add_xarray(self, name: str, value: Any) -> None:
        """Add a DataArray with its coordinates, at those that are there already."""
        known = {dim: self.variables[dim].values for dim in value.dims if dim in self.coords and dim in value.indexes}
        value = value.reindex(known)
        for key, coord in value.coords.items():
            if str(key) not in self.variables:
                self._add_encoded(str(key), coord.variable, coord=True)
        self._add_encoded(name, value.variable, coord=False)

    def _add_encoded(self, name: str, variable: Any, *, coord: bool) -> None:
        """Add a variable of xarray as files hold it: times are numbers there."""
        from xarray.conventions import encode_cf_variable

        encoded = encode_cf_variable(variable)
        attrs = {key: value for key, value in encoded.attrs.items() if key != "_FillValue"}  # what is missing is NaN
        self.add(name, tuple(map(str, encoded.dims)), encoded.values, attrs, coord=coord)


def write_group(content: Columns, path: Path) -> None:
    """Write arrays into a Zarr group, beside those that are there: all chunks, those of zeros too, with checksums."""
    # "Zarr core specification (version 3)" (2024), with the gathered metadata and the texts of zarr-python 3, which
    # xarray opens. `scene`, a text of many lines, makes the group's attributes the larger part of it.
    arrays = {file.parent.name: json.loads(file.read_bytes()) for file in path.glob("*/zarr.json")}
    for name, column in content.variables.items():
        if name not in arrays:
            chunk = chunk_shape(column.values.shape, max(column.values.dtype.itemsize, 8))
            arrays[name] = create_array(path / name, column, chunk)
            _write_chunks(path / name, column.values, chunk)
    apart = sorted(name for name in content.coords if content.variables[name].dims != (name,))
    named = {"coordinates": " ".join(apart)} if apart else {}
    gathered = {"kind": "inline", "must_understand": False, "metadata": arrays}
    path.mkdir(parents=True, exist_ok=True)
    group = _group(content.attrs | ALL_CHUNKS | named) | {"consolidated_metadata": gathered}
    (path / "zarr.json").write_text(_text(group), "utf-8")


def write_root(path: Path, attrs: dict[str, Any]) -> None:
    """Write a Zarr group in which others are made later."""
    path.mkdir(parents=True, exist_ok=True)
    (path / "zarr.json").write_text(_text(_group(attrs)), "utf-8")


def _group(attrs: dict[str, Any]) -> dict[str, Any]:
    return {"attributes": attrs, "zarr_format": 3, "node_type": "group"}


def _text(metadata: dict[str, Any]) -> str:
    """Return metadata as JSON; NumPy's numbers and arrays among attributes are plain ones."""
    return json.dumps(metadata, default=lambda value: value.tolist())


def create_array(path: Path, column: Column, chunk: tuple[int, ...]) -> dict[str, Any]:
    """Write the metadata of an array, and return them."""
    stored = stored_type(column.values.dtype)
    endian = {"configuration": {"endian": "little"}} if stored.itemsize > 1 else {}
    kind, text = stored.kind, stored.kind == "O"
    fill = {"O": "", "b": False, "f": "NaN", "c": ["NaN", "NaN"]}.get(kind, 0)
    metadata = {
        "shape": column.values.shape,
        "data_type": "string" if text else stored.name,
        "chunk_grid": {"name": "regular", "configuration": {"chunk_shape": chunk}},
        "chunk_key_encoding": {"name": "default", "configuration": {"separator": "/"}},
        "fill_value": fill,
        "codecs": [
            {"name": "vlen-utf8", "configuration": {}} if text else {"name": "bytes"} | endian,
            {"name": "zstd", "configuration": _COMPRESSION},
            {"name": "crc32c"},
        ],
        "attributes": column.attrs,
        "dimension_names": column.dims,
        "zarr_format": 3,
        "node_type": "array",
        "storage_transformers": [],
    }
    path.mkdir(parents=True)
    content = _text(metadata)
    (path / "zarr.json").write_text(content, "utf-8")
    found: dict[str, Any] = json.loads(content)
    return found


def stored_type(given: np.dtype[Any]) -> np.dtype[Any]:
    """Return the type that Zarr stores: numbers of at most 64 bits (complex ones 128), low bytes first, or texts."""
    if given.kind not in _KINDS:
        return np.dtype(object)
    return np.dtype(f"<{given.kind}{min(given.itemsize, 16 if given.kind == 'c' else 8)}")


def chunk_shape(shape: tuple[int, ...], item: int) -> tuple[int, ...]:
    """Return the shape of an array's chunks, items of some bytes: the whole, or halves of it that are small enough."""
    chunk = [max(n, 1) for n in shape]
    while math.prod(chunk) * item > _LARGEST:
        longest = int(np.argmax(chunk))
        chunk[longest] = -(-chunk[longest] // 2)
    return tuple(chunk)


def _write_chunks(path: Path, values: NDArray[Any], chunk: tuple[int, ...]) -> None:
    for place in _places(values.shape, chunk):
        part = values[tuple(slice(k * size, (k + 1) * size) for k, size in zip(place, chunk, strict=True))]
        if part.shape != chunk:  # all chunks are equally large
            part = np.pad(part, [(0, size - n) for size, n in zip(chunk, part.shape, strict=True)])
        write_chunk(path, place, part)


def _places(shape: tuple[int, ...], chunk: tuple[int, ...]) -> Iterator[tuple[int, ...]]:
    yield from product(*(range(-(-n // size)) for n, size in zip(shape, chunk, strict=True)))


def write_chunk(path: Path, place: tuple[int, ...], values: NDArray[Any]) -> Path:
    """Write one whole chunk of an array; return its file."""
    from google_crc32c import value as crc32c
    from numcodecs.zstd import compress

    stored = stored_type(values.dtype)
    if stored.kind == "O":
        texts = [str(text).encode() for text in values.ravel()]
        sized = (len(text).to_bytes(4, "little") + text for text in texts)
        content = len(texts).to_bytes(4, "little") + b"".join(sized)
    else:
        content = np.ascontiguousarray(values, stored).tobytes()
    packed = compress(content, _COMPRESSION["level"])
    file = path.joinpath("c", *map(str, place))
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_bytes(packed + crc32c(packed).to_bytes(4, "little"))
    return file
