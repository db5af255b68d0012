"""The tail of a source: how much energy arrives when, in which band and from where, beyond what images hold."""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.numerics.sphere import fibonacci_sphere
from clsim.paths.family import SPECULAR
from clsim.paths.response import covered
from clsim.scene.directivity.patterns import Omni
from clsim.tail.modes import modal_shares
from clsim.tail.rays import FLOOR, Listener, Tracer, volume_within
from clsim.tail.room_rays import WallEnergies, room_rays

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from clsim.arrays import Floats
    from clsim.paths.path_set import PathSet
    from clsim.scene.scene import Scene
    from clsim.tail.zones import Zones

ULTRASOUND = 40e3  # Hz, from which on images hold what is heard
DEPARTURES = 32  # directions of departure that are told apart
_STEP = 1e-3  # s, bins of time
_MOST_RAYS = 131_072  # from one place
_LEAST_RUNS = 4
_WINDOW = 0.02  # s, in which energies are compared between runs
_DEPTH = 1e-4  # of the loudest window's energy, down to which they are


@dataclass(frozen=True, eq=False)
class TailEnergy:
    """Energy of a tail from one zone to another."""

    # (T, M, B) by bin of time, direction of arrival and band: of the received over that of what was emitted, Pa² s /
    # (Pa² s).
    energy: NDArray[np.float32]
    departed: Floats  # (Q,) shares of it by direction of departure
    images: Floats  # (T, B) what images hold beside it, likewise


@dataclass(frozen=True, eq=False)
class SourceTail:
    """The tail of one source at all receivers."""

    centres: Floats  # (B,) of the bands, Hz
    time_step: float  # of the bins of time, s
    zones: Zones  # of the source, and of all receivers
    receiver_zones: Zones  # likewise
    pairs: dict[tuple[int, int], TailEnergy]  # `TailEnergy` by index of the source's zone and of the receivers'
    arrivals: Floats  # (M, 3) directions
    departures: Floats  # likewise
    rays: int  # that were traced for each zone of the source, at most
    error_db: float  # standard error of energies in windows of 20 ms, dB
    seed: int  # of rays and noise

    @property
    def duration(self) -> float:
        """Time after which the tail is negligible, s."""
        return max(len(pair.energy) for pair in self.pairs.values()) * self.time_step

    @property
    def left_db(self) -> float:
        """Energy of the tail over that of tail and images together, in the band where it is most, dB; -inf for none."""
        shares = []
        for pair in self.pairs.values():
            tail, images = pair.energy.sum(axis=(0, 1), dtype=np.float64), pair.images.sum(axis=0)
            shares.append(float((tail / np.maximum(tail + images, 1e-300)).max()))
        return 10.0 * math.log10(max(shares)) if max(shares) > 0.0 else -math.inf

    def digest(self) -> str:
        """Return a text that changes with any of it."""
        found = hashlib.sha256(repr((self.time_step, self.seed, sorted(self.pairs))).encode())
        for key in sorted(self.pairs):
            pair = self.pairs[key]
            for part in (pair.energy, pair.departed, self.centres, self.zones.poses, self.receiver_zones.poses):
                found.update(np.ascontiguousarray(part).tobytes())
        return found.hexdigest()

    def describe(self) -> str:
        """Describe it in a line."""
        return (
            f"{self.duration:.3g} s in {len(self.centres)} bands from {self.centres[0]:.4g} to {self.centres[-1]:.4g} "
            f"Hz, {len(self.arrivals)} directions, {len(self.zones)} x {len(self.receiver_zones)} zones; "
            f"{self.rays} rays, energies in 20 ms within {self.error_db:.2f} dB"
        )


@dataclass(frozen=True, slots=True)
class TailOptions:
    """Options of the search for a tail."""

    max_order: int  # of the images beside it
    directions: int = 64  # from which it arrives
    error_db: float = 0.25  # standard error of its energies that is asked for, dB
    seed: int = 0  # of rays and noise
    rays: int = 2048  # that are traced at a time, four times at least


