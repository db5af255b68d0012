"""Specular points and strengths of bodies, by geometrical optics: those of ellipsoids.

The strength of a body is the pressure that it sends to 1 m of a wave of 1 Pa, m; 20 lg of it is the target strength.
Time goes by ``exp(+j 2 pi f t)``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Floats

FAR = 0.1  # rad; where the first of Newton's steps is longer, they are watched
_STEPS = 40  # of these, at most
FOUND = 1e-3  # rad; the next step is about its square
LONGEST_STEP = 0.5  # rad
ELONGATED = 4.0  # ratio of semi-axes above which the first step tells nothing of how far the search is from its end
OUTWARD_STEPS = 8
PENUMBRA = 0.25  # cosine of the angle of incidence about which bodies stop to be mirrors
_OPPOSITE = 1e-9  # rad from opposite directions, below which their bisector is none
_SMALL = 1e-100  # in divisors: what is divided by it is squared, too


@dataclass(frozen=True, slots=True, eq=False)
class SpecularPoint:
    """Specular points of a body for n pairs of ends."""

    place: Floats  # (3, n) the specular point, m; where the body hides the ends from each other, a point between them
    normal: Floats  # (3, n) what finds a glint nearby by one step: the unit vector u of `ellipsoid_glint`
    hidden: NDArray[np.bool_]  # (n,) whether the body is between the ends
    change: float  # largest change of u by the last step, rad; infinity for what is guessed
    stays: bool = False  # whether from here on what is hidden stays so
    weight: Floats | float = 1.0  # (n,) of the way to the receiver, by which it was found

    def staying(self, hidden: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return the ends that stay hidden from each other at the next step, of those (n,) found hidden now."""
        return hidden | self.hidden if self.stays else hidden

    def guessed(self, normal: Floats) -> SpecularPoint:
        """Return the specular points of other ends, guessed by vectors (3, m) near to u."""
        return SpecularPoint(normal, _unit(normal), np.zeros(normal.shape[1], dtype=np.bool_), math.inf)


def ellipsoid_specular_point(
    semi_axes: Floats, source: Floats, receiver: Floats, near: SpecularPoint | None = None, weight: Floats | float = 1.0
) -> SpecularPoint:
    """Return the specular point of a rigid ellipsoid, by geometrical optics.

    Shapes: semi_axes (3,) m; source, receiver (3, n) m; weight (n,). near: that of nearly the same ends: one step is
    then made from it; from what is guessed, a search begins. weight: w, of the way to the receiver: ``(1 - M1) / (1 -
    M2)`` for a surface that moves at Mach numbers M1 off the source and M2 towards the receiver.

    The specular point makes the way ``L = d1 + w d2`` by the surface shortest (Fermat): at rest its normal is the
    bisector of the directions to both ends. On ``x = A u`` with a unit vector u, Newton's method finds it in the plane
    across u; what is seen from far away, ``u = A b / |A b|`` with the bisector b, is where it begins (G. T. Ruck et
    al., Radar Cross Section Handbook, 1970, section 2.2.3). The weight is our own derivation: of the times of both
    legs, that the scattered sound is received is stationary.
    """
    scale = semi_axes[:, None]
    between, hidden = _between(source / scale, receiver / scale)
    if near is None or math.isinf(near.change):
        begin = _unit(scale * _bisector(source, receiver)) if near is None else near.normal
        u, change = _search(scale, source, receiver, between, begin, weight)
    else:
        u, change = _newton(scale, source, receiver, near.normal, weight, LONGEST_STEP)
        hidden = near.staying(hidden)
    place = scale * u
    if hidden.any():
        change, place = np.where(hidden, 0.0, change), np.where(hidden, scale * between, place)
    return SpecularPoint(place, u, hidden, float(change.max(initial=0.0)))


def ellipsoid_strength(semi_axes: Floats, source: Floats, receiver: Floats, specular: SpecularPoint) -> Floats:
    """Return the strength (n,) of a rigid ellipsoid, m, by geometrical optics.

    With H the second derivatives of L along the surface, the principle of stationary phase gives ``cos(theta) /
    sqrt(det H)``: ``1 / (1 / d1 + 1 / d2)`` of a plane, and far from the body ``abc / (2 h^2)``, half the root of the
    product of both radii of curvature, with the support ``h = sqrt(b A^2 b)`` (G. T. Ruck et al., Radar Cross Section
    Handbook, 1970, section 2.2.3).

    Towards grazing incidence it is let go to 0 by ``1 - exp(-(cos(theta) / 0.25)^3)``, our own choice: 3 % off at an
    angle of 68°, where for k R = 150 the penumbra begins (V. A. Fock: ``(k R / 2)^(1/3) cos(theta)`` about 1).
    """
    _, _, steep, cosine, bend = _incidence(semi_axes[:, None], source, receiver, specular.normal)
    strength = lit_share(cosine) * cosine * float(np.prod(semi_axes)) * steep / np.sqrt(bend)
    return np.asarray(np.where(specular.hidden, 0.0, strength))


