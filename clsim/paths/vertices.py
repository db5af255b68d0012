"""Where paths leave, are reflected and arrive."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from typing import Any

    from numpy.typing import NDArray

    from clsim.arrays import Floats


def path_vertices(
    planes: tuple[Floats, Floats], walls: NDArray[np.signedinteger[Any]], source: Floats, receiver: Floats
) -> Floats:
    """Return the corners of paths from their sources by their walls to a receiver.

    Parameters
    ----------
    planes : tuple of ndarray (W, 3), (W,)
        Unit normals and offsets of all walls, m.
    walls : ndarray (P, N) int
        Walls of each path from the source's side, filled up with -1.
    source, receiver : ndarray (P, 3)
        Where each path was emitted, and is received, m.

    Returns
    -------
    ndarray (P, N + 2, 3)
        Source, points of reflection, receiver, and NaN where a path has fewer walls.
    """
    normal, offset = planes
    count, most = walls.shape
    image = np.empty((count, most + 1, 3))
    image[:, 0] = source
    for k in range(most):
        wall = walls[:, k]
        height = np.einsum("pi,pi->p", image[:, k], normal[wall]) - offset[wall]
        image[:, k + 1] = image[:, k] - 2.0 * np.where(wall >= 0, height, 0.0)[:, None] * normal[wall]
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
