"""From options to a plan: tracks, the rendering method of each pair, source filters, blocks and chunks."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from operator import methodcaller
from typing import Any

import numpy as np

from clsim.errors import InputError
from clsim.keywords import keywords_of
from clsim.numerics.blas import with_blas_threads
from clsim.numerics.convolution import Upsampler
from clsim.paths.path_set import PathSet
from clsim.plugins import METHODS, with_plugins
from clsim.render.baseband import Baseband, blocks_of, check_ends, segment_of, segmented
from clsim.render.contributions import Contribution
from clsim.render.diffuse_tail import DiffuseTail
from clsim.render.envelope import NarrowFilters, Split, design_envelope, design_split
from clsim.render.methods import ears, narrow_part, per_sample, sampled_channel, static
from clsim.render.methods.per_sample import PER_SAMPLE
from clsim.render.options import RenderOptions
from clsim.render.plan import (
    BLOCKS,
    SEGMENT,
    WITH_PLANS,
    Allocation,
    NarrowPart,
    Plan,
    ScatteredPart,
    chunk_of,
    plan_of_part,
)
from clsim.render.source_filters import Emission, SourceFilters
from clsim.scene.scene import Scene
from clsim.scene.signal.signal import Signal
from clsim.tail.design import ULTRASOUND, SourceTail, TailOptions, find_tail, searched_order
from clsim.tail.zones import DiffuseField, Zones
from clsim.tracks.pruning import pruned
from clsim.tracks.tracks import SceneTracks, Tracks, track

_MUCH_DB = -20.0  # of the reverberation, above which a note gives it
_FAINT_DB = -60.0  # of all energy, below which a tail is not rendered


@dataclass(frozen=True, slots=True)
class FoundTails:
    """The tails of a scene's sources."""

    of_sources: tuple[SourceTail | None, ...] = ()  # by source; empty if none was asked for
    notes: tuple[str, ...] = ()  # why some have none

    @property
    def duration(self) -> float:
        """The longest of them, s."""
        return max((tail.duration for tail in self.of_sources if tail is not None), default=0.0)


NO_TAILS = FoundTails()


@keywords_of(RenderOptions, PathSet)
def plan_render(paths: PathSet, options: RenderOptions) -> Plan:
    """Return the plan of a rendering without carrying it out.

    Parameters
    ----------
    paths : PathSet
        The paths of a scene, from `find_paths`.
    options : RenderOptions
        Each is a keyword, but for the first, the sampling rate, which may also stand behind the paths.

    Returns
    -------
    Plan
        For `render_chunks`, or to be looked at: samples, filters, errors, memory.

    Warns
    -----
    ClsimWarning
        If a signal, a wall or a directivity cannot be held as well as asked.
    """
    return plan_paths(paths, options)


def plan_paths(paths: PathSet, options: RenderOptions, progress: Callable[[float], None] | None = None) -> Plan:
    """Return the plan of rendering a scene's paths; see `plan_render`. Rays tell their progress, from 0 to 1."""
    scene = paths.scene
    if options.baseband is not None:
        check_ends(scene)
    ringing = _check_receivers(scene, options.sampling_rate)
    with with_blas_threads(1):
        tails = find_tails(paths, options, progress)
    tracks = track(paths, motion=options.motion, amplitude=options.amplitude, transition=options.transition)
    left_out = ""
    if options.prune_below_db is not None:
        tracks, left_out = _pruned(tracks, options, options.prune_below_db)
    emissions = [(source.emitted, source.start) for source in scene.sources]
    return Request(emissions, tracks, options, ringing, left_out, tails).plan()


def _check_receivers(scene: Scene, rate: float) -> float:
    """Check that transducers and electronics work at the sampling rate; return how long a receiver rings, s."""
    longest = 0
    for i, receiver in enumerate(scene.receivers):
        try:
            if receiver.transducer is not None:
                longest = max(longest, len(receiver.transducer.impulse_response(rate)) - 1)
            if receiver.electronics is not None:
                receiver.electronics.check_rate(rate)
        except InputError as error:
            inside = "" if error.field.startswith("transducer") else ".electronics"
            raise error.within(f"receivers[{i}]{inside}") from error
    return longest / rate


