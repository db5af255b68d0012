"""Splines through sampled delays and gains, and weights of paths that begin and end: transitions and tapers."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import ByRow, Floats, as_floats, as_number, read_only
from clsim.errors import InputError


def checked_samples(times: Any, delays: Any, gains: Any) -> tuple[Floats, Floats, Floats]:
    """Return times (T,), s, and delays, s, and gains (paths, T), NaN where a path is inactive."""
    times = as_floats("times", times, (None,))
    if len(times) < 2 or times[0] > 0.0 or np.any(np.diff(times) <= 0.0):
        raise InputError("times", f"must increase strictly from 0 s or before, but begin {times[:3].tolist()}")
    delays, gains = np.array(delays, dtype=np.float64), np.array(gains, dtype=np.float64)
    for name, values in (("delays", delays), ("gains", gains)):
        if values.ndim != 2 or values.shape[1] != len(times) or not len(values):
            raise InputError(name, f"must have the shape paths x {len(times)}, but has {values.shape}")
    audible = np.isfinite(delays)
    if delays.shape != gains.shape or np.any(audible != np.isfinite(gains)):
        raise InputError("gains", "must be finite where delays are, and NaN where they are")
    if np.any(delays[audible] < 0.0):
        raise InputError("delays", f"must be at least 0 s, but one is {np.min(delays[audible]):g} s")
    return times, delays, gains


def checked_indices(name: str, values: Any, count: int) -> NDArray[np.int64]:
    """Return the source or the receiver of each of so many paths; the first one of all where nothing is given."""
    if values is None:
        return np.zeros(count, dtype=np.int64)
    out = np.asarray(values)
    if out.shape != (count,) or out.dtype.kind not in "iu" or np.any(out < 0):
        raise InputError(name, f"must be {count} whole numbers of at least 0, but is {values!r:.80}")
    return out.astype(np.int64)


def audible_intervals(audible: NDArray[np.bool_]) -> list[tuple[int, int, int]]:
    """Return path, first and one past last sample of every interval in which a path is active."""
    path, edge = np.nonzero(np.diff(np.pad(audible, ((0, 0), (1, 1)))))
    found = list(zip(path[::2].tolist(), edge[::2].tolist(), edge[1::2].tolist(), strict=True))
    for p, first, end in found:
        if end - first < 2:
            raise InputError(f"delays[{p}][{first}]", "must be active for two samples or more, but is alone")
    if not found:
        raise InputError("delays", "must hold at least one active path, but all are NaN")
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


def audible(times: Floats, start: Floats, end: Floats, transition: float) -> Floats:
    """Return the weight (P, T) at times (T,) of paths active from `start` to `end` (P,), s: raised cosines.

    A gate splatters: a 40 kHz tone that is switched leaves -49 dB at 5 kHz off, over 1 ms -90 dB. Weights of paths that
    follow each other add up to 1, however short each is. Without a transition it is 1 from `start` on, 0 from `end` on.
    """
    if transition == 0.0:
        return ((times >= start[:, None]) & (times < end[:, None])).astype(np.float64)
    rise = np.clip((times - start[:, None]) / transition + 0.5, 0.0, 1.0)
    fall = np.clip((times - end[:, None]) / transition + 0.5, 0.0, 1.0)
    return np.asarray(0.5 * (np.cos(np.pi * fall) - np.cos(np.pi * rise)))


def audible_samples(
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


def in_batches(items: Sequence[int], counts: Sequence[int]) -> Iterator[list[int]]:
    """Yield neighbouring items together whose paths, as many as counted, are a bounded number, or one item."""
    batch: list[int] = []
    together = 0
    for item, count in zip(items, counts, strict=True):
        if batch and together + count > _TOGETHER:
            yield batch
            batch, together = [], 0
        batch.append(item)
        together += count
    if batch:
        yield batch


def fitted_tracks(
    times: Any, delays: Any, gains: Any, sources: Any, receivers: Any
) -> tuple[list[Any], dict[str, Any]]:
    """Fit tracks to samples: source, receiver, starts and ends (s) of each pair, and the fields of `SampledTracks`."""
    times, delays, gains = checked_samples(times, delays, gains)
    s, r = (checked_indices(n, v, len(delays)) for n, v in (("sources", sources), ("receivers", receivers)))
    intervals = audible_intervals(np.isfinite(delays))
    pairs, splines, largest = [], [], 0.0
    for pair in sorted({(int(s[p]), int(r[p])) for p, _, _ in intervals}):
        mine = [interval for interval in intervals if (s[interval[0]], r[interval[0]]) == pair]
        fitted = fitted_splines(mine, times, delays, gains)
        splines.append(fitted)
        largest = max([largest, *(float(np.abs(f(f.x, 1)[..., 0]).max()) for _, f in fitted)])
        start = np.array([times[a] if a else -np.inf for _, a, _ in mine])
        end = np.array([times[b - 1] if b < len(times) else np.inf for _, _, b in mine])
        pairs.append((*pair, read_only(start), read_only(end)))
    if largest >= 1.0:
        raise InputError("delays", f"must change by less than 1 s per second, but change by {largest:.3g}")
    names = tuple(f"receiver-{i}" for i in range(int(r.max()) + 1))
    # The slope at a sample bounds that between samples but for the spline's bend: 5 % cover it.
    bound = min(1.05 * largest, 0.99)
    return pairs, {
        "splines": tuple(splines), "source_count": int(s.max()) + 1, "receiver_names": names, "largest_rate": bound,
        "end": float(times[-1]),
    }  # fmt: skip


TAPER_TERMS = 11  # of the odd polynomial of a taper
REACH = 2.4  # length of a taper times the highest frequency that it has, at -86 dB; see `taper_terms`
_SHAPE = 9.0  # of Kaiser's window
_SPARE = 1.0  # s beyond a run in which pieces may begin or end: half of a transition at most matters


@cache
def taper_terms() -> Floats:
    """Return the coefficients (TAPER_TERMS,) of x, x^3 and so on of a taper, which rises by 2 from -1 to 1.

    The integral of Kaiser's window ``I0(b sqrt(1 - x^2))``, whose power series in ``1 - x^2`` ends early.
    """
    from numpy.polynomial import polynomial

    window: Any = np.zeros(1)
    power: Any = np.ones(1)
    for k in range(TAPER_TERMS):
        window = polynomial.polyadd(window, power * (0.25 * _SHAPE**2) ** k / math.factorial(k) ** 2)
        power = polynomial.polymul(power, [1.0, 0.0, -1.0])
    odd = polynomial.polyint(window)[1::2]
    return read_only(odd / odd.sum())


def taper(place: Floats) -> Floats:
    """Return the weight of a taper that rises from 0 at -1 to 1 at 1."""
    from numpy.polynomial import polynomial

    x = np.clip(place, -1.0, 1.0)
    return np.asarray(0.5 + 0.5 * x * polynomial.polyval(x * x, taper_terms()))


@dataclass(frozen=True, slots=True, eq=False)
class Tapers(ByRow):
    """Weights of paths: of what is taken between two tapers, or of what is left beside it."""

    rise: Floats  # (paths,) where the first taper begins, s; -inf where the weight is 1 all the time before
    fall: Floats  # (paths,) where the second one ends, s; inf likewise
    length: float  # of a taper, s
    rest: bool  # whether the weight is that of what is left

    def weights(self, times: Floats) -> Floats:
        """Return weights (paths, times) at times (T,), s."""
        per = 2.0 / self.length
        rising = taper((times - self.rise[:, None]) * per - 1.0)
        falling = taper((times - self.fall[:, None]) * per + 1.0)
        taken = rising - falling
        return np.asarray(1.0 - taken if self.rest else taken)

    def some_times(self, until: float, rng: np.random.Generator) -> Floats:
        """Draw a time (paths,) within each path, s: of every three one within each of its tapers, and one between."""
        begin = np.clip(self.rise, 0.0, until)
        end = np.maximum(np.minimum(self.fall, until), begin)
        rising = np.where(np.isfinite(self.rise), np.minimum(begin + self.length, end), end)
        falling = np.where(np.isfinite(self.fall), np.maximum(end - self.length, begin), begin)
        which = np.arange(len(begin)) % 3
        low, high = np.choose(which, [begin, falling, begin]), np.choose(which, [rising, end, end])
        return np.asarray(low + (high - low) * rng.random(len(begin)))


@dataclass(frozen=True, slots=True, eq=False)
class Pieces:
    """Stretches of a pair's paths over time, in which nothing changes at once."""

    rows: NDArray[np.int64]  # (n,) path of each
    start: Floats  # (n,) s; -inf where it goes on before the run
    end: Floats  # likewise

    @classmethod
    def of(cls, start: Floats, end: Floats, cuts: Floats, until: float) -> Pieces:
        """Return the pieces active up to a time, s, of paths from start to end (paths,) that are cut (paths, Q), s."""
        ends = np.stack([start, end], axis=1)
        cut = np.clip(cuts, ends[:, :1], ends[:, 1:])
        edges = np.sort(np.concatenate([ends, cut], axis=1), axis=1)
        begin, stop = edges[:, :-1], edges[:, 1:]
        there = (stop > begin) & (begin < until + _SPARE) & (stop > -_SPARE)
        return cls(np.nonzero(there)[0], begin[there], stop[there])

    def handed_over(self, apart: NDArray[np.bool_], length: float, transition: float) -> tuple[Rows, Rows]:
        """Return the taken and the left stretches of the pieces, by tapers of a length, s.

        Tapers lie within pieces, where these are not in transition. Pieces of paths that are `apart` (paths,) are left
        as they are. So are those that are shorter than their tapers.
        """
        rise, fall = self.start + 0.5 * transition, self.end - 0.5 * transition
        born, dies = np.isfinite(rise), np.isfinite(fall)
        taken = (fall - rise >= length * (1.0 * born + dies)) & ~apart[self.rows]
        whole, begun, ended = (np.flatnonzero(mask) for mask in (~taken, taken & born, taken & dies))
        rows, never = np.concatenate([whole, begun, ended]), np.full(len(self.rows), np.inf)
        left = Rows(
            self.rows[rows],
            np.concatenate([self.start[whole], self.start[begun], fall[ended] - length]),
            np.concatenate([self.end[whole], rise[begun] + length, self.end[ended]]),
            Tapers(
                np.concatenate([never[whole], rise[begun], -never[ended]]),
                np.concatenate([never[whole], never[begun], fall[ended]]), length, rest=True,
            ),
        )  # fmt: skip
        at = np.flatnonzero(taken)
        tapers = Tapers(rise[at], fall[at], length, rest=False)
        return Rows(self.rows[at], rise[at], fall[at], tapers), left


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """Some stretches of a pair's paths, with weights."""

    rows: NDArray[np.int64]
    start: Floats
    end: Floats
    tapers: Tapers

    def __len__(self) -> int:
        return len(self.rows)

    def seconds(self, until: float) -> float:
        """Return the sum of their times in a run, s."""
        return float(np.sum(np.maximum(np.minimum(self.end, until) - np.maximum(self.start, 0.0), 0.0)))
