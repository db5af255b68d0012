"""Low bands of a rectangular room, whose few modes decay more slowly than rays: many run along walls.

Rays in all directions stand for a continuum of modes. The coherent sum of all images is a sum over the room's modes, by
Poisson's formula for the image lattice along each axis. Its poles are `(n π + j a) / L`, where `exp(-2 a)` is what both
walls of the axis reflect of the pressure together. A mode with `n = 0` along an axis runs along these walls. They damp
it by `|erfcx(a √(j c t / (2 k L²)))|²`, more slowly than any exponential.
"""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from clsim.numerics.sphere import fibonacci_sphere
from clsim.tail.room_rays import ANGLES, WallEnergies

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from clsim.arrays import Floats
    from clsim.scene.room.protocol import Room

    Damping = Callable[[Floats, int], Floats]

_HIGHEST = 450.0  # Hz, above which decays by rays are within 3 % of coherent ones
_FEWEST, _MOST = 2.0, 1e6  # modes in a band: fewer tell no decay, more are a continuum
_DIRECTIONS = 4096
_RATES = 256  # of decay that are told apart in a band
_SQUARE = 1e-9  # by which the cosines of a rectangular room's corners may differ from 0 and 1


def modal_shares(room: Room, energies: WallEnergies, centres: Floats, times: Floats, c: float) -> Floats:
    """Energy of the coherent sum of images over that of rays, (T, B), in the mean over all pairs of places.

    Shapes: centres (B,) Hz of thirds of octaves; times (T,) s. c: speed of sound, m/s.

    It is 1 in rooms that are not rectangular and above 450 Hz, and returns to 1 as energy is scattered.
    """
    shares = np.ones((len(times), len(centres)))
    axes = _axes(room)
    if axes is None:
        return shares
    sizes, walls = axes
    for band in np.flatnonzero(centres < _HIGHEST):
        centre = float(centres[band])

        def damping(cosines: Floats, axis: int, band: int = int(band)) -> Floats:
            """Exponent `a` of an axis at angles of incidence (n,) and in this band."""
            angle = np.minimum((ANGLES * np.sqrt(cosines)).astype(np.int64), ANGLES - 1)
            back = energies.returned[energies.kind[walls[axis]][:, None], angle, band]
            return np.asarray(-0.25 * np.log(np.maximum(back, 1e-30)).sum(axis=0))

        modal = _modal(sizes, centre, c, times, damping)
        if modal is not None:
            mirrored = np.exp(-_scattered_per_second(sizes, walls, energies, int(band), c) * times)
            shares[:, band] += mirrored * (modal / _continuous(sizes, centre, c, times, damping) - 1.0)
    return shares


def _axes(room: Room) -> tuple[Floats, NDArray[np.int64]] | None:
    """Sizes (3,) m and walls (3, 2) along the axes of a rectangular room; None for any other room."""
    if not room.is_convex or len(room.faces) != 6:
        return None
    cosines = room.faces.normals @ room.faces.normals.T
    opposite = np.argwhere(np.triu(cosines < _SQUARE - 1.0))
    apart = np.abs(cosines) > _SQUARE
    if len(opposite) != 3 or np.count_nonzero(apart) != 12:
        return None
    return -room.faces.offsets[opposite].sum(axis=1), opposite


def _band_weight(frequencies: Floats, centre: float) -> Floats:
    """Share of energy that the tail's band about a centre passes, see `band_shares`."""
    away = np.minimum(np.abs(3.0 * np.log2(frequencies / centre)), 1.0)
    return np.asarray(np.cos(0.5 * np.pi * away) ** 4)


def _modal(sizes: Floats, centre: float, c: float, times: Floats, damping: Damping) -> Floats | None:
    """Energy (T,) of the modes in a band, 1 for each at time 0; None for too few, or too many to count."""
    from scipy.special import wofz

    most = 2.0 * centre * 2.0 ** (1.0 / 3.0) / c * sizes  # half waves in each size
    if np.prod(most) > _MOST:
        return None
    numbers = np.stack(np.meshgrid(*(np.arange(int(m) + 1) for m in most), indexing="ij"), axis=-1).reshape(-1, 3)[1:]
    waves = np.pi * numbers / sizes  # wave numbers, 1/m
    k = np.linalg.norm(waves, axis=1)
    weight = _band_weight(k * c / (2.0 * np.pi), centre)
    if weight.sum() < _FEWEST:
        return None
    cosines = waves / k[:, None]
    rates = _decay_rates(cosines, sizes, c, damping)
    middle = 2.0 * np.pi * centre / c
    along = [
        np.abs(wofz(1j * damping(np.zeros(1), i)[0] * np.sqrt(0.5j * c * times / middle) / sizes[i])) ** 2
        for i in range(3)
    ]
    total = np.zeros(len(times))
    for still in product((False, True), repeat=3):
        mine = np.all((numbers == 0) == still, axis=1)
        if mine.any():
            slow = np.prod([along[i] for i in range(3) if still[i]], axis=0)
            total += slow * _decay(rates[mine], weight[mine], times)
    return total


def _continuous(sizes: Floats, centre: float, c: float, times: Floats, damping: Damping) -> Floats:
    """Energy (T,) of as many modes as the volume holds, in all directions alike, as rays are."""
    frequencies = centre * np.linspace(2.0 ** (-1.0 / 3.0), 2.0 ** (1.0 / 3.0), 401)
    density = 4.0 * np.pi * np.prod(sizes) * frequencies**2 / c**3
    count = np.trapezoid(density * _band_weight(frequencies, centre), frequencies)
    rates = _decay_rates(np.abs(fibonacci_sphere(_DIRECTIONS)), sizes, c, damping)
    return _decay(rates, np.full(_DIRECTIONS, count / _DIRECTIONS), times)


def _decay_rates(cosines: Floats, sizes: Floats, c: float, damping: Damping) -> Floats:
    """Rates (n,) in 1/s by which the energy in directions (n, 3) decays."""
    return np.asarray(sum(2.0 * c * cosines[:, i] * damping(cosines[:, i], i) / sizes[i] for i in range(3)))


def _decay(rates: Floats, weights: Floats, times: Floats) -> Floats:
    """Sum (T,) of weights (n,) that decay by rates (n,)."""
    edges = np.linspace(rates.min(), rates.max() * (1.0 + 1e-12) + 1e-12, _RATES + 1)
    weight, _ = np.histogram(rates, edges, weights=weights)
    rate, _ = np.histogram(rates, edges, weights=weights * rates)
    some = weight > 0.0
    return np.asarray(np.exp(-np.multiply.outer(times, rate[some] / weight[some])) @ weight[some])


def _scattered_per_second(
    sizes: Floats, walls: NDArray[np.int64], energies: WallEnergies, band: int, c: float
) -> float:
    """Scatterings of a ray, 1/s: its share of reflections, in the mean of diffuse incidence."""
    root = (np.arange(ANGLES) + 0.5) / ANGLES
    share = energies.scattered[:, :, band] @ root**3 / np.sum(root**3)
    return float(0.5 * c * share[energies.kind[walls]].sum(axis=1) @ (0.5 / sizes))