def _pruned(tracks: SceneTracks, options: RenderOptions, below_db: float) -> tuple[SceneTracks, str]:
    """Return the tracks of the paths that may matter, and a note on the others."""
    end = min(max(source.start + source.emitted.duration for source in tracks.scene.sources), tracks.last_time())
    until = min(options.duration or end + tracks.longest_delay(end, end), tracks.last_time())
    return pruned(tracks, below_db, until)


def find_tails(paths: PathSet, options: RenderOptions, progress: Callable[[float], None] | None = None) -> FoundTails:
    """Return the tails that options ask for."""
    scene = paths.scene
    if options.tail == "off":
        return FoundTails(notes=_without_tails(paths, options.sampling_rate))
    found: list[SourceTail | None] = []
    notes: list[str] = []
    until = max(source.end for source in scene.sources) if options.duration is None else options.duration
    receivers = Zones.along(scene.receivers, scene.room, np.inf if options.duration is None else until, beams=False)
    requested = TailOptions(
        searched_order(paths), options.tail_directions, options.tail_error_db, options.tail_seed,
        options.tail_scattering, options.device,
    )  # fmt: skip
    for i, source in enumerate(scene.sources):
        low, high = source.emitted.band()
        if low >= ULTRASOUND:
            notes.append(
                f"source {i}: no tail, for its band begins at {low:.0f} Hz and tails end at {ULTRASOUND:.0f} Hz"
            )
            found.append(None)
            continue
        own = Zones.along([source], scene.room, until, beams=True)
        tail = find_tail(scene, i, (low, min(high, 0.5 * options.sampling_rate)), (own, receivers), requested, progress)
        faint = tail.left_db < _FAINT_DB
        notes += [f"source {i}: no tail, for images leave {tail.left_db:.0f} dB of the energy"] if faint else []
        found.append(None if faint else tail)
    if scene.bodies and any(tail is not None for tail in found):
        names = ", ".join(repr(body.name) for body in scene.bodies)
        notes.append(f"tails are those of the room without its bodies ({names}), which take no sound out of them")
    return FoundTails(tuple(found), tuple(notes))


def _without_tails(paths: PathSet, sampling_rate: float) -> tuple[str, ...]:
    """Note on the energy that images leave in a diffuse field, where that is much and tails are off."""
    highest = np.array([min(source.emitted.centre_frequency, 0.5 * sampling_rate) for source in paths.scene.sources])
    field = DiffuseField.of(paths.scene, highest[highest < ULTRASOUND])
    if field is None or not np.any(highest < ULTRASOUND):
        return ()
    left = float(field.left_db(searched_order(paths)).max())
    much = f"images leave some {left:.0f} dB of the reverberation: higher orders, and what walls scatter"
    return (f'{much} (tail="auto" adds it)',) if left > _MUCH_DB else ()


