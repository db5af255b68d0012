"""Names and contents of files: regular ones of bounded size are opened, so that none hangs or eats memory."""

from __future__ import annotations

import errno
import os
import re
import stat
import tomllib
import zipfile
from itertools import count
from pathlib import Path
from typing import IO, Any

from clsim.errors import InputError

LARGEST_TEXT = 2**27  # bytes; numbers in memory take up to ten times as much
LARGEST_BINARY = 2**28  # bytes, also of what a compressed file holds
_LARGEST_TOML = 2**24  # bytes
_DEEPEST = 64  # tables and lists within each other
_WHOLE = range(-(2**63), 2**64)  # TOML's whole numbers, and seeds

_KINDS = {stat.S_IFIFO: "a named pipe", stat.S_IFCHR: "a device", stat.S_IFBLK: "a device", stat.S_IFSOCK: "a socket"}


def check_file(path: str | os.PathLike[str], largest: int) -> None:
    """Raise unless a path leads to a regular file of at most `largest` bytes."""
    try:
        found = Path(path).stat()
    except ValueError as error:  # a zero character, or one that the system cannot write
        raise OSError(errno.EINVAL, f"no file can be called {str(path)!r:.80}") from error
    if stat.S_ISDIR(found.st_mode):
        raise OSError(errno.EISDIR, os.strerror(errno.EISDIR))
    if not stat.S_ISREG(found.st_mode):
        kind = _KINDS.get(stat.S_IFMT(found.st_mode), "something else")
        raise OSError(errno.EINVAL, f"it is {kind}, not a file")
    if found.st_size > largest:
        raise OSError(
            errno.EINVAL, f"it has {found.st_size / 2**20:.4g} MiB, and {largest / 2**20:.4g} are the most that is read"
        )


def open_file(path: str | os.PathLike[str], largest: int) -> IO[bytes]:
    """Return a regular file of at most `largest` bytes, opened for reading."""
    check_file(path, largest)
    return Path(path).open("rb")


def read_file(path: str | os.PathLike[str], largest: int) -> bytes:
    """Return the content of a regular file of at most `largest` bytes."""
    with open_file(path, largest) as file:
        return file.read(largest + 1)  # bounded even if it grows, or tells no size, as those of /proc


def check_archive(file: IO[bytes], largest: int = LARGEST_BINARY) -> None:
    """Raise unless a ZIP archive declares at most `largest` unpacked bytes."""
    with zipfile.ZipFile(file) as archive:
        size = sum(member.file_size for member in archive.infolist())
    if size > largest:
        raise OSError(
            errno.EINVAL, f"it unpacks to {size / 2**20:.4g} MiB, and {largest / 2**20:.4g} are the most that is read"
        )
    file.seek(0)


def read_toml(path: Path) -> dict[str, Any]:
    """Return the content of a TOML file."""
    try:
        content = tomllib.loads(read_file(path, _LARGEST_TOML).decode("utf-8-sig"))
    except OSError as error:
        raise InputError(str(path), f"cannot be read: {error.strerror or error}") from error
    except RecursionError as error:
        raise InputError(str(path), "must not hold tables and lists so deep within each other") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(str(path), f"is no TOML file: {error}") from error
    except ValueError as error:  # Python does not turn so many digits into a number
        raise InputError(str(path), "must hold numbers of 64 bits, but holds one of thousands of digits") from error
    _check_content(content, "", 1)
    return content


def _check_content(content: dict[str, Any] | list[Any], field: str, depth: int) -> None:
    """Refuse integers beyond every field's range, and depths beyond Python's recursion limit."""
    if depth > _DEEPEST:
        raise InputError(f"{field:.80}", f"must not be deeper than {_DEEPEST} tables and lists within each other")
    table = isinstance(content, dict)
    for key, value in content.items() if isinstance(content, dict) else enumerate(content):
        inner = isinstance(value, dict | list)
        if inner or (isinstance(value, int) and value not in _WHOLE):
            name = f"{field}[{key}]" if not table else f"{field}.{key}" if field else str(key)
            if not inner:
                raise InputError(name, f"must be a number of 64 bits, but is one of {value.bit_length()}")
            _check_content(value, name, depth + 1)


_LONGEST = 200  # letters; file systems take 255 bytes, of which the ends of names need some
_SPACES = "\u00a0\u2009\u202f"  # which Python does not count as printable


def shown(name: str) -> str:
    r"""Return a name or a line with escapes for bytes that are no UTF-8 and for control characters."""
    return "".join(c if c.isprintable() or c in _SPACES else c.encode("unicode_escape").decode() for c in name)


def file_names(wanted: tuple[str, ...]) -> list[str]:
    """Return names that any file system takes, each once."""
    names: list[str] = []
    taken: set[str] = set()  # in small letters, which some file systems do not tell from large ones
    numbers: dict[str, count[int]] = {}
    for text in wanted:
        name = base = re.sub(r"[^A-Za-z0-9_-]+", "_", text).strip("_")[:_LONGEST] or "receiver"
        while name.lower() in taken:
            name = f"{base}-{next(numbers.setdefault(base.lower(), count(2)))}"
        taken.add(name.lower())
        names.append(name)
    return names
