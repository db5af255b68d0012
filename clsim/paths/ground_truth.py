"""Ground truth: the direct sound for location systems, and ranges, speeds and bearings of targets for sonars."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from clsim.acoustics.scattering import SpecularPoint
from clsim.arrays import Floats, as_choice, as_floats, read_only, short_repr, texts
from clsim.errors import InputError, check_packages
from clsim.numerics.quaternions import rotate
from clsim.paths.chain import check_support
from clsim.paths.family import PairPaths
from clsim.paths.legs.events import Events
from clsim.paths.legs.legs import direct_paths
from clsim.paths.legs.mirrors import Mirrors
from clsim.paths.path_set import PathSet
from clsim.paths.path_table import categories, labelled_dataset, labelled_frame
from clsim.paths.propagation import mean_medium_of
from clsim.paths.response import Kinematics, slices_of
from clsim.paths.search.scatterers import direct_legs
from clsim.paths.vertices.scatterer_paths import find_scattered
from clsim.paths.visibility.obstacles import Legs, Obstacles
from clsim.scene.scatterer import PointShape, Scatterer
from clsim.scene.scene import Scene

SCALARS = ("delay", "doppler_factor", "line_of_sight", "radial_speed", "reception_time")
VECTORS = ("arrival", "local_arrival", "source_position", "receiver_position")
_NEWTON_LIMIT = 60


@dataclass(frozen=True, slots=True, eq=False)
class DirectPath:
    """The direct sound between every source and receiver, (sources, receivers, T).

    Attributes
    ----------
    times : ndarray (T,)
        The instants that were given, s, by the scene's clock: of emission where `emitted` is true, else of
        reception.
    delay : ndarray (sources, receivers, T)
        From emission to reception, s, also where a wall is in the way; group delays in air that disperses.
    radial_speed : ndarray (sources, receivers, T)
        Speed of sound times the change of the delay by time of reception, ``c (1 - doppler_factor)``, m/s; positive
        where they part.
    reception_time : ndarray (sources, receivers, T)
        Times of reception, s; the sound was emitted at ``reception_time - delay``.
    arrival : ndarray (sources, receivers, T, 3)
        Unit vectors from the receiver back along the path, in the room; in wind normals of the wavefront.
    local_arrival : ndarray (sources, receivers, T, 3)
        The same in the axes of the receiver as it is turned at reception: +x is where it faces.
    """

    times: Floats
    delay: Floats
    doppler_factor: Floats  # (sources, receivers, T) received over emitted frequency, also where a wall is in the way
    line_of_sight: NDArray[np.bool_]  # (sources, receivers, T) whether the direct sound is received
    radial_speed: Floats
    reception_time: Floats
    arrival: Floats
    local_arrival: Floats
    source_position: Floats  # (sources, receivers, T, 3) the source at emission and the receiver at reception, m
    receiver_position: Floats  # likewise
    source_names: tuple[str, ...]  # along the first two axes
    receiver_names: tuple[str, ...]  # likewise
    emitted: bool  # whether `times` are times of emission

    def tdoa(self, reference: str | None = None) -> Floats:
        """Return the time differences of arrival of one emission at all receivers.

        reference: name of the receiver whose reception is subtracted; the first one where left out.

        Delays at one time of reception belong to different emissions. Their differences are no TDOA: they are wrong by
        the share ``v / c``, v the radial speed of the source; at 1.7 m/s that is 5 mm per metre.
        """
        if not self.emitted:
            raise InputError("emitted", "must be given to direct_path for a TDOA, but the times are of reception")
        names = self.receiver_names
        row = 0 if reference is None else names.index(as_choice("reference", reference, names))
        return np.asarray(self.reception_time - self.reception_time[:, row : row + 1])

    def to_dataframe(self) -> Any:
        """Return it as a pandas DataFrame, a row per source, receiver and time.

        result: columns ``times``, ``source``, ``receiver`` and a column for each field, vectors as ``arrival_x`` and so
        on; texts as categories, as in `PathTable.to_dataframe`; ``attrs["units"]`` holds the units.
        """
        check_packages("to_dataframe", "a DataFrame", "tables", "pandas")
        source, receiver, at = (index.ravel() for index in np.indices(self.delay.shape))
        columns = {
            "times": self.times[at],
            "source": categories(self.source_names, source),
            "receiver": categories(self.receiver_names, receiver),
        }
        columns |= {name: getattr(self, name).ravel() for name in SCALARS}
        for name in VECTORS:
            columns |= {f"{name}_{axis}": getattr(self, name)[..., i].ravel() for i, axis in enumerate("xyz")}
        return labelled_frame(columns)

    def to_xarray(self) -> Any:
        """Return it with named dimensions ``source``, ``receiver``, ``times`` and ``axis``, coordinates and units."""
        over = ("source", "receiver", "times")
        coordinates = {
            "source": ("source", texts(self.source_names)), "receiver": ("receiver", texts(self.receiver_names)),
            "times": ("times", self.times), "axis": ("axis", list("xyz")),
        }  # fmt: skip
        scalars = {name: (over, getattr(self, name)) for name in SCALARS}
        vectors = {name: ((*over, "axis"), getattr(self, name)) for name in VECTORS}
        dataset = labelled_dataset(scalars | vectors, coordinates)
        if self.emitted:
            dataset["times"].attrs["long_name"] = "time of emission"
        return dataset


def direct_path(
    paths: PathSet, times: Floats | None = None, motion: str = "retarded", *, emitted: Floats | None = None
) -> DirectPath:
    """Return the ground truth of the direct sound, by time of reception or of emission.

    Parameters
    ----------
    paths : PathSet
        Paths of the scene.
    times : array_like (T,), optional
        Times of reception, s, by the scene's clock: what a receiver gets at one instant.
    motion : {"retarded", "quasi-static"}
        As in `render`.
    emitted : array_like (T,), optional
        Times of emission, s, in place of times of reception: the same sound at all receivers, as for TDOA.

    Notes
    -----
    What is emitted at ``t_e`` is received at the solution of ``t - delay(t) = t_e``.

    Times beyond the ends of a trajectory are taken as `render` takes them: 0.05 s beyond an end it comes to rest.

    Examples
    --------
    >>> import clsim
    >>> room = clsim.Shoebox((8.0, 6.0, 3.0), clsim.Material.from_reflection(0.9))
    >>> tone = clsim.Signal.tone(40e3, duration=0.01, sampling_rate=192e3)
    >>> source = clsim.Source("s", tone, clsim.Trajectory.fixed((1.0, 3.0, 1.5)))
    >>> ends = [(4.0, 3.0, 1.5), (5.0, 3.0, 1.5)], [(2.0, 3.0, 1.5), (2.0, 3.0, 1.5)]
    >>> receivers = [clsim.Receiver(n, clsim.Trajectory.line(*e, duration=1.0)) for n, e in zip("ab", ends)]
    >>> paths = clsim.find_paths(clsim.Scene(room, clsim.Air(speed_of_sound=340.0), [source], receivers), 0)
    >>> truth = direct_path(paths, [0.0, 0.5])
    >>> truth.delay[0, 0] * 340.0, truth.radial_speed[0, 0].round(9), truth.line_of_sight[0, 0]
    (array([3. , 3.5]), array([1., 1.]), array([ True,  True]))
    >>> direct_path(paths, emitted=[0.0]).tdoa("b")[0, 0].round(9)  # 3 m / (339 m/s) - 1 m / (340 m/s)
    array([0.00590838])
    """
    if not isinstance(paths, PathSet):
        raise InputError("paths", f"must be a PathSet, but is {paths!r:.80}")
    if (times is None) == (emitted is None):
        raise InputError("times", f"must be given or else emitted, but {'neither is' if times is None else 'both are'}")
    kinematics = Kinematics(motion)
    scene, by_emission = paths.scene, emitted is not None
    instants = as_floats("emitted" if by_emission else "times", emitted if by_emission else times, (None,))
    names = tuple(s.name for s in scene.sources), tuple(r.name for r in scene.receivers)
    shape = (len(scene.sources), len(scene.receivers), len(instants))
    found = {name: np.empty(shape) for name in ("delay", "rate", "reception_time")}
    found |= {name: np.empty((*shape, 3)) for name in VECTORS}
    for pair in direct_paths(scene).pairs():
        for part in slices_of(len(instants), 1):
            received = reception_times(pair, instants[part], kinematics) if by_emission else instants[part]
            for name, values in _direct_sound(pair, received, kinematics).items():
                found[name][pair.source, pair.receiver, part] = values
    speed = np.array([scene.air.speed_at(source.emitted.centre_frequency) for source in scene.sources])
    rate, sight = found.pop("rate"), [in_sight(paths, s, times) for s, times in enumerate(found["reception_time"])]
    return DirectPath(
        times=instants, doppler_factor=1.0 - rate, line_of_sight=np.array(sight),
        radial_speed=speed[:, None, None] * rate, source_names=names[0], receiver_names=names[1],
        emitted=by_emission, **found,
    )  # fmt: skip


def _direct_sound(pair: PairPaths, received: Floats, kinematics: Kinematics) -> dict[str, Floats]:
    """Return delays, their rates, directions and positions of the direct path of a pair at times of reception (T,)."""
    scene = pair.family.scene
    source, receiver = scene.sources[pair.source].trajectory, scene.receivers[pair.receiver]
    arrivals = pair.arrivals(received, kinematics)
    delay = (arrivals.delay + pair.group_delay_offset(arrivals))[0]
    left = received - delay if kinematics.retarded else received
    return {
        "delay": delay, "rate": arrivals.delay_rate[0], "reception_time": received, "arrival": arrivals.arrival[0],
        "local_arrival": rotate(receiver.orientation(received) * (-1.0, -1.0, -1.0, 1.0), arrivals.arrival[0]),
        "source_position": source.position(left), "receiver_position": receiver.trajectory.position(received),
    }  # fmt: skip


def reception_times(pair: PairPaths, emitted: Floats, kinematics: Kinematics) -> Floats:
    """Return the times of reception (T,) of what is emitted at times (T,), s, by Newton's method."""
    received = emitted
    for _ in range(_NEWTON_LIMIT):
        arrivals = pair.arrivals(received, kinematics)
        late = emitted + (arrivals.delay + pair.group_delay_offset(arrivals))[0] - received
        received = received + late / (1.0 - arrivals.delay_rate[0])
        if np.all(np.abs(late) <= 1e-15 + 4e-16 * np.abs(received)):
            break
    return received


