"""Triangle meshes: cleaning (welding, degenerate and doubled triangles), outward sides, thin panels, description."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from clsim.arrays import Floats, unique_rows

Ints = NDArray[np.int64]

_FLAT = 1e-3  # of a panel's thickness, by which its two sides may be uneven
_EVEN = 1e-3  # of the mesh's size, by which a sheet may be bent
_RAY = np.array([0.3607, 0.4783, 0.8007])  # a direction that no wall is likely to lie along
_HOLES_LISTED = 5


def outward_sides(
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
    directed = triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    _, _, which = unique_rows(np.sort(directed, axis=1))
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


def thin_panels(
    vertices: Floats, triangles: NDArray[np.int64], labels: Sequence[str], thinner_than: float
) -> tuple[Floats, NDArray[np.int64], NDArray[np.int64], list[str]]:
    """Return a mesh with one layer for every separate shell that is a flat panel and thin, and the origin of triangles.

    A panel is a shell all of whose corners lie in one of two planes along its largest triangle. Its layer is the one of
    its two sides that faces along the normal of that triangle, moved half-way to the other.
    """
    made, moved, origin, notes = [], [vertices], [], []
    count = len(vertices)
    for mine, side, shift, thickness in _panels(vertices, triangles):
        if not 0.0 < thickness < thinner_than:
            made.append(triangles[mine])
            origin.append(mine)
            continue
        corners, index = np.unique(triangles[mine[side]], return_inverse=True)
        moved.append(vertices[corners] + shift)
        made.append(count + index.reshape(-1, 3))
        origin.append(mine[side])
        count += len(corners)
        notes.append(f"{labels[mine[0]] or 'a panel'} of {1e3 * thickness:.3g} mm is taken as a sheet")
    return np.concatenate(moved), np.concatenate(made), np.concatenate(origin), notes


def panels_below(
    vertices: Floats, triangles: NDArray[np.int64], labels: Sequence[str], thinner_than: float
) -> list[tuple[str, float]]:
    """Return the names and thicknesses, m, of separate shells that are flat panels and thin."""
    return [
        (labels[mine[0]] or "a panel", thickness)
        for mine, _, _, thickness in _panels(vertices, triangles)
        if 0.0 < thickness < thinner_than
    ]


def _panels(
    vertices: Floats, triangles: NDArray[np.int64]
) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64], Floats, float]]:
    """Yield the triangles of every shell, and the result of `_side` for them."""
    _, part = clusters(len(vertices), triangles[:, [0, 1, 1, 2]].reshape(-1, 2))
    shell, area = part[triangles[:, 0]], np.linalg.norm(cross_products(vertices[triangles]), axis=1)
    for one in np.unique(shell):
        mine = np.flatnonzero(shell == one)
        yield mine, *_side(vertices[triangles[mine]], area[mine])


def _side(corners: Floats, area: Floats) -> tuple[NDArray[np.int64], Floats, float]:
    """Return triangles (n,) of one side of a panel, the shift (3,) to its middle, m, and its thickness, m."""
    # The thickness is 0 for a flat shell, or one that is no panel.
    largest = corners[np.argmax(area)]
    normal = np.cross(largest[1] - largest[0], largest[2] - largest[0])
    normal /= np.linalg.norm(normal)
    height = corners @ normal
    low, high = float(height.min()), float(height.max())
    thickness = high - low
    uneven = np.minimum(height - low, high - height).max()
    if uneven > _FLAT * thickness or thickness <= 0.0:
        return np.arange(0), normal, 0.0
    side = np.flatnonzero(np.all(height > 0.5 * (low + high), axis=1))
    return side, -0.5 * thickness * normal, thickness if len(side) else 0.0


def cross_products(corners: Floats) -> Floats:
    """Return the normals of triangles (n, 3, 3) with twice their areas as lengths, (n, 3) m²."""
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def clusters(count: int, pairs: NDArray[np.int64]) -> tuple[int, NDArray[np.int64]]:
    """Return number of clusters that pairs (n, 2) form among `count` items, and the cluster of each item."""
    graph = scipy.sparse.coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(count, count))
    found, cluster = scipy.sparse.csgraph.connected_components(graph, directed=False)
    return int(found), cluster.astype(np.int64)


@dataclass(frozen=True, slots=True, eq=False)
class MeshShape:
    """Connectivity of the triangles of a mesh."""

    open_edges: Floats  # (n, 2, 3) edges of an odd number of triangles that are no sheets, m
    crowded_edges: int  # edges of three triangles or more
    flipped_edges: int  # edges whose two triangles run in the same direction: one of them is flipped
    inwards: bool  # whether it is watertight and all triangles face inwards
    sheets: NDArray[np.bool_]  # (T,) of which triangles are flat sheets in a room that is closed without them

    @property
    def watertight(self) -> bool:
        """Whether every edge belongs to an even number of triangles, but for sheets."""
        return len(self.open_edges) == 0


def mesh_shape(vertices: Floats, triangles: NDArray[np.int64]) -> MeshShape:
    """Return connectivity of triangles on welded vertices."""
    directed = triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    edges, _, which = unique_rows(np.sort(directed, axis=1))
    sheets = _sheets(vertices, triangles, which)
    solid = np.repeat(~sheets, 3)
    uses = np.bincount(which)
    forward = np.bincount(which, weights=directed[:, 0] < directed[:, 1], minlength=len(edges))
    corners = vertices[triangles]
    volume = float(np.einsum("ti,ti->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6.0)
    opened = edges[np.bincount(which[solid], minlength=len(edges)) % 2 == 1]
    flipped = int(np.sum((uses == 2) & (forward != 1)))
    inwards = volume < 0.0 and not flipped and not len(opened) and not sheets.any()
    return MeshShape(vertices[opened], int(np.sum(uses > 2)), flipped, inwards, sheets)


def _sheets(vertices: Floats, triangles: NDArray[np.int64], which: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Find flat shells with open edges, (T,), if all others together are closed around them; none otherwise.

    which: the edge (3 T,) of every side. Shells hang together by edges of two triangles.
    """
    uses, owner = np.bincount(which), np.repeat(np.arange(len(triangles)), 3)
    none = np.zeros(len(triangles), dtype=bool)
    if not np.any(uses % 2 == 1):
        return none
    shared = np.flatnonzero((uses == 2)[which])
    pairs = owner[shared[np.argsort(which[shared], kind="stable")]].reshape(-1, 2)
    count, shell = clusters(len(triangles), pairs)
    opened = np.zeros(count, dtype=bool)
    opened[shell[owner[(uses == 1)[which]]]] = True
    normal = cross_products(vertices[triangles])
    size = np.ptp(vertices, axis=0).max()
    for one in np.flatnonzero(opened).tolist():
        mine = np.flatnonzero(shell == one)
        largest = mine[np.argmax(np.linalg.norm(normal[mine], axis=1))]
        along = normal[largest] / np.linalg.norm(normal[largest])
        opened[one] = np.ptp(vertices[triangles[mine]] @ along) <= _EVEN * size
    sheets = opened[shell]
    left = np.bincount(which[~sheets[owner]], minlength=len(uses))
    if sheets.all() or np.any(left % 2 == 1):
        return none
    middles = vertices[triangles[sheets]].mean(axis=1)
    return sheets if np.all(_surrounded(middles, vertices[triangles[~sheets]])) else none


