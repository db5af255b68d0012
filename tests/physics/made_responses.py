"""Beams and walls that have a phase, no symmetry, or an angle: written down here, independent of clsim's own."""

from dataclasses import dataclass

import numpy as np

import clsim


@dataclass(frozen=True)
class OffCentre:
    """A cardioid-like beam that radiates from a point `ahead` (m) of where it is said to be."""

    ahead: float
    is_complex = True
    band = (0.0, float("inf"))

    def gain(self, cosine, frequency, speed_of_sound):
        turns = np.asarray(frequency) * self.ahead * cosine / speed_of_sound
        return (0.7 + 0.3 * cosine) * np.exp(2j * np.pi * turns)


@dataclass(frozen=True)
class Lopsided:
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


class Porous(clsim.Material):
    """A wall of a complex specific impedance that falls with frequency: its factor depends on the angle."""

    def __init__(self) -> None:
        super().__init__(0.5, "porous")

    is_complex = property(lambda self: True)
    depends_on_angle = property(lambda self: True)

    def reflection_at(self, frequency, cosine=1.0, speed_of_sound=343.2):
        zeta = 3.0 + 2.0j - 1.5j * np.asarray(frequency) / 40e3
        return (zeta * cosine - 1.0) / (zeta * cosine + 1.0)


class Rough(clsim.Material):
    """A hard wall whose roughness takes from what it reflects straight on; real."""

    def __init__(self) -> None:
        super().__init__(0.5, "rough")

    depends_on_angle = property(lambda self: True)

    def reflection_at(self, frequency, cosine=1.0, speed_of_sound=343.2):
        return -0.95 * np.exp(-2.0 * (2 * np.pi * np.asarray(frequency) / speed_of_sound * 0.4e-3 * cosine) ** 2)
