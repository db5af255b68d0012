"""Kinds of paths: what every table, picture and engine asks of a path, whatever happens to it on its way."""

from __future__ import annotations

import hashlib
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from itertools import pairwise
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Complexes, Floats, by_value
from clsim.errors import InputError
from clsim.paths.propagation import Medium, SpeedRange, medium_of
from clsim.paths.response import RETARDED, Arrivals, Kinematics, SceneResponse, is_complex, to_transducer_frame
from clsim.scene.directivity.directivity import ChannelDirectivity
from clsim.scene.ends import Receiver, Source
from clsim.scene.scatterer import Scatterer
from clsim.scene.scene import Scene

Rows = slice | NDArray[np.int64]  # of a kind of paths
NONE, SPECULAR, DIFFRACTION, SCATTERING, BODY, TRANSMISSION = -1, 0, 1, 2, 3, 4  # kinds of interaction


@dataclass(frozen=True, slots=True, eq=False)
class PathFamily(ABC):
    """Paths of one kind, as columns of equal length: a kind owns its columns and its law.

    A kind adds columns of its own, names them in `columns`, and defines the abstract methods; the others have answers
    that hold for paths by things that rest. Rows are a slice or an array of indices.

    Attributes
    ----------
    interactions : ndarray (paths, N) int
        Interactions in order from the source: `SPECULAR`, `DIFFRACTION`, `SCATTERING`, `BODY`, `TRANSMISSION`;
        filled up with `NONE`.
    objects : ndarray (paths, N) int
        To which wall that happens (specular, transmission) or to which of `object_names`; filled up with -1.
    object_names : tuple of str
        Names of objects that are no walls.
    """

    scene: Scene  # where they are
    source: NDArray[np.int32]  # (paths,) indices in the scene, and number of interactions
    receiver: NDArray[np.int32]  # likewise
    order: NDArray[np.int32]  # likewise
    start: Floats  # (paths,) interval of reception in which each is heard, s
    end: Floats  # likewise
    interactions: NDArray[np.signedinteger[Any]]
    objects: NDArray[np.signedinteger[Any]]

    columns: ClassVar[tuple[str, ...]] = ()  # a kind's own fields with a row per path

    @abstractmethod
    def arrivals(self, rows: Rows, times: Floats, kinematics: Kinematics = RETARDED) -> Arrivals:
        """Return delays, directions and lengths of paths between one source and one receiver."""

    @abstractmethod
    def response(self, rows: Rows, found: Arrivals, times: Floats, at: SceneResponse) -> Floats | Complexes:
        """Return received over emitted pressure at 1 m, (P, T, F), without the delay."""

    def of_channels(self, paths: PairPaths, found: Arrivals, times: Floats, at: SceneResponse) -> Floats | Complexes:
        """Return responses of the paths of a pair by channel of the receiver, (C, P, T, F)."""
        receiver = self.scene.receivers[paths.receiver]
        return at.of_channels(paths.response(found, times, at), receiver, paths.channels, found, times)

    @abstractmethod
    def vertices(self, rows: Rows, time: float, kinematics: Kinematics = RETARDED) -> Floats:
        """Return source, points of interaction and receiver (P, N + 2, 3) of paths between one source and one receiver.

        They are those of what is received at a time, s; NaN behind the receiver of paths of fewer interactions.
        """

    @abstractmethod
    def lengths(self, rows: Rows, source: Floats, receiver: Floats) -> Floats:
        """Lengths of paths (P,) of any pairs with their endpoints at rest at places (P, 3), m."""

    def delay_bounds(self, rows: Rows, start: Instant, end: Instant, speeds: PeakSpeeds) -> tuple[Floats, Floats]:
        """Return bounds (P,) on the delays of paths of any pairs between two times of reception, s."""
        scene, source, receiver = self.scene, self.source[rows], self.receiver[rows]
        middle, half = 0.5 * (start + end), 0.5 * (end - start)
        length = self.lengths(rows, ends_at(scene.sources, source, middle), ends_at(scene.receivers, receiver, middle))
        source_speed, receiver_speed = speeds.source[source], speeds.receiver[receiver]
        return self.speed_range.delay_bounds(length, half * (source_speed + receiver_speed), source_speed)

    def gain_bound(self, rows: Rows, at: SceneResponse) -> Floats:
        """Return bounds (P, F) of responses without directivities and motion, relative to free air of the same length.

        What has none is never left out.
        """
        return np.full((len(self.source[rows]), len(at.frequencies)), np.inf)

    def max_rate(self, source_speed: float, receiver_speed: float) -> float:
        """Return a bound on how fast delays change with the time of reception, s/s, from the ends' speeds, m/s."""
        return self.speed_range.max_delay_rate(source_speed, receiver_speed)

    def medium(self, source: int) -> Medium:
        """Medium of a source's sound: its delays are those of the centre frequency's phase."""
        return medium_of(self.scene.air, self.scene.sources[source].emitted.centre_frequency)

    @property
    def speed_range(self) -> SpeedRange:
        """Bounds of the speed of sound of all sources."""
        media = [self.medium(source) for source in range(len(self.scene.sources))]
        bounds = min(m.slowest for m in media), max(m.fastest for m in media)
        return SpeedRange(*bounds, self.scene.air.fluctuation)

    @property
    def device(self) -> str | None:
        """Program that knows this kind's columns (see ``render/opencl/path_columns.py``), or None."""
        return None

    @property
    def is_complex(self) -> bool:
        """Whether responses have phases."""
        return is_complex(self.scene)

    @property
    def is_specular(self) -> bool:
        """Whether paths are images of `Chain`."""
        return False

    @property
    def costly(self) -> bool:
        """Whether responses cost so much that they are taken at few instants where they change slowly."""
        return False

    @property
    def varies(self) -> bool:
        """Whether the response of a path changes over a run so much that a few instants do not tell of all."""
        return False

    @property
    def shapes_channels(self) -> bool:
        """Whether responses of channels whose gains are the same at every frequency differ over frequency."""
        return False

    @property
    def one_by_one(self) -> bool:
        """Whether `response` takes an instant of its own for each path: times (P, 1) in place of (T,)."""
        return False

    @property
    def moves(self) -> bool:
        """Whether paths change though both ends rest."""
        return self.scene.air.fluctuation is not None

    @property
    def object_names(self) -> tuple[str, ...]:
        """Names of things other than walls."""
        return ()

    @property
    def walls(self) -> NDArray[np.signedinteger[Any]]:
        """Walls of specular reflections (paths, N) from the source's side, -1 elsewhere."""
        return np.where(self.interactions == SPECULAR, self.objects, -1)

    def ends(self, rows: Rows) -> tuple[Source, Receiver]:
        """Return the source and the receiver of paths of one pair."""
        source, receiver = self.source[rows], self.receiver[rows]
        return self.scene.sources[source[0]], self.scene.receivers[receiver[0]]

    def digest(self) -> str:
        """Return a hash of all fields but the scene."""
        found = hashlib.sha256(self.identity.encode())
        for name, value in self.hashed():
            found.update(name.encode())
            if isinstance(value, np.ndarray):
                found.update(f"{value.dtype.str}{value.shape}".encode())
            found.update(value.tobytes() if isinstance(value, np.ndarray) else repr(value).encode())
        return found.hexdigest()

    @property
    def identity(self) -> str:
        """Name of the kind, which never changes: runs are resumed by it."""
        return f"{type(self).__module__}.{type(self).__qualname__}"

    def hashed(self) -> Iterator[tuple[str, Any]]:
        """Yield names and values of all fields but the scene."""
        for field in fields(self):
            if field.name != "scene":
                yield field.name, getattr(self, field.name)

    def part(self, rows: Rows) -> Self:
        """Return some of the paths."""
        own = [f.name for f in fields(PathFamily) if f.name != "scene"] + list(self.columns)
        given = {f.name for f in fields(self) if f.init}
        return replace(self, **{name: getattr(self, name)[rows] for name in own if name in given})

    def in_scene(self, scene: Scene) -> Self:
        """Return the same paths, by the same things, in a scene that differs a little; intervals stay as they are."""
        return replace(self, scene=scene)

    def pairs(self) -> Iterator[PairPaths]:
        """Yield the paths of every source and receiver that have any, in order."""
        receivers = len(self.scene.receivers)
        pair = self.source.astype(np.int64) * receivers + self.receiver
        in_order = bool(np.all(pair[1:] >= pair[:-1]))
        order = np.arange(0) if in_order else np.argsort(pair, kind="stable")
        every = np.arange(len(self.scene.sources) * receivers + 1)
        bounds = np.searchsorted(pair if in_order else pair[order], every).tolist()
        for i, (first, last) in enumerate(pairwise(bounds)):
            if first < last:
                rows = slice(first, last) if in_order else order[first:last]  # a slice is no copy
                yield PairPaths(self, rows, *divmod(i, receivers))

    def __len__(self) -> int:
        return len(self.source)

    def check(self) -> None:
        """Refuse columns of other shapes than those of the paths; a `PathSet` asks it of each of its families."""
        for name in (*(f.name for f in fields(PathFamily) if f.name != "scene"), *self.columns):
            if (rows := len(getattr(self, name))) != len(self.source):
                raise InputError(name, f"must have one row per path, {len(self.source)}, but has {rows}")
        if self.objects.shape != self.interactions.shape:
            shapes = f"{self.interactions.shape}, but has {self.objects.shape}"
            raise InputError("objects", f"must have the shape of interactions, {shapes}")


