"""Names of files."""

from __future__ import annotations

import re
from itertools import count

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
