"""Sound at edges: the uniform theory of diffraction, with the time convention ``exp(+jωt)``.

An edge runs along z; r, θ, z are cylindrical coordinates about it, θ counted from its 0-face through the air to its
n-face at nπ, 0 < n ≤ 2. A way over an edge is straight once the faces are rolled out.

Notes
-----
The four terms of the field at an edge belong to four ways beside it, their partners, each of which is seen on one side
of a boundary: the way past the edge for ``θ_r - θ_s`` above -π, and below π, the reflection by the 0-face for
``θ_r + θ_s`` below π, and that by the n-face for ``θ_r + θ_s`` above (2n - 1)π. In an inner corner, n < 1, the way past
the edge is always seen; the partners are ways by both faces in turn, see `partner_reflections`. On its boundary a term
is minus a half of its partner where this is seen, and a half where it is not, so that the sum is smooth.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from clsim.arrays import Complexes, Floats

TERMS = 4  # past the edge above -π and below π, by the 0-face, by the n-face
ON_LINE = 1e-6  # m; an end that is nearer to the line of an edge has no angle there, see `off_line`
ON_BOUNDARY = 1e-9  # radians, below which an angle to a boundary is taken as none
_FAR = 8.0  # root of a phase from which on the series is taken
_LEAST_ROOT = -1.0  # of the table of the transition function
_CELLS = 8192
_ROOT_J = np.exp(0.25j * np.pi)


@dataclass(frozen=True, slots=True, eq=False)
class EdgeWay:
    """The shortest paths over edges, each array (...)."""

    length: Floats  # (...) of the whole way, m
    apex: Floats  # (...) z at which it meets the edge, m
    # (...) ``2 (s s' / L) sin² β``, m, with the distances s' and s of both ends from the apex and the angle β to the
    # edge.
    breadth: Floats


def edge_way(source_r: Floats, source_z: Floats, receiver_r: Floats, receiver_z: Floats) -> EdgeWay:
    """Return the shortest paths over edges between places at distances r and heights z (...), m.

    Rolled out, the ends are at (-r_s, z_s) and (r_r, z_r) of a plane, and the edge is its z-axis (J. B. Keller,
    "Geometrical theory of diffraction", J. Opt. Soc. Am. 52(2), 1962, section 2: the cone of diffracted rays).
    """
    across = source_r + receiver_r
    length = np.hypot(across, source_z - receiver_z)
    apex = (source_z * receiver_r + receiver_z * source_r) / across
    # s' = L r_s / (r_s + r_r), s = L r_r / (r_s + r_r), sin β = (r_s + r_r) / L
    return EdgeWay(length, apex, 2.0 * source_r * receiver_r / length)


def off_line(n: ArrayLike, x: Floats, y: Floats, low: ArrayLike) -> tuple[Floats, Floats]:
    """Return distances r and angles θ (...) of places at x along the 0-face and y off it, from angles `low` on.

    Within `ON_LINE` of the line, such as on the straight extension of an edge, the angle is lost in rounding: there r
    is `ON_LINE` and θ that of the middle of the air. The field has this limit whatever is done to the last digits.
    """
    r, angle = np.hypot(x, y), np.arctan2(y, x)
    angle = np.where(angle < low, angle + 2.0 * np.pi, angle)
    return np.maximum(r, ON_LINE), np.where(r < ON_LINE, 0.5 * np.pi * np.asarray(n), angle)


def partner_reflections(n: ArrayLike) -> NDArray[np.int64]:
    """Count the reflections by the two faces of each term's partner; result (... 4).

    result: an even number for the first two terms, which begin at the 0-face and at the n-face, and an odd one for the
    last two, which do so as well; they are the two neighbours of 1/n.

    Our own derivation: by so many faces in turn the source at θ_s has its images at ``θ_s ± 2nπN``, and at ``-θ_s -
    2nπN`` and ``2nπ - θ_s + 2nπN``. Of the boundaries of these, half a turn from an image, each kind has one between
    the faces. Where n = 1/m two terms each have the same boundary, and cancel each other.
    """
    half = 0.5 / np.asarray(n, dtype=np.float64)
    even, odd = 2.0 * np.round(half), 2.0 * np.floor(half) + 1.0
    return np.stack([even, even, odd, odd], axis=-1).astype(np.int64)


def lit_angles(n: ArrayLike, source: ArrayLike, receiver: ArrayLike) -> Floats:
    """Return the angle by which each partner is inside its lit region; result (... 4).

    result: angles to the four boundaries, positive where the partner is seen, in radians.

    The boundaries are the zeros of ``a±`` of Kouyoumjian and Pathak (1974), eq. 27, that lie between the faces, with
    ``N±`` not 0 alone but as of `partner_reflections`.
    """
    n, source, receiver = (np.asarray(x, dtype=np.float64) for x in (n, source, receiver))
    between, together = receiver - source, receiver + source
    past = np.pi + between, np.pi - between
    angles = np.stack(np.broadcast_arrays(*past, np.pi - together, together - (2.0 * n - 1.0) * np.pi), axis=-1)
    return np.asarray(angles - n[..., None] * np.pi * (partner_reflections(n) // 2 * 2))


def wedge_terms(n: ArrayLike, angles: Floats, lit: ArrayLike | None = None) -> tuple[Floats, Floats]:
    """Return the weights and roots of the four terms of the field at a wedge.

    Shapes: angles (..., 4); lit (..., 4); result (..., 4), (..., 4).

    lit: 1 for partners that are taken as seen, -1 for others, also shortly beyond the boundary; by the angles when left
    out.

    weight: κ of each term, -1 to 1; on its boundary -1 where the partner is seen and 1 where it is not.

    root: root of the detour by the edge against the partner over the breadth of the way, beyond a boundary negative.

    The field over ``exp(-jkL) / L`` is the sum of ``ρ κ E(√(k breadth) root) / 2`` over the terms, with the reflection
    factors ρ of the partners (1 for the first two where n ≥ 1). This is the coefficient of R. G. Kouyoumjian and P. H.
    Pathak, "A uniform geometrical theory of diffraction for an edge in a perfectly conducting surface", Proc. IEEE
    62(11), 1974, eq. 25, for hard faces; factors as of R. J. Luebbers, IEEE Trans. Antennas Propag. 32(1), 1984. With a
    fixed `lit` weights and roots are smooth functions of the ends' places across the boundary.
    """
    n = np.asarray(n, dtype=np.float64)[..., None]
    turns = np.round(angles / (2.0 * n * np.pi))
    angle = angles - 2.0 * n * np.pi * turns
    side = np.where(angle >= 0.0, 1.0, -1.0)
    if lit is not None:
        side = np.where(turns == 0.0, lit, side)
    sine = np.sin(0.5 * angle)
    near = np.abs(angle) < ON_BOUNDARY
    cotangent = np.where(near, n, sine / np.tan(0.5 * np.where(near, 1.0, angle) / n))
    return np.asarray(-side * cotangent / n), np.asarray(side * sine)


def transition(root: Floats) -> Complexes:
    """Return the transition function ``E(x) = exp(jx) erfc(√(jx))`` of roots √x (...) of phases x.

    root: √x; negative ones are those of the continuation beyond x = 0, where E is larger than 1.

    It is ``F(x)`` of Kouyoumjian and Pathak (1974), eq. 26, over ``√(πx) exp(jπ/4)``, and Faddeeva's ``w(j √(jx))``. As
    a function of ``1 / (2 + √x)`` it is smooth up to x = ∞: cubics in cells of that hold it to 2e-12 of itself. Of
    negative roots it is ``2 exp(jx)`` less that of positive ones.
    """
    root = np.asarray(root, dtype=np.float64)
    beyond = np.flatnonzero(root < _LEAST_ROOT)
    inside = root if not len(beyond) else np.where(root < _LEAST_ROOT, -root, root)
    place = _CELLS / (2.0 + inside)
    cell = np.minimum(place.astype(np.int64), _CELLS - 1)
    place -= cell
    c = _transition_cubics()[:, cell]
    found = c[0] + place * (c[1] + place * (c[2] + place * c[3]))
    if len(beyond):
        found.flat[beyond] = 2.0 * np.exp(1j * root.flat[beyond] ** 2) - found.flat[beyond]
    return np.asarray(found)


@cache
def _transition_cubics() -> Complexes:
    """Return the cubics (4, cells) of the transition function over the place in each cell of ``1 / (2 + root)``.

    They meet it at both ends of a cell and at its thirds.
    """
    share = np.linspace(0.0, 1.0, 4)
    place = (np.arange(_CELLS)[:, None] + share) / _CELLS
    values = np.zeros(place.shape, dtype=np.complex128)
    values.flat[1:] = _transition(1.0 / place.flat[1:] - 2.0)
    return np.asarray(np.linalg.solve(np.vander(share, increasing=True), values.T))


def _transition(root: Floats) -> Complexes:
    """Return the transition function by Faddeeva's; far out by nine terms of erfc's series, which hold it to 3e-11."""
    from scipy.special import wofz

    far = root > _FAR
    found = np.empty(root.shape, dtype=np.complex128)
    found[~far] = wofz(1j * _ROOT_J * root[~far])
    t = 0.5 / root[far] ** 2  # the series is that of Σ (2n - 1)!! (jt)^n
    tt = t * t
    real = 1.0 - tt * (3.0 - tt * (105.0 - tt * (10395.0 - tt * 2027025.0)))
    imag = t * (1.0 - tt * (15.0 - tt * (945.0 - tt * 135135.0)))
    scale = 1.0 / (np.sqrt(2.0 * np.pi) * root[far])  # times exp(-jπ/4) √2 = 1 - j
    found.real[far] = scale * (real + imag)
    found.imag[far] = scale * (imag - real)
    return found


def end_detour(way: EdgeWay, source: tuple[Floats, Floats], receiver: tuple[Floats, Floats], end: ArrayLike) -> Floats:
    """Return the detour over a point of the edge beyond the shortest path, (...) m.

    Our own derivation: each leg's ``far - near`` is ``(far² - near²) / (far + near)``. The parts linear in the offset
    of the point from the apex cancel over both legs, by Fermat's principle, and are left out before they round.
    """
    off = np.asarray(end, dtype=np.float64) - way.apex
    total = np.zeros(np.broadcast(off, way.length).shape)
    for r, z in (source, receiver):
        along = way.apex - z
        near, far = np.hypot(r, along), np.hypot(r, along + off)
        longer = off * (off + 2.0 * along) / (near + far)
        total += off * (off - along * longer / near) / (near + far)
    return np.asarray(np.maximum(total, 0.0))
