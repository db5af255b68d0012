"""How sound gets from one place to another, and the one equation that tells when it was emitted.

A sound that is received at time t at a place x left the source at t - delay, so that

    delay = travel time from x_s(t - delay) to x.

The kernels (``delay.h``) are the small twin of this file.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Floats, Rows
from clsim.paths.response import Arrivals, Kinematics
from clsim.scene.air import Air
from clsim.scene.fluctuation import Fluctuation
from clsim.scene.motion.motion import Motion

_NEWTON_LIMIT = 60
_CONVERGED = 1e-15  # s
_STEP = 1e-3  # m, half of that by which derivatives along the height are taken
_BEYOND_NODES = 5e-3  # of the speed, by which it and what delays change by are bounded beyond what layers say
NEAREST = 1e-7  # m, least length of a way, below every `min_distance`
_CONTRACTIONS = 1000
_CONTRACTED = 1e-13  # s
_BEYOND = 1.05  # half the room's height from its middle, beyond which the air is as it is there
_UPRIGHT = 1e-12  # vertical component of a wall's normal below which it leaves heights alone


@dataclass(frozen=True, slots=True, eq=False)
class Passage:
    """What a medium makes of ways of sound, of any shape (...), from places to others."""

    length: Floats  # (...) of the ways, m, and travel time, s
    time: Floats  # likewise
    # (...) by how many metres a way gets longer while its time grows by a second, with both ends as far apart, m/s.
    speed: float | Floats
    # (..., 3) by how much the time grows as the receiver goes on from the source, with the way as long, s/m; None for
    # not.
    carried: Floats | None
    through: Floats  # (...) length of the air that sound passes, m

    def growth(self, direction: Floats, velocity: Floats) -> Floats:
        """Rate of the travel time as the receiver moves, or its negative as the source does, s/s."""
        growth = _dot(direction, velocity) / self.speed
        return np.asarray(growth if self.carried is None else growth + _dot(self.carried, velocity))

    def slowness(self, direction: Floats) -> Floats:
        """Gradient of the travel time by the receiver's position (..., 3), s/m, for paths that run in a direction."""
        along = direction / np.asarray(self.speed)[..., None]
        return np.asarray(along if self.carried is None else along + self.carried)

    def along(self, normal: Floats, direction: Floats) -> Floats:
        """Return the lengths (...) along normals (..., 3) of wavefronts, m, of ways that run in directions (..., 3)."""
        if self.carried is None:
            return self.length
        return np.asarray(np.maximum(self.length * np.sum(normal * direction, axis=-1), NEAREST))

    def normal(self, direction: Floats) -> Floats:
        """Return the unit normals of the wavefront (..., 3) where ways run in a direction, both in the room."""
        if self.carried is None:
            return direction
        slowness = self.slowness(direction)
        return np.asarray(slowness / np.linalg.norm(slowness, axis=-1, keepdims=True))


def _dot(a: Floats, b: Floats) -> Floats:
    """Return the products (...) of vectors (..., 3), summed as `numpy.sum` does, without what it costs for three."""
    return np.asarray(a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1] + a[..., 2] * b[..., 2] + 0.0)  # never -0


class LegTable(Protocol):
    """Ways of P paths from any place of the source to a receiver at T times."""

    def leave(self, p: Any, t: Any, start: Floats) -> tuple[Floats, Floats]:
        """Return lengths (...), m, and unit vectors (..., 3) along the ways at the source, in the room."""

    def arrive(self, start: Floats) -> Floats:
        """Return unit vectors (P, T, 3) along the ways at the receiver, in the room, from places (P, T, 3)."""

    def seen(self) -> Floats:
        """Return the receiver (P, T, 3) as the source sees it, m."""

    def bends(self, p: Any, t: Any, start: Floats) -> tuple[Floats, Floats]:
        """Bends of paths, arguments as for `leave`: shares (..., K) from 0 to 1, and heights (..., K), m."""


