"""Polygons in space: cut into triangles, and out of larger ones in whose plane they lie; and read from AC3D files."""

from __future__ import annotations

import shlex
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clsim.arrays import FARTHEST, LARGEST_ROOM, SMALLEST_ROOM, Floats, as_floats, as_number
from clsim.errors import InputError
from clsim.files.input_files import LARGEST_TEXT, read_file

Ints = NDArray[np.int64]

_AREA_TOLERANCE = 1e-6  # relative, between a polygon's area and that of its triangles, or of a copy
_PLANE_TOLERANCE = 1e-3  # of a polygon's size, beyond which it is called not planar
_FLAT = 1e-12  # of the size squared, below which an area is rounding
_GRID = 1e-9  # of the size, on which polygons are compared
_PARALLEL = 1e-3  # sine of the angle between the planes of a polygon and of one that lies in it
_MOSTLY = 0.9  # of a polygon's area, from which on it lies in another
_ON = 1e-9  # of a side's length; what is nearer to it is on it


def polygon_notes(counts: Counter[str]) -> tuple[str, ...]:
    """Return sentences on what `cut_polygon` met."""
    said = {
        "concave": "concave {} ear-clipped.",
        "bent": f"{{}} not planar (by more than {_PLANE_TOLERANCE:g} of the size) and cut into triangles.",
        "flat": "{} without an area and left out.",
    }
    met = [(counts[key], text) for key, text in said.items() if counts[key]]
    return tuple(f"{n} " + text.format("polygon was" if n == 1 else "polygons were") for n, text in met)


def cut_polygon(corners: Floats, counts: Counter[str]) -> Ints:
    """Cut a polygon, corners (n, 3) in order, into triangles (T, 3) of their indices, which turn as it does."""
    # It may be concave, and touch itself along a seam, as polygons with holes are written; one without area gives none.
    from mapbox_earcut import triangulate_float64

    centre, axes, extent = _plane(corners)
    local = corners - centre
    size = float(np.linalg.norm(np.ptp(local, axis=0)))
    flat, depth = np.zeros((len(corners), 2)), 0.0  # in the plane of Newell's normal, turning left
    if extent > _FLAT * size**2:
        flat, depth = np.ascontiguousarray(local @ axes[:2].T), float(np.max(np.abs(local @ axes[2])))
    area = 0.5 * float(np.sum(_cross(flat, np.roll(flat, -1, axis=0))))
    if abs(area) <= _FLAT * size**2:
        spread = np.linalg.svd(corners - corners.mean(axis=0), compute_uv=False)
        if spread[1] > np.sqrt(_FLAT) * size:
            raise ValueError("must not cross itself, but the parts of its area cancel")
        counts["flat"] += 1
        return np.zeros((0, 3), dtype=np.int64)
    cut = triangulate_float64(flat, np.array([len(flat)], dtype=np.uint32)).astype(np.int64).reshape(-1, 3)
    a, b, c = (flat[cut[:, k]] for k in range(3))
    signed = 0.5 * _cross(b - a, c - a)
    if np.sum(signed) < 0.0:
        cut = cut[:, ::-1]
    covered = float(np.sum(np.abs(signed)))
    if abs(covered - area) > _AREA_TOLERANCE * area:
        raise ValueError(
            f"must not cross itself: its area is {area:.7g}, but its triangles cover {covered:.7g} (units of the file)"
        )
    before, after = flat - np.roll(flat, 1, axis=0), np.roll(flat, -1, axis=0) - flat
    counts["concave"] += bool(np.any(_cross(before, after) < -_FLAT * size**2))
    counts["bent"] += bool(depth > _PLANE_TOLERANCE * size)
    return cut


def _cross(a: Floats, b: Floats) -> Floats:
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])


def checked_polygons(value: Any, count: int) -> list[Ints]:
    """Convert polygons to arrays (k,) of numbers below a count of corners."""
    if isinstance(value, str) or not hasattr(value, "__len__") or not len(value):
        raise InputError("polygons", f"must be lists of corner numbers, one at least, but are {value!r:.80}")
    rows = []
    for i, polygon in enumerate(value):
        try:
            row = np.asarray(polygon)
        except ValueError:
            row = np.empty((0, 0))
        if row.ndim != 1 or len(row) < 3 or row.dtype.kind not in "iu":
            raise InputError(f"polygons[{i}]", f"must be three corner numbers or more, but is {polygon!r:.80}")
        if row.min() < 0 or row.max() >= count:
            raise InputError(f"polygons[{i}]", f"must name corners from 0 to {count - 1}, but is {polygon!r:.80}")
        rows.append(row.astype(np.int64))
    return rows


