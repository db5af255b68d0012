"""Where a signal has energy."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from clsim.arrays import Floats


def shares(spectrum: tuple[Floats, Floats], share: float) -> tuple[float, float]:
    """Return the frequencies below and above which a share of the energy of a spectrum lies, Hz."""
    frequencies, energy = spectrum
    below = np.cumsum(energy) / max(float(energy.sum()), 1e-300)
    low, high = np.minimum(np.searchsorted(below, [share, 1.0 - share]), len(below) - 1)
    return float(frequencies[low]), float(frequencies[high])


def occupied_band(spectrum: tuple[Floats, Floats], widest: float, share_db: float) -> tuple[float, float]:
    """Return the highest frequency that matters, and the share of energy above it in dB."""
    frequencies, energy = spectrum
    total = float(energy.sum())
    if total <= 0.0:
        return 0.5 * widest, -math.inf
    above = np.append(np.cumsum(energy[::-1])[::-1][1:], 0.0) / total  # energy above each bin
    edge = frequencies[np.flatnonzero(above <= 10 ** (share_db / 10))[0]]
    if edge <= widest:
        return max(float(edge), 0.05 * widest), -math.inf
    share = float(above[np.searchsorted(frequencies, widest, side="right") - 1])
    return widest, 10 * math.log10(share) if share > 0.0 else -math.inf
