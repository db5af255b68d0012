"""Zones of places that share a tail, its bands, and energies in a diffuse field."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Floats
from clsim.numerics.quaternions import rotate
from clsim.scene.directivity.patterns import Omni
from clsim.scene.ends import End, Receiver
from clsim.scene.motion.motion import Motion
from clsim.scene.room.protocol import Room
from clsim.scene.room.shoebox import enclosure_of
from clsim.scene.scene import Scene

_LOWEST = 31.25  # Hz, of a band's centre
TOGETHER = 16  # streams that are made at a time: as many as fill vectors of transforms and stay in cache
_SILENT = 1e-30  # energy, whose logarithm is still a number
_BENT = 0.015  # of the rate of decay in a middle between thirds, by which interpolation may miss it
_STEEP = 0.12  # difference of decay times of neighbours, above which there are bands between them: 0.3 dB in 35 dB
_DECAYED = 1e-3  # of the energy, that is left after a decay time


def band_centres(low: float, high: float) -> Floats:
    """Return centres (B,) of thirds of octaves that hold a band, Hz."""
    low = max(low, _LOWEST)
    high = max(high, low)
    first, last = (round(3.0 * math.log2(f / 1000.0)) for f in (low, high))
    return np.asarray(1000.0 * 2.0 ** (np.arange(first, last + 1) / 3.0))


def traced_bands(scene: Scene, low: float, high: float) -> Floats:
    """Centres (B,) of bands in which rays are traced, Hz."""
    # They are thirds of octaves, and the middles between them where the walls' absorption bends so much that the rate
    # of decay of a diffuse field there is not what `at_middles` makes of its neighbours.
    thirds = band_centres(low, high)
    both = with_middles(thirds)
    field = DiffuseField.of(scene, both)
    if field is None or len(thirds) < 2:
        return thirds
    kept = np.maximum(1.0 - field.absorption_area / field.surface, _SILENT)
    rate = 4.0 * field.air * field.volume / field.surface - np.log(kept)
    guessed = -np.log(at_middles(np.exp(-rate[::2])))
    traced = np.abs(guessed - rate) > _BENT * rate
    traced[::2] = True
    return both[traced]


def band_shares(frequencies: NDArray[Any], centres: Floats) -> Floats:
    """Return the amplitude (B, F) of each band's part at frequencies (F,), Hz: together 1 everywhere."""
    # At a centre a band is alone; between two of them one fades into the other over the logarithm of frequency, so that
    # the amplitude of noise shaped in bands goes smoothly from one centre's to the next; it is held beyond the ends.
    at = np.interp(np.log(np.maximum(frequencies, 1e-3)), np.log(centres), np.arange(len(centres), dtype=np.float64))
    away = np.abs(at - np.arange(len(centres))[:, None])
    return np.asarray(np.where(away < 1.0, np.cos(0.5 * np.pi * np.minimum(away, 1.0)) ** 2, 0.0))


def with_middles(centres: Floats) -> Floats:
    """Return the centres (2B - 1,) of bands and the geometric middles between them, Hz."""
    return np.exp(np.interp(np.arange(2 * len(centres) - 1) / 2.0, np.arange(len(centres)), np.log(centres)))


def at_middles(energy: NDArray[Any]) -> Floats:
    """Return energies (..., 2B - 1) at the centres of bands and the middles between, of those at centres (..., B)."""
    # Decays are exponential, so the logarithm goes smoothly over frequency: it is cubic through four centres, and stays
    # between the two about a middle. Where two amplitudes fade into each other, the slower decay wins; over half a
    # third of an octave that is little.
    level = np.log(np.maximum(energy, _SILENT))
    out = np.repeat(level, 2, axis=-1)[..., :-1]
    if level.shape[-1] > 1:
        before, after = level[..., :-1], level[..., 1:]
        ends = 2.0 * level[..., :1] - level[..., 1:2], 2.0 * level[..., -1:] - level[..., -2:-1]
        outer = np.concatenate([ends[0], level[..., :-2]], axis=-1) + np.concatenate([level[..., 2:], ends[1]], axis=-1)
        middle = (9.0 * (before + after) - outer) / 16.0
        out[..., 1::2] = np.clip(middle, np.minimum(before, after), np.maximum(before, after))
    return np.asarray(np.exp(out))


