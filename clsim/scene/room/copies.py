"""Meshes without repetition: vertices welded, triangles without area and copies of others left out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Floats, unique_rows
from clsim.errors import InputError
from clsim.scene.room.mesh_cleaning import clusters, cross_products

Ints = NDArray[np.int64]

WELD = 1e-6  # m; vertices nearer than this are one
SMALLEST_AREA = 1e-12  # m²
_BENT = 1e-3  # of the size of triangles, by which those of one plane may leave it
_MOST_AT_EDGE = 32  # triangles at an edge that are compared
_SAME = 1e-6  # of an area, between that of a copy and that of what it covers


@dataclass(frozen=True, slots=True, eq=False)
class CleanMesh:
    """Triangles on shared vertices."""

    vertices: Floats  # (V, 3) m, each used by a triangle
    triangles: NDArray[np.int64]  # (T, 3) indices of corners
    kept: NDArray[np.int64]  # (T,) row of each triangle before cleaning
    notes: tuple[str, ...]  # what was repaired


def clean_mesh(vertices: Floats, triangles: NDArray[np.int64]) -> CleanMesh:
    """Weld vertices (V, 3), m, by position, and drop triangles (T, 3) without area and copies of others."""
    unique, _, which = unique_rows(vertices)
    vertex, welded = _weld(unique)
    corners = vertex[which][triangles]
    notes = []
    area = 0.5 * np.linalg.norm(cross_products(welded[corners]), axis=1)
    flat = area <= SMALLEST_AREA
    if flat.any():
        notes.append(f"{flat.sum()} triangles without area were dropped, the first is face {np.flatnonzero(flat)[0]}")
    kept = np.flatnonzero(~flat)
    if not len(kept):
        raise InputError("triangles", f"must have an area, but all {len(triangles)} have none")
    once = kept[without_copies(welded, corners[kept])]
    if len(once) < len(kept):
        notes.append(f"{len(kept) - len(once)} triangles that lay on others were dropped")
    kept = once
    used, corners = np.unique(corners[kept], return_inverse=True)
    return CleanMesh(welded[used], corners.reshape(-1, 3).astype(np.int64), kept, tuple(notes))


def _weld(points: Floats) -> tuple[NDArray[np.int64], Floats]:
    """Return the index of each point's cluster, and one place per cluster."""
    from scipy.spatial import cKDTree

    count, cluster = clusters(len(points), cKDTree(points).query_pairs(WELD, output_type="ndarray"))
    places = np.empty((count, 3))
    places[cluster[::-1]] = points[::-1]
    return cluster, places


def without_copies(vertices: Floats, triangles: Ints) -> Ints:
    """Rows of the triangles (T, 3), on welded vertices (V, 3), m, that are no copies of earlier ones.

    Copies have the same corners, or cover together the same region of a plane, whatever the diagonals of both. Of the
    latter, faces of shells that touch are kept, as of crates on each other: without them edges would be open.
    """
    once = np.sort(unique_rows(np.sort(triangles, axis=1))[1])
    return once[~_copies(vertices, triangles[once])]


def _copies(vertices: Floats, triangles: Ints) -> NDArray[np.bool_]:
    """Mask of the triangles that cover together what earlier ones cover."""
    found = np.zeros(len(triangles), dtype=bool)
    edge, pairs = _pairs(triangles)
    flat, folded = _in_one_plane(vertices, triangles, edge, pairs)
    if folded.any():
        _, patch = clusters(len(triangles), pairs[flat])
        for one in np.unique(patch[pairs[folded, 0]]).tolist():
            mine = np.flatnonzero(patch == one)
            found[mine[_covered(vertices[triangles[mine]])]] = True
        _keep_touching(found, edge, pairs)
    return found