def _surrounded(points: Floats, corners: Floats) -> NDArray[np.bool_]:
    """Return mask of points (n, 3) from which a ray leaves through an odd number of triangles (T, 3, 3)."""
    a, along, up = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    across = np.cross(_RAY, up)
    scale = np.einsum("ti,ti->t", along, across)
    scale = np.where(np.abs(scale) > 1e-300, scale, np.inf)
    found = np.zeros(len(points), dtype=bool)
    for i, point in enumerate(points):
        away = point - a
        turned = np.cross(away, along)
        u, v = np.einsum("ti,ti->t", away, across) / scale, turned @ _RAY / scale
        met = (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (np.einsum("ti,ti->t", up, turned) / scale > 0.0)
        found[i] = np.count_nonzero(met) % 2 == 1
    return found


def describe_mesh(
    vertices: Floats,
    triangles: NDArray[np.int64],
    plane_of_wall: NDArray[np.int64],
    shape: MeshShape,
    notes: tuple[str, ...],
) -> list[str]:
    """Return description of a mesh, a line per fact; see `MeshRoom.describe`."""
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    size = high - low
    lines = [
        f"{len(triangles)} triangles, {len(plane_of_wall)} walls in {plane_of_wall.max() + 1} planes, "
        f"{size[0]:.4g} x {size[1]:.4g} x {size[2]:.4g} m from ({low[0]:.4g}, {low[1]:.4g}, {low[2]:.4g}) m"
    ]
    directed = triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    edges, uses = np.unique(np.sort(directed, axis=1), axis=0, return_counts=True)
    shells, part = clusters(int(triangles.max()) + 1, edges)
    closed = shells - len(np.unique(part[edges[uses % 2 == 1, 0]]))
    if shells > 1:
        lines.append(f"{shells} separate shells, {closed} of them closed")
    sheets = f", but for sheets of {shape.sheets.sum()} triangles in it" if shape.sheets.any() else ""
    lines += [f"watertight{sheets}"] if shape.watertight else _openings(shape.open_edges)
    if shape.flipped_edges:
        lines.append(f"mixed winding at {shape.flipped_edges} edges; harmless, since walls are two-sided")
    elif shape.inwards:
        lines.append("all triangles face inwards; harmless, since walls are two-sided")
    return [f"room: {line}" for line in (*lines, *notes)]


def _openings(edges: Floats) -> list[str]:
    """Return description of the holes of a mesh from its open edges (n, 2, 3)."""
    holes = _holes(edges)
    around = f"{len(holes)} hole{'s' if len(holes) > 1 else ''}"
    lines = [f"open: {len(edges)} edges are not shared by two triangles, around {around}"]
    for centre, extent, count in holes[:_HOLES_LISTED]:
        at = ", ".join(f"{x:.4g}" for x in centre)
        across = " x ".join(f"{x:.4g}" for x in extent)
        lines.append(f"a hole of {count} edges at ({at}) m, {across} m")
    if len(holes) > _HOLES_LISTED:
        lines.append(f"and {len(holes) - _HOLES_LISTED} holes that are no larger")
    return lines


def _holes(edges: Floats) -> list[tuple[Floats, Floats, int]]:
    """Return centre, extent and number of edges of every hole, the largest first, from open edges (n, 2, 3)."""
    points, index = np.unique(edges.reshape(-1, 3), axis=0, return_inverse=True)
    pairs = index.reshape(-1, 2)
    count, part = clusters(len(points), pairs)
    found = []
    for i in range(count):
        mine = points[part == i]
        low, high = mine.min(axis=0), mine.max(axis=0)
        found.append((0.5 * (low + high), high - low, int(np.sum(part[pairs[:, 0]] == i))))
    return sorted(found, key=lambda hole: -float(np.linalg.norm(hole[1])))
