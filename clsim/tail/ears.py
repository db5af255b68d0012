"""Ears that move or turn among plane waves: a few filters, whose weights and delays follow the direction."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from clsim.numerics.sphere import fibonacci_sphere
from clsim.scene.directivity.directivity import ChannelDirectivity
from clsim.tail.streams import NODE

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from clsim.arrays import Floats
    from clsim.scene.scene import Scene

_DIRECTIONS = 600  # over which responses are taken apart
_EVEN = 512  # steps between frequencies: impulses of twice as many samples
_EACH = 2  # of these from one at which weights are found to the next
_LEFT = 1e-3  # of the energy of all responses, that components leave out
_QUIET = 1e-5  # of the energy of all components, that is cut off before and after
_TURNING = 0.005  # s, between the instants at which directions are looked up
_FADE = 1.25  # of the end of the band, at which filters end


@dataclass(frozen=True, eq=False)
class EarFilters:
    """Responses of C channels without their lateness: R filters, with real weights for each direction and channel."""

    directivity: ChannelDirectivity
    speed_of_sound: float  # m/s
    frequencies: Floats  # (F,) at which weights are found, Hz
    fade: Floats  # (F,) of the band's upper end
    projection: Floats  # (2 F, R) from real and imaginary parts of responses to weights
    taps: NDArray[np.float32]  # (R, L)
    lead: int  # taps before time 0

    def weights(self, directions: Floats) -> Floats:
        """Return the weights (C, ..., R) of the filters for sound from directions (..., 3) in the head's frame."""
        channels = range(len(self.directivity.channels))
        response = self.fade * self.directivity.aligned(directions, self.frequencies, self.speed_of_sound, channels)
        return np.asarray(np.concatenate([response.real, response.imag], axis=-1) @ self.projection)

    def lateness(self, directions: Floats) -> Floats:
        """Return the delays (C, ...) behind the centre, s, that go with the weights."""
        return np.moveaxis(self.directivity.lateness(directions, self.speed_of_sound), -1, 0)

    def motions(
        self, own: Callable[[NDArray[np.int64]], Floats], grid: NDArray[np.int64], rate: float
    ) -> list[tuple[Floats, Floats]]:
        """Return lateness, s, and weights (N, M) of each filter, ear by ear, at samples (N,) of nodes.

        own: directions (n, M, 3) in the head's frame at samples (n,). Both are joined from a wider grid.
        """
        wide = NODE * max(round(_TURNING * rate / NODE), 1)
        few = wide * np.arange(grid[0] // wide, -(-grid[-1] // wide) + 2)
        directions = own(few)
        before, part = np.divmod(grid - few[0], wide)
        part = (part / wide)[:, None]
        # Products of one size, so that no bit depends on how many nodes are asked for.
        each = np.stack([self.weights(one) for one in directions], axis=1)
        late, weights = self.lateness(directions), np.moveaxis(each, -1, 1)
        late, weights = ((1.0 - part) * v[..., before, :] + part * v[..., before + 1, :] for v in (late, weights))
        return [(of_ear, weight) for of_ear, all_of_it in zip(late, weights, strict=True) for weight in all_of_it]

    def through(self, parts: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the sound (C, n) of what each filter is given, (C R, n + L - 1), from L - 1 - `lead` samples ahead."""
        count = self.taps.shape[1]
        out = np.zeros((len(self.directivity.channels), parts.shape[1] - count + 1), np.float32)
        for i, part in enumerate(parts):
            channel, r = divmod(i, len(self.taps))
            # Sums of a fixed length, so that samples do not depend on what is asked for.
            out[channel] += np.einsum("nt,t->n", sliding_window_view(part, count), self.taps[r, ::-1])
        return out


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
    from scipy.fft import irfft, rfft

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
    return EarFilters(
        directivity, speed_of_sound, met[::_EACH], fade[::_EACH],
        np.linalg.pinv(np.concatenate([spectra.real, spectra.imag], axis=1)),
        np.ascontiguousarray(middle[:, first : last + 1], dtype=np.float32), _EVEN - first,
    )  # fmt: skip
