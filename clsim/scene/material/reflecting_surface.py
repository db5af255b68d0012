"""Reflection and transmission factors of a wall by frequency and angle, and its scattering coefficient."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Protocol, Self, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clsim.acoustics.reflection import coherent_share, limp_transmission
from clsim.arrays import Floats, as_number
from clsim.errors import InputError, check_kind, inside, settle, warn
from clsim.scene.material.tabulated import as_column, checked_frequencies, curve_of, over_octaves

_LIGHTEST, _HEAVIEST = 1e-3, 1e5  # kg/m²
_MOST_LOSS = 300.0  # dB
_FREQUENCIES = 1e-6, 1e9  # Hz, between which no formula overflows
_ROUNDING = 1e-9  # by which a cosine may exceed 1, a frequency the ends of a table, and energies their sum
_COSINES = np.array([1.0, 0.7, 0.4, 0.1])  # at which energies are checked where they depend on the angle


@dataclass(frozen=True, slots=True)
class MassLaw:
    """A limp panel of a surface mass in kg/m²: its inertia alone resists the sound."""

    surface_mass: float

    band = (0.0, math.inf)
    beyond = ""
    is_complex = True
    depends_on_angle = True

    def factor(self, frequency: Floats, cosine: Floats, speed_of_sound: float) -> NDArray[Any]:
        return limp_transmission(self.surface_mass, frequency, cosine, speed_of_sound)

    def describe(self) -> str:
        return f"limp panel of {self.surface_mass:g} kg/m²"


@dataclass(frozen=True, slots=True, eq=False)
class LossTable:
    """Transmission losses in dB at increasing frequencies in Hz, at all angles and in phase; held outside."""

    frequencies: Floats
    losses_db: Floats
    beyond: str = "outside, the transmission loss at the nearest end is taken"

    is_complex = False
    depends_on_angle = False

    @property
    def band(self) -> tuple[float, float]:
        return float(self.frequencies[0]), float(self.frequencies[-1])

    def factor(self, frequency: Floats, cosine: Floats, speed_of_sound: float) -> NDArray[Any]:
        return np.asarray(10.0 ** (-curve_of(self)(frequency) / 20.0))

    def curves(self) -> Callable[[Floats], NDArray[Any]]:
        return over_octaves(self.frequencies, self.losses_db)

    def describe(self) -> str:
        return "table of transmission losses"


TransmissionModel = MassLaw | LossTable


def as_transmission(
    surface_mass: float | None, frequencies: ArrayLike | None, losses_db: ArrayLike | None
) -> TransmissionModel:
    """Make the model of a panel from its surface mass, kg/m², or from a table of losses, dB."""
    if surface_mass is not None and frequencies is None and losses_db is None:
        return MassLaw(as_number("surface_mass", surface_mass, at_least=_LIGHTEST, at_most=_HEAVIEST, unit="kg/m²"))
    if surface_mass is not None or frequencies is None or losses_db is None:
        raise InputError("transmission", "must have surface_mass, or frequencies and losses_db")
    f = checked_frequencies(frequencies)
    return LossTable(f, as_column("losses_db", losses_db, f, _MOST_LOSS, " dB"))


@dataclass(frozen=True, eq=False)
class Scattering:
    """Shares (n,) of the energy sent back that are scattered, at increasing frequencies (n,), Hz; held beyond."""

    frequencies: Floats
    values: Floats

    def at(self, frequency: Floats) -> NDArray[Any]:
        """Return the shares (...) at frequencies (...), Hz."""
        return np.asarray(np.clip(self._curve(frequency), 0.0, 1.0))

    @cached_property
    def _curve(self) -> Callable[[Floats], NDArray[Any]]:
        return over_octaves(self.frequencies, self.values)


def as_scattering(value: Any) -> Scattering | None:
    """Return a scattering coefficient: of a number, or of a pair of frequencies, Hz, and values; None for nothing."""
    if value is None or isinstance(value, Scattering):
        return value
    if not isinstance(value, str) and not hasattr(value, "__len__"):
        number = as_number("scattering", value, at_least=0.0, at_most=1.0)
        return Scattering(np.array([1e3]), np.array([number])) if number else None
    try:
        frequencies, values = value
    except (TypeError, ValueError) as error:
        rule = "must be a number or a pair of frequencies and values"
        raise InputError("scattering", f"{rule}, but is {value!r:.80}") from error
    with inside("scattering"):
        f = checked_frequencies(frequencies)
        shares = as_column("values", values, f, 1.0)
    return Scattering(f, shares) if np.any(shares) else None


@runtime_checkable
class SurfaceModel(Protocol):
    """Protocol of reflection models; a custom model is a frozen class with all of these members."""

    @property
    def is_complex(self) -> bool:
        """Whether factors have a phase."""

    @property
    def depends_on_angle(self) -> bool:
        """Whether factors depend on the angle of incidence."""

    @property
    def band(self) -> tuple[float, float]:
        """Frequencies (low, high) in Hz that are covered; ``(0, inf)`` if all."""

    @property
    def beyond(self) -> str:
        """Note on frequencies outside the band, where the nearest end is held; empty if they are refused."""

    def factor(self, frequency: Floats, cosine: Floats, speed_of_sound: float) -> NDArray[Any]:
        """Return factors.

        Parameters
        ----------
        frequency : ndarray (...)
            Hz, within the band.
        cosine : ndarray (...)
            Cosine of the angle of incidence; broadcasts against `frequency`.
        speed_of_sound : float
            In the air, m/s.

        Returns
        -------
        ndarray
            Float64, or complex128 if `is_complex`: of the shape to which the arguments broadcast, or, where
            nothing depends on the angle, of that of `frequency`.
        """

    def describe(self) -> str:
        """Return a short description."""


@dataclass(frozen=True, slots=True, eq=False)
class ReflectingSurface:
    """How much sound a wall sends back, by frequency and angle of incidence; its fields are those of `Material`."""

    model: SurfaceModel
    name: str = ""
    roughness: float = 0.0
    scattering: Scattering | None = None
    transmission: TransmissionModel | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.model, SurfaceModel):
            raise InputError("model", f"must have what a SurfaceModel has, but is {self.model!r:.80}")
        check_kind("name", self.name, str, "a text")
        settle(self, roughness=as_number("roughness", self.roughness, at_least=0.0, at_most=0.1, unit="m"))
        settle(self, scattering=as_scattering(self.scattering))
        if isinstance(self.transmission, LossTable):
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
        """Whether the reflection is weakened by what passes."""
        return isinstance(self.transmission, MassLaw)

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
        self,
        *,
        surface_mass: float | None = None,
        frequencies: ArrayLike | None = None,
        losses_db: ArrayLike | None = None,
    ) -> Self:
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

    def _check_energy(self, transmission: LossTable) -> None:
        """Refuse a table that sends on more energy than the reflection leaves."""
        own = getattr(self.model, "frequencies", np.empty(0))
        frequencies = np.concatenate([transmission.frequencies, np.clip(own, *transmission.band)])[:, None]
        sent_back = np.abs(self._smooth_factor(np.clip(frequencies, *self.model.band), _COSINES, 343.2)) ** 2
        total = np.max(sent_back + transmission.factor(frequencies, _COSINES, 343.2) ** 2, axis=1)
        for i in np.flatnonzero(total > 1.0 + _ROUNDING)[:1]:
            raise InputError(
                "transmission",
                "must leave reflected, absorbed and transmitted energy 1 together, but what is reflected and "
                f"transmitted at {frequencies[i, 0]:.6g} Hz is {total[i]:.4g}; lower one of both",
            )

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
            factor = factor * np.sqrt(1.0 - self.scattering.at(f))
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
            kept = kept * (1.0 - self.scattering.at(f))
        return np.asarray(1.0 - kept)

    def _checked(self, frequency: ArrayLike, cosine: ArrayLike, speed_of_sound: float) -> tuple[Floats, Floats, float]:
        """Return frequencies, Hz, cosines and the speed of sound, m/s, within their bounds."""
        f, cos = _numbers("frequency", frequency), _numbers("cosine", cosine)
        low, high = _FREQUENCIES
        for bad in f[~((f >= low) & (f <= high))].flat[:1]:
            raise InputError("frequency", f"must be from {low:g} to {high:g} Hz, but is {bad:g} Hz")
        for bad in cos[~((cos > 0.0) & (cos <= 1.0 + _ROUNDING))].flat[:1]:
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
        if isinstance(self.transmission, MassLaw):
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
        outside = (f < low * (1.0 - _ROUNDING)) | (f > high * (1.0 + _ROUNDING))
        if not np.any(outside):
            return
        called = repr(self.name) if self.name else f"({self.describe()})"
        if not self.model.beyond:
            raise InputError(
                "frequency",
                f"must be from {low:.6g} to {high:.6g} Hz, which the material {called} covers, but is "
                f"{f[outside].flat[-1]:.6g} Hz; extend it by name (outside=) or give more of it",
            )
        warn(f"the material {called} covers {low:.6g} to {high:.6g} Hz; {self.model.beyond}")


def _numbers(field: str, value: ArrayLike) -> Floats:
    try:
        return np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(field, f"must be numbers, but is {value!r:.80}") from error