@dataclass(frozen=True, slots=True)
class UniformAir:
    """Air of one speed of sound, m/s, that rests or moves at one velocity (3,), m/s, everywhere.

    The direct sound solves ``|D - w t| = c t``, D the receiver's place less that of the source at emission:

        t = (sqrt((D.w)² + (c² - w²) L²) - D.w) / (c² - w²),    L = |D|.

    Of paths by walls L is the length in still air: right to the first order of ``w / c``, since the displacements of
    the legs add up to D, and exact where walls are along the wind.
    """

    speed_of_sound: float
    wind: tuple[float, float, float] | None = None
    fluctuation: Fluctuation | None = None

    @property
    def slowest(self) -> float:
        """The speed against the wind."""
        return self.speed_of_sound - math.hypot(*(self.wind or ()))

    @property
    def fastest(self) -> float:
        """The speed with the wind."""
        return self.speed_of_sound + math.hypot(*(self.wind or ()))

    def means(self, leg_table: LegTable, p: Any, t: Any, start: Floats) -> Floats | None:
        """Return None: it is the same everywhere."""
        return None

    def passage(self, length: Floats, apart: Floats, means: Floats | None = None) -> Passage:
        """Compute what it makes of paths of lengths (...) between ends apart (..., 3), m."""
        return _passage(self.speed_of_sound, self.wind, length, apart)


@dataclass(frozen=True, slots=True)
class LayeredAir:
    """Air whose speed of sound depends on the height.

    Sound takes straight legs at the mean slowness along them, exact for polynomials of the height. That ways are bent
    makes them earlier by some ``g² d³ / (24 c³)``, g the change of the speed by height: 0.13 mm at 1 K/m over 10 m.
    """

    slowness: tuple[float, ...]  # Chebyshev's coefficients over `extent`, s/m
    extent: tuple[float, float]  # heights, m
    slowest: float  # bounds on the speed of sound, in any direction, m/s
    fastest: float  # likewise
    wind: tuple[float, float, float] | None  # as of `UniformAir`
    fluctuation: Fluctuation | None  # likewise

    def means(self, leg_table: LegTable, p: Any, t: Any, start: Floats) -> Floats | None:
        """Return means (..., terms) of Chebyshev polynomials of the height along ways."""
        return means_along(*leg_table.bends(p, t, start), self.extent, len(self.slowness))

    def passage(self, length: Floats, apart: Floats, means: Floats | None = None) -> Passage:
        """Return length times mean slowness; in wind as of `UniformAir`, at the mean speed."""
        assert means is not None
        return _passage(1.0 / (means @ np.array(self.slowness)), self.wind, length, apart)


Medium = UniformAir | LayeredAir


def _passage(c: float | Floats, wind: tuple[float, float, float] | None, length: Floats, apart: Floats) -> Passage:
    if wind is None:
        return Passage(length, np.asarray(length / c), c, None, length)
    w = np.array(wind)
    room, along = c**2 - w @ w, apart @ w
    root = np.sqrt(along**2 + room * length**2)
    time = (root - along) / room
    return Passage(length, time, root / length, ((along / root - 1.0) / room)[..., None] * w, c * time)


@dataclass(frozen=True, slots=True)
class SpeedRange:
    """Bounds of the speed of sound in some media, m/s, and their noise."""

    slowest: float
    fastest: float
    fluctuation: Fluctuation | None

    def delay_bounds(
        self, length: Floats, slack: Floats | float, source_speed: Floats | float
    ) -> tuple[Floats, Floats]:
        """Return bounds (n,) on the delays of ways, s, that have a length (n,), m, at some instant of reception.

        Both ends may be off by `slack`, m, together, and the source at emission by its largest speed times the delay.
        """
        low = np.maximum(length - slack, 0.0) / (self.fastest + source_speed)
        high = (length + slack) / (self.slowest - source_speed)
        if self.fluctuation is None:
            return low, high
        noise = self.fluctuation.most / (1.0 - source_speed / self.slowest)
        return np.maximum(low - noise, 0.0), high + noise

    def max_delay_rate(self, source_speed: float, receiver_speed: float) -> float:
        """Return a bound on how fast a delay changes with the time of reception, s/s, from the largest speeds, m/s."""
        rate = (source_speed + receiver_speed) / (self.slowest - source_speed)
        if self.fluctuation is None:
            return rate
        return rate + self.fluctuation.most_rate(source_speed, receiver_speed) / (1.0 - source_speed / self.slowest)


