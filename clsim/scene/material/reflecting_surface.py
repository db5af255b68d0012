"""Reflection and transmission factors of a wall by frequency and angle, its scattering, and checks of tables."""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from typing import Any, Self

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from clsim.acoustics.reflection import coherent_share, limp_transmission
from clsim.arrays import Floats, as_floats, as_number, read_only
from clsim.errors import InputError, check_kind, check_rising, inside, settle, warn

_LONGEST = 2**17  # samples of an impulse response
ROUNDING = 1e-9  # by which a magnitude may exceed 1, frequencies be the same, and energies exceed their sum
_UNCLEAR = 0.75 * math.pi  # rad, step of phase beyond which its direction is a guess
_FAINT = 0.1  # of the largest magnitude, below which it does not matter
_NOISE = 0.02  # error of a factor beyond which there is a warning of its noise
_LIGHTEST, _HEAVIEST = 1e-3, 1e5  # kg/m²
_MOST_LOSS = 300.0  # dB
_FREQUENCIES = 1e-6, 1e9  # Hz, between which no formula overflows
_COSINES = np.array([1.0, 0.7, 0.4, 0.1])  # at which energies are checked where they depend on the angle
EVERYWHERE = (0.0, math.inf)  # Hz

Law = Callable[[Floats, Floats, float], NDArray[Any]]


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
        note = f"factors: the phase turns by {turn[i]:.2f} rad from {f[i]:g} to {f[i + 1]:g} Hz, one way or the other; "
        warn(f"{note}give frequencies closer together, or take away the delay")


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
        note = f"samples: the last tenth of the impulse response{called} still holds {rms:.2g} rms, which over "
        warn(f"{note}{len(samples)} samples makes factors uncertain by some {error:.2g}; cut it or fade it out")


@dataclass(frozen=True, slots=True, eq=False)
class Curve:
    """Monotone cubics through values (n,) over the logarithm of increasing frequencies (n,), Hz; held beyond."""

    frequencies: Floats
    values: NDArray[Any]
    delayed: bool = False  # whether complex values lose their mean delay first, and get it back behind

    def __call__(self, frequency: Floats) -> NDArray[Any]:
        return _joined(self)(frequency)

    def share(self, frequency: Floats) -> NDArray[Any]:
        """Return values (...) from 0 to 1 at frequencies (...), Hz."""
        return np.asarray(np.clip(self(frequency), 0.0, 1.0))


@lru_cache(maxsize=256)
def _joined(curve: Curve) -> Callable[[Floats], NDArray[Any]]:
    """Return the function of frequency that a curve is."""
    f, values = curve.frequencies, curve.values
    if values.dtype.kind != "c":
        smooth = _smooth(np.log(f), values)
        return lambda at: smooth(np.log(at))
    if not curve.delayed:  # monotone cubics keep the real part of impedances above 0: the wall stays passive
        first, second = _smooth(np.log(f), values.real), _smooth(np.log(f), values.imag)
        return lambda at: first(np.log(at)) + 1j * second(np.log(at))
    # Without its mean delay, a delay stays one however coarse the table. Real and imaginary parts of the rest are
    # joined: magnitudes and phases would go astray where a factor comes near zero.
    step = values[1:] * values[:-1].conj()
    weight = np.abs(step)
    total = float(weight @ np.diff(f))
    turn = float(weight @ np.angle(step)) / total if total > 0.0 else 0.0  # mean slope of the phase, rad/Hz
    rest = values * np.exp(-1j * turn * f)
    real, imaginary, low, high = _smooth(f, rest.real), _smooth(f, rest.imag), f[0], f[-1]
    return lambda at: (real(at) + 1j * imaginary(at)) * np.exp(1j * turn * np.clip(at, low, high))


