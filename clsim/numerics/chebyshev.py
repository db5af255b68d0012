"""Chebyshev points of an interval, and polynomials through them."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from clsim.arrays import Floats


def chebyshev_points(low: float, high: float, count: int) -> Floats:
    """Chebyshev points (count,) of the first kind of an interval, from high to low."""
    angle = math.pi * (np.arange(count) + 0.5) / count
    return np.asarray(0.5 * (low + high) + 0.5 * (high - low) * np.cos(angle))


def interpolation(low: float, high: float, count: int, x: Floats) -> Floats:
    """Weights (count, n) of values at the Chebyshev points of an interval for those of the polynomial at x (n,)."""
    from numpy.polynomial.chebyshev import chebvander

    at_points = chebvander(chebyshev_points(-1.0, 1.0, count), count - 1) * (2.0 / count)
    at_points[:, 0] *= 0.5
    return np.asarray(at_points @ chebvander((2.0 * x - high - low) / max(high - low, 1e-300), count - 1).T)
