"""Noise that decays as the energies of a tail: the responses of its streams."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Floats
from clsim.numerics.quaternions import rotate
from clsim.paths.response import covered
from clsim.scene.directivity.directivity import ChannelDirectivity
from clsim.scene.directivity.patterns import Omni
from clsim.scene.ends import Receiver
from clsim.scene.scene import Scene
from clsim.tail.design import SourceTail
from clsim.tail.zones import TOGETHER, band_shares, joined_bands

_SHAPED = 7  # of seeds: what the numbers are for
_BESIDE = 250.0  # Hz beside a band, over which what its envelope adds fades out
_EVEN = 512  # steps between frequencies at which channels' gains are taken: impulses of twice as many samples
_RINGING = 1024  # samples in which the onset of low bands rings, before time 0


@dataclass(frozen=True, eq=False)
class Responses:
    """Responses of streams, K of them."""

    taps: NDArray[np.float32]  # (K, L) received over emitted pressure
    lead: int  # samples of them before that of time 0
    departure: NDArray[np.int64]  # (K,) in which direction each leaves the source, of the tail's
    output: NDArray[np.int64]  # (K,) to which of what is heard each adds


def plane_waves(tail: SourceTail, pair: tuple[int, int], source: int, rate: float, *, moves: bool) -> Responses:
    """Return the responses of a zone's streams, one for each direction of arrival, at the middle of the zone."""
    energy = tail.pairs[pair]
    rng = np.random.default_rng([tail.seed, source, *pair, _SHAPED])
    streams = np.arange(energy.energy.shape[1])
    departure = np.zeros_like(streams)
    if moves:  # as many of each as its share of the energy says
        ends = np.cumsum(energy.departed)
        drawn = np.searchsorted(ends / ends[-1], (streams + 0.5) / len(streams))
        departure = rng.permutation(np.minimum(drawn, len(ends) - 1))
    return Responses(_shaped(energy.energy, tail, rate, rng), 0, departure, streams)


def at_one_place(
    tail: SourceTail, pair: tuple[int, int], source: int, rate: float, weights: Floats, *, moves: bool
) -> Responses:
    """Return the responses at a zone's middle, for a single static end there; weights (M, B)."""
    # moves: whether the source does: then there is a stream for each direction of departure. Sums of independent noise
    # are noise: where no delay changes, directions of arrival are not distinguished.
    energy = tail.pairs[pair]
    rng = np.random.default_rng([tail.seed, source, *pair, _SHAPED])
    total = np.einsum("tmb,mb->tb", energy.energy, weights)[:, None, :]
    if moves:
        total = total * energy.departed[:, None]
    streams = np.arange(total.shape[1])
    return Responses(_shaped(total, tail, rate, rng), 0, streams, np.zeros_like(streams))


