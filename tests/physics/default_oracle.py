"""What must be heard at default settings, in float64 and by means of its own: nothing here is computed by clsim.

The truth is ``p(t) = sum over paths of (h * s)(t - delay(t))``: s the band-limited interpolation of the emitted samples,
h the zero-phase filter ``R^order / (d (1 - M)) 10^(-a(f) (d - 1) / 20)`` of the path as it is at t, M the Mach number at
emission. The emitted samples are filtered at Chebyshev distances and oversampled by Fourier transforms; between them
there are polynomials in time and distance. Delays are solved by Newton's method between bounds.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft

if TYPE_CHECKING:
    from collections.abc import Iterator

WINDOW = 0.02  # s, in which errors are compared with what is heard then
TOGETHER = 50_000  # delays that are solved at a time
QUIET_DB = -60.0  # relative to the loudest window, below which a window is not looked at


class Curve(Protocol):
    """A motion that has no end."""

    def position(self, time: np.ndarray) -> np.ndarray: ...

    def velocity(self, time: np.ndarray) -> np.ndarray: ...


@dataclass(frozen=True)
class Line:
    """A point at `origin` (3,) m at time 0 that moves at `speed` (3,) m/s; none is a point at rest."""

    origin: tuple[float, ...]
    speed: tuple[float, ...] = (0.0, 0.0, 0.0)

    def position(self, time: np.ndarray) -> np.ndarray:
        return np.array(self.origin) + np.asarray(time)[..., None] * np.array(self.speed)

    def velocity(self, time: np.ndarray) -> np.ndarray:
        return np.broadcast_to(np.array(self.speed, dtype=float), (*np.shape(time), 3))


@dataclass(frozen=True)
class Circle:
    """A point on a horizontal circle, at angle 0 (+x) at time 0."""

    centre: tuple[float, ...]
    radius: float
    period: float

    def position(self, time: np.ndarray) -> np.ndarray:
        angle = 2.0 * np.pi / self.period * np.asarray(time)
        around = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=-1)
        return np.array(self.centre) + self.radius * around

    def velocity(self, time: np.ndarray) -> np.ndarray:
        rate = 2.0 * np.pi / self.period
        angle = rate * np.asarray(time)
        return rate * self.radius * np.stack([-np.sin(angle), np.cos(angle), np.zeros_like(angle)], axis=-1)


@dataclass(frozen=True)
class Sway:
    """A sine along every axis about a centre: `amplitude` (3,) m, `rate` (3,) rad/s, `phase` (3,)."""

    centre: tuple[float, ...]
    amplitude: tuple[float, ...]
    rate: tuple[float, ...]
    phase: tuple[float, ...]

    def _angle(self, time: np.ndarray) -> np.ndarray:
        return np.asarray(time)[..., None] * np.array(self.rate) + np.array(self.phase)

    def position(self, time: np.ndarray) -> np.ndarray:
        return np.array(self.centre) + np.array(self.amplitude) * np.sin(self._angle(time))

    def velocity(self, time: np.ndarray) -> np.ndarray:
        return np.array(self.amplitude) * np.array(self.rate) * np.cos(self._angle(time))

    def speed_over(self, begin: np.ndarray, end: np.ndarray) -> np.ndarray:
        most = np.linalg.norm(np.array(self.amplitude) * np.array(self.rate) ** 2)  # of the acceleration
        return np.linalg.norm(self.velocity(begin), axis=-1) + (end - begin) * most


@dataclass(frozen=True)
class Room:
    """A shoebox with walls of one reflection factor, up to an order, and its air; no absorption if `lossless`."""

    size: tuple[float, ...]
    reflection: float
    order: int
    speed_of_sound: float
    temperature: float = 20.0  # °C
    humidity: float = 0.5
    pressure: float = 101_325.0
    lossless: bool = False

    def images(self) -> Iterator[tuple[int, np.ndarray, np.ndarray]]:
        """Yield order, signs (3,) and offset (3,) of every image ``sign x + offset``: cell n spans n L to (n + 1) L."""
        cells = range(-self.order, self.order + 1)
        for cell in ((i, j, k) for i in cells for j in cells for k in cells):
            order = sum(abs(n) for n in cell)
            if order <= self.order:
                odd = np.array([n % 2 for n in cell])
                yield order, 1.0 - 2.0 * odd, (np.array(cell) + odd) * np.array(self.size)

    def absorption(self, frequency: np.ndarray) -> np.ndarray:
        """Return dB/m, ISO 9613-1:1993 equations 3 to 5 and B.3."""
        if self.lossless:
            return np.zeros_like(frequency)
        kelvin, pa = self.temperature + 273.15, self.pressure / 101_325.0
        warm = kelvin / 293.15
        h = 100.0 * self.humidity * 10.0 ** (4.6151 - 6.8346 * (273.16 / kelvin) ** 1.261) / pa
        oxygen = pa * (24.0 + 4.04e4 * h * (0.02 + h) / (0.391 + h))
        nitrogen = pa / np.sqrt(warm) * (9.0 + 280.0 * h * np.exp(-4.170 * (warm ** (-1.0 / 3.0) - 1.0)))
        relaxing = 0.01275 * np.exp(-2239.1 / kelvin) / (oxygen + frequency**2 / oxygen)
        relaxing = relaxing + 0.1068 * np.exp(-3352.0 / kelvin) / (nitrogen + frequency**2 / nitrogen)
        return 8.686 * frequency**2 * (1.84e-11 * np.sqrt(warm) / pa + warm**-2.5 * relaxing)


@dataclass(frozen=True)
class Fineness:
    """How finely the truth is worked out; more of everything must change nothing."""

    oversampling: int = 4
    points: int = 14  # of the polynomial in time
    nodes: int = 6  # distances of the polynomial in distance
    padding: int = 4096  # samples of silence about the signal, four times as many if nothing limits its band


class Emitted:
    """Samples from time `start` on, filtered by the air over any distance and interpolated.

    `band_limit` is what the samples pass first: taps of odd length about their middle.
    """

    def __init__(
        self, samples: np.ndarray, rate: float, start: float, room: Room,
        band_limit: np.ndarray | None = None, fineness: Fineness = Fineness(),
    ) -> None:  # fmt: skip
        self.rate, self.start, self.room, self.fine = rate, start, room, fineness
        self.before = max(self.fine.padding * (4 if band_limit is None else 1), len(samples) // 4)
        self.length = next_fast_len(len(samples) + 2 * self.before, real=True)
        self.length += self.length % 2
        padded = np.zeros(self.length)
        padded[self.before : self.before + len(samples)] = samples
        self.spectrum = rfft(padded)
        self.spectrum[-1] *= 0.5  # half of it belongs to -rate / 2
        if band_limit is not None:
            taps = np.zeros(self.length)
            taps[: len(band_limit)] = band_limit
            self.spectrum = self.spectrum * rfft(np.roll(taps, -(len(band_limit) // 2)))
        self.absorption = room.absorption(np.arange(self.length // 2 + 1) * (rate / self.length))

    def sounds(self, time: np.ndarray) -> np.ndarray:
        """Test that times of emission lie where the samples are known."""
        at = (time - self.start) * self.rate + self.before
        return (at > self.fine.points) & (at < self.length - self.fine.points)

    def stream(self, distance: float) -> np.ndarray:
        """Return the oversampled signal through so many metres of air."""
        count = self.length * self.fine.oversampling
        heard = self.spectrum * 10.0 ** (-self.absorption * (distance - 1.0) / 20.0)
        return np.asarray(irfft(heard, count)) * self.fine.oversampling

    def at(self, time: np.ndarray, distance: np.ndarray) -> np.ndarray:
        """Return the signal (n,) at times of emission through distances of air."""
        place = ((time - self.start) * self.rate + self.before) * self.fine.oversampling
        out = np.zeros(len(time))
        for low, high in self._stretches(float(distance.min()), float(distance.max())):
            some = np.flatnonzero((distance >= low) & (distance < high))
            if not len(some):
                continue
            count = self.fine.nodes
            nodes = 0.5 * (low + high) - 0.5 * (high - low) * np.cos(np.pi * (np.arange(count) + 0.5) / count)
            if self.room.lossless:
                nodes = np.array([low])
            streams = [self.stream(node) for node in nodes]
            for part in (some[k : k + 20_000] for k in range(0, len(some), 20_000)):
                out[part] = self._between(streams, place[part], lagrange(nodes, distance[part]))
        return out

    def _stretches(self, low: float, high: float) -> Iterator[tuple[float, float]]:
        """Yield ranges of distance over which the loss at any frequency that is left is a short polynomial."""
        steepest = float(self.absorption.max()) / 8.686
        while low <= high:
            step = max(1.0 / steepest, 0.2 * low) if steepest > 0.0 else 2.0 * (high - low) + 1.0
            yield low, low + step
            low += step

    def _between(self, streams: list[np.ndarray], place: np.ndarray, in_distance: np.ndarray) -> np.ndarray:
        count = self.fine.points
        first = np.floor(place).astype(np.int64) - (count // 2 - 1)
        in_time = lagrange(np.arange(float(count)), place - first)
        out = np.zeros(len(place))
        for stream, weight in zip(streams, in_distance, strict=True):
            out += weight * sum(in_time[j] * stream[first + j] for j in range(count))
        return out


def lagrange(nodes: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Return the weights (nodes, n) of values at nodes in the polynomial through them."""
    off = at[None, :] - nodes[:, None]
    below, above = np.ones_like(off), np.ones_like(off)
    for k in range(1, len(nodes)):
        below[k] = below[k - 1] * off[k - 1]
        above[-k - 1] = above[-k] * off[-k]
    apart = nodes[:, None] - nodes[None, :] + np.eye(len(nodes))
    return below * above / apart.prod(axis=1)[:, None]


