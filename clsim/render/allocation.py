"""Which rendering method takes which pairs and bands, by the least cost, with the filters of each source."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache, partial
from typing import TYPE_CHECKING

from clsim.numerics.resampling import Upsampler
from clsim.render.baseband import Baseband, blocks_of, segment_of
from clsim.render.blas_threads import with_blas_threads
from clsim.render.envelope import design_envelope
from clsim.render.methods import narrow_choice, per_sample, sampled_channel, static
from clsim.render.methods.narrow_band import NarrowFilters, Split, design_split
from clsim.render.plan import LONG_BLOCKS, SEGMENT, Allocation, ChannelPart, NarrowPart, Plan, chunk_of
from clsim.render.source_filters import Emission, SourceFilters, design_source_filters
from clsim.scene.signal.occupied_bandwidth import spectra
from clsim.tracks.sampled import Draw

if TYPE_CHECKING:
    from collections.abc import Sequence

    from clsim.render.options import RenderOptions
    from clsim.scene.signal.signal import Signal
    from clsim.tracks.tracks import Tracks


def allocate(
    emissions: Sequence[tuple[Signal, float]], tracks: Tracks, options: RenderOptions, samples: int
) -> tuple[tuple[SourceFilters, ...], Allocation]:
    """Return the filters of what each source emits, and the allocation, for a recording of a length in samples."""
    convolved = Allocation(static.pairs_at_rest(tracks, options))
    rate = options.sampling_rate if options.baseband is None else options.baseband[2] or options.sampling_rate
    made: list[SourceFilters] = []
    narrow: list[tuple[int, NarrowFilters]] = []
    channels: list[tuple[int, sampled_channel.ChannelOffer]] = []
    notes: list[str] = []
    with with_blas_threads(1):
        for i, (emitted, start) in enumerate(emissions):
            mine = [k for k, pair in enumerate(tracks.pairs) if pair.source == i]
            pairs = [k for k in mine if k not in convolved.convolved]
            at_rest = bool(mine) and not pairs
            emission = _emission(
                i, emitted.at_rate(options.sampling_rate), start, tracks, options, samples / rate, at_rest
            )
            split, why = _cheapest_split(emission, pairs)
            notes += [why] if why else []
            if split is None:
                made.append((design_source_filters if options.baseband is None else design_envelope)(emission))
                offer, why = sampled_channel.offer(emission, made[-1], pairs)
                notes += [why] if why else []
                channels += [(i, offer)] if offer else []
            else:
                rest, bands = design_split(emission, split)
                made.append(rest)
                narrow += [(i, filters) for filters in bands]
    carriers = dict.fromkeys((filters.carrier, filters.rate) for _, filters in narrow)
    parts = tuple(_narrow_part(carrier, narrow, tracks, convolved, options, samples) for carrier in carriers)
    sampled = tuple(_channel_part(i, offer, tuple(made), options, samples) for i, offer in channels)
    return tuple(made), replace(convolved, narrow=parts, channels=sampled, notes=tuple(notes))


def _emission(
    source: int, signal: Signal, start: float, tracks: Tracks, options: RenderOptions, until: float, at_rest: bool
) -> Emission:
    sound, spectrum = spectra(signal)
    drawn = cache(partial(Draw.of, tracks, source, until))
    return Emission(source, signal, start, sound, tracks, options, until, at_rest, spectrum, drawn)


def _cheapest_split(emission: Emission, pairs: list[int]) -> tuple[Split | None, str]:
    """Return the cheapest split into narrow bands and a rest, None for the whole signal; and why it cannot be used."""
    offers = narrow_choice.offers(emission, pairs)
    if not offers:
        return None, ""
    best = min(offers, key=lambda offer: offer.cost)
    if best.cost > per_sample.cost_of_whole(emission) and not emission.options.narrowband:
        return None, ""
    why = narrow_choice.can(emission, pairs, best.split)
    if why is None:
        return best.split, ""
    return None, f"source {emission.source}: rendered as a whole, without a narrow part: {why}"


def _narrow_part(
    carrier: tuple[float, float],
    narrow: list[tuple[int, NarrowFilters]],
    tracks: Tracks,
    claimed: Allocation,
    options: RenderOptions,
    samples: int,
) -> NarrowPart:
    """Return the narrow part of all sources with filters for a carrier and a sampling rate of envelopes, Hz."""
    mine = {i: filters for i, filters in narrow if (filters.carrier, filters.rate) == carrier}
    # Others have no paths in it; what stands for their filters is not looked at.
    first = next(iter(mine.values()))
    filters = tuple(mine.get(i, first) for i in range(tracks.source_count))
    band = Baseband(carrier[0], 2.0 * max(f.band - f.carrier for f in mine.values()), carrier[1])
    upsampler = Upsampler.about(carrier[0], options.sampling_rate, first.mixer.every, 0.5 * band.bandwidth)
    within = replace(options, baseband=band, narrowband=None, chunk=None)
    others = claimed.convolved | {i for i, pair in enumerate(tracks.pairs) if pair.source not in mine}
    blocks = blocks_of(carrier[1], carrier[0], max(tracks.max_rate(i) for i in mine))
    count, segment = math.ceil(samples / upsampler.every) + upsampler.reach, segment_of(blocks)
    chunk = chunk_of(tracks, within, count, carrier[1], segment)
    alone, builders = Allocation(frozenset(others)), [per_sample.build]
    plan = Plan(within, tracks, alone, filters, carrier[1], count, chunk, segment, blocks, builders)
    return NarrowPart(plan, tuple(mine), upsampler)


def _channel_part(
    source: int,
    offer: sampled_channel.ChannelOffer,
    filters: tuple[SourceFilters, ...],
    options: RenderOptions,
    samples: int,
) -> ChannelPart:
    """Return the pairs of a source whose impulse responses are sampled, with a plan of their own for their tracks."""
    pairs, tracks = frozenset(offer.pairs), offer.tracks
    alone = Allocation(frozenset(range(len(tracks.pairs))) - pairs)
    chunk = chunk_of(tracks, options, samples, options.sampling_rate, SEGMENT)
    plan = Plan(
        options, tracks, alone, filters, options.sampling_rate, samples, chunk, SEGMENT, LONG_BLOCKS, [per_sample.build]
    )
    return ChannelPart(plan, source, pairs, offer.spacing, offer.error_db)


def moved_to(allocation: Allocation, device: str) -> Allocation:
    """Return the same allocation with envelopes rendered on a device."""
    narrow = tuple(replace(part, plan=_plan_on(device, part.plan)) for part in allocation.narrow)
    channels = tuple(replace(part, plan=_plan_on(device, part.plan)) for part in allocation.channels)
    return replace(allocation, narrow=narrow, channels=channels)


def _plan_on(device: str, plan: Plan) -> Plan:
    return replace(plan, options=replace(plan.options, device=device), builders=[per_sample.build])
