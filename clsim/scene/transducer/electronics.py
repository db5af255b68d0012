"""What a receiver does to the sound before it is a recording: noise, filters, amplifier, converter, clock."""

from __future__ import annotations

import math
from dataclasses import dataclass

from clsim.arrays import FASTEST, LOUDEST, QUIETEST, SLOWEST, Floats, as_count, as_number
from clsim.errors import InputError, settle

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
