"""Diffuse tails: plane waves from fixed directions, their sum on a device, and the source signals that excite them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Floats
from clsim.errors import DeviceError
from clsim.numerics.blas import with_blas_threads
from clsim.opencl.device import find_device
from clsim.opencl.launch import Scratch, compiler_of, upload, work
from clsim.render.contributions import Stateless, digest_of
from clsim.render.opencl.batches import CPU_LAYOUT, GPU_LAYOUT
from clsim.render.plan import Plan
from clsim.scene.directivity.directivity import ChannelDirectivity
from clsim.scene.scene import Scene
from clsim.tail import noise
from clsim.tail.design import SourceTail
from clsim.tail.streams import NEIGHBOURS, NODE, Between, Blocks, HostWaves, Motion, Streams, Waves, ears_among
from clsim.tail.zones import Crossings, fastest, is_static

_TOGETHER = 16384  # samples that moving receivers hear at a time
_RECEIVERS = 16  # of them at a time


@dataclass(frozen=True, slots=True, eq=False)
class DiffuseTail:
    """The tails of all sources."""

    plan: Plan  # which has them
    name: ClassVar[str] = "diffuse tail"

    def describe(self) -> list[str]:
        return [
            f"source {i}: diffuse tail of {tail.describe()}; without it {tail.left_db:.1f} dB of the energy is missing"
            for i, tail in enumerate(self.plan.allocation.tails)
            if tail is not None
        ]

    def digest(self) -> str:
        return digest_of(" ".join("" if tail is None else tail.digest() for tail in self.plan.allocation.tails))

    def begin(self) -> _Tail:
        return _Tail(self.plan)


class _Tail(Stateless):
    """Adds tails; their responses are computed at the first use."""

    def __init__(self, plan: Plan) -> None:
        self._plan = plan
        self._received: list[_ZoneTail] | None = None

    def add(self, pressure: NDArray[Any], start: int) -> None:
        if self._received is None:
            self._received = [
                _ZoneTail(self._plan, signals, zone)
                for source, tail in enumerate(self._plan.allocation.tails)
                if tail is not None
                for signals in [SourceSignals(self._plan, source, tail)]
                for zone in range(len(tail.receiver_zones))
            ]
        held = 0
        for received in self._received:
            received.add(pressure, start)
            for streams in received.streams.values():
                held = streams.kept_within(held)
        for received in self._received:
            received.signals.crossings.forget()


class _ZoneTail:
    """Tail of one source in one zone of receivers."""

    def __init__(self, plan: Plan, signals: SourceSignals, zone: int) -> None:
        of_scene = plan.tracks.of_scene
        assert of_scene is not None, "tails are of scenes"
        self._scene: Scene = of_scene.paths.scene
        self._rate, self._zone, self.signals = plan.sampling_rate, zone, signals
        self._samples = plan.samples
        self._source, self._tail = signals.source, signals.tail
        self._frequency = np.array([self._scene.sources[self._source].emitted.centre_frequency])
        there = [r for r in range(len(self._scene.receivers)) if not self._is_still(r) or self._is_here(r)]
        still = [r for r in there if self._is_still(r)]
        several = [r for r in there if isinstance(self._scene.receivers[r].directivity, ChannelDirectivity)]
        self._alone = still if len(there) == 1 and not several else []
        self._combined = still if not self._alone and not self.signals.moves else []
        self._moving = [r for r in there if r not in (*self._alone, *self._combined)]
        first = plan.first_rows.tolist()
        self._rows = {r: range(first[r], first[r + 1]) for r in there}
        self.streams: dict[bool, Streams] = {}
        with with_blas_threads(1):
            self._ears = ears_among(self._scene, self._moving, self._rate, self.signals.highest)
        self._blocks: dict[int, Blocks] = {}

    def add(self, pressure: NDArray[Any], start: int) -> None:
        still = self._alone or self._combined
        if still:
            received = self._of(waves=False).read(start, start + pressure.shape[1])
            if received is not None:
                pressure[[row for r in still for row in self._rows[r]]] += received
        for first in range(0, pressure.shape[1] if self._moving else 0, _TOGETHER):
            some = pressure[:, first : first + _TOGETHER]
            grid = _grid(start + first, start + first + some.shape[1])
            crossed = self.signals.crossings.weights
            plain = [r for r in self._moving if r not in self._ears and self._zone in crossed(r, grid)]
            for group in range(0, len(plain), _RECEIVERS):
                self._add_moving(some, plain[group : group + _RECEIVERS], start + first)
            for head, filters in self._ears.items():
                kept, made = self._blocks.setdefault(head, {}), partial(self._block, head)
                some[self._rows[head]] += filters.joined(made, kept, start + first, some.shape[1])

    def _add_moving(self, pressure: NDArray[Any], receivers: list[int], start: int) -> None:
        """Add all streams at moving receivers from sample `start` on to the pressure (receivers, n)."""
        stop = start + pressure.shape[1]
        found = {
            row: motion
            for r in receivers
            for row, motion in zip(self._rows[r], self._motions(r, _grid(start, stop)), strict=False)
        }
        if not found:
            return
        ahead, gains = zip(*found.values(), strict=True)
        received = self._summed(Motion(np.stack(ahead), np.stack(gains)), start, stop)
        if received is not None:
            pressure[list(found)] += received

    def _block(self, receiver: int, k: int) -> NDArray[np.float32] | None:
        """Return block k of all streams at a head's ears, (channels, n); None where it is silent."""
        filters = self._ears[receiver]
        start, stop = k * filters.block, (k + 1) * filters.block
        towards = self._approach(receiver, _grid(start, stop))
        if towards is None:
            return None
        times = self.signals.crossings.times(receiver, filters.instants(k))
        directions = noise.own_directions(self._scene.receivers[receiver], self._tail.arrivals, times)
        ahead = self._rate * (towards[0] - filters.lateness(directions)).swapaxes(1, 2)
        # A listener for each wave at each ear: filters are shared by waves that have arrived there.
        ahead = ahead.reshape(-1, ahead.shape[2], 1)
        waves = self._summed(Motion(ahead, np.broadcast_to(towards[1][:, None], ahead.shape)), start, stop)
        if waves is None:
            return None
        with with_blas_threads(1):
            return filters.filtered(waves.reshape(-1, directions.shape[1], stop - start), directions)

    def _summed(self, motion: Motion, start: int, stop: int) -> NDArray[np.float32] | None:
        """Return the sum (rows, n) of streams by motion from sample `start` to `stop`; None where it is silent."""
        (least, most), half = motion.reach, self.signals.between.half + 1
        first = start - NODE + least - half
        streams = self._of(waves=True).read(first, stop + NODE + most + half)
        return None if streams is None else self.signals.waves.received(streams, first, motion, start, stop)

    def _motions(self, receiver: int, grid: NDArray[np.int64]) -> list[tuple[Floats, Floats]]:
        """Return the advance of streams, samples, and gains (N, M) by row of a receiver; none out of the zone."""
        towards = self._approach(receiver, grid)
        if towards is None:
            return []
        times = self.signals.crossings.times(receiver, grid)
        by_row = noise.row_gains(self._scene, receiver, self._tail.arrivals, times, self._frequency)
        return [(towards[0] * self._rate, gains * towards[1][:, None]) for gains in by_row]

    def _approach(self, receiver: int, grid: NDArray[np.int64]) -> tuple[Floats, Floats] | None:
        """Return the advance of streams (N, M), s, and the zone's weight (N,) at a receiver; None out of the zone."""
        end, zones, c = self._scene.receivers[receiver], self._tail.receiver_zones, self._scene.air.speed_of_sound
        weight = self.signals.crossings.weights(receiver, grid).get(self._zone)
        if weight is None:
            return None
        clock, times = self.signals.crossings.clock(grid), self.signals.crossings.times(receiver, grid)
        ahead = (end.trajectory.position(times) - zones.centres[self._zone]) @ self._tail.arrivals.T / c
        # Where the zone is not heard it does not matter where in it the receiver were.
        return np.clip(ahead, -zones.reach / c, zones.reach / c) + (times - clock)[:, None], weight

    def _of(self, *, waves: bool) -> Streams:
        """Return the streams of plane waves, or of what stands still."""
        if waves not in self.streams:
            count = (
                len(self._tail.arrivals) if waves else sum(len(self._rows[r]) for r in self._alone or self._combined)
            )
            longest, lead, make = self._longest(), 0, self._waves
            if not waves and self._alone:
                make = self._at_one_place
            elif not waves:
                made = self._combined_responses()
                longest, lead, make = made.taps.shape[1], made.lead, lambda zone: made
            self.streams[waves] = Streams(
                self.signals, make, len(self._tail.zones), count, longest, self._samples, lead
            )
        return self.streams[waves]

    def _waves(self, zone: int) -> noise.Responses:
        return noise.plane_waves(self._tail, (zone, self._zone), self._source, self._rate, moves=self.signals.moves)

    def _at_one_place(self, zone: int) -> noise.Responses:
        weights = np.square(noise.gains_of(self._scene, self._alone, self._tail, 0.0)[0])
        return noise.at_one_place(
            self._tail, (zone, self._zone), self._source, self._rate, weights, moves=self.signals.moves
        )

    def _combined_responses(self) -> noise.Responses:
        places = [self._scene.receivers[r].trajectory.position(0.0) for r in self._combined for _ in self._rows[r]]
        middle = self._tail.receiver_zones.centres[self._zone]
        late = -(np.array(places) - middle) @ self._tail.arrivals.T / self._scene.air.speed_of_sound
        gains = noise.static_gains(self._scene, self._combined, self._tail, 0.0, self._rate)
        zone = int(np.argmax(self._tail.zones.weights(self._scene.sources[self._source], np.zeros(1))[:, 0]))
        return noise.combined(self._waves(zone), late, gains, self._tail.centres, self._rate)

    def _longest(self) -> int:
        steps = max(len(pair.energy) for key, pair in self._tail.pairs.items() if key[1] == self._zone)
        return int(np.ceil(steps * self._tail.time_step * self._rate))

    def _is_still(self, receiver: int) -> bool:
        end = self._scene.receivers[receiver]
        return is_static(end, turning=True) and end.clock_rate == 1.0 and not np.any(end.clock_error(np.zeros(1)))

    def _is_here(self, receiver: int) -> bool:
        return self._zone in self.signals.crossings.weights(receiver, np.zeros(1, np.int64))


