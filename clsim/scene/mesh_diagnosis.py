"""What is worth knowing about a mesh before it is used as a room."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from clsim.arrays import Floats
    from clsim.scene.mesh_room import MeshRoom

_LARGEST, _SMALLEST = 300.0, 0.2  # m, beyond which a room is likely to be in other units
_HOLES_LISTED = 5


def diagnose(room: MeshRoom) -> list[str]:
    """Return what a mesh is like, a line each: size, walls, holes, winding, repairs."""
    low, high = room.extent
    size = high - low
    lines = [
        f"room: {len(room.triangles)} triangles, {len(room.walls)} walls in {room.walls.plane.max() + 1} planes, "
        f"{size[0]:.4g} x {size[1]:.4g} x {size[2]:.4g} m from ({low[0]:.4g}, {low[1]:.4g}, {low[2]:.4g}) m"
    ]
    if size.max() > _LARGEST:
        lines.append(f"room: {size.max():.4g} m is large; if the file is in millimetres, say scale = 0.001")
    if size.max() < _SMALLEST:
        lines.append(f"room: {size.max():.4g} m is small; if the file is in kilometres or inches, say so by scale")
    shape = room.shape
    if shape.watertight:
        lines.append("room: watertight")
    else:
        holes = _holes(shape.open_edges)
        lines.append(f"room: open: {len(shape.open_edges)} edges belong to one triangle, around {len(holes)} holes")
        for centre, extent, edges in holes[:_HOLES_LISTED]:
            at = ", ".join(f"{x:.4g}" for x in centre)
            across = " x ".join(f"{x:.4g}" for x in extent)
            lines.append(f"room: a hole of {edges} edges at ({at}) m, {across} m")
    if shape.flipped_edges:
        lines.append(f"room: mixed winding at {shape.flipped_edges} edges; harmless, since walls are two-sided")
    elif shape.watertight and shape.volume < 0.0:
        lines.append("room: all triangles face inwards; harmless, since walls are two-sided")
    return lines + [f"room: {note}" for note in room.notes]


def _holes(edges: Floats) -> list[tuple[Floats, Floats, int]]:
    """Return centre, extent and number of edges of every hole, the largest first, from open edges (n, 2, 3)."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    points, index = np.unique(edges.reshape(-1, 3), axis=0, return_inverse=True)
    pairs = index.reshape(-1, 2)
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(points),) * 2)
    count, part = connected_components(graph, directed=False)
    found = []
    for i in range(count):
        mine = points[part == i]
        low, high = mine.min(axis=0), mine.max(axis=0)
        found.append((0.5 * (low + high), high - low, int(np.sum(part[pairs[:, 0]] == i))))
    return sorted(found, key=lambda hole: -float(np.linalg.norm(hole[1])))
