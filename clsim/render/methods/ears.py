"""Receivers whose channels differ over frequency: the sound of each path at the centre, through responses that turn."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from itertools import product
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Floats
from clsim.numerics.blas import with_blas_threads
from clsim.paths.family import PairPaths
from clsim.paths.response import to_transducer_frame
from clsim.render.contributions import Stateless, digest_of
from clsim.render.methods import sampled_channel
from clsim.render.methods.channel_split import cuts
from clsim.render.methods.ear_channel import EarChannelEngine
from clsim.render.methods.ear_components import Heads, may_be_cheaper
from clsim.render.methods.ear_responses import BEFORE, LAGRANGE, between_jumps, ear_responses, lagrange_weights
from clsim.render.methods.per_sample import PathSum, path_pressures
from clsim.render.methods.sampled_channel import SampledChannels
from clsim.render.opencl.batches import Fades
from clsim.render.opencl.channel_engine import TaperedRun
from clsim.render.opencl.engine import OpenclEngine, Run
from clsim.render.opencl.host_nodes import side_by_side
from clsim.render.options import RenderOptions
from clsim.render.plan import Allocation, PairPart, Plan, plan_of_part
from clsim.render.source_filters import Emission
from clsim.scene.directivity.directivity import ChannelDirectivity
from clsim.scene.directivity.patterns import Omni
from clsim.scene.scene import Scene
from clsim.scene.signal.signal import Signal
from clsim.tracks.tracks import SceneTracks, Tracks

_SPACINGS = (4608, 3072, 2304, 1536, 1024, 768, 512, 384, 256, 192, 128, 96, 64)  # samples, divisors of a segment
_EVERY = 192  # samples, after which directions are looked at before a spacing is chosen
_SMOOTH = 5e-3  # s for which motions are smooth: splines have knots
_STEADY = 0.05  # of that angle, up to which directions are interpolated over longer times
_SPARE = 1.1  # times that angle, up to which nodes beside a segment may lie apart
_AT_ONCE = 32  # paths of a segment that are filtered at a time


def _largest_step(directions: Floats) -> float:
    """Return the largest distance of neighbours among unit vectors (P, n, 3), rad if it is small."""
    return float(np.linalg.norm(np.diff(directions, axis=1), axis=-1).max())


class EarFrames:
    """Adds the sound of paths at receivers' centres, through their channels' responses, to a piece of the pressure."""

    def __init__(self, plan: Plan, scene: Scene, rows: tuple[NDArray[np.int32], NDArray[Any]], start: int) -> None:
        self.plan, self._start, (self._rows, self._pressure) = plan, start, rows
        assert plan.tracks.of_scene is not None, "ears are those of scenes"
        self._tracks = plan.tracks.of_scene
        band = max(filters.band for filters in plan.source_filters) * (1.0 + plan.max_rate)
        c = scene.air.speed_of_sound
        with with_blas_threads(1):
            self._ears = {
                r: ear_responses(scene.receivers[r].directivity, c, plan.sampling_rate, band)
                for r in sorted({pair.receiver for pair in plan.tracks.pairs})
            }

        self._known: dict[int, Floats] = {}
        # Samples that responses last before the centre's time, and behind it.
        self.before = max(ears.before for ears in self._ears.values())
        self.after = max(ears.after for ears in self._ears.values())

    def add(self, pair: int, rows: NDArray[np.int64], signals: NDArray[Any], first: int) -> None:
        """Add the signals (P, n) of some paths of a pair at the centre, from a sample on, the first of a segment."""
        active, paths = np.flatnonzero(np.any(signals, axis=1)), self._tracks.pair_paths[pair]
        jumps = self._jumps(pair)[rows]

        def filtered(part: tuple[int, int]) -> list[tuple[int, NDArray[Any]]]:
            at, some = part[0], active[part[1] : part[1] + _AT_ONCE]
            here = signals[some, at : at + self.plan.segment]
            pieces = between_jumps(jumps[some], first + at, here.shape[1])
            return [self._filtered(paths.part(rows[some]), here, first + at, piece) for piece in pieces]

        parts = list(product(range(0, signals.shape[1], self.plan.segment), range(0, len(active), _AT_ONCE)))
        with with_blas_threads(1):  # each part has a thread of its own
            found = [one for several in side_by_side(filtered, parts) for one in several]
        row = int(self._rows[paths.receiver])
        for begin, received in found:
            low, high = max(begin, self._start), min(begin + received.shape[1], self._start + self._pressure.shape[1])
            if low < high:
                into = self._pressure[row : row + len(received), low - self._start : high - self._start]
                into += received[:, low - begin : high - begin]

    def _jumps(self, pair: int) -> Floats:
        """Return the samples (P, Q) at which the directions of a pair's paths change suddenly, in order."""
        if pair not in self._known:
            self._known[pair] = np.sort(cuts(self._tracks, pair), axis=1) * self.plan.sampling_rate
        return self._known[pair]

    def _filtered(
        self, paths: PairPaths, signals: NDArray[Any], first: int, piece: Floats | None
    ) -> tuple[int, NDArray[Any]]:
        """Return a first sample, and from there the sound (C, n) of signals (P, n) through the channels' responses.

        piece: samples (P, 2) between which signals are taken, and directions are known.
        """
        from scipy.fft import irfft, next_fast_len, rfft

        ears, count, wide = self._ears[paths.receiver], signals.shape[1], np.result_type(signals.dtype, np.complex64)
        spacing, towards = self._nodes(paths, ears.turn, first, count, piece)
        if piece is not None:
            places = first + np.arange(count)
            signals = signals * ((places >= piece[:, :1]) & (places < piece[:, 1:]))
        blocks = -(-count // spacing)
        size = next_fast_len(spacing + ears.before + ears.after, real=True)
        responses = ears.spectra(towards, size, wide)  # (P, nodes, C, F)
        cut = np.zeros((len(signals), blocks, spacing), signals.dtype)
        cut.reshape(len(signals), -1)[:, :count] = signals
        weights = lagrange_weights(BEFORE + np.arange(spacing) / spacing).astype(signals.dtype)
        total = np.zeros((blocks, *responses.shape[2:]), wide)
        for k in range(LAGRANGE):
            sounds = rfft(cut * weights[k], size)[..., : total.shape[-1]]
            for sound, response in zip(sounds, responses[:, k : k + blocks], strict=True):
                total += sound[:, None] * response
        out = np.zeros((total.shape[1], (blocks - 1) * spacing + size), signals.dtype)
        for b, received in enumerate(np.roll(irfft(total, size), ears.before, axis=-1)):
            out[:, b * spacing : b * spacing + size] += received
        return first - ears.before, out

    def _nodes(self, paths: PairPaths, turn: float, first: int, count: int, piece: Floats | None) -> tuple[int, Floats]:
        """Return the spacing of nodes for a segment, samples, and directions (P, nodes, 3) that turn little between."""
        towards, _ = self._directions(paths, first + _EVERY * np.arange(-(-count // _EVERY) + 1))
        fastest = _largest_step(towards) / _EVERY
        for spacing in _SPACINGS:
            most = turn if spacing <= _SMOOTH * self.plan.sampling_rate else _STEADY * turn
            if spacing * fastest <= most or spacing == _SPACINGS[-1]:
                near = first // spacing - BEFORE + np.arange(-LAGRANGE, -(-count // spacing) + 2 * LAGRANGE - 1)
                # Nodes at either end tell how motions go on beyond their ends.
                found, enough = self._continued(paths, spacing * near, piece)
                nodes = found[:, LAGRANGE:-LAGRANGE]
                if enough and _largest_step(nodes) <= _SPARE * turn:
                    break
        return spacing, nodes

    def _continued(self, paths: PairPaths, samples: NDArray[np.int64], piece: Floats | None) -> tuple[Floats, bool]:
        """Return directions (P, n, 3) at evenly spaced samples, beyond the ends of motions as these would go on.

        Also test if enough of them are known for that.
        """
        towards, known = self._directions(paths, samples)
        if piece is not None:
            known &= (samples >= piece[:, :1]) & (samples <= piece[:, 1:])
        count = np.count_nonzero(known, axis=1)
        for own, inside in zip(towards, known, strict=True):
            if inside.all() or np.count_nonzero(inside) < LAGRANGE:
                continue
            first, last = np.flatnonzero(inside)[[0, -1]]
            for edge, step, count in ((first, 1, first), (last, -1, len(own) - 1 - last)):
                beyond = np.minimum(np.arange(count) + 1, LAGRANGE)
                made = lagrange_weights(-1.0 * beyond).T @ own[edge + step * np.arange(LAGRANGE)]
                own[edge - step * (np.arange(count) + 1)] = made / np.linalg.norm(made, axis=1, keepdims=True)
        return towards, not np.any((count > 0) & (count < min(LAGRANGE, len(samples))))

    def _directions(self, paths: PairPaths, samples: NDArray[np.int64]) -> tuple[Floats, NDArray[np.bool_]]:
        """Return directions (P, n, 3) of arrival in the receiver's frame, and if motions of both ends are known."""
        scene, times = paths.family.scene, samples / self.plan.sampling_rate
        receiver, emits = scene.receivers[paths.receiver], scene.sources[paths.source].trajectory
        now = times + receiver.clock_error(times)
        found = paths.arrivals(now, self._tracks.kinematics)
        known = (found.emission_time >= emits.start) & (found.emission_time <= emits.end)
        known &= (now >= receiver.trajectory.start) & (now <= receiver.trajectory.end)
        return to_transducer_frame(receiver.orientation, now, np.nan_to_num(found.arrival)), known


class _Centre(Omni):
    """An omnidirectional receiver in place of one with ears, whose turning matters."""


_BYTES = 64 * 2**20  # of path signals on the device at a time


def can(tracks: Tracks, options: RenderOptions, pair: int) -> str | None:
    """Return the reason against rendering a pair by this method, by its index; None if there is none."""
    of_scene = tracks.of_scene
    if of_scene is None:
        return "tracks without a scene"
    directivity = of_scene.paths.scene.receivers[tracks.pairs[pair].receiver].directivity
    if not isinstance(directivity, ChannelDirectivity) or directivity.by_functions:
        return "its channels are alike over frequency"
    return "envelopes" if options.baseband is not None or options.responses == "centre" else None


def centre_tracks(tracks: SceneTracks, pairs: Sequence[int]) -> SceneTracks:
    """Return the tracks of pairs as an omnidirectional receiver at each receiver's centre has them."""
    receivers = [copy(receiver) for receiver in tracks.scene.receivers]
    for i in {tracks.pairs[pair].receiver for pair in pairs}:
        object.__setattr__(receivers[i], "directivity", _Centre())
    once = {tracks.paths_of(pair): pair for pair in reversed(pairs)}  # both ears have the same paths
    centred = tracks.with_ends(receivers=receivers)
    made = centred.among(sorted(once.values()))
    members = tuple(replace(own, channels=range(1)) for own in made.pairs)
    pair_paths = tuple(replace(own, channels=range(1)) for own in made.pair_paths)
    return replace(made, paths=centred.paths, pairs=members, pair_paths=pair_paths)  # rates are those of all kinds


def parts_of(
    emissions: Sequence[tuple[Signal, float]], tracks: Tracks, options: RenderOptions, samples: int,
    others: frozenset[int],
) -> tuple[PairPart, ...]:  # fmt: skip
    """Return pairs with receivers whose channels differ over frequency, with a plan."""
    pairs = [i for i in range(len(tracks.pairs)) if i not in others and can(tracks, options, i) is None]
    if not pairs or tracks.of_scene is None:
        return ()
    centres, until, made, notes = (
        centre_tracks(tracks.of_scene, pairs),
        samples / options.sampling_rate,
        [],
        list[str](),
    )
    channels = list[tuple[int, sampled_channel.ChannelOffer]]()
    with with_blas_threads(1):
        for i, emitted in enumerate(emissions):
            mine = [k for k, pair in enumerate(centres.pairs) if pair.source == i]
            emission = Emission.of(i, emitted, centres, options, until, centres, static=not mine)
            made.append(emission.source_filters())
            if mine and (options.channels or (options.channels is None and may_be_cheaper(emission, made[-1], mine))):
                heads = Heads.among(tracks.of_scene.scene, centres, made[-1:], options.sampling_rate)
                offer, why = sampled_channel.offer(emission, made[-1], mine, heads)
                notes += [why] if why else []
                channels += [(i, offer)] if offer else []
    filters = tuple(made)
    sampled = sampled_channel.parts_of(channels, centres, filters, options, samples) if channels else {}
    plan = plan_of_part(options, centres, Allocation(notes=tuple(notes), **sampled), filters, samples)
    return (PairPart(plan, frozenset(pairs)),)


@dataclass(frozen=True, slots=True, eq=False)
class Ears:
    """Contribution of receivers whose channels differ over frequency."""

    plan: Plan  # of the whole
    name: ClassVar[str] = "ears"

    @property
    def scene(self) -> Scene:
        assert self.plan.tracks.of_scene is not None, "ears are those of scenes"
        return self.plan.tracks.of_scene.paths.scene

    def describe(self) -> list[str]:
        lines = []
        for part in self.plan.allocation.ears:
            ears = f"{len({pair.receiver for pair in part.plan.tracks.pairs})} receivers with ears"
            lines.append(f"{part.plan.path_count} paths to {ears}: each is filtered on its own")
            lines += [*part.plan.allocation.notes, *PathSum(part.plan).describe()]
            lines += SampledChannels(part.plan).describe()
        return lines

    def digest(self) -> str:
        """Return a text that changes with any tap, and with the responses, of which some are looked at."""
        found, c = list[Any](), self.scene.air.speed_of_sound
        for part in self.plan.allocation.ears:
            found += [PathSum(part.plan).digest(), SampledChannels(part.plan).digest()]
            for receiver in sorted({pair.receiver for pair in part.plan.tracks.pairs}):
                ears = self.scene.receivers[receiver].directivity
                some = np.clip(np.geomspace(100.0, 0.4 * part.plan.sampling_rate, 8), *ears.band)
                found.append(ears.gain_towards(np.eye(3)[:, None], some, c))
        return digest_of(*found)

    def begin(self) -> _Adding:
        return _Adding(self)


class _Adding(Stateless):
    """Adds what ears receive; the engines start with the first piece."""

    def __init__(self, ears: Ears) -> None:
        self._ears = ears
        self._all: list[OpenclEngine] = []

    def add(self, pressure: NDArray[Any], start: int) -> None:
        for part in self._ears.plan.allocation.ears:
            if not self._all and part.plan.options.engine != "reference":
                self._all = _engines(part.plan, self._ears.scene)
                self.engines = self._all[:1]
                for engine in self._all[1:]:
                    engine.shares(self._all[0])  # functions of frequency are made for all paths together
            for engine in self._all:
                if isinstance(engine, EarChannelEngine):
                    engine.add_ears(self._ears.plan.first_rows, pressure, start)
                elif isinstance(engine, EarEngine):
                    self._filter(engine.plan, engine, pressure, start)
            if not self._all:
                self._filter(part.plan, None, pressure, start)

    def _filter(self, plan: Plan, engine: EarEngine | None, pressure: NDArray[Any], start: int) -> None:
        """Add paths that are filtered one by one."""
        frames = EarFrames(plan, self._ears.scene, (self._ears.plan.first_rows, pressure), start)
        begin = max(start - frames.after, 0) // plan.segment * plan.segment
        # Whole segments but for the plan's last one, so that no bit depends on the chunks.
        end = -(-(start + pressure.shape[1] + frames.before) // plan.segment) * plan.segment
        end = min(end, plan.samples + frames.before)
        if engine is None:
            _add_exactly(frames, begin, end)
        else:
            engine.filter(frames, begin, end)


def _engines(plan: Plan, scene: Scene) -> list[OpenclEngine]:
    """Return the engines of paths that are filtered one by one, of sampled channels, and of what these leave."""
    made: list[OpenclEngine] = [] if len(plan.allocation.claimed) == len(plan.tracks.pairs) else [EarEngine(plan)]
    for part in plan.allocation.channels:
        assert part.plan.tracks.of_scene is not None, "ears are those of scenes"
        filters = [part.plan.source_filters[part.source]]
        heads = Heads.among(scene, part.plan.tracks.of_scene, filters, plan.sampling_rate)
        made.append(EarChannelEngine(part.plan, part.spacing, heads))
    return made + [TaperedEarEngine(part.plan) for part in plan.allocation.beside]


def _add_exactly(frames: EarFrames, begin: int, end: int) -> None:
    """Add paths in float64."""
    plan = frames.plan
    for first in range(begin, end, plan.segment):
        last = min(first + plan.segment, end)
        for pair, member in enumerate(plan.tracks.pairs):
            signals = np.zeros((len(member), last - first))
            for row, received in path_pressures(plan, pair, first, last):
                signals[row] = received[0]
            frames.add(pair, np.arange(len(member)), signals, first)


class _EarRun(Run):
    """Renders the paths of a batch one by one."""

    _engine: EarEngine
    _apart, _divides = True, False

    def _fades(self, start: int, block: int, blocks: int) -> Fades | None:
        """Return the beginnings and ends of paths, each slot with a row of its own."""
        fades = super()._fades(start, block, blocks)
        if fades is None:
            return None
        first = np.arange(len(fades.slot) + 1, dtype=np.int32)
        return Fades(fades.slot, fades.block, fades.start, fades.end, first, fades.slot, fades.block)

    def _render(self, nodes: Any, segment: int, end: int, block: int, first_block: int) -> None:
        import pyopencl as cl

        engine, count, length = self._engine, self._batch.count, self._plan.segment
        step = length * max(_BYTES // (4 * count * length), 1)
        for at in range(segment * length, end, step):
            stop = min(at + step, end)
            self._origin, self._stride, size = at, stop - at, 4 * count * (stop - at)
            self._pressure = engine._scratch.take("apart", size)
            cl.enqueue_fill_buffer(engine._queue, self._pressure, np.zeros(1, np.float32), 0, size)
            later = (at - segment * length) // block
            super()._render(nodes, at // length, stop, block, first_block + later)
            shape = count, stop - at
            made: Any = cl.enqueue_map_buffer(
                engine._queue, self._pressure, cl.map_flags.READ, 0, shape, np.dtype("f4")
            )[0]
            for i, pair in enumerate(self._batch.pairs):
                here = np.arange(count)[self._batch.of_pair(i)]
                here = here[~self._batch.padding[here]]
                engine.frames.add(pair, self._batch.path[here], made[here], self._start + at)
            made.base.release(engine._queue)


class EarEngine(OpenclEngine):
    """Renders the sound of each path at receivers' centres, and has it filtered."""

    run = _EarRun
    frames: EarFrames

    @property
    def plan(self) -> Plan:
        return self._plan

    def filter(self, frames: EarFrames, begin: int, end: int) -> None:
        self.frames = frames
        self.add(np.zeros((self._plan.row_count, end - begin), np.float32), begin)


class _TaperedEarRun(_EarRun, TaperedRun):
    """The same of what tapers leave of paths."""


class TaperedEarEngine(EarEngine):
    """Renders what sampled channels leave of paths, and has it filtered."""

    run = _TaperedEarRun

    def __init__(self, plan: Plan) -> None:
        super().__init__(plan)
        self.branch_signals.of_few = True