def _smooth(x: Floats, y: NDArray[Any]) -> Callable[[Floats], NDArray[Any]]:
    """Return monotone cubics through points, which overshoot none of them; held at the ends."""
    if len(x) < 2:
        return lambda at: np.full(np.shape(at), y[0])
    with np.errstate(over="ignore"):  # of next to nothing over nothing
        through = scipy.interpolate.PchipInterpolator(x, y)
    return lambda at: np.asarray(through(np.clip(at, x[0], x[-1])))


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceModel:
    """Model of a factor of sound pressure; a class of one's own needs `factor`, `describe` and fields but the first.

    Attributes
    ----------
    law : callable
        Takes frequencies (...) within the band, Hz, cosines (...) of the angle of incidence, the speed of sound, m/s.
        Factors, float64 or complex128, have the shape to which both broadcast; that of the frequencies where nothing
        depends on the angle.
    description : str
        Short description.
    is_complex, depends_on_angle : bool
        Whether factors have a phase, and whether they depend on the angle of incidence.
    band : (float, float)
        Frequencies that are covered, Hz.
    beyond : str
        Note on frequencies outside the band, where the nearest end is held; empty if they are refused.
    """

    law: Law = field(repr=False)
    description: str
    is_complex: bool = False
    depends_on_angle: bool = False
    band: tuple[float, float] = EVERYWHERE
    beyond: str = ""
    frequencies: Floats = field(default_factory=lambda: np.empty(0), repr=False)  # of a table

    def factor(self, frequency: Floats, cosine: Floats, speed_of_sound: float) -> NDArray[Any]:
        """Return factors, see `law`."""
        return self.law(frequency, cosine, speed_of_sound)

    def describe(self) -> str:
        """Return a short description."""
        return self.description


_MEMBERS = ("is_complex", "depends_on_angle", "band", "beyond", "factor", "describe")


def of_table(f: Floats, law: Law, description: str, *, held: bool = False, **fields: Any) -> SurfaceModel:
    """Return the model of a table at frequencies (n,), Hz; held: whether its ends count beyond, without a note."""
    band = EVERYWHERE if held else (float(f[0]), float(f[-1]))
    return SurfaceModel(law, description, band=band, frequencies=f, **fields)


def _lossy(losses: Curve, frequency: Floats, cosine: Floats, speed_of_sound: float) -> NDArray[Any]:
    """Return the transmission factors of losses in dB, at all angles and in phase."""
    return np.asarray(10.0 ** (-losses(frequency) / 20.0))


def as_transmission(
    surface_mass: float | None, frequencies: ArrayLike | None, losses_db: ArrayLike | None
) -> SurfaceModel:
    """Make the model of a panel from its surface mass, kg/m², or from a table of losses, dB."""
    if surface_mass is not None and frequencies is None and losses_db is None:
        mass = as_number("surface_mass", surface_mass, at_least=_LIGHTEST, at_most=_HEAVIEST, unit="kg/m²")
        return SurfaceModel(partial(limp_transmission, mass), f"limp panel of {mass:g} kg/m²", True, True)
    if surface_mass is not None or frequencies is None or losses_db is None:
        raise InputError("transmission", "must have surface_mass, or frequencies and losses_db")
    f = checked_frequencies(frequencies)
    losses = Curve(f, as_column("losses_db", losses_db, f, _MOST_LOSS, " dB"))
    beyond = "outside, the transmission loss at the nearest end is taken"
    return of_table(f, partial(_lossy, losses), "table of transmission losses", beyond=beyond)


def as_scattering(value: Any) -> Curve | None:
    """Return a scattering coefficient: of a number, or of a pair of frequencies, Hz, and values; None for nothing."""
    if value is None or isinstance(value, Curve):
        return value
    if not isinstance(value, str) and not hasattr(value, "__len__"):
        number = as_number("scattering", value, at_least=0.0, at_most=1.0)
        return Curve(np.array([1e3]), np.array([number])) if number else None
    try:
        frequencies, values = value
    except (TypeError, ValueError) as error:
        rule = "must be a number or a pair of frequencies and values"
        raise InputError("scattering", f"{rule}, but is {value!r:.80}") from error
    with inside("scattering"):
        f = checked_frequencies(frequencies)
        shares = as_column("values", values, f, 1.0)
    return Curve(f, shares) if np.any(shares) else None