@dataclass(frozen=True, slots=True, eq=False)
class Request:
    """What is to be rendered, from which its plan is made."""

    emissions: Sequence[tuple[Signal, float]]  # by source: the signal, and its start, s
    tracks: Tracks
    options: RenderOptions
    ringing: float = 0.0  # for which receivers ring on, s
    left_out: str = ""  # what of the scene is not in the tracks
    tails: FoundTails = NO_TAILS  # what images leave
    samples: int = 0  # of the recording; set by `plan`

    def plan(self) -> Plan:
        tracks, options = self.tracks, self.options
        if options.tail != "off" and tracks.of_scene is None:
            raise InputError("tail", f"must be 'off' for tracks without a room, but is {options.tail!r}")
        rate, carrier = options.sampling_rate, None if options.baseband is None else options.baseband[0]
        rate = rate if options.baseband is None else options.baseband[2] or rate
        samples = self._length(rate)
        filters, allocation = replace(self, samples=samples)._allocated()
        segment, blocks = (SEGMENT, BLOCKS) if carrier is None else segmented(tracks, rate, carrier)
        chunk = chunk_of(options, samples, rate, segment, sum(map(len, tracks.channels)), tracks.longest_delay)
        notes = (*allocation.notes, *self.tails.notes)
        allocation = replace(allocation, tails=self.tails.of_sources, notes=notes)
        return Plan(
            options, tracks, allocation, filters, rate, samples, chunk, segment, blocks, _builders(), self.left_out
        )

    def _length(self, rate: float) -> int:
        """Return the samples at a rate: as requested, or until all sound has arrived, with tails."""
        (last, what), duration = self.tracks.first_end(), self.options.duration
        if duration is None:
            end = max(start + signal.duration for signal, start in self.emissions)
            known = end if math.isinf(last) else min(end, last)
            longest = max(self.tracks.longest_delay(known, known), self.tails.duration)
            duration = min(last, end + longest + self.ringing)
        elif duration > last * (1 + 1e-12) + 0.5 / rate:
            raise InputError(
                "duration", f"must end while all that moves is known, {last:g} s ({what}), but is {duration:g} s"
            )
        return max(1, math.ceil(duration * rate - 1e-6))

    def _allocated(self) -> tuple[tuple[SourceFilters, ...], Allocation]:
        """Return the filters of what each source emits, and the allocation."""
        tracks, options = self.tracks, self.options
        convolved = Allocation(static.pairs_at_rest(tracks, options))
        parts = ears.parts_of(self.emissions, tracks, options, self.samples, convolved.convolved)
        convolved = replace(convolved, ears=parts)
        groups = per_sample.scattered_groups(tracks, convolved, options)
        # Their responses need many more functions of frequency than others, which these would all have to take.
        everyone, alone = frozenset(range(len(tracks.pairs))), frozenset[int]().union(*(g.pairs for g in groups))
        others = replace(convolved, convolved=convolved.convolved | alone)
        splits: dict[int, Split] = {}
        made, others = self._of(others, everyone - alone.union(*(part.pairs for part in parts)), splits)
        for name, within, pairs, blocks in groups:
            known = splits if name == per_sample.ECHOES else None
            filters, part = replace(self, options=within)._of(Allocation(everyone - pairs), pairs, known, costly=True)
            alike = replace(part, narrow=())
            plan = plan_of_part(within, tracks, alike, filters, self.samples, blocks, [PER_SAMPLE])
            scattered, narrow = (*others.scattered, ScatteredPart(plan, pairs, name)), others.narrow + part.narrow
            notes = tuple(dict.fromkeys(others.notes + part.notes))
            others = replace(others, scattered=scattered, narrow=narrow, notes=notes)
        return made, replace(others, convolved=convolved.convolved)

    def _of(
        self, claimed: Allocation, drawn: frozenset[int], splits: dict[int, Split] | None, costly: bool = False
    ) -> tuple[tuple[SourceFilters, ...], Allocation]:
        """Return filters and allocation of pairs that are not claimed, by responses of some; by few, if costly.

        splits: by source, those into narrow bands so far, which other paths take too; None takes none.
        """
        tracks, options = self.tracks, self.options
        rate = options.sampling_rate if options.baseband is None else options.baseband[2] or options.sampling_rate
        drawn_from = tracks
        if tracks.of_scene is not None and len(drawn) < len(tracks.pairs):
            drawn_from = tracks.of_scene.among(sorted(drawn))
        made: list[SourceFilters] = []
        narrow: list[tuple[int, NarrowFilters]] = []
        channels: list[tuple[int, sampled_channel.ChannelOffer]] = []
        notes: list[str] = []
        with with_blas_threads(1):
            for i, emitted in enumerate(self.emissions):
                mine = {k for k, pair in enumerate(tracks.pairs) if pair.source == i}
                pairs = sorted(mine - claimed.claimed)
                at_rest, until = bool(mine) and not pairs, self.samples / rate
                emission = Emission.of(
                    i, emitted, tracks, options, until, drawn_from, static=at_rest, costly=costly,
                    filters_more=costly and splits is not None,
                )  # fmt: skip
                split, why = narrow_part.cheapest_split(emission, pairs, (splits or {}).get(i))
                notes += [why] if why else []
                if split is None:
                    made.append(emission.source_filters() if options.baseband is None else design_envelope(emission))
                    offer, why = sampled_channel.offer(emission, made[-1], pairs)
                    notes += [why] if why else []
                    channels += [(i, offer)] if offer else []
                else:
                    if splits is not None and not costly:
                        splits[i] = split
                    rest, bands = design_split(emission, split)
                    made.append(rest)
                    narrow += [(i, filters) for filters in bands]
        carriers = dict.fromkeys((filters.carrier, filters.rate) for _, filters in narrow)
        parts = tuple(self._narrow_part(carrier, narrow, claimed, drawn_from.max_rate) for carrier in carriers)
        sampled = sampled_channel.parts_of(channels, tracks, tuple(made), options, self.samples) if channels else {}
        return tuple(made), replace(claimed, narrow=parts, notes=tuple(notes), **sampled)

    def _narrow_part(
        self, carrier: tuple[float, float], narrow: list[tuple[int, NarrowFilters]], claimed: Allocation,
        max_rate: Callable[[int], float],
    ) -> NarrowPart:  # fmt: skip
        """Return the narrow part of all sources with filters for a carrier and a sampling rate of envelopes, Hz.

        max_rate: bounds, by source, of the rates of its delays.
        """
        tracks, rate = self.tracks, self.options.sampling_rate
        mine = {i: filters for i, filters in narrow if (filters.carrier, filters.rate) == carrier}
        # Others have no paths in it; what stands for their filters is not looked at.
        first = next(iter(mine.values()))
        filters = tuple(mine.get(i, first) for i in range(tracks.source_count))
        band = Baseband(carrier[0], 2.0 * max(f.band - f.carrier for f in mine.values()), carrier[1])
        upsampler = Upsampler.about(carrier[0], rate, first.mixer.every, 0.5 * band.bandwidth)
        within = replace(self.options, baseband=band, narrowband=None, chunk=None)
        others = claimed.claimed | {i for i, pair in enumerate(tracks.pairs) if pair.source not in mine}
        blocks = blocks_of(carrier[1], carrier[0], max(max_rate(i) for i in mine))
        count, segment = math.ceil(self.samples / upsampler.every) + upsampler.reach, segment_of(blocks)
        chunk = chunk_of(within, count, carrier[1], segment, sum(map(len, tracks.channels)), tracks.longest_delay)
        alone, builders = Allocation(frozenset(others)), [PER_SAMPLE]
        plan = Plan(within, tracks, alone, filters, carrier[1], count, chunk, segment, blocks, builders)
        return NarrowPart(plan, tuple(mine), upsampler)


