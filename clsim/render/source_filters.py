"""Filters of a source's signal: fractional delays, and the responses of air, walls and directivities over its band."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Complexes, Floats
from clsim.errors import InputError, warn
from clsim.numerics.band_filters import magnitudes
from clsim.numerics.convolution import convolved, low_pass_between
from clsim.paths.channel import ImpulseResponse
from clsim.paths.response import check_band_coverage
from clsim.render.contributions import digest_of
from clsim.render.interpolator import Bandlimited, Bank, Interpolator
from clsim.render.methods.costs import measured_costs
from clsim.render.options import RenderOptions
from clsim.scene.signal.occupied_bandwidth import CELLS, ShortTimeSpectra, share_removed, shares, spectra
from clsim.scene.signal.signal import Signal
from clsim.tracks.basis import NO_TILT, Basis, Tilt, band_of, flat_basis
from clsim.tracks.basis_design import scene_basis, turning_basis
from clsim.tracks.picked import TIMES, TIMES_OF_BANDS, Draw
from clsim.tracks.tracks import Tracks

EXACT_DB = -100.0  # error of air, walls and directivities over a signal's band by the reference engine
_MAIN_SHARE = 1e-4  # of a signal's energy at either end of its band, where walls and directivities need not be known
_WIDEST = 0.95  # of Nyquist, the widest band that a bank holds
_WIDEST_OVERSAMPLED = 0.98  # the same where branch signals have twice the sampling rate
_OVERSAMPLED_DB = -40.0  # of the signal's energy beyond that, up to which it is worth it
_LOUD_SHARE_DB = -60.0  # of the signal's energy outside the band, from which on it is a warning
_WEAK_ERROR_DB = -60.0  # of the filter, from which on it is a warning
_LIMIT_DB = 100.0  # by which the band limit stops what lies above the band
_LIMIT_WIDTH, _LEAST_LIMIT_WIDTH = 0.08, 0.02  # of half the sampling rate, over which it falls to that
_LEAST_BIN = 1e-3  # of the spacing of a spectrum's frequencies: where bands begin that go down to 0 Hz
_OF_A_WINDOW = 0.5  # of a window of the short-time spectra in which the rest is loud
_TOGETHER = 8  # frequencies at which devices take responses together
_MAIN_WINDOW_SHARE = 1e-3  # of a window's energy, which a wide band limit may weaken


@dataclass(frozen=True, slots=True, eq=False)
class Emission:
    """Inputs of the filter design of one source: its signal, the paths and the options."""

    source: int  # its index
    signal: Signal  # what it emits, at the sampling rate
    start: float  # time at which that begins, s
    sound: ShortTimeSpectra  # of what is rendered of it
    tracks: Tracks  # paths of all sources
    # Say the sampling rate, the interpolator, and how responses are held: by the reference engine within -100 dB.
    options: RenderOptions
    until: float  # end of the run, s
    static: bool  # all its paths are convolved, so that nothing needs functions of frequency
    # Returns frequencies (n,), Hz, and all of the signal's energy at each (n,); worked out once, when first asked.
    spectrum: Callable[[], tuple[Floats, Floats]]
    drawn: Callable[[], Draw]  # returns paths at which responses are looked at; likewise
    drawn_for_bands: Callable[[], Draw]  # the same at fewer instants, for narrow bands and what they leave
    filters_more: bool  # whether its few paths take many functions, so that these cost more than the paths
    drawn_from: Tracks  # those of its paths alone

    @classmethod
    def of(
        cls, source: int, emitted: tuple[Signal, float], tracks: Tracks, options: RenderOptions, until: float,
        drawn_from: Tracks, *, static: bool, costly: bool = False, filters_more: bool = False,
    ) -> Emission:  # fmt: skip
        """Return that of a signal and its start, s; responses are drawn from some tracks, few if they are costly."""
        signal = emitted[0].at_rate(options.sampling_rate)
        sound, spectrum = spectra(signal)
        draws = [partial(Draw.of, drawn_from, source, until, costly, times=n) for n in (TIMES, TIMES_OF_BANDS)]
        of_run = options, until, static, spectrum, cache(draws[0]), cache(draws[1]), filters_more
        return cls(source, signal, emitted[1], sound, tracks, *of_run, drawn_from)

    @property
    def max_rate(self) -> float:
        """Bound on how fast its delays change, s/s."""
        return self.drawn_from.max_rate(self.source)

    @property
    def field(self) -> str:
        return f"signals[{self.source}]"

    def basis(self, band: tuple[float, float], rate: float, envelope: bool = False, tilt: Tilt = NO_TILT) -> Basis:
        """Return the functions of frequency that its paths need, within a band at most, both in Hz; less a tilt."""
        (least, high), sound, options, of_scene = band, self.sound, self.options, self.tracks.of_scene
        flat = flat_basis(self.signal.centre_frequency)
        if of_scene is None or not len(sound.energy):  # silence needs nothing
            return flat
        main = shares(self.spectrum(), _MAIN_SHARE)
        check_band_coverage(of_scene.paths.scene, [self.source], *main, f"the signal of source {self.source}")
        if self.static:
            return flat
        at_centre, exact = options.responses == "centre", options.engine == "reference"
        floor_db = EXACT_DB if at_centre or exact else options.response_error_db
        low = sound.bounds(10 ** ((floor_db - 6.0) / 10))[0]
        low = min(max(low, least, _LEAST_BIN * float(sound.frequencies[1])), 0.999 * high)
        band_at = cache(partial(band_of, low, high, sound, tilt))
        if not at_centre:
            requested_db, drawn = min(floor_db, options.response_error_db), self.drawn()
            by_formulae = drawn.approximate and options.response_error_db == options.scattering_error_db
            option = "scattering_error_db" if by_formulae else "response_error_db"
            return scene_basis(drawn, band_at, rate, requested_db, envelope and drawn.tracks.paths.turns_phases, option)
        if of_scene.paths.is_complex:
            return turning_basis(self.source, self.signal.centre_frequency, band_at(), rate, floor_db)
        return flat

    def source_filters(self) -> SourceFilters:
        """Design filters for the band of the signal and for how paths move."""
        signal, interpolator = self.signal, self.options.interpolator
        sampling_rate, sound = signal.sampling_rate, self.sound
        times = _oversampling(sound, interpolator, self.max_rate, sampling_rate)
        rate, (high, removed_db, limit) = times * sampling_rate, self.band_limited(times)
        basis = self.basis((0.0, high), rate)
        banks = self.banks(basis.filters, basis.loudness, high, rate, times)
        filters = np.stack([np.convolve(f, limit if times == 1 else _doubling(sampling_rate)) for f in basis.filters])
        swiftness = min(sound.swiftness(), high) or high
        return SourceFilters(signal, self.start, banks, basis, filters, limit, high, swiftness, times, removed_db)

    def cost_of_whole(self) -> float:
        """Processor time of a path in a sample of all that is emitted, ns."""
        assert isinstance(self.options.interpolator, Bandlimited)
        low, high = self.sound.bounds(10 ** ((self.options.interpolator.error_db - 6.0) / 10))
        known = measured_costs()
        return self._numbers * (known.plain + known.wide * (high - low) / (0.5 * self.signal.sampling_rate))

    @property
    def _numbers(self) -> int:
        """Real gains in place of one: two where fields turn phases. Those of envelopes are complex and cost as one."""
        of_scene = self.drawn_from.of_scene
        return 1 + int(of_scene is not None and of_scene.paths.turns_phases)

    def cost_of_rest(self, loud: float) -> float:
        """Processor time, ns, of what narrow bands leave, by the share of time in which that is not silent.

        Functions of frequency are then for that time alone, and on average it lasts for half of a window of the
        spectra.
        """
        known = measured_costs()
        of_functions = self.cost_of_whole() - self._numbers * known.plain
        return (of_functions + self._numbers * _OF_A_WINDOW * known.rest) * loud

    def band_limited(self, times: int) -> tuple[float, float, Floats]:
        """End of the band that matters, Hz, the share of the energy above it, dB, and the band limit."""
        sound, interpolator = self.sound, self.options.interpolator
        rate = self.signal.sampling_rate
        widest = (_WIDEST if times == 1 else _WIDEST_OVERSAMPLED) * 0.5 * rate / (1.0 + self.max_rate)
        band = max(sound.bounds(10 ** ((interpolator.error_db - 6.0) / 10))[1], 0.05 * widest)
        if band <= widest:
            return band, -math.inf, np.ones(1)
        spectrum = self.spectrum()
        limit = _band_limit(sound.bounds(_MAIN_WINDOW_SHARE)[1], widest, rate) if times == 1 else np.ones(1)
        low_pass = limit if times == 1 else _doubling(rate)
        removed_db = share_removed(spectrum, low_pass, times * rate)
        unmoved = 0.5 * rate * (_WIDEST_OVERSAMPLED if isinstance(interpolator, Bandlimited) else _WIDEST)
        self._check_received(spectrum, widest, unmoved)
        if removed_db > _LOUD_SHARE_DB:
            warn(
                f"{self.field}: {removed_db:.0f} dB of its energy lies above {widest:.0f} Hz, the band of the delay "
                "filters at this sampling rate and speed, and is removed; fade or window the signal, or sample faster"
            )
        return widest, removed_db, limit

    def _check_received(self, spectrum: tuple[Floats, Floats], widest: float, unmoved: float) -> None:
        """Refuse a signal that has more than half of its energy above the band, by itself (`unmoved`) or by Doppler."""
        middle = shares(spectrum, 0.5)[1]
        if middle <= widest:
            return
        rate = self.signal.sampling_rate
        if self.max_rate == 0.0 or middle >= unmoved:
            raise InputError(
                self.field,
                f"must lie below {widest:.0f} Hz at a sampling rate of {rate:g} Hz, but half of its energy lies at "
                f"{middle:.0f} Hz and above: sample faster",
            )
        speed, most = self.tracks.fastest(self.source, unmoved / middle - 1.0)
        raise InputError(
            self.field,
            f"must be received below {unmoved:.0f} Hz at a sampling rate of {rate:g} Hz, but at speeds of up to "
            f"{speed:.4g} m/s Doppler takes half of it, {middle:.0f} Hz and above, beyond: sample faster, or "
            f"stay below {most:.4g} m/s",
        )

    def banks(self, taps: Floats, loudness: Floats, high: float, rate: float, times: int) -> tuple[Bank, ...]:
        """Delay filters for each function of frequency, with its taps (K, L), by what it carries of the sound."""
        interpolator, max_rate = self.options.interpolator, self.max_rate
        edge = min(math.ceil(2.0 * math.pi * high / rate * 64) / 64, 0.97 * math.pi)  # so that designs are found again
        importance = self.sound.importance(edge * rate / (2.0 * math.pi), loudness)
        fine = edge * (np.arange(8 * CELLS) + 0.5) / (8 * CELLS)
        carried = magnitudes(taps, fine).reshape(len(taps), CELLS, 8).max(axis=2)
        banks = tuple(interpolator.bank(edge, max_rate, tuple((importance * row).tolist()), times) for row in carried)
        if banks[0].error_db > _WEAK_ERROR_DB:
            warn(
                f"{self.field}: the delay filters are wrong by up to {banks[0].error_db:.0f} dB for content at "
                f'{high:.0f} Hz; sample faster or use the "bandlimited" interpolator'
            )
        return banks


@dataclass(frozen=True, slots=True, eq=False, weakref_slot=True)
class SourceFilters:
    """One source's signal and the filters for it."""

    signal: Signal  # at the sampling rate of the recording
    start: float  # time at which it begins, s
    # Branch filters for each function of the basis, of `Basis.paired` ones for the first of two; fewer for those that
    # add little.
    banks: tuple[Bank, ...]
    basis: Basis  # functions of frequency that carry the responses of its paths
    # (K, L) the functions of the basis behind the band limit, as filters of odd length about their middle tap.
    filters: Floats
    # (M,) low-pass without delay that removes what lies above the band, of odd length; a single 1 where nothing does.
    band_limit: Floats
    band: float  # highest frequency that the bank holds, Hz
    swiftness: float  # frequency by which an error of a delay is heard, Hz
    oversampling: int  # samples of the branch signals in one of the recording, 1 or 2
    # Share of the signal's energy that is removed, above the band and where the band limit falls, dB; -inf for none.
    removed_db: float

    @property
    def bank(self) -> Bank:
        return self.banks[0]

    @property
    def rate(self) -> float:
        """Sampling rate of the branch signals, Hz."""
        return self.oversampling * self.signal.sampling_rate

    @property
    def delay_samples(self) -> float:
        """Offset added to delays, samples of the branch signals."""
        return self.start * self.rate - self.bank.shift

    @property
    def filter_half(self) -> int:
        """Taps on either side of the filters' middle."""
        return int(self.filters.shape[1] // 2)

    def emitted_between(self, rate: float) -> tuple[float, float]:
        """Return start and end, s, of the signal through the filters, which extend it, at a sampling rate in Hz."""
        spread = self.filter_half / rate
        return self.start - spread, self.start + self.signal.duration + spread

    @property
    def half_length(self) -> int:
        """Half length of the filters, samples: the longest ringing before a path's first arrival."""
        return -(-(self.filter_half + self.bank.half_length) // self.oversampling)

    @property
    def residual_db(self) -> float:
        """Residual of the functions of frequency relative to the received signal, dB, above which engines warn."""
        return self.basis.requested_db + 1.0

    @property
    def rows(self) -> NDArray[Any]:
        """First branch of every function, and the number of all branches at the end, (K + 1,) int."""
        step = 1 + int(self.basis.paired)
        counts = np.zeros(step * len(self.banks), dtype=np.int64)
        counts[::step] = [len(bank.taps) for bank in self.banks]
        return np.append(0, np.cumsum(counts))

    @property
    def banks_of_stretch(self) -> tuple[Bank, ...]:
        """Those of delays that lie together: of sound all, of envelopes each stretch of delays has the same again."""
        return self.banks

    def digest(self) -> str:
        return digest_of(self.basis.projection, self.filters, *(bank.taps for bank in self.banks), self.band_limit)

    def streams(self, first: int, last: int) -> NDArray[Any]:
        """Return samples `first` to `last`, at `rate`, of the signal through each function of the basis, (K, n)."""
        places, values = self.active(first, last)
        out = np.zeros((len(self.basis), last - first))
        out[:, places] = values
        return out

    def active(self, first: int, last: int) -> tuple[NDArray[np.int64], Floats]:
        """Return the non-zero samples of those streams from `first` to `last`: offsets (n,) and values (K, n)."""
        return filtered(self._read, self.filters, first, last)

    def is_silent(self, first: int, last: int) -> bool:
        """Test whether those streams are known to be zero, without making them."""
        return False

    def emitted_samples(self, first: int, last: int) -> Floats:
        """Return samples `first` to `last` of the signal that is rendered path by path."""
        return self.signal.read(first, last)

    def _read(self, first: int, last: int) -> Floats:
        """Return samples at `rate` of the signal that is rendered path by path, with zeros between its own samples."""
        if self.oversampling == 1:
            return self.emitted_samples(first, last)
        before, times = first // self.oversampling, self.oversampling
        own = self.emitted_samples(before, -(-last // times))
        return np.kron(own, np.eye(1, times)[0])[first - times * before :][: last - first]

    def carrier_phase(self, delay_samples: Floats) -> Floats | Complexes | float:
        """Return the factor by which delays (P, n), samples, turn the phase of what is carried: 1 of sound as it is."""
        return 1.0

    @property
    def held(self) -> tuple[float, float]:
        """Frequencies between which sound is not removed on purpose, Hz."""
        return 0.0, 0.5 * self.signal.sampling_rate

    def emitted(self, first: int, last: int) -> NDArray[Any]:
        """Return samples `first` to `last` of the signal that is convolved with impulse responses."""
        places, values = filtered(self.signal.read, self.band_limit[None], first, last)
        out = np.zeros(last - first)
        out[places] = values[0]
        return out

    def acting(self, response: ImpulseResponse) -> ImpulseResponse:
        """Return an impulse response at the signal's sampling rate as it acts on what is emitted."""
        return response

    def describe_filters(self) -> str:
        """Describe the delay filters in a sentence."""
        removed = "none" if np.isneginf(self.removed_db) else f"{self.removed_db:.0f} dB"
        lead = self.half_length / self.signal.sampling_rate
        return (
            f"filters of {len(self.bank.taps)} branches hold up to {self.band:.0f} Hz within "
            f"{self.bank.error_db:.1f} dB; share of the signal above, which is removed: {removed}; they ring up to "
            f"{self.half_length} samples ({1e3 * lead:.3g} ms) before an arrival"
            + ("; the signal is taken at twice the sampling rate" if self.oversampling > 1 else "")
        )

    def describe(self) -> str:
        """Describe the approximation of air, walls and directivities, and its cost."""
        basis = self.basis
        if not math.isfinite(basis.requested_db):
            return f"air, walls and directivities are those at {basis.nodes[0]:.6g} Hz"
        if len(basis) == len(basis.nodes) == 1:
            return f"air, walls and directivities hardly change over the signal's band ({basis.error_db:.1f} dB)"
        rows, most = int(self.rows[-1]), len(self.bank.taps)
        return (
            f"{len(basis)} functions of frequency, taken at {len(basis.nodes)} frequencies, carry air, walls and "
            f"directivities within {basis.error_db:.1f} dB ({rows} branch signals, {rows / most:.1f} times the work of "
            "one function)"
        )

    def cost(self) -> float:
        """Processor time of a path in a sample, ns."""
        known, times = measured_costs(), -(-len(self.basis.nodes) // _TOGETHER)
        return known.second * times**2 / self.rate + known.function * len(self.basis)


def _oversampling(sound: ShortTimeSpectra, interpolator: Interpolator, max_rate: float, rate: float) -> int:
    """Return 2 if a signal's band ends so near half the sampling rate that it needs twice that rate, else 1."""
    nyquist = 0.5 * rate / (1.0 + max_rate)
    if not isinstance(interpolator, Bandlimited) or sound.bounds(_MAIN_WINDOW_SHARE)[1] <= _WIDEST * nyquist:
        return 1
    return 2 if sound.bounds(10 ** (_OVERSAMPLED_DB / 10))[1] <= _WIDEST_OVERSAMPLED * nyquist else 1


def _doubling(rate: float) -> Floats:
    """Return the low-pass behind a signal's samples with zeros between them, at twice its rate in Hz."""
    passed = 0.5 * _WIDEST_OVERSAMPLED * rate
    return 2.0 * low_pass_between(passed, rate - passed, 2.0 * rate, _LIMIT_DB)


def _band_limit(main: float, stop: float, rate: float) -> Floats:
    """Return Kaiser's low-pass that stops at `stop` Hz, and leaves what lies below `main` Hz if there is room."""
    width = 0.5 * rate * float(np.clip((stop - main) / (0.5 * rate), _LEAST_LIMIT_WIDTH, _LIMIT_WIDTH))
    return low_pass_between(stop - width, stop, rate, _LIMIT_DB)


def filtered(
    read: Callable[[int, int], NDArray[Any]], filters: NDArray[Any], first: int, last: int
) -> tuple[NDArray[np.int64], Floats]:
    """Return the non-zero samples of a filtered signal from `first` to `last`: offsets (n,) and values (K, n).

    What no sound reaches is silent, without the rounding of transforms; pauses cost nothing.
    """
    half = filters.shape[1] // 2
    length = 2 * half  # of a sample, into what is filtered before it
    samples = read(first - half, last + half)
    if _sounds_throughout(samples, half + 1):
        return np.arange(last - first), np.asarray(convolved(samples, filters)[:, length : length + last - first])
    active = np.flatnonzero(samples)
    if not len(active):
        return active, np.zeros((len(filters), 0))
    pause = np.flatnonzero(np.diff(active) > length + 1)
    begins = np.maximum(active[np.concatenate([[0], pause + 1])] - length, 0)
    lengths = np.minimum(active[np.concatenate([pause, [-1]])] + 1, last - first) - begins
    places = _ranges(begins, lengths)
    if length == 0:
        return places, samples[places] * filters
    together = samples[_ranges(begins, lengths + length)]  # without the pauses
    within = _ranges(np.cumsum(lengths + length) - lengths, lengths)
    return places, np.asarray(convolved(together, filters)[:, within])


def _sounds_throughout(samples: NDArray[Any], count: int) -> bool:
    """Test that no aligned block of `count` samples, nor the last `count`, is all zero."""
    if len(samples) < 2 * count:
        return False
    whole = samples[: len(samples) // count * count].reshape(-1, count)
    return bool(np.all(np.any(whole, axis=1)) and np.any(samples[-count:]))


def _ranges(begins: NDArray[np.int64], lengths: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return whole numbers from each beginning on, range after range."""
    ends = np.cumsum(lengths)
    return np.repeat(begins - ends + lengths, lengths) + np.arange(int(ends[-1]) if len(ends) else 0)
