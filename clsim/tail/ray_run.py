"""What a run of rays is given, and the energies that it adds up."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Floats
    from clsim.tail.ray_room import Float32s, Int32s, RayRoom

SLOTS = 16  # independent estimates, between which the error is told
MOST_REFLECTIONS = 20_000  # of a ray
FAINT = np.float32(1e-30)  # energy below which nothing is computed: numbers near the end of float32 differ by device
NOT_ESCAPED = np.float32(-2.0)
FARTHEST = np.float32(1e4)  # m, of a wall behind a wall
ESCAPE_SCALE = 2.0**30  # of escaped energies as whole numbers


@dataclass(frozen=True, slots=True, eq=False)
class RayRun:
    """Rays from one place, in groups of bands that scatter alike.

    Bands of one group stand side by side.
    """

    room: RayRoom
    sized: bool  # whether walls scatter by their limited size
    kind: Int32s  # (W,) of which material each wall is
    returned: Float32s  # (kinds, ANGLES, B) share of energy that comes back
    scattered: Float32s  # (kinds, ANGLES, G) share of that which leaves the mirror's direction
    first_band: Int32s  # (G + 1,)
    wavelength: Float32s  # (G,) m
    until: Float32s  # (G,) way after which rays end, m
    max_order: int  # of images
    origin: Float32s  # (3,) m about the room's middle
    directions: Float32s  # (n, 3), slot after slot of `SLOTS`
    emitted: Float32s  # (n, B)
    departure: Int32s  # (n,) direction of departure
    first_ray: int
    stream: int  # tells apart runs of one seed
    key: tuple[int, int]  # the seed


@dataclass(frozen=True, slots=True, eq=False)
class Layout:
    """Zones in which energies are added up, and their bins."""

    zones: Float32s  # (Z, 4) middle, m about the room's middle, and 1 over the volume, 1/m³
    radius: float  # m
    late_row: Int32s  # (Z,) zones of one row share their late energies
    rows: int
    arrivals: Float32s  # (M, 4) directions
    departures: int
    per_bin: float  # m
    per_window: float  # m
    bins: int  # of time, by direction of arrival
    early: int  # of them, of each zone by itself
    windows: int  # of time, by slot
    rain: float  # m, way up to which scattered energy reaches zones directly
    scale: float  # of energies as whole numbers
    bands: int
    walls: int

    def empty(self) -> Energies:
        """Make energies of zero."""
        zones, arrivals, bands = len(self.zones), len(self.arrivals), self.bands
        return Energies(
            np.zeros((zones, self.early, arrivals, bands), np.uint64),
            np.zeros((self.rows, self.bins - self.early, arrivals, bands), np.uint64),
            np.zeros((zones, self.bins, bands), np.uint64),
            np.zeros((SLOTS, zones, self.windows, bands), np.uint64),
            np.zeros((zones, self.departures), np.uint64),
            np.zeros((self.walls + 1, bands), np.uint64),
            np.empty((0, 6)),
        )


@dataclass(slots=True, eq=False)
class Energies:
    """Energies as whole numbers, over the scale of their layout."""

    early: NDArray[np.uint64]  # (Z, early, M, B) by zone, bin, arrival and band
    late: NDArray[np.uint64]  # (rows, bins - early, M, B)
    images: NDArray[np.uint64]  # (Z, bins, B) of what images hold
    windows: NDArray[np.uint64]  # (SLOTS, Z, windows, B) of all else
    departures: NDArray[np.uint64]  # (Z, Q)
    escaped: NDArray[np.uint64]  # (W + 1, B) by wall from which it left, the last one the source, over `ESCAPE_SCALE`
    places: Floats  # (n, 6) some places about the room's middle, m, and directions, from which rays left

    TABLES = ("early", "late", "images", "windows", "departures", "escaped")


class RayEngine(Protocol):
    """Interface of what traces rays: a device, or the host."""

    def trace(self, run: RayRun, layout: Layout, energies: Energies) -> None:
        """Trace a run's rays and add up their energies."""
        ...
