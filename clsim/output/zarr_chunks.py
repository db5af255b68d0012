"""Chunks of Zarr stores that are missing: Zarr itself reads the fill value for them."""

from __future__ import annotations

import json
import math
import os
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pathlib import Path

ALL_CHUNKS = {"clsim_chunks": "all"}  # attribute of groups whose chunks of zeros are files, too


def arrays_with_missing_chunks(group: Path, metadata: dict[str, Any] | None = None) -> list[str]:
    """List the arrays of a group whose chunks are not all there; none of a group that left out zeros.

    Names of files are counted, no chunk is opened. `metadata` is the group's ``zarr.json``, with that of all arrays.

    Raises
    ------
    OSError, ValueError, KeyError, TypeError, AttributeError
        If the metadata cannot be read.
    """
    found = json.loads((group / "zarr.json").read_bytes()) if metadata is None else metadata
    if not ALL_CHUNKS.items() <= found.get("attributes", {}).items():
        return []
    arrays = found["consolidated_metadata"]["metadata"]
    return [name for name, array in arrays.items() if _stored(group / name / "c") < _wanted(array)]


def _wanted(array: dict[str, Any]) -> int:
    sizes = array["chunk_grid"]["configuration"]["chunk_shape"]
    return math.prod(-(-n // size) for n, size in zip(array["shape"], sizes, strict=True))


def _stored(folder: Path) -> int:
    if folder.is_file():  # that of a single number
        return 1
    return sum(name.isdigit() for _, _, names in os.walk(folder) for name in names)
