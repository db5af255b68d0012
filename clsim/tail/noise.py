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
_SLOWNESSES = (1, 2, 4, 8, 16)  # by which sampling rates are divided
_SLOWEST = _SLOWNESSES[-1]
_ROOM = 1.25  # half of such a rate over the end of a band, at least: envelopes make bands wider
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
    # A bin of n samples of variance v has the energy n v at every frequency. Low bands are shaped at lower rates.
    from scipy.fft import irfft, next_fast_len, rfft

    times, streams, _ = energy.shape
    length = math.ceil(times * tail.time_step * rate)
    size = _SLOWEST * next_fast_len(-(-(length + _RINGING) // _SLOWEST), real=True)
    centres, parts = joined_bands(tail.centres, energy)
    shares = band_shares(np.arange(size // 2 + 1) * (rate / size), centres).astype(np.float32)
    last = np.append(centres[1:], 0.5 * rate)  # bands end at the next centre
    fits = [np.where(n * _ROOM * last <= 0.5 * rate, n, 1) for n in _SLOWNESSES]
    slowness = np.max(fits, axis=0)  # powers of two by which the sampling rate is divided
    groups = [(n, *_envelope_places(length, n, tail.time_step * rate, times)) for n in np.unique(slowness).tolist()]
    taps = np.empty((streams, length), np.float32)
    for first, joined in zip(range(0, streams, TOGETHER), parts, strict=True):
        level = np.sqrt(joined / (tail.time_step * rate)).astype(np.float32)
        level = np.ascontiguousarray(np.moveaxis(level, 0, 2))  # (k, J, T)
        rise = np.diff(level, axis=2, append=level[..., -1:])
        spectra = rfft(rng.standard_normal((len(level), size), np.float32))
        total = np.zeros_like(spectra)
        for slow, before, part in groups:
            bins = size // slow // 2 + 1
            made = np.zeros((len(level), size // slow), np.float32)
            for b in np.flatnonzero(slowness == slow):
                envelope = rise[:, b].take(before, axis=1, mode="clip")
                envelope *= part
                envelope += level[:, b].take(before, axis=1, mode="clip")
                envelope *= irfft(spectra[:, :bins] * shares[b, :bins], size // slow)[:, : len(part)]
                made[:, : len(part)] += envelope
            total[:, :bins] += rfft(made) * _fade(bins, slow)
        taps[first : first + TOGETHER] = irfft(total, size)[:, :length]
    return taps


def _fade(bins: int, slow: int) -> NDArray[np.float32]:
    """Weights (bins,) of a spectrum up to half of a lower rate, 1 where bands are, that fall off towards its end."""
    # Envelopes that change within a few samples reach up to there. A spectrum that ends abruptly rings for as long as
    # tails last, and is louder than bands beside it that decay quickly.
    if slow == 1:
        return np.ones(bins, np.float32)
    beyond = np.clip((np.arange(bins) / (bins - 1) * _ROOM - 1.0) / (_ROOM - 1.0), 0.0, 1.0)
    return np.cos(0.5 * np.pi * beyond).astype(np.float32) ** 2


def _envelope_places(length: int, slow: int, step: float, times: int) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """Return the bins of time before every `slow`-th sample, and how far beyond their middles these lie, (n,) each."""
    at = np.clip((np.arange(0, length, slow) + 0.5) / step - 0.5, 0.0, times - 1.0)
    before = np.minimum(at.astype(np.int64), max(times - 2, 0))
    return before, (at - before).astype(np.float32)


def gains_of(scene: Scene, receivers: Sequence[int], tail: SourceTail, time: float) -> Floats:
    """Return the gains (R, M, B) of receivers at a time, s, by direction of arrival and band."""
    now = np.array([time])
    return np.concatenate([receiver_gains(scene, r, tail.arrivals, now, tail.centres) for r in receivers])
