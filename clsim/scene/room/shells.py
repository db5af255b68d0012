"""Closed shells of a mesh: which side of a wall is outside."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from clsim.arrays import unique_rows
from clsim.scene.room.mesh_cleaning import clusters, cross_products

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Floats

    Ints = NDArray[np.int64]


def outward_sides(
    corners: Floats, triangles: Ints, neighbours: Ints, of_triangle: Ints, normal: Floats, crossing: Ints, level: Ints
) -> tuple[Ints, Ints]:
    """Return the shell that each wall belongs to, and on which side of it the outside of this shell is.

    Shapes: corners (T, 3, 3) m; triangles (T, 3); neighbours (n, 2); of_triangle (T,); normal (W, 3); crossing (m, 2);
    level (k, 2); result (W,), (W,).

    outward: 1 if the wall's normal points out of the shell, -1 if into it, and 0 where there is no such side: in a
    shell that is open, runs through itself, lies on itself the other way round, or whose triangles turn both ways.
    """
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
