"""Files as a whole or none: writing through temporary ones, and the rule of what may be overwritten."""

from __future__ import annotations

import errno
import hashlib
import os
import platform
import re
import secrets
import shutil
import zlib
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

from clsim.errors import InputError


class NewFile:
    """A file that is to be written, over no input: checked before work begins, and again before it is written."""

    def __init__(self, path: Path, inputs: Sequence[Path], force: bool, *, new_folder: bool = False) -> None:
        self.path, self._inputs, self._force, self._new_folder = path, inputs, force, new_folder
        self._check()

    def ready(self) -> Path:
        """Return the path when all is still as it was."""
        self._check()
        if self.path.parent.exists():
            remove_leftovers(self.path.parent)
        return self.path

    def _check(self) -> None:
        path, field = self.path, "--output"
        check_folder(path.parent)
        if not (path.parent.exists() or self._new_folder):
            raise InputError(field, f"must be in a folder that exists, but {path.parent} does not")
        if path.is_symlink():
            raise InputError(field, f"must be no link, but {path} is one")
        refuse_inputs([path], self._inputs)
        if path.exists() and not path.is_file():
            raise InputError(field, f"must be a file, but {path} is {'a folder' if path.is_dir() else 'a device'}")
        if path.exists() and not self._force:
            raise InputError(field, f"must not exist yet, but {path} does (--force writes over it)")


def check_folder(folder: Path) -> None:
    """Raise unless a folder exists or can be created."""
    here = Path(os.path.abspath(folder))  # noqa: PTH100  (links are not to be resolved)
    first = next(path for path in [here, *here.parents] if os.path.lexists(path))
    if not first.is_dir():
        what = "a file" if first.exists() else "a link to nothing"
        raise InputError("--output", f"must be a folder or lie in one, but {first} is {what}")


def refuse_inputs(paths: Iterable[Path], inputs: Sequence[Path]) -> None:
    """Raise if an output is, or contains, an input file, under whatever name."""
    read = {_number(path): path for path in inputs if path.exists()}
    real = {Path(os.path.realpath(path)): path for path in inputs}
    for path in paths:
        found = read.get(_number(path)) if path.exists() else None
        if found is None and path.is_dir():
            here = Path(os.path.realpath(path))
            found = next((given for file, given in real.items() if here in file.parents), None)
        if found is not None:
            raise InputError("--output", f"must write over no input, but {path} is {found}, which is read")


def _number(path: Path) -> tuple[int, int]:
    """Return the file's identity (device, inode)."""
    found = path.stat()
    return found.st_dev, found.st_ino


_NEXT_TO_NOTHING = 2**16  # bytes; a disk with less is full
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
_FLUSHES = 16  # that wait at the same time
_TEMPORARY = re.compile(r"\.clsim-([0-9a-f]{8})-(\d{1,9})-[0-9a-f]{8}\.partial(\..*)?")


def temporary_path(path: Path) -> Path:
    """Return a short temporary name beside `path` with its suffix, from which libraries choose the format."""
    token = secrets.token_hex(4)
    return path.with_name(f".clsim-{_machine()}-{os.getpid()}-{token}.partial{path.suffix}")


def is_temporary(name: str) -> bool:
    """Return True for names of unfinished files."""
    return _TEMPORARY.fullmatch(name) is not None


def remove_leftovers(folder: Path) -> None:
    """Delete the temporary files that processes of this machine left in a folder when they were killed."""
    if os.name == "nt":  # where no signal asks whether a process lives
        return
    for name in os.listdir(folder):  # noqa: PTH208  (names are all that is needed)
        found = _TEMPORARY.fullmatch(name)
        path = folder / name
        if found and found[1] == _machine() and _is_dead(int(found[2])) and path.is_file() and not path.is_symlink():
            path.unlink(missing_ok=True)


@cache
def _machine() -> str:
    """Return an identity of this machine and container, for disks that several share."""
    space = Path("/proc/self/ns/pid")
    inode = space.stat().st_ino if space.exists() else 0
    return f"{zlib.crc32(f'{platform.node()} {inode}'.encode()):08x}"


def _is_dead(process: int) -> bool:
    try:
        os.kill(process, 0)
    except OSError as error:
        return isinstance(error, ProcessLookupError)
    return False


