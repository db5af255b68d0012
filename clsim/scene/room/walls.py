"""Walls: coplanar neighbouring triangles of one material, their outlines, and contacts of trajectories with them."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Floats, firsts, spread, unique_rows
from clsim.scene.room.faces import NEAREST
from clsim.scene.room.mesh_cleaning import clusters, cross_products, pairs_at_edges, sides_of
from clsim.scene.room.wall_pairs import WallTree, inwards, meeting, same_planes, straddling

Ints = NDArray[np.int64]

ON_LINE = 1e-9  # of the size; what is nearer to a line lies on it
FLATNESS = 1e-6  # m; triangles of a wall lie this near to its plane
INSIDE = 1e-9  # of the size; points this far outside a wall's outline still are on the wall
TOUCHING = 1e-6  # of the size; walls in one plane that are farther apart hold no point in common
_RANGE = 64  # positions taken together
_MOST_AT_EDGE = 4  # triangles at an edge, each pair of which are neighbours


def plane_of_each(corners: Floats, of_triangle: Ints) -> tuple[Floats, Floats]:
    """Return unit normals (W, 3) and offsets (W,), m, of the planes of the largest triangle (T, 3, 3) of each wall."""
    cross = cross_products(corners)
    area = np.linalg.norm(cross, axis=1)
    order = np.lexsort((np.arange(len(area)), -area, of_triangle))
    largest = order[firsts(np.bincount(of_triangle))[:-1]]
    normal = cross[largest] / area[largest, None]
    middle = corners[largest].mean(axis=1)
    return normal, np.array([float(m @ n) for m, n in zip(middle, normal, strict=True)])


def hulls(vertices: Floats, triangles: Ints, of_triangle: Ints, normal: Floats) -> tuple[Floats, Ints]:
    """Return the corners of the convex hulls of walls, counterclockwise about their normals, and where each begins."""
    along = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal), axis=1)])
    along /= np.array([np.linalg.norm(a) for a in along])[:, None]
    across = np.cross(normal, along)
    used, _, _ = unique_rows(np.stack([np.repeat(of_triangle, 3), triangles.ravel()], axis=1))
    first = firsts(np.bincount(used[:, 0]))
    rings = []
    for w in range(len(normal)):
        index = used[first[w] : first[w + 1], 1]
        points = vertices[index]
        rings.append(index[_ring(np.stack([points @ along[w], points @ across[w]], axis=1))])
    return vertices[np.concatenate(rings)], firsts(np.array([len(ring) for ring in rings]))


def _ring(flat: Floats) -> list[int]:
    """Return indices of points (n, 2) that are corners of their convex hull, counterclockwise."""
    sweep = np.lexsort((flat[:, 1], flat[:, 0])).tolist()
    points = flat.tolist()
    ring: list[int] = []
    for some in (sweep, sweep[::-1]):
        side: list[int] = []  # Andrew's monotone chain
        for i in some:
            while len(side) > 1 and _turn(points[side[-2]], points[side[-1]], points[i]) <= 1e-12:
                side.pop()
            side.append(i)
        ring += side[:-1]
    return ring


def _turn(a: list[float], b: list[float], c: list[float]) -> float:
    """Return the sine of the turn at b, times the length of the step to it (m)."""
    across = (b[0] - a[0]) * (c[1] - b[1]) - (b[1] - a[1]) * (c[0] - b[0])
    return across / max(math.hypot(c[0] - b[0], c[1] - b[1]), 1e-300)


def boundaries(vertices: Floats, triangles: Ints, of_triangle: Ints, normal: Floats) -> tuple[Floats, Ints]:
    """Return the edges (n, 2, 3) at which walls end, and where those of each begin."""
    # A wall ends where its triangles do not lie on both sides of an edge alike.
    edges = triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    low, high = vertices[edges.min(axis=1)], vertices[edges.max(axis=1)]
    other = vertices[triangles[:, [2, 0, 1]].ravel()]
    wall = np.repeat(of_triangle, 3)
    side = np.sign(np.einsum("ni,ni->n", np.cross(normal[wall], high - low), other - low))
    keys = np.column_stack([wall, edges.min(axis=1), edges.max(axis=1)])
    unique, _, which = unique_rows(keys)
    total = np.bincount(which, weights=side, minlength=len(unique))
    ends = unique[total != 0.0]
    return vertices[ends[:, 1:]], firsts(np.bincount(ends[:, 0], minlength=len(normal)))


def pieces(
    corners: Floats, of_triangle: Ints, normal: Floats, hull: Floats, first_hull: Ints, edge: Floats, first_edge: Ints,
    size: float,
) -> tuple[Floats, Ints, Ints]:  # fmt: skip
    """Return walls as convex pieces: their hulls where these fill them, else their triangles; result (L, 4)."""
    sides = np.diff(first_hull)
    lines = _lines(hull, first_hull, np.repeat(normal, sides, axis=0))
    filled = _filled(lines, first_hull, edge, first_edge, size)
    rings = corners.copy()
    turned = np.einsum("ti,ti->t", cross_products(corners), normal[of_triangle]) <= 0.0
    rings[turned] = rings[turned, ::-1]
    order = np.flatnonzero(~filled[of_triangle])
    order = order[np.argsort(of_triangle[order], kind="stable")]
    mine, three = of_triangle[order], firsts(np.full(len(order), 3))
    ring = rings[order].reshape(-1, 3)
    triangle_lines = _lines(ring, three, np.repeat(normal[mine], 3, axis=0))
    # Hulls and triangles, put in the order of their walls.
    whole = np.flatnonzero(filled)
    owner, length = np.concatenate([whole, mine]), np.concatenate([sides[whole], np.full(len(mine), 3)])
    start = np.concatenate([first_hull[whole], len(lines) + three[:-1]])
    place = np.argsort(owner, kind="stable")
    owner, length, start = owner[place], length[place], start[place]
    first_line = firsts(length)
    which = np.arange(first_line[-1]) + np.repeat(start - first_line[:-1], length)
    return np.concatenate([lines, triangle_lines])[which], first_line, firsts(np.bincount(owner, minlength=len(normal)))


def _lines(ring: Floats, first: Ints, normal: Floats) -> Floats:
    """Return inward unit normals and offsets of the sides of convex rings, counterclockwise about normals, (n, 4)."""
    inward = inwards(ring, first, normal)
    return np.concatenate([inward, np.sum(inward * ring, axis=1)[:, None]], axis=1)


def _filled(lines: Floats, first_line: Ints, edge: Floats, first_edge: Ints, size: float) -> NDArray[np.bool_]:
    """Return mask of walls that fill their hulls: each of their edges lies on a side of the hull."""
    count = np.diff(first_edge)
    wall = np.repeat(np.arange(len(count)), count)
    of, line = spread(first_line, wall)
    away = np.einsum("nei,ni->ne", edge[of], lines[line, :3]) - lines[line, 3:]
    on_line = np.zeros(len(wall), dtype=bool)
    on_line[of[np.all(np.abs(away) <= ON_LINE * size, axis=1)]] = True
    filled = np.ones(len(count), dtype=bool)
    filled[wall[~on_line]] = False
    return filled


@dataclass(frozen=True, slots=True, eq=False)
class Walls:
    """W flat walls. What a wall has several of stands in a row, from ``first_…[w]`` to ``first_…[w + 1]``."""

    # A wall is the union of convex pieces (P,), each bounded by lines (L, 4): x lies on a piece if ``line[:, :3] @ x >=
    # line[:, 3]`` for all of its lines.
    size: float  # diagonal of the bounding box, m
    normal: Floats  # (W, 3) plane ``normal @ x = offset``; the normal's sign means nothing
    offset: Floats  # likewise
    plane: NDArray[np.int64]  # (W,) equal for walls that lie in one plane; below 0 for those that hide nothing
    centre: Floats  # (W, 3) a ball that holds the wall, m
    radius: Floats  # likewise
    of_triangle: NDArray[np.int64]  # (T,) wall of each triangle
    hull: Floats  # (H, 3) corners of the convex hull, in order around the normal
    first_hull: NDArray[np.int64]  # likewise
    line: Floats  # (L, 4)
    first_line: NDArray[np.int64]  # (P + 1,)
    first_piece: NDArray[np.int64]  # (W + 1,)
    edge: Floats  # (E, 2, 3) segments that bound the wall, and those along which other walls run through it
    first_edge: NDArray[np.int64]
    twin: NDArray[np.int64]  # (X,) walls of lower index in the plane that touch it and own the points that both hold
    first_twin: NDArray[np.int64]
    shell: NDArray[np.int64]  # (W,) which shell each wall is of
    outward: NDArray[np.int64]  # (W,) 1 if its normal points out of this shell, -1 into it, 0 neither
    tree: WallTree  # boxes around walls and groups of them
    crossing: bool  # whether some walls run through each other

    def __len__(self) -> int:
        return len(self.offset)

    def hull_of(self, wall: int) -> Floats:
        """Return the corners of a wall's convex hull, (n, 3) m."""
        return self.hull[self.first_hull[wall] : self.first_hull[wall + 1]]

    def edges_of(self, wall: int) -> Floats:
        """Return the segments of a wall, (n, 2, 3) m."""
        return self.edge[self.first_edge[wall] : self.first_edge[wall + 1]]

    def holds(self, wall: int, points: Floats, beyond: float = INSIDE) -> NDArray[np.bool_]:
        # Points (n, 3) of the wall's plane; the mask is (n,).
        first, last = self.first_piece[wall], self.first_piece[wall + 1]
        lines = self.line[self.first_line[first] : self.first_line[last]]
        inside = points @ lines[:, :3].T - lines[:, 3] >= -beyond * self.size
        starts = self.first_line[first:last] - self.first_line[first]
        return np.asarray(np.any(np.logical_and.reduceat(inside, starts, axis=1), axis=1))


