"""Walls: coplanar neighbouring triangles of one material, and what is needed to meet them with rays."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from clsim.scene.room.mesh_cleaning import clusters, cross_products

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Floats

FLATNESS = 1e-6  # m; triangles of a wall lie this near to its plane
SAME_PLANE = 1e-7  # of the size; walls nearer than this to each other's plane lie in one plane
INSIDE = 1e-9  # of the size; points this far outside a wall's outline still are on the wall


@dataclass(frozen=True, slots=True, eq=False)
class Walls:
    """W flat walls. What a wall has several of stands in a row, from ``first_…[w]`` to ``first_…[w + 1]``.

    Attributes
    ----------
    size : float
        Diagonal of the bounding box, m.
    normal, offset : ndarray (W, 3), (W,)
        Plane ``normal @ x = offset``; the normal's sign means nothing.
    plane : ndarray (W,) int
        Equal for walls that lie in one plane.
    centre, radius : ndarray (W, 3), (W,)
        A ball that holds the wall, m.
    of_triangle : ndarray (T,) int
        Wall of each triangle.
    hull, first_hull : ndarray (H, 3), (W + 1,)
        Corners of the convex hull, in order around the normal.
    line, first_line, first_piece : ndarray (L, 4), (P + 1,), (W + 1,)
        A wall is the union of convex pieces; x lies on a piece if ``line[:, :3] @ x >= line[:, 3]`` for all its lines.
    edge, first_edge : ndarray (E, 2, 3), (W + 1,)
        Ends of the segments that bound the wall, and of those along which other walls run through it.
    twin, first_twin : ndarray (X,), (W + 1,)
        Walls of lower index in the same plane: they own the points that both hold.
    """

    size: float
    normal: Floats
    offset: Floats
    plane: NDArray[np.int64]
    centre: Floats
    radius: Floats
    of_triangle: NDArray[np.int64]
    hull: Floats
    first_hull: NDArray[np.int64]
    line: Floats
    first_line: NDArray[np.int64]
    first_piece: NDArray[np.int64]
    edge: Floats
    first_edge: NDArray[np.int64]
    twin: NDArray[np.int64]
    first_twin: NDArray[np.int64]

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

    Parameters
    ----------
    vertices : ndarray (V, 3)
        Welded, m.
    triangles : ndarray (T, 3) int
        Indices of corners; none without area.
    material : ndarray (T,) int
        Of each triangle.
    flatness : float
        Neighbours are one wall if the corners of each lie this near to the plane of the other, m.
    """
    corners = vertices[triangles]
    size = float(np.linalg.norm(np.ptp(vertices, axis=0)))
    of_triangle = _merge(vertices, triangles, material, flatness)
    count = int(of_triangle.max()) + 1
    normal, offset = np.empty((count, 3)), np.empty(count)
    hulls, edges, pieces = [], [], []
    order = np.argsort(of_triangle, kind="stable")
    bounds = np.searchsorted(of_triangle[order], np.arange(count + 1))
    for w in range(count):
        mine = order[bounds[w] : bounds[w + 1]]
        normal[w], offset[w] = _plane(corners[mine])
        hulls.append(_hull(np.unique(triangles[mine]), vertices, normal[w]))
        edges.append(vertices[_boundary(vertices, triangles[mine], normal[w])])
        pieces.append(_pieces(corners[mine], hulls[-1], edges[-1], normal[w], size))
    plane = _planes(normal, offset, hulls, size)
    twins = [np.flatnonzero(plane[:w] == plane[w]) for w in range(count)]
    for a, b, segment in _crossings(normal, offset, hulls, pieces, plane, size):
        edges[a], edges[b] = np.concatenate([edges[a], segment]), np.concatenate([edges[b], segment])
    lines = [line for piece in pieces for line in piece]
    centre = np.array([0.5 * (h.min(axis=0) + h.max(axis=0)) for h in hulls])
    radius = np.array([np.linalg.norm(h - c, axis=1).max() for h, c in zip(hulls, centre, strict=True)])
    return Walls(
        size, normal, offset, plane, centre, radius, of_triangle,
        np.concatenate(hulls), _firsts(hulls),
        np.concatenate(lines), _firsts(lines), _firsts(pieces),
        np.concatenate(edges), _firsts(edges),
        np.concatenate(twins).astype(np.int64), _firsts(twins),
    )  # fmt: skip


def _firsts(parts: list[Floats] | list[NDArray[np.int64]] | list[list[Floats]]) -> NDArray[np.int64]:
    """Return where each part begins when they stand in a row, and the end."""
    return np.concatenate([[0], np.cumsum([len(p) for p in parts])]).astype(np.int64)


