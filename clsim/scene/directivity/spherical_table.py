"""Measured directivity over the sphere: values by direction and frequency, from arrays or SOFA files (AES69)."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass, field
from functools import lru_cache
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from clsim.acoustics.directivity import fit_delay
from clsim.arrays import Floats, as_count, read_only, short_repr
from clsim.errors import InputError, settle
from clsim.numerics import sphere
from clsim.scene.directivity import directivity as tables
from clsim.scene.directivity.directivity import Directivity
from clsim.scene.directivity.text_files import axes_of, cartesian, opened_sofa, read_sofa, sampling_rate_of

_LARGEST_HOLE = 60.0  # degrees, radius of the largest cap without a direction
_MOST_SCATTERED = 4000  # directions off a grid, whose equations take 0.2 GB and two seconds
_AXIS = np.array([1.0, 0.0, 0.0])


@dataclass(frozen=True, slots=True, eq=False)
class SphericalDirectivity(Directivity):
    """A gain by direction and by frequency.

    Parameters
    ----------
    directions : array_like (n, 3)
        In the transducer's own frame, axis +x and up +z, of any length. They must surround it: no empty cap may be
        wider than 60° from its centre. Directions that occur several times, as poles do, are averaged.
    frequencies : array_like (f,)
        Increasing, Hz. One is enough.
    values : array_like (n, f)
        Gain of sound pressure, 1: complex (``exp(+j 2 pi f t)``: a delay has falling phase) or real with its sign.
    outside : {None, "hold"}
        Rule for frequencies beyond the table: refused (None), or the gain at the nearest one.
    relative_to_axis : bool
        Divide by the value on the axis (+x), frequency by frequency: the response on the axis, its delay included, is
        then that of `transducer=` alone.
    name : str
        Name in messages.

    Notes
    -----
    The delay that all phases share, linear in the direction, is found (`fit_delay`) and taken out; real and imaginary
    part of the rest are joined by cubic splines over frequency, and over the sphere by periodic bicubic splines across
    the poles (`GridOnSphere`) if the directions are an equiangular grid, else by cubic radial functions
    (`scattered_on_sphere`). Both go through the table's values.

    Examples
    --------
    >>> octahedron = np.vstack([np.eye(3), -np.eye(3)])
    >>> table = SphericalDirectivity(octahedron, [1e3], 0.5 + 0.5 * octahedron[:, :1])
    >>> table.gain_towards(octahedron, 1e3, 343.0).round(6).tolist()
    [1.0, 0.5, 0.5, 0.0, 0.5, 0.5]
    """

    directions: Floats
    frequencies: Floats
    values: NDArray[Any]
    _: KW_ONLY
    outside: str | None = None
    relative_to_axis: bool = False
    name: str = ""
    delay: Floats = field(init=False, repr=False)  # (4,) s, by 1 and by direction

    __repr__ = short_repr

    def __post_init__(self) -> None:
        tables.check_options(self.outside, self.relative_to_axis, self.name)
        frequencies = tables.as_frequencies(self.frequencies)
        directions = tables.unit_directions(self.directions)
        values = tables.as_gains(self.values, (len(directions), len(frequencies)), "directions by frequencies")
        tables.check_level(values, "")
        directions, values = sphere.merged(directions, values)
        hole = sphere.largest_hole(directions)
        if hole > _LARGEST_HOLE:
            problem = f"must surround the transducer with no gap wider than {_LARGEST_HOLE:g}° from its middle, but "
            problem += f"{'all lie on one side' if hole >= 90.0 else f'there is one of {hole:.0f}°'}"
            raise InputError("directions", problem)
        if len(directions) > _MOST_SCATTERED and sphere.GridOnSphere.of(directions) is None:
            raise InputError(
                "directions",
                f"must be at most {_MOST_SCATTERED} unless they are an equiangular grid, but are {len(directions)}",
            )
        if self.relative_to_axis:
            whole = SphericalDirectivity(directions, frequencies, values)
            axis = whole.gain_towards(_AXIS, frequencies, 1.0)  # a table does not ask for the speed of sound
            values = tables.over_axis(values, axis, frequencies)
        delay = np.zeros(4)
        if np.iscomplexobj(values):
            delay = fit_delay(directions, frequencies, values, sphere.neighbours_on_sphere(directions))
        kept = {"directions": directions, "frequencies": frequencies, "values": values, "delay": delay}
        settle(self, **{name: read_only(array) for name, array in kept.items()})

    @property
    def is_complex(self) -> bool:
        """Whether gains have a phase."""
        return np.iscomplexobj(self.values)

    @property
    def band(self) -> tuple[float, float]:
        """Frequencies (low, high) in Hz that the table covers."""
        return tables.table_band(self.frequencies, self.outside)

    def gain_towards(self, direction: ArrayLike, frequency: ArrayLike, speed_of_sound: float) -> NDArray[Any]:
        """Return the gain; see `Directivity.gain_towards`."""
        f = np.asarray(frequency, dtype=np.float64)
        tables.check_coverage(f, self.band)
        towards = np.asarray(direction, dtype=np.float64)
        shape = towards.shape[:-1]
        unique, column = np.unique(f, return_inverse=True)
        found = _joined(self, unique.tobytes())(towards.reshape(-1, 3))
        row = np.arange(found.shape[0]).reshape(shape)
        gain = found[row, column.reshape(f.shape)]
        if not self.is_complex:
            return np.ascontiguousarray(gain.real)
        return np.asarray(gain * np.exp(-2j * np.pi * f * (self.delay[0] + towards @ self.delay[1:])))

    @classmethod
    def from_sofa(cls, path: str | PathLike[str], measurement: int = 0, **options: Any) -> SphericalDirectivity:
        """Return the directivity in a SOFA file (AES69), through ``netCDF4`` (``pip install 'clsim[sofa]'``).

        Parameters
        ----------
        path : path-like
            With the ending ``.sofa``, of the convention FreeFieldDirectivityTF, GeneralTF or GeneralFIR: one source,
            and a receiver in each direction.
        measurement : int
            Index of the file's measurement (for example a note), from 0.
        **options : Any
            `outside`, `relative_to_axis` and `name` of the constructor.

        Notes
        -----
        SourceView becomes our axis +x and SourceUp our +z. Impulse responses are padded to four times their length and
        transformed.
        """
        sofa = opened_sofa(Path(path))
        try:
            read = read_sofa(sofa, _CONVENTIONS, lambda sofa, _: _read(sofa, measurement))
        except InputError as error:
            raise InputError(error.field, f"{error.problem}: {path}") from error
        return cls(*read, **options)


@lru_cache(maxsize=32)
def _joined(table: SphericalDirectivity, frequencies: bytes) -> sphere.OverSphere:
    """Return the function of direction at frequencies (u,) given as bytes; its results are (n, u)."""
    turn = 2j * np.pi * (table.delay[0] + table.directions @ table.delay[1:])[:, None]
    rest = table.values * np.exp(turn * table.frequencies)
    rows = tables.joined_over_frequency(table.frequencies, rest, np.frombuffer(frequencies))
    grid = sphere.GridOnSphere.of(table.directions)
    return grid.through(rows) if grid is not None else sphere.scattered_on_sphere(table.directions, rows)


# One source, and a receiver in each direction. AES69-2022 has no FreeFieldDirectivityIR; files that say so are laid out
# like GeneralFIR.
_CONVENTIONS = ("FreeFieldDirectivityTF", "FreeFieldDirectivityIR", "GeneralTF", "GeneralFIR")
_ROUND = 0.02  # by which distances to the receivers may differ
_PADDING = 4  # lengths of an impulse response over which it is transformed


def _read(sofa: Any, measurement: int) -> tuple[Floats, Floats, NDArray[np.complex128]]:
    """Return directions (n, 3) in the source's frame, frequencies (f,) in Hz and responses (n, f)."""
    if sofa.GLOBAL_DataType not in ("TF", "FIR"):
        raise InputError("path", f"must hold TF or FIR data, but holds {sofa.GLOBAL_DataType!r:.80}")
    if sofa.GLOBAL_DataType == "TF":
        frequencies = np.atleast_1d(np.asarray(sofa.N, dtype=np.float64))
        values = _of(sofa.Data_Real, measurement) + 1j * _of(sofa.Data_Imag, measurement)
    else:
        frequencies, values = _transformed(sofa, measurement)
    directions = _directions(sofa, measurement)
    if values.shape != (len(directions), len(frequencies)):
        problem = f"must hold values for {len(directions)} receivers and {len(frequencies)} frequencies, but holds "
        raise InputError("path", f"{problem}{values.shape[0]} x {values.shape[1]}")
    return directions, frequencies, values


