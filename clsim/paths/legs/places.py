"""Where paths leave, are reflected and arrive."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Floats

_ROUNDING = 1e-9  # of shares of a path


def path_vertices(
    planes: tuple[Floats, Floats],
    walls: NDArray[np.signedinteger[Any]],
    source: Floats,
    receiver: Floats,
    through: NDArray[np.bool_] | None = None,
) -> Floats:
    """Return the corners of paths from their sources by their walls to a receiver.

    Shapes: walls, through (P, N); source, receiver (P, 3) m.

    through: which walls paths pass straight through; all are then in the order in which they are met.

    walls: walls of each path from the source's side, filled up with -1; those at right angles to each other, as in a
    shoebox, may stand in another order than they are met in.

    result: source, points of reflection, receiver, and NaN where a path has fewer walls.
    """
    normal, offset = planes
    if through is None:
        walls = _in_order(planes, walls, source, receiver)
    mirrors = walls >= 0 if through is None else (walls >= 0) & ~through
    count, most = walls.shape
    image = np.empty((count, most + 1, 3))
    image[:, 0] = source
    for k in range(most):
        wall = walls[:, k]
        height = np.einsum("pi,pi->p", image[:, k], normal[wall]) - offset[wall]
        image[:, k + 1] = image[:, k] - 2.0 * np.where(mirrors[:, k], height, 0.0)[:, None] * normal[wall]
    vertices = np.full((count, most + 2, 3), np.nan)
    order = np.sum(walls >= 0, axis=1)
    vertices[:, 0] = source
    vertices[np.arange(count), order + 1] = receiver
    at = np.array(receiver, dtype=np.float64)
    for k in range(most, 0, -1):
        rows = np.flatnonzero(order >= k)
        wall = walls[rows, k - 1]
        near = np.einsum("pi,pi->p", at[rows], normal[wall]) - offset[wall]
        far = np.einsum("pi,pi->p", image[rows, k], normal[wall]) - offset[wall]
        with np.errstate(divide="ignore", invalid="ignore"):
            share = np.where(near == far, 0.5, near / (near - far))  # both in the wall: along it
        at[rows] += share[:, None] * (image[rows, k] - at[rows])
        vertices[rows, k] = at[rows]
    return vertices


def _in_order(
    planes: tuple[Floats, Floats], walls: NDArray[np.signedinteger[Any]], source: Floats, receiver: Floats
) -> NDArray[np.signedinteger[Any]]:
    """Return the walls (P, N) of each path in the order in which the unfolded path meets them."""
    count, most = walls.shape
    if most < 2:
        return walls
    normal, offset = (np.concatenate([x, np.zeros_like(x[:1])]) for x in planes)
    image, share = np.array(np.broadcast_to(receiver, (count, 3))), np.full(walls.shape, np.inf)
    for k in range(most - 1, -1, -1):  # the receiver as the source sees it by the walls from here on
        met = walls[:, k]
        image = image - 2.0 * (np.sum(image * normal[met], axis=1) - offset[met])[:, None] * normal[met]
    at, seen = np.array(np.broadcast_to(source, (count, 3))), image
    for k in range(most):  # both as they are seen behind the walls up to here
        met = walls[:, k]
        near, far = (np.sum(x * normal[met], axis=1) - offset[met] for x in (at, seen))
        apart = near - far
        share[:, k] = np.where(met >= 0, near / np.where(apart == 0.0, 1.0, apart), np.inf)
        at, seen = (x - 2.0 * h[:, None] * normal[met] for x, h in ((at, near), (seen, far)))
    late = np.any(share[:, 1:] < share[:, :-1] - _ROUNDING, axis=1)
    if not late.any():
        return walls
    order = np.where(late[:, None], np.argsort(share, axis=1, kind="stable"), np.arange(most))
    return np.take_along_axis(walls, order, axis=1)
