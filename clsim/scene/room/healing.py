"""Triangles of mesh files that are copies, or nearly meet: what is dropped, cut and joined."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from clsim.arrays import Floats, as_number, unique_rows
from clsim.errors import InputError
from clsim.scene.room.mesh_cleaning import clusters, cross_products, mesh_shape, pairs_at_edges, sides_of

Ints = NDArray[np.int64]

WELD = 1e-6  # m; vertices nearer than this are one
SMALLEST_AREA = 1e-12  # m²
_BENT = 1e-3  # of the size of triangles, by which those of one plane may leave it
_MOST_AT_EDGE = 32  # triangles at an edge that are compared
_SAME = 1e-6  # of an area, between that of a copy and that of what it covers


@dataclass(frozen=True, slots=True, eq=False)
class CleanMesh:
    """Triangles on shared vertices."""

    vertices: Floats  # (V, 3) m, each used by a triangle
    triangles: NDArray[np.int64]  # (T, 3) indices of corners
    kept: NDArray[np.int64]  # (T,) row of each triangle before cleaning
    notes: tuple[str, ...]  # what was repaired


def clean_mesh(vertices: Floats, triangles: NDArray[np.int64]) -> CleanMesh:
    """Weld vertices (V, 3), m, by position, and drop triangles (T, 3) without area and copies of others."""
    unique, _, which = unique_rows(vertices)
    count, vertex = clusters(len(unique), scipy.spatial.cKDTree(unique).query_pairs(WELD, output_type="ndarray"))
    welded = np.empty((count, 3))
    welded[vertex[::-1]] = unique[::-1]
    corners = vertex[which][triangles]
    notes = []
    area = 0.5 * np.linalg.norm(cross_products(welded[corners]), axis=1)
    flat = area <= SMALLEST_AREA
    if flat.any():
        notes.append(f"{flat.sum()} triangles without area were dropped, the first is face {np.flatnonzero(flat)[0]}")
    kept = np.flatnonzero(~flat)
    if not len(kept):
        raise InputError("triangles", f"must have an area, but all {len(triangles)} have none")
    once = kept[without_copies(welded, corners[kept])]
    if len(once) < len(kept):
        notes.append(f"{len(kept) - len(once)} triangles that lay on others were dropped")
    kept = once
    used, corners = np.unique(corners[kept], return_inverse=True)
    return CleanMesh(welded[used], corners.reshape(-1, 3).astype(np.int64), kept, tuple(notes))


def without_copies(vertices: Floats, triangles: Ints) -> Ints:
    """Rows of the triangles (T, 3), on welded vertices (V, 3), m, that are no copies of earlier ones."""
    # Copies have the same corners, or cover together the same region of a plane, whatever the diagonals of both. Of the
    # latter, faces of shells that touch are kept, as of crates on each other: without them edges would be open.
    once = np.sort(unique_rows(np.sort(triangles, axis=1))[1])
    return once[~_copies(vertices, triangles[once])]


def _copies(vertices: Floats, triangles: Ints) -> NDArray[np.bool_]:
    """Mask of the triangles that cover together what earlier ones cover."""
    found = np.zeros(len(triangles), dtype=bool)
    which = sides_of(triangles)[2]
    edge, pairs = which.reshape(-1, 3), pairs_at_edges(which, _MOST_AT_EDGE)
    flat, folded = _in_one_plane(vertices, triangles, edge, pairs)
    if folded.any():
        _, patch = clusters(len(triangles), pairs[flat])
        for one in np.unique(patch[pairs[folded, 0]]).tolist():
            mine = np.flatnonzero(patch == one)
            found[mine[_covered(vertices[triangles[mine]])]] = True
        _keep_touching(found, edge, pairs)
    return found


def _in_one_plane(
    vertices: Floats, triangles: Ints, edge: Ints, pairs: Ints
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Test pairs (n, 2) of triangles: whether they lie in one plane, and there on the same side of their edge."""
    corners = vertices[triangles]
    normal = cross_products(corners)
    area = np.linalg.norm(normal, axis=1)
    larger = np.argmax(area[pairs], axis=1)[:, None]
    one, other = (np.take_along_axis(pairs, side, axis=1)[:, 0] for side in (larger, 1 - larger))
    away = corners[other] - corners[one].mean(axis=1)[:, None]
    height = np.abs(np.einsum("nki,ni->nk", away, normal[one])).max(axis=1)
    level = height <= _BENT * area[one] * np.sqrt(area[one])
    shared = np.argmax(np.any(edge[one][:, :, None] == edge[other][:, None], axis=2), axis=1)
    begin, end = corners[one, shared], corners[one, (shared + 1) % 3]
    along = (end - begin) / np.linalg.norm(end - begin, axis=1)[:, None]
    beside = []
    for t in (one, other):
        middle = corners[t].mean(axis=1) - begin
        beside.append(middle - np.einsum("ni,ni->n", middle, along)[:, None] * along)
    onto = np.einsum("ni,ni->n", *beside) > 0.0
    return level, level & onto