@lru_cache(maxsize=256)
def medium_of(air: Air, frequency: float) -> Medium:
    """Medium of a scene's air for sound of a frequency, Hz."""
    if not air.layers:
        return UniformAir(air.speed_at(frequency), air.wind, air.fluctuation)
    assert air.extent is not None
    slowness = air.by_height(lambda layer: 1.0 / layer.speed_at(frequency))
    fastest = max(layer.speed_at(frequency) for layer in air.layers) + math.hypot(*(air.wind or ()))
    return LayeredAir(
        tuple(slowness.tolist()), air.extent, (1.0 - _BEYOND_NODES) * air.slowest, (1.0 + _BEYOND_NODES) * fastest,
        air.wind, air.fluctuation,
    )  # fmt: skip


def mean_medium_of(air: Air, frequency: float) -> UniformAir:
    """Medium without heights and noise, by which the validity of paths is determined."""
    return UniformAir(air.speed_at(frequency), air.wind)


def straight(start: Floats, stop: Floats) -> tuple[Floats, Floats]:
    """Return lengths (...) and unit vectors (..., 3) of straight ways between places (..., 3), m.

    Lengths are `NEAREST` at least: a source that is silent may be met, and its gain must be finite there.
    """
    apart = stop - start
    square = apart * apart  # summed as a norm is, without what it costs for three numbers
    length = np.maximum(np.sqrt(square[..., 0] + square[..., 1] + square[..., 2]), NEAREST)
    return length, apart / length[..., None]


def refine_delay(travel: Callable[[Rows, Rows, Floats], tuple[Floats, Floats]], delay: Floats, times: Floats) -> Floats:
    """Refine delays (P, T) at times of reception (T,), s, by Newton's method; slow sources have one solution.

    `travel` takes paths p (n,), indices t (n,) of times and times of emission (n,), s, at first slices of all and
    (P, T). It returns travel times (n,), s, and Mach numbers (n,) of the source towards the way.
    """
    delay = np.array(delay)
    p: Any = slice(None)  # all at first
    t: Any = slice(None)
    active = np.ones(delay.shape, dtype=bool)
    for _ in range(_NEWTON_LIMIT):
        time, mach = travel(p, t, times[t] - delay[p, t])
        step = np.where(active[p, t], (time - delay[p, t]) / (1.0 - mach), 0.0)
        delay[p, t] += step
        active[p, t] = np.abs(step) > _CONVERGED + 4e-16 * np.abs(times[t])
        left = np.count_nonzero(active)
        if not left:
            break
        if 2 * left < active.size:  # rows by their indices take twice as long each
            p, t = np.nonzero(active)
    return delay


