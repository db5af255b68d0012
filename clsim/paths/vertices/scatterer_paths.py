"""Paths by a moving scatterer between static legs, or moving ones: two delay equations, the later one first."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from clsim.acoustics.capsule import capsule_aspects, capsule_field, capsule_specular_point
from clsim.acoustics.outline import CapsuleOutline
from clsim.acoustics.scattering import SpecularPoint
from clsim.arrays import Complexes, Floats
from clsim.errors import InputError
from clsim.numerics.quaternions import cross_product, rotate
from clsim.paths.legs.events import Events, find_events
from clsim.paths.legs.mirrors import Mirrors, dot
from clsim.paths.propagation import Medium, Passage, UniformAir, straight
from clsim.scene.motion.motion import Motion
from clsim.scene.scatterer import Scatterer

Walls = NDArray[np.signedinteger[Any]]


_ROUNDS = 60
# Rounds after which what is hidden stays so: where shadows begin specular points jump, and with them what wind shows.
PATIENCE = 8
_APART = 4  # times from one at which ways are looked for to the next: between them it is known about where they are
_LEAST = 6 * _APART  # times, for that
_LONGEST_GAP = 0.05  # s between these
_CLOSE = 1e-9  # s; the next step is about its square over a second
_CONVERGED = 1e-3  # rad of a specular point; its way is the shortest: wrong by the fourth power of this after the step
_TURNS = 40
_FEW, _MANY = 3, 20  # rounds of the searches for events: by the centre first, from where the surface is looked for


class Ends(Protocol):
    """The ends of P paths as a scatterer sees them, at T times of reception."""

    receiver_at: Floats  # images of the receiver (P, T, 3), m
    receiver: Floats  # where it is (T, 3), m

    def emitted(self, times: Floats) -> tuple[Floats, Floats, Floats | None]:
        """Return images of the source, its places, and its velocities, None for rest, (P, T, 3) at times (P, T)."""

    def leaving(self, direction: Floats) -> Floats:
        """Return in which directions (P, T, 3) ways leave the source that reach the scatterer in given ones."""


@dataclass(frozen=True, slots=True, eq=False)
class Leg:
    """The way from an end to a scatterer, or on from there: length, m, direction as the scatterer sees it, passage."""

    length: Floats
    direction: Floats
    sound: Passage

    def ray(self) -> Floats:
        """Return the way (..., 3) of the wavefront through the air, along its normal, m."""
        return self.sound.through[..., None] * self.sound.normal(self.direction)

    def slowness(self) -> Floats:
        """Return that of the wavefront (...), s/m."""
        return np.asarray(np.linalg.norm(self.sound.slowness(self.direction), axis=-1))


@dataclass(frozen=True, slots=True, eq=False)
class ScatteredPath:
    """Sound by a scatterer, of any shape (...), as it is received at some time."""

    delay: Floats  # (...) since it was emitted, s
    first: Leg  # to the scatterer, and on from there
    second: Leg  # likewise
    # (...) mach numbers of the source towards the scatterer, and of the scatterer off it and towards the
    # receiver.
    mach: Floats
    coming: Floats  # likewise
    leaving: Floats  # likewise
    place: Floats  # (..., 3) where it was scattered, m
    strength: Floats  # (...) see `Shape`
    aspects: Floats  # likewise


class Capsules:
    """Capsules of P paths that are solved together, as one scatterer would be: twelve of a person cost as one."""

    def __init__(self, scatterers: Sequence[Scatterer], which: NDArray[np.int32]) -> None:
        self._scatterers, self._which = scatterers, which
        self.trajectory, self.shape, self.name = self, self, scatterers[int(which[0])].name
        shapes: list[Any] = [scatterers[i].shape for i in which]
        self._size = np.array([[shape.cylinder_radius, shape.length] for shape in shapes]).T
        self.radius, self.outlined = float(self._size.max()), shapes[0].outlined
        self.aspects, self.shadows = shapes[0].aspects, shapes[0].shadows
        self.has_orientation = any(scatterers[i].trajectory.has_orientation for i in np.unique(which))

    def __getattr__(self, name: str) -> Any:
        """Return the function of times for positions, velocities, orientations or angular velocities (P, T, n)."""
        if name not in ("position", "velocity", "orientation", "angular_velocity"):
            raise AttributeError(name)
        return partial(self._moved, name)

    def _moved(self, name: str, times: Floats) -> Floats:
        times = np.broadcast_to(times, (len(self._which), times.shape[-1]))
        out = np.empty((*times.shape, 4 if name == "orientation" else 3))
        for i in np.unique(self._which):
            mine = self._which == i
            out[mine] = getattr(self._scatterers[i].trajectory, name)(times[mine])
        return out

    def specular(
        self, source: Floats, receiver: Floats, near: SpecularPoint | None, weight: Floats | float
    ) -> SpecularPoint:
        """Return specular points of P paths at times, one path after the other."""
        return capsule_specular_point(*self._sizes(source), source, receiver, near, weight)

    def strength(self, source: Floats, receiver: Floats, specular: SpecularPoint | None) -> tuple[Floats, Floats]:
        """Return strengths and aspects likewise."""
        assert specular is not None
        return capsule_aspects(*self._sizes(source), source, receiver, specular, self.outlined)

    def field(self, wave: Floats, centre: float, aspects: Floats, past: float) -> Complexes:
        """Return fields (P, T, F) over strengths, without those about outlines: `past` is 0."""
        sizes = (np.repeat(size, aspects.shape[1]) for size in (self._size * [[1.0], [0.5]]))
        outline: Any = CapsuleOutline(*sizes) if self.outlined else None
        return capsule_field(wave, aspects, outline, past, centre)

    def _sizes(self, ends: Floats) -> tuple[Floats, Floats]:
        radius, length = np.repeat(self._size, ends.shape[1] // self._size.shape[1], axis=1)
        return radius, length


class Body:
    """A scatterer as ends see it, and what was found of it when last looked at."""

    def __init__(self, scatterer: Scatterer | Capsules, specular: SpecularPoint | None = None) -> None:
        self._shape, self._trajectory = scatterer.shape, scatterer.trajectory
        self._turned = scatterer.trajectory.has_orientation and scatterer.shape.radius > 0.0
        self.specular = specular
        self._ends: tuple[Floats, Floats] | None = None

    @property
    def change(self) -> float:
        """Rotation of the specular point in the last step of its search, rad."""
        return 0.0 if self.specular is None else self.specular.change

    def seen(
        self, times: Floats, source: Floats, receiver: Floats, weight: Floats | float, stays: bool = False
    ) -> tuple[Floats, Floats]:
        """Return place and velocity (..., 3) of what scatters at times (...) for ends (..., 3).

        The weight of the way to the receiver is that of `ellipsoid_specular_point`; with `stays`, ends that the
        scatterer hid from each other it hides again.
        """
        centre, velocity = self._trajectory.position(times), self._trajectory.velocity(times)
        away = [end - centre for end in (source, receiver)]
        if self._turned:
            axes = _axes(self._trajectory.orientation(times))
            away = [np.einsum("...ij,...i->...j", axes, v) for v in away]
        source, receiver = (np.ascontiguousarray(v.reshape(-1, 3).T) for v in away)
        flat = weight.ravel() if isinstance(weight, np.ndarray) else weight
        near = self.specular if self.specular is None else replace(self.specular, stays=stays)
        self.specular = self._shape.specular(source, receiver, near, flat)
        self._ends = source, receiver
        if self.specular is None:
            return centre, velocity
        offset = self.specular.place.T.reshape(*times.shape, 3)
        if self._turned:
            offset = np.einsum("...ij,...j->...i", axes, offset)
            velocity = velocity + np.cross(self._trajectory.angular_velocity(times), offset)
        return centre + offset, velocity

    def strength(self, shape: tuple[int, ...]) -> list[Floats]:
        """Return strength and aspects, of a shape, of what was last seen."""
        assert self._ends is not None
        strength, aspects = self._shape.strength(*self._ends, self.specular)
        return [strength.reshape(shape), aspects.reshape(*shape, self._shape.aspects)]


def _axes(quaternions: Floats) -> Floats:
    """Return matrices (..., 3, 3) that turn as unit quaternions x y z w (..., 4) do."""
    x, y, z, w = np.moveaxis(quaternions, -1, 0)
    rows = [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)],
        [2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)],
        [2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def unseen(what: str, times: Floats) -> InputError:
    """Make the error of a way that is not found for the sound received at times, s."""
    return InputError("scatterers", f"must be seen from {what} was found from {times[0]:.6g} to {times[-1]:.6g} s")


def scattered_path(
    medium: Medium, scatterer: Scatterer | Capsules, ends: Ends, times: Floats, retarded: bool
) -> ScatteredPath:
    """Return the ways (P, T) of sound by a scatterer that is received at times (T,), s.

    retarded: whether all is where it was when the sound passed, or where it is at reception.
    With the place x that scatters, ``late = travel time from x(t - late) to the receiver`` and ``delay - late = travel
    time from the source at t - delay to x(t - late)``, both by Newton's method together with the specular point: as its
    way is the shortest, that it moves over the surface changes no time, and x moves as the thing does.
    Where times are many and near to each other, ways are looked for at every fourth of them first: quintic splines
    through these are where the others begin, and change no more than how many steps that takes.
    """
    from scipy.interpolate import make_interp_spline

    few = np.arange(0, len(times), _APART)
    if not retarded or len(times) < _LEAST or np.any(np.diff(times) <= 0.0) or np.diff(times[few]).max() > _LONGEST_GAP:
        return _solved(medium, scatterer, ends, times, retarded, _begin(medium, scatterer, ends, times))[0]
    few[-1] = len(times) - 1
    some = _Some(ends, few)
    known = _solved(medium, scatterer, some, times[few], True, _begin(medium, scatterer, some, times[few]))[1]
    shares = make_interp_spline(times[few], np.eye(len(few)), k=5)(times).T
    return _solved(medium, scatterer, ends, times, True, known.between(shares))[0]


class _Some:
    """Ends at some of the times."""

    def __init__(self, ends: Ends, which: NDArray[np.int64]) -> None:
        self.receiver_at, self.receiver = ends.receiver_at[:, which], ends.receiver[which]
        self.emitted, self.leaving = ends.emitted, ends.leaving


@dataclass(frozen=True, slots=True, eq=False)
class _Known:
    """About how long sound travels from a scatterer and to it (P, T), s, and where it is reflected, by which weight."""

    late: Floats
    first_time: Floats
    specular: SpecularPoint | None
    weight: Floats | float

    def between(self, shares: Floats) -> _Known:
        """Return the same at other times, as sums (T, others) of these."""
        specular = self.specular
        if specular is not None:
            normal = specular.normal.reshape(3, *self.late.shape) @ shares
            specular = specular.guessed(normal.reshape(3, -1))
        return _Known(self.late @ shares, self.first_time @ shares, specular, self.weight @ shares)


def _begin(medium: Medium, scatterer: Scatterer | Capsules, ends: Ends, times: Floats) -> _Known:
    """Estimate from the centre at the times of reception."""
    centre = scatterer.trajectory.position(times)
    late = medium.passage(straight(centre, ends.receiver_at)[0], ends.receiver - centre).time
    image, real, _ = ends.emitted(np.broadcast_to(times, late.shape))
    return _Known(late, medium.passage(straight(image, centre)[0], centre - real).time, None, 1.0)


def _solved(
    medium: Medium, scatterer: Scatterer | Capsules, ends: Ends, times: Floats, retarded: bool, known: _Known
) -> tuple[ScatteredPath, _Known]:
    """Return the ways by Newton's method from what is known of them, and what is known then."""
    body, shape = Body(scatterer, known.specular), ends.receiver_at.shape[:2]
    now, late, first_time, weight = np.broadcast_to(times, shape), known.late, known.first_time, known.weight
    carried: tuple[Floats, Floats] | None = None
    weight_at_rest: Floats | float = 1.0
    for done in range(_ROUNDS):
        event = times - late if retarded else now
        image, real, source_velocity = ends.emitted(event - first_time if retarded else event)
        place, velocity = body.seen(event, *(carried or (image, ends.receiver_at)), weight, done >= PATIENCE)
        second = leg_between(medium, place, ends.receiver_at, ends.receiver - place)
        first = leg_between(medium, image, place, place - real)
        coming, leaving = (leg.sound.growth(leg.direction, velocity) for leg in (first, second))
        mach = np.zeros(shape)
        if source_velocity is not None:
            mach = first.sound.growth(ends.leaving(first.direction), source_velocity)
        later, more = second.sound.time - late, first.sound.time - first_time
        if retarded:
            weight = weight_at_rest = (1.0 - coming) / (1.0 - leaving)
            later = later / (1.0 - leaving)
            more = (more + later * (mach - coming)) / (1.0 - mach)
        late, first_time = late + later, first_time + more
        moved = max(np.abs(later).max(initial=0.0), np.abs(more).max(initial=0.0)) if retarded else 0.0
        again = carried is None and first.sound.carried is not None
        if first.sound.carried is not None:  # by air that moves: ends are seen where their wavefronts come from
            carried = place - first.ray(), place + second.ray()
            weight = weight_at_rest * (second.slowness() / first.slowness())
        if moved <= _CLOSE and body.change <= _CONVERGED and not again:
            break
    else:
        raise unseen(f"both ends, but no way by {scatterer.name!r}", times)
    solved = ScatteredPath(late + first_time, first, second, mach, coming, leaving, place, *body.strength(shape))
    return solved, _Known(late, first_time, body.specular, weight)