def on_device(plan: Plan, device: str | None) -> Plan:
    """Return a plan for a device of this machine; one that it names stays, and None is any."""
    if device is None or plan.options.device is not None:
        return plan
    allocation = moved_to(plan.allocation, device)
    return replace(plan, options=replace(plan.options, device=device), allocation=allocation, builders=_builders())


def moved_to(allocation: Allocation, device: str) -> Allocation:
    """Return the same allocation with envelopes rendered on a device."""

    def moved(part: Any) -> Any:
        options = replace(part.plan.options, device=device)
        inside = moved_to(part.plan.allocation, device)
        return replace(part, plan=replace(part.plan, options=options, allocation=inside, builders=[PER_SAMPLE]))

    parts: dict[str, Any] = {name: tuple(map(moved, getattr(allocation, name))) for name in WITH_PLANS}
    return replace(allocation, **parts)


# What may add to the pressure, in the order in which it does. A new kind of contribution is one more function here.
BUILDERS: list[Callable[[Plan], Contribution | None]] = [
    PER_SAMPLE,
    *(methodcaller("where_scattered", name, per_sample.PathSum) for name in (per_sample.ECHOES, "series")),
    methodcaller("where_claimed", "narrow", narrow_part.NarrowParts),
    methodcaller("where_claimed", "convolved", static.StaticConvolution),
    methodcaller("where_claimed", "channels", sampled_channel.SampledChannels),
    methodcaller("where_claimed", "ears", ears.Ears),
    methodcaller("where_claimed", "tails", DiffuseTail),
]


def _builders() -> list[Callable[[Plan], Contribution | None]]:
    """Builders of all contributions, those of plugins last."""
    return [*BUILDERS, *with_plugins({}, METHODS).values()]
