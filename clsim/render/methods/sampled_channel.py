"""Pairs whose impulse responses are sampled over time, as fast as Doppler changes them: for thousands of paths."""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.opencl.launch import work
from clsim.render.channel_grid import (
    NODES,
    OVERSAMPLING,
    PHASES,
    SPREAD_ERROR_DB,
    TAPS,
    WIDEST,
    ChannelFilters,
    ChannelFrames,
    ChannelGrid,
    node_window,
    nodes_of,
    window_table,
)
from clsim.render.contributions import Stateless
from clsim.render.interpolator import Bandlimited
from clsim.render.methods.costs import is_passed, measured_costs, on_gpu, passes
from clsim.render.methods.per_sample import PathSum
from clsim.render.opencl.batches import ActivePaths, in_batches
from clsim.render.opencl.branch_signals import Branches, Task
from clsim.render.opencl.engine import OpenclEngine, Run
from clsim.render.opencl.host_nodes import side_by_side, thread_count
from clsim.render.options import RenderOptions
from clsim.render.plan import LONG_BLOCKS, ChannelPart, Plan
from clsim.render.source_filters import Emission, SourceFilters
from clsim.scene.directivity.directivity import ChannelDirectivity
from clsim.tracks.basis import flat_basis
from clsim.tracks.sampled import continued
from clsim.tracks.tracks import SceneTracks, Tracks

_SPARE, _MARGINS = 1.03, (6.0, 12.0, 24.0, 48.0, 96.0)  # of the Doppler shift, and Hz beyond it, tried in this order
_BEYOND = 1.0  # s beyond delays and blocks, for which motions go on at either end: as long as nodes weigh at most
_LEAST_SPACING = 16  # samples between nodes, below which the sum over paths is as cheap
_EVALUATED_AT = (4, 8, 24)  # pairs, paths of each, and instants at which the error over time is measured


@dataclass(frozen=True, slots=True)
class ChannelOffer:
    """Sampled channels of the pairs of one source."""

    pairs: tuple[int, ...]  # indices among the tracks' pairs
    tracks: SceneTracks  # between ends that go on smoothly where nothing sounds
    spacing: int  # samples from node to node
    error_db: float  # measured, of interpolation from node to node at the end of the band


def offer(emission: Emission, filters: SourceFilters, pairs: list[int]) -> tuple[ChannelOffer | None, str]:
    """Return the sampled channels of pairs of a source, None where the sum over paths is cheaper, and why not."""
    options = emission.options
    mine = [pair for pair in pairs if can(emission.tracks, options, pair) is None]
    if not mine or options.channels is False or filters.oversampling > 1 or not len(emission.sound.energy):
        return None, ""
    rate = emission.signal.sampling_rate
    if filters.band > 0.5 * WIDEST * rate:
        return None, ""
    of_scene = emission.tracks.of_scene
    assert of_scene is not None, "channels are those of scenes"
    longest = of_scene.longest_delay(0.0, emission.until, emission.source)
    for margin in _MARGINS:
        shift = emission.max_rate * filters.band
        spacing = math.floor(rate / (2.0 * OVERSAMPLING * (_SPARE * shift + margin)))
        if spacing < _LEAST_SPACING or not _is_cheaper(emission, filters, mine, spacing, longest):
            return None, ""
        tracks = continued(of_scene, 2.0 * longest + _BEYOND + 4.0 * LONG_BLOCKS[0] / rate)
        why = _obstacle(emission, mine, shift, margin)
        error_db = -math.inf if why else _error_db(tracks, emission, filters, mine, spacing)
        if not why and error_db <= _allowed_db(options):
            return ChannelOffer(tuple(mine), tracks, spacing, error_db), ""
    why = why or f"responses change faster than Doppler shifts: {error_db:.0f} dB between nodes"
    return None, f"source {emission.source}: every path is summed, without sampled channels: {why}"


def can(tracks: Tracks, options: RenderOptions, pair: int) -> str | None:
    """Return the reason against sampling the channel of a pair, by its index; None if there is none."""
    of_scene = tracks.of_scene
    if of_scene is None:
        return "tracks without a scene"
    if options.engine != "opencl" or not isinstance(options.interpolator, Bandlimited) or options.baseband is not None:
        return "every path is rendered by the requested delay filter"
    if on_gpu(options):
        return "a GPU sums paths faster"
    family, scene = of_scene.pair_paths[pair].family, of_scene.paths.scene
    if family.moves or scene.air.fluctuation is not None:
        return "what is in between moves"
    member = tracks.pairs[pair]
    if isinstance(scene.receivers[member.receiver].directivity, ChannelDirectivity):
        return "its receiver has several channels"
    if not member.always_audible:
        return "paths begin or end"
    ends = scene.sources[member.source], scene.receivers[member.receiver]
    if any(len(end.trajectory.breaks) for end in ends):
        return "a velocity jumps"
    return None