def leg_between(medium: Medium, start: Floats, stop: Floats, apart: Floats) -> Leg:
    """Return the straight way between places (..., 3), whose real ones are so far apart (..., 3), m."""
    length, direction = straight(start, stop)
    return Leg(length, direction, medium.passage(length, apart))


@dataclass(frozen=True, slots=True, eq=False)
class ScatteredEvents:
    """P ways by a scatterer at T times of reception."""

    first: Events  # of the leg to the scatterer, with times counted from when it is met there, and of that from it
    last: Events  # likewise
    time: Floats  # (P, T) when it is scattered, s
    coming: Floats  # (P, T) mach number of the scatterer off the source
    strength: Floats  # (P, T) see `Shape`
    aspects: Floats  # likewise


class _Point:
    """A point of a scatterer as an end of either leg: it moves and turns as that does."""

    def __init__(self, motion: Motion, offset: Floats | None) -> None:
        self._motion, self._offset = motion, offset

    def part(self, rows: NDArray[np.int64]) -> _Point:
        return _Point(self._motion, None if self._offset is None else self._offset[rows])

    def _arm(self, times: Floats) -> Floats:
        assert self._offset is not None
        return rotate(self._motion.orientation(times), self._offset) if self._motion.has_orientation else self._offset

    def position(self, times: Floats) -> Floats:
        centre = self._motion.position(times)
        return centre if self._offset is None else centre + self._arm(times)

    def velocity(self, times: Floats) -> Floats:
        velocity = self._motion.velocity(times)
        if self._offset is None or not self._motion.has_orientation:
            return velocity
        return velocity + cross_product(self._motion.angular_velocity(times), self._arm(times))