def triangulated(corners: Floats, polygons: list[Ints], which: list[int], near: float) -> tuple[Ints, Ints, list[str]]:
    """Cut some polygons into triangles (T, 3), and return the polygon (T,) of each, and notes."""
    # near: distance of planes, m, within which polygons that lie in others are cut out of them; 0 for never.
    triangles, owner, counts = [np.zeros((0, 3), np.int64)], [np.zeros(0, np.int64)], Counter[str]()
    inner, cut = without_inner(corners, [polygons[i] for i in which], near) if near > 0.0 else ([], [])
    for place, i in enumerate(which):
        if place in cut:
            made = np.array(inner[place], dtype=np.int64).reshape(-1, 3)
        else:
            try:
                made = polygons[i][cut_polygon(corners[polygons[i]], counts)]
            except ValueError as error:
                raise InputError(f"polygons[{i}]", str(error)) from None
        triangles.append(made)
        owner.append(np.full(len(made), i))
    said = [f"{len(cut)} polygons have others in their plane, which were cut out of them."] if cut else []
    return np.concatenate(triangles), np.concatenate(owner), [*polygon_notes(counts), *said]


def without_inner(corners: Floats, polygons: Sequence[Ints], near: float) -> tuple[list[list[Ints]], list[int]]:
    """Cut out of each polygon, corner numbers (k,), the smaller ones that lie in it, within a distance, m."""
    # Returns for each polygon its triangles (T, 3) by part if it was cut, else none, and the polygons that were.
    from shapely import Polygon

    planes = [_plane(corners[polygon]) for polygon in polygons]
    parts: list[list[Ints]] = [[] for _ in polygons]
    cut: list[int] = []
    for i, (polygon, (centre, axes, area)) in enumerate(zip(polygons, planes, strict=True)):
        if area == 0.0:
            continue
        flat: list[Any] = []
        inner: list[Ints] = []
        for other, (_, turned, smaller) in zip(polygons, planes, strict=True):
            if (
                not 0.0 < smaller < (1.0 - _AREA_TOLERANCE) * area
                or np.linalg.norm(np.cross(axes[2], turned[2])) > _PARALLEL
            ):
                continue
            local = (corners[other] - centre) @ axes.T
            if np.abs(local[:, 2]).max() > near:
                continue
            if not flat:
                flat.append(Polygon(((corners[polygon] - centre) @ axes.T)[:, :2]))
            shape = Polygon(local[:, :2])
            # Without a grid, intersections of polygons that share an edge but for rounding may be wrong.
            valid = shape.is_valid and flat[0].is_valid
            if valid and flat[0].intersection(shape, grid_size=_GRID * area**0.5).area > _MOSTLY * shape.area:
                flat.append(shape)
                inner.append(other)
        if not inner:
            continue
        left = flat[0]
        for shape in flat[1:]:
            left = left.difference(shape)
        known = np.concatenate([polygon, *inner])
        places = ((corners[known] - centre) @ axes.T)[:, :2]
        parts[i] = [known[corner] for corner in _triangles(left, places, near)]
        cut.append(i)
    return parts, cut


def _triangles(shape: Any, places: Floats, near: float) -> Iterator[Ints]:
    """Yield the triangles of a shape as numbers (3,) of places (n, 2), m, but for those with a corner at none."""
    from shapely.constructive import constrained_delaunay_triangles

    for triangle in constrained_delaunay_triangles(shape).geoms:
        ring = np.array(triangle.exterior.coords)[:3]
        apart = np.linalg.norm(places - ring[:, None], axis=2)
        if np.all(apart.min(axis=1) <= near):
            yield apart.argmin(axis=1)


def _plane(corners: Floats) -> tuple[Floats, Floats, float]:
    """Middle (3,) of a polygon (n, 3), axes (3, 3) of which the last is its normal, and its area, m²."""
    centre = corners.mean(axis=0)
    local = corners - centre
    normal = 0.5 * np.sum(np.cross(local, np.roll(local, -1, axis=0)), axis=0)
    area = float(np.linalg.norm(normal))
    if area == 0.0:
        return centre, np.eye(3), 0.0
    normal = normal / area
    u = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    u /= np.linalg.norm(u)
    return centre, np.stack([u, np.cross(normal, u), normal]), area


