"""Bands of frequency in which a tail's energy is followed: thirds of octaves."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Floats

_LOWEST = 31.25  # Hz, of a band's centre
_SILENT = 1e-30  # energy, whose logarithm is still a number


def band_centres(low: float, high: float) -> Floats:
    """Return centres (B,) of thirds of octaves that hold a band, Hz."""
    low = max(low, _LOWEST)
    high = max(high, low)
    first, last = (round(3.0 * math.log2(f / 1000.0)) for f in (low, high))
    return np.asarray(1000.0 * 2.0 ** (np.arange(first, last + 1) / 3.0))


def band_shares(frequencies: NDArray[Any], centres: Floats) -> Floats:
    """Return the amplitude (B, F) of each band's part at frequencies (F,), Hz: together 1 everywhere.

    At a centre a band is alone; between two of them one fades into the other over the logarithm of frequency, so that
    the amplitude of noise shaped in bands goes smoothly from one centre's to the next; it is held beyond the ends.
    """
    at = np.interp(np.log(np.maximum(frequencies, 1e-3)), np.log(centres), np.arange(len(centres), dtype=np.float64))
    away = np.abs(at - np.arange(len(centres))[:, None])
    return np.asarray(np.where(away < 1.0, np.cos(0.5 * np.pi * np.minimum(away, 1.0)) ** 2, 0.0))


def with_middles(centres: Floats) -> Floats:
    """Return the centres (2B - 1,) of bands and the geometric middles between them, Hz."""
    return np.exp(np.interp(np.arange(2 * len(centres) - 1) / 2.0, np.arange(len(centres)), np.log(centres)))


def at_middles(energy: NDArray[Any]) -> Floats:
    """Return energies (..., 2B - 1) at the centres of bands and the middles between, of those at centres (..., B).

    Decays are exponential, so the logarithm goes smoothly over frequency: it is cubic through four centres, and stays
    between the two about a middle. Where two amplitudes fade into each other, the slower decay wins; over half a third
    of an octave that is little.
    """
    level = np.log(np.maximum(energy, _SILENT))
    out = np.repeat(level, 2, axis=-1)[..., :-1]
    if level.shape[-1] > 1:
        before, after = level[..., :-1], level[..., 1:]
        ends = 2.0 * level[..., :1] - level[..., 1:2], 2.0 * level[..., -1:] - level[..., -2:-1]
        outer = np.concatenate([ends[0], level[..., :-2]], axis=-1) + np.concatenate([level[..., 2:], ends[1]], axis=-1)
        middle = (9.0 * (before + after) - outer) / 16.0
        out[..., 1::2] = np.clip(middle, np.minimum(before, after), np.maximum(before, after))
    return np.asarray(np.exp(out))
