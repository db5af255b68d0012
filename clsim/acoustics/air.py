"""Sound in air at rest: its speed, its absorption, and how both go together.

References
----------
.. [Cramer] O. Cramer, "The variation of the specific heat ratio and the speed of sound in air with
   temperature, pressure, humidity, and CO2 concentration", J. Acoust. Soc. Am. 93 (5), 2510-2516, 1993.
.. [ISO] ISO 9613-1:1993, "Acoustics - Attenuation of sound during propagation outdoors - Part 1:
   Calculation of the absorption of sound by the atmosphere".
.. [Giacomo] P. Giacomo, "Equation for the determination of the density of moist air (1981)", Metrologia 18,
   33-40, 1982.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from clsim.arrays import Floats

KELVIN = 273.15  # K at 0 degrees Celsius
REFERENCE_PRESSURE = 101_325.0  # Pa
REFERENCE_TEMPERATURE = 293.15  # K
TRIPLE_POINT = 273.16  # K, of water
CO2_FRACTION = 314e-6  # molar, of standard air
DECIBEL_PER_NEPER = 8.686  # as the standard rounds it
_PER_NEPER = DECIBEL_PER_NEPER * math.log(10.0) / 20.0  # nepers of these decibels in one of the standard's


def saturation_pressure_giacomo(temperature_celsius: float) -> float:
    """Return the pressure of saturated water vapour, Pa.

    ``exp(1.2811805e-5 T² - 1.9509874e-2 T + 34.04926034 - 6353.6311/T)``, T in K: [Giacomo]_, as [Cramer]_ uses it in
    his appendix. Valid from 0 to 30 °C.

    >>> round(saturation_pressure_giacomo(20.0))
    2339
    """
    T = temperature_celsius + KELVIN
    return math.exp(1.2811805e-5 * T**2 - 1.9509874e-2 * T + 34.04926034 - 6.3536311e3 / T)


def vapour_fraction_giacomo(temperature_celsius: float, relative_humidity: float, pressure: float) -> float:
    """Return the molar fraction of water vapour.

    ``h f p_sv / p`` with the enhancement factor ``f = 1.00062 + 3.14e-8 p + 5.6e-7 t²``: [Giacomo]_, as [Cramer]_ uses
    it in his appendix.

    >>> round(vapour_fraction_giacomo(20.0, 0.5, 101_325.0), 6)
    0.011586
    """
    enhancement = 1.00062 + 3.14e-8 * pressure + 5.6e-7 * temperature_celsius**2
    return relative_humidity * enhancement * saturation_pressure_giacomo(temperature_celsius) / pressure


@lru_cache(maxsize=64)
def speed_of_sound_cramer(
    temperature_celsius: float, relative_humidity: float, pressure: float, co2_fraction: float = CO2_FRACTION
) -> float:
    """Return the speed of sound at zero frequency in moist air, m/s.

    co2_fraction: molar fraction of carbon dioxide, by default 314 ppm: standard air, for which the formula gives
    343.994 m/s at 20 °C and 50 %. Air of 415 ppm (2020) is 0.009 m/s slower.

    [Cramer]_, equation 15 with its coefficients for the speed of sound; valid from 0 to 30 °C, 75 to 102 kPa, vapour
    fractions to 0.06 and CO2 fractions to 0.01, with an uncertainty of 300 ppm.
    """
    t, p, c = temperature_celsius, pressure, co2_fraction
    w = vapour_fraction_giacomo(temperature_celsius, relative_humidity, pressure)
    return (
        331.5024
        + 0.603055 * t
        - 0.000528 * t**2
        + (51.471935 + 0.1495874 * t - 0.000782 * t**2) * w
        + (-1.82e-7 + 3.73e-8 * t - 2.93e-10 * t**2) * p
        + (-85.20931 - 0.228525 * t + 5.91e-5 * t**2) * c
        - 2.835149 * w**2
        - 2.15e-13 * p**2
        + 29.179762 * c**2
        + 0.000486 * w * p * c
    )


def speed_of_sound_iso9613(temperature_celsius: float) -> float:
    """Return the speed of sound in air by temperature alone, m/s.

    ``343.2 sqrt(T / 293.15 K)``: [ISO]_ annex A, equation A.5; from -20 to 50 °C.
    """
    return 343.2 * math.sqrt((temperature_celsius + KELVIN) / REFERENCE_TEMPERATURE)


def vapour_percent_iso9613(temperature_celsius: float, relative_humidity: float, pressure: float) -> float:
    """Return the molar concentration of water vapour, per cent.

    ``h = h_r (p_sat / p_r) / (p_a / p_r)`` with ``p_sat / p_r = 10^(-6.8346 (T_01 / T)^1.261 + 4.6151)``: [ISO]_ annex
    B.

    >>> round(vapour_percent_iso9613(20.0, 0.5, 101_325.0), 3)
    1.153
    """
    exponent = -6.8346 * (TRIPLE_POINT / (temperature_celsius + KELVIN)) ** 1.261 + 4.6151
    saturation: float = 10.0**exponent  # in units of the reference pressure
    return 100.0 * relative_humidity * saturation * REFERENCE_PRESSURE / pressure


def absorption_iso9613(
    frequency: ArrayLike, temperature_celsius: float, relative_humidity: float, pressure: float
) -> Floats:
    """Return the absorption of pure tones by air, dB/m.

    [ISO]_ equations 3 to 5: classical and rotational absorption and the vibrational relaxation of oxygen and nitrogen.
    Within 10 % from -20 to 50 °C, below 200 kPa, for vapour from 0.05 to 5 % and 4e-4 to 10 Hz/Pa.
    """
    f2 = np.square(np.asarray(frequency, dtype=np.float64))
    theta = (temperature_celsius + KELVIN) / REFERENCE_TEMPERATURE
    oxygen, nitrogen = (
        strength / (relaxation + f2 / relaxation)
        for strength, relaxation in _relaxations(temperature_celsius, relative_humidity, pressure)
    )
    classical = 1.84e-11 * theta**0.5 / (pressure / REFERENCE_PRESSURE)
    absorption: Floats = DECIBEL_PER_NEPER * f2 * (classical + theta**-2.5 * (oxygen + nitrogen))
    return absorption


def lead_iso9613(frequency: ArrayLike, temperature_celsius: float, relative_humidity: float, pressure: float) -> Floats:
    """Return the phase lead of pure tones over sound at zero frequency in each metre of air, rad/m.

    A relaxation that absorbs ``S f x / (1 + x²)``, with ``x = f / f_r`` and the strength S of [ISO]_ equation 3, lets
    sound lead by ``S f x² / (1 + x²)``: both are parts of ``j S f x / (1 + j x)``, by which one internal degree of
    freedom changes the wavenumber (A. D. Pierce, Acoustics, 1981, section 10-8), and which is causal. Classical
    absorption, by the square of the frequency, hardly disperses.

    >>> round(math.degrees(10.0 * float(lead_iso9613(40e3, 20.0, 0.5, 101_325.0))), 1)
    105.4
    """
    f = np.asarray(frequency, dtype=np.float64)
    lead = np.zeros(f.shape)
    for strength, relaxation in _strengths(temperature_celsius, relative_humidity, pressure):
        y = np.square(f / relaxation)
        lead = lead + strength * f * y / (1.0 + y)
    return lead


def lead_slope_iso9613(
    frequency: ArrayLike, temperature_celsius: float, relative_humidity: float, pressure: float
) -> Floats:
    """Return the derivative of `lead_iso9613` by the angular frequency: the lead of envelopes for each metre, s/m.

    The sum of ``S (y / (1 + y) + 2 y / (1 + y)²) / 2 pi``, ``y = x²``, over both relaxations of `lead_iso9613` ([ISO]_
    equation 3).

    >>> round(1.0 / (1.0 / 343.994 - float(lead_slope_iso9613(40e3, 20.0, 0.5, 101_325.0))) - 343.994, 4)
    0.1437
    """
    f = np.asarray(frequency, dtype=np.float64)
    slope = np.zeros(f.shape)
    for strength, relaxation in _strengths(temperature_celsius, relative_humidity, pressure):
        y = np.square(f / relaxation)
        slope = slope + strength * (y / (1.0 + y) + 2.0 * y / np.square(1.0 + y))
    return np.asarray(slope / (2.0 * math.pi))


def _relaxations(
    temperature_celsius: float, relative_humidity: float, pressure: float
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return strength without its power of temperature, s/m, and frequency, Hz, of oxygen and nitrogen."""
    T = temperature_celsius + KELVIN
    p = pressure / REFERENCE_PRESSURE
    theta = T / REFERENCE_TEMPERATURE
    h = vapour_percent_iso9613(temperature_celsius, relative_humidity, pressure)
    oxygen = p * (24.0 + 4.04e4 * h * (0.02 + h) / (0.391 + h))
    nitrogen = p * theta**-0.5 * (9.0 + 280.0 * h * math.exp(-4.170 * (theta ** (-1.0 / 3.0) - 1.0)))
    return (0.01275 * math.exp(-2239.1 / T), oxygen), (0.1068 * math.exp(-3352.0 / T), nitrogen)


def _strengths(temperature_celsius: float, relative_humidity: float, pressure: float) -> list[tuple[float, float]]:
    """Return strength S, s/m, and frequency, Hz, of the relaxation of oxygen and of nitrogen."""
    warm: float = ((temperature_celsius + KELVIN) / REFERENCE_TEMPERATURE) ** -2.5
    relaxations = _relaxations(temperature_celsius, relative_humidity, pressure)
    return [(_PER_NEPER * warm * strength, relaxation) for strength, relaxation in relaxations]
