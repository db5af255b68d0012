"""Directivities by formulae: omnidirectional, of first order, of a piston; and those of ambisonic microphones."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clsim.acoustics.directivity import first_order_gain, piston_gain
from clsim.arrays import Floats, as_choice, as_count, as_number
from clsim.errors import InputError, settle
from clsim.numerics.sphere import real_harmonics
from clsim.scene.directivity.axial_table import AxialDirectivity
from clsim.scene.directivity.directivity import NAMED, AxisymmetricDirectivity, ChannelDirectivity

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
        settle(self, order=as_count("order", self.order, at_least=0, at_most=HIGHEST))

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


# Murata states 80° between the -6 dB points at 40 kHz for both: the directivity of a baffled piston of this radius.
_MURATA_RADIUS = 0.0047  # m

# Nicera, T4010A1: directivity at 40 kHz as published, 0 to 90 degrees in steps of 10.
_NICERA_DB = np.array([0.0, 0.0, 0.0, -1.0, -3.0, -6.0, -9.0, -12.0, -14.0, -15.0])

_EVERYWHERE = (0.0, math.inf)
_LARGEST_RADIUS = 1.0  # m, beyond which no room is in a piston's far field


@dataclass(frozen=True, slots=True)
class Omni(AxisymmetricDirectivity):
    """The same in every direction.

    Examples
    --------
    >>> Omni().gain(np.array([1.0, -1.0]), 40e3, 343.0).tolist()
    [1.0, 1.0]
    """

    is_complex: ClassVar[bool] = False
    band: ClassVar[tuple[float, float]] = _EVERYWHERE

    def gain(self, cosine: Floats, frequency: ArrayLike, speed_of_sound: float) -> Floats:
        """Return 1 for every direction; see `AxisymmetricDirectivity.gain`."""
        return np.ones_like(cosine, dtype=np.float64)


@dataclass(frozen=True, slots=True)
class FirstOrder(AxisymmetricDirectivity):
    """A first-order pattern, ``weight + (1 - weight) cos θ``.

    Parameters
    ----------
    weight : float
        Share of the omnidirectional part, 0 to 1: 0.5 cardioid, 0.25 hypercardioid, 0 figure of eight.

    Examples
    --------
    >>> FirstOrder(0.5).gain(np.array([1.0, 0.0, -1.0]), 1e3, 343.0).tolist()
    [1.0, 0.5, 0.0]
    """

    is_complex: ClassVar[bool] = False
    band: ClassVar[tuple[float, float]] = _EVERYWHERE
    weight: float = 0.5

    def __post_init__(self) -> None:
        settle(self, weight=as_number("weight", self.weight, at_least=0.0, at_most=1.0))

    def gain(self, cosine: Floats, frequency: ArrayLike, speed_of_sound: float) -> Floats:
        """Return the gain, the same at every frequency; see `AxisymmetricDirectivity.gain`."""
        return first_order_gain(cosine, self.weight)


@dataclass(frozen=True, slots=True)
class Piston(AxisymmetricDirectivity):
    """A round piston in a baffle, ``2 J1(ka sin θ) / (ka sin θ)``.

    Behind the baffle the gain at 90° is kept: the formula says nothing there, and the gain has no step.

    Parameters
    ----------
    radius : float
        Radius of the piston, m; at most 1.

    Examples
    --------
    >>> gain = Piston(0.0047).gain(np.cos(np.radians([0.0, 40.0])), 40e3, 344.0)
    >>> (20 * np.log10(gain)).round(1).tolist()
    [0.0, -6.0]
    """

    is_complex: ClassVar[bool] = False
    band: ClassVar[tuple[float, float]] = _EVERYWHERE
    radius: float

    def __post_init__(self) -> None:
        radius = as_number("radius", self.radius, at_least=1e-6, unit="m")
        if radius > _LARGEST_RADIUS:
            problem = f"must be at most {_LARGEST_RADIUS:g} m, but is {radius:g} m; lengths are in metres: "
            raise InputError("radius", f"{problem}{radius:g} mm are {1e-3 * radius:g} m")
        settle(self, radius=radius)

    def gain(self, cosine: Floats, frequency: ArrayLike, speed_of_sound: float) -> Floats:
        """Return the gain; see `AxisymmetricDirectivity.gain`."""
        return piston_gain(cosine, frequency, self.radius, speed_of_sound)


_NICERA = np.arange(0.0, 91.0, 10.0), [40e3], _NICERA_DB[:, None]  # degrees, Hz
for _name in ("MA40S4S", "MA40S4R"):
    NAMED[_name] = lambda outside: Piston(_MURATA_RADIUS)
NAMED["T4010A1"] = lambda outside: AxialDirectivity.from_db(*_NICERA, rear="hold", outside=outside, name="T4010A1")
