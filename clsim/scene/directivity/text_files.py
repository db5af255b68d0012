"""Tables of directivities and head-related responses from text, NumPy, MATLAB and SOFA (AES69) files."""

from __future__ import annotations

import io
import math
import os
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from os import PathLike
from pathlib import Path
from types import SimpleNamespace
from typing import Any, TypeVar

import numpy as np

from clsim.arrays import Floats, as_choice
from clsim.errors import InputError, check_packages, not_one_of
from clsim.files.input_files import LARGEST_BINARY, LARGEST_TEXT, check_archive, check_file, open_file, read_file
from clsim.scene.directivity.mat_process import VERSION_73

T = TypeVar("T")
_ANGLE_UNITS = ("degree", "radian")
_DECIMALS = 4  # of degrees that were radians: rounding of single precision is less
_PATIENCE = 60.0  # s, for a MATLAB file to be read
_SEPARATORS = ("\t", ";", ",")  # a comma may be part of a number where one of the others separates


def read_csv_table(field: str, path: str | PathLike[str]) -> tuple[Floats, Floats, Floats]:
    """Return angles (a,), frequencies (f,) and values (a, f) of a text file."""
    # path: first row: any word, then frequencies. Other rows: the angle, then a value for each frequency.
    try:
        text = read_file(path, LARGEST_TEXT).decode("utf-8-sig")
    except OSError as error:
        raise InputError(field, f"cannot be read: {path}: {error.strerror or error}") from error
    except UnicodeDecodeError as error:
        raise InputError(field, f"must be a text file, but is not: {path}") from error
    lines = [(n, line.strip()) for n, line in enumerate(text.splitlines(), start=1)]
    lines = [(n, line) for n, line in lines if line and not line.startswith("#")]
    if len(lines) < 2:
        problem = f"must hold a row of frequencies and rows of values, but holds {len(lines)} rows: {path}"
        raise InputError(field, problem)
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
        known = sorted(content["names"].tolist())
        if variable not in known:
            raise InputError("variable", f"{not_one_of(variable, known)}: {path}")
        if variable not in content["structs"]:
            raise InputError("variable", f"must be a struct, but {variable!r} is an array; leave it out: {path}")
        if content["count"] != 1:
            several = f"{variable!r} is {int(content['count'])} of them"
            raise InputError("variable", f"must be one struct, but {several}: {path}")
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
    """Return content of a MATLAB file, read by `mat_process`."""
    # Another process reads it, because SciPy can end the one in which it meets a broken file. `stamp` makes a file that
    # is another one now be read again.
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


def _picked(
    file: Mapping[str, Any], names: tuple[str, str, str], path: str | PathLike[str], structs: Sequence[str] = ()
) -> tuple[Any, Any, Any]:
    there = sorted(file)
    for what, name in zip(("angle", "frequency", "values"), names, strict=True):
        if name not in there:
            hint = f'; {structs[0]!r} is a struct: give variable="{structs[0]}"' if structs else ""
            raise InputError(what, f"{not_one_of(name, there)}: {path}{hint}")
    angles, frequencies, values = (np.asarray(file[name]) for name in names)
    return angles, frequencies, values


HEAD_CONVENTIONS = ("SimpleFreeFieldHRIR", "FreeFieldHRIR", "SimpleFreeFieldHRTF", "FreeFieldHRTF")
_EVEN = 1e-6  # by which steps between frequencies may differ
_MOST_DELAY = 1.0  # s


def read_sofa(sofa: SofaFields, conventions: tuple[str, ...], read: Callable[[Any, str], T]) -> T:
    """Read the fields of a SOFA file of one of some conventions by a function."""
    try:
        convention = str(getattr(sofa, "GLOBAL_SOFAConventions", "none"))
        if convention not in conventions:
            wanted = ", ".join(conventions)
            raise InputError("path", f"must be of the convention {wanted}, but is of {convention!r:.80}")
        return read(sofa, convention)
    except InputError:
        raise
    except (AttributeError, ValueError, TypeError, IndexError, KeyError) as error:
        raise InputError("path", f"must be a whole SOFA file, but {error}") from error


def read_responses(sofa: Any, convention: str) -> tuple[Floats, Floats, float]:
    """Return directions (n, 3) in the head's frame, responses (n, 2, m) of both ears and their rate, Hz."""
    responses, rate = _impulses(sofa) if "IR" in convention else _transformed(sofa)  # (M, 2, n, E)
    measurements, emitters = responses.shape[0], responses.shape[3]
    # A single emitter is what its source is, whatever type the convention gives by default.
    if emitters > 1 and str(getattr(sofa, "EmitterPosition_Type", "cartesian")) == "spherical harmonics":
        raise InputError("path", "must hold responses by direction, but holds spherical harmonics")
    directions = np.concatenate([_directions(sofa, m, emitters) for m in range(measurements)])
    responses = np.moveaxis(responses, 3, 1).reshape(len(directions), 2, -1)
    # First the ear that is louder for sound from the left: files of early versions have receivers the wrong way round.
    side = directions[:, 1] @ np.sum(responses**2, axis=2)
    return directions, responses if side[0] >= side[1] else responses[:, ::-1], rate


