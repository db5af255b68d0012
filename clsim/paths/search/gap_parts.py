"""Ways of sound between parts of edges, and from ends of paths to parts of edges.

Edges are cut into parts and time into cells. A way over a part of each of two edges is ruled out for a cell

- where an end is inside the wedge of an edge,
- where the way misses a wall that reflects it,
- where a wall hides all of it,
- where the angles with an edge before and behind it cannot be the same.

All tests are of convex hulls, so that no way is missed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Floats, spread
from clsim.paths.visibility.clearance import mirrored
from clsim.paths.visibility.edge_gaps import seen_frames
from clsim.paths.visibility.edge_intervals import EdgeSearch
from clsim.paths.visibility.occlusion import CLEARLY, crossed_pieces
from clsim.scene.room.edges import Edges
from clsim.scene.room.walls import Walls

Bools = NDArray[np.bool_]
Ints = NDArray[np.integer[Any]]

PARTS = 8  # of an edge
_TOGETHER = 20_000  # ways looked at at a time
_OFF = 2e-7  # m, by which ends may be perturbed
_COPLANAR = 0.1  # of what is clear, from which on another edge is off a face
_CUBE = np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3, indexing="ij"), axis=-1).reshape(8, 3)


@dataclass(frozen=True, slots=True, eq=False)
class Fans:
    """Which parts of edges may be met on ways (..., parts), and the cotangents of their angles with the edges there."""

    free: Bools
    low: Floats
    high: Floats

    @staticmethod
    def hull(every: list[Fans]) -> Fans:
        """Fan (parts,) that holds several (..., parts)."""
        free, low, high = (np.concatenate([getattr(fan, name).reshape(-1, PARTS) for fan in every]) for name in _NAMES)
        lowest, highest = np.where(free, low, np.inf).min(axis=0, initial=np.inf), np.where(free, high, -np.inf)
        return Fans(np.any(free, axis=0), lowest, highest.max(axis=0, initial=-np.inf))

    @staticmethod
    def stacked(every: list[Fans]) -> Fans:
        """Return several as one, along a new first axis."""
        return Fans(*(np.stack([getattr(fan, name) for fan in every]) for name in _NAMES))

    def part(self, rows: Any) -> Fans:
        """Return some of them."""
        return Fans(self.free[rows], self.low[rows], self.high[rows])

    def turned(self) -> Fans:
        """Return the ways the other way round."""
        return Fans(self.free, -self.high, -self.low)

    def meet(self, ends: Fans, edge: int) -> Floats:
        """Mask (..., parts, parts) of ways between edges that go on as ways (..., parts) of ends, as numbers.

        edge: 0 for the first one of both, 1 for the last one.
        """
        free, low, high = (np.expand_dims(getattr(ends, name), -2 if edge else -1) for name in _NAMES)
        return np.asarray(self.free & free & (low <= self.high) & (high >= self.low), dtype=np.float32)


_NAMES = "free", "low", "high"


def fans_of_ends(
    finder: EdgeSearch, edge: int, sequence: NDArray[np.int32], centre: Floats, radius: Floats
) -> Fans:  # fmt: skip
    """Ways by sequences of walls (n, N) from balls (C, 3) and (C,), m, to an edge (C, n, parts), also hidden ones."""
    walls, edges, frame = finder.query.walls, finder.edges, finder.edges.frames[edge]
    shape, near = (len(radius), len(sequence), PARTS), CLEARLY * finder.query.walls.size
    ball, row = (x.ravel() for x in np.indices(shape[:2]))
    image, size = centre[ball], radius[ball] + _OFF
    for wall in sequence[row].T:
        image = mirrored(walls, wall, image)
    x, y, z = ((image - frame[0]) @ frame[axis] for axis in (1, 2, 3))
    free = np.repeat(in_air(edges.n[edge], x, y, -near - size)[:, None], PARTS, axis=1)
    places, r = np.linspace(0.0, edges.length[edge], PARTS + 1), np.hypot(x, y)
    heights = places[:-1] - (z + size)[:, None], places[1:] - (z - size)[:, None]
    low, high = cotangents(*heights, np.maximum(r - size, near)[:, None], (r + size)[:, None])
    return Fans(free.reshape(shape), low.reshape(shape), high.reshape(shape))


def unhidden(
    finder: EdgeSearch, edge: int, sequence: NDArray[np.int32], centre: Floats, radius: Floats, fans: Fans
) -> Fans:  # fmt: skip
    """Return the ways of `fans_of_ends` without those that walls hide, or that miss walls they are reflected by."""
    frame, free = finder.edges.frames[[edge]], fans.free.copy()
    ball, row, part = np.nonzero(fans.free)
    corners = centre[ball, None] + (radius[ball] + _OFF)[:, None, None] * _CUBE
    ends = _places(frame, finder.edges.length[[edge]])[0, np.stack([part, part + 1], axis=1)]
    free[ball, row, part] = legs_open(finder.query.walls, sequence[row], corners, ends)
    return Fans(free, fans.low, fans.high)


@dataclass(frozen=True, slots=True, eq=False)
class Gaps:
    """Pairs of edges (n, 2) and walls (n, B) between them, with the ways from parts of the first to parts of the last.

    Of both fans (n, parts, parts) the first has the angles at the first edges, the other those at the last ones.
    """

    pair: NDArray[np.int64]
    walls: NDArray[np.int32]
    fans: tuple[Fans, Fans]


def open_gaps(
    walls: Walls,
    edges: Edges,
    pair: NDArray[np.int64],
    between: NDArray[np.int32],
    ends: tuple[Fans, Fans] | None = None,
) -> Gaps:
    """Find the pairs of edges (n, 2) some parts of which may see each other by walls (n, B), and ends by fans."""
    frames = edges.frames[pair[:, 0]], seen_frames(walls, edges, pair[:, 1], between)
    length, real = edges.length[pair], edges.frames[pair[:, 1]]
    seen = [_places(frame, length[:, i]) for i, frame in enumerate(frames)]
    here, there = (
        _seen(frames[i], edges.n[pair[:, i]], seen[1 - i], length[:, i], CLEARLY * walls.size) for i in (0, 1)
    )
    there = Fans(there.free.swapaxes(1, 2), there.low.swapaxes(1, 2), there.high.swapaxes(1, 2)).turned()
    free = here.free & there.free
    here, there = Fans(free, here.low, here.high), Fans(free, there.low, there.high)
    if ends is not None:
        free = (here.meet(ends[0].part(pair[:, 0]), 0) * there.meet(ends[1].part(pair[:, 1]), 1)).astype(bool)
    g, i, j = np.nonzero(free)
    parts = [
        places[g[:, None], np.stack([part, part + 1], axis=1)]
        for places, part in ((seen[0], i), (_places(real, length[:, 1]), j))
    ]
    free[g, i, j] = legs_open(walls, between[g], *parts)
    kept = np.flatnonzero(free.any(axis=(1, 2)))
    fans = (Fans(free[kept], fan.low[kept], fan.high[kept]) for fan in (here, there))
    return Gaps(pair[kept], between[kept], (next(fans), next(fans)))


def _places(frame: Floats, length: Floats) -> Floats:
    """Places (n, parts + 1, 3) between the parts of edges of frames (n, 4, 3) and lengths (n,), m."""
    share = np.linspace(0.0, 1.0, PARTS + 1)
    return np.asarray(frame[:, None, 0] + (share * length[:, None])[..., None] * frame[:, None, 3])


def _seen(frame: Floats, n: Floats, other: Floats, length: Floats, near: float) -> Fans:
    """Ways (n, parts, parts) from parts of edges of frames (n, 4, 3) to those between places (n, parts + 1, 3)."""
    x, y, z = (np.einsum("npi,ni->np", other - frame[:, None, 0], frame[:, axis]) for axis in (1, 2, 3))
    beside = np.sin(np.pi * n)[:, None] * x - np.cos(np.pi * n)[:, None] * y
    above, beside = (np.maximum(h[:, :-1], h[:, 1:]) > _COPLANAR * near for h in (y, beside))
    air = np.where(n[:, None] < 1.0, above & beside, above | beside)
    places, r = np.linspace(0.0, 1.0, PARTS + 1) * length[:, None], np.hypot(x, y)
    low = np.minimum(z[:, :-1], z[:, 1:])[:, None, :] - places[:, 1:, None]
    high = np.maximum(z[:, :-1], z[:, 1:])[:, None, :] - places[:, :-1, None]
    flat = np.stack([x, y], axis=2)
    least, most = (
        np.maximum(segment_off(np.stack([flat[:, :-1], flat[:, 1:]], axis=2)), near),
        np.maximum(np.maximum(r[:, :-1], r[:, 1:]), near),
    )
    return Fans(np.repeat(air[:, None], PARTS, axis=1), *cotangents(low, high, least[:, None], most[:, None]))


def in_air(n: Floats | float, x: Floats, y: Floats, least: Floats | float) -> Bools:
    """Mask (...) of places at x and y about edges that are in the air of their wedges, by at least so much, m."""
    above, beside = y > least, np.sin(np.pi * n) * x - np.cos(np.pi * n) * y > least
    return np.asarray(np.where(np.asarray(n) < 1.0, above & beside, above | beside))


def cotangents(low: Floats, high: Floats, least: Floats, most: Floats) -> tuple[Floats, Floats]:
    """Least and largest ratios of heights from low to high over distances from least to most."""
    return low / np.where(low < 0.0, least, most), high / np.where(high > 0.0, least, most)


def segment_off(ends: Floats) -> Floats:
    """Distances (...) of segments between places (..., k, 2) from the origin; of one place, its own."""
    a, along = ends[..., 0, :], ends[..., -1, :] - ends[..., 0, :]
    share = np.clip(-np.sum(a * along, axis=-1) / np.maximum(np.sum(along**2, axis=-1), 1e-300), 0.0, 1.0)
    return np.asarray(np.linalg.norm(a + share[..., None] * along, axis=-1))


def legs_open(walls: Walls, sequence: NDArray[np.int32], first: Floats, last: Floats) -> Bools:
    """Mask of sequences of walls (n, N) by which something of hulls (n, a, 3) may see something of others (n, b, 3)."""
    parts = (slice(i, i + _TOGETHER) for i in range(0, len(sequence), _TOGETHER))
    found = [_legs_open(walls, sequence[part], first[part], last[part]) for part in parts]
    return np.concatenate([np.empty(0, dtype=bool), *found])


def _legs_open(walls: Walls, sequence: NDArray[np.int32], first: Floats, last: Floats) -> Bools:
    starts, stops = [first], [last]
    for wall in sequence.T:
        starts.append(_mirrored(walls, wall, starts[-1]))
    for wall in sequence.T[::-1]:
        stops.insert(0, _mirrored(walls, wall, stops[0]))
    free = np.ones(len(sequence), dtype=bool)
    for k, wall in enumerate(sequence.T):
        rows = np.flatnonzero(free)
        free[rows] = _may_meet(walls, wall[rows], starts[k + 1][rows], stops[k + 1][rows])
    for leg in range(sequence.shape[1] + 1):
        rows = np.flatnonzero(free)
        ends = sequence[rows, leg - 1] if leg else None, sequence[rows, leg] if leg < sequence.shape[1] else None
        free[rows] = ~_hidden(walls, ends, starts[leg][rows], stops[leg][rows])
    return free


def _mirrored(walls: Walls, wall: Ints, points: Floats) -> Floats:
    return np.asarray(points - 2.0 * _heights(walls, wall, points)[..., None] * walls.normal[wall][:, None])


def _heights(walls: Walls, wall: Ints, points: Floats) -> Floats:
    """Heights (n, a) of points (n, a, 3) over walls (n,), m."""
    return np.asarray(np.einsum("nai,ni->na", points, walls.normal[wall]) - walls.offset[wall][:, None])


def _crossings(before: Floats, behind: Floats, start: Floats, stop: Floats) -> Floats:
    """Places (n, a b, 3) at height 0 on lines between points (n, a, 3) and (n, b, 3) at given heights."""
    share = before[:, :, None] / (before[:, :, None] - behind[:, None, :])
    points = start[:, :, None] + share[..., None] * (stop[:, None] - start[:, :, None])
    return points.reshape(len(points), start.shape[1] * stop.shape[1], 3)


def _may_meet(walls: Walls, wall: Ints, start: Floats, stop: Floats) -> Bools:
    """Mask of lines from image hulls (n, a, 3) to others (n, b, 3) of which some may cross walls (n,)."""
    near = CLEARLY * walls.size
    before, behind = _heights(walls, wall, start), _heights(walls, wall, stop)
    both = np.concatenate([before, behind], axis=1)
    meets = (both.min(axis=1) <= near) & (both.max(axis=1) >= -near)
    apart = np.maximum(
        np.minimum(-before.max(axis=1), behind.min(axis=1)), np.minimum(before.min(axis=1), -behind.max(axis=1))
    )
    whole = walls.first_piece[wall + 1] - walls.first_piece[wall] == 1
    rows = np.flatnonzero(meets & (apart > near) & whole)
    points = _crossings(before[rows], behind[rows], start[rows], stop[rows])
    of, line = spread(walls.first_line, walls.first_piece[wall[rows]])
    off = np.einsum("nai,ni->na", points[of], walls.line[line, :3]) - walls.line[line, 3, None]
    meets[rows[of[off.max(axis=1) < -near]]] = False
    return np.asarray(meets)


def _hidden(walls: Walls, mirrors: tuple[Any, Any], start: Floats, stop: Floats) -> Bools:
    """Mask of lines from hulls (n, a, 3) to others (n, b, 3) all of which a wall hides between two mirrors (n,)."""
    near, hidden = CLEARLY * walls.size, np.zeros(len(start), dtype=bool)
    row, wall, piece = crossed_pieces(walls, start.mean(axis=1), stop.mean(axis=1))
    kept = walls.plane[wall] >= 0
    for mirror in mirrors:
        if mirror is not None:
            kept &= walls.plane[wall] != walls.plane[mirror[row]]
    row, wall, piece = row[kept], wall[kept], piece[kept]
    before, behind = _heights(walls, wall, start[row]), _heights(walls, wall, stop[row])
    apart = np.maximum(
        np.minimum(-before.max(axis=1), behind.min(axis=1)), np.minimum(before.min(axis=1), -behind.max(axis=1))
    )
    clear = np.flatnonzero(apart > near)
    row, piece = row[clear], piece[clear]
    points = _crossings(before[clear], behind[clear], start[row], stop[row])
    covers = np.ones(len(row), dtype=bool)
    for mirror, ends in zip(mirrors, (start, stop), strict=True):
        if mirror is not None:
            off, beyond = _heights(walls, mirror[row], ends[row]), _heights(walls, mirror[row], points)
            covers &= (off.max(axis=1) < 0.0) & (beyond.min(axis=1) > near) | (off.min(axis=1) > 0.0) & (
                beyond.max(axis=1) < -near
            )
    of, line = spread(walls.first_line, piece)
    inside = np.einsum("nai,ni->na", points[of], walls.line[line, :3]) - walls.line[line, 3, None]
    covers[of[inside.min(axis=1) < near]] = False
    hidden[row[covers]] = True
    return hidden
