"""Legs of paths: by surfaces at rest, where an image is an isometry, and by moving ones, where it is one of events."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import ByRow, Floats, read_only
from clsim.paths.chain import Chain
from clsim.paths.family import (
    DIFFRACTION,
    NONE,
    SPECULAR,
    TRANSMISSION,
    Columns,
    Instant,
    Integers,
    Links,
    Vertex,
    in_chunks,
    met_in_order,
)
from clsim.paths.legs.events import find_events
from clsim.paths.legs.mirrors import Mirrors
from clsim.paths.propagation import Folds, UniformAir, arrivals_by, straight
from clsim.paths.response import Arrivals, Kinematics
from clsim.scene.scene import Scene

_ROUNDING = 1e-9  # of shares of a path
_AT_A_TIME = 16384  # nodes that are solved together


@dataclass(frozen=True, slots=True, eq=False)
class StaticLinks(Links):
    """Legs whose surfaces rest, and vertices."""

    def solve(self, times: Floats, kinematics: Kinematics) -> Arrivals:
        """Solve the delay equation of paths at times of reception (T,), s."""
        if self.vertex is not None:
            found: Arrivals = self.vertex.on_static_legs(self, times, kinematics)
            return found
        return static_arrivals(self, times, kinematics)

    def places(self, time: float, kinematics: Kinematics) -> Floats:
        """Source, points of interaction and receiver (P, N + 2, 3) at a time of reception, s."""
        (source, receiver), now = self.motions, np.array([time])
        faces = self.chain.scene.room.faces
        planes = faces.normals, faces.offsets
        emitted_at = source.position(self.solve(now, kinematics).emission_time[:, 0])
        receiver_at = np.broadcast_to(receiver.position(now), emitted_at.shape)
        if len(self.legs) == 1:
            through = self.chain.interactions[self.rows] == TRANSMISSION if self.chain.passes else None
            return path_vertices(planes, self.chain.objects[self.rows], emitted_at, receiver_at, through)
        before, after = self.surfaces
        first, *between, last = self.vertex.places(self, (emitted_at, receiver_at), now, kinematics)
        there = path_vertices(planes, before, emitted_at, first)
        back, more = path_vertices(planes, after, receiver_at, last), int(first is not last)
        vertices = np.full((len(self), self.chain.objects.shape[1] + 2, 3), np.nan)
        for p, (walls, others) in enumerate(zip(before, after, strict=True)):
            n, m = int(np.sum(walls >= 0)), int(np.sum(others >= 0))
            points = [place[p : p + 1] for place in between if not np.isnan(place[p, 0])]
            each = np.concatenate([there[p, : n + 2], *points, back[p, m + more :: -1]])
            vertices[p, : len(each)] = each
        return vertices

    def lengths(self, source: Floats, receiver: Floats, times: Instant) -> Floats:
        """Lengths of paths (P,) between places (P, 3), m."""
        if len(self.legs) > 1:
            ends = tuple(leg.image(place) for leg, place in zip(self.legs, (source, receiver), strict=True))
            return np.asarray(self.vertex.lengths(self, (source, receiver), ends, times))
        leg = self.legs[0]
        image = (leg.matrix @ source[:, :, None])[..., 0] + leg.offset
        return np.asarray(np.linalg.norm(image - receiver, axis=1))

    @property
    def surfaces(self) -> tuple[Integers, ...]:
        """Walls (P, N) of each leg from the endpoint's side."""
        if len(self.legs) == 1:
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