def _impulses(sofa: Any) -> tuple[Floats, float]:
    """Return impulse responses (M, R, n, E), delays included, and their rate, Hz."""
    samples, rate = _filled(sofa.Data_IR, 4), sampling_rate_of(sofa)
    late = _filled(getattr(sofa, "Data_Delay", np.zeros((1, 2))), 3, ears=1)
    if late.shape[0] not in (1, samples.shape[0]) or late.shape[2] not in (1, samples.shape[3]):
        raise InputError("path", f"must have a delay per measurement or per ear, but has {late.shape[0]}")
    late = np.broadcast_to(late, (*samples.shape[:2], samples.shape[3]))
    if not np.any(late):
        return samples, rate
    if not 0.0 <= late.min() <= late.max() <= _MOST_DELAY * rate:
        raise InputError(
            "path",
            f"must have delays of 0 to {_MOST_DELAY:g} s, but has {late.min() / rate:.3g} to {late.max() / rate:.3g} s",
        )
    size = samples.shape[2] + 2 * int(np.ceil(late.max())) + 64
    turn = np.exp(-2j * np.pi * late[:, :, None] * np.fft.rfftfreq(size)[:, None])
    return np.fft.irfft(np.fft.rfft(samples, size, axis=2) * turn, size, axis=2), rate


def _transformed(sofa: Any) -> tuple[Floats, float]:
    """Return impulse responses (M, R, n, E) of transfer functions at multiples of a frequency, and their rate, Hz."""
    frequencies = np.atleast_1d(np.asarray(sofa.N, dtype=np.float64))
    values = _filled(sofa.Data_Real, 4) + 1j * _filled(sofa.Data_Imag, 4)
    if values.shape[2] != len(frequencies):
        values = np.moveaxis(values, -1, 2)  # as AES69 orders it: measurements, receivers, emitters, frequencies
    step = frequencies[-1] / (len(frequencies) - 1 + int(frequencies[0] > 0.0))
    if len(frequencies) < 8 or np.abs(np.diff(frequencies, prepend=frequencies[0] - step) - step).max() > _EVEN * step:
        raise InputError("path", "must hold at least 8 evenly spaced frequencies from 0 Hz or the first step on")
    if frequencies[0] > 0.0:  # what head-related responses are at 0 Hz is real
        values = np.concatenate([np.abs(values[:, :, :1]), values], axis=2)
    return np.fft.irfft(values, axis=2), float(2.0 * frequencies[-1])


def _filled(data: Floats, axes: int, ears: int = 2) -> Floats:
    """Give finite data (M, R, ...) so many axes, of which files may leave out the last."""
    array: Any = data.reshape(data.shape + (1,) * (axes - data.ndim))
    if array.ndim != axes or 0 in array.shape or array.shape[1] not in (2, ears):
        raise InputError("path", f"must have responses of two ears in {axes} axes, but has the shape {data.shape}")
    if not np.isfinite(array).all():
        raise InputError("path", "must hold finite real numbers, but does not")
    return np.asarray(array)


def _directions(sofa: Any, measurement: int, emitters: int) -> Floats:
    """Return unit vectors (E, 3) from the listener to the emitters, in the listener's frame."""
    source, listener = (cartesian(sofa, f"{end}Position", measurement)[0] for end in ("Source", "Listener"))
    apart = source - listener
    if emitters > 1:
        apart = apart + cartesian(sofa, "EmitterPosition", measurement)[:emitters] @ axes_of(
            sofa, "Source", measurement
        )
    apart = np.atleast_2d(apart) @ axes_of(sofa, "Listener", measurement).T
    distance = np.linalg.norm(apart, axis=1)
    if len(apart) != emitters or not distance.min() > 0.0:
        raise InputError("path", "must have every source away from the listener, but has not")
    return np.asarray(apart / distance[:, None])


_MOST_UNPACKED = 2**29  # bytes


class SofaFields(SimpleNamespace):
    """Numbers and attributes of a SOFA file by name, with underscores for dots: `Data_IR`, `GLOBAL_DataType`."""

    def __getattr__(self, name: str) -> Any:
        """Refuse a field that the file lacks."""
        raise AttributeError(f"{name.replace('_', '.')} is missing")


