"""The contribution of diffuse tails: streams from fixed directions, heard as plane waves where receivers are."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.render.contributions import Stateless
from clsim.render.tail_signals import SourceSignals
from clsim.tail.interpolation import NODE, Motion
from clsim.tail.noise import at_one_place, combined, gains_of, plane_waves, receiver_gains
from clsim.tail.streams import Streams
from clsim.tail.zones import is_static

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Floats
    from clsim.render.plan import Plan
    from clsim.scene.scene import Scene
    from clsim.tail.noise import Responses

_TOGETHER = 16384  # samples that moving receivers hear at a time
_RECEIVERS = 16  # of them at a time


def diffuse_tail(plan: Plan) -> DiffuseTail | None:
    """Return the contribution of a plan's tails; None if there is none."""
    return DiffuseTail(plan) if any(tail is not None for tail in plan.allocation.tails) else None


@dataclass(frozen=True, slots=True, eq=False)
class DiffuseTail:
    """The tails of all sources."""

    plan: Plan  # which has them

    @property
    def name(self) -> str:
        """Name of its kind."""
        return "diffuse tail"

    def describe(self) -> list[str]:
        """Return what each source's tail is."""
        return [
            f"source {i}: diffuse tail of {tail.describe()}; without it {tail.left_db:.1f} dB of the energy is missing"
            for i, tail in enumerate(self.plan.allocation.tails)
            if tail is not None
        ]

    def digest(self) -> str:
        """Return a text that changes with energies and seeds."""
        parts = ["" if tail is None else tail.digest() for tail in self.plan.allocation.tails]
        return hashlib.sha256(" ".join(parts).encode()).hexdigest()

    def begin(self) -> _Tail:
        """Return what adds it."""
        return _Tail(self.plan)


class _Tail(Stateless):
    """Adds tails; their responses are made when they are first heard."""

    def __init__(self, plan: Plan) -> None:
        self._plan = plan
        self._heard: list[_ZoneHeard] | None = None

    def add(self, pressure: NDArray[Any], start: int) -> None:
        """Add what is heard from sample `start` on to the pressure (receivers, n), Pa."""
        if self._heard is None:
            self._heard = [
                _ZoneHeard(self._plan, signals, zone)
                for source, tail in enumerate(self._plan.allocation.tails)
                if tail is not None
                for signals in [SourceSignals(self._plan, source, tail)]
                for zone in range(len(tail.receiver_zones))
            ]
        for heard in self._heard:
            heard.add(pressure, start)


