"""Directivities about an axis, by formulae and by tables of angle and frequency; those of ambisonic microphones."""

from __future__ import annotations

import math
from dataclasses import KW_ONLY, dataclass, field
from functools import lru_cache
from os import PathLike
from typing import Any, ClassVar

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from clsim.acoustics.directivity import first_order_gain, fit_delay, piston_gain
from clsim.arrays import Floats, as_choice, as_count, as_floats, as_number, read_only, short_repr
from clsim.errors import InputError, check_rising, settle, warn
from clsim.numerics.sphere import real_harmonics
from clsim.scene.directivity import directivity as tables
from clsim.scene.directivity.directivity import NAMED, ChannelDirectivity
from clsim.scene.directivity.directivity import AxisymmetricDirectivity as AxisymmetricDirectivity
from clsim.scene.directivity.directivity import Directivity as Directivity  # with the names of what is made here
from clsim.scene.directivity.text_files import as_table, read_csv_table, read_mat_arrays, read_npz_arrays

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


_SAME_ANGLE = 1e-6  # degrees
_OVERHANG = 15.0  # degrees beyond 0° or 180° that are taken for those of the other side


def overhangs(angles: Floats) -> bool:
    """Whether angles (a,) in degrees exceed 0° or 180° by at most `_OVERHANG` and do not cover both sides."""
    beyond = angles[0] < -_SAME_ANGLE or angles[-1] > 180.0 + _SAME_ANGLE
    far = angles[0] < -_OVERHANG - _SAME_ANGLE or angles[-1] > 180.0 + _OVERHANG + _SAME_ANGLE
    return bool(beyond and not far and abs(angles[0] + angles[-1]) > _SAME_ANGLE)


def within_half_turn(angles: Floats, values: NDArray[Any], unit: str) -> tuple[Floats, NDArray[Any]]:
    """Return the angles from 0° to 180°, and their values, of a table that overhangs."""
    # Shapes: angles (a,); values (a, f). Where no angle lies on the axis, or opposite, its values are those of a cubic
    # spline through all angles.
    made = [a for a in (0.0, 180.0) if angles[0] < a < angles[-1] and np.abs(angles - a).min() > _SAME_ANGLE]
    if made and len(angles) > 1:
        joined = scipy.interpolate.CubicSpline(angles, values)(made)
        order = np.argsort(np.concatenate([angles, made]), kind="stable")
        angles, values = np.concatenate([angles, made])[order], np.concatenate([values, joined])[order]
    kept = (angles >= -_SAME_ANGLE) & (angles <= 180.0 + _SAME_ANGLE)
    mirrored = np.where(angles < 90.0, -angles, 360.0 - angles)
    near = np.abs(angles[:, None] - mirrored[~kept]) <= 100.0 * _SAME_ANGLE
    pairs = np.argwhere(near & kept[:, None])
    difference = ""
    if len(pairs):
        apart = float(np.abs(values[pairs[:, 0]] - values[~kept][pairs[:, 1]]).max())
        most = float(np.abs(values).max()) or 1.0
        difference = f" within {apart:.3g} dB" if unit else f" within {apart / most:.2g} of the largest value"
    warn(
        f"angles_degrees: go from {angles[0]:.6g}° to {angles[-1]:.6g}°; what lies beyond 0° and 180° is left out, for "
        f"the angles on the other side are there{difference and ', and the same'}{difference}"
    )
    return np.clip(angles[kept], 0.0, 180.0), values[kept]


_REAR = ("hold", "mirror", "zero")
_SIDES = ("positive", "negative", "mean")
_SAME_SIDES = 1e-3  # of the largest value, or of a neper: sides that differ by less are the same
_FALL = math.radians(10.0)  # over which rear="zero" falls to nothing


