"""Pairs whose impulse responses are sampled over time, as fast as Doppler changes them: for thousands of paths."""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Floats
from clsim.opencl.launch import work
from clsim.render.channel_grid import (
    OVERSAMPLING,
    PHASES,
    SPREAD_ERROR_DB,
    TAPS,
    WIDEST,
    ChannelFilters,
    ChannelFrames,
    ChannelGrid,
    nodes_of,
    window_table,
    work_at_nodes,
)
from clsim.render.contributions import Stateless
from clsim.render.interpolator import Bandlimited
from clsim.render.methods.channel_split import Split, Splitter, described_beside, node_error_db
from clsim.render.methods.costs import measured_costs, on_gpu
from clsim.render.methods.per_sample import PER_SAMPLE, PathSum
from clsim.render.opencl.batches import ActivePaths, in_batches
from clsim.render.opencl.branch_signals import Branches, Task
from clsim.render.opencl.engine import OpenclEngine, Run
from clsim.render.opencl.host_nodes import side_by_side, thread_count
from clsim.render.opencl.tapered_sum import CONSTANTS, BatchTapers, TaperedEngine
from clsim.render.options import RenderOptions
from clsim.render.plan import LONG_BLOCKS, Allocation, ChannelPart, PairPart, Plan, plan_of_part
from clsim.render.source_filters import Emission, SourceFilters
from clsim.tracks.sampled import continued
from clsim.tracks.tapers import Rows
from clsim.tracks.tracks import SceneTracks, Tracks

_SPARE, _MARGINS = 1.03, (6.0, 12.0, 24.0, 48.0, 96.0)  # of the Doppler shift, and Hz beyond it, tried in this order
_BEYOND = 1.0  # s beyond delays and blocks, for which motions go on at either end: as long as nodes weigh at most
_SURE = 0.75  # of the cost of the sum over paths, below which sampling is cheaper even if many paths live shortly
_LEAST_SPACING = 16  # samples between nodes, below which the sum over paths is as cheap


@dataclass(frozen=True, slots=True)
class ChannelOffer:
    """Sampled channels of the pairs of one source."""

    split: Split  # which paths
    tracks: SceneTracks  # of these paths, between ends that go on smoothly where nothing sounds
    spacing: int  # samples from node to node
    error_db: float  # measured, of interpolation from node to node at the end of the band


def offer(emission: Emission, filters: SourceFilters, pairs: list[int]) -> tuple[ChannelOffer | None, str]:
    """Return the sampled channels of pairs of a source, None where the sum over paths is cheaper, and why not."""
    options = emission.options
    mine = [pair for pair in pairs if can(emission.tracks, options, pair) is None]
    rate, silent = emission.signal.sampling_rate, not len(emission.sound.energy)
    too_wide = filters.oversampling > 1 or filters.band > 0.5 * WIDEST * rate
    if not mine or options.channels is False or silent or too_wide:
        return None, ""
    of_scene = emission.tracks.of_scene
    assert of_scene is not None, "channels are those of scenes"
    longest = of_scene.longest_delay(0.0, emission.until, emission.source)
    if not options.channels and not _may_be_cheaper(emission, filters, mine, longest):
        return None, ""
    splitter, error_db = Splitter.of(emission, of_scene, mine), -math.inf
    shift, level = emission.max_rate * filters.band, 10 ** (_allowed_db(options) / 20)
    for margin, spacing in _cheaper(splitter, filters, longest):
        split = splitter.at(margin, splitter.near(shift, margin, level))
        if not split.pairs:
            continue
        tracks = continued(of_scene, 2.0 * longest + _BEYOND + 4.0 * LONG_BLOCKS[0] / rate).with_rows(split.taken)
        error_db = node_error_db(tracks, emission, filters, split.pairs, spacing)
        if error_db <= _allowed_db(options):
            return ChannelOffer(split, tracks, spacing, error_db), ""
    if error_db == -math.inf:
        return None, ""
    why = f"responses change faster than Doppler shifts: {error_db:.0f} dB between nodes"
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
    ends = scene.sources[member.source], scene.receivers[member.receiver]
    sudden = not member.always_audible or any(len(end.trajectory.breaks) for end in ends)
    return "paths by edges and scatterers begin, end or jump" if sudden and not family.is_specular else None


def _allowed_db(options: RenderOptions) -> float:
    assert isinstance(options.interpolator, Bandlimited)
    return options.interpolator.error_db


