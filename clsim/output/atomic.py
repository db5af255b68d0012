"""Files that appear whole or not at all."""

from __future__ import annotations

import os
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator


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