def ellipsoid_mirror(
    semi_axes: Floats, source: Floats, receiver: Floats, specular: SpecularPoint
) -> tuple[Floats, Floats, Floats]:
    """Return the specular reflection of a rigid ellipsoid: strength, m, cosine of incidence, curvature, 1/m, each (n,).

    The strength is that of `ellipsoid_strength` without its fall towards grazing incidence (G. T. Ruck et al., Radar
    Cross Section Handbook, 1970, section 2.2.3). The curvature is that in the plane of incidence at grazing incidence,
    and the mean of both where sound comes along the normal, in no plane: in between by the squared sine of the angle.
    """
    scale = semi_axes[:, None]
    normal, away, steep, cosine, bend = _incidence(scale, source, receiver, specular.normal)
    pressed, bent = _dot(normal, away) / steep, normal / (scale * steep)
    along = (away - pressed / steep * normal) / scale
    mean = 0.5 * (np.sum(scale**-2.0) - _dot(bent, bent))
    curvature = (_dot(along, along) + mean * pressed**2) / (steep * np.maximum(_dot(away, away), _SMALL))
    flattest = semi_axes.min() / semi_axes.max() ** 2
    return cosine * float(np.prod(semi_axes)) * steep / np.sqrt(bend), cosine, np.maximum(curvature, flattest)


def _incidence(
    scale: Floats, source: Floats, receiver: Floats, u: Floats
) -> tuple[Floats, Floats, Floats, Floats, Floats]:
    """Return normals and ways from the source (3, n), the normals' lengths, cosines of incidence and bends (n,)."""
    normal, away = u / scale, scale * u - source
    steep = np.sqrt(np.maximum(_dot(normal, normal), _SMALL))
    cosine = np.maximum(-_dot(normal, away) / (steep * np.sqrt(_dot(away, away))), 0.0)
    return normal, away, steep, cosine, np.maximum(_bend(scale, source, receiver, u, 1.0)[0], _SMALL)


def lit_share(cosine: Floats) -> Floats:
    """Return the share of specular reflection by bodies, by the cosine (n,) of the angle of incidence.

    ``1 - exp(-(cos(theta) / 0.25)^3)``, our own choice; see `ellipsoid_strength`.
    """
    return np.asarray(-np.expm1(-((cosine / PENUMBRA) ** 3)))


