"""What a source emits as its tail hears it: in zones, and from where it is when it does."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.paths.arrivals import MACH_EXPONENT
from clsim.render.opencl.plane_waves import DeviceWaves
from clsim.tail.interpolation import NODE, Between, HostWaves, Motion
from clsim.tail.zones import is_static

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Floats
    from clsim.render.plan import Plan
    from clsim.scene.motion.motion import Motion as Way
    from clsim.tail.design import SourceTail
    from clsim.tail.interpolation import Waves

_HIGHEST = 0.42  # of the sampling rate, above which what is between samples fades
_SPARE = 1.2  # of the end of the band that holds 99 % of the energy, up to which it is exact
_FASTEST = 0.5  # of the speed of sound, up to which what is between samples is exact
_ROUNDS = 3  # of looking for the time of emission: each leaves the Mach number of the error


class SourceSignals:
    """Emissions of one source of a plan."""

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
        ways = [self._end.trajectory, *(receiver.trajectory for receiver in of_scene.scene.receivers)]
        fastest = max(map(_fastest, ways)) / self._air.speed_of_sound
        self.between = Between.up_to(highest, self._rate, min(fastest, _FASTEST))
        self._options = plan.options
        self._waves: Waves | None = None
        self._sent_before: dict[int, tuple[int, NDArray[Any]]] = {}

    @property
    def waves(self) -> Waves:
        """What sums streams, by the engine of the plan: made where something moves."""
        if self._waves is None:
            of_host = self._options.engine == "reference"
            self._waves = HostWaves(self.between) if of_host else DeviceWaves(self.between, self._options.device)
        return self._waves

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
        # Blocks and zones of receivers share a part; values do not depend on what is asked.
        begin, known = self._sent_before.get(zone, (first, np.empty((len(self.tail.departures), 0), np.float32)))
        kept = known[:, first - begin :] if begin <= first < begin + known.shape[1] <= last else known[:, :0]
        missing = first + kept.shape[1]
        sent = np.concatenate([kept, self._sent(zone, missing, last)], axis=1) if missing < last else kept
        self._sent_before[zone] = first, sent
        return np.asarray(sent[departures])

    def _sent(self, zone: int, first: int, last: int) -> NDArray[Any]:
        """Return what is sent in all directions (Q, n), ahead of a front from the zone's middle."""
        grid = np.arange(first // NODE, -(-last // NODE) + 1) * NODE
        low = first - self._margin
        emitted = self._emitted(low, last + self._margin).astype(np.float32)
        ahead, level = zip(*(self._sending(zone, direction, grid) for direction in self.tail.departures), strict=True)
        motion = Motion(np.stack(ahead)[:, :, None], np.stack(level)[:, :, None])
        return self.waves.heard(emitted[None], low, motion, first, last)

    def _sending(self, zone: int, direction: Floats, grid: NDArray[np.int64]) -> tuple[Floats, Floats]:
        """Return samples (N,) by which the source is ahead in a direction, and its level, at nodes (N,)."""
        times, zones, c = grid / self._rate, self.tail.zones, self._air.speed_of_sound
        ahead, reach = np.zeros(len(times)), zones.reach / c
        for _ in range(_ROUNDS):
            # Beyond its reach a zone sends nothing, and where is of no matter.
            place = self._end.trajectory.position(times + ahead) - zones.centres[zone]
            ahead = np.clip(place @ direction / c, -reach, reach)
        sent = times + ahead
        mach = self._end.trajectory.velocity(sent) @ direction / c
        level = zones.weights(self._end, sent)[zone] / (1.0 - mach) ** self._exponent
        return ahead * self._rate, level

    @property
    def _margin(self) -> int:
        """Samples by which what is sent in a zone may be ahead or behind, with what interpolation reads."""
        zones = self.tail.zones
        return math.ceil(zones.reach / self._air.speed_of_sound * self._rate) + self.between.half + 2 * NODE

    def _emitted(self, first: int, last: int) -> NDArray[Any]:
        begin = round(self._filters.start * self._rate)
        return self._filters.signal.read(first - begin, last - begin)


def _fastest(way: Way) -> float:
    """Return a bound of the speed, m/s."""
    return 0.0 if way.is_static else float(way.speed_over(np.array([-1e9]), np.array([1e9]))[0])
