"""Streams of a tail: emitted signals through long responses, block by block, and values between their samples."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import pairwise
from typing import Any, Protocol

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from clsim.arrays import Floats
from clsim.numerics.fractional_delay import design_bandlimited
from clsim.numerics.sphere import fibonacci_sphere, table_directions, table_values
from clsim.scene.directivity.directivity import ChannelDirectivity
from clsim.scene.scene import Scene
from clsim.tail.noise import Responses

Blocks = dict[int, NDArray[np.float32] | None]

_DIRECTIONS = 600  # over which responses are taken apart
_EVEN = 512  # steps between frequencies: impulses of twice as many samples
_EACH = 2  # of these from one at which weights are found to the next
_LEFT = 9e-4  # of the energy of all responses, that components leave out
_QUIET = 1e-5  # of the energy of all components, that is cut off before and after
_TURNING = 0.005  # s, between the instants at which directions are looked up
_ROWS = 72  # circles of latitude of the table of weights, 2.5 degrees apart: -41 dB for a KU 100
_PARTS = 8  # in which the table is made, to save memory
_BLOCK = 4096  # samples that are filtered at a time, at least
_KEPT = 2  # blocks
_FADE = 1.25  # of the end of the band, at which filters end


@dataclass(frozen=True, eq=False)
class EarFilters:
    """Responses of C channels without their lateness: R filters, with real weights for each direction and channel."""

    directivity: ChannelDirectivity
    speed_of_sound: float  # m/s
    step: int  # samples between the instants at which directions are looked up
    block: int  # samples that are filtered at a time
    table: NDArray[np.float32]  # (directions, C R) weights
    spectra: NDArray[np.complex64]  # (R, F) of the filters, at the size of a block and its end
    size: int  # of the transforms
    lead: int  # taps before time 0

    def joined(
        self, make: Callable[[int], NDArray[np.float32] | None], kept: Blocks, start: int, count: int
    ) -> NDArray[np.float32]:
        """Return samples (C, n) from `start` on of blocks as `filtered` returns them, None of silence."""
        # They lie on a fixed grid and are added in order, so that samples do not depend on what is asked for.
        total = np.zeros((len(self.directivity.channels), count), np.float32)
        first = start + self.lead
        for k in range((first - self.size) // self.block + 1, -(-(first + count) // self.block)):
            if k not in kept:
                kept[k] = make(k)
            made, begin = kept[k], k * self.block - first
            if made is not None:
                part = made[:, max(-begin, 0) : count - begin]
                total[:, max(begin, 0) : max(begin, 0) + part.shape[1]] += part
        for old in sorted(kept)[:-_KEPT]:
            del kept[old]
        return total

    def instants(self, k: int) -> NDArray[np.int64]:
        """Return the samples (n + 1,) of block k and its end at which directions are looked up."""
        return k * self.block + np.arange(0, self.block + 1, self.step)

    def lateness(self, directions: Floats) -> Floats:
        """Return delays (C, N, M) behind the centre, s, at the nodes of a block, for directions (n + 1, M, 3)."""
        late = np.moveaxis(self.directivity.lateness(directions, self.speed_of_sound), -1, 0)
        before, part = np.divmod(np.arange(0, self.block + 1, NODE), self.step)
        share = part[:, None] / self.step
        return np.asarray((1.0 - share) * late[:, before] + share * late[:, np.minimum(before + 1, late.shape[1] - 1)])

    def filtered(self, waves: NDArray[np.float32], directions: Floats) -> NDArray[np.float32]:
        """Return a block (C, n) from `lead` samples before it on, of the waves (C, M, n) at each ear."""
        # Weights are linear between the instants, at which waves come from directions (n + 1, M, 3) in the head's
        # frame.
        from scipy.fft import irfft, rfft

        channels, count, _ = waves.shape
        weights = table_values(self.table, directions).reshape(*directions.shape[:2], channels, -1)
        weights = weights.transpose(2, 0, 3, 1)  # (C, n + 1, R, M)
        parts = np.ascontiguousarray(waves.reshape(channels, count, -1, self.step).swapaxes(1, 2))
        ramp = (np.arange(self.step) / self.step).astype(np.float32)
        mixed = np.concatenate([weights[:, :-1], weights[:, 1:]], axis=3) @ np.concatenate(
            [parts * (np.float32(1.0) - ramp), parts * ramp], axis=2
        )
        spectra = rfft(mixed.swapaxes(1, 2).reshape(channels, -1, self.block), self.size)
        return np.asarray(irfft(np.einsum("crf,rf->cf", spectra, self.spectra), self.size))


def ears_among(scene: Scene, receivers: Sequence[int], rate: float, highest: float) -> dict[int, EarFilters]:
    """Return the filters of those receivers whose channels differ over frequency, by their index."""
    several = {r: scene.receivers[r].directivity for r in receivers}
    return {
        r: ear_filters(directivity, scene.air.speed_of_sound, rate, highest)
        for r, directivity in several.items()
        if isinstance(directivity, ChannelDirectivity) and not directivity.is_flat
    }


@lru_cache(maxsize=8)
def ear_filters(directivity: ChannelDirectivity, speed_of_sound: float, rate: float, highest: float) -> EarFilters:
    """Take the responses of a directivity apart, for sound below a frequency at a sampling rate, Hz."""
    # Impulse responses of evenly spread directions are a matrix; its largest singular vectors are the filters.
    from scipy.fft import irfft, next_fast_len, rfft

    even = np.linspace(0.0, 0.5 * rate, _EVEN + 1)
    fade = np.cos(0.5 * np.pi * np.clip((even / highest - 1.0) / (_FADE - 1.0), 0.0, 1.0)) ** 2
    met, channels = np.clip(even, *directivity.band), range(len(directivity.channels))
    responses = directivity.aligned(fibonacci_sphere(_DIRECTIONS), met, speed_of_sound, channels)
    impulses = irfft(fade * responses, axis=-1).reshape(-1, 2 * _EVEN)
    power, axes = np.linalg.eigh(impulses.T @ impulses)
    kept = np.cumsum(power) > _LEFT * power.sum()
    components = (axes[:, kept] * np.sqrt(power[kept])).T
    middle = np.roll(components, _EVEN, axis=1)
    loud = np.cumsum(np.sum(middle**2, axis=0))
    first, last = np.searchsorted(loud, loud[-1] * np.array([_QUIET, 1.0 - _QUIET])).tolist()
    spectra: Any = rfft(components)[:, ::_EACH]
    to_weights = np.linalg.pinv(np.concatenate([spectra.real, spectra.imag], axis=1))
    table = []
    for some in np.array_split(table_directions(_ROWS), _PARTS):
        responses = fade[::_EACH] * directivity.aligned(some, met[::_EACH], speed_of_sound, channels)
        weights = np.concatenate([responses.real, responses.imag], axis=2) @ to_weights
        table.append(np.concatenate(list(weights), axis=1))
    step = NODE * max(round(_TURNING * rate / NODE), 1)
    block = step * -(-_BLOCK // step)
    size = next_fast_len(block + last - first, real=True)
    return EarFilters(
        directivity, speed_of_sound, step, block, np.concatenate(table, dtype=np.float32),
        rfft(middle[:, first : last + 1].astype(np.float32), size), size, _EVEN - first,
    )  # fmt: skip


_LEAST_BLOCK = 16384  # samples
_OF_LENGTH = 3.0  # a block over a response, unless there is less to render
_TOGETHER = 8  # streams that are transformed at a time: as many as fill vectors
_MOST_HELD = 2**29  # bytes of streams that are kept from chunk to chunk; those of more zones are made again


class Emissions(Protocol):
    """Signals that a source emits in some directions, in the far field."""

    def sounds(self, zone: int, first: int, last: int) -> bool:
        """Test whether a zone emits between samples `first` and `last`."""

    def read(self, zone: int, departures: NDArray[np.int64], first: int, last: int) -> NDArray[Any]:
        """Return samples `first` to `last` (Q, n) of what a zone sends in directions."""


@dataclass(eq=False)
class Streams:
    """Streams of one zone of receivers, of all zones of a source."""

    # Blocks lie on a grid that begins with sample 0, and each is computed from the emitted signal alone: whatever is
    # asked for, in which order and by which process, a sample is the same to the last bit. By overlap-save (A. V.
    # Oppenheim, R. W. Schafer, "Discrete-Time Signal Processing", 3rd ed., 2010, section 8.7.3).
    emissions: Emissions
    make: Callable[[int], Responses]
    zones: int
    count: int
    longest: int
    samples: int
    lead: int = 0
    _sending: dict[int, _Sending] = field(init=False, default_factory=dict)
    _blocks: dict[int, NDArray[np.float32] | None] = field(init=False, default_factory=dict)

    @property
    def block(self) -> int:
        """Samples of a block: as many as make a sample cheap."""
        return max(_LEAST_BLOCK, min(int(_OF_LENGTH * self.longest), self.samples))

    def read(self, first: int, last: int) -> NDArray[np.float32] | None:
        """Return samples `first` to `last` of all streams (K, n); None where all of it is silence."""
        grid = range(first // self.block, -(-last // self.block))
        parts = {k: self._made(k) for k in grid}
        if all(part is None for part in parts.values()):
            return None
        out = np.zeros((self.count, last - first), np.float32)
        for k, part in parts.items():
            begin, end = max(first, k * self.block), min(last, (k + 1) * self.block)
            if part is not None:
                out[:, begin - first : end - first] = part[:, begin - k * self.block : end - k * self.block]
        return out

    @property
    def held_bytes(self) -> int:
        """Memory of what is kept between calls."""
        blocks = sum(block.nbytes for block in self._blocks.values() if block is not None)
        return blocks + sum(sending.spectra.nbytes for sending in self._sending.values())

    def kept_within(self, held: int) -> int:
        """Add what is kept to the bytes that others hold, or drop it if all is too much: it is made again."""
        if held + self.held_bytes <= _MOST_HELD:
            return held + self.held_bytes
        self._blocks, self._sending = {}, {}
        return held

    def _made(self, k: int) -> NDArray[np.float32] | None:
        if k not in self._blocks:
            made = self._block(k)
            for old in list(self._blocks)[: 1 - _KEPT]:  # those that were made first
                del self._blocks[old]
            self._blocks[k] = made
        return self._blocks[k]

    def _block(self, k: int) -> NDArray[np.float32] | None:
        """Return block k of all streams (K, block)."""
        from scipy.fft import irfft, next_fast_len, rfft

        past = self.longest - 1
        size = next_fast_len(self.block + past, real=True)
        first, last = k * self.block + self.lead - past, (k + 1) * self.block + self.lead
        received: list[tuple[_Sending, NDArray[Any]]] = []
        sending = {}
        for zone in range(self.zones):
            if not self.emissions.sounds(zone, first, last):
                continue
            sending[zone] = self._sending.get(zone) or _Sending.of(self.make(zone), size)
            signals = self.emissions.read(zone, sending[zone].departures, first, last)
            received.append((sending[zone], rfft(signals.astype(np.float32), size)))
        self._sending = sending  # others are made again when they sound again
        if not received:
            return None
        out = np.empty((self.count, self.block), np.float32)
        for begin in range(0, self.count, _TOGETHER):
            total = np.zeros((min(_TOGETHER, self.count - begin), size // 2 + 1), np.complex64)
            for zone_sends, spectra in received:
                zone_sends.add(total, begin, spectra)
            out[begin : begin + len(total)] = irfft(total, size)[:, past : past + self.block]
        return out


@dataclass(frozen=True, eq=False)
class _Sending:
    """Spectra of the responses of a zone of the source."""

    spectra: NDArray[Any]
    departures: NDArray[np.int64]
    which: NDArray[np.int64]  # of these each response is
    output: NDArray[np.int64]

    @classmethod
    def of(cls, responses: Responses, size: int) -> _Sending:
        """Return the spectra of responses, of a size."""
        from scipy.fft import rfft

        departures, which = np.unique(responses.departure, return_inverse=True)
        return cls(rfft(responses.taps, size), departures, which, responses.output)

    def add(self, total: NDArray[Any], begin: int, signals: NDArray[Any]) -> None:
        """Add what outputs from `begin` on hear of signals' spectra (Q, F)."""
        for i in range(len(total)):
            for k in np.flatnonzero(self.output == begin + i):
                total[i] += signals[self.which[k]] * self.spectra[k]