class _ZoneHeard:
    """What is heard of one source in one zone of receivers."""

    def __init__(self, plan: Plan, signals: SourceSignals, zone: int) -> None:
        of_scene = plan.tracks.of_scene
        assert of_scene is not None, "tails are of scenes"
        self._scene: Scene = of_scene.scene
        self._rate, self._zone, self._signals, self._samples = plan.sampling_rate, zone, signals, plan.samples
        self._source, self._tail = signals.source, signals.tail
        centre = self._scene.sources[self._source].emitted.centre_frequency
        self._frequency = np.array([centre])
        there = [r for r in range(len(self._scene.receivers)) if not self._is_still(r) or self._is_here(r)]
        still = [r for r in there if self._is_still(r)]
        self._alone = still if len(there) == 1 else []
        self._combined = still if len(there) > 1 and not self._signals.moves else []
        self._moving = [r for r in there if r not in (*self._alone, *self._combined)]
        self._streams: dict[bool, Streams] = {}

    def add(self, pressure: NDArray[Any], start: int) -> None:
        """Add it from sample `start` on to the pressure (receivers, n)."""
        still = self._alone or self._combined
        if still:
            heard = self._of(waves=False).read(start, start + pressure.shape[1])
            if heard is not None:
                pressure[still] += heard
        for first in range(0, pressure.shape[1] if self._moving else 0, _TOGETHER):
            for group in range(0, len(self._moving), _RECEIVERS):
                self._add_moving(
                    pressure[:, first : first + _TOGETHER], self._moving[group : group + _RECEIVERS], start + first
                )

    def _add_moving(self, pressure: NDArray[Any], receivers: list[int], start: int) -> None:
        """Add what receivers hear of all streams from sample `start` on to the pressure (receivers, n)."""
        stop = start + pressure.shape[1]
        grid = np.arange(start // NODE, -(-stop // NODE) + 1) * NODE
        found = {r: motion_of for r in receivers if (motion_of := self._motion(r, grid)) is not None}
        if not found:
            return
        ahead, gains = zip(*found.values(), strict=True)
        motion = Motion(np.stack(ahead), np.stack(gains))
        (least, most), half = motion.reach, self._signals.between.half + 1
        first = start - NODE + least - half
        streams = self._of(waves=True).read(first, stop + NODE + most + half)
        if streams is not None:
            pressure[list(found)] += self._signals.waves.heard(streams, first, motion, start, stop)

    def _motion(self, receiver: int, grid: NDArray[np.int64]) -> tuple[Floats, Floats] | None:
        """Return the samples by which a receiver hears streams ahead, and their gains (N, M); None out of the zone."""
        end, clock = self._scene.receivers[receiver], grid / self._rate
        times = clock + end.clock_error(clock)
        zones, c = self._tail.receiver_zones, self._scene.air.speed_of_sound
        weight = zones.weights(end, times)[self._zone]
        if not np.any(weight):
            return None
        ahead = (end.trajectory.position(times) - zones.centres[self._zone]) @ self._tail.arrivals.T / c
        # Where the zone is not heard it does not matter where in it the receiver were.
        ahead = np.clip(ahead, -zones.reach / c, zones.reach / c) + (times - clock)[:, None]
        return ahead * self._rate, self._gains(receiver, times) * weight[:, None]

    def _gains(self, receiver: int, times: Floats) -> Floats:
        """Return the receiver's gains (T, M) by direction of arrival at times (T,), at the signal's centre."""
        gains = receiver_gains(self._scene, receiver, self._tail.arrivals, times, self._frequency)[:, :, 0]
        return np.broadcast_to(gains, (len(times), gains.shape[1]))

    def _of(self, *, waves: bool) -> Streams:
        """Return the streams of plane waves, or of what stands still."""
        if waves not in self._streams:
            count = len(self._tail.arrivals) if waves else len(self._alone or self._combined)
            longest, lead, make = self._longest(), 0, self._waves
            if not waves and self._alone:
                make = self._at_one_place
            elif not waves:
                made = self._combined_responses()
                longest, lead, make = made.taps.shape[1], made.lead, partial(_same, made)
            self._streams[waves] = Streams(
                self._signals, make, len(self._tail.zones), count, longest, self._samples, lead
            )
        return self._streams[waves]

    def _waves(self, zone: int) -> Responses:
        return plane_waves(self._tail, (zone, self._zone), self._source, self._rate, moves=self._signals.moves)

    def _at_one_place(self, zone: int) -> Responses:
        weights = np.square(gains_of(self._scene, self._alone, self._tail, 0.0)[0])
        key = zone, self._zone
        return at_one_place(self._tail, key, self._source, self._rate, weights, moves=self._signals.moves)

    def _combined_responses(self) -> Responses:
        places = [self._scene.receivers[r].trajectory.position(0.0) for r in self._combined]
        middle = self._tail.receiver_zones.centres[self._zone]
        late = -(np.array(places) - middle) @ self._tail.arrivals.T / self._scene.air.speed_of_sound
        gains = gains_of(self._scene, self._combined, self._tail, 0.0)
        zone = int(np.argmax(self._tail.zones.weights(self._scene.sources[self._source], np.zeros(1))[:, 0]))
        return combined(self._waves(zone), late, gains, self._tail.centres, self._rate)

    def _longest(self) -> int:
        steps = max(len(pair.energy) for key, pair in self._tail.pairs.items() if key[1] == self._zone)
        return int(np.ceil(steps * self._tail.time_step * self._rate))

    def _is_still(self, receiver: int) -> bool:
        end = self._scene.receivers[receiver]
        return is_static(end, turning=True) and end.clock_rate == 1.0 and not np.any(end.clock_error(np.zeros(1)))

    def _is_here(self, receiver: int) -> bool:
        return bool(self._tail.receiver_zones.weights(self._scene.receivers[receiver], np.zeros(1))[self._zone, 0])


def _same(responses: Responses, zone: int) -> Responses:
    """Return the responses of the only zone."""
    return responses