@dataclass(frozen=True, slots=True, eq=False)
class PairPaths:
    """Paths of one kind from one source to one receiver."""

    family: PathFamily  # whose paths
    rows: Rows  # (P,) which of them
    source: int  # indices in the scene
    receiver: int  # likewise
    channels: range | None = None  # of the receiver, those that share a delay; None for all, delays being the centre's

    def __len__(self) -> int:
        return len(self.family.source[self.rows])

    @property
    def index(self) -> NDArray[np.int64]:
        """The rows as indices (P,)."""
        if isinstance(self.rows, slice):
            return np.arange(*self.rows.indices(len(self.family)))
        return self.rows

    def part(self, rows: NDArray[np.int64]) -> PairPaths:
        """Return some of the paths, by their places among these."""
        return replace(self, rows=self.index[rows])

    def arrivals(self, times: Floats, kinematics: Kinematics = RETARDED) -> Arrivals:
        """Return delays, directions and lengths; see `PathFamily.arrivals`."""
        return self.family.arrivals(self.rows, times, kinematics)

    def response(self, found: Arrivals, times: Floats, at: SceneResponse) -> Floats | Complexes:
        """Return responses (P, T, F); see `PathFamily.response`. Those of several channels are at their centre."""
        return self.family.response(self.rows, found, times, at)

    def responses(self, found: Arrivals, times: Floats, at: SceneResponse) -> Floats | Complexes:
        """Return responses by channel of the receiver, (C, P, T, F)."""
        return self.family.of_channels(self, found, times, at)

    def lateness(self, found: Arrivals, times: Floats) -> Floats:
        """Return the delays of all channels behind the receiver's centre, (P, T, C), s."""
        receiver = self.family.scene.receivers[self.receiver]
        assert isinstance(receiver.directivity, ChannelDirectivity)
        towards = to_transducer_frame(receiver.orientation, times, found.arrival)
        return np.asarray(receiver.directivity.lateness(towards, self.family.scene.air.speed_of_sound))

    def emission_lateness(self, found: Arrivals, times: Floats) -> Floats:
        """Return the same by the source's clock, which is that of delays: more for a source that comes nearer."""
        return np.asarray(self.lateness(found, times) * (1.0 - found.delay_rate)[..., None])

    @property
    def only_channel(self) -> int:
        """The channel whose delay the paths have."""
        assert self.channels is not None
        return self.channels.start

    @property
    def reach(self) -> float:
        """Bound of the magnitude of `lateness`, s; 0 where the delay is that of the centre."""
        directivity = self.family.scene.receivers[self.receiver].directivity
        known = self.channels is not None and isinstance(directivity, ChannelDirectivity)
        return directivity.reach if known and isinstance(directivity, ChannelDirectivity) else 0.0

    def by_delay(self) -> list[PairPaths]:
        """Return the same paths for each group of channels that share a delay: all of them, or each of its own."""
        directivity = self.family.scene.receivers[self.receiver].directivity
        count = len(directivity.channels)
        apart = isinstance(directivity, ChannelDirectivity) and directivity.reach > 0.0
        groups = [range(i, i + 1) for i in range(count)] if apart else [range(count)]
        return [replace(self, channels=group) for group in groups]

    def gain(self, found: Arrivals, times: Floats) -> Floats | Complexes:
        """Return responses (P, T) at the centre frequency of what the source emits."""
        scene = self.family.scene
        centre = np.array([scene.sources[self.source].emitted.centre_frequency])
        return self.family.response(self.rows, found, times, SceneResponse(scene, self.source, centre))[..., 0]

    def group_delay_offset(self, found: Arrivals, frequency: float | None = None) -> Floats:
        """Group delay minus phase delay (P, T) at a frequency, s.

        The frequency is the centre of what the source emits where left out. What air does is counted from 1 m on,
        where the emitted pressure is told.
        """
        centre = self.family.scene.sources[self.source].emitted.centre_frequency
        chosen = centre if frequency is None else frequency
        offset = self.family.scene.air.by_height(
            lambda air: 1.0 / air.group_speed_at(chosen) - 1.0 / air.speed_at(centre)
        )
        mean = offset[0] if found.means is None else found.means @ offset
        return np.asarray(mean * (found.through - 1.0) * found.frequency_ratio)


@dataclass(frozen=True, slots=True, eq=False)
class PeakSpeeds:
    """Bounds of the speeds of the sources (S,) and the receivers (R,) of a scene, m/s."""

    source: Floats
    receiver: Floats


Instant = Any  # a time, or times (P,), s


def ends_at(
    ends: Sequence[Source] | Sequence[Receiver] | Sequence[Scatterer], which: NDArray[np.int32], times: Instant
) -> Floats:
    """Return the positions (P, 3) of sources, receivers or scatterers (P,) at a time, or at times (P,), m."""
    instants = np.broadcast_to(np.asarray(times, dtype=np.float64), which.shape)
    new = np.ones(len(which), dtype=bool)  # neighbours that are the same are looked at once
    new[1:] = (which[1:] != which[:-1]) | (instants[1:] != instants[:-1])
    first = np.flatnonzero(new)
    at = np.empty((len(first), 3))
    for end, mine in by_value(which[first]):
        at[mine] = ends[end].trajectory.position(instants[first[mine]])
    return np.repeat(at, np.diff([*first.tolist(), len(which)]), axis=0)
