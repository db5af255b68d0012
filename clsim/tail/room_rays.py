"""The energy that walls reflect, by angle and band."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from clsim.paths.response import NEPERS, covered

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Floats
    from clsim.scene.scene import Scene

ANGLES = 128  # cells of the root of the cosine of incidence


@dataclass(frozen=True, slots=True, eq=False)
class WallEnergies:
    """Energy sent back by kind of wall, angle and band."""

    kind: NDArray[np.int64]  # (walls,) of which material each wall is
    returned: Floats  # (kinds, angles, B) share of energy that comes back
    scattered: Floats  # (kinds, angles, B) share of that which leaves the mirror's direction
    air: Floats  # (B,) absorption of energy by the air, 1/m

    @classmethod
    def of(cls, scene: Scene, centres: Floats) -> WallEnergies:
        """Return those of a scene's walls at frequencies (B,), Hz."""
        materials = list(dict.fromkeys(scene.room.faces.materials))
        cosine = ((np.arange(ANGLES) + 0.5) / ANGLES)[:, None] ** 2
        c = scene.air.speed_of_sound
        made = [
            (
                material.energy_at(covered(centres, material), cosine, c),
                material.scattered_share(covered(centres, material), cosine, c),
            )
            for material in materials
        ]
        kind = np.array([materials.index(material) for material in scene.room.faces.materials])
        returned, scattered = (np.array([pair[i] for pair in made]) for i in range(2))
        return cls(kind, returned, scattered, 2.0 * NEPERS * scene.air.absorption_at(centres))

    def groups(self) -> list[NDArray[np.int64]]:
        """Return groups of bands with equal scattering, whose rays take the same paths."""
        _, which = np.unique(self.scattered.reshape(-1, len(self.air)), axis=1, return_inverse=True)
        return [np.flatnonzero(which.ravel() == i) for i in range(which.max() + 1)]
