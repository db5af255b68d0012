"""Directivity: the gain of a source or receiver by direction and frequency; checks of its tables."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from clsim.arrays import Floats, as_choice, as_floats
from clsim.errors import InputError, check_kind, check_rising

_SAME_FREQUENCY = 1e-9  # of an end of a band
_SILENT = 1e-12  # of the loudest direction
_LARGEST, _LARGEST_DB = 1e15, 300.0


def check_options(outside: Any, relative_to_axis: Any, name: Any) -> None:
    """Raise an InputError if an option that all tables share is invalid."""
    if outside is not None:
        as_choice("outside", outside, ("hold",))
    check_kind("relative_to_axis", relative_to_axis, bool | np.bool_, "true or false")
    check_kind("name", name, str, "a text")


def as_frequencies(frequencies: ArrayLike) -> Floats:
    """Return a table's frequencies (f,), from 0 Hz and strictly increasing."""
    f = as_floats("frequencies", frequencies, (None,))
    if f[0] < 0.0:
        raise InputError("frequencies[0]", f"must be at least 0 Hz, but is {f[0]:g} Hz")
    check_rising("frequencies", f, np.diff(f) > 0.0, " Hz")
    return f


def as_gains(values: Any, shape: tuple[int, int], layout: str) -> NDArray[Any]:
    """Return gains of a shape as float64 or complex128, finite."""
    given = np.asarray(values)
    parts = [
        as_floats("values", p, (None, None)) for p in ((given.real, given.imag) if np.iscomplexobj(given) else (given,))
    ]
    if parts[0].shape != shape:
        rows, columns = parts[0].shape
        hint = "; transpose them" if parts[0].shape == shape[::-1] else ""
        raise InputError("values", f"must be {layout}, {shape[0]} x {shape[1]}, but are {rows} x {columns}{hint}")
    return parts[0] if len(parts) == 1 else parts[0] + 1j * parts[1]


def unit_directions(value: Any) -> Floats:
    """Return directions (n, 3) of any length as unit vectors."""
    given = as_floats("directions", value, (None, 3))
    length = np.linalg.norm(given, axis=1)
    for i in np.flatnonzero(length <= 0.0)[:1]:
        raise InputError(f"directions[{i}]", "must have a length above 0, but is 0")
    return np.asarray(given / length[:, None])


def check_level(values: NDArray[Any], unit: str) -> None:
    """Raise an InputError if gains (n, f), in dB or as a factor, are all zero or absurdly large."""
    magnitude = np.abs(values)
    most = _LARGEST_DB if unit else _LARGEST
    for i, j in np.argwhere(magnitude > most)[:1]:
        within = f"from -{most:g} to {most:g} dB" if unit else f"at most {most:g} in magnitude"
        raise InputError(f"values[{i}][{j}]", f"must be {within}, but is {values[i, j]:g}{unit and ' dB'}")
    if not unit and not magnitude.any():
        raise InputError("values", "must not all be 0")


def over_axis(values: NDArray[Any], axis: NDArray[Any], frequencies: Floats) -> NDArray[Any]:
    """Return values (n, f) divided by those on the axis (f,)."""
    for i in np.flatnonzero(np.abs(axis) <= _SILENT * np.abs(values).max(axis=0))[:1]:
        problem = f"must be false where the axis is silent, but it is at {frequencies[i]:g} Hz"
        raise InputError("relative_to_axis", problem)
    return np.asarray(values / axis)


def table_band(frequencies: Floats, outside: str | None) -> tuple[float, float]:
    """Return the frequencies (low, high) in Hz that a table covers."""
    return (0.0, math.inf) if outside == "hold" else (float(frequencies[0]), float(frequencies[-1]))


def check_coverage(f: Floats, band: tuple[float, float]) -> None:
    """Check that a directivity's band (low, high) covers frequencies (...), Hz."""
    low, high = band[0] * (1.0 - _SAME_FREQUENCY), band[1] * (1.0 + _SAME_FREQUENCY)
    beyond = f[(f < low) | (f > high)]
    if beyond.size:
        problem = f"must cover {beyond.ravel()[0]:.6g} Hz, but covers {band[0]:.6g} to {band[1]:.6g} Hz; "
        raise InputError("directivity", f'{problem}measure more of it or give outside="hold"')


def joined_over_frequency(frequencies: Floats, values: NDArray[Any], at: Floats, *, monotone: bool = False) -> Any:
    """Return values (n, f) at other frequencies (u,), those beyond the ends as at the ends, (n, u)."""
    # Sound has no phase at 0 Hz: below half of the lowest frequency, imaginary parts fall to nothing as a raised
    # cosine.
    within = np.clip(at, frequencies[0], frequencies[-1])
    if len(frequencies) == 1:
        joined: Any = np.repeat(values, len(at), axis=1)
    else:
        joined = (scipy.interpolate.PchipInterpolator if monotone else scipy.interpolate.CubicSpline)(
            frequencies, values, axis=1
        )(within)
    if np.iscomplexobj(joined) and frequencies[0] > 0.0:
        joined.imag *= np.sin(0.5 * math.pi * np.minimum(at / (0.5 * frequencies[0]), 1.0)) ** 2
    return joined


