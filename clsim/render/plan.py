"""What will be computed, settled before anything is: both engines carry out the same plan."""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from clsim.arrays import Floats, as_choice, as_count, as_number
from clsim.errors import ClsimWarning, InputError
from clsim.paths.path_set import PathSet
from clsim.paths.responses import is_complex
from clsim.render.baseband import Baseband, as_baseband, check_ends, half_band, segmented
from clsim.render.basis import Basis, band_of, flat_basis, scene_basis, turning_basis
from clsim.render.emission import Emission
from clsim.render.envelope import EnvelopeEmission, envelope_emission
from clsim.render.interpolator import Bandlimited, Bank, Interpolator, Lagrange, TruncatedLagrange
from clsim.render.tracks import SceneTracks, Tracks, track
from clsim.render.transition import DEFAULT_TRANSITION
from clsim.scene.scene import Receiver, Scene
from clsim.scene.signal import Signal

if TYPE_CHECKING:
    from collections.abc import Sequence

ENGINES = ("opencl", "reference")
SEGMENT = 18432  # samples; chunks are whole segments, and the block length is chosen for each segment
BLOCKS = (768, 384, 192, 96)  # samples in a block, divisors of a segment, tried in this order
NODE_BUDGET = 48 * 2**20  # bytes of block polynomials on the device at a time
_PRESSURE_BUDGET = 64 * 2**20  # bytes of output held at a time
DEFAULT_RESPONSE_ERROR_DB = -80.0  # of air, walls and beams over a signal's band
AT_CENTRE = "centre"  # instead of that error: all of them as at the centre of the signal's band
EXACT_DB = -100.0  # the same for the reference engine
_MAIN_SHARE = 1e-4  # of a signal's energy at either end of its band, for which walls and beams need not be known
_WIDEST = 0.95  # of Nyquist, the widest band that a bank holds
_LOUD_SHARE_DB = -60.0  # of the signal's energy outside the band, from which on it is a warning
_WEAK_ERROR_DB = -60.0  # of the filter, from which on it is a warning


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """Everything that an engine needs, with nothing left to decide."""

    tracks: Tracks
    emissions: tuple[Emission, ...]
    interpolator: Interpolator
    sampling_rate: float
    samples: int
    chunk: int
    engine: str
    device: str | None
    segment: int = SEGMENT
    blocks: tuple[int, ...] = BLOCKS
    baseband: Baseband | None = None  # of complex envelopes; None for sound as it is

    @property
    def delay_terms(self) -> int:
        """Coefficients of the polynomial of a block's delay, 4 or 8; of the gains' it is always 4."""
        return 4 if self.baseband is None else 8

    @property
    def sample_type(self) -> type[np.generic]:
        """Type of the samples: float32, or complex64 in baseband."""
        return np.float32 if self.baseband is None else np.complex64

    @property
    def duration(self) -> float:
        """Length of the recording, s."""
        return self.samples / self.sampling_rate

    @property
    def path_count(self) -> int:
        """Number of paths over all pairs of source and receiver."""
        return sum(len(group) for group in self.tracks.groups)

    @property
    def interpolator_error_db(self) -> float:
        """Largest error of the delay filters over every source's band, dB."""
        return max(e.bank.error_db for e in self.emissions)

    @property
    def max_rate(self) -> float:
        """Fastest change of any delay, s/s."""
        return max(self.tracks.max_rate(s) for s in range(len(self.emissions)))

    @property
    def memory_bytes(self) -> int:
        """Memory that the rendering takes at a time, estimated, bytes."""
        span = max((self.longest_delay(s) for s in range(len(self.emissions))), default=0.0) * self.sampling_rate
        rows = max(int(e.rows[-1]) for e in self.emissions)
        functions = max(len(e.basis) for e in self.emissions)
        per_segment = (
            (4 + 4 * self.delay_terms + 16 * functions)
            * (self.segment // self.blocks[-1])
            * max((len(group) for group in self.tracks.groups), default=0)
        )
        nodes = max(NODE_BUDGET, per_segment)
        paths = self.path_count * 150
        parts = 1 if self.baseband is None else 2
        held = 4 * parts * ((rows + 1) * (self.chunk + span) + 2 * self.chunk * self.receiver_count)
        return int(held + nodes + paths)

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

    def longest_delay(self, source: int) -> float:
        """Return a bound on the delays of a source over the whole run, s."""
        bounds = [
            self.tracks.delay_range(i, 0.0, self.duration)[1].max()
            for i, group in enumerate(self.tracks.groups)
            if group.source == source
        ]
        return float(max(bounds, default=0.0))

    def describe(self) -> list[str]:
        """Return what will be computed, a line each."""
        lines = [
            f"{self.path_count} paths from {len(self.emissions)} sources to {self.receiver_count} receivers",
            f"{self.samples} samples at {self.sampling_rate:g} Hz, {self.duration:g} s, in chunks of {self.chunk}",
            f"{self.path_count * self.samples:.3g} path-samples, about {self.memory_bytes / 2**20:.0f} MiB at a time",
            f"delays change by at most {self.max_rate:.3g} s/s",
        ]
        if self.baseband is not None:
            lines[1] += f"; complex envelopes of {self.baseband.bandwidth:g} Hz about {self.baseband.carrier:g} Hz"
        for i, e in enumerate(self.emissions):
            lines += [f"source {i}: {line}" for line in e.describe()]
        for i, r in enumerate(self.receivers):
            if r.electronics is not None or r.transducer is not None:
                name = "" if r.transducer is None else f"; transducer {r.transducer.name or 'without a name'}"
                what = "ideal" if r.electronics is None else r.electronics.describe(r.unit)
                lines.append(f"receiver {i}: recorded in {r.unit}{name}; {what}")
        return lines


def plan_render(
    scene: Scene,
    paths: PathSet,
    sampling_rate: float,
    *,
    interpolator: Interpolator | None = None,
    motion: str = "retarded",
    amplitude: str = "wave-equation",
    transition: float | str = DEFAULT_TRANSITION,
    response_error_db: float | str = DEFAULT_RESPONSE_ERROR_DB,
    baseband: Baseband | tuple[float, ...] | None = None,
    engine: str = "opencl",
    device: str | None = None,
    duration: float | None = None,
    chunk: int | None = None,
) -> Plan:
    """Return the plan of a rendering without carrying it out; arguments as in `render`."""
    if not isinstance(scene, Scene):
        raise InputError("scene", f"must be a Scene, but is {scene!r:.80}")
    if isinstance(paths, PathSet) and paths.scene is not scene:
        raise InputError("paths", "must be those of the scene that is rendered, but belong to another one")
    rate = as_number("sampling_rate", sampling_rate, at_least=1000.0, at_most=100e6, unit="Hz")
    if baseband is not None:
        check_ends(scene)
    ringing = _check_receivers(scene, rate)
    return plan_tracks(
        [source.emitted for source in scene.sources],
        track(paths, motion=motion, amplitude=amplitude, transition=transition),
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
) -> Plan:
    """Return the plan of rendering signals along tracks; arguments as in `render_tracks`; receivers ring on, s."""
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
    made_at = rate
    if wanted is not None and wanted.sampling_rate is not None:
        rate = wanted.sampling_rate
    samples = _samples(signals, starts, tracks, rate, duration, ringing)
    if response_error_db != AT_CENTRE:
        if isinstance(response_error_db, str):
            raise InputError("response_error_db", f"must be dB or {AT_CENTRE!r}, but is {response_error_db!r:.80}")
        as_number("response_error_db", response_error_db, at_least=-120.0, at_most=-20.0, unit="dB")
    emissions: list[Emission] = []
    for i, (signal, start) in enumerate(zip(signals, starts, strict=True)):
        signal = signal.at_rate(made_at)
        if wanted is not None:
            envelope = _envelope(
                i, signal, start, wanted, interpolator, tracks, samples / rate, response_error_db, engine
            )
            emissions.append(envelope)
            continue
        high, removed_db, bank = _delay_filters(i, signal, interpolator, tracks, rate)
        basis = _basis(i, signal, high, tracks, samples / rate, rate, response_error_db, engine)
        banks = tuple(interpolator.weaker(bank, size) for size in basis.sizes)
        emissions.append(Emission(signal, start, banks, basis, high, removed_db))
    plan = Plan(tracks, tuple(emissions), interpolator, rate, samples, SEGMENT, engine, device)
    if wanted is not None:
        segment, blocks = segmented(tracks, rate, plan.max_rate)
        plan = replace(plan, segment=segment, blocks=blocks, baseband=wanted)
    return replace(plan, chunk=_chunk(plan, chunk))


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
        tail = max(
            (float(tracks.delay_range(i, known, known)[1].max()) for i in range(len(tracks.groups))), default=0.0
        )
        duration = min(last, end + tail + ringing)
    else:
        duration = as_number("duration", duration, above=0.0, unit="s")
        if duration > last * (1 + 1e-12) + 0.5 / rate:
            raise InputError(
                "duration",
                f"must end while every receiver's trajectory lasts, {last:g} s, but is {duration:g} s",
            )
    return max(1, math.ceil(duration * rate - 1e-6))


def _delay_filters(
    index: int, signal: Signal, interpolator: Interpolator, tracks: Tracks, rate: float
) -> tuple[float, float, Bank]:
    """Return the end of the band that matters, the share above it in dB, and the filters for band and speed."""
    field, max_rate = f"signals[{index}]", tracks.max_rate(index)
    widest = _WIDEST * 0.5 * rate / (1.0 + max_rate)
    floor_db = interpolator.error_db if isinstance(interpolator, Bandlimited) else -90.0
    band, removed_db = _occupied_band(signal, widest, floor_db - 6.0)
    bank = interpolator.bank(2.0 * math.pi * band / rate, max_rate)
    if removed_db > _LOUD_SHARE_DB:
        _warn(
            f"{field}: {removed_db:.0f} dB of its energy lies above {band:.0f} Hz, the band of the delay filters "
            "at this sampling rate and speed, and is removed or distorted; fade or window the signal, or sample faster"
        )
    if bank.error_db > _WEAK_ERROR_DB:
        _warn(
            f"{field}: the delay filters are wrong by up to {bank.error_db:.0f} dB for content at {band:.0f} Hz; "
            'sample faster or use the "bandlimited" interpolator'
        )
    return band, removed_db, bank


def _envelope(
    index: int,
    signal: Signal,
    start: float,
    baseband: Baseband,
    interpolator: Interpolator,
    tracks: Tracks,
    until: float,
    error_db: float | str,
    engine: str,
) -> EnvelopeEmission:
    """Return one source's complex envelope with its filters."""
    half, removed_db = half_band(index, signal, baseband, tracks.max_rate(index))
    low, high = baseband.carrier - half, baseband.carrier + half
    basis = _basis(index, signal, high, tracks, until, signal.sampling_rate, error_db, engine, low)
    return envelope_emission(signal, start, baseband, half, removed_db, interpolator, basis, tracks.max_rate(index))


def _basis(
    index: int,
    signal: Signal,
    high: float,
    tracks: Tracks,
    until: float,
    rate: float,
    error_db: float | str,
    engine: str,
    least: float = 0.0,
) -> Basis:
    """Return the functions of frequency that a source's paths need, from `least` to `high` Hz at most."""
    if not isinstance(tracks, SceneTracks):
        return flat_basis(signal.centre_frequency)
    frequencies, energy = signal.energy_spectrum()
    below = np.cumsum(energy) / max(float(energy.sum()), 1e-300)
    main = frequencies[np.searchsorted(below, [_MAIN_SHARE, 1.0 - _MAIN_SHARE])]
    _check_known(tracks.scene, index, float(main[0]), float(main[1]))
    floor_db = EXACT_DB if isinstance(error_db, str) or engine == "reference" else error_db
    low = float(frequencies[np.searchsorted(below, 10 ** ((floor_db - 6.0) / 10))])
    low = min(max(low, least, frequencies[1]), 0.999 * high)
    if not isinstance(error_db, str):
        floor_db = min(floor_db, error_db)
        band = partial(band_of, low, high, frequencies, energy)
        return scene_basis(tracks, index, band, until, rate, floor_db)
    if is_complex(tracks.scene):
        return turning_basis(signal.centre_frequency, low, high, rate, floor_db)
    return flat_basis(signal.centre_frequency)


def _check_known(scene: Scene, source: int, low: float, high: float) -> None:
    """Refuse, or warn, where walls or beams are not known from `low` to `high` Hz, where a source's signal is."""
    beams = [(f"sources[{source}]", scene.sources[source].directivity)]
    beams += [(f"receivers[{i}]", receiver.directivity) for i, receiver in enumerate(scene.receivers)]
    for field, beam in beams:
        if not (beam.band[0] <= low and high <= beam.band[1]):
            raise InputError(
                f"{field}.directivity",
                f"must cover the signal of source {source}, {low:.0f} to {high:.0f} Hz, but is known from "
                f'{beam.band[0]:.6g} to {beam.band[1]:.6g} Hz; give more of it, or say outside="hold"',
            )
    for material in dict.fromkeys(scene.room.wall_materials):
        try:
            material.check_known([low, high])
        except InputError as error:
            raise InputError("room", f"{error.field} {error.problem}") from error


def _occupied_band(signal: Signal, widest: float, share_db: float) -> tuple[float, float]:
    """Return the highest frequency that matters, and the share of energy above it in dB."""
    frequencies, energy = signal.energy_spectrum()
    total = float(energy.sum())
    if total <= 0.0:
        return 0.5 * widest, -math.inf
    above = np.append(np.cumsum(energy[::-1])[::-1][1:], 0.0) / total  # energy above each bin
    edge = frequencies[np.flatnonzero(above <= 10 ** (share_db / 10))[0]]
    if edge <= widest:
        return max(float(edge), 0.05 * widest), -math.inf
    share = float(above[np.searchsorted(frequencies, widest, side="right") - 1])
    return widest, 10 * math.log10(share) if share > 0.0 else -math.inf


def _chunk(plan: Plan, chunk: int | None) -> int:
    """Return the chunk's length in whole segments: as asked, or long against the delays and small in memory."""
    segment = plan.segment
    whole = math.ceil(plan.samples / segment)
    if chunk is not None:
        return segment * min(whole, math.ceil(as_count("chunk", chunk, at_least=1) / segment))
    span = max(plan.longest_delay(s) for s in range(len(plan.emissions))) * plan.sampling_rate
    wanted = math.ceil(4.0 * span / segment)
    affordable = _PRESSURE_BUDGET // (4 * segment * plan.receiver_count)
    least = 8 if plan.baseband is None else 48
    return segment * max(1, min(whole, max(least, min(wanted, 48)), affordable))


def _warn(message: str) -> None:
    warnings.warn(message, ClsimWarning, stacklevel=5)


def node_times(start: int, block: int, blocks: int, sampling_rate: float) -> Floats:
    """Return the times of a run's nodes: starts of its blocks, one before, and two after, s."""
    return (start + block * np.arange(-1, blocks + 2, dtype=np.float64)) / sampling_rate
