"""Sound over two edges of one face of a body that moves, among mirrors that move: where and when, exactly.

From the first edge to the second sound runs along the face that both share. As the object sees it, that way is straight
once the faces are rolled out into one plane: this tells both places nearly, and exactly where the object does not turn
on the way. From there Newton's method leads to where the time of the whole way is stationary.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.acoustics.diffraction import ON_LINE, path_over_edge
from clsim.arrays import Floats
from clsim.paths.legs.events import Events
from clsim.paths.legs.mirrors import EdgePoint, dot
from clsim.paths.vertices.edge_events import Chains, EdgeEvents, EdgeSolver, Triple
from clsim.paths.vertices.edge_field import RolledOut

_NEAR = 0.05  # of ends' distances from edges, and of both places': steps that are shorter are left to Newton's method


@dataclass(frozen=True, slots=True, eq=False)
class EdgePairs(Chains):
    """What P paths meet: mirrors, two edges that share a face, and mirrors, all from the source's side."""

    last: NDArray[np.int64]  # (P,) the second edge
    face: NDArray[np.int64]  # (P, 2) which face of each both share, 0 for its 0-face, 1 for its n-face

    def part(self, rows: NDArray[np.int64]) -> EdgePairs:
        """Return some of them."""
        return EdgePairs(*(getattr(self, f.name)[rows] for f in fields(EdgePairs)))


@dataclass(frozen=True, slots=True, eq=False)
class EdgePairEvents(EdgeEvents):
    """How sound goes over two edges; `source` is about the first, `receiver` about the second, from their starts.

    Attributes
    ----------
    along : ndarray (P, 2, T)
        Points of diffraction on the edges, m from their starts.
    time : ndarray (P, T)
        When at the first edge, s.
    last : Events
        Leg from the second edge; delay, its rate and distance include the leg from the first one.
    slope : ndarray (P, 2, T)
        By how much the way grows with each of the places.
    bend : ndarray (P, 2, 2, T)
        And twice, 1/m.
    """

    slope: Floats
    bend: Floats

    def part(self, rows: NDArray[np.int64]) -> EdgePairEvents:
        """Places, ends and slopes of some of the paths."""
        some: EdgePairEvents = EdgeEvents.part(self, rows)
        return replace(some, slope=self.slope[rows], bend=self.bend[rows])


