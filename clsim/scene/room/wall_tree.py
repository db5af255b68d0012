"""Boxes around walls and around groups of them, so that most walls need not be looked at one by one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from clsim.arrays import Floats

    Ints = NDArray[np.int64]
    Meets = Callable[[Ints, Floats, Floats], NDArray[np.bool_]]  # things, middles and halves of boxes

GROUP = 8  # boxes in the next larger one
_TOP = 64  # boxes that are looked at one by one
_OCTAVES = 12  # of wall sizes that are told apart
_BITS = 10  # of a place in each direction
_PAIRS = 400_000  # of things and boxes looked at at a time


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
        """Return the tree of walls with given lowest and highest corners, (W, 3) m.

        Large walls are grouped apart from small ones, and walls of a size along a curve that fills the room.
        """
        order = np.arange(len(low))
        if len(low) > _TOP:
            order = np.lexsort((_curve(0.5 * (low + high)), -_octave(high - low)))
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
        """Return pairs of an intersection of half-spaces and a wall whose box no half-space surely excludes.

        Shapes: planes (n, p, 4); result (m,).
        """

        def meets(row: Ints, middle: Floats, half: Floats) -> NDArray[np.bool_]:
            """Return which boxes reach to the inner side of all planes of their row."""
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
        """Return pairs of a segment and a wall that it may come near to.

        Shapes: start, stop (n, 3) m; result (m,).
        """
        centre, along = 0.5 * (start + stop), 0.5 * (stop - start)
        reach = np.abs(along) + slack

        def meets(row: Ints, middle: Floats, half: Floats) -> NDArray[np.bool_]:
            """Return which boxes, by middles and half sizes, touch the segment of their row, by separating axes."""
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
            """Return which boxes overlap the box of their row."""
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


def _octave(extent: Floats) -> Ints:
    """Return about how often walls of an extent (n, 3) fit into the largest one, as a power of two, (n,)."""
    length = extent.max(axis=1)
    share = np.maximum(length / max(float(length.max()), 1e-300), 2.0**-_OCTAVES)
    return np.asarray(np.floor(np.log2(share)).astype(np.int64))


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
