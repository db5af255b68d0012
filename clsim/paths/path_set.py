"""The paths of a scene: one row per path and interval, of every kind."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Complexes, Floats, as_count, as_floats, as_number, read_only
from clsim.errors import InputError, counted, old_names
from clsim.paths.channel import ChannelBand, ChannelPaths, ChannelTaps, DelayDoppler, channel_paths, channel_taps
from clsim.paths.family import SPECULAR, TRANSMISSION, PairPaths, PathFamily
from clsim.paths.path_table import PathTable, paths_page
from clsim.paths.response import Kinematics, slices_of
from clsim.pictures.view_page import html_table, inline_page
from clsim.scene.scene import Scene, known_until

Integers = NDArray[np.signedinteger[Any]]

_Number = TypeVar("_Number", bound=np.number[Any])


def _stacked(columns: list[NDArray[_Number]]) -> NDArray[_Number]:
    """Stack columns (paths,) or (paths, N), the latter filled up with -1; a single one is no copy."""
    if len(columns) == 1:
        return columns[0]
    if columns[0].ndim == 2:
        width = max(column.shape[1] for column in columns)
        columns = [np.pad(c, ((0, 0), (0, width - c.shape[1])), constant_values=-1) for c in columns]
    return read_only(np.concatenate(columns))


def _column(of: Callable[[PathFamily], NDArray[_Number]]) -> cached_property[NDArray[_Number]]:
    """Make the column of a set from that of each of its families."""
    return cached_property(lambda paths: _stacked([of(family) for family in paths.families]))


@old_names("0.3", heard_by="at_receiver")
@dataclass(frozen=True, eq=False)
class PathSet:
    """Every path from a source to a receiver, as columns of equal length: those of each kind in turn.

    Attributes
    ----------
    scene : Scene
        The scene in which they are.
    families : tuple of PathFamily
        The kinds of paths, in the order of their rows.
    source, receiver, order : ndarray (paths,) int
        Indices in the scene, and number of interactions.
    start, end : ndarray (paths,)
        Interval of reception in which the path is active, s.
    interactions : ndarray (paths, N) int
        Interactions in order from the source: 0 reflection by a wall, 1 diffraction, 2 scattering, 3
        reflection by a body, 4 transmission through a wall, 5 (the last) shadows on all of the path; filled up with -1.
    objects : ndarray (paths, N) int
        Objects of the interactions, as indices of `object_names`, walls first; filled up with -1.
    walls : ndarray (paths, N) int
        The objects of reflections, -1 elsewhere.
    object_names : tuple of str
        Names of walls, and of other objects that paths meet.
    """

    scene: Scene
    families: tuple[PathFamily, ...]

    def __repr__(self) -> str:
        ends = f"{counted(len(self.scene.sources), 'source')}, {counted(len(self.scene.receivers), 'receiver')}"
        return f"PathSet({counted(len(self), 'interval')} of paths, {ends}, up to order {self.order.max(initial=0)})"

    def __post_init__(self) -> None:
        if not self.families or not all(isinstance(family, PathFamily) for family in self.families):
            raise InputError("families", f"must be one PathFamily at least, but is {self.families!r:.80}")
        for i, family in enumerate(self.families):
            if family.scene is not self.scene:
                raise InputError(f"families[{i}]", "must hold paths of the same scene, but is of another one")
            family.check()

    def __len__(self) -> int:
        return sum(map(len, self.families))

    source = _column(lambda family: family.source)
    receiver = _column(lambda family: family.receiver)
    order = _column(lambda family: family.order)
    start = _column(lambda family: family.start)
    end = _column(lambda family: family.end)
    interactions = _column(lambda family: family.interactions)
    walls = _column(lambda family: family.walls)

    @cached_property
    def objects(self) -> Integers:
        """Where that happens: rows of `object_names`."""
        found, first = [], len(self.scene.room.faces.names)
        for family in self.families:
            of_wall = (family.interactions == SPECULAR) | (family.interactions == TRANSMISSION)
            other = ~of_wall & (family.objects >= 0)
            found.append(family.objects + first * other if other.any() else family.objects)
            first += len(family.object_names)
        return _stacked(found)

    @property
    def object_names(self) -> tuple[str, ...]:
        """Names of walls, and of other objects that paths meet."""
        own = (name for family in self.families for name in family.object_names)
        return (*self.scene.room.faces.names, *own)

    @property
    def is_complex(self) -> bool:
        """Whether responses of any path have phases."""
        return any(family.is_complex for family in self.families)

    @property
    def turns_phases(self) -> bool:
        """Whether fields at edges or scatterers turn phases by any angle."""
        vertices = (getattr(family, "vertex", None) for family in self.families)
        return any(vertex is not None and vertex.is_complex for vertex in vertices)

    def pairs(self) -> Iterator[tuple[NDArray[np.int64], PairPaths]]:
        """Yield the paths of every kind, source and receiver that has any: their rows here, and what they are."""
        first = 0
        for family in self.families:
            for pair in family.pairs():
                yield first + pair.index, pair
            first += len(family)

    def at_receiver(self, receiver: int) -> PathSet:
        """Return the paths to `receiver`, an index in the scene."""
        return PathSet(self.scene, tuple(f.part(np.flatnonzero(f.receiver == receiver)) for f in self.families))

    def digest(self) -> str:
        """Return a hash of all columns of all kinds."""
        return hashlib.sha256(" ".join(family.digest() for family in self.families).encode()).hexdigest()

    def table(self, times: Floats, motion: str = "retarded", amplitude: str = "wave-equation") -> PathTable:
        """Table of every path at the given times.

        Parameters
        ----------
        times : array_like (T,)
            Times of reception, s.
        motion, amplitude : str
            As in `render`.
        """
        times = as_floats("times", times, (None,))
        kinematics = Kinematics(motion, amplitude)
        shape = (len(self), len(times))
        delay, doppler_factor = (np.full(shape, np.nan) for _ in range(2))
        has_phases = self.is_complex or self.scene.air.dispersion
        gain: Any = np.full(shape, np.nan, dtype=np.complex128 if has_phases else np.float64)
        centres = np.array([source.emitted.centre_frequency for source in self.scene.sources])
        departure, arrival = (np.full((*shape, 3), np.nan) for _ in range(2))
        for rows, pair in self.pairs():
            for part in slices_of(len(times), len(rows)):
                found = pair.arrivals(times[part], kinematics)
                delay[rows, part], gain[rows, part] = found.delay, pair.gain(found, times[part])
                if self.scene.air.dispersion:  # delays told are those of groups
                    offset = pair.group_delay_offset(found)
                    delay[rows, part] += offset
                    gain[rows, part] *= np.exp(2j * np.pi * centres[pair.source] * offset)
                doppler_factor[rows, part] = 1.0 - found.delay_rate
                departure[rows, part], arrival[rows, part] = found.departure, found.arrival
        silent = (times[None, :] < self.start[:, None]) | (times[None, :] >= self.end[:, None])
        for column in (delay, doppler_factor, gain, departure, arrival):
            column[silent] = np.nan
        shift = (doppler_factor - 1.0) * centres[self.source][:, None]
        return PathTable(
            times, self.source, self.receiver, self.order, self.interactions, self.objects, self.order == 0,
            delay, doppler_factor, shift, gain, departure, arrival,
            *self._names(), self.object_names,
        )  # fmt: skip

    def to_dataframe(self, times: Floats, motion: str = "retarded", amplitude: str = "wave-equation") -> Any:
        """Table of paths as a pandas DataFrame, by `times` (T,), s, `motion` and `amplitude` as for `table`."""
        return self.table(times, motion, amplitude).to_dataframe()

    def to_xarray(self, times: Floats, motion: str = "retarded", amplitude: str = "wave-equation") -> Any:
        """Table of paths as an xarray Dataset, by `times` (T,), s, `motion` and `amplitude` as for `table`."""
        return self.table(times, motion, amplitude).to_xarray()

    def cir(
        self, times: Floats, *, carrier: float, motion: str = "retarded", amplitude: str = "wave-equation"
    ) -> ChannelPaths:
        """Return the complex gain about a carrier, and the absolute delay, of every path.

        Parameters
        ----------
        times : array_like (T,)
            Times of reception, s.
        carrier : float
            At which air, walls and directivities are taken, Hz.
        motion, amplitude : str
            As in `render`.

        Raises
        ------
        InputError
            If a wall or directivity is not known at the carrier.
        """
        times = as_floats("times", times, (None,))
        delay, _, gain = self._channel(times, carrier, Kinematics(motion, amplitude))
        ends, gain = (self.source, self.receiver), read_only(gain)
        return ChannelPaths(times, *ends, read_only(delay), gain, float(carrier), *self._names())

    def taps(
        self, times: Floats, *, carrier: float, bandwidth: float, sampling_rate: float, motion: str = "retarded",
        amplitude: str = "wave-equation",
    ) -> ChannelTaps:  # fmt: skip
        """Return the channel as a filter of complex envelopes that changes with time, exact over a band.

        Parameters
        ----------
        times : array_like (T,)
            Times of reception, s; any, for they need not follow the sampling rate.
        carrier : float
            Hz.
        bandwidth : float
            Width of the band about the carrier, both sides together, within which the filter is exact, Hz.
        sampling_rate : float
            Sampling rate of the taps and of the envelope that they filter, at least 1.25 times the bandwidth, Hz.
        motion, amplitude : str
            As in `render`.

        Raises
        ------
        InputError
            If a value is out of bounds, a wall or directivity is not known over the band, or the taps would be more
            than 8 GiB.

        Notes
        -----
        Air, walls and directivities act over the whole band. A path exists or not: the transition of `render`, in which
        it fades in and out, is left out.
        """
        times, band = as_floats("times", times, (None,)), ChannelBand(carrier, bandwidth, sampling_rate)
        span = self.start, self.end
        gain, first = channel_taps(self.scene, self.pairs(), span, times, band, Kinematics(motion, amplitude))
        delays = (first + np.arange(gain.shape[2])) / band.sampling_rate
        return ChannelTaps(
            times, read_only(delays), read_only(gain), band.carrier, band.bandwidth, band.sampling_rate, *self._names()
        )

    def delay_doppler(
        self, time: float, duration: float, *, carrier: float, motion: str = "retarded",
        amplitude: str = "wave-equation",
    ) -> DelayDoppler:  # fmt: skip
        """Return every path as a point of delay and Doppler shift over a time.

        Parameters
        ----------
        time : float
            Time of reception at the start, s.
        duration : float
            Duration, s.
        carrier : float
            Hz.
        motion, amplitude : str
            As in `render`.

        Raises
        ------
        InputError
            If a wall or directivity is not known at the carrier.
        """
        begin = as_number("time", time, at_least=0.0, unit="s")
        length = as_number("duration", duration, above=0.0, unit="s")
        times = begin + length * np.array([0.0, 0.5, 1.0])
        delay, rate, gain = self._channel(times, carrier, Kinematics(motion, amplitude))
        shift = -float(carrier) * rate
        return DelayDoppler(
            begin, length, self.source, self.receiver, read_only(delay[:, 1]), read_only(shift[:, 1]),
            read_only(gain[:, 1]), read_only(delay[:, 2] - delay[:, 0]), read_only(shift[:, 2] - shift[:, 0]),
            float(carrier),
        )  # fmt: skip

    def _channel(self, times: Floats, carrier: float, kinematics: Kinematics) -> tuple[Floats, Floats, Complexes]:
        return channel_paths(self.scene, self.pairs(), (self.start, self.end), times, carrier, kinematics)

    def _names(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        return tuple(s.name for s in self.scene.sources), tuple(r.name for r in self.scene.receivers)

    def show(self, duration: float | None = None, frames: int = 120, limit: int = 300, height: int = 600) -> Any:
        """Return the viewer page of the room, the motion and the paths over time, for a notebook.

        Parameters
        ----------
        duration : float, optional
            Until when, s; until the first trajectory ends when left out.
        frames : int
            Instants to choose from, 1 to 10 000.
        limit : int
            Strongest paths that are drawn, 1 to 100 000.
        height : int
            Pixels, 100 to 10 000.
        """
        frames = as_count("frames", frames, at_least=1, at_most=10_000)
        limit = as_count("limit", limit, at_least=1, at_most=100_000)
        height = as_count("height", height, at_least=100, at_most=10_000)
        longest = known_until(self.scene.named_ends())
        until = longest if duration is None else as_number("duration", duration, at_least=0.0, unit="s")
        return inline_page(paths_page(self, title="paths", duration=until, frames=frames, limit=limit), height)

    def _repr_html_(self) -> str:
        kinds, scene = np.unique(self.order), self.scene
        rows = [(n, int(np.sum(self.order == n)), self._seconds(self.order == n)) for n in kinds.tolist()]
        pairs = len(np.unique(self.source.astype(np.int64) * len(scene.receivers) + self.receiver))
        ends = f"{counted(len(scene.sources), 'source')}, {counted(len(scene.receivers), 'receiver')}"
        title = f"PathSet: {counted(len(self), 'interval')} of paths, {ends}"
        silent = len(scene.sources) * len(scene.receivers) - pairs
        notes = [f"{silent} pairs of source and receiver have none"] if silent else []
        return html_table(title, ("order", "intervals", "active"), rows, notes)

    def _seconds(self, rows: NDArray[np.bool_]) -> str:
        """Total length of intervals, as a text."""
        total = float(np.sum(self.end[rows] - self.start[rows]))
        return f"{total:.4g} s" if np.isfinite(total) else "always"

    def vertices(self, time: float, motion: str = "retarded") -> Floats:
        """Points where every path received at a time leaves, meets something and arrives.

        Parameters
        ----------
        time : float
            Time of reception, s.
        motion : {"retarded", "quasi-static"}
            As in `render`.

        Returns
        -------
        ndarray (paths, N + 2, 3)
            Source, points of interaction and receiver, m; NaN behind the receiver of paths of fewer interactions, and
            for paths that are not active at that time.
        """
        found = np.full((len(self), self.interactions.shape[1] + 2, 3), np.nan)
        for rows, pair in self.pairs():
            vertices_of = pair.family.vertices(pair.rows, time, Kinematics(motion))
            found[rows, : vertices_of.shape[1]] = vertices_of
        found[~((self.start <= time) & (time < self.end))] = np.nan
        return found