def find_tail(
    scene: Scene,
    source: int,
    band: tuple[float, float],
    zones: tuple[Zones, Zones],
    options: TailOptions,
    progress: Callable[[float], None] | None = None,
) -> SourceTail:
    """Return the tail of a source by rays; band (low, high) Hz."""
    of_source, of_receivers = zones
    centres = band_centres(*band)
    c, walls = scene.air.speed_of_sound, room_rays(scene.room)
    energies, departures = WallEnergies.of(scene, centres), fibonacci_sphere(DEPARTURES)
    arrivals = fibonacci_sphere(options.directions)
    volumes = [volume_within(scene.room, centre, of_receivers.radius) for centre in of_receivers.centres]
    pairs: dict[tuple[int, int], TailEnergy] = {}
    most_rays, error_db = 0, 0.0
    for i, place in enumerate(of_source.centres):
        emitted = _emitted(scene, source, of_source.turns[i], centres)
        tracer = Tracer(walls, scene.room.faces.normals, energies, place, emitted, departures, options.max_order)
        rng = np.random.default_rng([options.seed, source, i])
        until = tracer.longest_way(c, rng)
        shape = math.ceil(until / (_STEP * c)), len(centres)
        listeners = [
            Listener(centre, of_receivers.radius, volume, arrivals, departures, _STEP * c, shape)
            for centre, volume in zip(of_receivers.centres, volumes, strict=True)
        ]
        runs, error = _converged(tracer, until, listeners, rng, options)
        most_rays, error_db = max(most_rays, runs * options.rays), max(error_db, error)
        times = _STEP * (np.arange(shape[0], dtype=np.float64) + 0.5)
        modal = modal_shares(scene.room, energies, centres, times, c)
        pairs |= {(i, j): _settled(listener, runs, modal) for j, listener in enumerate(listeners)}
        if progress is not None:
            progress((i + 1) / len(of_source))
    return SourceTail(
        centres, _STEP, of_source, of_receivers, pairs, arrivals, departures, most_rays, error_db, options.seed
    )


def searched_order(paths: PathSet) -> int:
    """Return the highest order of images among paths."""
    only_mirrored = np.all((paths.interactions == SPECULAR) | (paths.interactions < 0), axis=1)
    return int(paths.order[only_mirrored].max(initial=0))


def _emitted(scene: Scene, source: int, turn: Floats, centres: Floats) -> Callable[[Floats], Floats]:
    """Return a function: the energy (n, B) that a source emits in directions (n, 3), turned by a quaternion."""
    from clsim.numerics.quaternions import rotate

    directivity, c = scene.sources[source].directivity, scene.air.speed_of_sound

    def emitted(directions: Floats) -> Floats:
        if isinstance(directivity, Omni):
            return np.ones((len(directions), len(centres)))
        own = np.stack([directions @ rotate(turn, axis) for axis in np.eye(3)], axis=1)
        gain = directivity.gain_towards(own[:, None, :], covered(centres, directivity), c)
        return np.broadcast_to(np.square(np.abs(gain)), (len(directions), len(centres)))

    return emitted


