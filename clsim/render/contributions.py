"""Base classes of contributions to the sound pressure at the receivers: the interface that renderings use."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

State = dict[str, "NDArray[Any]"]


def digest_of(*parts: str | NDArray[Any]) -> str:
    """Return the SHA-256 of texts and arrays (...), one after the other, in hexadecimal."""
    found = hashlib.sha256()
    for part in parts:
        found.update(part.encode() if isinstance(part, str) else np.ascontiguousarray(part).tobytes())
    return found.hexdigest()


class Contribution(Protocol):
    """Part of the pressure at all receivers, decided before any of it is computed."""

    @property
    def name(self) -> str:
        """Name of its kind, one word or two, as in messages and in what is kept of a run."""

    def describe(self) -> list[str]:
        """Describe the planned computation, one line for each part."""

    def digest(self) -> str:
        """Return a text that changes with all that its samples depend on beside paths and options."""

    def begin(self) -> Adding:
        """Return an object that adds it from the first sample on, or from a restored state on."""


class Adding(Protocol):
    """A contribution while it is rendered, piece by piece and in order."""

    def add(self, pressure: NDArray[Any], start: int) -> None:
        """Add samples from `start` on to the pressure (receivers, n), Pa; in baseband to its complex envelope."""

    def until(self, last: int) -> None:
        """Hint: samples from `last` on will not be requested yet; do not prefetch them."""

    def shared(self, first: int, last: int) -> list[str]:
        """Return the names of arrays that samples `first` to `last` share with others; one process computes each."""

    def made(self, name: str) -> NDArray[Any]:
        """Compute the shared array of a name, of any shape; it does not depend on the process or the time."""

    def look_up(self, find: Callable[[str], NDArray[Any]]) -> None:
        """Use `find` to get shared arrays by name instead of computing them."""

    def state(self) -> State:
        """Return the state after the chunks so far, from which rendering continues bit for bit."""

    def restore(self, state: State) -> None:
        """Continue from the `state` of another object of the same plan."""

    def warn(self) -> None:
        """Warn after the last chunk of results that miss the requested accuracy."""


class WithoutTables:
    """Base class of contributions whose chunks share no arrays."""

    def shared(self, first: int, last: int) -> list[str]:
        return []

    def made(self, name: str) -> NDArray[Any]:
        raise KeyError(name)

    def look_up(self, find: Callable[[str], NDArray[Any]]) -> None:
        """Look nothing up."""


class Stateless(WithoutTables):
    """Base class of contributions whose chunks do not depend on earlier chunks."""

    engines: Sequence[Any] = ()  # those that have something to warn of

    def until(self, last: int) -> None:
        """Prepare nothing anyway."""

    def state(self) -> State:
        return {}

    def restore(self, state: State) -> None:
        """Go on anywhere."""

    def warn(self) -> None:
        """Warn of what engines missed."""
        for engine in self.engines:
            engine.warn()
