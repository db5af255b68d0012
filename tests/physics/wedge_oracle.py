"""Exact fields at wedges and half-planes, by means that share nothing with the theory that is tested.

Conventions: exp(+jωt); the free field of a source is ``exp(-jkR) / R``.
"""

import numpy as np
from scipy.special import hankel2e, jv

C = 343.0
Place = tuple[float, float, float]


def edge_field(
    source: Place, receiver: Place, wedge: float, k: float, ends: tuple[float, float] | None = None
) -> complex:
    """Return the field that a hard edge adds to the geometrical one: Biot, Tolstoy, Medwin, Svensson (1999).

    An infinite edge by the contour of steepest descent, `p = L - jv^2`; one with `ends` along the edge itself.

    Parameters
    ----------
    source, receiver
        r (m), angle (rad) and z (m).
    wedge
        Exterior angle, rad.
    k
        Wave number, 1/m.
    ends
        z of both ends, m; none of an infinite edge.
    """
    (rs, ts, zs), (rr, tr, zr) = source, receiver
    nu = np.pi / wedge
    angles = nu * (np.pi + np.array([tr - ts, ts - tr, -(ts + tr), ts + tr]))

    def beta(cosh_eta):
        eta = np.arccosh(cosh_eta + 0j)
        terms = np.sin(angles) / (np.cosh(nu * eta)[..., None] - np.cos(angles))
        return terms.sum(axis=-1), np.sinh(eta)

    if ends is not None:

        def along(z):
            m, rest = np.hypot(rs, z - zs), np.hypot(rr, z - zr)
            terms, _ = beta((m * rest + (z - zs) * (z - zr)) / (rs * rr))
            return -nu / (4.0 * np.pi) * terms * np.exp(-1j * k * (m + rest)) / (m * rest)

        return _gauss(along, np.array(ends), 16000)
    length = np.hypot(rs + rr, zs - zr)

    def steep(log_v):  # so that what is near the start, of ends near the edge or near a boundary, is looked at closely
        v = np.exp(log_v)
        eta = 2.0 * np.arcsinh(np.sqrt(-(2j * length + v**2) * v**2 / (4.0 * rs * rr)))
        terms = (np.sin(angles) / (np.cosh(nu * eta)[..., None] - np.cos(angles))).sum(axis=-1)
        return terms / (rs * rr * np.sinh(eta)) * np.exp(-k * v**2) * (-2j * v) * v

    last = 0.5 * np.log(40.0 / abs(k))
    total = _gauss(steep, np.array([last - 24.0, last]), 800)
    return -nu / (2.0 * np.pi) * total * np.exp(-1j * k * length)


def _gauss(function, ends: np.ndarray, count: int) -> complex:
    """Return an integral by Gauss and Legendre, in pieces of 20 points."""
    x, w = np.polynomial.legendre.leggauss(20)
    edges = np.linspace(*ends, count // 20 + 1)
    half = 0.5 * np.diff(edges)[:, None]
    points = edges[:-1, None] + half * (x + 1.0)
    return complex(np.sum(half * w * function(points.ravel()).reshape(points.shape)))


def half_plane(source: Place, receiver: Place, k: float) -> complex:
    """Return the whole field at a hard half-plane: MacDonald (1915), in Bowman, Senior and Uslenghi (1969), 8.3."""
    (rs, ts, zs), (rr, tr, zr) = source, receiver
    length = np.hypot(rs + rr, zs - zr)
    total = 0j
    for angle in (tr - ts, tr + ts):
        apart = np.sqrt(rs**2 + rr**2 + (zs - zr) ** 2 - 2.0 * rs * rr * np.cos(angle))
        m = np.sign(np.cos(0.5 * angle)) * np.sqrt(k * (length - apart))
        total += _macdonald(k * apart, m) * np.exp(-1j * k * apart) / apart
    return total


def _macdonald(kr: float, m: float) -> complex:
    """Return the share of a way's field: ∫ from -m of H1(kr + μ²) / √(μ² + 2 kr) over that of all μ."""

    turn = np.exp(-0.25j * np.pi)

    def tail(low):  # from low >= 0 on, turned towards where exp(-jμ²) falls
        def steep(t):
            mu = low + turn * t
            u = kr + mu**2
            return turn * hankel2e(1, u) / np.sqrt(u + kr) * np.exp(-1j * mu**2)

        return _gauss(steep, np.array([0.0, 6.5]), 1000)

    whole = 2.0 * tail(0.0)
    part = tail(abs(m))
    return (whole - part) / whole if m >= 0.0 else part / whole


def wedge_series(n: float, angle: float, source_angle: float, kr: float) -> complex:
    """Return the whole field of a plane wave from an angle at a hard wedge, at another one: the series of modes."""
    m = np.arange(int(n * (kr + 12.0 * kr ** (1 / 3) + 40.0)))
    weight = np.where(m == 0, 1.0, 2.0)
    modes = np.exp(0.5j * np.pi * m / n) * jv(m / n, kr) * np.cos(m * angle / n) * np.cos(m * source_angle / n)
    return complex(2.0 / n * np.sum(weight * modes))
