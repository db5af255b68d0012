"""What walls absorb and scatter in a diffuse field."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from clsim.scene.room.shoebox import enclosure_of

if TYPE_CHECKING:
    from clsim.arrays import Floats
    from clsim.scene.scene import Scene

_ANGLES = 32  # over which absorption is averaged


@dataclass(frozen=True, slots=True, eq=False)
class DiffuseField:
    """A closed room in which energy arrives from all directions alike, at F frequencies."""

    volume: float  # m³
    surface: float  # m²
    absorption_area: Floats  # (F,) m²
    scattered: Floats  # (F,) share of what is reflected that leaves the mirror's direction
    air: Floats  # (F,) absorption of energy, 1/m

    @classmethod
    def of(cls, scene: Scene, frequencies: Floats) -> DiffuseField | None:
        """Average a scene's walls over angles of incidence; None in a room that is not closed."""
        volume, area, materials = enclosure_of(scene.room)
        if volume is None:
            return None
        c, surface = scene.air.speed_of_sound, float(area.sum())
        # Gauss's rule over the squared sine of the angle of incidence, as which a diffuse field is spread.
        places, weights = np.polynomial.legendre.leggauss(_ANGLES)
        cosine, weights = np.sqrt(0.5 * (1.0 - places))[:, None], 0.5 * weights
        absorbed, scattered = np.zeros((2, len(frequencies)))
        for material in dict.fromkeys(materials):
            mine = float(area[[m is material for m in materials]].sum())
            at = np.clip(frequencies, *material.band)
            shape = len(cosine), len(frequencies)
            met = cosine if material.depends_on_angle else 1.0
            absorbed += mine * (weights @ np.broadcast_to(1.0 - material.energy_at(at, met, c), shape))
            scattered += mine / surface * (weights @ np.broadcast_to(material.scattered_share(at, cosine, c), shape))
        air = scene.air.absorption_at(frequencies) * (math.log(10.0) / 10.0)
        return cls(volume, surface, absorbed, scattered, air)

    def left_db(self, max_order: int) -> Floats:
        """Energy that images up to an order leave, dB re all but the direct sound's (F,): a geometric series."""
        path = 4.0 * self.volume / self.surface
        kept = (1.0 - np.minimum(self.absorption_area / self.surface, 1.0)) * np.exp(-self.air * path)
        mirrored = kept * (1.0 - self.scattered)
        with np.errstate(divide="ignore", invalid="ignore"):
            of_images = (1.0 - mirrored**max_order) * mirrored / (1.0 - mirrored)
            left = 1.0 - of_images * (1.0 - kept) / kept
        return np.asarray(10.0 * np.log10(np.clip(np.nan_to_num(left), 1e-30, 1.0)))
