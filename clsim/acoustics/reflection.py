"""Reflection factors of sound pressure at walls, with the time convention ``exp(+jωt)``."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clsim.arrays import Floats

AIR_DENSITY = 1.204  # kg/m³, of dry air at 20 °C and 1 atm
_VISCOSITY = 1.51e-5  # m²/s, kinematic, of air at 20 °C and 1 atm
_PRANDTL = 0.71  # of air
_HEAT_RATIO = 1.40  # of air


def reflection_from_absorption(alpha: ArrayLike) -> Floats:
    """Return the reflection factor of sound pressure of a wall that absorbs a share of the energy.

    ``R = sqrt(1 - α)``: H. Kuttruff, "Room Acoustics", 5th ed. 2009, section 2.1. It holds for a plane wave at the
    angle for which α is given; tabulated values are mostly means over all angles.
    """
    factor: Floats = np.sqrt(1.0 - np.asarray(alpha, dtype=np.float64))
    return factor


def reflection_from_impedance(impedance: ArrayLike, cosine: ArrayLike = 1.0) -> NDArray[np.complex128]:
    """Return the reflection factor of plane waves on a locally reacting wall.

    impedance: specific impedance at normal incidence over that of air, ``ζ = Z / (ρ c)``; its real part is at least 0.

    ``R = (ζ cos θ - 1) / (ζ cos θ + 1)``: H. Kuttruff, "Room Acoustics", 5th ed. 2009, section 2.3. For plane waves,
    and walls in which sound does not travel along the surface.

    >>> reflection_from_impedance([3.0, 3.0], [1.0, 1 / 3]).real.tolist()
    [0.5, 0.0]
    """
    seen = np.asarray(impedance, dtype=np.complex128) * np.asarray(cosine, dtype=np.float64)
    return np.asarray((seen - 1.0) / (seen + 1.0))


def mismatch_reflection(density: float, sound_speed: float, speed_of_sound: float) -> float:
    """Return the reflection factor of a thick solid at normal incidence.

    ``R = (Z - ρ c) / (Z + ρ c)`` with ``Z`` the product of the solid's density and sound speed: L. E. Kinsler, A. R.
    Frey, A. B. Coppens and J. V. Sanders, "Fundamentals of Acoustics", 4th ed. 2000, section 6.2 (one fluid on another;
    section 6.6 for solids). Normal incidence on a half-space: no layers, no plate resonances, no coincidence.

    >>> round(mismatch_reflection(2500.0, 5600.0, 343.2), 5)  # glass
    0.99994
    """
    ratio = density * sound_speed / (AIR_DENSITY * speed_of_sound)
    return (ratio - 1.0) / (ratio + 1.0)


def boundary_layer_admittance(frequency: ArrayLike, cosine: ArrayLike, speed_of_sound: float) -> NDArray[np.complex128]:
    """Return the specific admittance, times ``ρ c``, that a smooth rigid wall has by viscosity and heat conduction.

    ``β = (1 + j) / 2 · k δ (sin² θ + (γ - 1) / sqrt(Pr))`` with the viscous depth ``δ = sqrt(2 ν / ω)``: the boundary
    condition of M. Berggren, A. Bernland and D. Noreland, "Acoustic boundary layers as boundary conditions", J. Comput.
    Phys. 371, 633-650, 2018, for a plane wave on a plane wall that stays at its temperature; also A. D. Pierce,
    "Acoustics", 1981, section 10-4, "Acoustic boundary-layer theory". Air of 20 °C. It holds while ``k δ`` is far below
    1 (0.008 at 40 kHz) and below cos θ.
    """
    f, cosine = np.asarray(frequency, dtype=np.float64), np.asarray(cosine, dtype=np.float64)
    depth = np.sqrt(_VISCOSITY / (np.pi * f))
    layers = (1.0 - cosine**2) + (_HEAT_RATIO - 1.0) / np.sqrt(_PRANDTL)
    return np.asarray((0.5 + 0.5j) * (2.0 * np.pi * f / speed_of_sound) * depth * layers)


def limp_transmission(
    surface_mass: float, frequency: ArrayLike, cosine: ArrayLike, speed_of_sound: float
) -> NDArray[np.complex128]:
    """Return the transmission factor of sound pressure of a thin limp panel, by the mass law.

    ``T = 1 / (1 + j ω m cos θ / (2 ρ c))`` with the surface mass m in kg/m²: F. Fahy and P. Gardonio, "Sound and
    Structural Vibration", 2nd ed. 2007, section 5.3. Its reflection factor is ``1 - T``, so that a limp panel absorbs
    nothing. It holds for plates far below their coincidence frequency, and without their resonances.

    >>> abs(limp_transmission(10.0, 500.0, 1.0, 343.2)).round(4).item()
    0.0263
    """
    f, cosine = np.asarray(frequency, dtype=np.float64), np.asarray(cosine, dtype=np.float64)
    return np.asarray(1.0 / (1.0 + 1j * np.pi * f * surface_mass * cosine / (AIR_DENSITY * speed_of_sound)))


def coherent_share(rms: float, frequency: ArrayLike, cosine: ArrayLike, speed_of_sound: float) -> Floats:
    """Return the factor of sound pressure by which roughness weakens the specular reflection.

    ``exp(-2 (k σ cos θ)²)``: J. A. Ogilvy, "Theory of Wave Scattering from Random Rough Surfaces", 1991, chapter 4, for
    heights with a normal distribution, slopes below 1 and roughness without shadows (Kirchhoff's approximation:
    features at least about a wavelength long; finer ones take away less). What is lost is scattered to other
    directions: half of the energy where ``k σ cos θ`` is 0.42, 98 % where it is 1.

    >>> coherent_share(0.5e-3, 40e3, 1.0, 343.2).round(3).item()
    0.765
    """
    k = 2.0 * np.pi * np.asarray(frequency, dtype=np.float64) / speed_of_sound
    return np.asarray(np.exp(-2.0 * (k * rms * np.asarray(cosine, dtype=np.float64)) ** 2))


def porous_medium(
    frequency: ArrayLike, flow_resistivity: float
) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """Return the equivalent fluid of a fibrous absorber.

    impedance, index: complex characteristic impedance over that of air, and wavenumber over that of air.

    With ``X = f / σ`` in m³/kg, ``1 + 0.070 X^-0.632 - 0.107j X^-0.632`` and ``1 + 0.109 X^-0.618 - 0.160j X^-0.618``:
    Y. Miki, "Acoustical properties of porous materials - modifications of Delany-Bazley models", J. Acoust. Soc. Jpn.
    (E) 11 (1), 19-24, 1990; both are equation 1 of the page "Delany-Bazley-Miki model" in L. Jaouen, "Acoustical Porous
    Material Recipes", apmr.matelys.com, there by 1000 X. Fitted to fibres of high porosity with X from 0.01 to 1.
    """
    X = np.asarray(frequency, dtype=np.float64) / flow_resistivity
    return np.asarray(1.0 + (0.070 - 0.107j) * X**-0.632), np.asarray(1.0 + (0.109 - 0.160j) * X**-0.618)


def backed_layer_reflection(
    impedance: ArrayLike, index: ArrayLike, phase: ArrayLike, cosine: ArrayLike
) -> NDArray[np.complex128]:
    """Return the reflection factor of a fluid layer on a rigid wall.

    impedance, index: complex characteristic impedance and wavenumber of the layer, over those of air.

    Plane waves are refracted into the layer (it reacts laterally too): ``q = sqrt(n² - sin² θ)``, seen impedance ``Z n
    / q``, ``R = (Γ + e) / (1 + Γ e)`` with ``Γ = (Z n cos θ / q - 1) / (Z n cos θ / q + 1)`` and ``e = exp(-2j k d
    q)``: the closed form of J. F. Allard and N. Atalla, "Propagation of Sound in Porous Media", 2nd ed. 2009, chapter 3
    (there by cotangents). For plane waves, and a frame that does not move.
    """
    n, cosine = np.asarray(index, dtype=np.complex128), np.asarray(cosine, dtype=np.float64)
    q = np.sqrt(n**2 - (1.0 - cosine**2))
    face = reflection_from_impedance(np.asarray(impedance) * n / q, cosine)
    travelled = np.exp(-2j * np.asarray(phase) * q)
    return np.asarray((face + travelled) / (1.0 + face * travelled))
