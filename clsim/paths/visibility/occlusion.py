"""Walls in the way: those that beams and segments meet, and what they hide of apertures from all of a ball.

The twin of ``meetings.cl`` and ``crossings.cl``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Bools, ByRow, Floats, Ints, spread
from clsim.scene.room.walls import INSIDE, Walls

Crossings = Callable[[Floats, Floats], tuple[Ints, Ints, Ints]]

BEHIND = 1e-9  # of the room's size, how far the space behind an aperture reaches before it
_SHORT = 1e-6  # of the room's size
_EVERYWHERE = np.array([0.0, 0.0, 0.0, -1.0])  # a half-space that holds all points


def beam_planes(
    centre: Floats, radius: float, ring: Floats, corners: NDArray[np.int64], normal: Floats, size: float
) -> Floats:
    """Return half-spaces (n, m + 1, 4) whose intersection holds all that a ball's rays reach behind an aperture.

    Rings (n, m, 3) are corners of convex apertures, counterclockwise about normals (n, 3); those beyond `corners` (n,)
    repeat the last one. Edges too short against the room's size, m, to have a direction give no plane.
    A ray from the ball through the aperture stays, behind it, on the inner side of the plane that holds an edge and
    touches the ball from the inner side. A ball that reaches through the aperture's plane has rays to both sides, and
    one that reaches an edge's line has rays in all directions through it: these give no plane.
    """
    count, sides = ring.shape[:2]
    planes = np.empty((count, sides + 1, 4))
    along = np.roll(ring, -1, axis=1) - ring
    last = np.arange(count), corners - 1
    along[last] = ring[:, 0] - ring[last]
    length = np.linalg.norm(along, axis=2)
    real = (np.arange(sides) < corners[:, None]) & (length > _SHORT * size)
    along /= np.where(real, length, 1.0)[..., None]
    away = centre[:, None] - ring
    away -= np.einsum("nmi,nmi->nm", away, along)[..., None] * along
    distance = np.linalg.norm(away, axis=2)
    real &= distance > radius
    distance = np.where(real, distance, 1.0)
    away /= distance[..., None]
    across = np.cross(along, away)
    inward = np.cross(np.broadcast_to(normal[:, None], along.shape), along)
    across *= np.where(np.einsum("nmi,nmi->nm", across, inward) < 0.0, -1.0, 1.0)[..., None]
    sine = np.where(real, radius / distance, 0.0)[..., None]
    planes[:, :sides, :3] = np.sqrt(1.0 - sine**2) * across - sine * away
    planes[:, :sides, 3] = np.einsum("nmi,nmi->nm", planes[:, :sides, :3], ring)
    planes[:, :sides][~real] = _EVERYWHERE
    height = np.einsum("ni,ni->n", centre - ring[:, 0], normal)
    behind = -np.sign(height)[:, None] * normal
    planes[:, sides, :3] = behind
    planes[:, sides, 3] = np.einsum("ni,ni->n", behind, ring[:, 0]) - BEHIND * size
    planes[np.abs(height) <= radius] = _EVERYWHERE
    return planes


def clip_rings(ring: Floats, corners: NDArray[np.int64], planes: Floats) -> tuple[Floats, NDArray[np.int64]]:
    """Return convex polygons (n, m, 3) cut by half-spaces (n, p, 4), many at a time (Sutherland and Hodgman)."""
    for p in range(planes.shape[1]):
        plane = planes[:, p]
        height = np.einsum("nmi,ni->nm", ring, plane[:, :3]) - plane[:, 3:]
        cut = np.flatnonzero((height < 0.0).any(axis=1))
        if len(cut):
            ring, corners = _cut(ring, corners, height, cut)
    return ring, corners


def _cut(
    ring: Floats, corners: NDArray[np.int64], height: Floats, cut: NDArray[np.int64]
) -> tuple[Floats, NDArray[np.int64]]:
    """Cut the polygons `cut` at height 0; keep what lies above."""
    points, high = ring[cut], height[cut]
    following = np.roll(points, -1, axis=1)
    following_high = np.roll(high, -1, axis=1)
    last = np.arange(len(cut)), np.maximum(corners[cut] - 1, 0)
    following[last], following_high[last] = points[:, 0], high[:, 0]
    exists = np.arange(ring.shape[1]) < corners[cut, None]
    stays = exists & (high >= 0.0)
    crosses = exists & ((high >= 0.0) != (following_high >= 0.0))
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.where(crosses, high / (high - following_high), 0.0)
    between = points + share[..., None] * (following - points)
    emitted = np.stack([stays, crosses], axis=2).reshape(len(cut), -1)
    source = np.stack([points, between], axis=2).reshape(len(cut), -1, 3)
    place = np.cumsum(emitted, axis=1) - 1
    count = place[:, -1] + 1
    width = max(ring.shape[1], int(count.max(initial=0)))
    made = np.zeros((len(cut), width, 3))
    row, column = np.nonzero(emitted)
    made[row, place[row, column]] = source[row, column]
    filled = np.minimum(np.arange(width), np.maximum(count - 1, 0)[:, None])
    ring, corners = widened(ring, width), corners.copy()
    ring[cut], corners[cut] = np.take_along_axis(made, filled[..., None], axis=1), count
    return ring, corners


def widened(ring: Floats, width: int) -> Floats:
    """Copy polygons (n, m, 3) with room for so many corners: those beyond the last one repeat it."""
    return ring[:, np.minimum(np.arange(width), ring.shape[1] - 1)]


_PAIRS = 20_000  # of beam, wall and receiver looked at at a time
INNER = 1e-9  # share of a segment at either end in which nothing blocks it
CLEARLY = 1e-6  # of the room's size, by which an obstacle covers what it hides: more than any tolerance of validity
# Directions that no wall is likely to lie along; where one of them meets an edge, the others outvote it.
_RAYS = np.array([[0.3607, 0.4783, 0.8007], [-0.7321, 0.5519, -0.3991], [0.5297, -0.8081, 0.2577]])
_ROUNDS = 5  # of taking hidden parts off apertures


@dataclass(frozen=True, slots=True, eq=False)
class Beams(ByRow):
    """n beams: what a ball lights through an aperture."""

    planes: Floats  # (n, p, 4) half-spaces that hold a beam; see `beam_planes`
    centre: Floats  # (n, 3) of the balls, m
    radius: float  # of all balls, m
    last: NDArray[np.int32]  # (n,) walls that the apertures are on
    slack: float  # by which walls are taken to be larger, m


@dataclass(frozen=True, slots=True, eq=False)
class Ears:
    """Spheres that hold R receivers, and what each sees."""

    centre: Floats  # (R, 3) of the spheres, m
    radius: Floats  # likewise
    seen: NDArray[np.bool_]  # (R, W) which walls each may see
    # (P, 4) half-spaces of the beams from each receiver through what it sees of each wall; see `beam_planes`.
    plane: Floats
    # (R * W + 1,) where those of receiver r and wall w begin, in row ``r * W + w``; none where it cannot see the wall.
    first_plane: Ints


@dataclass(eq=False)
class WallLookup:
    """Looks up walls in NumPy."""

    walls: Walls  # of the room

    def crossings(self, start: Floats, stop: Floats) -> tuple[Ints, Ints, Ints]:
        """Crossings (m,) of segments (n, 3) and walls strictly between their endpoints: segment, wall and its piece."""
        walls = self.walls
        tolerance = INSIDE * walls.size
        row, wall = walls.tree.meeting_segments(start, stop, tolerance)
        normal, offset = walls.normal[wall], walls.offset[wall]
        before, behind = (np.einsum("ni,ni->n", x[row], normal) - offset for x in (start, stop))
        crosses = before * behind < 0.0
        share = before / np.where(crosses, before - behind, 1.0)
        some = np.flatnonzero(crosses & (share > INNER) & (share < 1.0 - INNER))
        row, wall, share = row[some], wall[some], share[some]
        point = start[row] + share[:, None] * (stop[row] - start[row])
        of, piece = spread(walls.first_piece, wall)
        line_of, line = spread(walls.first_line, piece)
        height = np.einsum("ni,ni->n", walls.line[line, :3], point[of[line_of]]) - walls.line[line, 3]
        holds = np.ones(len(piece), dtype=bool)
        holds[line_of[height < -tolerance]] = False
        return row[of[holds]], wall[of[holds]], piece[holds]

    def meetings(self, beams: Beams, sides: Ints, ears: Ears | None) -> tuple[Ints, Ints]:
        """Return pairs (m,) of a beam and a wall off its last plane; with `ears` those that a receiver sees."""
        walls = self.walls
        beam, wall = walls.tree.meeting_planes(beams.planes, beams.slack)
        height = np.einsum("ni,ni->n", beams.centre[beam], walls.normal[wall]) - walls.offset[wall]
        meets = (walls.plane[beams.last[beam]] != walls.plane[wall]) & (sides[wall] * height >= -beams.radius)
        beam, wall = beam[meets], wall[meets]
        if ears is None:
            return beam, wall
        leads = self._leads(beams, beam, wall, ears)
        return beam[leads], wall[leads]

    def air_sides(self, place: Floats) -> Ints:
        """Return the sides of walls on which paths from a place can be: 1 that of the normal, -1 the other, 0 both.

        A path crosses no wall, so that it stays outside of a closed shell, or within it, as its source does: rays from
        there cross the shell an even number of times, or an odd one.
        """
        walls = self.walls
        stop = place + _RAYS * (walls.size + np.linalg.norm(walls.centre - place, axis=1).max())
        ray, wall, _ = self.crossings(np.broadcast_to(place, stop.shape), stop)
        ray, wall = np.unique(np.stack([ray, wall]), axis=1)  # pieces of a wall can share a point
        crossings = np.zeros((len(_RAYS), int(walls.shell.max()) + 1), dtype=np.int64)
        np.add.at(crossings, (ray, walls.shell[wall]), 1)
        inside = np.sum(crossings % 2, axis=0) > len(_RAYS) // 2
        return np.asarray(np.where(inside[walls.shell], -walls.outward, walls.outward))

    def _leads(self, beams: Beams, beam: Ints, wall: Ints, ears: Ears) -> NDArray[np.bool_]:
        """Mask of beams that may reach a receiver by a wall."""
        walls, found, seen = self.walls, np.zeros(len(beam), dtype=bool), ears.seen
        some = np.flatnonzero(np.any(seen[:, wall], axis=0))
        step = max(1, _PAIRS // max(len(ears.radius), 1))
        for pair in (some[i : i + step] for i in range(0, len(some), step)):
            at, by = beam[pair], wall[pair]
            normal, plane = walls.normal[by], beams.planes[at]
            cosine = np.einsum("npi,ni->np", plane[..., :3], normal)
            mirrored = plane[..., :3] - 2.0 * cosine[..., None] * normal[:, None]
            away = plane[..., 3] - 2.0 * cosine * walls.offset[by, None]
            touched = np.all(mirrored @ ears.centre.T - away[..., None] >= -ears.radius, axis=1) & seen[:, by].T
            row, receiver = np.nonzero(touched)
            height = np.einsum("ni,ni->n", beams.centre[at[row]], normal[row]) - walls.offset[by[row]]
            image = beams.centre[at[row]] - 2.0 * height[:, None] * normal[row]
            of, index = spread(ears.first_plane, receiver * len(walls) + by[row])
            inside = np.einsum("ni,ni->n", image[of], ears.plane[index, :3]) - ears.plane[index, 3] >= -beams.radius
            leads = np.ones(len(row), dtype=bool)
            leads[of[np.flatnonzero(~inside)]] = False
            found[pair[row[leads]]] = True
        return found


def in_air(walls: Walls, sides: Ints, sequence: NDArray[np.int32], end: Floats) -> Bools:
    """Mask of paths (n,) from ends (n, 3), m, that meet each wall of their sequences (n, N) from its side, `air_sides`.

    A wall holds points that are within a tolerance beyond its outline, so that what grazes another face of a closed
    shell may meet it there from behind for some microseconds.
    """
    met, image = np.ones(len(sequence), dtype=bool), end
    for wall in sequence.T:
        height = np.einsum("ni,ni->n", image, walls.normal[wall]) - walls.offset[wall]
        met &= sides[wall] * height >= 0.0
        image = image - 2.0 * height[:, None] * walls.normal[wall]
    return met


@dataclass(frozen=True, slots=True, eq=False)
class Views:
    """n apertures as seen from balls, some through windows."""

    centre: Floats  # (n, 3) of the balls, m
    radius: float  # of all balls, m
    # (n, m, 3) corners of convex windows through which the balls are seen, m; their centres where there are none.
    window: Floats
    last: Ints  # (n,) walls that the windows are on, -1 for none
    ring: Floats  # (n, k, 3) corners of convex apertures; those beyond `corners` repeat the last one
    corners: Ints  # (n,) number of corners
    wall: Ints  # (n,) walls that the apertures are on

    def part(self, rows: Ints, ring: Floats, corners: Ints) -> Views:
        """Return some of them with other apertures."""
        return Views(
            self.centre[rows], self.radius, self.window[rows], self.last[rows], ring[rows], corners[rows],
            self.wall[rows],
        )  # fmt: skip


def open_parts(walls: Walls, views: Views, crossings: Crossings) -> tuple[Floats, Ints]:
    """Return the apertures (n, k', 3), and their numbers of corners (n,), without what walls surely hide of them.

    What is taken away cannot be reached from anywhere in the ball, through the window, but through a wall, in neither
    of their planes, by clearly more than validity tolerates. Walls that are crossed on the way to the middle of an
    aperture are looked at. Of what lies beyond such a wall, the ball being before it, a convex piece of it hides what
    is on the inner side of a plane through each of its sides, which touches the ball from that side: rays from the ball
    to there cross the wall inside of this side. If one of these planes alone cuts the aperture, its outer side is left.
    """
    ring, corners = views.ring, views.corners.copy()
    rows = np.arange(len(ring))
    for _ in range(_ROUNDS):
        if not len(rows):
            break
        some = views.part(rows, ring, corners)
        view, plane, cuts = _shadows(walls, some, crossings)
        gone = np.zeros(len(rows), dtype=bool)
        gone[view[cuts == 0]] = True
        corners[rows[gone]] = 0
        cut = np.flatnonzero((cuts == 1) & ~gone[view])
        which, first = np.unique(view[cut], return_index=True)
        at = rows[which]
        left, count = clip_rings(ring[at], corners[at], plane[cut[first], None])
        ring = widened(ring, max(ring.shape[1], left.shape[1]))
        ring[at] = widened(left, ring.shape[1])
        corners[at] = np.where(count >= 3, count, 0)
        rows = at[count >= 3]
    return ring, corners


def _shadows(walls: Walls, views: Views, crossings: Crossings) -> tuple[Ints, Floats, Ints]:
    """Occlusion of apertures by walls: view, the outer half-space of a plane that cuts, and number of cuts, (n,)."""
    middle = views.ring.mean(axis=1)
    last, window = walls.normal[views.last], views.window[:, 0]
    high, low = (np.einsum("ni,ni->n", x - window, last) for x in (views.centre, middle))
    passes = (views.last >= 0) & (high * low < 0.0)
    share = np.where(passes, high / np.where(passes, high - low, 1.0), 0.0)  # at which the window is passed
    row, other, piece = crossings(np.asarray(views.centre + share[:, None] * (middle - views.centre)), middle)
    clearly = CLEARLY * walls.size
    normal, offset = walls.normal[other], walls.offset[other]
    side = np.where(np.einsum("ni,ni->n", middle[row], normal) < offset, -1.0, 1.0)
    normal, offset = side[:, None] * normal, side * offset
    beyond = np.einsum("nki,ni->nk", views.ring[row], normal).min(axis=1) - offset > clearly
    beyond &= np.einsum("nki,ni->nk", views.window[row], normal).max(axis=1) - offset < -clearly
    beyond &= np.einsum("ni,ni->n", views.centre[row], normal) - offset < -clearly - views.radius
    beyond &= (walls.plane[other] != walls.plane[views.wall[row]]) & (walls.plane[other] >= 0)
    beyond &= (views.last[row] < 0) | (walls.plane[other] != walls.plane[views.last[row]])
    row, piece, normal, offset = row[beyond], piece[beyond], normal[beyond], offset[beyond]
    of, line = spread(walls.first_line, piece)
    inward, at = walls.line[line, :3], row[of]
    centre = views.centre[at]
    # The centre from the side, which is moved inwards by the clearance: along the wall's plane, and before it.
    beside = np.einsum("ni,ni->n", centre, inward) - walls.line[line, 3] - clearly
    below = np.einsum("ni,ni->n", centre, normal[of]) - offset[of]
    away = beside[:, None] * inward + below[:, None] * normal[of]
    distance = np.hypot(beside, below)
    across = (-below[:, None] * inward + beside[:, None] * normal[of]) / distance[:, None]
    sine = views.radius / distance
    plane = np.empty((len(line), 4))
    plane[:, :3] = np.sqrt(1.0 - sine**2)[:, None] * across + (sine / distance)[:, None] * away
    plane[:, 3] = np.einsum("ni,ni->n", plane[:, :3], centre - away)
    visible = np.einsum("nki,ni->nk", views.ring[at], plane[:, :3]).min(axis=1) < plane[:, 3]
    cuts = np.bincount(of[visible], minlength=len(piece))
    outer = np.zeros((len(piece), 4))
    outer[of[visible]] = -plane[visible]
    return row, outer, cuts
