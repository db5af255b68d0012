"""Rays from one place of a source: how long they are followed, how many they are, and what energies they bring."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Floats
from clsim.numerics.quaternions import normalised, rotate
from clsim.numerics.sphere import fibonacci_sphere
from clsim.tail.host_rays import FLOOR
from clsim.tail.ray_room import ESCAPE_SCALE, SLOTS, Layout, RayEngine, RayRoom, RayRun, WallEnergies

Emitted = Callable[[Floats], Floats]
Ints = NDArray[np.int64]

STEP = 1e-3  # s, bins of time
WINDOW = 0.02  # s, in which energies are compared between slots
RAIN = 0.1  # s, up to which zones are told apart and scattered energy reaches them directly
MOST_RAYS = 131_072  # from one place
_PILOT = 12  # rays of a slot that find out how long it takes
_FIRST, _LEAST = 512, 64  # rays of a slot at first, over the groups of bands, and at least
_LARGEST = 1024  # rays of a slot at a time
_GROWTH = 4.0  # of their number at most before the error is looked at again
_LONGEST = 10.0  # s
OF_TIME = 0.03  # half of the time over which energies are smoothed, over the time itself
_DEPTH = 10.0**-3.5  # of the loudest window's energy, down to which the error is told: where T30 ends
_ALIKE = 10.0**0.1  # late energies of zones that share them: 1 dB
_WHOLE = 2.0**34  # the largest contribution as a whole number
_POINTS = 1024  # by which the volume of a sphere inside the room is measured
_BYTES = 2**28  # of energies on a device at a time


@dataclass(frozen=True, slots=True, eq=False)
class Received:
    """Energies in zones, of sources of 1 Pa at 1 m for 1 s, without the absorption of the air."""

    early: Floats  # (Z, T0, M, B) by bin of time, direction of arrival and band
    late: Floats  # (rows, T - T0, M, B) the same after `RAIN`, in the mean over the zones of a row
    images: Floats  # (Z, T, B) what images hold
    departed: Floats  # (Z, Q) by direction of departure
    row: Ints  # (Z,) row of each zone
    rays: int
    error_db: float


@dataclass(frozen=True, slots=True, eq=False)
class Escaped:
    """Energy that leaves a room through its openings."""

    share: float  # of what is emitted, in the band where it is most, the air's absorption aside
    places: Floats  # (n, 3) some of the places where it does, m
    walls: Ints  # walls from which most of it comes

    def describe(self, names: tuple[str, ...]) -> str:
        """Say how much leaves, and where."""
        near = "; ".join("(" + ", ".join(f"{x:.2f}" for x in place) + ")" for place in self.places[:3])
        last = ", ".join(repr(names[wall]) for wall in self.walls[:3])
        return (
            f"{100.0 * self.share:.2g} % of the energy escapes"
            + (f", near {near} m" if near else "")
            + (f", last reflected by {last}" if last else "")
        )


@dataclass(frozen=True, slots=True, eq=False)
class Spheres:
    """Zones of receivers as rays see them."""

    centres: Floats  # (Z, 3) m
    volumes: Floats  # (Z,) of their parts inside the room, m³
    radius: float  # m
    arrivals: Floats  # (M, 3) directions among which energy is shared
    departures: Floats  # (Q, 3) likewise those in which it left the source


@dataclass(frozen=True, eq=False)
class Tracer:
    """A room in which rays are traced from places of one source."""

    room: RayRoom
    energies: WallEnergies
    engine: RayEngine
    speed_of_sound: float
    max_order: int  # of images: energy that was only mirrored, so often at most, is theirs
    seed: tuple[int, int]  # of rays, and the source
    sized: NDArray[np.float64] | None = None  # wavelengths (B,) of bands, m, where walls scatter by their size
    even: bool = False  # whether the source emits the same in all bands

    @cached_property
    def groups(self) -> list[Ints]:
        """Bands that share rays: they scatter alike, and by size those of one octave do."""
        alike = self.energies.groups()
        if self.sized is None:
            return alike
        octave = np.rint(np.log2(self.speed_of_sound / self.sized / 1000.0))
        return [group[octave[group] == one] for group in alike for one in np.unique(octave[group])]

    def received(
        self, origins: Floats, emitted: Sequence[Emitted], spheres: Spheres, error_db: float,
        progress: Callable[[float], None],
    ) -> Iterator[tuple[int, list[Received]]]:  # fmt: skip
        """Yield the first sphere of each part that fits the memory, and the energies of the source's zones there."""
        pilots = [
            self._pilot(origin, one, spheres, zone)
            for zone, (origin, one) in enumerate(zip(origins, emitted, strict=True))
        ]
        untils = [self._until(pilot) for pilot in pilots]
        late = np.mean([late_shares(pilot) for pilot in pilots], axis=0)
        bins = math.ceil(float(np.max(untils)) / (STEP * self.speed_of_sound))
        bytes_each = 8.0 * len(self.energies.air) * (len(spheres.arrivals) * min(bins, RAIN / STEP) + bins)
        step, count = max(1, int(_BYTES / bytes_each)), len(spheres.centres)
        for i in range(0, count, step):
            part = slice(i, i + step)
            some = replace(spheres, centres=spheres.centres[part], volumes=spheres.volumes[part])
            layout = self._of_part(some, late[part], float(np.max(untils)))
            searches = [
                _Search(self, origin, one, some, zone, until, layout)
                for zone, (origin, one, until) in enumerate(zip(origins, emitted, untils, strict=True))
            ]
            shared: list[list[_Search]] = []
            for k, search in enumerate(searches):
                search.begin(shared)
                progress((i + step * (k + 1) / (len(searches) + 1)) / (count + step))
            while sum(search.refine(error_db) for search in searches):  # each in turn: what it finds serves others
                pass
            yield i, [search.found() for search in searches]

    def _pilot(self, origin: Floats, emitted: Emitted, spheres: Spheres, zone: int) -> Floats:
        """Return energies (Z, windows, B) by few rays."""
        windows = math.ceil(_LONGEST / WINDOW)
        layout = self._layout(spheres, np.zeros(len(spheres.centres), np.int64), 1, 0, windows)
        energies, longest = layout.empty(), np.full(len(self.groups), _LONGEST * self.speed_of_sound)
        self.engine.trace(self._run(origin, emitted, spheres, zone, _PILOT, longest, 0), layout, energies)
        return np.asarray(energies.windows.sum(axis=0).astype(np.float64).take(self.carried[1], axis=-1))

    def _of_part(self, spheres: Spheres, late: Floats, until: float) -> Layout:
        """Return the layout of some spheres, of late energies (Z,), up to a way, m."""
        bins, windows = (math.ceil(until / (step * self.speed_of_sound)) for step in (STEP, WINDOW))
        return self._layout(spheres, *rows_of(late), bins, windows)

    def _until(self, windows: Floats) -> Floats:
        """Return the way (G,), m, after which little is left of energies (Z, windows, B) in a group's bands."""
        times = WINDOW * (np.arange(windows.shape[1]) + 0.5)
        energy = windows.sum(axis=0) * np.exp(-np.multiply.outer(times, self.speed_of_sound * self.energies.air))
        left = np.cumsum(energy[::-1], axis=0)[::-1]
        loud = [(left[:, group] > FLOOR * left[:1, group]).any(axis=1) for group in self.groups]
        last = [int(np.flatnonzero(one).max(initial=0)) for one in loud]
        return np.asarray((np.array(last) + 2.0) * WINDOW * self.speed_of_sound)

    def escaped(self, origin: Floats, emitted: Emitted, rays: int = 1024) -> Escaped:
        """Return the energy that escapes of what is emitted at a place, m, by some rays."""
        sphere = Spheres(np.asarray(origin)[None], np.ones(1), 1e-3, np.eye(3)[:1], np.eye(3)[:1])
        layout = self._layout(sphere, np.zeros(1, np.int64), 1, 0, 0)
        until = np.full(len(self.groups), _LONGEST * self.speed_of_sound)
        run, energies = self._run(origin, emitted, sphere, 0, rays // SLOTS, until, 0), layout.empty()
        self.engine.trace(run, layout, energies)
        by_wall = energies.escaped / ESCAPE_SCALE
        emitted_energy = run.emitted.astype(np.float64).sum(axis=0)
        share = float((by_wall.sum(axis=0) / emitted_energy).max())
        of_walls = by_wall[:-1].sum(axis=1)
        loud = np.argsort(-of_walls, kind="stable")
        return Escaped(share, self._exits(energies.places), loud[of_walls[loud] > 0.05 * of_walls.sum()])

    def _exits(self, places: Floats) -> Floats:
        """Return places (n, 3) at which rays (n, 6) leave the box about the room, m."""
        size = np.abs(self.room.leaves[:, :9]).reshape(-1, 3, 3, 8).max(axis=(0, 1, 3)) if len(places) else np.ones(3)
        start, direction = places[:, :3], places[:, 3:]
        with np.errstate(divide="ignore", invalid="ignore"):
            far = np.where(direction == 0.0, np.inf, (np.copysign(size, direction) - start) / direction).min(
                axis=1, initial=np.inf
            )
        return np.asarray(
            start + np.where(np.isfinite(far), np.maximum(far, 0.0), 0.0)[:, None] * direction + self.room.middle
        )

    @cached_property
    def carried(self) -> tuple[list[Ints], Ints]:
        """Bands whose energies rays carry, group by group, and the place (B,) of every band's energy among them."""
        # Of bands that source and walls send alike, one is carried for all: walls of one absorption need a single one.
        bands, place, count = [], np.empty(len(self.energies.air), np.int64), 0
        for group in self.groups:
            columns = self.energies.returned[:, :, group].reshape(-1, len(group)) if self.even else np.eye(len(group))
            _, first, which = np.unique(columns, axis=1, return_index=True, return_inverse=True)
            own, which = np.unique(first[which.ravel()], return_inverse=True)
            bands.append(group[own])
            place[group] = count + which
            count += len(own)
        return bands, place

    def _layout(self, spheres: Spheres, row: Ints, rows: int, bins: int, windows: int) -> Layout:
        c = self.speed_of_sound
        zones = np.column_stack([spheres.centres - self.room.middle, 1.0 / spheres.volumes]).astype(np.float32)
        most = max(2.0 * spheres.radius * float((1.0 / spheres.volumes).max()), 1.0 / (np.pi * spheres.radius**2))
        return Layout(
            zones, spheres.radius, row.astype(np.int32), rows,
            np.pad(spheres.arrivals, ((0, 0), (0, 1))).astype(np.float32), len(spheres.departures), STEP * c,
            WINDOW * c, bins, min(bins, round(RAIN / STEP)), windows, RAIN * c, _WHOLE / most,
            sum(map(len, self.carried[0])), len(self.room.plane),
        )  # fmt: skip

    def _run(
        self, origin: Floats, emitted: Emitted, spheres: Spheres, zone: int, each: int, until: Floats, first_ray: int
    ) -> RayRun:
        """Return rays in even directions, turned at random in each of the slots."""
        rng = np.random.default_rng([*self.seed, zone, first_ray])
        even = fibonacci_sphere(each)
        turned = np.stack([rotate(normalised(rng.standard_normal((1, 4))), even) for _ in range(SLOTS)], axis=1)
        directions = turned.reshape(-1, 3)
        groups, tables = self.groups, self.energies
        order = np.concatenate(self.carried[0])
        ends = np.cumsum([0, *map(len, self.carried[0])])
        one_of_each = [group[0] for group in groups]
        wavelength = np.zeros(len(groups))
        if self.sized is not None:
            wavelength = np.exp([np.log(self.sized[group]).mean() for group in groups])
        return RayRun(
            self.room, self.sized is not None, tables.kind.astype(np.int32),
            tables.returned[:, :, order].astype(np.float32), tables.scattered[:, :, one_of_each].astype(np.float32),
            ends.astype(np.int32), wavelength.astype(np.float32), until.astype(np.float32), self.max_order,
            (np.asarray(origin) - self.room.middle).astype(np.float32), directions.astype(np.float32),
            np.ascontiguousarray(emitted(directions)[:, order], np.float32),
            (directions @ spheres.departures.T).argmax(axis=1).astype(np.int32), first_ray, zone,
            (self.seed[0] % 2**32, self.seed[1] % 2**32),
        )  # fmt: skip


def late_shares(windows: Floats) -> Floats:
    """Return late energies (Z,) over their means in bands, of energies (Z, windows, B)."""
    late = windows[:, round(RAIN / WINDOW) :].sum(axis=1)
    return np.asarray((late / np.maximum(late.mean(axis=0), 1e-300)).mean(axis=1))


def rows_of(late: Floats) -> tuple[Ints, int]:
    """Return the row (Z,) of zones whose late energies (Z,) differ by less than 1 dB, and the number of rows."""
    row, count, first = np.zeros(len(late), np.int64), 0, -1.0
    for zone in np.argsort(late, kind="stable"):
        if count == 0 or late[zone] > _ALIKE * first:
            first, count = float(late[zone]), count + 1
        row[zone] = count - 1
    return row, count


class _Search:
    """Rays from one zone of the source until energies are known as well as asked for."""

    # Late energies are means over all zones of the source in which they are alike, as they are over zones of receivers:
    # few rays, of slow decay, bring most of them, and no zone has enough of these by itself.
    def __init__(
        self, tracer: Tracer, origin: Floats, emitted: Emitted, spheres: Spheres, zone: int, until: Floats,
        layout: Layout,
    ) -> None:  # fmt: skip
        self._tracer, self._origin, self._emitted, self._zone, self._until = tracer, origin, emitted, zone, until
        self._spheres, self._layout, self._row = spheres, layout, layout.late_row.astype(np.int64)
        self._energies = layout.empty()
        self._rays, self._error = 0, 0.0
        self._shared = [self]

    def begin(self, shared: list[list[_Search]]) -> None:
        """Trace the first rays, and share late energies with a search whose ones are alike, or with later ones."""
        self._trace(max(_FIRST // len(self._until), _LEAST))
        mine = self._late()
        for others in shared:
            ratio = np.divide(mine, others[0]._late(), out=np.ones(len(mine)), where=mine > 0.0)
            if np.all((ratio < _ALIKE) & (ratio > 1.0 / _ALIKE)):
                others[0]._energies.late += self._energies.late
                self._energies.late = others[0]._energies.late
                others.append(self)
                self._shared = others
                return
        shared.append(self._shared)

    def _late(self) -> Floats:
        """Return the late energies (rows,) of a ray."""
        late = self._energies.windows[:, :, round(RAIN / WINDOW) :].sum(axis=(0, 2, 3)) / self._rays
        return np.asarray(np.bincount(self._row, late, self._layout.rows), np.float64)

    def refine(self, wanted_db: float) -> bool:
        """Trace more rays and return True, if the error is larger than is asked for and rays are not very many."""
        self._error = self._error_db()
        if self._error <= wanted_db or self._rays >= MOST_RAYS:
            return False
        most = min(1.1 * (self._error / wanted_db) ** 2, _GROWTH) * self._rays
        missing = min(most, MOST_RAYS) - self._rays
        self._trace(min(max(math.ceil(missing / SLOTS), _LEAST // 4), _LARGEST))
        return True

    def _trace(self, each: int) -> None:
        run = self._tracer._run(
            self._origin, self._emitted, self._spheres, self._zone, each, self._until, _PILOT * SLOTS + self._rays
        )
        self._tracer.engine.trace(run, self._layout, self._energies)
        self._rays += each * SLOTS

    def _error_db(self) -> float:
        """Return the standard error of what is loud, dB; late energies are means over zones of a row, and smoothed."""
        slots = self._energies.windows.astype(np.float64)
        early = round(RAIN / WINDOW)
        share = self._rays / sum(search._rays for search in self._shared)
        slots[:, :, early:] = share * sum(search._energies.windows[:, :, early:] for search in self._shared)
        slots = slots.take(self._tracer.carried[1], axis=-1)
        found = [slots[:, :, :early]]
        late = smoothed_windows(slots[:, :, early:], early)
        found += [late[:, self._row == row].mean(axis=1, keepdims=True) for row in range(self._layout.rows)]
        squares, counts = [], []
        loudest = slots.mean(axis=0).max(axis=(0, 1))
        for part in found:
            mean, spread = part.mean(axis=0), part.std(axis=0, ddof=1) / math.sqrt(SLOTS)
            loud = mean > _DEPTH * loudest
            squares.append(float(np.sum(np.square(spread[loud] / mean[loud]))))
            counts.append(int(np.count_nonzero(loud)))
        # Zones that share what comes late must not have what comes first less well known for it.
        errors = [squares[0] / max(counts[0], 1), sum(squares) / max(sum(counts), 1)]
        return 10.0 / math.log(10.0) * math.sqrt(max(errors))

    def found(self) -> Received:
        """Return the energies."""
        energies, place = self._energies, self._tracer.carried[1]
        zones = np.bincount(self._row, minlength=self._layout.rows)
        unit = 4.0 * np.pi / (self._layout.scale * self._rays)  # energy of a whole number
        of_late = unit * self._rays / sum(search._rays for search in self._shared)
        early: Any = (energies.early * unit).astype(np.float32).take(place, axis=-1)
        late: Any = (energies.late * (of_late / zones)[:, None, None, None]).astype(np.float32).take(place, axis=-1)
        images: Any = (energies.images * unit).take(place, axis=-1)
        departed = np.asarray(energies.departures * unit, np.float64)
        return Received(early, late, images, departed, self._row, self._rays, self._error)


def smoothed_windows(energy: Floats, first: int) -> Floats:
    """Average energies (S, Z, W, B) in windows over `OF_TIME` to either side; `first` windows came before them."""
    ends = np.arange(energy.shape[2] + 1)
    middle = ends[:-1] + 0.5
    half = np.maximum(OF_TIME * (middle + first), 0.5)[:, None]
    within = np.minimum(middle[:, None] + half, ends[1:]) - np.maximum(middle[:, None] - half, ends[:-1])
    share = np.maximum(within, 0.0)
    return np.asarray(np.einsum("vw,szwb->szvb", share / share.sum(axis=1, keepdims=True), energy, optimize=True))


@lru_cache(maxsize=4096)
def volume_within(room: Any, centre: tuple[float, ...], radius: float) -> float:
    """Return the volume of a sphere's part inside a room, m³; all of it where the room is not closed."""
    whole = 4.0 / 3.0 * np.pi * radius**3
    if not room.is_closed:
        return whole
    height = ((np.arange(_POINTS) * 0.754877666) % 1.0) ** (1.0 / 3.0)  # of a low-discrepancy sequence
    points = np.array(centre) + radius * height[:, None] * fibonacci_sphere(_POINTS)
    return whole * max(float(np.mean(room.contains(points))), 1.0 / _POINTS)
