"""Sound by mirrors that move, exactly: images of events.

A mirror ``n x = h + V t`` that moves evenly makes of the wave from an event at a time t and a place x that of the image

    x' = x - 2 g n / (1 - M²),    t' = t - 2 g V / (c² (1 - M²)),    g = n x - V t - h,    M = V / c

(a Lorentz reflection, with the speed of sound for that of light): what the image emits meets the boundary condition on
the mirror, and at rest it is the usual one. Sequences of mirrors compose. What a mirror does otherwise, such as
turning, is taken from its tangent in time and space about the event in which the sound meets it, which is found by
iteration: paths are stationary, so that each round squares what is left but for a factor M.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Floats
from clsim.paths.legs.mirrors import Mirrors, Planes, dot
from clsim.paths.propagation import UniformAir
from clsim.scene.motion.motion import Motion

_ROUNDS = 20
_CONVERGED = 1e-14  # s
_APART = 4  # times from one at which events are looked for to the next: between them it is known about when they are
_LEAST = 6 * _APART  # times, for that
_LONGEST_GAP = 0.05  # s between these
_FEW_ROUNDS = 3  # from there on
_FOUND = 1e-11  # s; what the next step leaves of this is its share of the mirrors' Mach numbers
_ASTRAY = 1e-5  # m, by which places on mirrors may still move from round to round; beyond it rounds are mixed
_FAR_ASTRAY, _OFF_LEG = 1e-2, 0.05  # the same where mirrors are off a leg, by so much of it
_MIXED, _MOST_SHARE = (10, 30), 10.0  # rounds, then, and how far one goes on from the last two, in their distance
BEYOND_LEG = 0.5  # of a leg, by which events of paths that are not there may lie off it


@dataclass(frozen=True, slots=True, eq=False)
class Events:
    """P paths of N mirrors at T times of reception, from which all times are counted."""

    delay: Floats  # (P, T) s, and its derivative by the time of reception
    rate: Floats  # likewise
    distance: Floats  # (P, T) from the image of the emission to the receiver in the air's frame, m
    # (P, T) by how much the time of reception grows with that of emission for a receiver that rests in the air.
    stretch: Floats
    carried: Floats  # (P, T) what the wind makes of it where all rests in the room
    mach: Floats  # (P, T) of the source along its way
    departure: Floats  # (P, T, 3) normals of the wavefront: as it leaves, and back from the receiver
    arrival: Floats  # likewise
    # (P, T, N + 2, 3) emission, reflections and reception in the room, m and s; those of no mirror at that
    # before.
    place: Floats
    time: Floats  # (P, T, N + 2)
    # (P, T, N) where the line from the receiver's side to the image meets each mirror: between 0 and 1 if it
    # does.
    share: Floats
    cosine: Floats  # (P, T, N) of the angle of incidence


@dataclass(frozen=True, slots=True, eq=False)
class _Ends:
    """Source and receiver as the air's frame sees them."""

    motion: tuple[Motion, Motion]
    now: Floats
    wind: Floats
    retarded: bool

    def emitted(self, event: Floats) -> tuple[Floats, Floats]:
        """Return places and velocities (P, T, 3) of the source in the room at events (P, T)."""
        source = self.motion[0]
        if not self.retarded:
            place = source.position(self.now)
            return place, np.zeros_like(place)
        return source.position(self.now + event), source.velocity(self.now + event)


