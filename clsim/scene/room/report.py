"""What is worth knowing about a mesh before it is used as a room."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from clsim.scene.room.mesh_cleaning import clusters

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Floats
    from clsim.scene.room.mesh_cleaning import MeshShape
    from clsim.scene.room.walls import Walls

_HOLES_LISTED = 5


def describe_mesh(
    vertices: Floats, triangles: NDArray[np.int64], walls: Walls, shape: MeshShape, notes: tuple[str, ...]
) -> list[str]:
    """Return what a mesh is like, a line each; see `MeshRoom.describe`.

    Shapes: vertices, triangles (V, 3) m.
    """
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    size = high - low
    lines = [
        f"{len(triangles)} triangles, {len(walls)} walls in {walls.plane.max() + 1} planes, "
        f"{size[0]:.4g} x {size[1]:.4g} x {size[2]:.4g} m from ({low[0]:.4g}, {low[1]:.4g}, {low[2]:.4g}) m"
    ]
    shells, closed = _shells(triangles)
    if shells > 1:
        lines.append(f"{shells} separate shells, {closed} of them closed")
    lines += ["watertight"] if shape.watertight else _openings(shape.open_edges)
    if shape.flipped_edges:
        lines.append(f"mixed winding at {shape.flipped_edges} edges; harmless, since walls are two-sided")
    elif shape.inwards:
        lines.append("all triangles face inwards; harmless, since walls are two-sided")
    return [f"room: {line}" for line in (*lines, *notes)]


def _shells(triangles: NDArray[np.int64]) -> tuple[int, int]:
    """Return how many parts a mesh has that share no vertex, and how many of those are watertight."""
    directed = triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    edges, uses = np.unique(np.sort(directed, axis=1), axis=0, return_counts=True)
    count, part = clusters(int(triangles.max()) + 1, edges)
    return count, count - len(np.unique(part[edges[uses % 2 == 1, 0]]))


def _openings(edges: Floats) -> list[str]:
    """Return where a mesh is open, from its open edges (n, 2, 3)."""
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
