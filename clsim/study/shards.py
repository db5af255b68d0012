"""Members of a study as archives of many (WebDataset) with a table of their labels beside each (Parquet)."""

from __future__ import annotations

import hashlib
import io
import json
import os
import tarfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.errors import InputError, check_packages, warn
from clsim.exchange import flac_bytes
from clsim.files.atomic import safe_path, sha256_of
from clsim.files.sound import as_frames, wav_header
from clsim.study.content import Computed
from clsim.study.file import Study

Row = dict[str, Any]

FOLDER, WAITING = "shards", "members"  # of whole archives, and of members that are in none yet
_FORMAT, _DIGEST = b"clsim_shard_format", b"clsim_tar_sha256"  # metadata of a table
_SEAL, _END = ', "sha256": "', '"}'  # around the digest of labels, which is last in their JSON
_SEALED = len(_SEAL) + 64 + len(_END)
_BROKEN = (OSError, ValueError, KeyError, TypeError, EOFError, tarfile.TarError)


class DamagedError(InputError):
    """A shard is not what was written."""


def write_member(path: Path, made: Computed, form: str, row: Row) -> None:
    """Write a member into an archive of its own, which appears whole: all variables as labels, a file per sound."""
    name, content, rate = path.stem, made.content, made.content.attrs["sampling_rate"]
    files: dict[str, bytes] = {}
    labels: dict[str, Any] = {"key": name, "member": row["member"], "warnings": row.get("warnings", [])}
    for kind, samples in made.sounds.items():
        part = "" if kind == "recording" else f".{kind}"
        frames = as_frames(samples)
        if form == "flac":
            files[f"{name}{part}.flac"], labels[f"full_scale{part.replace('.', '_')}"] = flac_bytes(frames, rate)
        else:
            header = wav_header(rate, frames.shape[1], len(frames))
            files[f"{name}{part}.wav"] = header + np.ascontiguousarray(frames, "<f4").tobytes()
    labels |= {key: value for key, value in content.attrs.items() if isinstance(value, str | float | int)}
    labels |= {str(key): _plain(str(key), value.values) for key, value in content.variables.items()}
    labels["files"] = [{"name": key, "sha256": _sha256(data)} for key, data in files.items()]
    text = _sealed(labels)
    with safe_path(path) as temporary, tarfile.open(temporary, "w", format=tarfile.USTAR_FORMAT) as archive:
        for key, data in ({f"{name}.json": text} | files).items():  # without time or owner: equal members, equal bytes
            about = tarfile.TarInfo(key)
            about.size = len(data)
            archive.addfile(about, io.BytesIO(data))


def _sealed(labels: dict[str, Any]) -> bytes:
    """Return labels as JSON with the digest of all of it before the digest."""
    text = json.dumps(labels, sort_keys=True, allow_nan=False)
    return f"{text[:-1]}{_SEAL}{_sha256(text)}{_END}".encode()


def _unsealed(content: bytes, name: str) -> dict[str, Any]:
    """Return labels without their digest; raise where they have changed."""
    text, seal = content[:-_SEALED] + b"}", content[-_SEALED:].decode()
    if seal != f"{_SEAL}{_sha256(text)}{_END}":
        raise DamagedError("", f"{name} is not what was written")
    labels: dict[str, Any] = json.loads(text)
    return labels


def _sha256(data: str | bytes) -> str:
    return hashlib.sha256(data.encode() if isinstance(data, str) else data).hexdigest()


def _plain(name: str, values: NDArray[Any]) -> Any:
    """Return nested lists of JSON's values; what is not finite is null."""
    if values.dtype.kind == "c":
        raise InputError("metrics", f"must be real for shards, but {name} is complex")
    if values.dtype.kind == "f" and not np.isfinite(values).all():
        plain = values.astype(object)
        plain[~np.isfinite(values)] = None
        values = plain
    return values.tolist()


def read_members(path: Path) -> Iterator[tuple[dict[str, Any], dict[str, bytes]]]:
    """Yield labels and files of each member of an archive, by names behind the key; raise where a file has changed."""
    labels: dict[str, Any] = {}
    files: dict[str, bytes] = {}
    try:
        with tarfile.open(path, "r:") as archive:
            for about in archive:
                data = archive.extractfile(about)
                content = b"" if data is None else data.read()
                kind = about.name.partition(".")[2]
                if kind == "json":
                    labels, files = _unsealed(content, f"{about.name} in {path}"), {}
                    wanted = {one["name"]: one["sha256"] for one in labels["files"]}
                elif wanted.pop(about.name) == _sha256(content):
                    files[kind] = content
                else:
                    raise DamagedError("", f"{about.name} in {path} is not what was written")
                if not wanted:
                    yield labels, files
        if wanted:
            raise DamagedError("", f"{path} ends before {next(iter(wanted))}")
    except InputError:
        raise
    except (*_BROKEN, UnboundLocalError) as error:
        raise DamagedError("", f"{path} cannot be read as a shard: {error!r:.120}") from error