@dataclass(frozen=True, slots=True, eq=False)
class AxialDirectivity(AxisymmetricDirectivity):
    """A gain by angle from the axis and by frequency, the same all round the axis.

    Parameters
    ----------
    angles_degrees : array_like (a,)
        From the axis, increasing: 0 to 180, or less with `rear`; or with negative angles too, see `side`. What goes up
        to 15° beyond 0 and 180 is left out, with a warning.
    frequencies : array_like (f,)
        Increasing, Hz. One is enough.
    values : array_like (a, f)
        Gain of sound pressure, complex (``exp(+j 2 pi f t)``: a delay has falling phase) or real with its sign; or,
        with ``scale="db"``, its magnitude in dB.
    scale : {"linear", "db"}
        Scale of `values`.
    rear : {None, "hold", "mirror", "zero"}
        Rule for angles beyond the last one: refused if the table does not reach 180° (None), the value at the last
        angle, that of the angle mirrored at 90° (of a table that ends there), or nothing: it falls to zero as a raised
        cosine over 10°.
    side : {None, "positive", "negative", "mean"}
        Rule for two unequal sides of a table over negative and positive angles: refused (None), one of them, or
        the mean of both `values`.
    outside : {None, "hold"}
        Rule for frequencies beyond the table: refused (None), or the gain at the nearest one.
    relative_to_axis : bool
        Divide by the value on the axis, frequency by frequency: the response on the axis, its delay included, is then
        that of `transducer=` alone.
    name : str
        Name in messages.

    Notes
    -----
    Complex and signed values: the delay that all phases share, linear in the cosine, is found (`fit_delay`) and taken
    out, real and imaginary part of the rest are joined by cubic splines over frequency and over angle, and the delay is
    put back. Magnitudes in dB are joined by monotone cubics (F. N. Fritsch and R. E. Carlson, SIAM J. Numer. Anal. 17
    (2), 238-246, 1980), which do not overshoot. Both have zero slope on the axis and where the rear begins. With
    ``outside="hold"`` the shared delay continues.

    Examples
    --------
    >>> table = AxialDirectivity([0, 45, 90], [40e3], [[0.0], [-6.0], [-20.0]], scale="db", rear="hold")
    >>> gain = table.gain(np.cos(np.radians([0.0, 45.0, 150.0])), 40e3, 343.0)
    >>> (20 * np.log10(gain)).round(6).tolist()
    [0.0, -6.0, -20.0]
    """

    angles_degrees: Floats
    frequencies: Floats
    values: NDArray[Any]
    _: KW_ONLY
    scale: str = "linear"
    rear: str | None = None
    side: str | None = None
    outside: str | None = None
    relative_to_axis: bool = False
    name: str = ""
    delay: Floats = field(init=False, repr=False)  # (2,) s, by 1 and by cosine

    __repr__ = short_repr

    def __post_init__(self) -> None:
        as_choice("scale", self.scale, ("linear", "db"))
        for name, choices in (("rear", _REAR), ("side", _SIDES)):
            if getattr(self, name) is not None:
                as_choice(name, getattr(self, name), choices)
        tables.check_options(self.outside, self.relative_to_axis, self.name)
        frequencies = tables.as_frequencies(self.frequencies)
        angles = as_floats("angles_degrees", self.angles_degrees, (None,))
        check_rising("angles_degrees", angles, np.diff(angles) > _SAME_ANGLE, "°")
        overhanging = overhangs(angles)
        if not overhanging and (angles[0] < -180.0 - _SAME_ANGLE or angles[-1] > 180.0 + _SAME_ANGLE):
            problem = f"must lie from -180° to 180°, but go from {angles[0]:g}° to {angles[-1]:g}°"
            raise InputError("angles_degrees", problem)
        values = tables.as_gains(self.values, (len(angles), len(frequencies)), "angles by frequencies")
        if self.scale == "db" and np.iscomplexobj(values):
            raise InputError("values", 'must be real with scale="db", but are complex; from_db takes phases')
        unit = "dB" if self.scale == "db" else ""
        tables.check_level(values, unit)
        angles, values = within_half_turn(angles, values, unit) if overhanging else self._one_side(angles, values)
        if len(angles) < 2 or abs(angles[0]) > _SAME_ANGLE:
            problem = f"must begin on the axis, 0°, and go on, but are {angles.tolist()!s:.80}"
            raise InputError("angles_degrees", problem)
        last = float(angles[-1])
        if last < 180.0 - _SAME_ANGLE and self.rear is None:
            advice = 'give rear="hold", "mirror" or "zero" for what lies beyond'
            raise InputError("angles_degrees", f"must reach 180°, but end at {last:g}°; {advice}")
        if self.rear == "mirror" and last < 180.0 - _SAME_ANGLE and abs(last - 90.0) > _SAME_ANGLE:
            raise InputError("rear", f'must be "hold" or "zero" unless the table ends at 90°, but it ends at {last:g}°')
        if self.relative_to_axis:
            values = values - values[0] if self.scale == "db" else tables.over_axis(values, values[0], frequencies)
        delay = np.zeros(2)
        if np.iscomplexobj(values):
            cosine = np.cos(np.radians(angles))[:, None]
            pairs = np.arange(len(angles) - 1)[:, None] + np.array([0, 1])
            delay = fit_delay(cosine, frequencies, values, pairs)
        kept = {"angles_degrees": angles, "frequencies": frequencies, "values": values, "delay": delay}
        settle(self, **{name: read_only(array) for name, array in kept.items()})

    @property
    def is_complex(self) -> bool:
        """Whether gains have a phase."""
        return np.iscomplexobj(self.values)

    @property
    def band(self) -> tuple[float, float]:
        """Frequencies (low, high) in Hz that the table covers."""
        return tables.table_band(self.frequencies, self.outside)

    def gain(self, cosine: ArrayLike, frequency: ArrayLike, speed_of_sound: float) -> NDArray[Any]:
        """Return the gain; see `AxisymmetricDirectivity.gain`."""
        f = np.asarray(frequency, dtype=np.float64)
        tables.check_coverage(f, self.band)
        angle = np.arccos(np.clip(np.asarray(cosine, dtype=np.float64), -1.0, 1.0))
        knots = np.radians(self.angles_degrees)
        behind = np.pi - angle if self.rear == "mirror" else knots[-1]
        seen = np.where(angle > knots[-1], np.minimum(behind, knots[-1]), angle)
        unique, column = np.unique(f, return_inverse=True)
        cell = np.clip(np.searchsorted(knots, seen, side="right") - 1, 0, len(knots) - 2)
        piece = _pieces(self, unique.tobytes())[:, cell, column.reshape(f.shape)]
        x = seen - knots[cell]
        gain: NDArray[Any] = ((piece[0] * x + piece[1]) * x + piece[2]) * x + piece[3]
        if self.scale == "db":
            gain = 10.0 ** (gain / 20.0)
        elif self.is_complex:
            gain = gain * np.exp(-2j * np.pi * f * (self.delay[0] + self.delay[1] * np.cos(seen)))
        if self.rear == "zero" and knots[-1] < np.pi:
            fallen = np.clip((angle - knots[-1]) / min(_FALL, np.pi - knots[-1]), 0.0, 1.0)
            gain = gain * np.cos(0.5 * np.pi * fallen) ** 2
        return gain

    @classmethod
    def from_db(
        cls, angles_degrees: ArrayLike, frequencies: ArrayLike, magnitudes_db: ArrayLike,
        phases_degrees: ArrayLike | None = None, **options: Any,
    ) -> AxialDirectivity:  # fmt: skip
        """Return the table of magnitudes (a, f) in dB and, if given, phases (a, f) in degrees.

        Parameters
        ----------
        angles_degrees, frequencies
            As in the constructor.
        magnitudes_db : array_like (a, f)
            20 times the logarithm of the gain. Silence has none: give a floor.
        phases_degrees : array_like (a, f), optional
            With them the gain is complex; a delay has falling phase.
        **options : Any
            `rear`, `side`, `outside`, `relative_to_axis` and `name` of the constructor.

        Examples
        --------
        >>> table = AxialDirectivity.from_db([0, 180], [1e3], [[0.0], [-6.0206]], [[0.0], [90.0]])
        >>> table.gain(-1.0, 1e3, 343.0).imag.round(4).tolist()
        0.5
        """
        angles, f = (np.asarray(given) for given in (angles_degrees, frequencies))
        magnitudes = as_floats("magnitudes_db", magnitudes_db, (None, None))
        if phases_degrees is None:
            return cls(angles, f, magnitudes, scale="db", **options)
        phases = as_floats("phases_degrees", phases_degrees, magnitudes.shape)
        values = 10.0 ** (magnitudes / 20.0) * np.exp(1j * np.radians(phases))
        return cls(angles, f, values, **options)

    @classmethod
    def from_csv(
        cls, path: str | PathLike[str], phases_path: str | PathLike[str] | None = None, scale: str = "db",
        **options: Any,
    ) -> AxialDirectivity:  # fmt: skip
        """Return the table of a text file: frequencies in its first row, angles in its first column.

        Parameters
        ----------
        path : path-like
            First row: any word (or nothing), then the frequencies in Hz. Other rows: the angle in degrees, then a value
            for each frequency. Separated by commas, semicolons or tabs; with semicolons or tabs a decimal comma is
            understood. Empty lines and lines that begin with ``#`` are skipped.
        phases_path : path-like, optional
            Another file of the same layout, angles and frequencies, with phases in degrees.
        scale : {"db", "linear"}
            Scale of the first file's values.
        **options : Any
            `rear`, `side`, `outside`, `relative_to_axis` and `name` of the constructor.
        """
        as_choice("scale", scale, ("linear", "db"))
        angles, frequencies, values = read_csv_table("path", path)
        if phases_path is None:
            return cls(angles, frequencies, values, scale=scale, **options)
        same, also, turned = read_csv_table("phases_path", phases_path)
        if not (np.array_equal(same, angles) and np.array_equal(also, frequencies)):
            problem = f"must have the angles and frequencies of {path}, but has others: {phases_path}"
            raise InputError("phases_path", problem)
        if scale == "db":
            return cls.from_db(angles, frequencies, values, turned, **options)
        return cls(angles, frequencies, values * np.exp(1j * np.radians(turned)), **options)

    @classmethod
    def from_npz(
        cls, path: str | PathLike[str], scale: str | None = None, angle: str = "angles", frequency: str = "frequencies",
        values: str = "values", angle_unit: str = "degree", **options: Any,
    ) -> AxialDirectivity:  # fmt: skip
        """Return the table of a NumPy file with three arrays.

        Parameters
        ----------
        path : path-like
            Written by ``numpy.savez``.
        scale : {None, "linear", "db"}
            Scale of real values; complex ones are linear.
        angle, frequency, values : str
            Names of the arrays: angles (a,), frequencies (f,) in Hz, values (a, f), or (f, a) where that fits only.
        angle_unit : {"degree", "radian"}
            That of the angles. Radians are rounded to a ten-thousandth of a degree.
        **options : Any
            `rear`, `side`, `outside`, `relative_to_axis` and `name` of the constructor.
        """
        found = as_table(read_npz_arrays(path, (angle, frequency, values)), angle_unit)
        return cls(*found, scale=_scale_of(found[2], scale), **options)

    @classmethod
    def from_mat(
        cls, path: str | PathLike[str], scale: str | None = None, angle: str = "angles", frequency: str = "frequencies",
        values: str = "values", angle_unit: str = "degree", variable: str | None = None, **options: Any,
    ) -> AxialDirectivity:  # fmt: skip
        """Return the table of a MATLAB file with three variables, or a struct of three fields; see `from_npz`.

        Parameters
        ----------
        path, scale, angle, frequency, values, angle_unit, **options
            As in `from_npz`. A file of version 7.3 must be saved with ``-v7``.
        variable : str, optional
            Name of the struct; `angle`, `frequency` and `values` are its fields then.
        """
        found = as_table(read_mat_arrays(path, (angle, frequency, values), variable), angle_unit)
        return cls(*found, scale=_scale_of(found[2], scale), **options)

    def _one_side(self, angles: Floats, values: NDArray[Any]) -> tuple[Floats, NDArray[Any]]:
        """Return angles from 0° on, and their values."""
        if angles[0] >= -_SAME_ANGLE:
            return angles, values
        right, left = angles >= -_SAME_ANGLE, angles <= _SAME_ANGLE
        if right.sum() != left.sum() or np.any(np.abs(angles[right] + angles[left][::-1]) > _SAME_ANGLE):
            problem = f"must be the same on both sides of 0°, but go from {angles[0]:g}° to {angles[-1]:g}° with "
            raise InputError("angles_degrees", f"{problem}{left.sum()} and {right.sum()} angles")
        one, other = values[right], values[left][::-1]
        if self.side is None:
            scale = 20.0 / math.log(10.0) if self.scale == "db" else float(np.abs(values).max())
            apart = np.abs(one - other).max(axis=1)
            worst = int(np.argmax(apart))
            if apart[worst] > _SAME_SIDES * scale:
                unit = " dB" if self.scale == "db" else ""
                problem = f"must be the same on both sides of 0°, but differ at ±{angles[right][worst]:g}° by up to "
                problem += f'{apart[worst]:.3g}{unit}; give side="positive", "negative" or "mean"'
                raise InputError("values", problem)
        return angles[right], {"negative": other, "mean": 0.5 * (one + other)}.get(self.side or "", one)


