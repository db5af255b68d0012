"""Pairs whose impulse responses are sampled over time, as fast as Doppler changes them: for thousands of paths."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar

from numpy.typing import NDArray

from clsim.render.channel_grid import OVERSAMPLING, SPREAD_ERROR_DB, WIDEST, ChannelFilters, work_at_nodes
from clsim.render.contributions import Stateless, digest_of
from clsim.render.interpolator import Bandlimited
from clsim.render.methods.channel_split import Split, Splitter, described_beside, node_error_db, sudden_times
from clsim.render.methods.costs import measured_costs, on_gpu
from clsim.render.methods.ear_components import Heads
from clsim.render.methods.per_sample import PER_SAMPLE, PathSum
from clsim.render.opencl.channel_engine import ChannelEngine, TaperedEngine
from clsim.render.options import RenderOptions
from clsim.render.plan import LONG_BLOCKS, Allocation, ChannelPart, PairPart, Plan, plan_of_part
from clsim.render.source_filters import Emission, SourceFilters
from clsim.tracks.onward import continued
from clsim.tracks.splines import Rows
from clsim.tracks.tracks import SceneTracks, Tracks

_SPARE, _MARGINS = 1.03, (6.0, 12.0, 24.0, 48.0, 96.0)  # of the Doppler shift, and Hz beyond it, tried in this order
_BEYOND = 1.0  # s beyond delays and blocks, for which motions go on at either end: as long as nodes weigh at most
_SURE = 0.85  # of the cost of the sum over paths, below which sampling is cheaper: estimates are right within 15 %
_PLANNED = 1.5e7  # ns, of looking at what changes between nodes, and of what is begun
_LEAST_SPACING = 16  # samples between nodes, below which the sum over paths is as cheap


@dataclass(frozen=True, slots=True)
class ChannelOffer:
    """Sampled channels of the pairs of one source."""

    split: Split  # which paths
    tracks: SceneTracks  # of these paths, between ends that go on smoothly where nothing sounds
    spacing: int  # samples from node to node
    error_db: float  # measured, of interpolation from node to node at the end of the band


def offer(
    emission: Emission, filters: SourceFilters, pairs: list[int], heads: Heads | None = None
) -> tuple[ChannelOffer | None, str]:
    """Return the sampled channels of pairs of a source, None where the sum over paths is cheaper, and why not.

    heads: of receivers with ears, whose pairs have paths to their centres.
    """
    options = emission.options
    mine = [pair for pair in pairs if can(emission.tracks, options, pair) is None]
    rate, silent = filters.rate, not len(emission.sound.energy)
    too_wide = filters.oversampling > 1 or (options.baseband is None and filters.band > 0.5 * WIDEST * rate)
    if not mine or options.channels is False or silent or too_wide:
        return None, ""
    of_scene = emission.tracks.of_scene
    assert of_scene is not None, "channels are those of scenes"
    longest = of_scene.longest_delay(0.0, emission.until, emission.source)
    spacings = None
    if not options.channels:
        if heads is None and not _may_be_cheaper(emission, filters, mine, longest):
            return None, ""
        spacings = _cheaper(*Splitter.of_few(emission, of_scene, mine), filters, longest, heads)
        if not spacings:
            return None, ""
    splitter, error_db = Splitter.of(emission, of_scene, mine), -math.inf
    if spacings is None or splitter.pieces:  # of paths that go on all the time, few tell of all
        spacings = _cheaper(splitter, 1.0, filters, longest, heads)
    shift, level = emission.max_rate * filters.band, 10 ** (_allowed_db(options) / 20)
    for margin, spacing in spacings:
        split = splitter.at(margin, splitter.near(shift, margin, level))
        if not split.pairs or (split.left and options.baseband is not None):
            continue
        tracks = continued(of_scene, 2.0 * longest + _BEYOND + 4.0 * LONG_BLOCKS[0] / rate).with_rows(split.taken)
        error_db = node_error_db(tracks, emission, filters, split.pairs, spacing, heads)
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
    if options.engine != "opencl" or not isinstance(options.interpolator, Bandlimited):
        return "every path is rendered by the requested delay filter"
    if on_gpu(options):
        return "a GPU sums paths faster"
    family, scene = of_scene.pair_paths[pair].family, of_scene.paths.scene
    if family.moves or scene.air.fluctuation is not None:
        return "what is in between moves"
    if family.is_specular:
        return None
    member = tracks.pairs[pair]
    ends = scene.sources[member.source], scene.receivers[member.receiver]
    sudden = not member.always_audible or any(len(sudden_times(end)) for end in ends)
    return "paths by edges and scatterers begin, end or jump" if sudden else None


def _allowed_db(options: RenderOptions) -> float:
    assert isinstance(options.interpolator, Bandlimited)
    return options.interpolator.error_db


def _may_be_cheaper(emission: Emission, filters: SourceFilters, pairs: list[int], longest: float) -> bool:
    """Compare the sum over all paths with transforms alone, for the fewest nodes: most scenes need no closer look."""
    rate, members = filters.rate, [emission.tracks.pairs[i] for i in pairs]
    spacing = max(_spacing(emission, filters, _MARGINS[0]), 1)
    counts = 0.0, 0.0, sum(len(member.channels) for member in members)
    least = measured_costs().channel_point * work_at_nodes(filters, counts, spacing, longest, emission.until)[2]
    gains = sum(len(member) * len(member.channels) for member in members)
    return least + _PLANNED < _SURE * filters.cost() * rate * emission.until * gains


def _spacing(emission: Emission, filters: SourceFilters, margin: float) -> int:
    """Return the samples from node to node for a margin beyond the Doppler shift, Hz."""
    shift = emission.max_rate * filters.band
    return math.floor(filters.rate / (2.0 * OVERSAMPLING * (_SPARE * shift + margin)))


def _cheaper(
    splitter: Splitter, times: float, filters: SourceFilters, longest: float, heads: Heads | None
) -> list[tuple[float, int]]:
    """Return margins, Hz, and spacings cheaper than the sum over `times` as many paths, or all if requested."""
    emission, known, found = splitter.emission, measured_costs(), []
    costs = known.channel_path, known.channel_function, known.channel_point, known.channel_nodes
    rate, of_path = filters.rate, filters.cost() if heads is None else heads.cost_of_path(filters)
    for margin in _MARGINS:
        spacing = _spacing(emission, filters, margin)
        if spacing < _LEAST_SPACING:
            break
        split = splitter.at(margin, {})
        paths, gains, rows = split.at_nodes(splitter.tracks, emission.until)
        counts = times * paths, times * gains, rows
        if heads is None:
            work = work_at_nodes(filters, counts, spacing, longest, emission.until)
            cost = sum(a * b for a, b in zip(work, costs, strict=True))
        else:
            cost = heads.cost_at_nodes(filters, counts, spacing, longest, emission.until)
        seconds, stretches = split.summed(emission.until)
        cost += times * (of_path * seconds * rate + known.stretch * stretches)
        whole = times * splitter.summed(split.pairs)
        if emission.options.channels or cost + _PLANNED < _SURE * of_path * rate * whole:
            found.append((cost, margin, spacing))
    return [(margin, spacing) for _, margin, spacing in sorted(found)]


def parts_of(
    offers: list[tuple[int, ChannelOffer]], tracks: Tracks, filters: tuple[SourceFilters, ...], options: RenderOptions,
    samples: int,
) -> dict[str, Any]:  # fmt: skip
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


@dataclass(frozen=True, slots=True, eq=False)
class SampledChannels:
    """Contribution of the pairs whose impulse responses are sampled over time."""

    plan: Plan  # of the whole
    name: ClassVar[str] = "sampled channels"

    def describe(self) -> list[str]:
        lines = [line for part in self.plan.allocation.channels for line in _described(part)]
        return lines + [line for part in self.plan.allocation.beside for line in described_beside(part)]

    def digest(self) -> str:
        found = list[str]()
        for part in self.plan.allocation.channels:
            found += [repr((part.source, part.spacing)), PathSum(part.plan).digest()]
        for beside in self.plan.allocation.beside:
            lengths = [tapers.length for i in sorted(beside.pairs) if (tapers := beside.plan.tracks.pairs[i].tapers)]
            found += [repr(lengths), PathSum(beside.plan).digest()]
        return digest_of(*found)

    def begin(self) -> _Adding:
        return _Adding(self.plan.allocation)


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

    def __init__(self, allocation: Allocation) -> None:
        self._allocation = allocation
        self._all: list[ChannelEngine | TaperedEngine] = []
        self._last = allocation.channels[0].plan.samples

    def until(self, last: int) -> None:
        self._last = last

    def add(self, pressure: NDArray[Any], start: int) -> None:
        if not self._all:
            self._all = [ChannelEngine(part.plan, part.spacing) for part in self._allocation.channels]
            self._all += [TaperedEngine(part.plan) for part in self._allocation.beside]
            self.engines = self._all[:1]
            for engine in self._all[1:]:
                engine.shares(self._all[0])  # functions of frequency are made for all paths together
        for engine in self._all:
            engine.until(self._last)
            engine.add(pressure, start)
