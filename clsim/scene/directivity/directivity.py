"""Directivity: the gain of a source or receiver by direction and frequency."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.arrays import as_choice

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import ArrayLike, NDArray

    from clsim.arrays import Floats

_NAMED: dict[str, Callable[[str | None], AxisymmetricDirectivity]] = {}  # filled where the patterns are made


class Directivity(ABC):
    """Gain of sound pressure by direction and frequency; subclass it, or `AxisymmetricDirectivity`.

    Attributes
    ----------
    is_complex : bool
        Whether gains have a phase.
    band : tuple of float
        Frequencies (low, high) in Hz that the directivity covers; ``(0, inf)`` if all.
    """

    __slots__ = ()

    @property
    @abstractmethod
    def is_complex(self) -> bool:
        """Whether gains have a phase."""

    @property
    @abstractmethod
    def band(self) -> tuple[float, float]:
        """Frequencies (low, high) in Hz that the directivity covers."""

    @abstractmethod
    def gain_towards(self, direction: Floats, frequency: ArrayLike, speed_of_sound: float) -> NDArray[Any]:
        """Return the gain of sound pressure by direction, 1 on the axis unless its table says otherwise.

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
            Gain, 1: float64, or complex128 if `is_complex` (``exp(+j 2 pi f t)``: a delay has falling phase).

        Raises
        ------
        InputError
            If a frequency lies outside `band`.
        """

    @staticmethod
    def names() -> tuple[str, ...]:
        """Return the names that `named` takes.

        Returns
        -------
        tuple of str
            In the order in which they were given.
        """
        return tuple(_NAMED)

    @staticmethod
    def named(name: str, outside: str | None = None) -> AxisymmetricDirectivity:
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
        AxisymmetricDirectivity
            A `Piston` or an `AxialDirectivity`.

        Raises
        ------
        InputError
            If the name is unknown.

        Examples
        --------
        >>> Directivity.named("MA40S4S")
        Piston(radius=0.0047)
        >>> gain = Directivity.named("T4010A1").gain(np.cos(np.radians([0.0, 50.0])), 40e3, 343.0)
        >>> (20 * np.log10(gain)).round(3).tolist()
        [0.0, -6.0]
        """
        if outside is not None:
            as_choice("outside", outside, ("hold",))
        return _NAMED[as_choice("name", name, Directivity.names())](outside)


class AxisymmetricDirectivity(Directivity):
    """A directivity that is the same all round the axis: a subclass gives `gain` by the angle from it."""

    __slots__ = ()

    @abstractmethod
    def gain(self, cosine: Floats, frequency: ArrayLike, speed_of_sound: float) -> NDArray[Any]:
        """Return the gain of sound pressure by the angle from the axis.

        Parameters
        ----------
        cosine : ndarray (...)
            Cosine of the angle between the axis (+x, turned by the orientation) and the direction, -1 to 1: of
            departure for a source, towards the incoming image for a receiver.
        frequency : array_like (...)
            Frequency, Hz; broadcasts against `cosine`.
        speed_of_sound : float
            Speed of sound, m/s.

        Returns
        -------
        ndarray (...)
            Gain, 1; as of `Directivity.gain_towards`.

        Raises
        ------
        InputError
            If a frequency lies outside `band`.
        """

    def gain_towards(self, direction: Floats, frequency: ArrayLike, speed_of_sound: float) -> NDArray[Any]:
        """Return the gain by direction (..., 3); see `Directivity.gain_towards`.

        Parameters
        ----------
        direction : ndarray (..., 3)
            Unit vectors in the transducer's own frame.
        frequency : array_like (...)
            Hz; broadcasts against `direction` without its last axis.
        speed_of_sound : float
            m/s.

        Returns
        -------
        ndarray (...)
            Gain, 1.
        """
        return self.gain(np.clip(np.asarray(direction)[..., 0], -1.0, 1.0), frequency, speed_of_sound)


def name_directivity(name: str, make: Callable[[str | None], AxisymmetricDirectivity]) -> None:
    """Let `Directivity.named` take a name; `make` gets its `outside`."""
    _NAMED[name] = make
