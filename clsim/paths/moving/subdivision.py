"""When paths are there, by certified subdivision of time.

Each look says whether a path is there, and for how long before and after that is certain. What no look covers is looked
at in its middle, down to one sample: what a path does within less, as it was before and after it, is not found.
Where it differs before and after, the change is found to the resolution by halving.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from clsim.arrays import Floats

    Bools = NDArray[np.bool_]
    Rows = NDArray[np.int64]
    Look = Callable[[Rows, Floats, Floats], tuple[Bools, Floats, Floats]]
    Status = Callable[[Rows, Floats], Bools]
    Gaps = tuple[Any, ...]  # path, begin, end, whether it is there before and after, each (n,)

SAMPLE = 16  # resolutions; what lasts less is not found
_CERTAIN = 0.999  # of the time for which something is certain, what is relied on
_AT_A_TIME = 4_000  # looks
_AT_ONCE = 400  # looks, below which more of them cost next to nothing
_MOST_PARTS = 7  # of a gap, at the middles of which is looked
_PARTS = 4  # of the time in which something changes, and so on


def intervals(
    look: Look, status: Status, spans: tuple[Rows, Floats, Floats], resolution: float,
    progress: Callable[[float], None] = lambda share: None,
) -> tuple[Rows, Floats, Floats]:  # fmt: skip
    """Return when paths are there: which (n,), begins and ends (n,), s, in the order of spans.

    look: takes paths (n,), times (n,) and halves (n,) of the times about them that matter, s; returns whether each is
    there, for how long before and after that is certain, s, and for how long it is taken to be so where two looks so
    far before and after agree, s: where a path runs along what decides about it, or nothing is certain.
    """
    which, begin, end = spans
    parts = [np.arange(i, min(i + _AT_A_TIME, len(which))) for i in range(0, len(which), _AT_A_TIME)]
    whole, done = float(np.sum(end - begin)) or 1.0, 0.0
    found: list[tuple[Any, Any, Any]] = [(which[:0], begin[:0], end[:0])]
    for part in parts:
        share = float(np.sum(end[part] - begin[part])) / whole
        tell = partial(_tell, progress, done, share)
        found.append(_of_part(look, status, (which[part], begin[part], end[part]), resolution, tell))
        done += share
    progress(1.0)
    path, first, last = (np.concatenate([each[i] for each in found]) for i in range(3))
    return path, first, last


def _tell(progress: Callable[[float], None], first: float, share: float, left: float) -> None:
    """Tell the share of the work that is done, where of one share of it, behind a first one, some is left."""
    progress(first + share * (1.0 - left))


def _of_part(
    look: Look, status: Status, spans: tuple[Rows, Floats, Floats], resolution: float, tell: Callable[[float], None]
) -> Any:
    which, begin, end = spans
    number, length = np.arange(len(which)), end - begin
    whole = float(np.sum(length)) or 1.0
    (at_first, after, _), (at_last, before, _) = (look(which, t, length) for t in (begin, end))
    left, right = begin + _CERTAIN * after, end - _CERTAIN * before
    stack: list[Gaps] = [_open((number, left, right, at_first, at_last))]
    changes: list[Gaps] = [tuple(x[:0] for x in stack[0])]
    # What two looks are certain of may touch or overlap only where they agree.
    touching = (at_first != at_last) & (left >= right)
    changes.append((number[touching], begin[touching], end[touching], at_first[touching], at_last[touching]))
    while stack:
        gaps = stack.pop()
        if len(gaps[0]) > _AT_A_TIME:
            stack.append(tuple(x[_AT_A_TIME:] for x in gaps))
            gaps = tuple(x[:_AT_A_TIME] for x in gaps)
        short = gaps[2] - gaps[1] <= SAMPLE * resolution
        differs = short & (gaps[3] != gaps[4])
        changes.append(tuple(x[differs] for x in gaps))
        if not np.all(short):
            stack.append(_divided(look, which, tuple(x[~short] for x in gaps)))
        tell(sum(float(np.sum(late - early)) for _, early, late, _, _ in stack) / whole)
    path, first, last, there, _ = (np.concatenate([each[i] for each in changes]) for i in range(5))
    return _joined(spans, at_first, (path, _narrowed(status, which[path], first, last, there, resolution), there))


def _divided(look: Look, which: Rows, gaps: Gaps) -> Gaps:
    """Rest of gaps after evaluation at the middles of even parts of them: more of each where gaps are few."""
    path, begin, end, before, after = gaps
    count = int(np.clip(_AT_ONCE // len(path), 1, _MOST_PARTS))
    half = 0.5 * (end - begin) / count
    times = begin[:, None] + half[:, None] * np.arange(1, 2 * count, 2)
    halves = np.repeat(half[:, None], count, axis=1)
    told = look(np.repeat(which[path], count), times.ravel(), halves.ravel())
    there, sure, taken = (x.reshape(times.shape) for x in told)
    state = np.column_stack([before, there, after])
    agreed = (2.0 * halves <= taken) & (there == state[:, :-2]) & (there == state[:, 2:])
    sure = np.where(agreed, halves, np.minimum(_CERTAIN * sure, halves))
    first, last = np.column_stack([begin, times + sure]), np.column_stack([times - sure, end])
    left: Gaps = (np.repeat(path, count + 1), first.ravel(), last.ravel(), state[:, :-1].ravel(), state[:, 1:].ravel())
    return _open(left)


def _open(gaps: Gaps) -> Gaps:
    """Return the gaps that have a length, and those at which something changes."""
    kept = (gaps[2] > gaps[1]) | (gaps[3] != gaps[4])
    return tuple(x[kept] for x in gaps)


def _narrowed(status: Status, rows: Rows, begin: Floats, end: Floats, there: Bools, resolution: float) -> Floats:
    """Return when (n,), between two times, paths are first seen no more to be as they were at the first, s."""
    begin, end = np.array(begin), np.array(end)
    share = np.arange(1, _PARTS) / _PARTS
    while len(wide := np.flatnonzero(end - begin > resolution)):
        times = begin[wide, None] + (end - begin)[wide, None] * share
        seen = status(np.repeat(rows[wide], _PARTS - 1), times.ravel()).reshape(times.shape)
        bounds = np.column_stack([begin[wide], times, end[wide]])
        part = np.argmax(np.column_stack([seen != there[wide, None], np.ones(len(wide), dtype=bool)]), axis=1)
        begin[wide], end[wide] = bounds[np.arange(len(wide)), part], bounds[np.arange(len(wide)), part + 1]
    return end


def _joined(
    spans: tuple[Rows, Floats, Floats], at_first: Bools, changes: tuple[Rows, Floats, Bools]
) -> tuple[Rows, Floats, Floats]:
    """Return intervals from what changes when, and was there before."""
    which, begin, end = spans
    number, time, was = changes
    order = np.lexsort((time, number))
    number, time, was = number[order], time[order], was[order]
    count = np.bincount(number, minlength=len(which))
    at_last = at_first ^ (count % 2 == 1)
    starts = np.concatenate([np.flatnonzero(at_first), number[~was]])
    stops = np.concatenate([number[was], np.flatnonzero(at_last)])
    bounds = np.concatenate([begin[at_first], time[~was]]), np.concatenate([time[was], end[at_last]])
    i, j = np.lexsort((bounds[0], starts)), np.lexsort((bounds[1], stops))
    return which[starts[i]], bounds[0][i], bounds[1][j]
