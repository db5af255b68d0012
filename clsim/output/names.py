"""Names of files."""

from __future__ import annotations

import re


def file_names(wanted: tuple[str, ...]) -> list[str]:
    """Return names that any file system takes, each once."""
    names: list[str] = []
    for text in wanted:
        name = base = re.sub(r"[^A-Za-z0-9_-]+", "_", text).strip("_") or "receiver"
        count = 2
        while name.lower() in (n.lower() for n in names):
            name, count = f"{base}-{count}", count + 1
        names.append(name)
    return names
