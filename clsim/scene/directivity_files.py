"""Angles, frequencies and values from text, NumPy and MATLAB files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.arrays import as_choice
from clsim.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Mapping
    from os import PathLike

    from clsim.arrays import Floats

_ANGLE_UNITS = ("degree", "radian")
_DECIMALS = 4  # of degrees that were radians: rounding of single precision is less
_SEPARATORS = ("\t", ";", ",")  # a comma may be part of a number where one of the others separates


def read_csv_table(field: str, path: str | PathLike[str]) -> tuple[Floats, Floats, Floats]:
    """Return angles (a,), frequencies (f,) and values (a, f) of a text file.

    Parameters
    ----------
    field : str
        Name used in errors.
    path : path-like
        First row: any word, then frequencies. Other rows: the angle, then a value for each frequency.

    Raises
    ------
    InputError
        If the file cannot be read, or a row is no such row; the message names the line.
    """
    try:
        text = Path(path).read_text("utf-8-sig")
    except OSError as error:
        raise InputError(field, f"cannot be read: {path}: {error.strerror or error}") from error
    except UnicodeDecodeError as error:
        raise InputError(field, f"must be a text file, but is not: {path}") from error
    lines = [(n, line.strip()) for n, line in enumerate(text.splitlines(), start=1)]
    lines = [(n, line) for n, line in lines if line and not line.startswith("#")]
    if len(lines) < 2:
        raise InputError(
            field, f"must hold a row of frequencies and rows of values, but holds {len(lines)} rows: {path}"
        )
    separator = next((s for s in _SEPARATORS if s in lines[0][1]), ",")
    rows: list[list[float]] = []
    for n, line in lines:
        cells = [cell.strip() for cell in line.split(separator)]
        if rows and len(cells) != len(rows[0]) + 1:
            raise InputError(
                field,
                f"must have a value for each of {len(rows[0])} frequencies, but line {n} has {len(cells) - 1}: {path}",
            )
        try:
            numbers = [float(c if separator == "," else c.replace(",", ".")) for c in (cells if rows else cells[1:])]
        except ValueError as error:
            raise InputError(field, f"must hold numbers, but line {n} is {line!r:.80}: {path}") from error
        if not numbers:
            raise InputError(field, f"must begin with a row of frequencies, but line {n} is {line!r:.80}: {path}")
        rows.append(numbers)
    table = np.array(rows[1:])
    return table[:, 0], np.array(rows[0]), table[:, 1:]


def read_npz_arrays(path: str | PathLike[str], names: tuple[str, str, str]) -> tuple[Any, Any, Any]:
    """Return three arrays of a NumPy file.

    Raises
    ------
    InputError
        If the file cannot be read or lacks one.
    """
    try:
        with Path(path).open("rb") as stream:  # np.load leaves a broken file open
            file = np.load(stream, allow_pickle=False)
            if not isinstance(file, np.lib.npyio.NpzFile):
                raise InputError("path", f"must be a .npz file of several arrays, but is one array: {path}")
            return _picked(file, names, path)
    except OSError as error:
        raise InputError("path", f"cannot be read: {path}: {error.strerror or error}") from error
    except InputError:
        raise
    except Exception as error:  # whatever a parser meets in a broken file
        raise InputError("path", f"must be a .npz file of numbers, but is not: {path}") from error


def read_mat_arrays(
    path: str | PathLike[str], names: tuple[str, str, str], variable: str | None
) -> tuple[Any, Any, Any]:
    """Return three variables of a MATLAB file, or three fields of a struct.

    Raises
    ------
    InputError
        If the file cannot be read or lacks one.
    """
    from scipy.io import loadmat

    if not Path(path).is_file():
        raise InputError("path", f"cannot be read: {path}: no such file")
    try:
        found = loadmat(path, appendmat=False)
        return _picked(found if variable is None else _fields(found, variable, path), names, path)
    except NotImplementedError as error:
        raise InputError("path", f"must be a MATLAB file up to version 7.2; save it with -v7: {path}") from error
    except OSError as error:
        raise InputError("path", f"cannot be read: {path}: {error.strerror or error}") from error
    except InputError:
        raise
    except Exception as error:  # whatever a parser meets in a broken file
        raise InputError("path", f"must be a MATLAB file, but is not: {path}") from error


def as_table(arrays: tuple[Any, Any, Any], angle_unit: str) -> tuple[Any, Any, Any]:
    """Return angles (a,) in degrees, frequencies (f,) and values (a, f) of vectors of any shape and values of either.

    Raises
    ------
    InputError
        If the unit is none.
    """
    as_choice("angle_unit", angle_unit, _ANGLE_UNITS)
    angles, frequencies, values = np.ravel(arrays[0]), np.ravel(arrays[1]), arrays[2]
    if angle_unit == "radian" and np.issubdtype(angles.dtype, np.number):
        angles = np.round(np.degrees(angles.astype(np.float64)), _DECIMALS)
    if values.shape == (len(frequencies), len(angles)) != (len(angles), len(frequencies)):
        values = values.T
    return angles, frequencies, values


def _fields(file: Mapping[str, Any], variable: str, path: str | PathLike[str]) -> dict[str, Any]:
    """Return the fields of a struct."""
    there = _names(file)
    if variable not in there:
        raise InputError("variable", _must_be_one_of(there, variable, path))
    struct = np.asarray(file[variable])
    if struct.dtype.names is None:
        raise InputError("variable", f"must be a struct, but {variable!r} is an array; leave it out: {path}")
    if struct.size != 1:
        raise InputError("variable", f"must be one struct, but {variable!r} is {struct.size} of them: {path}")
    return {name: struct.ravel()[0][name] for name in struct.dtype.names}


def _names(file: Mapping[str, Any]) -> list[str]:
    return sorted(name for name in file if not name.startswith("__"))


def _must_be_one_of(there: list[str], name: str, path: str | PathLike[str]) -> str:
    return f"must be one of {', '.join(map(repr, there))[:200]}, but is {name!r:.80}: {path}"


def _picked(file: Mapping[str, Any], names: tuple[str, str, str], path: str | PathLike[str]) -> tuple[Any, Any, Any]:
    there = _names(file)
    for what, name in zip(("angle", "frequency", "values"), names, strict=True):
        if name not in there:
            structs = [n for n in there if getattr(file[n], "dtype", np.dtype(float)).names]
            hint = f'; {structs[0]!r} is a struct: give variable="{structs[0]}"' if structs else ""
            raise InputError(what, _must_be_one_of(there, name, path) + hint)
    angles, frequencies, values = (np.asarray(file[name]) for name in names)
    return angles, frequencies, values