def build_walls(vertices: Floats, triangles: NDArray[np.int64], material: NDArray[np.int64], flatness: float) -> Walls:
    """Merge coplanar neighbours of one material (T,), triangles (T, 3) of vertices (V, 3) m, into walls."""
    # Neighbours are one wall if the corners of each lie within `flatness`, m, of the plane of the other.
    corners = vertices[triangles]
    size = float(np.linalg.norm(np.ptp(vertices, axis=0)))
    neighbours = pairs_at_edges(sides_of(triangles)[2], _MOST_AT_EDGE)
    of_triangle = _merge(corners, neighbours, material, flatness)
    normal, offset = plane_of_each(corners, of_triangle)
    hull, first_hull = hulls(vertices, triangles, of_triangle, normal)
    edge, first_edge = boundaries(vertices, triangles, of_triangle, normal)
    line, first_line, first_piece = pieces(corners, of_triangle, normal, hull, first_hull, edge, first_edge, size)
    plane = same_planes(normal, offset, hull, first_hull, size)
    low, high = (f.reduceat(hull, first_hull[:-1]) for f in (np.minimum, np.maximum))
    tree = WallTree.around(low, high)
    touching = np.stack(tree.meeting_boxes(low - TOUCHING * size, high + TOUCHING * size), axis=1)
    touching = touching[touching[:, 0] < touching[:, 1]]
    touching = touching[np.lexsort((touching[:, 1], touching[:, 0]))]
    level = plane[touching[:, 0]] == plane[touching[:, 1]]
    across = straddling(normal, offset, hull, first_hull, touching[~level], size)
    lines = [line[a:b] for a, b in itertools.pairwise(first_line)]
    crossings = []
    for pair in across:
        one, other = (lines[first_piece[w] : first_piece[w + 1]] for w in pair)
        segments = meeting(normal[pair], offset[pair], (one, other), size)
        if len(segments):
            crossings.append((pair, segments))
    edge, first_edge = _with_crossings(edge, first_edge, crossings)
    order = np.lexsort(touching[level].T)
    centre = 0.5 * (low + high)
    wall = np.repeat(np.arange(len(offset)), np.diff(first_hull))
    radius = np.maximum.reduceat(np.linalg.norm(hull - centre[wall], axis=1), first_hull[:-1])
    meets = np.array([pair for pair, _ in crossings], dtype=np.int64).reshape(-1, 2)
    shell, outward = _outward_sides(corners, triangles, neighbours, of_triangle, normal, meets, touching[level])
    return Walls(
        size, normal, offset, plane, centre, radius, of_triangle,
        hull, first_hull,
        line, first_line, first_piece,
        edge, first_edge,
        touching[level][order, 0], firsts(np.bincount(touching[level][:, 1], minlength=len(offset))),
        shell, outward, tree, bool(crossings),
    )  # fmt: skip


