"""Waveforms: what gives the samples of a signal at any sampling rate, in any order."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from clsim.errors import InputError
from clsim.scene.resampling import resample

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Floats

_NOISE_BLOCK = 4096  # samples drawn from one stream of the generator
_NOISE_HALF = 256  # taps on either side of the noise's band filter


class Waveform(Protocol):
    """A function of time, or samples."""

    @property
    def centre_frequency(self) -> float | None:
        """Frequency that stands for all, Hz; None where only the spectrum tells."""
        ...

    def count(self, sampling_rate: float) -> int:
        """Return the number of samples."""
        ...

    def read(self, first: int, last: int, sampling_rate: float) -> NDArray[Any]:
        """Return samples `first` to `last`, which lie inside."""
        ...

    def at_rate(self, old: float, new: float) -> Waveform:
        """Return the same sound for another sampling rate."""
        ...


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
        """Its frequency, Hz."""
        return self.frequency

    def count(self, sampling_rate: float) -> int:
        """Return the number of samples."""
        return _count(self.duration, sampling_rate)

    def read(self, first: int, last: int, sampling_rate: float) -> Floats:
        """Return samples; whole cycles are removed before the sine, so that late ones are as exact as the first."""
        n = np.arange(first, last, dtype=np.float64)
        per_sample = self.frequency / sampling_rate
        # n splits into 2^16 steps and a rest, so that no product loses the fraction of a cycle.
        high = np.floor(n / 65536.0)
        cycles = high * math.fmod(65536.0 * per_sample, 1.0) + (n - 65536.0 * high) * per_sample
        out = self.amplitude * np.sin(2.0 * math.pi * (cycles - np.floor(cycles)) + self.phase)
        if self.fade > 0.0:
            edge = np.minimum(n, self.count(sampling_rate) - 1 - n) / (sampling_rate * self.fade)
            out *= np.sin(0.5 * math.pi * np.clip(edge, 0.0, 1.0)) ** 2
        return np.asarray(out)

    def at_rate(self, old: float, new: float) -> Tone:
        """Return itself, if the frequency fits."""
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
        """Mean of start and stop, Hz."""
        return 0.5 * (self.start + self.stop)

    def count(self, sampling_rate: float) -> int:
        """Return the number of samples."""
        return _count(self.duration, sampling_rate)

    def read(self, first: int, last: int, sampling_rate: float) -> Floats:
        """Return samples."""
        t = np.arange(first, last, dtype=np.float64) / sampling_rate
        if self.method == "linear" or self.start == self.stop:
            cycles = t * (self.start + 0.5 * (self.stop - self.start) / self.duration * t)
        else:
            growth = math.log(self.stop / self.start) / self.duration
            cycles = self.start * np.expm1(growth * t) / growth
        out = self.amplitude * np.sin(2.0 * math.pi * (cycles - np.floor(cycles)))
        if self.taper > 0.0:
            edge = np.minimum(t, self.duration - t) / (self.taper * self.duration)
            out *= np.sin(0.5 * math.pi * np.clip(edge, 0.0, 1.0)) ** 2
        return np.asarray(out)

    def at_rate(self, old: float, new: float) -> Chirp:
        """Return itself, if its frequencies fit."""
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
        """That of the pulse, Hz."""
        return self.pulse.centre_frequency

    def count(self, sampling_rate: float) -> int:
        """Return the number of samples: the last pulse ends the train."""
        return (self.repetitions - 1) * self._step(sampling_rate) + self.pulse.count(sampling_rate)

    def read(self, first: int, last: int, sampling_rate: float) -> Floats:
        """Return samples."""
        out = np.zeros(last - first)
        step, length = self._step(sampling_rate), self.pulse.count(sampling_rate)
        for k in range(max(0, (first - length + 1) // step), min(self.repetitions - 1, (last - 1) // step) + 1):
            a, b = max(first, k * step), min(last, k * step + length)
            if a < b:
                out[a - first : b - first] += self.pulse.read(a - k * step, b - k * step, sampling_rate)
        return out

    def at_rate(self, old: float, new: float) -> Pulses:
        """Return the train of the pulse at the new rate."""
        return Pulses(self.pulse.at_rate(old, new), new, self.period, self.repetitions).checked(new)

    def checked(self, sampling_rate: float) -> Pulses:
        """Return itself if the period is a whole number of samples.

        Raises
        ------
        InputError
            If it is not; the message names the nearest periods that are.
        """
        samples = self.period * sampling_rate
        if abs(samples - round(samples)) > 1e-6 * max(1.0, samples * 1e-6):
            low, high = math.floor(samples) / sampling_rate, math.ceil(samples) / sampling_rate
            raise InputError(
                "period",
                f"must be a whole number of samples at {sampling_rate:g} Hz, such as {low!r} or {high!r} s, "
                f"but is {self.period!r} s",
            )
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

    @property
    def centre_frequency(self) -> float | None:
        """Middle of the band, Hz."""
        return None if self.band is None else 0.5 * (self.band[0] + self.band[1])

    def count(self, sampling_rate: float) -> int:
        """Return the number of samples."""
        return _count(self.duration, sampling_rate)

    def read(self, first: int, last: int, sampling_rate: float) -> Floats:
        """Return samples."""
        if self.band is None:
            return self.rms * self._white(first, last)
        from scipy.signal import oaconvolve

        taps = _band_taps(*self.band, sampling_rate)
        # Blocks aligned to whole generator blocks: the rounding of the convolution is the same however one reads.
        a, b = first // _NOISE_BLOCK, -(-last // _NOISE_BLOCK)
        parts = [
            oaconvolve(
                self._white(k * _NOISE_BLOCK - _NOISE_HALF, (k + 1) * _NOISE_BLOCK + _NOISE_HALF),
                taps,
                mode="valid",
            )
            for k in range(a, b)
        ]
        start = a * _NOISE_BLOCK
        return np.asarray(self.rms * np.concatenate(parts)[first - start : last - start])

    def at_rate(self, old: float, new: float) -> Noise:
        """Return noise of the same seed and band; its samples are others, since each is drawn by itself."""
        if self.band is not None:
            _fits("band[1]", self.band[1], new)
        return self

    def _white(self, first: int, last: int) -> Floats:
        a, b = first // _NOISE_BLOCK, -(-last // _NOISE_BLOCK)
        parts = []
        for k in range(a, b):
            stream = np.random.Philox(key=np.array([self.seed % 2**64, k % 2**64], dtype=np.uint64))
            parts.append(np.random.Generator(stream).standard_normal(_NOISE_BLOCK))
        return np.concatenate(parts)[first - a * _NOISE_BLOCK : last - a * _NOISE_BLOCK]


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """Samples in memory."""

    values: NDArray[Any]
    centre_frequency: float | None

    def count(self, sampling_rate: float) -> int:
        """Return the number of samples."""
        return len(self.values)

    def read(self, first: int, last: int, sampling_rate: float) -> NDArray[Any]:
        """Return samples."""
        return self.values[first:last]

    def at_rate(self, old: float, new: float) -> Samples:
        """Return resampled samples."""
        return Samples(resample(self.values, old, new), self.centre_frequency)


@lru_cache(maxsize=16)
def _band_taps(low: float, high: float, sampling_rate: float) -> Floats:
    """Return a linear-phase band filter of unit noise gain."""
    from scipy.signal import firwin

    count = 2 * _NOISE_HALF + 1
    edges, pass_zero = ([low, high], False) if low > 0.0 else ([high], True)
    taps = firwin(count, edges, window=("kaiser", 8.0), pass_zero=pass_zero, fs=sampling_rate)
    return np.asarray(taps / np.linalg.norm(taps))


def _count(duration: float, sampling_rate: float) -> int:
    return max(1, round(duration * sampling_rate))


def _fits(field: str, frequency: float, sampling_rate: float) -> None:
    if frequency >= 0.5 * sampling_rate:
        raise InputError(
            f"signal.{field}",
            f"must be below half the sampling rate, {0.5 * sampling_rate:g} Hz, but is {frequency:g} Hz",
        )
