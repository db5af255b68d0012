"""Digest of the metadata of a Zarr group: chunks have checksums, ``zarr.json`` has none."""

from __future__ import annotations

import hashlib
import json
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pathlib import Path

SEAL = "clsim_metadata_sha256"  # attribute of a group
_BLANK = "0" * 64  # stands in its place where the digest is computed


def seal(group: Path) -> None:
    """Store the digest of a group's ``zarr.json`` and of those of its arrays in the attributes of the group."""
    path = group / "zarr.json"
    metadata = json.loads(path.read_bytes())
    metadata.setdefault("attributes", {})[SEAL] = _BLANK
    text = json.dumps(metadata, indent=2)
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
