"""Waveforms: what gives the samples of a signal at any sampling rate, in any order."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache, partial
from typing import Any, Protocol

import numpy as np
import scipy
from numpy.typing import NDArray

from clsim.arrays import Complexes, Floats, as_count, read_only, short_repr
from clsim.errors import InputError
from clsim.numerics.convolution import Resampler, band_pass

_SWEPT = 64  # samples of a sweep, over which a turn is that of one frequency
_TONE_BLOCK = 4096  # samples of a tone that share one exact phase
_NOISE_BLOCK = 4096  # samples drawn from one stream of the generator
_NOISE_HALF = 384  # taps on either side of the noise's band filter
_NOISE_FILTERED = 4 * _NOISE_BLOCK  # samples that are filtered at a time
_NOISE_SIZE = 17280  # of their transforms, with so many taps on either side; few prime factors
_NOISE_SHAPE = 12.3  # of the window
_NOISE_EDGE = 0.0051  # of the sampling rate, from the ends of the band to -120 dB
SEQUENCES = ("mls", "gold")
# Feedback taps of preferred pairs of maximum-length sequences (R. Gold, IEEE Trans. Inf. Theory 13, 1967), as in
# scipy.signal.max_len_seq: the exponents between 0 and the register's length of each polynomial.
_PREFERRED: dict[int, tuple[tuple[int, ...], tuple[int, ...]]] = {
    5: ((2,), (2, 3, 4)),
    6: ((1,), (1, 2, 5)),
    7: ((3,), (1, 2, 3)),
    9: ((4,), (3, 4, 6)),
    10: ((3,), (2, 3, 8)),
    11: ((2,), (2, 5, 8)),
}
_MOST_SAMPLES = 2**26  # of a sequence, which is kept
_SEQUENCE_BLOCK = 2**16  # samples made at a time
_HALF_CHIPS = 16  # chips on either side over which a chip's pulse is kept


class Waveform(Protocol):
    """A function of time, or samples."""

    @property
    def centre_frequency(self) -> float | None:
        """Frequency that stands for all, Hz; None for all frequencies alike."""

    def count(self, sampling_rate: float) -> int:
        """Return the number of samples."""

    def read(self, first: int, last: int, sampling_rate: float) -> NDArray[Any]:
        """Return samples `first` to `last`, which lie inside."""

    def at_rate(self, old: float, new: float) -> Waveform:
        """Return the same sound for another sampling rate."""


@dataclass(frozen=True, slots=True)
class Tone:
    """A sine."""

    frequency: float
    duration: float
    amplitude: float
    phase: float
    fade: float

    @property
    def centre_frequency(self) -> float:
        return self.frequency

    def steady_band(self, sampling_rate: float, first: int, last: int) -> tuple[float, float]:
        """Return the frequencies that it has between its fades, Hz."""
        return self.frequency, self.frequency

    def count(self, sampling_rate: float) -> int:
        return _count(self.duration, sampling_rate)

    def read(self, first: int, last: int, sampling_rate: float) -> Floats:
        """Return samples."""
        # Every block's phase is a fraction of whole numbers, so that late samples are as exact as the first; inside a
        # block ``sin(a + b) = sin a cos b + cos a sin b`` with a table of the angles `b`.
        cosine, sine = _block_angles(self.frequency, sampling_rate)
        per_sample = Fraction(self.frequency) / Fraction(sampling_rate)
        p, q = per_sample.numerator * _TONE_BLOCK, per_sample.denominator
        start = first // _TONE_BLOCK
        blocks = range(start, -(-last // _TONE_BLOCK))
        begin = 2.0 * math.pi * np.array([k * p % q / q for k in blocks]) + self.phase
        whole = np.multiply.outer(self.amplitude * np.sin(begin), cosine)
        whole += np.multiply.outer(self.amplitude * np.cos(begin), sine)
        out = whole.ravel()[first - start * _TONE_BLOCK : last - start * _TONE_BLOCK]
        return _faded(out, first, sampling_rate, self.duration, self.fade)

    def at_rate(self, old: float, new: float) -> Tone:
        _fits("frequency", self.frequency, new)
        return self


@dataclass(frozen=True, slots=True)
class Chirp:
    """A sweep; `taper` is the share of the duration in which it rises, and falls."""

    start: float
    stop: float
    duration: float
    method: str
    taper: float
    amplitude: float

    @property
    def centre_frequency(self) -> float:
        return 0.5 * (self.start + self.stop)

    def count(self, sampling_rate: float) -> int:
        return _count(self.duration, sampling_rate)

    def read(self, first: int, last: int, sampling_rate: float) -> Floats:
        if self.method == "linear" or self.start == self.stop:
            out = self._linear(first, last, sampling_rate)
        else:
            growth = math.log(self.stop / self.start) / self.duration
            t = np.arange(first, last, dtype=np.float64) / sampling_rate
            cycles = self.start * np.expm1(growth * t) / growth
            out = self.amplitude * np.sin(2.0 * math.pi * (cycles - np.floor(cycles)))
        return _faded(out, first, sampling_rate, self.duration, self.fade)

    def _linear(self, first: int, last: int, sampling_rate: float) -> Floats:
        """Return samples of a linear sweep before it is faded, by blocks: products of turns take less than sines."""
        begin, growth = first // _TONE_BLOCK, (self.stop - self.start) / self.duration
        t = np.arange(begin, -(-last // _TONE_BLOCK)) * (_TONE_BLOCK / sampling_rate)
        cycles, per_sample = t * (self.start + 0.5 * growth * t), (self.start + growth * t) / sampling_rate
        coarse = self.amplitude * _turned(cycles[:, None] + per_sample[:, None] * np.arange(0, _TONE_BLOCK, _SWEPT))
        turned: Any = coarse[:, :, None] * _turned(per_sample[:, None] * np.arange(_SWEPT))[:, None]
        cosine, sine = _sweep_angles(growth / sampling_rate**2)
        whole: Floats = turned.imag * cosine + turned.real * sine
        return whole.ravel()[first - begin * _TONE_BLOCK : last - begin * _TONE_BLOCK]

    def steady_band(self, sampling_rate: float, first: int, last: int) -> tuple[float, float]:
        """Return the lowest and the highest frequency from a sample to another, Hz."""
        shares = (at / (self.duration * sampling_rate) for at in (first, last))
        if self.method == "linear":
            ends = [self.start + (self.stop - self.start) * share for share in shares]
        else:
            ends = [self.start * (self.stop / self.start) ** share for share in shares]
        return min(ends), max(ends)

    @property
    def fade(self) -> float:
        """Length of its rise, and of its fall, s."""
        return self.taper * self.duration

    def at_rate(self, old: float, new: float) -> Chirp:
        _fits("start", self.start, new)
        _fits("stop", self.stop, new)
        return self


@dataclass(frozen=True, slots=True)
class Pulses:
    """A train of equal pulses; `pulse_rate` is the sampling rate for which the pulse was made."""

    pulse: Waveform
    pulse_rate: float
    period: float
    repetitions: int

    @property
    def centre_frequency(self) -> float | None:
        return self.pulse.centre_frequency

    def count(self, sampling_rate: float) -> int:
        return (self.repetitions - 1) * self._step(sampling_rate) + self.pulse.count(sampling_rate)

    def read(self, first: int, last: int, sampling_rate: float) -> Floats:
        out = np.zeros(last - first)
        step, length = self._step(sampling_rate), self.pulse.count(sampling_rate)
        active = range(max(0, (first - length) // step + 1), min(self.repetitions - 1, (last - 1) // step) + 1)
        # Several pulses: made once, since they are no longer than the block.
        pulse = self.pulse.read(0, length, sampling_rate) if len(active) > 2 else None
        for k in active:
            a, b = max(first, k * step), min(last, k * step + length)
            part = slice(a - k * step, b - k * step)
            out[a - first : b - first] += (
                self.pulse.read(part.start, part.stop, sampling_rate) if pulse is None else pulse[part]
            )
        return out

    def at_rate(self, old: float, new: float) -> Pulses:
        return Pulses(self.pulse.at_rate(old, new), new, self.period, self.repetitions).checked(new)

    def checked(self, sampling_rate: float) -> Pulses:
        """Return itself if the period is a whole number of samples."""
        samples = self.period * sampling_rate
        if abs(samples - round(samples)) > 1e-6 * max(1.0, samples * 1e-6):
            low, high = math.floor(samples) / sampling_rate, math.ceil(samples) / sampling_rate
            problem = f"must be a whole number of samples at {sampling_rate:g} Hz, such as {low!r} or {high!r} s, "
            raise InputError("period", f"{problem}but is {self.period!r} s")
        return self

    def _step(self, sampling_rate: float) -> int:
        return round(self.period * sampling_rate)


@dataclass(frozen=True, slots=True)
class Noise:
    """Gaussian noise from a counter-based generator, so that any part of it can be drawn by itself."""

    duration: float
    seed: int
    band: tuple[float, float] | None
    rms: float
    fade: float

    @property
    def centre_frequency(self) -> float | None:
        return None if self.band is None else 0.5 * (self.band[0] + self.band[1])

    def steady_band(self, sampling_rate: float, first: int, last: int) -> tuple[float, float] | None:
        """Return the frequencies beyond which its filter stops it, Hz."""
        beyond = _NOISE_EDGE * sampling_rate
        return None if self.band is None else (self.band[0] - beyond, self.band[1] + beyond)

    def count(self, sampling_rate: float) -> int:
        return _count(self.duration, sampling_rate)

    def read(self, first: int, last: int, sampling_rate: float) -> Floats:
        block, ends = partial(_noise_block, self.seed, self.band, sampling_rate), (first, last)
        unit = white_noise(self.seed, *ends) if self.band is None else _of_blocks(block, *ends, _NOISE_FILTERED)
        out = self.rms * unit
        return _faded(out, first, sampling_rate, self.duration, self.fade)

    def at_rate(self, old: float, new: float) -> Noise:
        """Return noise of the same seed and band; its samples are others, since each is drawn by itself."""
        if self.band is not None:
            _fits("band[1]", self.band[1], new)
        return self


@dataclass(frozen=True, slots=True)
class Sequence:
    """A binary sequence on a carrier."""

    kind: str
    bits: int
    code: int
    repeats: int
    chip_rate: float
    carrier: float
    rolloff: float
    amplitude: float

    @property
    def centre_frequency(self) -> float:
        return self.carrier

    def count(self, sampling_rate: float) -> int:
        return len(shaped_sequence(self, sampling_rate))

    def read(self, first: int, last: int, sampling_rate: float) -> Floats:
        return self.amplitude * shaped_sequence(self, sampling_rate)[first:last]

    def at_rate(self, old: float, new: float) -> Sequence:
        _fits("carrier", self.carrier + 0.5 * self.chip_rate * (1.0 + self.rolloff), new)
        return self


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """Samples in memory, at the rate `recorded` (Hz); read at another rate, they pass through a polyphase filter."""

    values: NDArray[Any]
    recorded: float
    centre_frequency: float | None

    __repr__ = short_repr

    def count(self, sampling_rate: float) -> int:
        return self._resampler(sampling_rate).count(len(self.values))

    def read(self, first: int, last: int, sampling_rate: float) -> NDArray[Any]:
        if sampling_rate == self.recorded:
            return self.values[first:last]
        return self._resampler(sampling_rate).read(self.values, first, last)

    def at_rate(self, old: float, new: float) -> Samples:
        """Return itself, if the rates are in a simple ratio."""
        self._resampler(new)
        return self

    def _resampler(self, sampling_rate: float) -> Resampler:
        return Resampler.between(self.recorded, sampling_rate)


def white_noise(seed: int, first: int, last: int) -> Floats:
    """Return samples `first` to `last` of endless Gaussian noise of unit variance, the same however they are cut."""
    return _of_blocks(partial(_white_block, seed), first, last, _NOISE_BLOCK)


def _of_blocks(block: Callable[[int], Floats], first: int, last: int, size: int) -> Floats:
    """Return samples `first` to `last` of what is made in blocks of a size."""
    start = first // size
    blocks = [block(k) for k in range(start, -(-last // size))]
    return np.concatenate(blocks)[first - start * size : last - start * size]


@lru_cache(maxsize=4)  # neighbours of blocks that are filtered
def _white_block(seed: int, k: int) -> Floats:
    """Return block k of endless white noise."""
    stream = np.random.Philox(key=np.array([seed % 2**64, k % 2**64], dtype=np.uint64))
    return np.random.Generator(stream).standard_normal(_NOISE_BLOCK)


@lru_cache(maxsize=128)  # 16 MiB: planning looks at what rendering reads again
def _noise_block(seed: int, band: tuple[float, float], sampling_rate: float, k: int) -> Floats:
    """Return block k of endless noise through a band's filter, by overlap-save: the same however it is read."""
    white = white_noise(seed, k * _NOISE_FILTERED - _NOISE_HALF, (k + 1) * _NOISE_FILTERED + _NOISE_HALF)
    spectrum: Any = scipy.fft.rfft(white, _NOISE_SIZE) * _band_response(*band, sampling_rate)
    return np.asarray(scipy.fft.irfft(spectrum, _NOISE_SIZE)[2 * _NOISE_HALF :][:_NOISE_FILTERED])