NODE = 32  # samples between nodes, at which motion is looked at: whole numbers of them from sample 0
NEIGHBOURS = 8  # samples that share a whole part of the delay, where vectors are used
_ERROR_DB = -70.0  # of what is passed
_LEAST_BAND = 0.25  # of the sampling rate, below which filters hardly become shorter
_LEAST_REST = 0.75  # of a sample, for which filters are right around the nearest one
_PHASES = 4096  # of a sample, between which the nearest is taken: -70 dB at 0.84 of Nyquist


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """Read positions and gains of M streams for R listeners at N nodes, linear between these."""

    # Listeners read M streams each in turn: the first M, the next M, and the first again after the last.
    ahead: Floats  # (R, N, M) samples by which each stream is read ahead of the clock
    gains: Floats  # (R, N, M) of each stream

    @property
    def reach(self) -> tuple[int, int]:
        """Whole samples by which streams are read ahead, at least and at most."""
        return math.floor(self.ahead.min()), math.ceil(self.ahead.max())


class Waves(Protocol):
    """Interface of sums of streams for moving listeners."""

    def received(
        self, streams: NDArray[np.float32], first: int, motion: Motion, start: int, stop: int
    ) -> NDArray[np.float32]:
        """Return the pressure at listeners (R, n), samples `start` to `stop`, of streams (K, L) from sample `first` on.

        Motion is known at the nodes from that of `start` to the one that is not before `stop`.
        """


