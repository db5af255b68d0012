"""Where one edge path goes over into another: one event, told at one time."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from clsim.arrays import read_only
from clsim.paths.family import DIFFRACTION, ends_at

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Floats
    from clsim.paths.chain import Chain

    Rows = NDArray[np.int64]

_SAME_DELAY = 3e-8  # s, between paths of which one goes over into the other
_ROUNDS = 4  # of finding the time of emission


def with_swaps(family: Chain, within: float) -> Chain:
    """Return the paths with one time for the end of one and the beginning of another where they are the same event.

    This is where two walls are met in another order, or where the apex goes on from an edge to the next one or to its
    corner: both paths are as long as each other then. Pieces of one path meet already; where a path over an end of an
    edge changes sides, the path over the edge itself begins or ends.
    """
    start, end = _with_ends(family, within)
    pair = family.source.astype(np.int64) * len(family.scene.receivers) + family.receiver
    ends = np.flatnonzero(np.isfinite(end) & ~_among(pair, end, pair, start))
    starts = np.flatnonzero(np.isfinite(start) & ~_among(pair, start, pair, end))
    mine, theirs = _same_events(family, (starts, start[starts]), (ends, end[ends]), within)
    longer = end[theirs] < end[mine]  # nothing ends as it begins
    start[mine[longer][::-1]] = end[theirs[longer][::-1]]
    family = replace(family, start=read_only(start), end=read_only(end))
    kept = np.flatnonzero(start < end)
    return family if len(kept) == len(start) else family.part(kept)


def _with_ends(family: Chain, within: float) -> tuple[Floats, Floats]:
    """Compute starts and ends, s, where paths over edges have the times at which those over their ends change sides."""
    start, end, count = np.array(family.start), np.array(family.end), len(family.vertex.lines)
    edges = (family.interactions == DIFFRACTION) & (family.objects >= count)
    over = np.where(edges, (family.objects - count) // 2, family.objects)
    way = [tuple(row) for row in np.column_stack([family.source, family.receiver, over]).tolist()]
    follows = np.append(False, np.all(family.objects[1:] == family.objects[:-1], axis=1) & (start[1:] == end[:-1]))
    turns = follows & np.append(False, family.vertex.end_side[1:] != family.vertex.end_side[:-1])
    passing: dict[tuple[int, ...], list[float]] = {}
    for row in np.flatnonzero(turns[: len(start)]).tolist():
        passing.setdefault(way[row], []).append(float(start[row]))
    first = np.flatnonzero(~follows[: len(start)])
    for one, after in zip(first.tolist(), [*first[1:].tolist(), len(start)], strict=True) if passing else ():
        rows = slice(one, after)
        for time in passing.get(way[one], []) if family.vertex.end_side[one] == 0 else ():
            if abs(start[one] - time) <= within:
                start[one] = time
                start[rows] = np.maximum(start[rows], time)
            elif abs(end[after - 1] - time) <= within:
                end[after - 1] = time
                end[rows] = np.minimum(end[rows], time)
    return start, end


def _same_events(
    family: Chain, one: tuple[Rows, Floats], other: tuple[Rows, Floats], within: float
) -> tuple[Rows, Rows]:
    """Find the rows of `one` and of `other` (n,) at whose times, s, both paths between two ends are as long.

    Each is given as rows and their times; times are at most `within` apart.
    """
    pair = family.source.astype(np.int64) * len(family.scene.receivers) + family.receiver
    found = [np.empty((2, 0), dtype=np.int64)]
    for each in np.intersect1d(pair[one[0]], pair[other[0]]):
        (rows, times), (others, their_times) = ((r[pair[r] == each], t[pair[r] == each]) for r, t in (one, other))
        order = np.argsort(their_times, kind="stable")
        others, their_times = others[order], their_times[order]
        first = np.searchsorted(their_times, times - within)
        count = np.searchsorted(their_times, times + within, side="right") - first
        mine = np.repeat(np.arange(len(rows)), count)
        theirs = np.repeat(first - np.cumsum(count) + count, count) + np.arange(count.sum())
        when = 0.5 * (times[mine] + their_times[theirs])
        mine, theirs = rows[mine], others[theirs]
        same = np.abs(_delays(family, mine, when) - _delays(family, theirs, when)) < _SAME_DELAY
        found.append(np.stack([mine[same], theirs[same]]))
    both = np.concatenate(found, axis=1)
    return both[0], both[1]


def _among(pair: Rows, times: Floats, other_pair: Rows, others: Floats) -> NDArray[np.bool_]:
    """Mask of times of pairs that are, to the last bit, among others of the same pair."""
    known = set(zip(other_pair.tolist(), others.tolist(), strict=True))
    return np.array([moment in known for moment in zip(pair.tolist(), times.tolist(), strict=True)], dtype=bool)


def _delays(family: Chain, rows: Rows, times: Floats) -> Floats:
    """Return the delays (n,) of rows at times (n,), s, as near as tells whether two are the same."""
    scene, source = family.scene, family.source[rows]
    receiver = ends_at(scene.receivers, family.receiver[rows], times)
    delay = np.zeros(len(rows))
    for _ in range(_ROUNDS):
        delay = family.lengths(rows, ends_at(scene.sources, source, times - delay), receiver) / scene.air.speed_of_sound
    return delay
