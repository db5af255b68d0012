"""Sound over an edge that moves, among mirrors that move: where on the edge and when it is diffracted, exactly.

The way to the edge and the way from it are two of `find_events`, with a point of the edge for an end. Where the point
lies along the edge is found by Newton's method: the sum of both is stationary there (Fermat). Images of emission and
reception by the mirrors, and the event of diffraction, are seen from the edge's own frame, into which a Lorentz
transformation with the speed of sound leads: there the edge rests, and all is as at an edge at rest.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from clsim.acoustics.diffraction import path_over_edge
from clsim.arrays import Floats
from clsim.paths.legs.events import Events, few_of, find_events
from clsim.paths.legs.mirrors import EdgeLines, EdgePoint, Mirrors, dot
from clsim.paths.propagation import UniformAir
from clsim.paths.vertices.edge_field import cylindrical
from clsim.scene.motion.motion import Motion

Triple = tuple[Floats, Floats, Floats]

_ROUNDS = 20  # of `find_events`
_FOUND = 1e-8  # m along the edge: what that leaves of the way is its square over the distances
_BEYOND = 1.0  # lengths of the edge, by which places of paths that are not there may lie off it


@dataclass(frozen=True, slots=True, eq=False)
class Chains:
    """What P paths meet: mirrors, an edge or one of its ends, and mirrors, all from the source's side."""

    before: NDArray[np.int32]  # (P, N) mirrors before the edge and after it, filled up with -1
    after: NDArray[np.int32]  # likewise
    edge: NDArray[np.int64]  # (P,) which, of `EdgeLines`
    end: NDArray[np.signedinteger[Any]]  # (P,) 0 for its start, 1 for its stop, -1 for the edge itself

    def part(self, rows: NDArray[Any]) -> Chains:
        """Return some of them."""
        return Chains(*(getattr(self, f.name)[rows] for f in fields(Chains)))


@dataclass(frozen=True, slots=True, eq=False)
class EdgeEvents:
    """How sound goes over edges on P paths at T times of reception.

    Attributes
    ----------
    source, receiver : tuple of ndarray (P, T)
        r, θ and z about the edge of the images of emission and reception, from the point on it, as the edge sees
        them.
    """

    along: Floats  # (P, T) where on the edge it is diffracted, m from its start
    time: Floats  # (P, T) when, s
    first: Events  # of the way from the source to that point, and of the one from it to the receiver
    last: Events  # likewise
    source: tuple[Floats, Floats, Floats]
    receiver: tuple[Floats, Floats, Floats]
    doppler: Floats  # (P, T) frequency at the edge, as it sees it, over that emitted
    carried: Floats  # (P, T) what the wind makes of that where all rests in the room

    def part(self, rows: NDArray[np.int64]) -> Any:
        """Places and ends of some of the paths, all that a step takes."""
        ends: dict[str, Any] = {name: tuple(x[rows] for x in getattr(self, name)) for name in ("source", "receiver")}
        return replace(self, along=self.along[rows], **ends)

    def put(self, rows: NDArray[np.int64], other: Any) -> None:
        """Write others in place of some of the paths."""
        for mine, theirs in zip(_arrays(self), _arrays(other), strict=True):
            mine[rows] = theirs


def _arrays(value: Any) -> list[Floats]:
    """Return all arrays of events."""
    if isinstance(value, np.ndarray):
        return [value]
    parts = value if isinstance(value, tuple) else [getattr(value, f.name) for f in fields(value)]
    return [array for part in parts for array in _arrays(part)]


