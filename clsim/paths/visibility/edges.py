"""Validity of paths over edges at an instant, and how far their ends may move before it can change.

The twin of ``edge_evaluate.h``.

Notes
-----
Seen from its edge, a path is a path of reflections from the source to the apex, and another one from the receiver: each
is there as any path by walls between ends that move (`clearance`). If neither end of the whole path moves
farther than δ, the images do not either; rolled out about the edge the whole way is a straight line between them, of
which no point moves farther than δ, so that the apex moves by at most ``δ (L + 2 δ) / (r_s + r_r - 2 δ)`` along the
edge. The apex must stay on the edge, and both images in the air of the wedge. Walls that hold the apex end there, and
hide nothing.

The way between two edges is a straight line on the face that both share, and its ends slide along them. What stands on
the face has its footprint there: a wall crosses the way where the line crosses a line of that. If no end moves farther
than δ, two lines that are farther from each other than δ stay apart, and two that cross stay so while no end of either
comes nearer to the other than δ.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.acoustics.diffraction import TERMS, EdgePath, lit_angles, path_over_edge
from clsim.acoustics.edge_gap import Crossing
from clsim.arrays import Bools, Floats, Rows
from clsim.paths.vertices.edge_events import at_meeting
from clsim.paths.visibility.clearance import EVER, Reach, mirrored, moves_within, path_status
from clsim.paths.visibility.intervals import PERTURBATIONS, VisibilityQuery
from clsim.scene.room.edges import Edges
from clsim.scene.room.walls import Walls

End = tuple[Floats, Floats]


FAR = 1e3  # sizes of the room
SIDES = 2 * TERMS + 3  # of a path, see `EdgeVisibility.sides`
ENDS_BESIDE = (SIDES - 2, SIDES - 1)  # those of its ends
NEAR_WRAP = 0.2 * np.pi  # from the middle of a wedge, where angles wrap: nearer to it they go on beyond it
CONTRACTIONS = 100
CONTRACTED = 1e-13  # s
_ABOVE = 1e-3  # m above a face, at which what stands on it is cut: what is lower is not in the way
_INSIDE = 1e-6  # of the room's size; what is nearer to the outline of all ways is beside them


@dataclass(frozen=True, slots=True, eq=False)
class EdgeCandidates:
    """Sequences of walls, an edge or one of its ends, and walls, that paths may take: n of them."""

    before: NDArray[np.int32]  # (n, N) walls before the edge from the source's side
    after: NDArray[np.int32]  # (n, M) walls after the edge from the receiver's side
    edge: Rows  # (n, 2) of the room, from the source's side; the same twice for paths over one edge
    face: Rows  # (n, 2) of each both share, 0 or 1, its n-face; -1 for paths over one edge, `ACROSS_AIR` where none
    # (n,) 0 for its start, 1 for its stop, -1 for the edge itself; of the second of two 2 and 3, of both `MEETING` on
    # and `TWO_ENDS` on
    end: Rows
    receiver: Rows  # (n,) to which
    between: NDArray[np.int32]  # (n, B) walls between two edges with air between, from the first one's side
    spans: tuple[Rows, Floats, Floats] | None = (
        None  # rows, and from and up to when these may be there, s; None: always
    )

    @property
    def over_meeting_edges(self) -> bool:
        """Whether these are paths over corners at which two edges of a face end."""
        return bool(np.any(at_meeting(self.end)))

    @property
    def over_ends_of_pairs(self) -> bool:
        """Whether these are paths over an edge and an end of another one."""
        return bool(np.any((self.end >= 0) & (self.edge[:, 0] != self.edge[:, 1])))

    @staticmethod
    def joined(parts: Sequence[EdgeCandidates]) -> EdgeCandidates:
        """Return several with as many walls as one."""
        names = [f.name for f in fields(EdgeCandidates) if f.name != "spans"]
        columns: dict[str, Any] = {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
        first = np.cumsum([0, *(len(part.edge) for part in parts[:-1])])
        rows = [(part.spans[0] + i, *part.spans[1:]) for i, part in zip(first, parts, strict=True) if part.spans]
        spans: Any = tuple(np.concatenate(column) for column in zip(*rows, strict=True)) if rows else None
        return EdgeCandidates(**columns, spans=spans)


@dataclass(frozen=True, slots=True, eq=False)
class Course:
    """The shortest ways over the lines of edges, n of them, as each edge sees them."""

    edge_paths: tuple[EdgePath, EdgePath]
    across: tuple[Floats, Floats]  # how far the other end is beyond each edge, rolled out, m
    crossing: Crossing | None  # of edges with air between


@dataclass(frozen=True, slots=True, eq=False)
class EdgeStance:
    """Where paths over edges run at an instant, n of them."""

    ends: tuple[Floats, Floats]  # the source at emission, and the receiver, m
    angles: tuple[Floats, Floats]  # of their images, each about its edge
    distances: tuple[Floats, Floats]  # from its line, m
    heights: tuple[Floats, Floats]  # along it, m from its start
    # The shortest over the lines of the edges; emission is by the way over the end of those that run over one.
    course: Course
    places: tuple[Floats, Floats]  # where each path meets each edge, m from its start
    apexes: tuple[Floats, Floats]  # the same in the room
    reach: Floats  # (n,) how far both ends may move within what was asked, m
    reaches: tuple[Floats, Floats]  # the same of each


@dataclass(frozen=True, slots=True, eq=False)
class EdgeVisibility:
    """Tells of candidates whether they are there, and which partners are seen."""

    edges: Edges  # of the room
    candidates: EdgeCandidates  # what is asked about
    query: VisibilityQuery  # endpoints, walls and air

    def stance(self, which: Rows, time: Floats, half: Floats) -> EdgeStance:
        """Course of candidates `which` (n,) at times (n,), with the motion of their endpoints within `half`, s."""
        requested, query, edges = self.candidates, self.query, self.edges
        tables = query.trajectory_tables
        row, source = requested.receiver[which] + 1, np.zeros(len(which), dtype=np.int64)
        (one, other), end = requested.edge[which].T, requested.end[which]
        over_end = (end >= 0) & (one == other) | at_meeting(end)
        ends = end % 2 * edges.length[one], np.where(at_meeting(end), end // 2, end) % 2 * edges.length[other]
        at = tables.lifted(row, tables.position(row, time) + PERTURBATIONS[1])
        r_r, t_r, z_r = edges.cylindrical(other, imaged(query.walls, requested.after[which], at))
        delay = np.zeros(len(which))
        for _ in range(CONTRACTIONS):  # each step by the Mach number of the source
            emitted_at = tables.lifted(source, tables.position(source, time - delay) + PERTURBATIONS[0])
            r_s, t_s, z_s = edges.cylindrical(one, imaged(query.walls, requested.before[which], emitted_at))
            course = self.course(which, (r_s, z_s), (r_r, z_r))
            by_end = np.hypot(r_s, ends[0] - z_s) + np.hypot(r_r, ends[1] - z_r)
            length = np.where(over_end, by_end, course.edge_paths[0].length)
            later = query.medium.passage(length, at - emitted_at).time - delay
            delay += later
            if not np.any(np.abs(later) > CONTRACTED):
                break
        places = tuple(np.where(over_end, x, w.apex) for x, w in zip(ends, course.edge_paths, strict=True))
        late, emission_time = query.time_dilation[requested.receiver[which]], time - delay
        reaches = (
            half * late * tables.speed_over(source, emission_time - late * half, emission_time + late * half),
            half * tables.speed_over(row, time - half, time + half),
        )
        apexes = tuple(edges.start[e] + p[:, None] * edges.along[e] for e, p in zip((one, other), places, strict=True))
        return EdgeStance(
            (emitted_at, at), (t_s, t_r), (r_s, r_r), (z_s, z_r), course, (places[0], places[1]),
            (apexes[0], apexes[1]), np.maximum(*reaches), reaches,
        )  # fmt: skip

    def course(self, which: Rows, source: End, receiver: End) -> Course:
        """Shortest ways of candidates `which` (n,) between ends at r and z about the first and the last edges, m."""
        requested, edges = self.candidates, self.edges
        (one, other), (face, other_face) = requested.edge[which].T, requested.face[which].T
        if np.all(face < 0):
            leg = path_over_edge(*source, *receiver)
            return Course((leg, leg), (receiver[0], source[0]), None)
        received = edges.beyond(one, face, other, other_face, *receiver)
        sent = edges.beyond(other, other_face, one, face, *source)
        routes = path_over_edge(*source, *received), path_over_edge(*receiver, *sent)
        return Course(routes, (received[0], sent[0]), None)

    def between(self, stance: EdgeStance, which: Rows, turns: End) -> tuple[End, End]:
        """Angles (n,) at which the first edges see what is behind them, and the last ones what is before, and turns."""
        (one, other), (face, other_face) = self.candidates.edge[which].T, self.candidates.face[which].T
        still, double = np.zeros(len(which)), face >= 0
        ahead = np.where(double, face * np.pi * self.edges.n[one], stance.angles[1])
        back = np.where(double, other_face * np.pi * self.edges.n[other], stance.angles[0])
        return (ahead, back), (np.where(double, still, turns[1]), np.where(double, still, turns[0]))

    def evaluate(
        self, side: int, sequence: NDArray[np.int32], receiver: Rows, time: Floats, half: Floats
    ) -> tuple[Bools, Floats, Floats]:
        """Return validity, clearance and how far the ends can move, of one side of candidates, each (n,)."""
        which = sequence[:, 0].astype(np.int64)
        requested, stance = self.candidates, self.stance(which, time, half)
        both = [self.slides(stance, edge, requested.end[which], self.query.walls.size) for edge in (0, 1)]
        moves, most = both[side], np.maximum(stance.reach, np.maximum(*both))
        off, places = self._margins(stance, which)
        least = np.minimum(off, places)
        ratio, valid = moves_within(np.abs(least), most), least >= 0.0
        beside = moves_within(-off, stance.reach)  # wherever the places on the edges slide to
        ratio = np.where(off < 0.0, np.maximum(ratio, beside), ratio)
        rows, still = np.flatnonzero(valid), np.zeros((np.sum(valid), 3))
        walls = (requested.before, requested.after)[side][which[rows]]
        reach = Reach(stance.reach[rows], moves[rows], still, still)
        legs = stance.ends[side][rows], stance.apexes[side][rows]
        free, clear = path_status(self.query.walls, walls, *legs, reach, True)
        sure = moves_within(clear, reach.most)
        valid[rows] = free
        ratio[rows] = np.where(free, np.minimum(ratio[rows], sure), sure)
        return valid, ratio * stance.reach, stance.reach

    def ahead(
        self, sequence: NDArray[np.int32], receiver: Rows, time: Floats, half: Floats
    ) -> tuple[Bools, Floats, Floats]:
        """Test if either end is beyond the other one's edge, rolled out; the rest is as of `evaluate`."""
        stance = self.stance(sequence[:, 0].astype(np.int64), time, half)
        off = np.minimum(*stance.course.across)
        return off >= 0.0, np.abs(off), stance.reach

    def sides(self, which: Rows, time: Floats, half: Floats) -> tuple[NDArray[np.int8], Bools, Floats, Floats]:
        """Tell on which sides of their boundaries candidates are, (n, 11), and if that is sure.

        It is sure where it holds within `half` of the times, s. Then how far they are off the nearest boundary, and how
        far ends move within `half`, (n,) m.
        The sides are those of the four partners, 1 where one is seen and -1 where not; of the end of the edge, 1 while
        the shortest way meets the edge, 0 for candidates that run over no end; of the partners at the second edge, 0
        for paths over one; and those of both ends, -1 near the 0-face and 1 near the n-face of a sheet, or of a wedge
        nearly as thin, whose plane they may pass beyond its other edges, 0 elsewhere.
        """
        requested, stance = self.candidates, self.stance(which, time, half)
        (one, other), end, double = requested.edge[which].T, requested.end[which], requested.face[which, 0] >= 0
        near = stance.reach < np.minimum(*stance.distances)
        turn, other_turn = (
            np.arcsin(np.where(near, stance.reach / np.where(near, r, 1.0), 1.0)) for r in stance.distances
        )
        (ahead, back), more = self.between(stance, which, (turn, other_turn))
        angles = lit_angles(self.edges.n[one], stance.angles[0], ahead)
        others = lit_angles(self.edges.n[other], back, stance.angles[1])
        sure = near & np.all(np.abs(angles) > (turn + more[0])[:, None], axis=1)
        sure &= ~double | np.all(np.abs(others) > (other_turn + more[1])[:, None], axis=1)
        beside, passed = beside_faces(self.edges.n[requested.edge[which].T], np.stack(stance.angles))
        sure &= np.all(passed > np.stack([turn, other_turn]), axis=0)
        apex = stance.course.edge_paths[0].apex
        inside = np.where(end % 2 == 0, apex, self.edges.length[one] - apex)
        over_end = self.slides(stance, 0, np.full(len(end), -1), self.query.walls.size)
        sure &= (end < 0) | (np.abs(inside) > over_end)
        margins = [np.abs(angles).min(axis=1), passed.min(axis=0), np.where(double, np.abs(others).min(axis=1), np.inf)]
        near = np.min(margins, axis=0) * np.minimum(*stance.distances)
        off = np.minimum(near, np.where(end < 0, np.inf, np.abs(inside)))
        last = np.where(end < 0, 0, np.where(inside >= 0.0, 1, -1))
        second = np.where(double[:, None], np.where(others >= 0.0, 1, -1), 0)
        return (
            np.column_stack([np.where(angles >= 0.0, 1, -1), last, second, *beside]).astype(np.int8),
            sure,
            off, stance.reach,
        )  # fmt: skip

    def slides(self, stance: EdgeStance, edge: int, end: Rows, size: float) -> Floats:
        """Largest motion of the point on the first or second edge along it, (n,) m."""
        across, reach = stance.distances[edge] + stance.course.across[edge], stance.reach
        room = across - 2.0 * reach
        sliding = reach * (stance.course.edge_paths[edge].length + 2.0 * reach) / np.where(room > 0.0, room, 1.0)
        return np.where(end >= 0, 0.0, np.where(room > 0.0, sliding, FAR * size))

    def _margins(self, stance: EdgeStance, which: Rows) -> Floats:
        """Clearances (2, n), m: of images in the air of their wedges and beyond edges, and of apexes on these."""
        end, off, on = self.candidates.end[which], [*stance.course.across], []
        for edge, angle, r, place in zip(
            self.candidates.edge[which].T, stance.angles, stance.distances, stance.places, strict=True
        ):
            whole = np.pi * self.edges.n[edge]
            near = np.minimum(np.abs(angle), np.abs(whole - angle))
            away = np.where(near < 0.5 * np.pi, r * np.sin(near), r)
            off.append(np.where((angle >= 0.0) & (angle <= whole), away, -away))
            on.append(np.where(end < 0, np.minimum(place, self.edges.length[edge] - place), EVER))
        return np.stack([np.min(off, axis=0), np.min(on, axis=0)])