def _scale_of(values: Any, scale: str | None) -> str:
    if scale is None:
        if not np.iscomplexobj(values):
            raise InputError("scale", 'must be given for real values, "linear" or "db", but is missing')
        return "linear"
    return as_choice("scale", scale, ("linear", "db"))


@lru_cache(maxsize=32)
def _pieces(table: AxialDirectivity, frequencies: bytes) -> NDArray[Any]:
    """Return cubics between the table's angles (4, a - 1, u) at frequencies (u,) given as bytes."""
    at = np.frombuffer(frequencies)
    knots = np.radians(table.angles_degrees)
    if table.scale == "db":
        rows = tables.joined_over_frequency(table.frequencies, table.values, at, monotone=True)
        # A mirrored angle on either side makes both ends level.
        angles = np.concatenate([[-knots[1]], knots, [2.0 * knots[-1] - knots[-2]]])
        return np.asarray(
            scipy.interpolate.PchipInterpolator(angles, np.concatenate([rows[1:2], rows, rows[-2:-1]])).c[:, 1:-1]
        )
    turn = 2j * np.pi * (table.delay[0] + table.delay[1] * np.cos(knots))[:, None]
    rest = table.values * np.exp(turn * table.frequencies) if table.is_complex else table.values
    rows = tables.joined_over_frequency(table.frequencies, rest, at)
    # What the delay adds to the slope at the last angle is taken from the rest, so that the whole is level there.
    slope = -2j * np.pi * at * table.delay[1] * math.sin(knots[-1]) * rows[-1] if table.is_complex else 0.0 * rows[-1]
    return np.asarray(scipy.interpolate.CubicSpline(knots, rows, bc_type=((1, 0.0 * rows[0]), (1, slope))).c)


_NICERA = np.arange(0.0, 91.0, 10.0), [40e3], _NICERA_DB[:, None]  # degrees, Hz
for _name in ("MA40S4S", "MA40S4R"):
    NAMED[_name] = lambda outside: Piston(_MURATA_RADIUS)
NAMED["T4010A1"] = lambda outside: AxialDirectivity.from_db(*_NICERA, rear="hold", outside=outside, name="T4010A1")
