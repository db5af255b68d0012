"""Whether paths over edges are there at an instant, and how far their ends may move before that can change.

Notes
-----
Seen from its edge, a path is a path of reflections from the source to the apex, and another one from the receiver. If
neither end moves farther than δ, the images do not either; rolled out about the edge the whole way is a straight line
between them, of which no point moves farther than δ, so that the apex moves by at most ``δ (L + 2 δ) / (r_s + r_r - 2
δ)`` along the edge, and no point of either part moves farther than that. A point at which a part meets a wall moves by
that, and by how far it may slide along the line. Hence a path stays there while every edge of the room but its own is
farther from each leg than its points may move, and while the apex stays on the edge, and both images in the air of the
wedge; and it stays away while one of its defects surely remains.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from clsim.acoustics.diffraction import EdgeWay, edge_way, lit_angles
from clsim.paths.specular.occlusion import INNER
from clsim.paths.specular.visibility import EVER, Reach, mirrored, moves_within, segments_apart, unfold
from clsim.paths.trajectory_tables import PERTURBATIONS

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Floats
    from clsim.paths.specular.intervals import VisibilityQuery
    from clsim.paths.specular.visibility import Unfolded
    from clsim.scene.room.edges import Edges
    from clsim.scene.room.walls import Walls

    Bools = NDArray[np.bool_]
    Rows = NDArray[np.int64]

_ON = 1e-7  # of the room's size; what is nearer to the apex touches it
_CONTRACTIONS = 100
_CONTRACTED = 1e-13  # s
_NUMBERS = 300_000  # of legs and edges of the room looked at at a time


@dataclass(frozen=True, slots=True, eq=False)
class EdgeCandidates:
    """Sequences of walls, an edge or one of its ends, and walls, that paths may take: n of them.

    Attributes
    ----------
    before : ndarray (n, N) int32
        Walls before the edge from the source's side.
    after : ndarray (n, M) int32
        Walls after the edge from the receiver's side.
    edge : ndarray (n,) int
        Of the room.
    end : ndarray (n,) int
        0 for its start, 1 for its stop, -1 for the edge itself.
    receiver : ndarray (n,) int
        To which.
    """

    before: NDArray[np.int32]
    after: NDArray[np.int32]
    edge: Rows
    end: Rows
    receiver: Rows


@dataclass(frozen=True, slots=True, eq=False)
class EdgeStance:
    """Where paths over edges run at an instant, n of them.

    Attributes
    ----------
    ends : tuple of ndarray (n, 3)
        The source at emission, and the receiver, m.
    angles : tuple of ndarray (n,)
        Of their images about the edge.
    distances : tuple of ndarray (n,)
        From its line, m.
    way : EdgeWay
        The shortest over the line of the edge.
    place : ndarray (n,)
        Where each path meets the edge, m from its start.
    apex : ndarray (n, 3)
        The same in the room.
    reach : ndarray (n,)
        How far both ends may move within what was asked, m.
    """

    ends: tuple[Floats, Floats]
    angles: tuple[Floats, Floats]
    distances: tuple[Floats, Floats]
    way: EdgeWay
    place: Floats
    apex: Floats
    reach: Floats


@dataclass(frozen=True, slots=True, eq=False)
class EdgeVisibility:
    """Tells of candidates whether they are there, and which partners are seen.

    Attributes
    ----------
    edges : Edges
        Of the room.
    candidates : EdgeCandidates
        What is asked about.
    """

    edges: Edges
    candidates: EdgeCandidates

    def stance(self, query: VisibilityQuery, which: Rows, time: Floats, half: Floats) -> EdgeStance:
        """Return where candidates `which` (n,) run at times (n,), with what their ends move within `half`, s."""
        asked, tables, edges = self.candidates, query.trajectory_tables, self.edges
        edge, row, source = asked.edge[which], asked.receiver[which] + 1, np.zeros(len(which), dtype=np.int64)
        at = tables.lifted(row, tables.position(row, time) + PERTURBATIONS[1])
        r_r, t_r, z_r = edges.cylindrical(edge, _imaged(query.walls, asked.after[which], at))
        delay = np.zeros(len(which))
        for _ in range(_CONTRACTIONS):  # each step by the Mach number of the source
            emitted_at = tables.lifted(source, tables.position(source, time - delay) + PERTURBATIONS[0])
            r_s, t_s, z_s = edges.cylindrical(edge, _imaged(query.walls, asked.before[which], emitted_at))
            way = edge_way(r_s, z_s, r_r, z_r)
            later = query.medium.passage(way.length, at - emitted_at).time - delay
            delay += later
            if not np.any(np.abs(later) > _CONTRACTED):
                break
        place = np.where(asked.end[which] < 0, way.apex, asked.end[which] * edges.length[edge])
        late, emission_time = query.time_dilation[asked.receiver[which]], time - delay
        reach = np.maximum(
            half * late * tables.speed_over(source, emission_time - late * half, emission_time + late * half),
            half * tables.speed_over(row, time - half, time + half),
        )
        apex = edges.start[edge] + place[:, None] * edges.along[edge]
        return EdgeStance((emitted_at, at), (t_s, t_r), (r_s, r_r), way, place, apex, reach)

    def evaluate(
        self, query: VisibilityQuery, sequence: NDArray[np.int32], receiver: Rows, time: Floats, half: Floats
    ) -> tuple[Bools, Floats, Floats]:
        """Return validity, clearance and how far the ends can move; the rows of candidates are all of `sequence`."""
        which = sequence[:, 0].astype(np.int64)
        asked, stance = self.candidates, self.stance(query, which, time, half)
        reach = self._reach_of_points(stance, asked.end[which], query.walls.size)
        margins = self._margins(stance, which)
        valid = np.all(margins > 0.0, axis=0)
        ratio = moves_within(np.where(margins > 0.0, 0.0, -margins).max(axis=0), reach)
        ratio[valid] = moves_within(margins[:, valid].min(axis=0), reach[valid])
        for walls, end in ((asked.before, stance.ends[0]), (asked.after, stance.ends[1])):
            rows = np.flatnonzero(valid)
            some = _Part(query.walls, walls[which[rows]], end[rows], stance.apex[rows], reach[rows])
            free, sure = some.status()
            valid[rows] = free
            ratio[rows] = np.where(free, np.minimum(ratio[rows], sure), sure)
        return valid, ratio * stance.reach, stance.reach

    def sides(self, query: VisibilityQuery, which: Rows, time: Floats, half: Floats) -> tuple[NDArray[np.int8], Bools]:
        """Return on which sides of their boundaries candidates are, (n, 5), and whether that is sure within `half`.

        The sides are those of the four partners, 1 where one is seen and -1 where not, and of the end of the edge, 1
        while the shortest way meets the edge, 0 for candidates that run over no end.
        """
        asked, stance = self.candidates, self.stance(query, which, time, half)
        edge, end = asked.edge[which], asked.end[which]
        angles = lit_angles(self.edges.n[edge], *stance.angles)
        near = stance.reach < np.minimum(*stance.distances)
        one, other = (np.arcsin(np.where(near, stance.reach / np.where(near, r, 1.0), 1.0)) for r in stance.distances)
        sure = near & np.all(np.abs(angles) > (one + other)[:, None], axis=1)
        inside = np.where(end == 0, stance.way.apex, self.edges.length[edge] - stance.way.apex)
        over_end = self._reach_of_points(stance, np.full(len(end), -1), query.walls.size)
        sure &= (end < 0) | (np.abs(inside) > over_end)
        last = np.where(end < 0, 0, np.where(inside >= 0.0, 1, -1))
        return np.column_stack([np.where(angles >= 0.0, 1, -1), last]).astype(np.int8), sure

    def _reach_of_points(self, stance: EdgeStance, end: Rows, size: float) -> Floats:
        """Return how far the points of both parts may move, (n,) m."""
        across, reach = stance.distances[0] + stance.distances[1], stance.reach
        room = across - 2.0 * reach
        sliding = reach * (stance.way.length + 2.0 * reach) / np.where(room > 0.0, room, 1.0)
        return np.where(end >= 0, reach, np.where(room > 0.0, sliding, 1e3 * size))

    def _margins(self, stance: EdgeStance, which: Rows) -> Floats:
        """Return how far inside of the wedge's air each image is, and the apex of its edge, (3, n) m."""
        edge = self.candidates.edge[which]
        whole = np.pi * self.edges.n[edge]
        inside = []
        for angle, r in zip(stance.angles, stance.distances, strict=True):
            near = np.minimum(np.abs(angle), np.abs(whole - angle))
            away = np.where(near < 0.5 * np.pi, r * np.sin(near), r)
            inside.append(np.where((angle >= 0.0) & (angle <= whole), away, -away))
        on = np.minimum(stance.place, self.edges.length[edge] - stance.place)
        return np.stack([*inside, np.where(self.candidates.end[which] < 0, on, EVER)])