class EdgePairSolver(EdgeSolver):
    """What ways over two edges are looked for among, between one source and one receiver."""

    __slots__ = ()
    steps = 24

    def ahead(self, pairs: EdgePairs, found: EdgePairEvents) -> tuple[tuple[Floats, Floats], tuple[Floats, Floats]]:
        """Places r and z (P, T) of each end as the other end's edge sees it beyond its own, rolled out, m."""
        edges = pairs.edge, pairs.last
        frames, n = tuple(self.lines.frames[e] for e in edges), tuple(self.lines.n[e] for e in edges)
        one, other = RolledOut.between((frames[0], frames[1]), (n[0], n[1]), pairs.face)
        return one(*found.receiver[::2]), other(*found.source[::2])

    def _lengths(self, pairs: EdgePairs) -> Floats:
        """Lengths of both edges (P, 2, 1), m."""
        return self.lines.length[np.stack([pairs.edge, pairs.last], axis=1)][..., None]

    def held(self, pairs: EdgePairs) -> Floats:
        """Places on the edges (P, 2, 1) of paths over ends, m; NaN on edges that paths meet anywhere."""
        return np.full((len(pairs.edge), 2, 1), np.nan)

    def _next(self, pairs: EdgePairs, found: EdgePairEvents) -> Floats:
        """Places (P, 2, T) from which to go on: as if all rested where that is far, else by Newton's method, m."""
        near = _NEAR * np.min([found.source[0], found.receiver[0], self._apart(pairs, found)], axis=0)
        place = self._solved(pairs, found)
        (a, both), (_, b) = np.moveaxis(found.bend, (1, 2), (0, 1))
        first, last = np.moveaxis(found.slope, 1, 0)
        step = np.stack([b * first - both * last, a * last - both * first], axis=1) / (a * b - both**2)[:, None]
        close = np.all(np.abs(np.stack([place - found.along, step])) < near[:, None], axis=(0, 2))
        return np.where(close[:, None], found.along - step, place)

    def _apart(self, pairs: EdgePairs, found: EdgePairEvents) -> Floats:
        """Distances (P, T) between both places, m: near a common corner of both edges Newton's method leads astray."""
        frames, along = self.lines.frames[np.stack([pairs.edge, pairs.last])], np.moveaxis(found.along, 1, 0)
        one, other = frames[:, :, None, 0] + along[..., None] * frames[:, :, None, 3]
        return np.asarray(np.linalg.norm(other - one, axis=-1))

    def _solved(self, pairs: EdgePairs, found: EdgePairEvents) -> Floats:
        """Places (P, 2, T) on both edges if all rested where it is seen: rolled out, m."""
        ends = (found.source[::2], found.receiver[::2]), self.ahead(pairs, found)
        apexes = [path_over_edge(*end, np.maximum(r, ON_LINE), z).apex for end, (r, z) in zip(*ends, strict=True)]
        return np.stack(apexes, axis=1)

    def _at(self, pairs: EdgePairs, now: Floats, along: Floats) -> EdgePairEvents:
        points = [EdgePoint(self.lines, edge, along[:, i]) for i, edge in enumerate((pairs.edge, pairs.last))]
        last = self.leg(pairs.after, (points[1], self.ends[1]), now)
        leaving = self.begun(last, now)
        between = self.leg(self.walls_between(pairs), (points[0], points[1]), leaving)
        time = self.begun(between, leaving)
        first = self.leg(pairs.before, (self.ends[0], points[0]), time)
        source, doppler, carried = self.source_seen(points[0], time, first)
        received, onto = self.receiver_seen(points[1], leaving, last), self.receiver_seen(points[0], time, between)
        came = self.seen(points[1], leaving, -between.arrival, between.distance, -1.0)
        (r_s, t_s, z_s), (r_r, t_r, z_r) = source, received
        seen = (r_s, t_s, z_s + along[:, 0]), (r_r, t_r, z_r + along[:, 1])
        courses = [_course(source), _course(onto), _course(came), _course(received)]
        slopes, cosine = [c.slope for c in courses], self._between_axes(pairs, time, leaving, between)
        mixed = -(cosine + slopes[1] * slopes[2]) / np.maximum(between.distance, ON_LINE)
        bend = [[courses[0].bend + courses[1].bend, mixed], [mixed, courses[2].bend + courses[3].bend]]
        slope = np.stack([slopes[0] + slopes[1], slopes[2] + slopes[3]], axis=1)
        bends = np.moveaxis(np.array(bend), 2, 0)
        found = EdgePairEvents(along, time, first, self._joined(between, last), *seen, doppler, carried, slope, bends)
        return self._with_between(pairs, found, (leaving, between, onto, came))

    def walls_between(self, pairs: EdgePairs) -> NDArray[np.int32]:
        """Mirrors (P, B) between both edges."""
        return pairs.after[:, :0]

    def _between_axes(self, pairs: EdgePairs, time: Floats, leaving: Floats, between: Events) -> Floats:
        """Cosines (P, T) between both edges as the first one sees the second."""
        one, other = (self.lines.frames[edge, 3] for edge in (pairs.edge, pairs.last))
        return dot(one, other)[:, None]

    def _with_between(self, pairs: EdgePairs, found: EdgePairEvents, between: tuple[Any, ...]) -> EdgePairEvents:
        """Events with what must be known of the way between: nothing."""
        return found

    def _joined(self, between: Events, last: Events) -> Events:
        """Events of the last leg that begin at the first edge."""
        rate = between.rate + last.rate
        if self.retarded:
            rate = rate - between.rate * last.rate
        return replace(last, delay=between.delay + last.delay, rate=rate, distance=between.distance + last.distance)


@dataclass(frozen=True, slots=True)
class _Course:
    """Growth of the distance of an end with the place on an edge, and twice, 1/m."""

    slope: Floats
    bend: Floats


def _course(end: Triple) -> _Course:
    """Tell it of ends at r, θ and z about points on edges."""
    r, _, z = end
    distance = np.maximum(np.hypot(r, z), ON_LINE)
    return _Course(-z / distance, r**2 / distance**3)
