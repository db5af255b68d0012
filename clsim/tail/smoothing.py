"""Energies of rays by time and direction, smoothed as far as ears and statistics allow."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Floats

_OF_TIME = 0.03  # half of a window of time over the time itself
_OF_DIRECTIONS = 0.2  # the same for directions, which change more slowly and of which there are many
_LEAST = 2  # bins, half of a window for directions at the beginning


def smoothed(energy: Floats) -> Floats:
    """Return energies (T, M, B) by bin of time, direction and band, smoothed over times that grow with time.

    The sum over directions is kept, but for a short window in which it is smoothed; how it is spread over them is taken
    from a longer one, for it changes slowly.
    """
    total = _smoothed(energy.sum(axis=1), _OF_TIME, 0)
    spread = _smoothed(energy, _OF_DIRECTIONS, _LEAST)
    whole = spread.sum(axis=1, keepdims=True)
    even = np.full_like(spread, 1.0 / energy.shape[1])
    return np.asarray(total[:, None, :] * np.where(whole > 0.0, spread / np.maximum(whole, 1e-300), even))


def _smoothed(values: Floats, share: float, least: int) -> Floats:
    """Return means of values (T, ...) over times from `t - w` to `t + w`, w a share of t, cut at both ends alike."""
    count = len(values)
    t: NDArray[np.int64] = np.arange(count)
    half = np.minimum(np.maximum((share * t).astype(np.int64), least), np.minimum(t, count - 1 - t))
    cumulated = np.concatenate([np.zeros((1, *values.shape[1:])), np.cumsum(values, axis=0)])
    length = (2 * half + 1).reshape(-1, *[1] * (values.ndim - 1))
    return np.asarray((cumulated[t + half + 1] - cumulated[t - half]) / length)
