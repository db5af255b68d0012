"""Volume of a room, and areas and materials of its walls."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from clsim.scene.room.shoebox import Shoebox

if TYPE_CHECKING:
    from clsim.arrays import Floats
    from clsim.scene.material.material import Material
    from clsim.scene.room.protocol import Room


def enclosure_of(room: Room) -> tuple[float | None, Floats, tuple[Material, ...]]:
    """Return the enclosed volume, m³, None of a room that is not closed, and areas, m², and materials of its walls."""
    if isinstance(room, Shoebox):  # every plan asks: no mesh is made
        x, y, z = room.size.tolist()
        return x * y * z, np.array([y * z, y * z, x * z, x * z, x * y, x * y]), room.faces.materials
    mesh = room.as_mesh()
    corners = mesh.vertices[mesh.triangles]
    sides = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    triangles = 0.5 * np.linalg.norm(sides, axis=1)
    materials = mesh.faces.materials
    areas: Floats = np.bincount(mesh.walls.of_triangle, triangles, minlength=len(materials)).astype(np.float64)
    return mesh.volume, areas, materials