def _covered(corners: Floats) -> Ints:
    """Rows of triangles (n, 3, 3), nearly of one plane, that cover together what earlier ones cover."""
    import shapely

    normal = cross_products(corners)
    size = np.linalg.norm(normal, axis=1)
    upright = normal[np.argmax(size)] / size.max()
    along = corners[np.argmax(size), 1] - corners[np.argmax(size), 0]
    axes = np.stack([along, np.cross(upright, along)]) / np.linalg.norm(along)
    local = corners - corners.mean(axis=(0, 1))
    if np.ptp(local @ upright) > _BENT * np.ptp(local, axis=(0, 1)).max():  # a chain of triangles that bends
        return np.zeros(0, dtype=np.int64)
    shapes = shapely.polygons(local @ axes.T)
    area = shapely.area(shapes)
    i, j = shapely.STRtree(shapes).query(shapes, predicate="intersects")
    i, j = i[i < j], j[i < j]
    both = shapely.area(shapely.intersection(shapes[i], shapes[j]))
    some = both > _SAME * np.minimum(area[i], area[j])
    i, j, both = i[some], j[some], both[some]
    layer = np.zeros(len(corners), dtype=np.int64)
    for t in np.unique(j).tolist():
        taken = set(layer[i[j == t]].tolist())
        layer[t] = next(n for n in range(len(taken) + 1) if n not in taken)
    found = []
    for n in range(1, int(layer.max()) + 1):
        low, high = np.where(layer[i] < layer[j], i, j), np.where(layer[i] < layer[j], j, i)
        of_layer = (layer[low] == 0) & (layer[high] == n)
        _, part = clusters(len(corners), np.stack([low[of_layer], high[of_layer]], axis=1))
        common = np.bincount(part[low[of_layer]], both[of_layer], minlength=len(corners))
        sums = [np.bincount(part, area * (layer == of), len(corners)) for of in (0, n)]
        same = (common > 0.0) & (np.maximum(*sums) - common <= _SAME * np.maximum(*sums))
        found.append(np.flatnonzero(same[part] & (layer == n)))
    return np.concatenate([np.zeros(0, dtype=np.int64), *found])


def _keep_touching(found: NDArray[np.bool_], edge: Ints, pairs: Ints) -> None:
    """Take back the copies, by parts that share edges, without which more edges are open than with them."""
    uses = np.bincount(edge.ravel())
    _, part = clusters(len(found), pairs[np.all(found[pairs], axis=1)])
    for one in np.unique(part[found]).tolist():
        mine = found & (part == one)
        left = uses - np.bincount(edge[mine].ravel(), minlength=len(uses))
        opened = np.count_nonzero((uses % 2 == 0) & (left % 2 == 1) & (left > 1))
        found[mine] = opened <= np.count_nonzero((uses % 2 == 1) & (left % 2 == 0))


HEAL = "auto"
_TOLERANCES = (1e-4, 1e-3, 3e-3, 1.2e-2)  # m, of which "auto" takes the first that leaves the fewest open edges
_OF_SIZE = 2e-3  # of the mesh's size, at most
_LARGEST = 1.0  # m
_MOST_ROUNDS = 100
_LISTED = 3


