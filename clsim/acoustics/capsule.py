"""Scattering by a rigid capsule, a cylinder with round ends: its specular point, and its field about it."""

from __future__ import annotations

import math

import numpy as np
import scipy
from numpy.typing import NDArray

from clsim.acoustics import silhouette
from clsim.acoustics.outline import Outline, faded
from clsim.acoustics.scattering import SpecularPoint, lit_share
from clsim.arrays import Complexes, Floats
from clsim.numerics.band_filters import chebyshev_points, interpolation

_STEPS = 40  # of Newton's, at most, where ends are far from where they were
_LONGEST_STEP = 0.5  # rad
_FAR, _FOUND = 0.1, 1e-3  # rad, as for ellipsoids
_SMALL = 1e-100  # in divisors: what is divided by it is squared, too
_PARALLEL = 1e-20  # squared sine of the angle to the axis below which the middle between both ends is the nearest point
FLATTEST = 1e-9  # 1/m
CAP_FADE = 0.3  # radii beyond the side, along the axis, from which on the curvature is a sphere's; our own choice
NEAR_JUNCTION = 3e-3  # slope of the way where the side ends below which the bend there is that of the place itself
_TURN, _CARRIED = (
    np.exp(0.75j * math.pi),
    20.0,
)  # of E, see `_lobes`; nepers of the error of what few frequencies say of it
ASPECTS = 11  # numbers that a field takes, and as many more as `silhouette_field` with the field about the outline


def capsule_specular_point(
    radius: Floats | float, length: Floats | float, source: Floats, receiver: Floats, near: SpecularPoint | None,
    weight: Floats | float,
) -> SpecularPoint:  # fmt: skip
    """Return the specular point of a rigid capsule, by geometrical optics; source, receiver (3, n) m; weight (n,).

    near: that of nearly the same ends: one step is then made from it; from what is guessed, a search begins.

    The capsule is all spheres about points of its axis, so that the specular point is that of the sphere by which the
    way ``d1 + w d2`` is shortest: Newton's method over the point and the direction from it, with the point held to the
    axis; our own derivation from Fermat's principle (M. Born and E. Wolf, Principles of Optics, 1999, section 3.3.2).
    The way is convex in it. What finds a glint nearby is its place.
    """
    half = 0.5 * length
    between, at, hidden = _between(radius, half, source, receiver)
    if near is None or math.isinf(near.change):
        place, change = _search(radius, half, (source, receiver), near, (between, at), weight)
    else:
        place, change = _newton(radius, half, (source, receiver), _split(half, near.place), weight, _LONGEST_STEP)
        hidden = near.staying(hidden)
    if hidden.any():
        place, change = np.where(hidden, between, place), np.where(hidden, 0.0, change)
    return SpecularPoint(place, place, hidden, float(change.max(initial=0.0)), weight=weight)