def _merge(
    vertices: Floats, triangles: NDArray[np.int64], material: NDArray[np.int64], flatness: float
) -> NDArray[np.int64]:
    """Return the wall of each triangle, (T,), numbered in the order of their first triangles."""
    corners = vertices[triangles]
    normal = cross_products(corners)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    a, b = _neighbours(triangles)

    def near(i: NDArray[np.int64], j: NDArray[np.int64]) -> NDArray[np.bool_]:
        away = np.einsum("nci,ni->nc", corners[j] - corners[i][:, :1], normal[i])
        return np.asarray(np.abs(away).max(axis=1) <= flatness)

    together = near(a, b) & near(b, a) & (material[a] == material[b])
    together &= np.abs(np.sum(normal[a] * normal[b], axis=1)) > 0.999
    count, wall = clusters(len(triangles), np.stack([a[together], b[together]], axis=1))
    order = np.argsort(wall, kind="stable")
    # A chain of nearly coplanar triangles may bend: such walls are taken apart into triangles.
    for mine in np.split(order, np.flatnonzero(np.diff(wall[order])) + 1):
        n, d = _plane(corners[mine])
        if np.abs(corners[mine].reshape(-1, 3) @ n - d).max() > 2.0 * flatness:
            wall[mine[1:]] = count + np.arange(len(mine) - 1)
            count += len(mine) - 1
    _, first, again = np.unique(wall, return_index=True, return_inverse=True)
    rank = np.empty(len(first), dtype=np.int64)
    rank[np.argsort(first)] = np.arange(len(first))
    return rank[again.ravel()]


