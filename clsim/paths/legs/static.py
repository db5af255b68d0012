"""Legs by surfaces at rest: the image of an endpoint is an isometry of it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import ByRow, Floats, read_only
from clsim.paths.arrivals import Arrivals, Kinematics
from clsim.paths.chain import Chain
from clsim.paths.family import NONE, SPECULAR, TRANSMISSION, Instant
from clsim.paths.links import Integers, Links
from clsim.paths.propagation import Folds, arrivals_by, straight
from clsim.scene.scene import Scene

_ROUNDING = 1e-9  # of shares of a path


@dataclass(frozen=True, slots=True, eq=False)
class StaticLinks(Links):
    """Legs whose surfaces rest, and vertices."""

    def solve(self, times: Floats, kinematics: Kinematics) -> Arrivals:
        """Solve the delay equation of paths at times of reception (T,), s."""
        if self.vertex is not None:
            found: Arrivals = self.vertex.on_static_legs(self, times, kinematics)
            return found
        faces, layered = self.chain.scene.room.faces, self.chain.scene.air.layers
        walls = self.chain.walls[self.rows] if layered else None
        folds = None if walls is None else Folds((faces.normals, faces.offsets), walls)
        return arrivals_by(partial(_Images, self.legs[0], folds), self.medium, self.motions, times, kinematics)

    def places(self, time: float, kinematics: Kinematics) -> Floats:
        """Source, points of interaction and receiver (P, N + 2, 3) at a time of reception, s."""
        (source, receiver), now = self.motions, np.array([time])
        faces = self.chain.scene.room.faces
        planes = faces.normals, faces.offsets
        if self.vertex is None and not kinematics.retarded:
            emitted_at = source.position(np.full(len(self), time))
        else:
            found = self.chain.arrivals(self.rows, now, kinematics)
            emitted_at = source.position(found.emission_time[:, 0])
        receiver_at = np.broadcast_to(receiver.position(now), emitted_at.shape)
        if self.vertex is None:
            through = self.chain.interactions[self.rows] == TRANSMISSION if self.chain.passes else None
            return path_vertices(planes, self.chain.objects[self.rows], emitted_at, receiver_at, through)
        before, after = self.surfaces
        first, *between, last = self.vertex.places(self, (emitted_at, receiver_at), now, kinematics)
        there = path_vertices(planes, before, emitted_at, first)
        back, more = path_vertices(planes, after, receiver_at, last), int(first is not last)
        vertices = np.full((len(self), self.chain.objects.shape[1] + 2, 3), np.nan)
        for p, (walls, others) in enumerate(zip(before, after, strict=True)):
            n, m = int(np.sum(walls >= 0)), int(np.sum(others >= 0))
            vertices[p, : n + 2] = there[p, : n + 2]
            points = [place[p] for place in between if not np.isnan(place[p, 0])]
            inner = len(points)
            vertices[p, n + 2 : n + 2 + inner] = np.reshape(points, (inner, 3))
            vertices[p, n + inner + 2 : n + inner + m + more + 3] = back[p, m + more :: -1]
        return vertices

    def lengths(self, source: Floats, receiver: Floats, times: Instant) -> Floats:
        """Lengths of paths (P,) between places (P, 3), m."""
        if self.vertex is not None:
            ends = tuple(leg.image(place) for leg, place in zip(self.legs, (source, receiver), strict=True))
            return np.asarray(self.vertex.lengths(self, (source, receiver), ends, times))
        leg = self.legs[0]
        image = (leg.matrix @ source[:, :, None])[..., 0] + leg.offset
        return np.asarray(np.linalg.norm(image - receiver, axis=1))

    @property
    def surfaces(self) -> tuple[Integers, ...]:
        """Walls (P, N) of each leg from the endpoint's side."""
        if self.vertex is None:
            return (self.all_surfaces,)
        kinds, walls = self.chain.interactions[self.rows], self.all_surfaces
        met, step = kinds > SPECULAR, np.arange(kinds.shape[1])
        place, last = np.argmax(met, axis=1)[:, None], len(step) - 1 - np.argmax(met[:, ::-1], axis=1)[:, None]
        before = np.where(step < place, walls, -1)
        backwards = self.chain.order[self.rows][:, None] - 1 - step  # the last one first
        kept = (backwards > last) & (np.take_along_axis(kinds, np.maximum(backwards, 0), axis=1) == SPECULAR)
        return before, np.where(kept, np.take_along_axis(walls, np.maximum(backwards, 0), axis=1), -1)

    @property
    def all_surfaces(self) -> Integers:
        """Walls (P, N) from the source's side, those that let sound pass among them, -1 for what is none."""
        return np.asarray(self.chain.surfaces[self.rows])


