"""Models of a frequency response, and the causal impulse responses that render them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from clsim.errors import InputError
from clsim.numerics.resampling import Resampler
from clsim.numerics.resonator import minimum_phase, resonance_response, resonance_taps

if TYPE_CHECKING:
    from collections.abc import Callable

    from clsim.arrays import Floats

_SHORTEST, _LONGEST = 2**14, 2**20  # points of the spectrum from which taps are made
_REST = 1e-10  # share of energy in what is cut off behind
_BEFORE = 1e-3  # share of energy before 0 s that is cut off without complaint
_NOTHING = 1e-4  # of the peak, what a magnitude falls to where there is nothing
_EASY = 0.33  # of the sampling rate, up to which a resonance is rendered with its own phase
_SKIRT = 0.1  # of the last frequency, over which it falls there


@dataclass(frozen=True, slots=True)
class Resonance:
    """A second-order band-pass: centre and -6 dB width in Hz, magnitude at the centre."""

    frequency: float
    width: float
    peak: float

    @property
    def band(self) -> tuple[float, float]:
        """Known at all frequencies."""
        return 0.0, math.inf

    def taps(self, sampling_rate: float) -> Floats:
        """Return the impulse response.

        With three samples a period or more the response is the band-pass's own, phase included, at both -6 dB points,
        and within 0.05 dB and 2 degrees between them. With fewer, magnitudes are its own everywhere and the phase is
        the least, which is early by up to half a sample.
        """
        top = self.frequency + self.width
        if top > 0.5 * sampling_rate:
            raise InputError(
                "frequency",
                f"must lie a width below half the sampling rate, {0.5 * sampling_rate:g} Hz, but is "
                f"{self.frequency:g} Hz with a width of {self.width:g} Hz",
            )
        if top <= _EASY * sampling_rate:
            return self.peak * _cut(resonance_taps(self.frequency, self.width, sampling_rate))

        def magnitude(f: Floats) -> Floats:
            """Return the magnitude of the resonance, bounded from below, since its logarithm is taken."""
            return np.maximum(np.abs(resonance_response(f, self.frequency, self.width)), 1e-6)

        return self.peak * _settled(lambda f: minimum_phase(magnitude(f)), sampling_rate)


@dataclass(frozen=True, slots=True, eq=False)
class ResponseTable:
    """Magnitudes, and unwrapped phases in rad or None for minimum phase, at increasing frequencies in Hz."""

    frequencies: Floats
    magnitudes: Floats
    phases: Floats | None
    outside: str | None

    @property
    def peak(self) -> float:
        """Largest magnitude."""
        return float(self.magnitudes.max())

    @property
    def band(self) -> tuple[float, float]:
        """Frequencies (low, high) in Hz that it covers: those of the table, or all by name."""
        if self.outside is not None:
            return 0.0, math.inf
        return float(self.frequencies[0]), float(self.frequencies[-1])

    def magnitude_at(self, f: Floats) -> Floats:
        """Return the magnitude at frequencies (n,)."""
        log = np.interp(f, self.frequencies, np.log(self.magnitudes))
        if self.outside != "hold":
            low, high = self.frequencies[0], self.frequencies[-1]
            beyond = np.maximum((low - f) / (_SKIRT * max(low, 1e-300)), (f - high) / (_SKIRT * high))
            share = np.sin(0.5 * math.pi * np.clip(beyond, 0.0, 1.0)) ** 2
            log += share * (math.log(_NOTHING * self.peak) - log)
        return np.asarray(np.exp(log))

    def phase_at(self, f: Floats) -> Floats:
        """Return the phase at frequencies (n,), continued straight beyond the table."""
        assert self.phases is not None
        x, y = self.frequencies, self.phases
        inside = np.interp(f, x, y)
        below = (y[1] - y[0]) / (x[1] - x[0]) * np.minimum(f - x[0], 0.0)
        above = (y[-1] - y[-2]) / (x[-1] - x[-2]) * np.maximum(f - x[-1], 0.0)
        return np.asarray(inside + below + above)

    def taps(self, sampling_rate: float) -> Floats:
        """Return the impulse response: with minimum phase, or with the table's own, if that is causal."""
        if self.phases is None:
            return _settled(lambda f: minimum_phase(self.magnitude_at(f)), sampling_rate)

        def transformed(f: Floats) -> Floats:
            """Return the impulse response that magnitude and phase at frequencies (Hz) give."""
            from scipy.fft import irfft

            return np.asarray(irfft(self.magnitude_at(f) * np.exp(1j * self.phase_at(f))), dtype=np.float64)

        taps = _settled(transformed, sampling_rate, acausal=True)
        return _causal(taps, "values", "delay them by what the measurement took away, or give magnitudes only")


@dataclass(frozen=True, slots=True, eq=False)
class ImpulseResponse:
    """Taps, at the rate `recorded` in Hz."""

    samples: Floats
    recorded: float

    @property
    def peak(self) -> float:
        """Largest magnitude."""
        return float(np.abs(np.fft.rfft(self.samples, 4 * max(len(self.samples), 256))).max())

    @property
    def band(self) -> tuple[float, float]:
        """Frequencies (low, high) in Hz that it covers: up to half the rate at which it was recorded."""
        return 0.0, 0.5 * self.recorded

    def taps(self, sampling_rate: float) -> Floats:
        """Return the samples, or what they are at another rate."""
        if sampling_rate == self.recorded:
            return self.samples
        resampler = Resampler.between(self.recorded, sampling_rate)
        count = resampler.count(len(self.samples))
        taps = resampler.read(self.samples, -count, 2 * count) * (self.recorded / sampling_rate)
        whole = np.concatenate([taps[count:], taps[:count]])  # what lies before 0 s stands at the end
        advice = f"render at {self.recorded:g} Hz, or put silence in front of them"
        return _cut(_causal(whole, "samples", advice, count))


def _settled(make: Callable[[Floats], Floats], sampling_rate: float, *, acausal: bool = False) -> Floats:
    """Return taps from a spectrum that is fine enough for them to die away, cut where they have."""
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
        raise InputError(
            field,
            f"must respond after 0 s, but {10 * math.log10(share):.0f} dB of the energy come before; {advice}",
        )
    return _cut(taps[: len(taps) - size])


def _cut(taps: Floats) -> Floats:
    """Return taps up to where nothing that matters follows."""
    rest = np.cumsum(np.square(taps[::-1]))[::-1]
    return taps[: max(1, int(np.count_nonzero(rest > _REST * rest[0])))]