@lru_cache(maxsize=16)
def _block_angles(frequency: float, sampling_rate: float) -> tuple[Floats, Floats]:
    """Return the cosine and sine of a tone's phase over one block."""
    cycles = np.arange(_TONE_BLOCK) * (frequency / sampling_rate)
    angle = 2.0 * math.pi * (cycles - np.floor(cycles))
    return np.cos(angle), np.sin(angle)


@lru_cache(maxsize=16)
def _sweep_angles(growth: float) -> tuple[Floats, Floats]:
    """Return the cosine and sine of the phase that a growing frequency adds over one block, cycles a sample squared."""
    angles = math.pi * growth * np.arange(_TONE_BLOCK, dtype=np.float64).reshape(-1, _SWEPT) ** 2
    return np.cos(angles), np.sin(angles)


def _turned(cycles: Any) -> Complexes:
    return np.asarray(np.exp(2j * math.pi * (cycles - np.floor(cycles))))


@lru_cache(maxsize=16)
def _band_response(low: float, high: float, sampling_rate: float) -> NDArray[np.complex128]:
    """Return the spectrum, over one block, of a linear-phase band filter of unit noise gain."""
    half_rate = 0.5 * sampling_rate
    taps = band_pass(max(low, 0.0) / half_rate, high / half_rate, 2 * _NOISE_HALF + 1, _NOISE_SHAPE)
    return np.asarray(scipy.fft.rfft(taps / np.linalg.norm(taps), _NOISE_SIZE))


