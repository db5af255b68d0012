"""Whether paths are valid at an instant, and how far their ends may move before that can change; in NumPy, float64.

The twin of ``visibility.h`` and ``unfolded.h``, which have the same names.

Notes
-----
A path is a sequence of walls. Leg k runs from wall k to wall k + 1 (0 is the source, N + 1 the receiver) on the
straight line from the source mirrored k times to the receiver mirrored back, which meets wall k at the share tau_k. It
is valid if every wall is met from one side to the other, inside its outline, in order, and no other wall crosses a leg.
If neither end moves farther than `reach`, no point of that line at a fixed share moves farther, and tau_k changes by at
most ``reach / |distance of one mirrored end to wall k - that of the other|``. Heights over a wall's plane change by
what each end moves across that plane: by nothing if it stands still, or sits in a wall of this plane and slides along
it. Hence

- a valid path stays valid if every edge of the room is farther than `reach` from every leg, drawn out at its ends by
  what these can move: a path can become invalid only by touching an edge (ends that touch a wall are refused before);
- a path stays invalid if one of its defects does: ends farther than `reach` on one side of a wall; a wall missed, with
  all its edges farther than `reach` from the whole line; an order that is wrong by more than both shares can change; or
  an obstacle that crosses what is always part of a leg, its edges and both ends of that part farther than `reach`. An
  obstacle nearer to an end of its leg than that can move has the largest reach for which this holds as its clearance:
  0 is left to what touches an edge (or a wall) at this very instant.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Bools, ByRow, Floats
from clsim.paths.visibility.occlusion import INNER
from clsim.scene.room.walls import INSIDE, Walls

Ints = NDArray[np.int64] | NDArray[np.int32]


EVER = 1e300  # m, next to no bound
TOUCHING = 100.0  # tolerances of a wall's outline; what is nearer to the end of a path at an edge touches it
_PAIRS = 2**16  # of segments and edges looked at at a time
_IN_PLANE = 1e-7  # of the room's size, up to which a place is in the plane of a wall
PARALLEL = 1e-14  # square of the sine of an angle below which segments are parallel


@dataclass(frozen=True, slots=True, eq=False)
class Reach(ByRow):
    """How far the ends of n paths may move."""

    source: Floats  # (n,) m
    receiver: Floats  # likewise
    # (n, 3) unit normals of the walls that they sit in and slide along; zero for ends in the open.
    source_facing: Floats
    receiver_facing: Floats  # (n, 3) likewise

    @property
    def most(self) -> Floats:
        """How far any of them may move, (n,) m."""
        return np.asarray(np.maximum(self.source, self.receiver))


@dataclass(frozen=True, slots=True, eq=False)
class Unfolded(ByRow):
    """The straight line of n paths of N reflections in the real space of each leg."""

    start: Floats  # (n, N + 1, 3) its ends: mirrored source and mirrored receiver, m
    stop: Floats  # likewise
    # (n, N + 2) shares at which it meets source, walls and receiver, NaN where it does not, and how far these can move.
    tau: Floats
    slack: Floats  # (n, N + 2) likewise
    inverse: Floats  # (n, N) 1 / (change of the distance to each wall along the line), 1/m
    crosses: Bools  # (n, N) whether the ends lie on both sides of each wall
    reach: Reach  # how far both may move
    start_facing: Floats  # (n, N + 1, 3) the mirrored normals of the walls that the ends sit in
    stop_facing: Floats  # likewise

    def along(self, leg: int, tau: Floats) -> Floats:
        """Return points (n, 3) of a leg's line at shares (n,)."""
        return self.start[:, leg] + tau[:, None] * (self.stop[:, leg] - self.start[:, leg])

    def across(self, leg: int, tau: Floats, normal: Floats) -> Floats:
        """Largest motion of points at shares (n,) of a leg's line across planes of given normals, (n,) m."""
        slides = (np.sum(facing[:, leg] * normal, axis=-1) for facing in (self.start_facing, self.stop_facing))
        start, stop = (np.sqrt(np.maximum(1.0 - cosine**2, 0.0)) for cosine in slides)
        return np.asarray((1.0 - tau) * self.reach.source * start + tau * self.reach.receiver * stop)