def find_events(
    mirrors: Mirrors,
    walls: NDArray[np.signedinteger[Any]],
    motion: tuple[Motion, Motion],
    medium: UniformAir,
    times: Floats,
    retarded: bool = True,
    rounds: int = _ROUNDS,
) -> Events:
    """Return the events of paths by mirrors (P, N) at times (T,), s, as if mirrors had no edges.

    In wind all is seen from the air's own frame, where the law is the same. All is where it was when the sound passed,
    `retarded`, or rests where it is at reception.

    Where times are many and near to each other, events are looked for at every fourth of them first: quintic splines
    through these are where the others begin, and change no more than how many rounds that takes.

    Along a mirror that turns at w, a round leaves the share ``w L / (c sin a)`` of an error, L being the
    length of the path and a its angle with the mirror. What grazes it takes more rounds, mixed by Anderson's method.

    References
    ----------
    A. Einstein, Annalen der Physik 17 (1905), section 8: reflection by a moving mirror, of which this is the form for
    events; for sound D. Censor, J. Acoust. Soc. Am. 76 (1984), with mirrors that leave the air at rest.
    """
    moments = np.asarray(times, dtype=np.float64)
    search = _Search(mirrors, motion, medium, retarded)
    few = few_of(moments) if retarded else None
    if few is None:
        return search.surely_solved(walls, moments, rounds)
    coarse = search.surely_solved(walls, moments[few], rounds)
    found, left, _ = search.solved(walls, moments, _Known.between(coarse, moments, few), _FEW_ROUNDS)
    rows = np.flatnonzero(left > _FOUND)
    if len(rows):
        again = search.surely_solved(walls[rows], moments, rounds)
        for field in fields(Events):
            getattr(found, field.name)[rows] = getattr(again, field.name)
    return found


def few_of(times: Floats) -> NDArray[np.int64] | None:
    """Pick the times among many (T,) near to each other at which events are solved first; None where far."""
    if times.ndim != 1 or len(times) < _LEAST or np.any(np.diff(times) <= 0.0):
        return None
    few = np.arange(0, len(times), _APART)
    few[-1] = len(times) - 1
    return few if np.diff(times[few]).max() <= _LONGEST_GAP else None


@dataclass(frozen=True, slots=True, eq=False)
class _Known:
    """About when sound is emitted (P, T), and when (P, T, N), s, and where (P, T, N, 3), m, it is reflected."""

    emission: Floats
    event: Floats
    place: Floats

    @staticmethod
    def between(coarse: Events, times: Floats, few: NDArray[np.int64]) -> _Known:
        """Events at all times (T,) by quintic splines through those at few of them."""
        from scipy.interpolate import make_interp_spline

        shares = make_interp_spline(times[few], np.eye(len(few)), k=5)(times)
        when, where = (np.moveaxis(x, 1, -1) @ shares.T for x in (coarse.time, coarse.place))
        when, where = np.moveaxis(when, -1, 1), np.moveaxis(where, -1, 1)
        return _Known(when[..., 0], when[..., 1:-1], where[..., 1:-1, :])


