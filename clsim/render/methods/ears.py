"""Receivers whose channels differ over frequency: the sound of each path at the centre, through responses that turn."""

from __future__ import annotations

import hashlib
import math
from copy import copy
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.paths.path_set import PathSet
from clsim.paths.response import to_transducer_frame
from clsim.render.contributions import Stateless
from clsim.render.memory import with_blas_threads
from clsim.render.methods.per_sample import PathSum, path_pressures
from clsim.render.opencl.batches import Fades
from clsim.render.opencl.engine import OpenclEngine, Run
from clsim.render.opencl.host_nodes import side_by_side
from clsim.scene.directivity.directivity import ChannelDirectivity
from clsim.scene.directivity.patterns import Omni

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from clsim.arrays import Complexes, Floats
    from clsim.paths.family import PairPaths
    from clsim.render.options import RenderOptions
    from clsim.render.plan import EarPart, Plan
    from clsim.scene.scene import Scene
    from clsim.tracks.tracks import SceneTracks, Tracks

_NODES = 6  # from which responses between two of them are made
_SPACINGS = (64, 96, 128, 192, 256, 384, 512, 768, 1024, 1536, 2304, 3072, 4608)  # samples, divisors of a segment
_EVERY = 192  # samples, after which directions are looked at before a spacing is chosen
_TURNS = (0.05, 0.035, 0.025, 0.0175, 0.0125, 0.00875, 0.006, 0.004)  # rad between nodes, tried in this order
_TURN_ERROR_DB = -92.0  # of responses between nodes, relative to them, over random great circles
_CIRCLES = 24
_SIZES = (2048, 8192, 32768, 131072)  # samples in which impulse responses are looked for
_FADE = 1.0 / 12.0  # of the sampling rate, over which responses fade out above the band
_POWERS = 16  # of a bin's phase factor that are worked out at a time
_QUIET = 1e-10  # of their energy, that is cut off at either end
_AT_ONCE = 32  # paths of a segment that are filtered at a time
_BYTES = 64 * 2**20  # of path signals on the device at a time


def can(tracks: Tracks, options: RenderOptions, pair: int) -> str | None:
    """Return the reason against rendering a pair by this method, by its index; None if there is none."""
    of_scene = tracks.of_scene
    if of_scene is None:
        return "tracks without a scene"
    directivity = of_scene.paths.scene.receivers[tracks.pairs[pair].receiver].directivity
    if not isinstance(directivity, ChannelDirectivity) or directivity.is_flat:
        return "its channels are alike over frequency"
    return "envelopes" if options.baseband is not None or options.responses == "centre" else None


def centre_tracks(tracks: SceneTracks, pairs: Sequence[int]) -> SceneTracks:
    """Return the tracks of pairs as an omnidirectional receiver at each receiver's centre has them."""
    scene = copy(tracks.paths.scene)
    receivers = [copy(receiver) for receiver in scene.receivers]
    for i in {tracks.pairs[pair].receiver for pair in pairs}:
        object.__setattr__(receivers[i], "directivity", Omni())
    object.__setattr__(scene, "receivers", tuple(receivers))
    families = {id(family): copy(family) for family in tracks.paths.families}
    for family in families.values():
        object.__setattr__(family, "scene", scene)
    once = {tracks.paths_of(pair): pair for pair in reversed(pairs)}  # both ears have the same paths
    kept = sorted(once.values())
    return replace(
        tracks,
        paths=PathSet(scene, tuple(families.values())),
        pairs=tuple(replace(tracks.pairs[i], channels=range(1)) for i in kept),
        pair_paths=tuple(
            replace(tracks.pair_paths[i], family=families[id(tracks.pair_paths[i].family)], channels=range(1))
            for i in kept
        ),
    )


def build(plan: Plan) -> Ears:
    """Make the contribution of a plan's receivers whose channels differ over frequency."""
    assert plan.tracks.of_scene is not None, "ears are those of scenes"
    first_rows = plan.first_rows
    return Ears(plan.allocation.ears, plan.tracks.of_scene.paths.scene, first_rows)


