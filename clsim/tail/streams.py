"""Streams of a tail: emitted signals through long responses, block by block on a grid of their own."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from clsim.tail.noise import Responses

_LEAST_BLOCK = 16384  # samples
_OF_LENGTH = 3.0  # a block over a response, unless there is less to render
_TOGETHER = 8  # streams that are transformed at a time: as many as fill vectors
_KEPT = 2  # blocks


class Emissions(Protocol):
    """Signals that a source emits in some directions, in the far field."""

    def sounds(self, zone: int, first: int, last: int) -> bool:
        """Test whether a zone emits between samples `first` and `last`."""
        ...

    def read(self, zone: int, departures: NDArray[np.int64], first: int, last: int) -> NDArray[Any]:
        """Return samples `first` to `last` (Q, n) of what a zone sends in directions."""
        ...


@dataclass(eq=False)
class Streams:
    """Streams of one zone of receivers, of all zones of a source.

    Blocks lie on a grid that begins with sample 0, and each is computed from the emitted signal alone: whatever is
    asked for, in which order and by which process, a sample is the same to the last bit. By overlap-save (A. V.
    Oppenheim, R. W. Schafer, "Discrete-Time Signal Processing", 3rd ed., 2010, section 8.7.3).
    """

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

    def forget(self) -> None:
        """Drop what is kept between calls: it is made again, to the last bit."""
        self._blocks, self._sending = {}, {}

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
        heard: list[tuple[_Sending, NDArray[Any]]] = []
        sending = {}
        for zone in range(self.zones):
            if not self.emissions.sounds(zone, first, last):
                continue
            sending[zone] = self._sending.get(zone) or _Sending.of(self.make(zone), size)
            signals = self.emissions.read(zone, sending[zone].departures, first, last)
            heard.append((sending[zone], rfft(signals.astype(np.float32), size)))
        self._sending = sending  # others are made again when they sound again
        if not heard:
            return None
        out = np.empty((self.count, self.block), np.float32)
        for begin in range(0, self.count, _TOGETHER):
            total = np.zeros((min(_TOGETHER, self.count - begin), size // 2 + 1), np.complex64)
            for zone_sends, spectra in heard:
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
