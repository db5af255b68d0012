"""Ways over an edge as the delay equation asks for them, where the air depends on the height or fluctuates."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.acoustics.diffraction import ON_LINE, edge_way
from clsim.paths.heights import Folds
from clsim.paths.propagation import straight

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Floats


class WaysOver:
    """Ways over the edges of paths `index` (P,) of `EdgePaths` to a receiver at places (T, 3)."""

    def __init__(self, paths: Any, index: NDArray[np.int64], received_at: Floats) -> None:
        self._paths, self._index, self._received_at = paths, index, received_at
        self._heard_at = paths.image("after", index, received_at[None])
        faces = paths.scene.room.faces
        planes = faces.normals, faces.offsets
        self._folds = [Folds(planes, walls) for walls in paths.walls_of_sides(index)] if paths.scene.air.layers else []

    def leave(self, p: Any, t: Any, start: Floats) -> tuple[Floats, Floats]:
        """Return lengths and directions at the source, see `Ways`."""
        (first, direction), (second, _) = self._legs(p, t, start)
        return first + second, np.einsum("pji,p...j->p...i", self._paths.before_matrix[self._index[p]], direction)

    def arrive(self, start: Floats) -> Floats:
        """Return directions at the receiver, see `Ways`."""
        _, (_, direction) = self._legs(slice(None), slice(None), start)
        return np.asarray(np.einsum("pji,ptj->pti", self._paths.after_matrix[self._index], direction))

    def seen(self) -> Floats:
        """Return the receiver as the source sees it, see `Ways`."""
        apart = self._heard_at - self._paths.before_offset[self._index][:, None]
        return np.asarray(np.einsum("pji,ptj->pti", self._paths.before_matrix[self._index], apart))

    def bends(self, p: Any, t: Any, start: Floats) -> tuple[Floats, Floats]:
        """Bends of paths, see `Ways`."""
        apex, first, second = self._parts(p, t, start)
        one, other = straight(first, apex)[0][..., None], straight(apex, second)[0][..., None]
        before, low = self._folds[0].bends(p, start, apex)
        after, high = self._folds[1].bends(p, self._received_at[t], apex)  # from the receiver's side
        shares = [one * before, one + other * (1.0 - after[..., -2::-1])]
        return np.concatenate(shares, axis=-1) / (one + other), np.concatenate([low, high[..., -2::-1]], axis=-1)

    def _legs(self, p: Any, t: Any, start: Floats) -> tuple[tuple[Floats, Floats], tuple[Floats, Floats]]:
        apex, first, second = self._parts(p, t, start)
        return straight(first, apex), straight(apex, second)

    def _parts(self, p: Any, t: Any, start: Floats) -> tuple[Floats, Floats, Floats]:
        """Points where paths meet the edges, and both endpoints as seen from these."""
        index, heard_at = self._index[p], self._heard_at[p, t]
        edges = index[:, None] if heard_at.ndim == 3 else index  # all times of a path, or one each
        emitted_at = self._paths.image("before", index, np.broadcast_to(start, heard_at.shape))
        frame, end = self._paths.frame[edges], self._paths.end_place[edges]
        coordinates: list[Floats] = []
        for place in (emitted_at, heard_at):
            away = place - frame[..., 0, :]
            x, y, z = (np.sum(away * frame[..., axis, :], axis=-1) for axis in (1, 2, 3))
            coordinates += [np.maximum(np.hypot(x, y), ON_LINE), z]
        along = np.where(np.isnan(end), edge_way(*coordinates).apex, end)
        return frame[..., 0, :] + along[..., None] * frame[..., 3, :], emitted_at, heard_at
