"""Checks before writing: foreign files and inputs are never overwritten."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from pathlib import Path

from clsim.errors import InputError
from clsim.files.atomic import remove_leftovers


class NewFile:
    """A file that is to be written: checked before work begins, and again when there is something to write.

    inputs: what the command reads: never written over, as links, folders and devices never are.
    """

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


def check_folder(folder: Path, field: str = "--output") -> None:
    """Raise unless a folder exists or can be created."""
    here = Path(os.path.abspath(folder))  # noqa: PTH100  (links are not to be resolved)
    first = next(path for path in [here, *here.parents] if os.path.lexists(path))
    if not first.is_dir():
        what = "a file" if first.exists() else "a link to nothing"
        raise InputError(field, f"must be a folder or lie in one, but {first} is {what}")


def refuse_inputs(paths: Iterable[Path], inputs: Sequence[Path], field: str = "--output") -> None:
    """Raise if an output is, or contains, an input file, under whatever name."""
    read = {_number(path): path for path in inputs if path.exists()}
    real = {Path(os.path.realpath(path)): path for path in inputs}
    for path in paths:
        found = read.get(_number(path)) if path.exists() else None
        if found is None and path.is_dir():
            here = Path(os.path.realpath(path))
            found = next((given for file, given in real.items() if here in file.parents), None)
        if found is not None:
            raise InputError(field, f"must write over no input, but {path} is {found}, which is read")


def _number(path: Path) -> tuple[int, int]:
    """Return the file's identity (device, inode)."""
    found = path.stat()
    return found.st_dev, found.st_ino
