"""Wall sequences that rays meet, some of which miss small walls, and when paths go straight through thin panels."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Floats, Ints, by_value, unique_rows
from clsim.errors import check_packages
from clsim.numerics.sphere import fibonacci_sphere
from clsim.paths.search.beam_tree import Candidates, FoundPaths
from clsim.paths.visibility.clearance import blocks, segments_apart, unfold
from clsim.paths.visibility.intervals import BoundingSpheres, VisibilityQuery, find_intervals
from clsim.scene.motion.instants import Instants
from clsim.scene.motion.motion import Motion
from clsim.scene.room.faces import Mount
from clsim.scene.room.mesh import MeshRoom
from clsim.scene.room.walls import Walls

RAYS = 4_000_000  # from all positions of a source together, and at least the next number from each
_LEAST_RAYS = 20_000
_AT_ONCE = 1_000_000  # rays
_RATE = 200.0  # Hz, at which a source's way is measured
_MOST = 2_000_000  # instants of a longer one
_STEP = 0.25  # m between positions from which rays are shot
_OFF_WALL = 1e-4  # of the size; Embree's float32 is no judge nearer than this


class ShotRays:
    """Sequences collected by rays from along a trajectory."""

    def __init__(self, room: MeshRoom, source: Motion, receivers: BoundingSpheres, mount: Mount | None = None) -> None:
        self._room, self._receivers = room, receivers
        self._positions = _positions(source)
        if mount is not None:
            self._positions = self._positions + _OFF_WALL * room.walls.size * mount.normal
        self.share = 0.0  # of the work that is done
        self._halves: dict[bytes, int] = {}
        check_packages("finder", "shooting", "shooting", "embreex")
        from trimesh import Trimesh
        from trimesh.ray.ray_pyembree import RayMeshIntersector

        self._middle = 0.5 * (room.extent[0] + room.extent[1])  # float32 is finest around 0
        mesh = Trimesh(room.vertices - self._middle, room.triangles, process=False)
        self._rays = RayMeshIntersector(mesh)

    def candidates(self, max_order: int) -> Iterator[Candidates]:
        """Yield the sequences of every order that rays have met, for all receivers."""
        everyone = np.arange(len(self._receivers.radius))
        met: list[list[NDArray[np.int32]]] = [[] for _ in range(max_order)]
        directions = fibonacci_sphere(max(_LEAST_RAYS, RAYS // len(self._positions)))
        for i, position in enumerate(self._positions):
            for first in range(0, len(directions), _AT_ONCE):
                bounces = self._bounce(position, directions[first : first + _AT_ONCE], max_order)
                for order, sequences in enumerate(bounces):
                    met[order].append(sequences)
            self.share = (i + 1) / len(self._positions)
            if i % 16 == 15:
                met = [[_once(np.concatenate(some))] if some else [] for some in met]
        found = [np.empty((1, 0), dtype=np.int32)]
        for some in (_once(np.concatenate(some)) for some in met if some):
            found.append(some[:, 1:])
            self._halves |= {row[1:].tobytes(): int(row[0]) for row in some}
        for sequence in found:
            row, receiver = (x.ravel() for x in np.meshgrid(np.arange(len(sequence)), everyone, indexing="ij"))
            yield Candidates(sequence, row, receiver)

    def missed(self, walls: NDArray[np.int32]) -> float:
        """Estimate the number of paths that rays have missed, from those (P, N) that they have met.

        Of a paths that only one half of the rays has met, b that only the other has and c that both have, all are
        ``(a + c + 1) (b + c + 1) / (c + 1) - 1``, so that ``a b / (c + 1)`` are missed, or more where some are met less
        easily (D. G. Chapman, University of California Publications in Statistics 1, 131-160, 1951).
        """
        halves = [self._halves[row[row >= 0].tobytes()] for row in walls if row.max(initial=-1) >= 0]
        one, other, both = (halves.count(half) for half in (1, 2, 3))
        return one * other / (both + 1.0)

    def _bounce(self, position: Floats, directions: Floats, max_order: int) -> Iterator[NDArray[np.int32]]:
        """Yield the sequences of order 1, 2, … that rays from a position meet, each behind the halves that met it."""
        walls = self._room.walls
        origin = np.broadcast_to(position - self._middle, directions.shape)
        offset = walls.offset - walls.normal @ self._middle
        sequence = np.empty((len(directions), 0), dtype=np.int32)
        half = (1 + np.arange(len(directions)) % 2).astype(np.int32)
        for _ in range(max_order):
            triangle = self._rays.intersects_first(origin, directions)
            hit = np.flatnonzero(triangle >= 0)
            wall = walls.of_triangle[triangle[hit]]
            origin, directions, sequence = origin[hit], directions[hit], sequence[hit]
            toward = np.einsum("ni,ni->n", directions, walls.normal[wall])
            fresh = np.abs(toward) > 1e-6
            if sequence.shape[1]:
                fresh &= walls.plane[sequence[:, -1]] != walls.plane[wall]
            half = half[hit][fresh]
            rays = origin, directions, sequence, wall, toward
            origin, directions, sequence, wall, toward = (x[fresh] for x in rays)
            far = (offset[wall] - np.einsum("ni,ni->n", origin, walls.normal[wall])) / toward
            origin = origin + far[:, None] * directions
            directions = directions - 2.0 * toward[:, None] * walls.normal[wall]
            origin = origin + _OFF_WALL * walls.size * directions
            sequence = np.concatenate([sequence, wall[:, None].astype(np.int32)], axis=1)
            yield _once(np.column_stack([half, sequence]))


def _once(met: NDArray[np.int32]) -> NDArray[np.int32]:
    """Return different sequences (n, 1 + N), each behind all halves of rays that met it, a bit each."""
    sequence, _, which = unique_rows(met[:, 1:])
    halves = np.zeros(len(sequence), dtype=np.int32)
    np.bitwise_or.at(halves, which, met[:, 0])
    return np.column_stack([halves, sequence])


def _positions(source: Motion) -> Floats:
    """Return positions along a trajectory, some decimetres apart, (n, 3) m."""
    if source.is_static:
        return np.atleast_2d(source.position(0.0))
    instants = Instants(0.0, source.end, min(_RATE, _MOST / source.end))
    places = source.position(instants.times(np.arange(instants.count)))
    travelled = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(places, axis=0), axis=1))])
    stops = np.linspace(0.0, travelled[-1], max(2, min(math.ceil(travelled[-1] / _STEP), _MOST) + 1))
    return np.asarray(places[np.unique(np.searchsorted(travelled, stops).clip(max=len(places) - 1))])


THROUGH = -2  # less the wall: a panel that a path passes through, among the walls that it meets


def see_through(walls: Walls, panels: tuple[int, ...]) -> Walls:
    """Mark panels, by numbers of their planes below 0, as walls that hide nothing."""
    plane, outward, which = walls.plane.copy(), walls.outward.copy(), list(panels)
    plane[which] = -1 - plane[which]
    outward[np.isin(walls.shell, walls.shell[which])] = 0  # paths are on both sides of them
    return replace(walls, plane=plane, outward=outward)


def divided(query: VisibilityQuery, found: FoundPaths, panels: tuple[int, ...]) -> FoundPaths:
    """Divide paths by the panels that they cross: `met` holds these among the walls, and `order` counts both."""
    span = np.maximum(found.begin, query.first[found.receiver]), np.minimum(found.end, query.last[found.receiver])
    crossed = _crossings(query, found, panels, span)
    row, begin, end = _pieces(span, crossed)
    middle = 0.5 * (begin + end)
    begin = np.where(begin <= span[0][row], found.begin[row], begin)
    end = np.where(end >= span[1][row], found.end[row], end)
    # Of each piece: its walls, at whole numbers along the path, and the panels of its legs between these.
    walls = found.walls[row]
    piece, bounce = np.nonzero(walls >= 0)
    entries = [(piece, bounce + 1.0, walls[piece, bounce])]
    of_path = np.searchsorted(row, np.stack([crossed[0], crossed[0] + 1]))
    for path, leg, panel, first, last, low, high in zip(*crossed, *of_path, strict=True):
        mine = low + np.flatnonzero((first < middle[low:high]) & (middle[low:high] < last))
        share = _share(query, found, path, leg, panel, middle[mine])
        entries.append((mine, leg + share, np.full(len(mine), THROUGH - panel)))
    piece, place, thing = (np.concatenate([each[i] for each in entries]) for i in range(3))
    ranks = np.lexsort((place, piece))
    piece, thing, order = piece[ranks], thing[ranks], np.bincount(piece, minlength=len(row))
    met = np.full((len(row), int(order.max(initial=0))), -1, dtype=np.int32)
    met[piece, np.arange(len(piece)) - (np.cumsum(order) - order)[piece]] = thing
    rank = np.lexsort([begin, *met.T[::-1], order, found.receiver[row]])
    return replace(
        found, receiver=found.receiver[row][rank], order=order[rank], walls=walls[rank], begin=begin[rank],
        end=end[rank], met=met[rank],
    )  # fmt: skip


def _crossings(
    query: VisibilityQuery, found: FoundPaths, panels: tuple[int, ...], span: tuple[Floats, Floats]
) -> tuple[Any, ...]:
    """Find which paths cross which panels, on which legs, and when: path, leg, panel (n,), begin, end (n,) s."""
    parts: list[tuple[Any, ...]] = [(*(np.empty(0, dtype=np.int64),) * 3, np.empty(0), np.empty(0))]
    bounces = np.sum(found.walls >= 0, axis=1)
    for count, rows in by_value(bounces):
        sequence, spans = found.walls[rows, :count], (span[0][rows], span[1][rows])
        for panel in panels:
            for leg in range(count + 1):
                evaluations = partial(_evaluate, panel, leg, query)
                crossed = find_intervals(query, sequence, found.receiver[rows], evaluations, spans)
                each = (np.full(len(crossed.path), x) for x in (leg, panel))
                parts.append((rows[crossed.path], *each, crossed.begin, crossed.end))
    return tuple(np.concatenate(columns) for columns in zip(*parts, strict=True))


def _evaluate(
    panel: int, leg: int, query: VisibilityQuery, sequence: NDArray[np.int32], receiver: Ints, time: Floats,
    half: Floats,
) -> tuple[NDArray[np.bool_], Floats, Floats]:  # fmt: skip
    """Test whether a leg of paths crosses a panel, how far ends may move before that changes, and how far they do."""
    walls = query.walls
    source, ear, reach = query.ends_about(sequence, receiver, time, half)
    paths = unfold(walls, sequence, source, ear, reach)
    tau, slack = paths.tau, paths.slack
    a, b = paths.along(leg, tau[:, leg]), paths.along(leg, tau[:, leg + 1])
    crossed = blocks(walls, panel, a, b)
    a = paths.along(leg, np.maximum(tau[:, leg] - slack[:, leg], 0.0))
    b = paths.along(leg, np.minimum(tau[:, leg + 1] + slack[:, leg + 1], 1.0))
    clear = segments_apart(walls.edges_of(panel), a, b).min(axis=1, initial=np.inf)
    plane = np.maximum(walls.plane, -1 - walls.plane)
    for k in (leg - 1, leg):  # what is reflected in the plane of a panel does not cross it
        if 0 <= k < sequence.shape[1]:
            beside = plane[sequence[:, k]] == plane[panel]
            crossed[beside], clear[beside] = False, np.inf
    return crossed, clear, reach.most


def _pieces(span: tuple[Floats, Floats], crossed: tuple[Any, ...]) -> tuple[Ints, Floats, Floats]:
    """Divide spans of paths where a panel begins or ceases to be crossed: path (n,), begin, end (n,) s."""
    every = np.arange(len(span[0]))
    path = np.concatenate([every, crossed[0], crossed[0], every])
    time = np.concatenate([span[0], crossed[3], crossed[4], span[1]])
    path, time = np.unique(np.stack([path, time]), axis=1)
    row = path.astype(np.int64)
    inner = np.flatnonzero(row[1:] == row[:-1])
    return row[inner], time[inner], time[inner + 1]


def _share(query: VisibilityQuery, found: FoundPaths, path: int, leg: int, panel: int, times: Floats) -> Floats:
    """Find at which share of a leg (n,) a path crosses a panel at times (n,)."""
    walls, receiver = query.walls, np.full(len(times), found.receiver[path])
    met = found.walls[path][found.walls[path] >= 0]
    sequence = np.tile(met, (len(times), 1))
    source, ear, reach = query.ends_about(sequence, receiver, times, np.zeros(len(times)))
    paths = unfold(walls, sequence, source, ear, reach)
    a, b = (paths.along(leg, paths.tau[:, leg + i]) @ walls.normal[panel] - walls.offset[panel] for i in range(2))
    return np.asarray(a / (a - b))
