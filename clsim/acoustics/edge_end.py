"""Sound at an end of an edge: the transitions of both at once, with the time convention ``exp(+jωt)``."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from clsim.acoustics.diffraction import transition

if TYPE_CHECKING:
    from clsim.arrays import Complexes, Floats

END_TERMS = 4  # Chebyshev polynomials of the angle's square: within 5e-7 (three: 1e-5)
AT_CORNER = 1e-9  # root of a phase, below which angle and sides are lost
EVEN = 0.25 * np.pi  # angle of a, b then: as much of either edge at a corner
_CELLS = 256
_POINTS = 120  # of the half-way rule: within 1e-11, however near the corner
_FIRST, _FADED = -3.4, 36.0  # of the points, exp(u - exp(-u)), and exponent of the fall at which they end


def end_transition(end: Floats, root: Floats, corner: Floats | float = EVEN) -> Complexes:
    """Compute the transition function of an edge and of its end, the field at the end over that of the partner.

    end: root a of the phase by which the way over the end is longer than the shortest one; negative beyond the boundary
    at which the shortest way passes the end.

    root: root b of the phase of a term of the edge, as of `transition`; negative beyond the term's boundary.

    corner: the angle φ of ``a + jb`` as the shortest way comes to the corner, where both are less than `AT_CORNER`.

    result: ``E(b) / 2`` for a = 0; 0 for b = 0 and a > 0; about ``E(a) E(b) b² / (a² + b²) / 2`` far out.

    Along the edge a term is ``b / π ∫ exp(-jt²) / (t² + b²) dt`` with t² the phase of the way's detour: that of an
    infinite edge is E(b) (`exact_wedge` has the integral). What is beyond the end, over the phase of the way by the
    end, is the generalised Fresnel integral

        C(a, b) = b / π exp(ja²) ∫ from a of exp(-jt²) / (t² + b²) dt,

    of P. C. Clemmow and T. B. A. Senior, Proc. Camb. Phil. Soc. 49(3), 1953. Owen's relation (Ann. Math. Stat. 27(4),
    1956, eq. 2.5, with a complex argument) is ``C(a, b) + C(b, a) = E(a) E(b) / 2``, so that only a ≥ b is needed: φ
    times a polynomial of φ², with ``a + jb = ρ exp(jφ)``, whose coefficients depend on ρ alone.
    """
    end, root, corner = np.broadcast_arrays(*(np.asarray(x, dtype=np.float64) for x in (end, root, corner)))
    a, b = np.abs(end), np.abs(root)
    low, high = np.minimum(a, b), np.maximum(a, b)
    off = high > AT_CORNER
    phi = np.where(off, np.arctan2(low, high), np.minimum(corner, 0.5 * np.pi - corner))
    found, beside = _of_octant(np.hypot(a, b), phi), np.where(off, b > a, corner > EVEN)
    found[beside] = 0.5 * transition(a[beside]) * transition(b[beside]) - found[beside]
    found *= np.where((root < 0.0) & off, -1.0, 1.0)
    beyond = (end < 0.0) & off
    if beyond.any():  # the edge itself is added
        found[beyond] = np.exp(1j * a[beyond] ** 2) * transition(root[beyond]) - found[beyond]
    return found


def end_coefficients(radius: Floats) -> Complexes:
    """Compute the coefficients (..., END_TERMS) of `angle_polynomials` that give C at radii ρ (...).

    Our own derivation: with ``t² = a² - js`` the integral falls as exp(-s); half-way rule in u of ``s = f exp(u -
    exp(-u))`` at the Chebyshev nodes of φ².
    """
    nodes = np.cos(np.pi * (np.arange(END_TERMS) + 0.5) / END_TERMS)
    phi = 0.25 * np.pi * np.sqrt(0.5 * (nodes + 1.0))
    radius = np.asarray(radius, dtype=np.float64)[..., None]
    finest = np.clip(radius**2, 1e-10, 1.0)
    spacing = (np.log(_FADED / finest) - _FIRST) / _POINTS
    total = np.zeros((*radius.shape[:-1], END_TERMS), dtype=np.complex128)
    for point in range(_POINTS):
        u = _FIRST + spacing * (point + 0.5)
        s = finest * np.exp(u - np.exp(-u))
        pole = radius**2 - 1j * s
        total += np.exp(-s) * s * (1.0 + np.exp(-u)) * spacing / (np.sqrt(pole - (radius * np.sin(phi)) ** 2) * pole)
    values = -0.5j / np.pi * radius * np.sin(phi) / phi * total
    values = np.where(radius > 1e-5, values, 1.0 / np.pi)
    return np.asarray(values @ np.linalg.inv(np.polynomial.chebyshev.chebvander(nodes, END_TERMS - 1)).T)


def angle_polynomials(phi: Floats) -> list[Floats]:
    """Compute φ times the Chebyshev polynomials of φ², for φ (...) from 0 to π/4; END_TERMS arrays (...)."""
    x = 2.0 * (phi / (0.25 * np.pi)) ** 2 - 1.0
    found = [phi, phi * x]
    while len(found) < END_TERMS:
        found.append(2.0 * x * found[-1] - found[-2])
    return found


def _of_octant(radius: Floats, phi: Floats) -> Complexes:
    """Compute C for a ≥ b at ρ and φ (...), by cubics over ``1 / (1 + ρ)``."""
    place = _CELLS / (1.0 + radius)
    cell = np.minimum(place.astype(np.int64), _CELLS - 1)
    place -= cell
    found = np.zeros(radius.shape, dtype=np.complex128)
    for cubics, weight in zip(_cubics(), angle_polynomials(phi), strict=True):
        c = cubics[:, cell]
        found += weight * (c[0] + place * (c[1] + place * (c[2] + place * c[3])))
    return found


@cache
def _cubics() -> Complexes:
    """Compute the cubics (END_TERMS, 4, cells), lowest power first."""
    from scipy.interpolate import CubicSpline

    place = np.arange(_CELLS + 1.0)
    values = np.zeros((_CELLS + 1, END_TERMS), dtype=np.complex128)
    values[1:] = end_coefficients(_CELLS / place[1:] - 1.0)
    return np.ascontiguousarray(np.moveaxis(CubicSpline(place, values).c[::-1], 2, 0))