def _with_crossings(
    edge: Floats, first_edge: NDArray[np.int64], crossings: list[tuple[NDArray[np.int64], Floats]]
) -> tuple[Floats, NDArray[np.int64]]:
    """Return the edges of all walls with the lines along which pairs of them run through each other."""
    wall = np.repeat(np.arange(len(first_edge) - 1), np.diff(first_edge))
    owner = np.concatenate([wall, *(np.repeat(pair, len(lines)) for pair, lines in crossings)])
    every = np.concatenate([edge, *(lines for _, lines in crossings for _ in range(2))])
    return every[np.argsort(owner, kind="stable")], firsts(np.bincount(owner, minlength=len(first_edge) - 1))


def _merge(
    corners: Floats, neighbours: NDArray[np.int64], material: NDArray[np.int64], flatness: float
) -> NDArray[np.int64]:
    """Return the wall of each triangle, (T,), numbered in the order of their first triangles."""
    normal = cross_products(corners)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    a, b = neighbours.T

    def near(i: NDArray[np.int64], j: NDArray[np.int64]) -> NDArray[np.bool_]:
        away = np.einsum("nci,ni->nc", corners[j] - corners[i][:, :1], normal[i])
        return np.asarray(np.abs(away).max(axis=1) <= flatness)

    together = near(a, b) & near(b, a) & (material[a] == material[b])
    together &= np.abs(np.sum(normal[a] * normal[b], axis=1)) > 0.999
    count, wall = clusters(len(corners), neighbours[together])
    # A chain of nearly coplanar triangles may bend: such walls are taken apart into triangles.
    plane, offset = plane_of_each(corners, wall)
    away = np.abs(np.einsum("tci,ti->tc", corners, plane[wall]) - offset[wall, None]).max(axis=1)
    bent = np.zeros(count, dtype=bool)
    bent[wall[away > 2.0 * flatness]] = True
    wall = np.where(bent[wall], count + np.arange(len(wall)), wall)
    _, first, again = np.unique(wall, return_index=True, return_inverse=True)
    rank = np.empty(len(first), dtype=np.int64)
    rank[np.argsort(first)] = np.arange(len(first))
    return rank[again.ravel()]


