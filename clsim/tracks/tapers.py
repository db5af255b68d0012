"""Tapers: slow weights by which paths that begin or end are handed from one rendering method to another."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import ByRow, Floats, read_only

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
