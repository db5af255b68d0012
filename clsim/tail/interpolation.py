"""Signals between their samples, for delays that change all the time."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from clsim.numerics.kaiser import length_of, shape_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Floats

_ERROR_DB = 60.0  # of what is passed, by which images of the spectrum are below it
_PHASES = 4096  # of a sample, between which the nearest is taken: -70 dB at 0.8 of Nyquist
_MOST_TAPS = 32
_TOGETHER = 16384  # samples


@dataclass(frozen=True, eq=False)
class Between:
    """Windowed sincs for places between samples.

    Attributes
    ----------
    table : ndarray (phases + 1, taps)
        Taps by the fraction of a sample.
    """

    table: NDArray[np.float32]

    @classmethod
    def up_to(cls, band: float, rate: float) -> Between:
        """Return sincs for signals below a frequency at a sampling rate, Hz.

        Windows are Kaiser's, falling from the band to its image about half the sampling rate (J. F. Kaiser, 1974).
        """
        width = max(2.0 - 2.0 * band / (0.5 * rate), 0.02)
        taps = min(2 * math.ceil(0.5 * length_of(width, _ERROR_DB)), _MOST_TAPS)
        x = np.arange(taps) - (taps // 2 - 1) - (np.arange(_PHASES + 1) / _PHASES)[:, None]
        window = np.i0(shape_of(_ERROR_DB) * np.sqrt(np.maximum(1.0 - (2.0 * x / taps) ** 2, 0.0)))
        table = np.sinc(x) * window
        return cls((table / table.sum(axis=1, keepdims=True)).astype(np.float32))

    @property
    def half(self) -> int:
        """Samples that are read to either side."""
        return int(self.table.shape[1] // 2)

    def at(self, signal: NDArray[Any], places: Floats) -> NDArray[np.float32]:
        """Return the values (n,) of a signal at places (n,), samples from its first one, which it must hold around."""
        windows = sliding_window_view(signal, self.table.shape[1])
        whole = np.floor(places).astype(np.int64)
        out = np.empty(len(places), np.float32)
        # Where the whole part of the delay stays the same, samples and windows go on side by side and are not copied.
        ahead = whole - np.arange(len(places))
        bounds = np.concatenate([[0], np.flatnonzero(np.diff(ahead)) + 1, [len(places)]])
        for first, last in pairwise(bounds.tolist()):
            for begin in range(first, last, _TOGETHER):
                here = slice(begin, min(begin + _TOGETHER, last))
                phase = np.rint((places[here] - whole[here]) * _PHASES).astype(np.int64)
                start = int(whole[begin]) - self.half + 1
                np.einsum("nt,nt->n", windows[start : start + len(phase)], self.table[phase], out=out[here])
        return out