NAMED: dict[str, Callable[[str | None], AxisymmetricDirectivity]] = {}  # by `outside`; filled where patterns are made


class Directivity(ABC):
    """Gain of sound pressure by direction and frequency; subclass it, or `AxisymmetricDirectivity`."""

    __slots__ = ()

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the outputs of a receiver: one without a name, unless it is a `ChannelDirectivity`."""
        return ("",)

    @property
    @abstractmethod
    def is_complex(self) -> bool:
        """Whether gains have a phase."""

    @property
    @abstractmethod
    def band(self) -> tuple[float, float]:
        """Frequencies (low, high) in Hz that the directivity covers; ``(0, inf)`` if all."""

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
        """Return the names that `named` takes."""
        return tuple(NAMED)

    @staticmethod
    def named(name: str, outside: str | None = None) -> AxisymmetricDirectivity:
        """Return the directivity of a transducer by its name: a `Piston` or an `AxialDirectivity`.

        Parameters
        ----------
        name : {"MA40S4S", "MA40S4R", "T4010A1"}
            Murata's open 40 kHz transmitter and receiver. Each is the baffled piston of 4.7 mm radius, which has 80°
            between -6 dB points, as the maker states at 40 kHz. It is an equivalent piston, not a measurement: side
            lobes, rear and other frequencies are the formula's. Nicera's 40 kHz transmitter: the published levels at 40
            kHz in steps of 10° up to 90°, the last of them (-15 dB) kept behind. They are nominal, read to whole dB,
            and have no phase.
        outside : {None, "hold"}
            Rule for other frequencies than those of a table (T4010A1): refused (None), or the same gain.

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
        return NAMED[as_choice("name", name, Directivity.names())](outside)


class ChannelDirectivity(Directivity):
    """Directivities of a receiver with several outputs at one place: ears, or ambisonic components."""

    # `gain_towards` has shape (..., C), C channels; a subclass gives `channels`.
    __slots__ = ()

    @property
    def is_flat(self) -> bool:
        """Whether gains are the same at every frequency, and the first channel's is 1."""
        return False

    @property
    def by_functions(self) -> bool:
        """Whether paths are rendered by functions of frequency in any case, instead of through filters that turn."""
        return self.is_flat

    @property
    def reach(self) -> float:
        """Bound of the magnitude of `lateness`, s; 0 where all channels have the centre's delay."""
        return 0.0

    def lateness(self, direction: Floats, speed_of_sound: float) -> Floats:
        """Return the approximate delay of each channel behind the centre.

        Parameters
        ----------
        direction : ndarray (..., 3)
            Unit vectors in the receiver's own frame.
        speed_of_sound : float
            m/s.

        Returns
        -------
        ndarray (..., C)
            s. Delays of paths have it, and the gains that go with them are without its phase.
        """
        return np.zeros((*np.shape(direction)[:-1], len(self.channels)))

    def aligned(self, direction: Floats, frequencies: Floats, speed_of_sound: float, channels: range) -> NDArray[Any]:
        """Return the gains (C, ..., F) of some channels without the phase of their lateness.

        Parameters
        ----------
        direction, speed_of_sound
            As of `lateness`.
        frequencies : ndarray (F,)
            Hz.
        channels : range
            Indices of C channels.
        """
        gain = np.moveaxis(self.gain_towards(direction[..., None, :], frequencies, speed_of_sound), -1, 0)[
            channels.start : channels.stop
        ]
        if self.reach == 0.0:
            return gain
        late = np.moveaxis(self.lateness(direction, speed_of_sound), -1, 0)[channels.start : channels.stop]
        return np.asarray(gain * np.exp(2j * np.pi * late[..., None] * frequencies))


class AxisymmetricDirectivity(Directivity):
    """A directivity that is the same all round the axis: a subclass gives `gain` by the angle from it."""

    __slots__ = ()

    @abstractmethod
    def gain(self, cosine: Floats, frequency: ArrayLike, speed_of_sound: float) -> NDArray[Any]:
        """Return the gain (...) of sound pressure by the angle from the axis; see `Directivity.gain_towards`.

        Parameters
        ----------
        cosine : ndarray (...)
            Cosine of the angle between the axis (+x, turned by the orientation) and the direction, -1 to 1: of
            departure for a source, towards the incoming image for a receiver.
        frequency : array_like (...)
            Frequency, Hz; broadcasts against `cosine`.
        speed_of_sound : float
            Speed of sound, m/s.
        """

    def gain_towards(self, direction: Floats, frequency: ArrayLike, speed_of_sound: float) -> NDArray[Any]:
        """Return the gain by direction (..., 3); see `Directivity.gain_towards`."""
        return self.gain(np.clip(np.asarray(direction)[..., 0], -1.0, 1.0), frequency, speed_of_sound)
