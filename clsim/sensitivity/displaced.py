"""Scenes in which one thing differs a little: the same paths are solved there again."""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass, fields, replace
from operator import attrgetter
from typing import TYPE_CHECKING, Any, TypeVar, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clsim.arrays import Complexes, Floats
from clsim.numerics.band_filters import chebyshev_points, interpolation
from clsim.numerics.quaternions import quaternion_product
from clsim.paths.family import PairPaths
from clsim.paths.response import Arrivals, Kinematics, SceneResponse, covered, to_transducer_frame
from clsim.scene.directivity.directivity import ChannelDirectivity
from clsim.scene.ends import Receiver
from clsim.scene.material.material import Material
from clsim.scene.motion.curves import Curve, Piecewise, Static, spline_through
from clsim.scene.room.faces import Faces
from clsim.scene.room.protocol import Room
from clsim.scene.scene import Scene

if TYPE_CHECKING:
    from scipy.interpolate import PPoly

T = TypeVar("T")

# Ratios of arriving to emitted frequencies, of which gains of heads are polynomials: their bounds are multiples of the
# first, by so many points at least, and more by how long heads ring about, s.
_RATIO, _LEAST_RATIOS, _RINGING = 0.01, 4, 1e-3
_INSTANT = 1e-4  # s, to either side, by which rates are taken
_NOTHING = 1e-9  # of a curve's largest value, as which rounding counts


def varied(thing: T, **changes: Any) -> T:
    """Copy a frozen value with changed fields, without its checks: a small step may break one."""
    made = copy.copy(thing)
    for name, value in changes.items():
        object.__setattr__(made, name, value)
    return made


@dataclass(frozen=True, slots=True, eq=False)
class Displaced:
    """A curve plus a multiple `by` of another one."""

    curve: Curve
    shift: Curve
    by: float

    def position(self, time: Floats) -> Floats:
        return self.curve.position(time) + self.by * self.shift.position(time)

    def velocity(self, time: Floats) -> Floats:
        return self.curve.velocity(time) + self.by * self.shift.velocity(time)

    def speed_over(self, begin: Floats, end: Floats) -> Floats:
        return self.curve.speed_over(begin, end) + abs(self.by) * self.shift.speed_over(begin, end)


@dataclass(frozen=True, slots=True, eq=False)
class Knot:
    """Displacement along an axis by one point of a motion; `spread` has the curves of all points side by side."""

    spread: Piecewise
    number: int
    axis: int

    def position(self, time: Floats) -> Floats:
        return self._along(self.spread.polynomial, time)

    def velocity(self, time: Floats) -> Floats:
        knots = self.spread.derivative.x
        inside = (time >= knots[0]) & (time <= knots[-1])
        return np.asarray(self._along(self.spread.derivative, time) * inside[..., None])

    def speed_over(self, begin: Floats, end: Floats) -> Floats:
        return self.spread.speed_over(begin, end)

    def _along(self, polynomial: PPoly, time: Floats) -> Floats:
        from scipy.interpolate import PPoly

        own = PPoly.construct_fast(np.ascontiguousarray(polynomial.c[:, :, self.number]), polynomial.x)
        out = np.zeros((*time.shape, 3))
        out[..., self.axis] = own(np.clip(time, polynomial.x[0], polynomial.x[-1]))
        return out


def locally(spread: Piecewise) -> tuple[Piecewise, Floats]:
    """B-splines of the same motions as the curves of points, and their weights (points, points) in each of these."""
    from scipy.interpolate import BSpline

    times = spread.polynomial.x[1:-1]  # without what it is continued by
    if not np.any(spread.polynomial.c[:2]) or len(times) < 4:
        return spread, np.eye(len(times))
    knots = np.concatenate([np.repeat(times[0], 4), times[2:-2], np.repeat(times[-1], 4)])
    design = BSpline.design_matrix(times, knots, 3).toarray()
    return spline_through(times, design, "not-a-knot"), np.asarray(np.linalg.inv(design).T, dtype=np.float64)


def moving(spread: Piecewise, first: float, last: float) -> tuple[int, int]:
    """Range of the curves of a spread that are not zero throughout a time, s."""
    polynomial = spread.polynomial
    sizes = polynomial.c * np.diff(polynomial.x)[:, None] ** np.arange(3, -1, -1)[:, None, None]
    begin, end = np.searchsorted(polynomial.x[1:-1], [first, last], "right")
    active = np.flatnonzero(np.abs(sizes[:, begin : end + 1]).max(axis=(0, 1)) > _NOTHING)
    return int(active[0]), int(active[-1]) + 1


