"""The ground truth beside the sound: what every path does over time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

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
        Indices in the scene, and number of reflections.
    walls : ndarray (P, max_order) int
        Walls from the source's side, filled up with -1.
    direct : ndarray (P,) bool
        Whether it is the direct path.
    delay : ndarray (P, T)
        From emission to reception, s; NaN while the path is not heard.
    doppler_factor : ndarray (P, T)
        Received over emitted frequency.
    gain : ndarray (P, T)
        Received over emitted pressure at the signal's centre frequency, signed; complex where a wall or beam is.
    departure, arrival : ndarray (P, T, 3)
        Unit vectors: from the source along the path, and from the receiver back along it.
    source_names, receiver_names, wall_names : tuple of str
        What the indices mean.
    """

    times: Floats
    source: NDArray[np.int32]
    receiver: NDArray[np.int32]
    order: NDArray[np.int32]
    walls: NDArray[np.signedinteger[Any]]
    direct: NDArray[np.bool_]
    delay: Floats
    doppler_factor: Floats
    gain: Floats | Complexes
    departure: Floats
    arrival: Floats
    source_names: tuple[str, ...]
    receiver_names: tuple[str, ...]
    wall_names: tuple[str, ...]

    @property
    def heard(self) -> NDArray[np.bool_]:
        """Whether anything arrives (P, T): the path is there, and its gain is not 0."""
        return np.asarray(np.isfinite(self.delay) & (self.gain != 0.0))
