"""Transmission factors of thin panels: a limp sheet by the mass law, or a table of transmission losses."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.acoustics.reflection import limp_transmission
from clsim.arrays import as_floats, as_number
from clsim.errors import InputError
from clsim.scene.material.tabulated import checked_frequencies, over_octaves

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import ArrayLike, NDArray

    from clsim.arrays import Floats

_LIGHTEST, _HEAVIEST = 1e-3, 1e5  # kg/m²
_MOST_LOSS = 300.0  # dB


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
        return np.asarray(10.0 ** (-_curve(self)(frequency) / 20.0))

    def describe(self) -> str:
        return "table of transmission losses"


TransmissionModel = MassLaw | LossTable


@lru_cache(maxsize=256)
def _curve(table: LossTable) -> Callable[[Floats], NDArray[Any]]:
    return over_octaves(table.frequencies, table.losses_db)


def as_transmission(
    surface_mass: float | None, frequencies: ArrayLike | None, losses_db: ArrayLike | None
) -> TransmissionModel:
    """Make the model of a panel from its surface mass, kg/m², or from a table of losses, dB."""
    if surface_mass is not None and frequencies is None and losses_db is None:
        return MassLaw(as_number("surface_mass", surface_mass, at_least=_LIGHTEST, at_most=_HEAVIEST, unit="kg/m²"))
    if surface_mass is not None or frequencies is None or losses_db is None:
        raise InputError("transmission", "must have surface_mass, or frequencies and losses_db")
    f = checked_frequencies(frequencies)
    losses = as_floats("losses_db", losses_db, (len(f),))
    for i in np.flatnonzero((losses < 0.0) | (losses > _MOST_LOSS))[:1]:
        raise InputError(f"losses_db[{i}]", f"must be from 0 to {_MOST_LOSS:g} dB, but is {losses[i]:g} dB")
    return LossTable(f, losses)