@contextmanager
def atomic_path(path: str | os.PathLike[str], within: Path | None = None) -> Iterator[Path]:
    """Yield a temporary path that becomes `path` when the block ends well, and is deleted when it does not."""
    # within: folder of the temporary path, on the same disk; that of `path` when left out.
    final = Path(path)
    temporary = temporary_path(final if within is None else within / final.name)
    try:
        yield temporary
        temporary.replace(final)
    except OSError as error:
        if error.errno is not None and error.filename in (None, str(temporary)):  # who reads knows `path` only
            raise OSError(error.errno, error.strerror, str(final)) from error
        raise
    finally:
        if os.path.lexists(temporary):  # on a read-only disk not even a name that is not there can be deleted
            temporary.unlink(missing_ok=True)


def uninterrupted(work: Callable[..., Any], *arguments: Any, **more: Any) -> Any:
    """Call a function in a thread, and let an interrupt wait until it has ended."""
    # Interrupted itself, a library that writes by threads returns while these go on, into folders that are deleted.
    with ThreadPoolExecutor(1) as thread:
        return thread.submit(work, *arguments, **more).result()


def is_disk_full(error: BaseException) -> bool:
    """Return True for an error that all that is written there would meet, too."""
    return isinstance(error, OSError) and error.errno in _FULL


@contextmanager
def naming_full(path: Path) -> Iterator[None]:
    """Name a file or folder in the error of a full disk that names none."""
    try:
        yield
    except OSError as error:
        if is_disk_full(error) and error.filename is None:
            error.filename = str(path)
        raise


def not_written(path: str | os.PathLike[str], error: Exception) -> OSError:
    """Return the error of a file that cannot be written, with a full disk named, which C libraries do not report."""
    folder = Path(path).parent
    full = folder.is_dir() and shutil.disk_usage(folder).free < _NEXT_TO_NOTHING
    return OSError(f"cannot write {path}: {'disk full' if full or not str(error) else error}")


def to_disk(path: Path) -> None:
    """Flush a file, or the names in a folder, to the disk."""
    if os.name == "nt" and path.is_dir():  # Windows keeps names safe on its own, and opens no folders
        return
    number = os.open(path, os.O_RDONLY if path.is_dir() else os.O_RDWR)
    try:
        os.fsync(number)
    finally:
        os.close(number)


def sha256_of(path: Path) -> str:
    """Digest of a file, in hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def tree_to_disk(folder: Path) -> None:
    """Flush all files of a folder to the disk."""
    # Flushes that wait at the same time share one commit of the file system: 10 ms instead of 350 ms for 95 names.
    inside = [Path(where, name) for where, folders, files in os.walk(folder) for name in (*folders, *files)]
    parts = [inside[k::_FLUSHES] for k in range(min(_FLUSHES, len(inside)))]
    with ThreadPoolExecutor(_FLUSHES) as threads:
        deque(threads.map(_all_to_disk, [[folder], *parts]), maxlen=0)


def _all_to_disk(paths: Iterable[Path]) -> None:
    for path in paths:
        to_disk(path)


@contextmanager
def safe_path(path: Path, within: Path | None = None) -> Iterator[Path]:
    """Yield a temporary path as `atomic_path`; when the block has ended, the file is on the disk itself."""
    with atomic_path(path, within) as temporary:
        yield temporary
        to_disk(temporary)
    to_disk(path.parent)


@contextmanager
def locked(path: Path, field: str) -> Iterator[None]:
    """Hold a lock on a file that the system takes back when the process dies; on Windows there is none."""
    try:
        import fcntl
    except ImportError:
        yield
        return
    if path.is_symlink():
        raise InputError(field, f"must hold no links where clsim works, but {path} is one")
    try:
        number = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o666)
    except FileNotFoundError as error:  # who held it has deleted its folder just now
        raise _in_use(field, path) from error
    with os.fdopen(number, "r+") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise _in_use(field, path) from error
        except OSError:
            pass  # a file system without locks: what it cannot refuse, it allows
        if not path.exists() or not os.path.samestat(os.fstat(file.fileno()), path.lstat()):  # deleted since
            raise _in_use(field, path)
        yield


def _in_use(field: str, path: Path) -> InputError:
    return InputError(field, f"must be used by one process at a time, but another one holds {path}")
