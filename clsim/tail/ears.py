"""Ears that move or turn among plane waves: a few filters, whose weights and delays follow the direction."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Floats
from clsim.numerics.sphere import fibonacci_sphere, table_directions, table_values
from clsim.scene.directivity.directivity import ChannelDirectivity
from clsim.scene.scene import Scene
from clsim.tail.streams import NODE

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
        """Return samples (C, n) from `start` on of blocks as `filtered` returns them, None of silence.

        They lie on a fixed grid and are added in order, so that samples do not depend on what is asked for.
        """
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
        """Return a block (C, n) from `lead` samples before it on, of the waves (C, M, n) at each ear.

        Weights are linear between the instants, at which waves come from directions (n + 1, M, 3) in the head's frame.
        """
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
    """Take the responses of a directivity apart, for sound below a frequency at a sampling rate, Hz.

    Impulse responses of evenly spread directions are a matrix; its largest singular vectors are the filters.
    """
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
