"""Energy at a place by time, band and direction of arrival, as rays pass it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Floats
    from clsim.scene.room.protocol import Room

_HELD = 200_000  # rays' passages that are kept before they are sorted in
_POINTS = 4096  # by which the volume of a sphere inside the room is measured


@dataclass(eq=False)
class Listener:
    """A sphere in a room and the energy density in it, of sources of 1 Pa at 1 m for 1 s.

    Shapes: centre (3,) m; arrivals, departures (M, 3); shape (T, B).

    arrivals, departures: directions among which energy is shared: those that it comes from, and in which it left the
    source.

    Attributes
    ----------
    tail : ndarray (T, M, B)
        Energy by time, direction of arrival and band of what no image holds, Pa² s / (Pa² s).
    """

    centre: Floats
    radius: float
    volume: float
    arrivals: Floats
    departures: Floats
    time_step: float
    shape: tuple[int, int]
    tail: Floats = field(init=False)
    images: Floats = field(init=False)  # (T, B) likewise of what images hold
    departed: Floats = field(init=False)  # (Q, B) of the tail, by direction of departure
    _held: list[tuple[NDArray[np.int64], NDArray[np.int64], Floats]] = field(init=False, default_factory=list)
    _count: int = field(init=False, default=0)

    def __post_init__(self) -> None:
        times, bands = self.shape
        self.tail = np.zeros((times, len(self.arrivals), bands))
        self.images = np.zeros((times, bands))
        self.departed = np.zeros((len(self.departures), bands))

    def add(self, rays: Rays, far: Floats, late: NDArray[np.bool_], air: Floats, bands: NDArray[np.int64]) -> None:
        """Add what rays carry through the sphere on their next way, far (n,) m; late ones are no images'.

        The energy density of a ray of energy e is e times its way in the sphere over the sphere's volume; the time is
        that at which its plane passes the centre.
        """
        to_centre = self.centre - rays.origin
        along = np.einsum("ni,ni->n", to_centre, rays.direction)
        inside = self.radius**2 - (np.einsum("ni,ni->n", to_centre, to_centre) - along**2)
        hit = np.flatnonzero(inside > 0.0)
        half, middle = np.sqrt(inside[hit]), along[hit]
        way = np.minimum(middle + half, far[hit]) - np.maximum(middle - half, 0.0)
        met = way > 0.0
        hit, way, middle = hit[met], way[met], middle[met]
        path = rays.travelled[hit] + middle
        time = (path / self.time_step).astype(np.int64)
        kept = (time >= 0) & (time < self.shape[0])
        hit, time, path, way = hit[kept], time[kept], path[kept], way[kept]
        energy = rays.energy[hit] * np.exp(-np.multiply.outer(path - 1.0, air)) * (way / self.volume)[:, None]
        self._sort(late[hit], time, rays.direction[hit], rays.departure[hit], energy, bands)

    def _sort(
        self, late: NDArray[np.bool_], time: NDArray[np.int64], direction: Floats, departure: NDArray[np.int64],
        energy: Floats, bands: NDArray[np.int64],
    ) -> None:  # fmt: skip
        early = ~late
        if early.any():
            for i, band in enumerate(bands):
                self.images[:, band] += np.bincount(time[early], energy[early, i], self.shape[0])
        if late.any():
            arrival = (-direction[late] @ self.arrivals.T).argmax(axis=1)
            self._held.append((time[late] * len(self.arrivals) + arrival, departure[late], energy[late]))
            self._count += len(arrival)
        if self._count > _HELD:
            self.settle(bands)

    def settle(self, bands: NDArray[np.int64]) -> None:
        """Sort in what is held of rays that carry bands."""
        if not self._held:
            return
        place, departure, energy = (np.concatenate(parts) for parts in zip(*self._held, strict=True))
        for i, band in enumerate(bands):
            found = np.bincount(place, energy[:, i], self.tail.shape[0] * self.tail.shape[1])
            self.tail[:, :, band] += found.reshape(self.tail.shape[:2])
            self.departed[:, band] += np.bincount(departure, energy[:, i], len(self.departures))
        self._held, self._count = [], 0


@dataclass(eq=False)
class Rays:
    """Rays under way, n of them."""

    origin: Floats  # (n, 3) where they last met a wall, m, and unit vectors
    direction: Floats  # likewise
    travelled: Floats  # (n,) their way so far, m
    energy: Floats  # (n, B) that of a source of 1 Pa at 1 m over the rays, without the air's absorption
    order: NDArray[np.int64]  # (n,) reflections so far
    scattered: NDArray[np.bool_]  # (n,) whether one of these was scattered
    departure: NDArray[np.int64]  # (n,) in which of some directions they left

    def kept(self, rows: NDArray[np.bool_]) -> Rays:
        """Return some of them."""
        return Rays(
            self.origin[rows], self.direction[rows], self.travelled[rows], self.energy[rows], self.order[rows],
            self.scattered[rows], self.departure[rows],
        )  # fmt: skip


def volume_within(room: Room, centre: Floats, radius: float) -> float:
    """Return the volume of a sphere's part inside a closed room, m³, by points on spirals of equal volume."""
    from clsim.numerics.sphere import fibonacci_sphere

    height = ((np.arange(_POINTS) * 0.754877666) % 1.0) ** (1.0 / 3.0)  # of a low-discrepancy sequence
    points = centre + radius * height[:, None] * fibonacci_sphere(_POINTS)
    return 4.0 / 3.0 * np.pi * radius**3 * max(float(np.mean(room.contains(points))), 1.0 / _POINTS)
