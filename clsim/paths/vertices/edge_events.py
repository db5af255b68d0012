"""Sound over edges that move, among mirrors that move: where on the edges and when it is diffracted, exactly.

The way to the edge and the way from it are two of `find_events`, with a point of the edge for an end. Where the point
lies along the edge is found by Newton's method: the sum of both is stationary there (Fermat). Images of emission and
reception by the mirrors, and the event of diffraction, are seen from the edge's own frame, into which a Lorentz
transformation with the speed of sound leads: there the edge rests, and all is as at an edge at rest.

Over two edges of one face sound runs along the face from the first edge to the second. As the object sees it, that way
is straight once the faces are rolled out into one plane: this tells both places nearly, and exactly where the object
does not turn on the way. From there Newton's method leads to where the time of the whole way is stationary. Over two
edges with air between, and over an edge and an end of another, the least of a convex length takes the plane's place.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from clsim.acoustics.diffraction import ON_LINE, path_over_edge
from clsim.acoustics.edge_gap import EdgeGap
from clsim.arrays import ByRow, Floats
from clsim.paths.legs.events import Events, few_of, find_events
from clsim.paths.legs.mirrors import EdgeLines, EdgePoint, Mirrors, dot
from clsim.paths.propagation import UniformAir
from clsim.paths.vertices.edge_field import RolledOut, cylindrical
from clsim.scene.motion.motion import Motion

Triple = tuple[Floats, Floats, Floats]

_ROUNDS = 20  # of `find_events`
_FOUND = 1e-8  # m along the edge: what that leaves of the way is its square over the distances
_BEYOND = 1.0  # lengths of the edge, by which places of paths that are not there may lie off it


@dataclass(frozen=True, slots=True, eq=False)
class Chains(ByRow):
    """What P paths meet: mirrors, an edge or one of its ends, and mirrors, all from the source's side."""

    before: NDArray[np.int32]  # (P, N) mirrors before the edge and after it, filled up with -1
    after: NDArray[np.int32]  # likewise
    edge: NDArray[np.int64]  # (P,) which, of `EdgeLines`
    end: NDArray[np.signedinteger[Any]]  # (P,) 0 for its start, 1 for its stop, -1 for the edge itself


@dataclass(frozen=True, slots=True, eq=False)
class EdgeEvents:
    """How sound goes over edges on P paths at T times of reception."""

    along: Floats  # (P, T) where on the edge it is diffracted, m from its start
    time: Floats  # (P, T) when, s
    first: Events  # of the way from the source to that point, and of the one from it to the receiver
    last: Events  # likewise
    # (P, T) r, θ and z about the edge of the images of emission and reception, from the point on it, as the
    # edge sees them.
    source: tuple[Floats, Floats, Floats]
    receiver: tuple[Floats, Floats, Floats]  # likewise
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
    """Return coordinates (3, P, T) that edges see of what is ``sign * distance`` off in directions (P, T, 3)."""
    across, out, along = axes
    slip = velocity - dot(velocity, along)[..., None] * along
    gamma = 1.0 / np.sqrt(1.0 - dot(slip, slip))
    moved = gamma**2 / (gamma + 1.0) * dot(direction, slip) - gamma
    seen = sign * distance[..., None] * (direction + moved[..., None] * slip)
    return np.stack([dot(seen, axis) for axis in (across, out, along)])


_NEAR = 0.05  # of ends' distances from edges, and of both places': steps that are shorter are left to Newton's method


@dataclass(frozen=True, slots=True, eq=False)
class EdgePairs(Chains):
    """What P paths meet: mirrors, two edges that share a face, and mirrors, all from the source's side."""

    last: NDArray[np.int64]  # (P,) the second edge
    face: NDArray[np.int64]  # (P, 2) which face of each both share, 0 for its 0-face, 1 for its n-face


@dataclass(frozen=True, slots=True, eq=False)
class EdgePairEvents(EdgeEvents):
    """How sound goes over two edges; `source` is about the first, `receiver` about the second, from their starts."""

    slope: Floats  # (P, 2, T) by how much the way grows with the places `along` (P, 2, T), m from the edges' starts
    bend: Floats  # (P, 2, 2, T) and twice, 1/m; `last` is from the second edge, with what the first leg makes of it

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


Axes = tuple[Floats, Floats, Floats]


@dataclass(frozen=True, slots=True, eq=False)
class GapPairs(EdgePairs):
    """What P paths meet: mirrors, an edge, mirrors, another edge, and mirrors, all from the source's side."""

    between: NDArray[np.int32]  # (P, B) mirrors between both edges, filled up with -1


@dataclass(frozen=True, slots=True, eq=False)
class GapEvents(EdgePairEvents):
    """How sound goes over two edges with air between."""

    between: Events  # leg from the first edge to the second, received when it leaves that, at `leaving`
    leaving: Floats
    # (P, T, 6) angles of that way about both edges, rad, its length, m, the cosine between the directions of
    # the angles, and those between either edge and the way from it to the other one.
    middle: Floats
    gap: Floats  # (P, T, 2, 4, 3) frames of both edges as the first one sees them, see `EdgeGap`

    def part(self, rows: NDArray[np.int64]) -> GapEvents:
        """Places, ends, slopes and frames of some of the paths."""
        names = [f.name for f in fields(GapEvents) if f.name not in ("between", "first", "last")]
        some: dict[str, Any] = {name: _rows(getattr(self, name), rows) for name in names}
        return GapEvents(**some, first=self.first, last=self.last, between=self.between)


