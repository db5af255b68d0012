"""What clsim raises: one class for what the user gave, one for the device; and how it warns."""

from __future__ import annotations

import sys
import traceback
import warnings
from pathlib import Path


class ClsimError(Exception):
    """Base of every error that clsim raises on purpose."""


class InputError(ClsimError, ValueError):
    """A value from the user breaks a rule.

    Parameters
    ----------
    field : str
        Where the value stands, for example ``"sources[1].trajectory.times"``.
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

    def __str__(self) -> str:
        return f"{self.field}: {self.problem}" if self.field else self.problem

    def within(self, parent: str) -> InputError:
        """Return the same error seen from the value that holds the field.

        Parameters
        ----------
        parent : str
            Where that value stands, for example ``"sources[1]"``.

        Returns
        -------
        InputError
            To be raised by the caller; its field is ``parent.field``.

        Examples
        --------
        >>> print(InputError("times", "must increase strictly").within("sources[1]"))
        sources[1].times: must increase strictly
        """
        joint = "" if self.field.startswith("[") or not self.field else "."
        return InputError(f"{parent}{joint}{self.field}", self.problem)


class DeviceError(ClsimError, RuntimeError):
    """The OpenCL device is missing or failed; the message says what to do."""


class ClsimWarning(UserWarning):
    """A result is right but perhaps not what was meant; the message says why."""


def in_one_line(error: BaseException) -> str:
    """Return an error in a line; for one that clsim did not expect, with its place."""
    text = " ".join(str(error).split())[:500]
    if isinstance(error, ClsimError):
        return text
    last = traceback.extract_tb(error.__traceback__)[-1:]
    place = "".join(f" ({Path(frame.filename).name}, line {frame.lineno})" for frame in last)
    return f"{type(error).__name__}: {text}{place}"


def warn(message: str) -> None:
    """Warn, as of the line outside clsim that called it."""
    level, frame = 2, sys._getframe(1)
    while frame.f_back is not None and str(frame.f_globals.get("__name__")).partition(".")[0] == "clsim":
        level, frame = level + 1, frame.f_back
    warnings.warn(message, ClsimWarning, stacklevel=level)