def _may_be_cheaper(emission: Emission, filters: SourceFilters, pairs: list[int], longest: float) -> bool:
    """Compare the sum over all paths with transforms alone, for the fewest nodes: most scenes need no closer look."""
    rate, members = emission.signal.sampling_rate, [emission.tracks.pairs[i] for i in pairs]
    spacing = max(_spacing(emission, filters, _MARGINS[0]), 1)
    counts = 0.0, 0.0, sum(len(member.channels) for member in members)
    least = measured_costs().channel_point * work_at_nodes(filters, counts, spacing, longest, emission.until)[2]
    return least < filters.cost() * rate * emission.until * sum(len(m) * len(m.channels) for m in members)


def _spacing(emission: Emission, filters: SourceFilters, margin: float) -> int:
    """Return the samples from node to node for a margin beyond the Doppler shift, Hz."""
    shift = emission.max_rate * filters.band
    return math.floor(emission.signal.sampling_rate / (2.0 * OVERSAMPLING * (_SPARE * shift + margin)))


def _cheaper(splitter: Splitter, filters: SourceFilters, longest: float) -> list[tuple[float, int]]:
    """Return margins, Hz, and spacings of nodes cheaper than the sum over paths, cheapest first; all if requested."""
    emission, known, found = splitter.emission, measured_costs(), []
    costs = known.channel_path, known.channel_function, known.channel_point, known.channel_nodes
    rate = emission.signal.sampling_rate
    share = min(emission.signal.duration + longest, emission.until) / emission.until  # in which something is emitted
    for margin in _MARGINS:
        spacing = _spacing(emission, filters, margin)
        if spacing < _LEAST_SPACING:
            break
        split = splitter.at(margin, {})
        work = work_at_nodes(filters, split.at_nodes(splitter.tracks, emission.until), spacing, longest, emission.until)
        seconds, stretches = split.summed(emission.until)
        cost = sum(a * b for a, b in zip(work, costs, strict=True))
        cost += filters.cost() * seconds * rate + known.stretch * stretches
        most = filters.cost() * rate * share * splitter.summed(split.pairs) * (_SURE if split.left else 1.0)
        if emission.options.channels or cost < most:
            found.append((cost, margin, spacing))
    return [(margin, spacing) for _, margin, spacing in sorted(found)]


def work_of(part: ChannelPart, filters: SourceFilters, until: float) -> tuple[float, ...]:
    """Return the counts of `work_at_nodes` of a part, until the end of a run, s."""
    tracks = part.plan.tracks
    pairs = [tracks.pairs[pair] for pair in part.pairs]
    counts = sum(map(len, pairs)), sum(len(p) * len(p.channels) for p in pairs), sum(len(p.channels) for p in pairs)
    return work_at_nodes(filters, counts, part.spacing, tracks.longest_delay(0.0, until, part.source), until)


def parts_of(
    offers: list[tuple[int, ChannelOffer]],
    tracks: Tracks,
    filters: tuple[SourceFilters, ...],
    options: RenderOptions,
    samples: int,
) -> dict[str, Any]:
    """Return the fields of the allocation: sampled channels of sources, and what is summed beside them."""
    everything, channels, left = frozenset(range(len(tracks.pairs))), [], dict[int, Rows]()
    for source, one in offers:
        alone, pairs = Allocation(everything - set(one.split.pairs)), frozenset(one.split.pairs)
        plan = plan_of_part(options, one.tracks, alone, filters, samples, LONG_BLOCKS, [PER_SAMPLE])
        channels.append(ChannelPart(plan, pairs, source, one.spacing, one.error_db))
        left |= one.split.left
    if not left:
        return {"channels": tuple(channels)}
    assert tracks.of_scene is not None, "offers are made for scenes"
    shortest = min((one.split for _, one in offers if one.split.left), key=lambda split: split.length)
    blocks, fine = shortest.blocks(options.sampling_rate)
    alone, rest = Allocation(everything - set(left)), tracks.of_scene.with_rows(left)
    plan = plan_of_part(options, rest, alone, filters, samples, blocks, [PER_SAMPLE], fine=fine)
    return {"channels": tuple(channels), "beside": (PairPart(plan, frozenset(left)),)}


def build(plan: Plan) -> SampledChannels:
    """Make the contribution of a plan's sampled channels."""
    return SampledChannels(plan.allocation.channels, plan.allocation.beside)


