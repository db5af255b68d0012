"""Sound over two edges of one face: the transition of both at once, with the time convention ``exp(+jωt)``."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from clsim.acoustics.diffraction import transition

if TYPE_CHECKING:
    from clsim.acoustics.diffraction import EdgeWay
    from clsim.arrays import Complexes, Floats

_POINTS = 72
_FIRST, _FADED = -2.7, 20.0  # of the points, exp(u - exp(-u)), and exponent of the fall at which they end
_FINEST = 1e-5  # of the root of a phase, what is finer adds as little
_LEAST = 2e-5  # the same where both edges are on their boundaries: the function is 1, within as much


def double_tie(way: EdgeWay, first: Floats, last: Floats) -> Floats:
    """Return the coupling of the transitions at two edges (...): 0 for edges far apart, 1 for one edge.

    Our own derivation: ``w² = s1 s2 / ((s1 + s) (s + s2))`` with the part s between the edges is the square of the
    mixed second derivative of the way's length by both angles over the product of the others; what is left, 1 - w², is
    the ratio by which the breadth is less where the other edge itself is the receiver.
    """
    between = np.maximum(way.length - first - last, 0.0)
    return np.asarray(np.sqrt(first * last / ((first + between) * (between + last))))


def double_transition(first: Floats, last: Floats, tie: Floats, wave: Floats) -> Complexes:
    """Return the transition function of two edges (..., F), which of edges far apart is that of one times the other's.

    Shapes: wave (..., F) 1/m.

    first, last: root of the detour of a term at each edge, with the breadth of the way as that edge sees it, √m;
    negative beyond a boundary, as of `transition`.

    With a and b, first and last times the root of the wave number, it is

        E(a, b) = jab / π² ∬ exp(-(α² + β² + 2wαβ)) / ((α² + ja²) (β² + jb²)) dα dβ,

    the double integral of steepest descent over the angles in which waves run between the edges, in both of which it is
    even along a hard face, with the poles of both. It is 1 where both edges are on their boundaries, E(b) where the
    first is, and ``E(a √(1 - w²)) / (√(jπ) b)`` where the second is far from its own: H.-S. Kim et al., "Sound
    diffraction by multiple wedges and thin screens", Appl. Acoust. 66, 2005, take that product for it. Our own
    derivation from there, to four generalised Fresnel integrals, as F. Capolino et al., "Double diffraction at a pair
    of coplanar skew edges", IEEE Trans. Antennas Propag. 45(8), 1997, have them; these are taken along ``t² = (1 - w²)
    a² - js``, by a half-way rule in u of ``s = f exp(u - exp(-u))``, within 1e-6 (but 1e-3 within roots of 1e-4 from
    both boundaries).
    """
    a, b = np.abs(first), np.abs(last)
    found = _along_the_contour(a, b, tie, wave)
    for root, other, beyond in ((a, b, first < 0.0), (b, np.where(first < 0.0, -a, a), last < 0.0)):
        some = np.nonzero(beyond)
        if len(some[0]):  # shortly beyond a boundary the partner is added
            found[some] = _partner(root[some], other[some], tie[some], wave[some]) - found[some]
    return found


def _partner(root: Floats, other: Floats, tie: Floats, wave: Floats) -> Complexes:
    """Return the transition over one of the edges alone, where the other's boundary is passed."""
    turned = np.exp(1j * wave * ((1.0 - tie**2) * root**2)[..., None])
    scale, moved = np.sqrt(wave), tie * root
    return np.asarray(
        turned * (transition((other + moved)[..., None] * scale) + transition((other - moved)[..., None] * scale))
    )


def _along_the_contour(a: Floats, b: Floats, tie: Floats, wave: Floats) -> Complexes:
    """Return it for positive a and b: over s = v², with points that are dense about the least of its scales."""
    left, longest = 1.0 - tie**2, np.sqrt(wave.max(axis=-1))
    on_both = np.maximum(a, b) * longest < _LEAST
    a, b = (np.where(on_both, _LEAST / longest, x) for x in (a, b))
    finest = (np.clip(np.sqrt(left) * np.minimum(a, b) * longest, _FINEST, 1.0) / longest) ** 2
    last = np.log(_FADED / (wave.min(axis=-1) * finest))
    spacing = (last - _FIRST) / _POINTS
    u = _FIRST + spacing[..., None] * (np.arange(_POINTS) + 0.5)
    fine = np.exp(-u)
    s = finest[..., None] * np.exp(u - fine)
    a, b, w, left, turned = a[..., None], b[..., None], tie[..., None], left[..., None], -1j * s
    roots, total = (
        (np.sqrt(left * a**2 + turned), np.sqrt(left * b**2 + turned)),
        np.zeros(s.shape, dtype=np.complex128),
    )
    for sign in (1.0, -1.0):
        pole = a**2 + b**2 + 2.0 * sign * w * a * b + turned
        total += ((b + sign * w * a) / roots[0] + (a + sign * w * b) / roots[1]) / pole
    total *= turned * (1.0 + fine) * (0.5 / np.pi * spacing[..., None])
    both = np.stack([total.real, total.imag], axis=-2) @ np.exp(-s[..., None] * wave[..., None, :])
    return np.asarray(both[..., 0, :] + 1j * both[..., 1, :])