def unfold(walls: Walls, sequence: Ints, source: Floats, receiver: Floats, reach: Reach) -> Unfolded:
    """Return the straight lines of paths by sequences (n, N) of walls between places (n, 3), m."""
    count, order = sequence.shape
    start, stop, start_facing, stop_facing = (np.empty((count, order + 1, 3)) for _ in range(4))
    start[:, 0], stop[:, order] = source, receiver
    start_facing[:, 0], stop_facing[:, order] = reach.source_facing, reach.receiver_facing
    for k in range(order):
        start[:, k + 1] = mirrored(walls, sequence[:, k], start[:, k])
        start_facing[:, k + 1] = turned(walls, sequence[:, k], start_facing[:, k])
    for k in range(order, 0, -1):
        stop[:, k - 1] = mirrored(walls, sequence[:, k - 1], stop[:, k])
        stop_facing[:, k - 1] = turned(walls, sequence[:, k - 1], stop_facing[:, k])
    normal, offset = walls.normal[sequence], walls.offset[sequence]
    before = np.einsum("nki,nki->nk", start[:, 1:], normal) - offset
    behind = np.einsum("nki,nki->nk", stop[:, 1:], normal) - offset
    crosses = before * behind < 0.0
    inverse = 1.0 / np.where(crosses, np.abs(before - behind), np.inf)
    tau, slack = np.zeros((count, order + 2)), np.zeros((count, order + 2))
    tau[:, 1:-1] = np.where(crosses, before / np.where(crosses, before - behind, 1.0), np.nan)
    tau[:, -1] = 1.0
    slack[:, 1:-1] = reach.most[:, None] * inverse
    return Unfolded(start, stop, tau, slack, inverse, crosses, reach, start_facing, stop_facing)


def mirrored(walls: Walls, wall: Ints, points: Floats) -> Floats:
    """Return points (n, 3) mirrored by the planes of walls (n,)."""
    height = np.einsum("ni,ni->n", points, walls.normal[wall]) - walls.offset[wall]
    return np.asarray(points - 2.0 * height[:, None] * walls.normal[wall])


def turned(walls: Walls, wall: Ints, directions: Floats) -> Floats:
    """Return directions (n, 3) mirrored by the planes of walls (n,)."""
    normal = walls.normal[wall]
    return np.asarray(directions - 2.0 * np.sum(directions * normal, axis=1, keepdims=True) * normal)


def in_planes(walls: Walls, place: Floats, sequence: NDArray[np.int32]) -> NDArray[np.bool_]:
    """Mask of walls of sequences (n, N) in whose plane places (3,) or (n, 3) lie, as seen by the walls behind each."""
    found, seen = np.zeros(sequence.shape, dtype=bool), np.broadcast_to(place, (len(sequence), 3))
    for k in range(sequence.shape[1] - 1, -1, -1):
        wall = sequence[:, k]
        height = np.einsum("ni,ni->n", seen, walls.normal[wall]) - walls.offset[wall]
        found[:, k] = np.abs(height) <= _IN_PLANE * walls.size
        seen = mirrored(walls, wall, seen)
    return found


def path_status(
    walls: Walls, sequence: Ints, source: Floats, receiver: Floats, reach: Reach, at_edge: bool = False
) -> tuple[Bools, Floats]:
    """Mask of valid paths (n,), and their clearances (n,), m.

    Where the last legs end on edges of the room, `at_edge`, walls that hold these places hide nothing of them. If a
    clearance exceeds the most of `reach`, the state stays while neither end moves farther than `reach`; else while both
    move by less than its share ``clear / most`` of their reach.
    """
    paths = unfold(walls, sequence, source, receiver, reach)
    valid, clear = _reflects(walls, sequence, paths)
    rows = np.flatnonzero(valid)
    free, blocked_clear = _passes(walls, sequence[rows], paths.part(rows), at_edge)
    valid[rows], clear[rows] = free, blocked_clear
    rows = np.flatnonzero(valid)
    clear[rows] = _edge_clearance(walls, paths.part(rows), at_edge)
    return valid, clear


