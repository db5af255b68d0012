"""Walls whose factors follow from physics: hard smooth solids and fibrous absorbers."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.acoustics.reflection import (
    backed_layer_reflection,
    boundary_layer_admittance,
    mismatch_reflection,
    porous_medium,
    reflection_from_impedance,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Floats

MIKI_RANGE = (0.01, 1.0)  # m³/kg, of frequency over flow resistivity


@dataclass(frozen=True, slots=True)
class SolidWall:
    """A thick smooth solid: density in kg/m³, sound speed in m/s, and whether the air's boundary layer takes its part.

    The mismatch of impedances at normal incidence is taken at all angles. Beyond some 10 degrees nothing at all can
    be transmitted into a hard solid, so this takes away too much there: less than 2e-4 of the pressure for concrete.
    """

    density: float
    sound_speed: float
    boundary_layer: bool

    band = (0.0, math.inf)
    beyond = ""

    @property
    def is_complex(self) -> bool:
        """Whether factors have a phase: the boundary layer's."""
        return self.boundary_layer

    @property
    def depends_on_angle(self) -> bool:
        """Whether factors depend on the angle: the boundary layer's do."""
        return self.boundary_layer

    def factor(self, frequency: Floats, cosine: Floats, speed_of_sound: float) -> NDArray[Any]:
        """Return factors by frequency and angle."""
        mismatch = mismatch_reflection(self.density, self.sound_speed, speed_of_sound)
        if not self.boundary_layer:
            return np.full(frequency.shape, mismatch)
        beta = boundary_layer_admittance(frequency, cosine, speed_of_sound)
        return mismatch * reflection_from_impedance(1.0 / beta, cosine)

    def describe(self) -> str:
        """Return what it is."""
        return f"solid of {self.density:g} kg/m³ and {self.sound_speed:g} m/s"


@dataclass(frozen=True, slots=True)
class PorousLayer:
    """A fibrous absorber on a rigid wall, by Miki: flow resistivity in Pa s/m², thickness in m."""

    flow_resistivity: float
    thickness: float
    outside: str | None

    beyond = ""
    is_complex = True
    depends_on_angle = True

    @property
    def band(self) -> tuple[float, float]:
        """Where the formula was fitted, or everywhere by name."""
        if self.outside == "extend":
            return 0.0, math.inf
        return MIKI_RANGE[0] * self.flow_resistivity, MIKI_RANGE[1] * self.flow_resistivity

    def factor(self, frequency: Floats, cosine: Floats, speed_of_sound: float) -> NDArray[Any]:
        """Return complex factors by frequency and angle."""
        phase = 2.0 * math.pi * frequency / speed_of_sound * self.thickness
        return backed_layer_reflection(*porous_medium(frequency, self.flow_resistivity), phase, cosine)

    def describe(self) -> str:
        """Return what it is."""
        return f"porous layer of {1e3 * self.thickness:g} mm and {self.flow_resistivity:g} Pa s/m²"