def displaced(motion: T, shift: Curve, by: float) -> T:
    """Displace a motion by a multiple of a curve; a fixed point stays one."""
    own: Any = motion
    if isinstance(own.curve, Static) and isinstance(shift, Static):
        place = own.curve.position(np.zeros(()))
        return varied(motion, curve=Static(place + by * shift.position(np.zeros(()))), _peaks={})
    return varied(motion, curve=Displaced(own.curve, shift, by), _peaks={})


@dataclass(frozen=True, slots=True, eq=False)
class _Turned:
    """Orientations of a source or receiver, turned in the room by one more quaternion (4,)."""

    own: Any
    turn: Floats

    def orientation(self, time: Floats) -> Floats:
        own = self.own.orientation(time.ravel()).reshape(*time.shape, 4)
        return quaternion_product(np.broadcast_to(self.turn, own.shape), own)


def turned(end: T, axis: int, angle: float) -> T:
    """Turn a source or receiver about an axis of the room by an angle, rad."""
    turn = np.append(math.sin(0.5 * angle) * np.eye(3)[axis], math.cos(0.5 * angle))
    given: Any = end
    return varied(end, aim=None, trajectory=varied(given.trajectory, turning=_Turned(end, turn)))


@dataclass(frozen=True, slots=True, eq=False)
class _Shifted(Material):
    """A material whose reflection factor is larger by `by`, at all frequencies and angles."""

    by: float = 0.0

    def reflection_at(
        self, frequency: ArrayLike, cosine: ArrayLike = 1.0, speed_of_sound: float = 343.2
    ) -> NDArray[Any]:
        """Return the reflection factor, which may be above 1 by the shift."""
        return np.asarray(Material.reflection_at(self, frequency, cosine, speed_of_sound) + self.by)


def shifted(material: Material, by: float) -> Material:
    """Return a material whose reflection factor is larger by a number."""
    own = {field.name: getattr(material, field.name) for field in fields(Material)}
    return _Shifted(**own, by=by)


def members_of(own: str, *names: str) -> Any:
    """Properties that have the values, methods too, of an attribute's members."""
    return tuple(property(attrgetter(f"{own}.{name}")) for name in names)


class ByFunctions(ChannelDirectivity):
    """Directivities of several channels whose paths are rendered by functions of frequency; all else is theirs."""

    __slots__ = ("_own", "arriving")
    by_functions = True
    channels, is_complex, band, reach = members_of("_own", "channels", "is_complex", "band", "reach")
    gain_towards, lateness, aligned = members_of("_own", "gain_towards", "lateness", "aligned")

    def __init__(self, own: ChannelDirectivity, arriving: bool) -> None:
        self._own, self.arriving = own, arriving  # whether gains are those at the frequencies that arrive


