"""Narrow parts of what a source emits, and the rest: band-passes split them, and their sum is the signal."""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.numerics.resampling import low_pass_between
from clsim.render.envelope import EnvelopeFilters, envelope_filters
from clsim.render.opencl.batches import CELL
from clsim.render.source_filters import Emission, SourceFilters, design_source_filters, filtered
from clsim.scene.signal.occupied_bandwidth import ShortTimeSpectra

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Floats
    from clsim.render.baseband import Baseband
    from clsim.scene.signal.signal import Signal

MARGIN_DB = 10.0  # by which what is taken for silence is better than asked
_RIPPLE_DB = 15.0  # the same of the band-pass: what it leaves of a steady tone is silence
LEVEL_TIME = 0.02  # s, of the windows whose level with that of their neighbours is what sounds about a sample
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
        """Return the gain of the band-stop at evenly spaced frequencies (F,) up to half the sampling rate."""
        away = np.abs(frequencies - self.baseband.carrier)
        left, bins = np.where(away <= self.flat, 0.0, 1.0), np.flatnonzero((away > self.flat) & (away < self.half))
        rate = 2.0 * float(frequencies[-1])
        turns = np.outer(away[bins] * (2.0 * math.pi / rate), np.arange(-self.reach, self.reach + 1))
        left[bins] = 1.0 - np.cos(turns) @ self.low_pass
        return left

    def band_pass(self, rate: float) -> Floats:
        """Return the taps (n,) of the band-pass at a sampling rate, Hz."""
        step = 2.0 * math.pi * self.baseband.carrier / rate
        return np.asarray(2.0 * self.low_pass * np.cos(step * np.arange(-self.reach, self.reach + 1)))


@dataclass(frozen=True, slots=True, eq=False)
class Split:
    """Bands that are taken out of a signal, none overlapping another, and what is left of it."""

    bands: tuple[NarrowBand, ...]  # one or more
    silence: float  # level relative to what sounds within some 40 ms, below which the rest is silent

    @classmethod
    def into(cls, bands: tuple[NarrowBand, ...], error_db: float) -> Split:
        """Return the split into bands, for the error requested of the whole rendering."""
        return cls(bands, 10 ** ((error_db - MARGIN_DB) / 20))

    @property
    def reach(self) -> int:
        """Samples by which the band-passes look to either side."""
        return max(band.reach for band in self.bands)

    def rest(self, signal: Signal, first: int, last: int) -> Floats:
        """Return samples `first` to `last` of what is left of a signal, exactly zero where that is silent.

        Silence is looked for in cells of 16 samples, relative to the level of what sounds within 20 to 40 ms.
        """
        begin, end = first // CELL * CELL, -(-last // CELL) * CELL
        window = math.ceil(max(LEVEL_TIME * signal.sampling_rate, self.reach) / CELL) * CELL
        before, after = begin // window - 1, -(-end // window) + 1
        offset = before * window
        if self._leaves_nothing(
            signal.steady_frequency(min(offset, begin - self.reach), max(after * window, end + self.reach))
        ):
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

    def _leaves_nothing(self, tone: float | None) -> bool:
        """Test whether a steady tone is removed, by its frequency in Hz.

        Its level is 3 dB below its amplitude; what the band-pass leaves of it and of its image is 6 dB below silence.
        """
        return (
            tone is not None
            and len(self.bands) == 1
            and abs(tone - self.bands[0].baseband.carrier) <= self.bands[0].flat
        )

    def rest_of(self, sound: ShortTimeSpectra) -> ShortTimeSpectra:
        """Return the short-time spectra of the rest, relative to the whole, without windows in which it is silent."""
        left = np.ones(len(sound.frequencies))
        for band in self.bands:
            left *= band.left(sound.frequencies)
        energy = sound.energy * left**2
        loud = energy.sum(axis=1) > _SILENT
        return ShortTimeSpectra(sound.frequencies, energy[loud], sound.weights[loud])

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

    @property
    def filter_half(self) -> int:
        """Samples by which the band filters extend the signal to either side, without the delay filters."""
        return int(self.filters.shape[1] // 2) + self.oversampling * (self.split.reach + CELL)

    @property
    def unheld_db(self) -> float:
        """Infinite: engines know the residual of the rest, but not its level relative to the narrow part."""
        return math.inf

    def sounding(self, first: int, last: int) -> Floats:
        """Return samples `first` to `last` of the rest."""
        return self.split.rest(self.signal, first, last)

    def digest(self) -> str:
        """Return a text that changes with any tap."""
        taps = b"".join(band.low_pass.tobytes() for band in self.split.bands)
        return SourceFilters.digest(self) + hashlib.sha256(taps).hexdigest()


@dataclass(frozen=True, slots=True, eq=False)
class NarrowFilters(EnvelopeFilters):
    """Filters for the envelope of a narrow part."""

    @property
    def filter_half(self) -> int:
        """Samples of the envelope by which it is longer than the signal to either side, without the delay filters."""
        return self.mixer.half_length


def design_split(emission: Emission, split: Split) -> tuple[RestFilters, tuple[NarrowFilters, ...]]:
    """Return the filters for what narrow parts leave of a source's signal, and for each of these."""
    rest = design_source_filters(replace(emission, sound=split.rest_of(emission.sound)))
    parts = []
    for band in split.bands:
        within = replace(emission.options, baseband=band.baseband, narrowband=None)
        part = envelope_filters(replace(emission, options=within), band.half, band.low_pass, -math.inf)
        parts.append(NarrowFilters(**_columns(part)))
    return RestFilters(**_columns(rest), split=split), tuple(parts)


def _columns(made: SourceFilters) -> dict[str, Any]:
    return {f.name: getattr(made, f.name) for f in fields(made)}