@dataclass(frozen=True, slots=True, eq=False)
class EdgeSolver:
    """What ways over edges are looked for among, between one source and one receiver."""

    mirrors: Mirrors  # of the scene
    lines: EdgeLines  # its edges
    ends: tuple[Motion, Motion]  # of the source and of the receiver
    medium: UniformAir  # what sound travels in; in wind all is seen from the air's own frame, where the law is the same
    retarded: bool = True  # whether all is where it was when the sound passed, or rests where it is at reception
    rounds: int = _ROUNDS  # of the search for events at mirrors, at the most

    steps: ClassVar[int] = 12  # of Newton's method along the edge

    def find(self, chains: Chains, times: Floats) -> Any:
        """Events at edges of sound that is received at times (T,) or (P, T), s.

        As the edge sees it, both images rest, and the shortest way over the line of the edge meets it where
        `path_over_edge` says; where the images lie changes with that place only as mirrors, source and edge move
        meanwhile, so that each step leaves some Mach number of what was left, and its square at the end. Where times
        are many and near to each other places are found at every fourth of them first, and quintic splines through
        these are where the others begin.
        """
        now = np.array(np.broadcast_to(times, (len(chains.edge), np.shape(times)[-1])))
        along = np.repeat(0.5 * self._lengths(chains), now.shape[1], axis=-1)
        few = few_of(np.asarray(times)) if self.retarded else None
        if few is not None:
            from scipy.interpolate import make_interp_spline

            coarse = self._found(chains, now[:, few], along[..., few]).along
            along = coarse @ make_interp_spline(times[few], np.eye(len(few)), k=5)(times).T
        return self._found(chains, now, along)

    def _found(self, chains: Any, now: Floats, along: Floats) -> Any:
        """Events from about where they are on the edges (P, ..., T), m, on."""
        length, held = self._lengths(chains), self.held(chains)
        along = np.where(np.isnan(held), along, held)
        found = self._at(chains, now, along)
        rows = np.flatnonzero(np.isnan(held).any(axis=tuple(range(1, held.ndim))))
        for _ in range(self.steps if len(rows) else 0):
            place = self._next(chains.part(rows), found.part(rows))
            place = np.clip(place, -_BEYOND * length[rows], (1.0 + _BEYOND) * length[rows])
            place = np.where(np.isnan(held[rows]), place, held[rows])
            left = np.abs(place - along[rows]).max(axis=tuple(range(1, along.ndim)), initial=0.0) > _FOUND
            rows = rows[left]
            if not len(rows):
                break
            along[rows] = place[left]
            found.put(rows, self._at(chains.part(rows), now[rows], along[rows]))
        return found

    def _lengths(self, chains: Any) -> Floats:
        """Lengths of the edges (P, ..., 1), m."""
        return self.lines.length[chains.edge, None]

    def held(self, chains: Any) -> Floats:
        """Places on the edges (P, ..., 1) of paths over ends, m; NaN on edges that paths meet anywhere."""
        ends = np.where(chains.end == 1, self.lines.length[chains.edge], 0.0)
        return np.where(chains.end < 0, np.nan, ends)[:, None]

    def _next(self, chains: Any, found: Any) -> Floats:
        """Places on the edges (P, ..., T) to go on from, m."""
        return np.asarray(found.along + path_over_edge(*found.source[::2], *found.receiver[::2]).apex)

    def _at(self, chains: Any, now: Floats, along: Floats) -> EdgeEvents:
        """Return events with the places on the edges (P, T) given, m."""
        point = EdgePoint(self.lines, chains.edge, along)
        last = self.leg(chains.after, (point, self.ends[1]), now)
        time = self.begun(last, now)
        first = self.leg(chains.before, (self.ends[0], point), time)
        source, doppler, carried = self.source_seen(point, time, first)
        return EdgeEvents(along, time, first, last, source, self.receiver_seen(point, time, last), doppler, carried)

    def leg(self, surfaces: NDArray[np.signedinteger[Any]], ends: tuple[Any, Any], times: Floats) -> Events:
        """Events of ways by mirrors (P, N) between two ends that are received at times (P, T), s."""
        return find_events(self.mirrors, surfaces, ends, self.medium, times, self.retarded, self.rounds)

    def begun(self, leg: Events, times: Floats) -> Floats:
        """When sound begins legs at whose ends it is at times (P, T), s."""
        return times - leg.delay if self.retarded else times

    def source_seen(self, point: EdgePoint, time: Floats, first: Events) -> tuple[Triple, Floats, Floats]:
        """Place r, θ and z of the emission's image about points on edges, and frequencies there, see `EdgeEvents`."""
        coming, wind = -first.arrival, self._wind
        source = self.seen(point, time, coming, first.distance, -1.0)
        doppler = np.hypot(source[0], source[2]) / (first.distance * first.stretch)
        axes, c = self.lines.axes(point.edge, time), self.medium.speed_of_sound
        still = _from_moving(np.broadcast_to(-wind / c, coming.shape), axes, coming, np.ones(time.shape), -1.0)
        return source, doppler, np.linalg.norm(still, axis=0) / first.carried

    def receiver_seen(self, point: EdgePoint, time: Floats, last: Events) -> Triple:
        """Place r, θ and z of the reception's image about points on edges.

        The image by moving mirrors is as far as the invariant ``d (1 - n V / c)`` says, which mirrors do not change.
        """
        moved = self._moved(point, time)
        ahead = last.distance * last.stretch / (1.0 - dot(last.departure, moved) / self.medium.speed_of_sound)
        return self.seen(point, time, last.departure, ahead, 1.0)

    @property
    def _wind(self) -> Floats:
        return np.array(self.medium.wind or (0.0, 0.0, 0.0))

    def _moved(self, point: EdgePoint, time: Floats) -> Floats:
        """Velocities (P, T, 3) of points on edges in the air's frame, m/s."""
        velocity = point.velocity(time)
        return np.asarray((velocity if self.retarded else 0.0 * velocity) - self._wind)

    def seen(self, point: EdgePoint, time: Floats, direction: Floats, distance: Floats, sign: float) -> Triple:
        """Place r, θ and z of images in the air about points on edges.

        With n and d the direction and the distance of an image in the air, what is at ``(t, x) = (d / c, d n)`` from
        the edge, or at ``-(d / c, d n)``, is at ``x + g² / (g + 1) (x b) b - g c t b`` there, with ``b = V / c`` for
        the velocity V across the edge and ``g = 1 / sqrt(1 - b²)``.
        """
        axes, velocity = self.lines.axes(point.edge, time), self._moved(point, time) / self.medium.speed_of_sound
        place = _from_moving(velocity, axes, direction, distance, sign)
        return cylindrical(self.lines.n[point.edge], place, np.zeros(len(point.edge), dtype=np.int8))


def _from_moving(
    velocity: Floats, axes: tuple[Floats, Floats, Floats], direction: Floats, distance: Floats, sign: float
) -> Floats:
    """Return coordinates (3, P, T) that edges see of what is ``sign * distance`` off in directions (P, T, 3).

    It is as much later, over the speed of sound, and the velocity (P, T, 3) is over that too.
    """
    across, out, along = axes
    slip = velocity - dot(velocity, along)[..., None] * along
    gamma = 1.0 / np.sqrt(1.0 - dot(slip, slip))
    moved = gamma**2 / (gamma + 1.0) * dot(direction, slip) - gamma
    seen = sign * distance[..., None] * (direction + moved[..., None] * slip)
    return np.stack([dot(seen, axis) for axis in (across, out, along)])