@dataclass(frozen=True, slots=True, eq=False)
class _Part:
    """Paths of reflections from ends (n, 3) to apexes (n, 3) of which no point moves farther than reach (n,)."""

    walls: Walls
    sequence: NDArray[np.int32]
    end: Floats
    apex: Floats
    reach: Floats

    def status(self) -> tuple[Bools, Floats]:
        """Return which are free, and how often what moves fits into what is left until that changes, each (n,)."""
        nowhere = np.zeros_like(self.end)
        line = unfold(self.walls, self.sequence, self.end, self.apex, Reach(self.reach, self.reach, nowhere, nowhere))
        moves = self.reach[:, None] + line.slack * np.linalg.norm(line.stop - line.start, axis=2)[:, :1]
        valid, ratio = self._meets(line, moves)
        for leg in range(self.sequence.shape[1] + 1):
            rows = np.flatnonzero(valid)
            a, b = (line.along(leg, line.tau[:, leg + i])[rows] for i in (0, 1))
            valid[rows], ratio[rows] = self._passes(leg, rows, a, b, moves[rows, leg : leg + 2])
        rows = np.flatnonzero(valid)
        ratio[rows] = EVER
        for leg in range(self.sequence.shape[1] + 1):
            a, b = (line.along(leg, line.tau[:, leg + i])[rows] for i in (0, 1))
            apart = self._edges_apart(rows, a, b, last=leg == self.sequence.shape[1])
            ratio[rows] = np.minimum(ratio[rows], moves_within(apart, moves[rows, leg : leg + 2].max(axis=1)))
        return valid, ratio

    def _meets(self, line: Unfolded, moves: Floats) -> tuple[Bools, Floats]:
        """Return which paths meet all walls in order, and how sure the surest defect of the others is."""
        count, order = self.sequence.shape
        valid, ratio = np.ones(count, dtype=bool), np.zeros(count)
        for k in range(order):
            wall, sure = self.sequence[:, k], np.full(count, -1.0)
            normal, offset = self.walls.normal[wall], self.walls.offset[wall]
            heights = [np.abs(np.sum(x[:, k + 1] * normal, axis=1) - offset) for x in (line.start, line.stop)]
            beside = ~line.crosses[:, k]
            sure[beside] = moves_within(np.minimum(*heights), self.reach)[beside]
            for w in np.unique(wall[~beside]):
                rows = np.flatnonzero((wall == w) & ~beside)
                hit = line.along(k + 1, line.tau[:, k + 1])[rows]
                missed = ~self.walls.holds(w, hit)
                out, lost = rows[missed], hit[missed]
                if len(out):
                    apart = segments_apart(self.walls.edges_of(w), lost, lost).min(axis=1)
                    sure[out] = moves_within(apart, moves[out, k + 1])
            if k > 0:
                with np.errstate(invalid="ignore"):
                    late = line.tau[:, k] - line.tau[:, k + 1]
                    swapped = moves_within(late, line.slack[:, k] + line.slack[:, k + 1])
                sure = np.where(late >= 0.0, np.maximum(sure, swapped), sure)
            valid &= sure < 0.0
            ratio = np.maximum(ratio, sure)
        return valid, ratio

    def _passes(self, leg: int, rows: Rows, a: Floats, b: Floats, moves: Floats) -> tuple[Bools, Floats]:
        """Return which legs no wall crosses, and how sure the surest obstacle of the others is."""
        walls, (count, order) = self.walls, (len(rows), self.sequence.shape[1])
        valid, ratio = np.ones(count, dtype=bool), np.zeros(count)
        before, behind = (x @ walls.normal.T - walls.offset for x in (a, b))
        crosses = before * behind < 0.0
        share = before / np.where(crosses, before - behind, 1.0)
        crosses &= (share > INNER) & (share < 1.0 - INNER)
        for k in (leg - 1, leg):
            if 0 <= k < order:
                crosses &= walls.plane[self.sequence[rows, k]][:, None] != walls.plane
        if leg == order:  # walls that the edge lies in end at it
            crosses &= np.abs(behind) > _ON * walls.size
        for w in np.flatnonzero(crosses.any(axis=0)).tolist():
            some = np.flatnonzero(crosses[:, w])
            some = some[walls.holds(w, a[some] + share[some, w, None] * (b[some] - a[some]))]
            if not len(some):
                continue
            valid[some] = False
            apart = segments_apart(walls.edges_of(w), a[some], b[some]).min(axis=1)
            sure = moves_within(apart, moves[some].max(axis=1))
            for height, move in ((before[some, w], moves[some, 0]), (behind[some, w], moves[some, 1])):
                sure = np.minimum(sure, moves_within(np.abs(height), move))
            ratio[some] = np.maximum(ratio[some], sure)
        return valid, ratio

    def _edges_apart(self, rows: Rows, a: Floats, b: Floats, last: bool) -> Floats:
        """Return how far legs are from the nearest edge of the room that does not touch the apex, (n,) m."""
        edges, found = self.walls.edge, np.empty(len(rows))
        step = max(1, _NUMBERS // len(edges))
        for first in range(0, len(rows), step):
            some = slice(first, first + step)
            apart = segments_apart(edges, a[some], b[some])
            if last:
                apex = self.apex[rows[some]]
                apart[segments_apart(edges, apex, apex) < _ON * self.walls.size] = EVER
            found[some] = apart.min(axis=1)
        return found


def _imaged(walls: Walls, sequence: NDArray[np.int32], places: Floats) -> Floats:
    """Return places (n, 3) mirrored by walls (n, N), one after the other."""
    for wall in sequence.T:
        places = mirrored(walls, wall, places)
    return places
