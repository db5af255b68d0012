"""Paths over one edge, with reflections before and after it: two isometries and the field at a wedge."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from clsim.acoustics.diffraction import EdgeWay, edge_way, end_detour, lit_angles, transition, wedge_terms
from clsim.paths.family import DIFFRACTION, SPECULAR, PathFamily
from clsim.paths.heights import Folds
from clsim.paths.propagation import arrivals_by, straight
from clsim.paths.vertices import path_vertices

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Complexes, Floats
    from clsim.paths.arrivals import Arrivals
    from clsim.paths.family import Rows
    from clsim.paths.response import SceneResponse

    Integers = NDArray[np.signedinteger[Any]]

_LOUDEST = 3.0  # over the partners: four terms of a half at most, one of which may be continued beyond its boundary


@dataclass(frozen=True, slots=True, eq=False)
class EdgePaths(PathFamily):
    """Paths over one edge, and those over an end of one; each row is a piece between two boundaries of its terms.

    Shortly beyond its own interval a row goes on smoothly: what it takes over there is its partner's.

    Attributes
    ----------
    before_matrix, before_offset : ndarray (paths, 3, 3), (paths, 3)
        The image of the source by the walls before the edge is at ``before_matrix @ x + before_offset``.
    after_matrix, after_offset : ndarray (paths, 3, 3), (paths, 3)
        The same of the receiver, by the walls after the edge from its own side.
    frame : ndarray (paths, 4, 3)
        Start of the edge, m, and its vectors `across`, `out` and `along`, see `Edges`.
    n : ndarray (paths,)
        Exterior angle over π.
    faces : ndarray (paths, 2) int
        Walls of the 0-face and the n-face.
    lit : ndarray (paths, 4) int8
        1 for terms whose partner is seen, -1 for those whose partner is not, 0 for terms that are left out.
    end_place : ndarray (paths,)
        How far along the edge the end is that a path runs over, m; NaN for those over the edge itself.
    end_side : ndarray (paths,) int8
        1 while the shortest way over the line of the edge meets the edge, -1 while it passes the end.
    edge_names : tuple of str
        Of all edges of the room.
    """

    before_matrix: Floats
    before_offset: Floats
    after_matrix: Floats
    after_offset: Floats
    frame: Floats
    n: Floats
    faces: NDArray[np.int64]
    lit: NDArray[np.int8]
    end_place: Floats
    end_side: NDArray[np.int8]
    edge_names: tuple[str, ...]

    columns: ClassVar[tuple[str, ...]] = (
        "before_matrix", "before_offset", "after_matrix", "after_offset", "frame", "n", "faces", "lit",
        "end_place", "end_side",
    )  # fmt: skip

    @property
    def is_complex(self) -> bool:
        """True: the field at an edge has a phase of its own."""
        return True

    @property
    def object_names(self) -> tuple[str, ...]:
        """Names of the edges, and of their two ends, edge by edge."""
        return (*self.edge_names, *(f"{end} of {name}" for name in self.edge_names for end in ("start", "end")))

    def arrivals(
        self, rows: Rows, times: Floats, motion: str = "retarded", amplitude: str = "wave-equation"
    ) -> Arrivals:
        """Return delays, directions and lengths of paths between one source and one receiver.

        Notes
        -----
        The way over the edge is the shortest one, so the change of the apex does not change its length: rates are those
        of two legs to a place at rest.
        """
        source, receiver = (end.trajectory for end in self.ends(rows))
        times = np.asarray(times, dtype=np.float64)
        index, folds = np.arange(len(self))[rows], None
        if self.scene.air.layers:
            planes = self.scene.room.faces.normals, self.scene.room.faces.offsets
            folds = [Folds(planes, walls) for walls in self._walls_of_sides(index)]
        return arrivals_by(
            lambda heard_at: _WaysOver(self, index, heard_at, folds), self.medium(int(self.source[rows][0])),
            (source, receiver), times, motion, amplitude,
        )  # fmt: skip

    def response(self, rows: Rows, found: Arrivals, times: Floats, at: SceneResponse) -> Floats | Complexes:
        """Return received over emitted pressure (P, T, F): the field at the edge, spreading, air, walls, directivities.

        Notes
        -----
        The phases of the transition are those at the time of emission, stretched by ``1 / (1 - M)`` as all that a
        moving source emits.
        """
        index = np.arange(len(self))[rows]
        source, receiver = self.ends(rows)
        shape = found.delay.shape
        emitted_at = source.trajectory.position(found.emission_time.ravel()).reshape(*shape, 3)
        velocity = source.trajectory.velocity(found.emission_time.ravel()).reshape(*shape, 3)
        speed = self.scene.air.speed_of_sound
        mach = np.sum(found.departure * velocity, axis=-1) / speed
        late = found.emission_time != times  # as received; quasi-static sound is emitted at once
        wave = 2.0 * np.pi * at.frequencies / speed / (1.0 - np.where(late, mach, 0.0))[..., None]
        response: Complexes = self._edge_field(
            index, self.image("before", index, emitted_at),
            self.image("after", index, receiver.trajectory.position(times)[None]), wave, at,
        )  # fmt: skip
        response *= at.air(found) * found.mach_factor[..., None]
        for walls, direction in zip(self._walls_of_sides(index), (found.departure, found.arrival), strict=True):
            response *= at.reflection(walls)[:, None, :]
            for bounce, normals in at.angular_bounces(walls):
                met = walls[:, bounce]
                for wall in np.unique(met[at.angular[met]]):
                    here = np.flatnonzero(met == wall)
                    cosine = np.abs(np.einsum("pti,pi->pt", direction[here], normals[here]))
                    response[here] *= at.reflection_at(wall, cosine)
        at.apply_directivities(response, self.ends(rows), found, times)
        return response

    def vertices(self, rows: Rows, time: float, motion: str = "retarded") -> Floats:
        """Return source, points of reflection and diffraction, and receiver (P, N + 2, 3) of paths of one pair."""
        index = np.arange(len(self))[rows]
        source, receiver = (end.trajectory for end in self.ends(rows))
        now = np.array([time])
        emitted_at = source.position(self.arrivals(index, now, motion).emission_time[:, 0])
        heard_at = np.broadcast_to(receiver.position(now), emitted_at.shape)
        apex = self.apex(index, *(self.image(s, index, x) for s, x in (("before", emitted_at), ("after", heard_at))))
        planes = self.scene.room.faces.normals, self.scene.room.faces.offsets
        before, after = self._walls_of_sides(index)
        there, back = (path_vertices(planes, w, x, apex) for w, x in ((before, emitted_at), (after, heard_at)))
        found = np.full((len(index), self.objects.shape[1] + 2, 3), np.nan)
        for p, (walls, others) in enumerate(zip(before, after, strict=True)):
            n, m = int(np.sum(walls >= 0)), int(np.sum(others >= 0))
            found[p, : n + 2] = there[p, : n + 2]
            found[p, n + 2 : n + m + 3] = back[p, m::-1]
        return found

    def lengths(self, rows: Rows, source: Floats, receiver: Floats) -> Floats:
        """Return the lengths (P,) of the shortest ways between places (P, 3) and others, m."""
        index = np.arange(len(self))[rows]
        (first, _), (second, _) = self.legs(
            index, self.image("before", index, source), self.image("after", index, receiver)
        )
        return np.asarray(first + second)

    def gain_bound(self, rows: Rows, at: SceneResponse) -> Floats:
        """Return the reflection factors' magnitudes (P, F) times the largest field at an edge."""
        return _LOUDEST * at.largest_reflection(self.walls[rows])

    def image(self, side: str, index: NDArray[np.int64], places: Floats) -> Floats:
        """Return where places (P, [T,] 3) are seen by the edge of each path."""
        offset = (self.before_offset if side == "before" else self.after_offset)[index]
        return self._turned(side, index, places) + offset.reshape(len(index), *[1] * (places.ndim - 2), 3)

    def _turned(self, side: str, index: NDArray[np.int64], vectors: Floats) -> Floats:
        """Return how vectors (P, [T,] 3) are seen by the edge of each path."""
        matrix = (self.before_matrix if side == "before" else self.after_matrix)[index]
        vectors = np.broadcast_to(vectors, (len(index), *vectors.shape[1:]))
        return np.asarray(np.einsum("pij,p...j->p...i", matrix, vectors))

    def _cylindrical(self, index: NDArray[np.int64], places: Floats) -> tuple[Floats, Floats, Floats]:
        """Return r (...), θ (...) and z (...) of places (..., 3) about the edges of paths (...)."""
        frame = self.frame[index]
        away = places - frame[..., 0, :]
        x, y, z = (np.sum(away * frame[..., axis, :], axis=-1) for axis in (1, 2, 3))
        angle, low = np.arctan2(y, x), 0.5 * np.pi * (self.n[index] - 2.0)
        return np.hypot(x, y), np.where(angle < low, angle + 2.0 * np.pi, angle), z

    def apex(self, index: NDArray[np.int64], emitted_at: Floats, heard_at: Floats) -> Floats:
        """Return where ways between places (..., 3) meet the edges of paths (...), or the ends that they run over."""
        (r_s, _, z_s), (r_r, _, z_r) = (self._cylindrical(index, x) for x in (emitted_at, heard_at))
        end = self.end_place[index]
        place = np.where(np.isnan(end), edge_way(r_s, z_s, r_r, z_r).apex, end)
        return np.asarray(self.frame[index][..., 0, :] + place[..., None] * self.frame[index][..., 3, :])

    def legs(
        self, index: NDArray[np.int64], emitted_at: Floats, heard_at: Floats
    ) -> tuple[tuple[Floats, Floats], tuple[Floats, Floats]]:
        """Return lengths (...) and directions (..., 3) of the ways to the edges of paths (...) and on from there."""
        apex = self.apex(index, emitted_at, heard_at)
        return straight(emitted_at, apex), straight(apex, heard_at)

    def _walls_of_sides(self, index: NDArray[np.int64]) -> tuple[Integers, Integers]:
        """Return the walls (P, N) before the edge from the source's side, and after it from the receiver's."""
        kinds, walls = self.interactions[index], self.walls[index]
        edge = np.argmax(kinds == DIFFRACTION, axis=1)[:, None]
        step = np.arange(kinds.shape[1])
        before = np.where(step < edge, walls, -1)
        backwards = self.order[index][:, None] - 1 - step  # the last one first
        kept = (backwards > edge) & (np.take_along_axis(kinds, np.maximum(backwards, 0), axis=1) == SPECULAR)
        return before, np.where(kept, np.take_along_axis(walls, np.maximum(backwards, 0), axis=1), -1)

    def _edge_field(
        self, index: NDArray[np.int64], emitted_at: Floats, heard_at: Floats, wave: Floats, at: SceneResponse
    ) -> Any:
        """Return the field (P, T, F) at the edge, of places (P, T, 3) and wave numbers (P, T, F), without its phase."""
        (r_s, t_s, z_s), (r_r, t_r, z_r) = (self._cylindrical(index[:, None], x) for x in (emitted_at, heard_at))
        way = edge_way(r_s, z_s, r_r, z_r)
        n, lit = self.n[index], self.lit[index]
        weight, root = wedge_terms(n[:, None], lit_angles(n[:, None], t_s, t_r), lit[:, None])
        factors = self._face_factors(index, np.cos(0.5 * (t_r - t_s)) * (r_s + r_r) / way.length, at)
        scale, field = np.sqrt(wave * way.breadth[..., None]), np.zeros(wave.shape, dtype=np.complex128)
        for term in range(lit.shape[1]):
            kept = np.flatnonzero(lit[:, term])
            each = 0.5 * weight[kept, :, term, None] * transition(root[kept, :, term, None] * scale[kept])
            field[kept] += each * factors[term - 2][kept] if term >= 2 else each
        field /= way.length[..., None]
        over_end = np.flatnonzero(self.end_side[index])
        if len(over_end):
            field[over_end] *= self._end_factor(index, over_end, way, (r_s, z_s), (r_r, z_r), wave)
        return field

    def _face_factors(self, index: NDArray[np.int64], cosine: Floats, at: SceneResponse) -> list[Any]:
        """Return the reflection factors (P, T, F) of the 0-face and of the n-face.

        The cosine (P, T) is that of the angle of incidence of a reflection where it comes or goes, the same for both
        ends elsewhere.
        """
        found = []
        for walls in self.faces[index].T:
            factor: Any = np.broadcast_to(
                at.reflection(walls[:, None])[:, None], (*cosine.shape, len(at.frequencies))
            ).astype(np.complex128)
            for wall in np.unique(walls[at.angular[walls]]):
                here = np.flatnonzero(walls == wall)
                factor[here] = at.reflection_at(wall, np.abs(cosine[here]))
            found.append(factor)
        return found

    def _end_factor(
        self, index: NDArray[np.int64], rows: NDArray[np.int64], way: EdgeWay,
        source: tuple[Floats, Floats], receiver: tuple[Floats, Floats], wave: Floats,
    ) -> Any:  # fmt: skip
        """Return what an end sends (n, T, F) over the field of the edge without one, without its detour's phase."""
        some = EdgeWay(way.length[rows], way.apex[rows], way.breadth[rows])
        end, side = self.end_place[index[rows]][:, None], 1.0 * self.end_side[index[rows]][:, None]
        detour = end_detour(some, (source[0][rows], source[1][rows]), (receiver[0][rows], receiver[1][rows]), end)
        # Towards the start or the stop of the edge its inside is on another side of the end.
        inside = np.where(end > 0.0, end - some.apex, some.apex)
        root = side * (np.sign(inside) * np.sqrt(detour))
        return -0.5 * side[..., None] * transition(root[..., None] * np.sqrt(wave[rows]))


