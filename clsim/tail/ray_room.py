"""A room as rays see it, in float32, the energy that its walls reflect, and what a run of rays is given and adds up."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Floats
from clsim.paths.response import NEPERS, covered
from clsim.scene.room.mesh import MeshRoom
from clsim.scene.room.mesh_cleaning import clusters
from clsim.scene.room.protocol import Room
from clsim.scene.room.walls import Walls
from clsim.scene.scene import Scene

Float32s = NDArray[np.float32]
Int32s = NDArray[np.int32]

ANGLES = 128  # cells of the root of the cosine of incidence


@dataclass(frozen=True, slots=True, eq=False)
class WallEnergies:
    """Energy sent back by kind of wall, angle and band."""

    kind: NDArray[np.int64]  # (walls,) of which material each wall is
    returned: Floats  # (kinds, angles, B) share of energy that comes back
    scattered: Floats  # (kinds, angles, B) share of that which leaves the mirror's direction
    air: Floats  # (B,) absorption of energy by the air, 1/m

    @classmethod
    def of(cls, scene: Scene, centres: Floats) -> WallEnergies:
        """Return those of a scene's walls at frequencies (B,), Hz."""
        materials = list(dict.fromkeys(scene.room.faces.materials))
        cosine = ((np.arange(ANGLES) + 0.5) / ANGLES)[:, None] ** 2
        c = scene.air.speed_of_sound
        made = [
            (
                material.energy_at(covered(centres, material), cosine, c),
                material.scattered_share(covered(centres, material), cosine, c),
            )
            for material in materials
        ]
        kind = np.array([materials.index(material) for material in scene.room.faces.materials])
        returned, scattered = (np.array([pair[i] for pair in made]) for i in range(2))
        return cls(kind, returned, scattered, 2.0 * NEPERS * scene.air.absorption_at(centres))

    def groups(self) -> list[NDArray[np.int64]]:
        """Return groups of bands with equal scattering, whose rays take the same paths."""
        _, which = np.unique(self.scattered.reshape(-1, len(self.air)), axis=1, return_inverse=True)
        return [np.flatnonzero(which.ravel() == i) for i in range(which.max() + 1)]


WIDE = 8  # children of a node, and triangles of a leaf
NO_NUMBERS = 1e30  # of boxes that hold nothing
_OFF_WALL = 1e-5  # of the size: rays set out so far off a wall that float32 tells on which side they are
_AROUND = 4e-6  # of the size, by which boxes are wider than what they hold
_ENDLESS = 1e6  # m, size of walls whose size is of no effect


@dataclass(frozen=True, slots=True, eq=False)
class RayRoom:
    """Walls for rays, about the middle of the room, where float32 is finest."""

    convex: bool
    middle: Floats  # (3,) m, from which all places count
    off: float  # m, by which rays set out in front of a wall
    plane: Float32s  # (W, 4) unit normal and offset
    along: Float32s  # (W, 4) side of the smallest rectangle about a wall, and its length, m
    across: Float32s  # likewise the other side
    boxes: Float32s  # (nodes, 6, 8) lowest and highest x, y, z of a node's children
    children: Int32s  # (nodes, 8) node, or ~leaf
    leaves: Float32s  # (leaves, 13, 8) x, y, z of three corners, and planes, of a leaf's triangles
    wall_of: Int32s  # (leaves, 8) of the triangles, -1 for none

    @classmethod
    def of(cls, room: Room) -> RayRoom:
        """Prepare a room."""
        low, high = room.extent
        middle = 0.5 * (low + high)
        if room.is_convex:
            planes = np.column_stack([room.faces.normals, room.faces.offsets - room.faces.normals @ middle])
            frames = [_frame(normal) for normal in room.faces.normals]
            along, across = (np.array([[*frame[i], _ENDLESS] for frame in frames]) for i in range(2))
            return cls(
                True, middle, 0.0, _single(planes), _single(along), _single(across),
                np.zeros((1, 6, WIDE), np.float32), np.zeros((1, WIDE), np.int32), np.zeros((1, 13, WIDE), np.float32),
                np.full((1, WIDE), -1, np.int32),
            )  # fmt: skip
        return cls._of_mesh(room.as_mesh(), middle)

    @classmethod
    def _of_mesh(cls, room: MeshRoom, middle: Floats) -> RayRoom:
        walls, size = room.walls, room.walls.size
        planes = np.column_stack([walls.normal, walls.offset - walls.normal @ middle])
        along, across = _rectangles(walls)
        triangles = _single(room.vertices[room.triangles] - middle)
        tree = _tree(triangles, _single(planes), walls.of_triangle, _AROUND * size)
        return cls(False, middle, _OFF_WALL * size, _single(planes), _single(along), _single(across), *tree)


def _single(values: Floats) -> Float32s:
    return np.ascontiguousarray(values, np.float32)


def _frame(normal: Floats) -> tuple[Floats, Floats]:
    """Return two unit vectors that make a frame with a unit normal."""
    along = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    along /= np.linalg.norm(along)
    return along, np.cross(normal, along)


