"""What will be computed, settled before anything is: both engines carry out the same plan."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from threadpoolctl import threadpool_limits

from clsim.arrays import Floats, as_choice, as_count, as_number
from clsim.errors import InputError
from clsim.paths.path_set import PathSet
from clsim.render.baseband import Baseband, as_baseband, check_ends, segmented
from clsim.render.envelope import design_envelope
from clsim.render.interpolator import SMALL_GROUP, Bandlimited, Interpolator, Lagrange, TruncatedLagrange
from clsim.render.source_filters import AT_CENTRE, DEFAULT_RESPONSE_ERROR_DB, SourceFilters, design_source_filters
from clsim.render.static_pairs import NO_STATIC_PAIRS, StaticPairs, find_static_pairs
from clsim.scene.signal.signal import Signal
from clsim.tracks.pruning import pruned
from clsim.tracks.tracks import SceneTracks, Tracks, track
from clsim.tracks.transition import DEFAULT_TRANSITION

if TYPE_CHECKING:
    from collections.abc import Sequence

    from clsim.scene.ends import Receiver
    from clsim.scene.scene import Scene

ENGINES = ("opencl", "reference")
SEGMENT = 18432  # samples; chunks are whole segments, and the block length is chosen for each segment
BLOCKS = (768, 384, 192, 96, 48, 24, 8)  # samples in a block, divisors of a segment, tried in this order
FINE = 96  # samples, shorter blocks than which are rendered in small groups by all terms of their cubics
NODE_BUDGET = 48 * 2**20  # bytes of block polynomials on the device at a time
_PRESSURE_BUDGET = 256 * 2**20  # bytes of output held at a time


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """Everything that an engine needs, with nothing left to decide."""

    tracks: Tracks
    source_filters: tuple[SourceFilters, ...]
    interpolator: Interpolator
    sampling_rate: float
    samples: int
    chunk: int
    engine: str
    device: str | None
    left_out: str = ""
    static_pairs: StaticPairs = NO_STATIC_PAIRS
    segment: int = SEGMENT
    blocks: tuple[int, ...] = BLOCKS
    baseband: Baseband | None = None  # of complex envelopes; None for sound as it is

    @property
    def delay_terms(self) -> int:
        """Coefficients of the polynomial of a block's delay, 4 or 8; of the gains' it is always 4."""
        return 4 if self.baseband is None else 8

    @property
    def shortest_block(self) -> int:
        """Samples in the shortest block for which room is made beforehand: shorter ones are rare."""
        return max(self.blocks[-1], FINE) if self.baseband is None else self.blocks[-1]

    def is_fine(self, block: int) -> bool:
        """Return whether blocks of a length are rendered in small groups by all terms of their cubics."""
        return self.baseband is None and block < FINE

    def group(self, source: int, block: int) -> int:
        """Return how many neighbouring samples of a block share the whole part of a delay."""
        group = self.source_filters[source].bank.group
        return min(group, SMALL_GROUP) if self.is_fine(block) else group

    @property
    def sample_type(self) -> type[np.generic]:
        """Type of the samples: float32, or complex64 in baseband."""
        return np.float32 if self.baseband is None else np.complex64

    @property
    def carrier(self) -> float | None:
        """That of complex envelopes, Hz; None for sound as it is."""
        return None if self.baseband is None else self.baseband.carrier

    @property
    def duration(self) -> float:
        """Length of the recording, s."""
        return self.samples / self.sampling_rate

    @property
    def path_count(self) -> int:
        """Number of paths over all pairs of source and receiver."""
        return sum(len(group) for group in self.tracks.groups)

    @property
    def max_rate(self) -> float:
        """Fastest change of any delay, s/s."""
        return max(self.tracks.max_rate(s) for s in range(len(self.source_filters)))

    @property
    def memory_bytes(self) -> int:
        """Memory that the rendering takes at a time, estimated, bytes."""
        return int(sum(self._memory().values()))

    @property
    def largest_field(self) -> str:
        """Field of a scene file that makes the memory large."""
        memory = self._memory()
        largest = max(memory, key=memory.__getitem__)
        return "receivers" if largest == "render.chunk" and self.chunk == self.segment else largest

    def _memory(self) -> dict[str, float]:
        """Return the bytes that the fields of a scene file ask for."""
        middle, length = 0.5 * self.duration, 0.5 * min(self.chunk / self.sampling_rate, self.duration)
        span = self.tracks.longest_delay(middle - length, middle + length) * self.sampling_rate
        rows = max(e.oversampling * int(e.rows[-1]) for e in self.source_filters)
        functions = max(len(e.basis) for e in self.source_filters)
        per_segment = (
            (4 + 4 * self.delay_terms + 16 * functions)
            * (self.segment // self.shortest_block)
            * max((len(group) for group in self.tracks.groups), default=0)
        )
        size = 4.0 if self.baseband is None else 8.0
        return {
            "render.chunk": size * ((rows + 1) * self.chunk + 2 * self.chunk * self.receiver_count),
            "paths.max_order": size * (rows + 1) * span + max(NODE_BUDGET, per_segment) + self.path_count * 150,
        }

    def promised_db(self, source: int) -> float:
        """Return the bound on the error of what is rendered path by path, relative to what is heard at any moment, dB.

        Errors of delay filters, of responses and of motion between nodes are independent: their squares add up.
        """
        filters = self.source_filters[source]
        parts_db = [filters.bank.error_db, filters.basis.error_db, self.motion_error_db]
        return 10.0 * math.log10(sum(10.0 ** (part / 10.0) for part in parts_db))

    @property
    def motion_error_db(self) -> float:
        """Bound on the error of delays and gains between nodes, dB."""
        return float(getattr(self.interpolator, "error_db", -90.0)) - 6.0

    @property
    def receiver_count(self) -> int:
        """Number of receivers."""
        return len(self.tracks.receiver_names)

    @property
    def receivers(self) -> tuple[Receiver, ...]:
        """The scene's receivers; none for tracks computed elsewhere."""
        return tuple(self.tracks.scene.receivers) if isinstance(self.tracks, SceneTracks) else ()

    @property
    def units(self) -> tuple[str, ...]:
        """Unit of each receiver's samples: Pa, or V."""
        return tuple(r.unit for r in self.receivers) or ("Pa",) * self.receiver_count

    def describe(self) -> list[str]:
        """Return what will be computed, a line each."""
        lines = [
            f"{self.path_count} paths from {len(self.source_filters)} sources to {self.receiver_count} receivers",
            f"{self.samples} samples at {self.sampling_rate:g} Hz, {self.duration:g} s, in chunks of {self.chunk}",
            f"{self.path_count * self.samples:.3g} path-samples, about {self.memory_bytes / 2**20:.0f} MiB at a time",
            f"delays change by at most {self.max_rate:.3g} s/s",
            *([self.left_out] if self.left_out else []),
            *self.static_pairs.describe(self.tracks),
        ]
        if self.baseband is not None:
            lines[1] += f"; complex envelopes of {self.baseband.bandwidth:g} Hz about {self.baseband.carrier:g} Hz"
        for i, e in enumerate(self.source_filters):
            if not self.static_pairs.holds(self.tracks, i):
                lines += [f"source {i}: {e.describe_filters()}", f"source {i}: {e.describe()}"]
                lines.append(
                    f"source {i}: all of it together within {self.promised_db(i):.0f} dB of what is heard in some 40 ms"
                )
        for i, r in enumerate(self.receivers):
            if r.electronics is not None or r.transducer is not None:
                name = "" if r.transducer is None else f"; transducer {r.transducer.name or 'without a name'}"
                what = "ideal" if r.electronics is None else r.electronics.describe(r.unit)
                lines.append(f"receiver {i}: recorded in {r.unit}{name}; {what}")
        return lines


