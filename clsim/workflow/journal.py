"""A checkpoint: what a run needs to go on: what it is, how far it came, what its receivers remember."""

from __future__ import annotations

import json
import zipfile
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.errors import InputError
from clsim.files.atomic import safe_path

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

State = dict[str, "NDArray[Any]"]


class Journal:
    """A small file beside the sound; it is always whole, and on the disk itself."""

    def __init__(self, folder: Path) -> None:
        self._path = folder / "journal.npz"

    def exists(self) -> bool:
        """Return whether there is something to go on from."""
        return self._path.exists()

    def discard(self) -> None:
        """Forget what there was to go on from."""
        self._path.unlink(missing_ok=True)

    def save(self, identity: dict[str, Any], done: int, state: State) -> None:
        """Note that `done` samples are on the disk, and the state of the receivers behind them."""
        write: Any = np.savez
        with safe_path(self._path) as temporary:
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
