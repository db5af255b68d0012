"""Relations between walls: common planes, shared points, lines of intersection, and a tree of bounding boxes."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from clsim.arrays import Floats, spread, unique_rows
from clsim.scene.room.mesh_cleaning import clusters

Ints = NDArray[np.int64]
Meets = Callable[[Ints, Floats, Floats], NDArray[np.bool_]]  # things, middles and halves of boxes

SAME_PLANE = 1e-7  # of the size; walls nearer than this to each other's plane lie in one plane
_PARTS = 1e-9  # of the size; what is shorter is no line
GROUP = 8  # boxes in the next larger one
_TOP = 64  # boxes that are looked at one by one
_OCTAVES = 12  # of wall sizes that are told apart
_BITS = 10  # of a place in each direction
_PAIRS = 400_000  # of things and boxes looked at at a time


def same_planes(normal: Floats, offset: Floats, hull: Floats, first_hull: Ints, size: float) -> Ints:
    """Return numbers that are equal for walls in one plane, (W,)."""
    # If all corners of each of two walls lie within a distance t of the plane of the other, the sine of the angle
    # between the planes is at most ``2 t / b``, b being the width of the broader one, and their offsets from a middle
    # of all walls differ by at most that sine times the farthest wall, and t: pairs are looked for this near to each
    # other.
    tolerance = SAME_PLANE * size
    middle = 0.5 * (hull.min(axis=0) + hull.max(axis=0))
    far = float(np.linalg.norm(hull - middle, axis=1).max())
    sine = np.minimum(1.0, 2.0 * tolerance / np.maximum(_widths(normal, hull, first_hull), 1e-300))
    place = np.column_stack([far * normal, offset - normal @ middle])
    near = 1.01 * np.hypot(1.5 * far * sine, 1.5 * far * sine + tolerance) + 1e-12 * size
    tree = scipy.spatial.cKDTree(place)
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
        if not len(both):  # all walls are bent by more
            break
        away, at = heights_over(normal, offset, hull, first_hull, both[:, wall], both[:, other])
        both = both[np.maximum.reduceat(np.abs(away), at[:-1]) <= tolerance]
    return clusters(len(offset), both)[1]


def inwards(ring: Floats, first: Ints, normal: Floats) -> Floats:
    """Return unit normals of the sides of convex rings, counterclockwise about normals, each field (n, 3)."""
    following = np.arange(1, len(ring) + 1)
    following[first[1:] - 1] = first[:-1]
    inward = np.cross(normal, ring[following] - ring)
    return np.asarray(inward / np.linalg.norm(inward, axis=1, keepdims=True))


def _widths(normal: Floats, hull: Floats, first_hull: Ints) -> Floats:
    """Return the least widths of convex hulls in their planes, (W,) m: from a side to the corner farthest from it."""
    count = np.diff(first_hull)
    wall = np.repeat(np.arange(len(count)), count)
    inward = inwards(hull, first_hull, normal[wall])
    of, corner = spread(first_hull, wall)
    away = np.einsum("ni,ni->n", hull[corner] - hull[of], inward[of])
    across = np.maximum.reduceat(away, firsts_of(of))
    return np.asarray(np.minimum.reduceat(across, first_hull[:-1]))


def firsts_of(of: Ints) -> Ints:
    """Return first index of each value of a sorted array that contains all values from 0."""
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
    """Return segments (n, 2, 3) of the planes' common line on convex pieces of two walls, given by their side lines."""
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
    return (float(np.max(at[slope > 1e-12], initial=-np.inf)), float(np.min(at[slope < -1e-12], initial=np.inf)))


@dataclass(frozen=True, slots=True, eq=False)
class BoxesInDepth:
    """Boxes of all levels, each before those in it."""

    middle: Floats  # (n, 3) of the boxes, m
    half: Floats  # likewise
    wall: Ints  # (n,) wall of the box, -1 for a group
    skip: Ints  # (n,) the next box that is not in this one


