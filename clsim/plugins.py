"""Plugins: what installed packages add to clsim by entry points, one group for each kind of addition."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any, TypeVar

from clsim.errors import InputError

T = TypeVar("T")

PATH_FAMILIES = "clsim.path_families"  # functions, each a `FamilyFinder`
ROOMS = "clsim.rooms"  # subclasses or own classes of rooms, whose static method `find_paths` is a `RoomFinder`
STORES = "clsim.stores"  # subclasses of `SoundStore`
METHODS = "clsim.methods"  # functions that take a `Plan` and return a `Contribution` or None


def with_plugins(known: Mapping[str, T], group: str) -> dict[str, T]:
    """Join the objects of clsim, by name, and those of a group of entry points, sorted by name."""
    added = _plugins(group)
    for name in added:
        if name in known:
            raise InputError("plugin", f"must have a name of its own in {group}, but {name!r} is part of clsim")
    return {**known, **added}


@cache
def _plugins(group: str) -> dict[str, Any]:
    """Load the entry points of a group, by name; packages that are installed later are not seen by this process."""
    found: dict[str, EntryPoint] = {}
    for point in sorted(entry_points(group=group), key=lambda point: (point.name, point.value)):
        other = found.setdefault(point.name, point)
        if other.value != point.value:
            twice = f"{point.name!r} is {other.value} and {point.value}"
            raise InputError("plugin", f"must have a name of its own in {group}, but {twice}")
    return {name: _loaded(point) for name, point in found.items()}


def _loaded(point: EntryPoint) -> Any:
    try:
        value = point.load()
    except Exception as error:  # the code of a package that somebody else wrote
        raise _refused(point, f"must be importable, but raises {type(error).__name__}: {error}") from error
    if not callable(value):
        raise _refused(point, f"must be a class or a function, but is {value!r:.80}")
    return value


def _refused(point: EntryPoint, problem: str) -> InputError:
    package = point.dist.name if point.dist is not None else "an unknown package"
    return InputError(f"plugin {point.group}:{point.name}", f"{problem} ({point.value} of {package})")
