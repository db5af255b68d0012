"""Directivities from SOFA files (AES69)."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.arrays import Floats, as_count
from clsim.errors import InputError
from clsim.files.input_files import LARGEST_BINARY, check_file
from clsim.packages import check_packages

if TYPE_CHECKING:
    from os import PathLike

    from numpy.typing import NDArray

# One source, and a receiver in each direction. AES69-2022 has no FreeFieldDirectivityIR; files that say so are laid out
# like GeneralFIR.
_CONVENTIONS = ("FreeFieldDirectivityTF", "FreeFieldDirectivityIR", "GeneralTF", "GeneralFIR")
_ROUND = 0.02  # by which distances to the receivers may differ
_MOST_UNPACKED = 2**29  # bytes
_PADDING = 4  # lengths of an impulse response over which it is transformed


def read_sofa_table(path: str | PathLike[str], measurement: int) -> tuple[Floats, Floats, NDArray[np.complex128]]:
    """Return directions (n, 3) in the source's frame, frequencies (f,) in Hz and responses (n, f)."""
    sofa = _opened(Path(path))
    try:
        return _read(sofa, measurement)
    except InputError as error:
        raise InputError(error.field, f"{error.problem}: {path}") from error
    except (AttributeError, ValueError, TypeError, IndexError) as error:
        raise InputError(
            "path", f"must be a whole SOFA file, but has no readable field for: {error}: {path}"
        ) from error


def _opened(path: Path) -> Any:
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
        return sofar.read_sofa_as_netcdf(str(path))
    except (OSError, ValueError, KeyError, AttributeError, RuntimeError) as error:
        raise InputError("path", f"must be a SOFA file, but cannot be read as one: {path}: {error}") from error


def _check_size(path: Path) -> None:
    """Refuse a file that unpacks to more than anyone measures."""
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


def _read(sofa: Any, measurement: int) -> tuple[Floats, Floats, NDArray[np.complex128]]:
    convention = getattr(sofa, "GLOBAL_SOFAConventions", "none")
    if convention not in _CONVENTIONS:
        raise InputError("path", f"must be of the convention {', '.join(_CONVENTIONS)}, but is of {convention!r:.80}")
    if sofa.GLOBAL_DataType not in ("TF", "FIR"):
        raise InputError("path", f"must hold TF or FIR data, but holds {sofa.GLOBAL_DataType!r:.80}")
    if sofa.GLOBAL_DataType == "TF":
        frequencies = np.atleast_1d(np.asarray(sofa.N, dtype=np.float64))
        values = _of(sofa.Data_Real, measurement) + 1j * _of(sofa.Data_Imag, measurement)
    else:
        frequencies, values = _transformed(sofa, measurement)
    directions = _directions(sofa, measurement)
    if values.shape != (len(directions), len(frequencies)):
        raise InputError(
            "path",
            f"must hold values for {len(directions)} receivers and {len(frequencies)} frequencies, but holds "
            f"{values.shape[0]} x {values.shape[1]}",
        )
    return directions, frequencies, values


def _of(data: Any, measurement: int) -> Floats:
    """Return one measurement (R, N) of data (M, R, N), whose last axes are dropped by sofar where their length is 1."""
    array: Any = np.ma.filled(np.asanyarray(data, dtype=np.float64), np.nan)
    array = array.reshape(array.shape + (1,) * (3 - array.ndim))
    as_count("measurement", measurement, at_least=0, at_most=array.shape[0] - 1)
    return np.asarray(array[measurement])


def _transformed(sofa: Any, measurement: int) -> tuple[Floats, NDArray[np.complex128]]:
    """Return frequencies and the spectrum of impulse responses, delays included."""
    from scipy.fft import next_fast_len, rfft, rfftfreq

    samples = _of(sofa.Data_IR, measurement)
    rate = float(np.ravel(sofa.Data_SamplingRate)[0])
    size = next_fast_len(_PADDING * samples.shape[1], real=True)
    frequencies = np.asarray(rfftfreq(size, 1.0 / rate), dtype=np.float64)
    delay = np.atleast_2d(np.asarray(sofa.Data_Delay, dtype=np.float64))
    delay = delay[measurement if len(delay) > 1 else 0] / rate
    turn = -2j * np.pi * frequencies * np.broadcast_to(delay, samples.shape[:1])[:, None]
    return frequencies, np.asarray(rfft(samples, size, axis=1) * np.exp(turn), dtype=np.complex128)


def _directions(sofa: Any, measurement: int) -> Floats:
    """Return unit vectors (R, 3) from the source to the receivers, in the source's frame."""
    receivers = _cartesian(sofa, "ReceiverPosition", measurement)
    listener = _cartesian(sofa, "ListenerPosition", measurement)[0]
    source = _cartesian(sofa, "SourcePosition", measurement)[0]
    apart = receivers @ _axes(sofa, "Listener", measurement) + listener - source
    distance = np.linalg.norm(apart, axis=1)
    if not distance.min() > 0.0 or distance.max() > (1.0 + _ROUND) * distance.min():
        raise InputError(
            "path",
            f"must have receivers on a sphere about the source, but their distances are from {distance.min():.4g} to "
            f"{distance.max():.4g} m",
        )
    return np.asarray(apart @ _axes(sofa, "Source", measurement).T / distance[:, None])


def _axes(sofa: Any, what: str, measurement: int) -> Floats:
    """Return the unit vectors front, left and up as the rows of (3, 3)."""
    if not hasattr(sofa, f"{what}View"):
        return np.eye(3)
    view = _cartesian(sofa, f"{what}View", measurement)[0]
    up = _cartesian(sofa, f"{what}Up", measurement)[0] if hasattr(sofa, f"{what}Up") else np.array([0.0, 0.0, 1.0])
    left = np.cross(up, view)
    if not np.linalg.norm(left) > 1e-9 * np.linalg.norm(up) * np.linalg.norm(view):
        raise InputError("path", f"must have {what}View and {what}Up in different directions, but has {view} and {up}")
    axes = np.array([view, left, np.cross(view, left)])
    return np.asarray(axes / np.linalg.norm(axes, axis=1, keepdims=True))


def _cartesian(sofa: Any, name: str, measurement: int) -> Floats:
    """Return positions or directions (k, 3) of one measurement, m, from a field (1 or M or R, 3) or (R, 3, M)."""
    given = np.ma.filled(np.asanyarray(getattr(sofa, name), dtype=np.float64), np.nan)
    if given.ndim == 3:
        given = given[:, :, measurement if given.shape[2] > 1 else 0]
    given = np.atleast_2d(given)
    if name != "ReceiverPosition":
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