def arrivals_by(
    mirrored_to: Callable[[Floats], LegTable], medium: Medium, ends: tuple[Motion, Motion], times: Floats,
    kinematics: Kinematics,
) -> Arrivals:  # fmt: skip
    """Arrivals of paths between one source and one receiver at times (T,), s.

    The delay solves ``delay = travel time from x_s(t - delay) to x_r(t)``. A point source of the linear wave equation
    is received as ``s(t - delay) / (d (1 - M))``, M its Mach number along the way at emission (Morse and Ingard,
    Theoretical Acoustics, 1968, section 11.2); d is the length of the way along the wavefront's normal: less in wind.
    """
    source, receiver = ends
    receiver_at, heading = receiver.position(times), receiver.velocity(times)
    leg_table, whole = mirrored_to(receiver_at), (slice(None), slice(None))

    def passage(p: Any, t: Any, start: Floats) -> tuple[Floats, Passage, Floats | None]:
        """Departure of sound from `start` (m): direction, effect of the medium on the path, its means along it."""
        length, direction = leg_table.leave(p, t, start)
        means = medium.means(leg_table, p, t, start)
        # Without wind only the length matters.
        return direction, medium.passage(length, start if medium.wind is None else receiver_at[t] - start, means), means

    def travel(p: Any, t: Any, emission_time: Floats) -> tuple[Floats, Floats]:
        """Return the time that sound takes which was emitted at a time (s), and how fast that time grows with it."""
        flat, shape = emission_time.ravel(), (*emission_time.shape, 3)
        direction, sound, _ = passage(p, t, source.position(flat).reshape(shape))
        growth = sound.growth(direction, source.velocity(flat).reshape(shape))
        return (sound.time if noise is None else sound.time + noise[0][p, t]), growth

    noise = _noise(mirrored_to, medium, ends, times)
    delay = passage(*whole, source.position(times)[None])[1].time
    if noise is not None:
        delay = delay + noise[0]
    if kinematics.retarded and not math.isinf(source.end):  # a fixed source was where it is
        delay = refine_delay(travel, delay, times)
    emission_time = times - delay if kinematics.retarded else np.broadcast_to(times, delay.shape)
    flat, shape = emission_time.ravel(), (*delay.shape, 3)
    start, velocity = source.position(flat).reshape(shape), source.velocity(flat).reshape(shape)
    (direction, sound, means), onwards = passage(*whole, start), leg_table.arrive(start)
    mach, receding = sound.growth(direction, velocity), sound.growth(onwards, heading)
    if means is not None:  # which change too as the ends move
        growth = partial(_growth_by_means, medium, sound.length, receiver_at - start)
        mach -= growth(lambda step: medium.means(leg_table, *whole, start + step), velocity)
        receding += growth(lambda step: medium.means(mirrored_to(receiver_at + step), *whole, start), heading)
    rate = receding - mach if noise is None else receding - mach + noise[1]
    factor, ratio = np.ones_like(mach), np.ones_like(mach)
    if kinematics.retarded:
        rate, factor, ratio = rate / (1.0 - mach), (1.0 - mach) ** -kinematics.exponent, 1.0 / (1.0 - mach)
    departure, arrival = sound.normal(direction), -sound.normal(onwards)
    length = sound.along(departure, direction)
    return Arrivals(delay, rate, departure, arrival, length, sound.through, means, emission_time, factor, ratio)


def _noise(
    mirrored_to: Callable[[Floats], LegTable], medium: Medium, ends: tuple[Motion, Motion], times: Floats
) -> tuple[Floats, Floats] | None:
    """Noise of delays (P, T), s, and of their rates, with both endpoints as at reception; or None."""
    if medium.fluctuation is None:
        return None
    source, receiver = ends
    receiver_at, heading = receiver.position(times), receiver.velocity(times)
    seen = mirrored_to(receiver_at).seen()
    turned = mirrored_to(receiver_at + heading).seen() - seen  # isometries: velocities as the source sees them
    return medium.fluctuation.at(times, seen, source.position(times), (turned, source.velocity(times)))


def _growth_by_means(
    medium: Medium, length: Floats, apart: Floats, means: Callable[[Floats], Floats | None], velocity: Floats
) -> Floats:
    """Rate of the travel time as an endpoint moves, by path lengths and the medium along them, s/s."""
    speed = np.linalg.norm(velocity, axis=-1)
    if not speed.any():
        return np.zeros(speed.shape)
    step = _STEP * velocity / np.maximum(speed, 1e-300)[..., None]
    before, after = (medium.passage(length, apart, means(sign * step)).time for sign in (-1.0, 1.0))
    return np.asarray((after - before) * speed / (2.0 * _STEP))


def contract_delay(
    medium: Medium, position: Callable[[Floats], Floats], mirrored: Floats, receiver_at: Floats, times: Floats
) -> Floats:
    """Return the delays (n,) of a source of which only positions are known, s."""
    delay: Floats = np.zeros(len(times))
    for _ in range(_CONTRACTIONS):
        emitted_at = position(times - delay)
        step = medium.passage(straight(emitted_at, mirrored)[0], receiver_at - emitted_at).time - delay
        delay = delay + step
        if not np.any(np.abs(step) > _CONTRACTED):
            break
    return delay


