"""Where paths over edges that move go over into others: one event, told at one time."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.arrays import read_only
from clsim.paths.arrivals import RETARDED

if TYPE_CHECKING:
    from collections.abc import Sequence

    from clsim.arrays import Floats
    from clsim.paths.chain import Chain
    from clsim.paths.family import PairPaths, PathFamily

_WITHIN = 1e-4  # s between two times at which the same event was found, at most
_SAME_DELAY = 3e-8  # s, between paths of which one goes over into the other


def tied(family: Chain, others: Sequence[PathFamily]) -> Chain:
    """Return the paths with the times at which others begin or end where that is the same event.

    Where sound goes over from one path to another both take the same time: an edge path and the one that passes its
    edge, or is reflected at it, and a path over an edge and that over the end of it.
    """
    start, end = np.array(family.start), np.array(family.end)
    known: dict[tuple[int, int], list[PairPaths]] = {}
    for other in others:
        for pair in other.pairs():
            known.setdefault((pair.source, pair.receiver), []).append(pair)
    for pair in family.pairs():
        rows = pair.index
        mine = np.concatenate([start[rows], end[rows]])
        which = np.flatnonzero(np.isfinite(mine))
        if not len(which):
            continue
        at, owner = mine[which], np.concatenate([rows, rows])[which]
        links: Any = family.links(owner)
        first = links.events(at[:, None], RETARDED)
        delay = (first.first.delay + first.last.delay)[:, 0]
        mine[which] = _settled(at, delay, _events(known.get((pair.source, pair.receiver), []), at))
        start[rows], end[rows] = mine[: len(rows)], mine[len(rows) :]
    family = replace(family, start=read_only(start), end=read_only(end))
    kept = np.flatnonzero(start < end)
    return family if len(kept) == len(start) else family.part(kept)


def _settled(times: Floats, delay: Floats, others: tuple[Floats, Floats, Floats]) -> Floats:
    """Return the times (n,) at which other paths of the delays (n,) begin or end, or the first of the same event."""
    found, order = np.array(times), np.argsort(times, kind="stable")
    theirs, their_delay, their_rate = others
    for place, i in enumerate(order.tolist()):
        near = slice(*np.searchsorted(theirs, (times[i] - _WITHIN, times[i] + _WITHIN)).tolist())
        apart = their_delay[near] + their_rate[near] * (times[i] - theirs[near]) - delay[i]
        same = theirs[near][np.abs(apart) < _SAME_DELAY]
        if len(same):
            found[i] = same[np.argmin(np.abs(same - times[i]))]
            continue
        before = order[:place][::-1]
        before = before[: int(np.searchsorted(times[i] - times[before], _WITHIN))]
        mine = before[np.abs(delay[before] - delay[i]) < _SAME_DELAY]
        found[i] = found[mine[0]] if len(mine) else times[i]
    return found


def _events(pairs: Sequence[PairPaths], near: Floats) -> tuple[Floats, Floats, Floats]:
    """Return when paths begin and end near given times, in order, and their delays and the rates of these, (n,)."""
    found, near = [np.empty((3, 0))], np.sort(near)
    for pair in pairs:
        index = pair.index
        bounds = np.concatenate([pair.family.start[index], pair.family.end[index]])
        rows = np.concatenate([index, index])
        place = np.searchsorted(near, bounds - _WITHIN)
        close = np.isfinite(bounds) & (np.append(near, np.inf)[place] <= bounds + _WITHIN)
        for time in np.unique(bounds[close]):
            here = rows[close & (bounds == time)]
            arrivals = pair.family.arrivals(here, np.array([time]))
            found.append(np.stack([np.full(len(here), time), arrivals.delay[:, 0], arrivals.delay_rate[:, 0]]))
    times, delay, rate = np.concatenate(found, axis=1)
    order = np.argsort(times, kind="stable")
    return times[order], delay[order], rate[order]