@dataclass(frozen=True, slots=True, eq=False)
class Healed:
    """A mesh that was healed."""

    vertices: Floats  # (V, 3) m
    triangles: Ints  # (T, 3)
    origin: Ints  # (T,) the triangle before of which each is a part
    notes: tuple[str, ...]  # what was changed
    places: Floats  # (n, 3) m, where


def heal_mesh(vertices: Floats, triangles: Ints, heal: str | float) -> Healed:
    """Join what nearly meets in triangles (T, 3) of vertices (V, 3) m, by "auto", "off" or a tolerance, m."""
    # Corners nearer than the tolerance become one. A triangle with a corner of another one on its side is cut there, so
    # that no slit without an area is left. Where edges stay open, it is tried without triangles thinner than the
    # tolerance. "auto" tries tolerances from 0.1 to 12 mm, 2 per mille of the size of the mesh at most, and takes the
    # first of those that leave the fewest open edges. A mesh that is closed, or that gains nothing, is left as it is.
    as_it_is = Healed(vertices, triangles, np.arange(len(triangles)), (), np.empty((0, 3)))
    if heal == "off":
        return as_it_is
    if isinstance(heal, str) and heal != HEAL:
        raise InputError("heal", f"must be 'auto', 'off' or a tolerance in m, but is {heal!r}")
    clean = clean_mesh(vertices, triangles)
    start = _open_edges(clean.vertices, clean.triangles)
    if heal == HEAL:
        if start == 0:
            return as_it_is
        most = healing_tolerance(clean.vertices, heal)
        tolerances = [t for t in _TOLERANCES if t <= most] or [most]
    else:
        tolerances = [as_number("heal", heal, at_least=WELD, at_most=_LARGEST, unit="m")]
    found = []
    for tolerance, thinner in [(t, thinner) for t in tolerances for thinner in (0.0, t)]:
        healed = _joined(clean.vertices, clean.triangles, tolerance, thinner)
        if len(healed.triangles):
            found.append((_open_edges(healed.vertices, healed.triangles), healed))
            if found[-1][0] == 0:
                break
    if not found:
        raise InputError("heal", f"must leave triangles of the mesh, but joins all corners of each: {tolerances[0]} m")
    left, best = min(found, key=lambda pair: pair[0])  # the first of the best
    if heal == HEAL and left >= start:
        return as_it_is
    return Healed(best.vertices, best.triangles, clean.kept[best.origin], best.notes, best.places)


def healing_tolerance(vertices: Floats, heal: str | float) -> float:
    """Return the largest distance, m, by which a mesh (V, 3) is healed; 0 for "off"."""
    if isinstance(heal, str):
        return 0.0 if heal == "off" else min(_TOLERANCES[-1], _OF_SIZE * float(np.ptp(vertices, axis=0).max()))
    return float(heal)


def _open_edges(vertices: Floats, triangles: Ints) -> int:
    """Count open edges, but for those of sheets in a closed room."""
    return len(mesh_shape(vertices, triangles).open_edges)


def _joined(vertices: Floats, triangles: Ints, tolerance: float, thinner: float) -> Healed:
    """Weld corners, leave out triangles thinner than a distance, m, and cut triangles at corners on their sides."""
    vertex, places, moved = _welded(vertices, tolerance)
    corners, origin = vertex[triangles], np.arange(len(triangles))
    notes, where = [], [vertices[moved > 0.0]]
    if len(places) < len(vertices):
        count = len(vertices) - len(places)
        joined = _at(places[np.unique(vertex[moved > 0.0])])
        notes.append(f"healed: {count} corners joined to others, moved by {1e3 * moved.max():.3g} mm at most, {joined}")
    corners, origin, thin = _without_flat(places, corners, origin, thinner)
    cut: dict[int, float] = {}
    for _ in range(_MOST_ROUNDS):
        pieces = _cut_once(places, corners, origin, tolerance) if len(corners) else None
        if pieces is None:
            break
        corners, origin, at = pieces
        cut |= at
        corners, origin, more = _without_flat(places, corners, origin, thinner)
        thin += more
    if thin:
        notes.append(f"healed: {thin} triangles thinner than {1e3 * thinner:.3g} mm were left out")
    if cut:
        off = f"within {1e3 * max(cut.values()):.3g} mm" if max(cut.values()) > WELD else "exactly"
        notes.append(f"healed: sides cut at {len(cut)} corners that were on them {off}, {_at(places[sorted(cut)])}")
        where.append(places[sorted(cut)])
    return Healed(places, corners, origin, tuple(notes), np.concatenate(where))


