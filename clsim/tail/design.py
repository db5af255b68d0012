"""The tail of a source: how much energy arrives when, in which band and from where, beyond what images hold."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Floats
from clsim.errors import InputError
from clsim.numerics.sphere import fibonacci_sphere
from clsim.paths.family import SPECULAR
from clsim.paths.path_set import PathSet
from clsim.paths.response import covered
from clsim.scene.directivity.patterns import Omni
from clsim.scene.room.protocol import Room
from clsim.scene.scene import Scene
from clsim.tail.device_rays import ray_engine
from clsim.tail.host_rays import FLOOR
from clsim.tail.ray_room import ANGLES, WallEnergies, has_free_edges, ray_room
from clsim.tail.rays import OF_TIME, STEP, Emitted, Received, Spheres, Tracer, volume_within
from clsim.tail.zones import Zones, traced_bands

Damping = Callable[[Floats, int], Floats]

SCATTERINGS = ("size", "material")
MOST_ESCAPED = 0.5  # share of energy that may leave a room with a tail
LITTLE_ESCAPED = 1e-3  # share of which nothing is said
ULTRASOUND = 40e3  # Hz, from which on images hold what is heard
DEPARTURES = 32  # directions of departure that are told apart


@dataclass(frozen=True, eq=False)
class TailEnergy:
    """Energy of a tail from one zone to another, by time, direction of arrival and band."""

    # Energies are those of the received over those of what was emitted, Pa² s / (Pa² s).
    early: NDArray[np.float32]  # (T0, M, B) of the zone itself
    late: NDArray[np.float32]  # (T1, M, B) after that; zones in which it is alike share it
    departed: Floats  # (Q,) shares of it by direction of departure
    images: Floats  # (T, B) what images hold beside it, likewise

    def __len__(self) -> int:
        return len(self.early) + len(self.late)

    @property
    def energy(self) -> NDArray[np.float32]:
        """All of it (T, M, B), made at every call."""
        return np.concatenate([self.early, self.late])

    @property
    def by_band(self) -> Floats:
        """Sums (B,)."""
        return np.asarray(sum(part.sum(axis=(0, 1), dtype=np.float64) for part in (self.early, self.late)))


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
    escapes: str = ""  # how much energy leaves the room, and where; empty where next to nothing does

    @property
    def duration(self) -> float:
        """Time after which the tail is negligible, s."""
        return max(map(len, self.pairs.values())) * self.time_step

    @property
    def left_db(self) -> float:
        """Energy of the tail over that of tail and images together, in the band where it is most, dB; -inf for none."""
        shares = []
        for pair in self.pairs.values():
            tail, images = pair.by_band, pair.images.sum(axis=0)
            shares.append(float((tail / np.maximum(tail + images, 1e-300)).max()))
        return 10.0 * math.log10(max(shares)) if max(shares) > 0.0 else -math.inf

    def digest(self) -> str:
        """Return a text that changes with any of it."""
        found = hashlib.sha256(repr((self.time_step, self.seed, sorted(self.pairs))).encode())
        for key in sorted(self.pairs):
            pair = self.pairs[key]
            of_pair = pair.early, pair.late, pair.departed
            for part in (*of_pair, self.centres, self.zones.poses, self.receiver_zones.poses):
                found.update(np.ascontiguousarray(part).tobytes())
        return found.hexdigest()

    def describe(self) -> str:
        """Describe it in a line."""
        return (
            f"{self.duration:.3g} s in {len(self.centres)} bands from {self.centres[0]:.4g} to {self.centres[-1]:.4g} "
            f"Hz, {len(self.arrivals)} directions, {len(self.zones)} x {len(self.receiver_zones)} zones; "
            f"{self.rays} rays, energies in 20 ms within {self.error_db:.2f} dB"
            + (f"; {self.escapes}" if self.escapes else "")
        )


@dataclass(frozen=True, slots=True)
class TailOptions:
    """Options of the search for a tail."""

    max_order: int  # of the images beside it
    directions: int = 64  # from which it arrives
    error_db: float = 0.25  # standard error of its energies that is asked for, dB
    seed: int = 0  # of rays and noise
    scattering: str = SCATTERINGS[0]  # "size": walls scatter by their limited size as well
    device: str | None = None  # on which rays are traced


class NoTailError(InputError):
    """A room has no tail, for most of the energy escapes from it."""


def find_tail(
    scene: Scene, source: int, band: tuple[float, float], zones: tuple[Zones, Zones], options: TailOptions,
    progress: Callable[[float], None] | None = None,
) -> SourceTail:  # fmt: skip
    """Return the tail of a source by rays; band (low, high) Hz."""
    of_source, of_receivers = zones
    centres = traced_bands(scene, *band)
    c = scene.air.speed_of_sound
    energies = WallEnergies.of(scene, centres)
    sized = options.scattering == "size" and has_free_edges(scene.room)
    room: Any = scene.room
    tracer = Tracer(
        ray_room(room), energies, ray_engine(options.device), c, options.max_order, (options.seed, source),
        c / centres if sized else None, isinstance(scene.sources[source].directivity, Omni),
    )  # fmt: skip
    arrivals, departures = fibonacci_sphere(options.directions), fibonacci_sphere(DEPARTURES)
    radius = of_receivers.radius
    volumes = np.array([volume_within(room, tuple(centre), radius) for centre in of_receivers.centres.tolist()])
    spheres = Spheres(of_receivers.centres, volumes, radius, arrivals, departures)
    pairs: dict[tuple[int, int], TailEnergy] = {}
    rays, error_db, escapes = 0, 0.0, ""
    decay = _Decay(scene, energies, centres)
    emitted = [_emitted(scene, source, turn, centres) for turn in of_source.turns]
    for place, one in zip(of_source.centres, emitted, strict=True):
        escapes = escapes or _checked_escapes(scene, tracer, place, one)
    done = progress or (lambda share: None)
    for first, parts in tracer.received(of_source.centres, emitted, spheres, options.error_db, done):
        for i, received in enumerate(parts):
            rays, error_db = max(rays, received.rays), max(error_db, received.error_db)
            pairs |= {(i, first + k): pair for k, pair in enumerate(_converged(received, decay))}
    done(1.0)
    return SourceTail(
        centres, STEP, of_source, of_receivers, pairs, arrivals, departures, rays, error_db, options.seed, escapes
    )


def _checked_escapes(scene: Scene, tracer: Tracer, place: Floats, emitted: Emitted) -> str:
    """Describe the energy that escapes from a room that is not closed; refuse a room from which most does."""
    if scene.room.is_closed:
        return ""
    escaped = tracer.escaped(place, emitted)
    given = escaped.describe(scene.room.faces.names)
    if escaped.share > MOST_ESCAPED:
        raise NoTailError(
            "tail", f"must be 'off' in a room from which more than {100.0 * MOST_ESCAPED:.0f} % of the energy escapes, "
            f"but {given}; the mesh is not watertight (`clsim check` lists the places)"
        )  # fmt: skip
    return given if escaped.share > LITTLE_ESCAPED else ""


def searched_order(paths: PathSet) -> int:
    """Return the highest order of images among paths."""
    only_mirrored = np.all((paths.interactions == SPECULAR) | (paths.interactions < 0), axis=1)
    return int(paths.order[only_mirrored].max(initial=0))


def left_by_images(paths: PathSet, sampling_rate: float) -> float | None:
    """Return the energy that images leave at 0 s, relative to all, of the source where it is most, dB, by a few rays.

    None in rooms from which most of the energy escapes.
    """
    scene, most = paths.scene, -np.inf
    receivers = Zones.frozen(scene.receivers, scene.room, 0.0, beams=False)
    requested = TailOptions(searched_order(paths), directions=1, error_db=np.inf)
    for i, source in enumerate(scene.sources):
        low, high = source.emitted.band()
        own = Zones.frozen([source], scene.room, 0.0, beams=True)
        try:
            found = find_tail(scene, i, (low, min(high, 0.5 * sampling_rate)), (own, receivers), requested)
        except NoTailError:
            return None
        most = max(most, found.left_db)
    return float(most)


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


class _Decay:
    """Energy that air leaves over time, and as modes decay: the same for all zones of a source."""

    def __init__(self, scene: Scene, energies: WallEnergies, centres: Floats) -> None:
        self._room, self._energies, self._centres, self._c = scene.room, energies, centres, scene.air.speed_of_sound
        self._air = self._modal = np.empty((0, len(centres)))

    def over(self, count: int) -> tuple[Floats, Floats]:
        """Return the share that air leaves in bins of time (T, B), and that times the share of modes."""
        known = len(self._air)
        if count > known:
            times = STEP * (np.arange(known, -(-count // _AHEAD) * _AHEAD, dtype=np.float64) + 0.5)
            air = np.exp(-np.multiply.outer(self._c * times - 1.0, self._energies.air))
            modal = air * modal_shares(self._room, self._energies, self._centres, times, self._c)
            self._air, self._modal = (np.concatenate(both) for both in ((self._air, air), (self._modal, modal)))
        return self._air[:count], self._modal[:count]


def _converged(received: Received, decay: _Decay) -> list[TailEnergy]:
    """Return energies of all zones in air, as modes decay, smoothed and cut at their audible end."""
    early = received.early.shape[1]
    air, modal = decay.over(received.images.shape[1])
    factor = modal.astype(np.float32)[:, None]
    own, images = received.early * factor[:early], received.images * air
    lates, lasts = [], []
    for row, late in enumerate(received.late):
        mine = received.row == row
        whole = np.concatenate([own[mine].mean(axis=0), late * factor[early:]])
        by_band = whole.sum(axis=1, dtype=np.float64)
        left = np.cumsum(by_band[::-1], axis=0)[::-1]
        total = left[:1] + images[mine].mean(axis=0).sum(axis=0)
        loud = np.flatnonzero((left > FLOOR * total).any(axis=1))
        lasts.append(int(loud[-1]) + 1 if len(loud) else 1)
        lates.append(smoothed(whole[: lasts[-1]])[early:])
    found = []
    for zone, row in enumerate(received.row):
        # Windows of smoothing about the last early bin reach into the late part.
        beyond = math.ceil(_OF_DIRECTIONS * early) + _LEAST + 1
        raw = np.concatenate([own[zone], received.late[row][:beyond] * factor[early : early + beyond]])[: lasts[row]]
        departed = received.departed[zone]
        shares = departed / departed.sum() if departed.any() else np.full(len(departed), 1.0 / len(departed))
        found.append(TailEnergy(smoothed(raw)[:early], lates[row], shares, images[zone]))
    return found


_AHEAD = 256  # bins of time, multiples of which are looked at together
_OF_DIRECTIONS = 0.2  # as `OF_TIME`, for directions, which change more slowly and of which there are many
_LEAST = 2  # bins, half of a window for directions at the beginning


def smoothed(energy: NDArray[Any]) -> NDArray[np.float32]:
    """Return energies (T, M, B) by bin of time, direction and band, smoothed over times that grow with time."""
    # The sum over directions is kept, but for a short window in which it is smoothed; how it is spread over them is
    # taken from a longer one, for it changes slowly.
    total = _smoothed(energy.sum(axis=1, dtype=np.float64), OF_TIME, 0)
    found = np.ascontiguousarray(np.moveaxis(energy, 2, 0), np.float32)
    for of_band, level in zip(found, total.T, strict=True):  # one at a time stays in cache
        spread = _smoothed(of_band, _OF_DIRECTIONS, _LEAST)
        whole = spread.sum(axis=1)
        spread *= (level / np.maximum(whole, 1e-30))[:, None]
        spread += np.where(whole > 0.0, 0.0, level / energy.shape[1])[:, None]
        of_band[:] = spread
    return np.ascontiguousarray(np.moveaxis(found, 0, 2))


def _smoothed(values: NDArray[Any], share: float, least: int) -> Floats:
    """Return means of values (T, ...) over times from `t - w` to `t + w`, w a share of t, cut at both ends alike."""
    count = len(values)
    t: NDArray[np.int64] = np.arange(count)
    half = np.minimum(np.maximum((share * t).astype(np.int64), least), np.minimum(t, count - 1 - t))
    cumulated = np.concatenate([np.zeros((1, *values.shape[1:])), np.cumsum(values, axis=0, dtype=np.float64)])
    length = (2 * half + 1).reshape(-1, *[1] * (values.ndim - 1))
    return np.asarray((cumulated[t + half + 1] - cumulated[t - half]) / length)


_HIGHEST = 450.0  # Hz, above which decays by rays are within 3 % of coherent ones
_FEWEST, _MOST = 2.0, 1e6  # modes in a band: fewer tell no decay, more are a continuum
_DIRECTIONS = 4096
_RATES = 256  # of decay that are told apart in a band
_STEPS = 32  # of time between times whose decays are worked out
_SQUARE = 1e-9  # by which the cosines of a rectangular room's corners may differ from 0 and 1


def modal_shares(room: Room, energies: WallEnergies, centres: Floats, times: Floats, c: float) -> Floats:
    """Energy of the coherent sum of images over that of rays, (T, B), in the mean over all pairs of places."""
    # Shapes: centres (B,) Hz of thirds of octaves; times (T,) s. c: speed of sound, m/s. It is 1 in rooms that are not
    # rectangular and above 450 Hz, and returns to 1 as energy is scattered.
    shares = np.ones((len(times), len(centres)))
    axes = _axes(room)
    if axes is None:
        return shares
    sizes, walls = axes
    root = (np.arange(ANGLES) + 0.5) / ANGLES
    for band in np.flatnonzero(centres < _HIGHEST):
        centre = float(centres[band])

        def damping(cosines: Floats, axis: int, band: int = int(band)) -> Floats:
            """Exponent `a` of an axis at angles of incidence (n,) and in this band."""
            angle = np.minimum((ANGLES * np.sqrt(cosines)).astype(np.int64), ANGLES - 1)
            back = energies.returned[energies.kind[walls[axis]][:, None], angle, band]
            return np.asarray(-0.25 * np.log(np.maximum(back, 1e-30)).sum(axis=0))

        modal = _modal(sizes, centre, c, times, damping)
        if modal is not None:
            share = energies.scattered[:, :, band] @ root**3 / np.sum(root**3)  # in the mean of diffuse incidence
            per_second = float(0.5 * c * share[energies.kind[walls]].sum(axis=1) @ (0.5 / sizes))
            mirrored = np.exp(-per_second * times)
            shares[:, band] += mirrored * (modal / _continuous(sizes, centre, c, times, damping) - 1.0)
    return shares


def _axes(room: Room) -> tuple[Floats, NDArray[np.int64]] | None:
    """Sizes (3,) m and walls (3, 2) along the axes of a rectangular room; None for any other room."""
    if not room.is_convex or len(room.faces) != 6:
        return None
    cosines = room.faces.normals @ room.faces.normals.T
    opposite = np.argwhere(np.triu(cosines < _SQUARE - 1.0))
    apart = np.abs(cosines) > _SQUARE
    if len(opposite) != 3 or np.count_nonzero(apart) != 12:
        return None
    return -room.faces.offsets[opposite].sum(axis=1), opposite


def _band_weight(frequencies: Floats, centre: float) -> Floats:
    """Share of energy that the tail's band about a centre passes, see `band_shares`."""
    away = np.minimum(np.abs(3.0 * np.log2(frequencies / centre)), 1.0)
    return np.asarray(np.cos(0.5 * np.pi * away) ** 4)