def _rectangles(walls: Walls) -> tuple[Floats, Floats]:
    """Return the sides (W, 4) of the smallest rectangles about walls: unit vector and length, m."""
    # Walls that touch in one plane, such as a window that is flush with its wall, are one there.
    flush = np.column_stack([np.repeat(np.arange(len(walls)), np.diff(walls.first_twin)), walls.twin])
    _, surface = clusters(len(walls), flush)
    sides = []
    for wall, normal in enumerate(walls.normal):
        ring = walls.hull_of(wall)
        held = np.concatenate([walls.hull_of(one) for one in np.flatnonzero(surface == surface[wall]).tolist()])
        edges = np.roll(ring, -1, axis=0) - ring
        edges /= np.linalg.norm(edges, axis=1, keepdims=True)
        others = np.cross(normal, edges)
        lengths = np.ptp(held @ edges.T, axis=0), np.ptp(held @ others.T, axis=0)
        best = int(np.argmin(lengths[0] * lengths[1]))
        sides.append([[*edges[best], lengths[0][best]], [*others[best], lengths[1][best]]])
    found = np.array(sides)
    return found[:, 0], found[:, 1]


def _tree(
    triangles: Float32s, planes: Float32s, wall_of: NDArray[np.int64], around: float
) -> tuple[Float32s, Int32s, Float32s, Int32s]:
    """Return boxes, children, leaves and walls of a tree about triangles (T, 3, 3)."""
    low, high = triangles.min(axis=1) - np.float32(around), triangles.max(axis=1) + np.float32(around)
    boxes: list[Any] = [None]
    children: list[Any] = [None]
    leaves: list[Float32s] = []
    walls: list[Int32s] = []
    waiting = [(0, np.arange(len(triangles)))]
    while waiting:
        node, mine = waiting.pop()
        box = np.full((6, WIDE), NO_NUMBERS, np.float32)
        box[1::2] = -NO_NUMBERS
        child = np.zeros(WIDE, np.int32)
        for i, part in enumerate(_parts(low, high, mine)):
            box[::2, i], box[1::2, i] = low[part].min(axis=0), high[part].max(axis=0)
            if len(part) > WIDE:
                child[i] = len(boxes)
                boxes.append(None)
                children.append(None)
                waiting.append((len(boxes) - 1, part))
                continue
            child[i] = ~len(leaves)
            leaf, of = np.zeros((13, WIDE), np.float32), np.full(WIDE, -1, np.int32)
            leaf[12] = -1.0  # no plane: its distance is infinite, and behind the ray
            leaf[:9, : len(part)] = triangles[part].reshape(len(part), 9).T
            leaf[9:, : len(part)] = planes[wall_of[part]].T
            of[: len(part)] = wall_of[part]
            leaves.append(leaf)
            walls.append(of)
        boxes[node], children[node] = box, child
    return np.array(boxes, np.float32), np.array(children, np.int32), np.array(leaves), np.array(walls)


def _parts(low: Float32s, high: Float32s, mine: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    """Cut triangles into at most eight parts, the largest one first, each time where boxes become small."""
    parts = [mine]
    while len(parts) < WIDE:
        sizes = [len(part) for part in parts]
        largest = int(np.argmax(sizes))
        if sizes[largest] <= WIDE:
            break
        parts[largest : largest + 1] = _halves(low, high, parts[largest])
    return parts


def _halves(low: Float32s, high: Float32s, mine: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    """Cut triangles in two along the axis and at the place where the boxes' areas, by their numbers, are least."""
    best, halves = np.inf, [mine[: len(mine) // 2], mine[len(mine) // 2 :]]
    for axis in range(3):
        order = mine[np.argsort(low[mine, axis] + high[mine, axis], kind="stable")]
        first = _areas(np.minimum.accumulate(low[order]), np.maximum.accumulate(high[order]))
        last = _areas(np.minimum.accumulate(low[order[::-1]]), np.maximum.accumulate(high[order[::-1]]))[::-1]
        # Leaves hold eight: a part costs as many leaves as it needs.
        count = np.arange(1, len(order))
        leaves = -(-count // WIDE) * first[:-1] + -(-(len(order) - count) // WIDE) * last[1:]
        place = int(np.argmin(leaves))
        if leaves[place] < best:
            best, halves = float(leaves[place]), [order[: place + 1], order[place + 1 :]]
    return halves


def _areas(low: Float32s, high: Float32s) -> Floats:
    x, y, z = (high - low).astype(np.float64).T
    return np.asarray(x * y + y * z + z * x)


def has_free_edges(room: Room) -> bool:
    """Test whether walls end where no mirror image goes on, as at a column or a sheet: a convex room has none."""
    if room.is_convex:
        return False
    walls = room.as_mesh().walls
    height = walls.hull @ walls.normal.T - walls.offset
    flat = _AROUND * walls.size
    return not np.all((height.min(axis=0) > -flat) | (height.max(axis=0) < flat))


@lru_cache(maxsize=4)
def ray_room(room: Any) -> RayRoom:
    """Return a `Room` for rays, prepared once."""
    return RayRoom.of(room)


SLOTS = 16  # independent estimates, between which the error is told
MOST_REFLECTIONS = 20_000  # of a ray
FAINT = np.float32(1e-30)  # energy below which nothing is computed: numbers near the end of float32 differ by device
NOT_ESCAPED = np.float32(-2.0)
FARTHEST = np.float32(1e4)  # m, of a wall behind a wall
ESCAPE_SCALE = 2.0**30  # of escaped energies as whole numbers


@dataclass(frozen=True, slots=True, eq=False)
class RayRun:
    """Rays from one place, in groups of bands that scatter alike. Bands of one group stand side by side."""

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