def beside_faces(n: Floats, angle: Floats) -> tuple[NDArray[np.int64], Floats]:
    """Return near which face ends are to the middle of the wedge, see `EdgeVisibility.sides`, and up to which turn."""
    off = angle - 0.5 * np.pi * n
    left = np.pi - np.abs(off)
    beside = np.where(left < NEAR_WRAP, np.where(off < 0.0, -1, 1), 0)
    return beside, np.minimum(left, np.abs(left - NEAR_WRAP))


def imaged(walls: Walls, sequence: NDArray[np.int32], places: Floats) -> Floats:
    """Return places (n, 3) mirrored by walls (n, N), one after the other; those of -1 mirror nothing."""
    for wall in sequence.T:
        places = np.where((wall >= 0)[:, None], mirrored(walls, wall, places), places)
    return places


class FaceLegs:
    """Ways between two edges, on the faces that these share."""

    def __init__(self, visibility: EdgeVisibility) -> None:
        self._visibility = visibility
        self._footprint = cache(partial(footprint, visibility.edges, visibility.query.walls))

    def hindered(self, rows: Rows) -> Bools:
        """Mask of candidates (n,) with an obstacle between their edges."""
        pairs = np.column_stack([x[rows] for x in (self._visibility.candidates.edge, self._visibility.candidates.face)])
        kinds, which = np.unique(pairs, axis=0, return_inverse=True)
        found = [kind[2] >= 0 and len(self._footprint(*kind[:3].tolist())) > 0 for kind in kinds]
        return np.array(found, dtype=bool)[which.ravel()]

    def evaluate(
        self, sequence: NDArray[np.int32], receiver: Rows, time: Floats, half: Floats
    ) -> tuple[Bools, Floats, Floats]:
        """Return validity, clearance and how far the ends of candidates can move, each (n,), see `EdgeVisibility`."""
        which, seen = sequence[:, 0].astype(np.int64), self._visibility
        stance = seen.stance(which, time, half)
        no_end = np.full(len(which), -1)
        moves = np.maximum(*(seen.slides(stance, edge, no_end, seen.query.walls.size) for edge in (0, 1)))
        free, clear = np.ones(len(which), dtype=bool), np.full(len(which), EVER)
        for i, row in enumerate(which.tolist()):
            edge, face = seen.candidates.edge[row].tolist(), seen.candidates.face[row].tolist()
            lines = self._footprint(*edge, face[0])
            leg = np.stack([in_face(seen.edges, edge[0], face[0], apex[i]) for apex in stance.apexes])
            crosses, apart = lines_apart(leg, lines)
            free[i] = not crosses.any()
            clear[i] = apart.min(initial=EVER) if free[i] else apart[crosses].max()
        return free, moves_within(clear, moves) * stance.reach, stance.reach


