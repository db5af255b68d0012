"""Matched filter of a pulse, and peaks of its output between samples."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Complexes, Floats, short_repr
from clsim.errors import InputError
from clsim.scene.signal.signal import Signal

_REACH = 16  # samples to either side from which a value between samples is made
_STEPS = 64  # per sample, between which a parabola is laid
_SHAPE = 12.0  # of the Kaiser window: -115 dB
_BATCH = 2**22  # samples that are filtered at a time


@dataclass(frozen=True, slots=True, eq=False)
class MatchedFilter:
    """The filter of a pulse at a sampling rate."""

    pulse: Floats  # (n,) its samples
    sampling_rate: float  # hz
    energy: float  # sum of their squares over the sampling rate, Pa² s
    centre: float  # mean frequency of its energy, Hz
    bandwidth: float  # root mean square of the frequency about it, Hz

    __repr__ = short_repr

    @classmethod
    def of(cls, pulse: Signal, sampling_rate: float) -> MatchedFilter:
        """Return the filter of a pulse."""
        if not isinstance(pulse, Signal):
            raise InputError("pulse", f"must be a Signal, but is {pulse!r:.80}")
        at_rate = pulse.at_rate(sampling_rate)
        samples = at_rate.read(0, at_rate.count)
        total = float(np.sum(np.square(samples)))
        if total == 0.0:
            raise InputError("pulse", "must not be silent, but is")
        spectrum = np.square(np.abs(np.fft.rfft(samples, 2 * len(samples))))
        frequencies = np.fft.rfftfreq(2 * len(samples), 1.0 / sampling_rate)
        centre = float(np.sum(frequencies * spectrum) / np.sum(spectrum))
        spread = float(np.sum(np.square(frequencies - centre) * spectrum) / np.sum(spectrum))
        return cls(samples, sampling_rate, total / sampling_rate, centre, math.sqrt(spread))

    def outputs(self, rows: NDArray[Any]) -> Complexes:
        """Return the complex output (n, T - L + 1) for rows of samples (n, T): amplitude of the pulse beginning there.

        Its magnitude is the envelope, its real part the correlation itself, over the pulse's energy.
        """
        from scipy.fft import fft, ifft, next_fast_len

        length = rows.shape[1]
        size = next_fast_len(length + len(self.pulse) - 1)
        filtered = np.conj(fft(self.pulse, size))
        filtered[size // 2 + 1 :] = 0.0  # what is left is the analytic signal
        filtered[1 : (size + 1) // 2] *= 2.0
        out = np.empty((len(rows), max(length - len(self.pulse) + 1, 0)), dtype=np.complex128)
        scale = 1.0 / (self.energy * self.sampling_rate)
        step = max(1, _BATCH // size)
        for i in range(0, len(rows), step):
            made = ifft(fft(rows[i : i + step].astype(np.float64), size) * filtered)
            out[i : i + step] = made[:, : out.shape[1]] * scale
        return out


def envelope_peak(output: Complexes, index: int) -> float:
    """Return the position of the magnitude's peak in an output (n,), near a sample, in samples."""
    places, values = _between(output, index)
    level = np.square(np.abs(values))
    top = int(np.clip(np.argmax(level), 1, len(level) - 2))
    before, at, after = level[top - 1 : top + 2]
    curve = before - 2.0 * at + after
    return float(places[top] + (0.5 * (before - after) / curve / _STEPS if curve < 0.0 else 0.0))


def phase_peak(output: Complexes, index: int) -> float:
    """Return the position nearest to the envelope's peak at which the output (n,) is real and positive, in samples."""
    # That is the crest of the correlation itself: exact to a fraction of a wave, if the envelope finds the right one.
    place = envelope_peak(output, index)
    values = _at(output, place + np.array([-0.25, 0.0, 0.25]))
    turn = np.unwrap(np.angle(values))
    rate = max(2.0 * (turn[2] - turn[0]), 1e-3)  # rad per sample
    place -= float(np.angle(values[1])) / rate
    for _ in range(3):
        place -= float(np.angle(_at(output, np.array([place]))[0])) / rate
    return float(place)


def _between(output: Complexes, index: int) -> tuple[Floats, Complexes]:
    """Return places within a sample of an index, in samples, and the output there."""
    fractions = np.arange(-_STEPS, _STEPS + 1) / _STEPS
    return index + fractions, _weights()[0] @ _around(output, index) * _weights()[1]


def _at(output: Complexes, places: Floats) -> Complexes:
    """Return an output (n,) at places, in samples, near each other."""
    index = round(float(np.mean(places)))
    near = np.arange(-_REACH, _REACH + 1)
    weights = _kernel(places[:, None] - index - near)
    return np.asarray(weights @ _around(output, index) * np.exp(0.5j * np.pi * (places - index)))


def _around(output: Complexes, index: int) -> Complexes:
    """Return samples around an index, moved down by a quarter of the sampling rate, zero beyond the ends."""
    # An analytic signal lies between 0 and half the sampling rate: moved down, it is centred and oversampled twice.
    near = np.arange(-_REACH, _REACH + 1)
    inside = (index + near >= 0) & (index + near < len(output))
    values = np.where(inside, output[np.clip(index + near, 0, len(output) - 1)], 0.0)
    return np.asarray(values * np.exp(-0.5j * np.pi * near))


@lru_cache(maxsize=1)
def _weights() -> tuple[Floats, Complexes]:
    fractions = np.arange(-_STEPS, _STEPS + 1) / _STEPS
    near = np.arange(-_REACH, _REACH + 1)
    return _kernel(fractions[:, None] - near), np.exp(0.5j * np.pi * fractions)


def _kernel(x: Floats) -> Floats:
    """Return the weight of a sample at a distance of x samples: a Kaiser-windowed sinc."""
    across = np.sqrt(np.maximum(1.0 - np.square(x / (_REACH + 1)), 0.0))
    return np.asarray(np.sinc(x) * np.i0(_SHAPE * across) / np.i0(_SHAPE))