@dataclass(frozen=True, slots=True, eq=False)
class StaticLeg(ByRow):
    """Legs of P paths whose surfaces rest."""

    # (P, 3, 3) the image of the leg's endpoint, which is the source, or the receiver of a leg after a vertex,
    # is at ``matrix @ x + offset`` as seen from the other end; the matrix is orthogonal.
    matrix: Floats
    offset: Floats  # (P, 3)

    kind: ClassVar[str] = "static"
    moving: ClassVar[bool] = False
    links: ClassVar[type[Links]] = StaticLinks

    def in_scene(self, scene: Scene, surfaces: Integers) -> StaticLeg:
        """Return legs whose offsets are those of displaced walls: ``b <- b - 2 (n b - d) n``; normals stay."""
        faces, offset = scene.room.faces, np.zeros_like(self.offset)
        for met in surfaces.T:
            here = (met >= 0) & (met < len(faces))  # others let sound pass, and mirror nothing
            normal = np.where(here[:, None], faces.normals[met * here], 0.0)
            height = np.sum(offset * normal, axis=1) - faces.offsets[met * here] * here
            offset = offset - 2.0 * height[:, None] * normal
        return StaticLeg(self.matrix, offset)

    def named(self, name: str) -> Iterator[tuple[str, Any]]:
        """Yield the columns by name."""
        yield f"{name}_matrix", self.matrix
        yield f"{name}_offset", self.offset

    def image(self, places: Floats) -> Floats:
        """Images of endpoints (P, [T,] 3), or (1, [T,] 3) for all, m."""
        return self.turned(places) + self.offset.reshape(len(self), *[1] * (places.ndim - 2), 3)

    def turned(self, vectors: Floats) -> Floats:
        """Vectors (P, [T,] 3) at the endpoint as seen from the other end."""
        vectors = np.broadcast_to(vectors, (len(self), *vectors.shape[1:]))
        return np.asarray(np.einsum("pij,p...j->p...i", self.matrix, vectors))

    def turned_back(self, vectors: Floats) -> Floats:
        """Vectors (P, T, 3) at the endpoint itself, from those seen from the other end."""
        return np.asarray(np.einsum("pji,ptj->pti", self.matrix, vectors))

    def __len__(self) -> int:
        return len(self.matrix)


class _Images:
    """Straight paths from a source to mirrored receivers: seen from an image's room one is at A^T (x_r - b)."""

    def __init__(self, leg: StaticLeg, folds: Folds | None, receiver_at: Floats) -> None:
        self._matrix, self._receiver_at, self._folds = leg.matrix, receiver_at, folds
        at = receiver_at[:1] if np.all(receiver_at == receiver_at[:1]) else receiver_at  # one place if it rests
        mirrored = np.einsum("pji,ptj->pti", leg.matrix, at[None] - leg.offset[:, None, :])
        self._mirrored = np.broadcast_to(mirrored, (len(leg), len(receiver_at), 3))
        self._left: tuple[Floats, Floats] | None = None  # places of which all left last, and in which directions

    def leave(self, p: Any, t: Any, start: Floats) -> tuple[Floats, Floats]:
        """Return lengths (m) and directions of the straight paths from `start` to the mirrored receivers."""
        length, direction = straight(start, self._mirrored[p, t])
        if direction.shape == start.shape == self._mirrored.shape:
            self._left = start, direction
        return length, direction

    def arrive(self, start: Floats) -> Floats:
        """Return the directions in which sound arrives, turned by each image's matrix, `(paths, times, 3)`."""
        left = self._left
        direction = left[1] if left is not None and left[0] is start else straight(start, self._mirrored)[1]
        return np.asarray(np.einsum("pij,ptj->pti", self._matrix, direction))

    def seen(self) -> Floats:
        """Return the receivers as they are seen from the source, mirrored, `(paths, times, 3)` m."""
        return np.asarray(self._mirrored)

    def bends(self, p: Any, t: Any, start: Floats) -> tuple[Floats, Floats]:
        """Effect of layered air on folded paths from `start`."""
        assert self._folds is not None
        return self._folds.bends(p, start, self._receiver_at[t])


def image_columns(walls: NDArray[Any], matrix: Floats, offset: Floats) -> dict[str, Any]:
    """Columns of a `Chain` of one static leg: images of the source, each an isometry of its trajectory."""
    kinds = read_only(np.where(walls >= 0, np.int8(SPECULAR), np.int8(NONE)))
    return {"interactions": kinds, "objects": walls, "legs": (StaticLeg(matrix, offset),)}


def direct_paths(scene: Scene) -> Chain:
    """Make the direct path of every pair of source and receiver, whatever is in the way."""
    source, receiver = np.divmod(np.arange(len(scene.sources) * len(scene.receivers)), len(scene.receivers))
    count = len(source)
    images = image_columns(
        np.empty((count, 0), dtype=np.int32), np.tile(np.eye(3), (count, 1, 1)), np.zeros((count, 3))
    )
    return Chain(
        scene, source.astype(np.int32), receiver.astype(np.int32), np.zeros(count, dtype=np.int32),
        np.full(count, -np.inf), np.full(count, np.inf), **images,
    )  # fmt: skip


def path_vertices(
    planes: tuple[Floats, Floats], walls: NDArray[np.signedinteger[Any]], source: Floats, receiver: Floats,
    through: NDArray[np.bool_] | None = None,
) -> Floats:  # fmt: skip
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
