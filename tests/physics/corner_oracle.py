"""Fields of plates and boxes as sums over their edges, each by its own line integral, and the geometrical paths.

The integral is that of Svensson, Fred and Vanderkooy, J. Acoust. Soc. Am. 106(5), 1999, eq. 27 and 30, between the two
ends of an edge; faces are hard, and ends do not lie on edges. Conventions: exp(+jωt); free field exp(-jkR) / R.
"""

from dataclasses import dataclass

import numpy as np

_PANELS, _POINTS = 1000, 8  # of Gauss and Legendre, over u of z = apex + w sinh(u)
_BOTH_PANELS = 160  # of each of two edges
_SHARPEST = 2e-3  # m, the width w: of an edge whose boundary is nearer than that the pole is integrated apart


@dataclass(frozen=True)
class Edge:
    """An edge from a place to another one; `across` points along its 0-face, `out` off it into the air."""

    start: np.ndarray
    stop: np.ndarray
    across: np.ndarray
    out: np.ndarray
    wedge: float  # exterior angle, rad

    def cylindrical(self, place: np.ndarray) -> tuple[float, float, float]:
        away = place - self.start
        along = (self.stop - self.start) / np.linalg.norm(self.stop - self.start)
        x, y = away @ self.across, away @ self.out
        low = 0.5 * (self.wedge - 2.0 * np.pi)
        angle = np.arctan2(y, x)
        return float(np.hypot(x, y)), float(angle + 2.0 * np.pi * (angle < low)), float(away @ along)

    def seen_from(self, place: np.ndarray) -> bool:
        return 0.0 <= self.cylindrical(place)[1] <= self.wedge

    def field(self, source: np.ndarray, receiver: np.ndarray, k: np.ndarray) -> np.ndarray:
        """Return the field of the edge at wave numbers (F,)."""
        (rs, ts, zs), (rr, tr, zr) = self.cylindrical(source), self.cylindrical(receiver)
        nu, length = np.pi / self.wedge, np.hypot(rs + rr, zs - zr)
        apex, stop = (zs * rr + zr * rs) / (rs + rr), np.linalg.norm(self.stop - self.start)
        angles = nu * (np.pi + np.array([tr - ts, ts - tr, -(ts + tr), ts + tr]))
        nearest = np.min(np.abs(np.sin(0.5 * angles))) / nu
        width = 0.3 * min(rs * rr / length * max(nearest, 1e-9), _SHARPEST)
        x, w = np.polynomial.legendre.leggauss(_POINTS)
        ends = np.arcsinh(np.array([-apex, stop - apex]) / width)
        borders = np.unique(np.concatenate([np.linspace(*ends, _PANELS + 1), np.clip(0.0, *ends)[None]]))
        half = 0.5 * np.diff(borders)[:, None]
        u = borders[:-1, None] + half * (x + 1.0)
        off, weight = width * np.sinh(u), half * w * width * np.cosh(u)
        before, after = np.hypot(rs, apex + off - zs), np.hypot(rr, apex + off - zr)
        # cosh η - 1, and the detour, without the difference of numbers that are nearly the same
        up, down = (apex + off - zs) / rs, (apex + off - zr) / rr
        eta = np.abs(np.arcsinh(up) + np.arcsinh(down))
        beta = sum(np.sin(a) / (2.0 * np.sinh(0.5 * nu * eta) ** 2 + 2.0 * np.sin(0.5 * a) ** 2) for a in angles)
        common = (-nu / (4.0 * np.pi) * weight * beta / (before * after)).ravel()
        return np.exp(-1j * np.multiply.outer(k, (before + after).ravel())) @ common


@dataclass(frozen=True)
class Face:
    """A parallelogram: a corner, two sides, and the normal out of it; a sheet has air on both sides."""

    corner: np.ndarray
    sides: np.ndarray  # (2, 3)
    normal: np.ndarray
    sheet: bool

    def crosses(self, one: np.ndarray, other: np.ndarray) -> bool:
        heights = (one - self.corner) @ self.normal, (other - self.corner) @ self.normal
        if heights[0] * heights[1] >= 0.0:
            return False
        met = one + (other - one) * heights[0] / (heights[0] - heights[1])
        share = np.linalg.solve(self.sides @ self.sides.T, self.sides @ (met - self.corner))
        return bool(np.all((share > 0.0) & (share < 1.0)))

    def mirrored(self, place: np.ndarray) -> np.ndarray:
        return place - 2.0 * ((place - self.corner) @ self.normal) * self.normal


