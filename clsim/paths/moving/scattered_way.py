"""Ways of sound by mirrors that move to a scatterer, and on by others: images of events on both legs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.errors import InputError
from clsim.numerics.quaternions import cross_product, rotate
from clsim.paths.moving.events import find_events
from clsim.paths.moving.mirrors import dot
from clsim.paths.scattering.way import Body

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Floats
    from clsim.paths.moving.events import Events
    from clsim.paths.moving.mirrors import Mirrors
    from clsim.paths.propagation import UniformAir
    from clsim.scene.motion.motion import Motion
    from clsim.scene.scatterer import Scatterer

    Walls = NDArray[np.signedinteger[Any]]

_ROUNDS = 40
_FEW, _MANY = 3, 20  # rounds of the searches for events: by the centre first, from where the surface is looked for
_SETTLED = 1e-3  # rad of a specular point, by the last step


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
    """A point of a scatterer as an end of either leg: it moves and turns as that does.

    Shapes: offset (P, T, 3) m.

    offset: of each path and time from the centre, in the scatterer's frame, m; the centre where left out.
    """

    def __init__(self, motion: Motion, offset: Floats | None) -> None:
        self._motion, self._offset = motion, offset

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
    mirrors: Mirrors,
    legs: tuple[Walls, Walls],
    scatterer: Scatterer,
    ends: tuple[Motion, Motion],
    medium: UniformAir,
    times: Floats,
    retarded: bool = True,
) -> ScatteredEvents:
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
    settled = False
    for done in range(_ROUNDS):
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
        if settled or body.glint is None:
            break
        settled = done > 0 and body.change <= _SETTLED  # by images that the surface sees, not the centre
        point = _Point(scatterer.trajectory, body.glint.place.T.reshape(*shape, 3))
    else:
        raise InputError(
            "scatterers",
            f"must be seen from both ends, but no way by {scatterer.name!r} was found from {times[0]:.6g} to "
            f"{times[-1]:.6g} s",
        )
    strength, aspects = body.strength(shape)
    return ScatteredEvents(first, second, event, mach[0], strength, aspects)