def delays(
    source: Curve, receiver: Curve, sign: np.ndarray, offset: np.ndarray, times: np.ndarray, c: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return delays of an image at times of reception (n,), and its Mach number towards the receiver at emission.

    Both are (n,), or (m, n) of m images, whose `sign` and `offset` are (m, 1, 3) then.
    """
    at = receiver.position(times)

    def apart(delay: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        way = at - (sign * source.position(times - delay) + offset)
        distance = np.sqrt(np.einsum("...k,...k->...", way, way))
        towards = np.einsum("...k,...k->...", way, sign * source.velocity(times - delay)) / distance
        return distance, towards / c

    low, high = np.zeros(len(times)), np.full(len(times), np.inf)
    delay = apart(low)[0] / c
    for _ in range(200):
        distance, mach = apart(delay)
        step = (delay - distance / c) / (1.0 - mach)
        if np.max(np.abs(step)) < 1e-14:
            return delay - step, mach
        short = step < 0.0  # delay c less distance grows with the delay, since Mach numbers are below 1
        low, high = np.where(short, delay, low), np.where(short, high, delay)
        new = delay - step
        inside = (new >= low) & (new <= high)
        delay = np.where(inside, new, np.where(np.isfinite(high), 0.5 * (low + high), 2.0 * delay))
    raise AssertionError("no time of emission found")


@dataclass(frozen=True)
class Truth:
    """What is heard at some samples, and the root of the sum of the squares of what each path gives."""

    pressure: np.ndarray
    level: np.ndarray


def truth(
    sources: list[tuple[Emitted, Curve]], receiver: Curve, room: Room, times: np.ndarray, block: int = 4_000_000
) -> Truth:
    """Return the pressure at a receiver at times (n,), from all sources."""
    pressure, power = np.zeros(len(times)), np.zeros(len(times))
    for emitted, curve in sources:
        found: list[tuple[np.ndarray, ...]] = []
        images, some = list(room.images()), max(1, TOGETHER // len(times))
        for first in range(0, len(images), some):
            order, sign, offset = (np.array(one) for one in zip(*images[first : first + some], strict=True))
            delay, mach = delays(curve, receiver, sign[:, None], offset[:, None], times, room.speed_of_sound)
            distance, emission = room.speed_of_sound * delay, times - delay
            heard = emitted.sounds(emission)
            gain = room.reflection ** order[:, None] / (distance * (1.0 - mach))
            found.append((np.nonzero(heard)[1], emission[heard], distance[heard], gain[heard]))
            if first + some >= len(images) or sum(len(f[0]) for f in found) > block:
                where, emission, away, gains = (np.concatenate([f[k] for f in found]) for k in range(4))
                found = []
                if len(where):
                    part = gains * emitted.at(emission, away)
                    pressure += np.bincount(where, part, len(times))
                    power += np.bincount(where, part**2, len(times))
    return Truth(pressure, np.sqrt(power))


def chosen(samples: int, count: int, seed: int = 0) -> np.ndarray:
    """Return `count` samples of so many, anywhere in equal cells: (n,), sorted."""
    edges = np.linspace(0, samples, min(count, samples) + 1).astype(np.int64)
    return np.asarray(np.random.default_rng(seed).integers(edges[:-1], edges[1:]))


def error_db(got: np.ndarray, exact: np.ndarray) -> float:
    """Return the error's RMS over that of what is heard, dB."""
    return float(20.0 * np.log10(np.linalg.norm(got - exact) / np.linalg.norm(exact)))


def local_errors(got: np.ndarray, exact: Truth, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return middles (w,) of windows in which something sounds, s, and errors over the level there (w,), dB."""
    window = np.floor(times / WINDOW).astype(np.int64)
    count = np.maximum(np.bincount(window), 1)
    wrong = np.bincount(window, (got - exact.pressure) ** 2) / count
    level = np.bincount(window, exact.level**2) / count
    heard = np.flatnonzero(level > 10 ** (QUIET_DB / 10) * level.max())
    return (heard + 0.5) * WINDOW, 10.0 * np.log10(np.maximum(wrong[heard], 1e-300) / level[heard])