def static_arrivals(links: Links, times: Floats, kinematics: Kinematics) -> Arrivals:
    """Solve the delay equation of paths by one static leg at times of reception (T,), s."""
    faces, layered = links.chain.scene.room.faces, links.chain.scene.air.layers
    walls = links.chain.walls[links.rows] if layered else None
    folds = None if walls is None else Folds((faces.normals, faces.offsets), walls)
    return arrivals_by(partial(_Images, links.legs[0], folds), links.medium, links.motions, times, kinematics)


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
    none = np.empty((count, 0), dtype=np.int32)
    images = image_columns(none, np.tile(np.eye(3), (count, 1, 1)), np.zeros((count, 3)))
    return Chain(
        scene, source.astype(np.int32), receiver.astype(np.int32), np.zeros(count, dtype=np.int32),
        np.full(count, -np.inf), np.full(count, np.inf), **images,
    )  # fmt: skip


def path_vertices(
    planes: tuple[Floats, Floats], walls: NDArray[np.signedinteger[Any]], source: Floats, receiver: Floats,
    through: NDArray[np.bool_] | None = None,
) -> Floats:  # fmt: skip
    """Return source, points of reflection and receiver (P, N + 2, 3) of paths by walls (P, N), NaN behind the receiver.

    Walls at right angles to each other, as in a shoebox, may stand in another order than they are met in. Where paths
    pass straight `through` (P, N) some, all are in the order in which they are met.
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


@dataclass(frozen=True, slots=True, eq=False)
class MovingLinks(Links):
    """Legs of which some surfaces move, and vertices."""

    def solve(self, times: Floats, kinematics: Kinematics) -> Arrivals:
        """Solve the delay equations of paths at times of reception (T,), s."""
        nodes = _AT_A_TIME if self.vertex is None else self.vertex.nodes_at_a_time
        return in_chunks(self, times, nodes, partial(_columns, kinematics))

    def places(self, time: float, kinematics: Kinematics) -> Floats:
        """Source, points of interaction and receiver (P, N + 2, 3) at a time of reception, s."""
        found = np.full((len(self), self.chain.objects.shape[1] + 2, 3), np.nan)
        for mine in [np.arange(len(self))] if self.vertex is None else self.vertex.groups():
            some: Any = self.part(mine)
            events = some.events(np.array([time]), kinematics)
            first, last = (events, None) if self.vertex is None else (events.first, events.last)
            for i, p in enumerate(mine.tolist()):
                n = int(np.sum(some.legs[0].surfaces[i] >= 0))
                found[p, : n + 2] = first.place[i, 0, : n + 2]
                if last is None:  # the receiver stands behind all mirrors
                    continue
                m, two = int(np.sum(some.legs[1].surfaces[i] >= 0)), some.vertex.objects.ndim - 1
                if (between := some.between).shape[1]:
                    b = int(np.sum(between[i] >= 0))
                    found[p, n + 2 : n + 2 + b] = events.between.place[i, 0, 1 : b + 1]
                    n += b
                found[p, n + 2 : n + m + 3 + two] = last.place[i, 0, 1 - two : m + 2]
        return found

    def lengths(self, source: Floats, receiver: Floats, times: Instant) -> Floats:
        """Lengths of paths (P,) between places (P, 3), with all mirrors where they are at times, m."""
        if self.vertex is not None:
            return np.asarray(self.vertex.moving_lengths(self, (source, receiver), times))
        leg = self.legs[0]
        return np.asarray(leg.mirrors.distances(leg.surfaces, source, receiver, times))

    def events(self, times: Floats, kinematics: Kinematics) -> Any:
        """Events of paths: of reflection alone, or those of both legs with what the vertex found."""
        medium, leg = self.medium, self.legs[0]
        assert isinstance(medium, UniformAir)
        if self.vertex is not None:
            return self.vertex.on_moving_legs(self, medium, times, kinematics)
        return find_events(leg.mirrors, leg.surfaces, self.motions, medium, times, kinematics.retarded)

    @property
    def surfaces(self) -> tuple[Integers, ...]:
        """Mirrors (P, N) of each leg from the source's side."""
        return tuple(leg.surfaces for leg in self.legs)

    @property
    def all_surfaces(self) -> Integers:
        """Mirrors (P, N) of all legs, -1 for none."""
        return np.concatenate([*self.surfaces, self.between], axis=1)

    @property
    def between(self) -> Integers:
        """Mirrors (P, B) between two vertices, -1 for none."""
        none = np.empty((len(self), 0), dtype=np.int32)
        return none if self.vertex is None else getattr(self.vertex, "between", none)