def plan_render(
    paths: PathSet,
    sampling_rate: float,
    *,
    interpolator: Interpolator | None = None,
    motion: str = "retarded",
    amplitude: str = "wave-equation",
    transition: float | str = DEFAULT_TRANSITION,
    response_error_db: float | str = DEFAULT_RESPONSE_ERROR_DB,
    baseband: Baseband | tuple[float, ...] | None = None,
    prune_below_db: float | None = None,
    engine: str = "opencl",
    device: str | None = None,
    duration: float | None = None,
    chunk: int | None = None,
    convolve_static: bool = True,
) -> Plan:
    """Return the plan of a rendering without carrying it out; arguments as in `render`."""
    if not isinstance(paths, PathSet):
        raise InputError("paths", f"must be a PathSet, but is {paths!r:.80}")
    scene = paths.scene
    rate = as_number("sampling_rate", sampling_rate, at_least=1000.0, at_most=100e6, unit="Hz")
    if baseband is not None:
        check_ends(scene)
    ringing = _check_receivers(scene, rate)
    tracks, left_out = track(paths, motion=motion, amplitude=amplitude, transition=transition), ""
    if prune_below_db is not None:
        below_db = as_number("prune_below_db", prune_below_db, at_least=-300.0, at_most=-20.0, unit="dB")
        end = min(max(source.start + source.emitted.duration for source in scene.sources), tracks.last_time())
        until = min(duration or end + tracks.longest_delay(end, end), tracks.last_time())
        tracks, left_out = pruned(tracks, below_db, until)
    return plan_tracks(
        [source.emitted for source in scene.sources],
        tracks,
        sampling_rate,
        starts=[source.start for source in scene.sources],
        interpolator=interpolator,
        response_error_db=response_error_db,
        baseband=baseband,
        engine=engine,
        device=device,
        duration=duration,
        chunk=chunk,
        ringing=ringing,
        left_out=left_out,
        convolve_static=convolve_static,
    )