def _of(data: Any, measurement: int) -> Floats:
    """Return one measurement (R, N) of data (M, R, N), of which files may leave out the last axis."""
    array: Any = data
    array = array.reshape(array.shape + (1,) * (3 - array.ndim))
    as_count("measurement", measurement, at_least=0, at_most=array.shape[0] - 1)
    return np.asarray(array[measurement])


def _transformed(sofa: Any, measurement: int) -> tuple[Floats, NDArray[np.complex128]]:
    """Return frequencies and the spectrum of impulse responses, delays included."""
    samples = _of(sofa.Data_IR, measurement)
    rate = sampling_rate_of(sofa)
    size = scipy.fft.next_fast_len(_PADDING * samples.shape[1], real=True)
    frequencies = np.asarray(scipy.fft.rfftfreq(size, 1.0 / rate), dtype=np.float64)
    delay = np.atleast_2d(np.asarray(sofa.Data_Delay, dtype=np.float64))
    delay = delay[measurement if len(delay) > 1 else 0] / rate
    turn = -2j * np.pi * frequencies * np.broadcast_to(delay, samples.shape[:1])[:, None]
    return frequencies, np.asarray(scipy.fft.rfft(samples, size, axis=1) * np.exp(turn), dtype=np.complex128)


def _directions(sofa: Any, measurement: int) -> Floats:
    """Return unit vectors (R, 3) from the source to the receivers, in the source's frame."""
    receivers = cartesian(sofa, "ReceiverPosition", measurement)
    listener = cartesian(sofa, "ListenerPosition", measurement)[0]
    source = cartesian(sofa, "SourcePosition", measurement)[0]
    apart = receivers @ axes_of(sofa, "Listener", measurement) + listener - source
    distance = np.linalg.norm(apart, axis=1)
    if not distance.min() > 0.0 or distance.max() > (1.0 + _ROUND) * distance.min():
        raise InputError(
            "path",
            f"must have receivers on a sphere about the source, but their distances are from {distance.min():.4g} to "
            f"{distance.max():.4g} m",
        )
    return np.asarray(apart @ axes_of(sofa, "Source", measurement).T / distance[:, None])