def _columns(kinematics: Kinematics, links: Any, times: Floats) -> Columns:
    """Arrivals (P, T) of events.

    The pressure is that of images of the source: it falls with the distance d of each leg from its image event, and
    by the time of reception over that of emission, ``s(t - delay) / (d dt/dt_e)``, in which the Doppler factors of
    the source and of all mirrors are. Other conditions on moving faces differ by the order of their Mach number.
    """
    passed, retarded = links.events(times, kinematics), kinematics.retarded
    first, last = (passed, passed) if links.vertex is None else (passed.first, passed.last)
    mach = first.mach if retarded else np.zeros_like(first.mach)
    delay, rate, through, cosine = first.delay, first.rate, first.distance, first.cosine
    if links.vertex is None:
        stretch = first.stretch / first.carried if retarded else np.ones_like(first.stretch)
        own: Columns = {"length": first.distance * first.carried, "mach_factor": stretch**-kinematics.exponent}
    else:
        delay, rate, through = delay + last.delay, rate + last.rate, through + last.distance
        rate = rate - first.rate * last.rate if retarded else rate
        cosines = [passed.between.cosine] if links.between.shape[1] else []
        cosine = np.concatenate([cosine, last.cosine, *cosines], axis=2)
        own = links.vertex.passed(passed, kinematics)
    return {
        "delay": delay, "delay_rate": rate, "departure": first.departure, "arrival": last.arrival,
        "through": through, "frequency_ratio": 1.0 / (1.0 - mach), "cosine": cosine,
        "emission_time": times - delay if retarded else np.broadcast_to(times, delay.shape), **own,
    }  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class MovingLeg(ByRow):
    """Legs of P paths of which some surfaces belong to bodies."""

    # (P, N) mirrors from the source's side, -1 behind the last: walls of the room, and behind them the faces of
    # bodies.
    surfaces: NDArray[np.int32]
    mirrors: Mirrors  # of the scene

    kind: ClassVar[str] = "moving"
    moving: ClassVar[bool] = True
    links: ClassVar[type[Links]] = MovingLinks

    def in_scene(self, scene: Scene, surfaces: Integers) -> MovingLeg:
        """Return legs by the mirrors of another scene."""
        return MovingLeg(self.surfaces, Mirrors.of(scene.room, scene.bodies))

    def named(self, name: str) -> Iterator[tuple[str, Any]]:
        """Yield the columns by name."""
        yield name, self.surfaces

    def __len__(self) -> int:
        return len(self.surfaces)


def moving_paths(
    scene: Scene, mirrors: Mirrors, columns: dict[str, Any], legs: tuple[str, ...], vertex: Vertex | None = None
) -> Chain:
    """Make paths of moving legs from columns, of which some are the surfaces of legs."""
    surfaces = tuple(columns[name] for name in legs)
    each: Any = vertex
    walls, at = len(scene.room.faces), None if vertex is None else (each.interaction, each.objects)
    counts = walls, walls + sum(len(body.faces) for body in scene.bodies)
    kinds, objects = met_in_order(counts, surfaces[0], at, surfaces[-1], getattr(vertex, "between", None))
    wide = np.int32 if at is not None and at[0] == DIFFRACTION else np.int64  # as they are hashed
    kinds, objects = read_only(kinds), read_only(objects.astype(wide))
    always: dict[str, Any] = {name: columns[name] for name in ("source", "receiver", "order", "start", "end")}
    moving = tuple(MovingLeg(met, mirrors) for met in surfaces)
    return Chain(scene=scene, **always, interactions=kinds, objects=objects, legs=moving, vertex=vertex)
