"""How sound gets from one place to another, and the one equation that tells when it was emitted.

A sound that is received at time t at a place x left the source at t - delay, so that

    delay = travel time from x_s(t - delay) to x.

The kernels (``delay.h``) are the small twin of this file.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from clsim.paths.arrivals import MACH_EXPONENT, Arrivals

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
class Passage:
    """What a medium makes of ways of sound, of any shape (...), from places to others.

    Attributes
    ----------
    time : ndarray (...)
        Travel time, s.
    speed : float or ndarray (...)
        By how many metres a way gets longer while its time grows by a second, with both ends as far apart, m/s.
    carried : ndarray (..., 3) or None
        By how much the time grows as the receiver goes on from the source, with the way as long, s/m; None for not.
    through : ndarray (...)
        Length of the air that sound passes, m.
    """

    time: Floats
    speed: float | Floats
    carried: Floats | None
    through: Floats

    def growth(self, direction: Floats, velocity: Floats) -> Floats:
        """Return by how much the time grows per second as the receiver moves, or falls as the source does.

        Parameters
        ----------
        direction : ndarray (..., 3)
            Unit vector along the way at that end, in the room.
        velocity : ndarray (..., 3)
            Of the end, m/s.
        """
        growth = np.sum(direction * velocity, axis=-1) / self.speed
        return np.asarray(growth if self.carried is None else growth + np.sum(self.carried * velocity, axis=-1))

    def normal(self, direction: Floats) -> Floats:
        """Return the unit normals of the wavefront (..., 3) where ways run in a direction, both in the room."""
        if self.carried is None:
            return direction
        slowness = direction / np.asarray(self.speed)[..., None] + self.carried
        return np.asarray(slowness / np.linalg.norm(slowness, axis=-1, keepdims=True))


class Ways(Protocol):
    """Ways of P paths from any place of the source to a receiver at T times."""

    def leave(self, p: Any, t: Any, start: Floats) -> tuple[Floats, Floats]:
        """Return lengths (...), m, and unit vectors (..., 3) along the ways at the source, in the room.

        Paths `p` and times `t` are indices (n,), or slices; `start` are the places of the source for these.
        """
        ...

    def arrive(self, start: Floats) -> Floats:
        """Return unit vectors (P, T, 3) along the ways at the receiver, in the room, from places (P, T, 3)."""
        ...


class Medium(Protocol):
    """What sound travels in."""

    @property
    def slowest(self) -> float:
        """Bound on the speed of sound from below, in any direction, m/s."""
        ...

    @property
    def fastest(self) -> float:
        """Bound on the speed of sound from above, in any direction, m/s."""
        ...

    def passage(self, length: Floats, apart: Floats) -> Passage:
        """Return how sound passes ways.

        Parameters
        ----------
        length : ndarray (...)
            Of the ways, m.
        apart : ndarray (..., 3)
            From where each begins to where it ends in the room, whatever it met in between, m.
        """
        ...


@dataclass(frozen=True, slots=True)
class UniformAir:
    """Air of one speed of sound, m/s, that rests or moves at one velocity (3,), m/s, everywhere.

    Notes
    -----
    The direct sound solves ``|D - w t| = c t``, D the receiver's place less that of the source at emission:

        t = (sqrt((D.w)² + (c² - w²) L²) - D.w) / (c² - w²),    L = |D|.

    Of paths by walls L is the length in still air: right to the first order of ``w / c``, since the displacements of
    the legs add up to D, and exact where walls are along the wind.
    """

    speed_of_sound: float
    wind: tuple[float, float, float] | None = None

    @property
    def slowest(self) -> float:
        """The speed against the wind."""
        return self.speed_of_sound - (0.0 if self.wind is None else math.hypot(*self.wind))

    @property
    def fastest(self) -> float:
        """The speed with the wind."""
        return self.speed_of_sound + (0.0 if self.wind is None else math.hypot(*self.wind))

    def passage(self, length: Floats, apart: Floats) -> Passage:
        """Return length over speed; in wind the positive root, and its derivatives."""
        c = self.speed_of_sound
        if self.wind is None:
            return Passage(np.asarray(length / c), c, None, length)
        wind = np.array(self.wind)
        room, along = c**2 - wind @ wind, apart @ wind
        root = np.sqrt(along**2 + room * length**2)
        time = (root - along) / room
        return Passage(time, root / length, ((along / root - 1.0) / room)[..., None] * wind, c * time)


def medium_of(air: Air) -> UniformAir:
    """Return what sound travels in, of the air of a scene."""
    return UniformAir(air.speed_of_sound, air.wind)


def straight(start: Floats, stop: Floats) -> tuple[Floats, Floats]:
    """Return lengths (...) and unit vectors (..., 3) of straight ways between places (..., 3), m."""
    apart = stop - start
    length = np.linalg.norm(apart, axis=-1)
    return length, apart / np.maximum(length, 1e-300)[..., None]


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


def arrivals_by(
    ways: Ways, medium: Medium, ends: tuple[Motion, Motion], times: Floats, motion: str, amplitude: str
) -> Arrivals:
    """Return what ways between one source and one receiver bring.

    Parameters
    ----------
    ways : Ways
        To where the receiver is at the times.
    medium : Medium
        What sound travels in.
    ends : tuple of Motion
        Of the source and the receiver.
    times : ndarray (T,)
        Of reception, s.
    motion, amplitude : str
        See `PathFamily.arrivals`.

    Notes
    -----
    The delay solves ``delay = travel time from x_s(t - delay) to x_r(t)``. A point source of the linear wave equation
    is received as ``s(t - delay) / (d (1 - M))``, M its Mach number along the way at emission (Morse and Ingard,
    Theoretical Acoustics, 1968, section 11.2); d is the length of the way along the wavefront's normal: less in wind.
    """
    (source, receiver), everything = ends, slice(None)
    heard_at, heading = receiver.position(times), receiver.velocity(times)

    def travel(p: Any, t: Any, emission_time: Floats) -> tuple[Floats, Floats]:
        start = source.position(emission_time)
        length, direction = ways.leave(p, t, start)
        sound = medium.passage(length, heard_at[t] - start)
        return sound.time, sound.growth(direction, source.velocity(emission_time))

    start = source.position(times)
    delay = medium.passage(ways.leave(everything, everything, start)[0], heard_at - start).time
    emission_time = np.broadcast_to(times, delay.shape)
    if motion == "retarded":
        if not math.isinf(source.end):  # a fixed source was where it is
            delay = refine_delay(travel, delay, times)
        emission_time = times - delay
    flat, shape = emission_time.ravel(), (*delay.shape, 3)
    start, velocity = source.position(flat).reshape(shape), source.velocity(flat).reshape(shape)
    length, direction = ways.leave(everything, everything, start)
    onwards, sound = ways.arrive(start), medium.passage(length, heard_at - start)
    mach, receding = sound.growth(direction, velocity), sound.growth(onwards, heading)
    departure, arrival = sound.normal(direction), -sound.normal(onwards)
    if sound.carried is not None:
        length = length * np.sum(departure * direction, axis=-1)
    rate, factor = receding - mach, np.ones_like(mach)
    if motion == "retarded":
        rate, factor = rate / (1.0 - mach), (1.0 - mach) ** -MACH_EXPONENT[amplitude]
    return Arrivals(delay, rate, departure, arrival, length, sound.through, emission_time, factor)


def contract_delay(
    medium: Medium, position: Callable[[Floats], Floats], mirrored: Floats, heard_at: Floats, times: Floats
) -> Floats:
    """Return the delays (n,) of a source of which only positions are known, s.

    Parameters
    ----------
    medium : Medium
        What sound travels in.
    position : callable
        Takes times (n,), s; returns the source's places (n, 3), m.
    mirrored, heard_at : ndarray (n, 3)
        The receiver as the source sees it and in the room, m.
    times : ndarray (n,)
        Of reception, s.

    Notes
    -----
    Each step is a contraction by the Mach number of the source.
    """
    delay: Floats = np.zeros(len(times))
    for _ in range(_CONTRACTIONS):
        emitted_at = position(times - delay)
        step = medium.passage(straight(emitted_at, mirrored)[0], heard_at - emitted_at).time - delay
        delay = delay + step
        if not np.any(np.abs(step) > _CONTRACTED):
            break
    return delay


def delay_bounds(
    medium: Medium, length: Floats, slack: Floats | float, source_speed: Floats | float
) -> tuple[Floats, Floats]:
    """Return bounds (n,) on the delays of ways that are `length` (n,) m long within `slack`, s.

    Parameters
    ----------
    medium : Medium
        What sound travels in.
    length : ndarray (n,)
        Of the ways at some instant of reception, with source and receiver where they are then, m.
    slack : float or ndarray (n,)
        By how much both ends may be off, together, at the times of reception that matter, m.
    source_speed : float or ndarray (n,)
        Largest speed of the source, m/s: it was elsewhere at emission by so much times the delay.
    """
    low = np.maximum(length - slack, 0.0) / (medium.fastest + source_speed)
    return low, (length + slack) / (medium.slowest - source_speed)


def max_delay_rate(medium: Medium, source_speed: float, receiver_speed: float) -> float:
    """Return a bound on how fast a delay changes with the time of reception, s/s, from the largest speeds, m/s."""
    return (source_speed + receiver_speed) / (medium.slowest - source_speed)
