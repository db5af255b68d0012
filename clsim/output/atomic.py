"""Files that appear whole or not at all, and stay so when the power fails."""

from __future__ import annotations

import os
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from clsim.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Iterator
    from typing import IO


def temporary_path(path: Path) -> Path:
    """Return the name beside `path` under which it is written; it keeps the suffix, which libraries look at."""
    return path.with_name(f".{path.stem}.{os.getpid()}.partial{path.suffix}")


@contextmanager
def atomic_path(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield a temporary path that becomes `path` when the block ends well, and is deleted when it does not.

    Parameters
    ----------
    path : path-like
        Where the file is to be; its folder must exist.

    Raises
    ------
    OSError
        If it cannot be written; it names the file.
    """
    final = Path(path)
    temporary = temporary_path(final)
    try:
        yield temporary
        temporary.replace(final)
    except OSError as error:
        if error.filename is None and error.errno is not None:  # writing does not tell the name, opening does
            raise OSError(error.errno, error.strerror, str(final)) from error
        raise
    finally:
        temporary.unlink(missing_ok=True)


def to_disk(path: Path) -> None:
    """Wait until a file, or the names in a folder, are on the disk itself."""
    if os.name == "nt" and path.is_dir():  # Windows keeps names safe on its own, and opens no folders
        return
    number = os.open(path, os.O_RDONLY if path.is_dir() else os.O_RDWR)
    try:
        os.fsync(number)
    finally:
        os.close(number)


def tree_to_disk(folder: Path) -> None:
    """Wait until all that a folder holds is on the disk itself."""
    for path in sorted(folder.rglob("*"), reverse=True):
        to_disk(path)
    to_disk(folder)


@contextmanager
def safe_path(path: Path) -> Iterator[Path]:
    """Yield a temporary path as `atomic_path`; when the block has ended, the file is on the disk itself."""
    with atomic_path(path) as temporary:
        yield temporary
        to_disk(temporary)
    to_disk(path.parent)


@contextmanager
def locked(path: Path, field: str) -> Iterator[None]:
    """Hold a lock on a file that the system takes back when the process dies; on Windows there is none.

    Raises
    ------
    InputError
        If another process holds it; `field` is what that names.
    """
    try:
        import fcntl
    except ImportError:
        yield
        return
    with path.open("w") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            _refuse_locked(file, field, error)
        yield


def _refuse_locked(file: IO[str], field: str, error: OSError) -> None:
    if isinstance(error, BlockingIOError):
        raise InputError(field, f"must be used by one process at a time, but another one holds {file.name}") from error
    # A file system without locks: what it cannot refuse, it allows.
