"""Delays and gains as samples, splines through them, bounds on delays, and transitions of paths that begin and end."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.arrays import as_floats, as_number
from clsim.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from clsim.arrays import Floats
    from clsim.paths.family import PairPaths, PeakSpeeds
    from clsim.paths.path_set import PathSet


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


DEFAULT_TRANSITION = 1e-3  # s
_LONGEST = 1.0  # s


def as_transition(value: object) -> float:
    """Return the length of the transition, s; 0 for none."""
    return as_number("transition", value, at_least=0.0, at_most=_LONGEST, unit="s")


def heard(times: Floats, start: Floats, end: Floats, transition: float) -> Floats:
    """Return the weight (paths, times) of paths that are active from `start` to `end` (paths,).

    Shapes: times (T,) s; start, end (P,) s.

    transition: length of the raised cosine, s; 0 for none: 1 from `start` on and 0 from `end` on.

    A gate splatters: a 40 kHz tone that is switched leaves -49 dB at 5 kHz off, over 1 ms -90 dB. Weights of paths that
    follow each other add up to 1, however short each is.
    """
    if transition == 0.0:
        return ((times >= start[:, None]) & (times < end[:, None])).astype(np.float64)
    rise = np.clip((times - start[:, None]) / transition + 0.5, 0.0, 1.0)
    fall = np.clip((times - end[:, None]) / transition + 0.5, 0.0, 1.0)
    return np.asarray(0.5 * (np.cos(np.pi * fall) - np.cos(np.pi * rise)))


def heard_samples(
    start: Floats, end: Floats, transition: float, sampling_rate: float
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the first sample of each path and the one after its last, counted from time 0, bounded to 62 bits."""
    first = _first_at(start - 0.5 * transition, sampling_rate)
    last = _first_at(end + 0.5 * transition, sampling_rate)
    return first, last


def _first_at(times: Floats, sampling_rate: float) -> NDArray[np.int64]:
    """Return the first sample n with ``n / sampling_rate >= time``, exactly as floats compare."""
    place = np.clip(np.ceil(times * sampling_rate), -(2.0**62), 2.0**62)
    place = np.where((place - 1.0) / sampling_rate >= times, place - 1.0, place)
    place = np.where(place / sampling_rate < times, place + 1.0, place)
    return np.asarray(np.clip(place, -(2.0**62), 2.0**62), dtype=np.int64)


_TOGETHER = 65536  # paths looked at at a time


def delay_bounds(
    paths: PathSet, speeds: PeakSpeeds, pair_paths: Sequence[PairPaths], pairs: Sequence[int], start: float, end: float
) -> Iterator[tuple[list[int], Floats, Floats]]:
    """Yield some pairs, and the lowest and highest delays of all their paths, s, one pair's after the other's."""
    clock_times = np.array([start, end])
    clock_error = np.stack([r.clock_error(clock_times) for r in paths.scene.receivers])
    first, last = (clock_times + clock_error).T
    least, most = clock_error.min(axis=1), clock_error.max(axis=1)
    for family in paths.families:
        for batch in _batches(pair_paths, [i for i in pairs if pair_paths[i].family is family]):
            rows = np.concatenate([pair_paths[i].index for i in batch])
            r = family.receiver[rows]
            low, high = family.delay_bounds(rows, first[r], last[r], speeds)
            reach = np.repeat([pair_paths[i].reach for i in batch], [len(pair_paths[i]) for i in batch])
            yield batch, low - most[r] - reach, high - least[r] + reach


def _batches(pair_paths: Sequence[PairPaths], pairs: list[int]) -> Iterator[list[int]]:
    """Yield neighbouring pairs together whose paths are a bounded number, or one pair."""
    batch: list[int] = []
    count = 0
    for pair in pairs:
        if batch and count + len(pair_paths[pair]) > _TOGETHER:
            yield batch
            batch, count = [], 0
        batch.append(pair)
        count += len(pair_paths[pair])
    if batch:
        yield batch
