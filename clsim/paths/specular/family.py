"""Paths that walls reflect like mirrors: images of the source, each an isometry of its trajectory."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np

from clsim.arrays import read_only
from clsim.paths.family import NONE, SPECULAR, PathFamily
from clsim.paths.heights import Folds
from clsim.paths.propagation import UniformAir, arrivals_by, straight
from clsim.paths.vertices import path_vertices

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Complexes, Floats
    from clsim.paths.arrivals import Arrivals
    from clsim.paths.family import Rows
    from clsim.paths.response import SceneResponse
    from clsim.scene.scene import Scene


@dataclass(frozen=True, slots=True, eq=False)
class SpecularPaths(PathFamily):
    """Paths by any number of mirrors that rest; all interactions are reflections, and objects are walls.

    Attributes
    ----------
    image_matrix, image_offset : ndarray (paths, 3, 3), (paths, 3)
        The image of the source is at ``image_matrix @ x + image_offset``; the matrix is orthogonal.
    """

    interactions: NDArray[np.signedinteger[Any]] = field(init=False, repr=False)
    image_matrix: Floats
    image_offset: Floats

    columns: ClassVar[tuple[str, ...]] = ("image_matrix", "image_offset")

    def __post_init__(self) -> None:
        kinds = np.where(self.objects >= 0, np.int8(SPECULAR), np.int8(NONE))
        object.__setattr__(self, "interactions", read_only(kinds))
        super(SpecularPaths, self).__post_init__()

    @classmethod
    def direct(cls, scene: Scene) -> Self:
        """Return the direct path of every pair of source and receiver, whatever is in the way."""
        source, receiver = np.divmod(np.arange(len(scene.sources) * len(scene.receivers)), len(scene.receivers))
        count = len(source)
        return cls(
            scene, source.astype(np.int32), receiver.astype(np.int32), np.zeros(count, dtype=np.int32),
            np.full(count, -np.inf), np.full(count, np.inf), np.empty((count, 0), dtype=np.int32),
            np.tile(np.eye(3), (count, 1, 1)), np.zeros((count, 3)),
        )  # fmt: skip

    @property
    def device(self) -> str | None:
        """The program for images; none that knows a medium other than air of one speed, without noise."""
        media = [self.medium(source) for source in range(len(self.scene.sources))]
        return "images" if all(isinstance(m, UniformAir) and m.fluctuation is None for m in media) else None

    @property
    def walls(self) -> NDArray[np.signedinteger[Any]]:
        """Walls (paths, N) from the source's side, filled up with -1."""
        return self.objects

    def arrivals(
        self, rows: Rows, times: Floats, motion: str = "retarded", amplitude: str = "wave-equation"
    ) -> Arrivals:
        """Return delays, directions and lengths of paths between one source and one receiver."""
        source, receiver = (end.trajectory for end in self.ends(rows))
        times = np.asarray(times, dtype=np.float64)
        images = self.image_matrix[rows], self.image_offset[rows]
        faces = self.scene.room.faces
        folds = Folds((faces.normals, faces.offsets), self.objects[rows]) if self.scene.air.layers else None
        return arrivals_by(
            lambda heard_at: _Images(*images, heard_at, folds),
            self.medium(int(self.source[rows][0])),
            (source, receiver),
            times,
            motion,
            amplitude,
        )

    def response(self, rows: Rows, found: Arrivals, times: Floats, at: SceneResponse) -> Floats | Complexes:
        """Return received over emitted pressure (P, T, F): spreading, air, walls and directivities."""
        walls = self.objects[rows]
        response = at.air(found) * at.reflection(walls)[:, None, :]
        response *= (found.mach_factor / found.length)[..., None]
        at.apply_angular_walls(response, walls, found.departure)
        at.apply_directivities(response, self.ends(rows), found, times)
        return response

    def vertices(self, rows: Rows, time: float, motion: str = "retarded") -> Floats:
        """Return source, points of reflection and receiver (P, N + 2, 3) of paths of one pair."""
        source, receiver = (end.trajectory for end in self.ends(rows))
        now, walls = np.array([time]), self.objects[rows]
        delay = 0.0 if motion == "quasi-static" else self.arrivals(rows, now, motion).delay[:, 0]
        emitted_at = source.position(np.full(len(walls), time) - delay)
        faces, heard_at = self.scene.room.faces, np.broadcast_to(receiver.position(now), emitted_at.shape)
        return path_vertices((faces.normals, faces.offsets), walls, emitted_at, heard_at)

    def lengths(self, rows: Rows, source: Floats, receiver: Floats) -> Floats:
        """Return distances (P,) from the images of places (P, 3) to others, m."""
        image = (self.image_matrix[rows] @ source[:, :, None])[..., 0] + self.image_offset[rows]
        return np.asarray(np.linalg.norm(image - receiver, axis=1))

    def gain_bound(self, rows: Rows, at: SceneResponse) -> Floats:
        """Return the reflection factors' magnitudes (P, F), 1 where they depend on the angle."""
        return at.largest_reflection(self.objects[rows])


class _Images:
    """Straight ways from a source to mirrored receivers: seen from an image's room one stands at A^T (x_r - b)."""

    def __init__(self, matrix: Floats, offset: Floats, heard_at: Floats, folds: Folds | None) -> None:
        self._matrix, self._heard_at, self._folds = matrix, heard_at, folds
        self._mirrored = np.einsum("pji,ptj->pti", matrix, heard_at[None] - offset[:, None, :])

    def leave(self, p: Any, t: Any, start: Floats) -> tuple[Floats, Floats]:
        """Return lengths (m) and directions of the straight ways from `start` to the mirrored receivers."""
        return straight(start, self._mirrored[p, t])

    def arrive(self, start: Floats) -> Floats:
        """Return the directions in which sound arrives, turned by each image's matrix, `(paths, times, 3)`."""
        return np.asarray(np.einsum("pij,ptj->pti", self._matrix, straight(start, self._mirrored)[1]))

    def seen(self) -> Floats:
        """Return the receivers as they are seen from the source, mirrored, `(paths, times, 3)` m."""
        return np.asarray(self._mirrored)

    def bends(self, p: Any, t: Any, start: Floats) -> tuple[Floats, Floats]:
        """Effect of layered air on folded paths from `start`."""
        assert self._folds is not None
        return self._folds.bends(p, start, self._heard_at[t])
