"""The machine's memory, with errors that name the field that needs more."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

from clsim.errors import InputError


@contextmanager
def within_memory(field: str, what: str, wanted: float) -> Iterator[None]:
    """Refuse what needs more memory than the machine has, and tell what needed it where less than that is free."""
    rule = f"must ask for less memory: {what} needs about {wanted / 2**20:.0f} MiB"
    there = machine_memory()
    if wanted > there:
        raise InputError(field, f"{rule}, but the machine has {there / 2**20:.0f} MiB")
    try:
        yield
    except MemoryError as error:
        raise InputError(field, f"{rule}, but there is not enough memory left") from error


def machine_memory() -> float:
    """Return the machine's memory, bytes; infinite where the system does not say."""
    try:
        return float(os.sysconf("SC_PHYS_PAGES")) * float(os.sysconf("SC_PAGE_SIZE"))
    except (AttributeError, ValueError, OSError):
        return float("inf")