def joined_bands(centres: Floats, energy: NDArray[Any]) -> tuple[Floats, Iterator[NDArray[Any]]]:
    """Return the bands (J,) in Hz in which noise is shaped, and the energies (T, k, J) of `TOGETHER` streams at a time.

    The bands are those of rays, the middles between thirds, and those between sixths in which all streams together,
    `energy` (T, K, B), decay differently.
    """
    is_third = np.isclose(3.0 * np.log2(centres / 1000.0) % 1.0, [[0.0], [1.0]], atol=1e-6).any(axis=0)
    sixths = with_middles(centres[is_third])
    traced = np.isclose(sixths[:, None], centres, rtol=1e-6).any(axis=1)

    def in_sixths(energy: NDArray[Any]) -> Floats:
        found = at_middles(energy[..., is_third])
        found[..., traced] = energy
        return found

    parts = [in_sixths(energy[:, k : k + TOGETHER]) for k in range(0, energy.shape[1], TOGETHER)]
    total = np.asarray(sum(part.sum(axis=1) for part in parts))
    left = np.cumsum(total[::-1], axis=0)[::-1]
    times = np.maximum(np.count_nonzero(left > _DECAYED * left[:1], axis=0), 1)
    steep = np.abs(np.diff(np.log(times))) > _STEEP  # decay times of neighbours differ
    if not steep.any():
        return sixths, iter(parts)
    kept = np.ones(2 * len(sixths) - 1, np.bool_)
    kept[1::2] = steep
    return with_middles(sixths)[kept], (at_middles(part)[..., kept] for part in parts)


_ANGLES = 32  # over which absorption is averaged


@dataclass(frozen=True, slots=True, eq=False)
class DiffuseField:
    """A closed room in which energy arrives from all directions alike, at F frequencies."""

    volume: float  # m³
    surface: float  # m²
    absorption_area: Floats  # (F,) m²
    scattered: Floats  # (F,) share of what is reflected that leaves the mirror's direction
    air: Floats  # (F,) absorption of energy, 1/m

    @classmethod
    def of(cls, scene: Scene, frequencies: Floats) -> DiffuseField | None:
        """Average a scene's walls over angles of incidence; None in a room that is not closed."""
        volume, area, materials = enclosure_of(scene.room)
        if volume is None:
            return None
        c, surface = scene.air.speed_of_sound, float(area.sum())
        # Gauss's rule over the squared sine of the angle of incidence, as which a diffuse field is spread.
        places, weights = np.polynomial.legendre.leggauss(_ANGLES)
        cosine, weights = np.sqrt(0.5 * (1.0 - places))[:, None], 0.5 * weights
        absorbed, scattered = np.zeros((2, len(frequencies)))
        for material in dict.fromkeys(materials):
            mine = float(area[[m is material for m in materials]].sum())
            at = np.clip(frequencies, *material.band)
            shape = len(cosine), len(frequencies)
            met = cosine if material.depends_on_angle else 1.0
            absorbed += mine * (weights @ np.broadcast_to(1.0 - material.energy_at(at, met, c), shape))
            scattered += mine / surface * (weights @ np.broadcast_to(material.scattered_share(at, cosine, c), shape))
        air = scene.air.absorption_at(frequencies) * (math.log(10.0) / 10.0)
        return cls(volume, surface, absorbed, scattered, air)

    def left_db(self, max_order: int) -> Floats:
        """Energy that images up to an order leave, dB re all but the direct sound's (F,): a geometric series."""
        path = 4.0 * self.volume / self.surface
        kept = (1.0 - np.minimum(self.absorption_area / self.surface, 1.0)) * np.exp(-self.air * path)
        mirrored = kept * (1.0 - self.scattered)
        with np.errstate(divide="ignore", invalid="ignore"):
            of_images = (1.0 - mirrored**max_order) * mirrored / (1.0 - mirrored)
            left = 1.0 - of_images * (1.0 - kept) / kept
        return np.asarray(10.0 * np.log10(np.clip(np.nan_to_num(left), 1e-30, 1.0)))


_OF_FREE_PATH = 0.25  # a zone's radius over the mean free path of rays
_LEAST, _MOST = 0.1, 4.0  # m, of the radius
_REACH = 1.5  # radii within which a zone is heard
_ANGLE = math.radians(30.0)  # by which a beam turns within a zone
_RATE, _MOST_TIMES = 50.0, 200_000  # Hz, and instants at which ways are looked at