@dataclass(frozen=True, slots=True, eq=False)
class Ears:
    """Contribution of receivers whose channels differ over frequency."""

    parts: tuple[EarPart, ...]
    scene: Scene
    first_rows: NDArray[np.int32]  # of each receiver in the pressure

    @property
    def name(self) -> str:
        """Name of its kind."""
        return "ears"

    def describe(self) -> list[str]:
        """Describe the paths, and the filters and errors of each source."""
        lines = []
        for part in self.parts:
            receivers = len({pair.receiver for pair in part.plan.tracks.pairs})
            lines.append(
                f"{part.plan.path_count} paths to {receivers} receivers with ears: each is filtered on its own"
            )
            lines += PathSum(part.plan).describe()
        return lines

    def digest(self) -> str:
        """Return a text that changes with any tap."""
        found = hashlib.sha256()
        for part in self.parts:
            found.update(PathSum(part.plan).digest().encode())
        return found.hexdigest()

    def begin(self) -> _Adding:
        """Return an object that adds it."""
        return _Adding(self)


class _Adding(Stateless):
    """Adds what ears receive; the engine starts with the first piece."""

    def __init__(self, ears: Ears) -> None:
        self._ears = ears
        self._engines: list[EarEngine] = []

    def add(self, pressure: NDArray[Any], start: int) -> None:
        """Add what ears receive from sample `start` on to the pressure (rows, n), Pa."""
        for i, part in enumerate(self._ears.parts):
            plan = part.plan
            frames = EarFrames(plan, self._ears, pressure, start)
            begin = max(start - frames.after, 0) // plan.segment * plan.segment
            end = start + pressure.shape[1] + frames.before
            if plan.options.engine == "reference":
                _add_exactly(frames, begin, end)
                continue
            if len(self._engines) <= i:
                self._engines.append(EarEngine(plan))
            self._engines[i].filter(frames, begin, end)

    def warn(self) -> None:
        """Warn of residuals above the requested error."""
        for engine in self._engines:
            engine.warn()


def _add_exactly(frames: EarFrames, begin: int, end: int) -> None:
    """Add paths in float64."""
    plan = frames.plan
    for first in range(begin, end, plan.segment):
        last = min(first + plan.segment, end)
        for pair, member in enumerate(plan.tracks.pairs):
            signals = np.zeros((len(member), last - first))
            for row, heard in path_pressures(plan, pair, first, last):
                signals[row] = heard[0]
            frames.add(pair, np.arange(len(member)), signals, first)


