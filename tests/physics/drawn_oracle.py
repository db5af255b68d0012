"""Exact pressure in a shoebox whose walls and transducers depend on frequency: a Fourier sum for every path and sample.

Only NumPy, SciPy and `default_oracle` are used. A path's pressure at reception time t is
``2 Re sum_k S(f_k) H(f_k, t) exp(2 pi j f_k (t - delay(t))) / N``: S the spectrum of the emitted samples with silence
about them, H the product of spreading, air, walls and directivities at the emitted frequency and the geometry of t.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

import numpy as np
from default_oracle import Room, Truth, delays
from scipy.fft import next_fast_len, rfft
from scipy.interpolate import PchipInterpolator
from scipy.special import j1

if TYPE_CHECKING:
    from collections.abc import Callable

    from default_oracle import Curve

NEGLIGIBLE = 1e-13  # of the signal's energy: what all terms that are left out have together
LEVEL_WINDOW = 0.04  # s, in which the error is relative to the level of the received signal
LOUD = 0.1  # of the loudest window's power, from which on windows are judged by themselves


@dataclass(frozen=True)
class Factor:
    """A wall with one real reflection factor."""

    value: float

    def at(self, frequency: float, cosine: np.ndarray) -> complex | np.ndarray:
        return self.value


@dataclass(frozen=True)
class Absorption:
    """A wall with absorption coefficients by frequency (n,), Hz: monotone cubics over log f, held at the ends."""

    frequencies: tuple[float, ...]
    coefficients: tuple[float, ...]

    def at(self, frequency: float, cosine: np.ndarray) -> complex | np.ndarray:
        return float(np.sqrt(1.0 - held_cubic(self.frequencies, self.coefficients, frequency).real))


@dataclass(frozen=True)
class Impedance:
    """A locally reacting wall with specific impedances (n,) at frequencies (n,), Hz."""

    frequencies: tuple[float, ...]
    impedances: tuple[complex, ...]

    def at(self, frequency: float, cosine: np.ndarray) -> complex | np.ndarray:
        normal = held_cubic(self.frequencies, self.impedances, frequency) * cosine
        return (normal - 1.0) / (normal + 1.0)


@dataclass(frozen=True)
class Echo:
    """A wall with the impulse response `samples` (n,), of which sample `reference` is the wall's plane."""

    samples: tuple[float, ...]
    rate: float
    reference: float

    def at(self, frequency: float, cosine: np.ndarray) -> complex | np.ndarray:
        n = np.arange(len(self.samples)) - self.reference
        return complex(np.array(self.samples) @ np.exp(-2j * np.pi * frequency / self.rate * n))


Wall = Factor | Absorption | Impedance | Echo


@cache
def cubic(frequencies: tuple[float, ...], values: tuple[complex, ...]) -> PchipInterpolator:
    given = np.array(values)
    return PchipInterpolator(np.log(frequencies), np.stack([given.real, given.imag], axis=1))


def held_cubic(frequencies: tuple[float, ...], values: tuple[complex, ...], at: float) -> complex:
    """Monotone cubic over log f through values (n,), held at the ends."""
    if len(frequencies) == 1:
        return values[0]
    real, imaginary = cubic(frequencies, values)(np.log(min(max(at, frequencies[0]), frequencies[-1])))
    return complex(real, imaginary)


@dataclass(frozen=True)
class Beam:
    """A directivity about `axis` (3,): a piston of `radius` m, or ``weight + (1 - weight) cos``; both None is omni."""

    axis: tuple[float, ...] = (1.0, 0.0, 0.0)
    radius: float | None = None
    weight: float | None = None

    def gain(self, cosine: np.ndarray, frequency: float, c: float) -> np.ndarray:
        if self.weight is not None:
            return self.weight + (1.0 - self.weight) * cosine
        if self.radius is None:
            return np.ones_like(cosine)
        sine = np.where(cosine > 0.0, np.sqrt(np.maximum(1.0 - cosine**2, 0.0)), 1.0)  # behind the baffle as at 90°
        x = np.maximum(2.0 * np.pi * frequency / c * self.radius * sine, 1e-9)
        return 2.0 * j1(x) / x