@dataclass(frozen=True, slots=True, eq=False)
class SampledChannels:
    """Contribution of the pairs whose impulse responses are sampled over time."""

    parts: tuple[ChannelPart, ...]  # one for each source
    beside: tuple[PairPart, ...]  # what the sum over paths keeps of their pairs; one part at most

    @property
    def name(self) -> str:
        """Name of its kind."""
        return "sampled channels"

    def describe(self) -> list[str]:
        """Describe node rates, functions of frequency and errors, some lines."""
        lines = [line for part in self.parts for line in _described(part)]
        return lines + [line for part in self.beside for line in described_beside(part)]

    def digest(self) -> str:
        """Return a text that changes with any tap."""
        found = hashlib.sha256()
        for part in self.parts:
            found.update(repr((part.source, part.spacing)).encode() + PathSum(part.plan).digest().encode())
        for beside in self.beside:
            lengths = [tapers.length for i in sorted(beside.pairs) if (tapers := beside.plan.tracks.pairs[i].tapers)]
            found.update(repr(lengths).encode() + PathSum(beside.plan).digest().encode())
        return found.hexdigest()

    def begin(self) -> _Adding:
        """Return an object that adds them."""
        return _Adding(self)


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
    """Adds sampled channels and what is summed beside them; the engines start with the first piece."""

    def __init__(self, what: SampledChannels) -> None:
        self._what = what
        self._engines: list[ChannelEngine | TaperedEngine] = []
        self._last = what.parts[0].plan.samples

    def until(self, last: int) -> None:
        """Have the engines prepare nothing from sample `last` on."""
        self._last = last

    def add(self, pressure: NDArray[Any], start: int) -> None:
        """Add what sampled channels make from sample `start` on to the pressure (receivers, n), Pa."""
        if not self._engines:
            self._engines = [ChannelEngine(part.plan, part.spacing) for part in self._what.parts]
            self._engines += [TaperedEngine(part.plan) for part in self._what.beside]
            for engine in self._engines[1:]:
                engine.shares(self._engines[0])  # functions of frequency are made for all paths together
        for engine in self._engines:
            engine.until(self._last)
            engine.add(pressure, start)

    def warn(self) -> None:
        """Warn of residuals above the requested error."""
        for engine in self._engines[:1]:
            engine.warn()


