"""Walls: coplanar neighbouring triangles of one material, and what is needed to meet them with rays."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from clsim.arrays import firsts
from clsim.scene.room.mesh_cleaning import clusters, cross_products
from clsim.scene.room.outlines import boundaries, hulls, pieces, plane_of_each
from clsim.scene.room.shells import outward_sides
from clsim.scene.room.wall_pairs import meeting, same_planes, straddling, touching_pairs
from clsim.scene.room.wall_tree import WallTree

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Floats

FLATNESS = 1e-6  # m; triangles of a wall lie this near to its plane
INSIDE = 1e-9  # of the size; points this far outside a wall's outline still are on the wall
TOUCHING = 1e-6  # of the size; walls in one plane that are farther apart hold no point in common


@dataclass(frozen=True, slots=True, eq=False)
class Walls:
    """W flat walls. What a wall has several of stands in a row, from ``first_…[w]`` to ``first_…[w + 1]``.

    Attributes
    ----------
    line, first_line, first_piece : ndarray (L, 4), (P + 1,), (W + 1,)
        A wall is the union of convex pieces; x lies on a piece if ``line[:, :3] @ x >= line[:, 3]`` for all its
        lines.
    edge, first_edge : ndarray (E, 2, 3), (W + 1,)
        Ends of the segments that bound the wall, and of those along which other walls run through it.
    twin, first_twin : ndarray (X,), (W + 1,)
        Walls of lower index in the same plane that touch it: they own the points that both hold.
    shell, outward : ndarray (W,) int
        Which shell the wall is of, and whether its normal points out of this shell, 1, into it, -1, or neither, 0;
        see `outward_sides`.
    """

    size: float  # diagonal of the bounding box, m
    normal: Floats  # (W, 3) plane ``normal @ x = offset``; the normal's sign means nothing
    offset: Floats  # likewise
    plane: NDArray[np.int64]  # (W,) equal for walls that lie in one plane
    centre: Floats  # (W, 3) a ball that holds the wall, m
    radius: Floats  # likewise
    of_triangle: NDArray[np.int64]  # (T,) wall of each triangle
    hull: Floats  # (H, 3) corners of the convex hull, in order around the normal
    first_hull: NDArray[np.int64]  # likewise
    line: Floats
    first_line: NDArray[np.int64]
    first_piece: NDArray[np.int64]
    edge: Floats
    first_edge: NDArray[np.int64]
    twin: NDArray[np.int64]
    first_twin: NDArray[np.int64]
    shell: NDArray[np.int64]
    outward: NDArray[np.int64]
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

    def holds(self, wall: int, points: Floats) -> NDArray[np.bool_]:
        """Return which points (n, 3) of a wall's plane lie on the wall, (n,)."""
        first, last = self.first_piece[wall], self.first_piece[wall + 1]
        lines = self.line[self.first_line[first] : self.first_line[last]]
        inside = points @ lines[:, :3].T - lines[:, 3] >= -INSIDE * self.size
        starts = self.first_line[first:last] - self.first_line[first]
        return np.asarray(np.any(np.logical_and.reduceat(inside, starts, axis=1), axis=1))


def build_walls(vertices: Floats, triangles: NDArray[np.int64], material: NDArray[np.int64], flatness: float) -> Walls:
    """Merge coplanar neighbours of one material into walls.

    Shapes: vertices (V, 3) m; triangles (T, 3); material (T,).

    flatness: neighbours are one wall if the corners of each lie this near to the plane of the other, m.
    """
    corners = vertices[triangles]
    size = float(np.linalg.norm(np.ptp(vertices, axis=0)))
    neighbours = _neighbours(triangles)
    of_triangle = _merge(corners, neighbours, material, flatness)
    normal, offset = plane_of_each(corners, of_triangle)
    hull, first_hull = hulls(vertices, triangles, of_triangle, normal)
    edge, first_edge = boundaries(vertices, triangles, of_triangle, normal)
    line, first_line, first_piece = pieces(corners, of_triangle, normal, hull, first_hull, edge, first_edge, size)
    plane = same_planes(normal, offset, hull, first_hull, size)
    low, high = (f.reduceat(hull, first_hull[:-1]) for f in (np.minimum, np.maximum))
    tree = WallTree.around(low, high)
    touching = touching_pairs(tree, low, high, TOUCHING * size)
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
    shell, outward = outward_sides(corners, triangles, neighbours, of_triangle, normal, meets, touching[level])
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


def _neighbours(triangles: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return pairs (n, 2) of triangles that share an edge."""
    edges = np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    owner = np.repeat(np.arange(len(triangles)), 3)
    order = np.lexsort((edges[:, 1], edges[:, 0]))
    edges, owner = edges[order], owner[order]
    pairs = []
    for apart in (1, 2, 3):  # an edge of up to four triangles: each pair of them
        same = np.all(edges[apart:] == edges[:-apart], axis=1)
        pairs.append(np.stack([owner[:-apart][same], owner[apart:][same]], axis=1))
    return np.concatenate(pairs)