def _allowed_db(options: RenderOptions) -> float:
    assert isinstance(options.interpolator, Bandlimited)
    return options.interpolator.error_db


def _is_cheaper(emission: Emission, filters: SourceFilters, pairs: list[int], spacing: int, longest: float) -> bool:
    """Test whether the processor time of sampled channels is below that of the sum over paths, or is requested."""
    if emission.options.channels:
        return True
    tracks, known = emission.tracks, measured_costs()
    paths = sum(len(tracks.pairs[pair]) for pair in pairs)
    work = _work(filters, (paths, len(pairs)), spacing, longest, emission.until)
    costs = known.channel_path, known.channel_function, known.channel_point, known.channel_nodes
    samples = min(emission.signal.duration + longest, emission.until) * emission.signal.sampling_rate
    return sum(a * b for a, b in zip(work, costs, strict=True)) < filters.cost() * paths * samples


def work_of(part: ChannelPart, filters: SourceFilters, until: float) -> tuple[float, ...]:
    """Return the counts of `_work` of a part, until the end of a run, s."""
    tracks = part.plan.tracks
    counts = sum(len(tracks.pairs[pair]) for pair in part.pairs), len(part.pairs)
    return _work(filters, counts, part.spacing, tracks.longest_delay(0.0, until, part.source), until)


def _work(
    filters: SourceFilters, counts: tuple[int, int], spacing: int, longest: float, until: float
) -> tuple[float, ...]:
    """Return counts of paths at nodes, these by functions, points of transforms, and paths in samples."""
    (paths, pairs), functions = counts, len(filters.basis)
    rate = filters.signal.sampling_rate
    nodes = until * rate / spacing + 2 * NODES
    points = ChannelFilters.of(filters).grid(0.0, longest, spacing).size * ((1.25 * functions + 1.0) * pairs + 1.0)
    return nodes * paths, nodes * paths * functions, nodes * points, paths * (until * rate + 2 * NODES * spacing)


def _obstacle(emission: Emission, pairs: list[int], shift: float, margin: float) -> str:
    """Return the reason why responses hold more than Doppler shifts and a margin, Hz; "" if there is none.

    Passing an end at a distance d with a speed v spreads a tone beyond its shift D, at an offset f, by
    ``exp(-2 pi sqrt(f^2 - D^2) d / v)``: the phase has branch points at +-j d / v.
    """
    tracks = emission.tracks.of_scene
    assert tracks is not None, "offers are made for scenes"
    level = 10 ** (_allowed_db(emission.options) / 20)
    needed = -math.log(level) / (2.0 * math.pi * math.sqrt(margin * (margin + 2.0 * shift)))
    receivers = sorted({tracks.pairs[pair].receiver for pair in pairs})
    for what, ends, most, radius in passes(tracks, emission.source, receivers):
        if most > 0.0 and is_passed(ends, emission.until, needed, most, radius):
            return f"{what} is passed so near, at up to {most:.3g} m/s, that its sound changes fast"
    return ""


