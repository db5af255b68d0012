"""The field about the outline of a smooth rigid body: its shadow, and the sound that creeps round it.

Time goes by ``exp(+j 2 pi f t)``. Geometry is that of the body's own frame, m, with its centre at the origin.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from clsim.acoustics.fock import fock_hard, lit_reflection
from clsim.acoustics.outline import LEAST, Outline, OutlinePoints, counts_of_points, eased, faded
from clsim.acoustics.scattering import SpecularPoint
from clsim.arrays import Complexes, Floats
from clsim.numerics.band_filters import chebyshev_points, interpolation

ASPECTS = 11  # numbers that a field takes
# Cosines of the angle of incidence between which the share of the outline falls from 1 to 0: beyond, the body is a
# mirror.
FORWARD_COSINE = (0.25, 0.45)
# Radii of the first Fresnel zone by which a line of sight passes a body: up to here its outline counts, beyond twice
# it does not.
WITHIN = 1.0
NEAR_FOCK = (-4.0, -5.5)  # where the near side of an outline ends that the line of sight does not meet
# Squared sine of the angle that a tangent makes with the outline: below, a point is no edge of the body.
GRAZING = (0.3, 0.02)
# Frequencies at which the strength of an outline's points is known, by the largest half range of their cube roots over
# the middle: within 1e-4 of the strength, by trial.
KNOWN_AT = ((1e-9, 1), (0.009, 3), (0.035, 4), (0.13, 6), (math.inf, 12))
# Fock's function is the first order of a series in 1 / m^2, for a surface that bends evenly along its penumbra. On a
# sphere ``m^2 / (m^2 + 0.8)`` of it is taken, and less on what is sharper. At low frequencies, and on a thin disc seen
# edge-on, nothing is left. The form is our own choice, and the number fits exact spheres.
SHARP = 0.4
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(4)
SHORTEST = 1e-3  # of the path by the surface: no line of sight counts as shorter
_LARGEST = 3.5  # of the field about an outline, relative to the free field
_AT_A_TIME, _IN_CACHE = 1 << 20, 1 << 16  # numbers that are worked on together, and those that phases are made of


def silhouette_aspects(
    ends: tuple[Floats, Floats], specular: SpecularPoint, mirrored: tuple[Floats, Floats, Floats]
) -> tuple[Floats, Floats]:
    """Return the strength (n,) that `silhouette_field` is relative to, m, and what that takes (n, 11).

    Shapes: both endpoints (3, n) m. mirrored: strength of the specular reflection (n,), m, cosine of the angle of
    incidence there (n,), and curvature (n,) of the surface in the plane of incidence, 1/m.

    The strength is ``l1 l2 / L``: both legs by the specular point, and the line of sight, along which the free field
    falls. Where the body hides the endpoints from each other, its point is on that line. Our own derivation.
    """
    source, receiver = ends
    legs = [np.sqrt(np.sum((specular.place - end) ** 2, axis=0)) for end in ends]
    sight = np.sqrt(np.sum((receiver - source) ** 2, axis=0))
    held = np.maximum(sight, SHORTEST * (legs[0] + legs[1]))
    strength = legs[0] * legs[1] / held
    columns = [*source, *receiver, held, np.where(specular.hidden, 0.0, mirrored[0]) / strength]
    columns += [np.where(specular.hidden, -1.0, mirrored[1]), mirrored[2], sight - legs[0] - legs[1]]
    return strength, np.stack(columns, axis=1)


def forward_share(outline: Outline, centre: float, source: Floats, receiver: Floats) -> Floats:
    """Share (n, 1) of the field about an outline in what a body sends on; the rest of it is a mirror.

    centre: wave number in the middle of the signal's band, 1/m. Shapes: source, receiver (n, 3) m, in the body's frame.

    With the distance h of the body from the line of sight, at d1 and d2 from the ends of that, the radius of the first
    Fresnel zone is ``sqrt(2 pi d1 d2 / (k L))``, and sound reflected there is incident at ``cos theta = h L / (2 d1
    d2)``, about. All frequencies have one share, so that neither field fades within the band.
    """
    clearance, place = (x[:, None] for x in outline.clearance(source, receiver))
    twice = 2.0 * np.linalg.norm(receiver - source, axis=1)[:, None] * place * (1.0 - place)  # of d1 d2 / L
    beyond = np.maximum(clearance, 0.0)
    share = eased(beyond / np.maximum(twice, LEAST), FORWARD_COSINE)
    zones = beyond * np.sqrt(centre / (math.pi * np.maximum(twice, LEAST)))
    return np.asarray(share * eased(zones, (WITHIN, 2.0 * WITHIN)))


def silhouette_field(
    outline: Outline, wave: Floats, centre: float, aspects: Floats, mirror: Complexes | float = 1.0,
    past: Complexes | float = 1.0,
) -> Complexes:  # fmt: skip
    """Field of a smooth rigid body over its strength.

    centre: wave number in the middle of the signal's band, 1/m.

    Shapes: wave (F,) 1/m; aspects (..., 11); mirror, a factor (..., F) of what is reflected; past, a factor (..., F) of
    the field about the outline, see `shade`; result (..., F).

    Near the forward direction it is the field about the outline, `outline_field`, elsewhere the specular reflection
    times `lit_reflection`. One fades into the other by `forward_share`, where both hold. Our own derivation.
    """
    flat = aspects.reshape(-1, ASPECTS)
    share = forward_share(outline, centre, flat[:, 0:3], flat[:, 3:6])
    fock = -2.0 * flat[:, 8:9] * np.cbrt(0.5 * wave / flat[:, 9:10])
    left = np.broadcast_to(np.asarray(past).reshape(-1, np.shape(past)[-1] if np.ndim(past) else 1), fock.shape)
    lit = flat[:, 7:8] * (1.0 - share) * lit_reflection(fock)
    found = lit * np.reshape(mirror, (-1, np.shape(mirror)[-1] if np.ndim(mirror) else 1))
    some = np.flatnonzero(share.any(axis=1) & left.any(axis=1))
    for rows, about, sight in outline_fields(outline, wave, (flat[:, 0:3], flat[:, 3:6]), some):
        about *= np.exp(-1j * flat[rows, 10:11] * wave) * (flat[rows, 6:7] / sight)
        found[rows] += share[rows] * left[rows] * about
    return np.asarray(found.reshape(*aspects.shape[:-1], len(wave)))


def outline_fields(
    outline: Outline, wave: Floats, ends: tuple[Floats, Floats], some: NDArray[np.int64]
) -> Iterator[tuple[NDArray[np.int64], Complexes, Floats]]:
    """Yield rows of ends (n, 3), m, their fields (rows, F) by `outline_field` of enough points, and lines of sight."""
    if not len(some):
        return
    highest, own = float(wave.max()), outline.part(some)
    counts = counts_of_points(own, highest, *(end[some] for end in ends))
    for count in np.unique(counts).tolist():
        alike = np.flatnonzero(counts == count)
        each = max(_AT_A_TIME // (count * KNOWN_AT[-1][1]), 1)
        for here in (alike[first : first + each] for first in range(0, len(alike), each)):
            rows = some[here]
            yield rows, *outline_field(own.part(here), wave, ends[0][rows], ends[1][rows], count)


def outline_field(
    outline: Outline, wave: Floats, source: Floats, receiver: Floats, count: int
) -> tuple[Complexes, Floats]:
    """Field (n, F) that an outline adds to the free field, over the free field, and the lines of sight (n, 1), m.

    Shapes: wave (F,) 1/m; source, receiver (n, 3) m.

    A line integral of our own derivation. Kirchhoff's field of a screen with that outline is ``1 + (1 / 2 pi) integral
    of (exp(-j k psi) - 1) d phi``, with the angle phi about the line of sight and the detour psi (A. Rubinowicz, Prog.
    Opt. 4 (1965), 199, far from the screen). A smooth hard body differs from a screen by ``-m sqrt(2 / k) q*(xi)``
    times a creeping wave (P. H. Pathak, W. D. Burnside, R. J. Marhefka 1980, eq. 22), with ``m = (k R / 2)^(1/3)`` and
    the Fock parameter xi. Along a straight outline the integral of ``-m q*(xi) exp(-j k psi) / (d sqrt(pi))`` is that,
    d half the harmonic mean of both tangents, so this is added to Kirchhoff's term. The detour is that of a string
    about the ellipse in which the plane of the point cuts the body, and on either side of grazing the same function of
    it. Where the ellipse bends within the penumbra, Fock's term falls, see `SHARP`. Against rigid spheres it is right
    within 0.2 dB rms from k a of 2 on.
    """
    points = outline.points(source, receiver, count)
    sight = points.receiver - points.source
    string = _strings(points)
    beside = points.beside**2
    detour = np.sqrt(string.source**2 + beside) + np.sqrt(string.receiver**2 + beside) - sight
    weight = points.step * string.width
    inside = np.where((points.source < 0.0) & (points.receiver > 0.0), -points.depth, 0.0)
    screen = points.step * inside / (inside**2 + beside + LEAST) / (2.0 * math.pi)
    edge = string.offset / (string.offset**2 + beside + LEAST) / (2.0 * math.pi)
    smooth = string.curve / np.maximum(string.apart * math.sqrt(math.pi), LEAST)
    # But for the phase all changes slowly with frequency: it is known at few of them.
    roots = np.cbrt(0.5 * wave)  # on which it depends
    root = chebyshev_points(float(roots.min()), float(roots.max()), known_at(roots))[:, None, None]
    fock = root * string.fock
    known = faded(fock, NEAR_FOCK) * weight * (edge - root**3 * smooth / (root**2 + string.sharp) * fock_hard(fock))
    return _summed(known, detour, wave) - np.sum(screen, axis=1)[:, None], sight[:, :1]


def known_at(roots: Floats) -> int:
    """Frequencies at which strengths of points are known, by cube roots of half the wave numbers (F,)."""
    return next(count for reach, count in KNOWN_AT if np.ptp(roots) <= reach * (roots.min() + roots.max()))


def _summed(known: Complexes, detour: Floats, wave: Floats) -> Complexes:
    """Field (n, F) of points by their strengths (M, n, N), see `outline_field`, with the phases of detours (n, N), m.

    Over a band, a phase that turns by up to c rad to either side of its middle is a polynomial of a degree little above
    c, to 1e-9 (Bessel functions J_n(c) fall quickly beyond n = c): a sum is taken at as many wave numbers and carried
    to all others.
    """
    total = np.zeros((len(detour), len(wave)), dtype=np.complex128)
    low, high = float(wave.min()), float(wave.max())
    roots = np.cbrt(0.5 * wave)
    counted = np.any(known != 0.0, axis=0)
    begin, end = np.where(counted, detour, np.inf).min(axis=1), np.where(counted, detour, -np.inf).max(axis=1)
    turn, middle = 0.25 * (high - low) * np.maximum(end - begin, 0.0), 0.5 * (begin + end)
    counts = 8 * np.ceil((turn + 6.0 * np.cbrt(turn) + 12.0) / 8.0)
    counts[counts >= len(wave)] = 0  # of wave numbers themselves
    for count in np.unique(counts).astype(int).tolist():
        at = chebyshev_points(low, high, count) if count else wave
        weights = interpolation(float(roots.min()), float(roots.max()), len(known), np.cbrt(0.5 * at))
        alike = np.flatnonzero((counts == count) & counted.any(axis=1))
        each = max(_IN_CACHE // (detour.shape[1] * len(at)), 1)
        for rows in (alike[first : first + each] for first in range(0, len(alike), each)):
            late = (detour[rows] - middle[rows, None]) * (0.5 / math.pi)
            strength = known[:, rows].swapaxes(0, 1)
            if not count:
                total[rows] = np.sum(weights * (strength @ _turned(late[..., None] * at)), axis=1)
                continue
            # Of Chebyshev points one half has the phases of the other with the other sign, about the middle.
            strength = strength * _turned(late * (0.5 * (high + low)))[:, None]
            half = _turned(late[..., None] * (at[: count // 2] - 0.5 * (high + low)))
            sums = np.concatenate([strength @ half, np.conj(np.conj(strength) @ half)[..., ::-1]], axis=-1)
            total[rows] = np.sum(weights * sums, axis=1) @ _carry(wave.tobytes(), count)
    return total * np.exp(-1j * np.where(np.isfinite(middle), middle, 0.0)[:, None] * wave)


def _turned(turns: Floats) -> Complexes:
    """Phase factors of turns, within 2e-7: sine and cosine in single precision take a fifth of the time."""
    part = ((turns - np.rint(turns)) * (2.0 * math.pi)).astype(np.float32)
    factors = np.empty(part.shape, dtype=np.complex128)
    factors.real, factors.imag = np.cos(part), -np.sin(part)
    return factors


@lru_cache(maxsize=32)
def _carry(wave: bytes, count: int) -> Complexes:
    """Weights (count, F) of values at Chebyshev points of a band for those at wave numbers (F,)."""
    x = np.frombuffer(wave)
    return interpolation(float(x.min()), float(x.max()), count, x).astype(np.complex128)


@dataclass(frozen=True, slots=True, eq=False)
class _Strings:
    """Strings from endpoint to endpoint over the ellipses of outlines' points, each field (n, N).

    A string that does not touch has an arc of negative length: what follows is one function of the geometry.
    """

    source: Floats  # tangent from the source and half of the arc, m
    receiver: Floats
    apart: Floats  # 1 / (1 / t1 + 1 / t2) of both tangents, m
    fock: Floats  # Fock parameter of the arc over (k / 2)^(1/3)
    curve: Floats  # m of the ends of the arc over (k / 2)^(1/3)
    offset: Floats  # what stands for the depth of the line of sight: apart * fock / curve, m
    width: Floats  # of the wavefront at the ends of the arc over that at the point, and 0 where tangents graze
    sharp: Floats  # (k / 2)^(2/3) below which the ellipse is too sharp for Fock's function


def _strings(at: OutlinePoints) -> _Strings:
    """Strings over ellipses, which affine coordinates about their centres make unit circles.

    Tangents are as long as those of the circle, times the speed of the ellipse where they touch.
    """
    skew = at.q_nz / at.q_zz
    bent = at.q_nn - at.q_nz * skew
    over, ahead = at.support * bent, at.support * np.sqrt(bent * at.q_zz)
    flat, slim = 1.0 / over, 1.0 / ahead

    def slope(cosine: Floats, sine: Floats) -> Floats:
        up = sine * flat
        on = cosine * slim + skew * up
        return np.asarray(np.sqrt(up * up + on * on))

    x = 1.0 + over * at.depth
    tangents, cosines, sines, slopes = [], [], [], []
    for q, sign in ((at.source, -1.0), (at.receiver, 1.0)):
        y = sign * ahead * (q + skew * at.depth)
        squared = np.maximum(x * x + y * y, 1.0)
        leg = np.sqrt(squared - 1.0)
        cosines.append((x + y * leg) / squared)
        sines.append((y - x * leg) / squared)
        slopes.append(slope(cosines[-1], sign * sines[-1]))
        tangents.append(leg * slopes[-1])
    (c1, c2), (s1, s2) = cosines, sines
    half = 0.5 * np.arctan2(s1 * c2 + c1 * s2, c1 * c2 - s1 * s2)
    middle = np.arctan2(s2, c2) - half

    arc, fock = np.zeros_like(half), np.zeros_like(half)
    for node, weight in zip(_NODES, _WEIGHTS, strict=True):
        turn = middle + half * node
        steep = slope(np.cos(turn), np.sin(turn))
        arc, fock = arc + weight * half * steep, fock + weight * half / steep
    size = np.cbrt(flat * slim)  # J^(1/3), with the curvature J / slope^3
    fock = fock * size * size
    curve = np.sqrt(slopes[0] * slopes[1]) / size
    sharp = SHARP * ((1.0 + skew * skew) * flat**2 + slim**2) / size**4
    apart = tangents[0] * tangents[1] / (tangents[0] + tangents[1] + LEAST)
    wide = np.sqrt(np.maximum(c1 * c2, 0.0))
    for tangent in tangents:
        wide = wide * faded(tangent**2 / (tangent**2 + at.beside**2 + LEAST), GRAZING)
    source, receiver = (tangent + 0.5 * arc for tangent in tangents)
    return _Strings(source, receiver, apart, fock, curve, apart * fock / curve, wide, sharp)


def silhouette_bound(largest: float, wave: Floats, nearest: Floats) -> Floats:
    """Return a bound (n, F) of the field about an outline, times the path's length; see `Shape.largest`.

    That of a disc of the largest radius in Kirchhoff's approximation, ``k a^2 / d`` with the distances' harmonic mean,
    twice for small bodies; at most 3.5, since the field behind a sphere on the axis is 2.4 times the free one. Our own
    derivation.
    """
    return np.asarray(np.minimum(wave * largest**2 / nearest[:, None], _LARGEST))
