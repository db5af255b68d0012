"""Beams without symmetry or with a phase, and what walls ought to do: written down here, independent of clsim's own."""

from dataclasses import dataclass

import numpy as np

import clsim

_BAND = np.linspace(20e3, 60e3, 401)


@dataclass(frozen=True)
class OffCentre(clsim.AxisymmetricDirectivity):
    """A cardioid-like beam that radiates from a point `ahead` (m) of where it is said to be."""

    ahead: float
    is_complex = True
    band = (0.0, float("inf"))

    def gain(self, cosine, frequency, speed_of_sound):
        turns = np.asarray(frequency) * self.ahead * cosine / speed_of_sound
        return (0.7 + 0.3 * cosine) * np.exp(2j * np.pi * turns)


@dataclass(frozen=True)
class Lopsided(clsim.Directivity):
    """A beam without any symmetry: different to the left, above and ahead, and not centred either; or real."""

    is_complex: bool = True
    band: tuple[float, float] = (0.0, float("inf"))

    def gain_towards(self, direction, frequency, speed_of_sound):
        x, y, z = np.moveaxis(np.asarray(direction, dtype=np.float64), -1, 0)
        loud = (0.6 + 0.3 * x + 0.25 * y - 0.2 * z + 0.15 * x * y) * (np.asarray(frequency) / 40e3) ** (0.3 * y)
        if not self.is_complex:
            return loud
        turns = np.asarray(frequency) * (1.0e-3 * x - 1.5e-3 * y + 0.7e-3 * z) / speed_of_sound
        return loud * np.exp(2j * np.pi * turns)


def porous_factor(frequency, cosine):
    """Return the reflection of a wall of a complex specific impedance that changes with frequency."""
    zeta = 3.0 + 2.0j - 1.5j * np.asarray(frequency) / 40e3
    return (zeta * cosine - 1.0) / (zeta * cosine + 1.0)


def rough_factor(frequency, cosine, speed_of_sound):
    """Return the reflection factor of a rough pressure-release wall at normal incidence; real."""
    return -0.95 * np.exp(-2.0 * (2 * np.pi * np.asarray(frequency) / speed_of_sound * 0.4e-3 * cosine) ** 2)


POROUS = clsim.Material.from_impedance(_BAND, 3.0 + 2.0j - 1.5j * _BAND / 40e3, outside="hold", name="porous")
ROUGH = clsim.Material.from_reflection(-0.95).rough(0.4e-3)
