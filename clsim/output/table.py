"""Path tables as files."""

from __future__ import annotations

import dataclasses
import zipfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.errors import InputError
from clsim.files.atomic import atomic_path
from clsim.packages import check_packages
from clsim.paths.path_table import PathTable, long_columns

if TYPE_CHECKING:
    import os
    from collections.abc import Sequence

    from clsim.paths.ground_truth import DirectPath, EchoTruth

_NAMES = ("source_names", "receiver_names", "object_names")
_ROW_GROUP = 100_000  # rows of a Parquet file written at a time, or those of one path where it has more
_REPEATING = ["times", "path", "source", "receiver", "order", "objects"]  # columns worth a dictionary


def write_table(table: PathTable, path: str | os.PathLike[str]) -> None:
    """Write a path table as ``.npz`` (arrays as in `PathTable`) or ``.parquet`` (a row per path and time).

    A complex gain is two columns in Parquet: magnitude, and ``gain_phase`` in rad.
    """
    check_table(str(path))
    if Path(path).suffix == ".npz":
        with atomic_path(path) as temporary:
            columns: dict[str, Any] = {f.name: getattr(table, f.name) for f in dataclasses.fields(table)}
            write: Any = np.savez_compressed
            write(temporary, **{k: np.array(v) if k in _NAMES else v for k, v in columns.items()})
    else:
        _write_parquet(table, path)


def check_table(name: str, field: str = "path") -> None:
    """Raise if a path table of this name cannot be written; an error names `field`."""
    suffix = Path(name).suffix
    if name and suffix not in (".npz", ".parquet"):
        raise InputError(field, f"must end in .npz or .parquet, but is {name!r}")
    if suffix == ".parquet":
        check_packages(field, "Parquet", "parquet", "pyarrow")


def write_ground_truth(found: DirectPath, path: str | os.PathLike[str], echoes: Sequence[EchoTruth] = ()) -> None:
    """Write ground truth as ``.npz``: arrays as in `DirectPath`, ``scatterer_…`` and ``body_…``."""
    columns: dict[str, Any] = {f.name: getattr(found, f.name) for f in dataclasses.fields(found)}
    columns = {name: np.array(value) if name in _NAMES else value for name, value in columns.items()}
    for echo in echoes:
        columns |= {f"{echo.KIND}_{name}": getattr(echo, name) for name in echo.MEASURES}
        columns[f"{echo.KIND}_names"] = np.array(echo.names)
    with atomic_path(path) as temporary:
        np.savez_compressed(temporary, **columns)


def read_table(path: str | os.PathLike[str]) -> PathTable:
    """Read a path table that `write_table` wrote as ``.npz``."""
    try:
        with Path(path).open("rb") as raw, np.load(raw, allow_pickle=False) as file:
            columns = {f.name: file[f.name] for f in dataclasses.fields(PathTable)}
    except (OSError, ValueError, TypeError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise InputError("path", f"must be a path table (.npz), but {str(path)!r} is none: {error}") from error
    arguments: dict[str, Any] = {k: tuple(map(str, v)) if k in _NAMES else v for k, v in columns.items()}
    return PathTable(**arguments)


def _write_parquet(table: PathTable, path: str | os.PathLike[str]) -> None:
    import pyarrow as pa
    from pyarrow import parquet

    def words(texts: Sequence[str], which: Any) -> Any:
        # Not NumPy's text, where every row is as wide as the longest and four bytes a character.
        return pa.array(texts, pa.string()).take(pa.array(which, pa.int64()))

    step = max(1, _ROW_GROUP // max(1, len(table.times)))
    with atomic_path(path) as temporary:
        writer = None
        try:
            for first in range(0, max(1, len(table.source)), step):
                rows = range(first, min(first + step, len(table.source)))
                columns = long_columns(table, rows, words)
                if np.iscomplexobj(table.gain):  # a type that Parquet does not know
                    columns |= {"gain": np.abs(columns["gain"]), "gain_phase": np.angle(columns["gain"])}
                piece = pa.table(columns)
                writer = writer or parquet.ParquetWriter(temporary, piece.schema, use_dictionary=_REPEATING)
                writer.write_table(piece)
        finally:
            if writer is not None:
                writer.close()
