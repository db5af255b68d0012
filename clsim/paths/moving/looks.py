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
    change = _changes(quick, some, between, resolution)
    near = np.stack([np.maximum(change - resolution, begin), np.minimum(change, end)], axis=1)
    seen, last = _at(status, rows[some], near), quick(some, end[:, None])[:, 0]
    wrong = np.flatnonzero((seen[:, 0] == last) | (seen[:, 1] != last))
    if len(wrong):
        change[wrong] = _changes(status, rows[some[wrong]], (begin[wrong], end[wrong]), resolution)
    return change


def _changes(status: Status, rows: NDArray[np.int64], between: tuple[Floats, Floats], resolution: float) -> Floats:
    """Return the first time (n,) of those between two at which a path is no more as it was at the first, s."""
    begin, end = (np.array(x) for x in between)
    before = ~_at(status, rows, end[:, None])[:, 0]
    share = np.arange(1, _PARTS) / _PARTS
    while np.max(end - begin) > resolution:
        times = begin[:, None] + (end - begin)[:, None] * share
        differs = _at(status, rows, times) != before[:, None]
        any_differs, first = differs.any(axis=1), np.argmax(differs, axis=1)
        step = (end - begin) / _PARTS
        part = np.where(any_differs, first, _PARTS - 1)
        begin, end = begin + step * part, np.where(any_differs, begin + step * (part + 1), end)
    return end


def _at(status: Status, rows: NDArray[np.int64], times: Floats) -> NDArray[np.bool_]:
    parts = np.array_split(np.arange(len(rows)), max(1, -(-times.size // _AT_A_TIME)))
    return np.concatenate([status(rows[part], times[part]) for part in parts if len(part)])
