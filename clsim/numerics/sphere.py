"""Points spread over the sphere, interpolation over it, and real spherical harmonics."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from clsim.arrays import Floats

OverSphere = Callable[[Floats], NDArray[np.complex128]]  # values (m, u) in directions (m, 3), unit vectors
_SAME = 1e-5  # rad, between directions that count as one
_SAME_CIRCLE = 1e-4  # rad, between circles of a grid that count as one
_NEIGHBOURS = 4
_QUADRATIC = 2  # degree of the functions beside fifth powers
_TOGETHER = 2048  # directions whose distances to all others are held at a time


def fibonacci_sphere(count: int) -> Floats:
    """Return unit vectors spread evenly over the sphere.

    The spiral of the golden ratio, through parts of equal area: R. Swinbank, R. J. Purser, "Fibonacci grids: a novel
    approach to global modelling", Q. J. R. Meteorol. Soc. 132, 2006, section 3.
    """
    i = np.arange(count) + 0.5
    z = 1.0 - 2.0 * i / count
    angle = math.pi * (1.0 + math.sqrt(5.0)) * i
    across = np.sqrt(1.0 - z * z)
    return np.stack([across * np.cos(angle), across * np.sin(angle), z], axis=1)


def merged(directions: Floats, values: NDArray[Any]) -> tuple[Floats, NDArray[Any]]:
    """Return unit vectors (n, 3) that differ by more than 1e-5 rad, and the mean of what each has of values (m, f)."""
    pairs = scipy.spatial.KDTree(directions).query_pairs(_SAME, output_type="ndarray")
    if not len(pairs):
        return directions, values
    size = len(directions)
    links = scipy.sparse.coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(size, size))
    count, label = scipy.sparse.csgraph.connected_components(links, directed=False)
    total = np.zeros((count, values.shape[1]), dtype=values.dtype)
    np.add.at(total, label, values)
    first = np.unique(label, return_index=True)[1]
    return directions[first], total / np.bincount(label)[:, None]


def largest_hole(directions: Floats) -> float:
    """Return the radius in degrees of the widest cap of the sphere without a direction in it; at least 90 is a side.

    Caps without points are those that facets of the convex hull cut off.
    """
    try:
        offsets = -scipy.spatial.ConvexHull(directions).equations[:, 3]
    except (scipy.spatial.QhullError, ValueError):  # fewer than four points, or all in one plane
        return 180.0
    return float(np.degrees(np.arccos(np.clip(offsets.min(), -1.0, 1.0))))


def neighbours_on_sphere(directions: Floats) -> NDArray[np.intp]:
    """Return pairs (m, 2) of each direction and those nearest to it."""
    nearest = np.asarray(scipy.spatial.KDTree(directions).query(directions, k=min(_NEIGHBOURS + 1, len(directions)))[1])
    here = np.broadcast_to(nearest[:, :1], nearest[:, 1:].shape)
    return np.column_stack([here.ravel(), nearest[:, 1:].ravel()])


@dataclass(frozen=True, slots=True, eq=False)
class GridOnSphere:
    """Directions on circles about +z, the same azimuths on each, evenly all round.

    Shapes: colatitudes (e,) rad; azimuths (a,) rad; index (e, a).
    """

    colatitudes: Floats
    azimuths: Floats
    index: NDArray[np.intp]

    @classmethod
    def of(cls, directions: Floats) -> GridOnSphere | None:
        """Return the grid that different unit vectors (n, 3) are, or None if they are none."""
        colatitude, azimuth = _angles(directions)
        pole = np.minimum(colatitude, np.pi - colatitude) < _SAME
        off = np.flatnonzero(~pole)
        if len(off) < 12:
            return None
        circles, row = _levels(colatitude[off])
        azimuths, column = _levels(np.where(azimuth[off] > 2.0 * np.pi - _SAME_CIRCLE, 0.0, azimuth[off]))
        e, a = len(circles), len(azimuths)
        step = 2.0 * np.pi / max(a, 1)
        if e < 3 or a < 4 or a % 2 or e * a != len(off):
            return None
        if np.any(np.abs(azimuths - azimuths[0] - step * np.arange(a)) > _SAME_CIRCLE):
            return None
        index = np.full((e, a), -1)
        index[row, column] = off
        if index.min() < 0:
            return None
        for at in (0.0, np.pi):
            for here in np.flatnonzero(pole & (np.abs(colatitude - at) < _SAME)):
                place = int(np.searchsorted(circles, at))
                circles, index = np.insert(circles, place, at), np.insert(index, place, here, axis=0)
        return cls(circles, azimuths[0] + step * np.arange(a), index)

    def through(self, values: NDArray[np.complex128]) -> OverSphere:
        """Return the function of direction that goes through values (n, u)."""
        # Great circles through the poles are closed: colatitudes go on from the pole down the opposite azimuth, to 2 pi
        # (the "double Fourier sphere"; P. E. Merilees, Atmosphere 11 (1), 13-20, 1973). Values are then periodic in
        # both angles, and a periodic cubic spline in each goes through them. A pole that the grid lacks is put in
        # first.
        circle, table = _closed(*_with_poles(self.colatitudes, values[self.index]))
        knots, coefficients = _periodic_spline(circle, np.concatenate([table.real, table.imag], axis=-1))
        others, coefficients = _periodic_spline(self.azimuths, np.swapaxes(coefficients, 0, 1))
        spline = scipy.interpolate.NdBSpline((knots, others), np.ascontiguousarray(np.swapaxes(coefficients, 0, 1)), 3)
        begin = self.azimuths[0]

        def on_grid(directions: Floats) -> NDArray[np.complex128]:
            colatitude, azimuth = _angles(directions)
            return _complex(spline(np.column_stack([colatitude, begin + (azimuth - begin) % (2.0 * np.pi)])))

        return on_grid


@dataclass(frozen=True, slots=True, eq=False)
class RadialOnSphere:
    """Sums of fifth powers of distances and of quadratic functions, by products of matrices: for very many values."""

    directions: Floats  # (n, 3)
    factors: Floats  # (n + 9, u), of the powers, then of quadratic functions

    @classmethod
    def through(cls, directions: Floats, values: Floats) -> RadialOnSphere:
        """Return the function of direction that goes through real values (n, u) in directions (n, 3)."""
        # As of `scattered_on_sphere`, one derivative smoother.
        smooth = real_harmonics(_QUADRATIC, directions)
        count = smooth.shape[1]
        system = np.block([[_powers(directions, directions), smooth], [smooth.T, np.zeros((count, count))]])
        return cls(directions, np.linalg.solve(system, np.concatenate([values, np.zeros((count, values.shape[1]))])))

    def __call__(self, directions: Floats) -> Floats:
        """Return values (m, u) in directions (m, 3), unit vectors."""
        own, smooth = np.split(self.factors, [len(self.directions)])
        parts = np.array_split(directions, 1 + len(directions) // _TOGETHER)
        return np.concatenate(
            [_powers(p, self.directions) @ own + real_harmonics(_QUADRATIC, p) @ smooth for p in parts]
        )


def _powers(some: Floats, others: Floats) -> Floats:
    """Return the fifth powers (m, n) of distances between unit vectors (m, 3) and (n, 3)."""
    squares = np.maximum(2.0 - 2.0 * (some @ others.T), 0.0)
    return np.asarray(squares * squares * np.sqrt(squares))


def scattered_on_sphere(directions: Floats, values: NDArray[np.complex128]) -> OverSphere:
    """Return the function of direction that goes through values (n, u) in directions (n, 3) anywhere.

    The sum of the cubes of distances to all directions and a linear function: the smoothest of all that go through the
    values, in the sense of the norm that belongs to the cube (H. Wendland, "Scattered Data Approximation", 2005,
    chapter 8 and chapter 17).
    """
    both = np.concatenate([values.real, values.imag], axis=1)
    functions = scipy.interpolate.RBFInterpolator(directions, both, kernel="cubic")
    return lambda towards: _complex(functions(towards))


def _closed(colatitudes: Floats, down: NDArray[Any]) -> tuple[Floats, NDArray[Any]]:
    """Return colatitudes (n,) up to 2 pi, and values (n, a, u) that go on from (e, a, u) down the opposite azimuths."""
    inner = (colatitudes > _SAME) & (colatitudes < np.pi - _SAME)
    up = np.roll(down, down.shape[1] // 2, axis=1)[inner][::-1]
    return np.concatenate([colatitudes, 2.0 * np.pi - colatitudes[inner][::-1]]), np.concatenate([down, up])


def _with_poles(colatitudes: Floats, down: NDArray[Any]) -> tuple[Floats, NDArray[Any]]:
    """Return colatitudes and values (e, a, u) with poles: the mean, where they are missing, of what goes over them."""
    circle, table = _closed(colatitudes, down)
    over = scipy.interpolate.BSpline(*_periodic_spline(circle, table), 3)
    for pole, seen in ((0.0, 2.0 * np.pi), (np.pi, np.pi)):
        if np.abs(colatitudes - pole).min() > _SAME:
            place = int(np.searchsorted(colatitudes, pole))
            colatitudes = np.insert(colatitudes, place, pole)
            down = np.insert(down, place, over(seen).mean(axis=0), axis=0)
    return colatitudes, down


def _periodic_spline(x: Floats, values: Floats) -> tuple[Floats, Floats]:
    """Return knots and coefficients (n + 3, ...) of the cubic spline of period 2 pi through values (n, ...) at x."""
    period = 2.0 * np.pi
    knots = np.concatenate([x[-3:] - period, x, x[:4] + period])
    matrix = scipy.interpolate.BSpline.design_matrix(x, knots, 3).toarray()
    matrix[:, :3] += matrix[:, -3:]  # the last three functions are the first ones, a period later
    found = np.linalg.solve(matrix[:, :-3], values.reshape(len(x), -1)).reshape(values.shape)
    return knots, np.concatenate([found, found[:3]])


def _complex(stacked: Any) -> NDArray[np.complex128]:
    """Return (m, u) complex from (m, 2 u), real parts first."""
    half = stacked.shape[1] // 2
    return np.asarray(stacked[:, :half] + 1j * stacked[:, half:])


def _angles(directions: Floats) -> tuple[Floats, Floats]:
    """Return colatitudes from +z (n,), 0 to pi, and azimuths from +x towards +y (n,), 0 to 2 pi, of unit vectors."""
    x, y, z = directions.T
    return np.arctan2(np.hypot(x, y), z), np.arctan2(y, x) % (2.0 * np.pi)


def _levels(values: Floats) -> tuple[Floats, NDArray[np.intp]]:
    """Return values that differ by more than a grid's tolerance, increasing, and which of them each one is."""
    order = np.argsort(values)
    new = np.diff(values[order], prepend=-np.inf) > _SAME_CIRCLE
    label = np.empty(len(values), dtype=np.intp)
    label[order] = np.cumsum(new) - 1
    return values[order][new], label