def _neighbours(triangles: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return pairs of triangles that share an edge."""
    edges = np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    owner = np.repeat(np.arange(len(triangles)), 3)
    order = np.lexsort((edges[:, 1], edges[:, 0]))
    edges, owner = edges[order], owner[order]
    pairs = []
    for apart in (1, 2, 3):  # an edge of up to four triangles: each pair of them
        same = np.all(edges[apart:] == edges[:-apart], axis=1)
        pairs.append(np.stack([owner[:-apart][same], owner[apart:][same]]))
    a, b = np.concatenate(pairs, axis=1)
    return a, b


def _plane(corners: Floats) -> tuple[Floats, float]:
    """Return unit normal and offset of the largest triangle's plane, from (n, 3, 3)."""
    cross = cross_products(corners)
    area = np.linalg.norm(cross, axis=1)
    i = int(np.argmax(area))
    normal = cross[i] / area[i]
    return normal, float(corners[i].mean(axis=0) @ normal)


def _axes(normal: Floats) -> tuple[Floats, Floats]:
    """Return two unit vectors that span a plane, right-handed with its normal."""
    along = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    along /= np.linalg.norm(along)
    return along, np.cross(normal, along)


def _hull(index: NDArray[np.int64], vertices: Floats, normal: Floats) -> Floats:
    """Return the corners of the convex hull of a wall, counterclockwise about its normal, (n, 3)."""
    u, v = _axes(normal)
    points = vertices[index]
    flat = np.stack([points @ u, points @ v], axis=1)
    ring: list[int] = []
    for sweep in (np.lexsort((flat[:, 1], flat[:, 0])), np.lexsort((flat[:, 1], flat[:, 0]))[::-1]):
        side: list[int] = []  # Andrew's monotone chain
        for i in sweep.tolist():
            while len(side) > 1 and _turn(flat[side[-2]], flat[side[-1]], flat[i]) <= 1e-12:
                side.pop()
            side.append(i)
        ring += side[:-1]
    return points[ring]


def _turn(a: Floats, b: Floats, c: Floats) -> float:
    """Return the sine of the turn at b, times the length of the step to it (m)."""
    p, q = b - a, c - b
    return float((p[0] * q[1] - p[1] * q[0]) / max(float(np.hypot(q[0], q[1])), 1e-300))


def _boundary(vertices: Floats, triangles: NDArray[np.int64], normal: Floats) -> NDArray[np.int64]:
    """Return the edges (n, 2) at which a wall ends: those whose triangles do not lie on both sides of it alike."""
    edges = triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    low, high = vertices[edges.min(axis=1)], vertices[edges.max(axis=1)]
    other = vertices[triangles[:, [2, 0, 1]].ravel()]
    side = np.sign(np.einsum("ni,ni->n", np.cross(normal, high - low), other - low))
    unique, which = np.unique(np.sort(edges, axis=1), axis=0, return_inverse=True)
    total = np.bincount(which.ravel(), weights=side, minlength=len(unique))
    return np.asarray(unique[total != 0.0])


def _pieces(corners: Floats, hull: Floats, edges: Floats, normal: Floats, size: float) -> list[Floats]:
    """Return a wall as convex pieces: its hull if it fills it, else its triangles; each as lines (n, 4)."""
    lines = _lines(hull, normal)
    beyond = edges.reshape(-1, 3) @ lines[:, :3].T - lines[:, 3]
    on_line = np.abs(beyond.reshape(-1, 2, len(lines))) <= 1e-9 * size
    if np.all(np.any(np.all(on_line, axis=1), axis=1)):
        return [lines]
    cross = cross_products(corners) @ normal
    return [_lines(c if up > 0.0 else c[::-1], normal) for c, up in zip(corners, cross, strict=True)]


def _lines(ring: Floats, normal: Floats) -> Floats:
    """Return inward unit normals and offsets of the sides of a convex ring, counterclockwise, (n, 4)."""
    inward = np.cross(normal, np.roll(ring, -1, axis=0) - ring)
    inward /= np.linalg.norm(inward, axis=1, keepdims=True)
    return np.concatenate([inward, np.sum(inward * ring, axis=1)[:, None]], axis=1)


def _planes(normal: Floats, offset: Floats, hulls: list[Floats], size: float) -> NDArray[np.int64]:
    """Return numbers that are equal for walls in one plane."""
    count, first = len(offset), _firsts(hulls)
    corners = np.concatenate(hulls)
    near = np.empty((count, count), dtype=bool)  # near[w, o]: all corners of o lie in the plane of w
    for w in range(count):
        away = np.abs(corners @ normal[w] - offset[w])
        near[w] = np.maximum.reduceat(away, first[:-1]) <= SAME_PLANE * size
    return clusters(count, np.argwhere(near & near.T))[1]


def _crossings(
    normal: Floats,
    offset: Floats,
    hulls: list[Floats],
    pieces: list[list[Floats]],
    plane: NDArray[np.int64],
    size: float,
) -> list[tuple[int, int, Floats]]:
    """Return the segments (n, 2, 3) along which two walls run through each other."""
    low, high = (np.array([f(h, axis=0) for h in hulls]) for f in (np.min, np.max))
    found = []
    for a in range(len(hulls) - 1):
        others = np.arange(a + 1, len(hulls))
        meets = np.all((low[others] <= high[a]) & (high[others] >= low[a]), axis=1) & (plane[others] != plane[a])
        for b in others[meets]:
            if not all(
                np.ptp(np.sign(d) * (np.abs(d) > 1e-7 * size)) == 2
                for d in (hulls[b] @ normal[a] - offset[a], hulls[a] @ normal[b] - offset[b])
            ):
                continue
            segments = _meeting(normal[[a, b]], offset[[a, b]], pieces[a], pieces[b], size)
            if len(segments):
                found.append((a, int(b), segments))
    return found


def _meeting(normal: Floats, offset: Floats, one: list[Floats], other: list[Floats], size: float) -> Floats:
    """Return the parts (n, 2, 3) of two planes' common line that lie on a piece of each."""
    along = np.cross(normal[0], normal[1])
    along /= np.linalg.norm(along)
    point = np.linalg.solve(np.stack([normal[0], normal[1], along]), [offset[0], offset[1], 0.0])
    spans = [[s for s in (_span(point, along, lines) for lines in pieces) if s[1] > s[0]] for pieces in (one, other)]
    parts = [(max(a[0], b[0]), min(a[1], b[1])) for a in spans[0] for b in spans[1]]
    ends = np.array([p for p in parts if p[1] - p[0] > 1e-9 * size]).reshape(-1, 2)
    return np.asarray(point + ends[..., None] * along)


def _span(point: Floats, along: Floats, lines: Floats) -> tuple[float, float]:
    """Return the range of a line within a convex piece; empty if its end is not beyond its start."""
    slope, value = lines[:, :3] @ along, lines[:, :3] @ point - lines[:, 3]
    if np.any((np.abs(slope) < 1e-12) & (value < 0.0)):
        return 0.0, 0.0
    with np.errstate(divide="ignore", invalid="ignore"):
        at = -value / slope
    return (
        float(np.max(at[slope > 1e-12], initial=-np.inf)),
        float(np.min(at[slope < -1e-12], initial=np.inf)),
    )