@dataclass(frozen=True, slots=True, eq=False)
class _Search:
    """What events are looked for among."""

    mirrors: Mirrors
    motion: tuple[Motion, Motion]
    medium: UniformAir
    retarded: bool
    mixes: bool = False  # whether rounds are mixed

    def surely_solved(self, walls: NDArray[np.signedinteger[Any]], times: Floats, rounds: int) -> Events:
        """Return the events of paths: of those that are astray after some rounds with mixed ones."""
        found, _, strays = self.solved(walls, times, None, rounds)
        for more in _MIXED:
            near = np.all((found.share > -_OFF_LEG) & (found.share < 1.0 + _OFF_LEG), axis=2).any(axis=1)
            rows = np.flatnonzero((strays > _ASTRAY) & near | (strays > _FAR_ASTRAY))
            if not len(rows):
                break
            motion: Any = tuple(end.part(rows) if hasattr(end, "part") else end for end in self.motion)
            search, some = replace(self, motion=motion, mixes=True), times[rows] if times.ndim > 1 else times
            again, _, strays[rows] = search.solved(walls[rows], some, None, more)
            for field in fields(Events):
                getattr(found, field.name)[rows] = getattr(again, field.name)
        return found

    def solved(
        self, walls: NDArray[np.signedinteger[Any]], times: Floats, known: _Known | None, rounds: int
    ) -> tuple[Events, Floats, Floats]:
        """Return the events of paths, and the last steps (P,) of times of emission, s, and of places on mirrors, m."""
        shape, retarded = (len(walls), times.shape[-1]), self.retarded
        now, receiver = np.broadcast_to(times, shape), self.motion[1]
        wind, c, count = np.array(self.medium.wind or (0.0, 0.0, 0.0)), self.medium.speed_of_sound, walls.shape[1]
        ends = _Ends(self.motion, now, wind, retarded)
        receiver_at = np.broadcast_to(receiver.position(times), (*shape, 3))
        event, place = [np.zeros(shape)] * count, [receiver_at] * count
        emission, first = np.zeros(shape), known is None
        if known is not None:
            emission = known.emission
            event, place = ([x[:, :, k] for k in range(count)] for x in (known.event, known.place))
        mixed, strays = _Mixing(), np.zeros(len(walls))
        for _ in range(rounds):
            rest = first or not retarded
            at = [e if retarded else np.zeros(shape) for e in event]
            planes = [self.mirrors.planes(walls[:, k], now, at[k], None if rest else place[k]) for k in range(count)]
            if wind.any():  # mirrors as they are in the air's frame: the room's at the times from which is counted
                planes = [replace(mirror, speed=mirror.speed - mirror.normal @ wind) for mirror in planes]
            seen = _images(planes, ends, emission, c)
            apart = receiver_at - seen.place[-1]
            distance = np.linalg.norm(apart, axis=-1)
            onwards = apart / np.maximum(distance, 1e-300)[..., None]
            beyond = seen.late - dot(onwards, seen.moved) / c
            step = -(seen.time[-1] + distance / c) / (1.0 + beyond)
            taken, emission = [emission, *event], emission + step
            before = place
            event, place, share = _traced(planes, seen, receiver_at, wind)
            largest = np.abs(step).max(axis=1, initial=0.0)
            moved = [np.abs(a - b).max(axis=(1, 2)) for a, b in zip(place, before, strict=True)]
            strays = np.max(moved, axis=0, initial=0.0)
            enough = largest.max(initial=0.0) <= (_CONVERGED if known is None else _FOUND)
            if not first and enough and (not self.mixes or strays.max(initial=0.0) <= _ASTRAY):
                break
            if self.mixes and not first:
                emission, event, place = mixed.next((taken, before), ([emission, *event], place), c)
            first = False
        found = (emission, event, place, share), (distance, onwards, beyond)
        return _given(self.mirrors, walls, planes, ends, *found, c), largest, strays


class _Mixing:
    """Anderson's method of the first order: the next guess is where the line through the last two rounds would end.

    D. G. Anderson, J. ACM 12 (1965). Residuals are those of times, as lengths of sound's way, and of places together.
    """

    def __init__(self) -> None:
        self._last: tuple[Floats, Floats] | None = None  # residuals and results (P, T, n) of the round before

    def next(
        self, taken: tuple[list[Floats], list[Floats]], found: tuple[list[Floats], list[Floats]], c: float
    ) -> tuple[Floats, list[Floats], list[Floats]]:
        """Return emission, events and places to go on from, from those taken and found in a round."""
        before, after = (np.concatenate([np.stack(x[0], axis=-1) * c, *x[1]], axis=-1) for x in (taken, found))
        residual, mixed = after - before, after
        if self._last is not None:
            change = residual - self._last[0]
            share = dot(residual, change) / np.maximum(dot(change, change), 1e-300)
            mixed = after - np.clip(share, -_MOST_SHARE, _MOST_SHARE)[..., None] * (after - self._last[1])
        self._last = residual, after
        count = len(found[1])
        times, places = mixed[..., : count + 1] / c, mixed[..., count + 1 :]
        return times[..., 0], list(np.moveaxis(times[..., 1:], -1, 0)), np.split(places, count, axis=-1)


@dataclass(frozen=True, slots=True, eq=False)
class _Images:
    """Images of the emission, before and after each mirror, in the air's frame, and how the last one moves on.

    It is later by ``late``, and farther by ``moved``, m, for a second of emission.
    """

    time: list[Floats]
    place: list[Floats]
    late: Floats
    moved: Floats


