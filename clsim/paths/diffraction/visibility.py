"""Whether paths over edges are there at an instant, and how far their ends may move before that can change.

The twin of ``edge_evaluate.h``.

Notes
-----
Seen from its edge, a path is a path of reflections from the source to the apex, and another one from the receiver: each
is there as any path by walls between ends that move (`specular.visibility`). If neither end of the whole path moves
farther than δ, the images do not either; rolled out about the edge the whole way is a straight line between them, of
which no point moves farther than δ, so that the apex moves by at most ``δ (L + 2 δ) / (r_s + r_r - 2 δ)`` along the
edge. The apex must stay on the edge, and both images in the air of the wedge. Walls that hold the apex end there, and
hide nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from clsim.acoustics.diffraction import EdgeWay, edge_way, lit_angles
from clsim.paths.specular.visibility import EVER, Reach, mirrored, moves_within, path_status
from clsim.paths.trajectory_tables import PERTURBATIONS

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Floats
    from clsim.paths.specular.intervals import VisibilityQuery
    from clsim.scene.room.edges import Edges
    from clsim.scene.room.walls import Walls

    Bools = NDArray[np.bool_]
    Rows = NDArray[np.int64]

FAR = 1e3  # sizes of the room
CONTRACTIONS = 100
CONTRACTED = 1e-13  # s


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
        for _ in range(CONTRACTIONS):  # each step by the Mach number of the source
            emitted_at = tables.lifted(source, tables.position(source, time - delay) + PERTURBATIONS[0])
            r_s, t_s, z_s = edges.cylindrical(edge, _imaged(query.walls, asked.before[which], emitted_at))
            way = edge_way(r_s, z_s, r_r, z_r)
            later = way.length / query.speed_of_sound - delay
            delay += later
            if not np.any(np.abs(later) > CONTRACTED):
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
        self, side: int, query: VisibilityQuery, sequence: NDArray[np.int32], receiver: Rows, time: Floats, half: Floats
    ) -> tuple[Bools, Floats, Floats]:
        """Return validity, clearance and how far the ends can move, of one side of candidates, each (n,).

        The side is 0 from the source to the edge, 1 from the receiver; rows of candidates are all of `sequence`.
        """
        which = sequence[:, 0].astype(np.int64)
        asked, stance = self.candidates, self.stance(query, which, time, half)
        moves = self._reach_of_apex(stance, asked.end[which], query.walls.size)
        most = np.maximum(stance.reach, moves)
        least = self._margins(stance, which).min(axis=0)
        ratio, valid = moves_within(np.abs(least), most), least >= 0.0
        rows, still = np.flatnonzero(valid), np.zeros((np.sum(valid), 3))
        walls = (asked.before, asked.after)[side][which[rows]]
        reach = Reach(stance.reach[rows], moves[rows], still, still)
        free, clear = path_status(query.walls, walls, stance.ends[side][rows], stance.apex[rows], reach, at_edge=True)
        sure = moves_within(clear, most[rows])
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
        over_end = self._reach_of_apex(stance, np.full(len(end), -1), query.walls.size)
        sure &= (end < 0) | (np.abs(inside) > over_end)
        last = np.where(end < 0, 0, np.where(inside >= 0.0, 1, -1))
        return np.column_stack([np.where(angles >= 0.0, 1, -1), last]).astype(np.int8), sure

    def _reach_of_apex(self, stance: EdgeStance, end: Rows, size: float) -> Floats:
        """Return how far the place on the edge may move along it, (n,) m."""
        across, reach = stance.distances[0] + stance.distances[1], stance.reach
        room = across - 2.0 * reach
        sliding = reach * (stance.way.length + 2.0 * reach) / np.where(room > 0.0, room, 1.0)
        return np.where(end >= 0, 0.0, np.where(room > 0.0, sliding, FAR * size))

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


def _imaged(walls: Walls, sequence: NDArray[np.int32], places: Floats) -> Floats:
    """Return places (n, 3) mirrored by walls (n, N), one after the other."""
    for wall in sequence.T:
        places = mirrored(walls, wall, places)
    return places
