"""Wall sequences that a source may be heard by, from one tree of beams: none is missing, some are never heard."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import ByRow, Floats, firsts
from clsim.paths.visibility import occlusion
from clsim.paths.visibility.intervals import BoundingSpheres, joined
from clsim.scene.room.walls import Walls

_BEAMS = 2_000  # looked at at a time
_PAIRS = 20_000  # of beam and next wall clipped at a time
_SLACK = 1e-7  # of the room's size, added to spheres against rounding


@dataclass(frozen=True, slots=True, eq=False)
class Candidates:
    """Sequences of one length, and the receivers that each may reach."""

    sequence: NDArray[np.int32]  # (n, order) walls from the source's side
    row: NDArray[np.int64]  # (m,) pairs of a row of `sequence` and a receiver
    receiver: NDArray[np.int64]  # likewise

    @staticmethod
    def joined(parts: list[Candidates]) -> Candidates:
        """Return the candidates of several parts of one order."""
        first = np.cumsum([0, *(len(p.sequence) for p in parts[:-1])])
        row = np.concatenate([p.row + f for p, f in zip(parts, first, strict=True)])
        return Candidates(np.concatenate([p.sequence for p in parts]), row, np.concatenate([p.receiver for p in parts]))


@dataclass(frozen=True, slots=True, eq=False)
class FoundPaths:
    """Paths of one source, sorted by receiver, order, walls and time."""

    receiver: NDArray[np.int64]  # (P,) which, and number of reflections
    order: NDArray[np.int64]  # likewise
    walls: NDArray[np.int32]  # (P, max_order) from the source's side, filled up with -1
    begin: Floats  # (P,) interval in which it is heard, s; infinite where it reaches an end of what matters
    end: Floats  # likewise
    met: NDArray[np.int32] | None = None  # (P, N) of walls and panels, see `divided`; None for walls alone

    @staticmethod
    def none(max_order: int) -> FoundPaths:
        """Return no paths."""
        no = np.empty(0, dtype=np.int64)
        return FoundPaths(no, no, np.empty((0, max_order), dtype=np.int32), np.empty(0), np.empty(0))

    @staticmethod
    def joined(parts: list[FoundPaths]) -> FoundPaths:
        """Return the paths of several parts."""
        names = ("receiver", "order", "walls", "begin", "end")
        return FoundPaths(*(np.concatenate([getattr(p, name) for p in parts]) for name in names))

    @staticmethod
    def of_cells(parts: list[FoundPaths], last: Floats) -> FoundPaths:
        """Join paths of all cells, intervals that touch included; sort by receiver, order, walls and time."""
        found = FoundPaths.joined(parts)
        first, until = joined([found.receiver, found.order, *found.walls.T], found.begin, found.end)
        begin, end, receiver = found.begin[first], found.end[until], found.receiver[first]
        begin = np.where(begin <= 0.0, -np.inf, begin)
        end = np.where(end >= last[receiver], np.inf, end)
        return FoundPaths(receiver, found.order[first], found.walls[first], begin, end)


@dataclass(frozen=True, slots=True, eq=False)
class _Beams(ByRow):
    """Beams after the same number of reflections: image of the sphere, aperture on the last wall, sequence."""

    centre: Floats
    ring: Floats
    corners: NDArray[np.int64]
    sequence: NDArray[np.int32]

    @staticmethod
    def joined(parts: list[_Beams]) -> _Beams:
        """Return the beams of several sets as one."""
        width = max(p.ring.shape[1] for p in parts)
        columns = [(p.centre, occlusion.widened(p.ring, width), p.corners, p.sequence) for p in parts]
        return _Beams(*(np.concatenate(each) for each in zip(*columns, strict=True)))


class BeamTree:
    """All sequences up to an order from a sphere to receivers: spheres, or the `ears` of another tree."""

    def __init__(
        self, walls: Walls, centre: Floats, radius: float, receivers: BoundingSpheres | occlusion.Ears, limit: int,
        sides: NDArray[np.int64] | None = None, lookup: occlusion.WallLookup | None = None, hides: bool = True,
    ) -> None:  # fmt: skip
        self._walls, self._limit, self._hides = walls, limit, hides
        self._lookup = lookup or occlusion.WallLookup(walls)
        self._centre, self._radius = centre, radius + _SLACK * walls.size
        # On which sides of walls paths can be, as from `air_sides`.
        self._sides = np.zeros(len(walls), dtype=np.int64) if sides is None else sides
        widths = np.diff(walls.first_hull)
        fill = np.minimum(np.arange(widths.max()), widths[:, None] - 1)
        self._hulls, self._widths = walls.hull[walls.first_hull[:-1, None] + fill], widths
        self.beams, self.share = 0, 0.0  # beams looked at so far; of the work that is done, estimated
        self.ears = receivers if isinstance(receivers, occlusion.Ears) else self._listening(receivers)

    def candidates(self, max_order: int) -> Iterator[Candidates]:
        """Yield candidates batch by batch; depth first, so that little is held at a time."""
        everyone = np.arange(len(self.ears.radius))
        yield Candidates(np.empty((1, 0), np.int32), np.zeros(len(everyone), np.int64), everyone)
        if max_order == 0:
            return
        first = self._first()
        pieces = range(0, len(first.corners), _BEAMS // 32)
        stack = [(first.part(slice(i, i + _BEAMS // 32)), 1.0 / len(pieces)) for i in reversed(pieces)]
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
            children = self._reflected(beams, planes, max_order - beams.sequence.shape[1])
            count = -(-len(children.corners) // _BEAMS)
            if not count:
                self.share += share
            for i in reversed(range(count)):
                stack.append((children.part(slice(i * _BEAMS, (i + 1) * _BEAMS)), share / count))

    def estimate(self, max_order: int) -> float:
        """Return about how many beams the tree up to an order has, from samples of its first levels."""
        total, growth, beams = 1.0, 1.0, self._first()
        count = float(len(beams.corners))
        for level in range(1, max_order):
            total += count
            if level < min(4, max_order - 1) and len(beams.corners):
                beams = beams.part(np.linspace(0, len(beams.corners) - 1, min(64, len(beams.corners))).astype(np.int64))
                children = self._reflected(beams, self._planes(beams), max_order - level)
                growth, beams = len(children.corners) / len(beams.corners), children
            count *= growth
        return total

    def _first(self) -> _Beams:
        """Return the beams after one reflection."""
        ring, corners = self._open(self._centre, self._radius)
        wall = np.flatnonzero(corners).astype(np.int32)
        centre = self._mirrored(np.broadcast_to(self._centre, (len(wall), 3)), wall)
        return _Beams(centre, ring[wall], corners[wall], wall[:, None])

    def _listening(self, receivers: BoundingSpheres) -> occlusion.Ears:
        """View of the receivers."""
        walls, planes = self._walls, [np.empty((0, 4))]
        radii = receivers.radius + _SLACK * walls.size
        count = np.zeros((len(radii), len(walls)), dtype=np.int64)
        for row, centre, radius in zip(count, receivers.centre, radii, strict=True):
            ring, corners = self._open(centre, radius)
            wall = np.flatnonzero(corners)
            centres = np.broadcast_to(centre, (len(wall), 3))
            some = occlusion.beam_planes(centres, radius, ring[wall], corners[wall], walls.normal[wall], walls.size)
            real = np.arange(ring.shape[1] + 1) < corners[wall, None]
            real[:, -1] = True  # the half-space behind the wall
            planes.append(some[real])
            row[wall] = corners[wall] + 1
        return occlusion.Ears(receivers.centre, radii, count > 0, np.concatenate(planes), firsts(count.ravel()))

    def _open(self, centre: Floats, radius: float) -> tuple[Floats, NDArray[np.int64]]:
        """Return the parts of all walls that no other one hides from a ball; see `open_parts`."""
        ring, corners = self._hulls, np.zeros_like(self._widths)
        some = np.flatnonzero(self._faces(np.broadcast_to(centre, (len(corners), 3)), radius, np.arange(len(corners))))
        if not self._hides:
            corners[some] = self._widths[some]
            return ring, corners
        centres, none = np.broadcast_to(centre, (len(some), 3)), np.full(len(some), -1)
        views = occlusion.Views(centres, radius, centres[:, None], none, self._hulls[some], self._widths[some], some)
        left, corners[some] = occlusion.open_parts(self._walls, views, self._lookup.crossings)
        ring = occlusion.widened(ring, left.shape[1])
        ring[some] = left
        return ring, corners

    def _faces(self, centre: Floats, radius: float, wall: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Mask of balls about places (n, 3) that reach to the side of walls (n,) that paths can be on."""
        height = np.einsum("ni,ni->n", centre, self._walls.normal[wall]) - self._walls.offset[wall]
        return np.asarray(self._sides[wall] * height >= -radius)

    def _mirrored(self, points: Floats, wall: NDArray[np.int32]) -> Floats:
        normal = self._walls.normal[wall]
        height = np.einsum("ni,ni->n", points, normal) - self._walls.offset[wall]
        return np.asarray(points - 2.0 * height[:, None] * normal)

    def _planes(self, beams: _Beams) -> Floats:
        normal = self._walls.normal[beams.sequence[:, -1]]
        return occlusion.beam_planes(beams.centre, self._radius, beams.ring, beams.corners, normal, self._walls.size)

    def _reached(self, beams: _Beams, planes: Floats) -> Candidates:
        """Return the beams as candidates for receivers whose spheres they touch, and that see their last walls."""
        ears = self.ears
        height = np.einsum("npi,ri->nrp", planes[..., :3], ears.centre) - planes[:, None, :, 3]
        touched = np.all(height >= -ears.radius[None, :, None], axis=2)
        row, receiver = np.nonzero(touched & ears.seen[:, beams.sequence[:, -1]].T)
        return Candidates(beams.sequence, row, receiver)

    def _reflected(self, beams: _Beams, planes: Floats, more: int) -> _Beams:
        """Return the beams after one more reflection: on walls that they may meet, at last: to a receiver."""
        cones = occlusion.Beams(planes, beams.centre, self._radius, beams.sequence[:, -1], _SLACK * self._walls.size)
        beam, wall = self._lookup.meetings(cones, self._sides, self.ears if more == 1 else None)
        pieces = [slice(i, i + _PAIRS) for i in range(0, max(len(beam), 1), _PAIRS)]
        return _Beams.joined([self._clipped(beams, planes, beam[piece], wall[piece], more > 2) for piece in pieces])

    def _clipped(
        self, beams: _Beams, planes: Floats, beam: NDArray[np.int64], wall: NDArray[np.int64], open_only: bool
    ) -> _Beams:
        """Return the parts of beams that walls (n,) reflect, all or what others do not hide."""
        walls = self._walls
        least = np.zeros(planes.shape[1])
        least[-1] = 2.0 * occlusion.BEHIND * walls.size  # walls that touch the last one from its other side
        height = np.einsum("npi,nmi->npm", planes[beam, :, :3], self._hulls[wall]) - planes[beam, :, 3:]
        meets = np.all(height.max(axis=2) > least, axis=1)  # all corners outside one plane: none
        beam, wall = beam[meets], wall[meets]
        ring, corners = occlusion.clip_rings(self._hulls[wall], self._widths[wall], planes[beam])
        left = np.flatnonzero(corners >= 3)
        ring, corners, beam, wall = ring[left, : int(corners.max(initial=1))], corners[left], beam[left], wall[left]
        if open_only and self._hides:
            before = beams.sequence[beam, -1]
            views = occlusion.Views(beams.centre[beam], self._radius, beams.ring[beam], before, ring, corners, wall)
            ring, corners = occlusion.open_parts(walls, views, self._lookup.crossings)
        left = np.flatnonzero(corners)
        next_wall = wall[left].astype(np.int32)
        sequence = np.concatenate([beams.sequence[beam[left]], next_wall[:, None]], axis=1)
        return _Beams(self._mirrored(beams.centre[beam[left]], next_wall), ring[left], corners[left], sequence)


class TooManyBeamsError(Exception):
    """The tree has more beams than its limit."""
