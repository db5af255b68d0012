"""Paths over two edges of one face, such as round a pillar or a thick screen, among any reflections."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from clsim.acoustics.diffraction import ON_LINE, edge_way, lit_angles, wedge_terms
from clsim.acoustics.double_edge import double_tie, double_transition
from clsim.paths.diffraction.family import EdgePaths, cylindrical, face_factors
from clsim.paths.diffraction.ways import EdgeView, RolledOut

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Floats
    from clsim.paths.family import Rows
    from clsim.paths.response import SceneResponse

_LOUDEST = 18.0  # over a path without edges
_SOFTEST = 1e-3  # least magnitude of one and the factor of the face between


@dataclass(frozen=True, slots=True, eq=False)
class DoubleEdgePaths(EdgePaths):
    """Paths over two edges that share a face; columns of `EdgePaths` are those of the first one.

    Attributes
    ----------
    shared : ndarray (paths, 2) int
        Which face of the first and of the second edge both share: 0 for the 0-face, 1 for the n-face.
    """

    last_frame: Floats  # (paths, 4, 3) start of the second edge, m, and its vectors
    last_n: Floats  # (paths,) its exterior angle over π
    last_faces: NDArray[np.int64]  # (paths, 2) its walls
    last_lit: NDArray[np.int8]  # (paths, 4) of its terms, as `lit`
    shared: NDArray[np.int64]

    columns: ClassVar[tuple[str, ...]] = (
        *EdgePaths.columns, "last_frame", "last_n", "last_faces", "last_lit", "shared",
    )  # fmt: skip

    @property
    def device(self) -> None:
        """None: the host makes their nodes."""
        return

    def gain_bound(self, rows: Rows, at: SceneResponse) -> Floats:
        """Return the reflection factors' magnitudes (P, F) times the largest field beyond two edges."""
        return _LOUDEST * at.largest_reflection(self.walls[rows])

    def _view(self, side: str, index: NDArray[np.int64]) -> EdgeView:
        frame = self.frame if side == "before" else self.last_frame
        return EdgeView.of(*self._isometry(side, index), frame[index])

    def _beyond(self, index: NDArray[np.int64]) -> tuple[RolledOut, RolledOut]:
        frames, angles = (self.frame[index], self.last_frame[index]), np.pi * np.stack([self.n, self.last_n], axis=1)
        turned = np.where(self.shared[index] == 1, angles[index], 0.0)
        inward = [
            np.cos(angle)[:, None] * frame[:, 1] + np.sin(angle)[:, None] * frame[:, 2]
            for frame, angle in zip(frames, turned.T, strict=True)
        ]
        one, other = (frames[0], inward[0]), (frames[1], inward[1])
        return RolledOut.of(*one, *other), RolledOut.of(*other, *one)

    def _apexes(self, index: NDArray[np.int64], source: Floats, receiver: Floats) -> tuple[Floats, Floats]:
        ends = [self._view(side, index).places(x[:, None]) for side, x in (("before", source), ("after", receiver))]
        (r_s, z_s), (r_r, z_r) = ((np.maximum(np.hypot(x, y), ON_LINE), z) for x, y, z in ends)
        beyond = self._beyond(index)
        first = edge_way(r_s, z_s, *beyond[0](r_r, z_r)).apex
        last = edge_way(r_r, z_r, *beyond[1](r_s, z_s)).apex
        one, other = (
            frame[index, 0] + place * frame[index, 3] for frame, place in ((self.frame, first), (self.last_frame, last))
        )
        return np.asarray(one), np.asarray(other)

    def _edge_field(
        self, index: NDArray[np.int64], emitted_at: Floats, heard_at: Floats, wave: Floats, at: SceneResponse
    ) -> Any:
        """Return the field (P, T, F) beyond both edges, without its phase.

        Along a rigid face all is twice as loud as what comes from either side, which the second edge has twice again:
        what the two edges make of it is halved, and for other faces divided by one and the face's factor. Paths whose
        terms by faces are left out have neither.
        """
        (r_s, t_s, z_s), (r_r, t_r, z_r) = (
            cylindrical(n[index], seen, beside)
            for n, seen, beside in zip((self.n, self.last_n), (emitted_at, heard_at), self.beside[index].T, strict=True)
        )
        beyond = self._beyond(index)
        heard, sent = (_ahead(*seen) for seen in (beyond[0](r_r, z_r), beyond[1](r_s, z_s)))
        ways = edge_way(r_s, z_s, *heard), edge_way(r_r, z_r, *sent)
        face = self.shared[index, :, None] * np.pi * np.stack([self.n, self.last_n], axis=1)[index, :, None]
        edges = (
            (self.n[index], t_s, face[:, 0], self.lit[index], self.faces[index]),
            (self.last_n[index], face[:, 1], t_r, self.last_lit[index], self.last_faces[index]),
        )
        tie = double_tie(ways[0], r_s * ways[0].length / (r_s + heard[0]), r_r * ways[1].length / (r_r + sent[0]))
        found = [
            self._terms(edge, way.breadth, by_face, at)
            for edge, way, by_face in zip(edges, ways, ((2, 3), (3, 2)), strict=True)
        ]
        (first, before, _), (last, after, last_factors) = found
        field: Any = np.zeros(wave.shape, dtype=np.complex128)
        for i, weight in enumerate(before):
            for j, other in enumerate(after):
                field += 0.25 * weight * other * double_transition(first[..., i], last[..., j], tie, wave)
        field /= ways[0].length[..., None]
        both = 1.0 + np.where(self.shared[index, 1, None, None] == 1, last_factors[1], last_factors[0])
        both = np.where(np.any(self.lit[index, 2:], axis=1)[:, None, None], both, 1.0)
        return field / np.where(np.abs(both) > _SOFTEST, both, _SOFTEST)

    @staticmethod
    def _terms(
        edge: tuple[Any, ...], breadth: Floats, by_face: tuple[int, int], at: SceneResponse
    ) -> tuple[Floats, list[Any], list[Any]]:
        """Return roots (P, T, 2), weights (P, T, F) of the two kinds of terms at an edge, and its faces' factors.

        Along the shared face a term by a face has the root of one past the edge: `by_face` are those of 0 and 1.
        """
        n, came, went, lit, faces = edge
        weight, root = wedge_terms(n[:, None], lit_angles(n[:, None], came, went), lit[:, None])
        factors = face_factors(faces, np.broadcast_to(np.cos(0.5 * (went - came)), breadth.shape), at)
        kept = weight * np.abs(lit)[:, None]
        weights = [kept[..., i, None] + kept[..., j, None] * factors[j - 2] for i, j in enumerate(by_face)]
        return root[..., :2] * np.sqrt(breadth)[..., None], weights, factors


def _ahead(r: Floats, z: Floats) -> tuple[Floats, Floats]:
    """Return r and z (P, T) as an edge sees what is beyond the other one, r at least `ON_LINE`.

    Behind the edge there is no path, but nodes just beyond its interval are evaluated: there the field keeps the
    value that it has at the edge.
    """
    return np.maximum(r, ON_LINE), z
