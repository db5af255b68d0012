"""What tables of gains by direction and frequency share."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.arrays import Floats, as_choice, as_floats
from clsim.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

_SAME_FREQUENCY = 1e-9  # of an end of a band
_SILENT = 1e-12  # of the loudest direction
_LARGEST, _LARGEST_DB = 1e15, 300.0


def check_options(outside: Any, relative_to_axis: Any, name: Any) -> None:
    """Raise an InputError if one of the options that all tables have is no such option."""
    if outside is not None:
        as_choice("outside", outside, ("hold",))
    if not isinstance(relative_to_axis, bool | np.bool_):
        raise InputError("relative_to_axis", f"must be true or false, but is {relative_to_axis!r:.80}")
    if not isinstance(name, str):
        raise InputError("name", f"must be a text, but is {name!r:.80}")


def as_frequencies(frequencies: ArrayLike) -> Floats:
    """Return a table's frequencies (f,), from 0 Hz and strictly increasing."""
    f = as_floats("frequencies", frequencies, (None,))
    if f[0] < 0.0:
        raise InputError("frequencies[0]", f"must be at least 0 Hz, but is {f[0]:g} Hz")
    for i in np.flatnonzero(np.diff(f) <= 0.0)[:1]:
        raise InputError(
            "frequencies", f"must increase strictly, but [{i + 1}] = {f[i + 1]:g} Hz follows [{i}] = {f[i]:g} Hz"
        )
    return f


def as_gains(values: Any, shape: tuple[int, int], layout: str) -> NDArray[Any]:
    """Return gains of a shape as float64 or complex128, finite."""
    given = np.asarray(values)
    parts = [
        as_floats("values", p, (None, None)) for p in ((given.real, given.imag) if np.iscomplexobj(given) else (given,))
    ]
    if parts[0].shape != shape:
        rows, columns = parts[0].shape
        hint = "; transpose them" if parts[0].shape == shape[::-1] else ""
        raise InputError("values", f"must be {layout}, {shape[0]} x {shape[1]}, but are {rows} x {columns}{hint}")
    return parts[0] if len(parts) == 1 else parts[0] + 1j * parts[1]


def check_level(values: NDArray[Any], unit: str) -> None:
    """Raise an InputError if gains (n, f), in dB or as a factor, are silent altogether or absurdly large."""
    magnitude = np.abs(values)
    most = _LARGEST_DB if unit else _LARGEST
    for i, j in np.argwhere(magnitude > most)[:1]:
        within = f"from -{most:g} to {most:g} dB" if unit else f"at most {most:g} in magnitude"
        raise InputError(f"values[{i}][{j}]", f"must be {within}, but is {values[i, j]:g}{unit and ' dB'}")
    if not unit and not magnitude.any():
        raise InputError("values", "must not all be 0")


def over_axis(values: NDArray[Any], axis: NDArray[Any], frequencies: Floats) -> NDArray[Any]:
    """Return values (n, f) over those on the axis (f,)."""
    for i in np.flatnonzero(np.abs(axis) <= _SILENT * np.abs(values).max(axis=0))[:1]:
        raise InputError(
            "relative_to_axis", f"must be false where the axis is silent, but it is at {frequencies[i]:g} Hz"
        )
    return np.asarray(values / axis)


def table_band(frequencies: Floats, outside: str | None) -> tuple[float, float]:
    """Return the frequencies (low, high) in Hz that a table covers."""
    return (0.0, math.inf) if outside == "hold" else (float(frequencies[0]), float(frequencies[-1]))


def check_coverage(f: Floats, band: tuple[float, float]) -> None:
    """Check that a directivity's band (low, high) covers frequencies (...), Hz."""
    low, high = band[0] * (1.0 - _SAME_FREQUENCY), band[1] * (1.0 + _SAME_FREQUENCY)
    beyond = f[(f < low) | (f > high)]
    if beyond.size:
        raise InputError(
            "directivity",
            f"must cover {beyond.ravel()[0]:.6g} Hz, but covers {band[0]:.6g} to {band[1]:.6g} Hz; "
            'measure more of it or give outside="hold"',
        )


def joined_over_frequency(frequencies: Floats, values: NDArray[Any], at: Floats, *, monotone: bool = False) -> Any:
    """Return values (n, f) at other frequencies (u,), those beyond the ends as at the ends, (n, u).

    Sound has no phase at 0 Hz: below half of the lowest frequency, imaginary parts fall to nothing as a raised cosine.
    """
    from scipy.interpolate import CubicSpline, PchipInterpolator

    within = np.clip(at, frequencies[0], frequencies[-1])
    if len(frequencies) == 1:
        joined: Any = np.repeat(values, len(at), axis=1)
    else:
        joined = (PchipInterpolator if monotone else CubicSpline)(frequencies, values, axis=1)(within)
    if np.iscomplexobj(joined) and frequencies[0] > 0.0:
        joined.imag *= np.sin(0.5 * math.pi * np.minimum(at / (0.5 * frequencies[0]), 1.0)) ** 2
    return joined
