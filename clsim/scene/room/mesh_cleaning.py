"""Triangle meshes: edges, thin panels, description, and shells: what these enclose whatever the winding."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from clsim.arrays import Floats, unique_rows
from clsim.numerics.quaternions import cross_product

Ints = NDArray[np.int64]

_FLAT = 1e-3  # of a panel's thickness, by which its two sides may be uneven
_EVEN = 1e-3  # of the mesh's size, by which a sheet may be bent
_RAY = np.array([0.3607, 0.4783, 0.8007])  # a direction that no wall is likely to lie along
_HOLES_LISTED = 5


def thin_panels(
    vertices: Floats, triangles: NDArray[np.int64], labels: Sequence[str], thinner_than: float
) -> tuple[Floats, NDArray[np.int64], NDArray[np.int64], list[str]]:
    """Return a mesh with one layer for every separate shell that is a flat panel and thin, and the origin of triangles.

    A panel is a shell all of whose corners lie in one of two planes along its largest triangle. Its layer is the one of
    its two sides that faces along the normal of that triangle, moved half-way to the other.
    """
    made, moved, origin, notes = [], [vertices], [], []
    count = len(vertices)
    for mine, side, shift, thickness in panels(vertices, triangles):
        if not 0.0 < thickness < thinner_than:
            made.append(triangles[mine])
            origin.append(mine)
            continue
        corners, index = np.unique(triangles[mine[side]], return_inverse=True)
        moved.append(vertices[corners] + shift)
        made.append(count + index.reshape(-1, 3))
        origin.append(mine[side])
        count += len(corners)
        notes.append(f"{labels[mine[0]] or 'a panel'} of {1e3 * thickness:.3g} mm is taken as a sheet")
    return np.concatenate(moved), np.concatenate(made), np.concatenate(origin), notes


def panels(
    vertices: Floats, triangles: NDArray[np.int64]
) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64], Floats, float]]:
    """Yield the triangles of every shell, and the result of `_side` for them."""
    _, part = clusters(len(vertices), triangles[:, [0, 1, 1, 2]].reshape(-1, 2))
    shell, area = part[triangles[:, 0]], np.linalg.norm(cross_products(vertices[triangles]), axis=1)
    for one in np.unique(shell):
        mine = np.flatnonzero(shell == one)
        yield mine, *_side(vertices[triangles[mine]], area[mine])


def _side(corners: Floats, area: Floats) -> tuple[NDArray[np.int64], Floats, float]:
    """Return triangles (n,) of one side of a panel, the shift (3,) to its middle, m, and its thickness, m."""
    # The thickness is 0 for a flat shell, or one that is no panel.
    largest = corners[np.argmax(area)]
    normal = np.cross(largest[1] - largest[0], largest[2] - largest[0])
    normal /= np.linalg.norm(normal)
    height = corners @ normal
    low, high = float(height.min()), float(height.max())
    thickness = high - low
    uneven = np.minimum(height - low, high - height).max()
    if uneven > _FLAT * thickness or thickness <= 0.0:
        return np.arange(0), normal, 0.0
    side = np.flatnonzero(np.all(height > 0.5 * (low + high), axis=1))
    return side, -0.5 * thickness * normal, thickness if len(side) else 0.0


def cross_products(corners: Floats) -> Floats:
    """Return the normals of triangles (n, 3, 3) with twice their areas as lengths, (n, 3) m²."""
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def clusters(count: int, pairs: NDArray[np.int64]) -> tuple[int, NDArray[np.int64]]:
    """Return number of clusters that pairs (n, 2) form among `count` items, and the cluster of each item."""
    graph = scipy.sparse.coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(count, count))
    found, cluster = scipy.sparse.csgraph.connected_components(graph, directed=False)
    return int(found), cluster.astype(np.int64)


def sides_of(triangles: Ints) -> tuple[Ints, Ints, Ints]:
    """Return the sides (3 T, 2) of triangles (T, 3) as they turn, the edges (E, 2), and each side's edge (3 T,)."""
    directed = triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    edges, _, which = unique_rows(np.sort(directed, axis=1))
    return directed, edges, which