def _converged(
    tracer: Tracer, until: float, listeners: list[Listener], rng: np.random.Generator, options: TailOptions
) -> tuple[int, float]:
    """Trace until energies are known within an error, dB, or rays are very many; return runs and the error reached."""
    windows: list[Floats] = []
    before = np.zeros(1)
    runs, error = 0, math.inf
    while runs < _LEAST_RUNS or (error > options.error_db and runs * options.rays < _MOST_RAYS):
        for _ in range(max(_LEAST_RUNS, runs // 2)):
            tracer.run(options.rays, until, listeners, rng)
            now = np.stack([_windowed(listener.tail.sum(axis=1)) for listener in listeners])
            windows.append(now - before)
            before = now
            runs += 1
        error = _error_db(np.array(windows))
    return runs, error


def _windowed(energy: Floats) -> Floats:
    """Return energies (T, B) summed in windows of 20 ms."""
    length = round(_WINDOW / _STEP)
    padded = np.pad(energy, ((0, -len(energy) % length), (0, 0)))
    return np.asarray(padded.reshape(-1, length, energy.shape[1]).sum(axis=1))


def _error_db(runs: Floats) -> float:
    """Return the standard error of the mean of runs (R, zones, windows, B), in the mean over what is loud, dB."""
    mean, spread = runs.mean(axis=0), runs.std(axis=0, ddof=1) / math.sqrt(len(runs))
    loud = mean > _DEPTH * mean.max(axis=1, initial=0.0, keepdims=True)
    if not loud.any():
        return 0.0
    relative = np.sqrt(np.mean(np.square(spread[loud] / mean[loud])))
    return float(10.0 / math.log(10.0) * relative)


def _settled(listener: Listener, runs: int, modal: Floats) -> TailEnergy:
    """Mean of runs, as modes (T, B) decay, smoothed and cut at its audible end."""
    tail, images = listener.tail * modal[:, None] / runs, listener.images / runs
    total = tail.sum(axis=(0, 1)) + images.sum(axis=0)
    left = np.cumsum(tail.sum(axis=1)[::-1], axis=0)[::-1]
    loud = np.flatnonzero((left > FLOOR * total).any(axis=1))
    last = int(loud[-1]) + 1 if len(loud) else 1
    departed = listener.departed.sum(axis=1)
    departed = departed / departed.sum() if departed.any() else np.full(len(departed), 1.0 / len(departed))
    return TailEnergy(smoothed(tail[:last]).astype(np.float32), departed, images)


_OF_TIME = 0.03  # half of a window of time over the time itself
_OF_DIRECTIONS = 0.2  # the same for directions, which change more slowly and of which there are many
_LEAST = 2  # bins, half of a window for directions at the beginning


def smoothed(energy: Floats) -> Floats:
    """Return energies (T, M, B) by bin of time, direction and band, smoothed over times that grow with time.

    The sum over directions is kept, but for a short window in which it is smoothed; how it is spread over them is taken
    from a longer one, for it changes slowly.
    """
    total = _smoothed(energy.sum(axis=1), _OF_TIME, 0)
    spread = _smoothed(energy, _OF_DIRECTIONS, _LEAST)
    whole = spread.sum(axis=1, keepdims=True)
    even = np.full_like(spread, 1.0 / energy.shape[1])
    return np.asarray(total[:, None, :] * np.where(whole > 0.0, spread / np.maximum(whole, 1e-300), even))


def _smoothed(values: Floats, share: float, least: int) -> Floats:
    """Return means of values (T, ...) over times from `t - w` to `t + w`, w a share of t, cut at both ends alike."""
    count = len(values)
    t: NDArray[np.int64] = np.arange(count)
    half = np.minimum(np.maximum((share * t).astype(np.int64), least), np.minimum(t, count - 1 - t))
    cumulated = np.concatenate([np.zeros((1, *values.shape[1:])), np.cumsum(values, axis=0)])
    length = (2 * half + 1).reshape(-1, *[1] * (values.ndim - 1))
    return np.asarray((cumulated[t + half + 1] - cumulated[t - half]) / length)


_LOWEST = 31.25  # Hz, of a band's centre
_SILENT = 1e-30  # energy, whose logarithm is still a number


def band_centres(low: float, high: float) -> Floats:
    """Return centres (B,) of thirds of octaves that hold a band, Hz."""
    low = max(low, _LOWEST)
    high = max(high, low)
    first, last = (round(3.0 * math.log2(f / 1000.0)) for f in (low, high))
    return np.asarray(1000.0 * 2.0 ** (np.arange(first, last + 1) / 3.0))


def band_shares(frequencies: NDArray[Any], centres: Floats) -> Floats:
    """Return the amplitude (B, F) of each band's part at frequencies (F,), Hz: together 1 everywhere.

    At a centre a band is alone; between two of them one fades into the other over the logarithm of frequency, so that
    the amplitude of noise shaped in bands goes smoothly from one centre's to the next; it is held beyond the ends.
    """
    at = np.interp(np.log(np.maximum(frequencies, 1e-3)), np.log(centres), np.arange(len(centres), dtype=np.float64))
    away = np.abs(at - np.arange(len(centres))[:, None])
    return np.asarray(np.where(away < 1.0, np.cos(0.5 * np.pi * np.minimum(away, 1.0)) ** 2, 0.0))


def with_middles(centres: Floats) -> Floats:
    """Return the centres (2B - 1,) of bands and the geometric middles between them, Hz."""
    return np.exp(np.interp(np.arange(2 * len(centres) - 1) / 2.0, np.arange(len(centres)), np.log(centres)))


def at_middles(energy: NDArray[Any]) -> Floats:
    """Return energies (..., 2B - 1) at the centres of bands and the middles between, of those at centres (..., B).

    Decays are exponential, so the logarithm goes smoothly over frequency: it is cubic through four centres, and stays
    between the two about a middle. Where two amplitudes fade into each other, the slower decay wins; over half a third
    of an octave that is little.
    """
    level = np.log(np.maximum(energy, _SILENT))
    out = np.repeat(level, 2, axis=-1)[..., :-1]
    if level.shape[-1] > 1:
        before, after = level[..., :-1], level[..., 1:]
        ends = 2.0 * level[..., :1] - level[..., 1:2], 2.0 * level[..., -1:] - level[..., -2:-1]
        outer = np.concatenate([ends[0], level[..., :-2]], axis=-1) + np.concatenate([level[..., 2:], ends[1]], axis=-1)
        middle = (9.0 * (before + after) - outer) / 16.0
        out[..., 1::2] = np.clip(middle, np.minimum(before, after), np.maximum(before, after))
    return np.asarray(np.exp(out))