def table_directions(rows: int) -> Floats:
    """Return the directions (2 rows², 3) of a table with so many circles of latitude, see `table_values`."""
    angle = np.pi / rows * np.stack(np.meshgrid(np.arange(rows) + 0.5, np.arange(2 * rows), indexing="ij"))
    across, (colatitude, azimuth) = np.sin(angle[0]), angle
    return np.stack([across * np.cos(azimuth), across * np.sin(azimuth), np.cos(colatitude)], axis=2).reshape(-1, 3)


def table_values(table: NDArray[np.float32], directions: Floats) -> NDArray[np.float32]:
    """Return values (m, u) in unit vectors (..., 3) from those (2 rows², u) of `table_directions`.

    By cubics through four values along each angle (M. Abramowitz, I. A. Stegun, "Handbook of Mathematical Functions",
    1964, equation 25.2.13). Beyond a pole, circles go on down the opposite azimuth (P. E. Merilees, Atmosphere 11 (1),
    13-20, 1973).
    """
    rows = math.isqrt(len(table) // 2)
    colatitude, azimuth = _angles(directions.reshape(-1, 3))
    places = np.stack([colatitude * rows / np.pi - 0.5, azimuth * rows / np.pi])
    whole = np.floor(places)
    x = places - whole
    inner, outer = x * (x - 1.0), (x + 1.0) * (x - 2.0)
    cubics = np.stack(
        [inner * (2.0 - x) / 6.0, outer * (x - 1.0) / 2.0, -outer * x / 2.0, inner * (x + 1.0) / 6.0], axis=2
    )
    row, column = whole.astype(np.int32)[:, :, None] + np.arange(-1, 3, dtype=np.int32)
    beyond = (row < 0) | (row >= rows)
    row = np.where(row < 0, -1 - row, np.where(row < rows, row, 2 * rows - 1 - row))
    index = row[:, :, None] * 2 * rows + (column[:, None] + rows * beyond[:, :, None]) % (2 * rows)
    factors = (cubics[0][:, :, None] * cubics[1][:, None]).astype(np.float32)
    starts = 16 * np.arange(len(row) + 1)
    return np.asarray(
        scipy.sparse.csr_array((factors.ravel(), index.ravel(), starts), shape=(len(row), len(table))) @ table
    )


def real_harmonics(order: int, directions: Floats) -> Floats:
    """Evaluate real spherical harmonics up to an order, semi-normalised (SN3D), in ACN order.

    Shapes: directions (..., 3); result (..., (order + 1)²).

    ``Y_l^m = sqrt((2 - [m = 0]) (l - |m|)! / (l + |m|)!) P_l^|m|(z) {cos m φ, sin |m| φ}`` without Condon and
    Shortley's phase, at place ``l² + l + m`` (C. Nachbar et al., "AmbiX - a suggested Ambisonics format", Ambisonics
    Symposium, 2011, section 2.1). Powers of ``x + j y`` stand for the sine's and the azimuth's: poles are places like
    others.
    """
    x, y, z = np.moveaxis(np.asarray(directions, dtype=np.float64), -1, 0)
    out = np.empty((*x.shape, (order + 1) ** 2))
    around, largest = np.ones_like(x) + 0j, 1.0
    for m in range(order + 1):
        before, now = np.zeros_like(z), np.full_like(z, largest)
        for degree in range(m, order + 1):
            factor = harmonic_norm(degree, m)
            out[..., degree * degree + degree + m] = factor * now * around.real
            if m:
                out[..., degree * degree + degree - m] = factor * now * around.imag
            before, now = now, ((2 * degree + 1) * z * now - (degree + m) * before) / (degree + 1 - m)
        around, largest = around * (x + 1j * y), largest * (2 * m + 1)
    return out


def harmonic_norms(order: int) -> Floats:
    """Return the factors of all harmonics up to an order in SN3D and ACN order, ((order + 1)²,)."""
    return np.array([harmonic_norm(degree, abs(m)) for degree in range(order + 1) for m in range(-degree, degree + 1)])


def harmonic_norm(degree: int, m: int) -> float:
    """Return the factor of a harmonic's Legendre function in SN3D."""
    return math.sqrt((1 if m == 0 else 2) * math.factorial(degree - m) / math.factorial(degree + m))