def _pairs(triangles: Ints) -> tuple[Ints, Ints]:
    """Find the edge (T, 3) of each side, from a corner to the next, and pairs (n, 2) of triangles at one edge."""
    sides = triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    edge = unique_rows(np.sort(sides, axis=1))[2]
    order = np.argsort(edge, kind="stable")
    ranked, pairs = edge[order], [np.zeros((0, 2), dtype=np.int64)]
    for step in range(1, min(_MOST_AT_EDGE, int(np.bincount(edge).max()))):
        same = np.flatnonzero(ranked[step:] == ranked[:-step])
        pairs.append(np.stack([order[same], order[same + step]], axis=1) // 3)
    return edge.reshape(-1, 3), np.concatenate(pairs)


def _in_one_plane(
    vertices: Floats, triangles: Ints, edge: Ints, pairs: Ints
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Test pairs (n, 2) of triangles: whether they lie in one plane, and there on the same side of their edge."""
    corners = vertices[triangles]
    normal = cross_products(corners)
    area = np.linalg.norm(normal, axis=1)
    larger = np.argmax(area[pairs], axis=1)[:, None]
    one, other = (np.take_along_axis(pairs, side, axis=1)[:, 0] for side in (larger, 1 - larger))
    away = corners[other] - corners[one].mean(axis=1)[:, None]
    height = np.abs(np.einsum("nki,ni->nk", away, normal[one])).max(axis=1)
    level = height <= _BENT * area[one] * np.sqrt(area[one])
    shared = np.argmax(np.any(edge[one][:, :, None] == edge[other][:, None], axis=2), axis=1)
    begin, end = corners[one, shared], corners[one, (shared + 1) % 3]
    along = (end - begin) / np.linalg.norm(end - begin, axis=1)[:, None]
    beside = []
    for t in (one, other):
        middle = corners[t].mean(axis=1) - begin
        beside.append(middle - np.einsum("ni,ni->n", middle, along)[:, None] * along)
    onto = np.einsum("ni,ni->n", *beside) > 0.0
    return level, level & onto


def _covered(corners: Floats) -> Ints:
    """Rows of triangles (n, 3, 3), nearly of one plane, that cover together what earlier ones cover."""
    import shapely

    normal = cross_products(corners)
    size = np.linalg.norm(normal, axis=1)
    upright = normal[np.argmax(size)] / size.max()
    along = corners[np.argmax(size), 1] - corners[np.argmax(size), 0]
    axes = np.stack([along, np.cross(upright, along)]) / np.linalg.norm(along)
    local = corners - corners.mean(axis=(0, 1))
    if np.ptp(local @ upright) > _BENT * np.ptp(local, axis=(0, 1)).max():  # a chain of triangles that bends
        return np.zeros(0, dtype=np.int64)
    shapes = shapely.polygons(local @ axes.T)
    area = shapely.area(shapes)
    i, j = shapely.STRtree(shapes).query(shapes, predicate="intersects")
    i, j = i[i < j], j[i < j]
    both = shapely.area(shapely.intersection(shapes[i], shapes[j]))
    some = both > _SAME * np.minimum(area[i], area[j])
    i, j, both = i[some], j[some], both[some]
    layer = np.zeros(len(corners), dtype=np.int64)
    for t in np.unique(j).tolist():
        taken = set(layer[i[j == t]].tolist())
        layer[t] = next(n for n in range(len(taken) + 1) if n not in taken)
    found = []
    for n in range(1, int(layer.max()) + 1):
        low, high = np.where(layer[i] < layer[j], i, j), np.where(layer[i] < layer[j], j, i)
        of_layer = (layer[low] == 0) & (layer[high] == n)
        _, part = clusters(len(corners), np.stack([low[of_layer], high[of_layer]], axis=1))
        common = np.bincount(part[low[of_layer]], both[of_layer], minlength=len(corners))
        sums = [np.bincount(part, area * (layer == of), len(corners)) for of in (0, n)]
        same = (common > 0.0) & (np.maximum(*sums) - common <= _SAME * np.maximum(*sums))
        found.append(np.flatnonzero(same[part] & (layer == n)))
    return np.concatenate([np.zeros(0, dtype=np.int64), *found])


def _keep_touching(found: NDArray[np.bool_], edge: Ints, pairs: Ints) -> None:
    """Take back the copies, by parts that share edges, without which more edges are open than with them."""
    uses = np.bincount(edge.ravel())
    _, part = clusters(len(found), pairs[np.all(found[pairs], axis=1)])
    for one in np.unique(part[found]).tolist():
        mine = found & (part == one)
        left = uses - np.bincount(edge[mine].ravel(), minlength=len(uses))
        opened = np.count_nonzero((uses % 2 == 0) & (left % 2 == 1) & (left > 1))
        found[mine] = opened <= np.count_nonzero((uses % 2 == 1) & (left % 2 == 0))
