"""Checked, read-only arrays: what a frozen value holds."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import fields, is_dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from clsim.errors import InputError, not_one_of

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]
Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]
Rows = NDArray[np.int64]  # indices

# Bounds that more than one field has, generous beyond all use: no product of what they allow overflows float64.
SLOWEST, FASTEST = 1e-3, 100e6  # Hz, of frequencies
FARTHEST = 1e8  # m, of coordinates: where float64 still resolves 15 nm
LARGEST_ROOM, SMALLEST_ROOM = 1e5, 1e-4  # m, of lengths of a room
LOUDEST = 1e12  # Pa or V, of samples, amplitudes and what full scale means; Pa/V or V/Pa of sensitivities
QUIETEST = 1e-15  # the same, of what must not be 0
_FEW, _SHORT = 4, 60  # values, and letters of a part, that a repr shows


def read_only(array: NDArray[Any]) -> NDArray[Any]:
    """Return a contiguous read-only view, copied only where needed."""
    out = np.ascontiguousarray(array)
    if out is array:
        out = out.view()
    out.flags.writeable = False
    return out


def texts(values: Iterable[str]) -> NDArray[Any]:
    """Return texts (n,) as an array that pandas, xarray, Zarr and HDF5 store with variable lengths."""
    return np.array(list(values), dtype=object)


class ByRow:
    """Base class of dataclasses whose arrays have a row for each of n things."""

    __slots__ = ()

    def part(self, rows: Any) -> Self:
        """Return some of the rows, by indices, a mask or a slice; what is no array and has no rows stays as it is."""
        whole: Any = self
        values: list[Any] = [getattr(whole, field.name) for field in fields(whole)]
        parts = (x[rows] if isinstance(x, np.ndarray) else x.part(rows) if hasattr(x, "part") else x for x in values)
        return type(self)(*parts)


def firsts(count: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return offsets (n + 1,) of consecutive parts from their lengths (n,), with the end as the last one."""
    return np.concatenate([[0], np.cumsum(count)]).astype(np.int64)


