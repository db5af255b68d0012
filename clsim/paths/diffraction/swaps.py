"""Where one edge path goes over into another: one event, told at one time."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from clsim.arrays import read_only
from clsim.paths.family import ends_at

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Floats
    from clsim.paths.diffraction.family import EdgePaths

    Rows = NDArray[np.int64]

Family = TypeVar("Family", bound="EdgePaths")
_SAME_DELAY = 3e-8  # s, between paths of which one goes over into the other
_ROUNDS = 4  # of finding the time of emission


def with_swaps(family: Family, within: float) -> Family:
    """Return the paths with one time for the end of one and the beginning of another where they are the same event.

    Parameters
    ----------
    family : EdgePaths
        Whose intervals were found path by path.
    within : float
        How far apart both may have been found, s.

    Notes
    -----
    This is where two walls are met in another order, or where the apex goes on from an edge to the next one or to its
    corner: both paths are as long as each other then. Pieces of one path meet already.
    """
    start, end = np.array(family.start), np.array(family.end)
    pair = family.source.astype(np.int64) * len(family.scene.receivers) + family.receiver
    ends = np.flatnonzero(np.isfinite(end) & ~_among(pair, end, pair, start))
    starts = np.flatnonzero(np.isfinite(start) & ~_among(pair, start, pair, end))
    if not len(ends) or not len(starts):
        return family
    ends = ends[np.lexsort((end[ends], pair[ends]))]
    for one in np.unique(pair[starts]):
        some, others = starts[pair[starts] == one], ends[pair[ends] == one]
        first = np.searchsorted(end[others], start[some] - within)
        count = np.searchsorted(end[others], start[some] + within, side="right") - first
        mine = np.repeat(some, count)
        theirs = others[np.repeat(first - np.cumsum(count) + count, count) + np.arange(count.sum())]
        when = 0.5 * (start[mine] + end[theirs])
        same = np.abs(_delays(family, mine, when) - _delays(family, theirs, when)) < _SAME_DELAY
        longer = end[theirs] < end[mine]  # nothing ends as it begins
        mine, theirs = mine[same & longer], theirs[same & longer]
        start[mine[::-1]] = end[theirs[::-1]]
    return replace(family, start=read_only(start))


def _among(pair: Rows, times: Floats, other_pair: Rows, others: Floats) -> NDArray[np.bool_]:
    """Return which times of pairs are, to the last bit, among others of the same pair."""
    known = set(zip(other_pair.tolist(), others.tolist(), strict=True))
    return np.array([moment in known for moment in zip(pair.tolist(), times.tolist(), strict=True)], dtype=bool)


def _delays(family: EdgePaths, rows: Rows, times: Floats) -> Floats:
    """Return the delays (n,) of rows at times (n,), s, as near as tells whether two are the same."""
    scene, source = family.scene, family.source[rows]
    receiver = ends_at(scene.receivers, family.receiver[rows], times)
    delay = np.zeros(len(rows))
    for _ in range(_ROUNDS):
        delay = family.lengths(rows, ends_at(scene.sources, source, times - delay), receiver) / scene.air.speed_of_sound
    return delay
