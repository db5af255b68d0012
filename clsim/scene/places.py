"""Where a motion leaves a room, meets a wall, or comes too near to others: sought only where that can be."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from clsim.scene.motion.motion import Motion

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Floats
    from clsim.scene.motion.instants import Indices, Instants
    from clsim.scene.room.faces import Mount
    from clsim.scene.room.protocol import Room

_RANGE = 64  # instants between which walls are sought from one to the next
_PAIRS = 500_000  # of positions and others at a time
_SPARE = 1.0 + 1e-9  # for the rounding of distances


def first_refused(room: Room, motion: Motion, instants: Instants, mount: Mount | None = None) -> int | None:
    """Return the first instant at which a motion is out of the room or in a wall, or about to go through one.

    mount: the wall that it sits in: refused is then what is off that, or beyond its edges, as well.
    """

    def probe(first: Indices, middle: Indices, last: Indices) -> tuple[Indices, NDArray[np.bool_]]:
        """Return the instants at which the room refuses a place, and which spans may hold one."""
        after = np.minimum(last + 1, instants.count - 1)  # the way to the next instant belongs to each
        free = room.clearance(motion.position(instants.times(middle)), mount)
        speed = motion.speed_over(instants.times(first), instants.times(after))
        unsure = ~(free > _SPARE * speed * instants.margin(first, middle, after))
        if room.is_convex:
            return np.where(free > 0.0, -1, middle), unsure
        hit = np.full(len(first), -1)
        for i in np.flatnonzero(unsure & (last - first < _RANGE)):
            way = instants.times(np.arange(first[i], after[i] + 1))
            met = room.first_contact(motion.position(way), mount)
            hit[i], unsure[i] = -1 if met is None else min(first[i] + met.index, last[i]), False
        return hit, unsure

    return instants.first(probe)


def first_approach(
    motion: Motion, others: Motion | Floats, nearest: float, instants: Instants
) -> tuple[int, int] | None:
    """Return the first instant about which a motion comes nearer to others than allowed, and to which of them.

    Shapes: others (n, 3) m.
    """
    to_whom: dict[int, int] = {}
    half = 0.5 * instants.step

    def probe(first: Indices, middle: Indices, last: Indices) -> tuple[Indices, NDArray[np.bool_]]:
        """Return the instants at which the other end is too near, and which spans may hold one."""
        speed, times = motion.speed_over(instants.times(first), instants.times(last)), instants.times(middle)
        at, velocity = motion.position(times)[:, None], motion.velocity(times)
        if isinstance(others, Motion):
            speed = speed + others.speed_over(instants.times(first), instants.times(last))
            places, velocity = others.position(times)[:, None], others.velocity(times) - velocity
        else:
            places, velocity = others[None], -velocity
        margin = _SPARE * speed * (instants.margin(first, middle, last) + half)
        hit, unsure = np.full(len(first), -1), np.empty(len(first), dtype=bool)
        for some in _slices(len(first), places.shape[1]):
            apart = (places[some] if len(places) > 1 else places) - at[some]
            distance = np.linalg.norm(apart, axis=2)
            unsure[some] = ~(distance.min(axis=1) - nearest > margin[some])
            fast = np.linalg.norm(velocity[some], axis=1)
            row, other = np.nonzero(distance < nearest + _SPARE * fast[:, None] * half)
            approach = nearest_within(apart[row, other], velocity[some][row], half)[0]
            for i, which in zip(row[approach < nearest], other[approach < nearest], strict=True):
                hit[some.start + i] = middle[some.start + i]
                to_whom.setdefault(int(middle[some.start + i]), int(which))
        return hit, unsure

    met = instants.first(probe)
    return None if met is None else (met, to_whom[met])


def nearest_within(apart: Floats, velocity: Floats, half: float) -> tuple[Floats, Floats]:
    """Return the least distances (n,), m, within a time before and after, s, and when from now, of straight motions.

    Shapes: apart, velocity (n, 3) m.
    """
    speed_squared = np.maximum(np.sum(velocity**2, axis=1), 1e-300)
    shift = np.clip(-np.sum(apart * velocity, axis=1) / speed_squared, -half, half)
    return np.linalg.norm(apart + shift[:, None] * velocity, axis=1), shift


def _slices(count: int, others: int) -> list[slice]:
    """Return slices of so many that each has a bounded number of pairs with the others."""
    step = max(1, _PAIRS // max(others, 1))
    return [slice(i, min(i + step, count)) for i in range(0, count, step)]
