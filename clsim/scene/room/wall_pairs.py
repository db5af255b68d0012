"""What walls have to do with each other: a plane in common, points that several hold, lines along which they meet."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING

import numpy as np

from clsim.arrays import spread, unique_rows
from clsim.scene.room.mesh_cleaning import clusters

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Floats
    from clsim.scene.room.wall_tree import WallTree

    Ints = NDArray[np.int64]

SAME_PLANE = 1e-7  # of the size; walls nearer than this to each other's plane lie in one plane
_PARTS = 1e-9  # of the size; what is shorter is no line


def touching_pairs(tree: WallTree, low: Floats, high: Floats, slack: float) -> Ints:
    """Return pairs (n, 2) of walls whose boxes, from `low` to `high` (W, 3) m, touch; the lower index first, sorted."""
    one, other = tree.meeting_boxes(low - slack, high + slack)
    pairs = np.stack([one, other], axis=1)[one < other]
    return pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]


def same_planes(normal: Floats, offset: Floats, hull: Floats, first_hull: Ints, size: float) -> Ints:
    """Return numbers that are equal for walls in one plane, (W,).

    If all corners of each of two walls lie within a distance t of the plane of the other, the sine of the angle between
    the planes is at most ``2 t / b``, b being the width of the broader one, and their offsets from a middle of all
    walls differ by at most that sine times the farthest wall, and t: pairs are looked for this near to each other.
    """
    from scipy.spatial import cKDTree

    tolerance = SAME_PLANE * size
    middle = 0.5 * (hull.min(axis=0) + hull.max(axis=0))
    far = float(np.linalg.norm(hull - middle, axis=1).max())
    sine = np.minimum(1.0, 2.0 * tolerance / np.maximum(_widths(normal, hull, first_hull), 1e-300))
    place = np.column_stack([far * normal, offset - normal @ middle])
    near = 1.01 * np.hypot(1.5 * far * sine, 1.5 * far * sine + tolerance) + 1e-12 * size
    tree = cKDTree(place)
    pairs = [np.empty((0, 2), dtype=np.int64)]
    for sign in (1.0, -1.0):
        found = tree.query_ball_point(sign * place, near, return_sorted=False)
        count = np.array([len(f) for f in found])
        several = np.fromiter(itertools.chain.from_iterable(found), np.int64, count.sum())
        pairs.append(np.stack([np.repeat(np.arange(len(found)), count), several], axis=1))
    both = np.concatenate(pairs)
    away = np.einsum("ni,ni->n", hull[first_hull[both[:, 1]]], normal[both[:, 0]]) - offset[both[:, 0]]
    both, _, _ = unique_rows(np.sort(both[np.abs(away) <= tolerance], axis=1))
    for wall, other in ((0, 1), (1, 0)):
        away, at = heights_over(normal, offset, hull, first_hull, both[:, wall], both[:, other])
        both = both[np.maximum.reduceat(np.abs(away), at[:-1]) <= tolerance]
    return clusters(len(offset), both)[1]


def _widths(normal: Floats, hull: Floats, first_hull: Ints) -> Floats:
    """Return the least widths of convex hulls in their planes, (W,) m: from a side to the corner farthest from it."""
    count = np.diff(first_hull)
    wall = np.repeat(np.arange(len(count)), count)
    following = np.arange(1, len(hull) + 1)
    following[first_hull[1:] - 1] = first_hull[:-1]
    inward = np.cross(normal[wall], hull[following] - hull)
    inward /= np.linalg.norm(inward, axis=1, keepdims=True)
    of, corner = spread(first_hull, wall)
    away = np.einsum("ni,ni->n", hull[corner] - hull[of], inward[of])
    across = np.maximum.reduceat(away, firsts_of(of))
    return np.asarray(np.minimum.reduceat(across, first_hull[:-1]))


def firsts_of(of: Ints) -> Ints:
    """Return where each value of a sorted array, which has all from 0 on, begins."""
    return np.flatnonzero(np.concatenate([[True], of[1:] != of[:-1]]))


def heights_over(
    normal: Floats, offset: Floats, hull: Floats, first_hull: Ints, wall: Ints, other: Ints
) -> tuple[Floats, Ints]:
    """Return heights of the corners of walls `other` (n,) over planes of walls (n,), m, and where each pair begins."""
    of, corner = spread(first_hull, other)
    height = np.einsum("ni,ni->n", hull[corner], normal[wall[of]]) - offset[wall[of]]
    return height, np.concatenate([firsts_of(of), [len(of)]]).astype(np.int64)


def straddling(normal: Floats, offset: Floats, hull: Floats, first_hull: Ints, pairs: Ints, size: float) -> Ints:
    """Return those pairs of walls each of which has corners on both sides of the other."""
    for one, other in ((0, 1), (1, 0)):
        if len(pairs):
            height, first = heights_over(normal, offset, hull, first_hull, pairs[:, one], pairs[:, other])
            low, high = (f.reduceat(height, first[:-1]) for f in (np.minimum, np.maximum))
            pairs = pairs[(low < -SAME_PLANE * size) & (high > SAME_PLANE * size)]
    return pairs


def meeting(normal: Floats, offset: Floats, lines: tuple[list[Floats], list[Floats]], size: float) -> Floats:
    """Return the parts (n, 2, 3) of two planes' common line on pieces of two walls, which are told by their lines."""
    along = np.cross(normal[0], normal[1])
    along /= np.linalg.norm(along)
    point = np.linalg.solve(np.stack([normal[0], normal[1], along]), [offset[0], offset[1], 0.0])
    spans = [[s for s in (_span(point, along, piece) for piece in pieces) if s[1] > s[0]] for pieces in lines]
    parts = [(max(a[0], b[0]), min(a[1], b[1])) for a in spans[0] for b in spans[1]]
    ends = np.array([p for p in parts if p[1] - p[0] > _PARTS * size]).reshape(-1, 2)
    return np.asarray(point + ends[..., None] * along)


def _span(point: Floats, along: Floats, lines: Floats) -> tuple[float, float]:
    """Return the range of a line within a convex piece; empty if its end is not beyond its start."""
    slope, value = lines[:, :3] @ along, lines[:, :3] @ point - lines[:, 3]
    if np.any((np.abs(slope) < 1e-12) & (value < 0.0)):
        return 0.0, 0.0
    with np.errstate(divide="ignore", invalid="ignore"):
        at = -value / slope
    return (
        float(np.max(at[slope > 1e-12], initial=-np.inf)),
        float(np.min(at[slope < -1e-12], initial=np.inf)),
    )