def capsule_aspects(
    radius: Floats | float, length: Floats | float, source: Floats, receiver: Floats, specular: SpecularPoint,
    outlined: bool = False,
) -> tuple[Floats, Floats]:  # fmt: skip
    """Return the strength (n,) that `capsule_field` is relative to, m, and what that takes (n, 11), outlined (n, 22).

    Our own derivation, by physical optics (G. T. Ruck et al., Radar Cross Section Handbook, 1970, section 2.2.2).
    Around the capsule the principle of stationary phase holds; along it the way is a parabola on the side and a steeper
    one on either end, with one slope where they meet, so that the integral along a line of it (Kirchhoff's) is a sum of
    Fresnel integrals: on the side all of it, ``1 / sqrt(h)`` with the bend h, less what is missing beyond its ends, and
    more what the round ends add. At a distance of many lengths that is the finite cylinder, near by geometrical optics
    ``sqrt(R1 R2) / 2``, and on the round ends those of a sphere, without a jump between them. Either leg counts alike.
    Towards grazing incidence all goes to 0 as for ellipsoids or, outlined, the field about the outline takes over.
    """
    half, ends, weight = 0.5 * length, (source, receiver), specular.weight
    oblique = _positive if outlined else _obliquity
    at, normal = _split(half, specular.place)
    aside = _unit(np.stack([normal[0], normal[1], np.where(np.hypot(*normal[:2]) > 0.0, 0.0, 1.0)]))
    around = np.stack([-aside[1], aside[0], 0.0 * at])
    along = np.cross(normal, around, axis=0)
    detour, _, steep, bend, inward = _lengths_by(radius, ends, specular.place, (normal, around, along), weight)
    side, cosine = bend, 0.5 * np.maximum(inward, 0.0)
    aspects = np.empty((len(at), ASPECTS))
    on_end = np.zeros(len(at), dtype=bool)
    for i, sign in enumerate((-1.0, 1.0)):
        place = radius * aside + np.stack([0.0 * at, 0.0 * at, sign * half + 0.0 * at])
        axis = np.broadcast_to(np.array([[0.0], [0.0], [sign]]), place.shape)
        there, slope, _, flat, pressed = _lengths_by(radius, ends, place, (aside, around, axis), weight)
        late, sharp = np.maximum(there - detour, 0.0), np.maximum(flat + pressed / radius, FLATTEST)
        on_end |= slope < 0.0
        # Where the specular point is on this round end, the parabola that is as late at the junction.
        held = slope**2 / (slope**2 + NEAR_JUNCTION**2)
        other = slope**2 / np.maximum(2.0 * late, _SMALL)
        sharp = np.where((slope < 0.0) & (late > 0.0), sharp + held * (other - sharp), sharp)
        lit = np.sign(slope + _SMALL) * oblique(0.5 * pressed)
        columns = [late]
        for h in (sharp, np.maximum(flat, FLATTEST)):
            columns += [0.5 * lit / np.sqrt(h), np.abs(slope) / np.sqrt(2.0 * h)]
        aspects[:, 1 + 5 * i : 6 + 5 * i] = np.stack(columns, axis=1)
    bend = np.maximum(side + np.where(on_end, np.maximum(inward, 0.0) / radius, 0.0), FLATTEST)
    aspects[:, 0] = oblique(cosine) / np.sqrt(bend)
    if not outlined:
        aspects[specular.hidden] = 0.0
        return 1.0 / np.sqrt(steep), aspects
    curvature = _incidence_curvature(radius, half, source, (specular.place, normal, around))
    strength, outline = silhouette.silhouette_aspects(ends, specular, (1.0 / np.sqrt(steep), cosine, curvature))
    return strength, np.concatenate([aspects, outline], axis=1)


def _incidence_curvature(
    radius: Floats | float, half: Floats | float, source: Floats, at: tuple[Floats, Floats, Floats]
) -> Floats:
    """Curvature (n,) at places (3, n) with normals and directions around (3, n), 1/m, see `ellipsoid_mirror`."""
    place, normal, around = at
    away = place - source
    share = (_dot(around, away) ** 2 + 0.5 * _dot(normal, away) ** 2) / np.maximum(_dot(away, away), _SMALL)
    share = 1.0 - (1.0 - share) * faded((np.abs(place[2]) - half) / radius, (0.0, CAP_FADE))
    return np.asarray(np.maximum(share / radius, radius / (radius + half) ** 2))


def capsule_field(
    wave: Floats, aspects: Floats, outline: Outline | None = None, past: Complexes | float = 1.0, centre: float = 0.0
) -> Complexes:
    """Return the field of a rigid capsule over its strength.

    centre: that of the signal's band, see `silhouette_field`. Shapes: wave (F,) 1/m; aspects (..., 11), outlined (...,
    22); result (..., F).

    Lobes by physical optics and, outlined, in the forward direction the field about the outline. Our own derivation.
    """
    lobes = _lobes(wave, aspects[..., :ASPECTS])
    if outline is None:
        return lobes
    return silhouette.silhouette_field(outline, wave, centre, aspects[..., ASPECTS:], lobes, past)


def _lobes(wave: Floats, aspects: Floats) -> Complexes:
    """Field of what a capsule reflects; wave (F,) 1/m; aspects (..., 11); result (..., F).

    ``m + sum exp(-j k t) (A E(a sqrt k) - B E(b sqrt k))`` over both ends of the side, with the Fresnel integral ``E(x)
    = exp(j x^2) erfc(exp(j pi / 4) x)`` (M. Abramowitz and I. A. Stegun, Handbook of Mathematical Functions, 1964, eq.
    7.1.3).
    """
    roots = np.sqrt(wave)
    at, weights = _fewer(roots)
    total: Complexes = np.zeros((*aspects.shape[:-1], len(wave)), dtype=np.complex128)
    for first in (1, 6):
        late, *rest = (aspects[..., first + i, None] for i in range(5))
        part = rest[0] * _fresnel(rest[1] * at) - rest[2] * _fresnel(rest[3] * at)
        phase, turned = late * wave, np.empty(total.shape, dtype=np.complex128)
        turned.real, turned.imag = np.cos(phase), -np.sin(phase)
        total += (part if weights is None else part @ weights) * turned
    total += aspects[..., :1]
    return total


def _fresnel(x: Floats) -> Complexes:
    """Return E(x), see `_lobes`."""
    return np.asarray(scipy.special.wofz(_TURN * x))


