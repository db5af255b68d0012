"""Transducers: frequency response on the axis, and the impulse responses that render it; a receiver's electronics."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache, partial
from os import PathLike
from typing import Any

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

from clsim.acoustics.air import absorption_iso9613
from clsim.arrays import (
    FASTEST,
    LOUDEST,
    QUIETEST,
    SLOWEST,
    Floats,
    as_choice,
    as_count,
    as_floats,
    as_number,
    read_only,
    short_repr,
)
from clsim.errors import InputError, check_kind, inside, settle
from clsim.files.sound import as_scale, read_sound_file
from clsim.numerics.band_filters import minimum_phase, resonance_response, resonance_taps
from clsim.numerics.convolution import Resampler
from clsim.scene.signal.signal import Filtered, Signal, energy_centroid

_SHORTEST, _LONGEST = 2**14, 2**20  # points of the spectrum from which taps are made
_REST = 1e-10  # share of energy in what is cut off behind
_BEFORE = 1e-3  # share of energy before 0 s that is cut off without complaint
_NOTHING = 1e-4  # of the peak, what a magnitude falls to where there is nothing
_EASY = 0.33  # of the sampling rate, up to which a resonance is rendered with its own phase
_SKIRT = 0.1  # of the last frequency, over which it falls there
# Murata, "Ultrasonic Sensor Application Manual", Cat. No. S15E: MA40S4S gives 120 dB re 20 µPa at 0.3 m for 10 V rms,
# MA40S4R -63 dB re 10 V/Pa, both at 40 kHz and within 3 dB. The width is a round value for both: it is no stated
# figure, and samples differ from each other by more. The 0.7 m from 0.3 m to 1 m are air of 20 °C and 50 %.
_RESONANCE, _WIDTH = 40e3, 2.4e3  # Hz
_AT_ONE_METRE = 0.3 * 10 ** (-0.7 * float(absorption_iso9613(40e3, 20.0, 0.5, 101_325.0)) / 20)
_NAMED_SENSITIVITY = {
    "MA40S4S": 20e-6 * 10 ** (120 / 20) / 10.0 * _AT_ONE_METRE,  # Pa/V at 1 m
    "MA40S4R": 10.0 * 10 ** (-63 / 20),  # V/Pa
}
TRANSDUCER_NAMES = tuple(_NAMED_SENSITIVITY)


@dataclass(frozen=True, slots=True, eq=False)
class ResponseModel:
    """Model of a response on the axis."""

    taps: Callable[[float], Floats] = field(repr=False)  # impulse response by sampling rate, Hz
    description: str
    peak: float  # largest magnitude
    band: tuple[float, float]  # covered frequencies, Hz
    outside: bool = False  # whether more of it may be had by `outside`


def _ringing(frequency: float, width: float, peak: float, sampling_rate: float) -> Floats:
    """Return the impulse response of a second-order band-pass of a centre and a -6 dB width, Hz."""
    # With three samples a period or more the response is the band-pass's own, phase included, at both -6 dB points,
    # and within 0.05 dB and 2 degrees between them. With fewer, magnitudes are its own everywhere and the phase is the
    # least, which is early by up to half a sample.
    top = frequency + width
    if top > 0.5 * sampling_rate:
        problem = f"must lie a width below half the sampling rate, {0.5 * sampling_rate:g} Hz, but is "
        raise InputError("frequency", f"{problem}{frequency:g} Hz with a width of {width:g} Hz")
    if top <= _EASY * sampling_rate:
        return peak * _cut(resonance_taps(frequency, width, sampling_rate))

    def magnitude(f: Floats) -> Floats:
        """Return the magnitude of the resonance, bounded from below, since its logarithm is taken."""
        return np.maximum(np.abs(resonance_response(f, frequency, width)), 1e-6)

    return peak * _converged(lambda f: minimum_phase(magnitude(f)), sampling_rate)


@dataclass(frozen=True, slots=True, eq=False)
class _Table:
    """Magnitudes, and unwrapped phases in rad or None for minimum phase, at increasing frequencies in Hz."""

    frequencies: Floats
    magnitudes: Floats
    phases: Floats | None
    held: bool

    def magnitude_at(self, f: Floats) -> Floats:
        """Return the magnitude at frequencies (n,)."""
        log = np.interp(f, self.frequencies, np.log(self.magnitudes))
        if not self.held:
            low, high = self.frequencies[0], self.frequencies[-1]
            beyond = np.maximum((low - f) / (_SKIRT * max(low, 1e-300)), (f - high) / (_SKIRT * high))
            share = np.sin(0.5 * math.pi * np.clip(beyond, 0.0, 1.0)) ** 2
            log += share * (math.log(_NOTHING * float(self.magnitudes.max())) - log)
        return np.asarray(np.exp(log))

    def phase_at(self, f: Floats, y: Floats) -> Floats:
        """Return the phase at frequencies (n,), continued straight beyond the table's own (m,)."""
        x = self.frequencies
        inside = np.interp(f, x, y)
        below = (y[1] - y[0]) / (x[1] - x[0]) * np.minimum(f - x[0], 0.0)
        above = (y[-1] - y[-2]) / (x[-1] - x[-2]) * np.maximum(f - x[-1], 0.0)
        return np.asarray(inside + below + above)

    def __call__(self, sampling_rate: float) -> Floats:
        """Return the impulse response: with minimum phase, or with the table's own, if that is causal."""
        phases = self.phases
        if phases is None:
            return _converged(lambda f: minimum_phase(self.magnitude_at(f)), sampling_rate)

        def transformed(f: Floats) -> Floats:
            """Return the impulse response that magnitude and phase at frequencies (Hz) give."""
            spectrum = self.magnitude_at(f) * np.exp(1j * self.phase_at(f, phases))
            return np.asarray(scipy.fft.irfft(spectrum), dtype=np.float64)

        taps = _converged(transformed, sampling_rate, acausal=True)
        return _causal(taps, "values", "delay them by what the measurement took away, or give magnitudes only")


