"""Rows of paths over ends of edges: no cut where terms pass their boundaries, as the field goes on smoothly there."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from clsim.paths.vertices.edge_field import BOTH

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Floats

    Rows = NDArray[np.int64]
    Sides = NDArray[np.int8]


def joined_over_ends(
    path: Rows, begin: Floats, end: Floats, lit: Sides, side: Sides, beside: Sides
) -> tuple[Rows, Floats, Floats, Sides]:
    """Join the pieces of paths over ends of edges between two changes of side of the end.

    Shapes: path (n,); begin, end (n,) s; lit (n, 4); side (n,); beside (n, 2); result (m,), (m,) s, (m, 4).

    path: which path each piece belongs to; pieces are in the order of paths and times.

    lit: sides of the terms as the end changes sides: beyond that the field depends on them, elsewhere not. Times `BOTH`
    where the term passes its own boundary at the same time: the line of sight passes the corner itself, and the paths
    over both edges there cancel in what each would add by going round its boundary on one side.
    """
    follows = np.append(False, (path[1:] == path[:-1]) & (begin[1:] == end[:-1]))[: len(path)]
    turns = follows & np.append(False, side[1:] != side[:-1])[: len(path)]
    cut = ~follows | turns | np.append(False, np.any(beside[1:] != beside[:-1], axis=1))[: len(path)]
    first = np.flatnonzero(cut)
    last = np.append(first[1:], len(path))[: len(first)] - 1
    times = np.ones(lit.shape, dtype=np.int8)
    times[1:][lit[1:] != lit[:-1]] = BOTH
    found: list[tuple[int, float, float, Sides]] = []
    for one, other in zip(first.tolist(), last.tolist(), strict=True):
        at_start = times[one] * lit[one] if turns[one] else None
        at_end = times[other + 1] * lit[other] if other + 1 < len(path) and turns[other + 1] else None
        at_start, at_end = (lit[one] if at_end is None else at_end) if at_start is None else at_start, at_end
        if at_end is None or np.array_equal(at_start, at_end):
            found.append((one, begin[one], end[other], at_start))
        else:
            middle = 0.5 * (begin[one] + end[other])
            found += [(one, begin[one], middle, at_start), (one, middle, end[other], at_end)]
    kept, starts, ends, sides = ([row[i] for row in found] for i in range(4))
    return (
        np.array(kept, np.int64),
        np.array(starts),
        np.array(ends),
        np.array(sides, np.int8).reshape(-1, lit.shape[1]),
    )
