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

    from clsim.render.plan import Plan
    from clsim.tail.design import SourceTail

NODE = 32  # samples between places where motion is looked at
_HIGHEST = 0.42  # of the sampling rate, above which what is between samples fades
_SPARE = 1.2  # of the end of the band that holds 99 % of the energy, up to which it is exact
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
        self.source, self.tail = source, tail
        self._filters = plan.source_filters[source]
        self._end, self._air = of_scene.scene.sources[source], of_scene.scene.air
        self._exponent = MACH_EXPONENT[plan.options.amplitude]
        self._rate = plan.sampling_rate
        self.moves = not is_static(self._end, turning=tail.zones.beams)
        highest = min(_SPARE * self._end.emitted.band()[1], _HIGHEST * self._rate)
        self.between = Between.up_to(highest, self._rate)
        self._sent_before: dict[tuple[int, int], tuple[int, NDArray[Any]]] = {}

    def sounds(self, zone: int, first: int, last: int) -> bool:
        """Return whether a zone sends anything from sample `first` to `last`."""
        margin = self._margin if self.moves else 0
        if not np.any(self._emitted(first - margin, last + margin)):
            return False
        nodes = np.arange(first - margin, last + margin + NODE, NODE)
        return bool(np.any(self.tail.zones.weights(self._end, nodes / self._rate)[zone]))

    def read(self, zone: int, departures: NDArray[np.int64], first: int, last: int) -> NDArray[Any]:
        """Return samples `first` to `last` of what a zone sends in directions (Q, n), Pa at 1 m."""
        if not self.moves:
            return self._emitted(first, last)[None]
        return np.stack([self._remembered(zone, int(q), first, last) for q in departures])

    def _remembered(self, zone: int, departure: int, first: int, last: int) -> NDArray[Any]:
        """Return what is sent in one direction, of which blocks share a part; values do not depend on what is asked."""
        begin, known = self._sent_before.get((zone, departure), (first, np.empty(0)))
        end = begin + len(known)
        kept = known[first - begin :] if begin <= first < end <= last else known[:0]
        made = self._sent(zone, departure, first + len(kept), last) if first + len(kept) < last else known[:0]
        sent = np.concatenate([kept, made])
        self._sent_before[zone, departure] = first, sent
        return sent

    def _sent(self, zone: int, departure: int, first: int, last: int) -> NDArray[Any]:
        """Return what is sent in one direction: ahead of a front from the zone's middle by where the source is."""
        grid = np.arange(first // NODE, -(-last // NODE) + 1) * NODE
        low = first - self._margin
        emitted = self._emitted(low, last + self._margin).astype(np.float32)
        times, zones, c = grid / self._rate, self.tail.zones, self._air.speed_of_sound
        direction = self.tail.departures[departure]
        sent = times
        for _ in range(_ROUNDS):
            sent = times + (self._end.trajectory.position(sent) - zones.centres[zone]) @ direction / c
        mach = self._end.trajectory.velocity(sent) @ direction / c
        level = zones.weights(self._end, sent)[zone] / (1.0 - mach) ** self._exponent
        # Beyond its reach a zone sends nothing, and where is of no matter.
        places = np.where(level > 0.0, sent, times) * self._rate
        samples = np.arange(first, last)
        heard = self.between.at(emitted, np.interp(samples, grid, places) - low)
        return np.asarray(heard * np.interp(samples, grid, level))

    @property
    def _margin(self) -> int:
        """Samples by which what is sent in a zone may be ahead or behind, with what interpolation reads."""
        zones = self.tail.zones
        far = 1.5 * zones.radius + NODE / self._rate * self._air.speed_of_sound
        return math.ceil(far / self._air.speed_of_sound * self._rate) + self.between.half + NODE

    def _emitted(self, first: int, last: int) -> NDArray[Any]:
        begin = round(self._filters.start * self._rate)
        return self._filters.signal.read(first - begin, last - begin)
