"""What sources emit."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from os import PathLike
from typing import Any, Protocol

import numpy as np
import scipy
from numpy.typing import NDArray

from clsim.arrays import LOUDEST, SLOWEST, Floats, as_choice, as_count, as_floats, as_number, read_only, short_repr
from clsim.errors import InputError, check_kind, warn
from clsim.files.sound import as_scale, read_sound_file
from clsim.scene.signal import waveforms

SEGMENT_LENGTH = 8192  # samples of a segment
_FILTERED = 8192  # samples of a filtered signal that are made at a time
_ALL_SEGMENTS = 400  # above which segments are picked
_TOGETHER = 32  # windows of a short-time spectrum that are read together
_WINDOW = 0.04  # s, of a short-time spectrum
_QUIET_WINDOW = 1e-6  # energy of a window relative to the loudest, below which it is taken relative to this level
_LONGEST = 1e7  # s
_TAPERS = {"none": 0.0, "tukey": 0.1, "hann": 0.5}  # share of a chirp's duration in which its envelope rises
_REFERENCE, _LOUD = 20e-6, 160.0  # Pa and dB SPL, above which samples are hardly in Pa


@dataclass(frozen=True, slots=True, eq=False, weakref_slot=True)
class Signal:
    """Sound pressure at 1 m on a source's axis in free field, Pa, by sample.

    Made by one of the constructors below, which warn of samples above 160 dB SPL.

    Parameters
    ----------
    waveform : Waveform
        Source of the samples.
    sampling_rate : float
        Hz.
    """

    waveform: waveforms.Waveform
    sampling_rate: float

    __repr__ = short_repr

    def __post_init__(self) -> None:
        given: object = self.waveform
        if isinstance(given, Signal) or not hasattr(given, "read"):
            problem = f"must be a waveform, but is {type(self.waveform).__name__}; "
            raise InputError("waveform", f"{problem}samples are taken by Signal.from_array(samples, sampling_rate)")

    @property
    def count(self) -> int:
        """Number of samples."""
        return self.waveform.count(self.sampling_rate)

    @property
    def duration(self) -> float:
        """Length, s."""
        return self.count / self.sampling_rate

    @property
    def centre_frequency(self) -> float:
        """Frequency, Hz, that stands for the band: the carrier, the mean, or the centroid of energy."""
        centre = self.waveform.centre_frequency
        return 0.25 * self.sampling_rate if centre is None else centre

    @property
    def pulse_times(self) -> Floats:
        """Onsets (n,) of the pulses of a train, s; 0 for any other signal."""
        if not isinstance(self.waveform, waveforms.Pulses):
            return np.zeros(1)
        return np.asarray(np.arange(self.waveform.repetitions) * self.waveform.period)

    @property
    def pulse(self) -> Signal:
        """The repeated pulse of a train; any other signal itself."""
        if not isinstance(self.waveform, waveforms.Pulses):
            return self
        return Signal(self.waveform.pulse, self.waveform.pulse_rate)

    def steady_band(self, first: int, last: int) -> tuple[float, float] | None:
        """Return the frequencies between which a tone, noise of a band or a sweep lies where its level is constant.

        Parameters
        ----------
        first, last : int
            First sample, and the one after the last.

        Returns
        -------
        (low, high) or None
            Hz, beyond which there is -120 dB of it; None unless all of these samples are at full level.
        """
        wave = self.waveform
        if not isinstance(wave, waveforms.Tone | waveforms.Noise | waveforms.Chirp):
            return None
        fade = math.ceil(wave.fade * self.sampling_rate)
        inside = fade <= first and last <= self.count - 1 - fade
        return wave.steady_band(self.sampling_rate, first, last) if inside else None

    def read(self, start: int, stop: int) -> Floats:
        """Return samples (n,) from `start` to `stop`, Pa or V; zero outside the signal, the same however cut."""
        out = np.zeros(max(stop - start, 0))
        first, last = max(start, 0), min(stop, self.count)
        if first < last:
            out[first - start : last - start] = self.waveform.read(first, last, self.sampling_rate)
        return out

    def at_rate(self, sampling_rate: float) -> Signal:
        """Return the signal at another sampling rate: formulae are evaluated anew, samples are resampled.

        Raises
        ------
        InputError
            If a formula's frequencies do not fit below half the new rate, a train's period is no whole number of its
            samples, or the rates of recorded samples are in no simple ratio.
        """
        sampling_rate = _rate(sampling_rate)
        if sampling_rate == self.sampling_rate:
            return self
        return Signal(self.waveform.at_rate(self.sampling_rate, sampling_rate), sampling_rate)

    def energy_spectrum(self) -> tuple[Floats, Floats]:
        """Return frequencies (n,) in Hz and the signal's energy at each (n,), in Pa² times samples.

        Hann-windowed segments with half overlap, from before the onset to after the end. Of long signals the
        first and last segments and, from equal stretches between them, one each are taken, which stand for the rest.
        """
        length, hop = SEGMENT_LENGTH, SEGMENT_LENGTH // 2
        picked, weight = _picked_segments(self.count, hop)
        window = _hann(length)
        energy = np.zeros(hop + 1)
        for k, share in zip(picked, weight, strict=True):
            spectrum = scipy.fft.rfft(self.read(int(k) * hop, int(k) * hop + length) * window)
            energy += share * _squared(spectrum)
        frequencies: Floats = np.arange(hop + 1, dtype=np.float64) * (self.sampling_rate / length)
        return frequencies, energy / length

    def short_time_spectra(self) -> tuple[Floats, Floats, Floats, Floats]:
        """Return the energy (W, F) in windows of some 40 ms at frequencies (F,), Hz, with weights (W,), and in all.

        Hann windows with half overlap, picked as by `energy_spectrum`; silent ones are left out. Energies are relative
        to that of the window or its neighbour on either side, whichever is most, so that the end of a sound is seen
        beside the sound; what is 60 dB below the loudest window is taken relative to that level.

        Returns
        -------
        frequencies, energy, weights, whole : ndarray (F,), (W, F), (W,), (F,)
            Hz, energies relative to such a level, windows for which each stands, and the energy of all of the signal in
            Pa² times samples, which is that of `energy_spectrum` but for rounding where its segments are as long.
        """
        length = 2 ** int(np.clip(round(math.log2(_WINDOW * self.sampling_rate)), 6, 14))
        hop = length // 2
        found, levels, weights, whole = [], [], [], np.zeros(hop + 1)
        picked, shares = _picked_segments(self.count, hop)
        for run in _runs(picked):
            for k, level, spectrum in zip(run, *self._windows(picked[run], length), strict=True):
                if level == 0.0:  # of 1e-162 Pa and less, squares are 0
                    continue
                whole += shares[k] * spectrum
                found.append(spectrum)
                weights.append(shares[k])
                levels.append(level)
        frequencies: Floats = np.arange(hop + 1, dtype=np.float64) * (self.sampling_rate / length)
        if not found:
            return frequencies, np.zeros((0, hop + 1)), np.zeros(0), whole
        energy, relative_to = np.array(found), np.maximum(levels, _QUIET_WINDOW * max(levels))
        energy /= relative_to[:, None]
        energy[:, 1:-1] *= 2.0
        return frequencies, energy, np.array(weights), whole / length

    def _windows(self, segments: NDArray[np.int64], length: int) -> tuple[Floats, Floats]:
        """Return the levels (n,) about neighbouring windows, 0 for silent ones, and their energy spectra (n, F)."""
        hop = length // 2
        samples = self.read((int(segments[0]) - 1) * hop, (int(segments[-1]) + 1) * hop + length)
        each = np.lib.stride_tricks.sliding_window_view(samples, length)[::hop]
        windowed = each * _hann(length)
        energy = np.einsum("wn,wn->w", windowed, windowed)
        level = np.maximum(np.maximum(energy[:-2], energy[1:-1]), energy[2:]) * length
        active = np.any((samples != 0.0).reshape(-1, hop), axis=1)
        emitting = active[1:-2] | active[2:-1]
        return np.where(emitting, level, 0.0), _squared(scipy.fft.rfft(windowed[1:-1], axis=1))

    def band(self) -> tuple[float, float]:
        """Return the frequencies between which 99 % of the signal's energy lies, as much below as above, Hz."""
        frequencies, energy = self.energy_spectrum()
        share = np.cumsum(energy) / max(float(energy.sum()), 1e-300)
        low, high = np.minimum(np.searchsorted(share, [0.005, 0.995]), len(share) - 1)
        return float(frequencies[low]), float(frequencies[high])

    @classmethod
    def tone(
        cls, frequency: float, duration: float, sampling_rate: float, amplitude: float = 1.0, phase: float = 0.0,
        fade: float = 0.0,
    ) -> Signal:  # fmt: skip
        """Return ``amplitude sin(2 pi frequency t + phase)``.

        Parameters
        ----------
        frequency : float
            Above 0 and below half the sampling rate, Hz.
        duration, sampling_rate : float
            s, Hz.
        amplitude, phase : float
            Pa, rad.
        fade : float
            Length of a raised-cosine rise and fall, s; at most half the duration.

        Examples
        --------
        >>> Signal.tone(1e3, duration=0.01, sampling_rate=8e3).read(0, 3)
        array([0.        , 0.70710678, 1.        ])
        """
        rate = _rate(sampling_rate)
        duration = _duration(duration, rate)
        return cls(
            waveforms.Tone(
                _frequency("frequency", frequency, rate), duration, _amplitude(amplitude),
                as_number("phase", phase, at_least=-1e9, at_most=1e9, unit="rad"), _fade(fade, duration),
            ),
            rate,
        )  # fmt: skip

    @classmethod
    def chirp(
        cls, start: float, stop: float, duration: float, sampling_rate: float, method: str = "linear",
        window: str = "none", amplitude: float = 1.0, fade: float = 0.0,
    ) -> Signal:  # fmt: skip
        """Return a sweep from one frequency to another.

        Parameters
        ----------
        start, stop : float
            Above 0 and below half the sampling rate, Hz.
        duration, sampling_rate : float
            s, Hz.
        method : {"linear", "exponential"}
            Change of the frequency from start to stop.
        window : {"none", "tukey", "hann"}
            Envelope; ``"tukey"`` rises and falls within a tenth of the duration each.
        amplitude : float
            Pa.
        fade : float
            Length of a raised-cosine rise and fall, s, in place of a window; at most half the duration.

        Notes
        -----
        With T the duration and k = stop / start, the phase is ``2 pi (start t + (stop - start) t² / 2T)`` or
        ``2 pi start T (k^(t/T) - 1) / ln k``.

        Examples
        --------
        >>> Signal.chirp(20e3, 60e3, duration=0.01, sampling_rate=192e3).centre_frequency
        40000.0
        """
        rate = _rate(sampling_rate)
        as_choice("method", method, ("linear", "exponential"))
        as_choice("window", window, tuple(_TAPERS))
        duration = _duration(duration, rate)
        fade = _fade(fade, duration)
        if fade > 0.0 and window != "none":
            raise InputError("fade", f"must be left out with a window, but is {fade:g} s beside {window!r}")
        return cls(
            waveforms.Chirp(
                _frequency("start", start, rate), _frequency("stop", stop, rate), duration, method,
                fade / duration or _TAPERS[window], _amplitude(amplitude),
            ),
            rate,
        )  # fmt: skip

    @classmethod
    def pulses(cls, pulse: Signal, period: float, count: int) -> Signal:
        """Return a pulse, repeated.

        Parameters
        ----------
        pulse : Signal
            The repeated signal, no train itself.
        period : float
            From one beginning to the next, a whole number of samples and not shorter than the pulse, s.
        count : int
            At least 1; the train lasts 1e7 s at most.

        Examples
        --------
        >>> Signal.pulses(Signal.tone(40e3, 0.001, 192e3), period=0.1, count=3).duration
        0.201
        """
        check_kind("pulse", pulse, Signal, "a Signal")
        if isinstance(pulse.waveform, waveforms.Pulses):
            raise InputError("pulse", "must be a single pulse, but is a train")
        period = as_number("period", period, at_least=pulse.duration, at_most=_LONGEST, unit="s")
        count = as_count("count", count, at_least=1, at_most=max(1, math.floor(_LONGEST / period)))
        rate = pulse.sampling_rate
        return cls(waveforms.Pulses(pulse.waveform, rate, period, count).checked(rate), rate)

    @classmethod
    def noise(
        cls, duration: float, sampling_rate: float, seed: int, band: tuple[float, float] | None = None,
        rms: float = 1.0, fade: float = 0.0,
    ) -> Signal:  # fmt: skip
        """Return Gaussian noise, the same for the same seed.

        Parameters
        ----------
        duration, sampling_rate : float
            s, Hz.
        seed : int
            From 0 to 2^64 - 1.
        band : (low, high), optional
            Pass band, Hz; white up to half the sampling rate when left out.
        rms : float
            Root mean square between the fades, Pa.
        fade : float
            Length of a raised-cosine rise and fall, s; at most half the duration. Abrupt ends sound over all
            frequencies, outside of the band too.

        Notes
        -----
        The band's ends are the -6 dB points of a filter that falls to -120 dB within half a hundredth of the
        sampling rate; a narrower band than a hundredth becomes as wide as the filter can be. At another sampling
        rate the same seed gives other samples.

        Examples
        --------
        >>> Signal.noise(1.0, 192e3, seed=1, band=(30e3, 50e3)).centre_frequency
        40000.0
        """
        rate = _rate(sampling_rate)
        ends, duration = None, _duration(duration, rate)
        if band is not None:
            low, high = as_floats("band", band, (2,))
            as_number("band[0]", float(low), at_least=0.0, unit="Hz")
            as_number("band[1]", float(high), above=float(low), below=0.5 * rate, unit="Hz")
            ends = (float(low), float(high))
        return cls(
            waveforms.Noise(
                duration, as_count("seed", seed, at_least=0, at_most=2**64 - 1), ends,
                _rms(rms), _fade(fade, duration),
            ),
            rate,
        )  # fmt: skip

    @classmethod
    def sequence(
        cls, *, carrier: float, chip_rate: float, sampling_rate: float, kind: str = "mls", bits: int = 10,
        code: int = 0, repeats: int = 1, rolloff: float = 0.5, amplitude: float = 1.0,
    ) -> Signal:  # fmt: skip
        """Return a binary sequence on a carrier (BPSK), its chips shaped by a raised cosine.

        Parameters
        ----------
        carrier, chip_rate, sampling_rate : float
            Hz; the band, ``carrier`` plus and minus ``chip_rate (1 + rolloff) / 2``, fits below half the last.
        kind : {"mls", "gold"}
            Maximum-length or Gold sequence of ``2**bits - 1`` chips.
        bits : int
            Register length: 2 to 16 for "mls"; 5, 6, 7, 9, 10 or 11 for "gold".
        code : int
            Index of the Gold sequence, from 0 to ``2**bits``; for "mls" the number of chips by which it is rotated.
        repeats : int
            Periods; the whole signal has at most 67 million samples.
        rolloff : float
            From 0.05 to 1.
        amplitude : float
            Level of a chip at its centre, Pa; between chips it overshoots, to 1.5 times at a rolloff of 0.5.

        Examples
        --------
        >>> Signal.sequence(carrier=40e3, chip_rate=8e3, sampling_rate=192e3, bits=5).count
        1489
        """
        rate = _rate(sampling_rate)
        as_choice("kind", kind, waveforms.SEQUENCES)
        chip_rate = as_number("chip_rate", chip_rate, at_least=SLOWEST, below=0.5 * rate, unit="Hz")
        rolloff = as_number("rolloff", rolloff, at_least=0.05, at_most=1.0)
        half = 0.5 * chip_rate * (1.0 + rolloff)
        carrier = as_number("carrier", carrier, at_least=half, at_most=0.5 * rate - half, unit="Hz")
        chips = len(waveforms.binary_sequence(kind, bits, code))  # refuses what there is not
        repeats = as_count("repeats", repeats, at_least=1, at_most=waveforms.most_repeats(chips, chip_rate, rate))
        return cls(
            waveforms.Sequence(kind, bits, code, repeats, chip_rate, carrier, rolloff, _amplitude(amplitude)), rate
        )

    @classmethod
    def from_array(cls, samples: Any, sampling_rate: float, scale: float | None = None) -> Signal:
        """Return a signal from samples (n,).

        Parameters
        ----------
        samples : array_like (n,)
            Numbers in units of `scale`.
        scale : float, optional
            Amplitude of a sample of 1, Pa, or V for a transducer; 1 if left out. Integers need it: they are steps of a
            converter, whose full scale is rarely 32767 Pa.

        Examples
        --------
        >>> Signal.from_array([0.0, 1.0, 0.0], 48e3).read(-1, 2)
        array([0., 0., 1.])
        >>> Signal.from_array(np.array([0, 16384, 0], dtype=np.int16), 48e3, scale=1 / 32768).read(0, 2)
        array([0. , 0.5])
        """
        rate, pressure = _rate(sampling_rate), as_floats("samples", samples, (None,), within=LOUDEST, unit="Pa")
        kind = np.asarray(samples).dtype
        if kind == np.bool_:
            raise InputError("samples", "must be numbers, but are true and false: give samples.astype(float)")
        if scale is not None:
            pressure = as_floats("samples", pressure * as_scale(scale), (None,), within=LOUDEST, unit="Pa")
        elif np.issubdtype(kind, np.integer):
            raise InputError(
                "scale",
                f"must be given for integers ({kind}), the pressure of a sample of 1 in Pa: full scale of 16 bits is "
                "1 Pa with scale=1 / 32768",
            )
        _question_level("samples", pressure)
        return _with_centroid(pressure, rate)

    @classmethod
    def from_wav(
        cls, path: str | PathLike[str], channel: int = 0, scale: float = 1.0, *, truncated: bool = False
    ) -> Signal:
        """Return one channel of a sound file; full scale (1.0) becomes `scale` Pa.

        Parameters
        ----------
        path : path-like
            Path of the sound file.
        channel : int
            From 0.
        scale : float
            Amplitude of a sample of 1, Pa, or V for a transducer.
        truncated : bool
            Whether a file that ends before its header says is taken as far as it goes; else it is refused.
        """
        channel, scale = as_count("channel", channel, at_least=0), as_scale(scale)
        samples, rate = read_sound_file(path, channel, truncated)
        samples *= scale
        _question_level("scale", samples)
        return _with_centroid(read_only(samples), _rate(rate))


