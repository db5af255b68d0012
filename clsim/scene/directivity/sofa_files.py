"""SOFA files (AES69): opening within bounds, positions and axes."""

from __future__ import annotations

import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from clsim.arrays import Floats
from clsim.errors import InputError
from clsim.files.input_files import LARGEST_BINARY, check_file
from clsim.packages import check_packages

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
        raise InputError(
            "path", f"must unpack to at most {_MOST_UNPACKED / 2**20:g} MiB, but to {size / 2**20:.4g} MiB: {path}"
        )
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
        raise InputError(
            "path", f"must have three finite numbers in each row of {name}, but has {given.tolist()!s:.80}"
        )
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