class TangentResponse(SceneResponse):
    """What a scene does at frequencies (F,) that are emitted, or what it does at their centre at all of them."""

    def __init__(self, scene: Scene, source: int, turning: Floats, at_centre: bool = False) -> None:
        centre = scene.sources[source].emitted.centre_frequency
        super().__init__(scene, source, np.full_like(turning, centre) if at_centre else turning)
        self.turning = turning  # by which delays turn phases
        # Rates of directions of arrival at a head (P, T, 3), and relative ones of the length (P, T), 1/s.
        self.passing: tuple[Floats, Floats] | None = None
        self._source, self._at_centre = source, at_centre

    def in_scene(self, scene: Scene) -> TangentResponse:
        """Return the same of another scene."""
        made = TangentResponse(scene, self._source, self.turning, self._at_centre)
        made.passing = self.passing
        return made

    def beside(self, paths: PairPaths, times: Floats, kinematics: Kinematics) -> TangentResponse:
        """Return the same for paths at times (T,) whose directions change at a head."""
        receiver = self._scene.receivers[paths.receiver]
        if times.ndim > 1 or not isinstance(receiver.directivity, ByFunctions) or not receiver.directivity.arriving:
            return self
        towards, lengths = [], []
        for at in (times + _INSTANT, times - _INSTANT):
            found = paths.arrivals(at, kinematics)
            towards.append(to_transducer_frame(receiver.orientation, at, np.nan_to_num(found.arrival)))
            lengths.append(np.log(found.length))
        made, apart = self.in_scene(self._scene), 2.0 * _INSTANT
        made.passing = (towards[0] - towards[1]) / apart, (lengths[0] - lengths[1]) / apart
        return made

    def part(self, rows: NDArray[np.int64]) -> TangentResponse:
        """Return the same for some of these paths."""
        if self.passing is None:
            return self
        made = self.in_scene(self._scene)
        made.passing = self.passing[0][rows], self.passing[1][rows]
        return made

    def of_channels(
        self, response: Floats | Complexes, receiver: Receiver, channels: range | None, found: Arrivals, times: Floats
    ) -> Floats | Complexes:
        """Multiply responses (P, T, F) by the gains of channels, (C, P, T, F)."""
        # Renders filter with a head what arrives at its centre, at the frequencies that arrive and by the directions
        # from which they do: ``h(u, t - u)``. With the lateness d of gains A that are without it, and the length L, to
        # the first order in the rates of change,
        # A exp(2j pi f d d') - d' A - d A' - f d' dA/df - j / (2 pi) dA'/df + L'/L (d A + j / (2 pi) dA/df).
        own, ratio = receiver.directivity, 1.0 - found.delay_rate
        rests = bool(np.all(ratio == 1.0)) and (self.passing is None or not np.any(self.passing[0]))
        if rests or channels is None or not isinstance(own, ByFunctions) or not own.arriving:
            return super().of_channels(response, receiver, channels, found, times)
        towards, c = to_transducer_frame(receiver.orientation, times, found.arrival), self._scene.air.speed_of_sound
        turn, longer = (0.0, 0.0) if self.passing is None else (self.passing[0], self.passing[1][..., None])
        low, high = _RATIO * math.floor(ratio.min() / _RATIO), _RATIO * (1 + math.floor(ratio.max() / _RATIO))
        count = _LEAST_RATIOS + math.ceil(2.0 * math.pi * _RINGING * float(self.frequencies.max()) * (high - low))
        met = covered(np.outer(chebyshev_points(low, high, count), self.frequencies).ravel(), own)
        at = [interpolation(low, high, count, (ratio + step).ravel()) for step in (0.0, _INSTANT, -_INSTANT)]
        weights = np.reshape([at[0], (at[1] - at[2]) / (2.0 * _INSTANT)], (2, count, *ratio.shape))
        each, late = [], []
        for to in (towards + _INSTANT * turn, towards - _INSTANT * turn):
            to = to / np.linalg.norm(to, axis=-1, keepdims=True)
            gain = own.aligned(to, met, c, channels)
            each.append(np.einsum("cptnf,wnpt->wcptf", gain.reshape(*gain.shape[:3], count, -1), weights))
            late.append(np.moveaxis(own.lateness(to, c), -1, 0)[channels.start : channels.stop, ..., None])
        (gain, by_ratio), (gain_rate, rate_by_ratio) = 0.5 * (each[0] + each[1]), (each[0] - each[1]) / (2.0 * _INSTANT)
        delay, rate = 0.5 * (late[0] + late[1]), (late[0] - late[1]) / (2.0 * _INSTANT)
        turns, met_at = 0.5j / np.pi / self.frequencies, ratio[..., None]
        gain = (
            gain * (np.exp(2j * np.pi * self.frequencies * met_at * delay * rate) - rate + longer * delay)
            - delay * gain_rate + (longer * turns - met_at * rate) * by_ratio - turns * rate_by_ratio
        )  # fmt: skip
        return np.asarray(gain * response)


class _Refaced:
    """A room with other faces; all else is that of the room."""

    def __init__(self, room: Room, faces: Faces) -> None:
        self._room, self.faces = room, faces

    def __getattr__(self, name: str) -> Any:
        return getattr(self._room, name)


def with_wall(room: Room, wall: int, *, along: float = 0.0, reflection: float = 0.0) -> Room:
    """Return a room with one wall moved along its normal, m, or with a larger reflection factor."""
    faces = room.faces
    materials = [shifted(m, reflection) if i == wall and reflection else m for i, m in enumerate(faces.materials)]
    offsets = faces.offsets + along * (np.arange(len(faces)) == wall)
    made: Any = _Refaced(room, replace(faces, offsets=offsets, materials=tuple(materials)))
    return cast("Room", made)
