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
from clsim.paths.known import check_known
from clsim.paths.path_set import PathSet
from clsim.paths.responses import is_complex
from clsim.render.at_rest import NONE_AT_REST, AtRest, find_at_rest
from clsim.render.basis import Basis, band_of, flat_basis, scene_basis, turning_basis
from clsim.render.interpolator import Bandlimited, Bank, Interpolator, Lagrange, TruncatedLagrange
from clsim.render.occupied import occupied_band, shares
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
class Emission:
    """One source's signal and the filters for it.

    Attributes
    ----------
    signal : Signal
        At the sampling rate of the recording.
    start : float
        Time at which it begins, s.
    banks : tuple of Bank
        Branch filters, for each function of the basis; fewer for those that add little.
    basis : Basis
        Functions of frequency that carry the responses of its paths.
    band : float
        Highest frequency that the bank holds, Hz.
    removed_db : float
        Share of the signal's energy above the band, dB; -inf for none.
    """

    signal: Signal
    start: float
    banks: tuple[Bank, ...]
    basis: Basis
    band: float
    removed_db: float

    @property
    def bank(self) -> Bank:
        """The branch filters of the strongest function."""
        return self.banks[0]

    @property
    def rows(self) -> Floats:
        """Where the branches of every function begin among all, and their number at the end, (K + 1,) int."""
        return np.cumsum([0, *(len(bank.taps) for bank in self.banks)])

    def streams(self, first: int, last: int) -> Floats:
        """Return samples `first` to `last` of the signal through each function of the basis, (K, n)."""
        half = self.basis.half
        signal = self.signal.read(first - half, last + half)
        if half == 0:
            return signal * self.basis.filters
        if not np.any(signal):
            return np.zeros((len(self.basis), last - first))
        from scipy.signal import oaconvolve

        out = np.asarray(oaconvolve(signal[None], self.basis.filters, mode="valid", axes=1))
        # What no sound reaches is silent, without the rounding of the transforms.
        sounding = np.concatenate([[0], np.cumsum(signal != 0.0)])
        out[:, sounding[2 * half + 1 :] == sounding[: last - first]] = 0.0
        return out


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
    at_rest: AtRest = NONE_AT_REST

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
            (20 + 16 * functions)
            * (SEGMENT // BLOCKS[-1])
            * max((len(group) for group in self.tracks.groups), default=0)
        )
        nodes = max(NODE_BUDGET, per_segment)
        paths = self.path_count * 150
        return int(4 * (rows + 1) * (self.chunk + span) + nodes + 8 * self.chunk * self.receiver_count + paths)

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
            *self.at_rest.describe(self.tracks),
        ]
        for i, e in enumerate(self.emissions):
            if self.at_rest.holds(self.tracks, i):
                continue
            removed = "none" if np.isneginf(e.removed_db) else f"{e.removed_db:.0f} dB"
            lines.append(
                f"source {i}: filters of {len(e.bank.taps)} branches hold up to {e.band:.0f} Hz within "
                f"{e.bank.error_db:.1f} dB; share of the signal above: {removed}"
            )
            lines.append(f"source {i}: {_described(e)}")
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
    engine: str = "opencl",
    device: str | None = None,
    duration: float | None = None,
    chunk: int | None = None,
    convolve_at_rest: bool = True,
) -> Plan:
    """Return the plan of a rendering without carrying it out; arguments as in `render`."""
    if not isinstance(scene, Scene):
        raise InputError("scene", f"must be a Scene, but is {scene!r:.80}")
    if isinstance(paths, PathSet) and paths.scene is not scene:
        raise InputError("paths", "must be those of the scene that is rendered, but belong to another one")
    rate = as_number("sampling_rate", sampling_rate, at_least=1000.0, at_most=100e6, unit="Hz")
    ringing = _check_receivers(scene, rate)
    return plan_tracks(
        [source.emitted for source in scene.sources],
        track(paths, motion=motion, amplitude=amplitude, transition=transition),
        sampling_rate,
        starts=[source.start for source in scene.sources],
        interpolator=interpolator,
        response_error_db=response_error_db,
        engine=engine,
        device=device,
        duration=duration,
        chunk=chunk,
        ringing=ringing,
        convolve_at_rest=convolve_at_rest,
    )


