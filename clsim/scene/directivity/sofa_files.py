"""SOFA files (AES69): opening within bounds, positions and axes."""

from __future__ import annotations

import math
import warnings
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.errors import InputError
from clsim.files.input_files import LARGEST_BINARY, check_file
from clsim.packages import check_packages

if TYPE_CHECKING:
    from pathlib import Path

    from clsim.arrays import Floats

_MOST_UNPACKED = 2**29  # bytes


def opened_sofa(path: Path) -> Any:
    """Read a SOFA file of any convention."""
    if path.suffix != ".sofa":
        raise InputError("path", f"must end in .sofa, but is {path}")
    try:
        check_file(path, LARGEST_BINARY)
    except OSError as error:
        raise InputError("path", f"cannot be read: {path}: {error.strerror or error}") from error
    check_packages("path", f"reading {path}", "sofa", "sofar")
    import sofar

    _check_size(path)
    try:
        # Conventions that sofar does not know and versions that it no longer has are read all the same.
        with warnings.catch_warnings(action="ignore"):  # of missing data, which are refused where they are needed
            return sofar.read_sofa_as_netcdf(str(path))
    except (OSError, ValueError, KeyError, AttributeError, RuntimeError) as error:
        raise InputError("path", f"must be a SOFA file, but cannot be read as one: {path}: {error}") from error


def _check_size(path: Path) -> None:
    """Refuse a file whose unpacked data exceed a bound."""
    from netCDF4 import Dataset

    try:
        with Dataset(path) as file:
            numbers = sum(math.prod(map(float, variable.shape)) for variable in file.variables.values())
    except (OSError, RuntimeError, ValueError) as error:
        raise InputError("path", f"must be a SOFA file, but cannot be read as one: {path}: {error}") from error
    if 8 * numbers > _MOST_UNPACKED:
        raise InputError(
            "path",
            f"must hold at most {_MOST_UNPACKED / 2**20:g} MiB, but unpacks to {8 * numbers / 2**20:.4g}: {path}",
        )


def axes_of(sofa: Any, what: str, measurement: int) -> Floats:
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


def cartesian(sofa: Any, name: str, measurement: int) -> Floats:
    """Return positions or directions (k, 3) of one measurement, m, from a field (1 or M or R, 3) or (R, 3, M)."""
    given = np.ma.filled(np.asanyarray(getattr(sofa, name), dtype=np.float64), np.nan)
    if given.ndim == 3:
        given = given[:, :, measurement if given.shape[2] > 1 else 0]
    given = np.atleast_2d(given)
    if name not in ("ReceiverPosition", "EmitterPosition"):
        given = given[[measurement if len(given) > 1 else 0]]
    if given.shape[1] != 3 or not np.isfinite(given).all():
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
