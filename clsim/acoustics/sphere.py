"""The field that a rigid sphere scatters between two ends at any distance, and on itself: the series over its modes.

Time goes by ``exp(+j 2 pi f t)``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy

from clsim.acoustics.scattering import SpecularPoint
from clsim.arrays import Complexes, Floats

LEFT_OUT = 1e-7  # of the largest mode: where one is smaller, behind mode number ka, the series ends
ASPECTS = 4  # numbers that a field takes
# Modes beyond those that matter far away: an end at 1.03 a from the centre needs them for 120 dB.
_NEARBY = 240
_AT_A_TIME = 4096  # numbers that are worked on together: they stay in the cache
_LEAST = 1e-300
_STATIC = 1e-3  # ka, below which the sphere does nothing but turn the phase
_SURFACE_LEFT_OUT = 1e-9  # of the largest mode, behind mode number ka, from which on modes are left out


@dataclass(frozen=True, slots=True, eq=False)
class SphereModes:
    """Coefficients of modes 0 to N - 1 of a rigid sphere at F values of ka.

    With ``g_n = h_n(kd) / |h_n(ka)| * (d / a) exp(jkd)`` of an end at the distance d, from ``g_-1 = 1`` and ``g_0 =
    j``, ``g_n+1 = step_n (a / d) g_n - back_n g_n-1``. All numbers are bounded, whatever n and ka are.
    """

    ka: Floats  # (F,) wave numbers times radius
    step: Floats  # (N, F) factors of the recurrence
    back: Floats  # likewise
    weight: Complexes  # (N, F) ``(2 n + 1) j_n'(ka) |h_n(ka)|^2 / h_n'(ka)``


@lru_cache(maxsize=32)
def sphere_modes(ka: tuple[float, ...]) -> SphereModes:
    """Return the modes of a rigid sphere.

    Ratios ``h_n+1 / h_n`` come from the upward recurrence, ``j_n+1 / j_n`` from the downward one, each stable that way
    (M. Abramowitz and I. A. Stegun, Handbook of Mathematical Functions, 1964, section 10.1.19 and 10.5), and the
    product ``j_n h_n`` from their Wronskian, so that nothing overflows.
    """
    x = np.array(ka)
    most = float(x.max())
    count = math.ceil(most + 4.05 * most ** (1.0 / 3.0)) + 10 + _NEARBY
    n = np.arange(count)[:, None]
    rise, fall = np.empty((count, len(x)), dtype=np.complex128), np.empty((count, len(x)))
    ratio = np.full(len(x), 1j)  # h_0 / h_-1
    for i in range(count):
        ratio = (2 * i + 1) / x - 1.0 / ratio
        rise[i] = ratio
    last = 2 * count + math.ceil(most)
    below = x / (2.0 * last + 3.0)
    for i in range(last - 1, -1, -1):
        below = 1.0 / ((2 * i + 3) / x - below)
        if i < count:
            fall[i] = below
    size = np.abs(rise)
    one = np.ones((1, len(x)))
    phase = 1j * np.exp(-1j * x) * np.cumprod(np.concatenate([one, (rise / size)[:-1]]), axis=0)
    regular, outgoing = n / x - fall, n / x - rise  # logarithmic derivatives of j_n and h_n
    weight = (2 * n + 1) * (-1j / x**2) * regular / (outgoing - regular) * np.conj(phase) ** 2 / outgoing
    return SphereModes(x, (2 * n + 1) / (x * size), 1.0 / (size * np.concatenate([one, size[:-1]])), weight)


def sphere_aspects(radius: float, source: Floats, receiver: Floats, specular: SpecularPoint) -> tuple[Floats, Floats]:
    """Return the strength (n,) that `sphere_field` is relative to, m, and what that takes (n, 4).

    Shapes: source, receiver (3, n) m.

    The strength is ``a l1 l2 / (2 d1 d2)``: distances d of the ends from the centre, and lengths l of both legs by the
    place, over which pressure falls. The aspects are the cosine of the angle between both ends at the centre, a / d1, a
    / d2, and by how much the path by the centre is longer than that by the place, over a. Our own derivation.
    """
    far = [np.sqrt(np.sum(end * end, axis=0)) for end in (source, receiver)]
    legs = [np.sqrt(np.sum((specular.place - end) ** 2, axis=0)) for end in (source, receiver)]
    cosine = np.clip(np.sum(source * receiver, axis=0) / (far[0] * far[1]), -1.0, 1.0)
    longer = (far[0] - legs[0]) + (far[1] - legs[1])
    aspects = np.stack([cosine, radius / far[0], radius / far[1], longer / radius], axis=1)
    return 0.5 * radius * legs[0] * legs[1] / (far[0] * far[1]), aspects


def sphere_field(ka: Floats, aspects: Floats) -> Complexes:
    """Return the field that a rigid sphere scatters from one end to the other.

    Shapes: ka (F,); aspects (..., 4); result (... F). result: F: of a source that gives ``exp(-j k d) / d``, the
    pressure that is scattered is ``a / (2 d1 d2) F exp(-j k l)``, with the length l of the path by the place.

    ``p = j k sum (2 n + 1) j_n'(ka) / h_n'(ka) h_n(k d1) h_n(k d2) P_n(cos gamma)`` with the spherical Hankel functions
    of the second kind (P. M. Morse and K. U. Ingard, Theoretical Acoustics, 1968, section 8.2). It is exact wherever
    the ends are: on the lit side it is close to a mirror's, behind the sphere to the direct sound's with the other
    sign.
    """
    flat = aspects.reshape(-1, ASPECTS)
    found = np.empty((len(flat), len(ka)), dtype=np.complex128)
    wide = min(len(ka), 256)
    rows = max(_AT_A_TIME // wide, 1)
    for low in range(0, len(ka), wide):
        modes = sphere_modes(tuple(ka[low : low + wide].tolist()))
        for first in range(0, len(flat), rows):
            found[first : first + rows, low : low + wide] = _summed(modes, flat[first : first + rows])
    return found.reshape(*aspects.shape[:-1], len(ka))


def _summed(modes: SphereModes, aspects: Floats) -> Complexes:
    """Return the fields (n, F) of aspects (n, 4)."""
    cosine, ends = aspects[:, :1], [aspects[:, i : i + 1] for i in (1, 2)]
    # Where an end stays as far away, its factors are the same for all.
    ends = [end[:1] if np.all(end == end[0]) else end for end in ends]
    now = [np.full((len(end), len(modes.ka)), 1j) for end in ends]
    before = [np.ones_like(one) for one in now]
    legendre, last = np.ones_like(cosine), np.zeros_like(cosine)
    total = np.zeros((len(cosine), len(modes.ka)), dtype=np.complex128)
    loudest, most = _LEAST, float(modes.ka.max())
    for n, (step, back, weight) in enumerate(zip(modes.step, modes.back, modes.weight, strict=True)):
        mode = weight * now[0] * now[1]
        total += legendre * mode
        if n % 8 == 0:
            size = float(np.abs(mode).max())
            if n > most and size < LEFT_OUT * loudest:
                break
            loudest = max(loudest, size)
        now, before = [(step * end) * g - back * b for end, g, b in zip(ends, now, before, strict=True)], now
        legendre, last = ((2 * n + 1) * cosine * legendre - n * last) / (n + 1), legendre
    return np.asarray(2j * modes.ka * total * np.exp(-1j * modes.ka * aspects[:, 3:]))


def sphere_bound(radius: float, wave: Floats, nearest: Floats) -> Floats:
    """Return a bound (n, F) of what a rigid sphere scatters, times the length of its path.

    Shapes: wave (F,) 1/m; nearest (n,) m. nearest: bounds from below of half the harmonic mean of the distances of both
    ends from the surface, m.

    That of a wave from far away, in the direction where it is largest, with what h_1 is more nearby; and at most 3. The
    largest of all is behind a sphere on the axis, 2.4 times the direct sound (found between ka = 0.1 and 400; our own
    derivation).
    """
    cosine = np.cos(np.linspace(0.0, math.pi, 257))
    aspects = np.stack([cosine, *np.zeros((3, 257))], axis=1)
    far = 0.5 * radius * np.abs(sphere_field(radius * wave, aspects)).max(axis=0)
    near = nearest[:, None]
    return np.asarray(np.minimum(far / near * (1.0 + 1.0 / (wave * near)) ** 2, 3.0))


def sphere_surface_field(ka: Floats, cosine: Floats) -> Complexes:
    """Return the pressure on a rigid sphere in a plane wave, relative to that of the wave at its centre without it.

    Shapes: ka (F,); cosine (n,) of the angle between the place and the wave's origin, seen from the centre; result (n,
    F).

    ``p = 1 / (ka)² sum (2 n + 1) j^(n - 1) P_n(cosine) / h_n'(ka)`` with spherical Hankel functions of the second kind,
    for ``exp(+j 2 pi f t)`` (J. W. Strutt, Phil. Trans. R. Soc. 203, 1904; R. O. Duda and W. L. Martens, J. Acoust.
    Soc. Am. 104 (5), pp. 3048-3058, 1998, section I, for sources far away).
    """
    modes = _surface_modes(tuple(np.maximum(ka, _STATIC).tolist()))
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
def _surface_modes(ka: tuple[float, ...]) -> Complexes:
    """Return the factors (N, F) of Legendre's polynomials."""
    x = np.array(ka)
    most = float(x.max())
    count = math.ceil(most + 4.05 * most ** (1.0 / 3.0)) + 12
    n = np.arange(count)[:, None]
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        slope = scipy.special.spherical_jn(n, x, derivative=True) - 1j * scipy.special.spherical_yn(
            n, x, derivative=True
        )
        made = (2 * n + 1) * 1j ** (n - 1.0) / (slope * x**2)
    made = np.where(np.isfinite(made), made, 0.0)  # of high modes at low frequencies, which are nothing
    loud = np.abs(made).max(axis=1)
    last = np.flatnonzero(loud > _SURFACE_LEFT_OUT * loud.max())[-1]
    return made[: last + 1]
