"""Checks of what describes a motion: places, lengths of time, increasing times."""

from __future__ import annotations

from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from clsim.arrays import FARTHEST, Floats, as_choice, as_floats, as_number
from clsim.errors import InputError, warn

SHORTEST, LONGEST = 1e-9, 1e9  # s, bounds of lengths of time
_NO_LENGTH = 1e-100  # of a direction
_TWO_TURNS = 4.0 * np.pi + 1e-9  # rad


def as_span(field_name: str, value: Any) -> float:
    """Return a length of time, s."""
    as_number(field_name, value, above=0.0, unit="s")
    return as_number(field_name, value, at_least=SHORTEST, at_most=LONGEST, unit="s")


def as_places(field_name: str, value: Any, shape: tuple[int | None, ...]) -> Floats:
    """Return positions, m."""
    return as_floats(field_name, value, shape, within=FARTHEST, unit="m")


def as_direction(field_name: str, value: Any) -> Floats:
    """Return a direction (3,) of any length."""
    direction = as_floats(field_name, value, (3,), within=1.0 / _NO_LENGTH)
    if not np.linalg.norm(direction) > _NO_LENGTH:
        raise InputError(field_name, f"must be a direction, but is {', '.join(f'{x:g}' for x in direction)}")
    return direction


def question_turns(field_name: str, largest: float) -> None:
    """Warn of angles above two turns, rad, which are more often degrees than a spinning object."""
    if largest > _TWO_TURNS:
        warn(
            f"{field_name}: {largest:.6g} rad are {largest / (2.0 * np.pi):.3g} turns; angles are in radians: "
            f"{largest:.6g} degrees are {np.radians(largest):.6g} rad"
        )


def as_increasing(times: Any) -> Floats:
    """Return the field ``times`` (n,) s."""
    t = as_floats("times", times, (None,))
    if len(t) < 2:
        raise InputError("times", f"must hold at least two, but holds {len(t)}")
    if np.abs(t).max() > 2.0 * LONGEST:  # seconds since 1970 pass
        i = int(np.argmax(np.abs(t)))
        raise InputError(f"times[{i}]", f"must be within {2.0 * LONGEST:g} s, but is {t[i]:g} s")
    close = np.flatnonzero(np.diff(t) < SHORTEST)
    if len(close):
        i = int(close[0])
        raise InputError(
            "times",
            f"must increase strictly, but [{i + 1}] = {t[i + 1]:.12g} s follows [{i}] = {t[i]:.12g} s",
        )
    return t


def as_choices(field_name: str, values: Any, choices: tuple[str, ...]) -> tuple[str, ...]:
    """Return a tuple of names."""
    if not isinstance(values, list | tuple):
        raise InputError(field_name, f"must be a list of names, but is {values!r:.80}")
    return tuple(as_choice(f"{field_name}[{i}]", value, choices) for i, value in enumerate(values))


def as_path(value: Any) -> Path:
    """Return the field ``path``."""
    if not isinstance(value, str | PathLike) or not str(value).strip():
        raise InputError("path", f"must be the path of a file, but is {value!r:.80}")
    return Path(value)


def as_columns(value: Any, known: tuple[str, ...]) -> dict[str, str] | None:
    """Names of a file's columns by what stands in them, some of `known`."""
    if value is None:
        return None
    if not isinstance(value, Mapping) or not all(isinstance(name, str) for name in value.values()):
        raise InputError("columns", f"must be a mapping to names of columns, but is {value!r:.80}")
    for name in value:
        as_choice("columns", name, known)
    return dict(value)


def as_topic(value: Any) -> str:
    """Return the field ``topic``."""
    if not isinstance(value, str) or not value.strip():
        raise InputError("topic", f"must name the topic of a bag, such as '/robot/pose', but is {value!r:.80}")
    return value
