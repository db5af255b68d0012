"""Fades of paths that begin or end where no other path takes over."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from clsim.arrays import ByRow, Complexes, Floats
from clsim.paths.family import Integers
from clsim.paths.response import Arrivals


@dataclass(frozen=True, slots=True, eq=False)
class FadeColumns:
    """Fades of P paths, each column (P, 2) as they begin and as they end.

    Each runs with the mean of the times at which the source sends, what moves on the way is met, and the receiver
    receives, each by its speed there. So fades depend on where all of these are, and are the same both ways.
    """

    share: Complexes  # (P, 2) of the response that fades
    span: Floats  # (P, 2) s
    moment: Floats  # (P, 2) mean time at which paths begin and end, s
    sent: Floats  # (P, 2) weights of the times of emission, 0 to 1
    met: Floats  # (P, 2) and of those at which what moves is met

    @staticmethod
    def none(count: int) -> FadeColumns:
        """Make columns of paths that do not fade."""
        shape = count, 2
        zeros = (np.zeros(shape) for _ in range(3))
        return FadeColumns(np.zeros(shape, dtype=np.complex128), np.ones(shape), *zeros)

    def __getitem__(self, rows: Any) -> FadeColumns:
        """Return those of some paths."""
        return FadeColumns(*(getattr(self, field.name)[rows] for field in fields(self)))


@dataclass(frozen=True, slots=True, eq=False)
class Fades(ByRow):
    """Shares of P paths that fade: those missing as paths begin and as they end, for want of paths that take over."""

    found: Any  # `Fading` of all paths of the scene: it computes shares where they are first needed
    family: int  # number of these paths' family there
    row: Integers  # (P,) of that family

    @property
    def columns(self) -> FadeColumns:
        """Shares and times."""
        some: FadeColumns = self.found.made[self.family][self.row]
        return some

    @property
    def share(self) -> Complexes:
        """Shares (P, 2) of the response, complex."""
        return self.columns.share

    def gain(self, found: Arrivals, times: Floats) -> Complexes:
        """Compute factors (P, T) of paths that are found at times (T,) or (P, 1) of reception, s."""
        of, gain = self.columns, np.ones((len(self), 1), dtype=np.complex128)
        onwards = found.more.get("onwards", 0.0)
        for side, sign in enumerate((1.0, -1.0)) if of.share.any() else ():
            share, span, moment, sent, met = (getattr(of, field.name)[:, [side]] for field in fields(of))
            x = np.clip(sign * (times - sent * found.delay - met * onwards - moment) / span, 0.0, 1.0)
            gain = gain - share * (1.0 - x**3 * (10.0 - 15.0 * x + 6.0 * x**2))
        return gain

    @property
    def largest(self) -> Floats:
        """Bounds (P,) of the factors' magnitudes."""
        return np.asarray(np.maximum(np.abs(1.0 - self.share).max(axis=1), 1.0))

    def __len__(self) -> int:
        return len(self.row)