def _modal(sizes: Floats, centre: float, c: float, times: Floats, damping: Damping) -> Floats | None:
    """Energy (T,) of the modes in a band, 1 for each at time 0; None for too few, or too many to count."""
    from scipy.special import wofz

    most = 2.0 * centre * 2.0 ** (1.0 / 3.0) / c * sizes  # half waves in each size
    if np.prod(most) > _MOST:
        return None
    numbers = np.stack(np.meshgrid(*(np.arange(int(m) + 1) for m in most), indexing="ij"), axis=-1).reshape(-1, 3)[1:]
    waves = np.pi * numbers / sizes  # wave numbers, 1/m
    k = np.linalg.norm(waves, axis=1)
    weight = _band_weight(k * c / (2.0 * np.pi), centre)
    if weight.sum() < _FEWEST:
        return None
    cosines = waves / k[:, None]
    rates = _decay_rates(cosines, sizes, c, damping)
    middle = 2.0 * np.pi * centre / c
    along = [
        np.abs(wofz(1j * damping(np.zeros(1), i)[0] * np.sqrt(0.5j * c * times / middle) / sizes[i])) ** 2
        for i in range(3)
    ]
    total = np.zeros(len(times))
    for still in product((False, True), repeat=3):
        mine = np.all((numbers == 0) == still, axis=1)
        if mine.any():
            slow = np.prod([along[i] for i in range(3) if still[i]], axis=0)
            total += slow * _decay(rates[mine], weight[mine], times)
    return total