def extruded_plan(
    outline: ArrayLike, height: float, pillars: Sequence[ArrayLike]
) -> tuple[Floats, NDArray[np.int64], list[str]]:
    """Return vertices (V, 3), m, and triangles (T, 3) of a room over a floor plan (n, 2), m, and the label of each."""
    from mapbox_earcut import triangulate_float64

    height = as_number("height", height, at_least=SMALLEST_ROOM, at_most=LARGEST_ROOM, unit="m")
    rings = [_ring("outline", outline)] + [_ring(f"pillars[{i}]", p) for i, p in enumerate(pillars)]
    plan = np.concatenate(rings)
    ends = np.cumsum([len(ring) for ring in rings])
    floor = triangulate_float64(plan, ends.astype(np.uint32)).astype(np.int64).reshape(-1, 3)
    covered = sum(abs(_area(plan[t])) for t in floor)
    wanted = abs(_area(rings[0])) - sum(abs(_area(ring)) for ring in rings[1:])
    if not abs(covered - wanted) <= 1e-9 * abs(_area(rings[0])):
        raise InputError("outline", "must not cross itself or a pillar, and pillars must stand inside, apart")
    floor = _split_at_corners(plan, floor)
    count = len(plan)
    vertices = np.concatenate([np.column_stack([plan, np.full(count, z)]) for z in (0.0, height)])
    triangles, labels = [*floor, *(floor + count)], ["floor"] * len(floor) + ["ceiling"] * len(floor)
    first = 0
    for r, ring in enumerate(rings):
        for i in range(len(ring)):
            a, b = first + i, first + (i + 1) % len(ring)
            triangles += [np.array([a, b, b + count]), np.array([a, b + count, a + count])]
            labels += [f"wall {i}" if r == 0 else f"pillar {r - 1} wall {i}"] * 2
        first += len(ring)
    return vertices, np.array(triangles), labels


def _split_at_corners(plan: Floats, floor: NDArray[np.int64]) -> NDArray[np.int64]:
    """Triangles (T, 3) of the plan (V, 2), none with a corner of another one on its side: else the room is not closed.

    Corners in line, such as those of pillars in a row, are left out of triangles without an area.
    """
    whole, parts = floor.tolist(), []
    while whole:
        triangle = whole.pop()
        for a, b, c in (triangle, triangle[1:] + triangle[:1], triangle[2:] + triangle[:2]):
            side, away = plan[b] - plan[a], plan - plan[a]
            along, length = away @ side, side @ side
            off = np.abs(away[:, 0] * side[1] - away[:, 1] * side[0])
            on = np.flatnonzero((off <= _ON * length) & (along > _ON * length) & (along < (1.0 - _ON) * length))
            on = on[~np.isin(on, triangle)]
            if len(on):
                corner = int(on[0])
                whole += [[a, corner, c], [corner, b, c]]
                break
        else:
            parts.append(triangle)
    return np.array(parts[::-1])


def _ring(field: str, value: ArrayLike) -> Floats:
    ring = as_floats(field, value, (None, 2), within=FARTHEST, unit="m")
    if len(ring) < 3 or not abs(_area(ring)) > 0.0:
        raise InputError(field, f"must be three corners or more around an area, but is {ring.tolist()!r:.80}")
    return ring


def _area(ring: Floats) -> float:
    """Return the signed area of a polygon (n, 2)."""
    x, y = (ring - ring[0]).T
    return float(0.5 * np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))


_KIND = 0x0F  # bits of a surface's flags: 0 for a polygon, others are lines
_DEEPEST = 200


@dataclass(slots=True)
class _Lines:
    """The lines of a file, in order."""

    path: Path
    lines: list[str]
    at: int = 0

    def next(self) -> list[str]:
        """Return the words of the next line that has some; none at the end."""
        while self.at < len(self.lines):
            self.at += 1
            text = self.lines[self.at - 1].strip()
            if text:
                try:
                    return shlex.split(text)
                except ValueError:
                    return text.split()
        return []

    def numbers(self, words: list[str], count: int) -> list[float]:
        """Return so many numbers of a line, or refuse it."""
        try:
            found = [float(word) for word in words[:count]]
        except ValueError:
            found = []
        if len(found) < count:
            raise self.wrong(f"must have {count} numbers, but is {' '.join(words)!r:.60}")
        return found

    def count(self, words: list[str]) -> int:
        """Return the whole number of a line, at most one for each line that is left."""
        number = self.numbers(words, 1)[0]
        if not (number == int(number) and 0 <= number <= len(self.lines) - self.at):
            raise self.wrong(f"must have a count of what follows, but has {words[0]!r:.40}")
        return int(number)

    def wrong(self, problem: str) -> InputError:
        return InputError(str(self.path), f"line {self.at} {problem}")


