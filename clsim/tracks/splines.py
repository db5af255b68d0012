"""Delays and gains as samples: checks, active intervals, and splines through them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.arrays import as_floats
from clsim.errors import InputError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Floats


def checked_samples(times: Any, delays: Any, gains: Any) -> tuple[Floats, Floats, Floats]:
    """Return times (T,), s, and delays, s, and gains (paths, T), NaN where a path is inactive."""
    times = as_floats("times", times, (None,))
    if len(times) < 2 or times[0] > 0.0 or np.any(np.diff(times) <= 0.0):
        raise InputError("times", f"must increase strictly from 0 s or before, but begin {times[:3].tolist()}")
    delays, gains = np.array(delays, dtype=np.float64), np.array(gains, dtype=np.float64)
    for name, values in (("delays", delays), ("gains", gains)):
        if values.ndim != 2 or values.shape[1] != len(times) or not len(values):
            raise InputError(name, f"must have the shape paths x {len(times)}, but has {values.shape}")
    heard = np.isfinite(delays)
    if delays.shape != gains.shape or np.any(heard != np.isfinite(gains)):
        raise InputError("gains", "must be finite where delays are, and NaN where they are")
    if np.any(delays[heard] < 0.0):
        raise InputError("delays", f"must be at least 0 s, but one is {np.min(delays[heard]):g} s")
    return times, delays, gains


def checked_indices(name: str, values: Any, count: int) -> NDArray[np.int64]:
    """Return the source or the receiver of each of so many paths; the first one of all where nothing is given."""
    if values is None:
        return np.zeros(count, dtype=np.int64)
    out = np.asarray(values)
    if out.shape != (count,) or out.dtype.kind not in "iu" or np.any(out < 0):
        raise InputError(name, f"must be {count} whole numbers of at least 0, but is {values!r:.80}")
    return out.astype(np.int64)


def heard_intervals(heard: NDArray[np.bool_]) -> list[tuple[int, int, int]]:
    """Return path, first and one past last sample of every interval in which a path is active."""
    found = []
    for p, row in enumerate(heard):
        edges = np.flatnonzero(np.diff(np.concatenate([[False], row, [False]]).astype(np.int8)))
        for a, b in edges.reshape(-1, 2):
            if b - a < 2:
                raise InputError(f"delays[{p}][{a}]", "must be heard for two samples or more, but stands alone")
            found.append((p, int(a), int(b)))
    if not found:
        raise InputError("delays", "must hold at least one path that is heard, but all are NaN")
    return found


def fitted_splines(
    intervals: list[tuple[int, int, int]], times: Floats, delays: Floats, gains: Floats
) -> tuple[tuple[NDArray[np.int64], Any], ...]:
    """Fit one spline through all intervals of the same samples: (T, paths, 2) for delay and gain."""
    from scipy.interpolate import CubicSpline

    fitted = []
    for a, b in sorted({(a, b) for _, a, b in intervals}):
        rows = np.array([i for i, interval in enumerate(intervals) if interval[1:] == (a, b)])
        which = [intervals[i][0] for i in rows]
        values = np.stack([delays[which, a:b], gains[which, a:b]], axis=-1).swapaxes(0, 1)
        fitted.append((rows, CubicSpline(times[a:b], values, bc_type="not-a-knot" if b - a > 3 else "natural")))
    return tuple(fitted)