def in_sight(paths: PathSet, source: int, received: Floats) -> NDArray[np.bool_]:
    """Return a mask of the times of reception (receivers, T) at which the direct path of a source is there."""
    seen = np.zeros(received.shape, dtype=bool)
    for row in np.flatnonzero((paths.order == 0) & (paths.source == source)):
        times = received[paths.receiver[row]]
        seen[paths.receiver[row]] |= (times >= paths.start[row]) & (times < paths.end[row])
    return seen


_AT_A_TIME = 100_000  # times and triangles
_TINY = 1e-300
_STEPS = 6  # of Newton's method on a face or an edge, from where they would be met at rest


@dataclass(frozen=True, slots=True, eq=False)
class EchoTruth:
    """A path by each object between every source and receiver, (objects, sources, receivers, T).

    Attributes
    ----------
    times : ndarray (T,)
        Times of reception, s.
    delay : ndarray (things, sources, receivers, T)
        From emission to reception, s, also where something is in the way; group delays in air that disperses.
    doppler_factor : ndarray (things, sources, receivers, T)
        Received over emitted frequency.
    range : ndarray (things, sources, receivers, T)
        From where it comes back to the receiver, m.
    radial_speed : ndarray (things, sources, receivers, T)
        Speed of sound times the change of the delay by time of reception, over 2, m/s: for a source and a receiver at
        one place at rest how fast the thing goes away.
    bearing : ndarray (things, sources, receivers, T, 3)
        Unit vectors from the receiver to where it comes back, in the room; in wind normals of the wavefront.
    source_names, receiver_names : tuple of str
        Along two of the axes.
    KIND, MEASURES : str, tuple of str
        Kind of the objects, and names of the fields that have them along the first axis.
    """

    times: Floats
    delay: Floats
    doppler_factor: Floats
    range: Floats
    radial_speed: Floats
    bearing: Floats
    source_names: tuple[str, ...]
    receiver_names: tuple[str, ...]

    KIND: ClassVar[str]
    MEASURES: ClassVar[tuple[str, ...]] = ("delay", "doppler_factor", "range", "radial_speed", "bearing")

    __repr__ = short_repr

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the objects, along the first axis."""
        named: tuple[str, ...] = getattr(self, f"{self.KIND}_names")
        return named


def echo_fields(scene: Scene, times: Floats, delay: Floats, rate: Floats, away: Floats, bearing: Floats) -> Any:
    """Return the fields of `EchoTruth` by their names."""
    speed = np.array([scene.air.speed_at(source.emitted.centre_frequency) for source in scene.sources])
    return {
        "times": times, "delay": read_only(delay), "doppler_factor": read_only(1.0 - rate), "range": read_only(away),
        "radial_speed": read_only(0.5 * speed[:, None, None] * rate), "bearing": read_only(bearing),
        "source_names": tuple(source.name for source in scene.sources),
        "receiver_names": tuple(receiver.name for receiver in scene.receivers),
    }  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class ScattererTruth(EchoTruth):
    """The path by every scatterer between source and receiver, without walls (scatterers, sources, receivers, T).

    Delay, range and the other fields are those of `EchoTruth`.

    Attributes
    ----------
    scatterer_names : tuple of str
        Along the first axis.
    """

    scatterer_names: tuple[str, ...]

    KIND: ClassVar[str] = "scatterer"


def scatterer_truth(scene: Scene, times: Floats, motion: str = "retarded") -> ScattererTruth:
    """Return the truth about the scatterers of a scene.

    Parameters
    ----------
    scene : Scene
        With scatterers.
    times : array_like (T,)
        Times of reception, s, by the scene's clock.
    motion : {"retarded", "quasi-static"}
        As in `render`.

    Raises
    ------
    InputError
        If the scene has no scatterers, or its air depends on the height or fluctuates.

    Examples
    --------
    >>> import clsim
    >>> room = clsim.Shoebox((8.0, 6.0, 3.0), clsim.Material.from_reflection(0.9))
    >>> tone = clsim.Signal.tone(40e3, duration=0.01, sampling_rate=192e3)
    >>> at = clsim.Trajectory.fixed((1.0, 3.0, 1.5))
    >>> ends = [clsim.Source("s", tone, at)], [clsim.Receiver("r", clsim.Trajectory.fixed((1.0, 3.1, 1.5)))]
    >>> ball = clsim.Scatterer.sphere("ball", 0.05, clsim.Trajectory.fixed((3.0, 3.05, 1.5)))
    >>> scene = clsim.Scene(room, clsim.Air(speed_of_sound=340.0), *ends, scatterers=[ball])
    >>> clsim.scatterer_truth(scene, [0.1]).range.round(4).ravel().tolist()
    [1.9506]
    """
    times = as_floats("times", times, (None,))
    kinematics = Kinematics(motion)
    if not scene.scatterers:
        raise InputError("scene", "must hold scatterers, but has none")
    shape = len(scene.scatterers), len(scene.sources), len(scene.receivers), len(times)
    delay, rate, away, bearing = np.empty(shape), np.empty(shape), np.empty(shape), np.empty((*shape, 3))
    for pair in direct_legs(scene).pairs():
        found = pair.arrivals(times, kinematics)
        here = (slice(None), pair.source, pair.receiver)
        delay[here], rate[here] = found.delay + pair.group_delay_offset(found), found.delay_rate
        bearing[here] = found.arrival
        away[here] = found.more["second_length"]
    names = tuple(scatterer.name for scatterer in scene.scatterers)
    return ScattererTruth(**echo_fields(scene, times, delay, rate, away, bearing), scatterer_names=names)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class BodyTruth(EchoTruth):
    """The shortest path by every body between every source and receiver, (bodies, sources, receivers, T).

    It meets the surface at the point of least delay, on a face, an edge or a corner. No echo of the body alone is
    earlier. Delay, range and the other fields are those of `EchoTruth`.

    Attributes
    ----------
    visible : ndarray (bodies, sources, receivers, T) of bool
        Whether neither the room nor any body is in the way from the source to the point, or from there to the receiver.
    body_names : tuple of str
        Along the first axis.
    """

    visible: NDArray[np.bool_]
    body_names: tuple[str, ...]

    KIND: ClassVar[str] = "body"
    MEASURES: ClassVar[tuple[str, ...]] = (*EchoTruth.MEASURES, "visible")


def body_truth(scene: Scene, times: Floats, motion: str = "retarded") -> BodyTruth:
    """Return the truth about the bodies of a scene.

    Parameters
    ----------
    scene : Scene
        With bodies.
    times : array_like (T,)
        Times of reception, s, by the scene's clock.
    motion : {"retarded", "quasi-static"}
        As in `render`.

    Raises
    ------
    InputError
        If the scene has no bodies, or its air depends on the height or fluctuates.

    Examples
    --------
    >>> import clsim
    >>> wood = clsim.Material.from_reflection(0.9)
    >>> room, tone = clsim.Shoebox((8.0, 6.0, 3.0), wood), clsim.Signal.tone(40e3, duration=0.01, sampling_rate=192e3)
    >>> at = clsim.Trajectory.fixed
    >>> ends = [clsim.Source("s", tone, at((1.0, 3.0, 1.5)))], [clsim.Receiver("r", at((1.0, 3.1, 1.5)))]
    >>> crate = clsim.Body.box("crate", (0.4, 0.6, 0.4), wood, at((4.2, 3.0, 1.5)))
    >>> truth = clsim.body_truth(clsim.Scene(room, clsim.Air(), *ends, bodies=[crate]), [0.1])
    >>> truth.range.round(4).ravel().tolist(), truth.visible.ravel().tolist()
    ([3.0004], [True])
    """
    times = as_floats("times", times, (None,))
    kinematics = Kinematics(motion)
    if not scene.bodies:
        raise InputError("scene", "must hold bodies, but has none")
    check_support("moving", scene.air)
    shape = len(scene.bodies), len(scene.sources), len(scene.receivers), len(times)
    delay, rate, away, bearing = np.empty(shape), np.empty(shape), np.empty(shape), np.empty((*shape, 3))
    walls = (*(body.mesh.walls for body in scene.bodies), scene.room.as_mesh().walls)
    obstacles = Obstacles(Mirrors.of(scene.room, scene.bodies), walls, scene.room.is_convex)
    visible, direct = np.zeros(shape, dtype=bool), np.empty((1, 0), dtype=np.int64)
    for which, body in enumerate(scene.bodies):
        thing = Scatterer(body.name, _Surface(1.0, body.mesh.vertices[body.mesh.triangles]), body.trajectory)
        for source, receiver in np.ndindex(shape[1:3]):
            ends = scene.sources[source], scene.receivers[receiver]
            medium = mean_medium_of(scene.air, ends[0].emitted.centre_frequency)
            motions = ends[0].trajectory, ends[1].trajectory
            mirrors, still = obstacles.mirrors, (direct, direct)
            found = find_scattered(mirrors, still, thing, motions, medium, times, kinematics.retarded)
            first, second, here = found.first, found.last, (which, source, receiver)
            delay[here], rate[here] = first.delay + second.delay, first.rate + second.rate
            if kinematics.retarded:
                rate[here] -= (first.rate * second.rate)[0]
            away[here], bearing[here] = second.distance * second.carried, second.arrival
            legs = [_leg(events, at) for events, at in ((first, found.time), (second, times))]
            none = np.full(len(times), -1)
            visible[here] = ~np.any([obstacles.evaluated(leg, none, none, None)[0] for leg in legs], axis=0)
    return BodyTruth(
        **echo_fields(scene, times, delay, rate, away, bearing),
        visible=read_only(visible), body_names=tuple(body.name for body in scene.bodies),
    )  # fmt: skip


def _leg(events: Events, received: Floats) -> Legs:
    """Return the one leg of ways by no mirror (1, T) as legs (T,)."""
    at = np.broadcast_to(received, events.delay.shape)[0]
    return Legs(events.place[0, :, 0], events.place[0, :, 1], at + events.time[0, :, 0], at)


@dataclass(frozen=True, slots=True, eq=False)
class _Surface(PointShape):
    """The surface of triangles (F, 3, 3), m, as what sound may go by: its glint is the nearest point."""

    corners: Floats
    radius: ClassVar[float] = 1.0  # it is no point: its sides matter

    def specular(
        self, source: Floats, receiver: Floats, near: SpecularPoint | None, weight: Floats | float
    ) -> SpecularPoint:
        """Return the nearest point, which needs no search."""
        count, least = source.shape[1], np.broadcast_to(weight, source.shape[1])
        parts = np.array_split(np.arange(count), -(-count * len(self.corners) // _AT_A_TIME))
        place = [_nearest(self.corners, source.T[p], receiver.T[p], least[p, None]) for p in parts]
        found = np.concatenate(place).T
        return SpecularPoint(found, found, np.zeros(count, dtype=bool), 0.0)


def _nearest(corners: Floats, source: Floats, receiver: Floats, weight: Floats) -> Floats:
    """Return the points (n, 3) on triangles (F, 3, 3) by which ways ``d1 + w d2`` between ends (n, 3) are shortest."""
    along = np.roll(corners, -1, axis=1) - corners
    start, step = corners.reshape(-1, 3), along.reshape(-1, 3)
    places = np.concatenate(
        [_on_faces(corners, along, source, receiver, weight), _on_edges(start, step, source, receiver, weight)], axis=1
    )
    lengths = [np.linalg.norm(places - end[:, None], axis=2) for end in (source, receiver)]
    best = np.nanargmin(lengths[0] + weight * lengths[1], axis=1)
    return np.asarray(places[np.arange(len(places)), best])


def _on_line(s: Floats, high_s: Floats, r: Floats, high_r: Floats, weight: Floats) -> Floats:
    """Find the places (n, m) on lines with the shortest ways between ends at s and r along and high over them."""
    t = (s * high_r + r * high_s) / np.maximum(high_s + high_r, _TINY)
    for _ in range(_STEPS):
        to, back = (np.maximum(np.hypot(t - x, high), _TINY) for x, high in ((s, high_s), (r, high_r)))
        slope, bend = (t - s) / to + weight * (t - r) / back, high_s**2 / to**3 + weight * high_r**2 / back**3
        t = t - slope / np.maximum(bend, _TINY)
    return t


def _on_edges(start: Floats, step: Floats, source: Floats, receiver: Floats, weight: Floats) -> Floats:
    """Return the points (n, E, 3) of edges by which ways are shortest."""
    length = np.linalg.norm(step, axis=1)
    unit, away = step / length[:, None], (source[:, None] - start, receiver[:, None] - start)
    s, r = (np.einsum("nei,ei->ne", x, unit) for x in away)
    high_s, high_r = (np.linalg.norm(x - t[..., None] * unit, axis=2) for x, t in zip(away, (s, r), strict=True))
    place = _on_line(s, high_s, r, high_r, weight)
    return np.asarray(start + np.clip(place, 0.0, length)[..., None] * unit)


def _on_faces(corners: Floats, along: Floats, source: Floats, receiver: Floats, weight: Floats) -> Floats:
    """Return the points (n, F, 3) inside of triangles by which ways are shortest; NaN where these are outside."""
    normal = np.cross(along[:, 0], along[:, 1])
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    high_s, high_r = (np.einsum("nfi,fi->nf", end[:, None] - corners[:, 0], normal) for end in (source, receiver))
    # The shortest way meets the face on the line between the feet of both ends.
    foot = source[:, None] - high_s[..., None] * normal
    step = receiver[:, None] - high_r[..., None] * normal - foot
    apart = np.linalg.norm(step, axis=2)
    place = _on_line(np.zeros_like(apart), np.abs(high_s), apart, np.abs(high_r), weight)
    places = foot + (place / np.maximum(apart, _TINY))[..., None] * step
    inward = np.cross(normal[:, None], along)
    inside = np.all(np.einsum("fki,nfki->nfk", inward, places[:, :, None] - corners) >= 0.0, axis=2)
    return np.where(inside[..., None], places, np.nan)
