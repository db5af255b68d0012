"""Which walls beams and segments meet, by the boxes around them; in NumPy.

The twin of ``meetings.cl`` and ``crossings.cl``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

from clsim.arrays import spread
from clsim.paths.specular.occlusion import crossed_pieces

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Floats
    from clsim.scene.room.walls import Walls

    Ints = NDArray[np.int64]

_PAIRS = 20_000  # of beam, wall and receiver looked at at a time


@dataclass(frozen=True, slots=True, eq=False)
class Beams:
    """n beams: what a ball lights through an aperture."""

    planes: Floats  # (n, p, 4) half-spaces that hold a beam; see `beam_planes`
    centre: Floats  # (n, 3) of the balls, m
    radius: float  # of all balls, m
    last: NDArray[np.int32]  # (n,) walls that the apertures are on
    slack: float  # by which walls are taken to be larger, m

    def part(self, which: slice) -> Beams:
        """Return some of them."""
        return Beams(self.planes[which], self.centre[which], self.radius, self.last[which], self.slack)


@dataclass(frozen=True, slots=True, eq=False)
class Ears:
    """Spheres that hold R receivers, and what each sees.

    Attributes
    ----------
    plane : ndarray (P, 4)
        Half-spaces of the beams from each receiver through what it sees of each wall; see `beam_planes`.
    first_plane : ndarray (R * W + 1,) int
        Where those of receiver r and wall w begin, in row ``r * W + w``; none where it cannot see the wall.
    """

    centre: Floats  # (R, 3) of the spheres, m
    radius: Floats  # likewise
    seen: NDArray[np.bool_]  # (R, W) which walls each may see
    plane: Floats
    first_plane: Ints


class Lookup(Protocol):
    """Looks up walls, on the host or on a device."""

    def crossings(self, start: Floats, stop: Floats) -> tuple[Ints, Ints, Ints]:
        """Crossings of segments and walls."""
        ...

    def meetings(self, beams: Beams, sides: Ints, ears: Ears | None) -> tuple[Ints, Ints]:
        """Return pairs of a beam and a wall that it may meet."""
        ...


class WallLookup:
    """Looks up walls in NumPy."""

    def __init__(self, walls: Walls) -> None:
        self._walls = walls

    def crossings(self, start: Floats, stop: Floats) -> tuple[Ints, Ints, Ints]:
        """Crossings of segments and walls strictly between their endpoints; see `crossed_pieces`.

        Shapes: start, stop (n, 3) m; result (m,).
        """
        return crossed_pieces(self._walls, start, stop)

    def meetings(self, beams: Beams, sides: Ints, ears: Ears | None) -> tuple[Ints, Ints]:
        """Return pairs of a beam and a wall that it may meet, in another plane than its last.

        Shapes: sides (W,); result (m,).

        ears: where given, only walls by which a beam may reach a receiver that sees them.
        """
        walls = self._walls
        beam, wall = walls.tree.meeting_planes(beams.planes, beams.slack)
        height = np.einsum("ni,ni->n", beams.centre[beam], walls.normal[wall]) - walls.offset[wall]
        meets = (walls.plane[beams.last[beam]] != walls.plane[wall]) & (sides[wall] * height >= -beams.radius)
        beam, wall = beam[meets], wall[meets]
        if ears is None:
            return beam, wall
        leads = self._leads(beams, beam, wall, ears)
        return beam[leads], wall[leads]

    def _leads(self, beams: Beams, beam: Ints, wall: Ints, ears: Ears) -> NDArray[np.bool_]:
        """Mask of beams that may reach a receiver by a wall.

        They touch the receiver's sphere mirrored by the wall, and what the receiver sees in it touches their ball.
        """
        walls, found, seen = self._walls, np.zeros(len(beam), dtype=bool), ears.seen
        some = np.flatnonzero(np.any(seen[:, wall], axis=0))
        step = max(1, _PAIRS // max(len(ears.radius), 1))
        for pair in (some[i : i + step] for i in range(0, len(some), step)):
            at, by = beam[pair], wall[pair]
            normal, plane = walls.normal[by], beams.planes[at]
            cosine = np.einsum("npi,ni->np", plane[..., :3], normal)
            mirrored = plane[..., :3] - 2.0 * cosine[..., None] * normal[:, None]
            away = plane[..., 3] - 2.0 * cosine * walls.offset[by, None]
            touched = np.all(mirrored @ ears.centre.T - away[..., None] >= -ears.radius, axis=1) & seen[:, by].T
            row, receiver = np.nonzero(touched)
            height = np.einsum("ni,ni->n", beams.centre[at[row]], normal[row]) - walls.offset[by[row]]
            image = beams.centre[at[row]] - 2.0 * height[:, None] * normal[row]
            of, index = spread(ears.first_plane, receiver * len(walls) + by[row])
            inside = np.einsum("ni,ni->n", image[of], ears.plane[index, :3]) - ears.plane[index, 3] >= -beams.radius
            leads = np.ones(len(row), dtype=bool)
            leads[of[np.flatnonzero(~inside)]] = False
            found[pair[row[leads]]] = True
        return found
