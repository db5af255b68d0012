"""Rooms and screens made for tests: vertices (V, 3) in m, z up, and triangles (T, 3).

Rooms are watertight, each edge between two triangles that turn the same way about the outward normal.
"""

from collections.abc import Sequence

import mapbox_earcut
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Mesh = tuple[Array, Ints]


def box(size: object) -> Mesh:
    """Return a room from the origin to `size`, of 12 triangles."""
    return cut_box(size, per_face=2)


def cut_box(size: object, per_face: int = 50) -> Mesh:
    """Return a room from the origin to `size`, each face cut into twice a square number of triangles."""
    n = round((per_face / 2) ** 0.5)
    if 2 * n * n != per_face:
        raise ValueError(f"per_face must be 2, 8, 18, 32, 50, ..., but is {per_face}")
    xs, ys, zs = (np.linspace(0, side, n + 1) for side in np.asarray(size, float))
    return _cells(xs, ys, zs, np.ones((n, n, n), dtype=np.bool_))


def l_room() -> Mesh:
    """Return a room 8 m by 9 m and 3 m high, without the corner x > 4, y > 5."""
    return _prism([[(0, 0), (8, 0), (8, 5), (4, 5), (4, 9), (0, 9)]], 3.0)


def pillar_room() -> Mesh:
    """Return a room 10 m by 8 m and 3 m high, around a pillar from (4.2, 3.1) to (5.2, 4.1)."""
    walls = [(0, 0), (10, 0), (10, 8), (0, 8)]
    pillar = [(4.2, 3.1), (4.2, 4.1), (5.2, 4.1), (5.2, 3.1)]
    return _prism([walls, pillar], 3.0)


def screen(corner: object, along: object, height: float) -> Mesh:
    """Return a thin open rectangle of 2 triangles: from a corner along a vector, and upwards."""
    corner, along, up = np.asarray(corner, float), np.asarray(along, float), np.array([0, 0, height])
    return np.array([corner, corner + along, corner + along + up, corner + up]), np.array([[0, 1, 2], [0, 2, 3]])


def hall(bays: int = 7) -> Mesh:
    """Return a nave of 4 m a bay, 9 to 12 m wide and 7 to 8 m high, that widens and rises along x.

    Each bay has a pilaster at either side with a beam across the ceiling, and a low niche between the pilasters; the
    last bay but one is a step up, the last another. 184 triangles a bay less 80, 4 planes a bay and 13; at least 3 bays.
    """
    xs = np.concatenate([4.0 * i + np.array([0.0, 0.7, 1.5, 3.1]) for i in range(bays)] + [[4.0 * bays]])
    ys = np.array([-6.0, -5.0, -4.6, 4.6, 5.0, 6.0])
    zs = np.array([0.0, 0.2, 0.4, 2.5, 7.0, 7.5])
    part, step = np.tile(np.arange(4), bays), np.repeat(np.arange(bays), 4) - (bays - 3)
    air = np.zeros((4 * bays, 5, 5), dtype=np.bool_)
    air[:, 2, :4] = True  # the nave
    air[part > 0, 2, 4] = True  # between the beams
    air[part > 0, 1:4:2, :4] = True  # between the pilasters
    air[part == 2, 0::4, :3] = True  # niches
    for rise in (1, 2):
        air[step >= rise, :, :rise] = False
    vertices, triangles = _cells(xs, ys, zs, air)
    # Planes of constant x, y or z stay planes, and those of y and z turn against each other.
    grow = 1 + 0.3 * vertices[:, :1] / xs[-1] * [[0, 1, 0.4]]
    return vertices * grow, triangles


def joined(*meshes: Mesh) -> Mesh:
    """Return several meshes as one."""
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in meshes)])
    triangles = [t + start for (_, t), start in zip(meshes, starts, strict=False)]
    return np.concatenate([vertices for vertices, _ in meshes]), np.concatenate(triangles)


def _cells(xs: Array, ys: Array, zs: Array, air: NDArray[np.bool_]) -> Mesh:
    """Return the boundary of the cells of a grid that hold air (X - 1, Y - 1, Z - 1): two triangles a face."""
    held = np.pad(air, 1)
    quads = []
    for axis in range(3):
        e, f = np.eye(3, dtype=np.int64)[[(axis + 1) % 3, (axis + 2) % 3]]
        jump = np.diff(held.astype(int), axis=axis)
        for sign in (1, -1):  # 1: air begins here, and outwards is against the axis
            low = np.argwhere(jump == sign)
            low -= 1 - np.eye(3, dtype=np.int64)[axis]  # from the padded grid to that of the corners
            ring = [0 * e, e, e + f, f]
            quads.append(np.stack([low + corner for corner in (ring if sign < 0 else ring[::-1])], axis=1))
    corners = np.concatenate(quads)  # (Q, 4, 3) indices of the grid
    unique, index = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    a, b, c, d = index.reshape(-1, 4).T
    vertices = np.stack([xs[unique[:, 0]], ys[unique[:, 1]], zs[unique[:, 2]]], axis=1)
    return vertices, np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])


def _prism(rings: Sequence[Sequence[tuple[float, float]]], height: float) -> Mesh:
    """Return the room above a plan: its outline turning left, then the outlines of holes turning right."""
    plan = np.array([point for ring in rings for point in ring], dtype=np.float64)
    ends = np.cumsum([len(ring) for ring in rings])
    ceiling = mapbox_earcut.triangulate_float64(plan, ends.astype(np.uint32)).astype(np.int64).reshape(-1, 3)
    p, q, r = (plan[ceiling[:, k]] for k in range(3))
    if np.sum((q - p)[:, 0] * (r - p)[:, 1] - (q - p)[:, 1] * (r - p)[:, 0]) < 0:
        ceiling = ceiling[:, ::-1]
    n = len(plan)
    this = np.arange(n)
    after = np.concatenate([np.roll(ring, -1) for ring in np.split(this, ends[:-1])])
    walls = [np.stack([this, after, after + n], axis=1), np.stack([this, after + n, this + n], axis=1)]
    vertices = np.concatenate([np.column_stack([plan, np.full(n, z)]) for z in (0.0, height)])
    return vertices, np.concatenate([ceiling[:, ::-1], ceiling + n, *walls])
