"""How loud a source or receiver is in each direction."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Protocol, runtime_checkable

import numpy as np

from clsim.acoustics.directivity import first_order_gain, piston_gain
from clsim.arrays import Floats, as_choice, as_number
from clsim.scene.directivity.axial_table import AxialDirectivity

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

# Murata states 80° between the -6 dB points at 40 kHz for both: the beam of a baffled piston of this radius.
_NAMED_RADIUS = {"MA40S4S": 0.0047, "MA40S4R": 0.0047}  # m

# Nicera, T4010A1: directivity at 40 kHz as published, 0 to 90 degrees in steps of 10.
_NICERA_FREQUENCY = 40e3  # Hz
_NICERA_ANGLES = np.arange(0.0, 91.0, 10.0)  # degrees
_NICERA_DB = np.array([0.0, 0.0, 0.0, -1.0, -3.0, -6.0, -9.0, -12.0, -14.0, -15.0])

DIRECTIVITY_NAMES = (*_NAMED_RADIUS, "T4010A1")
_EVERYWHERE = (0.0, math.inf)


@runtime_checkable
class AxialPattern(Protocol):
    """Anything with a gain by the angle from its axis."""

    @property
    def is_complex(self) -> bool:
        """Whether gains have a phase."""
        ...

    @property
    def band(self) -> tuple[float, float]:
        """Frequencies (low, high) in Hz at which the gain is known."""
        ...

    def gain(self, cosine: Floats, frequency: ArrayLike, speed_of_sound: float) -> NDArray[Any]:
        """Return the gain of sound pressure by direction, 1 on the axis unless its table says otherwise.

        Parameters
        ----------
        cosine : ndarray (...)
            Cosine of the angle between the axis (+x, turned by the orientation) and the direction: of
            departure for a source, towards the incoming image for a receiver.
        frequency : array_like (...)
            Frequency, Hz; broadcasts against `cosine`.
        speed_of_sound : float
            Speed of sound, m/s.

        Returns
        -------
        ndarray (...)
            Gain, 1: float64, or complex128 if `is_complex` (``exp(+j 2 pi f t)``: a delay has falling phase).

        Raises
        ------
        InputError
            If a frequency lies outside `band`.
        """
        ...


@runtime_checkable
class DirectionalPattern(Protocol):
    """Anything with a gain by direction that differs round its axis."""

    @property
    def is_complex(self) -> bool:
        """Whether gains have a phase."""
        ...

    @property
    def band(self) -> tuple[float, float]:
        """Frequencies (low, high) in Hz at which the gain is known."""
        ...

    def gain_towards(self, direction: Floats, frequency: ArrayLike, speed_of_sound: float) -> NDArray[Any]:
        """Return the gain of sound pressure by direction.

        Parameters
        ----------
        direction : ndarray (..., 3)
            Unit vectors in the transducer's own frame (axis +x, up +z; the orientation turns it into the world): of
            departure for a source, towards the incoming image for a receiver.
        frequency : array_like (...)
            Frequency, Hz; broadcasts against `direction` without its last axis.
        speed_of_sound : float
            Speed of sound, m/s.

        Returns
        -------
        ndarray (...)
            Gain, 1: float64, or complex128 if `is_complex` (``exp(+j 2 pi f t)``).

        Raises
        ------
        InputError
            If a frequency lies outside `band`.
        """
        ...


Directivity = AxialPattern | DirectionalPattern


@dataclass(frozen=True, slots=True)
class Omni:
    """The same in every direction.

    Examples
    --------
    >>> Omni().gain(np.array([1.0, -1.0]), 40e3, 343.0).tolist()
    [1.0, 1.0]
    """

    kind: ClassVar[str] = "omni"
    is_complex: ClassVar[bool] = False
    band: ClassVar[tuple[float, float]] = _EVERYWHERE

    def gain(self, cosine: Floats, frequency: ArrayLike, speed_of_sound: float) -> Floats:
        """Return 1 for every direction; see `Directivity.gain`."""
        return np.ones_like(cosine, dtype=np.float64)


@dataclass(frozen=True, slots=True)
class FirstOrder:
    """A first-order pattern, ``weight + (1 - weight) cos θ``.

    Parameters
    ----------
    weight : float
        Share of the omnidirectional part, 0 to 1: 0.5 cardioid, 0.25 hypercardioid, 0 figure of eight.

    Raises
    ------
    InputError
        If the weight is out of bounds.

    Examples
    --------
    >>> FirstOrder(0.5).gain(np.array([1.0, 0.0, -1.0]), 1e3, 343.0).tolist()
    [1.0, 0.5, 0.0]
    """

    kind: ClassVar[str] = "cardioid"
    is_complex: ClassVar[bool] = False
    band: ClassVar[tuple[float, float]] = _EVERYWHERE
    weight: float = 0.5

    def __post_init__(self) -> None:
        object.__setattr__(self, "weight", as_number("weight", self.weight, at_least=0.0, at_most=1.0))

    def gain(self, cosine: Floats, frequency: ArrayLike, speed_of_sound: float) -> Floats:
        """Return the gain, the same at every frequency; see `Directivity.gain`."""
        return first_order_gain(cosine, self.weight)


@dataclass(frozen=True, slots=True)
class Piston:
    """A round piston in a baffle, ``2 J1(ka sin θ) / (ka sin θ)``.

    Behind the baffle the gain at 90° is kept: the formula says nothing there, and the gain has no step.

    Parameters
    ----------
    radius : float
        Radius of the piston, m.

    Raises
    ------
    InputError
        If the radius is not positive.

    Examples
    --------
    >>> beam = Piston(0.0047).gain(np.cos(np.radians([0.0, 40.0])), 40e3, 344.0)
    >>> (20 * np.log10(beam)).round(1).tolist()
    [0.0, -6.0]
    """

    kind: ClassVar[str] = "piston"
    is_complex: ClassVar[bool] = False
    band: ClassVar[tuple[float, float]] = _EVERYWHERE
    radius: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "radius", as_number("radius", self.radius, at_least=1e-6, at_most=1e3, unit="m"))

    def gain(self, cosine: Floats, frequency: ArrayLike, speed_of_sound: float) -> Floats:
        """Return the gain; see `Directivity.gain`."""
        return piston_gain(cosine, frequency, self.radius, speed_of_sound)


def named_directivity(name: str, outside: str | None = None) -> AxialPattern:
    """Return the directivity of a transducer by its name.

    Parameters
    ----------
    name : {"MA40S4S", "MA40S4R", "T4010A1"}
        Murata's open 40 kHz transmitter and receiver: each is the baffled piston of 4.7 mm radius, which has
        the 80° between -6 dB points that the maker states at 40 kHz. It is an equivalent piston, not a
        measurement: side lobes, rear and other frequencies are the formula's.
        Nicera's 40 kHz transmitter: the published levels at 40 kHz in steps of 10° up to 90°, the last of them
        (-15 dB) kept behind. They are nominal, read to whole dB, and have no phase.
    outside : {None, "hold"}
        What a table (T4010A1) gives at other frequencies than its own: refused (None), or the same.

    Returns
    -------
    Directivity
        A `Piston` or a `AxialDirectivity`.

    Raises
    ------
    InputError
        If the name is unknown.

    Examples
    --------
    >>> named_directivity("MA40S4S")
    Piston(radius=0.0047)
    >>> gain = named_directivity("T4010A1").gain(np.cos(np.radians([0.0, 50.0])), 40e3, 343.0)
    >>> (20 * np.log10(gain)).round(3).tolist()
    [0.0, -6.0]
    """
    if outside is not None:
        as_choice("outside", outside, ("hold",))
    if as_choice("name", name, DIRECTIVITY_NAMES) in _NAMED_RADIUS:
        return Piston(_NAMED_RADIUS[name])
    return AxialDirectivity.from_db(
        _NICERA_ANGLES, [_NICERA_FREQUENCY], _NICERA_DB[:, None], rear="hold", outside=outside, name=name
    )
