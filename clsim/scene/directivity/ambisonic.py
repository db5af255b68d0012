"""Directivities of ambisonic microphones: spherical harmonics about one place."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clsim.arrays import Floats, as_choice, as_count
from clsim.numerics.sphere import real_harmonics
from clsim.scene.directivity.directivity import ChannelDirectivity

HIGHEST = 7  # order
NORMALIZATIONS = ("SN3D", "N3D")


@dataclass(frozen=True, slots=True)
class Ambisonic(ChannelDirectivity):
    """Ideal ambisonic components: real spherical harmonics of the direction of arrival, at every frequency alike.

    Parameters
    ----------
    order : int
        0 to 7; there are ``(order + 1)²`` channels in ACN order.
    normalization : {"SN3D", "N3D"}
        Normalization of the harmonics: SN3D as in AmbiX files, or N3D, larger by ``sqrt(2 l + 1)`` at degree l.

    Examples
    --------
    >>> Ambisonic(1).gain_towards(np.array([1.0, 0.0, 0.0]), 1e3, 343.0).tolist()
    [1.0, 0.0, 0.0, 1.0]
    """

    is_complex: ClassVar[bool] = False
    band: ClassVar[tuple[float, float]] = (0.0, math.inf)
    order: int = 1
    normalization: str = "SN3D"

    def __post_init__(self) -> None:
        as_choice("normalization", self.normalization, NORMALIZATIONS)
        object.__setattr__(self, "order", as_count("order", self.order, at_least=0, at_most=HIGHEST))

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the channels, ``"ACN0"`` and so on."""
        return tuple(f"ACN{i}" for i in range((self.order + 1) ** 2))

    @property
    def is_flat(self) -> bool:
        """Components have no frequency."""
        return True

    @property
    def scale(self) -> Floats:
        """Factor of each channel over SN3D, (C,)."""
        degrees = np.floor(np.sqrt(np.arange((self.order + 1) ** 2)))
        return np.sqrt(2.0 * degrees + 1.0) if self.normalization == "N3D" else np.ones_like(degrees)

    def gain_towards(self, direction: Floats, frequency: ArrayLike, speed_of_sound: float) -> NDArray[Any]:
        """Return the gain of each channel; see `Directivity.gain_towards`."""
        gain = real_harmonics(self.order, direction) * self.scale
        shape = np.broadcast_shapes(gain.shape[:-1], np.shape(frequency))
        return np.broadcast_to(gain, (*shape, gain.shape[-1]))