def spread(first: NDArray[np.int64], which: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return indices (m,) of the ragged rows `which` (k,), where row w spans ``first[w]`` to ``first[w + 1]``."""
    return ranges(first[which], first[which + 1])


def ranges(first: NDArray[np.int64], after: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return for the numbers of several ranges, up to those after their last ones, which range each is of, and all."""
    count = after - first
    of = np.repeat(np.arange(len(count)), count)
    return of, np.arange(len(of)) + np.repeat(first - np.cumsum(count) + count, count)


def by_value(values: NDArray[Any]) -> Iterator[tuple[Any, Rows]]:
    """Yield each different value (n,), increasing, and the indices at which it stands."""
    for value in np.unique(values).tolist():
        yield value, np.flatnonzero(values == value)


def unique_rows(rows: NDArray[Any]) -> tuple[NDArray[Any], NDArray[np.int64], NDArray[np.int64]]:
    """Return unique rows of a table, much faster than `numpy.unique`; rows (n, k); result (m, k), (m,), (n,)."""
    order = np.lexsort(rows.T[::-1])
    ordered = rows[order]
    new = np.ones(len(rows), dtype=bool)
    new[1:] = np.any(ordered[1:] != ordered[:-1], axis=1)
    which = np.empty(len(rows), dtype=np.int64)
    which[order] = np.cumsum(new) - 1
    return ordered[new], order[new], which


def as_floats(
    field: str, value: Any, shape: tuple[int | None, ...], *, within: float = math.inf, unit: str = ""
) -> Floats:
    """Convert to a read-only float64 array of finite values."""
    if isinstance(value, np.ndarray) and np.iscomplexobj(value):  # whose imaginary parts NumPy would drop
        raise InputError(field, f"must be real, but is {value.dtype}")
    try:
        array = np.array(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(field, f"must be numbers, but is {_given(value)}") from error
    wanted = " x ".join("n" if n is None else str(n) for n in shape) or "a single number"
    if array.ndim != len(shape) or any(n not in (None, m) for n, m in zip(shape, array.shape, strict=True)):
        got = " x ".join(map(str, array.shape)) or "a single number"
        raise InputError(field, f"must have the shape {wanted}, but has {got}")
    if array.size == 0:
        raise InputError(field, "must not be empty")
    bad = np.argwhere(~np.isfinite(array))
    if len(bad):
        index = "".join(f"[{i}]" for i in bad[0])
        raise InputError(f"{field}{index}", f"must be finite, but is {array[tuple(bad[0])]}")
    if max(-array.min(), array.max()) > within:
        place = np.unravel_index(np.argmax(np.abs(array)), array.shape)
        index, unit = "".join(f"[{i}]" for i in place), f" {unit}" if unit else ""
        raise InputError(f"{field}{index}", f"must be within {within:g}{unit}, but is {array[place]:g}{unit}")
    return read_only(array)


def _given(value: Any) -> str:
    """Return the first characters of a value's ``repr``."""
    try:
        return f"{value!r:.80}"
    except (ValueError, RecursionError):  # thousands of digits, or of lists within each other
        return "too long to be shown"


def as_number(
    field: str,
    value: Any,
    *,
    above: float = -math.inf,
    at_least: float = -math.inf,
    below: float = math.inf,
    at_most: float = math.inf,
    unit: str = "",
) -> float:
    """Convert to a finite float inside the stated bounds (``above`` and ``below`` exclude their end)."""
    if isinstance(value, bool | np.bool_) or not isinstance(value, int | float | np.integer | np.floating):
        raise InputError(field, f"must be a number, but is {_given(value)}")
    try:
        number = float(value)
    except OverflowError:  # a whole number beyond all floats
        number = math.inf if value > 0 else -math.inf
    unit = f" {unit}" if unit else ""
    for holds, rule in (
        (math.isfinite(number), "finite"),
        (number > above or above == -math.inf, f"above {above:g}{unit}"),
        (number >= at_least, f"at least {at_least:g}{unit}"),
        (number < below or below == math.inf, f"below {below:g}{unit}"),
        (number <= at_most, f"at most {at_most:g}{unit}"),
    ):
        if not holds:
            raise InputError(field, f"must be {rule}, but is {number:g}{unit}")
    return number


def as_count(field: str, value: Any, *, at_least: int = 0, at_most: int | None = None) -> int:
    """Convert to an int inside the stated bounds; floats and bools are refused."""
    if isinstance(value, bool | np.bool_) or not isinstance(value, int | np.integer):
        raise InputError(field, f"must be a whole number, but is {_given(value)}")
    if value < at_least or (at_most is not None and value > at_most):
        rule = f"at least {at_least}" if at_most is None else f"from {at_least} to {at_most}"
        raise InputError(field, f"must be {rule}, but is {_given(value)}")
    return int(value)


def as_flag(field: str, value: Any) -> bool:
    """Return a bool; numbers and words are refused."""
    if not isinstance(value, bool | np.bool_):
        raise InputError(field, f"must be True or False, but is {value!r:.80}")
    return bool(value)


def as_choice(field: str, value: Any, choices: tuple[str, ...]) -> str:
    """Return the value if it is one of the choices."""
    if not isinstance(value, str) or value not in choices:
        raise InputError(field, not_one_of(value, choices))
    return value


def as_index(field: str, value: Any, names: Sequence[str]) -> int:
    """Return index of a named item, given by index or name."""
    if not isinstance(value, str):
        return as_count(field, value, at_most=len(names) - 1)
    if value not in names:
        raise InputError(field, not_one_of(value, names))
    return names.index(value)


def short_repr(value: Any) -> str:
    """Return one-line ``__repr__`` for dataclasses with array fields.

    result: arrays of more than four numbers by type and shape, several things by their number, other values by their
    names.

    Examples
    --------
    >>> from dataclasses import make_dataclass
    >>> Sound = make_dataclass("Sound", ["rate", "samples"], namespace={"__repr__": short_repr})
    >>> Sound(48e3, np.zeros((2, 100)))
    Sound(rate=48000.0, samples=<float64 (2, 100)>)
    """
    shown = [f"{field.name}={_shown(getattr(value, field.name))}" for field in fields(value) if field.name[0] != "_"]
    return f"{type(value).__name__}({', '.join(shown)})"


def _shown(value: Any) -> str:
    """Return short text of a field's value."""
    if isinstance(value, np.ndarray):
        return str(value.tolist()) if value.size <= _FEW else f"<{value.dtype} {value.shape}>"
    if isinstance(value, tuple | list | dict):
        plain = len(value) <= _FEW and not any(is_dataclass(v) or isinstance(v, np.ndarray) for v in value)
        kinds = " and ".join(dict.fromkeys(type(v).__name__ for v in value))  # of a mapping's names
        return repr(value) if plain and not isinstance(value, dict) else f"<{len(value)} {kinds}>"
    if is_dataclass(value) and not isinstance(value, type):
        name, whole = getattr(value, "name", ""), repr(value)
        head = repr(name) if isinstance(name, str) and name else "…"
        return whole if len(whole) <= _SHORT else f"{type(value).__name__}({head})"
    return f"{value!r:.80}"


def row_name(channel: tuple[str, str]) -> str:
    """Name a row of samples by its receiver and the receiver's channel, which may be ""."""
    return " ".join(filter(None, channel))
