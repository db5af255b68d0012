"""Real spherical harmonics of unit vectors."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from clsim.arrays import Floats


def real_harmonics(order: int, directions: Floats) -> Floats:
    """Evaluate real spherical harmonics up to an order, semi-normalised (SN3D), in ACN order.

    Shapes: directions (..., 3); result (..., (order + 1)²).

    ``Y_l^m = sqrt((2 - [m = 0]) (l - |m|)! / (l + |m|)!) P_l^|m|(z) {cos m φ, sin |m| φ}`` without Condon and
    Shortley's phase, at place ``l² + l + m`` (C. Nachbar et al., "AmbiX - a suggested Ambisonics format", Ambisonics
    Symposium, 2011, section 2.1). Powers of ``x + j y`` stand for the sine's and the azimuth's: poles are places like
    others.
    """
    x, y, z = np.moveaxis(np.asarray(directions, dtype=np.float64), -1, 0)
    out = np.empty((*x.shape, (order + 1) ** 2))
    around, largest = np.ones_like(x) + 0j, 1.0
    for m in range(order + 1):
        before, now = np.zeros_like(z), np.full_like(z, largest)
        for degree in range(m, order + 1):
            factor = harmonic_norm(degree, m)
            out[..., degree * degree + degree + m] = factor * now * around.real
            if m:
                out[..., degree * degree + degree - m] = factor * now * around.imag
            before, now = now, ((2 * degree + 1) * z * now - (degree + m) * before) / (degree + 1 - m)
        around, largest = around * (x + 1j * y), largest * (2 * m + 1)
    return out


def harmonic_norms(order: int) -> Floats:
    """Return the factors of all harmonics up to an order in SN3D and ACN order, ((order + 1)²,)."""
    return np.array([harmonic_norm(degree, abs(m)) for degree in range(order + 1) for m in range(-degree, degree + 1)])


def harmonic_norm(degree: int, m: int) -> float:
    """Return the factor of a harmonic's Legendre function in SN3D."""
    return math.sqrt((1 if m == 0 else 2) * math.factorial(degree - m) / math.factorial(degree + m))