def in_face(edges: Edges, edge: int, face: int, places: Floats) -> Floats:
    """Coordinates (..., 2) of places (..., 3), into a face of an edge and along it, m."""
    axes = np.stack([edges.inward(np.array(edge), np.array(face)), edges.along[edge]])
    return np.asarray((places - edges.start[edge]) @ axes.T)


def footprint(edges: Edges, walls: Walls, edge: int, other: int, face: int) -> Floats:
    """Lines (n, 2, 2) of what stands on the face between two edges, as `in_face` has them, m."""
    from scipy.spatial import ConvexHull

    angle = np.pi * (edges.n[edge] - 0.5 if face else 0.5)  # off the face, into the air
    normal = np.cos(angle) * edges.across[edge] + np.sin(angle) * edges.out[edge]
    height = float(normal @ edges.start[edge]) + _ABOVE
    ends = np.stack([x[e] for e in (edge, other) for x in (edges.start, edges.stop)])
    hull = ConvexHull(in_face(edges, edge, face, ends)).equations
    found = [
        in_face(edges, edge, face, line)
        for wall in range(len(walls))
        for line in _cut(walls.edges_of(wall), walls.normal[wall], normal, height)
    ]
    kept = [line for line in found if _enters(line, hull, _INSIDE * walls.size)]
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


def lines_apart(leg: Floats, lines: Floats) -> tuple[Bools, Floats]:
    """Mask of lines (n, 2, 2) that a segment (2, 2) crosses, and the least distance of any end to the other line, m."""

    def turn(a: Floats, b: Floats, c: Floats) -> Floats:
        u, v = b - a, c - a
        return np.asarray(u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0])

    def off(place: Floats, a: Floats, b: Floats) -> Floats:
        along = b - a
        squared = np.maximum(np.sum(along * along, axis=-1), 1e-300)
        share = np.clip(np.sum((place - a) * along, axis=-1) / squared, 0.0, 1.0)
        return np.asarray(np.linalg.norm(place - a - share[..., None] * along, axis=-1))

    (a, b), (p, q) = leg, np.moveaxis(lines, 1, 0)
    crosses = (turn(a, b, p) * turn(a, b, q) < 0.0) & (turn(p, q, a) * turn(p, q, b) < 0.0)
    return crosses, np.minimum(np.minimum(off(a, p, q), off(b, p, q)), np.minimum(off(p, a, b), off(q, a, b)))