def _continuous(sizes: Floats, centre: float, c: float, times: Floats, damping: Damping) -> Floats:
    """Energy (T,) of as many modes as the volume holds, in all directions alike, as rays are."""
    frequencies = centre * np.linspace(2.0 ** (-1.0 / 3.0), 2.0 ** (1.0 / 3.0), 401)
    density = 4.0 * np.pi * np.prod(sizes) * frequencies**2 / c**3
    count = np.trapezoid(density * _band_weight(frequencies, centre), frequencies)
    rates = _decay_rates(np.abs(fibonacci_sphere(_DIRECTIONS)), sizes, c, damping)
    return _decay(rates, np.full(_DIRECTIONS, count / _DIRECTIONS), times)


def _decay_rates(cosines: Floats, sizes: Floats, c: float, damping: Damping) -> Floats:
    """Rates (n,) in 1/s by which the energy in directions (n, 3) decays."""
    return np.asarray(sum(2.0 * c * cosines[:, i] * damping(cosines[:, i], i) / sizes[i] for i in range(3)))


def _decay(rates: Floats, weights: Floats, times: Floats) -> Floats:
    """Sum (T,) of weights (n,) that decay by rates (n,), at evenly spaced times."""
    edges = np.linspace(rates.min(), rates.max() * (1.0 + 1e-12) + 1e-12, _RATES + 1)
    weight, _ = np.histogram(rates, edges, weights=weights)
    rate, _ = np.histogram(rates, edges, weights=weights * rates)
    some = weight > 0.0
    mean = rate[some] / weight[some]
    # Exponentials of sums are products: of times some steps apart, and of few steps.
    apart, near = times[::_STEPS], times[:_STEPS] - times[0]
    made = (np.exp(-np.multiply.outer(apart, mean)) * weight[some]) @ np.exp(-np.multiply.outer(near, mean)).T
    return np.asarray(made.ravel()[: len(times)])
