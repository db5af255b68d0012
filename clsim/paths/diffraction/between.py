"""What stands on a face between two edges of it, and when it is in the way of paths over both.

Notes
-----
The way between two edges is a straight line on the face that both share, and its ends slide along them. What stands on
the face has its footprint there: a wall crosses the way where the line crosses a line of that. If no end moves farther
than δ, two lines that are farther from each other than δ stay apart, and two that cross stay so while no end of either
comes nearer to the other than δ.
"""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from clsim.paths.specular.visibility import EVER, moves_within

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Floats
    from clsim.paths.diffraction.visibility import EdgeVisibility
    from clsim.paths.specular.intervals import VisibilityQuery
    from clsim.scene.room.walls import Walls

    Rows = NDArray[np.int64]
    Bools = NDArray[np.bool_]

_ABOVE = 1e-3  # m above a face, at which what stands on it is cut: what is lower is not in the way
_INSIDE = 1e-6  # of the room's size; what is nearer to the outline of all ways is beside them


class FaceLegs:
    """Ways between two edges, on the faces that these share."""

    def __init__(self, visibility: EdgeVisibility, walls: Walls) -> None:
        self._visibility, self._walls = visibility, walls
        self._footprint = cache(self._find_footprint)

    def hindered(self, rows: Rows) -> Bools:
        """Mask of candidates (n,) with an obstacle between their edges."""
        pairs = np.column_stack([x[rows] for x in (self._visibility.candidates.edge, self._visibility.candidates.face)])
        kinds, which = np.unique(pairs, axis=0, return_inverse=True)
        found = [kind[2] >= 0 and len(self._footprint(*kind[:3].tolist())) > 0 for kind in kinds]
        return np.array(found, dtype=bool)[which.ravel()]

    def evaluate(
        self, query: VisibilityQuery, sequence: NDArray[np.int32], receiver: Rows, time: Floats, half: Floats
    ) -> tuple[Bools, Floats, Floats]:
        """Return validity, clearance and how far the ends of candidates can move, each (n,), see `EdgeVisibility`."""
        which, seen = sequence[:, 0].astype(np.int64), self._visibility
        stance = seen.stance(query, which, time, half)
        no_end = np.full(len(which), -1)
        moves = np.maximum(*(seen.slides(stance, edge, no_end, query.walls.size) for edge in (0, 1)))
        free, clear = np.ones(len(which), dtype=bool), np.full(len(which), EVER)
        for i, row in enumerate(which.tolist()):
            edge, face = seen.candidates.edge[row].tolist(), seen.candidates.face[row].tolist()
            lines = self._footprint(*edge, face[0])
            way = np.stack([self._in_face(edge[0], face[0], apex[i]) for apex in stance.apexes])
            crosses, apart = _lines_apart(way, lines)
            free[i] = not crosses.any()
            clear[i] = apart.min(initial=EVER) if free[i] else apart[crosses].max()
        return free, moves_within(clear, moves) * stance.reach, stance.reach

    def _in_face(self, edge: int, face: int, places: Floats) -> Floats:
        """Return coordinates (..., 2) of places (..., 3), into a face of an edge and along it, m."""
        edges = self._visibility.edges
        axes = np.stack([edges.inward(np.array(edge), np.array(face)), edges.along[edge]])
        return np.asarray((places - edges.start[edge]) @ axes.T)

    def _find_footprint(self, edge: int, other: int, face: int) -> Floats:
        """Return lines (n, 2, 2) of what stands on the face between two edges, as `_in_face` has them, m."""
        from scipy.spatial import ConvexHull

        edges = self._visibility.edges
        angle = np.pi * (edges.n[edge] - 0.5 if face else 0.5)  # off the face, into the air
        normal = np.cos(angle) * edges.across[edge] + np.sin(angle) * edges.out[edge]
        height = float(normal @ edges.start[edge]) + _ABOVE
        ends = np.stack([x[e] for e in (edge, other) for x in (edges.start, edges.stop)])
        hull = ConvexHull(self._in_face(edge, face, ends)).equations
        found = [
            self._in_face(edge, face, line)
            for wall in range(len(self._walls))
            for line in _cut(self._walls.edges_of(wall), self._walls.normal[wall], normal, height)
        ]
        kept = [line for line in found if _enters(line, hull, _INSIDE * self._walls.size)]
        return np.array(kept).reshape(-1, 2, 2)


def _cut(outline: Floats, of_wall: Floats, normal: Floats, height: float) -> Floats:
    """Return the lines (n, 2, 3) in which a wall with an outline (m, 2, 3) and its normal meets a plane, m."""
    above = outline @ normal - height
    crossing = np.flatnonzero(above[:, 0] * above[:, 1] < 0.0)
    share = (above[crossing, 0] / (above[crossing, 0] - above[crossing, 1]))[:, None]
    points = outline[crossing, 0] + share * (outline[crossing, 1] - outline[crossing, 0])
    rank = np.argsort(points @ np.cross(of_wall, normal), kind="stable")
    return np.asarray(points[rank[: len(rank) // 2 * 2]].reshape(-1, 2, 3))


def _enters(line: Floats, hull: Floats, within: float) -> bool:
    """Test if a line (2, 2) has a part inside a convex outline of half-planes (n, 3), m off it at least."""
    first, last = 0.0, 1.0
    for a, b in (line @ hull[:, :2].T + hull[:, 2]).T + within:  # negative inside
        if a > 0.0 and b > 0.0:
            return False
        if a * b < 0.0:
            share = a / (a - b)
            first, last = (max(first, share), last) if a > 0.0 else (first, min(last, share))
    return bool(first < last)


def _lines_apart(way: Floats, lines: Floats) -> tuple[Bools, Floats]:
    """Mask of lines (n, 2, 2) that a segment (2, 2) crosses, and the least distance of any end to the other line, m."""

    def turn(a: Floats, b: Floats, c: Floats) -> Floats:
        u, v = b - a, c - a
        return np.asarray(u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0])

    def off(place: Floats, a: Floats, b: Floats) -> Floats:
        along = b - a
        squared = np.maximum(np.sum(along * along, axis=-1), 1e-300)
        share = np.clip(np.sum((place - a) * along, axis=-1) / squared, 0.0, 1.0)
        return np.asarray(np.linalg.norm(place - a - share[..., None] * along, axis=-1))

    (a, b), (p, q) = way, np.moveaxis(lines, 1, 0)
    crosses = (turn(a, b, p) * turn(a, b, q) < 0.0) & (turn(p, q, a) * turn(p, q, b) < 0.0)
    return crosses, np.minimum(np.minimum(off(a, p, q), off(b, p, q)), np.minimum(off(p, a, b), off(q, a, b)))