def _resampled(samples: Floats, recorded: float, sampling_rate: float) -> Floats:
    """Return taps (n,) of a rate, Hz, resampled for another one."""
    if sampling_rate == recorded:
        return samples
    resampler = Resampler.between(recorded, sampling_rate)
    count = resampler.count(len(samples))
    taps = resampler.read(samples, -count, 2 * count) * (recorded / sampling_rate)
    whole = np.concatenate([taps[count:], taps[:count]])  # what lies before 0 s stands at the end
    advice = f"render at {recorded:g} Hz, or put silence in front of them"
    return _cut(_causal(whole, "samples", advice, count))


def _converged(make: Callable[[Floats], Floats], sampling_rate: float, *, acausal: bool = False) -> Floats:
    """Return taps from a spectrum fine enough for them to decay, truncated after the decay."""
    size = _SHORTEST
    while True:
        frequencies = np.asarray(np.arange(size // 2 + 1) * (sampling_rate / size), dtype=np.float64)
        taps = make(frequencies)
        middle = slice(size // 2 - size // 8, size // 2 + size // 8) if acausal else slice(size // 2, None)
        energy = np.square(taps)
        if energy[middle].sum() <= _REST * energy.sum():
            return taps if acausal else _cut(taps)
        if size >= _LONGEST:
            raise InputError("", f"must die away within {size / 2 / sampling_rate:.3g} s, but rings for longer")
        size *= 2


def _causal(taps: Floats, field: str, advice: str, before: int | None = None) -> Floats:
    """Return taps without those before 0 s, which stand at the end; refuse if they matter."""
    size = len(taps) // 2 if before is None else before
    energy = np.square(taps)
    share = float(energy[len(taps) - size :].sum() / energy.sum())
    if share > _BEFORE:
        problem = f"must respond after 0 s, but {10 * math.log10(share):.0f} dB of the energy come before; {advice}"
        raise InputError(field, problem)
    return _cut(taps[: len(taps) - size])


def _cut(taps: Floats) -> Floats:
    """Return taps without their negligible end."""
    rest = np.cumsum(np.square(taps[::-1]))[::-1]
    return taps[: max(1, int(np.count_nonzero(rest > _REST * rest[0])))]


@dataclass(frozen=True, slots=True, eq=False)
class Transducer:
    """Frequency response on the axis: of a source in Pa at 1 m per V, of a receiver in V per Pa.

    Made by one of the constructors below.

    Parameters
    ----------
    model : ResponseModel
        Model of the response.
    name : str
        Name in messages.
    """

    model: ResponseModel
    name: str = ""

    __repr__ = short_repr

    def __post_init__(self) -> None:
        check_kind("model", self.model, ResponseModel, "a ResponseModel")
        check_kind("name", self.name, str, "a text")

    @property
    def sensitivity(self) -> float:
        """Largest magnitude of the response, in its own unit."""
        return self.model.peak

    def impulse_response(self, sampling_rate: float) -> Floats:
        """Return the causal impulse response (n,) at a `sampling_rate`, Hz, in Pa at 1 m per V, or V per Pa.

        Raises
        ------
        InputError
            If the response cannot be made causal at this rate; the message says why.
        """
        return _taps(self, as_number("sampling_rate", sampling_rate, at_least=1000.0, at_most=100e6, unit="Hz"))

    def response(self, frequencies: ArrayLike, sampling_rate: float) -> NDArray[np.complex128]:
        """Return the complex response (n,) at `frequencies` (n,), Hz, as rendered at a `sampling_rate`, Hz."""
        taps = self.impulse_response(sampling_rate)
        angle = -2j * np.pi * np.asarray(frequencies, dtype=np.float64) / sampling_rate
        return np.array([np.exp(a * np.arange(len(taps))) @ taps for a in np.atleast_1d(angle)])

    def drive(self, voltage: Signal) -> Signal:
        """Return the sound pressure at 1 m that a `voltage` makes, Pa; the ring-down makes it longer.

        Raises
        ------
        InputError
            If the voltage has a wider band than the transducer's table.
        """
        check_kind("signal", voltage, Signal, "a Signal")
        self.check_coverage(voltage.band(), "the signal")
        made = Signal(Filtered(voltage.waveform, self, None), voltage.sampling_rate)
        centre = energy_centroid(made)
        made_about = Filtered(voltage.waveform, self, voltage.centre_frequency if centre is None else centre)
        return Signal(made_about, voltage.sampling_rate)

    def check_coverage(self, band: tuple[float, float], what: str) -> None:
        """Raise an InputError if the `band` (low, high), Hz, of `what` is not covered by the response."""
        low, high = self.model.band
        if band[0] < low or band[1] > high:
            extend = ' or give outside="zero" or "hold"' if self.model.outside else ""
            problem = f"must cover the band of {what} (99 % of its energy), {band[0]:.6g} to {band[1]:.6g} Hz, "
            problem += f"but covers {low:.6g} to {high:.6g} Hz; measure more of it, fade or window the signal{extend}"
            raise InputError("transducer", problem)

    @classmethod
    def resonance(cls, frequency: float, width: float, sensitivity: float, name: str = "") -> Transducer:
        """Return a second-order band-pass, which rings with the time constant ``sqrt(3) / (pi width)``.

        Parameters
        ----------
        frequency : float
            Frequency of resonance, Hz.
        width : float
            Between the -6 dB points (half the magnitude), Hz; less than `frequency`.
        sensitivity : float
            Magnitude at resonance: Pa at 1 m per V, or V per Pa.

        Examples
        --------
        >>> made = Transducer.resonance(40e3, width=2.4e3, sensitivity=0.5)
        >>> abs(made.response([40e3], 192e3)).round(3).tolist()
        [0.5]
        """
        frequency = as_number("frequency", frequency, at_least=1.0, at_most=50e6, unit="Hz")
        width = as_number("width", width, at_least=1e-3 * frequency, below=frequency, unit="Hz")
        sensitivity = as_number("sensitivity", sensitivity, at_least=QUIETEST, at_most=LOUDEST)
        taps, what = partial(_ringing, frequency, width, sensitivity), f"resonance at {frequency:g} Hz"
        return cls(ResponseModel(taps, what, sensitivity, (0.0, math.inf)), name)

    @classmethod
    def from_table(cls, frequencies: ArrayLike, values: Any, outside: str | None = None, name: str = "") -> Transducer:
        """Return a measured response.

        Parameters
        ----------
        frequencies : array_like (n,)
            At least two, from 0 up and increasing, Hz.
        values : array_like (n,)
            Real: magnitudes above 0, to which the minimum phase is found. Complex: magnitude and phase
            (``exp(+j 2 pi f t)``), which must belong to a response that does not begin before 0 s.
        outside : {None, "zero", "hold"}
            Rule for frequencies beyond the table: refused if a signal needs it (None), nothing, or the value at its
            nearer end.

        Notes
        -----
        Between frequencies the logarithm of the magnitude and the phase are interpolated linearly. Nothing means
        that the magnitude falls to -80 dB of its peak, as a raised cosine of its logarithm over a tenth of the last
        frequency.

        Examples
        --------
        >>> made = Transducer.from_table([35e3, 40e3, 45e3], [0.2, 0.6, 0.2], outside="zero")
        >>> abs(made.response([40e3], 192e3)).round(3).tolist()
        [0.6]
        """
        f = as_floats("frequencies", frequencies, (None,))
        if len(f) < 2 or f[0] < 0.0 or np.any(np.diff(f) <= 0.0):
            problem = f"must be two or more from 0 Hz that increase strictly, but are {f.tolist()!s:.80}"
            raise InputError("frequencies", problem)
        if outside is not None:
            as_choice("outside", outside, ("zero", "hold"))
        given = np.asarray(values)
        if given.dtype.kind == "c":
            parts = [as_floats("values", part, (len(f),), within=LOUDEST) for part in (given.real, given.imag)]
            magnitudes, phases = np.hypot(*parts), read_only(np.unwrap(np.arctan2(parts[1], parts[0])))
        else:
            magnitudes, phases = as_floats("values", values, (len(f),), within=LOUDEST), None
        for i in np.flatnonzero(magnitudes < QUIETEST)[:1]:
            raise InputError(f"values[{i}]", f"must have a magnitude above 0, but is {given[i]}")
        band = (float(f[0]), float(f[-1])) if outside is None else (0.0, math.inf)
        table = _Table(f, read_only(magnitudes), phases, outside == "hold")
        return cls(ResponseModel(table, "table", float(magnitudes.max()), band, True), name)

    @classmethod
    def from_impulse_response(cls, samples: ArrayLike, sampling_rate: float, name: str = "") -> Transducer:
        """Return the transducer with a measured impulse response.

        Parameters
        ----------
        samples : array_like (n,)
            Taps at `sampling_rate`: their spectrum ``sum h[n] exp(-2j pi f n / sampling_rate)`` is the response.
        sampling_rate : float
            Hz. At another rate the taps are resampled, flat to 0.9 of the lower Nyquist frequency.
        """
        rate = as_number("sampling_rate", sampling_rate, at_least=1000.0, at_most=100e6, unit="Hz")
        taps = as_floats("samples", samples, (None,), within=LOUDEST)
        if not np.abs(taps).max() >= QUIETEST:
            raise InputError("samples", "must not all be 0")
        peak = float(np.abs(np.fft.rfft(taps, 4 * max(len(taps), 256))).max())
        what = f"impulse response of {len(taps)} samples"
        return cls(ResponseModel(partial(_resampled, taps, rate), what, peak, (0.0, 0.5 * rate)), name)

    @classmethod
    def from_wav(
        cls, path: str | PathLike[str], channel: int = 0, scale: float = 1.0, name: str = "", *, truncated: bool = False
    ) -> Transducer:
        """Return the transducer whose impulse response is one channel of a sound file; full scale becomes `scale`.

        Parameters
        ----------
        path, channel, truncated
            As of `Signal.from_wav`.
        scale : float
            Response of a sample of 1: Pa at 1 m per V, or V per Pa.
        """
        channel, scale = as_count("channel", channel, at_least=0), as_scale(scale)
        samples, rate = read_sound_file(path, channel, truncated)
        return cls.from_impulse_response(scale * samples.astype(np.float64), rate, name)

    @classmethod
    def named(cls, name: str) -> Transducer:
        """Return the frequency response of a transducer by its name.

        Parameters
        ----------
        name : {"MA40S4S", "MA40S4R"}
            Murata's open 40 kHz transmitter (Pa at 1 m per V) and receiver (V per Pa). Nominal models, no measurements:
            a resonance at 40 kHz, 2.4 kHz wide at -6 dB. MA40S4S makes 120 dB re 20 µPa at 0.3 m from 10 V rms, MA40S4R
            has -63 dB re 10 V/Pa. Frequency, level and sensitivity are the catalogue's (Murata, "Ultrasonic Sensor
            Application Manual", Cat. No. S15E), each within 3 dB; the width is a round typical value.

        Examples
        --------
        >>> round(1e3 * Transducer.named("MA40S4R").sensitivity, 2)  # mV/Pa
        7.08
        """
        name = as_choice("name", name, TRANSDUCER_NAMES)
        return cls.resonance(_RESONANCE, _WIDTH, _NAMED_SENSITIVITY[name], name)


@lru_cache(maxsize=32)
def _taps(transducer: Transducer, sampling_rate: float) -> Floats:
    with inside("transducer"):
        return read_only(transducer.model.taps(sampling_rate))


_REFERENCE = 20e-6  # Pa
_LARGEST_OFFSET = 1.0  # s
_LARGEST_ERROR = 10_000.0  # ppm


@dataclass(frozen=True, slots=True)
class Electronics:
    """A receiver's end: everything is left out unless it is given.

    In this order: noise of the air is added to the sound pressure, the receiver's transducer makes a voltage of it,
    noise of the receiver is added, low and high cut, gain, converter. Without a transducer all of it happens to
    the pressure itself, in Pa.

    Parameters
    ----------
    ambient_noise_db : float, optional
        White noise in the air, dB re 20 µPa/√Hz; it passes through the transducer.
    snr_db, reference_level_db : float, optional
        In place of `ambient_noise_db`. The ratio, dB, is that of a sound to all the noise from 0 Hz to half the
        sampling rate. The level is that of this sound, dB re 20 µPa.
    self_noise_db : float, optional
        White noise of the receiver, dB re 20 µPa/√Hz where the transducer is most sensitive; added to its voltage.
    seed : int
        Seed of both noises, from 0 to 2^64 - 1. Receivers of other names have other noise from the same seed.
    low_cut, high_cut : float, optional
        Frequencies at which Butterworth filters have fallen by 3 dB, Hz.
    order : int
        Order of each filter, 1 to 8: 6 dB per octave and order.
    gain_db : float
        Gain of the amplifier, dB.
    adc_bits : int, optional
        Bits of the converter, 1 to 24; with `adc_full_scale`.
    adc_full_scale : float, optional
        Amplitude at which it clips, V (Pa without a transducer).
    clock_ppm, clock_offset : float
        Sample n is taken at ``n (1 + 1e-6 clock_ppm) / sampling_rate + clock_offset``; up to 10 000 ppm and 1 s either
        way.

    Notes
    -----
    A ratio to the level of the recording itself would need the whole recording before its first sample;
    recordings are made piece by piece in bounded memory, so the level is given beforehand: render once without noise
    to learn it. The converter rounds to whole steps of ``2 full_scale / 2^bits``, from ``-2^(bits-1)`` of them to
    ``2^(bits-1) - 1``.

    Examples
    --------
    >>> Electronics(adc_bits=12, adc_full_scale=2.048).step
    0.001
    """

    ambient_noise_db: float | None = None
    snr_db: float | None = None
    reference_level_db: float | None = None
    self_noise_db: float | None = None
    seed: int = 0
    low_cut: float | None = None
    high_cut: float | None = None
    order: int = 2
    gain_db: float = 0.0
    adc_bits: int | None = None
    adc_full_scale: float | None = None
    clock_ppm: float = 0.0
    clock_offset: float = 0.0

    def __post_init__(self) -> None:
        levels = ("ambient_noise_db", "snr_db", "reference_level_db", "self_noise_db", "gain_db")
        rules = dict.fromkeys(levels, (-200.0, 200.0, "dB")) | {
            "clock_ppm": (-_LARGEST_ERROR, _LARGEST_ERROR, "ppm"),
            "clock_offset": (-_LARGEST_OFFSET, _LARGEST_OFFSET, "s"),
            "low_cut": (SLOWEST, FASTEST, "Hz"), "high_cut": (SLOWEST, FASTEST, "Hz"),
            "adc_full_scale": (QUIETEST, LOUDEST, ""),
        }  # fmt: skip
        for name, (low, high, unit) in rules.items():
            value = getattr(self, name)
            if value is not None:
                settle(self, **{name: as_number(name, value, at_least=low, at_most=high, unit=unit)})
        as_count("seed", self.seed, at_least=0, at_most=2**64 - 1)
        as_count("order", self.order, at_least=1, at_most=8)
        if self.adc_bits is not None:
            as_count("adc_bits", self.adc_bits, at_least=1, at_most=24)
        for one, other in (
            ("snr_db", "reference_level_db"), ("reference_level_db", "snr_db"),
            ("adc_bits", "adc_full_scale"), ("adc_full_scale", "adc_bits"),
        ):  # fmt: skip
            if getattr(self, one) is not None and getattr(self, other) is None:
                raise InputError(other, f"must be given with {one}, but is missing")
        if self.snr_db is not None and self.ambient_noise_db is not None:
            raise InputError("snr_db", "must be left out where ambient_noise_db is given: both say how loud the air is")
        if self.low_cut is not None and self.high_cut is not None and not self.low_cut < self.high_cut:
            raise InputError("high_cut", f"must be above low_cut, {self.low_cut:g} Hz, but is {self.high_cut:g} Hz")

    @property
    def step(self) -> float:
        """Step of the converter, V (Pa without a transducer); 0 for none."""
        if self.adc_bits is None or self.adc_full_scale is None:
            return 0.0
        return self.adc_full_scale * 2.0 ** (1 - self.adc_bits)

    def ambient_rms(self, sampling_rate: float) -> float:
        """Return the root mean square of the air's noise from 0 Hz to half the `sampling_rate`, Hz, in Pa."""
        if self.snr_db is not None and self.reference_level_db is not None:
            return _REFERENCE * 10 ** ((self.reference_level_db - self.snr_db) / 20)
        return _rms(self.ambient_noise_db, sampling_rate)

    def self_rms(self, sampling_rate: float) -> float:
        """Return that of the receiver's noise at a `sampling_rate`, Hz, as the pressure that would make it, Pa."""
        return _rms(self.self_noise_db, sampling_rate)

    @property
    def own_clock(self) -> bool:
        """Whether the receiver's clock is not the scene's."""
        return self.clock_ppm != 0.0 or self.clock_offset != 0.0

    def clock_error(self, times: Floats) -> Floats:
        """Return the error (n,) of the receiver's clock at its own `times` (n,), s: the lateness of samples."""
        return 1e-6 * self.clock_ppm * times + self.clock_offset

    def check_rate(self, sampling_rate: float) -> None:
        """Raise an InputError if a cut does not lie below half the `sampling_rate`, Hz."""
        for name in ("low_cut", "high_cut"):
            if getattr(self, name) is not None:
                as_number(name, getattr(self, name), below=0.5 * sampling_rate, unit="Hz")

    def describe(self, unit: str) -> str:
        """Return a description of the processing in one line, with the `unit` of the samples, "Pa" or "V"."""
        parts = []
        if self.ambient_noise_db is not None:
            parts.append(f"ambient noise {self.ambient_noise_db:g} dB re 20 µPa/√Hz")
        if self.snr_db is not None:
            parts.append(f"ambient noise {self.snr_db:g} dB below {self.reference_level_db:g} dB re 20 µPa")
        if self.self_noise_db is not None:
            parts.append(f"self-noise {self.self_noise_db:g} dB re 20 µPa/√Hz")
        parts += [f"{n.replace('_', ' ')} {getattr(self, n):g} Hz" for n in ("low_cut", "high_cut") if getattr(self, n)]
        if self.gain_db:
            parts.append(f"gain {self.gain_db:g} dB")
        if self.step:
            parts.append(f"{self.adc_bits} bits of {self.step:.4g} {unit}, full scale {self.adc_full_scale:g} {unit}")
        if self.own_clock:
            parts.append(f"clock {self.clock_ppm:+g} ppm, {self.clock_offset:+g} s")
        return ", ".join(parts) or "ideal"


def _rms(density_db: float | None, sampling_rate: float) -> float:
    """Return the root mean square of white noise of a density over half the sampling rate, Pa; 0 for none."""
    return 0.0 if density_db is None else _REFERENCE * 10 ** (density_db / 20) * math.sqrt(0.5 * sampling_rate)
