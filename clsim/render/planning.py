"""From options to a plan: tracks, the rendering method of each pair, source filters, blocks and chunks."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

from clsim.errors import InputError
from clsim.plugins import METHODS, with_plugins
from clsim.render.allocation import allocate, moved_to
from clsim.render.baseband import check_ends, segmented
from clsim.render.diffuse_tail import diffuse_tail
from clsim.render.methods import narrow_part, per_sample, sampled_channel, static
from clsim.render.options import RenderOptions, keywords_of
from clsim.render.plan import BLOCKS, SEGMENT, Plan, chunk_of, max_rate
from clsim.render.tails import NO_TAILS, FoundTails, find_tails
from clsim.tracks.pruning import pruned
from clsim.tracks.tracks import track

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from clsim.paths.path_set import PathSet
    from clsim.render.contributions import Contribution
    from clsim.scene.scene import Scene
    from clsim.scene.signal.signal import Signal
    from clsim.tracks.tracks import SceneTracks, Tracks

# What may add to the pressure, in the order in which it does. A new kind of contribution is one more function here.
BUILDERS: list[Callable[[Plan], Contribution | None]] = [
    per_sample.build,
    narrow_part.build,
    static.build,
    sampled_channel.build,
    diffuse_tail,
]


@keywords_of(RenderOptions)
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

    Raises
    ------
    InputError
        If an argument breaks a rule.

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
    tracks, left_out = _tracks(paths, options)
    emissions = [(source.emitted, source.start) for source in scene.sources]
    tails = find_tails(paths, options, progress)
    return plan_tracks(emissions, tracks, options, ringing=ringing, left_out=left_out, tails=tails)


def plan_tracks(
    emissions: Sequence[tuple[Signal, float]],
    tracks: Tracks,
    options: RenderOptions,
    *,
    ringing: float = 0.0,
    left_out: str = "",
    tails: FoundTails = NO_TAILS,
) -> Plan:
    """Return the plan of rendering signals, each from its start (s) on, along tracks.

    Receivers ring on for a while, s, `left_out` tells what of the scene is not in the tracks, tails what images leave.
    """
    if options.tail != "off" and tracks.of_scene is None:
        raise InputError("tail", f"must be 'off' for tracks without a room, but is {options.tail!r}")
    rate = options.sampling_rate
    heard_at = rate if options.baseband is None else options.baseband[2] or rate
    samples = _samples(emissions, tracks, heard_at, options.duration, ringing, tails.duration)
    filters, allocation = allocate(emissions, tracks, options, samples)
    segment, blocks = _blocks(tracks, options, heard_at)
    chunk = chunk_of(tracks, options, samples, heard_at, segment)
    allocation = allocation.with_tails(tails.of_sources, tails.told)
    return Plan(
        options, tracks, allocation, filters, heard_at, samples, chunk, segment, blocks, _builders(), left_out=left_out
    )


def on_device(plan: Plan, device: str | None) -> Plan:
    """Return a plan for a device of this machine; one that it names stays, and None is any."""
    if device is None or plan.options.device is not None:
        return plan
    allocation = moved_to(plan.allocation, device)
    return replace(plan, options=replace(plan.options, device=device), allocation=allocation, builders=_builders())


def _builders() -> list[Callable[[Plan], Contribution | None]]:
    """Builders of all contributions, those of plugins last."""
    return [*BUILDERS, *with_plugins({}, METHODS).values()]


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


def _tracks(paths: PathSet, options: RenderOptions) -> tuple[SceneTracks, str]:
    """Return the tracks of the paths that may matter, and what is said of the others."""
    tracks = track(paths, motion=options.motion, amplitude=options.amplitude, transition=options.transition)
    if options.prune_below_db is None:
        return tracks, ""
    end = min(max(source.start + source.emitted.duration for source in paths.scene.sources), tracks.last_time())
    until = min(options.duration or end + tracks.longest_delay(end, end), tracks.last_time())
    return pruned(tracks, options.prune_below_db, until)


def _samples(
    emissions: Sequence[tuple[Signal, float]],
    tracks: Tracks,
    rate: float,
    duration: float | None,
    ringing: float,
    tail: float,
) -> int:
    """Return the length: as requested, or until all sound has arrived, with tails that last so long, s."""
    last, what = tracks.first_end()
    if duration is None:
        end = max(start + signal.duration for signal, start in emissions)
        known = end if math.isinf(last) else min(end, last)
        duration = min(last, end + max(tracks.longest_delay(known, known), tail) + ringing)
    elif duration > last * (1 + 1e-12) + 0.5 / rate:
        raise InputError(
            "duration",
            f"must end while all that moves is known, {last:g} s ({what}), but is {duration:g} s",
        )
    return max(1, math.ceil(duration * rate - 1e-6))


def _blocks(tracks: Tracks, options: RenderOptions, rate: float) -> tuple[int, tuple[int, ...]]:
    """Return the lengths of segments and blocks, samples."""
    if options.baseband is None:
        return SEGMENT, BLOCKS
    return segmented(tracks, rate, options.baseband[0], max_rate(tracks))
