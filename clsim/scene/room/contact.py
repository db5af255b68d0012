"""Where a trajectory meets a wall."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from clsim.scene.room.faces import NEAREST

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Floats
    from clsim.scene.room.walls import Walls

_RANGE = 64  # positions taken together


def first_contact(walls: Walls, positions: Floats) -> tuple[int, int] | None:
    """Return the first position that is on a wall, or after which a wall is walked through, and that wall.

    Shapes: positions (n, 3) m.
    """
    starts = np.arange(0, len(positions), _RANGE)
    low = np.minimum.reduceat(positions, starts)
    high = np.maximum.reduceat(positions, starts)
    after = positions[np.minimum(starts + _RANGE, len(positions) - 1)]
    low, high = np.minimum(low, after), np.maximum(high, after)
    centre, radius = 0.5 * (low + high), 0.5 * np.linalg.norm(high - low, axis=1) + NEAREST
    for i, first in enumerate(starts):
        near = np.abs(walls.normal @ centre[i] - walls.offset) <= radius[i]
        near &= np.linalg.norm(walls.centre - centre[i], axis=1) <= radius[i] + walls.radius
        met = [
            (int(first) + at, int(w))
            for w in np.flatnonzero(near)
            if (at := _contact(walls, int(w), positions[first : first + _RANGE + 1])) is not None
        ]
        if met:
            return min(met)
    return None


def walls_at(walls: Walls, position: Floats) -> NDArray[np.int64]:
    """Return the walls that a position (3,) is on."""
    near = np.flatnonzero(np.abs(walls.normal @ position - walls.offset) < NEAREST)
    return near[[bool(_near(walls, int(w), position[None])[0]) for w in near]]


def first_off(walls: Walls, wall: int, positions: Floats) -> int | None:
    """Return the first of positions (n, 3) in the plane of a wall that is on no wall of this plane."""
    held = np.zeros(len(positions), dtype=bool)
    for twin in np.flatnonzero(walls.plane == walls.plane[wall]):
        held |= walls.holds(int(twin), positions)
    return None if held.all() else int(np.argmin(held))


def _contact(walls: Walls, wall: int, positions: Floats) -> int | None:
    """Return the first of a few positions that is on a wall, or after which it is walked through."""
    height = positions @ walls.normal[wall] - walls.offset[wall]
    on = (np.abs(height) < NEAREST) & _near(walls, wall, positions)
    crosses = np.flatnonzero(height[:-1] * height[1:] < 0.0)
    share = height[crosses] / (height[crosses] - height[crosses + 1])
    hits = positions[crosses] + share[:, None] * (positions[crosses + 1] - positions[crosses])
    found = np.concatenate([np.flatnonzero(on), crosses[walls.holds(wall, hits)]])
    return int(found.min()) if len(found) else None


def _near(walls: Walls, wall: int, positions: Floats) -> NDArray[np.bool_]:
    """Return which positions lie over a wall, or beside it by less than the nearest distance."""
    over = walls.holds(wall, positions)
    edges = walls.edges_of(wall)
    along = edges[:, 1] - edges[:, 0]
    away = positions[:, None] - edges[:, 0]
    share = np.clip(np.sum(away * along, axis=2) / np.sum(along * along, axis=1), 0.0, 1.0)
    apart = np.linalg.norm(away - share[..., None] * along, axis=2).min(axis=1, initial=np.inf)
    return np.asarray(over | (apart < NEAREST))
