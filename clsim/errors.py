"""What clsim raises: one class for what the user gave, one for the device; and how it warns."""

from __future__ import annotations

import sys
import traceback
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from types import UnionType
from typing import Any, TypeVar

T = TypeVar("T")
_FEW = 8  # names that are listed though one of them is close to what was given
_NEAR = 0.65  # share of letters that names have in common where one is meant: of three, two in order


class ClsimError(Exception):
    """Base of every error that clsim raises on purpose."""


class InputError(ClsimError, ValueError):
    """A value from the user breaks a rule.

    Parameters
    ----------
    field : str
        Path of the value, for example ``"sources[1].trajectory.times"``.
    problem : str
        The rule and the value that breaks it.

    Examples
    --------
    >>> raise InputError("times", "must increase strictly, but [2] = 0.5 s follows [1] = 0.75 s")
    Traceback (most recent call last):
        ...
    clsim.errors.InputError: times: must increase strictly, but [2] = 0.5 s follows [1] = 0.75 s
    """

    def __init__(self, field: str, problem: str) -> None:
        super().__init__(field, problem)
        self.field = field
        self.problem = problem
        self.file = ""  # whose field it is

    def __str__(self) -> str:
        return ": ".join(part for part in (self.file, self.field, self.problem) if part)

    def within(self, parent: str) -> InputError:
        """Return the same error seen from the value that holds the field.

        Parameters
        ----------
        parent : str
            Path of that value, for example ``"sources[1]"``.

        Examples
        --------
        >>> print(InputError("times", "must increase strictly").within("sources[1]"))
        sources[1].times: must increase strictly
        """
        joint = "" if self.field.startswith("[") or not self.field else "."
        return InputError(f"{parent}{joint}{self.field}", self.problem)


@contextmanager
def inside(parent: str) -> Iterator[None]:
    """Raise an InputError of the block as seen from the value that holds the field, whose path is `parent`."""
    try:
        yield
    except InputError as error:
        raise error.within(parent) from error


@contextmanager
def of_file(path: object) -> Iterator[None]:
    """Name a file in an InputError of the block whose field is in it, unless another one is named."""
    try:
        yield
    except InputError as error:
        error.file = error.file or ("" if error.field == str(path) else str(path))
        raise


@contextmanager
def with_field(field: str) -> Iterator[None]:
    """Raise an InputError of the block with another field."""
    try:
        yield
    except InputError as error:
        raise InputError(field, error.problem) from error


def check_kind(field: str, value: Any, kind: type[Any] | UnionType, called: str) -> None:
    """Refuse a value of another type than a kind; messages call it by its name with an article."""
    if not isinstance(value, kind):
        raise InputError(field, f"must be {called}, but is {value!r:.80}")


def check_name(value: Any) -> None:
    """Refuse a field ``name`` that is no text or empty."""
    if not isinstance(value, str) or not value.strip():
        raise InputError("name", f"must be a text that is not empty, but is {value!r:.80}")


def settle(thing: Any, **values: Any) -> None:
    """Set fields of a frozen dataclass that is being made."""
    for name, value in values.items():
        object.__setattr__(thing, name, value)


def check_rising(field: str, values: Any, rises: Any, unit: str, form: str = "g") -> None:
    """Refuse values (n,) unless each rises (n - 1,) enough from the one before."""
    if not rises.all():
        i = int(rises.argmin())
        after, before = (f"[{k}] = {values[k]:{form}}{unit}" for k in (i + 1, i))
        raise InputError(field, f"must increase strictly, but {after} follows {before}")


def not_one_of(value: Any, names: Iterable[str]) -> str:
    """Return problem text for a value that is none of the allowed names, with the nearest name as a suggestion.

    result: the rule, the value, and the name that was perhaps meant; of many names then that one alone.

    Examples
    --------
    >>> print(not_one_of("hane", ["none", "tukey", "hann"]))
    must be one of "none", "tukey", "hann", but is 'hane'; did you mean "hann"?
    """
    listed = list(names)
    close = meant(value, listed)
    rule = (
        f"one of {len(listed)} names"
        if close and len(listed) > _FEW
        else "one of " + ", ".join(f'"{n}"' for n in listed)
    )
    return f"must be {rule}, but is {value!r:.80}{close}"


def meant(value: Any, names: Iterable[str]) -> str:
    """Return the suffix "did you mean ..." with the nearest name; empty where none is near."""
    from difflib import get_close_matches  # late: only what goes wrong needs it

    by_form = {name.casefold().replace("_", "-"): name for name in names}
    close = get_close_matches(str(value)[:80].casefold().replace("_", "-"), by_form, n=1, cutoff=_NEAR)
    return f'; did you mean "{by_form[close[0]]}"?' if close else ""


class DeviceError(ClsimError, RuntimeError):
    """The OpenCL device is missing or failed; the message states the remedy."""


class ClsimWarning(UserWarning):
    """A result is right but perhaps not intended; the message says why."""


def in_one_line(error: BaseException) -> str:
    """Return an error in a line; for one that clsim did not expect, with its place."""
    text = " ".join(str(error).split())[:500]
    if isinstance(error, ClsimError):
        return text
    last = traceback.extract_tb(error.__traceback__)[-1:]
    place = "".join(f" ({Path(frame.filename).name}, line {frame.lineno})" for frame in last)
    return f"{type(error).__name__}: {text}{place}"


def counted(count: int, noun: str) -> str:
    """Return a count with its noun: ``1 source``, ``2 sources``."""
    return f"{count} {noun}{'' if count == 1 else 's'}"


def renamed(old: str, new: str, since: str) -> None:
    """Warn that a public name is another since a version, and works for one more minor version."""
    warn(f"clsim.{old} is called clsim.{new} since version {since}", DeprecationWarning)


def old_names(since: str, **names: str) -> Callable[[type[T]], type[T]]:
    """Return a class decorator that keeps former names of attributes: those warn and give the new ones."""

    def decorated(kind: type[T]) -> type[T]:
        def missing(self: T, name: str) -> Any:
            if name not in names:
                raise AttributeError(f"{kind.__name__!r} object has no attribute {name!r}")
            renamed(f"{kind.__name__}.{name}", f"{kind.__name__}.{names[name]}", since)
            return getattr(self, names[name])

        setattr(kind, "__getattr__", missing)  # noqa: B010 - mypy knows no such attribute
        return kind

    return decorated


def warn(message: str, category: type[Warning] = ClsimWarning) -> None:
    """Issue a warning, attributed to the calling line outside clsim."""
    level, frame = 2, sys._getframe(1)
    while frame.f_back is not None and str(frame.f_globals.get("__name__")).partition(".")[0] == "clsim":
        level, frame = level + 1, frame.f_back
    warnings.warn(message, category, stacklevel=level)


def check_packages(field: str, what: str, extra: str, *packages: str) -> None:
    """Raise an InputError if a package that a feature needs is not installed.

    Examples
    --------
    >>> check_packages("path", "a table", "tables", "pandas_of_nobody")
    Traceback (most recent call last):
        ...
    clsim.errors.InputError: path: a table needs pandas_of_nobody: pip install 'clsim[tables]'
    """
    missing = [name for name in packages if find_spec(name) is None]
    if missing:
        raise InputError(field, f"{what} needs {' and '.join(missing)}: pip install 'clsim[{extra}]'")


def check_pictures(field: str) -> None:
    """Raise an InputError for `field` if the plotting packages are not installed."""
    check_packages(field, "a picture", "pictures", "matplotlib")
