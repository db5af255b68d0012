"""The record of a folder: clsim's files, their run and their digests."""

from __future__ import annotations

import hashlib
import json
import os
import stat
from collections.abc import Iterable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from clsim.errors import InputError
from clsim.files.atomic import safe_path, sha256_of

RECORD = "clsim.json"
_FORMAT = 1
Fingerprint = tuple[int, str]  # bytes, and SHA-256 in hexadecimal


@dataclass(frozen=True, slots=True)
class Record:
    """Files that clsim wrote into a folder."""

    identity: dict[str, Any] = field(default_factory=dict)  # of the run, as JSON keeps it; empty where there is none
    finished: bool = False  # whether all of it was made
    files: dict[str, Fingerprint] = field(default_factory=dict)  # fingerprints of results by name, folders among them
    replaced: tuple[tuple[str, Fingerprint], ...] = ()  # earlier results in whose place others are being put

    def fingerprints(self, name: str) -> list[Fingerprint]:
        """Return the possible fingerprints of one of clsim's files."""
        now = [self.files[name]] if name in self.files else []
        return now + [mark for other, mark in self.replaced if other == name]

    def names(self) -> list[str]:
        """Return the names of all that is clsim's."""
        return list(dict.fromkeys([*self.files, *(name for name, _ in self.replaced)]))

    def outdated(self) -> Record:
        """Return the record of a folder in which another run is begun."""
        marks = tuple((name, mark) for name in self.names() for mark in self.fingerprints(name))
        return Record({}, self.finished, {}, marks)


def load_record(folder: Path, requested_by: str = "--output") -> Record:
    """Return the record of a folder, which a field or an option named; an empty one where there is none."""
    path = folder / RECORD
    if not os.path.lexists(path):
        return Record()
    try:
        if path.is_symlink():
            raise ValueError("it is a link")
        read = json.loads(path.read_text("utf-8"))
        if read.pop("format") != _FORMAT:
            raise ValueError("it has another format")
        files = {_plain(name): (int(size), str(digest)) for name, (size, digest) in read["files"].items()}
        replaced = tuple((_plain(name), (int(size), str(digest))) for name, (size, digest) in read["replaced"])
        return Record(dict(read["identity"]), bool(read["finished"]), files, replaced)
    except (OSError, ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
        raise InputError(
            requested_by, f"must hold no {RECORD} of others, but {path} cannot be read: {error}"
        ) from error


def save_record(folder: Path, record: Record, work: Path) -> None:
    """Write the record of a folder, on the disk itself; `work` is where it is made."""
    with safe_path(folder / RECORD, work) as temporary:
        temporary.write_text(json.dumps({"format": _FORMAT, **asdict(record)}, indent=1) + "\n", "utf-8")


def changed_results(folder: Path, record: Record, names: Iterable[str] | None = None) -> list[str]:
    """List results, all or those of given names, that are missing or differ from their record."""
    wanted = record.files if names is None else [name for name in names if name in record.files]
    return [name for name in wanted if fingerprint(folder / name) != record.files[name]]


def _plain(name: Any) -> str:
    """Return the name of a file in the folder itself."""
    if not isinstance(name, str) or name in ("", ".", "..", RECORD) or "/" in name or os.sep in name:
        raise ValueError(f"{name!r:.80} is no name of a result")
    return name


def fingerprint(path: Path) -> Fingerprint | None:
    """Return size and digest of a file or folder; None if it is missing, a link or a device."""
    try:
        mode = path.lstat().st_mode
        if stat.S_ISREG(mode):
            return path.stat().st_size, sha256_of(path)
        if not stat.S_ISDIR(mode):
            return None
        inside = {child.name: fingerprint(child) for child in sorted(path.iterdir())}
    except FileNotFoundError:
        return None
    if None in inside.values():
        return None
    size = sum(mark[0] for mark in inside.values() if mark is not None)
    return size, hashlib.sha256(json.dumps(inside).encode()).hexdigest()