def total(edges: list[Edge], faces: list[Face], source: np.ndarray, receiver: np.ndarray, k: np.ndarray) -> np.ndarray:
    """Return the whole pressure (F,) of first order beside a convex thing: direct, mirrored, and of its edges."""
    found = np.zeros(len(k), dtype=np.complex128)

    def add(image: np.ndarray) -> None:
        apart = np.linalg.norm(image - receiver)
        found[:] += np.exp(-1j * k * apart) / apart

    if not any(face.crosses(source, receiver) for face in faces):
        add(source)
    for face in faces:
        heights = np.array([source - face.corner, receiver - face.corner]) @ face.normal
        above = np.all(heights > 0.0) or (face.sheet and np.all(heights < 0.0))
        if above and face.crosses(face.mirrored(source), receiver):
            add(face.mirrored(source))
    for edge in edges:
        if edge.seen_from(source) and edge.seen_from(receiver):
            found += edge.field(source, receiver, k)
    return found


def plate(width: float, height: float, corner: float = 90.0) -> tuple[list[Edge], list[Face]]:
    """Return a plate at z = 0 with a corner at (0, 0), degrees, between sides towards -x and, at 90 degrees, -y."""
    sides = np.array([[-width, 0.0, 0.0], turned(-height, corner)])
    corners = [np.zeros(3), sides[0], sides.sum(axis=0), sides[1]]
    middle, up, edges = sides.sum(axis=0) / 2.0, np.array([0.0, 0.0, 1.0]), []
    for start, stop in zip(corners, corners[1:] + corners[:1], strict=True):
        along = (stop - start) / np.linalg.norm(stop - start)
        across = middle - start - ((middle - start) @ along) * along
        across /= np.linalg.norm(across)
        edges.append(Edge(start, stop, across, np.cross(along, across), 2.0 * np.pi))
    return edges, [Face(corners[0], sides, up, True)]


def turned(length: float, angle: float) -> np.ndarray:
    """Return a vector of a length in z = 0, turned by an angle in degrees from x."""
    return length * np.array([np.cos(np.radians(angle)), np.sin(np.radians(angle)), 0.0])


def box(size: tuple[float, float, float]) -> tuple[list[Edge], list[Face]]:
    """Return a box from -size to the corner at (0, 0, 0)."""
    edges, faces = [], []
    for axis in range(3):
        one, other = (axis + 1) % 3, (axis + 2) % 3
        unit, lengths = np.eye(3), np.array(size, dtype=float)
        for up in (0.0, -1.0):
            corner = up * lengths[axis] * unit[axis]
            sides = np.array([-lengths[one] * unit[one], -lengths[other] * unit[other]])
            faces.append(Face(corner, sides, unit[axis] * (1.0 if up == 0.0 else -1.0), False))
        for a in (0.0, -1.0):
            for b in (0.0, -1.0):
                start = a * lengths[one] * unit[one] + b * lengths[other] * unit[other]
                # 0-face: that with the normal along `one`, which goes on along `other`
                across = unit[other] * (-1.0 if b == 0.0 else 1.0)
                out = unit[one] * (1.0 if a == 0.0 else -1.0)
                edges.append(Edge(start, start - lengths[axis] * unit[axis], across, out, 1.5 * np.pi))
    return edges, faces