def _reflects(walls: Walls, sequence: Ints, paths: Unfolded) -> tuple[Bools, Floats]:
    """Mask of paths that meet all walls in order, and the clearance of the surest defect of the others."""
    count, order = sequence.shape
    valid, clear = np.ones(count, dtype=bool), np.zeros(count)
    for k in range(order):
        sure = np.full(count, -1.0)
        beside = ~paths.crosses[:, k]
        normal, offset = walls.normal[sequence[:, k]], walls.offset[sequence[:, k]]
        ends = (paths.start[:, k + 1], paths.stop[:, k + 1])
        heights = (np.abs(np.einsum("ni,ni->n", end, normal) - offset) for end in ends)
        moves = (paths.across(k + 1, np.full(count, tau), normal) for tau in (0.0, 1.0))
        ratios = (moves_within(height, move) for height, move in zip(heights, moves, strict=True))
        sure[beside] = (paths.reach.most * np.minimum(*ratios))[beside]
        hit = paths.along(k + 1, paths.tau[:, k + 1])
        for wall in np.unique(sequence[:, k]):
            rows = np.flatnonzero((sequence[:, k] == wall) & paths.crosses[:, k])
            lost, at = ~walls.holds(wall, hit[rows]), int(wall)
            out = rows[lost]
            sure[out] = edges_apart(walls.edges_of(at), ends[0][out], ends[1][out])
            for twin in walls.twin[walls.first_twin[wall] : walls.first_twin[wall + 1]]:
                taken = rows[(sure[rows] < 0.0) & walls.holds(twin, hit[rows])]
                sure[taken] = edges_apart(walls.edges_of(int(twin)), ends[0][taken], ends[1][taken])
        if k > 0:
            with np.errstate(invalid="ignore", divide="ignore"):
                late = paths.tau[:, k] - paths.tau[:, k + 1]
                swapped = late / (paths.inverse[:, k - 1] + paths.inverse[:, k])
            sure = np.where(late >= 0.0, np.maximum(sure, swapped), sure)
        valid &= sure < 0.0
        clear = np.maximum(clear, sure)
    return valid, clear


def moves_within(apart: Floats, move: Floats) -> Floats:
    """Ratio of a distance to a move, (n,); next to infinity where nothing moves."""
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        return np.where(move > 0.0, np.minimum(apart / np.where(move > 0.0, move, 1.0), EVER), EVER)


def _passes(walls: Walls, sequence: Ints, paths: Unfolded, at_edge: bool) -> tuple[Bools, Floats]:
    """Mask of paths that no wall crosses, and the clearance of the surest obstacle of the others."""
    count, order = sequence.shape
    valid, clear = np.ones(count, dtype=bool), np.zeros(count)
    for leg in range(order + 1):
        a, b = paths.along(leg, paths.tau[:, leg]), paths.along(leg, paths.tau[:, leg + 1])
        first = paths.tau[:, leg] + paths.slack[:, leg]
        last = paths.tau[:, leg + 1] - paths.slack[:, leg + 1]
        for wall in np.flatnonzero(walls.plane >= 0).tolist():  # of others panels let sound pass
            beside = [walls.plane[sequence[:, k]] == walls.plane[wall] for k in (leg - 1, leg) if 0 <= k < order]
            rows = np.flatnonzero(~np.any([np.zeros(count, dtype=bool), *beside], axis=0))
            ends = at_edge and leg == order
            rows = rows[blocks(walls, wall, a[rows], b[rows], 0.0 if ends else INSIDE)]
            if ends:
                rows = rows[np.abs(b[rows] @ walls.normal[wall] - walls.offset[wall]) > TOUCHING * INSIDE * walls.size]
            if not len(rows):
                continue
            valid[rows] = False
            some = rows[first[rows] < last[rows]]
            path, normal = paths.part(some), walls.normal[wall]
            ends = [path.along(leg, tau) for tau in (first[some], last[some])]
            before, behind = (end @ normal - walls.offset[wall] for end in ends)
            moves = [path.across(leg, tau, normal) for tau in (first[some], last[some])]
            surely = np.minimum(moves_within(np.abs(before), moves[0]), moves_within(np.abs(behind), moves[1]))
            apart = np.minimum(edges_apart(walls.edges_of(wall), *ends), path.reach.most * surely)
            clear[some] = np.where(before * behind < 0.0, np.maximum(clear[some], apart), clear[some])
            # Nearer to an end of the leg than that can move: sure only while both ends move less.
            unsure = np.concatenate([rows[first[rows] >= last[rows]], some[before * behind >= 0.0]])
            path = paths.part(unsure)
            high, low = (np.abs(end[unsure] @ normal - walls.offset[wall]) for end in (a, b))
            slope = (high + low) / (path.tau[:, leg + 1] - path.tau[:, leg])
            apart = edges_apart(walls.edges_of(wall), a[unsure], b[unsure])
            for end, k in ((high, leg), (low, leg + 1)):
                moves = path.across(leg, path.tau[:, k], normal) + path.slack[:, k] * slope
                apart = np.minimum(apart, path.reach.most * moves_within(end, moves))
            clear[unsure] = np.maximum(clear[unsure], apart)
    return valid, clear


