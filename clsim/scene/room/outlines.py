"""Outlines of walls: convex hulls, edges and convex pieces, of all walls at once."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from clsim.arrays import firsts, spread, unique_rows
from clsim.scene.room.mesh_cleaning import cross_products

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Floats

    Ints = NDArray[np.int64]

ON_LINE = 1e-9  # of the size; what is nearer to a line lies on it


def plane_of_each(corners: Floats, of_triangle: Ints) -> tuple[Floats, Floats]:
    """Return unit normals (W, 3) and offsets (W,) of the planes of the largest triangle of each wall.

    Shapes: corners (T, 3, 3) m; of_triangle (T,).
    """
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
    """Return which points (n, 2) are corners of their convex hull, counterclockwise."""
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
    """Return the edges (n, 2, 3) at which walls end, and where those of each begin.

    A wall ends where its triangles do not lie on both sides of an edge alike.
    """
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
    corners: Floats,
    of_triangle: Ints,
    normal: Floats,
    hull: Floats,
    first_hull: Ints,
    edge: Floats,
    first_edge: Ints,
    size: float,
) -> tuple[Floats, Ints, Ints]:
    """Return walls as convex pieces: their hulls where these fill them, else their triangles.

    Shapes: result (L, 4).
    """
    sides = np.diff(first_hull)
    lines = _lines(hull, _following(first_hull), np.repeat(normal, sides, axis=0))
    filled = _filled(lines, first_hull, edge, first_edge, size)
    rings = corners.copy()
    turned = np.einsum("ti,ti->t", cross_products(corners), normal[of_triangle]) <= 0.0
    rings[turned] = rings[turned, ::-1]
    order = np.flatnonzero(~filled[of_triangle])
    order = order[np.argsort(of_triangle[order], kind="stable")]
    mine, three = of_triangle[order], firsts(np.full(len(order), 3))
    ring = rings[order].reshape(-1, 3)
    triangle_lines = _lines(ring, _following(three), np.repeat(normal[mine], 3, axis=0))
    # Hulls and triangles, put in the order of their walls.
    whole = np.flatnonzero(filled)
    owner, length = np.concatenate([whole, mine]), np.concatenate([sides[whole], np.full(len(mine), 3)])
    start = np.concatenate([first_hull[whole], len(lines) + three[:-1]])
    place = np.argsort(owner, kind="stable")
    owner, length, start = owner[place], length[place], start[place]
    first_line = firsts(length)
    which = np.arange(first_line[-1]) + np.repeat(start - first_line[:-1], length)
    return np.concatenate([lines, triangle_lines])[which], first_line, firsts(np.bincount(owner, minlength=len(normal)))


def _following(first: Ints) -> Ints:
    """Return the index of the next corner of each corner of rings that stand in a row."""
    following = np.arange(1, first[-1] + 1)
    following[first[1:] - 1] = first[:-1]
    return following


def _lines(ring: Floats, following: Ints, normal: Floats) -> Floats:
    """Return inward unit normals and offsets of the sides of convex rings, counterclockwise about normals, (n, 4)."""
    inward = np.cross(normal, ring[following] - ring)
    inward /= np.linalg.norm(inward, axis=1, keepdims=True)
    return np.concatenate([inward, np.sum(inward * ring, axis=1)[:, None]], axis=1)


def _filled(lines: Floats, first_line: Ints, edge: Floats, first_edge: Ints, size: float) -> NDArray[np.bool_]:
    """Return which walls fill their hulls: each of their edges lies on a side of it."""
    count = np.diff(first_edge)
    wall = np.repeat(np.arange(len(count)), count)
    of, line = spread(first_line, wall)
    away = np.einsum("nei,ni->ne", edge[of], lines[line, :3]) - lines[line, 3:]
    on_line = np.zeros(len(wall), dtype=bool)
    on_line[of[np.all(np.abs(away) <= ON_LINE * size, axis=1)]] = True
    filled = np.ones(len(count), dtype=bool)
    filled[wall[~on_line]] = False
    return filled