def sound_of(labels: dict[str, Any], files: dict[str, bytes], part: str = "") -> NDArray[np.float32]:
    """Return samples (rows, n) of a member's sound: the recording, or ``"direct"``, ``"reverberant"``, ``"noise"``."""
    import soundfile

    before = f"{part}." if part else ""
    kind = next((name for name in (f"{before}wav", f"{before}flac") if name in files), None)
    if kind is None:
        raise InputError("sounds", f"must be kept by the study, but {labels['key']} has {', '.join(files)}")
    scale = labels["full_scale" + (f"_{part}" if part else "")] if kind.endswith("flac") else 1.0
    samples: NDArray[np.float32] = soundfile.read(io.BytesIO(files[kind]), dtype="float32", always_2d=True)[0]
    return samples.T * np.float32(scale)


def read_shards(
    folder: str | os.PathLike[str], sounds: Sequence[str] = ("recording",)
) -> Iterator[tuple[dict[str, Any], dict[str, NDArray[np.float32]]]]:
    """Read the members of a study that was written as shards, one after another.

    Parameters
    ----------
    folder : path-like
        Output folder of ``clsim study``.
    sounds : sequence of str
        Sounds to decode, by their words in the study's `keep`: ``"recording"``, ``"direct"``, ``"reverberant"``,
        ``"noise"``.

    Yields
    ------
    labels : dict
        The columns of the shards' tables, vectors and arrays as nested lists, None where a number is not finite.
    sounds : dict of ndarray (rows, samples) float32
        By name, Pa or V.

    Raises
    ------
    InputError
        If the folder holds no shards, a member has no such sound, or a shard is not what was written.

    Examples
    --------
    >>> next(read_shards("nowhere"))
    Traceback (most recent call last):
        ...
    clsim.errors.InputError: folder: must hold shards of a study, but 'nowhere' holds none
    """
    for table in tables_of(folder):
        yield from ((labels, sounds_of(labels, files, sounds)) for labels, files in members_of(table))


def tables_of(folder: str | os.PathLike[str]) -> list[Path]:
    """Return the tables of all shards of a study's folder."""
    tables = sorted((Path(folder) / FOLDER).glob("shard-*.parquet"))
    if not tables:
        raise InputError("folder", f"must hold shards of a study, but {str(folder)!r} holds none")
    check_packages("folder", "a table of labels", "parquet", "pyarrow")
    return tables


def members_of(table: Path) -> Iterator[tuple[dict[str, Any], dict[str, bytes]]]:
    """Yield labels and files of the members of a shard, as many as its table has."""
    tar, left = table.with_suffix(".tar"), member_count(table)
    for member in read_members(tar):
        left -= 1
        yield member
    if left:
        raise DamagedError("", f"{tar} is not what was written: it lacks {left} members")


def sounds_of(labels: dict[str, Any], files: dict[str, bytes], names: Sequence[str]) -> dict[str, NDArray[np.float32]]:
    """Return sounds of a member by their words in `keep`."""
    return {name: sound_of(labels, files, "" if name == "recording" else name) for name in names}