def _fewer(roots: Floats) -> tuple[Floats, Complexes | None]:
    """Return roots of wave numbers at which E is known, and weights (n, F) that carry it to roots (F,); None for all.

    E is entire and falls off as 1 / x. A polynomial through n Chebyshev points of an interval from a to b is right to
    about r^-n, with r = z + sqrt(z^2 - 1) and z = (b + a) / (b - a), as of ``1 / x`` (L. N. Trefethen, Approximation
    Theory and Approximation Practice, 2013, theorem 8.2).
    """
    low, high = float(roots.min()), float(roots.max())
    z = (high + low) / max(high - low, 1e-9 * high)
    count = math.ceil(_CARRIED / math.log(z + math.sqrt(z * z - 1.0))) if z > 1.0 else len(roots)
    if 2 * count > len(roots):
        return roots, None
    return chebyshev_points(low, high, count), interpolation(low, high, count, roots).astype(np.complex128)


def _obliquity(cosine: Floats) -> Floats:
    """Return the obliquity factor of the surface pressure, by the cosine of the angle of incidence."""
    bounded = np.maximum(cosine, 0.0)
    return bounded * lit_share(bounded)


def _positive(cosine: Floats) -> Floats:
    return np.asarray(np.maximum(cosine, 0.0))


def _dot(a: Floats, b: Floats) -> Floats:
    return np.asarray(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


def _unit(v: Floats) -> Floats:
    return np.asarray(v / np.sqrt(np.maximum(_dot(v, v), _SMALL)))


def _split(half: Floats | float, place: Floats) -> tuple[Floats, Floats]:
    """Return the axial coordinate (n,), m, of the sphere of a place (3, n), and the direction (3, n) from there."""
    at = np.clip(place[2], -half, half)
    return at, _unit(np.stack([place[0], place[1], place[2] - at]))


def _between(
    radius: Floats | float, half: Floats | float, source: Floats, receiver: Floats
) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Return points (3, n) between two that are nearest to the axis, where on it (n,), and whether they are inside."""
    away = receiver - source
    size = np.maximum(_dot(away, away), _SMALL)
    straight, level = _dot(source, away), _PARALLEL * size
    aside, inwards = level, 0.5 * level
    for i in (0, 1):
        aside, inwards = aside + away[i] * away[i], inwards - source[i] * away[i]
    share = np.clip(inwards / aside, 0.0, 1.0)
    at = np.clip(source[2] + share * away[2], -half, half)
    share = np.clip((at * away[2] - straight) / size, 0.0, 1.0)
    nearest = source + share * away
    off = np.stack([nearest[0], nearest[1], nearest[2] - at])
    return nearest, at, _dot(off, off) < radius**2


def _search(
    radius: Floats | float, half: Floats | float, ends: tuple[Floats, Floats], near: SpecularPoint | None,
    between: tuple[Floats, Floats], weight: Floats | float,
) -> tuple[Floats, Floats]:  # fmt: skip
    """Return specular points (3, n) by steps that shorten the path, and their change (n,) by the last step, rad."""
    source, receiver = ends
    if near is None:  # the mirror point of the axis, and the bisector from there
        off = [np.maximum(np.hypot(end[0], end[1]) - radius, 1e-3 * radius) for end in ends]
        share = off[0] / (off[0] + off[1])
        at = np.clip(source[2] + share * (receiver[2] - source[2]), -half, half)
        axis = np.stack([0.0 * at, 0.0 * at, at])
        begin = at, _unit(_unit(source - axis) + _unit(receiver - axis))
    else:
        begin = _split(half, near.place)
    nearest, on = between
    other = on, _unit(np.stack([nearest[0], nearest[1], nearest[2] - on]))
    detours = [_length_by(_joined(radius, guess), ends, weight) for guess in (begin, other)]
    at, normal = (np.where(detours[0] <= detours[1], one, two) for one, two in zip(begin, other, strict=True))
    place, detour = _joined(radius, (at, normal)), np.minimum(*detours)
    longest = np.full(len(detour), _LONGEST_STEP)
    for step in range(_STEPS):
        new, change = _newton(radius, half, ends, _split(half, place), weight, longest)
        shorter = _length_by(new, ends, weight)
        better = shorter <= detour * (1.0 + 1e-15)
        longest = np.where(better, np.minimum(2.0 * longest, _LONGEST_STEP), 0.25 * np.minimum(longest, change))
        place, detour = np.where(better, new, place), np.where(better, shorter, detour)
        if not np.any(change > (_FAR if step == 0 else _FOUND)):
            break
    return place, change


def _joined(radius: Floats | float, of: tuple[Floats, Floats]) -> Floats:
    """Return the place (3, n) of a point of the axis and a direction."""
    at, normal = of
    return np.asarray(radius * normal + np.stack([0.0 * at, 0.0 * at, at]))


def _length_by(place: Floats, ends: tuple[Floats, Floats], weight: Floats | float) -> Floats:
    """Return the lengths (n,) of the paths by places (3, n)."""
    to, back = (place - end for end in ends)
    return np.asarray(np.sqrt(_dot(to, to)) + weight * np.sqrt(_dot(back, back)))


def _lengths_by(
    radius: Floats | float, ends: tuple[Floats, Floats], place: Floats, frame: tuple[Floats, Floats, Floats],
    weight: Floats | float,
) -> tuple[Floats, Floats, Floats, Floats, Floats]:  # fmt: skip
    """Return the way's length, slope along, bend around, bend along and pressure by places (3, n), each (n,).

    The frame is the normal and the directions around and along. Where the way is not the shortest around, its length,
    slope and bend along are those where it is, to the second order.
    """
    normal, around, along = frame
    detour, inward = np.zeros(place.shape[1]), np.zeros(place.shape[1])
    g = [np.zeros(place.shape[1]) for _ in range(2)]
    h = [np.zeros(place.shape[1]) for _ in range(3)]
    for end, w in zip(ends, (1.0, weight), strict=True):
        away = place - end
        distance = np.sqrt(_dot(away, away))
        a, b, size = _dot(around, away) / distance, _dot(along, away) / distance, w / distance
        detour, inward = detour + w * distance, inward - size * _dot(normal, away)
        g = [g[0] + w * a, g[1] + w * b]
        h = [h[0] + (1.0 - a * a) * size, h[1] - a * b * size, h[2] + (1.0 - b * b) * size]
    steep = np.maximum(h[0] + np.maximum(inward, 0.0) / radius, FLATTEST)
    off = g[0] / steep
    return detour - 0.5 * g[0] * off, g[1] - h[1] * off, steep, np.maximum(h[2] - h[1] ** 2 / steep, 0.0), inward


def _newton(
    radius: Floats | float, half: Floats | float, ends: tuple[Floats, Floats], of: tuple[Floats, Floats],
    weight: Floats | float, longest: Floats | float,
) -> tuple[Floats, Floats]:  # fmt: skip
    """Return places (3, n) one step nearer to the shortest way, and by how much they have changed (n,), rad."""
    at, u = of
    sign = np.where(u[2] >= 0.0, 1.0, -1.0)  # two vectors across u, as for ellipsoids
    a = -1.0 / (sign + u[2])
    b = u[0] * u[1] * a
    one = np.stack([1.0 + sign * u[0] * u[0] * a, sign * b, -sign * u[0]])
    other = np.stack([b, sign + u[1] * u[1] * a, -u[1]])
    place = _joined(radius, of)
    gz = gp = gq = hzz = hzp = hzq = hpp = hpq = hqq = inward = np.zeros(u.shape[1])
    for end, w in zip(ends, (1.0, weight), strict=True):
        away = place - end
        close = 1.0 / np.sqrt(_dot(away, away))
        z, p, q, size = away[2] * close, _dot(one, away) * close, _dot(other, away) * close, w * close
        gz, gp, gq, inward = gz + w * z, gp + w * p, gq + w * q, inward - w * close * _dot(u, away)
        hzz, hzp, hzq = hzz + (1.0 - z * z) * size, hzp + (one[2] - z * p) * size, hzq + (other[2] - z * q) * size
        hpp, hpq, hqq = hpp + (1.0 - p * p) * size, hpq - p * q * size, hqq + (1.0 - q * q) * size
    hpp, hqq = hpp + np.abs(inward) / radius, hqq + np.abs(inward) / radius
    size = np.maximum(hpp * hqq - hpq**2, _SMALL)
    by_p, by_q = (hqq * hzp - hpq * hzq) / size, (hpp * hzq - hpq * hzp) / size
    bend = np.maximum(hzz - hzp * by_p - hzq * by_q, FLATTEST)
    moved = np.clip(at - (gz - gp * by_p - gq * by_q) / bend, -half, half)
    gp, gq = gp + hzp * (moved - at), gq + hzq * (moved - at)
    first, second = (hpq * gq - hqq * gp) / size / radius, (hpq * gp - hpp * gq) / size / radius
    turn = np.hypot(first, second)
    held = np.minimum(1.0, longest / np.maximum(turn, _SMALL))
    new = moved, _unit(u + held * (first * one + second * other))
    return _joined(radius, new), turn * held + np.abs(moved - at) / radius
