"""Pairs of edges with air between, and the walls by which sound may run from one to the other."""

from __future__ import annotations

from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.acoustics.diffraction import partner_reflections
from clsim.acoustics.edge_gap import EdgeGap
from clsim.paths.vertices.gap_pair import ACROSS_AIR
from clsim.paths.visibility.clearance import blocks, segments_apart
from clsim.paths.visibility.edge_gaps import seen_frames

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from clsim.arrays import Floats
    from clsim.paths.visibility.edge_intervals import EdgeSearch
    from clsim.scene.room.edges import Edges

    Reached = Callable[[tuple[Floats, float]], list[list[NDArray[np.int32]]]]

_PLACES = 9  # on an edge, from which is looked whether another one is in sight
_NEAR = 1e-7  # of the room's size, up to which edges meet, or lie in a plane


def edge_gaps(finder: EdgeSearch, reached: Reached, order: int) -> list[list[Any]]:
    """List pairs of edges with air between by the number of walls between, see `edges._candidates`.

    reached: the sequences of walls by which each edge may be reached from a ball.
    """
    edges, found = finder.edges, list[list[Any]]([] for _ in range(order + 1))
    balls = zip(0.5 * (edges.start + edges.stop), 0.5 * edges.length, strict=True)
    from_edge, fewest = [reached(ball) for ball in balls], partner_reflections(edges.n).min(axis=1)
    for one, other in _apart(edges, _NEAR * finder.query.walls.size):
        for count, sequences in enumerate(from_edge[one][other]):
            back = {sequence[::-1].tobytes() for sequence in from_edge[other][one][count]}
            found[count] += [
                ((one, other), (ACROSS_AIR, ACROSS_AIR), -1, int(fewest[one] + fewest[other]), sequence)
                for sequence in sequences
                if sequence.tobytes() in back and _in_sight(finder, one, other, sequence)
            ]
    return found


def _apart(edges: Edges, near: float) -> list[tuple[int, int]]:
    """List edges that share no face and do not meet, in either order, with some of each in the air of the other.

    near: m, up to which edges meet, or lie in a plane.
    """
    ends, found = np.stack([edges.start, edges.stop], axis=1), []
    for one, other in combinations(range(len(edges)), 2):
        shared = set(edges.faces[one].tolist()) & set(edges.faces[other].tolist())
        distance = segments_apart(ends[other][None], ends[one, :1], ends[one, 1:])[0, 0]
        in_sight = _sees(edges, one, ends[other], near) and _sees(edges, other, ends[one], near)
        if not shared and distance > near and in_sight:
            found += [(one, other), (other, one)]
    return found


def _in_sight(finder: EdgeSearch, one: int, other: int, sequence: NDArray[np.int32]) -> bool:
    """Test whether any of some places on two edges see each other, by a sequence of walls or past all of them."""
    edges, walls = finder.edges, finder.query.walls
    share = (np.arange(_PLACES) + 0.5) / _PLACES
    seen = seen_frames(walls, edges, np.array([other]), sequence[None])
    first, last = (
        frame[0] + (share * edges.length[edge])[:, None] * frame[3]
        for frame, edge in ((edges.frames[one], one), (seen[0], other))
    )
    start, stop = np.repeat(first, _PLACES, axis=0), np.tile(last, (_PLACES, 1))
    gap = EdgeGap(edges.frames[[one]], seen, (edges.n[[one]], edges.n[[other]]))
    air = np.ones(len(start), dtype=bool)
    for angle, edge in zip(gap.angles(start - stop)[:2], (one, other), strict=True):
        air &= (angle > 0.0) & (angle < np.pi * edges.n[edge])
    start, stop = start[air], stop[air]
    for wall in np.flatnonzero(walls.plane >= 0).tolist() if not len(sequence) else ():
        free = ~blocks(walls, wall, start, stop)
        start, stop = start[free], stop[free]
    return len(start) > 0


def _sees(edges: Edges, edge: int, ends: Floats, near: float) -> bool:
    """Test whether some of a line between ends (2, 3) may be in the air of an edge, farther than `near` off it, m."""
    frame, n = edges.frames[edge], edges.n[edge]
    x, y = ((ends - frame[0]) @ frame[axis] for axis in (1, 2))
    other = np.sin(np.pi * n) * x - np.cos(np.pi * n) * y  # off the n-face, into the air beside it
    above, beside = y > near, other > near
    return bool(np.any(above) and np.any(beside) if n < 1.0 else np.any(above | beside))