def plan_tracks(
    signals: Sequence[Signal],
    tracks: Tracks,
    sampling_rate: float,
    *,
    starts: Sequence[float] | None = None,
    interpolator: Interpolator | None = None,
    response_error_db: float | str = DEFAULT_RESPONSE_ERROR_DB,
    baseband: Baseband | tuple[float, ...] | None = None,
    engine: str = "opencl",
    device: str | None = None,
    duration: float | None = None,
    chunk: int | None = None,
    ringing: float = 0.0,
    left_out: str = "",
    convolve_static: bool = True,
) -> Plan:
    """Return the plan of rendering signals along tracks; arguments as in `render_tracks`.

    Receivers ring on for a while, s, and `left_out` tells what of the scene is not in the tracks.
    """
    rate = as_number("sampling_rate", sampling_rate, at_least=1000.0, at_most=100e6, unit="Hz")
    as_choice("engine", engine, ENGINES)
    interpolator = Bandlimited() if interpolator is None else interpolator
    if not isinstance(interpolator, Bandlimited | Lagrange | TruncatedLagrange):
        raise InputError("interpolator", f"must be an interpolator, but is {interpolator!r:.80}")
    if not isinstance(tracks, Tracks):
        raise InputError("tracks", f"must be Tracks, but is {tracks!r:.80}")
    for i, signal in enumerate(signals):
        if not isinstance(signal, Signal):
            raise InputError(f"signals[{i}]", f"must be a Signal, but is {signal!r:.80}")
    if len(signals) != tracks.source_count:
        raise InputError("signals", f"must be one per source, {tracks.source_count}, but are {len(signals)}")
    starts = [0.0] * len(signals) if starts is None else starts
    wanted = None if baseband is None else as_baseband(baseband, rate)
    design = design_source_filters if wanted is None else partial(design_envelope, baseband=wanted)
    heard_at = rate if wanted is None else wanted.sampling_rate or rate
    samples = _samples(signals, starts, tracks, heard_at, duration, ringing)
    if not isinstance(convolve_static, bool | np.bool_):
        raise InputError("convolve_static", f"must be true or false, but is {convolve_static!r:.80}")
    static_pairs = NO_STATIC_PAIRS
    if convolve_static and engine == "opencl":
        static_pairs = find_static_pairs(tracks, interpolator, at_centre=response_error_db == AT_CENTRE)
    # Matrices are small: threads of the linear algebra would wait for each other, the longer the busier the machine.
    with threadpool_limits(1, "blas"):
        source_filters = tuple(
            design(
                i, signal, start, tracks, interpolator=interpolator, until=samples / heard_at, sampling_rate=rate,
                response_error_db=response_error_db, exact=engine == "reference", static=static_pairs.holds(tracks, i),
            )
            for i, (signal, start) in enumerate(zip(signals, starts, strict=True))
        )  # fmt: skip
    draft = Plan(
        tracks, source_filters, interpolator, heard_at, samples, SEGMENT, engine, device, left_out, static_pairs
    )
    if wanted is not None:
        segment, blocks = segmented(tracks, heard_at, wanted.carrier, draft.max_rate)
        draft = replace(draft, segment=segment, blocks=blocks, baseband=wanted)
    return replace(draft, chunk=_chunk(draft, chunk))


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


def _samples(
    signals: Sequence[Signal],
    starts: Sequence[float],
    tracks: Tracks,
    rate: float,
    duration: float | None,
    ringing: float,
) -> int:
    """Return the length: as asked, or until all that was emitted has been heard."""
    last = tracks.last_time()
    if duration is None:
        end = max(start + signal.duration for start, signal in zip(starts, signals, strict=True))
        known = end if math.isinf(last) else min(end, last)
        duration = min(last, end + tracks.longest_delay(known, known) + ringing)
    else:
        duration = as_number("duration", duration, above=0.0, unit="s")
        if duration > last * (1 + 1e-12) + 0.5 / rate:
            raise InputError(
                "duration",
                f"must end while every receiver's trajectory lasts, {last:g} s, but is {duration:g} s",
            )
    return max(1, math.ceil(duration * rate - 1e-6))


def _chunk(plan: Plan, chunk: int | None) -> int:
    """Return the chunk's length in whole segments: as asked, or long against the delays and small in memory."""
    segment = plan.segment
    whole = math.ceil(plan.samples / segment)
    if chunk is not None:
        return segment * min(whole, math.ceil(as_count("chunk", chunk, at_least=1) / segment))
    span = plan.tracks.longest_delay(0.0, plan.duration) * plan.sampling_rate
    wanted = math.ceil(4.0 * span / segment)
    affordable = _PRESSURE_BUDGET // (4 * segment * plan.receiver_count)
    least = 8 if plan.baseband is None else 48
    return segment * max(1, min(whole, max(least, min(wanted, 48)), affordable))


def node_times(start: int, block: int, blocks: int, sampling_rate: float) -> Floats:
    """Return the times of a run's nodes: starts of its blocks, one before, and two after, s."""
    return (start + block * np.arange(-1, blocks + 2, dtype=np.float64)) / sampling_rate