class Response(Protocol):
    """Protocol of filters with an impulse response at every sampling rate."""

    def impulse_response(self, sampling_rate: float) -> Floats:
        """Return the causal impulse response, (n,)."""


@dataclass(frozen=True, slots=True, eq=False)
class Filtered:
    """A waveform after a filter: longer by the filter's impulse response."""

    waveform: waveforms.Waveform
    response: Response
    centre_frequency: float | None

    def count(self, sampling_rate: float) -> int:
        return self.waveform.count(sampling_rate) + len(self.response.impulse_response(sampling_rate)) - 1

    def read(self, first: int, last: int, sampling_rate: float) -> Floats:
        start = first // _FILTERED
        blocks = [_filtered_block(self, k, sampling_rate) for k in range(start, -(-last // _FILTERED))]
        return np.concatenate(blocks)[first - start * _FILTERED : last - start * _FILTERED]

    def at_rate(self, old: float, new: float) -> Filtered:
        return Filtered(self.waveform.at_rate(old, new), self.response, self.centre_frequency)


@lru_cache(maxsize=64)
def _filtered_block(filtered: Filtered, k: int, sampling_rate: float) -> Floats:
    """Return the k-th block of a filtered waveform: overlap-save with everything that reaches into it."""
    taps = filtered.response.impulse_response(sampling_rate)
    before, count = len(taps) - 1, filtered.waveform.count(sampling_rate)
    size = scipy.fft.next_fast_len(_FILTERED + before, real=True)
    emitted = np.zeros(size)
    start = k * _FILTERED - before
    first, last = max(start, 0), min((k + 1) * _FILTERED, count)
    if first < last:
        emitted[first - start : last - start] = filtered.waveform.read(first, last, sampling_rate)
    made = scipy.fft.irfft(scipy.fft.rfft(emitted) * scipy.fft.rfft(taps, size), size)
    return np.asarray(made[before : before + _FILTERED], dtype=np.float64)


def _picked_segments(count: int, hop: int) -> tuple[NDArray[np.int64], Floats]:
    """Return segments of `hop` samples, those before the onset included, and how many each stands for."""
    # Of many segments the first, the last and equally spaced ones between them are taken.
    last = -(-count // hop)
    if last + 1 <= _ALL_SEGMENTS:
        return np.arange(-1, last), np.ones(last + 1)
    stretch = np.arange(_ALL_SEGMENTS // 2)
    # Anywhere in its stretch: an even step could always meet a train's pauses.
    place = (stretch + np.random.default_rng(0).random(len(stretch))) / len(stretch)
    inner = np.unique(8 + (place * (last - 16)).astype(np.int64))
    picked = np.concatenate([np.arange(-1, 8), inner, np.arange(last - 8, last)])
    return picked, np.gradient(picked.astype(np.float64))


def _runs(segments: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    """Return the places of neighbouring segments that are read together, 32 at most."""
    last = 0
    begins = [0]
    for place in range(1, len(segments)):
        if segments[place] != segments[place - 1] + 1 or place - last == _TOGETHER:
            begins.append(last := place)
    return np.split(np.arange(len(segments)), begins[1:])


def _squared(spectrum: NDArray[Any]) -> Floats:
    return np.asarray(spectrum.real**2 + spectrum.imag**2)


@lru_cache(maxsize=16)
def _hann(length: int) -> Floats:
    return read_only(np.sin(math.pi * (np.arange(length) + 0.5) / length) ** 2)


def _question_level(field: str, pressure: NDArray[Any]) -> None:
    """Warn of samples above 160 dB SPL: of a converter's steps, or of another unit."""
    # A signal does not know whether it drives a transducer, so the message names both units.
    peak = float(np.abs(pressure).max())
    level = 20.0 * math.log10(max(peak, _REFERENCE) / (math.sqrt(2.0) * _REFERENCE))
    if level > _LOUD:
        remedy = "scale is the value of a sample of 1" if field in ("samples", "scale") else "it may be in another unit"
        note = f"{field}: gives samples of up to {peak:.5g}: without a transducer Pa, a tone of {level:.0f} dB SPL at "
        warn(f"{note}1 m, with one the volts that drive it; {remedy}")


def energy_centroid(signal: Signal) -> float | None:
    """Return the centroid of a signal's energy over frequency, Hz; None for silence."""
    frequencies, energy = signal.energy_spectrum()
    total = float(energy.sum())
    return float(frequencies @ energy) / total if total > 0.0 else None


def _with_centroid(samples: NDArray[Any], rate: float) -> Signal:
    """Return samples whose centre frequency is the centroid of their energy."""
    centre = energy_centroid(Signal(waveforms.Samples(samples, rate, None), rate))
    return Signal(waveforms.Samples(samples, rate, centre), rate)


def _rate(sampling_rate: float) -> float:
    return as_number("sampling_rate", sampling_rate, at_least=1000.0, at_most=100e6, unit="Hz")


def _amplitude(amplitude: float) -> float:
    amplitude = as_number("amplitude", amplitude, at_least=-LOUDEST, at_most=LOUDEST, unit="Pa")
    _question_level("amplitude", np.array(amplitude))
    return amplitude


def _rms(rms: float) -> float:
    rms = as_number("rms", rms, at_least=0.0, at_most=LOUDEST, unit="Pa")
    _question_level("rms", np.array(math.sqrt(2.0) * rms))  # a tone of this peak is as loud
    return rms


def _duration(duration: float, rate: float) -> float:
    return as_number("duration", duration, at_least=1.0 / rate, at_most=_LONGEST, unit="s")


def _fade(fade: float, duration: float) -> float:
    return as_number("fade", fade, at_least=0.0, at_most=duration / 2, unit="s")


def _frequency(field: str, frequency: float, rate: float) -> float:
    return as_number(field, frequency, at_least=SLOWEST, below=0.5 * rate, unit="Hz")