def _images(planes: list[Planes], ends: _Ends, emission: Floats, c: float) -> _Images:
    """Return the images of what is emitted at times (P, T)."""
    place, velocity = ends.emitted(emission)
    places, times = [place - emission[..., None] * ends.wind], [emission]
    moved, late = velocity - ends.wind, np.zeros(emission.shape)
    for plane in planes:
        mach = plane.speed / c
        twice = 2.0 / (1.0 - mach**2)
        height = plane.height(times[-1], places[-1]) * twice
        rise = (dot(plane.normal, moved) - plane.speed * (1.0 + late)) * twice
        places.append(places[-1] - height[..., None] * plane.normal)
        times.append(times[-1] - height * mach / c)
        moved, late = moved - rise[..., None] * plane.normal, late - rise * mach / c
    return _Images(times, places, late, moved)


def _traced(
    planes: list[Planes], seen: _Images, receiver_at: Floats, wind: Floats
) -> tuple[list[Floats], list[Floats], list[Floats]]:
    """Return times, places in the room and shares of the reflections, from the receiver back to the source."""
    time, place = np.zeros(receiver_at.shape[:2]), receiver_at
    found: list[tuple[Floats, Floats, Floats]] = []
    for k in range(len(planes) - 1, -1, -1):
        near = planes[k].height(time, place)
        far = planes[k].height(seen.time[k + 1], seen.place[k + 1])
        apart = near - far
        share = np.where(apart == 0.0, 0.0, near / np.where(apart == 0.0, 1.0, apart))
        part = np.clip(share, -BEYOND_LEG, 1.0 + BEYOND_LEG)
        time, place = (time + part * (seen.time[k + 1] - time), place + part[..., None] * (seen.place[k + 1] - place))
        found.append((time, place + time[..., None] * wind, share))
    times, places, shares = ([each[i] for each in found[::-1]] for i in range(3))
    return times, places, shares


def _given(
    mirrors: Mirrors, walls: NDArray[np.signedinteger[Any]], planes: list[Planes], ends: _Ends,
    found: tuple[Floats, list[Floats], list[Floats], list[Floats]], last: tuple[Floats, Floats, Floats], c: float,
) -> Events:  # fmt: skip
    """`Events` of the converged solution, with directions of the legs from the receiver back."""
    emission, event, place, share = found
    distance, onwards, beyond = last
    now, wind, shape = ends.now, ends.wind, ends.now.shape
    source, receiver = ends.motion
    heading = np.broadcast_to(receiver.velocity(now), (*shape, 3))
    carried = 1.0 + onwards @ wind / c
    turned, cosine, growth = onwards, np.empty((*shape, len(planes))), np.zeros(shape)
    for k in range(len(planes) - 1, -1, -1):
        before = _reflected(planes[k], turned, c)
        cosine[..., k] = np.abs(np.sum(planes[k].normal * before, axis=-1))
        if not ends.retarded:
            speed = mirrors.planes(walls[:, k], now, np.zeros(shape), place[k]).speed
            slowness = before / (c + before @ wind)[..., None] - turned / (c + turned @ wind)[..., None]
            growth += dot(slowness, planes[k].normal) * speed
        turned = before
    at, velocity = ends.emitted(emission)
    leaving = velocity if ends.retarded else np.broadcast_to(source.velocity(now), (*shape, 3))
    mach = dot(turned, leaving) / (c + turned @ wind)
    if ends.retarded:
        away = dot(onwards, heading - wind) / c
        rate = (beyond + away) / (1.0 + beyond)
    else:
        rate = growth - mach + dot(onwards, heading) / (c + onwards @ wind)
    receiver_at = np.broadcast_to(receiver.position(now), (*shape, 3))
    return Events(
        -emission, rate, distance, 1.0 + beyond, carried, mach, turned, -onwards,
        np.stack([np.broadcast_to(at, receiver_at.shape), *place, receiver_at], axis=-2),
        np.stack([emission, *event, np.zeros(shape)], axis=-1),
        np.stack([*share], axis=-1) if share else np.empty((*shape, 0)), cosine,
    )  # fmt: skip


def _reflected(plane: Planes, direction: Floats, c: float) -> Floats:
    """Return the directions (P, T, 3) in which sound comes to a mirror that leaves it in given ones."""
    mach = plane.speed / c
    rise = 2.0 * (dot(plane.normal, direction) - mach) / (1.0 - mach**2)
    before = direction - rise[..., None] * plane.normal
    return np.asarray(before / (1.0 - rise * mach)[..., None])