def find_scattered(
    mirrors: Mirrors, legs: tuple[Walls, Walls], scatterer: Scatterer, ends: tuple[Motion, Motion],
    medium: UniformAir, times: Floats, retarded: bool = True,
) -> ScatteredEvents:  # fmt: skip
    """Return the events of ways by a scatterer, with mirrors on either leg.

    Shapes: times (T,) s.
    legs: mirrors on the way to the scatterer, and on that from it, in the order in which sound meets them, filled up
    with -1.
    With the point x of the surface that reflects, the second leg is that of a source at x, the first one that of a
    receiver at x at the time when it is scattered. Of all points of the surface, the sound that is received was emitted
    last by way of x. The images of both ends, as x sees them, have it where ``d1 + w d2`` is the shortest, with ``w =
    (1 - M1) s2 / ((1 - M2) s1)``: Mach numbers of the surface off the first and towards the second one, and the
    slownesses of the wavefronts. That x slides over the surface changes no time: it moves as the scatterer does.
    """
    body, shape = Body(scatterer), (len(legs[0]), len(times))
    now, point = np.broadcast_to(times, shape), _Point(scatterer.trajectory, None)
    wind = np.array(medium.wind or (0.0, 0.0, 0.0))
    converged = False
    for done in range(_TURNS):
        rounds = _FEW if done == 0 and scatterer.shape.radius > 0.0 else _MANY
        place: Any = point
        second = find_events(mirrors, legs[1], (place, ends[1]), medium, now, retarded, rounds)
        event = now - second.delay if retarded else now
        first = find_events(mirrors, legs[0], (ends[0], place), medium, event, retarded, rounds)
        velocity = point.velocity(event)
        onwards = (-first.arrival, second.departure)
        away = -first.distance, second.distance
        seen = [point.position(event) + d[..., None] * n for d, n in zip(away, onwards, strict=True)]
        speed = [medium.speed_of_sound + dot(n, np.broadcast_to(wind, n.shape)) for n in onwards]
        mach = [dot(n, velocity) / c for n, c in zip(onwards, speed, strict=True)]
        weight = (1.0 - mach[0]) / (1.0 - mach[1]) * speed[0] / speed[1] if retarded else speed[0] / speed[1]
        body.seen(event, seen[0], seen[1], weight)
        if converged or body.specular is None:
            break
        converged = done > 0 and body.change <= _CONVERGED  # by images that the surface sees, not the centre
        point = _Point(scatterer.trajectory, body.specular.place.T.reshape(*shape, 3))
    else:
        raise unseen(f"both ends, but no way by {scatterer.name!r}", times)
    strength, aspects = body.strength(shape)
    return ScatteredEvents(first, second, event, mach[0], strength, aspects)