def _faded(out: Floats, first: int, sampling_rate: float, duration: float, fade: float) -> Floats:
    """Return samples from `first` on after a raised-cosine rise and fall in place, each `fade` long (s)."""
    if fade <= 0.0:
        return out
    reach = math.ceil(fade * sampling_rate) + 1
    rise = slice(0, max(0, reach - first))
    fall = slice(max(rise.stop, math.floor((duration - fade) * sampling_rate) - first), None)
    for part in (rise, fall):
        t = (np.arange(len(out))[part] + first) / sampling_rate
        share = np.clip(np.minimum(t, duration - t), 0.0, fade) / fade
        out[part] *= np.sin(0.5 * math.pi * share) ** 2
    return out


def _count(duration: float, sampling_rate: float) -> int:
    return max(1, round(duration * sampling_rate))


def _fits(field: str, frequency: float, sampling_rate: float) -> None:
    if frequency >= 0.5 * sampling_rate:
        problem = f"must be above {2.0 * frequency:g} Hz, twice the signal's {field}, but is {sampling_rate:g} Hz"
        raise InputError("sampling_rate", problem)


def binary_sequence(kind: str, bits: int, code: int) -> NDArray[np.float64]:
    """Return one period of a sequence as +1 and -1, ``2**bits - 1`` chips."""
    # code: for "gold" 0 and 1 are the two maximum-length sequences, k + 2 their product with the second one rotated by
    # k. For "mls" the number of chips by which it is rotated.
    bits = as_count("bits", bits, at_least=2, at_most=16)
    length = 2**bits - 1
    if kind == "mls":
        code = as_count("code", code, at_least=0, at_most=length - 1)
        return np.asarray(np.roll(1.0 - 2.0 * scipy.signal.max_len_seq(bits)[0], code))
    if bits not in _PREFERRED:
        raise InputError("bits", f"must be one of {', '.join(map(str, _PREFERRED))} for Gold sequences, but is {bits}")
    code = as_count("code", code, at_least=0, at_most=length + 1)
    first, second = (1.0 - 2.0 * scipy.signal.max_len_seq(bits, taps=np.array(taps))[0] for taps in _PREFERRED[bits])
    if code < 2:
        return np.asarray((first, second)[code])
    return np.asarray(first * np.roll(second, code - 2))


