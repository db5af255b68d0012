"""How sound gets from one place to another, and the one equation that tells when it was emitted.

A sound that is received at time t at a place x left the source at t - delay, so that

    delay = travel time from x_s(t - delay) to x.

The kernels (``delay.h``) are the small twin of this file.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Protocol

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from clsim.arrays import Floats
    from clsim.scene.air import Air
    from clsim.scene.motion.motion import Motion

    Rows = NDArray[np.int64]

_NEWTON_LIMIT = 60
_CONVERGED = 1e-15  # s
_CONTRACTIONS = 1000
_CONTRACTED = 1e-13  # s


@dataclass(frozen=True, slots=True, eq=False)
class Leg:
    """A way of sound from one place to another, of any shape (...).

    Attributes
    ----------
    time : ndarray (...)
        Travel time, s.
    length : ndarray (...)
        Distance of the places, m.
    departure, arrival : ndarray (..., 3)
        Unit normals of the wavefront where the way begins and ends.
    departure_speed, arrival_speed : float or ndarray (...)
        Speeds at which the wavefront passes there, along its normal, m/s.
    """

    time: Floats
    length: Floats
    departure: Floats
    arrival: Floats
    departure_speed: float | Floats
    arrival_speed: float | Floats

    def mach_at_departure(self, velocity: Floats) -> Floats:
        """Return by how much the travel time falls per second as the beginning moves with a velocity (..., 3), m/s."""
        return np.asarray(np.sum(self.departure * velocity, axis=-1) / self.departure_speed)

    def mach_at_arrival(self, velocity: Floats) -> Floats:
        """Return by how much the travel time grows per second as the end moves with a velocity (..., 3), m/s."""
        return np.asarray(np.sum(self.arrival * velocity, axis=-1) / self.arrival_speed)


class SpeedBounds(Protocol):
    """How fast sound can be."""

    @property
    def slowest(self) -> float:
        """Bound on the speed of sound from below, in any direction, m/s."""
        ...

    @property
    def fastest(self) -> float:
        """Bound on the speed of sound from above, in any direction, m/s."""
        ...


class Medium(SpeedBounds, Protocol):
    """What sound travels in."""

    def travel_time(self, start: Floats, stop: Floats) -> Floats:
        """Return the time (...) that sound takes from places (..., 3) to others, s."""
        ...

    def leg(self, start: Floats, stop: Floats) -> Leg:
        """Return the way from places (..., 3) to others, with the derivatives of its time by either."""
        ...


@dataclass(frozen=True, slots=True)
class StillAir:
    """Air of one speed of sound, m/s, that rests."""

    speed_of_sound: float

    @property
    def slowest(self) -> float:
        """The speed of sound."""
        return self.speed_of_sound

    @property
    def fastest(self) -> float:
        """The speed of sound."""
        return self.speed_of_sound

    def travel_time(self, start: Floats, stop: Floats) -> Floats:
        """Return distance over speed, s."""
        return np.asarray(np.linalg.norm(stop - start, axis=-1) / self.speed_of_sound)

    def leg(self, start: Floats, stop: Floats) -> Leg:
        """Return the straight way."""
        apart = stop - start
        length = np.linalg.norm(apart, axis=-1)
        direction = apart / np.maximum(length, 1e-300)[..., None]
        c = self.speed_of_sound
        return Leg(length / c, length, direction, direction, c, c)


@dataclass(frozen=True, slots=True)
class SpeedRange:
    """Bounds of the speed of sound in some media, m/s."""

    slowest: float
    fastest: float


@lru_cache(maxsize=256)
def medium_of(air: Air, frequency: float) -> Medium:
    """Return what sound of a frequency, Hz, travels in, of the air of a scene."""
    return StillAir(air.speed_at(frequency))


def solve_delay(medium: Medium, source: Motion, stop: Floats, times: Floats) -> Floats:
    """Return the delays (P, T) of single legs from a source to places (P, T, 3) at times of reception (T,), s."""
    delay = medium.travel_time(source.position(times), stop)
    if np.isinf(source.end):
        return delay  # a fixed source was where it is

    def travel(p: Rows, t: Rows, emission_time: Floats) -> tuple[Floats, Floats]:
        leg = medium.leg(source.position(emission_time), stop[p, t])
        return leg.time, leg.mach_at_departure(source.velocity(emission_time))

    return refine_delay(travel, delay, times)


def refine_delay(travel: Callable[[Rows, Rows, Floats], tuple[Floats, Floats]], delay: Floats, times: Floats) -> Floats:
    """Return the delays (P, T) of ways of any kind at times of reception (T,), s, by Newton's method.

    Parameters
    ----------
    travel : callable
        Takes paths p (n,), indices t (n,) of times and times of emission (n,), s; returns the travel times (n,), s, and
        by how much these fall per second as the source moves on, the Mach number (n,) towards the way.
    delay : ndarray (P, T)
        Where to begin, such as the quasi-static value, s.
    times : ndarray (T,)
        s.

    Notes
    -----
    For a source below the speed of sound there is one solution.
    """
    delay = np.array(delay)
    active: NDArray[np.bool_] = np.ones(delay.shape, dtype=bool)
    for _ in range(_NEWTON_LIMIT):
        p, t = np.nonzero(active)
        if not len(p):
            break
        time, mach = travel(p, t, times[t] - delay[p, t])
        step = (time - delay[p, t]) / (1.0 - mach)
        delay[p, t] += step
        active[p, t] = np.abs(step) > _CONVERGED + 4e-16 * np.abs(times[t])
    return delay


def contract_delay(medium: Medium, position: Callable[[Floats], Floats], stop: Floats, times: Floats) -> Floats:
    """Return the delays (n,) to places (n, 3) at times (n,) of a source of which only positions are known, s.

    Each step is a contraction by the Mach number of the source.
    """
    delay: Floats = np.zeros(len(times))
    for _ in range(_CONTRACTIONS):
        step = medium.travel_time(position(times - delay), stop) - delay
        delay = delay + step
        if not np.any(np.abs(step) > _CONTRACTED):
            break
    return delay


def delay_bounds(
    speeds: SpeedBounds, length: Floats, slack: Floats | float, source_speed: Floats | float
) -> tuple[Floats, Floats]:
    """Return bounds (n,) on the delays of ways that are `length` (n,) m long within `slack`, s.

    Parameters
    ----------
    speeds : SpeedBounds
        Of sound.
    length : ndarray (n,)
        Of the ways at some instant of reception, with source and receiver where they are then, m.
    slack : float or ndarray (n,)
        By how much both ends may be off, together, at the times of reception that matter, m.
    source_speed : float or ndarray (n,)
        Largest speed of the source, m/s: it was elsewhere at emission by so much times the delay.
    """
    low = np.maximum(length - slack, 0.0) / (speeds.fastest + source_speed)
    return low, (length + slack) / (speeds.slowest - source_speed)


def max_delay_rate(speeds: SpeedBounds, source_speed: float, receiver_speed: float) -> float:
    """Return a bound on how fast a delay changes with the time of reception, s/s, from the largest speeds, m/s."""
    return (source_speed + receiver_speed) / (speeds.slowest - source_speed)
