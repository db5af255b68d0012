"""The air in the room."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from clsim.acoustics.air import (
    absorption_iso9613,
    lead_iso9613,
    lead_slope_iso9613,
    speed_of_sound_cramer,
    speed_of_sound_iso9613,
    vapour_fraction_giacomo,
    vapour_percent_iso9613,
)
from clsim.arrays import Floats, as_choice, as_flag, as_floats, as_number
from clsim.errors import InputError, warn

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from clsim.arrays import Complexes

_COLDEST, _HOTTEST = -73.0, 100.0  # °C: 200 K, where ISO 9613-1 stops claiming anything, and boiling water
_THINNEST, _DENSEST = 1e4, 1e6  # Pa
_SLOWEST, _FASTEST = 100.0, 2000.0  # m/s: heavy gases, hydrogen, water
_STRONGEST = 0.5  # of the speed of sound, a wind


@dataclass(frozen=True, slots=True, init=False)
class Air:
    """Air of one temperature, humidity and pressure, that rests or moves as a whole.

    Parameters
    ----------
    temperature_celsius : float
        Temperature, -73 to 100 °C.
    relative_humidity : float
        From 0 to 1 (not per cent).
    pressure : float
        Static pressure, 10 kPa to 1 MPa, Pa.
    speed_of_sound : float or "iso9613" or None
        A speed, 100 to 2000 m/s; ISO 9613-1's formula by name; or None for Cramer's formula (1993, 314 ppm CO2).
    absorption : bool
        Whether the air absorbs sound, by ISO 9613-1; without it closed forms of walls and spreading hold exactly.
    dispersion : bool or None
        Whether the speed of sound depends on frequency, as it must where relaxations absorb; None for whether it comes
        by a formula. Without it a speed holds at all frequencies, with it at zero frequency.
    wind : array_like (3,), optional
        Velocity of the air, below half the speed of sound, m/s; at rest when left out.

    Attributes
    ----------
    speed_of_sound : float
        The given speed, or what the formula gives, m/s.
    wind : tuple or None
        Velocity of the air, m/s; None where it rests.

    Raises
    ------
    InputError
        If a value is out of bounds, there would be more water vapour than air, or air that does not absorb disperses.

    Warns
    -----
    ClsimWarning
        If the speed lies outside the range of Cramer's formula (0 to 30 °C, 75 to 102 kPa), or the absorption
        is less sure than within 20 %, which ISO 9613-1 is from -20 to 50 °C, below 200 kPa and from 0.005 %
        of vapour.

    Examples
    --------
    >>> air = Air(temperature_celsius=20.0, relative_humidity=0.5)
    >>> round(air.speed_of_sound, 3), round(float(air.absorption_at(40e3)), 3)
    (343.994, 1.318)
    """

    temperature_celsius: float
    relative_humidity: float
    pressure: float
    speed_of_sound: float = field(init=False)
    absorption: bool
    dispersion: bool | None
    wind: tuple[float, float, float] | None
    _asked_speed: float | str | None = field(repr=False)  # so that `dataclasses.replace` keeps what was asked for

    def __init__(
        self,
        temperature_celsius: float = 20.0,
        relative_humidity: float = 0.5,
        pressure: float = 101_325.0,
        speed_of_sound: float | str | None = None,
        absorption: bool = True,
        dispersion: bool | None = None,
        wind: ArrayLike | None = None,
        *,
        _asked_speed: float | str | None = None,
    ) -> None:
        celsius = as_number("temperature_celsius", temperature_celsius, at_least=_COLDEST, at_most=_HOTTEST, unit="°C")
        humidity = _checked_humidity(relative_humidity)
        pascal = as_number("pressure", pressure, at_least=_THINNEST, at_most=_DENSEST, unit="Pa")
        asked = _checked_speed(_asked_speed if speed_of_sound is None else speed_of_sound)
        absorbs = as_flag("absorption", absorption)
        disperses = None if dispersion is None else as_flag("dispersion", dispersion)
        if disperses and not absorbs:
            raise InputError("dispersion", "must be False or None in air without absorption, but is True")
        vapour = vapour_fraction_giacomo(celsius, humidity, pascal)
        if vapour >= 1.0:
            raise InputError(
                "relative_humidity",
                f"must leave room for air, but at {celsius:g} °C and {pascal:g} Pa "
                f"{humidity:g} is nothing but water vapour",
            )
        speed = _speed(asked, celsius, humidity, pascal)
        values = (celsius, humidity, pascal, speed, absorbs, disperses, _checked_wind(wind, speed), asked)
        for name, value in zip(self.__slots__, values, strict=True):
            object.__setattr__(self, name, value)
        for message in (_doubt_in_speed(self, asked, vapour), _doubt_in_absorption(self)):
            if message:
                warn(message)

    @property
    def slowest(self) -> float:
        """Speed at which sound makes way at least, against the wind, m/s."""
        return self.speed_of_sound - (0.0 if self.wind is None else math.hypot(*self.wind))

    @property
    def disperses(self) -> bool:
        """Whether the speed of sound depends on frequency."""
        by_formula = not isinstance(self._asked_speed, float)
        return self.absorption and (by_formula if self.dispersion is None else self.dispersion)

    def absorption_at(self, frequency: ArrayLike) -> Floats:
        """Return the absorption of pure tones by ISO 9613-1, dB/m; zero in air without.

        Parameters
        ----------
        frequency : array_like
            Frequencies of any shape, at least 0, Hz.

        Returns
        -------
        ndarray
            Absorption of the shape of `frequency`, dB/m.

        Raises
        ------
        InputError
            If a frequency is negative or not finite.

        Warns
        -----
        ClsimWarning
            Above 10 Hz/Pa (1.01 MHz at one atmosphere), where ISO 9613-1 states no accuracy.
        """
        f = np.asarray(frequency, dtype=np.float64)
        if not np.all((f >= 0.0) & np.isfinite(f)):
            raise InputError("frequency", "must be finite and at least 0 Hz")
        if not self.absorption:
            return np.zeros(f.shape)
        if np.any(f > 10.0 * self.pressure):
            warn(
                f"the absorption of air is asked for at {np.max(f):g} Hz, but ISO 9613-1 states its accuracy "
                f"up to 10 Hz/Pa only, here {10.0 * self.pressure:g} Hz"
            )
        return absorption_iso9613(f, self.temperature_celsius, self.relative_humidity, self.pressure)

    def wavenumber_at(self, frequency: ArrayLike) -> Complexes:
        """Return the complex wavenumber k of pure tones, with ``exp(j 2 pi f t - j k x)``, 1/m.

        Parameters
        ----------
        frequency : array_like
            Frequencies of any shape, as for `absorption_at`, Hz.

        Returns
        -------
        ndarray
            Of the shape of `frequency`; its imaginary part is minus the absorption of the amplitude.
        """
        f = np.asarray(frequency, dtype=np.float64)
        k = 2.0 * np.pi / self.speed_of_sound * f - 1j * np.log(10.0) / 20.0 * self.absorption_at(f)
        return np.asarray(k - lead_iso9613(f, *self._state) if self.disperses else k)

    def speed_at(self, frequency: float) -> float:
        """Return the speed of sound of a pure tone, that of its phase, m/s.

        Parameters
        ----------
        frequency : float
            Above 0, Hz.

        Returns
        -------
        float
            Speed, m/s.
        """
        c = self.speed_of_sound
        if not self.disperses:
            return c
        return c / (1.0 - c * float(lead_iso9613(frequency, *self._state)) / (2.0 * np.pi * frequency))

    def group_speed_at(self, frequency: float) -> float:
        """Return the speed of what sounds about a frequency, that of envelopes, m/s.

        Parameters
        ----------
        frequency : float
            At least 0, Hz.

        Returns
        -------
        float
            Speed, m/s.
        """
        c = self.speed_of_sound
        if not self.disperses:
            return c
        return c / (1.0 - c * float(lead_slope_iso9613(frequency, *self._state)))

    @property
    def _state(self) -> tuple[float, float, float]:
        return self.temperature_celsius, self.relative_humidity, self.pressure


def _checked_humidity(value: float) -> float:
    humidity = as_number("relative_humidity", value, at_least=0.0)
    if humidity > 1.0:
        hint = f"; {humidity:g} per cent is {humidity / 100:g}" if humidity <= 100.0 else ""
        raise InputError("relative_humidity", f"must be from 0 to 1, but is {humidity:g}{hint}")
    return humidity


def _checked_speed(value: float | str | None) -> float | str | None:
    if value is None:
        return None
    if isinstance(value, str):
        return as_choice("speed_of_sound", value, ("iso9613",))
    return as_number("speed_of_sound", value, at_least=_SLOWEST, at_most=_FASTEST, unit="m/s")


def _checked_wind(value: ArrayLike | None, speed_of_sound: float) -> tuple[float, float, float] | None:
    if value is None:
        return None
    x, y, z = as_floats("wind", value, (3,)).tolist()
    if math.hypot(x, y, z) >= _STRONGEST * speed_of_sound:
        raise InputError(
            "wind",
            f"must be slower than half the speed of sound, {_STRONGEST * speed_of_sound:.6g} m/s, "
            f"but is {math.hypot(x, y, z):.6g} m/s",
        )
    return (x, y, z) if x or y or z else None


def _speed(asked: float | str | None, celsius: float, humidity: float, pressure: float) -> float:
    """Return the speed of sound that was asked for, by number or by formula, m/s."""
    if asked is None:
        return speed_of_sound_cramer(celsius, humidity, pressure)
    if isinstance(asked, str):
        return speed_of_sound_iso9613(celsius)
    return asked


def _doubt_in_speed(air: Air, asked: float | str | None, vapour: float) -> str:
    """Return a sentence if the speed comes from Cramer's formula outside its range."""
    inside = 0.0 <= air.temperature_celsius <= 30.0 and 75e3 <= air.pressure <= 102e3 and vapour <= 0.06
    if asked is not None or inside:
        return ""
    return (
        f"Cramer's formula of the speed of sound holds from 0 to 30 °C, 75 to 102 kPa and up to 6 % of "
        f"vapour, but the air has {air.temperature_celsius:g} °C, {air.pressure / 1e3:g} kPa "
        f"and {100 * vapour:.3g} %; "
        f'give speed_of_sound as a number or as "iso9613"'
    )


def _doubt_in_absorption(air: Air) -> str:
    """Return a sentence if ISO 9613-1 is less sure of the absorption than within 20 %."""
    vapour = vapour_percent_iso9613(air.temperature_celsius, air.relative_humidity, air.pressure)
    inside = -20.0 <= air.temperature_celsius <= 50.0 and air.pressure < 200e3 and vapour >= 0.005
    if not air.absorption or inside:
        return ""
    return (
        f"ISO 9613-1 gives the absorption of air within 20 % from -20 to 50 °C, below 200 kPa and from "
        f"0.005 % of vapour, but the air has {air.temperature_celsius:g} °C, {air.pressure / 1e3:g} kPa "
        f"and {vapour:.3g} %"
    )