def plan_tracks(
    signals: Sequence[Signal],
    tracks: Tracks,
    sampling_rate: float,
    *,
    starts: Sequence[float] | None = None,
    interpolator: Interpolator | None = None,
    response_error_db: float | str = DEFAULT_RESPONSE_ERROR_DB,
    engine: str = "opencl",
    device: str | None = None,
    duration: float | None = None,
    chunk: int | None = None,
    ringing: float = 0.0,
    convolve_at_rest: bool = True,
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
    samples = _samples(signals, starts, tracks, rate, duration, ringing)
    if response_error_db != AT_CENTRE:
        if isinstance(response_error_db, str):
            raise InputError("response_error_db", f"must be dB or {AT_CENTRE!r}, but is {response_error_db!r:.80}")
        as_number("response_error_db", response_error_db, at_least=-120.0, at_most=-20.0, unit="dB")
    if not isinstance(convolve_at_rest, bool | np.bool_):
        raise InputError("convolve_at_rest", f"must be true or false, but is {convolve_at_rest!r:.80}")
    still = NONE_AT_REST
    if convolve_at_rest and engine == "opencl":
        still = find_at_rest(tracks, interpolator, at_centre=response_error_db == AT_CENTRE)
    emissions = []
    for i, (signal, start) in enumerate(zip(signals, starts, strict=True)):
        signal = signal.at_rate(rate)
        high, removed_db, bank = _delay_filters(i, signal, interpolator, tracks, rate)
        _check_known(i, signal, tracks)
        basis = flat_basis(signal.centre_frequency)
        if not still.holds(tracks, i):
            basis = _basis(i, signal, high, tracks, samples / rate, rate, response_error_db, engine)
        banks = tuple(interpolator.weaker(bank, size) for size in basis.sizes)
        emissions.append(Emission(signal, start, banks, basis, high, removed_db))
    draft = Plan(tracks, tuple(emissions), interpolator, rate, samples, SEGMENT, engine, device, still)
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
    band, removed_db = occupied_band(signal, widest, floor_db - 6.0)
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


def _check_known(index: int, signal: Signal, tracks: Tracks) -> None:
    """Refuse, or warn, where walls or beams are not known where a source's signal is."""
    if isinstance(tracks, SceneTracks):
        check_known(tracks.scene, [index], *shares(signal, _MAIN_SHARE), f"the signal of source {index}")


def _basis(
    index: int,
    signal: Signal,
    high: float,
    tracks: Tracks,
    until: float,
    rate: float,
    error_db: float | str,
    engine: str,
) -> Basis:
    """Return the functions of frequency that a source's paths need."""
    if not isinstance(tracks, SceneTracks):
        return flat_basis(signal.centre_frequency)
    frequencies, energy = signal.energy_spectrum()
    below = np.cumsum(energy) / max(float(energy.sum()), 1e-300)
    floor_db = EXACT_DB if isinstance(error_db, str) or engine == "reference" else error_db
    low = float(frequencies[np.searchsorted(below, 10 ** ((floor_db - 6.0) / 10))])
    low = min(max(low, frequencies[1]), 0.999 * high)
    if not isinstance(error_db, str):
        floor_db = min(floor_db, error_db)
        band = partial(band_of, low, high, frequencies, energy)
        return scene_basis(tracks, index, band, until, rate, floor_db)
    if is_complex(tracks.scene):
        return turning_basis(signal.centre_frequency, low, high, rate, floor_db)
    return flat_basis(signal.centre_frequency)


def _described(emission: Emission) -> str:
    """Return how air, walls and beams are carried, and what it costs."""
    basis = emission.basis
    if not math.isfinite(basis.asked_db):
        return f"air, walls and beams are those at {basis.nodes[0]:.6g} Hz"
    if len(basis) == 1 and basis.at_one_frequency:
        return f"air, walls and beams hardly change over the signal's band ({basis.error_db:.1f} dB)"
    rows, most = int(emission.rows[-1]), len(emission.bank.taps)
    return (
        f"{len(basis)} functions of frequency carry air, walls and beams within {basis.error_db:.1f} dB "
        f"({rows} branch signals, {rows / most:.1f} times the work of one function)"
    )


def _chunk(plan: Plan, chunk: int | None) -> int:
    """Return the chunk's length in whole segments: as asked, or long against the delays and small in memory."""
    whole = math.ceil(plan.samples / SEGMENT)
    if chunk is not None:
        return SEGMENT * min(whole, math.ceil(as_count("chunk", chunk, at_least=1) / SEGMENT))
    span = max(plan.longest_delay(s) for s in range(len(plan.emissions))) * plan.sampling_rate
    wanted = math.ceil(4.0 * span / SEGMENT)
    affordable = _PRESSURE_BUDGET // (4 * SEGMENT * plan.receiver_count)
    return SEGMENT * max(1, min(whole, max(8, min(wanted, 48)), affordable))


def _warn(message: str) -> None:
    warnings.warn(message, ClsimWarning, stacklevel=5)


def node_times(start: int, block: int, blocks: int, sampling_rate: float) -> Floats:
    """Return the times of a run's nodes: starts of its blocks, one before, and two after, s."""
    return (start + block * np.arange(-1, blocks + 2, dtype=np.float64)) / sampling_rate