@dataclass(frozen=True, slots=True, eq=False)
class EarResponses:
    """Responses of a receiver's channels within a band at a sampling rate."""

    directivity: ChannelDirectivity
    speed_of_sound: float  # m/s
    rate: float  # Hz
    band: float  # Hz, from which on to half the sampling rate responses are faded out
    before: int  # samples that a response lasts before the centre's time
    after: int
    turn: float  # rad from node to node

    def spectra(self, directions: Floats, size: int, kind: Any) -> Complexes:
        """Return the responses (..., C, F) of a kind of number at a transform's bins, by direction (..., 3)."""
        step, end = self.rate / size, min(self.band + _FADE * self.rate, 0.5 * self.rate)
        count = math.ceil(end / step)
        fade = np.cos(0.5 * math.pi * np.clip((step * np.arange(count) - self.band) / (end - self.band), 0.0, 1.0)) ** 2
        out = np.zeros((*directions.shape[:-1], len(self.directivity.channels), size // 2 + 1), kind)
        out[..., :count] = self.at_multiples(directions, step, fade.astype(out.real.dtype))
        return out

    def at_multiples(self, directions: Floats, step: float, weights: Floats) -> Complexes:
        """Return weighted responses (..., C, F) at multiples of a frequency from 0 Hz on, by direction (..., 3)."""
        count, directivity, c = len(weights), self.directivity, self.speed_of_sound
        frequencies = np.clip(step * np.arange(count), *directivity.band)
        gain = directivity.aligned(directions, frequencies, c, range(len(directivity.channels)))
        angle = -2.0j * math.pi * step * directivity.lateness(directions, c)[..., None]
        # Products of few powers: exponential functions would take most of the time.
        coarse, fine = (np.exp(angle * k) for k in (_POWERS * np.arange(-(-count // _POWERS)), np.arange(_POWERS)))
        kind = np.result_type(weights, np.complex64)
        turned = coarse.astype(kind)[..., None] * fine.astype(kind)[..., None, :]
        out = turned.reshape(*angle.shape[:-1], -1)[..., :count] * weights
        out *= np.moveaxis(gain, 0, -2)
        return np.asarray(out)


@lru_cache(maxsize=32)
def ear_responses(directivity: ChannelDirectivity, speed_of_sound: float, rate: float, band: float) -> EarResponses:
    """Return a receiver's responses, with their length and the angle between nodes as measured at some directions."""
    from scipy.fft import irfft

    drawn = np.random.default_rng(0).standard_normal((2, _CIRCLES, 3))
    axis = drawn[0] / np.linalg.norm(drawn[0], axis=1, keepdims=True)
    across = np.cross(axis, drawn[1])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    made = EarResponses(directivity, speed_of_sound, rate, min(band, 0.49 * rate), 0, 0, 0.0)
    for size in _SIZES:
        impulses = irfft(made.spectra(axis, size, np.complex128), axis=-1)
        energy = np.cumsum(np.roll(np.sum(impulses**2, axis=(0, 1)), size // 2))
        edges = np.searchsorted(energy, energy[-1] * np.array([_QUIET, 1.0 - _QUIET])) - size // 2
        if np.abs(edges).max() < 0.4 * size:
            break
    for turn in _TURNS:
        angle = turn * np.append(np.arange(_NODES) - (_NODES // 2 - 1.0), 0.5)[:, None]
        towards = axis[:, None] * np.cos(angle) + across[:, None] * np.sin(angle)
        found = made.at_multiples(towards, made.band / 64, np.ones(65))  # (circles, nodes, C, F)
        wrong = np.tensordot(found[:, :-1], _weights(2)[_NODES // 2, :, 1], ([1], [0])) - found[:, -1]
        if np.linalg.norm(wrong) <= 10 ** (_TURN_ERROR_DB / 20.0) * np.linalg.norm(found[:, -1]):
            break
    return replace(made, before=max(int(-edges[0]), 0), after=max(int(edges[1]), 0), turn=turn)


@cache
def _weights(spacing: int) -> Floats:
    """Return Lagrange's weights (_NODES + 1, _NODES, spacing) of nodes in the samples from one to the next.

    Before the first samples there is no node, before the next one, and so on: ends of motions are near.
    """
    nodes = np.arange(_NODES)
    place = np.arange(-1, _NODES)[:, None, None, None] + np.arange(spacing) / spacing
    factors = (place - nodes[:, None]) / np.where(np.eye(_NODES), 1.0, nodes[:, None] - nodes)[..., None]
    return np.asarray(np.where(np.eye(_NODES)[..., None], 1.0, factors).prod(axis=2))


class EarFrames:
    """Adds the sound of paths at receivers' centres, through their channels' responses, to a piece of the pressure."""

    def __init__(self, plan: Plan, ears: Ears, pressure: NDArray[Any], start: int) -> None:
        self.plan, self._pressure, self._start, self._rows = plan, pressure, start, ears.first_rows
        assert plan.tracks.of_scene is not None, "ears are those of scenes"
        self._tracks = plan.tracks.of_scene
        band, c = (
            max(filters.band for filters in plan.source_filters) * (1.0 + plan.max_rate),
            ears.scene.air.speed_of_sound,
        )
        with with_blas_threads(1):
            self._ears = {
                r: ear_responses(ears.scene.receivers[r].directivity, c, plan.sampling_rate, band)
                for r in sorted({pair.receiver for pair in plan.tracks.pairs})
            }

    @property
    def before(self) -> int:
        """Samples that responses last before the centre's time."""
        return max(ears.before for ears in self._ears.values())

    @property
    def after(self) -> int:
        """Samples that they last behind it."""
        return max(ears.after for ears in self._ears.values())

    def add(self, pair: int, rows: NDArray[np.int64], signals: NDArray[Any], first: int) -> None:
        """Add the signals (P, n) of some paths of a pair at the centre, from a sample on, the first of a segment."""
        sounding, paths = np.flatnonzero(np.any(signals, axis=1)), self._tracks.pair_paths[pair]

        def filtered(part: tuple[int, int]) -> tuple[int, NDArray[Any]]:
            at, some = part[0], sounding[part[1] : part[1] + _AT_ONCE]
            return self._filtered(paths.part(rows[some]), signals[some, at : at + self.plan.segment], first + at)

        parts = list(product(range(0, signals.shape[1], self.plan.segment), range(0, len(sounding), _AT_ONCE)))
        with with_blas_threads(1):  # each part has a thread of its own
            found = side_by_side(filtered, parts)
        row = int(self._rows[paths.receiver])
        for begin, heard in found:
            low, high = max(begin, self._start), min(begin + heard.shape[1], self._start + self._pressure.shape[1])
            if low < high:
                self._pressure[row : row + len(heard), low - self._start : high - self._start] += heard[
                    :, low - begin : high - begin
                ]

    def _filtered(self, paths: PairPaths, signals: NDArray[Any], first: int) -> tuple[int, NDArray[Any]]:
        """Return a first sample, and from there the sound (C, n) of signals (P, n) through the channels' responses."""
        from scipy.fft import irfft, next_fast_len, rfft

        ears, count, wide = self._ears[paths.receiver], signals.shape[1], np.result_type(signals.dtype, np.complex64)
        spacing = self._spacing(paths, ears, first, count)
        here = first // spacing + np.arange(-(-count // spacing))
        begin, towards = self._nodes(paths, here, spacing)
        size = next_fast_len(spacing + ears.before + ears.after, real=True)
        responses = ears.spectra(towards, size, wide)  # (P, nodes, C, F)
        cut = np.zeros((len(signals), len(here), spacing), signals.dtype)
        cut.reshape(len(signals), -1)[:, :count] = signals
        weights = _weights(spacing).astype(signals.dtype)
        before, total = here - begin + 1, np.zeros((len(here), *responses.shape[2:]), wide)
        for k in range(_NODES):
            sounds, at = rfft(cut * weights[before, k], size), begin + k - begin.min()
            for sound, response, which in zip(sounds, responses, at, strict=True):
                total += sound[:, None] * response[which]
        out = np.zeros((total.shape[1], (len(here) - 1) * spacing + size), signals.dtype)
        for b, heard in enumerate(np.roll(irfft(total, size), ears.before, axis=-1)):
            out[:, b * spacing : b * spacing + size] += heard
        return first - ears.before, out

    def _spacing(self, paths: PairPaths, ears: EarResponses, first: int, count: int) -> int:
        """Return the spacing of nodes for a segment, samples: what turns fastest turns little from node to node."""
        towards, _ = self._directions(paths, first + _EVERY * np.arange(-(-count // _EVERY) + 1))
        fastest = float(np.linalg.norm(np.diff(towards, axis=1), axis=-1).max()) / _EVERY
        return max((s for s in _SPACINGS if s * fastest <= ears.turn), default=_SPACINGS[0])

    def _nodes(self, paths: PairPaths, here: NDArray[np.int64], spacing: int) -> tuple[NDArray[np.int64], Floats]:
        """Return the first node (P, blocks) of blocks that begin at nodes, and directions (P, nodes, 3) from there on.

        Where motions begin or end, nodes beyond tell nothing of those between.
        """
        nodes = np.arange(here[0] - _NODES + 1, here[-1] + _NODES + 1)
        towards, known = self._directions(paths, nodes * spacing)
        first = nodes[known.argmax(axis=1)]
        last = nodes[::-1][known[:, ::-1].argmax(axis=1)]
        enough = last - first >= _NODES - 1
        first, last = np.where(enough, first, nodes[0]), np.where(enough, last, nodes[-1])
        begin = np.clip(here - (_NODES // 2 - 1), first[:, None], (last - _NODES + 1)[:, None])
        begin = np.clip(begin, here - _NODES + 1, here + 1)
        return begin, towards[:, begin.min() - nodes[0] : begin.max() - nodes[0] + _NODES]

    def _directions(self, paths: PairPaths, samples: NDArray[np.int64]) -> tuple[Floats, NDArray[np.bool_]]:
        """Return directions (P, n, 3) of arrival in the receiver's frame, and if motions of both ends are known."""
        scene, times = paths.family.scene, samples / self.plan.sampling_rate
        receiver, emits = scene.receivers[paths.receiver], scene.sources[paths.source].trajectory
        now = times + receiver.clock_error(times)
        found = paths.arrivals(now, self._tracks.kinematics)
        known = (found.emission_time >= emits.start) & (found.emission_time <= emits.end)
        known &= (now >= receiver.trajectory.start) & (now <= receiver.trajectory.end)
        return to_transducer_frame(receiver.orientation, now, np.nan_to_num(found.arrival)), known


class EarEngine(OpenclEngine):
    """Renders the sound of each path at receivers' centres, and has it filtered."""

    frames: EarFrames

    def filter(self, frames: EarFrames, begin: int, end: int) -> None:
        """Add paths that arrive at centres from a sample to another to frames."""
        self.frames = frames
        self.add(np.zeros((self._plan.row_count, end - begin), np.float32), begin)

    @property
    def run(self) -> type[Run]:
        """Class that renders a batch of receivers."""
        return _EarRun


class _EarRun(Run):
    """Renders the paths of a batch one by one."""

    _engine: EarEngine
    _apart = True

    def _fades(self, start: int, block: int, blocks: int) -> Fades | None:
        """Return the beginnings and ends of paths, each slot with a row of its own."""
        fades = self._batch.fades(start, block, blocks)
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