class Folds:
    """Heights along paths by walls (P, N), whatever the places of their ends.

    Of the unfolded straight line, leg k is seen in the room from the source mirrored by the first k walls to the
    receiver mirrored back by the others; its height is linear in the share of the way, and both legs at a wall agree
    where it is met. Walls that stand upright bend no height.
    """

    def __init__(self, planes: tuple[Floats, Floats], walls: NDArray[np.signedinteger[Any]]) -> None:
        count, most = walls.shape
        normals = np.where((walls >= 0)[..., None], planes[0][walls], 0.0)
        offsets = np.where(walls >= 0, planes[1][walls], 0.0)
        forth, back = (np.tile(np.eye(4), (count, most + 1, 1, 1)) for _ in range(2))
        for k in range(most):
            forth[:, k + 1] = _mirror(normals[:, k], offsets[:, k]) @ forth[:, k]
        for k in range(most, 0, -1):
            back[:, k - 1] = _mirror(normals[:, k - 1], offsets[:, k - 1]) @ back[:, k]
        # Legs that begin at the source or at a wall that bends heights; the last one again where a path has fewer.
        bends = np.concatenate([np.ones((count, 1), dtype=bool), np.abs(normals[..., 2]) > _UPRIGHT], axis=1)
        legs = np.argsort(~bends, axis=1, kind="stable")[:, : int(bends.sum(axis=1).max(initial=1))]
        self._real = np.take_along_axis(bends, legs, axis=1)
        last = np.take_along_axis(legs, self._real.sum(axis=1, keepdims=True) - 1, axis=1)
        legs = np.where(self._real, legs, last)[:, :, None]
        self._forth, self._back = (np.take_along_axis(rows[:, :, 2], legs, axis=1) for rows in (forth, back))

    def bends(self, p: Any, start: Floats, stop: Floats) -> tuple[Floats, Floats]:
        """Bends of paths between places (..., 3), first and last, in the room."""
        among = np.broadcast_shapes(start.shape, stop.shape)[1:-1]  # all times of a path, or none: one each
        spread = (slice(None), *[None] * len(among))
        forth, back, bent = (rows[p][spread] for rows in (self._forth, self._back, self._real))
        shape = (len(bent), *among)
        real = np.broadcast_to(bent, (*shape, bent.shape[-1]))
        first, last = (
            np.broadcast_to(np.einsum("...ki,...i->...k", rows[..., :3], place) + rows[..., 3], real.shape)
            for rows, place in ((forth, start), (back, stop))
        )
        shares = np.zeros((*shape, real.shape[-1] + 1))
        apart = first[..., :-1] - first[..., 1:]
        rise = apart - (last[..., :-1] - last[..., 1:])
        inner = np.where(rise == 0.0, 0.5, apart / np.where(rise == 0.0, 1.0, rise))
        shares[..., 1:-1] = np.where(real[..., 1:], inner, 1.0)
        shares[..., -1] = 1.0
        heights = np.empty_like(shares)
        heights[..., :-1] = first + shares[..., :-1] * (last - first)
        heights[..., -1] = last[..., -1]
        return shares, heights


def means_along(shares: Floats, heights: Floats, extent: tuple[float, float], terms: int) -> Floats:
    """Return the means of Chebyshev polynomials of the height over ways of straight legs."""
    place, weight = np.polynomial.legendre.leggauss(terms // 2 + 1)
    scaled = (2.0 * heights - (extent[0] + extent[1])) / (extent[1] - extent[0])
    low, change = scaled[..., :-1, None], np.diff(scaled, axis=-1)[..., None]
    u = np.clip(low + 0.5 * (1.0 + place) * change, -_BEYOND, _BEYOND)
    weights = 0.5 * np.diff(shares, axis=-1)[..., None] * weight
    means, before, now = np.empty((*shares.shape[:-1], terms)), np.ones_like(u), u
    for i in range(terms):
        means[..., i] = np.sum(weights * before, axis=(-2, -1))
        before, now = now, 2.0 * u * now - before
    return means


def _mirror(normal: Floats, offset: Floats) -> Floats:
    """Return matrices (P, 4, 4) that mirror (x, y, z, 1) by planes; those of no normal do nothing."""
    matrix = np.tile(np.eye(4), (len(normal), 1, 1))
    matrix[:, :3, :3] -= 2.0 * normal[:, :, None] * normal[:, None, :]
    matrix[:, :3, 3] = 2.0 * offset[:, None] * normal
    return matrix