class Shards:
    """The shards of a study's folder: members' archives, joined when all of a shard are done with and none failed."""

    def __init__(self, folder: Path, study: Study) -> None:
        assert study.shards is not None
        self._folder, self._size, self._count = folder, study.shards.members, len(study.members)
        self._form = study.shards.format
        self._known: dict[int, set[int]] = {}

    def path_of(self, number: int) -> Path:
        """Archive of a member that is in no shard yet."""
        return self._folder / WAITING / f"m{number:06d}.tar"

    def _paths(self, shard: int) -> tuple[Path, Path]:
        name = f"shard-{shard:06d}"
        return self._folder / FOLDER / f"{name}.tar", self._folder / FOLDER / f"{name}.parquet"

    def row_of(self, number: int) -> Row | None:
        """Return the row of a member whose results are there and whole."""
        path = self.path_of(number)
        if path.exists():
            try:
                ((labels, _),) = read_members(path)
            except ValueError:  # damaged, or not one member
                return None
            row = {"member": number, "status": "finished", "error": "", "warnings": labels["warnings"]}
            return row if labels["member"] == number else None
        return {"member": number, "status": "finished"} if number in self._holds(number // self._size) else None

    def _holds(self, shard: int) -> set[int]:
        """Return the members of a shard that is whole; one that is not is deleted, with a warning."""
        if shard not in self._known:
            tar, table = self._paths(shard)
            try:
                found = {row["member"] for row in read_table(table)} if table.exists() else set()
            except InputError as error:
                warn(f"the members of {tar.stem} are run again: {error}")
                found = set()
                table.unlink()
            self._known[shard] = found
        return self._known[shard]

    def holds(self, number: int) -> bool:
        """Test whether a member has results, whole or not."""
        return self.path_of(number).exists() or number in self._holds(number // self._size)

    def write(self, number: int, made: Computed, row: Row) -> None:
        """Write the results of a member."""
        write_member(self.path_of(number), made, self._form, row)

    def discard(self, number: int) -> None:
        """Delete a member that waits for its shard."""
        self.path_of(number).unlink(missing_ok=True)

    def decided(self, number: int, rows: Mapping[int, Any]) -> None:
        """Join the shard of a member if all of it are done with."""
        shard = number // self._size
        mine = range(shard * self._size, min((shard + 1) * self._size, self._count))
        if any(rows[k].status == "waiting" for k in mine):
            return
        there = [k for k in mine if self.path_of(k).exists()]
        if not self._holds(shard).issuperset(there):
            self._join(shard, there)
        if all(rows[k].status == "finished" for k in mine):
            for k in there:
                self.discard(k)

    def _join(self, shard: int, members: list[int]) -> None:
        tar, table = self._paths(shard)
        rows = []
        with safe_path(tar) as temporary:
            with tarfile.open(temporary, "w", format=tarfile.USTAR_FORMAT) as archive:
                for number in members:
                    for labels, _ in read_members(self.path_of(number)):
                        rows.append(labels)
                    with tarfile.open(self.path_of(number), "r:") as one:
                        for about in one:
                            archive.addfile(about, one.extractfile(about))
            digest = sha256_of(temporary).encode()
        with safe_path(table) as temporary:
            _write_table(temporary, rows, digest)
        self._known[shard] = set(members)


def _write_table(path: Path, rows: list[dict[str, Any]], digest: bytes) -> None:
    """Write labels, a row per member; columns whose values do not agree are texts of JSON."""
    import pyarrow as pa
    from pyarrow import parquet

    columns = {}
    for name in dict.fromkeys(name for row in rows for name in sorted(row)):
        values = [row.get(name) for row in rows]
        try:
            columns[name] = pa.array(values)
        except (pa.ArrowInvalid, pa.ArrowTypeError, OverflowError):
            columns[name] = pa.array([json.dumps(value) for value in values])
    table = pa.table(columns).replace_schema_metadata({_FORMAT: b"1", _DIGEST: digest})
    parquet.write_table(table, path, compression="zstd", write_page_checksum=True)


def read_table(path: Path, whole: bool = True) -> list[dict[str, Any]]:
    """Return the labels of a shard from its table (``.parquet``); `whole` reads its archive, which must be there."""
    from pyarrow import parquet

    tar = path.with_suffix(".tar")
    try:
        file = parquet.ParquetFile(path, page_checksum_verification=True)
        about = file.schema_arrow.metadata or {}
        rows: list[dict[str, Any]] = file.read().to_pylist()
        if about.get(_FORMAT) != b"1":
            raise DamagedError("", f"{path} is no table of clsim's shards of format 1")
        if not tar.is_file() or (whole and sha256_of(tar).encode() != about[_DIGEST]):
            raise DamagedError("", f"{tar} is not what was written")
    except _BROKEN as error:
        if isinstance(error, InputError):
            raise
        raise DamagedError("", f"{path} cannot be read: {error!r:.120}") from error
    return rows


def member_count(table: Path) -> int:
    """Return the number of members of a shard."""
    from pyarrow import parquet

    try:
        return int(parquet.read_metadata(table).num_rows)
    except _BROKEN as error:
        raise DamagedError("", f"{table} cannot be read: {error!r:.120}") from error


def changed_shards(folder: Path) -> tuple[list[str], int]:
    """List the shards of a study's folder that have changed or are missing, and count all of both."""
    tables = sorted((folder / FOLDER).glob("shard-*.parquet"))
    known = {path.stem for path in tables} | {path.stem for path in (folder / FOLDER).glob("shard-*.tar")}
    changed = []
    for name in sorted(known):
        try:
            read_table(folder / FOLDER / f"{name}.parquet")
        except InputError:
            changed.append(f"{FOLDER}/{name}")
    return changed, len(known)