def _dot(a: Floats, b: Floats) -> Floats:
    """Return the products (n,) of vectors (3, n)."""
    return np.asarray(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


def _between(s: Floats, r: Floats) -> tuple[Floats, Any]:
    """Return the points (3, n) between two that are nearest to the origin, and which lie in the unit sphere."""
    line = r - s
    share = np.clip(-_dot(s, line) / np.maximum(_dot(line, line), _SMALL), 0.0, 1.0)
    nearest = s + share * line
    return nearest, _dot(nearest, nearest) < 1.0


def _search(
    scale: Floats, s: Floats, r: Floats, between: Floats, begin: Floats, weight: Floats | float
) -> tuple[Floats, Floats]:
    """Return unit vectors (3, n) of the shortest paths, and their change by the last step."""
    u, change = _newton(scale, s, r, begin, weight, LONGEST_STEP)
    is_long = _is_long(scale)
    rest = np.flatnonzero(change > (-1.0 if is_long else FAR))
    if len(rest):
        some = weight[rest] if isinstance(weight, np.ndarray) else weight
        other = _outwards(scale, between[:, rest]) if is_long else _unit(between[:, rest])
        u[:, rest], change[rest] = _careful(scale, s[:, rest], r[:, rest], other, u[:, rest], some)
    return u, change


def _careful(
    scale: Floats, s: Floats, r: Floats, other: Floats, u: Floats, weight: Floats | float
) -> tuple[Floats, Floats]:
    """Return unit vectors as of `_search`, by steps that shorten the path, from the shorter of two guesses (3, n)."""
    guesses = (u, other)
    lengths = [_length_by(scale, s, r, v, weight) for v in guesses]
    u, line = np.where(lengths[0] <= lengths[1], *guesses), np.minimum(*lengths)
    longest = np.full(len(line), LONGEST_STEP)
    for _ in range(_STEPS):
        new, change = _newton(scale, s, r, u, weight, longest)
        shorter = _length_by(scale, s, r, new, weight)
        better = shorter <= line * (1.0 + 1e-15)
        longest = np.where(better, np.minimum(2.0 * longest, LONGEST_STEP), 0.25 * np.minimum(longest, change))
        u, line = np.where(better, new, u), np.where(better, shorter, line)
        if not np.any(change > FOUND):
            break
    return u, change


def _is_long(scale: Floats) -> bool:
    return bool(scale.max() > ELONGATED * scale.min())


def _outwards(scale: Floats, between: Floats) -> Floats:
    """Return unit vectors u (3, n) of the points ``A u`` of the surface nearest to ``A between`` outside.

    ``u = A^2 b / (A^2 + m)`` with ``|u| = 1``. Newton's method on ``1 / |u|``, concave in m, approaches it from below
    (J. J. More and D. C. Sorensen, SIAM J. Sci. Stat. Comput. 4(3), 1983, section 3).
    """
    squared = scale**2
    m = np.maximum((squared * (np.abs(between) - 1.0)).max(axis=0), 0.0)
    for _ in range(OUTWARD_STEPS):
        u = squared * between / (squared + m)
        size = np.maximum(_dot(u, u), _SMALL)
        m = m + np.maximum((np.sqrt(size) - 1.0) * size / _dot(u, u / (squared + m)), 0.0)
    return _unit(squared * between / (squared + m))


def _bisector(s: Floats, r: Floats) -> Floats:
    """Return the sums (3, n) of the directions to both ends; where these are opposite, a direction across them."""
    one, other = _unit(s), _unit(r)
    both = one + other
    opposite = _dot(both, both) < _OPPOSITE**2
    if opposite.any():
        across = np.eye(3)[np.abs(one).argmin(axis=0)].T
        both = np.where(opposite, across - _dot(across, one) * one, both)
    return np.asarray(both)


def _unit(v: Floats) -> Floats:
    """Return vectors (3, n) of length 1."""
    return np.asarray(v / np.sqrt(np.maximum(_dot(v, v), _SMALL)))


def _length_by(scale: Floats, s: Floats, r: Floats, u: Floats, weight: Floats | float) -> Floats:
    """Return the lengths (n,) of the paths by ``A u``."""
    to, back = (scale * u - end for end in (s, r))
    return np.asarray(np.sqrt(_dot(to, to)) + weight * np.sqrt(_dot(back, back)))


def _bend(scale: Floats, s: Floats, r: Floats, u: Floats, weight: Floats | float) -> tuple[Floats, Any]:
    """Return the determinant (n,) of second derivatives of the way by u, and what a step needs."""
    sign = np.where(u[2] >= 0.0, 1.0, -1.0)  # two vectors across u (T. Duff et al., J. Comput. Graph. Tech. 6(1), 2017)
    a = -1.0 / (sign + u[2])
    b = u[0] * u[1] * a
    one, other = np.empty_like(u), np.empty_like(u)
    one[0], one[1], one[2] = 1.0 + sign * u[0] * u[0] * a, sign * b, -sign * u[0]
    other[0], other[1], other[2] = b, sign + u[1] * u[1] * a, -u[1]
    p, q, place = scale * one, scale * other, scale * u
    pp, pq, qq = _dot(p, p), _dot(p, q), _dot(q, q)
    gp = gq = h11 = h12 = h22 = inward = nearest = np.zeros(u.shape[1])
    for end, w in ((s, 1.0), (r, weight)):
        away = place - end
        near = 1.0 / np.sqrt(_dot(away, away))
        nearest = np.maximum(nearest, near)
        along, across, size = _dot(p, away) * near, _dot(q, away) * near, w * near
        gp, gq, inward = gp + w * along, gq + w * across, inward - size * _dot(place, away)
        h11 = h11 + (pp - along * along) * size
        h12 = h12 + (pq - along * across) * size
        h22 = h22 + (qq - across * across) * size
    h11, h22 = h11 + np.abs(inward), h22 + np.abs(inward)  # below 0 on the far side alone: it is still a slope
    return h11 * h22 - h12**2, (one, other, gp, gq, h11, h12, h22, nearest)


def _newton(
    scale: Floats, s: Floats, r: Floats, u: Floats, weight: Floats | float, longest: float | Floats
) -> tuple[Floats, Floats]:
    """Return unit vectors (3, n) one step nearer to the shortest way, and by how much they have changed (n,), rad."""
    determinant, (one, other, gp, gq, h11, h12, h22, nearest) = _bend(scale, s, r, u, weight)
    size = np.maximum(determinant, _SMALL)
    first, second = (h12 * gq - h22 * gp) / size, (h12 * gp - h11 * gq) / size
    step = first * one + second * other
    shift = scale * step
    # Of long bodies the place moves by much where u turns by little.
    length = np.maximum(np.hypot(first, second), nearest * np.sqrt(_dot(shift, shift)))
    held = np.minimum(1.0, longest / np.maximum(length, _SMALL))
    moved = u + held * step
    return _outwards(scale, moved) if _is_long(scale) else _unit(moved), length * held
