"""Rays of energy from a source, reflected or scattered by walls, and their energy at listeners."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from clsim.numerics.quaternions import normalised, rotate
from clsim.numerics.sphere import fibonacci_sphere

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from clsim.arrays import Floats
    from clsim.scene.room.protocol import Room
    from clsim.tail.room_rays import RoomRays, WallEnergies

    Emitted = Callable[[Floats], Floats]

_HELD = 200_000  # rays' passages that are kept before they are sorted in
_POINTS = 4096  # by which the volume of a sphere inside the room is measured


@dataclass(eq=False)
class Listener:
    """A sphere in a room and the energy density in it, of sources of 1 Pa at 1 m for 1 s.

    Shapes: centre (3,) m; arrivals, departures (M, 3); shape (T, B).

    arrivals, departures: directions among which energy is shared: those that it comes from, and in which it left the
    source.
    """

    centre: Floats
    radius: float
    volume: float
    arrivals: Floats
    departures: Floats
    time_step: float
    shape: tuple[int, int]
    # (T, M, B) energy by time, direction of arrival and band of what no image holds, Pa² s / (Pa² s).
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
        """Add the stored passages of rays that carry bands to the histogram."""
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


FLOOR = 10.0**-6.5  # of the energy, below which nothing is heard
_PILOT = 256  # rays that find out how long it takes
_SEVERAL = 16  # one in so many rays that end are taken out together
_LONGEST = 10.0  # s


@dataclass(frozen=True, eq=False)
class Tracer:
    """A room in which rays are traced from one place."""

    walls: RoomRays  # where rays meet walls
    normals: Floats  # (walls, 3) of the walls
    energies: WallEnergies  # what these do
    origin: Floats  # (3,) of the rays, m
    emitted: Emitted  # returns the energy (n, B) that is sent in directions (n, 3), 1 on the axis
    departures: Floats  # (Q, 3) directions among which departures are told apart
    max_order: int  # of images: energy that was only mirrored, so often at most, is theirs

    @cached_property
    def _groups(self) -> list[NDArray[np.int64]]:
        """Bands that share rays."""
        return self.energies.groups()

    def longest_way(self, speed_of_sound: float, rng: np.random.Generator) -> float:
        """Return the way in m after which next to nothing of the energy is left, by a few rays."""
        most = math.ceil(_LONGEST * speed_of_sound)
        alive = np.zeros((most + 1, len(self.energies.air)))

        def note(rays: Rays, far: Floats, bands: NDArray[np.int64]) -> None:
            first = np.minimum(rays.travelled, most).astype(np.int64)
            last = np.minimum(rays.travelled + far, most).astype(np.int64)
            for i, band in enumerate(bands):
                alive[:, band] += np.bincount(first, rays.energy[:, i], most + 1)
                alive[:, band] -= np.bincount(last, rays.energy[:, i], most + 1)

        for bands in self._groups:
            self._trace(_PILOT, float(most), bands, rng, note)
        energy = np.cumsum(alive, axis=0) * np.exp(-np.arange(most + 1)[:, None] * self.energies.air)
        left = np.cumsum(np.maximum(energy, 0.0)[::-1], axis=0)[::-1]
        loud = np.flatnonzero((left > FLOOR * left[0]).any(axis=1))
        return float(loud[-1] + 2) if len(loud) else 1.0

    def run(self, count: int, until: float, listeners: Sequence[Listener], rng: np.random.Generator) -> None:
        """Trace so many rays for each group of bands up to a way in m, and have listeners note what passes."""
        for bands in self._groups:
            air = self.energies.air[bands]

            def note(rays: Rays, far: Floats, bands: NDArray[np.int64], air: Floats = air) -> None:
                late = rays.scattered | (rays.order > self.max_order)
                for listener in listeners:
                    listener.add(rays, far, late, air, bands)

            self._trace(count, until, bands, rng, note)
            for listener in listeners:
                listener.settle(bands)

    def _trace(
        self,
        count: int,
        until: float,
        bands: NDArray[np.int64],
        rng: np.random.Generator,
        note: Callable[[Rays, Floats, NDArray[np.int64]], None],
    ) -> None:
        rays = self._started(count, bands, rng)
        least = FLOOR * float(rays.energy.max(initial=0.0))
        while len(rays.travelled):
            far, wall = self.walls.next(rays.origin, rays.direction)
            note(rays, far, bands)
            self._bounce(rays, far, wall, bands, rng)
            loud = (rays.energy * np.exp(np.multiply.outer(rays.travelled, -self.energies.air[bands]))).max(axis=1)
            kept = (rays.travelled < until) & (loud > least) & (wall >= 0)
            rays.energy[~kept] = 0.0
            if np.count_nonzero(kept) <= len(kept) * (1.0 - 1.0 / _SEVERAL):
                rays = rays.kept(kept)

    def _started(self, count: int, bands: NDArray[np.int64], rng: np.random.Generator) -> Rays:
        """Return rays in even directions, turned at random."""
        directions = rotate(normalised(rng.standard_normal((1, 4))), fibonacci_sphere(count))
        energy = np.array(self.emitted(directions)[:, bands]) * (4.0 * np.pi / count)
        departure = (directions @ self.departures.T).argmax(axis=1)
        return Rays(
            np.tile(self.origin, (count, 1)), directions, np.zeros(count), energy, np.zeros(count, np.int64),
            np.zeros(count, np.bool_), departure,
        )  # fmt: skip

    def _bounce(
        self, rays: Rays, far: Floats, wall: NDArray[np.int64], bands: NDArray[np.int64], rng: np.random.Generator
    ) -> None:
        """Bring rays to the walls that they meet, and send them off: mirrored, or scattered by Lambert's law."""
        rays.origin += far[:, None] * rays.direction
        rays.travelled += far
        normal = self.normals[wall]
        towards = np.einsum("ni,ni->n", rays.direction, normal)
        returned, share = self.energies.at(wall, towards, bands)
        rays.energy *= returned
        rays.direction -= 2.0 * towards[:, None] * normal
        rays.order += 1
        if self.walls.off:
            rays.origin -= self.walls.off * np.sign(towards)[:, None] * normal
        if not np.any(share):
            return
        scattered = np.flatnonzero(rng.random(len(share)) < share)
        # A normal and a point on the unit sphere add up to a direction whose density is the cosine's.
        ball = rng.standard_normal((len(share), 3))[scattered]
        ball /= np.linalg.norm(ball, axis=1, keepdims=True)
        lambert = ball - np.sign(towards[scattered])[:, None] * (1.0 + 1e-9) * normal[scattered]
        lambert /= np.linalg.norm(lambert, axis=1, keepdims=True)
        rays.direction[scattered] = lambert
        rays.scattered[scattered] = True