def combined(
    waves: Responses, delays: Floats, gains: Sequence[NDArray[Any]], centres: Floats, rate: float
) -> Responses:
    """Return the sum of plane waves at static places; delays (R, M) s; centres (B,) Hz."""
    # gains: of each place, (M, B) by band, or complex (M, F) at even frequencies up to half the sampling rate.
    from scipy.fft import irfft, next_fast_len, rfft

    lead = math.ceil(float(np.abs(delays).max(initial=0.0)) * rate) + 32
    count = waves.taps.shape[1] + 2 * lead
    size = next_fast_len(count, real=True)
    spectra = rfft(waves.taps, size)
    frequencies = np.arange(size // 2 + 1) * (rate / size)
    shares = band_shares(frequencies, centres)
    taps = np.empty((len(delays), count), np.float32)
    for place, (delay, gain) in enumerate(zip(delays, gains, strict=True)):
        total = np.zeros(len(frequencies), np.complex128)
        for spectrum, late, one in zip(spectra, delay, gain, strict=True):
            turn = np.exp(-2j * np.pi * frequencies * (late + lead / rate))
            shape = one
            if np.iscomplexobj(one):  # by its impulses
                impulses = irfft(one)
                early, later = np.split(impulses, [len(impulses) // 2])
                shape = rfft(np.concatenate([early, np.zeros(size - len(impulses)), later]))
            else:
                shape = one @ shares
            total += spectrum * turn if np.all(one == 1.0) else spectrum * turn * shape
        taps[place] = irfft(total, size)[:count]
    places = np.arange(len(delays))
    return Responses(taps, waves.lead + lead, np.zeros_like(places), places)


def receiver_gains(scene: Scene, receiver: int, directions: Floats, times: Floats, frequencies: Floats) -> Floats:
    """Return the gain of pressure (T, M, F) of a receiver at times (T,), s, for sound from directions (M, 3)."""
    end, shape = scene.receivers[receiver], (len(times), len(directions), len(frequencies))
    if isinstance(end.directivity, Omni):
        return np.ones(shape)
    turns = end.orientation(times)
    turns = turns[:1] if np.all(turns == turns[:1]) else turns
    own = np.stack([rotate(turns, axis) @ directions.T for axis in np.eye(3)], axis=-1)
    met = covered(frequencies, end.directivity)
    gain: Any = end.directivity.gain_towards(own[:, :, None, :], met, scene.air.speed_of_sound)
    # Signs are kept: a figure of eight is not coherent with an omnidirectional receiver in a diffuse field.
    return np.broadcast_to(np.abs(gain) if np.iscomplexobj(gain) else gain, shape)


def own_directions(end: Receiver, directions: Floats, times: Floats) -> Floats:
    """Return directions (M, 3) of the room in a receiver's own frame at times (T,), s, (T, M, 3)."""
    return np.stack([rotate(end.orientation(times), axis) @ directions.T for axis in np.eye(3)], axis=-1)


def channel_gains(scene: Scene, receiver: int, directions: Floats, times: Floats, frequencies: Floats) -> NDArray[Any]:
    """Return the gains (C, T, M, F) of a receiver's channels, with their signs or phases; see `receiver_gains`."""
    end = scene.receivers[receiver]
    own = own_directions(end, directions, times)
    met = covered(frequencies, end.directivity)
    return np.moveaxis(end.directivity.gain_towards(own[:, :, None, :], met, scene.air.speed_of_sound), -1, 0)


def row_gains(scene: Scene, receiver: int, directions: Floats, times: Floats, frequency: Floats) -> list[Floats]:
    """Return the gains (T, M) of each row of a receiver at times (T,), s, and one frequency (1,), Hz."""
    if isinstance(scene.receivers[receiver].directivity, ChannelDirectivity):
        return list(channel_gains(scene, receiver, directions, times, frequency)[..., 0])
    gains = receiver_gains(scene, receiver, directions, times, frequency)[:, :, 0]
    return [np.broadcast_to(gains, (len(times), gains.shape[1]))]


def static_gains(scene: Scene, receivers: Sequence[int], tail: SourceTail, time: float, rate: float) -> list[Any]:
    """Return the gains of every row of static receivers, as `combined` takes them."""
    found: list[Any] = []
    for r in receivers:
        if isinstance(scene.receivers[r].directivity, ChannelDirectivity):
            even = np.linspace(0.0, 0.5 * rate, _EVEN + 1)
            gains = channel_gains(scene, r, tail.arrivals, np.array([time]), even)[:, 0]
            found += list(gains.astype(np.complex128))
        else:
            found += list(gains_of(scene, [r], tail, time))
    return found


def _shaped(energy: NDArray[Any], tail: SourceTail, rate: float, rng: np.random.Generator) -> NDArray[np.float32]:
    """Return noise (K, L) whose energy in bands and bins of time is that of energies (T, K, B)."""
    # A bin of n samples of variance v has the energy n v at every frequency.
    from scipy.fft import irfft, next_fast_len

    times, streams, _ = energy.shape
    length = math.ceil(times * tail.time_step * rate)
    size = 2 * next_fast_len(-(-(length + _RINGING) // 2))
    bins = size // 2 + 1
    centres, parts = joined_bands(tail.centres, energy)
    shares = band_shares(np.arange(bins) * (rate / size), centres).astype(np.float32)
    beside = math.ceil(_BESIDE * size / rate)
    found = [
        (b, _Band.of(share, beside, (length, size), tail.time_step * rate, times))
        for b, share in enumerate(shares) if share.any()
    ]  # fmt: skip
    taps = np.empty((streams, length), np.float32)
    for first, joined in zip(range(0, streams, TOGETHER), parts, strict=True):
        level = np.sqrt(joined / (tail.time_step * rate)).astype(np.float32)
        level = np.ascontiguousarray(np.moveaxis(level, 0, 2))  # (k, J, T)
        rise = np.diff(level, axis=2, append=level[..., -1:])
        spectra = rng.standard_normal((len(level), 2 * bins), np.float32).view(np.complex64)
        spectra *= np.float32(math.sqrt(0.5 * size))
        total = np.zeros_like(spectra)
        for b, band in found:
            band.add(spectra, level[:, b], rise[:, b], total)
        taps[first : first + TOGETHER] = irfft(total, size)[:, :length]
    return taps


@dataclass(frozen=True, slots=True, eq=False)
class _Band:
    """A band of noise, shaped at a rate of its own: its spectrum alone is transformed, and moved to its place after."""

    share: NDArray[np.float32]  # (n,) amplitude of its part
    low: int  # first bin of it
    beside: int  # bins beside it: envelopes make bands wider
    fade: NDArray[np.float32]  # (m,) weights of bins, from the first one beside it on
    before: NDArray[np.int64]  # bins of time before each sample at that rate
    part: NDArray[np.float32]  # how far samples lie beyond their middles

    @classmethod
    def of(
        cls, share: NDArray[np.float32], beside: int, samples: tuple[int, int], step: float, times: int
    ) -> _Band:  # fmt: skip
        """Return a band by its share (F,) at all bins; samples of responses and of transforms; a step of time."""
        from scipy.fft import next_fast_len

        there, (length, size) = np.flatnonzero(share), samples
        low, high = int(there[0]), int(there[-1]) + 1
        count = next_fast_len(high - low + 2 * beside)
        # A spectrum that ends abruptly rings for as long as tails last, and is louder than bands beside it that decay
        # quickly.
        away = np.arange(count) - beside
        away = np.maximum(-away, away - (high - low - 1))
        fade = np.cos(0.5 * np.pi * np.clip(away / (beside + 1.0), 0.0, 1.0)).astype(np.float32) ** 2
        own = share[low:high].copy()
        own[[i for i, end in ((0, low == 0), (-1, high == len(share))) if end]] *= 0.5  # conjugates are the other half
        at = np.arange(math.ceil(length * count / size)) * (size / count)
        place = np.clip((at + 0.5) / step - 0.5, 0.0, times - 1.0)
        before = np.minimum(place.astype(np.int64), max(times - 2, 0))
        return cls(own, low, beside, fade, before, (place - before).astype(np.float32))

    def add(
        self, spectra: NDArray[np.complex64], level: NDArray[np.float32], rise: NDArray[np.float32],
        total: NDArray[np.complex64],
    ) -> None:  # fmt: skip
        """Add spectra (k, F) in the band, shaped by levels (k, T) that rise so much to the next ones, to a total."""
        from scipy.fft import fft, ifft

        own = np.zeros((len(spectra), len(self.fade)), np.complex64)
        within = slice(self.low, self.low + len(self.share))
        np.multiply(spectra[:, within], self.share, out=own[:, self.beside : self.beside + len(self.share)])
        made, count = ifft(own, overwrite_x=True), len(self.before)
        envelope = rise.take(self.before, axis=1, mode="clip")
        envelope *= self.part
        envelope += level.take(self.before, axis=1, mode="clip")
        made[:, :count] *= envelope
        made[:, count:] = 0.0
        shaped = fft(made, overwrite_x=True)
        shaped *= self.fade
        first, last = self.low - self.beside, total.shape[1] - 1
        into = total[:, max(first, 0) : first + len(self.fade)]
        into += shaped[:, max(-first, 0) :][:, : into.shape[1]]
        # What lies beyond either end of the spectrum are conjugates of what is before it.
        if first <= 0:
            total[:, : 1 - first] += np.conj(shaped[:, -first::-1])
        if first + len(self.fade) > last:
            beyond = np.conj(shaped[:, last - first :])
            total[:, last + 1 - beyond.shape[1] :] += beyond[:, ::-1]


def gains_of(scene: Scene, receivers: Sequence[int], tail: SourceTail, time: float) -> Floats:
    """Return the gains (R, M, B) of receivers at a time, s, by direction of arrival and band."""
    now = np.array([time])
    return np.concatenate([receiver_gains(scene, r, tail.arrivals, now, tail.centres) for r in receivers])