def _error_db(tracks: SceneTracks, emission: Emission, filters: SourceFilters, pairs: list[int], spacing: int) -> float:
    """Measure the error of responses between nodes at the end of the band, relative to them, dB, from a sample.

    The sample is the first and some other paths of some pairs at some instants, the first and the last among them.
    """
    rate = emission.signal.sampling_rate
    rng, window = np.random.default_rng(emission.source), node_window(spacing)
    count = _EVALUATED_AT[2]
    places = rng.integers(0, max(round(emission.until * rate), 1), count)
    places[:2] = 0, round(emission.until * rate)
    whole, within = np.divmod(places, spacing)
    whole, within = whole[:, None] + np.arange(1 - NODES, NODES + 1), np.where(within == 0, spacing // 2, within)
    weights = window[within[:, None] + spacing * np.arange(2 * NODES - 1, -1, -1) - 1]
    times = np.concatenate([whole * spacing, whole[:, NODES - 1, None] * spacing + within[:, None]], axis=1) / rate
    wrong = loud = 0.0
    for pair in pairs[:: -(-len(pairs) // _EVALUATED_AT[0])]:
        rows = np.unique(np.append(0, rng.integers(0, len(tracks.pairs[pair]), _EVALUATED_AT[1] - 1)))
        delay, _, gain = tracks.evaluate(pair, times.ravel(), flat_basis(filters.band), rows)
        turned = (gain[0, 0] * np.exp(-2j * math.pi * filters.band * delay)).reshape(len(rows), count, -1)
        apart = np.einsum("pin,in->pi", turned[..., :-1], weights) - turned[..., -1]
        wrong += float(np.max(np.sum(np.abs(apart) ** 2, axis=0)))
        loud += float(np.mean(np.sum(np.abs(turned[..., -1]) ** 2, axis=0)))
    return 10.0 * math.log10(max(wrong / max(loud, 1e-300), 1e-30))


def build(plan: Plan) -> SampledChannels:
    """Make the contribution of a plan's sampled channels."""
    return SampledChannels(plan.allocation.channels)


@dataclass(frozen=True, slots=True, eq=False)
class SampledChannels:
    """Contribution of the pairs whose impulse responses are sampled over time."""

    parts: tuple[ChannelPart, ...]  # one for each source

    @property
    def name(self) -> str:
        """Name of its kind."""
        return "sampled channels"

    def describe(self) -> list[str]:
        """Describe node rates, functions of frequency and errors, some lines."""
        return [line for part in self.parts for line in _described(part)]

    def digest(self) -> str:
        """Return a text that changes with any tap."""
        found = hashlib.sha256()
        for part in self.parts:
            found.update(repr((part.source, part.spacing)).encode() + PathSum(part.plan).digest().encode())
        return found.hexdigest()

    def begin(self) -> _Adding:
        """Return an object that adds them."""
        return _Adding(self.parts)


def _described(part: ChannelPart) -> list[str]:
    plan, filters, here = part.plan, part.plan.source_filters[part.source], f"source {part.source}"
    rate = plan.sampling_rate
    reach = ChannelFilters.of(filters).ringing
    parts_db = (part.error_db, SPREAD_ERROR_DB, filters.basis.error_db, plan.motion_error_db)
    promised_db = 10.0 * math.log10(sum(10.0 ** (db / 10.0) for db in parts_db))
    return [
        f"{here}: impulse responses of {len(part.pairs)} pairs are sampled {rate / part.spacing:.3g} times a second "
        f"(every {part.spacing} samples), within {part.error_db:.0f} dB between them; they ring up to {reach} samples "
        f"({1e3 * reach / rate:.3g} ms) before an arrival",
        f"{here}: {filters.describe()}",
        f"{here}: total error at most {promised_db:.0f} dB of the level received within 40 ms",
    ]


class _Adding(Stateless):
    """Adds sampled channels; the engines start with the first piece."""

    def __init__(self, parts: tuple[ChannelPart, ...]) -> None:
        self._parts = parts
        self._engines: list[ChannelEngine] = []

    def add(self, pressure: NDArray[Any], start: int) -> None:
        """Add what sampled channels make from sample `start` on to the pressure (receivers, n), Pa."""
        if not self._engines:
            self._engines = [ChannelEngine(part.plan, part.spacing) for part in self._parts]
        for engine in self._engines:
            engine.add(pressure, start)

    def warn(self) -> None:
        """Warn of residuals above the requested error."""
        for engine in self._engines:
            engine.warn()


_APART = 8  # neighbouring slots whose delays lie far apart, see scatter.cl
_TOGETHER = 4  # nodes to a thread at a time. SciPy transforms four side by side; others take three times as long each
_AT_ONCE = 32 * 2**20  # bytes of grids that are made at a time: a launch takes as long as some hundred thousand places
_MARGIN = 64  # samples beside the bounds of delays
_NEVER = -(2**62)


@dataclass(frozen=True, slots=True, eq=False)
class ChannelTask(Task):
    """The paths of a batch of receivers from one source, and the frames of the nodes of a chunk."""

    frames: ChannelFrames


class ChannelEngine(OpenclEngine):
    """Renders pairs of a plan by their impulse responses at nodes that are a number of samples apart."""

    def __init__(self, plan: Plan, spacing: int) -> None:
        super().__init__(plan)
        self._spacing = spacing
        self.window = self._upload(window_table().astype(np.float32))
        self.branch_signals.last = _NEVER  # there are none to prepare
        self._filters = [ChannelFilters.of(filters) for filters in plan.source_filters]

    def add(self, pressure: NDArray[Any], start: int) -> None:
        """Add all pairs of the plan from sample `start` on to the pressure (receivers, n), Pa."""
        block = self._plan.blocks[0]
        nodes = nodes_of(start, start + pressure.shape[1], self._spacing)
        first, last = ((node * self._spacing // block + i) * block for i, node in enumerate((nodes[0], nodes[-1])))
        for source, filters in enumerate(self._filters):
            active = self.branch_signals.active(source, first, last - first)
            if active:
                grid = self._grid(filters, active)
                frames = ChannelFrames(filters, grid, pressure, start)
                self._add_source(source, active, frames, first, last - first)
        for residuals in self.residuals:
            residuals.settle(first // self._plan.segment)

    def _grid(self, filters: ChannelFilters, active: list[ActivePaths]) -> ChannelGrid:
        low, high = min(pair.low.min() for pair in active), max(pair.high.max() for pair in active)
        return filters.grid(float(low), float(high), self._spacing)

    def _add_source(
        self, source: int, active: list[ActivePaths], frames: ChannelFrames, start: int, length: int
    ) -> None:
        plan, rate, begin = self._plan, self._plan.sampling_rate, self._plan.source_filters[source].start
        least = round((min(float(pair.low.min()) for pair in active) + begin) * rate)
        most = round((max(float(pair.high.max()) for pair in active) + begin) * rate)
        branches = Branches(None, 0, start - most, least - _MARGIN, most + _MARGIN, None)
        received = [part for pair in active for part in pair.parts(self.limits.paths_in_launch)]
        for batch in in_batches(plan, received, self.kind, self.limits.node_budget, plan.blocks[0], apart=_APART):
            task = ChannelTask(source, batch, branches, None, length, start, 0, -(-length // plan.segment), frames)
            _ChannelRun(self, task).render()


class _ChannelRun(Run):
    """Makes the responses of one batch of receivers at the nodes of some segments, and adds what is heard by them."""

    _task: ChannelTask
    _engine: ChannelEngine

    def _render(self, nodes: Any, segment: int, end: int, block: int, first_block: int) -> None:
        begin, frames, rows = segment * self._plan.segment, self._task.frames, self._batch.row
        spacing, first, last = frames.grid.spacing, self._start + begin, self._start + end
        wanted = frames.active_nodes(range(-(-first // spacing), -(-last // spacing)))
        unit = _TOGETHER * thread_count()
        beside = min(max(1, _AT_ONCE // (4 * unit * self._functions * frames.grid.points)), len(rows))
        step = unit * max(1, _AT_ONCE // (4 * unit * beside * self._functions * frames.grid.points))
        for some in (wanted[i : i + step] for i in range(0, len(wanted), step)):
            at = np.array(some) * spacing - first
            place = (2.0 * (at % block) / block - 1.0).astype(np.float32)
            where = (at // block + first_block).astype(np.int32), place
            spectra = frames.spectra(some)
            for i in range(0, len(rows), beside):
                self._scattered(nodes, some, where, spectra, slice(i, min(i + beside, len(rows))))

    def _scattered(
        self, nodes: Any, some: list[int], where: tuple[NDArray[np.int32], NDArray[np.float32]],
        spectra: NDArray[Any], receivers: slice,
    ) -> None:  # fmt: skip
        """Make responses of some nodes, by their blocks and places there, to some receivers, and add their sound."""
        import pyopencl as cl

        engine, frames, rows = self._engine, self._task.frames, self._batch.row[receivers]
        shape = len(some), len(rows), self._functions, frames.grid.points
        grids = engine._scratch.take(("grids", shape[1:]), 4 * math.prod(shape), zeros=True)
        bank = self._plan.source_filters[self._source].bank
        room = 1 if self._functions == 1 else -(-self._functions // 8) * 8
        first_slot = self._batch.first_slot[receivers.start : receivers.stop + 1]
        constants = {
            "LANES": 8, "FUNCTIONS": room, "PHASES": PHASES, "TAPS": TAPS, "TOGETHER": _TOGETHER,
            **self._polynomial_constants(nodes),
        }  # fmt: skip
        engine._compiler.kernel("scatter", constants)(
            engine._queue, work(-(-len(some) // _TOGETHER), len(rows), group=1), delay=nodes.delay,
            polynomials=nodes.polynomials, slots=self._batch.count, functions=self._functions, node_block=where[0],
            node_place=where[1], nodes=len(some), first_slot=first_slot, receivers=len(rows), window=engine.window,
            first=frames.grid.first - math.floor(bank.shift), shift=bank.shift - math.floor(bank.shift),
            points=shape[3], reached=frames.grid.reached, grids=grids,
        )  # fmt: skip
        made: Any = cl.enqueue_map_buffer(engine._queue, grids, cl.map_flags.READ, 0, shape, np.dtype("f4"))[0]
        parts = np.array_split(np.arange(len(some)), min(thread_count(), len(some)))
        received = side_by_side(lambda part: frames.received(spectra[part], made[part[0] : part[-1] + 1]), parts)
        made.base.release(engine._queue)
        for part, samples in zip(parts, received, strict=True):
            for i, of_node in zip(part, samples, strict=True):
                frames.add(some[i], rows, of_node)
