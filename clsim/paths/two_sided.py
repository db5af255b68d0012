"""Paths with one place at which they do more than be reflected, and reflections before and after it."""

from __future__ import annotations

from abc import ABC
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.paths.family import SPECULAR, PathFamily
from clsim.paths.vertices import path_vertices

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Complexes, Floats
    from clsim.paths.arrivals import Arrivals
    from clsim.paths.response import SceneResponse

    Integers = NDArray[np.signedinteger[Any]]


@dataclass(frozen=True, slots=True, eq=False)
class TwoSidedPaths(PathFamily, ABC):
    """Paths by walls to a place, such as an edge or a scatterer, and on by walls: an isometry for each side.

    Attributes
    ----------
    before_matrix, before_offset : ndarray (paths, 3, 3), (paths, 3)
        The image of the source by the walls before the place is at ``before_matrix @ x + before_offset``.
    """

    before_matrix: Floats
    before_offset: Floats
    after_matrix: Floats  # (paths, 3, 3) the same of the receiver, by the walls after the place from its own side
    after_offset: Floats  # likewise

    def reflect(
        self, response: Floats | Complexes, index: NDArray[np.int64], found: Arrivals, at: SceneResponse
    ) -> Any:
        """Multiply responses (P, T, F) of paths (P,) by the factors of the walls of both sides, in place."""
        for walls, direction in zip(self.walls_of_sides(index), (found.departure, found.arrival), strict=True):
            response *= at.reflection(walls)[:, None, :]
            at.apply_angular_walls(response, walls, direction)
        return response

    def vertices_by(
        self, index: NDArray[np.int64], emitted_at: Floats, places: tuple[Floats, Floats], heard_at: Floats
    ) -> Floats:
        """Return source, points of interaction, receiver (P, N + 2, 3) by the first place and the last, (P, 3) each."""
        planes = self.scene.room.faces.normals, self.scene.room.faces.offsets
        before, after = self.walls_of_sides(index)
        there = path_vertices(planes, before, emitted_at, places[0])
        back, more = path_vertices(planes, after, heard_at, places[1]), int(places[0] is not places[1])
        found = np.full((len(index), self.objects.shape[1] + 2, 3), np.nan)
        for p, (walls, others) in enumerate(zip(before, after, strict=True)):
            n, m = int(np.sum(walls >= 0)), int(np.sum(others >= 0))
            found[p, : n + 2] = there[p, : n + 2]
            found[p, n + 2 : n + m + more + 3] = back[p, m + more :: -1]
        return found

    def image(self, side: str, index: NDArray[np.int64], places: Floats) -> Floats:
        """Positions of endpoints (P, [T,] 3) as seen from the place of each path, "before" it or "after" it."""
        offset = (self.before_offset if side == "before" else self.after_offset)[index]
        return self.turned(side, index, places) + offset.reshape(len(index), *[1] * (places.ndim - 2), 3)

    def turned(self, side: str, index: NDArray[np.int64], vectors: Floats) -> Floats:
        """Vectors (P, [T,] 3) as seen from the place of each path."""
        matrix = (self.before_matrix if side == "before" else self.after_matrix)[index]
        vectors = np.broadcast_to(vectors, (len(index), *vectors.shape[1:]))
        return np.asarray(np.einsum("pij,p...j->p...i", matrix, vectors))

    def turned_back(self, side: str, index: NDArray[np.int64], vectors: Floats) -> Floats:
        """Vectors (P, T, 3) at the endpoint itself, from those seen from the place of each path."""
        matrix = (self.before_matrix if side == "before" else self.after_matrix)[index]
        return np.asarray(np.einsum("pji,ptj->pti", matrix, vectors))

    def walls_of_sides(self, index: NDArray[np.int64]) -> tuple[Integers, Integers]:
        """Return the walls (P, N) before the place from the source's side, and after it from the receiver's."""
        kinds, walls = self.interactions[index], self.walls[index]
        place = np.argmax(kinds > SPECULAR, axis=1)[:, None]
        step = np.arange(kinds.shape[1])
        before = np.where(step < place, walls, -1)
        backwards = self.order[index][:, None] - 1 - step  # the last one first
        kept = (backwards > place) & (np.take_along_axis(kinds, np.maximum(backwards, 0), axis=1) == SPECULAR)
        return before, np.where(kept, np.take_along_axis(walls, np.maximum(backwards, 0), axis=1), -1)