@dataclass(frozen=True, slots=True, eq=False)
class WallTree:
    """Boxes in levels: box i of a level holds the boxes from ``GROUP * i`` on of the level before."""

    wall: Ints  # (W,) wall of each box of the first level
    middle: tuple[Floats, ...]  # of the boxes, level by level, m
    half: tuple[Floats, ...]  # likewise

    @staticmethod
    def around(low: Floats, high: Floats) -> WallTree:
        """Return the tree of walls with given lowest and highest corners, (W, 3) m."""
        # Large walls are grouped apart from small ones, and walls of a size along a curve that fills the room.
        order = np.arange(len(low))
        if len(low) > _TOP:
            length = (high - low).max(axis=1)
            share = np.maximum(length / max(float(length.max()), 1e-300), 2.0**-_OCTAVES)
            octave = np.floor(np.log2(share)).astype(np.int64)  # below the largest wall
            order = np.lexsort((_curve(0.5 * (low + high)), -octave))
        middle, half = [0.5 * (low + high)[order]], [0.5 * (high - low)[order]]
        while len(middle[-1]) > _TOP:
            starts = np.arange(0, len(middle[-1]), GROUP)
            lowest = np.minimum.reduceat(middle[-1] - half[-1], starts)
            highest = np.maximum.reduceat(middle[-1] + half[-1], starts)
            middle.append(0.5 * (lowest + highest))
            half.append(0.5 * (highest - lowest))
        return WallTree(order, tuple(middle), tuple(half))

    @property
    def has_groups(self) -> bool:
        """Whether there are boxes of boxes; without them there is one for each wall, in the order of these."""
        return len(self.middle) > 1

    def in_depth(self) -> BoxesInDepth:
        """Return the boxes in the order of a walk that goes into each box before it goes on, as devices take them."""
        length = np.ones(len(self.wall), dtype=np.int64)  # boxes in a box, itself included
        lengths = [length]
        for boxes in self.middle[1:]:
            length = 1 + np.add.reduceat(length, GROUP * np.arange(len(boxes)))
            lengths.append(length)
        at = np.cumsum(lengths[-1]) - lengths[-1]
        count = sum(len(level) for level in lengths)
        found = BoxesInDepth(np.empty((count, 3)), np.empty((count, 3)), np.full(count, -1), np.full(count, -1))
        for level in range(len(self.middle) - 1, -1, -1):
            found.middle[at], found.half[at] = self.middle[level], self.half[level]
            found.skip[at] = at + lengths[level]
            if level:
                parent = np.arange(len(lengths[level - 1])) // GROUP
                before = np.cumsum(lengths[level - 1]) - lengths[level - 1]
                at = at[parent] + 1 + before - before[GROUP * parent]
        found.wall[at] = self.wall
        return found

    def meeting_planes(self, planes: Floats, slack: float) -> tuple[Ints, Ints]:
        """Return pairs (m,) of an intersection of half-spaces (n, p, 4) and a wall whose box none of them excludes."""

        def meets(row: Ints, middle: Floats, half: Floats) -> NDArray[np.bool_]:
            """Return mask of boxes that reach to the inner side of all planes of their row."""
            inside = np.ones(len(row), dtype=bool)
            for p in range(planes.shape[1]):
                plane = planes[:, p][row]
                height = np.einsum("ni,ni->n", plane[:, :3], middle) - plane[:, 3]
                inside &= height + np.einsum("ni,ni->n", np.abs(plane[:, :3]), half) >= -slack
            return inside

        top = len(self.middle) - 1
        middle, half = self.middle[top], self.half[top]
        normal, away = planes[..., :3].reshape(-1, 3), planes[..., 3].reshape(-1, 1)
        height = normal @ middle.T + np.abs(normal) @ half.T - away
        seen = np.all(height.reshape(*planes.shape[:2], -1) >= -slack, axis=1)
        row, box = np.nonzero(seen)
        return self._below(top, row, box, meets)

    def meeting_segments(self, start: Floats, stop: Floats, slack: float) -> tuple[Ints, Ints]:
        """Return pairs of a segment and a wall that it may come near to; start, stop (n, 3) m; result (m,)."""
        centre, along = 0.5 * (start + stop), 0.5 * (stop - start)
        reach = np.abs(along) + slack

        def meets(row: Ints, middle: Floats, half: Floats) -> NDArray[np.bool_]:
            """Return mask of boxes that touch the segment of their row, by separating axes; centres and half sizes."""
            apart, length, away = along[row], reach[row], middle - centre[row]
            near = np.all(np.abs(away) <= half + length, axis=1)
            for i, j in ((1, 2), (2, 0), (0, 1)):  # an axis apart from both: the cross product of segment and axis
                turn = np.abs(apart[:, i] * away[:, j] - apart[:, j] * away[:, i])
                near &= turn <= length[:, i] * (half[:, j] + slack) + length[:, j] * (half[:, i] + slack)
            return np.asarray(near)

        return self._from_top(len(start), meets)

    def meeting_boxes(self, low: Floats, high: Floats) -> tuple[Ints, Ints]:
        """Return pairs of a box, from `low` to `high` (n, 3) m, and a wall whose box it touches; sorted."""
        centre, reach = 0.5 * (low + high), 0.5 * (high - low)

        def meets(row: Ints, middle: Floats, half: Floats) -> NDArray[np.bool_]:
            """Return mask of boxes that overlap the box of their row."""
            return np.asarray(np.all(np.abs(middle - centre[row]) <= half + reach[row], axis=1))

        return self._from_top(len(low), meets)

    def _from_top(self, count: int, meets: Meets) -> tuple[Ints, Ints]:
        """Return the pairs of `count` things and walls that pass a test of boxes on every level."""
        top = len(self.middle) - 1
        boxes = len(self.middle[top])
        step, found = max(1, _PAIRS // boxes), [(np.empty(0, dtype=np.int64),) * 2]
        for first in range(0, count, step):
            row = np.repeat(np.arange(first, min(first + step, count)), boxes)
            box = np.tile(np.arange(boxes), len(row) // boxes)
            seen = meets(row, self.middle[top][box], self.half[top][box])
            found.append(self._below(top, row[seen], box[seen], meets))
        rows, walls = (np.concatenate(parts) for parts in zip(*found, strict=True))
        return rows, walls

    def _below(self, level: int, row: Ints, box: Ints, meets: Meets) -> tuple[Ints, Ints]:
        """Go down from pairs of a thing and a box to pairs of a thing and a wall."""
        for below in range(level - 1, -1, -1):
            count = len(self.middle[below])
            row, box = np.repeat(row, GROUP), (GROUP * box[:, None] + np.arange(GROUP)).ravel()
            row, box = row[box < count], box[box < count]
            near = meets(row, self.middle[below][box], self.half[below][box])
            row, box = row[near], box[near]
        return row, self.wall[box]


def _curve(points: Floats) -> Ints:
    """Return the places of points (n, 3) along Morton's curve through the cube that holds them, (n,)."""
    low = points.min(axis=0)
    cube = max(float(np.ptp(points, axis=0).max()), 1e-300)
    cell = np.minimum((points - low) / cube * 2**_BITS, 2**_BITS - 1).astype(np.int64)
    place = np.zeros(len(points), dtype=np.int64)
    for bit in range(_BITS):
        for axis in range(3):
            place |= ((cell[:, axis] >> bit) & 1) << (3 * bit + axis)
    return place