class _WaysOver:
    """Ways over the edges of paths `index` (P,) to a receiver at places (T, 3)."""

    def __init__(
        self, paths: EdgePaths, index: NDArray[np.int64], received_at: Floats, folds: list[Folds] | None
    ) -> None:
        self._paths, self._index, self._received_at, self._folds = paths, index, received_at, folds
        heard_at = received_at
        self._heard_at = paths.image("after", index, heard_at[None])

    def leave(self, p: Any, t: Any, start: Floats) -> tuple[Floats, Floats]:
        (first, direction), (second, _) = self._legs(p, t, start)
        return first + second, np.einsum("pji,p...j->p...i", self._paths.before_matrix[self._index[p]], direction)

    def arrive(self, start: Floats) -> Floats:
        _, (_, direction) = self._legs(slice(None), slice(None), start)
        return np.asarray(np.einsum("pji,ptj->pti", self._paths.after_matrix[self._index], direction))

    def _legs(self, p: Any, t: Any, start: Floats) -> tuple[tuple[Floats, Floats], tuple[Floats, Floats]]:
        edges, emitted_at, heard_at = self._seen(p, t, start)
        return self._paths.legs(edges, emitted_at, heard_at)

    def seen(self) -> Floats:
        apart = self._heard_at - self._paths.before_offset[self._index][:, None]
        return np.asarray(np.einsum("pji,ptj->pti", self._paths.before_matrix[self._index], apart))

    def bends(self, p: Any, t: Any, start: Floats) -> tuple[Floats, Floats]:
        assert self._folds is not None
        edges, emitted_at, heard_at = self._seen(p, t, start)
        apex = self._paths.apex(edges, emitted_at, heard_at)
        first, second = straight(emitted_at, apex)[0][..., None], straight(apex, heard_at)[0][..., None]
        before, low = self._folds[0].bends(p, start, apex)
        after, high = self._folds[1].bends(p, self._received_at[t], apex)  # from the receiver's side
        shares = [first * before, first + second * (1.0 - after[..., -2::-1])]
        return np.concatenate(shares, axis=-1) / (first + second), np.concatenate([low, high[..., -2::-1]], axis=-1)

    def _seen(self, p: Any, t: Any, start: Floats) -> tuple[NDArray[np.int64], Floats, Floats]:
        """Return the edges, and both ends as these see them."""
        index, heard_at = self._index[p], self._heard_at[p, t]
        edges = index[:, None] if heard_at.ndim == 3 else index  # all times of a path, or one each
        return edges, self._paths.image("before", index, np.broadcast_to(start, heard_at.shape)), heard_at