def _rows(value: Any, rows: NDArray[np.int64]) -> Any:
    return tuple(x[rows] for x in value) if isinstance(value, tuple) else value[rows]


class GapPairSolver(EdgePairSolver):
    """What ways over two edges with air between are looked for among, between one source and one receiver."""

    __slots__ = ()

    def walls_between(self, pairs: Any) -> NDArray[np.int32]:
        """Mirrors (P, B) between both edges."""
        walls: NDArray[np.int32] = pairs.between
        return walls

    def _solved(self, pairs: Any, found: Any) -> Floats:
        (r_s, _, z_s), (r_r, _, z_r) = found.source, found.receiver
        n = self.lines.n[pairs.edge][:, None], self.lines.n[pairs.last][:, None]
        gap = EdgeGap(found.gap[:, :, 0], found.gap[:, :, 1], n)
        return np.stack(gap.cross((r_s, z_s), (r_r, z_r)).places, axis=1)

    def _apart(self, pairs: Any, found: Any) -> Floats:
        return np.asarray(found.middle[..., 2])

    def _between_axes(self, pairs: Any, time: Floats, leaving: Floats, between: Events) -> Floats:
        one, other = self._seen_axes(pairs, time, leaving, between)
        return dot(one[2], other[2])

    def _seen_axes(self, pairs: Any, time: Floats, leaving: Floats, between: Events) -> tuple[Axes, Axes]:
        """`across`, `out` and `along` (P, T, 3) of both edges as the first one sees them by the mirrors between."""
        other = list(self.lines.axes(pairs.last, leaving))
        for k in range(pairs.between.shape[1] - 1, -1, -1):
            normal = self.mirrors.planes(pairs.between[:, k], leaving, between.time[..., k + 1], None).normal
            other = [axis - 2.0 * dot(axis, normal)[..., None] * normal for axis in other]
        return self.lines.axes(pairs.edge, time), (other[0], other[1], other[2])

    def _with_between(self, pairs: Any, found: EdgePairEvents, between: tuple[Any, ...]) -> GapEvents:
        leaving, length, onto, came = between
        axes = self._seen_axes(pairs, found.time, leaving, length)
        turned = [
            np.cos(angle)[..., None] * out - np.sin(angle)[..., None] * across
            for angle, (across, out, _) in zip((onto[1], came[1]), axes, strict=True)
        ]
        distance = np.hypot(onto[0], onto[2])
        slopes = [z / np.maximum(np.hypot(r, z), ON_LINE) for r, _, z in (onto, came)]
        middle = np.stack([onto[1], came[1], distance, dot(*turned), *slopes], axis=-1)
        first, last = found.along[:, 0, :, None] * axes[0][2], found.along[:, 1, :, None] * axes[1][2]
        start = first - last + length.departure * length.distance[..., None]  # of the last edge from that of the first
        starts = np.zeros_like(start), start
        frames = [np.stack([place, *turn], axis=2) for place, turn in zip(starts, axes, strict=True)]
        own = {f.name: getattr(found, f.name) for f in fields(EdgePairEvents)}
        return GapEvents(**own, between=length, leaving=leaving, middle=middle, gap=np.stack(frames, axis=2))


OF_LAST = 2  # added to the numbers of the ends of last edges
MEETING = 4  # number of the first end, and twice that of the second one, of edges that end at one corner
TWO_ENDS = 8  # as of an end of one edge, and four times the end of the other, of two edges that both end


def at_meeting(end: Any) -> Any:
    """Mask (n,) of numbers of corners at which both edges end."""
    return (end >= MEETING) & (end < TWO_ENDS)


def end_numbers(end: Any) -> tuple[Any, Any]:
    """Numbers (n,) of the ends of the first and of the last edges, 0 or 1, and -1 of those that do not end."""
    other, meeting, of_last = np.where(end >= TWO_ENDS, end // 4 - 2, -1), at_meeting(end), end % 4 >= 2
    last = np.where(meeting, end // 2 % 2, end % 2)
    return np.where(of_last & ~meeting, other, end % 2), np.where(of_last | meeting, last, other)


def held_places(number: NDArray[Any], lengths: Floats) -> Floats:
    """Places (P, 2) on both edges, of lengths (P, 2), of paths over ends, see `EdgeEndVertex`, m; NaN where any."""
    ends = np.stack(end_numbers(number), axis=1)
    return np.where(ends < 0, np.nan, np.where(ends == 1, lengths, 0.0))


class EdgeEndSolver(GapPairSolver):
    """What ways over an edge and an end of another one are looked for among, with air or a face between."""

    __slots__ = ()

    def held(self, pairs: Any) -> Floats:
        """Places on the edges (P, 2, 1) of paths over ends, m; NaN on edges that paths meet anywhere."""
        return held_places(pairs.end, self._lengths(pairs)[..., 0])[..., None]

    def _next(self, pairs: Any, found: Any) -> Floats:
        """Places (P, 2, T) where the shortest ways between endpoints and ends meet the other edges, m."""
        places = np.array(found.along)
        for i, ((r, _, z), slope) in enumerate(
            zip((found.source, found.receiver), np.moveaxis(found.middle[..., 4:], 2, 0), strict=True)
        ):
            distance = found.middle[..., 2]
            across = np.maximum(np.sqrt(np.maximum(1.0 - slope**2, 0.0)) * distance, ON_LINE)
            places[:, i] = path_over_edge(r, z, across, found.along[:, i] + slope * distance).apex
        return places
