"""Stretches of time in which paths stay as they are, whatever that is: found by looks and bisection."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from clsim.paths.moving.looks import evaluated, first_change

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from clsim.arrays import Floats

    Rows = NDArray[np.int64]
    Codes = NDArray[np.int8]
    CodesAt = Callable[[Rows, Floats], Codes]

_CODES = 20_000  # paths and times that are coded together


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
        seen = evaluated(codes, rows, np.broadcast_to(times, (len(rows), len(times))), _CODES)
        path, gap = np.nonzero(seen[:, 1:] != seen[:, :-1])
        found.append((rows, np.full(len(rows), times[0]), seen[:, 0]))
        gaps.append((rows[path], times[gap], times[gap + 1], seen[path, gap], seen[path, gap + 1]))
        last[rows] = times[-1]
    path, begin, stop, code, then = (np.concatenate([gap[i] for gap in gaps]) for i in range(5))
    path = path.astype(np.int64)
    while len(path):
        change = first_change(codes, path, (begin, stop), code, resolution, _CODES)
        after = np.where(change >= stop, then, evaluated(codes, path, change[:, None], _CODES)[:, 0])
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
