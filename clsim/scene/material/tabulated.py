"""Given or measured reflection factors: a number, tables by frequency, an impulse response; their checks."""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Protocol

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from clsim.acoustics.reflection import reflection_from_absorption, reflection_from_impedance
from clsim.arrays import Floats, as_floats, as_number, read_only
from clsim.errors import InputError, check_rising, warn

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
    check_rising("frequencies", f, np.diff(f) > ROUNDING * f[:-1], " Hz")
    return f


def as_column(field: str, value: ArrayLike, frequencies: Floats, most: float, unit: str = "") -> Floats:
    """Return a table's values (n,) from 0 to the largest allowed, one for each frequency."""
    found = as_floats(field, value, (len(frequencies),))
    for i in np.flatnonzero((found < 0.0) | (found > most))[:1]:
        raise InputError(f"{field}[{i}]", f"must be from 0 to {most:g}{unit}, but is {found[i]:g}{unit}")
    return found


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
    """Warn if the phase change between two frequencies is ambiguous."""
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
    """Raise an InputError if an impulse response is too long, or reflects too much energy within a band."""
    if len(samples) > _LONGEST:
        raise InputError("samples", f"must be at most {_LONGEST}, the wall's echo alone, but are {len(samples)}")
    if not np.any(samples):
        raise InputError("samples", "must not all be 0")
    size = scipy.fft.next_fast_len(max(8 * len(samples), 4096))
    frequencies = np.arange(size // 2 + 1) * (sampling_rate / size)
    step = sampling_rate / size  # a narrow band still holds a point
    inside = (frequencies > band[0] - step) & (frequencies < band[1] + step)
    magnitude = np.abs(scipy.fft.rfft(samples, size)) * inside
    k = int(magnitude.argmax())
    if magnitude[k] > 1.0 + tolerance:
        raise InputError(
            "samples",
            f"must send back no more than they receive: magnitudes of at most 1 within the tolerance of {tolerance:g}, "
            f"but one is {magnitude[k]:.4g} at {frequencies[k]:.6g} Hz; divide them by the incident sound, or name the "
            "band that was measured",
        )


def warn_of_noise(samples: Floats, name: str) -> None:
    """Warn if the end of an impulse response has so much energy that the factor is uncertain."""
    tail = samples[-(len(samples) // 10) :] if len(samples) >= 100 else samples[:0]
    rms = math.sqrt(float(np.mean(tail**2))) if len(tail) else 0.0
    error = rms * math.sqrt(len(samples))
    if error > _NOISE:
        called = f" of {name!r}" if name else ""
        warn(
            f"samples: the last tenth of the impulse response{called} still holds {rms:.2g} rms, which over "
            f"{len(samples)} samples makes factors uncertain by some {error:.2g}; cut it or fade it out"
        )


_FEW = 512  # samples of an impulse response that are summed at once


class Tabulated(Protocol):
    """Table whose values a curve over frequency joins."""

    def curves(self) -> Callable[[Floats], NDArray[Any]]:
        """Return values at frequencies (...), Hz."""


@dataclass(frozen=True, slots=True)
class ConstantFactor:
    """One factor, real or complex, at every frequency and angle."""

    value: float | complex

    band = (0.0, math.inf)
    beyond = ""
    depends_on_angle = False

    @property
    def is_complex(self) -> bool:
        return isinstance(self.value, complex)

    def factor(self, frequency: Floats, cosine: Floats, speed_of_sound: float) -> NDArray[Any]:
        return np.full(frequency.shape, self.value)

    def describe(self) -> str:
        return f"reflection {self.value:g}"


@dataclass(frozen=True, slots=True, eq=False)
class AbsorptionTable:
    """Absorption coefficients at increasing frequencies in Hz; outside, the nearest end is held with a warning."""

    frequencies: Floats
    coefficients: Floats
    beyond: str = "outside, the absorption at the nearest end is taken"

    is_complex = False
    depends_on_angle = False

    @property
    def band(self) -> tuple[float, float]:
        return float(self.frequencies[0]), float(self.frequencies[-1])

    def factor(self, frequency: Floats, cosine: Floats, speed_of_sound: float) -> NDArray[Any]:
        return np.asarray(reflection_from_absorption(np.clip(curve_of(self)(frequency), 0.0, 1.0)))

    def curves(self) -> Callable[[Floats], NDArray[Any]]:
        return over_octaves(self.frequencies, self.coefficients)

    def describe(self) -> str:
        return "absorption table"


@dataclass(frozen=True, slots=True, eq=False)
class FactorTable:
    """Factors, real or complex, at increasing frequencies in Hz; outside, refused (None) or held by name."""

    frequencies: Floats
    factors: NDArray[Any]
    outside: str | None

    beyond = ""
    depends_on_angle = False

    @property
    def is_complex(self) -> bool:
        return self.factors.dtype.kind == "c"

    @property
    def band(self) -> tuple[float, float]:
        return _band(self.frequencies, self.outside)

    def factor(self, frequency: Floats, cosine: Floats, speed_of_sound: float) -> NDArray[Any]:
        return curve_of(self)(frequency)

    def curves(self) -> Callable[[Floats], NDArray[Any]]:
        """Return the factor as a function of frequency."""
        # Complex factors lose their mean delay first, so that a delay stays one however coarse the table, and get it
        # back behind. Real and imaginary parts of the rest are joined by monotone cubics: magnitudes and phases would
        # go astray where a factor comes near zero.
        if not self.is_complex:
            return over_octaves(self.frequencies, self.factors)
        step = self.factors[1:] * self.factors[:-1].conj()
        weight = np.abs(step)
        total = float(weight @ np.diff(self.frequencies))
        turn = float(weight @ np.angle(step)) / total if total > 0.0 else 0.0  # mean slope of the phase, rad/Hz
        rest = self.factors * np.exp(-1j * turn * self.frequencies)
        real, imaginary = _smooth(self.frequencies, rest.real), _smooth(self.frequencies, rest.imag)
        low, high = self.frequencies[0], self.frequencies[-1]
        return lambda f: (real(f) + 1j * imaginary(f)) * np.exp(1j * turn * np.clip(f, low, high))

    def describe(self) -> str:
        return "complex table" if self.is_complex else "table of factors"


@dataclass(frozen=True, slots=True, eq=False)
class ImpedanceTable:
    """Specific impedances over that of air, at increasing frequencies in Hz, of a locally reacting wall."""

    frequencies: Floats
    impedances: NDArray[np.complex128]
    outside: str | None

    beyond = ""
    is_complex = True
    depends_on_angle = True

    @property
    def band(self) -> tuple[float, float]:
        return _band(self.frequencies, self.outside)

    def factor(self, frequency: Floats, cosine: Floats, speed_of_sound: float) -> NDArray[Any]:
        return reflection_from_impedance(curve_of(self)(frequency), cosine)

    def curves(self) -> Callable[[Floats], NDArray[Any]]:
        # Monotone cubics keep the real part above 0: the wall stays passive.
        resistance = over_octaves(self.frequencies, self.impedances.real)
        reactance = over_octaves(self.frequencies, self.impedances.imag)
        return lambda f: resistance(f) + 1j * reactance(f)

    def describe(self) -> str:
        return "locally reacting impedance"


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredEcho:
    """Impulse response of a reflection: samples, their rate in Hz, the index that is 0 s, the band in Hz."""

    samples: Floats
    sampling_rate: float
    reference: float
    measured: tuple[float, float]
    outside: str | None

    beyond = ""
    is_complex = True
    depends_on_angle = False

    @property
    def band(self) -> tuple[float, float]:
        """Known where it was measured, or everywhere by name."""
        return self.measured if self.outside is None else (0.0, math.inf)

    def factor(self, frequency: Floats, cosine: Floats, speed_of_sound: float) -> NDArray[Any]:
        """Return the spectrum at frequencies, ``sum h[n] exp(-2j π f (n - reference) / sampling_rate)``."""
        f, back = np.unique(np.clip(frequency, *self.measured), return_inverse=True)
        turn = -2j * np.pi * f / self.sampling_rate  # per sample
        # A long sum as a short sum of short ones: few exponentials, and a product of matrices.
        rows = np.pad(self.samples, (0, -len(self.samples) % _FEW)).reshape(-1, _FEW)
        spectrum = np.zeros(len(f), dtype=np.complex128)
        for part in np.array_split(np.arange(len(f)), max(1, len(f) // 512)):
            short = np.exp(turn[part, None] * np.arange(_FEW)) @ rows.T
            spectrum[part] = (short * np.exp(turn[part, None] * _FEW * np.arange(len(rows)))).sum(axis=1)
        return np.asarray((spectrum * np.exp(-turn * self.reference))[back].reshape(frequency.shape))

    def describe(self) -> str:
        return f"impulse response of {len(self.samples)} samples"


def _band(frequencies: Floats, outside: str | None) -> tuple[float, float]:
    return (0.0, math.inf) if outside == "hold" else (float(frequencies[0]), float(frequencies[-1]))


@lru_cache(maxsize=256)
def curve_of(table: Tabulated) -> Callable[[Floats], NDArray[Any]]:
    """Return the curve of a table over frequency, made once."""
    return table.curves()


def _smooth(x: Floats, y: NDArray[Any]) -> Callable[[Floats], NDArray[Any]]:
    """Return monotone cubics through points, which overshoot none of them; held at the ends."""
    if len(x) < 2:
        return lambda at: np.full(np.shape(at), y[0])
    with np.errstate(over="ignore"):  # of next to nothing over nothing
        through = scipy.interpolate.PchipInterpolator(x, y)
    return lambda at: np.asarray(through(np.clip(at, x[0], x[-1])))


def over_octaves(frequencies: Floats, values: NDArray[Any]) -> Callable[[Floats], NDArray[Any]]:
    """Return monotone cubics over the logarithm of frequency."""
    curve = _smooth(np.log(frequencies), values)
    return lambda f: curve(np.log(f))