def read_ac3d(path: Path) -> tuple[Floats, list[NDArray[np.int64]], list[int], list[str]]:
    """Read corners (n, 3), polygons of them, the material of each, and the materials' names."""
    # "The AC3D file format", version 3.0, at the site of AC3D: text, an object to a block, blocks in a tree.
    try:
        data = read_file(path, LARGEST_TEXT)
    except OSError as error:
        raise InputError(str(path), f"cannot be read: {error.strerror or error}") from error
    if not data.startswith(b"AC3D") or b"\0" in data:
        raise InputError(str(path), "must be an AC3D file, which begins with AC3D, but is not")
    lines = _Lines(path, data.decode("utf-8", "replace").splitlines(), 1)
    materials: list[str] = []
    vertices: list[Floats] = []
    polygons: list[NDArray[np.int64]] = []
    of_polygon: list[int] = []
    while words := lines.next():
        if words[0] == "MATERIAL":
            materials.append(words[1] if len(words) > 1 else "")
        elif words[0] == "OBJECT":
            _read_object(lines, np.eye(3), np.zeros(3), vertices, polygons, of_polygon, 0)
        else:
            raise lines.wrong(f"must begin a material or an object, but is {' '.join(words)!r:.60}")
    for number in sorted(set(of_polygon)):
        if not 0 <= number < len(materials):
            raise InputError(str(path), f"must use materials from 0 to {len(materials) - 1}, but uses {number}")
    if not polygons:
        raise InputError(str(path), "must hold faces, but holds none")
    return np.concatenate(vertices), polygons, of_polygon, materials


def _read_object(
    lines: _Lines, turn: Floats, shift: Floats, vertices: list[Floats], polygons: list[NDArray[np.int64]],
    of_polygon: list[int], depth: int,
) -> None:  # fmt: skip
    """Read an object and its descendants; each is turned and moved within the one above."""
    if depth > _DEEPEST:
        raise lines.wrong(f"must have objects in each other {_DEEPEST} deep at most")
    first, count = sum(map(len, vertices)), 0
    while words := lines.next():
        if words[0] == "loc":
            shift = shift + turn @ np.array(lines.numbers(words[1:], 3))
        elif words[0] == "rot":
            turn = turn @ np.array(lines.numbers(words[1:], 9)).reshape(3, 3).T
        elif words[0] == "data":
            lines.at += 1  # a line of text
        elif words[0] == "numvert":
            count = lines.count(words[1:])
            own = np.array([lines.numbers(lines.next(), 3) for _ in range(count)]).reshape(-1, 3)
            vertices.append(own @ turn.T + shift)
        elif words[0] == "SURF":
            _read_surface(lines, words, first, count, polygons, of_polygon)
        elif words[0] == "kids":
            for _ in range(lines.count(words[1:])):
                if lines.next()[:1] != ["OBJECT"]:
                    raise lines.wrong("must begin an object that stands in another one")
                _read_object(lines, turn, shift, vertices, polygons, of_polygon, depth + 1)
            return


def _read_surface(
    lines: _Lines, words: list[str], first: int, count: int, polygons: list[NDArray[np.int64]], of_polygon: list[int]
) -> None:
    """Read a surface; lines are left out."""
    try:
        flags = int(words[1], 0)
    except (IndexError, ValueError):
        raise lines.wrong("must have the flags of a surface") from None
    material, corners = 0, []
    while words := lines.next():
        if words[0] == "mat":
            material = int(lines.numbers(words[1:], 1)[0])
        elif words[0] == "refs":
            for _ in range(lines.count(words[1:])):
                corner = lines.numbers(lines.next(), 1)[0]
                if not (corner == int(corner) and 0 <= corner < count):
                    raise lines.wrong(f"must name a corner from 0 to {count - 1}, but names {corner:g}")
                corners.append(first + int(corner))
            break
    if flags & _KIND == 0 and len(corners) >= 3:
        polygons.append(np.array(corners, dtype=np.int64))
        of_polygon.append(material)
