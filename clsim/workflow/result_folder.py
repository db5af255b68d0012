"""A folder of results, in which nothing of others is touched and nothing that is made is lost.

Results are made in ``.partial`` within it and moved when they are whole; the record, ``clsim.json``, says beforehand
what will be moved. So whatever moment a process dies at, each file is clsim's by the record, or not touched.
"""

from __future__ import annotations

import errno
import hashlib
import json
import os
import re
import shutil
import stat
import time
import zipfile
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.errors import InputError, warn
from clsim.files import atomic

COMPLETED = "scene.completed.toml"
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
            return path.stat().st_size, atomic.sha256_of(path)
        if not stat.S_ISDIR(mode):
            return None
        inside = {child.name: fingerprint(child) for child in sorted(path.iterdir())}
    except FileNotFoundError:
        return None
    if None in inside.values():
        return None
    size = sum(mark[0] for mark in inside.values() if mark is not None)
    return size, hashlib.sha256(json.dumps(inside).encode()).hexdigest()


State = dict[str, "NDArray[Any]"]
_LOCK, _JOURNAL, _CONTENTS = "lock", "journal.npz", "contents.json"
_STORE_FILE = re.compile(r"(\w+/)?zarr\.json|\w+/c(/\d+)*|.*\.[0-9a-f]{32}\.partial")  # of a Zarr store
_STORE_FOLDER = re.compile(r"\w+(/c(/\d+)*)?")
_STILL_WRITING = 2.0  # s in which threads of an interrupted process finish their writes


class Journal:
    """Checkpoint file: identity of the run, samples written, state of the receivers; replaced atomically."""

    def __init__(self, folder: Path) -> None:
        self._path = folder / _JOURNAL

    def exists(self) -> bool:
        """Whether there is a checkpoint."""
        return self._path.exists()

    def save(self, identity: dict[str, Any], done: int, state: State) -> None:
        """Record that `done` samples are on the disk, with the state of the receivers after them."""
        write: Any = np.savez
        with atomic.safe_path(self._path) as temporary:
            write(temporary, identity=np.array(json.dumps(identity)), done=np.array(done), **state)

    def load(self) -> tuple[dict[str, Any], int, State]:
        """Return identity, number of samples and state."""
        try:
            with self._path.open("rb") as raw, np.load(raw, allow_pickle=False) as file:
                columns = dict(file.items())
            return json.loads(str(columns.pop("identity"))), int(columns.pop("done")), columns
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
            raise InputError("--resume", f"{self._path} cannot be read ({error}); --force begins anew") from error


def first_difference(old: Any, new: Any, field: str = "") -> str | None:
    """Return the first difference of two nested values in words, or None.

    Examples
    --------
    >>> first_difference({"walls": [{"reflection": 0.9}]}, {"walls": [{"reflection": 0.8}]})
    'walls[0].reflection was 0.9 and is 0.8'
    """
    if isinstance(old, dict) and isinstance(new, dict):
        inside = [(f"{field}.{k}" if field else k, old.get(k), new.get(k)) for k in dict.fromkeys([*old, *new])]
    elif isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        inside = [(f"{field}[{i}]", a, b) for i, (a, b) in enumerate(zip(old, new, strict=True))]
    else:
        return None if old == new else f"{field or 'it'} was {_in_words(old)} and is {_in_words(new)}"
    return next((found for k, a, b in inside if (found := first_difference(a, b, k)) is not None), None)


def _in_words(value: Any) -> str:
    return "not given" if value is None else f"{value!r:.60}"


