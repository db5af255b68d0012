"""Sound at edges, their ends and pairs of them, uniform and exact, with the time convention ``exp(+jωt)``.

An edge runs along z; r, θ, z are cylindrical coordinates about it, θ counted from its 0-face through the air to its
n-face at nπ, 0 < n ≤ 2. A way over an edge is straight once the faces are rolled out.

Notes
-----
The four terms of the field at an edge belong to four ways beside it, their partners, each of which is seen on one side
of a boundary: the way past the edge for ``θ_r - θ_s`` above -π, and below π, the reflection by the 0-face for
``θ_r + θ_s`` below π, and that by the n-face for ``θ_r + θ_s`` above (2n - 1)π. In an inner corner, n < 1, the way past
the edge is always seen; the partners are ways by both faces in turn, see `adjacent_reflections`. On its boundary a term
is minus a half of its partner where this is seen, and a half where it is not, so that the sum is smooth.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clsim.arrays import Complexes, Floats

TERMS = 4  # past the edge above -π and below π, by the 0-face, by the n-face
ON_LINE = 1e-6  # m; an end that is nearer to the line of an edge has no angle there, see `off_line`
ON_BOUNDARY = 1e-9  # radians, below which an angle to a boundary is taken as none
_FAR = 8.0  # root of a phase from which on the series is taken
_LEAST_ROOT = -1.0  # of the table of the transition function
_CELLS = 8192
_ROOT_J = np.exp(0.25j * np.pi)
_WEDGE_POINTS = 40  # of the contour; steps stay below 0.2, which leaves exp(-2π 0.57 / 0.2) = -155 dB
_WEDGE_FADED = 20.0  # exponent of the fall along the contour at which it is left
END_TERMS = 4  # Chebyshev polynomials of the angle's square: within 5e-7 (three: 1e-5)
AT_CORNER = 1e-9  # root of a phase, below which angle and sides are lost
EVEN = 0.25 * np.pi  # angle of a, b then: as much of either edge at a corner
_END_CELLS = 256
_END_POINTS = 120  # of the half-way rule: within 1e-11, however near the corner
_END_FIRST, _END_FADED = -3.4, 36.0  # of the points, exp(u - exp(-u)), and exponent of the fall at which they end
_DOUBLE_POINTS = 72
_TERMS_AT_ONCE = 8192
_DOUBLE_FIRST, _DOUBLE_FADED = -2.7, 20.0  # of the points, exp(u - exp(-u)), and exponent of the fall at which they end
_DOUBLE_FINEST = 1e-5  # of the root of a phase, what is finer adds as little
_DOUBLE_LEAST = 2e-5  # the same where both edges are on their boundaries: the function is 1, within as much


@dataclass(frozen=True, slots=True, eq=False)
class EdgePath:
    """The shortest paths over edges, each array (...)."""

    length: Floats  # (...) of the whole way, m
    apex: Floats  # (...) z at which it meets the edge, m
    # (...) ``2 (s s' / L) sin² β``, m, with the distances s' and s of both ends from the apex and the angle β to the
    # edge.
    breadth: Floats


def path_over_edge(source_r: Floats, source_z: Floats, receiver_r: Floats, receiver_z: Floats) -> EdgePath:
    """Return the shortest paths over edges between places at distances r and heights z (...), m.

    Rolled out, the ends are at (-r_s, z_s) and (r_r, z_r) of a plane, and the edge is its z-axis (J. B. Keller,
    "Geometrical theory of diffraction", J. Opt. Soc. Am. 52(2), 1962, section 2: the cone of diffracted rays).
    """
    across = source_r + receiver_r
    length = np.hypot(across, source_z - receiver_z)
    apex = (source_z * receiver_r + receiver_z * source_r) / across
    # s' = L r_s / (r_s + r_r), s = L r_r / (r_s + r_r), sin β = (r_s + r_r) / L
    return EdgePath(length, apex, 2.0 * source_r * receiver_r / length)


def off_line(n: ArrayLike, x: Floats, y: Floats, low: ArrayLike) -> tuple[Floats, Floats]:
    """Return distances r and angles θ (...) of places at x along the 0-face and y off it, from angles `low` on.

    Within `ON_LINE` of the line, such as on the straight extension of an edge, the angle is lost in rounding: there r
    is `ON_LINE` and θ that of the middle of the air. The field has this limit whatever is done to the last digits.
    """
    r, angle = np.hypot(x, y), np.arctan2(y, x)
    angle = np.where(angle < low, angle + 2.0 * np.pi, angle)
    return np.maximum(r, ON_LINE), np.where(r < ON_LINE, 0.5 * np.pi * np.asarray(n), angle)


def adjacent_reflections(n: ArrayLike) -> NDArray[np.int64]:
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
    ``N±`` not 0 alone but as of `adjacent_reflections`.
    """
    n, source, receiver = (np.asarray(x, dtype=np.float64) for x in (n, source, receiver))
    between, together = receiver - source, receiver + source
    past = np.pi + between, np.pi - between
    angles = np.stack(np.broadcast_arrays(*past, np.pi - together, together - (2.0 * n - 1.0) * np.pi), axis=-1)
    return np.asarray(angles - n[..., None] * np.pi * (adjacent_reflections(n) // 2 * 2))


def wedge_terms(n: ArrayLike, angles: Floats, lit: ArrayLike | None = None) -> tuple[Floats, Floats]:
    """Return the weights and roots of the four terms of the field at a wedge.

    Shapes: angles (..., 4); lit (..., 4); result (..., 4), (..., 4). lit: 1 for partners that are taken as seen, -1 for
    others, also shortly beyond the boundary; by the angles when left out. weight: κ of each term, -1 to 1; on its
    boundary -1 where the partner is seen and 1 where it is not. root: root of the detour by the edge against the
    partner over the breadth of the way, beyond a boundary negative.

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


def end_detour(
    edge_path: EdgePath, source: tuple[Floats, Floats], receiver: tuple[Floats, Floats], end: ArrayLike
) -> Floats:
    """Return the detour over a point of the edge beyond the shortest path, (...) m.

    Our own derivation: each leg's ``far - near`` is ``(far² - near²) / (far + near)``. The parts linear in the offset
    of the point from the apex cancel over both legs, by Fermat's principle, and are left out before they round.
    """
    off = np.asarray(end, dtype=np.float64) - edge_path.apex
    total = np.zeros(np.broadcast(off, edge_path.length).shape)
    for r, z in (source, receiver):
        along = edge_path.apex - z
        near, far = np.hypot(r, along), np.hypot(r, along + off)
        longer = off * (off + 2.0 * along) / (near + far)
        total += off * (off - along * longer / near) / (near + far)
    return np.asarray(np.maximum(total, 0.0))


def exact_wedge_terms(
    n: ArrayLike,
    angles: Floats,
    lit: ArrayLike,
    source_r: Floats,
    receiver_r: Floats,
    edge_path: EdgePath,
    wave: Floats,
) -> list[Complexes]:
    """Return the four terms of the exact field at a hard wedge, each (..., F), over ``exp(-jkL) / L``.

    Shapes: angles (..., 4); lit (..., 4); wave (..., F) 1/m. lit: 1 for partners that are taken as seen, also shortly
    beyond the boundary, -1 for others.

    The integral along an infinite edge of U. P. Svensson, R. I. Fred and J. Vanderkooy, "An analytic secondary source
    model of edge diffraction impulse responses", J. Acoust. Soc. Am. 106(5), 1999, eq. 27 and 30, over the length ``L -
    jv²`` in place of the place on the edge: there ``exp(-jkp)`` falls as ``exp(-kv²)`` and does not turn. What a term
    has as its pole, where that length is the partner's R, is integrated in closed form, ``E(√(k (L - R))) L / 2R``; the
    rest is smooth, also on the boundary. Half-way rule in u of ``v = a sinh u``, with a fine enough for the highest
    wave number and the wedge, and an end where the lowest has fallen.
    """
    n = np.asarray(n, dtype=np.float64)[..., None]
    angle = angles - 2.0 * n * np.pi * np.round(angles / (2.0 * n * np.pi))
    side = np.where(angle >= 0.0, 1.0, -1.0)
    lit = np.where(np.abs(angles) <= n * np.pi, lit, side)
    length, product = edge_path.length[..., None], (source_r * receiver_r)[..., None]
    shorter = 4.0 * product * np.sin(0.5 * angle) ** 2
    direct = np.sqrt(np.maximum(length**2 - shorter, 1e-30 * length**2))
    detour = shorter / (length + direct)
    has_pole = np.abs(angle) < np.pi
    v, step = _contour(edge_path, wave)
    rests = _integrands(n, angle, length, product, v)
    fall = step[..., None] * np.exp(-(v**2)[..., None] * wave[..., None, :])
    found = []
    for term in range(TERMS):
        pole = np.where(has_pole, side * length / direct, 0.0)[..., term, None]
        root = np.sqrt(detour[..., term, None])
        rest = next(rests) + pole * _ROOT_J / np.pi * root / (v**2 + 1j * detour[..., term, None])
        both = np.stack([rest.real, rest.imag], axis=-2) @ fall
        seen = lit[..., term, None]
        closed = transition(seen * side[..., term, None] * root * np.sqrt(wave))
        found.append(both[..., 0, :] + 1j * both[..., 1, :] - 0.5 * seen * np.abs(pole) * closed)
    return found


def _contour(edge_path: EdgePath, wave: Floats) -> tuple[Floats, Floats]:
    """Return the points v (..., points) of the contour, roots of m, and their weights."""
    finest = np.minimum(np.sqrt(edge_path.breadth), 1.0 / np.sqrt(wave.max(axis=-1)))
    last = np.arcsinh(np.sqrt(_WEDGE_FADED / wave.min(axis=-1)) / finest)
    spacing = (last / _WEDGE_POINTS)[..., None]
    u = spacing * (np.arange(_WEDGE_POINTS) + 0.5)
    return finest[..., None] * np.sinh(u), finest[..., None] * spacing * np.cosh(u)


def _integrands(n: Floats, angle: Floats, length: Floats, product: Floats, v: Floats) -> Iterator[Complexes]:
    """Yield what is integrated over v (..., points) for each term, without its fall."""
    both = 2.0 * length - 1j * v**2  # p + L
    half = v / _ROOT_J * np.sqrt(both / (4.0 * product))  # sinh(η / 2)
    eta = 2.0 * np.arcsinh(half)
    common = -length / (np.pi * n * _ROOT_J) / (np.sqrt(both * product) * np.sqrt(1.0 + half**2))
    squared = np.sinh(0.5 * eta / n) ** 2
    for term in range(TERMS):
        turn = angle[..., term, None] / n
        yield common * np.sin(turn) / (2.0 * (squared + np.sin(0.5 * turn) ** 2))


def end_transition(end: Floats, root: Floats, corner: Floats | float = EVEN) -> Complexes:
    """Compute the transition function of an edge and of its end, the field at the end over that of the partner.

    end: root a of the phase by which the way over the end is longer than the shortest one; negative beyond the boundary
    at which the shortest way passes the end. root: root b of the phase of a term of the edge, as of `transition`;
    negative beyond the term's boundary. corner: the angle φ of ``a + jb`` as the shortest way comes to the corner,
    where both are less than `AT_CORNER`. result: ``E(b) / 2`` for a = 0; 0 for b = 0 and a > 0; about ``E(a) E(b) b² /
    (a² + b²) / 2`` far out.

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
    spacing = (np.log(_END_FADED / finest) - _END_FIRST) / _END_POINTS
    total = np.zeros((*radius.shape[:-1], END_TERMS), dtype=np.complex128)
    for point in range(_END_POINTS):
        u = _END_FIRST + spacing * (point + 0.5)
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
    place = _END_CELLS / (1.0 + radius)
    cell = np.minimum(place.astype(np.int64), _END_CELLS - 1)
    place -= cell
    found = np.zeros(radius.shape, dtype=np.complex128)
    for cubics, weight in zip(_end_cubics(), angle_polynomials(phi), strict=True):
        c = cubics[:, cell]
        found += weight * (c[0] + place * (c[1] + place * (c[2] + place * c[3])))
    return found


@cache
def _end_cubics() -> Complexes:
    """Compute the cubics (END_TERMS, 4, cells), lowest power first."""
    from scipy.interpolate import CubicSpline

    place = np.arange(_END_CELLS + 1.0)
    values = np.zeros((_END_CELLS + 1, END_TERMS), dtype=np.complex128)
    values[1:] = end_coefficients(_END_CELLS / place[1:] - 1.0)
    return np.ascontiguousarray(np.moveaxis(CubicSpline(place, values).c[::-1], 2, 0))


def double_tie(edge_path: EdgePath, first: Floats, last: Floats) -> Floats:
    """Return the coupling of the transitions at two edges (...): 0 for edges far apart, 1 for one edge.

    Our own derivation: ``w² = s1 s2 / ((s1 + s) (s + s2))`` with the part s between the edges is the square of the
    mixed second derivative of the way's length by both angles over the product of the others; what is left, 1 - w², is
    the ratio by which the breadth is less where the other edge itself is the receiver.
    """
    between = np.maximum(edge_path.length - first - last, 0.0)
    return np.asarray(np.sqrt(first * last / ((first + between) * (between + last))))


def double_transition(first: Floats, last: Floats, tie: Floats, wave: Floats) -> Complexes:
    """Return the transition function of two edges (..., F), which of edges far apart is that of one times the other's.

    Shapes: wave (..., F) 1/m. first, last: root of the detour of a term at each edge, with the breadth of the way as
    that edge sees it, √m; negative beyond a boundary, as of `transition`.

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
    found = _along_the_contour(a, b, tie, wave, (1.0, -1.0))
    for root, other, beyond in ((a, b, first < 0.0), (b, np.where(first < 0.0, -a, a), last < 0.0)):
        some = np.nonzero(beyond)
        if len(some[0]):  # shortly beyond a boundary the partner is added
            found[some] = _over_one_edge(root[some], other[some], tie[some], wave[some], (-1.0, 1.0)) - found[some]
    return found


def gap_transition(first: Floats, last: Floats, tie: Floats, wave: Floats) -> Complexes:
    """Compute the transition functions (..., K, F) of K pairs of terms of two edges across open air.

    Shapes: first, last, tie (..., K); wave (..., F) 1/m.

    first, last: as of `double_transition`.

    tie: of `double_tie`, times the cosine between the two directions in which the partners are seen past the edges, of
    one before the edge that is dark; with its sign changed for each of both terms whose partner is seen.

    Along no face the double integral is even in both angles together, not in each. With ``c = -tie`` it is the integral
    over the quarter plane beyond both edges,

        E(a, b) = 4j √(1 - c²) / π ∬ exp(-j (u² + 2cuv + v² + 2 √(1 - c²) (au + bv))) du dv,

    a bivariate error function: ``1 + (2/π) arcsin(tie)`` on both boundaries, where two parallel half-planes leave a
    quarter of it. The mean over both signs of the tie is that of `double_transition`. Our own derivation: of skew edges
    the quadratic form of the detour by the places where the way passes both half-planes, least along the edges, has
    this c.
    """
    a, b = np.abs(first), np.abs(last)
    one, other = np.where(first < 0.0, -1.0, 1.0), np.where(last < 0.0, -1.0, 1.0)
    parts = np.array_split(np.arange(len(a)), max(1, min(len(a), a.size // _TERMS_AT_ONCE)))
    sign, over = tie * one * other, wave[..., None, :]
    found = np.concatenate([_along_the_contour(a[p], b[p], sign[p], over[p], (1.0,)) for p in parts])
    for root, beside, sign, beyond in ((a, b, tie * other, first < 0.0), (b, one * a, tie, last < 0.0)):
        some = np.nonzero(beyond)
        if len(some[0]):
            found[some] = (
                _over_one_edge(root[some], beside[some], sign[some], wave[some[:-1]], (-1.0, -1.0)) - found[some]
            )
    return found


def _over_one_edge(root: Floats, other: Floats, tie: Floats, wave: Floats, signs: tuple[float, float]) -> Complexes:
    """Return the transition over one of the edges alone, where the other's boundary is passed."""
    turned = np.exp(1j * wave * ((1.0 - tie**2) * root**2)[..., None])
    scale, moved = np.sqrt(wave), tie * root
    one, more = (transition((other + sign * moved)[..., None] * scale) for sign in signs)
    return np.asarray(turned * (one + more))


def _along_the_contour(a: Floats, b: Floats, tie: Floats, wave: Floats, signs: tuple[float, ...]) -> Complexes:
    """Return it for positive a and b: over s = v², with points that are dense about the least of its scales.

    That is the least of all where there is but one sign of the tie.
    """
    left, longest = 1.0 - tie**2, np.sqrt(wave.max(axis=-1))
    on_both = np.maximum(a, b) * longest < _DOUBLE_LEAST
    a, b = (np.where(on_both, _DOUBLE_LEAST / longest, x) for x in (a, b))
    finest = (np.clip(np.sqrt(left) * np.minimum(a, b) * longest, _DOUBLE_FINEST, 1.0) / longest) ** 2
    if len(signs) == 1:
        finest = finest.min(axis=-1, keepdims=True)
    last = np.log(_DOUBLE_FADED / (wave.min(axis=-1) * finest))
    spacing = (last - _DOUBLE_FIRST) / _DOUBLE_POINTS
    u = _DOUBLE_FIRST + spacing[..., None] * (np.arange(_DOUBLE_POINTS) + 0.5)
    fine = np.exp(-u)
    s = finest[..., None] * np.exp(u - fine)
    a, b, w, left, turned = a[..., None], b[..., None], tie[..., None], left[..., None], -1j * s
    roots: Any = np.sqrt(left * a**2 + turned), np.sqrt(left * b**2 + turned)
    total = np.zeros(roots[0].shape, dtype=np.complex128)
    for sign in signs:
        pole = a**2 + b**2 + 2.0 * sign * w * a * b + turned
        total += ((b + sign * w * a) / roots[0] + (a + sign * w * b) / roots[1]) / pole
    total *= turned * (1.0 + fine) * (1.0 / np.pi / len(signs) * spacing[..., None])
    both = np.stack([total.real, total.imag], axis=-2) @ np.exp(-s[..., None] * wave[..., None, :])
    return np.asarray(both[..., 0, :] + 1j * both[..., 1, :])
