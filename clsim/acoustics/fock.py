"""The Fock function of a hard surface: what a smooth body adds to the field of its outline.

Time goes by ``exp(+j 2 pi f t)``.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from clsim.arrays import Complexes, Floats

FIRST, LAST, COUNT = -6.0, 14.0, 2001  # arguments of the table; between two of them it is linear, to 1e-5
# Pieces of the path of integration, from infinity: begin and end. On the ray the integrand falls for all arguments,
# since it begins beyond their saddle points at -xi^2 / 4; on the axis it oscillates, and falls by 1e-10 up to 7.
_TURN = np.exp(2j * math.pi / 3.0)
_BEND = -0.25 * FIRST * FIRST
_PIECES = (_BEND + 16.0 / _TURN, _BEND), (_BEND, 0.0), (0.0, 7.0)
_NODES = 240


def fock_hard(xi: Floats) -> Complexes:
    """Fock function q* of a hard surface at arguments of any shape, with that shape.

    Between arguments -6 and 14 it is taken from a table; above, it is that of a half-plane, ``1 / (2 sqrt(pi) xi)``.
    P. H. Pathak, W. D. Burnside, R. J. Marhefka, A uniform GTD analysis of the diffraction of electromagnetic waves by
    a smooth convex surface, IEEE Trans. Antennas Propagat. 28 (1980), eq. 24; ``|q*(0)| = 0.307`` there.
    """
    rest = fock_table()
    held = np.clip(xi, FIRST, LAST)
    place = (held - FIRST) * ((COUNT - 1) / (LAST - FIRST))
    cell = np.minimum(place.astype(np.int64), COUNT - 2)
    part = place - cell
    found = rest[cell] + part * (rest[cell + 1] - rest[cell]) + pole(held)
    return np.where(xi > LAST, 0.5 / (math.sqrt(math.pi) * np.maximum(xi, 1.0)), found)


def pole(xi: Floats) -> Floats:
    """Pole of q*, which falls too slowly for the table: ``xi / (2 sqrt(pi) (1 + xi^2))``. Our own derivation."""
    return np.asarray(xi / (2.0 * math.sqrt(math.pi) * (1.0 + xi * xi)))


@lru_cache(maxsize=1)
def fock_table() -> Complexes:
    """Table of q* less its pole at `COUNT` arguments from `FIRST` to `LAST`.

    ``sqrt(pi) q* = integral of V'(t) / W2'(t) exp(-j xi t)``, with V = sqrt(pi) Ai and W2 = sqrt(pi) (Bi - j Ai). For
    t < 0 the quotient is j/2, whose integral is the pole of a half-plane and left out, and a reflected wave.
    """
    from scipy.special import airy

    x, weight = np.polynomial.legendre.leggauss(_NODES)
    xi, total = np.linspace(FIRST, LAST, COUNT), np.zeros(COUNT, dtype=np.complex128)
    for begin, end in _PIECES:
        t = begin + 0.5 * (end - begin) * (x + 1.0)
        if end <= 0.0:
            value = 0.5j * _TURN * airy(t * _TURN)[1] / airy(t / _TURN)[1]
        else:
            _, ai, _, bi = airy(t)
            value = ai / (bi - 1j * ai)
        total += (0.5 * (end - begin) * weight * value) @ np.exp(-1j * np.outer(t, xi))
    return np.asarray(total / math.sqrt(math.pi) - pole(xi))