def _outward_sides(
    corners: Floats, triangles: Ints, neighbours: Ints, of_triangle: Ints, normal: Floats, crossing: Ints, level: Ints
) -> tuple[Ints, Ints]:
    """Return the shell (W,) of each wall, and the side (W,) of the wall on which the outside of this shell lies."""
    # The side is 1 if the normal of the wall points out of the shell, -1 if into it, and 0 where there is no such side:
    # in a shell that is open, runs through itself, lies on itself the other way round, or whose triangles turn both
    # ways. Shapes: corners (T, 3, 3) m; triangles (T, 3); neighbours (n, 2); crossing (m, 2); level (k, 2).
    count, of_face = clusters(len(triangles), neighbours)
    shell = np.empty(len(normal), dtype=np.int64)
    shell[of_triangle] = of_face
    good = np.ones(count, dtype=bool)
    directed, _, which = sides_of(triangles)
    uses = np.bincount(which)
    forward = np.bincount(which, weights=directed[:, 0] < directed[:, 1], minlength=len(uses))
    good[np.repeat(of_face, 3)[(uses[which] != 2) | (forward[which] != 1.0)]] = False
    turn = np.sign(np.einsum("ti,ti->t", cross_products(corners), normal[of_triangle]))
    most, least = np.full(len(normal), -1.0), np.ones(len(normal))
    np.maximum.at(most, of_triangle, turn)
    np.minimum.at(least, of_triangle, turn)
    good[shell[most != least]] = False
    faces = most[:, None] * normal
    opposed = level[np.sum(faces[level[:, 0]] * faces[level[:, 1]], axis=1) < 0.0]
    for pairs in (crossing, opposed):
        one, other = shell[pairs].T
        good[one[one == other]] = False
    about = corners - corners.reshape(-1, 3).mean(axis=0)
    volume = np.einsum("ti,ti->t", about[:, 0], np.cross(about[:, 1], about[:, 2]))
    outside = np.sign(np.bincount(of_face, weights=volume, minlength=count))
    return shell, (good[shell] * outside[shell] * most).astype(np.int64)


