"""Rooms of constant height over a floor plan."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from clsim.arrays import FARTHEST, LARGEST_ROOM, SMALLEST_ROOM, Floats, as_floats, as_number
from clsim.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike, NDArray

_ON = 1e-9  # of a side's length; what is nearer to it is on it


def extruded_plan(
    outline: ArrayLike, height: float, pillars: Sequence[ArrayLike]
) -> tuple[Floats, NDArray[np.int64], list[str]]:
    """Return triangles of a room over a floor plan, and the label of each.

    Shapes: outline (n, 2) m; pillars (n, 2) m; result (V, 3) m, (T, 3).

    labels: ``floor``, ``ceiling``, ``wall i`` from corner i of the outline to the next, ``pillar p wall i``.
    """
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
