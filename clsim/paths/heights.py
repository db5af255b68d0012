"""At which heights paths run: where they are bent, and the means of polynomials of the height along straight legs."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Floats

_BEYOND = 1.05  # half the room's height from its middle, beyond which the air is as it is there
_UPRIGHT = 1e-12  # vertical component of a wall's normal below which it leaves heights alone


class Folds:
    """Heights along paths by walls, whatever the places of their ends.

    Of the unfolded straight line, leg k is seen in the room from the source mirrored by the first k walls to the
    receiver mirrored back by the others; its height is linear in the share of the way, and both legs at a wall agree
    where it is met. Walls that stand upright bend no height.

    Shapes: walls (P, N).
    """

    def __init__(self, planes: tuple[Floats, Floats], walls: NDArray[np.signedinteger[Any]]) -> None:
        count, most = walls.shape
        normals = np.where((walls >= 0)[..., None], planes[0][walls], 0.0)
        offsets = np.where(walls >= 0, planes[1][walls], 0.0)
        forth, back = (np.tile(np.eye(4), (count, most + 1, 1, 1)) for _ in range(2))
        for k in range(most):
            forth[:, k + 1] = _mirror(normals[:, k], offsets[:, k]) @ forth[:, k]
        for k in range(most, 0, -1):
            back[:, k - 1] = _mirror(normals[:, k - 1], offsets[:, k - 1]) @ back[:, k]
        # Legs that begin at the source or at a wall that bends heights; the last one again where a path has fewer.
        bends = np.concatenate([np.ones((count, 1), dtype=bool), np.abs(normals[..., 2]) > _UPRIGHT], axis=1)
        legs = np.argsort(~bends, axis=1, kind="stable")[:, : int(bends.sum(axis=1).max(initial=1))]
        self._real = np.take_along_axis(bends, legs, axis=1)
        last = np.take_along_axis(legs, self._real.sum(axis=1, keepdims=True) - 1, axis=1)
        legs = np.where(self._real, legs, last)[:, :, None]
        self._forth, self._back = (np.take_along_axis(rows[:, :, 2], legs, axis=1) for rows in (forth, back))

    def bends(self, p: Any, start: Floats, stop: Floats) -> tuple[Floats, Floats]:
        """Bends of paths between places (..., 3), first and last, in the room.

        Shapes: start, stop (..., 3) m; result (..., legs + 1).
        """
        among = np.broadcast_shapes(start.shape, stop.shape)[1:-1]  # all times of a path, or none: one each
        spread = (slice(None), *[None] * len(among))
        forth, back, bent = (rows[p][spread] for rows in (self._forth, self._back, self._real))
        shape = (len(bent), *among)
        real = np.broadcast_to(bent, (*shape, bent.shape[-1]))
        first, last = (
            np.broadcast_to(np.einsum("...ki,...i->...k", rows[..., :3], place) + rows[..., 3], real.shape)
            for rows, place in ((forth, start), (back, stop))
        )
        shares = np.zeros((*shape, real.shape[-1] + 1))
        apart = first[..., :-1] - first[..., 1:]
        rise = apart - (last[..., :-1] - last[..., 1:])
        inner = np.where(rise == 0.0, 0.5, apart / np.where(rise == 0.0, 1.0, rise))
        shares[..., 1:-1] = np.where(real[..., 1:], inner, 1.0)
        shares[..., -1] = 1.0
        heights = np.empty_like(shares)
        heights[..., :-1] = first + shares[..., :-1] * (last - first)
        heights[..., -1] = last[..., -1]
        return shares, heights


def means_along(shares: Floats, heights: Floats, extent: tuple[float, float], terms: int) -> Floats:
    """Return the means of Chebyshev polynomials of the height over ways of straight legs.

    Shapes: shares, heights (..., legs + 1); result (... terms).

    extent: heights between which the polynomials are those of -1 to 1, m; a little beyond they stay as they are.
    """
    place, weight = np.polynomial.legendre.leggauss(terms // 2 + 1)
    scaled = (2.0 * heights - (extent[0] + extent[1])) / (extent[1] - extent[0])
    low, change = scaled[..., :-1, None], np.diff(scaled, axis=-1)[..., None]
    u = np.clip(low + 0.5 * (1.0 + place) * change, -_BEYOND, _BEYOND)
    weights = 0.5 * np.diff(shares, axis=-1)[..., None] * weight
    means, before, now = np.empty((*shares.shape[:-1], terms)), np.ones_like(u), u
    for i in range(terms):
        means[..., i] = np.sum(weights * before, axis=(-2, -1))
        before, now = now, 2.0 * u * now - before
    return means


def _mirror(normal: Floats, offset: Floats) -> Floats:
    """Return matrices (P, 4, 4) that mirror (x, y, z, 1) by planes; those of no normal do nothing."""
    matrix = np.tile(np.eye(4), (len(normal), 1, 1))
    matrix[:, :3, :3] -= 2.0 * normal[:, :, None] * normal[:, None, :]
    matrix[:, :3, 3] = 2.0 * offset[:, None] * normal
    return matrix
