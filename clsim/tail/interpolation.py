"""Streams between their samples, for delays that change all the time."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from clsim.numerics.fractional_delay import design_bandlimited

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Floats

NODE = 32  # samples between nodes, at which motion is looked at: whole numbers of them from sample 0
NEIGHBOURS = 8  # samples that share a whole part of the delay, where vectors are used
_ERROR_DB = -70.0  # of what is passed
_LEAST_BAND = 0.25  # of the sampling rate, below which filters hardly become shorter
_LEAST_REST = 0.75  # of a sample, for which filters are right around the nearest one
_PHASES = 4096  # of a sample, between which the nearest is taken: -70 dB at 0.84 of Nyquist


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """Read positions and gains of M streams for R listeners at N nodes, linear between these."""

    ahead: Floats  # (R, N, M) samples by which each stream is read ahead of the clock
    gains: Floats  # (R, N, M) of each stream

    @property
    def reach(self) -> tuple[int, int]:
        """Whole samples by which streams are read ahead, at least and at most."""
        return math.floor(self.ahead.min()), math.ceil(self.ahead.max())


class Waves(Protocol):
    """Interface of sums of streams for moving listeners."""

    def heard(
        self, streams: NDArray[np.float32], first: int, motion: Motion, start: int, stop: int
    ) -> NDArray[np.float32]:
        """Return the pressure at listeners (R, n), samples `start` to `stop`, of streams (M, L) from sample `first` on.

        Motion is known at the nodes from that of `start` to the one that is not before `stop`.
        """
        ...


@dataclass(frozen=True, slots=True, eq=False)
class Between:
    """Filters for places between samples."""

    # (powers, taps) of each sample, from `half` before the nearest one on: the coefficients of powers of how far beyond
    # that one.
    bank: NDArray[np.float32]

    @classmethod
    def up_to(cls, band: float, rate: float, fastest: float) -> Between:
        """Return filters for signals below a frequency at a sampling rate, Hz, and for a speed over that of sound."""
        rest = max(_LEAST_REST, 0.5 + 0.5 * (NEIGHBOURS - 1) * fastest)
        cutoff = 2.0 * math.pi * max(band / rate, _LEAST_BAND)
        delays, _ = design_bandlimited(_ERROR_DB, cutoff, rest)
        signs = np.where(np.arange(len(delays)) % 2 == 0, 1.0, -1.0)  # ahead, not late
        return cls((delays * signs[:, None])[:, ::-1].astype(np.float32))

    @property
    def half(self) -> int:
        """Samples that are read to either side."""
        return int(self.bank.shape[1] // 2)


class HostWaves:
    """Sums streams on the host: the definition of right."""

    def __init__(self, between: Between) -> None:
        self._half = between.half
        rest = np.arange(_PHASES + 1) / _PHASES - 0.5
        self._table = np.polynomial.polynomial.polyval(rest, between.bank.astype(np.float64)).T.astype(np.float32)

    def heard(
        self, streams: NDArray[np.float32], first: int, motion: Motion, start: int, stop: int
    ) -> NDArray[np.float32]:
        """Return the pressure at listeners (R, n), see `Waves`."""
        samples = np.arange(start, stop)
        grid = (start // NODE + np.arange(motion.ahead.shape[1])) * NODE
        out = np.zeros((len(motion.ahead), len(samples)), np.float32)
        for total, ahead, gains in zip(out, motion.ahead, motion.gains, strict=True):
            for m, stream in enumerate(streams):
                value = self._at(stream, samples - first + np.interp(samples, grid, ahead[:, m]))
                total += value * np.interp(samples, grid, gains[:, m]).astype(np.float32)
        return out

    def _at(self, stream: NDArray[Any], places: Floats) -> NDArray[np.float32]:
        """Return the values (n,) of a stream at places (n,), samples from its first one, which it must hold around."""
        windows = sliding_window_view(stream, self._table.shape[1])
        whole = np.rint(places).astype(np.int64)
        phase = np.rint((places - whole + 0.5) * _PHASES).astype(np.int64)
        out = np.empty(len(places), np.float32)
        # Where the whole part of the delay stays the same, samples and windows go on side by side and are not copied.
        ahead = whole - np.arange(len(places))
        bounds = np.concatenate([[0], np.flatnonzero(np.diff(ahead)) + 1, [len(places)]])
        for first, last in pairwise(bounds.tolist()):
            begin = int(whole[first]) - self._half
            np.einsum(
                "nt,nt->n", windows[begin : begin + last - first], self._table[phase[first:last]], out=out[first:last]
            )
        return out
