"""Pressure on a rigid sphere, as a model of the head."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from clsim.arrays import Complexes, Floats

_STATIC = 1e-3  # ka, below which the sphere does nothing but turn the phase
_LEFT_OUT = 1e-9  # of the largest mode, behind mode number ka, from which on modes are left out


def sphere_surface_field(ka: Floats, cosine: Floats) -> Complexes:
    """Return the pressure on a rigid sphere in a plane wave, relative to that of the wave at its centre without it.

    Shapes: ka (F,); cosine (n,) of the angle between the place and the wave's origin, seen from the centre; result (n,
    F).

    ``p = 1 / (ka)² sum (2 n + 1) j^(n - 1) P_n(cosine) / h_n'(ka)`` with spherical Hankel functions of the second kind,
    for ``exp(+j 2 pi f t)`` (J. W. Strutt, Phil. Trans. R. Soc. 203, 1904; R. O. Duda and W. L. Martens, J. Acoust.
    Soc. Am. 104 (5), pp. 3048-3058, 1998, section I, for sources far away).
    """
    modes = _modes(tuple(np.maximum(ka, _STATIC).tolist()))
    legendre, before = np.ones_like(cosine), np.zeros_like(cosine)
    columns = np.empty((len(cosine), len(modes)))
    for n in range(len(modes)):
        columns[:, n] = legendre
        legendre, before = ((2 * n + 1) * cosine * legendre - n * before) / (n + 1), legendre
    field = columns @ modes
    low = np.asarray(ka) < _STATIC
    if low.any():
        field[:, low] = 1.0 + 1.5j * np.outer(cosine, np.asarray(ka)[low])
    return np.asarray(field)


@lru_cache(maxsize=32)
def _modes(ka: tuple[float, ...]) -> Complexes:
    """Return the factors (N, F) of Legendre's polynomials."""
    from scipy.special import spherical_jn, spherical_yn

    x = np.array(ka)
    most = float(x.max())
    count = math.ceil(most + 4.05 * most ** (1.0 / 3.0)) + 12
    n = np.arange(count)[:, None]
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        slope = spherical_jn(n, x, derivative=True) - 1j * spherical_yn(n, x, derivative=True)
        made = (2 * n + 1) * 1j ** (n - 1.0) / (slope * x**2)
    made = np.where(np.isfinite(made), made, 0.0)  # of high modes at low frequencies, which are nothing
    loud = np.abs(made).max(axis=1)
    last = np.flatnonzero(loud > _LEFT_OUT * loud.max())[-1]
    return made[: last + 1]
