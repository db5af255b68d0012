"""What all paths have in common whose ways become longer and shorter as bodies move."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from clsim.paths.family import PathFamily, ends_at
from clsim.paths.moving.mirrors import Mirrors
from clsim.paths.propagation import delay_bounds

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Floats
    from clsim.paths.family import Instant, PeakSpeeds, Rows


@dataclass(frozen=True, eq=False)
class MovingPaths(PathFamily):
    """Paths by things of which some belong to bodies."""

    @cached_property
    def mirrors(self) -> Mirrors:
        """Walls and faces."""
        return Mirrors.of(self.scene)

    @property
    def moves(self) -> bool:
        """Whether any body moves or turns."""
        return not all(body.is_static for body in self.scene.bodies)

    @cached_property
    @abstractmethod
    def speeds(self) -> Floats:
        """Sums (paths,) of the bounds of the speeds of the bodies on each path's way, m/s."""

    def lengths(self, rows: Rows, source: Floats, receiver: Floats) -> Floats:
        """Lengths of paths (P,) by bodies as they are at 0 s, with endpoints at places (P, 3), m."""
        return self._lengths(np.arange(len(self))[rows], source, receiver, 0.0)

    @abstractmethod
    def _lengths(self, index: NDArray[np.int64], source: Floats, receiver: Floats, times: Instant) -> Floats:
        """Return the same by bodies as they are at a time, or at times (P,)."""

    def _spare(self, index: NDArray[np.int64]) -> Floats:
        """Return half of by how much ways (P,) may be shorter than lengths are said to be, m."""
        return np.zeros(len(index))

    def delay_bounds(self, rows: Rows, start: Instant, end: Instant, speeds: PeakSpeeds) -> tuple[Floats, Floats]:
        """Return bounds (P,) on the delays of paths of any pairs between two times of reception, s.

        A mirror, an edge or a scatterer that moves by d makes a way longer by at most 2 d.
        """
        scene, index = self.scene, np.arange(len(self))[rows]
        source, receiver = self.source[index], self.receiver[index]
        middle, half = 0.5 * (start + end), 0.5 * (end - start)
        places = ends_at(scene.sources, source, middle), ends_at(scene.receivers, receiver, middle)
        emitting, spare = speeds.source[source] + 2.0 * self.speeds[index], self._spare(index)
        slack = half * (emitting + speeds.receiver[receiver]) + spare
        return delay_bounds(self.speed_range, self._lengths(index, *places, middle) - spare, slack, emitting)

    def max_rate(self, source_speed: float, receiver_speed: float) -> float:
        """Return a bound on how fast delays change with the time of reception, s/s, from the ends' speeds, m/s."""
        c, most = self.speed_range.slowest, float(self.speeds.max(initial=0.0))
        return (c + receiver_speed) * (c + most) / ((c - most) * (c - source_speed)) - 1.0
