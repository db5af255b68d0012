"""Beginnings and ends of paths at a corner, given one time where they follow each other more closely than is known.

Where the line of sight, or a mirror path, passes exactly through a corner, paths over both edges, over their ends and
without an edge begin and end together. Each is found by its own test, with its own tolerance: between their times the
sum would jump by as much as the strongest path.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.arrays import read_only
from clsim.paths.chain import Chain
from clsim.paths.search.edge_chains import SAME_DELAY, delays_of
from clsim.paths.visibility.edge_intervals import LONGEST, STEP, indistinct

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from clsim.arrays import Floats
    from clsim.paths.family import PathFamily
    from clsim.scene.scene import Scene

    Rows = NDArray[np.int64]


def at_one_time(scene: Scene, found: tuple[PathFamily, ...], resolution: float) -> tuple[PathFamily, ...]:
    """Return paths without and over edges with one time for all that begins and ends as a corner is passed.

    These are events of one source and one receiver which follow each other by no more than the resolution, s, or the
    tolerance of outlines explains, at which all paths are as long. The first one's time is that of all.
    """
    chains = [family for family in found if isinstance(family, Chain)]
    bounds = [[np.array(family.start), np.array(family.end)] for family in chains]
    for group in _groups(scene, chains, resolution):
        time = min(bounds[family][side][row] for family, side, row in group)
        for family, side, row in group:
            bounds[family][side][row] = time
    changed = iter([_with_bounds(family, *each) for family, each in zip(chains, bounds, strict=True)])
    return tuple(next(changed) if isinstance(family, Chain) else family for family in found)


def _with_bounds(family: Chain, start: Floats, end: Floats) -> Chain:
    if np.array_equal(start, family.start) and np.array_equal(end, family.end):
        return family
    family = replace(family, start=read_only(start), end=read_only(end))
    return family.part(np.flatnonzero(start < end))


def _groups(scene: Scene, found: Sequence[Chain], resolution: float) -> Iterator[list[tuple[int, int, int]]]:
    """Yield groups of events that are one: numbers of the family, of the side (0 start, 1 end) and of the row."""
    parts: list[Any] = []
    for place, family in enumerate(found):
        pairs = family.source.astype(np.int64) * len(scene.receivers) + family.receiver
        for end, bounds in enumerate((family.start, family.end)):
            some = np.flatnonzero(np.isfinite(bounds))
            parts.append((pairs[some], bounds[some], np.full(len(some), place), np.full(len(some), end), some))
    columns: Any = [np.concatenate(column) for column in zip(*parts, strict=True)]
    order = np.lexsort((columns[1], columns[0]))
    pair, times, number, side, rows = (column[order] for column in columns)
    gap = np.where(pair[1:] == pair[:-1], times[1:] - times[:-1], np.inf)
    near = gap <= LONGEST
    near[near] = gap[near] <= _explained(scene, pair[1:][near], times[1:][near], resolution)
    for first, after in pairwise([0, *(np.flatnonzero(~near) + 1).tolist(), len(times)]):
        if after - first < 2 or times[after - 1] == times[first]:
            continue
        here, delay = np.arange(first, after), np.empty(after - first)
        for family in np.unique(number[here]).tolist():
            mine = number[here] == family
            delay[mine] = delays_of(found[family], rows[here[mine]], times[here[mine]])
        ranks = np.argsort(delay, kind="stable")
        for group in np.split(here[ranks], np.flatnonzero(np.diff(delay[ranks]) >= SAME_DELAY) + 1):
            if any(found[n].vertex is not None for n in number[group].tolist()):
                yield list(zip(number[group].tolist(), side[group].tolist(), rows[group].tolist(), strict=True))


def _explained(scene: Scene, pair: Rows, times: Floats, resolution: float) -> Floats:
    """Compute by how much times (n,) of the same event of pairs (n,) may differ, s."""
    source, receiver = np.divmod(pair, len(scene.receivers))
    moved = np.zeros(len(pair))
    for ends, which in ((scene.sources, source), (scene.receivers, receiver)):
        for each in np.unique(which).tolist():
            mine = which == each
            place = ends[each].trajectory.position(times[mine][:, None] + np.array([0.0, STEP]))
            moved[mine] += np.linalg.norm(place[:, 1] - place[:, 0], axis=-1)
    return indistinct(moved, resolution, scene.room.as_mesh().walls.size)
