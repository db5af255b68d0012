"""When to look which paths are there, and where between two looks that changes."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.scene.motion.carried import even_ways

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from clsim.arrays import Floats
    from clsim.scene.body import Body
    from clsim.scene.motion.motion import Motion

    Status = Callable[[NDArray[np.int64], Floats], NDArray[np.bool_]]
    Rows = NDArray[np.int64]
    CodesAt = Callable[[Rows, Floats], NDArray[Any]]
    Nearby = Callable[[NDArray[np.int64], Floats], Status]

ROUNDS = 5  # of the search for events, where 1e-9 m do
_RATE = 1000.0  # Hz, at which speeds are looked at
_PARTS = 4  # of the time between two looks, and so on
_AT_A_TIME = 50_000  # paths and times
_ROWS = 1_000  # paths at a time
_TOGETHER = 32  # looks between which paths are smooth


def looks(bodies: Sequence[Body], ends: Sequence[Motion], last: float, longest: float, step: float) -> Floats:
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
    return np.minimum(even_ways(maximum_filter1d(speed, width, mode="nearest"), _RATE, step), last)


def intervals(
    status: Status, rows: NDArray[np.int64], times: Floats, resolution: float, nearby: Nearby
) -> tuple[NDArray[np.int64], Floats, Floats]:
    """Return when paths are there: places among `rows` (n,) in order, begins and ends (n,), s.

    Shapes: rows (P,); times (T,) s.

    status: takes rows (P,) and times (P, T), s; returns whether each path is there at each of its times.

    nearby: takes rows (P,) and some of the times; returns what takes places among these rows (n,) and times (n, T)
    within these for about `status`. Where that finds a change, two looks say whether it is one; else it is found by
    looks.
    """
    there = np.zeros((len(rows), len(times)), dtype=bool)
    found: list[tuple[Any, Any, Any]] = [(np.empty(0, dtype=np.int64),) * 2 + (np.empty(0),)]
    for first in range(0, max(len(times) - 1, 1), _TOGETHER):
        here = slice(first, min(first + _TOGETHER, len(times) - 1) + 1)
        for some in range(0, len(rows), _ROWS):
            part = np.arange(some, min(some + _ROWS, len(rows)))
            quick = nearby(rows[part], times[here])
            seen = quick(np.arange(len(part)), np.tile(times[here], (len(part), 1)))
            there[part, here] = seen
            path, gap = np.nonzero(seen[:, 1:] != seen[:, :-1])
            span = times[here][gap], times[here][gap + 1]
            found.append((part[path], gap + first, _found(status, quick, (rows[part], path), span, resolution)))
    path, gap, change = (np.concatenate([each[i] for each in found]) for i in range(3))
    # In the order of time each path's changes are begins and ends in turn.
    early, late = np.flatnonzero(there[:, 0]), np.flatnonzero(there[:, -1])
    rising = ~there[path, gap]
    paths = np.concatenate([path[rising], early]), np.concatenate([path[~rising], late])
    bounds = (
        np.concatenate([change[rising], np.full(len(early), times[0])]),
        np.concatenate([change[~rising], np.full(len(late), times[-1])]),
    )
    begin, end = (np.lexsort((when, whose)) for when, whose in zip(bounds, paths, strict=True))
    return paths[0][begin], bounds[0][begin], bounds[1][end]


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
