"""The Fock function of a hard surface: what a smooth body adds to the field of its outline.

Time goes by ``exp(+j 2 pi f t)``.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
import scipy

from clsim.arrays import Complexes, Floats

FIRST, LAST, COUNT = -6.0, 14.0, 4001  # arguments of the table; between two of them it is linear, to 3e-6
# Pieces of the path of integration, from infinity: begin and end. On the ray the integrand falls for all arguments,
# since it begins beyond their saddle points at -xi^2 / 4; on the axis it oscillates, and falls by 1e-10 up to 7.
_TURN = np.exp(2j * math.pi / 3.0)
_BEND = -0.25 * FIRST * FIRST
_PIECES = (_BEND + 16.0 / _TURN, _BEND), (_BEND, 0.0), (0.0, 7.0)
_NODES = 240
_LIT = -0.5  # largest argument of `lit_reflection`, whose table is as long, to 5e-6


def fock_hard(xi: Floats) -> Complexes:
    """Fock function q* of a hard surface at arguments of any shape, with that shape.

    Between arguments -6 and 14 it is taken from a table; above, it is that of a half-plane, ``1 / (2 sqrt(pi) xi)``.
    P. H. Pathak, W. D. Burnside, R. J. Marhefka, A uniform GTD analysis of the diffraction of electromagnetic waves by
    a smooth convex surface, IEEE Trans. Antennas Propagat. 28 (1980), eq. 24; ``|q*(0)| = 0.307`` there.
    """
    held = np.clip(xi, FIRST, LAST)
    found = _interpolated(fock_table(), held) + pole(held)
    return np.where(xi > LAST, 0.5 / (math.sqrt(math.pi) * np.maximum(xi, 1.0)), found)


def _interpolated(table: Complexes, xi: Floats) -> Complexes:
    """Interpolate a table linearly at arguments within it, of any shape."""
    place = (xi - FIRST) * ((COUNT - 1) / (LAST - FIRST))
    cell = np.minimum(place.astype(np.int64), COUNT - 2)
    return np.asarray(table[cell] + (place - cell) * (table[cell + 1] - table[cell]))


def lit_reflection(xi: Floats) -> Complexes:
    """Reflection of a smooth hard surface near grazing incidence, over the mirror's, at Fock parameters of any shape.

    It is ``exp(j 3 pi / 4) sqrt(-4 / xi) exp(-j xi^3 / 12) (q*(xi) - 1 / (2 sqrt(pi) xi))`` from a table between -6 and
    -0.5 and ``1 - 2 j / xi^3 - 28 / xi^6 + 896 j / xi^9 + 43120 / xi^12`` below, to 6e-6 (Pathak, Burnside, Marhefka
    1980, eq. 26, outside the transition of the incident field). The last three numbers are our own fit to the integral.
    """
    found = np.empty(np.shape(xi), dtype=np.complex128)
    beyond = xi < FIRST
    low = xi[beyond]
    over = 1.0 / (low * low * low)
    squared = over * over
    found[beyond] = 1.0 - squared * (28.0 - 43120.0 * squared) - 2j * (over * (1.0 - 448.0 * squared))
    found[~beyond] = _interpolated(lit_table(), np.minimum(xi[~beyond], LAST))
    return found


@lru_cache(maxsize=1)
def lit_table() -> Complexes:
    """Table of `lit_reflection` at the arguments of `fock_table`; from -1 to 0 it goes over to that at -0.5."""
    xi = np.linspace(FIRST, LAST, COUNT)
    u = np.clip(xi + 1.0, 0.0, 1.0)
    xi = np.minimum(xi, -1.0) + u * (1.0 - u * u * (1.0 - 0.5 * u))
    turn = np.exp(1j * (0.75 * math.pi - xi**3 / 12.0))
    return np.asarray(np.sqrt(-4.0 / xi) * turn * (_exact(xi) - 0.5 / (math.sqrt(math.pi) * xi)))


def pole(xi: Floats) -> Floats:
    """Pole of q*, which falls too slowly for the table: ``xi / (2 sqrt(pi) (1 + xi^2))``. Our own derivation."""
    return np.asarray(xi / (2.0 * math.sqrt(math.pi) * (1.0 + xi * xi)))


@lru_cache(maxsize=1)
def fock_table() -> Complexes:
    """Table of q* less its pole at `COUNT` arguments from `FIRST` to `LAST`.

    ``sqrt(pi) q* = integral of V'(t) / W2'(t) exp(-j xi t)``, with V = sqrt(pi) Ai and W2 = sqrt(pi) (Bi - j Ai). For
    t < 0 the quotient is j/2, whose integral is the pole of a half-plane and left out, and a reflected wave.
    """
    xi = np.linspace(FIRST, LAST, COUNT)
    return np.asarray(_exact(xi) - pole(xi))


def _exact(xi: Floats) -> Complexes:
    """Fock function q* at arguments (n,), by its integral."""
    x, weight = np.polynomial.legendre.leggauss(_NODES)
    total = np.zeros(len(xi), dtype=np.complex128)
    for begin, end in _PIECES:
        t = begin + 0.5 * (end - begin) * (x + 1.0)
        if end <= 0.0:
            value = 0.5j * _TURN * scipy.special.airy(t * _TURN)[1] / scipy.special.airy(t / _TURN)[1]
        else:
            _, ai, _, bi = scipy.special.airy(t)
            value = ai / (bi - 1j * ai)
        total += (0.5 * (end - begin) * weight * value) @ np.exp(-1j * np.outer(t, xi))
    return np.asarray(total / math.sqrt(math.pi))