def shaped_count(chips: int, chip_rate: float, sampling_rate: float) -> int:
    """Return the number of samples of a sequence on a carrier."""
    return math.ceil((chips - 1 + 2 * _HALF_CHIPS) * sampling_rate / chip_rate) + 1


def most_repeats(chips: int, chip_rate: float, sampling_rate: float) -> int:
    """Return number of periods of a sequence that can be kept, at least 1."""
    if shaped_count(chips, chip_rate, sampling_rate) > _MOST_SAMPLES:
        problem = f"must be high enough for a period of {chips} chips to take at most {_MOST_SAMPLES} samples, "
        raise InputError("chip_rate", f"{problem}but is {chip_rate:g} Hz")
    return max(1, int((_MOST_SAMPLES * chip_rate / sampling_rate - 2 * _HALF_CHIPS) / chips))


@lru_cache(maxsize=4)
def shaped_sequence(sequence: Sequence, sampling_rate: float) -> Floats:
    """Return a sequence on a carrier, (n,), its chips of level 1 shaped by a raised cosine."""
    # The first chip is centred 16 chips after the beginning, so that its pulse begins from nothing. J. G. Proakis,
    # Digital Communications, 4th ed., eq. 9.2-27.
    chip_rate = sequence.chip_rate
    chips = np.tile(binary_sequence(sequence.kind, sequence.bits, sequence.code), sequence.repeats)
    out = np.empty(shaped_count(len(chips), chip_rate, sampling_rate))
    for first in range(0, len(out), _SEQUENCE_BLOCK):
        n = np.arange(first, min(first + _SEQUENCE_BLOCK, len(out)))
        place = n * (chip_rate / sampling_rate) - _HALF_CHIPS  # in chips
        base = np.zeros(len(n))
        nearest = np.floor(place).astype(np.int64)
        for offset in range(-_HALF_CHIPS, _HALF_CHIPS + 1):
            k = nearest + offset
            inside = (k >= 0) & (k < len(chips))
            base[inside] += chips[k[inside]] * _pulse(place[inside] - k[inside], sequence.rolloff)
        out[n] = base * np.cos(2.0 * math.pi * np.mod(n * (sequence.carrier / sampling_rate), 1.0))
    return read_only(out)


def _pulse(x: Floats, rolloff: float) -> Floats:
    """Return the raised-cosine pulse, tapered to nothing at its ends; `x` in chips."""
    singular = np.abs(np.abs(2.0 * rolloff * x) - 1.0) < 1e-6
    safe = np.where(singular, 0.0, x)
    shape = np.sinc(safe) * np.cos(math.pi * rolloff * safe) / (1.0 - (2.0 * rolloff * safe) ** 2)
    limit = math.pi / 4.0 * math.sin(math.pi / (2.0 * rolloff)) / (math.pi / (2.0 * rolloff))
    taper = np.cos(0.5 * math.pi * np.clip(x / (_HALF_CHIPS + 1), -1.0, 1.0)) ** 2
    return np.asarray(np.where(singular, limit, shape) * taper)