def first_contact(walls: Walls, positions: Floats) -> tuple[int, int] | None:
    """Return the first of positions (n, 3), m, on a wall or after which a wall is walked through, and that wall."""
    starts = np.arange(0, len(positions), _RANGE)
    low = np.minimum.reduceat(positions, starts)
    high = np.maximum.reduceat(positions, starts)
    after = positions[np.minimum(starts + _RANGE, len(positions) - 1)]
    low, high = np.minimum(low, after), np.maximum(high, after)
    centre, radius = 0.5 * (low + high), 0.5 * np.linalg.norm(high - low, axis=1) + NEAREST
    for i, first in enumerate(starts):
        near = np.abs(walls.normal @ centre[i] - walls.offset) <= radius[i]
        near &= np.linalg.norm(walls.centre - centre[i], axis=1) <= radius[i] + walls.radius
        met = [
            (int(first) + at, int(w))
            for w in np.flatnonzero(near)
            if (at := _contact(walls, int(w), positions[first : first + _RANGE + 1])) is not None
        ]
        if met:
            return min(met)
    return None


def walls_at(walls: Walls, position: Floats) -> NDArray[np.int64]:
    """Return the walls that a position (3,) is on."""
    near = np.flatnonzero(np.abs(walls.normal @ position - walls.offset) < NEAREST)
    return near[[bool(_near(walls, int(w), position[None])[0]) for w in near]]


def first_off(walls: Walls, wall: int, positions: Floats) -> int | None:
    """Return the first of positions (n, 3) in the plane of a wall that is on no wall of this plane."""
    held = np.zeros(len(positions), dtype=bool)
    for twin in np.flatnonzero(walls.plane == walls.plane[wall]):
        held |= walls.holds(int(twin), positions)
    return None if held.all() else int(np.argmin(held))


def _contact(walls: Walls, wall: int, positions: Floats) -> int | None:
    """Return the first of a few positions that is on a wall, or after which it is walked through."""
    height = positions @ walls.normal[wall] - walls.offset[wall]
    on = (np.abs(height) < NEAREST) & _near(walls, wall, positions)
    crosses = np.flatnonzero(height[:-1] * height[1:] < 0.0)
    share = height[crosses] / (height[crosses] - height[crosses + 1])
    hits = positions[crosses] + share[:, None] * (positions[crosses + 1] - positions[crosses])
    found = np.concatenate([np.flatnonzero(on), crosses[walls.holds(wall, hits)]])
    return int(found.min()) if len(found) else None


def _near(walls: Walls, wall: int, positions: Floats) -> NDArray[np.bool_]:
    """Return mask of positions over a wall, or beside it by less than `NEAREST`."""
    over = walls.holds(wall, positions)
    edges = walls.edges_of(wall)
    along = edges[:, 1] - edges[:, 0]
    away = positions[:, None] - edges[:, 0]
    share = np.clip(np.sum(away * along, axis=2) / np.sum(along * along, axis=1), 0.0, 1.0)
    apart = np.linalg.norm(away - share[..., None] * along, axis=2).min(axis=1, initial=np.inf)
    return np.asarray(over | (apart < NEAREST))