_APART = 8  # neighbouring slots whose delays lie far apart, see scatter.cl
_TOGETHER = 4  # nodes to a thread at a time. SciPy transforms four side by side; others take three times as long each
_AT_ONCE = 32 * 2**20  # bytes of grids that are made at a time: a launch takes as long as some hundred thousand places
_MARGIN = 64  # samples beside the bounds of delays


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
        self.branch_signals.last = -(2**62)  # there are none to prepare
        self._filters = [ChannelFilters.of(filters) for filters in plan.source_filters]
        self.reached: dict[tuple[int, ...], int] = {}  # points of grids of a shape (1:) that were ever written

    def until(self, last: int) -> None:
        """Prepare nothing anyway."""

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
                self._add_source(source, active, frames, (first, last - first))
        for residuals in self.residuals:
            residuals.settle(first // self._plan.segment)

    def _grid(self, filters: ChannelFilters, active: list[ActivePaths]) -> ChannelGrid:
        low, high = min(pair.low.min() for pair in active), max(pair.high.max() for pair in active)
        return filters.grid(float(low), float(high), self._spacing)

    def _add_source(self, source: int, active: list[ActivePaths], frames: ChannelFrames, span: tuple[int, int]) -> None:
        plan, (start, length) = self._plan, span
        rate, begin = plan.sampling_rate, plan.source_filters[source].start
        least = round((min(float(pair.low.min()) for pair in active) + begin) * rate)
        most = round((max(float(pair.high.max()) for pair in active) + begin) * rate)
        branches = Branches(None, 0, start - most, least - _MARGIN, most + _MARGIN, None)
        budget, block, most_paths = self.limits.node_budget, plan.blocks[0], self.limits.paths_in_launch
        for first, last, here in self.branch_signals.chosen(active, start, length):
            received = [part for pair in here for part in pair.parts(most_paths)]
            for batch in in_batches(plan, received, self.kind, budget, block, apart=_APART):
                task = ChannelTask(source, batch, branches, None, length, start, first, last, frames)
                _ChannelRun(self, task).render()


class _ChannelRun(Run):
    """Makes the responses of one batch of receivers at the nodes of some segments, and adds what is heard by them."""

    _task: ChannelTask
    _engine: ChannelEngine

    def __post_init__(self) -> None:
        super().__post_init__()
        self._tapers = BatchTapers(self._plan, self._batch)

    def _levels(self, error: Floats, level: int) -> NDArray[np.int64]:
        """Return the levels of blocks that may do: for paths that begin and end the longest ones are tried in vain."""
        if not self._tapers.there:
            return super()._levels(error, level)
        return np.where(error > self._tolerance, self._promising_levels(error, level), level)

    def _render(self, nodes: Any, segment: int, end: int, block: int, first_block: int) -> None:
        begin, frames, rows = segment * self._plan.segment, self._task.frames, self._batch.row
        spacing, first, last = frames.grid.spacing, self._start + begin, self._start + end
        wanted = frames.active_nodes(range(-(-first // spacing), -(-last // spacing)))
        unit, of_receiver = _TOGETHER * thread_count(), 4 * self._gains * frames.grid.points
        beside = min(max(1, _AT_ONCE // (unit * of_receiver)), len(rows))
        step = unit * max(1, _AT_ONCE // (unit * beside * of_receiver))
        for some in (wanted[i : i + step] for i in range(0, len(wanted), step)):
            at = np.array(some) * spacing - first
            place = 2.0 * (at % block) / block - 1.0
            where = {
                "node_block": (at // block + first_block).astype(np.int32), "node_place": place.astype(np.float32),
                "node_sample": at.astype(np.float32), **self._tapers.arguments(first),
            }  # fmt: skip
            spectra = frames.spectra(some)
            for i in range(0, len(rows), beside):
                self._scattered(nodes, some, where, spectra, slice(i, min(i + beside, len(rows))))

    def _scattered(
        self, nodes: Any, some: list[int], where: dict[str, Any], spectra: NDArray[Any], receivers: slice
    ) -> None:
        """Make responses of some nodes, by their blocks and places there, to some receivers, and add their sound."""
        import pyopencl as cl

        engine, frames, rows = self._engine, self._task.frames, self._batch.row[receivers]
        shape = len(some), len(rows), self._gains, frames.grid.points
        grids = engine._scratch.take(("grids", shape[1:]), 4 * math.prod(shape), zeros=True)
        reached = engine.reached[shape[1:]] = max(frames.grid.reached, engine.reached.get(shape[1:], 0))
        bank = self._plan.source_filters[self._source].bank
        room = 1 if self._gains == 1 else -(-self._gains // 8) * 8
        constants = {
            "LANES": 8, "FUNCTIONS": room, "PHASES": PHASES, "TAPS": TAPS, "TOGETHER": _TOGETHER,
            "TAPERED": int(self._tapers.there), **CONSTANTS, **self._polynomial_constants(nodes),
        }  # fmt: skip
        engine._compiler.kernel("scatter", constants)(
            engine._queue, work(-(-len(some) // _TOGETHER), len(rows), group=1), delay=nodes.delay,
            polynomials=nodes.polynomials, slots=self._batch.count, functions=self._gains, nodes=len(some), **where,
            first_slot=self._batch.first_slot[receivers.start : receivers.stop + 1], receivers=len(rows),
            window=engine.window, first=frames.grid.first - math.floor(bank.shift),
            shift=bank.shift - math.floor(bank.shift), points=shape[3], reached=reached, grids=grids,
        )  # fmt: skip
        mapped: Any = cl.enqueue_map_buffer(engine._queue, grids, cl.map_flags.READ, 0, shape, np.dtype("f4"))[0]
        # Of each function the channels of a receiver come side by side.
        made = mapped.reshape(len(some), len(rows), self._functions, self._channels, shape[3]).swapaxes(2, 3)
        made = made.reshape(len(some), -1, self._functions, shape[3])
        rows = (rows[:, None] + np.arange(self._channels)).ravel()
        parts = np.array_split(np.arange(len(some)), min(thread_count(), len(some)))
        received = side_by_side(lambda part: frames.received(spectra[part], made[part[0] : part[-1] + 1]), parts)
        mapped.base.release(engine._queue)
        for part, samples in zip(parts, received, strict=True):
            for i, of_node in zip(part, samples, strict=True):
                frames.add(some[i], rows, of_node)
