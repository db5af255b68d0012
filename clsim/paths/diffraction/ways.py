"""Ways over edges between ends that move, in the frames of the edges: nothing is solved but the time of emission."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from clsim.acoustics.diffraction import edge_way

if TYPE_CHECKING:
    from clsim.arrays import Floats
    from clsim.scene.motion.motion import Motion

_NEWTON_LIMIT = 60
_CONVERGED = 1e-15  # s


@dataclass(frozen=True, slots=True, eq=False)
class EdgeView:
    """How the edges of P paths see one end: as coordinates along `across`, `out` and `along` of each edge.

    Attributes
    ----------
    turn : ndarray (P, 3, 3)
        From directions in the room to those in each edge's frame, seen by the walls between.
    shift : ndarray (P, 3)
        Where the room's origin is seen, m.
    """

    turn: Floats
    shift: Floats

    @staticmethod
    def of(matrix: Floats, offset: Floats, frame: Floats) -> EdgeView:
        """Return the view by the walls of isometries (P, 3, 3) and (P, 3), of edges with frames (P, 4, 3)."""
        axes = frame[:, 1:]
        return EdgeView(axes @ matrix, np.einsum("paj,pj->pa", axes, offset - frame[:, 0]))

    def places(self, places: Floats) -> Floats:
        """Return coordinates (3, P, T) of places (T, 3) that are the same for all paths, or (P, T, 3), m."""
        return np.asarray(self.directions(places) + self.shift.T[:, :, None])

    def directions(self, vectors: Floats) -> Floats:
        """Return components (3, P, T) of vectors (T, 3) that are the same for all paths, or (P, T, 3)."""
        seen = self.turn @ np.swapaxes(vectors, -1, -2)
        return np.moveaxis(seen, 1, 0)

    def back(self, components: Floats) -> Floats:
        """Return vectors (P, T, 3) in the room of components (3, P, T)."""
        turned = np.swapaxes(self.turn, 1, 2) @ np.moveaxis(components, 0, 1)
        return np.swapaxes(turned, 1, 2)


@dataclass(frozen=True, slots=True, eq=False)
class EdgeWays:
    """Ways of P paths at T times, as each edge sees them.

    Attributes
    ----------
    source, receiver : ndarray (3, P, T)
        Coordinates of both images, that of the source at emission, m.
    place : ndarray (P, T)
        Where each way meets the edge, m from its start.
    emission_time : ndarray (P, T)
        s.
    delay : ndarray (P, T)
        s.
    mach : ndarray (P, T)
        Of the source towards the way.
    """

    source: Floats
    receiver: Floats
    place: Floats
    emission_time: Floats
    delay: Floats
    mach: Floats

    @property
    def parts(self) -> tuple[Floats, Floats]:
        """Unit vectors (3, P, T) from the source to the edge, and from the receiver to it."""
        return tuple(_towards(end, self.place)[0] for end in (self.source, self.receiver))  # type: ignore[return-value]


def edge_ways(
    views: tuple[EdgeView, EdgeView], end_place: Floats, source: Motion, receiver: Floats, times: Floats,
    speed_of_sound: float, retarded: bool,
) -> EdgeWays:  # fmt: skip
    """Return the ways of P paths between a source and a receiver in still air.

    Parameters
    ----------
    views : tuple of EdgeView
        Of the source, and of the receiver.
    end_place : ndarray (P,)
        Of the ends that paths run over, m; NaN for paths over the edge itself, by the shortest way.
    source : Motion
        How the source moves.
    receiver : ndarray (T, 3)
        Where the receiver is, m.
    times : ndarray (T,)
        Of reception, s.
    speed_of_sound : float
        m/s.
    retarded : bool
        Whether the source is where it was when the sound was emitted, or where it is at reception.

    Notes
    -----
    As the way over the edge itself is the shortest, the change of its apex does not change it: Newton's steps for the
    time of emission take the source's speed along the first part.
    """
    heard_at = views[1].places(receiver)
    over_end = np.flatnonzero(~np.isnan(end_place))
    shape = heard_at.shape[1:]
    emission_time = np.broadcast_to(times, shape)
    positions, velocities = source.position(times), source.velocity(times)
    delay = np.zeros(shape)
    for step_count in range(_NEWTON_LIMIT):
        emitted_at = views[0].places(positions)
        place = np.broadcast_to(_apex(emitted_at, heard_at), shape)
        if len(over_end):
            place = place.copy()
            place[over_end] = end_place[over_end, None]
        towards, first = _towards(emitted_at, place)
        travel = (first + _towards(heard_at, place)[1]) / speed_of_sound
        mach = np.einsum("ipt,ipt->pt", towards, views[0].directions(velocities)) / speed_of_sound
        if not retarded:
            return EdgeWays(emitted_at, heard_at, place, emission_time, travel, mach)
        step = (travel - delay) / (1.0 - mach)
        delay = delay + step
        if step_count and not np.any(np.abs(step) > _CONVERGED + 4e-16 * np.abs(times)):
            break
        if np.isinf(source.end):
            continue
        emission_time = times - delay
        flat = emission_time.ravel()
        positions, velocities = (f(flat).reshape(*shape, 3) for f in (source.position, source.velocity))
    return EdgeWays(emitted_at, heard_at, place, times - delay, delay, mach)


def _apex(emitted_at: Floats, heard_at: Floats) -> Floats:
    (x, y, z), (a, b, h) = emitted_at, heard_at
    return edge_way(np.hypot(x, y), z, np.hypot(a, b), h).apex


def _towards(end: Floats, place: Floats) -> tuple[Floats, Floats]:
    """Return unit vectors (3, P, T) from ends (3, P, T) to places on edges (P, T), and the distances (P, T), m."""
    away = np.stack(np.broadcast_arrays(-end[0], -end[1], place - end[2]))
    distance = np.sqrt(np.einsum("ipt,ipt->pt", away, away))
    return away / np.maximum(distance, 1e-300), distance
