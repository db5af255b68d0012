"""Stretches of time in which paths stay as they are, whatever that is: found by looks and bisection."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from clsim.arrays import Floats

    Rows = NDArray[np.int64]
    Codes = NDArray[np.int8]
    CodesAt = Callable[[Rows, Floats], Codes]

_PARTS = 4  # of the time between two looks, and so on
_AT_A_TIME = 20_000  # paths and times


def pieces(
    codes: CodesAt, looks: Sequence[tuple[Rows, Floats]], resolution: float
) -> tuple[Rows, Floats, Floats, Codes]:
    """Return rows (n,), when each begins and ends to be as a code says (n,), s, and the codes (n,), 0 or more.

    Shapes: looks (rows, times) s.

    codes: takes rows (P,) and times (P, T), s; returns how each path is at each of its times, below 0 where it is not
    there.

    looks: rows (P,) with the times (T,) at which to look at them, s; each row once. What comes and goes between two of
    the times is missed unless something else changes there, too.
    """
    found, gaps = (
        [(np.empty(0, np.int64), np.empty(0), np.empty(0, np.int8))],
        [(*[np.empty(0)] * 3, *[np.empty(0, np.int8)] * 2)],
    )
    last = np.empty(sum(len(rows) for rows, _ in looks))
    for rows, times in looks:
        seen = _codes_at(codes, rows, np.broadcast_to(times, (len(rows), len(times))))
        path, gap = np.nonzero(seen[:, 1:] != seen[:, :-1])
        found.append((rows, np.full(len(rows), times[0]), seen[:, 0]))
        gaps.append((rows[path], times[gap], times[gap + 1], seen[path, gap], seen[path, gap + 1]))
        last[rows] = times[-1]
    path, begin, stop, code, then = (np.concatenate([gap[i] for gap in gaps]) for i in range(5))
    path = path.astype(np.int64)
    while len(path):
        change = _first_change(codes, path, (begin, stop), code, resolution)
        after = np.where(change >= stop, then, _codes_at(codes, path, change[:, None])[:, 0])
        found.append((path, change, after))
        more = (after != then) & (change < stop)
        path, begin, stop, code, then = (x[more] for x in (path, change, stop, after, then))
    path, when, code = (np.concatenate([each[i] for each in found]) for i in range(3))
    order = np.lexsort((when, path))
    path, when, code = path[order], when[order], code[order]
    until = last[path]
    goes_on = np.flatnonzero(path[1:] == path[:-1])
    until[goes_on] = when[goes_on + 1]
    kept = code >= 0
    return path[kept], when[kept], until[kept], code[kept]


def _first_change(codes: CodesAt, rows: Rows, between: tuple[Floats, Floats], code: Codes, resolution: float) -> Floats:
    """Return the first of the times (n,) between two, the second included, at which paths are no more as coded, s."""
    begin, end = (np.array(x) for x in between)
    share = np.arange(1, _PARTS) / _PARTS
    while len(rows) and np.max(end - begin) > resolution:
        times = begin[:, None] + (end - begin)[:, None] * share
        differs = _codes_at(codes, rows, times) != code[:, None]
        any_differs, first = differs.any(axis=1), np.argmax(differs, axis=1)
        step = (end - begin) / _PARTS
        part = np.where(any_differs, first, _PARTS - 1)
        begin, end = begin + step * part, np.where(any_differs, begin + step * (part + 1), end)
    return end


def _codes_at(codes: CodesAt, rows: Rows, times: Floats) -> Codes:
    if not times.size:
        return np.empty(times.shape, dtype=np.int8)
    parts = np.array_split(np.arange(len(rows)), max(1, -(-times.size // _AT_A_TIME)))
    return np.concatenate([codes(rows[part], times[part]) for part in parts if len(part)])