@dataclass(frozen=True)
class Sound:
    """Emitted samples (n,) from time `start` on, and the taps (odd,) of a low-pass about their middle."""

    samples: np.ndarray
    rate: float
    start: float
    margin: float  # s of silence that is known about it
    low_pass: np.ndarray

    @property
    def length(self) -> int:
        """Samples of the transform."""
        return int(next_fast_len(len(self.samples) + 2 * round(self.margin * self.rate), real=True))

    def terms(self) -> tuple[np.ndarray, np.ndarray]:
        """Frequencies (k,), Hz, and the factors (k,) of the sum behind the low-pass."""
        length = self.length
        spectrum = 2.0 / length * rfft(self.samples, length)
        spectrum[0] *= 0.5
        if length % 2 == 0:
            spectrum[-1] *= 0.5
        frequency = np.arange(len(spectrum)) * (self.rate / length)
        spectrum *= self.passed(length)
        quietest = np.argsort(np.abs(spectrum))
        energy = np.cumsum(np.abs(spectrum[quietest]) ** 2)
        kept = np.sort(quietest[energy > NEGLIGIBLE * energy[-1]])
        return frequency[kept], spectrum[kept]

    def passed(self, length: int) -> np.ndarray:
        """Response (k,) of the low-pass at the frequencies of a transform of `length` samples."""
        taps = np.zeros(length)
        taps[: len(self.low_pass)] = self.low_pass
        return rfft(np.roll(taps, -(len(self.low_pass) // 2))).real

    def removed_db(self) -> float:
        """Share of the energy that the low-pass takes away, dB."""
        length = next_fast_len(len(self.samples) + len(self.low_pass), real=True)
        energy = np.abs(rfft(self.samples, length)) ** 2
        removed = energy * (1.0 - self.passed(length)) ** 2
        return float(10.0 * np.log10(np.maximum(removed.sum() / energy.sum(), 1e-30)))

    def known(self, emission: np.ndarray) -> np.ndarray:
        """Whether times of emission are within the silence about the samples."""
        end = self.start + len(self.samples) / self.rate
        return (emission > self.start - self.margin) & (emission < end + self.margin)


@dataclass(frozen=True)
class End:
    """A source or receiver: where it is, and its beam."""

    curve: Curve
    beam: Beam


@dataclass(frozen=True)
class Leg:
    """Pairs (n,) of a path and a time at which its sound is known, and what its response depends on."""

    image: np.ndarray
    time: np.ndarray
    late: np.ndarray  # s since emission of the first sample
    distance: np.ndarray
    spread: np.ndarray
    cosines: np.ndarray  # (3, n) of incidence on walls across x, y, z
    leaving: np.ndarray  # cosine from the source's axis
    coming: np.ndarray


def received(
    sounds: list[tuple[Sound, End]], receiver: End, room: Room, walls: tuple[Wall, ...], times: np.ndarray
) -> Truth:
    """Pressure at times (n,) behind each source's low-pass, and the root of the sum of the paths' squares."""
    pressure, power = np.zeros(len(times)), np.zeros(len(times))
    for sound, source in sounds:
        hits, leg = paths(sound, source, receiver, room, times)
        if len(leg.time):
            part = path_pressures(sound, leg, response(hits, leg, source.beam, receiver.beam, room, walls))
            pressure += np.bincount(leg.time, part, len(times))
            power += np.bincount(leg.time, part**2, len(times))
    return Truth(pressure, np.sqrt(power))


def paths(sound: Sound, source: End, receiver: End, room: Room, times: np.ndarray) -> tuple[np.ndarray, Leg]:
    """Reflections (images, 6) at x_min, x_max, y_min, ... of each image, and the pairs that sound."""
    images = list(room.images())
    sign, offset = np.array([i[1] for i in images]), np.array([i[2] for i in images])
    cell = np.rint((offset - 0.5 * (1.0 - sign) * room.size) / room.size).astype(int)  # offset = (cell + odd) size
    beyond, before = np.maximum(cell, 0), np.maximum(-cell, 0)
    hits = np.stack([(before + 1) // 2 + beyond // 2, (beyond + 1) // 2 + before // 2], axis=2).reshape(-1, 6)
    delay, mach = delays(source.curve, receiver.curve, sign[:, None], offset[:, None], times, room.speed_of_sound)
    emission = times - delay
    image, time = np.nonzero(sound.known(emission))
    distance = room.speed_of_sound * delay[image, time]
    at = sign[image] * source.curve.position(emission[image, time]) + offset[image]
    towards = (receiver.curve.position(times[time]) - at) / distance[:, None]
    axes = [np.array(end.beam.axis) / np.linalg.norm(end.beam.axis) for end in (source, receiver)]
    return hits, Leg(
        image, time, emission[image, time] - sound.start, distance, 1.0 / (distance * (1.0 - mach[image, time])),
        np.abs(towards.T), np.clip((sign[image] * towards) @ axes[0], -1, 1), np.clip(-towards @ axes[1], -1, 1),
    )  # fmt: skip


def response(
    hits: np.ndarray, leg: Leg, source: Beam, receiver: Beam, room: Room, walls: tuple[Wall, ...]
) -> Callable[[float], np.ndarray]:
    """The response (n,) of each pair as a function of frequency."""
    by_angle = [w for w in range(6) if isinstance(walls[w], Impedance)]
    most = hits.max(axis=0)

    def at(f: float) -> np.ndarray:
        loss = float(room.absorption(np.array(f))) * np.log(10.0) / 20.0
        made = leg.spread * np.exp(-loss * (leg.distance - 1.0))
        if (source.radius, source.weight, receiver.radius, receiver.weight) != (None,) * 4:
            made = made * source.gain(leg.leaving, f, room.speed_of_sound)
            made = made * receiver.gain(leg.coming, f, room.speed_of_sound)
        flat = np.ones(len(hits))
        for w in set(range(6)) - set(by_angle):
            if most[w]:
                flat = flat * walls[w].at(f, leg.distance) ** hits[:, w]
        made = made * flat[leg.image]
        for w in by_angle:
            if most[w]:
                made = made * walls[w].at(f, leg.cosines[w // 2]) ** hits[leg.image, w]
        return made

    return at


def path_pressures(sound: Sound, leg: Leg, response: Callable[[float], np.ndarray]) -> np.ndarray:
    """Pressure of each pair (n,)."""
    frequency, spectrum = sound.terms()
    out = np.zeros(len(leg.time), dtype=complex)
    step = sound.rate / sound.length
    turn, place = np.exp(2j * np.pi * step * leg.late), np.rint(frequency / step).astype(int)
    at, wave = -1, np.ones(0)
    for k, f in enumerate(frequency):
        if at < 0 or place[k] - at > 8 or k % 512 == 0:  # rounding grows by 1e-16 a step
            wave = np.exp(2j * np.pi * f * leg.late)
        else:
            for _ in range(place[k] - at):
                wave = wave * turn
        at = place[k]
        out += spectrum[k] * wave * response(f)
    return out.real


def errors_db(got: np.ndarray, exact: Truth, times: np.ndarray) -> tuple[float, float]:
    """Errors over the level of the sound, dB: of all samples, and the largest in 40 ms that are nearly as loud as any.

    Quieter windows hold what filters sound before an arrival, which is as loud as the error beside it.
    """
    cell = np.floor(times / (0.5 * LEVEL_WINDOW)).astype(int)
    whole = max(1, round(times[-1] / (0.5 * LEVEL_WINDOW)))  # half windows that are filled
    squares = (got - exact.pressure) ** 2, exact.level**2, np.ones(len(cell))
    halves = [np.bincount(cell, x)[:whole] for x in squares]
    wrong, level, count = (np.convolve(x, np.ones(min(2, whole)), "valid") for x in halves)
    wrong, level = wrong / np.maximum(count, 1), level / np.maximum(count, 1)
    loud = level > LOUD * level.max()
    overall, local = squares[0].sum() / squares[1].sum(), np.max(wrong[loud] / level[loud])
    return float(10.0 * np.log10(overall)), float(10.0 * np.log10(local))
