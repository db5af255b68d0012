"""Shells of a mesh, turned one way whatever the winding of their triangles: what they enclose, and who is in them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Floats, unique_rows
from clsim.numerics.quaternions import cross_product
from clsim.scene.room.mesh_cleaning import clusters, cross_products

Ints = NDArray[np.int64]

_POINTS = 2**16  # of the lattice that measures shells which run through each other
_LATTICE_ERROR = 4e-3  # of a volume by these points
_STEP = 1e-4  # of the size of a triangle, by which a point stands off it
_PAIRS = 16_384  # of points and triangles at a time
_LEAK = 0.05  # of the surface, above which holes make a shell open
_WHOLE = 0.9  # of the mesh's extent, from which on a shell is the room


@dataclass(frozen=True, slots=True, eq=False)
class Shells:
    """The S shells of a mesh: triangles joined by edges that two of them share."""

    corners: Floats  # (T, 3, 3) of the triangles, m, in an order by which all of a shell face outwards
    shell: Ints  # (T,) the shell of each triangle
    volume: Floats  # (S,) enclosed by each shell alone, m³; without meaning where it has holes
    holes: Floats  # (S,) area of the holes of each shell over its surface: 0 where it is closed

    @staticmethod
    def of(vertices: Floats, triangles: Ints) -> Shells | None:
        """Return the shells of triangles (T, 3) on welded vertices (V, 3); None if one has a single side."""
        oriented = _oriented(triangles)
        if oriented is None:
            return None
        turn, shell = oriented
        corners = vertices[np.where(turn[:, None] < 0, triangles[:, ::-1], triangles)]
        about = corners - vertices.mean(axis=0)
        volume = np.bincount(shell, np.einsum("ti,ti->t", about[:, 0], np.cross(about[:, 1], about[:, 2])) / 6.0)
        inwards = volume[shell] < 0.0
        corners[inwards] = corners[inwards, ::-1]
        return Shells(corners, shell, np.abs(volume), _holes(vertices, triangles, turn, shell))

    def volume_between(self) -> float:
        """Return the volume that is in an odd number of shells, none of which cross, m³."""
        low, high = self.boxes()
        normal = cross_products(self.corners)
        area = np.linalg.norm(normal, axis=1)
        total = 0.0
        for i, volume in enumerate(self.volume):
            mine = np.flatnonzero(self.shell == i)
            t = mine[np.argmax(area[mine])]
            point = self.corners[t].mean(axis=0) - _STEP * normal[t] / np.sqrt(area[t])
            around = (self.volume > volume) & np.all((low < point) & (point < high), axis=1)
            depth = sum(bool(self.holds(int(j), point[None])[0]) for j in np.flatnonzero(around))
            total += (-1.0) ** depth * volume
        return float(total)

    def holds(self, shell: int, points: Floats) -> NDArray[np.bool_]:
        """Return a mask of the points (n, 3) that a shell, which may have holes, surrounds more than half."""
        # The generalised winding number: the share of all directions in which rays leave through the shell, those that
        # enter it counted off; 1 inside a closed shell and 0 outside. A. Jacobson, L. Kavan, O. Sorkine-Hornung,
        # "Robust inside-outside segmentation using generalized winding numbers", ACM Transactions on Graphics 32(4),
        # 2013; solid angles: A. van Oosterom, J. Strackee, "The solid angle of a plane triangle", IEEE Transactions on
        # Biomedical Engineering 30(2), 1983.
        corners = self.corners[self.shell == shell]
        step = max(1, _PAIRS // len(corners))
        parts = [_winding(points[i : i + step], corners) for i in range(0, len(points), step)]
        return np.asarray(np.abs(np.concatenate(parts)) > 0.5)

    def rooms(self) -> Ints | None:
        """Return the shells with few holes or none, if one of them reaches over all of the mesh; else None."""
        low, high = self.boxes()
        nearly = self.holes <= _LEAK
        whole = np.all(high - low >= _WHOLE * (high.max(axis=0) - low.min(axis=0)), axis=1)
        return np.flatnonzero(nearly) if np.any(nearly & whole) else None

    def boxes(self) -> tuple[Floats, Floats]:
        """Return the lowest and highest corner of every shell, (S, 3) m each."""
        order = np.argsort(self.shell, kind="stable")
        first = np.searchsorted(self.shell[order], np.arange(len(self.volume)))
        low, high = (f(self.corners, axis=1)[order] for f in (np.min, np.max))
        return np.minimum.reduceat(low, first), np.maximum.reduceat(high, first)


def enclosed_volume(
    vertices: Floats, triangles: Ints, crossing: bool, contains: Callable[[Floats], NDArray[np.bool_]]
) -> float | None:
    """Return the volume in an odd number of shells of a watertight mesh, m³; None where there is none.

    crossing: whether walls run through each other, as bent ones seem to: `contains` is then evaluated on a lattice in
    the box around the largest shell, so that what is sunk into the floor does not count below it. The volumes of the
    shells are taken where they agree with it within its error, 0.4 %, and of a single shell.
    """
    shells = Shells.of(vertices, triangles)
    between = None if shells is None or np.any(shells.holes) else shells.volume_between()
    if between is None or (crossing and shells is not None and len(shells.volume) > 1):
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        if shells is not None:
            low, high = (corners[np.argmax(shells.volume)] for corners in shells.boxes())
        # Kronecker's lattice of the plastic number's next one, whose points are spread evenly in three dimensions.
        share = (0.5 + np.arange(_POINTS)[:, None] * 1.2207440846057596 ** -np.arange(1.0, 4.0)) % 1.0
        found = float(np.mean(contains(low + share * (high - low))) * np.prod(high - low))
        if between is None or abs(between - found) > _LATTICE_ERROR * found:
            between = found
    return between if between > 0.0 else None


def held_by_rooms(vertices: Floats, triangles: Ints, points: Floats) -> tuple[NDArray[np.bool_], bool] | None:
    """Return mask of points (n, 3), m, in an odd number of nearly closed shells, and whether all these are closed."""
    # Sheets and shells with large holes do not count. None if none of the others reaches over all of the mesh.
    shells = Shells.of(vertices, triangles)
    rooms = None if shells is None else shells.rooms()
    if shells is None or rooms is None:
        return None
    inside = np.sum([shells.holds(int(i), points) for i in rooms], axis=0) % 2 == 1
    return inside, not np.any(shells.holes[rooms])


def _oriented(triangles: Ints) -> tuple[Ints, Ints] | None:
    """Return 1 or -1 for each triangle (T,), by which all of a shell turn alike, and the shell of each; or None."""
    # Triangles are nodes of a graph twice, as they are and turned over: a shell with two sides is two parts of it.
    count = len(triangles)
    edge, rising, owner = _edges(triangles)
    shared = np.flatnonzero((np.bincount(edge) == 2)[edge])
    a, b = shared[np.argsort(edge[shared], kind="stable")].reshape(-1, 2).T
    one, other, over = owner[a], owner[b], np.where(rising[a] == rising[b], count, 0)
    as_is, turned = np.stack([one, other + over]), np.stack([one + count, other + count - over])
    _, part = clusters(2 * count, np.concatenate([as_is, turned], axis=1).T)
    first, second = part[:count], part[count:]
    if np.any(first == second):
        return None
    shell = np.unique(np.minimum(first, second), return_inverse=True)[1]
    return np.where(first < second, 1, -1), shell.astype(np.int64)


def _edges(triangles: Ints) -> tuple[Ints, NDArray[np.bool_], Ints]:
    """Return for every side of a triangle, (3 T,) each, its edge, if it runs to the higher vertex, and the triangle."""
    directed = triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    _, _, edge = unique_rows(np.sort(directed, axis=1))
    return edge, directed[:, 0] < directed[:, 1], np.repeat(np.arange(len(triangles)), 3)


def _holes(vertices: Floats, triangles: Ints, turn: Ints, shell: Ints) -> Floats:
    """Return the area of the holes of every shell (S,) over its surface: that of flat lids on their rims."""
    edge, rising, owner = _edges(triangles)
    of_shell = np.stack([shell[owner], edge], axis=1)
    _, first, side = unique_rows(of_shell)
    net = np.bincount(side, turn[owner] * np.where(rising, 1.0, -1.0))
    rim = np.flatnonzero(net)
    ends = np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)[first[rim]]
    whose = of_shell[first[rim], 0]
    # Rims of one hole hang together; a shell's own vertices are numbered apart from those of others.
    key, node = np.unique(whose[:, None] * len(vertices) + ends, return_inverse=True)
    count, part = clusters(len(key), node.reshape(-1, 2))
    hole = part[node.reshape(-1, 2)[:, 0]]
    middle = vertices.mean(axis=0)
    swept = 0.5 * net[rim, None] * np.cross(vertices[ends[:, 0]] - middle, vertices[ends[:, 1]] - middle)
    lids = np.stack([np.bincount(hole, swept[:, i], minlength=count) for i in range(3)], axis=1)
    owners = np.zeros(count, dtype=np.int64)
    owners[hole] = whose
    shells = int(shell.max()) + 1
    area = np.bincount(shell, 0.5 * np.linalg.norm(cross_products(vertices[triangles]), axis=1), minlength=shells)
    return np.asarray(np.bincount(owners, np.linalg.norm(lids, axis=1), minlength=shells) / area)


def _winding(points: Floats, corners: Floats) -> Floats:
    """Return the winding numbers of triangles (T, 3, 3) about points (n, 3)."""
    a, b, c = (corners[:, i] - points[:, None] for i in range(3))
    la, lb, lc = (np.sqrt(np.einsum("nti,nti->nt", x, x)) for x in (a, b, c))
    ab, bc, ca = (np.einsum("nti,nti->nt", x, y) for x, y in ((a, b), (b, c), (c, a)))
    triple = np.einsum("nti,nti->nt", a, cross_product(b, c))
    return np.asarray(np.arctan2(triple, la * lb * lc + ab * lc + bc * la + ca * lb).sum(axis=-1) / (2.0 * np.pi))