@dataclass(frozen=True, slots=True, eq=False)
class ReflectingSurface:
    """How much sound a wall sends back, by frequency and angle of incidence; its fields are those of `Material`."""

    model: SurfaceModel
    name: str = ""
    roughness: float = 0.0
    scattering: Curve | None = None
    transmission: SurfaceModel | None = None

    def __post_init__(self) -> None:
        if not all(hasattr(self.model, name) for name in _MEMBERS):
            raise InputError("model", f"must have what a SurfaceModel has, but is {self.model!r:.80}")
        check_kind("name", self.name, str, "a text")
        settle(self, roughness=as_number("roughness", self.roughness, at_least=0.0, at_most=0.1, unit="m"))
        settle(self, scattering=as_scattering(self.scattering))
        if self.transmission is not None and not self._limp:
            self._check_energy(self.transmission)

    @property
    def is_complex(self) -> bool:
        """Whether `reflection_at` returns complex factors."""
        return self.model.is_complex or self._limp

    @property
    def depends_on_angle(self) -> bool:
        """Whether factors depend on the angle of incidence."""
        return self.model.depends_on_angle or self.roughness > 0.0 or self._limp

    @property
    def _limp(self) -> bool:
        """Whether the reflection is weakened by what passes, as by the mass law."""
        return self.transmission is not None and self.transmission.depends_on_angle

    @property
    def band(self) -> tuple[float, float]:
        """Frequencies (low, high) in Hz that the material covers, or was extended to by name."""
        return self.model.band

    def describe(self) -> str:
        """Return a short description."""
        rough = f", {1e3 * self.roughness:g} mm rough" if self.roughness else ""
        passes = f", lets sound pass ({self.transmission.describe()})" if self.transmission else ""
        return self.model.describe() + rough + (", scatters" if self.scattering else "") + passes

    def rough(self, rms: float) -> Self:
        """Return the material with a rough surface, which sends less sound back specularly.

        Parameters
        ----------
        rms : float
            Root mean square of the heights about the mean plane, 0 to 0.1 m. Twice rough adds up by squares.

        Notes
        -----
        Factors are multiplied by ``exp(-2 (k rms cos θ)²)``: see `clsim.acoustics.reflection.coherent_share`, also for
        its range. The lost energy is scattered: `scattered_share`.

        Examples
        --------
        >>> from clsim.scene.material.material import Material
        >>> plaster = Material.from_reflection(1.0).rough(0.5e-3)
        >>> plaster.reflection_at(40e3, [1.0, 0.5]).round(3).tolist()
        [0.765, 0.935]
        """
        rms = as_number("rms", rms, at_least=0.0, at_most=0.1, unit="m")
        return replace(self, roughness=math.hypot(self.roughness, rms))

    def transmitting(
        self, *, surface_mass: float | None = None, frequencies: ArrayLike | None = None,
        losses_db: ArrayLike | None = None,
    ) -> Self:  # fmt: skip
        """Return the material as a thin panel through which sound passes straight on.

        Parameters
        ----------
        surface_mass : float, optional
            Mass per area of a limp panel, 1e-3 to 1e5 kg/m²: the mass law.
        frequencies, losses_db : array_like (n,), optional
            In its place, transmission losses, 0 to 300 dB, at positive, increasing frequencies, Hz.

        Raises
        ------
        InputError
            If a value is out of bounds, not one of both is given, or reflected and transmitted energy by a table would
            be more than 1 together.

        Notes
        -----
        By the mass law ``T = 1 / (1 + j ω m cos θ / (2 ρ c))``, and the reflection factor is multiplied by ``1 - T``:
        the material absorbs its share of what does not pass, and nothing if it is rigid. By a table
        ``T = 10^(-loss / 20)`` at all angles, in phase, and the reflection factor stays as it is.

        Examples
        --------
        >>> from clsim.scene.material.material import Material
        >>> board = Material.from_reflection(1.0).transmitting(surface_mass=10.0)
        >>> abs(board.passing.reflection_at(500.0)).round(4).item()
        0.0263
        """
        return replace(self, transmission=as_transmission(surface_mass, frequencies, losses_db))

    @property
    def passing(self) -> Self:
        """Surface whose factors are those of the pressure behind the wall."""
        assert self.transmission is not None
        return type(self)(self.transmission, f"transmission of {self.name}" if self.name else "")

    def _check_energy(self, transmission: SurfaceModel) -> None:
        """Refuse a table that sends on more energy than the reflection leaves."""
        own = getattr(self.model, "frequencies", np.empty(0))
        frequencies = np.concatenate([transmission.frequencies, np.clip(own, *transmission.band)])[:, None]
        sent_back = np.abs(self._smooth_factor(np.clip(frequencies, *self.model.band), _COSINES, 343.2)) ** 2
        total = np.max(sent_back + transmission.factor(frequencies, _COSINES, 343.2) ** 2, axis=1)
        for i in np.flatnonzero(total > 1.0 + ROUNDING)[:1]:
            problem = "must leave reflected, absorbed and transmitted energy 1 together, but what is reflected and "
            problem += f"transmitted at {frequencies[i, 0]:.6g} Hz is {total[i]:.4g}; lower one of both"
            raise InputError("transmission", problem)

    def reflection_at(
        self, frequency: ArrayLike, cosine: ArrayLike = 1.0, speed_of_sound: float = 343.2
    ) -> NDArray[Any]:
        """Return the reflection factor of sound pressure, with the time convention ``exp(+jωt)``.

        Parameters
        ----------
        frequency : array_like (...)
            Hz, 1e-6 to 1e9.
        cosine : array_like (...)
            Cosine of the angle of incidence, to the wall's normal: above 0, at most 1.
        speed_of_sound : float
            In the air, m/s.

        Returns
        -------
        ndarray (...)
            Factors of the shape to which frequency and cosine broadcast, of magnitude 1 at most: float64, or complex128
            where `is_complex`.

        Warns
        -----
        ClsimWarning
            If a frequency lies outside a table of absorption; its nearest end is taken. The words depend on the
            material alone, so that a filter for equal warnings shows each once.
        """
        f, cos, c = self._checked(frequency, cosine, speed_of_sound)
        factor = self._smooth_factor(f, cos, c)
        if self.roughness:
            factor = factor * coherent_share(self.roughness, np.clip(f, *self.model.band), cos, c)
        if self.scattering is not None:
            factor = factor * np.sqrt(1.0 - self.scattering.share(f))
        factor = factor / np.maximum(np.abs(factor), 1.0)
        return np.array(np.broadcast_to(factor, np.broadcast_shapes(f.shape, cos.shape)))

    def energy_at(self, frequency: ArrayLike, cosine: ArrayLike = 1.0, speed_of_sound: float = 343.2) -> Floats:
        """Return the reflected share (...) of energy, by `frequency`, `cosine`, `speed_of_sound` as of `reflection_at`.

        Examples
        --------
        >>> from clsim.scene.material.material import Material
        >>> Material.from_reflection(0.5, scattering=0.36).energy_at(1e3).item()
        0.25
        """
        f, cos, c = self._checked(frequency, cosine, speed_of_sound)
        energy = np.square(np.abs(self._smooth_factor(f, cos, c)))
        return np.array(np.broadcast_to(np.minimum(energy, 1.0), np.broadcast_shapes(f.shape, cos.shape)))

    def scattered_share(self, frequency: ArrayLike, cosine: ArrayLike = 1.0, speed_of_sound: float = 343.2) -> Floats:
        """Return the scattered share (...) of energy, by `frequency`, `cosine`, `speed_of_sound` as of `reflection_at`.

        Notes
        -----
        ``1 - (1 - s) exp(-(2 k rms cos θ)²)`` with the scattering coefficient s: what `reflection_at` loses by either.
        M. Vorländer, E. Mommertz, "Definition and measurement of random-incidence scattering coefficients", Applied
        Acoustics 60, 2000, section 2.

        Examples
        --------
        >>> from clsim.scene.material.material import Material
        >>> Material.from_reflection(0.9, scattering=([500.0, 2000.0], [0.1, 0.5])).scattered_share(1e3).round(9).item()
        0.3
        """
        f, cos, c = self._checked(frequency, cosine, speed_of_sound)
        kept = np.ones(np.broadcast_shapes(f.shape, cos.shape))
        if self.roughness:
            kept = kept * np.square(coherent_share(self.roughness, np.clip(f, *self.model.band), cos, c))
        if self.scattering is not None:
            kept = kept * (1.0 - self.scattering.share(f))
        return np.asarray(1.0 - kept)

    def _checked(self, frequency: ArrayLike, cosine: ArrayLike, speed_of_sound: float) -> tuple[Floats, Floats, float]:
        """Return frequencies, Hz, cosines and the speed of sound, m/s, within their bounds."""
        f, cos = _numbers("frequency", frequency), _numbers("cosine", cosine)
        low, high = _FREQUENCIES
        for bad in f[~((f >= low) & (f <= high))].flat[:1]:
            raise InputError("frequency", f"must be from {low:g} to {high:g} Hz, but is {bad:g} Hz")
        for bad in cos[~((cos > 0.0) & (cos <= 1.0 + ROUNDING))].flat[:1]:
            raise InputError("cosine", f"must be above 0 and at most 1, but is {bad:g}")
        c = as_number("speed_of_sound", speed_of_sound, at_least=1.0, at_most=1e5, unit="m/s")
        try:
            np.broadcast_shapes(f.shape, cos.shape)
        except ValueError as error:
            raise InputError("cosine", f"must broadcast with frequency, {f.shape}, but has {cos.shape}") from error
        return f, np.minimum(cos, 1.0), c

    def _smooth_factor(self, frequency: Floats, cosine: Floats, speed_of_sound: float) -> NDArray[Any]:
        """Return the model's factor, with frequencies outside its band held at the ends."""
        self.check_coverage(frequency)
        factor = self.model.factor(np.clip(frequency, *self.model.band), cosine, speed_of_sound)
        if self._limp and self.transmission is not None:
            factor = factor * (1.0 - self.transmission.factor(frequency, cosine, speed_of_sound))
        return factor

    def check_coverage(self, frequency: ArrayLike) -> None:
        """Check that the material covers each `frequency` (...), Hz.

        Warns
        -----
        ClsimWarning
            If it is held, or goes on, there by name.
        """
        f = np.asarray(frequency, dtype=np.float64)
        low, high = self.model.band
        outside = (f < low * (1.0 - ROUNDING)) | (f > high * (1.0 + ROUNDING))
        if not np.any(outside):
            return
        called = repr(self.name) if self.name else f"({self.describe()})"
        if not self.model.beyond:
            problem = f"must be from {low:.6g} to {high:.6g} Hz, which the material {called} covers, but is "
            problem += f"{f[outside].flat[-1]:.6g} Hz; extend it by name (outside=) or give more of it"
            raise InputError("frequency", problem)
        warn(f"the material {called} covers {low:.6g} to {high:.6g} Hz; {self.model.beyond}")


def _numbers(field: str, value: ArrayLike) -> Floats:
    try:
        return np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(field, f"must be numbers, but is {value!r:.80}") from error