class ResultFolder:
    """The folder of one run, whose possible files are known beforehand; `work` holds what is not whole yet."""

    def __init__(
        self, folder: Path, names: Sequence[str], inputs: Sequence[Path], *, resume: bool, force: bool
    ) -> None:
        if resume and force:
            raise InputError("--resume", "must be given without --force, which begins anew")
        self.folder, self.work = folder, folder / ".partial"
        self.journal = Journal(self.work)
        self._names, self._inputs, self._resume, self._force = list(names), inputs, resume, force
        self._record = Record()
        self._identity: dict[str, Any] = {}
        self._seen = False  # whether what `work` holds is known to be ours

    @contextmanager
    def held(self) -> Iterator[None]:
        """Lock the folder for this process; refuse foreign files, and clean up when the block ends."""
        atomic.check_folder(self.folder)
        self._check_before()
        made = [path for path in [self.folder, *self.folder.parents] if not path.exists()]
        self.work.mkdir(parents=True, exist_ok=True)
        try:
            with atomic.locked(self.work / _LOCK, "--output"):
                try:
                    self._check()
                    with atomic.naming_full(self.folder):
                        yield
                except BaseException as error:
                    self._keep_or_clear(error)
                    raise
                self._clear()
        finally:
            for path in [self.work, *made]:
                with suppress(OSError):  # what is not empty stays
                    path.rmdir()

    def begin(self, identity: dict[str, Any]) -> None:
        """Record the run's identity; results of another run are not resumed."""
        self._identity = json.loads(json.dumps(identity))
        if self._resume:
            old = self._record.identity if self._record.files else self._identity
            old = self.journal.load()[0] if self.journal.exists() else old
            difference = first_difference(old, self._identity)
            if difference is not None:
                raise InputError("--resume", f"must go on with the same run, but {difference} (--force begins anew)")
        if not (self._resume and self.journal.exists()):
            self._clear(lock=False)
        if not self._resume or self._record.identity != self._identity:
            self._record = self._record.outdated()
        made_here = sorted({*self._names, *self._contents()})
        with atomic.safe_path(self.work / _CONTENTS) as temporary:
            temporary.write_text(json.dumps(made_here), "utf-8")

    def is_whole(self, name: str) -> bool:
        """Return True if a result of this run exists unchanged."""
        mine = self._record.identity == self._identity and name in self._record.files
        return mine and fingerprint(self.folder / name) == self._record.files[name]

    def take(self, names: Sequence[str], *, finished: bool = False) -> list[Path]:
        """Move finished results from `work` to their place; return their paths."""
        names = [name for name in names if (self.work / name).exists()]
        if not names and self._record.finished:
            return []
        old = self._record
        for name in names:
            if name not in old.names():
                self._refuse(self.folder / name)
        before = tuple((n, old.files[n]) for n in names if n in old.files)
        for name in names:
            if (self.work / name).is_file():  # sound is flushed already
                atomic.to_disk(self.work / name)
        fresh = {n: mark for n in names if (mark := fingerprint(self.work / n)) is not None}
        files = dict(sorted((old.files | fresh).items()))
        self._save(Record(self._identity, False, files, (*old.replaced, *before)))
        for name in names:
            self._make_room(name)
            (self.work / name).replace(self.folder / name)
        atomic.to_disk(self.folder)
        left = [(name, mark) for name, mark in self._record.replaced if name not in self._record.files]
        for name, mark in left:  # earlier results that this run does not make
            if (finished or name not in self._names) and fingerprint(self.folder / name) == mark:
                self._set_aside(name)
        kept = () if finished else tuple((name, mark) for name, mark in left if name in self._names)
        self._save(Record(self._identity, finished, files, kept))
        return [self.folder / name for name in names]

    def _save(self, record: Record) -> None:
        self._record = record
        with atomic.safe_path(self.folder / RECORD, self.work) as temporary:  # on the disk itself
            temporary.write_text(json.dumps({"format": _FORMAT, **asdict(record)}, indent=1) + "\n", "utf-8")

    def _make_room(self, name: str) -> None:
        """Set aside an earlier result; one that somebody changed is kept under another name."""
        target = self.folder / name
        atomic.refuse_inputs([target], self._inputs)
        if not os.path.lexists(target):
            return
        if fingerprint(target) in self._record.fingerprints(name):
            if target.is_dir():
                self._set_aside(name)
            return
        kept, number = target.with_name(f"{name}.changed"), 2
        while os.path.lexists(kept):
            kept, number = target.with_name(f"{name}.changed-{number}"), number + 1
        target.rename(kept)
        warn(f"{target} was changed since it was written: it is kept as {kept.name}")

    def _set_aside(self, name: str) -> None:
        """Take one of our results out of the folder at once, however many files it has, to be deleted."""
        (self.folder / name).replace(atomic.temporary_path(self.work / name))

    def _check_before(self) -> None:
        """Refuse a working folder that is not ours; ours has a lock as long as it has anything."""
        inside = [path.name for path in self.work.iterdir()] if self.work.is_dir() else []
        lock = self.work / _LOCK
        foreign = os.path.lexists(self.work) and (self.work.is_symlink() or not self.work.is_dir())
        if foreign or (inside and _LOCK not in inside):
            self._refuse(self.work)
        if inside and lock.exists() and (not lock.is_file() or lock.stat().st_size):
            self._refuse(lock)

    def _check(self) -> None:
        """Raise if the folder holds foreign files."""
        self._check_work()
        self._seen = True
        self._record = load_record(self.folder)
        mine = self._record.names()
        atomic.refuse_inputs([self.folder / name for name in {*self._names, *mine, RECORD}], self._inputs)
        if not (self._resume or self._force):
            if self.journal.exists() or (mine and not self._record.finished):
                where = self.work if self.journal.exists() else self.folder
                choice = "(--resume goes on, --force begins anew)"
                raise InputError("--output", f"must hold no unfinished run, but {where} is one {choice}")
            if mine:
                listed = self.folder / RECORD
                raise InputError("--output", f"must hold no results yet, but {listed} lists some (--force writes over)")
        for name in self._names:
            if name not in mine:
                self._refuse(self.folder / name)
        atomic.remove_leftovers(self.folder)

    def _check_work(self) -> None:
        known = {_LOCK, *self._contents()}
        for path in self.work.iterdir():
            shared = path.is_file() and path.stat().st_nlink > 1  # writing into it would change another file
            if path.is_symlink() or shared or not (path.name in known or atomic.is_temporary(path.name)):
                self._refuse(path)
            for part in path.rglob("*") if path.is_dir() else ():
                pattern = _STORE_FILE if part.is_file() else _STORE_FOLDER
                if part.is_symlink() or not pattern.fullmatch(part.relative_to(path).as_posix()):
                    self._refuse(part)
        atomic.refuse_inputs(self.work.rglob("*"), self._inputs)

    def _contents(self) -> list[str]:
        """Return the names of clsim's files in `work`, beside the lock."""
        path = self.work / _CONTENTS
        if not path.exists():
            return [_CONTENTS]
        try:
            names = [name for name in json.loads(path.read_text("utf-8")) if isinstance(name, str)]
        except (OSError, ValueError, TypeError) as error:
            raise InputError("--output", f"must hold nothing of others, but {path} cannot be read: {error}") from error
        return [*names, _JOURNAL, _CONTENTS]

    def _refuse(self, path: Path) -> None:
        if os.path.lexists(path):
            raise InputError("--output", f"must hold no files of others at these names, but clsim did not write {path}")

    def _keep_or_clear(self, error: BaseException) -> None:
        """Delete useless files; a note on the error names the kept ones."""
        if not self._seen:  # nor is it known to be ours
            return
        if not self.journal.exists() and (self._record.finished or not self._record.names()):
            self._clear()
        elif not isinstance(error, InputError):  # which says itself what can be done
            kept = self.work if self.journal.exists() else self.folder
            error.add_note(f"what was rendered is kept in {kept}: --resume goes on with it")

    def _clear(self, *, lock: bool = True) -> None:
        """Delete our files in `work`, the list of them last."""
        ours = {*self._contents(), _LOCK} if lock else {*self._contents()}
        for path in sorted(self.work.iterdir(), key=lambda path: (path.name == _LOCK, path.name == _CONTENTS)):
            if path.name in ours or atomic.is_temporary(path.name):
                if path.is_dir() and not path.is_symlink():
                    _remove_folder(path)
                else:
                    path.unlink(missing_ok=True)


def _remove_folder(path: Path) -> None:
    """Delete a folder; after an interrupt, threads of Zarr may still be writing into it for a moment."""
    deadline = time.monotonic() + _STILL_WRITING
    while path.exists():
        try:
            shutil.rmtree(path)
        except OSError as error:
            if error.errno not in (errno.ENOTEMPTY, errno.EEXIST, errno.ENOENT) or time.monotonic() > deadline:
                raise
            time.sleep(0.02)
