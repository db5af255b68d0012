"""Intervals in which paths are there, by evaluations of them: certified, or at given times and by bisection.

Each look says whether a path is there, and for how long before and after that is certain. What no look covers is looked
at in its middle, down to one sample: what a path does within less, as it was before and after it, is not found.
Where it differs before and after, the change is found to the resolution by halving.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Bools, Floats, Rows
from clsim.scene.body import Body
from clsim.scene.motion.motion import Motion, even_lengths

Evaluation = Callable[[Rows, Floats, Floats], tuple[Bools, Floats, Floats]]
Status = Callable[[Rows, Floats], Bools]
Gaps = tuple[Any, ...]
CodesAt = Callable[[Rows, Floats], NDArray[Any]]
Nearby = Callable[[NDArray[np.int64], Floats], Status]
Codes = NDArray[np.int8]


SAMPLE = 16  # resolutions; what lasts less is not found
_CERTAIN = 0.999  # of the time for which something is certain, what is relied on
_EVALUATIONS = 4_000  # looks
_AT_ONCE = 400  # looks, below which more of them cost next to nothing
_MOST_PARTS = 7  # of a gap, at the middles of which is looked
_PARTS = 4  # of the time in which something changes, and so on
ROUNDS = 5  # of the search for events, where 1e-9 m do
_RATE = 1000.0  # Hz, at which speeds are looked at
_AT_A_TIME = 50_000  # paths and times
_ROWS = 1_000  # paths at a time
_TOGETHER = 32  # looks between which paths are smooth
_CODES = 20_000  # paths and times that are coded together


def certified(
    evaluate: Evaluation, status: Status, spans: tuple[Rows, Floats, Floats], resolution: float,
    progress: Callable[[float], None] = lambda share: None,
) -> tuple[Rows, Floats, Floats]:  # fmt: skip
    """Return when paths are there: which (n,), begins and ends (n,), s, in the order of spans.

    `evaluate` takes paths (n,), times (n,) and halves (n,) of the times about them that matter, s. It returns whether
    each is there, for how long before and after that is certain, s, and how far apart two evaluations may be that agree
    where a path runs along what decides about it, or nothing is certain, s.
    """
    which, begin, end = spans
    parts = [np.arange(i, min(i + _EVALUATIONS, len(which))) for i in range(0, len(which), _EVALUATIONS)]
    whole, done = float(np.sum(end - begin)) or 1.0, 0.0
    found: list[tuple[Any, Any, Any]] = [(which[:0], begin[:0], end[:0])]
    for part in parts:
        share = float(np.sum(end[part] - begin[part])) / whole
        notify = partial(lambda first, all_of, left: progress(first + all_of * (1.0 - left)), done, share)
        found.append(_of_part(evaluate, status, (which[part], begin[part], end[part]), resolution, notify))
        done += share
    progress(1.0)
    path, first, last = map(np.concatenate, zip(*found, strict=True))
    return path, first, last


def _of_part(
    evaluate: Evaluation, status: Status, spans: tuple[Rows, Floats, Floats], resolution: float,
    notify: Callable[[float], None],
) -> Any:  # fmt: skip

    def seen(rows: Rows, times: Floats) -> Bools:
        return status(np.repeat(rows, times.shape[1]), times.ravel()).reshape(times.shape)

    which, begin, end = spans
    number, length = np.arange(len(which)), end - begin
    whole = float(np.sum(length)) or 1.0
    (at_first, after, _), (at_last, before, _) = (evaluate(which, t, length) for t in (begin, end))
    left, right = begin + _CERTAIN * after, end - _CERTAIN * before
    stack: list[Gaps] = [_open((number, left, right, at_first, at_last))]
    changes: list[Gaps] = [tuple(x[:0] for x in stack[0])]
    # What two looks are certain of may touch or overlap only where they agree.
    touching = (at_first != at_last) & (left >= right)
    changes.append((number[touching], begin[touching], end[touching], at_first[touching], at_last[touching]))
    while stack:
        gaps = stack.pop()
        if len(gaps[0]) > _EVALUATIONS:
            stack.append(tuple(x[_EVALUATIONS:] for x in gaps))
            gaps = tuple(x[:_EVALUATIONS] for x in gaps)
        short = gaps[2] - gaps[1] <= SAMPLE * resolution
        differs = short & (gaps[3] != gaps[4])
        changes.append(tuple(x[differs] for x in gaps))
        if not np.all(short):
            stack.append(_divided(evaluate, which, tuple(x[~short] for x in gaps)))
        notify(sum(float(np.sum(late - early)) for _, early, late, _, _ in stack) / whole)
    row, first, last, there, _ = map(np.concatenate, zip(*changes, strict=True))
    change = first_change(seen, which[row], (first, last), there, resolution, _AT_A_TIME)
    path, first, last, _ = _stretches([(number, begin, _coded(at_first)), (row, change, _coded(~there))], end)
    return which[path], first, last


def _divided(evaluate: Evaluation, which: Rows, gaps: Gaps) -> Gaps:
    """Rest of gaps after evaluation at the middles of even parts of them: more of each where gaps are few."""
    path, begin, end, before, after = gaps
    count = int(np.clip(_AT_ONCE // len(path), 1, _MOST_PARTS))
    half = 0.5 * (end - begin) / count
    times = begin[:, None] + half[:, None] * np.arange(1, 2 * count, 2)
    halves = np.repeat(half[:, None], count, axis=1)
    given = evaluate(np.repeat(which[path], count), times.ravel(), halves.ravel())
    there, sure, taken = (x.reshape(times.shape) for x in given)
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


def _coded(there: Bools) -> Codes:
    """Codes of paths that are there, 0, or not, -1."""
    return there.astype(np.int8) - np.int8(1)


def _stretches(found: Sequence[tuple[Any, Any, Any]], last: Floats) -> tuple[Rows, Floats, Floats, Codes]:
    """Order what rows are from times on, codes each, until the next time or the last one of the row; drop codes < 0."""
    path, when, code = map(np.concatenate, zip(*found, strict=True))
    order = np.lexsort((when, path))
    path, when, code = path[order], when[order], code[order]
    until = last[path]
    goes_on = np.flatnonzero(path[1:] == path[:-1])
    until[goes_on] = when[goes_on + 1]
    kept = code >= 0
    return path[kept], when[kept], until[kept], code[kept]


def evaluations(bodies: Sequence[Body], ends: Sequence[Motion], last: float, longest: float, step: float) -> Floats:
    """Return times of reception (n,), from one to the next of which all that moves goes no farther than a step, s."""
    from scipy.ndimage import maximum_filter1d

    instants = np.arange(math.ceil(last * _RATE) + 1) / _RATE
    speed = np.zeros(len(instants))
    for body in bodies:
        if not body.is_static:
            speed += body.speed(instants)
    for motion in ends:
        if not motion.is_static:
            speed += np.linalg.norm(motion.velocity(instants), axis=-1)
    width = 2 * math.ceil(longest * _RATE) + 1
    return np.minimum(even_lengths(maximum_filter1d(speed, width, mode="nearest"), _RATE, step), last)


def sampled(
    status: Status, rows: NDArray[np.int64], times: Floats, resolution: float, nearby: Nearby
) -> tuple[NDArray[np.int64], Floats, Floats]:
    """Return when paths are there: places among `rows` (n,) in order, begins and ends (n,), s.

    `status` takes rows (P,) and times (P, T), s, and returns whether each path is there at each of its times. `nearby`
    takes rows (P,) and some of the times (T,), and returns an approximation of `status` by places among these rows.
    Where that finds a change, two evaluations say whether it is one; else it is found by evaluations.
    """
    found: list[tuple[Any, Any, Any]] = [(np.empty(0, np.int64), np.empty(0), np.empty(0, np.int8))]
    for first in range(0, max(len(times) - 1, 1), _TOGETHER):
        here = times[first : first + _TOGETHER + 1]
        for some in range(0, len(rows), _ROWS):
            part = np.arange(some, min(some + _ROWS, len(rows)))
            quick = nearby(rows[part], here)
            seen = quick(np.arange(len(part)), np.tile(here, (len(part), 1)))
            if first == 0:
                found.append((part, np.full(len(part), here[0]), _coded(seen[:, 0])))
            path, gap = np.nonzero(seen[:, 1:] != seen[:, :-1])
            change = _found(status, quick, (rows[part], path), (here[gap], here[gap + 1]), resolution)
            found.append((part[path], change, _coded(seen[path, gap + 1])))
    return _stretches(found, np.full(len(rows), times[-1]))[:3]


def _found(
    status: Status, quick: Status, paths: tuple[NDArray[np.int64], NDArray[np.int64]], between: tuple[Floats, Floats],
    resolution: float,
) -> Floats:  # fmt: skip
    """Return the times (n,) between two at which some of rows change, s, as `_changes`."""
    rows, some = paths
    if not len(some):
        return np.empty(0)
    begin, end = between
    last = quick(some, end[:, None])[:, 0]
    change = first_change(quick, some, between, ~last, resolution, _AT_A_TIME)
    near = np.stack([np.maximum(change - resolution, begin), np.minimum(change, end)], axis=1)
    seen = evaluated(status, rows[some], near, _AT_A_TIME)
    wrong = np.flatnonzero((seen[:, 0] == last) | (seen[:, 1] != last))
    if len(wrong):
        these, spans = rows[some[wrong]], (begin[wrong], end[wrong])
        before = ~evaluated(status, these, spans[1][:, None], _AT_A_TIME)[:, 0]
        change[wrong] = first_change(status, these, spans, before, resolution, _AT_A_TIME)
    return change


def first_change(
    codes: CodesAt, rows: Rows, between: tuple[Floats, Floats], code: Any, resolution: float, together: int
) -> Floats:
    """Find the first of the times (n,) between two, the second included, at which paths are not as coded, s."""
    begin, end = (np.array(x) for x in between)
    share = np.arange(1, _PARTS) / _PARTS
    while len(rows) and np.max(end - begin) > resolution:
        times = begin[:, None] + (end - begin)[:, None] * share
        differs = evaluated(codes, rows, times, together) != code[:, None]
        any_differs, first = differs.any(axis=1), np.argmax(differs, axis=1)
        step = (end - begin) / _PARTS
        part = np.where(any_differs, first, _PARTS - 1)
        begin, end = begin + step * part, np.where(any_differs, begin + step * (part + 1), end)
    return end


def evaluated(codes: CodesAt, rows: Rows, times: Floats, together: int) -> Any:
    """Codes of paths at times (n, T), computed for so many nodes together."""
    if not times.size:
        return np.empty(times.shape, dtype=np.int8)
    parts = np.array_split(np.arange(len(rows)), max(1, -(-times.size // together)))
    return np.concatenate([codes(rows[part], times[part]) for part in parts if len(part)])


def coded(
    codes: CodesAt, evaluations: Sequence[tuple[Rows, Floats]], resolution: float
) -> tuple[Rows, Floats, Floats, Codes]:
    """Return rows (n,), when each begins and ends to be as a code says (n,), s, and the codes (n,), 0 or more.

    `codes` takes rows (P,) and times (P, T), s, and returns how each path is at each of its times, below 0 where it is
    not there. Evaluations are rows (P,) with their times (T,), s; each row once. What comes and goes between two of the
    times is missed unless something else changes there, too.
    """
    found = [(np.empty(0, np.int64), np.empty(0), np.empty(0, np.int8))]
    gaps = [(*[np.empty(0)] * 3, *[np.empty(0, np.int8)] * 2)]
    last = np.empty(sum(len(rows) for rows, _ in evaluations))
    for rows, times in evaluations:
        seen = evaluated(codes, rows, np.broadcast_to(times, (len(rows), len(times))), _CODES)
        path, gap = np.nonzero(seen[:, 1:] != seen[:, :-1])
        found.append((rows, np.full(len(rows), times[0]), seen[:, 0]))
        gaps.append((rows[path], times[gap], times[gap + 1], seen[path, gap], seen[path, gap + 1]))
        last[rows] = times[-1]
    path, begin, stop, code, then = map(np.concatenate, zip(*gaps, strict=True))
    path = path.astype(np.int64)
    while len(path):
        change = first_change(codes, path, (begin, stop), code, resolution, _CODES)
        after = np.where(change >= stop, then, evaluated(codes, path, change[:, None], _CODES)[:, 0])
        found.append((path, change, after))
        more = (after != then) & (change < stop)
        path, begin, stop, code, then = (x[more] for x in (path, change, stop, after, then))
    return _stretches(found, last)
