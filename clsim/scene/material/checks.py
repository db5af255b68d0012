"""Checks of reflection factors that are given or measured."""

from __future__ import annotations

import cmath
import math
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.arrays import Floats, as_floats, as_number, read_only
from clsim.errors import InputError, warn

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

_LONGEST = 2**17  # samples of an impulse response
ROUNDING = 1e-9  # by which a magnitude may exceed 1, and within which frequencies are the same
_UNCLEAR = 0.75 * math.pi  # rad, step of phase beyond which its direction is a guess
_FAINT = 0.1  # of the largest magnitude, below which it does not matter
_NOISE = 0.02  # error of a factor beyond which there is a warning of its noise


def checked_frequencies(value: ArrayLike) -> Floats:
    """Return frequencies (n,) that are positive and increase strictly, Hz, or raise an InputError."""
    f = as_floats("frequencies", value, (None,))
    for i in np.flatnonzero(f <= 0.0)[:1]:
        raise InputError(f"frequencies[{i}]", f"must be above 0 Hz, but is {f[i]:g} Hz")
    for i in np.flatnonzero(np.diff(f) <= ROUNDING * f[:-1])[:1] + 1:
        raise InputError(
            "frequencies",
            f"must increase strictly, but [{i}] = {f[i]:g} Hz follows [{i - 1}] = {f[i - 1]:g} Hz",
        )
    return f


def as_factor(field: str, value: Any) -> float | complex:
    """Return a passive reflection factor: a float where it has no phase but the sign, else complex."""
    if isinstance(value, complex | np.complexfloating):
        factor = complex(value)
        if not cmath.isfinite(factor) or abs(factor) > 1.0 + ROUNDING:
            raise InputError(field, f"must have a magnitude of at most 1, but is {factor:g}")
        return factor / max(abs(factor), 1.0) if factor.imag else max(-1.0, min(factor.real, 1.0))
    number = as_number(field, value)
    if not -1.0 <= number <= 1.0:
        raise InputError(field, f"must be from -1 to 1, but is {number:g}")
    return number


def as_complexes(field: str, value: ArrayLike, count: int) -> NDArray[Any]:
    """Return finite numbers (count,), read-only: float64, or complex128 where any has an imaginary part."""
    try:
        given = np.asarray(value)
    except ValueError:  # lists of lists of other lengths
        given = np.asarray(None)
    if given.dtype.kind != "c":
        return as_floats(field, value, (count,))
    real, imaginary = as_floats(field, given.real, (count,)), as_floats(field, given.imag, (count,))
    return read_only(real + 1j * imaginary) if np.any(imaginary) else real


def check_clear_phase(frequencies: Floats, factors: NDArray[Any]) -> None:
    """Warn if the phase turns so far between two frequencies that nobody can tell which way."""
    if factors.dtype.kind != "c":
        return
    magnitude = np.abs(factors)
    turn = np.abs(np.angle(factors[1:] * factors[:-1].conj()))
    turn[np.minimum(magnitude[1:], magnitude[:-1]) < _FAINT * magnitude.max()] = 0.0  # through zero any turn is fair
    for i in np.flatnonzero(turn > _UNCLEAR)[:1]:
        f = frequencies
        warn(
            f"factors: the phase turns by {turn[i]:.2f} rad from {f[i]:g} to {f[i + 1]:g} Hz, one way or the other; "
            "give frequencies closer together, or take away the delay"
        )


def check_passive_echo(samples: Floats, sampling_rate: float, band: tuple[float, float], tolerance: float) -> None:
    """Raise an InputError if an impulse response is too long, or sends back more than it receives within a band."""
    from scipy.fft import next_fast_len, rfft

    if len(samples) > _LONGEST:
        raise InputError("samples", f"must be at most {_LONGEST}, the wall's echo alone, but are {len(samples)}")
    if not np.any(samples):
        raise InputError("samples", "must not all be 0")
    size = next_fast_len(max(8 * len(samples), 4096))
    frequencies = np.arange(size // 2 + 1) * (sampling_rate / size)
    step = sampling_rate / size  # a narrow band still holds a point
    inside = (frequencies > band[0] - step) & (frequencies < band[1] + step)
    magnitude = np.abs(rfft(samples, size)) * inside
    k = int(magnitude.argmax())
    if magnitude[k] > 1.0 + tolerance:
        raise InputError(
            "samples",
            f"must send back no more than they receive: magnitudes of at most 1 within the tolerance of {tolerance:g}, "
            f"but one is {magnitude[k]:.4g} at {frequencies[k]:.6g} Hz; divide them by the incident sound, or name the "
            "band that was measured",
        )


def warn_of_noise(samples: Floats, name: str) -> None:
    """Warn if the end of an impulse response holds so much that the factor cannot be sure."""
    tail = samples[-(len(samples) // 10) :] if len(samples) >= 100 else samples[:0]
    rms = math.sqrt(float(np.mean(tail**2))) if len(tail) else 0.0
    error = rms * math.sqrt(len(samples))
    if error > _NOISE:
        called = f" of {name!r}" if name else ""
        warn(
            f"samples: the last tenth of the impulse response{called} still holds {rms:.2g} rms, which over "
            f"{len(samples)} samples makes factors uncertain by some {error:.2g}; cut it or fade it out"
        )
