"""Ways of sound from a source by a moving scatterer to a receiver: two delay equations, the later one first."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from clsim.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Callable

    from clsim.acoustics.scattering import Glint
    from clsim.arrays import Floats
    from clsim.paths.propagation import Leg, Medium
    from clsim.scene.scatterer import Scatterer

    Emitter = Callable[[Floats], tuple[Floats, Floats]]  # positions and velocities (..., 3) at times (...)

_ROUNDS = 60
_CLOSE = 1e-9  # s; the next step is about its square over a second
_SETTLED = 1e-3  # rad of a specular point; its way is the shortest: wrong by the fourth power of this after the step


@dataclass(frozen=True, slots=True, eq=False)
class Way:
    """Sound by a scatterer, of any shape (...), as it is received at some time.

    Attributes
    ----------
    delay, late : ndarray (...)
        Since it was emitted, and since it was scattered, s.
    first, second : Leg
        To the scatterer, and on from there.
    place, velocity : ndarray (..., 3)
        Where it was scattered, m, and how fast the thing moved there, m/s.
    source_velocity : ndarray (..., 3)
        Of the source when it was emitted, m/s.
    strength, cosine : ndarray (...)
        See `Shape`.
    """

    delay: Floats
    late: Floats
    first: Leg
    second: Leg
    place: Floats
    velocity: Floats
    source_velocity: Floats
    strength: Floats
    cosine: Floats


class Body:
    """A scatterer as ends see it, and what was found of it when last looked at.

    Parameters
    ----------
    scatterer : Scatterer
        Which.
    """

    def __init__(self, scatterer: Scatterer) -> None:
        self._shape, self._trajectory = scatterer.shape, scatterer.trajectory
        self._turned = scatterer.trajectory.has_orientation and scatterer.shape.radius > 0.0
        self._glint: Glint | None = None
        self._ends: list[Floats] = []

    @property
    def change(self) -> float:
        """By how much the specular point has turned when it was last looked for, rad."""
        return 0.0 if self._glint is None else self._glint.change

    def seen(
        self, times: Floats, source: Floats, receiver: Floats, weight: Floats | float
    ) -> tuple[Floats, Floats]:
        """Return place and velocity (..., 3) of what scatters at times (...) for ends (..., 3).

        The weight of the way to the receiver is that of `ellipsoid_glint`.
        """
        centre, velocity = self._trajectory.position(times), self._trajectory.velocity(times)
        away = [end - centre for end in (source, receiver)]
        if self._turned:
            axes = _axes(self._trajectory.orientation(times))
            away = [np.einsum("...ij,...i->...j", axes, v) for v in away]
        self._ends = [np.ascontiguousarray(v.reshape(-1, 3).T) for v in away]
        flat = weight.ravel() if isinstance(weight, np.ndarray) else weight
        self._glint = self._shape.glint(*self._ends, self._glint, flat)
        if self._glint is None:
            return centre, velocity
        offset = self._glint.place.T.reshape(*times.shape, 3)
        if self._turned:
            offset = np.einsum("...ij,...j->...i", axes, offset)
            velocity = velocity + np.cross(self._trajectory.angular_velocity(times), offset)
        return centre + offset, velocity

    def strength(self, shape: tuple[int, ...]) -> list[Floats]:
        """Return strength and cosine, of a shape, of what was last seen."""
        return [values.reshape(shape) for values in self._shape.strength(*self._ends, self._glint)]


def _axes(quaternions: Floats) -> Floats:
    """Return matrices (..., 3, 3) that turn as unit quaternions x y z w (..., 4) do."""
    x, y, z, w = np.moveaxis(quaternions, -1, 0)
    rows = [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)],
        [2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)],
        [2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def scattered_way(
    medium: Medium, scatterer: Scatterer, source: Emitter, heard_at: Floats, times: Floats, retarded: bool
) -> Way:
    """Return the ways of sound that is received at places (P, T, 3) at times (T,), s.

    Parameters
    ----------
    medium : Medium
        What sound travels in.
    scatterer : Scatterer
        By which.
    source : callable
        Gives places and velocities (P, T, 3) of each path's image of the source at times (P, T).
    heard_at : ndarray (P, T, 3)
        Each path's image of the receiver, m.
    times : ndarray (T,)
        Of reception, s.
    retarded : bool
        Whether all is where it was when the sound passed, or where it is at reception.

    Notes
    -----
    With the place x that scatters, ``late = travel time from x(t - late) to the receiver`` and ``delay - late = travel
    time from the source at t - delay to x(t - late)``, both by Newton's method together with the specular point: as its
    way is the shortest, that it moves over the surface changes no time, and x moves as the thing does.
    """
    body, shape = Body(scatterer), heard_at.shape[:2]
    weight: Floats | float = 1.0
    late = medium.travel_time(scatterer.trajectory.position(times), heard_at)
    first_time = medium.travel_time(source(np.broadcast_to(times, shape))[0], scatterer.trajectory.position(times))
    for _ in range(_ROUNDS):
        event = times - late if retarded else np.broadcast_to(times, shape)
        emitted_at, source_velocity = source(event - first_time if retarded else event)
        place, velocity = body.seen(event, emitted_at, heard_at, weight)
        second, first = medium.leg(place, heard_at), medium.leg(emitted_at, place)
        later, more = second.time - late, first.time - first_time
        if retarded:
            leaving, coming = second.mach_at_departure(velocity), first.mach_at_arrival(velocity)
            mach, weight = first.mach_at_departure(source_velocity), (1.0 - coming) / (1.0 - leaving)
            later = later / (1.0 - leaving)
            more = (more + later * (mach - coming)) / (1.0 - mach)
        late, first_time = late + later, first_time + more
        if not retarded and body.change <= _SETTLED:
            break
        if max(np.abs(later).max(initial=0.0), np.abs(more).max(initial=0.0)) <= _CLOSE and body.change <= _SETTLED:
            break
    else:
        raise InputError(
            "scatterers",
            f"must be seen from both ends, but no way by {scatterer.name!r} was found from {times[0]:.6g} to "
            f"{times[-1]:.6g} s",
        )
    return Way(late + first_time, late, first, second, place, velocity, source_velocity, *body.strength(shape))
