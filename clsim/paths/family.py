"""Interfaces of kinds of paths, which tables, pictures and engines use, and of their legs and vertices.

A *leg* is a part of a path between two vertices or endpoints, reflected by any number of surfaces. A *vertex* is a
point at which a path changes direction otherwise: an edge, two edges, a scatterer. The paths of one kind of
leg and one kind of vertex are a `Chain`: specular paths are one static leg, edge paths a static leg, an edge and a
static leg, paths by a scatterer behind a body a moving leg, a scatterer and a moving leg.

Whatever tables, engines and searches ask of a path is asked of `Chain`, once. What depends on the kind of leg is a
method of `Links`: they solve the delay equation, the last leg first. A leg names its class as `links`. What depends on
the kind of vertex is a method of `Vertex`: where sound passes it (Fermat's principle), and what it makes of the sound.
A new kind of vertex is a class with the members of `Vertex`, a search that finds its paths, and its names in
``chain.py``.

Columns of legs and vertices have one row per path. A vertex with shadow boundaries (an edge) holds for each row the
side of each boundary on which the row is; its field goes on smoothly beyond the row's ends, so that the terms of both
sides cancel there.
"""

from __future__ import annotations

import hashlib
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from itertools import pairwise
from typing import Any, ClassVar, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Complexes, Floats, by_value
from clsim.errors import InputError
from clsim.paths.propagation import Medium, SpeedRange, UniformAir, medium_of
from clsim.paths.response import RETARDED, Arrivals, Kinematics, SceneResponse, is_complex, to_transducer_frame
from clsim.scene.directivity.directivity import ChannelDirectivity
from clsim.scene.ends import Receiver, Source
from clsim.scene.scatterer import Scatterer
from clsim.scene.scene import Scene

Rows = slice | NDArray[np.int64]  # of a kind of paths
NONE, SPECULAR, DIFFRACTION, SCATTERING, BODY, TRANSMISSION, SHADOW = -1, 0, 1, 2, 3, 4, 5  # kinds of interaction


@dataclass(frozen=True, slots=True, eq=False)
class PathFamily(ABC):
    """Paths of one kind, as columns of equal length: a kind owns its columns and its law.

    A kind adds columns of its own, names them in `columns`, and defines the abstract methods; the others have answers
    that hold for paths by things that rest. Rows are a slice or an array of indices.

    Attributes
    ----------
    interactions : ndarray (paths, N) int
        Interactions in order from the source: `SPECULAR`, `DIFFRACTION`, `SCATTERING`, `BODY`, `TRANSMISSION`,
        `SHADOW`; filled up with `NONE`.
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

    def unshaded(self, rows: Rows, found: Arrivals, times: Floats, at: SceneResponse) -> Floats | Complexes:
        """Return responses (P, T, F) relative to which errors count: those of paths, or of the paths in a shadow."""
        return self.response(rows, found, times, at)

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
    def adds(self) -> bool:
        """Whether paths are what others change by, relative to which errors count, see `unshaded`."""
        return False

    @property
    def silent_ends(self) -> bool:
        """Whether nothing is heard of paths where they begin or end."""
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


Integers = NDArray[np.signedinteger[Any]]
Columns = dict[str, Floats]
Pair = tuple[Floats, Floats]  # of source and receiver


class Vertex(Protocol):
    """Columns of P vertices of one kind.

    Attributes
    ----------
    kind : str
        Word for it.
    interaction : int
        Number of the kind, see `PathFamily`.
    names : tuple of str
        Objects that can be vertices.
    objects : ndarray (P,), (P, 2) or (P, 3)
        Number of each vertex, or of all edges of each, among the names.
    moves : bool
        Whether any vertex moves.
    radius : ndarray (P,) or float
        Half of the length by which paths may be shorter than `lengths`, m.
    swiftest : float or None
        Bound of the speed of any vertex, m/s; None for vertices of the room.
    nodes_at_a_time : int
        Number of nodes that are solved together.
    is_complex, varies, costly, one_by_one : bool
        Whether responses have phases; whether they change so much that a few instants do not tell of all; whether they
        are taken at few instants where they change slowly; whether each path may have an instant of its own.
    """

    def part(self, rows: Rows) -> Self:
        """Take some of the vertices."""

    def in_scene(self, scene: Scene) -> Self:
        """Make the same vertices in a scene that differs a little."""

    def named(self, moving: bool) -> Iterator[tuple[str, Any]]:
        """Yield the columns on moving or static legs, as they are hashed."""

    def groups(self) -> list[NDArray[np.int64]]:
        """List vertices that can be solved together."""

    @property
    def on_device(self) -> bool:
        """Whether a program of nodes knows these vertices, if it knows their kind in the medium."""

    def speeds(self, moving: bool) -> Floats:
        """Bound the speeds of the vertices on moving or static legs, (P,) m/s."""

    def on_static_legs(self, links: Links, times: Floats, kinematics: Kinematics) -> Arrivals:
        """Solve paths between static legs at times of reception (T,), s."""

    def on_moving_legs(self, links: Links, medium: UniformAir, times: Floats, kinematics: Kinematics) -> Any:
        """Solve paths between moving legs; the result has the `Events` of both legs as `first` and `last`."""

    def passed(self, events: Any, kinematics: Kinematics) -> Columns:
        """Compute ``length``, ``mach_factor`` and what else `respond` needs from what `on_moving_legs` found."""

    def places(self, links: Links, ends: Pair, times: Floats, kinematics: Kinematics) -> tuple[Floats, ...]:
        """Locate the first to last points (P, 3) of vertices between static legs, m; one point counts as both."""

    def respond(self, links: Links, found: Arrivals, times: Floats, passing: Any, at: SceneResponse) -> Any:
        """Compute responses (P, T, F) with the vertex's field, spreading, and what air and legs let pass (P, T, F)."""

    def largest(self, links: Links, at: SceneResponse) -> Floats | float:
        """Bound responses over those of the legs in free air of the same length, (P, F)."""

    def lengths(self, links: Links, ends: Pair, images: Pair, times: Instant) -> Floats:
        """Compute lengths (P,) between endpoints (P, 3), and their images, on static legs, m."""

    def moving_lengths(self, links: Links, ends: Pair, times: Instant) -> Floats:
        """Compute lengths (P,) between endpoints (P, 3) on moving legs, m."""

    def __len__(self) -> int: ...