def _grid(start: int, stop: int) -> NDArray[np.int64]:
    """Return the samples of the nodes from that of `start` to the one that is not before `stop`."""
    return np.arange(start // NODE, -(-stop // NODE) + 1) * NODE


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
        self._end, self._air = of_scene.paths.scene.sources[source], of_scene.paths.scene.air
        self._exponent = of_scene.kinematics.exponent
        self._rate = plan.sampling_rate
        self.moves = not is_static(self._end, turning=tail.zones.beams)
        highest = self.highest = min(_SPARE * self._end.emitted.band()[1], _HIGHEST * self._rate)
        trajectories = [self._end.trajectory, *(receiver.trajectory for receiver in of_scene.paths.scene.receivers)]
        speed = max(map(fastest, trajectories)) / self._air.speed_of_sound
        self.between = Between.up_to(highest, self._rate, min(speed, _FASTEST))
        self._options = plan.options
        self.crossings = Crossings(tail.receiver_zones, of_scene.paths.scene.receivers, self._rate, plan.samples + NODE)
        self._waves: Waves | None = None
        self._sent_before: dict[int, tuple[int, NDArray[Any]]] = {}
        self._read_before: tuple[int, NDArray[Any]] = (0, np.empty(0))

    @property
    def waves(self) -> Waves:
        """Sum of streams by the plan's engine, made when something moves."""
        if self._waves is None:
            of_host = self._options.engine == "reference"
            self._waves = HostWaves(self.between) if of_host else DeviceWaves(self.between, self._options.device)
        return self._waves

    def sounds(self, zone: int, first: int, last: int) -> bool:
        """Test whether a zone emits between samples `first` and `last`."""
        margin = self._margin if self.moves else 0
        times = np.arange(first - margin, last + margin + NODE, NODE) / self._rate
        emits = np.any(self._emitted(first - margin, last + margin))
        return bool(emits and np.any(self.tail.zones.weights(self._end, times)[zone]))

    def read(self, zone: int, departures: NDArray[np.int64], first: int, last: int) -> NDArray[Any]:
        """Return samples `first` to `last` of a zone's emission in directions (Q, n), Pa at 1 m."""
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
        """Return the signals in all directions (Q, n), relative to a wave front from the zone's middle."""
        sent, grid = np.zeros((len(self.tail.departures), last - first), np.float32), _grid(first, last)
        near = self._near(zone, grid)
        if near.any():  # beyond the nodes next to these all is silence
            part = slice(max(int(near.argmax()) - 1, 0), len(near) - int(near[::-1].argmax()) + 1)
            grid, near = grid[part], near[part]
            begin, end = max(first, int(grid[0])), min(last, int(grid[-1]))
            emitted = self._emitted(begin - self._margin, end + self._margin).astype(np.float32)
            ahead, level = np.zeros((2, len(sent), len(grid), 1))
            ahead[:, near, 0], level[:, near, 0] = self._sending(zone, grid[near])
            made = self.waves.received(emitted[None], begin - self._margin, Motion(ahead, level), begin, end)
            sent[:, begin - first : end - first] = made
        return sent

    def _near(self, zone: int, grid: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Mask (N,) of nodes at and next to which a zone may be heard in some direction."""
        reach, c = self.tail.zones.reach, self._air.speed_of_sound
        place = self._end.trajectory.position(grid / self._rate) - self.tail.zones.centres[zone]
        moved = fastest(self._end.trajectory) * (reach / c + 2.0 * NODE / self._rate)
        return np.asarray(np.linalg.norm(place, axis=1) <= reach + moved)

    def _sending(self, zone: int, grid: NDArray[np.int64]) -> tuple[Floats, Floats]:
        """Return samples (Q, N) by which the source is ahead in all directions, and its level, at nodes (N,)."""
        times, zones, c = grid / self._rate, self.tail.zones, self._air.speed_of_sound
        directions, reach = self.tail.departures, zones.reach / c
        ahead = np.zeros((len(directions), len(times)))

        def along(vectors: Floats) -> Floats:
            """Return parts (Q, N) of vectors (Q N, 3) in the directions."""
            return np.asarray(np.einsum("qni,qi->qn", vectors.reshape(*ahead.shape, 3), directions))

        for _ in range(_ROUNDS):
            # Beyond its reach a zone sends nothing, and where is of no matter.
            place = self._end.trajectory.position((times + ahead).ravel()) - zones.centres[zone]
            ahead = np.clip(along(place) / c, -reach, reach)
        sent = (times + ahead).ravel()
        mach = along(self._end.trajectory.velocity(sent)) / c
        weight = zones.weights(self._end, sent)[zone].reshape(ahead.shape)
        return ahead * self._rate, weight / (1.0 - mach) ** self._exponent

    @property
    def _margin(self) -> int:
        """Samples by which what is sent in a zone may be ahead or behind, with what interpolation reads."""
        return math.ceil(self.tail.zones.reach / self._air.speed_of_sound * self._rate) + self.between.half + 2 * NODE

    def _emitted(self, first: int, last: int) -> NDArray[Any]:
        """Return samples of the signal; the last stretch is kept, of which all zones read parts."""
        begin, known = self._read_before
        if not begin <= first <= last <= begin + len(known):
            at = round(self._filters.start * self._rate)
            begin, known = self._read_before = first, self._filters.signal.read(first - at, last - at)
        return known[first - begin : last - begin]


assert CPU_LAYOUT.lanes <= NEIGHBOURS


class DeviceWaves:
    """Sums streams on an OpenCL device; `HostWaves` is its twin."""

    def __init__(self, between: Between, device: str | None, lanes: int | None = None) -> None:
        import pyopencl as cl

        self._info, found = find_device(device)
        compiler = compiler_of(found)
        self._queue, self._scratch = cl.CommandQueue(compiler.context), Scratch(compiler.context)
        self._lanes = lanes or (GPU_LAYOUT if self._info.kind == "GPU" else CPU_LAYOUT).lanes
        powers, taps = between.bank.shape
        constants = {"LANES": self._lanes, "NODE": NODE, "POWERS": powers, "TAPS": taps}
        self._kernel = compiler.kernel("plane_waves", constants)
        self._bank = upload(compiler.context, np.pad(between.bank.ravel(), (0, self._lanes)))

    def received(
        self, streams: NDArray[np.float32], first: int, motion: Motion, start: int, stop: int
    ) -> NDArray[np.float32]:
        """Return the pressure at listeners (R, n), see `Waves`."""
        import pyopencl as cl

        listeners, nodes, count = motion.ahead[:, :-1].shape
        begin = start // NODE * NODE
        whole = np.floor(motion.ahead[:, :-1])
        packed = np.empty((listeners, nodes, count, 4), np.float32)
        packed[..., 0] = motion.ahead[:, :-1] - whole
        packed[..., 1] = np.diff(motion.ahead, axis=1) / NODE
        packed[..., 2] = motion.gains[:, :-1]
        packed[..., 3] = np.diff(motion.gains, axis=1) / NODE
        received = np.empty((listeners, nodes * NODE), np.float32)
        try:
            out = self._scratch.take("received", received.nbytes)
            self._kernel(
                self._queue, work(nodes * NODE // self._lanes, listeners), streams=streams, count=count,
                total=len(streams), stride=streams.shape[1], lead=begin - first, whole=whole.astype(np.int32),
                motion=packed, nodes=nodes, bank=self._bank, received=out,
            )  # fmt: skip
            cl.enqueue_copy(self._queue, received, out)
        except cl.Error as error:
            raise DeviceError(f"{self._info.name} ran out of memory or failed ({error}) at a diffuse tail") from error
        return received[:, start - begin : stop - begin]
