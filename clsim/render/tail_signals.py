"""What a source emits as its tail hears it: in zones, and from where it is when it does."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.paths.arrivals import MACH_EXPONENT
from clsim.tail.interpolation import Between
from clsim.tail.zones import is_static

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Floats
    from clsim.render.plan import Plan
    from clsim.tail.design import SourceTail

NODE = 32  # samples between places where motion is looked at
_ROUNDS = 3  # of looking for the time of emission: each leaves the Mach number of the error


class SourceSignals:
    """Emissions of one source of a plan.

    Parameters
    ----------
    plan : Plan
        Of the rendering.
    source : int
        Which one.
    tail : SourceTail
        Its tail.
    """

    def __init__(self, plan: Plan, source: int, tail: SourceTail) -> None:
        of_scene = plan.tracks.of_scene
        assert of_scene is not None, "tails are of scenes"
        self._filters, self._tail = plan.source_filters[source], tail
        self._end, self._air = of_scene.scene.sources[source], of_scene.scene.air
        self._exponent = MACH_EXPONENT[plan.options.amplitude]
        self._rate = plan.sampling_rate
        self.moves = not is_static(self._end, turning=tail.zones.beams)
        self.between = Between.up_to(self._filters.band, self._rate)

    def sounds(self, zone: int, first: int, last: int) -> bool:
        """Return whether a zone sends anything from sample `first` to `last`."""
        margin = self._margin if self.moves else 0
        if not np.any(self._emitted(first - margin, last + margin)):
            return False
        nodes = np.arange(first - margin, last + margin + NODE, NODE)
        return bool(np.any(self._tail.zones.weights(self._end, nodes / self._rate)[zone]))

    def read(self, zone: int, departures: NDArray[np.int64], first: int, last: int) -> NDArray[Any]:
        """Return samples `first` to `last` of what a zone sends in directions (Q, n), Pa at 1 m."""
        if not self.moves:
            return self._emitted(first, last)[None]
        grid = np.arange(first // NODE, -(-last // NODE) + 1) * NODE
        samples = np.arange(first, last)
        low, high = first - self._margin, last + self._margin
        emitted = self._emitted(low, high)
        return np.stack([self._sent(zone, q, grid, samples, emitted, low) for q in departures])

    def _sent(
        self, zone: int, departure: int, grid: NDArray[np.int64], samples: NDArray[np.int64], emitted: Floats, low: int
    ) -> NDArray[Any]:
        """Return what is sent in one direction: ahead of a front from the zone's middle by where the source is."""
        times, zones, c = grid / self._rate, self._tail.zones, self._air.speed_of_sound
        direction = self._tail.departures[departure]
        sent = times
        for _ in range(_ROUNDS):
            sent = times + (self._end.trajectory.position(sent) - zones.centres[zone]) @ direction / c
        mach = self._end.trajectory.velocity(sent) @ direction / c
        level = zones.weights(self._end, sent)[zone] / (1.0 - mach) ** self._exponent
        # Beyond its reach a zone sends nothing, and where is of no matter.
        places = np.where(level > 0.0, sent, times) * self._rate - low
        places = np.clip(places, self.between.half, len(emitted) - self.between.half - 1)
        heard = self.between.at(emitted, np.interp(samples, grid, places))
        return np.asarray(heard * np.interp(samples, grid, level))

    @property
    def _margin(self) -> int:
        """Samples by which what is sent in a zone may be ahead or behind, with what interpolation reads."""
        zones = self._tail.zones
        far = 1.5 * zones.radius + NODE / self._rate * self._air.speed_of_sound
        return math.ceil(far / self._air.speed_of_sound * self._rate) + self.between.half + NODE

    def _emitted(self, first: int, last: int) -> NDArray[Any]:
        begin = round(self._filters.start * self._rate)
        return self._filters.emitted(first - begin, last - begin)
