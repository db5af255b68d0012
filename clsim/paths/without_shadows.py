"""What is wrong without shadows on echoes: scatterers that stand in the way of reflections, at a few instants."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from clsim.errors import warn
from clsim.scene.scene import known_until

if TYPE_CHECKING:
    from clsim.arrays import Floats
    from clsim.paths.path_set import PathSet

_INSTANTS = np.linspace(0.0, 1.0, 9)  # of the known time
_MOST = 4096  # paths that are looked at, at most


def warn_without_shadows(paths: PathSet, scattering_order: int) -> None:
    """Warn of the first scatterer with a shadow that stands in an echo of more than `scattering_order` walls.

    It stands there if the path passes its centre within the least of its semi-axes.
    """
    scene = paths.scene
    casting = [scatterer for scatterer in scene.scatterers if scatterer.shape.shadows]
    echoes = next((family for family in paths.families if family.is_specular), None)
    if not casting or echoes is None or not np.any(high := echoes.order > scattering_order):
        return
    until = known_until([*scene.named_ends(), *scene.named_scatterers()])
    for time in (until * (_INSTANTS if until > 0.0 else _INSTANTS[:1])).tolist():
        rows = np.flatnonzero(high & (echoes.start <= time) & (echoes.end > time))[:_MOST]
        places = echoes.vertices(rows, time)
        for scatterer in casting:
            centre, least = scatterer.trajectory.position(np.array([time]))[0], float(np.min(scatterer.shape.semi_axes))
            if len(rows) and _apart(places, centre) < least:
                warn(
                    f"{scatterer.name!r} stands in the way of echoes at {time:.3g} s and casts no shadow on them: "
                    f"scattering_order is {scattering_order}, and echoes of N walls have shadows from N on"
                )
                return


def _apart(places: Floats, centre: Floats) -> float:
    """Least distance of a point from paths by places (P, N, 3), m, NaN beyond the receiver."""
    begin, along = places[:, :-1], np.diff(places, axis=1)
    squared = np.sum(along**2, axis=2)
    share = np.clip(np.sum((centre - begin) * along, axis=2) / np.where(squared > 0.0, squared, 1.0), 0.0, 1.0)
    return float(np.nanmin(np.linalg.norm(begin + share[..., None] * along - centre, axis=2)))