def pairs_at_edges(which: Ints, most: int) -> Ints:
    """Return pairs (n, 2) of triangles that share an edge, of up to so many, by the edge (3 T,) of each side."""
    order = np.argsort(which, kind="stable")
    ranked, pairs = which[order], [np.zeros((0, 2), dtype=np.int64)]
    for step in range(1, min(most, int(np.bincount(which).max()))):
        same = np.flatnonzero(ranked[step:] == ranked[:-step])
        pairs.append(np.stack([order[same], order[same + step]], axis=1) // 3)
    return np.concatenate(pairs)


@dataclass(frozen=True, slots=True, eq=False)
class MeshShape:
    """Connectivity of the triangles of a mesh."""

    open_edges: Floats  # (n, 2, 3) edges of an odd number of triangles that are no sheets, m
    flipped_edges: int  # edges whose two triangles run in the same direction: one of them is flipped
    inwards: bool  # whether it is watertight and all triangles face inwards
    sheets: NDArray[np.bool_]  # (T,) of which triangles are flat sheets in a room that is closed without them

    @property
    def watertight(self) -> bool:
        """Whether every edge belongs to an even number of triangles, but for sheets."""
        return len(self.open_edges) == 0


def mesh_shape(vertices: Floats, triangles: NDArray[np.int64]) -> MeshShape:
    """Return connectivity of triangles on welded vertices."""
    directed, edges, which = sides_of(triangles)
    sheets = _sheets(vertices, triangles, which)
    solid = np.repeat(~sheets, 3)
    uses = np.bincount(which)
    forward = np.bincount(which, weights=directed[:, 0] < directed[:, 1], minlength=len(edges))
    corners = vertices[triangles]
    volume = float(np.einsum("ti,ti->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6.0)
    opened = edges[np.bincount(which[solid], minlength=len(edges)) % 2 == 1]
    flipped = int(np.sum((uses == 2) & (forward != 1)))
    inwards = volume < 0.0 and not flipped and not len(opened) and not sheets.any()
    return MeshShape(vertices[opened], flipped, inwards, sheets)


def _sheets(vertices: Floats, triangles: NDArray[np.int64], which: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Find flat shells with open edges, (T,), if all others together are closed around them; none otherwise."""
    # which: the edge (3 T,) of every side. Shells hang together by edges of two triangles.
    uses, owner = np.bincount(which), np.repeat(np.arange(len(triangles)), 3)
    none = np.zeros(len(triangles), dtype=bool)
    if not np.any(uses % 2 == 1):
        return none
    shared = np.flatnonzero((uses == 2)[which])
    pairs = owner[shared[np.argsort(which[shared], kind="stable")]].reshape(-1, 2)
    count, shell = clusters(len(triangles), pairs)
    opened = np.zeros(count, dtype=bool)
    opened[shell[owner[(uses == 1)[which]]]] = True
    normal = cross_products(vertices[triangles])
    size = np.ptp(vertices, axis=0).max()
    for one in np.flatnonzero(opened).tolist():
        mine = np.flatnonzero(shell == one)
        largest = mine[np.argmax(np.linalg.norm(normal[mine], axis=1))]
        along = normal[largest] / np.linalg.norm(normal[largest])
        opened[one] = np.ptp(vertices[triangles[mine]] @ along) <= _EVEN * size
    sheets = opened[shell]
    left = np.bincount(which[~sheets[owner]], minlength=len(uses))
    if sheets.all() or np.any(left % 2 == 1):
        return none
    middles = vertices[triangles[sheets]].mean(axis=1)
    return sheets if np.all(_surrounded(middles, vertices[triangles[~sheets]])) else none


def _surrounded(points: Floats, corners: Floats) -> NDArray[np.bool_]:
    """Return mask of points (n, 3) from which a ray leaves through an odd number of triangles (T, 3, 3)."""
    a, along, up = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    across = np.cross(_RAY, up)
    scale = np.einsum("ti,ti->t", along, across)
    scale = np.where(np.abs(scale) > 1e-300, scale, np.inf)
    found = np.zeros(len(points), dtype=bool)
    for i, point in enumerate(points):
        away = point - a
        turned = np.cross(away, along)
        u, v = np.einsum("ti,ti->t", away, across) / scale, turned @ _RAY / scale
        met = (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (np.einsum("ti,ti->t", up, turned) / scale > 0.0)
        found[i] = np.count_nonzero(met) % 2 == 1
    return found


def describe_mesh(
    vertices: Floats, triangles: NDArray[np.int64], plane_of_wall: NDArray[np.int64], shape: MeshShape,
    notes: tuple[str, ...],
) -> list[str]:  # fmt: skip
    """Return description of a mesh, a line per fact; see `MeshRoom.describe`."""
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    size = high - low
    lines = [
        f"{len(triangles)} triangles, {len(plane_of_wall)} walls in {plane_of_wall.max() + 1} planes, "
        f"{size[0]:.4g} x {size[1]:.4g} x {size[2]:.4g} m from ({low[0]:.4g}, {low[1]:.4g}, {low[2]:.4g}) m"
    ]
    _, edges, which = sides_of(triangles)
    uses = np.bincount(which)
    shells, part = clusters(int(triangles.max()) + 1, edges)
    closed = shells - len(np.unique(part[edges[uses % 2 == 1, 0]]))
    if shells > 1:
        lines.append(f"{shells} separate shells, {closed} of them closed")
    sheets = f", but for sheets of {shape.sheets.sum()} triangles in it" if shape.sheets.any() else ""
    lines += [f"watertight{sheets}"] if shape.watertight else _openings(shape.open_edges)
    if shape.flipped_edges:
        lines.append(f"mixed winding at {shape.flipped_edges} edges; harmless, since walls are two-sided")
    elif shape.inwards:
        lines.append("all triangles face inwards; harmless, since walls are two-sided")
    return [f"room: {line}" for line in (*lines, *notes)]


def _openings(edges: Floats) -> list[str]:
    """Return description of the holes of a mesh from its open edges (n, 2, 3)."""
    holes = _holes(edges)
    around = f"{len(holes)} hole{'s' if len(holes) > 1 else ''}"
    lines = [f"open: {len(edges)} edges are not shared by two triangles, around {around}"]
    for centre, extent, count in holes[:_HOLES_LISTED]:
        at = ", ".join(f"{x:.4g}" for x in centre)
        across = " x ".join(f"{x:.4g}" for x in extent)
        lines.append(f"a hole of {count} edges at ({at}) m, {across} m")
    if len(holes) > _HOLES_LISTED:
        lines.append(f"and {len(holes) - _HOLES_LISTED} holes that are no larger")
    return lines


def _holes(edges: Floats) -> list[tuple[Floats, Floats, int]]:
    """Return centre, extent and number of edges of every hole, the largest first, from open edges (n, 2, 3)."""
    points, index = np.unique(edges.reshape(-1, 3), axis=0, return_inverse=True)
    pairs = index.reshape(-1, 2)
    count, part = clusters(len(points), pairs)
    found = []
    for i in range(count):
        mine = points[part == i]
        low, high = mine.min(axis=0), mine.max(axis=0)
        found.append((0.5 * (low + high), high - low, int(np.sum(part[pairs[:, 0]] == i))))
    return sorted(found, key=lambda hole: -float(np.linalg.norm(hole[1])))


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
        return Shells(corners, shell, np.abs(volume), _hole_shares(vertices, triangles, turn, shell))

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
    """Return the volume in an odd number of shells of a watertight mesh, m³; None where there is none."""
    # crossing: whether walls run through each other, as bent ones seem to: `contains` is then evaluated on a lattice in
    # the box around the largest shell, so that what is sunk into the floor does not count below it. The volumes of the
    # shells are taken where they agree with it within its error, 0.4 %, and of a single shell.
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
    directed, _, edge = sides_of(triangles)
    rising, owner = directed[:, 0] < directed[:, 1], np.repeat(np.arange(count), 3)
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


def _hole_shares(vertices: Floats, triangles: Ints, turn: Ints, shell: Ints) -> Floats:
    """Return the area of the holes of every shell (S,) over its surface: that of flat lids on their rims."""
    directed, edges, edge = sides_of(triangles)
    owner = np.repeat(np.arange(len(triangles)), 3)
    of_shell = np.stack([shell[owner], edge], axis=1)
    _, first, side = unique_rows(of_shell)
    net = np.bincount(side, turn[owner] * np.where(directed[:, 0] < directed[:, 1], 1.0, -1.0))
    rim = np.flatnonzero(net)
    whose, ends = of_shell[first[rim], 0], edges[edge[first[rim]]]
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
