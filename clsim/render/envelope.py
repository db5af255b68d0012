"""Complex envelopes of emitted signals, narrow bands and the rest that a signal is split into, and their filters."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from fractions import Fraction
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Complexes, Floats, read_only
from clsim.numerics.band_filters import magnitudes
from clsim.numerics.convolution import low_pass_between
from clsim.paths.channel import ImpulseResponse
from clsim.render.baseband import WIDEST_SUBBLOCK, Baseband, half_band
from clsim.render.contributions import digest_of
from clsim.render.interpolator import Bandlimited, Bank
from clsim.render.methods.costs import measured_costs
from clsim.render.mixer import Mixer
from clsim.render.opencl.batches import CELL
from clsim.render.source_filters import Emission, SourceFilters, filtered
from clsim.render.tilt import WHOLE, Stretches, bank_of, cheapest, stretches_of
from clsim.scene.signal.occupied_bandwidth import CELLS, ShortTimeSpectra
from clsim.scene.signal.signal import Signal
from clsim.tracks.basis import Basis

_MARGIN_DB = 10.0  # by which the low-pass is better than the delay filters
_ROUNDED = 0.505  # samples, of a delay about the whole ones in the middle of a vector
_NARROWEST = 0.05  # of half the sampling rate, the least band of the delay filters


@dataclass(frozen=True, slots=True, eq=False)
class EnvelopeFilters(SourceFilters):
    """One source's complex envelope and the filters for it; what is removed lies outside the band on either side."""

    carrier: float  # hz
    half: float  # frequencies off the carrier that are held, Hz
    mixer: Mixer  # applies the functions of the basis that have branches of their own
    plain: Mixer  # applies none
    stretches: Stretches = WHOLE  # of delays: each has banks and streams of all functions, side by side

    @property
    def banks_of_stretch(self) -> tuple[Bank, ...]:
        return self.banks[: len(self.banks) // self.stretches.count]

    @property
    def counts(self) -> int:
        """Branches of each function that has some, four bits each from the lowest; 0 if they are too many for that."""
        counts = [len(bank.taps) for bank in self.banks_of_stretch]
        return sum(n << 4 * k for k, n in enumerate(counts)) if len(counts) < 8 and max(counts) < 16 else 0

    @property
    def cycles(self) -> float:
        """Phase of the carrier over one sample of the envelope."""
        return self.carrier * self.mixer.every / self.signal.sampling_rate

    @property
    def rate(self) -> float:
        return self.signal.sampling_rate / self.mixer.every

    @property
    def held(self) -> tuple[float, float]:
        return self.carrier - self.half, self.carrier + self.half

    def streams(self, first: int, last: int) -> NDArray[Any]:
        """Return samples `first` to `last` of the envelope through each function of the basis, (K, n) complex."""
        mixed = self.mixer(self.signal.read, first, last)
        return np.stack([mixed, 1j * mixed], axis=1).reshape(-1, last - first) if self.basis.paired else mixed

    def active(self, first: int, last: int) -> tuple[NDArray[np.int64], NDArray[Any]]:
        """Return the non-zero samples of streams with branches from `first` to `last`: offsets (n,), values (K, n)."""
        streams = self.mixer(self.signal.read, first, last, single=True)
        places = np.arange(last - first) if streams[0].all() else np.flatnonzero(np.any(streams, axis=0))
        return places, streams if len(places) == last - first else streams[:, places]

    def emitted(self, first: int, last: int) -> NDArray[Any]:
        return np.asarray(self.plain(self.signal.read, first, last)[0])

    def digest(self) -> str:
        return digest_of(SourceFilters.digest(self), self.mixer.taps, self.plain.taps)

    def acting(self, response: ImpulseResponse) -> ImpulseResponse:
        """Return an impulse response at the signal's sampling rate as it acts on the envelope, at that one's rate.

        Both are made alike: where the low-pass is flat, the spectrum of a response's envelope is twice the response
        about the carrier, over the samples of sound in one of the envelope.
        """
        every, half = self.plain.every, self.plain.half_length
        first, last = response.first // every - half, response.last // every + half + 1
        return ImpulseResponse(first, 0.5 * every * self.plain(response.read, first, last)[0])

    def cost(self) -> float:
        return measured_costs().envelope

    def carrier_phase(self, delay_samples: Floats) -> Complexes:
        """Return the carrier's phase ``exp(-2 pi j carrier delay)`` of delays (P, n), samples of the envelope."""
        return np.asarray(np.exp(-2j * math.pi * self.cycles * delay_samples))

    def describe_filters(self) -> str:
        removed = "none" if np.isneginf(self.removed_db) else f"{self.removed_db:.0f} dB"
        return (
            f"filters of {len(self.bank.taps)} branches hold {self.half:.0f} Hz on either side of "
            f"{self.carrier:.0f} Hz within {self.bank.error_db:.1f} dB; share of the signal outside: {removed}"
        )


def design_envelope(emission: Emission) -> EnvelopeFilters:
    """Return a source's complex envelope with filters for its band and motion; the interpolator is `Bandlimited`."""
    signal, options = emission.signal, emission.options
    assert options.baseband is not None
    baseband = Baseband(*options.baseband)
    half, removed_db = half_band(emission.source, signal, emission.spectrum(), baseband, emission.max_rate)
    carrier, _, rate = baseband
    # What would be folded onto what is held, or is the image of the carrier, which the signal's rate may bring nearer:
    # where it all but touches the band it stays, beside what is held.
    image = min(2.0 * carrier, max(signal.sampling_rate - 2.0 * carrier, 2.5 * half))
    stop = min(rate or 0.0, image) - half
    low_pass = low_pass_between(half, stop, signal.sampling_rate, -options.interpolator.error_db + _MARGIN_DB)
    return envelope_filters(emission, half, low_pass, removed_db)


def envelope_filters(
    emission: Emission, half: float, low_pass: Floats, removed_db: float, *, tilted: bool = False
) -> EnvelopeFilters:
    """Return filters for the envelope of a source's signal through a low-pass (n,) about the options' carrier.

    The even part of the air's absorption over the band is an imaginary delay, if it may be (`tilted`).
    """
    options = emission.options
    assert options.baseband is not None
    baseband, interpolator = Baseband(*options.baseband), options.interpolator
    assert isinstance(interpolator, Bandlimited)  # as the options have checked
    sampling_rate, max_rate = emission.signal.sampling_rate, emission.max_rate
    rate, held = baseband.sampling_rate or 0.0, (baseband.carrier - half, baseband.carrier + half)
    edge = 2.0 * math.pi * max(half / rate, 0.5 * _NARROWEST)
    edge = math.ceil(edge * 64) / 64
    ends = edge * rate / (2.0 * math.pi) * np.arange(CELLS + 1) / CELLS
    gain = magnitudes(low_pass[None], 2.0 * math.pi / sampling_rate * ends)[0]
    passed = np.maximum(gain[1:], gain[:-1])
    mu_max = math.ceil((_ROUNDED + 0.5 * (WIDEST_SUBBLOCK - 1) * max_rate) * 32) / 32

    def designed(stretches: Stretches) -> tuple[Basis, tuple[Bank, ...], Stretches]:
        """Return functions of frequency beside a tilt, their banks, and its stretches."""
        basis = emission.basis(held, sampling_rate, envelope=True, tilt=stretches.tilt)
        own = basis.sizes[:: 1 + int(basis.paired)].tolist()
        away = emission.sound.importance(ends[-1], basis.loudness, baseband.carrier)
        banks = (bank_of(size, away * passed, interpolator, edge, mu_max, stretches) for size in own)
        return basis, tuple(banks), stretches

    basis, banks, stretches = cheapest(emission, stretches_of(emission, held, rate, edge, tilted), designed)
    every, own = round(sampling_rate / rate), basis.filters[:: 1 + int(basis.paired)]
    mixed, plain = (_mixed(sampling_rate, baseband.carrier, low_pass, f) for f in (own, np.ones((1, 1))))
    about, turn = (sampling_rate, baseband.carrier, half, every), Fraction(baseband.carrier) / Fraction(sampling_rate)
    mixer = Mixer.of(
        stretches.filters(mixed, *about), every, turn, mixed, lambda f: stretches.acting(f * sampling_rate, *about)
    )
    plain_mixer = Mixer.of(plain, every, turn)
    highest = baseband.carrier + 0.5 * baseband.bandwidth
    return EnvelopeFilters(
        emission.signal, emission.start, banks * stretches.count, basis, basis.filters, np.ones(1), highest, highest,
        1, removed_db, baseband.carrier, half, mixer, plain_mixer, stretches,
    )  # fmt: skip


def _mixed(rate: float, carrier: float, low_pass: Floats, filters: Floats) -> Complexes:
    """Return taps that mix sound at a rate, Hz, with filters (K, L) of odd length about their middle tap."""
    length = len(low_pass)
    # Twice, for half of a real signal is on the carrier's negative side.
    mixed = 2.0 * low_pass * np.exp(-2j * math.pi * (carrier / rate) * (np.arange(length) - length // 2))
    return np.stack([np.convolve(f[::-1], mixed) for f in filters])


MARGIN_DB = 10.0  # by which what is taken for silence is better than asked
_RIPPLE_DB = 15.0  # the same of the band-pass: what it leaves of a steady tone is silence
LEVEL_TIME = 0.02  # s, of the windows whose level with that of their neighbours is what sounds about a sample
_FAR_BELOW = 0.5  # of the level of silence: what cells of noise may be louder than its mean
_SILENT = 1e-10  # energy of the rest in a window relative to the whole, below which nothing is designed for it: -100 dB


@dataclass(frozen=True, slots=True, eq=False)
class NarrowBand:
    """A band about a carrier, and the band-pass that takes it out of a signal."""

    baseband: Baseband  # in which what is received of it is rendered, with its sampling rate
    flat: float  # frequencies off the carrier that are passed as they are, Hz
    half: float  # frequencies off the carrier from which on nothing is passed, Hz
    low_pass: Floats  # (n,) the band-pass about 0 Hz, without delay, of odd length, at the signal's sampling rate

    @classmethod
    def designed(cls, baseband: Baseband, flat: float, half: float, rate: float, error_db: float) -> NarrowBand:
        """Return a band at a sampling rate, Hz, for the error requested of the whole rendering."""
        low_pass = low_pass_between(flat, half, rate, MARGIN_DB + _RIPPLE_DB - error_db)
        return cls(baseband, flat, half, low_pass)

    @property
    def reach(self) -> int:
        """Samples by which the band-pass looks to either side."""
        return len(self.low_pass) // 2

    def left(self, frequencies: Floats) -> Floats:
        """Return the gain of the band-stop at evenly spaced frequencies (F,) from 0 to half the sampling rate."""
        return _left(self, len(frequencies), 2.0 * float(frequencies[-1]))

    def band_pass(self, rate: float) -> Floats:
        """Return the taps (n,) of the band-pass at a sampling rate, Hz."""
        step = 2.0 * math.pi * self.baseband.carrier / rate
        return np.asarray(2.0 * self.low_pass * np.cos(step * np.arange(-self.reach, self.reach + 1)))


@lru_cache(maxsize=64)  # of some 30 KB each: windows of several kinds are asked about the same split
def _left(band: NarrowBand, count: int, rate: float) -> Floats:
    """Return the gain of a band-stop at evenly spaced frequencies (count,) from 0 to half the sampling rate, Hz."""
    away = np.abs(np.linspace(0.0, 0.5 * rate, count) - band.baseband.carrier)
    left, between = np.where(away <= band.flat, 0.0, 1.0), (away > band.flat) & (away < band.half)
    # The transform has as many points as the frequencies ask for, or a multiple of that, which holds all taps.
    size, places = 2 * (count - 1), np.arange(-band.reach, band.reach + 1)
    times = -(-len(band.low_pass) // size)
    placed = np.zeros(times * size, dtype=np.complex128)
    placed[places % len(placed)] = band.low_pass * np.exp(2j * math.pi * band.baseband.carrier / rate * places)
    passed = np.fft.fft(placed).real[: times * count : times]
    left[between] = 1.0 - passed[between]
    return read_only(left)


@dataclass(frozen=True, slots=True, eq=False)
class Split:
    """Bands that are taken out of a signal, none overlapping another, and what is left of it."""

    bands: tuple[NarrowBand, ...]  # one or more
    silence: float  # level relative to what sounds within some 40 ms, below which the rest is silent
    quiet: bool = False  # whether the rest is known to be silent where the signal's level is constant

    @classmethod
    def into(cls, bands: tuple[NarrowBand, ...], error_db: float, steady: ShortTimeSpectra | None = None) -> Split:
        """Return the split into bands, for the error requested of the whole rendering, and windows of steady sound."""
        made = cls(bands, 10 ** ((error_db - MARGIN_DB) / 20))
        if steady is None or not len(steady.energy):
            return made
        left = steady.energy @ made.left(steady.frequencies) ** 2
        return replace(made, quiet=bool(left.max() < _FAR_BELOW**2 * made.silence**2))

    @property
    def reach(self) -> int:
        """Samples by which the band-passes look to either side."""
        return max(band.reach for band in self.bands)

    def rest(self, signal: Signal, first: int, last: int) -> Floats:
        """Return samples `first` to `last` of what is left of a signal, exactly zero where that is silent.

        Silence is looked for in cells of 16 samples, relative to the level of what sounds within 20 to 40 ms.
        """
        begin, end, window, before, after = self._windows(signal, first, last)
        offset = before * window
        if self.leaves_nothing(signal, first, last):
            return np.zeros(last - first)
        whole, left = signal.read(offset, after * window), np.zeros(end - begin)
        single = whole.astype(np.float32)  # rounds at -140 dB
        places, passed = filtered(lambda a, b: single[a - offset : b - offset], self._band_pass(signal), begin, end)
        if len(places) == len(left):
            left = whole[begin - offset : end - offset] - passed[0]
        else:
            left[places] = whole[begin - offset :][places] - passed[0]
        level = np.sqrt(np.mean(whole.reshape(after - before, window) ** 2, axis=1))
        around = np.max([level[:-2], level[1:-1], level[2:]], axis=0)
        of_cell = around[np.arange(begin, end, CELL) // window - before - 1]
        cells = left.reshape(-1, CELL)
        cells[np.sqrt(np.mean(cells**2, axis=1)) <= self.silence * of_cell] = 0.0
        return left[first - begin : last - begin]

    def _windows(self, signal: Signal, first: int, last: int) -> tuple[int, int, int, int, int]:
        """Return the cells about some samples, the length of windows, and those with neighbours about the cells."""
        begin, end = first // CELL * CELL, -(-last // CELL) * CELL
        window = math.ceil(max(LEVEL_TIME * signal.sampling_rate, self.reach) / CELL) * CELL
        return begin, end, window, begin // window - 1, -(-end // window) + 1

    def leaves_nothing(self, signal: Signal, first: int, last: int) -> bool:
        """Test whether samples `first` to `last` are those of a steady tone, noise or sweep that is removed.

        The level of a tone is 3 dB below its amplitude; what the band-pass leaves of it and of its image is 6 dB below
        silence.
        """
        begin, end, window, before, after = self._windows(signal, first, last)
        band = signal.steady_band(min(before * window, begin - self.reach), max(after * window, end + self.reach))
        if band is None or self.quiet or len(self.bands) > 1:
            return band is not None and self.quiet
        return max(abs(end - self.bands[0].baseband.carrier) for end in band) <= self.bands[0].flat

    def left(self, frequencies: Floats) -> Floats:
        """Return the gain of all band-stops at evenly spaced frequencies (F,) up to half the sampling rate."""
        return np.asarray(np.prod([band.left(frequencies) for band in self.bands], axis=0))

    def within(self, error_db: float) -> Split:
        """Return the same split for another error requested of the rendering."""
        return replace(self, silence=10 ** ((error_db - MARGIN_DB) / 20))

    def loud_in(self, sound: ShortTimeSpectra, silent: float = _SILENT) -> NDArray[np.bool_]:
        """Test in which windows (W,) of a sound the rest is not silent, relative to the whole."""
        return np.asarray(sound.energy @ self.left(sound.frequencies) ** 2 > max(silent, self.silence**2))

    def rest_of(self, sound: ShortTimeSpectra) -> ShortTimeSpectra:
        """Return the short-time spectra of the rest, relative to the whole, without windows in which it is silent."""
        loud = self.loud_in(sound)
        energy = sound.energy[loud] * self.left(sound.frequencies) ** 2
        return ShortTimeSpectra(sound.frequencies, energy, sound.weights[loud])

    def _band_pass(self, signal: Signal) -> NDArray[Any]:
        """Return all band-passes together, (1, n) float32."""
        taps = np.zeros(2 * self.reach + 1)
        for band in self.bands:
            taps[self.reach - band.reach : self.reach + band.reach + 1] += band.band_pass(signal.sampling_rate)
        return np.asarray(taps[None], dtype=np.float32)


@dataclass(frozen=True, slots=True, eq=False)
class RestFilters(SourceFilters):
    """Filters for what narrow parts leave of a source's signal; pairs at rest are convolved with all of it."""

    split: Split  # what is left out
    silent: bool  # whether all of it is silent

    @property
    def filter_half(self) -> int:
        """Samples by which the band filters extend the signal to either side, without the delay filters."""
        return int(self.filters.shape[1] // 2) + self.oversampling * (self.split.reach + CELL)

    @property
    def residual_db(self) -> float:
        """Infinite: engines know the residual of the rest, but not its level relative to the narrow part."""
        return math.inf

    def emitted_samples(self, first: int, last: int) -> Floats:
        return self.split.rest(self.signal, first, last)

    def is_silent(self, first: int, last: int) -> bool:
        half = self.filters.shape[1] // 2
        own = (first - half) // self.oversampling, -((-last - half) // self.oversampling)
        return self.split.leaves_nothing(self.signal, *own)

    def digest(self) -> str:
        return SourceFilters.digest(self) + digest_of(*(band.low_pass for band in self.split.bands))


@dataclass(frozen=True, slots=True, eq=False)
class NarrowFilters(EnvelopeFilters):
    """Filters for the envelope of a narrow part."""

    @property
    def filter_half(self) -> int:
        """Samples of the envelope by which it is longer than the signal to either side, without the delay filters."""
        return self.mixer.half_length


def design_split(emission: Emission, split: Split) -> tuple[RestFilters, tuple[NarrowFilters, ...]]:
    """Return the filters for what narrow parts leave of a source's signal, and for each of these."""
    emission = replace(emission, drawn=emission.drawn_for_bands)
    rest_sound = split.rest_of(emission.sound)
    rest = replace(emission, sound=rest_sound).source_filters()
    parts = []
    for band in split.bands:
        within = replace(emission.options, baseband=band.baseband, narrowband=None)
        part = envelope_filters(replace(emission, options=within), band.half, band.low_pass, -math.inf, tilted=True)
        parts.append(NarrowFilters(**_columns(part)))
    return RestFilters(**_columns(rest), split=split, silent=not len(rest_sound.energy)), tuple(parts)


def _columns(made: SourceFilters) -> dict[str, Any]:
    return {f.name: getattr(made, f.name) for f in fields(made)}
