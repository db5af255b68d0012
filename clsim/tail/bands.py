"""Bands of a tail: where rays are traced, and how energies join between them."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.tail.diffuse_field import DiffuseField

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Floats
    from clsim.scene.scene import Scene

_LOWEST = 31.25  # Hz, of a band's centre
_SILENT = 1e-30  # energy, whose logarithm is still a number
_BENT = 0.015  # of the rate of decay in a middle between thirds, by which interpolation may miss it
_STEEP = 0.12  # difference of decay times of neighbours, above which there are bands between them: 0.3 dB in 35 dB
_DECAYED = 1e-3  # of the energy, that is left after a decay time


def band_centres(low: float, high: float) -> Floats:
    """Return centres (B,) of thirds of octaves that hold a band, Hz."""
    low = max(low, _LOWEST)
    high = max(high, low)
    first, last = (round(3.0 * math.log2(f / 1000.0)) for f in (low, high))
    return np.asarray(1000.0 * 2.0 ** (np.arange(first, last + 1) / 3.0))


def traced_bands(scene: Scene, low: float, high: float) -> Floats:
    """Centres (B,) of bands in which rays are traced, Hz.

    They are thirds of octaves, and the middles between them where the walls' absorption bends so much that the rate of
    decay of a diffuse field there is not what `at_middles` makes of its neighbours.
    """
    thirds = band_centres(low, high)
    both = with_middles(thirds)
    field = DiffuseField.of(scene, both)
    if field is None or len(thirds) < 2:
        return thirds
    kept = np.maximum(1.0 - field.absorption_area / field.surface, _SILENT)
    rate = 4.0 * field.air * field.volume / field.surface - np.log(kept)
    guessed = -np.log(at_middles(np.exp(-rate[::2])))
    traced = np.abs(guessed - rate) > _BENT * rate
    traced[::2] = True
    return both[traced]


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


def joined_bands(centres: Floats, energy: NDArray[Any]) -> tuple[Floats, Floats]:
    """Return the bands (J,) in Hz in which noise is shaped, and their energies (T, K, J) of energies (T, K, B).

    They are the bands of rays, the middles between thirds, and those between sixths that decay differently.
    """
    is_third = np.isclose(3.0 * np.log2(centres / 1000.0) % 1.0, [[0.0], [1.0]], atol=1e-6).any(axis=0)
    sixths = with_middles(centres[is_third])
    found = at_middles(energy[..., is_third])
    traced = np.isclose(sixths[:, None], centres, rtol=1e-6).any(axis=1)
    found[..., traced] = energy
    steep = _steep(found.sum(axis=1))
    if not steep.any():
        return sixths, found
    kept = np.ones(2 * len(sixths) - 1, np.bool_)
    kept[1::2] = steep
    return with_middles(sixths)[kept], at_middles(found)[..., kept]


def _steep(energy: Floats) -> NDArray[np.bool_]:
    """Mask (B - 1,) of neighbouring bands of energies (T, B) whose decay times differ."""
    left = np.cumsum(energy[::-1], axis=0)[::-1]
    times = np.maximum(np.count_nonzero(left > _DECAYED * left[:1], axis=0), 1)
    return np.asarray(np.abs(np.diff(np.log(times))) > _STEEP)
