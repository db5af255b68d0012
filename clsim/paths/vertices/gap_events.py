"""Sound over two edges with open air between, of bodies that move or of the room: where and when, exactly."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.acoustics.diffraction import ON_LINE, path_over_edge
from clsim.acoustics.edge_gap import EdgeGap
from clsim.arrays import Floats
from clsim.paths.legs.events import Events
from clsim.paths.legs.mirrors import dot
from clsim.paths.vertices.edge_pair_events import EdgePairEvents, EdgePairs, EdgePairSolver

Axes = tuple[Floats, Floats, Floats]


@dataclass(frozen=True, slots=True, eq=False)
class GapPairs(EdgePairs):
    """What P paths meet: mirrors, an edge, mirrors, another edge, and mirrors, all from the source's side."""

    between: NDArray[np.int32]  # (P, B) mirrors between both edges, filled up with -1

    def part(self, rows: NDArray[np.int64]) -> GapPairs:
        """Return some of them."""
        return GapPairs(*(getattr(self, f.name)[rows] for f in fields(GapPairs)))


@dataclass(frozen=True, slots=True, eq=False)
class GapEvents(EdgePairEvents):
    """How sound goes over two edges with air between.

    Attributes
    ----------
    between : Events
        Leg from the first edge to the second, received when it leaves that, at `leaving`.
    middle : ndarray (P, T, 6)
        Angles of that way about both edges, rad, its length, m, the cosine between the directions of the angles, and
        those between either edge and the way from it to the other one.
    gap : ndarray (P, T, 2, 4, 3)
        Frames of both edges as the first one sees them, see `EdgeGap`.
    """

    between: Events
    leaving: Floats
    middle: Floats
    gap: Floats

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
        frames = [
            np.stack([place, *turn], axis=2) for place, turn in zip((np.zeros_like(start), start), axes, strict=True)
        ]
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
