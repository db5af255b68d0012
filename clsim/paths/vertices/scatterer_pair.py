"""Two scatterers in a row as vertices: three delay equations, the last one first, and the product of both fields.

The first scatterer sends to the specular point of the second, which is met as if by a source at that of the first.
Either is far enough from the other for its far field.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import permutations, product
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Floats, read_only
from clsim.errors import InputError
from clsim.paths.chain import Chain, check_support
from clsim.paths.family import NONE, SCATTERING, SPECULAR, Columns, Instant, Links, Pair, Rows, ends_at
from clsim.paths.response import Arrivals, Kinematics, SceneResponse
from clsim.paths.search.scatterers import Side, at_receivers, received_after
from clsim.paths.vertices.scatterer import PairEnds, ScattererVertex, centre_of
from clsim.paths.vertices.scatterer_paths import PATIENCE, Body, Leg, leg_between, unseen
from clsim.scene.ends import Receiver, Source
from clsim.scene.scatterer import Scatterer
from clsim.scene.scene import Scene

_ROUNDS, _CLOSE, _CONVERGED = 80, 1e-9, 1e-3  # of finding both; s and rad that end it, as for one scatterer


@dataclass(frozen=True, slots=True, eq=False)
class ScattererPairVertex(ScattererVertex):
    """First and second scatterers (P, 2) that P paths between static legs meet; `nearest` holds for both."""

    kind: ClassVar[str] = "scatterer pair"

    @property
    def on_device(self) -> bool:
        """Whether a program of nodes knows these: none."""
        return False

    def part(self, rows: Rows) -> ScattererPairVertex:
        """Return some of the vertices."""
        return replace(self, scatterer=self.scatterer[rows], nearest=self.nearest[rows])

    @property
    def objects(self) -> NDArray[np.int32]:
        """Number of each first scatterer among the names, (P,)."""
        return self.scatterer[:, 0]

    @property
    def swiftest(self) -> float:
        """Bound of the speeds of both surfaces of a path together, m/s."""
        return 2.0 * float(self.fastest[:, 1].max())

    @property
    def radius(self) -> Floats:
        """Radii (P,) of both together, m."""
        radii = np.array([scatterer.shape.radius for scatterer in self.scatterers])
        return np.asarray(radii[self.scatterer].sum(axis=1))

    def speeds(self, moving: bool) -> Floats:
        """Bounds (P,) of the speeds of both together, m/s."""
        return np.asarray(self.fastest[self.scatterer, int(moving)].sum(axis=1))

    def groups(self) -> list[NDArray[np.int64]]:
        """Vertices that are solved together: those of the same two."""
        return [np.flatnonzero(np.all(self.scatterer == two, axis=1)) for two in np.unique(self.scatterer, axis=0)]

    @property
    def two(self) -> tuple[Scatterer, ...]:
        """The scatterers of vertices that are all of the same two."""
        return tuple(self.scatterers[which] for which in self.scatterer[0].tolist())

    def places(self, links: Links, ends: Pair, times: Floats, kinematics: Kinematics) -> Pair:
        """Points (P, 3), m, where sound that is received at a time (1,) is scattered first and last."""
        found = np.empty((2, len(self), 3))
        for mine in self.groups():
            some = links.part(mine)
            solved = _solved(some, PairEnds(some, times), times, kinematics.retarded)
            found[:, mine] = np.stack(solved.places)[:, :, 0]
        return found[0], found[1]

    def lengths(self, links: Links, ends: Pair, images: Pair, times: Instant) -> Floats:
        """Lengths (P,) by the centres at times, between images of endpoints (P, 3), m."""
        first, second = (ends_at(self.scatterers, which, times) for which in self.scatterer.T)
        legs = images[0] - first, first - second, images[1] - second
        return np.asarray(sum(np.linalg.norm(leg, axis=1) for leg in legs))

    def alike(self) -> list[NDArray[np.int64]]:
        """Vertices whose paths are solved together."""
        return self.groups()

    def _columns(self, kinematics: Kinematics, links: Links, times: Floats) -> Columns:
        """Arrivals (P, T) by two scatterers: the law is that of three points of the wave equation in a row.

        A second of reception is, at emission, the product of what each event makes of it by its Mach numbers: off where
        the sound comes from, and towards where it goes.
        """
        ends, retarded = PairEnds(links, times), kinematics.retarded
        solved = _solved(links, ends, times, retarded)
        onwards, departing = links.legs[1].turned_back(solved.legs[2].direction), ends.leaving(solved.legs[0].direction)
        receding = solved.legs[2].sound.growth(onwards, links.motions[1].velocity(times))
        slower, faster = (receding, *solved.coming), (solved.mach, *solved.leaving)
        rate, factor, ratio = sum(slower) - sum(faster), np.ones_like(solved.mach), np.ones_like(solved.mach)
        delay, late = np.sum(solved.delays, axis=0), solved.delays[2]
        if retarded:  # not 1 less a number near 1: that would leave fewer digits
            rate = -np.expm1(sum(np.log1p(-x) for x in slower) - sum(np.log1p(-x) for x in faster))
            factor, ratio = np.prod([1.0 - x for x in faster], axis=0), 1.0 / (1.0 - solved.mach)
            for scatterer, coming in zip(self.two, solved.coming, strict=True):
                factor = factor / (1.0 - coming) if scatterer.shape.shadows else factor
            factor = factor**-kinematics.exponent
        else:
            late = np.zeros_like(late)
        lengths = [leg.length for leg in solved.legs]
        first_late = late + (solved.delays[1] if retarded else 0.0)
        return {
            "delay": delay, "delay_rate": rate, "departure": solved.legs[0].sound.normal(departing),
            "arrival": -solved.legs[2].sound.normal(onwards), "length": sum(lengths),
            "through": sum(leg.sound.through for leg in solved.legs),
            "emission_time": times - delay if retarded else np.broadcast_to(times, delay.shape),
            "mach_factor": factor, "frequency_ratio": ratio,
            "strength": np.prod(solved.strengths, axis=0) / np.prod(lengths, axis=0),
            "aspects": np.stack([self._padded(aspects) for aspects in solved.aspects], axis=-1),
            "event_times": np.stack([times - first_late, times - late], axis=-1),
        }  # fmt: skip

    def respond(self, links: Links, found: Arrivals, times: Floats, passing: Any, at: SceneResponse) -> Any:
        """Responses (P, T, F) by the fields of both, and by what air and legs let pass, (P, T, F)."""
        response = passing.astype(np.complex128, copy=False) if links.chain.is_complex else passing
        response *= (found.mach_factor * found.more["strength"])[..., None]
        waves = 2.0 * np.pi * at.frequencies / links.chain.scene.air.speed_of_sound, centre_of(links)
        for mine in self.groups():
            two = self.part(mine).two
            seen = [found.more["aspects"][mine, :, : s.shape.aspects, i] for i, s in enumerate(two)]
            fields: list[Any] = [s.shape.field(*waves, aspects) for s, aspects in zip(two, seen, strict=True)]
            if all(scatterer.shape.outlined for scatterer in two):  # the path by the second alone has both shades
                mirrored: list[Any] = [s.shape.field(*waves, x, 0.0) for s, x in zip(two, seen, strict=True)]
                fields = [np.prod(fields, axis=0) - np.prod(np.stack(fields) - np.stack(mirrored), axis=0), None]
            for i, (scatterer, field) in enumerate(zip(two, fields, strict=True)):
                if field is not None:
                    response[mine] *= field
                if scatterer.fluctuation is not None:
                    response[mine] *= scatterer.fluctuation.at(found.more["event_times"][mine, :, i])[..., None]
        return response

    def largest(self, links: Links, at: SceneResponse) -> Floats:
        """Bounds (P, F) of what both send on, times the lengths of the paths.

        With the lengths d1, d2, d3 of the legs ``(d1 + d2) (d2 + d3)`` is at least ``d2 (d1 + d2 + d3)``, so that the
        product of the bounds of both is one.
        """
        c = links.chain.scene.air.speed_of_sound
        bound, wave = np.ones((len(self), len(at.frequencies))), 2.0 * np.pi * at.frequencies / c
        for mine in self.groups():
            for scatterer in self.part(mine).two:
                most = 1.0 if scatterer.fluctuation is None else scatterer.fluctuation.most
                bound[mine] *= most * scatterer.shape.largest(wave, self.nearest[mine])
        return np.asarray(bound / np.prod(1.0 - self.fastest[self.scatterer, 1] / c, axis=1)[:, None] ** 2)


@dataclass(frozen=True, slots=True, eq=False)
class _SolvedPath:
    """Sound by two scatterers (P, T); of Mach numbers, places and fields, those of the first one and of the second."""

    legs: tuple[Leg, ...]
    delays: Floats  # (3, P, T) of the legs, s
    mach: Floats  # number of the source towards the first one
    coming: tuple[Floats, ...]  # off where sound comes from
    leaving: tuple[Floats, ...]  # towards where it goes
    places: tuple[Floats, ...]  # (P, T, 3) m
    strengths: tuple[Floats, ...]
    aspects: tuple[Floats, ...]


def _solved(links: Links, ends: PairEnds, times: Floats, retarded: bool) -> _SolvedPath:
    """Find the events (P, T) of sound that is received at times (T,), s, by Newton's method, the last one first.

    Each step solves what is linear in the travel times of the legs; specular points follow, each as seen from what was
    found of the other. As the way is the shortest, that they move on the surfaces changes no time.
    """
    scatterers, shape = links.vertex.two, ends.receiver_at.shape[:2]
    bodies, now = [Body(scatterer) for scatterer in scatterers], np.broadcast_to(times, shape)
    delays = np.zeros((3, *shape))  # of the legs from the source on
    second = np.broadcast_to(scatterers[1].trajectory.position(times), (*shape, 3))
    weights: list[Any] = [1.0, 1.0]
    for done in range(_ROUNDS):
        events = now - np.cumsum(delays[::-1], axis=0)[::-1] if retarded else np.broadcast_to(now, delays.shape)
        image, real, source_velocity = ends.emitted(events[0])
        first, velocity = bodies[0].seen(events[1], image, second, weights[0], done >= PATIENCE)
        second, after = bodies[1].seen(events[2], first, ends.receiver_at, weights[1], done >= PATIENCE)
        stops = (image, first, first - real), (first, second, second - first)
        last = second, ends.receiver_at, ends.receiver - second
        legs = tuple(leg_between(links.medium, *leg) for leg in (*stops, last))
        coming, leaving = (
            tuple(leg.sound.growth(leg.direction, v) for leg, v in zip(some, (velocity, after), strict=True))
            for some in (legs[:2], legs[1:])
        )
        mach = np.zeros(shape)
        if source_velocity is not None:
            mach = legs[0].sound.growth(ends.leaving(legs[0].direction), source_velocity)
        change = np.stack([leg.sound.time for leg in legs]) - delays
        if retarded:
            weights = [(1.0 - came) / (1.0 - went) for came, went in zip(coming, leaving, strict=True)]
            change[2] = change[2] / (1.0 - leaving[1])
            change[1] = (change[1] + change[2] * (leaving[0] - coming[1])) / (1.0 - leaving[0])
            change[0] = (change[0] + (change[1] + change[2]) * (mach - coming[0])) / (1.0 - mach)
        delays = delays + change
        converged = max(body.change for body in bodies) <= _CONVERGED
        if converged and np.abs(change).max(initial=0.0) <= _CLOSE:
            fields = zip(*(body.strength(shape) for body in bodies), strict=True)
            return _SolvedPath(legs, delays, mach, coming, leaving, (first, second), *fields)
    names = " and ".join(repr(scatterer.name) for scatterer in scatterers)
    raise unseen(f"each other and both ends, but no path by {names}", times)


_WIDE = 0.5  # of the least distance from scatterers: half the harmonic mean of two of them


def scatterer_pair_paths(
    scene: Scene, sides: tuple[Side, Side], straight_on: Callable[[Scene], Side], limit: int
) -> Chain:
    """Find every path by two scatterers, with the walls that sides have before the first and after the second."""
    check_support("static scatterer pair", scene.air)
    found: list[dict[str, Any]] = []
    between = [straight_on(_others(scene, which)) for which in range(len(scene.scatterers))]
    ends = product(range(len(scene.sources)), range(len(scene.receivers)))
    for (source, receiver), pair in product(ends, permutations(range(len(scene.scatterers)), 2)):
        found.append(_columns(scene, (sides[0], between[pair[0]], sides[1]), (source, receiver), pair))
        if sum(len(each["start"]) for each in found) > limit:
            raise InputError("scatterers_in_row", f"must give at most {limit} paths (path_limit), but 2 gives more")
    if not found:
        found = [_columns(scene, (sides[0], sides[0], sides[1]), (0, 0), (-1, -1))]
    columns: dict[str, Any] = {name: read_only(np.concatenate([each[name] for each in found])) for name in found[0]}
    which = columns.pop("scatterer")
    nearest = read_only(np.full(len(which), _WIDE * scene.min_distance))
    speeds = np.array([scatterer.peak_speeds() for scatterer in scene.scatterers])
    vertex = ScattererPairVertex(which, nearest, speeds, tuple(scene.scatterers))
    legs = sides[0].leg, sides[1].leg
    assert legs[0] is not None
    assert legs[1] is not None
    before, after = columns.pop("before"), columns.pop("after")
    return Chain(scene=scene, **columns, legs=(legs[0].part(before), at_receivers(legs[1].part(after))), vertex=vertex)


def _others(scene: Scene, which: int) -> Scene:
    """Return the scene in which one scatterer sounds and all others listen."""
    signal = max((source.signal for source in scene.sources), key=lambda signal: signal.sampling_rate)
    one = scene.scatterers[which]
    listening = [Receiver(s.name, s.trajectory) for s in scene.scatterers if s is not one]
    with warnings.catch_warnings():  # what there is to say of room and signals was said
        warnings.simplefilter("ignore")
        source = Source(one.name, signal, one.trajectory)
        return Scene(scene.room, scene.air, [source], listening, scene.min_distance, (), scene.bodies)


def _columns(
    scene: Scene, sides: tuple[Side, Side, Side], ends: tuple[int, int], pair: tuple[int, int]
) -> dict[str, Any]:
    """Columns of the paths from a source by two scatterers to a receiver: sides that are there together."""
    (before, between, after), (source, receiver), (first, second) = sides, ends, pair
    rows = (
        np.flatnonzero((before.source == source) & (before.receiver == first)),
        np.flatnonzero(between.receiver == second - (second > first)),
        np.flatnonzero((after.source == second) & (after.receiver == receiver)),
    )
    i, j, k = (each.ravel() for each in np.meshgrid(*rows, indexing="ij"))
    start, end = (_known(scene, sides, (i, j, k), (source, first, second, receiver), name) for name in ("start", "end"))
    kept = np.flatnonzero(start < end)
    i, k, count = i[kept], k[kept], len(kept)
    both = np.tile(np.array([-2 - first, -2 - second], dtype=np.int32), (count, 1))
    met = np.concatenate([before.surfaces[i], both, after.surfaces[k]], axis=1)
    met = np.take_along_axis(met, np.argsort(met == -1, axis=1, kind="stable"), axis=1)
    return {
        "source": np.full(count, source, dtype=np.int32), "receiver": np.full(count, receiver, dtype=np.int32),
        "order": np.sum(met != -1, axis=1).astype(np.int32), "start": start[kept], "end": end[kept],
        "interactions": np.select([met < -1, met >= 0], [SCATTERING, SPECULAR], NONE).astype(np.int8),
        "objects": np.where(met < -1, -2 - met, met), "before": i, "after": k,
        "scatterer": np.tile(np.array(pair, dtype=np.int32), (count, 1)),
    }  # fmt: skip


def _known(
    scene: Scene, sides: tuple[Side, Side, Side], rows: tuple[Any, Any, Any], met: tuple[int, int, int, int], name: str
) -> Any:
    """Find the times of reception (n,) of the last start, or first end, of the three sides of paths, s."""
    places = [scene.scatterers[which].trajectory for which in met[1:3]] + [scene.receivers[met[3]].trajectory]
    latest = np.maximum if name == "start" else np.minimum
    frequency, times = scene.sources[met[0]].emitted.centre_frequency, getattr(sides[0], name)[rows[0]]
    for n in (1, 2):
        motions = places[n - 1], places[n]
        times = received_after(scene, frequency, motions, sides[n], rows[n], times)
        times = latest(times, getattr(sides[n], name)[rows[n]])
    return times