def opened_sofa(path: Path) -> SofaFields:
    """Read a SOFA file of any convention and version, for sofar reads those that it knows only."""
    if path.suffix != ".sofa":
        raise InputError("path", f"must end in .sofa, but is {path}")
    try:
        check_file(path, LARGEST_BINARY)
    except OSError as error:
        raise InputError("path", f"cannot be read: {path}: {error.strerror or error}") from error
    check_packages("path", f"reading {path}", "sofa", "netCDF4")
    from netCDF4 import Dataset

    try:
        with Dataset(path) as file:
            return _read_fields(path, file)
    except InputError:
        raise
    except (OSError, RuntimeError, ValueError, KeyError, AttributeError) as error:
        raise InputError("path", f"must be a SOFA file, but cannot be read as one: {path}: {error}") from error


def _read_fields(path: Path, file: Any) -> SofaFields:
    """Read attributes and variables within a bound; NaN for what is no real number, where netCDF can crash."""
    size = 8 * sum(math.prod(map(float, variable.shape)) for variable in file.variables.values())
    if size > _MOST_UNPACKED:
        problem = f"must unpack to at most {_MOST_UNPACKED / 2**20:g} MiB, but to {size / 2**20:.4g} MiB: {path}"
        raise InputError("path", problem)
    fields = SofaFields(**{f"GLOBAL_{name}": file.getncattr(name) for name in file.ncattrs()})
    for name, variable in file.variables.items():
        field = name.replace(".", "_")
        real = isinstance(variable.dtype, np.dtype) and variable.dtype.kind in "fiu"
        values = variable[...] if real else np.full(variable.shape, np.nan)
        setattr(fields, field, np.ma.filled(np.ma.asarray(values, dtype=np.float64), np.nan))
        for attribute in variable.ncattrs():
            setattr(fields, f"{field}_{attribute}", variable.getncattr(attribute))
    return fields


def sampling_rate_of(sofa: SofaFields) -> float:
    """Return the sampling rate of all measurements of impulse responses, Hz."""
    rates = np.unique(np.ravel(sofa.Data_SamplingRate))
    if len(rates) != 1 or not rates[0] > 0.0:
        raise InputError("path", f"must have one sampling rate above 0 Hz, but has {rates.tolist()!s:.80}")
    unit = getattr(sofa, "Data_SamplingRate_Units", "hertz")
    if str(unit).lower() not in ("hertz", "hz"):
        raise InputError("path", f"must have its sampling rate in hertz, but it is in {unit!r:.80}")
    return float(rates[0])


def axes_of(sofa: SofaFields, what: str, measurement: int) -> Floats:
    """Return the unit vectors front, left and up as the rows of (3, 3)."""
    if not hasattr(sofa, f"{what}View"):
        return np.eye(3)
    view = cartesian(sofa, f"{what}View", measurement)[0]
    up = cartesian(sofa, f"{what}Up", measurement)[0] if hasattr(sofa, f"{what}Up") else np.array([0.0, 0.0, 1.0])
    left = np.cross(up, view)
    if not np.linalg.norm(left) > 1e-9 * np.linalg.norm(up) * np.linalg.norm(view):
        raise InputError("path", f"must have {what}View and {what}Up in different directions, but has {view} and {up}")
    axes = np.array([view, left, np.cross(view, left)])
    return np.asarray(axes / np.linalg.norm(axes, axis=1, keepdims=True))


def cartesian(sofa: SofaFields, name: str, measurement: int) -> Floats:
    """Return positions or directions (k, 3) of one measurement, m, from a field (1 or M or R, 3) or (R, 3, M)."""
    given = getattr(sofa, name)
    if given.ndim == 3:
        given = given[:, :, measurement if given.shape[2] > 1 else 0]
    given = np.atleast_2d(given)
    if 0 not in given.shape and name not in ("ReceiverPosition", "EmitterPosition"):
        given = given[[measurement if len(given) > 1 else 0]]
    if given.shape[1:] != (3,) or 0 in given.shape or not np.isfinite(given).all():
        problem = f"must have three finite numbers in each row of {name}, but has {given.tolist()!s:.80}"
        raise InputError("path", problem)
    # An Up vector is of its View's type.
    kind = getattr(sofa, f"{name}_Type", getattr(sofa, f"{name.removesuffix('Up')}View_Type", "cartesian"))
    if kind == "cartesian":
        return np.asarray(given)
    if kind != "spherical":
        raise InputError("path", f"must have cartesian or spherical {name}, but it is {kind!r:.80}")
    if str(getattr(sofa, f"{name}_Units", "degree")).lower().startswith("rad"):
        raise InputError("path", f"must have {name} in degrees, as AES69 asks, but it is in radians")
    azimuth, elevation = np.radians(given[:, 0]), np.radians(given[:, 1])
    around = np.cos(elevation)
    unit = np.column_stack([around * np.cos(azimuth), around * np.sin(azimuth), np.sin(elevation)])
    return np.asarray(unit * given[:, 2:])
