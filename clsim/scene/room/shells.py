"""Separate shells of a mesh: the outward side of closed ones, and thin panels as one layer whose edges diffract."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from clsim.arrays import unique_rows
from clsim.scene.room.mesh_cleaning import clusters, cross_products

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

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


_FLAT = 1e-3  # of a panel's thickness, by which its two sides may be uneven


def thin_panels(
    vertices: Floats, triangles: NDArray[np.int64], labels: Sequence[str], thinner_than: float
) -> tuple[Floats, NDArray[np.int64], NDArray[np.int64], list[str]]:
    """Return a mesh with one layer for every separate shell that is a flat panel and thin.

    Shapes: vertices, triangles (V, 3) m; result (V + X, 3) m, (U, 3), (U,).

    A panel is a shell all of whose corners lie in one of two planes along its largest triangle. Its layer is the one of
    its two sides that faces along that triangle's normal, moved half-way to the other.
    """
    made, moved, origin, notes = [], [vertices], [], []
    count = len(vertices)
    for mine, side, shift, thickness in _shells(vertices, triangles):
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
        for mine, _, _, thickness in _shells(vertices, triangles)
        if 0.0 < thickness < thinner_than
    ]


def _shells(
    vertices: Floats, triangles: NDArray[np.int64]
) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64], Floats, float]]:
    """Yield the triangles of every shell, and what `_side` says of them."""
    _, part = clusters(len(vertices), triangles[:, [0, 1, 1, 2]].reshape(-1, 2))
    shell, area = part[triangles[:, 0]], np.linalg.norm(cross_products(vertices[triangles]), axis=1)
    for one in np.unique(shell):
        mine = np.flatnonzero(shell == one)
        yield mine, *_side(vertices[triangles[mine]], area[mine])


def _side(corners: Floats, area: Floats) -> tuple[NDArray[np.int64], Floats, float]:
    """Return the triangles (n,) of one side of a panel, how to move them to its middle, and its thickness, m.

    The thickness is 0 of what is flat already, or no panel.
    """
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
