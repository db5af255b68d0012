"""Wall sequences that a source may be heard by, from one tree of beams: none is missing, some are never heard."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from clsim.paths.specular.beams import BEHIND, beam_planes, clip_rings

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from clsim.arrays import Floats
    from clsim.paths.trajectory_tables import BoundingSpheres
    from clsim.scene.room.walls import Walls

_PAIRS = 200_000  # of beam and next wall looked at at a time
_SLACK = 1e-7  # of the room's size, added to spheres against rounding


@dataclass(frozen=True, slots=True, eq=False)
class Candidates:
    """Sequences of one length, and the receivers that each may reach.

    Attributes
    ----------
    sequence : ndarray (n, order) int32
        Walls from the source's side.
    row, receiver : ndarray (m,) int
        Pairs of a row of `sequence` and a receiver.
    """

    sequence: NDArray[np.int32]
    row: NDArray[np.int64]
    receiver: NDArray[np.int64]

    @staticmethod
    def joined(parts: list[Candidates]) -> Candidates:
        """Return the candidates of several parts of one order."""
        first = np.cumsum([0, *(len(p.sequence) for p in parts[:-1])])
        return Candidates(
            np.concatenate([p.sequence for p in parts]),
            np.concatenate([p.row + f for p, f in zip(parts, first, strict=True)]),
            np.concatenate([p.receiver for p in parts]),
        )


@dataclass(frozen=True, slots=True, eq=False)
class _Beams:
    """Beams after the same number of reflections: image of the sphere, aperture on the last wall, sequence."""

    centre: Floats
    ring: Floats
    corners: NDArray[np.int64]
    sequence: NDArray[np.int32]

    def part(self, which: slice | NDArray[np.int64]) -> _Beams:
        return _Beams(self.centre[which], self.ring[which], self.corners[which], self.sequence[which])


class BeamTree:
    """All sequences up to an order from a sphere to receivers.

    Parameters
    ----------
    walls : Walls
        The room.
    centre, radius : ndarray (3,), float
        Sphere that holds the source, m.
    receivers : BoundingSpheres
        Where the receivers are.
    limit : int
        Beams after which the search is given up.

    Attributes
    ----------
    beams : int
        Beams looked at so far.
    share : float
        Of the work that is done, 0 to 1, estimated.
    """

    def __init__(self, walls: Walls, centre: Floats, radius: float, receivers: BoundingSpheres, limit: int) -> None:
        self._walls, self._receivers, self._limit = walls, receivers, limit
        self._centre, self._radius = centre, radius + _SLACK * walls.size
        widths = np.diff(walls.first_hull)
        fill = np.minimum(np.arange(widths.max()), widths[:, None] - 1)
        self._hulls, self._widths = walls.hull[walls.first_hull[:-1, None] + fill], widths
        self.beams = 0
        self.share = 0.0

    def candidates(self, max_order: int) -> Iterator[Candidates]:
        """Yield candidates batch by batch; depth first, so that little is held at a time.

        Raises
        ------
        TooManyBeamsError
            If there are more than the limit.
        """
        walls = self._walls
        everyone = np.arange(len(self._receivers.radius))
        yield Candidates(np.empty((1, 0), np.int32), np.zeros(len(everyone), np.int64), everyone)
        if max_order == 0:
            return
        step = max(1, _PAIRS // (32 * len(walls)))
        first = self._first()
        pieces = [slice(i, i + step) for i in range(0, len(walls), step)]
        stack = [(first.part(piece), 1.0 / len(pieces)) for piece in reversed(pieces)]
        while stack:
            beams, share = stack.pop()
            self.beams += len(beams.corners)
            if self.beams > self._limit:
                raise TooManyBeamsError(f"must give at most {self._limit} beams, but {max_order} gives more; lower it")
            planes = self._planes(beams)
            yield self._reached(beams, planes)
            if beams.sequence.shape[1] == max_order:
                self.share += share
                continue
            children = self._reflected(beams, planes)
            most = max(1, _PAIRS // len(walls))
            count = -(-len(children.corners) // most)
            if not count:
                self.share += share
            for i in reversed(range(count)):
                stack.append((children.part(slice(i * most, (i + 1) * most)), share / count))

    def estimate(self, max_order: int) -> float:
        """Return about how many beams the tree up to an order has, from samples of its first levels."""
        total, count, growth, beams = 1.0, float(len(self._walls)), 1.0, self._first()
        for level in range(1, max_order + 1):
            total += count
            if level < 4 and len(beams.corners):
                beams = beams.part(np.linspace(0, len(beams.corners) - 1, min(64, len(beams.corners))).astype(np.int64))
                children = self._reflected(beams, self._planes(beams))
                growth, beams = len(children.corners) / len(beams.corners), children
            count *= growth
        return total

    def _first(self) -> _Beams:
        """Return the beams after one reflection."""
        walls = self._walls
        sequence = np.arange(len(walls), dtype=np.int32)[:, None]
        centre = self._mirrored(np.broadcast_to(self._centre, (len(walls), 3)), sequence[:, 0])
        return _Beams(centre, self._hulls, self._widths, sequence)

    def _mirrored(self, points: Floats, wall: NDArray[np.int32]) -> Floats:
        normal, offset = self._walls.normal[wall], self._walls.offset[wall]
        height = np.einsum("ni,ni->n", points, normal) - offset
        return np.asarray(points - 2.0 * height[:, None] * normal)

    def _planes(self, beams: _Beams) -> Floats:
        normal = self._walls.normal[beams.sequence[:, -1]]
        return beam_planes(beams.centre, self._radius, beams.ring, beams.corners, normal, self._walls.size)

    def _reached(self, beams: _Beams, planes: Floats) -> Candidates:
        """Return the beams as candidates for those receivers whose spheres they touch."""
        spheres = self._receivers
        height = np.einsum("npi,ri->nrp", planes[..., :3], spheres.centre) - planes[:, None, :, 3]
        radius = spheres.radius + _SLACK * self._walls.size
        row, receiver = np.nonzero(np.all(height >= -radius[None, :, None], axis=2))
        return Candidates(beams.sequence, row, receiver)

    def _reflected(self, beams: _Beams, planes: Floats) -> _Beams:
        """Return the beams after one more reflection, on every wall that they may meet."""
        walls = self._walls
        height = planes[..., :3] @ walls.centre.T - planes[..., 3:]  # (n, planes, W)
        meets = np.all(height >= -walls.radius, axis=1)
        meets &= walls.plane[beams.sequence[:, -1], None] != walls.plane
        beam, wall = np.nonzero(meets)
        if len(beam):  # the hull's corners: all of them outside one plane
            height = np.einsum("npi,nmi->npm", planes[beam, :, :3], self._hulls[wall]) - planes[beam, :, 3:]
            least = np.zeros(planes.shape[1])
            least[-1] = 2.0 * BEHIND * walls.size  # walls that touch the last one from its other side
            meets = np.all(height.max(axis=2) > least, axis=1)
            beam, wall = beam[meets], wall[meets]
        ring, corners = clip_rings(self._hulls[wall], self._widths[wall], planes[beam])
        left = np.flatnonzero(corners >= 3)
        ring, corners, beam, next_wall = ring[left], corners[left], beam[left], wall[left].astype(np.int32)
        ring = ring[:, : int(corners.max(initial=1))]
        sequence = np.concatenate([beams.sequence[beam], next_wall[:, None]], axis=1)
        return _Beams(self._mirrored(beams.centre[beam], next_wall), ring, corners, sequence)


class TooManyBeamsError(Exception):
    """The tree has more beams than its limit."""