@dataclass(frozen=True, slots=True, eq=False)
class Between:
    """Filters for places between samples."""

    # (powers, taps) of each sample, from `half` before the nearest one on: the coefficients of powers of how far beyond
    # that one.
    bank: NDArray[np.float32]

    @classmethod
    def up_to(cls, band: float, rate: float, fastest: float) -> Between:
        """Return filters for signals below a frequency at a sampling rate, Hz, and for a speed over that of sound."""
        rest = max(_LEAST_REST, 0.5 + 0.5 * (NEIGHBOURS - 1) * fastest)
        cutoff = 2.0 * math.pi * max(band / rate, _LEAST_BAND)
        delays, _ = design_bandlimited(_ERROR_DB, cutoff, rest)
        signs = np.where(np.arange(len(delays)) % 2 == 0, 1.0, -1.0)  # ahead, not late
        return cls((delays * signs[:, None])[:, ::-1].astype(np.float32))

    @property
    def half(self) -> int:
        """Samples that are read to either side."""
        return int(self.bank.shape[1] // 2)


class HostWaves:
    """Sums streams on the host: the definition of right."""

    def __init__(self, between: Between) -> None:
        self._half = between.half
        rest = np.arange(_PHASES + 1) / _PHASES - 0.5
        self._table = np.polynomial.polynomial.polyval(rest, between.bank.astype(np.float64)).T.astype(np.float32)

    def received(
        self, streams: NDArray[np.float32], first: int, motion: Motion, start: int, stop: int
    ) -> NDArray[np.float32]:
        """Return the pressure at listeners (R, n), see `Waves`."""
        samples = np.arange(start, stop)
        grid = (start // NODE + np.arange(motion.ahead.shape[1])) * NODE
        out = np.zeros((len(motion.ahead), len(samples)), np.float32)
        for i, (total, ahead, gains) in enumerate(zip(out, motion.ahead, motion.gains, strict=True)):
            for m in range(ahead.shape[1]):
                stream = streams[(i * ahead.shape[1] + m) % len(streams)]
                value = self._at(stream, samples - first + np.interp(samples, grid, ahead[:, m]))
                total += value * np.interp(samples, grid, gains[:, m]).astype(np.float32)
        return out

    def _at(self, stream: NDArray[Any], places: Floats) -> NDArray[np.float32]:
        """Return the values (n,) of a stream at places (n,), samples from its first one, which it must hold around."""
        windows = sliding_window_view(stream, self._table.shape[1])
        whole = np.rint(places).astype(np.int64)
        phase = np.rint((places - whole + 0.5) * _PHASES).astype(np.int64)
        out = np.empty(len(places), np.float32)
        # Where the whole part of the delay stays the same, samples and windows go on side by side and are not copied.
        ahead = whole - np.arange(len(places))
        bounds = np.concatenate([[0], np.flatnonzero(np.diff(ahead)) + 1, [len(places)]])
        for first, last in pairwise(bounds.tolist()):
            begin = int(whole[first]) - self._half
            np.einsum(
                "nt,nt->n", windows[begin : begin + last - first], self._table[phase[first:last]], out=out[first:last]
            )
        return out
