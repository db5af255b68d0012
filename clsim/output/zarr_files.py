"""What Zarr does not check: chunks that are missing, read as the fill value, and changes of ``zarr.json``."""

from __future__ import annotations

import hashlib
import json
import math
import os
from pathlib import Path
from typing import Any

ALL_CHUNKS = {"clsim_chunks": "all"}  # attribute of groups whose chunks of zeros are files, too
SEAL = "clsim_metadata_sha256"  # attribute of a group
_BLANK = "0" * 64  # stands in its place where the digest is computed


def arrays_with_missing_chunks(group: Path, metadata: dict[str, Any] | None = None) -> list[str]:
    """List the arrays of a group whose chunks are not all there; none of a group that left out zeros.

    Names of files are counted, no chunk is opened. `metadata` is the group's ``zarr.json``, with that of all arrays.
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


def seal(group: Path) -> None:
    """Store the digest of a group's ``zarr.json`` and of those of its arrays in the attributes of the group."""
    path = group / "zarr.json"
    metadata = json.loads(path.read_bytes())
    metadata.setdefault("attributes", {})[SEAL] = _BLANK
    text = json.dumps(metadata)
    path.write_text(text.replace(_BLANK, _digest(group, text.encode(), metadata)), "utf-8")


def is_sealed(group: Path) -> bool:
    """Test whether the metadata of a group and its arrays are what was sealed, to the byte."""
    try:
        content = (group / "zarr.json").read_bytes()
        metadata = json.loads(content)
        digest = metadata["attributes"][SEAL]
        blank = content.replace(digest.encode(), _BLANK.encode())
        return bool(digest != _BLANK and digest == _digest(group, blank, metadata))
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return False


def _digest(group: Path, content: bytes, metadata: dict[str, Any]) -> str:
    """SHA-256 of a group's metadata, whose own digest is blank, and of the metadata of its arrays."""
    found = hashlib.sha256(content)
    for name in sorted(metadata.get("consolidated_metadata", {}).get("metadata", {})):
        found.update((group / name / "zarr.json").read_bytes())
    return found.hexdigest()
