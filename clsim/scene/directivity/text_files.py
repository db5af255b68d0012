"""Angles, frequencies and values from text, NumPy and MATLAB files."""

from __future__ import annotations

import io
import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from functools import lru_cache
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from clsim.arrays import Floats, as_choice
from clsim.errors import InputError, not_one_of
from clsim.files.input_files import LARGEST_BINARY, LARGEST_TEXT, check_archive, check_file, open_file, read_file
from clsim.scene.directivity.mat_process import VERSION_73

_ANGLE_UNITS = ("degree", "radian")
_DECIMALS = 4  # of degrees that were radians: rounding of single precision is less
_PATIENCE = 60.0  # s, for a MATLAB file to be read
_SEPARATORS = ("\t", ";", ",")  # a comma may be part of a number where one of the others separates


def read_csv_table(field: str, path: str | PathLike[str]) -> tuple[Floats, Floats, Floats]:
    """Return angles (a,), frequencies (f,) and values (a, f) of a text file.

    path: first row: any word, then frequencies. Other rows: the angle, then a value for each frequency.
    """
    try:
        text = read_file(path, LARGEST_TEXT).decode("utf-8-sig")
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
    """Return three arrays of a NumPy file."""
    try:
        with open_file(path, LARGEST_BINARY) as stream:  # np.load leaves a broken file open
            check_archive(stream)
            file = np.load(stream, allow_pickle=False)
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
    """Return three variables of a MATLAB file, or three fields of a struct."""
    try:
        check_file(path, LARGEST_BINARY)
        found = Path(path).stat()
    except OSError as error:
        raise InputError("path", f"cannot be read: {path}: {error.strerror or error}") from error
    stamp = (found.st_mtime_ns, found.st_size, found.st_ino)
    try:
        content = _mat_variables(Path(path).absolute(), stamp, names, variable or "")
    except NotImplementedError as error:
        raise InputError("path", f"must be a MATLAB file up to version 7.2; save it with -v7: {path}") from error
    except (OSError, ValueError) as error:
        raise InputError("path", f"must be a MATLAB file, but is not: {path} ({error})") from error
    if variable is not None:
        _check_struct(content, variable, path)
    there = content["names"] if variable is None else content["fields"]
    arrays = {name: content.get(f"array {name}") for name in there.tolist()}
    return _picked(arrays, names, path, [] if variable is not None else content["structs"].tolist())


def as_table(arrays: tuple[Any, Any, Any], angle_unit: str) -> tuple[Any, Any, Any]:
    """Return angles (a,) in degrees, frequencies (f,) and values (a, f) of arrays of any shape."""
    as_choice("angle_unit", angle_unit, _ANGLE_UNITS)
    angles, frequencies, values = np.ravel(arrays[0]), np.ravel(arrays[1]), arrays[2]
    if angle_unit == "radian" and np.issubdtype(angles.dtype, np.number):
        angles = np.round(np.degrees(angles.astype(np.float64)), _DECIMALS)
    if values.shape == (len(frequencies), len(angles)) != (len(angles), len(frequencies)):
        values = values.T
    return angles, frequencies, values


@lru_cache(maxsize=4)
def _mat_variables(path: Path, stamp: tuple[int, ...], names: tuple[str, ...], variable: str) -> dict[str, Any]:
    """Return content of a MATLAB file, read by `mat_process`.

    Another process reads it, because SciPy can end the one in which it meets a broken file. `stamp` makes a file that
    is another one now be read again.
    """
    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join(p for p in sys.path if p), "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1",
    }  # fmt: skip
    # -P: the modules beside the script are none of its own.
    script = str(Path(__file__).with_name("mat_process.py"))
    command = [sys.executable, "-P", script, str(LARGEST_BINARY), variable, *names]
    try:
        with open_file(path, LARGEST_BINARY) as file:
            done = subprocess.run(command, stdin=file, capture_output=True, env=environment, timeout=_PATIENCE)
    except subprocess.TimeoutExpired as error:
        raise ValueError(f"reading it takes more than {_PATIENCE:g} s") from error
    if done.returncode == VERSION_73:
        raise NotImplementedError
    if done.returncode:
        said = done.stderr.decode("utf-8", "replace").strip().splitlines()
        raise ValueError(said[-1][:200] if said and done.returncode > 0 else "reading it ends the process")
    return dict(np.load(io.BytesIO(done.stdout), allow_pickle=False))


def _check_struct(content: Mapping[str, Any], variable: str, path: str | PathLike[str]) -> None:
    """Refuse a variable that a MATLAB file does not hold, or that is not one struct."""
    there = sorted(content["names"].tolist())
    if variable not in there:
        raise InputError("variable", _must_be_one_of(there, variable, path))
    if variable not in content["structs"]:
        raise InputError("variable", f"must be a struct, but {variable!r} is an array; leave it out: {path}")
    if content["count"] != 1:
        raise InputError("variable", f"must be one struct, but {variable!r} is {int(content['count'])} of them: {path}")


def _must_be_one_of(there: list[str], name: str, path: str | PathLike[str]) -> str:
    return f"{not_one_of(name, there)}: {path}"


def _picked(
    file: Mapping[str, Any], names: tuple[str, str, str], path: str | PathLike[str], structs: Sequence[str] = ()
) -> tuple[Any, Any, Any]:
    there = sorted(file)
    for what, name in zip(("angle", "frequency", "values"), names, strict=True):
        if name not in there:
            hint = f'; {structs[0]!r} is a struct: give variable="{structs[0]}"' if structs else ""
            raise InputError(what, _must_be_one_of(there, name, path) + hint)
    angles, frequencies, values = (np.asarray(file[name]) for name in names)
    return angles, frequencies, values
