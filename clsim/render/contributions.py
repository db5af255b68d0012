"""What adds to the sound pressure at the receivers: the interface that all kinds of it have."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

State = dict[str, "NDArray[Any]"]


class Contribution(Protocol):
    """Part of the pressure at all receivers, settled before any of it is computed.

    Attributes
    ----------
    name : str
        Of its kind, one word or two.
    """

    @property
    def name(self) -> str:
        """Name of its kind, as in messages and in what is kept of a run."""
        ...

    def describe(self) -> list[str]:
        """Return what will be computed, a line each."""
        ...

    def digest(self) -> str:
        """Return a text that changes with all that its samples depend on beside paths and options."""
        ...

    def begin(self) -> Adding:
        """Return what adds it, from the first sample on or from where another one was."""
        ...


class Adding(Protocol):
    """A contribution while it is rendered, piece by piece and in order."""

    def add(self, pressure: NDArray[Any], start: int) -> None:
        """Add samples from `start` on to the pressure (receivers, n), Pa; in baseband to its complex envelope."""
        ...

    def until(self, last: int) -> None:
        """Take note that for now nothing will be asked for from sample `last` on: it need not be prepared."""
        ...

    def shared(self, first: int, last: int) -> list[str]:
        """Return names of what samples `first` to `last` and others are made of alike: many processes make it once."""
        ...

    def made(self, name: str) -> NDArray[Any]:
        """Return what is shared by a name, of any shape; the same whoever makes it, and when."""
        ...

    def look_up(self, find: Callable[[str], NDArray[Any]]) -> None:
        """Take note that `find` returns what is shared by a name, so that it need not be made."""
        ...

    def state(self) -> State:
        """Return all that it remembers of the pieces so far and needs to go on bit for bit."""
        ...

    def restore(self, state: State) -> None:
        """Go on where another one of the same plan was; `state` is what that remembered."""
        ...

    def warn(self) -> None:
        """Warn, behind the last piece, of what came out worse than asked."""
        ...


class Unshared:
    """What most contributions have in common: no piece is made of what others are made of."""

    def shared(self, first: int, last: int) -> list[str]:
        """Return no names."""
        return []

    def made(self, name: str) -> NDArray[Any]:
        """Make nothing: there are no names."""
        raise KeyError(name)

    def look_up(self, find: Callable[[str], NDArray[Any]]) -> None:
        """Look nothing up."""


class Stateless(Unshared):
    """What most of them have in common, too: a piece does not depend on those before."""

    def until(self, last: int) -> None:
        """Prepare nothing anyway."""

    def state(self) -> State:
        """Return nothing."""
        return {}

    def restore(self, state: State) -> None:
        """Go on anywhere."""

    def warn(self) -> None:
        """Tell nothing."""