def field_of_both(
    edges: tuple[Edge, Edge], ends: tuple[np.ndarray, np.ndarray], k: float, near: tuple[float, float], within: float,
    stops: tuple[float, float] = (np.inf, np.inf),
) -> complex:  # fmt: skip
    """Return the field over two edges that see each other, by one integral along both of them.

    Places farther than `within` from those given on either edge fade out, as if edges went on for ever; `stops` are the
    places at which they do not. Each end must be in the shadow of the edge that is not next to it: elsewhere the
    integrand has a pole.
    """
    x, w = np.polynomial.legendre.leggauss(_POINTS)
    shares, weights = [], []
    for place, stop in zip(near, stops, strict=True):
        last = min(1.0, (stop - place) / within)
        half = 0.5 * (last + 1.0) / _BOTH_PANELS
        share = (np.linspace(-1.0, last, _BOTH_PANELS + 1)[:-1, None] + half * (x + 1.0)).ravel()
        shares.append(share)
        weights.append(within * half * np.tile(w, _BOTH_PANELS) * _faded(np.abs(share)))
    seen = [edge.cylindrical(end) for edge, end in zip(edges, ends, strict=True)]
    units = [(edge.stop - edge.start) / np.linalg.norm(edge.stop - edge.start) for edge in edges]
    along = [place + within * share for place, share in zip(near, shares, strict=True)]
    places = [edge.start + z[:, None] * unit for edge, z, unit in zip(edges, along, units, strict=True)]
    total = 0.0j
    for z, place, scale in zip(along[0], places[0], weights[0], strict=True):
        apart = np.linalg.norm(places[1] - place, axis=1)
        product, way = scale * weights[1] / apart, apart.copy()
        for i, (at, away) in enumerate(((np.full(len(apart), z), places[1]), (along[1], place))):
            (r, angle, height), edge = seen[i], edges[i]
            x_y = np.moveaxis(away - edge.start, -1, 0)
            across, out, up = (np.tensordot(axis, x_y, 1) for axis in (edge.across, edge.out, units[i]))
            turned = np.arctan2(out, across)
            turned = turned + 2.0 * np.pi * (turned < 0.5 * (edge.wedge - 2.0 * np.pi))
            eta = np.arcsinh((at - height) / r) + np.arcsinh((at - up) / np.hypot(across, out))
            product = product * _directivity(edge.wedge, angle, turned, eta)
            leg = np.hypot(r, at - height)
            product, way = product / leg, way + leg
        total += np.sum(product * np.exp(-1j * k * way))
    return complex(total)


def _faded(share: np.ndarray) -> np.ndarray:
    """Return weights (n,) of places by their distance over that at which edges have faded out: 1 up to one half."""
    off = np.clip(2.0 * share - 1.0, 0.002, 0.998)
    return np.asarray(1.0 / (1.0 + np.exp(1.0 / (1.0 - off) - 1.0 / off)))


def field_of_meeting(
    edges: tuple[Edge, Edge], ends: tuple[np.ndarray, np.ndarray], faces: tuple[float, float], k: float, within: float
) -> complex:
    """Return the field over two edges of one face that begin at one corner, by one integral along both of them.

    `faces` are the angles at which either edge sees the face. With places at r (1 - t) and r t on the edges the distance
    between them is in proportion to r, as is the surface element. Along a face edges send twice what half of it does.
    """
    x, w = np.polynomial.legendre.leggauss(_POINTS)
    share = ((np.arange(2 * _BOTH_PANELS)[:, None] + 0.5 * (x + 1.0)) / (2 * _BOTH_PANELS)).ravel()
    weight = 0.5 * np.tile(w, 2 * _BOTH_PANELS) / (2 * _BOTH_PANELS)
    r, turn, on_r = 2.0 * within * share[:, None], share[::2], 2.0 * within * weight
    along, total = (r * (1.0 - turn), r * turn), np.outer(on_r * r[:, 0], 2.0 * weight[::2])
    units = [(edge.stop - edge.start) / np.linalg.norm(edge.stop - edge.start) for edge in edges]
    places = [edges[i].start + along[i][..., None] * units[i] for i in (0, 1)]
    apart = np.linalg.norm(places[1] - places[0], axis=-1)
    total, way = total / apart, apart
    for i, edge in enumerate(edges):
        (radius, angle, height), away = edge.cylindrical(ends[i]), places[1 - i] - edge.start
        up = away @ units[i]
        off = np.sqrt(np.maximum(np.sum(away**2, axis=-1) - up**2, 1e-30))
        eta = np.arcsinh((along[i] - height) / radius) + np.arcsinh((along[i] - up) / off)
        leg = np.hypot(radius, along[i] - height)
        total = total * _directivity(edge.wedge, angle, np.array(faces[i]), eta) / leg * _faded(along[i] / within)
        way = way + leg
    return complex(0.5 * np.sum(total * np.exp(-1j * k * way)))


def _directivity(wedge: float, one: float, other: np.ndarray, eta: np.ndarray) -> np.ndarray:
    """Return ``-ν β / 4π`` of equation 27 for ends at two angles about an edge."""
    nu = np.pi / wedge
    angles = [nu * (np.pi + sign * other + turn * one) for sign, turn in ((1, -1), (-1, 1), (-1, -1), (1, 1))]
    beta = sum(np.sin(a) / (2.0 * np.sinh(0.5 * nu * eta) ** 2 + 2.0 * np.sin(0.5 * a) ** 2) for a in angles)
    return np.asarray(-nu / (4.0 * np.pi) * beta)
