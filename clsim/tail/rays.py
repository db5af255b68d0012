"""Rays of energy from a source, mirrored or scattered by walls."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from clsim.numerics.quaternions import normalised, rotate
from clsim.numerics.sphere import fibonacci_sphere
from clsim.tail.histogram import Listener, Rays

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from clsim.arrays import Floats
    from clsim.tail.reflections import WallEnergies
    from clsim.tail.room_rays import RoomRays

    Emitted = Callable[[Floats], Floats]

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