@dataclass(frozen=True, eq=False)
class Zones:
    """Zones along the trajectories of some ends."""

    radius: float  # m
    poses: Floats  # (Z, 3) their middles over the radius, and, where beams turn, two axes over 30 degrees
    beams: bool  # whether beams turn
    turns: Floats  # (Z, 4) orientation in the middle, unit quaternions

    def __len__(self) -> int:
        return len(self.poses)

    @property
    def centres(self) -> Floats:
        """Middles (Z, 3), m."""
        return np.asarray(self.poses[:, :3] * self.radius)

    @property
    def reach(self) -> float:
        """Radius of a zone about its middle, m."""
        return _REACH * self.radius

    @classmethod
    def along(cls, ends: Sequence[End], room: Room, until: float, *, beams: bool) -> Zones:
        """Return zones that cover the trajectories of ends from 0 s to a time, s; with `beams`, turning counts too."""
        return cls._covering([(end, _instants(end, until)) for end in ends], room, beams=beams)

    @classmethod
    def frozen(cls, ends: Sequence[End], room: Room, at: float, *, beams: bool) -> Zones:
        """Return zones that hold ends as they are at a time, s."""
        return cls._covering([(end, np.array([at])) for end in ends], room, beams=beams)

    @classmethod
    def _covering(cls, ends: Sequence[tuple[End, Floats]], room: Room, *, beams: bool) -> Zones:
        """Return zones that hold ends as they are at times (T,), s."""
        radius = zone_radius(room)
        found: list[Floats] = []
        turns: list[Floats] = []
        for end, times in ends:
            turning = beams and not isinstance(end.directivity, Omni)
            poses, orientation = _poses(end, times, radius, turning=turning, beams=beams), end.orientation(times)
            left = np.ones(len(times), np.bool_)
            for centre in found:
                left &= np.linalg.norm(poses - centre, axis=1) > 1.0
            while left.any():
                first = int(left.argmax())
                found.append(poses[first])
                turns.append(orientation[first])
                left &= np.linalg.norm(poses - poses[first], axis=1) > 1.0
        return cls(radius, np.array(found), beams, np.array(turns))

    def weights(self, end: End, times: Floats) -> Floats:
        """Return the shares (Z, T) of amplitude of an end at times (T,), s; their squares add up to 1."""
        # What stands still is in one zone; what moves goes smoothly from one to the next.
        turning = self.beams and not isinstance(end.directivity, Omni)
        if is_static(end, turning=turning):
            pose = _poses(end, np.zeros(1), self.radius, turning=turning, beams=self.beams)[0]
            nearest = np.arange(len(self)) == np.linalg.norm(self.poses - pose, axis=1).argmin()
            return np.asarray(np.repeat(nearest[:, None].astype(np.float64), len(times), axis=1))
        poses = _poses(end, times, self.radius, turning=turning, beams=self.beams)
        square = np.zeros((len(self), len(times)))
        for place, middle in zip(poses.T, self.poses.T, strict=True):
            if place.any() or middle.any():  # axes are all 0 where nothing turns
                square += np.square(place - middle[:, None])
        share = np.maximum(1.0 - np.sqrt(square) / _REACH, 0.0)
        return np.asarray(share / np.sqrt(np.maximum(np.sum(share**2, axis=0), 1e-12)))


@dataclass(frozen=True, eq=False)
class Crossings:
    """Weights of the zones that receivers cross, computed once for all zones of a chunk."""

    zones: Zones
    receivers: Sequence[Receiver]
    sampling_rate: float  # Hz
    last: int  # sample; filters reach beyond both ends of the run, where a trajectory may have ended
    _found: dict[tuple[int, int, int], dict[int, Floats]] = field(init=False, default_factory=dict)

    def clock(self, grid: NDArray[np.int64]) -> Floats:
        """Return the times of samples (N,) within the run, s."""
        return np.clip(grid, 0, self.last) / self.sampling_rate

    def times(self, receiver: int, grid: NDArray[np.int64]) -> Floats:
        """Return the times of samples (N,) by which a receiver moves, s: those of its clock."""
        clock = self.clock(grid)
        return clock + self.receivers[receiver].clock_error(clock)

    def weights(self, receiver: int, grid: NDArray[np.int64]) -> dict[int, Floats]:
        """Return the weights (N,) at samples (N,) of the zones that a receiver crosses, by zone."""
        key = receiver, int(grid[0]), len(grid)
        if key not in self._found:
            weights = self.zones.weights(self.receivers[receiver], self.times(receiver, grid))
            self._found[key] = {zone: weights[zone].copy() for zone in np.flatnonzero(weights.any(axis=1)).tolist()}
        return self._found[key]

    def forget(self) -> None:
        """Drop all weights."""
        self._found.clear()


def zone_radius(room: Room) -> float:
    """Return the radius of zones in a room, m: a quarter of the mean free path, 0.1 to 4 m."""
    # The volume of an open room is that of the box about it.
    low, high = room.extent
    volume = float(np.prod(high - low)) if room.volume is None else room.volume
    return float(np.clip(_OF_FREE_PATH * 4.0 * volume / room.surface_area, _LEAST, _MOST))


def is_static(end: End, *, turning: bool) -> bool:
    """Test whether an end never moves, and never turns where that matters."""
    return end.trajectory.is_static and not (turning and end.trajectory.turns)


def fastest(moved: Motion) -> float:
    """Bound of the speed of a way, m/s."""
    return 0.0 if moved.is_static else float(moved.speed_over(np.array([-1e9]), np.array([1e9]))[0])


def _instants(end: End, until: float) -> Floats:
    last = min(end.trajectory.end, until)
    if (end.trajectory.is_static and not end.trajectory.turns) or not 0.0 < last < math.inf:
        return np.zeros(1)
    return np.linspace(0.0, last, min(math.ceil(last * _RATE) + 1, _MOST_TIMES))


def _poses(end: End, times: Floats, radius: float, *, turning: bool, beams: bool) -> Floats:
    places = end.trajectory.position(times) / radius
    if not beams:
        return np.asarray(places)
    axes = np.zeros((len(times), 6))
    if turning:
        orientation = end.orientation(times)
        size = 1.0 / (2.0 * math.sin(0.5 * _ANGLE))
        axes = size * np.concatenate([rotate(orientation, axis) for axis in np.eye(3)[:2]], axis=1)
    return np.concatenate([places, axes], axis=1)