def _welded(vertices: Floats, tolerance: float) -> tuple[Ints, Floats, Floats]:
    """Index (V,) of the place that each vertex goes to, the places (n, 3), and how far each vertex moves (V,), m."""
    vertex = np.full(len(vertices), -1)
    near: Any = scipy.spatial.cKDTree(vertices).query_ball_point(vertices, tolerance)
    firsts: list[int] = []
    for i, around in enumerate(near):
        if vertex[i] < 0:
            free = [j for j in around if vertex[j] < 0]
            vertex[free] = len(firsts)
            firsts.append(i)
    places = vertices[firsts]
    return vertex, places, np.linalg.norm(places[vertex] - vertices, axis=1)


def _without_flat(places: Floats, corners: Ints, origin: Ints, thinner: float) -> tuple[Ints, Ints, int]:
    """Drop triangles without area, copies, and triangles thinner than a distance, m; these are counted."""
    # What is thinner has a corner on its longest side, at which the triangles beyond this side are cut.
    sides = places[corners] - places[np.roll(corners, 1, axis=1)]
    area = 0.5 * np.linalg.norm(cross_products(places[corners]), axis=1)
    thick = 2.0 * area > thinner * np.linalg.norm(sides, axis=2).max(axis=1)
    kept = np.flatnonzero((area > SMALLEST_AREA) & thick)
    kept = kept[without_copies(places, corners[kept])] if len(kept) else kept
    return corners[kept], origin[kept], int(np.count_nonzero((area > SMALLEST_AREA) & ~thick))


def _cut_once(
    places: Floats, corners: Ints, origin: Ints, tolerance: float
) -> tuple[Ints, Ints, dict[int, float]] | None:
    """Cut every triangle with a corner on an open side of it there, once; None where there is none."""
    # result: triangles, their origin, and the corners with their distances off the sides, m.
    sides, _, which = sides_of(corners)
    opened = np.flatnonzero((np.bincount(which) % 2 == 1)[which])
    candidates = np.unique(sides[opened])
    cuts: dict[int, tuple[int, int]] = {}  # triangle: which side, and the corner on it
    apart: dict[int, float] = {}
    for side in opened.tolist():
        a, b = places[sides[side]]
        along, length = (b - a) / np.linalg.norm(b - a), float(np.linalg.norm(b - a))
        away = places[candidates] - a
        at = away @ along
        off = np.linalg.norm(away - at[:, None] * along, axis=1)
        on = np.flatnonzero((off <= tolerance) & (at > tolerance) & (at < length - tolerance))
        on = on[~np.isin(candidates[on], corners[side // 3])]
        if len(on) and side // 3 not in cuts:
            first = on[np.argmin(at[on])]
            cuts[side // 3] = side % 3, int(candidates[first])
            apart[int(candidates[first])] = max(float(off[first]), apart.get(int(candidates[first]), 0.0))
    if not cuts:
        return None
    made, owner = [], []
    for t, triangle in enumerate(corners.tolist()):
        if t in cuts:
            side, corner = cuts[t]
            a, b, c = triangle[side:] + triangle[:side]
            made += [[a, corner, c], [corner, b, c]]
            owner += [origin[t]] * 2
        else:
            made.append(triangle)
            owner.append(origin[t])
    return np.array(made), np.array(owner), apart


def _at(places: Floats) -> str:
    """Say where the first of some places (n, 3) are."""
    shown = ", ".join(f"({', '.join(f'{x:.3f}' for x in place)})" for place in places[:_LISTED])
    return f"the first at {shown} m" if len(places) > 1 else f"at {shown} m"