@dataclass(frozen=True, slots=True, eq=False)
class Links(ABC):
    """Legs and vertices of some paths of a chain; a class for each kind of leg."""

    chain: Any  # `Chain` of which these are
    rows: Rows  # (P,) which
    legs: tuple[Any, ...]  # of these paths alone
    vertex: Any  # likewise
    ends: tuple[Any, ...]  # source and receiver of the first path; none without paths
    motions: tuple[Any, ...]  # their trajectories

    @abstractmethod
    def solve(self, times: Floats, kinematics: Kinematics) -> Arrivals:
        """Solve the delay equation of paths at times of reception (T,), s."""

    @abstractmethod
    def places(self, time: float, kinematics: Kinematics) -> Floats:
        """Locate source, interactions and receiver (P, N + 2, 3) of what is received at a time (s), m."""

    @abstractmethod
    def lengths(self, source: Floats, receiver: Floats, times: Instant) -> Floats:
        """Compute lengths (P,) between endpoints (P, 3), m, with all else where it is at times (P,) or one time, s."""

    @property
    @abstractmethod
    def surfaces(self) -> tuple[Integers, ...]:
        """Surfaces (P, N) of each leg: of static ones from the endpoint's side, of moving ones from the source's."""

    @property
    @abstractmethod
    def all_surfaces(self) -> Integers:
        """Surfaces (P, N) of all legs, -1 for none."""

    def part(self, rows: NDArray[np.int64]) -> Links:
        """Return the links of some of the paths, by their places among these."""
        some: Links = self.chain.links(np.arange(len(self.chain))[self.rows][rows])
        return some

    @property
    def medium(self) -> Medium:
        """Medium of the sound."""
        medium: Medium = self.chain.medium(int(self.chain.source[self.rows][0]))
        return medium

    def __len__(self) -> int:
        return len(self.legs[0])


def in_chunks(
    links: Links, times: Floats, nodes: int, solve: Callable[[Links, Floats], Columns],
    groups: list[NDArray[np.int64]] | None = None,
) -> Arrivals:  # fmt: skip
    """Solve paths at times (T,), so many nodes at a time that what is worked on stays in the cache."""
    if groups is None:
        groups = [np.arange(len(links))] if links.vertex is None else links.vertex.groups()
    columns: Columns = {}
    for mine in groups:
        some = links if len(mine) == len(links) else links.part(mine)
        parts = max(-(-len(times) * len(mine) // nodes), 1)
        for part in range(parts):
            here = slice(part * len(times) // parts, (part + 1) * len(times) // parts)
            for name, values in solve(some, times[here]).items():
                if name not in columns:
                    columns[name] = np.empty((len(links), len(times), *values.shape[2:]))
                columns[name][mine, here] = values
    always = {field.name: columns.pop(field.name) for field in fields(Arrivals) if field.name in columns}
    return Arrivals(**always, means=None, more=columns)


def met_in_order(
    counts: tuple[int, int], before: Integers, vertex: tuple[int, Integers] | None, after: Integers | None,
    between: Integers | None = None,
) -> tuple[Integers, Integers]:  # fmt: skip
    """Make interactions and objects (P, N) of paths from their surfaces and vertices, and counts of walls and faces."""
    walls, faces = counts
    things, at_vertex = before, NONE if vertex is None else vertex[0]
    if vertex is not None and after is not None:
        own = faces + np.atleast_2d(vertex[1].T).T
        inner = own[:, :0] if between is None else between  # mirrors between two vertices
        things = np.concatenate([before, own[:, :1], inner, own[:, 1:], after], axis=1)
    things = np.take_along_axis(things, np.argsort(things < 0, axis=1, kind="stable"), axis=1)
    kinds = np.select([things < 0, things < walls, things < faces], [NONE, SPECULAR, BODY], at_vertex)
    return kinds.astype(np.int8), np.where(things >= walls, things - walls, things)
