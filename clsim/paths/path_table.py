"""The ground truth beside the sound: what every path does over time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.paths.family import SPECULAR

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Complexes, Floats


@dataclass(frozen=True, slots=True, eq=False)
class PathTable:
    """Delay, Doppler factor, gain and directions of P paths at T times.

    Attributes
    ----------
    times : ndarray (T,)
        Times of reception, s.
    source, receiver, order : ndarray (P,) int
        Indices in the scene, and number of interactions.
    interactions : ndarray (P, N) int
        What happens on the way from the source: 0 specular reflection, 1 diffraction, 2 scattering; filled up with -1.
    objects : ndarray (P, N) int
        Where it happens, of `object_names`, of which the walls are the first; filled up with -1.
    direct : ndarray (P,) bool
        Whether it is the direct path.
    delay : ndarray (P, T)
        From emission to reception, s; NaN while the path is not heard. In air that disperses that of what sounds about
        the centre frequency of the source's signal, the group delay.
    doppler_factor : ndarray (P, T)
        Received over emitted frequency; in air that disperses of the centre frequency.
    doppler_shift : ndarray (P, T)
        Received less emitted frequency at the centre frequency of the source's signal, Hz.
    gain : ndarray (P, T)
        Received over emitted pressure at the signal's centre frequency but for the delay, signed; complex where walls,
        directivities or air have phases.
    departure, arrival : ndarray (P, T, 3)
        Unit vectors: from the source along the path, and from the receiver back along it.
    source_names, receiver_names, object_names : tuple of str
        What the indices mean.
    """

    times: Floats
    source: NDArray[np.int32]
    receiver: NDArray[np.int32]
    order: NDArray[np.int32]
    interactions: NDArray[np.signedinteger[Any]]
    objects: NDArray[np.signedinteger[Any]]
    direct: NDArray[np.bool_]
    delay: Floats
    doppler_factor: Floats
    doppler_shift: Floats
    gain: Floats | Complexes
    departure: Floats
    arrival: Floats
    source_names: tuple[str, ...]
    receiver_names: tuple[str, ...]
    object_names: tuple[str, ...]

    @property
    def walls(self) -> NDArray[np.signedinteger[Any]]:
        """Walls of reflections (P, N) from the source's side, -1 elsewhere."""
        return np.where(self.interactions == SPECULAR, self.objects, -1)

    def name_way(self, path: int | np.integer[Any]) -> str:
        """Return the names of the walls and other things that a path meets.

        Parameters
        ----------
        path : int
            Row of the table.

        Returns
        -------
        str
            Names from the source's side, joined by commas; "direct" if it meets nothing.
        """
        return ", ".join(self.object_names[i] for i in self.objects[path] if i >= 0) or "direct"

    @property
    def heard(self) -> NDArray[np.bool_]:
        """Whether anything arrives (P, T): the path is there, and its gain is not 0."""
        return np.asarray(np.isfinite(self.delay) & (self.gain != 0.0))