def blocks(walls: Walls, wall: int, a: Floats, b: Floats, beyond: float = INSIDE) -> Bools:
    """Mask of segments that a wall, or what is a share of the size beyond it, crosses between their endpoints."""
    first, last = (x @ walls.normal[wall] - walls.offset[wall] for x in (a, b))
    crosses = first * last < 0.0
    share = first / np.where(crosses, first - last, 1.0)
    inner = crosses & (share > INNER) & (share < 1.0 - INNER)
    blocked = np.zeros(len(a), dtype=bool)
    rows = np.flatnonzero(inner)
    blocked[rows] = walls.holds(wall, a[rows] + share[rows, None] * (b[rows] - a[rows]), beyond)
    return blocked


def _edge_clearance(walls: Walls, paths: Unfolded, at_edge: bool) -> Floats:
    """Return distances from the legs, drawn out at their ends by what these can move, to the nearest edge."""
    clear = 2.0 * paths.reach.most
    legs = paths.start.shape[1]
    some = max(1, _PAIRS // max(1, len(clear)))
    for leg in range(legs):
        a = paths.along(leg, np.maximum(paths.tau[:, leg] - paths.slack[:, leg], 0.0))
        b = paths.along(leg, np.minimum(paths.tau[:, leg + 1] + paths.slack[:, leg + 1], 1.0))
        for edges in (walls.edge[first : first + some] for first in range(0, len(walls.edge), some)):
            apart = segments_apart(edges, a, b)
            if at_edge and leg == legs - 1:
                end = paths.stop[:, leg]
                apart[segments_apart(edges, end, end) <= TOUCHING * INSIDE * walls.size] = np.inf
            clear = np.minimum(clear, apart.min(axis=1, initial=np.inf))
    return clear


def edges_apart(outline: Floats, start: Floats, stop: Floats) -> Floats:
    """Distances (n,) of straight legs from an outline (E, 2, 3), m."""
    return np.asarray(segments_apart(outline, start, stop).min(axis=1, initial=np.inf))


def segments_apart(edges: Floats, a: Floats, b: Floats) -> Floats:
    """Return the distances (n, E) from segments a to b (n, 3) to edges (E, 2, 3), m."""
    # Components one by one: sums over a last axis of three take several times as long.
    u, v = (b - a).T[..., None], (edges[:, 1] - edges[:, 0]).T[:, None]
    w = [x[:, None] - y for x, y in zip(a.T, edges[:, 0].T, strict=True)]
    uu, uv, vv, uw, vw = (_product(x, y) for x, y in ((u, u), (u, v), (v, v), (u, w), (v, w)))
    determinant = uu * vv - uv * uv
    with np.errstate(divide="ignore", invalid="ignore"):
        s = np.where(determinant > PARALLEL * uu * vv, np.clip((uv * vw - vv * uw) / determinant, 0.0, 1.0), 0.0)
        t = np.clip((uv * s + vw) / vv, 0.0, 1.0)
        s = np.where(uu > 0.0, np.clip((uv * t - uw) / uu, 0.0, 1.0), 0.0)
    apart = [z + s * x - t * y for x, y, z in zip(u, v, w, strict=True)]
    return np.sqrt(_product(apart, apart))


def _product(x: Floats | list[Floats], y: Floats | list[Floats]) -> Floats:
    """Return the products of vectors, by three components."""
    return np.asarray(x[0] * y[0] + x[1] * y[1] + x[2] * y[2])
