"""Paths by one scatterer, with reflections before and after it."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any, ClassVar, cast

import numpy as np

from clsim.paths.arrivals import MACH_EXPONENT, Arrivals
from clsim.paths.family import PeakSpeeds, ends_at
from clsim.paths.propagation import delay_bounds
from clsim.paths.scattering.way import scattered_way
from clsim.paths.two_sided import TwoSidedPaths

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Complexes, Floats
    from clsim.paths.family import Instant, Rows
    from clsim.paths.response import SceneResponse
    from clsim.scene.scene import Scene

_AT_A_TIME = 6144  # nodes that are looked at together: what is worked on stays in the cache


@dataclass(frozen=True, slots=True, eq=False)
class ScatteredArrivals(Arrivals):
    """What paths by scatterers bring, with what their responses need."""

    second_length: Floats  # (P, T) from the scatterer to the receiver, m
    strength: Floats  # (P, T) of the scatterer, m, see `Shape`
    aspects: Floats  # likewise
    event_time: Floats  # (P, T) when it was scattered, s


def scatter(
    response: Any, scene: Scene, which: NDArray[np.int32], here: ScatteredArrivals, frequencies: Floats
) -> None:
    """Multiply responses (P, T, F) by the fields and the fluctuations of scatterers, in place.

    Shapes: response (P, T, F); which (P,); frequencies (F,) Hz.
    """
    wave = 2.0 * np.pi * frequencies / scene.air.speed_of_sound
    for each in np.unique(which):
        mine, scatterer = np.flatnonzero(which == each), scene.scatterers[each]
        field = scatterer.shape.field(wave, here.aspects[mine, :, : scatterer.shape.aspects])
        if field is not None:
            response[mine] *= field
        if scatterer.fluctuation is not None:
            response[mine] *= scatterer.fluctuation.at(here.event_time[mine])[..., None]


def largest_scattered(scene: Scene, which: NDArray[np.int32], nearest: Floats, frequencies: Floats) -> Floats:
    """Return bounds of what scatterers send back, times the lengths of the paths (P, F).

    Shapes: which (P,); nearest (P,) m; frequencies (F,) Hz.

    nearest: bounds from below of half the harmonic mean of the distances of both ends, m.
    """
    wave = 2.0 * np.pi * frequencies / scene.air.speed_of_sound
    bound = np.empty((len(which), len(wave)))
    for each in np.unique(which):
        mine, scatterer = which == each, scene.scatterers[each]
        most = 1.0 if scatterer.fluctuation is None else scatterer.fluctuation.most
        bound[mine] = most * scatterer.shape.largest(wave, nearest[mine])
    return bound


@dataclass(frozen=True, slots=True, eq=False)
class ScatteredPaths(TwoSidedPaths):
    """Paths by one scatterer each.

    Attributes
    ----------
    nearest : ndarray (paths,)
        Bound from below of the harmonic mean of the distances of both ends from the scatterer, over 2, m.
    """

    scatterer: NDArray[np.int32]  # (paths,) index in the scene
    fastest: Floats  # (scatterers, 2) bounds of the speeds of centres and surfaces, m/s
    nearest: Floats

    columns: ClassVar[tuple[str, ...]] = (
        "before_matrix", "before_offset", "after_matrix", "after_offset", "scatterer", "nearest",
    )  # fmt: skip

    @property
    def moves(self) -> bool:
        """Whether any scatterer moves or turns."""
        return not all(scatterer.is_static for scatterer in self.scene.scatterers)

    @property
    def varies(self) -> bool:
        """Whether the field of any scatterer has lobes or fringes, which a path passes one after another."""
        return any(scatterer.shape.is_complex for scatterer in self.scene.scatterers)

    @property
    def is_complex(self) -> bool:
        """Whether the field or the fluctuation of any scatterer, a wall or a directivity has a phase."""
        things = any(s.shape.is_complex or s.fluctuation is not None for s in self.scene.scatterers)
        return things or super(ScatteredPaths, self).is_complex

    @property
    def device(self) -> str | None:
        """The program for scatterers; none that knows how one fluctuates."""
        fluctuates = [scatterer.fluctuation is not None for scatterer in self.scene.scatterers]
        return None if np.array(fluctuates)[self.scatterer].any() else "scatterers"

    @property
    def object_names(self) -> tuple[str, ...]:
        """Names of the scatterers."""
        return tuple(scatterer.name for scatterer in self.scene.scatterers)

    def arrivals(
        self, rows: Rows, times: Floats, motion: str = "retarded", amplitude: str = "wave-equation"
    ) -> Arrivals:
        """Return delays, directions and lengths of paths between one source and one receiver.

        What a moving thing scatters is received as from a moving source: the pressure is that of two points of the wave
        equation in a row, ``1 / (d1 (1 - M_s)) f / (d2 (1 - M_c))``, with the Mach numbers of the source towards the
        scatterer at emission, and of what scatters towards the receiver. What casts a shadow is raised by ``1 - M_1``
        with its Mach number off the source, as by a mirror: behind it that is the direct sound's strength.
        """
        times, index = np.asarray(times, dtype=np.float64), np.arange(len(self))[rows]
        shape, wide = (len(index), len(times)), {"departure": 3, "arrival": 3, "aspects": self._aspects}
        columns = {
            f.name: np.empty((*shape, wide[f.name]) if f.name in wide else shape)
            for f in fields(ScatteredArrivals)
            if f.name != "means"
        }
        for which in np.unique(self.scatterer[index]):
            mine = np.flatnonzero(self.scatterer[index] == which)
            parts = -(-len(times) * len(mine) // _AT_A_TIME)
            for part in range(parts):
                here = slice(part * len(times) // parts, (part + 1) * len(times) // parts)
                found = self._arrivals(int(which), index[mine], times[here], motion, amplitude)
                for name, column in columns.items():
                    column[mine, here] = found[name]
        return ScatteredArrivals(**columns, means=None)

    @property
    def _aspects(self) -> int:
        """Numbers that the field of any scatterer takes, at most."""
        return max(scatterer.shape.aspects for scatterer in self.scene.scatterers)

    def _arrivals(
        self, which: int, index: NDArray[np.int64], times: Floats, motion: str, amplitude: str
    ) -> dict[str, Floats]:
        """Return the columns (P, T) of arrivals by one scatterer."""
        retarded, ends = motion == "retarded", _PairEnds(self, index, times)
        medium = self.medium(int(self.source[index[0]]))
        scatterer = self.scene.scatterers[which]
        way = scattered_way(medium, scatterer, ends, times, retarded)
        mach, coming, leaving = way.mach, way.coming, way.leaving
        onwards, departing = self.turned_back("after", index, way.second.direction), ends.leaving(way.first.direction)
        receding = way.second.sound.growth(onwards, self.ends(index)[1].trajectory.velocity(times))
        rate, factor, ratio = receding - leaving + coming - mach, np.ones_like(mach), np.ones_like(mach)
        if retarded:  # not 1 less a number near 1: that would leave fewer digits
            rate = (receding * (1.0 - coming) + coming - mach - leaving * (1.0 - mach)) / ((1 - leaving) * (1 - mach))
            raised = 1.0 - coming if scatterer.shape.shadows else 1.0
            factor = ((1.0 - mach) * (1.0 - leaving) / raised) ** -MACH_EXPONENT[amplitude]
            ratio = 1.0 / (1.0 - mach)
        departure, arrival = way.first.sound.normal(departing), -way.second.sound.normal(onwards)
        first, second, late = way.first.length, way.second.length, way.second.sound.time if retarded else 0.0
        strength = way.strength
        none = np.zeros((*way.delay.shape, self._aspects - way.aspects.shape[-1]))
        if way.first.sound.carried is not None:  # as of paths by walls in wind
            first = first * np.sum(departure * departing, axis=-1)
            second = second * -np.sum(arrival * onwards, axis=-1)
            if scatterer.shape.shadows:  # rest in wind is motion through still air
                strength = strength * first / way.first.sound.through
        return {
            "delay": way.delay, "delay_rate": rate, "departure": departure, "arrival": arrival,
            "length": first + second, "through": way.first.sound.through + way.second.sound.through,
            "emission_time": times - way.delay if retarded else np.broadcast_to(times, way.delay.shape),
            "mach_factor": factor, "frequency_ratio": ratio, "second_length": second,
            "strength": strength, "aspects": np.concatenate([way.aspects, none], axis=-1),
            "event_time": np.broadcast_to(times - late, way.delay.shape),
        }  # fmt: skip

    def response(self, rows: Rows, found: Arrivals, times: Floats, at: SceneResponse) -> Floats | Complexes:
        """Return received over emitted pressure (P, T, F): scatterers, spreading, air, walls, directivities."""
        index, here = np.arange(len(self))[rows], cast("ScatteredArrivals", found)
        spreading = here.strength / ((here.length - here.second_length) * here.second_length)
        response: Any = at.air(found)  # complex by itself where air disperses
        if self.is_complex:
            response = response.astype(np.complex128, copy=False)
        response *= (found.mach_factor * spreading)[..., None]
        scatter(response, self.scene, self.scatterer[index], here, at.frequencies)
        self.reflect(response, index, found, at)
        at.apply_directivities(response, self.ends(rows), found, times)
        return cast("Floats", response)

    def vertices(self, rows: Rows, time: float, motion: str = "retarded") -> Floats:
        """Return source, points of reflection and scattering, and receiver (P, N + 2, 3) of paths of one pair."""
        index, now = np.arange(len(self))[rows], np.array([time])
        source, receiver = (end.trajectory for end in self.ends(rows))
        place, delay = np.empty((len(index), 3)), np.empty(len(index))
        medium = self.medium(int(self.source[index[0]]))
        for which in np.unique(self.scatterer[index]):
            mine = np.flatnonzero(self.scatterer[index] == which)
            ends = _PairEnds(self, index[mine], now)
            way = scattered_way(medium, self.scene.scatterers[which], ends, now, motion == "retarded")
            place[mine], delay[mine] = way.place[:, 0], way.delay[:, 0]
        emitted_at = source.position(time - delay if motion == "retarded" else np.full(len(index), time))
        return self.vertices_by(
            index, emitted_at, (place, place), np.broadcast_to(receiver.position(now), emitted_at.shape)
        )

    def lengths(self, rows: Rows, source: Floats, receiver: Floats) -> Floats:
        """Lengths of paths (P,) by the centres of scatterers at 0 s, with endpoints at places (P, 3), m."""
        return self._lengths(np.arange(len(self))[rows], source, receiver, 0.0)

    def _lengths(self, index: NDArray[np.int64], source: Floats, receiver: Floats, times: Instant) -> Floats:
        """Return the same at a time, or at times (P,)."""
        centre = ends_at(self.scene.scatterers, self.scatterer[index], times)
        sides = (("before", source), ("after", receiver))
        return np.asarray(sum(np.linalg.norm(self.image(side, index, x) - centre, axis=1) for side, x in sides))

    def delay_bounds(self, rows: Rows, start: Instant, end: Instant, speeds: PeakSpeeds) -> tuple[Floats, Floats]:
        """Return bounds (P,) on the delays of paths of any pairs between two times of reception, s.

        The way by the surface is shorter than that by the centre, by at most the diameter of a sphere that holds the
        thing. A scatterer was elsewhere by its speed times a delay when the sound met it, which both legs see.
        """
        scene, index = self.scene, np.arange(len(self))[rows]
        source, receiver = self.source[index], self.receiver[index]
        middle, half = 0.5 * (start + end), 0.5 * (end - start)
        places = ends_at(scene.sources, source, middle), ends_at(scene.receivers, receiver, middle)
        radius = np.array([scatterer.shape.radius for scatterer in scene.scatterers])[self.scatterer[index]]
        length = self._lengths(index, *places, middle) - radius
        twice = 2.0 * self.fastest[self.scatterer[index], 0]
        emitting = speeds.source[source] + twice
        return delay_bounds(self.speed_range, length, half * (emitting + speeds.receiver[receiver]) + radius, emitting)

    def max_rate(self, source_speed: float, receiver_speed: float) -> float:
        """Return a bound on how fast delays change with the time of reception, s/s, from the ends' speeds, m/s."""
        c, most = self.speed_range.slowest, float(self.fastest[:, 1].max())
        squeezed = (c + receiver_speed) * (c + most) / ((c - most) * (c - source_speed))
        return squeezed - 1.0

    def gain_bound(self, rows: Rows, at: SceneResponse) -> Floats:
        """Return the reflection factors' magnitudes (P, F) times a bound of what scatterers send back."""
        index, c = np.arange(len(self))[rows], self.scene.air.speed_of_sound
        bound = largest_scattered(self.scene, self.scatterer[index], self.nearest[index], at.frequencies)
        bound /= (1.0 - self.fastest[self.scatterer[index], 1:] / c) ** 2
        return np.asarray(bound * at.largest_reflection(self.walls[index]))


class _PairEnds:
    """Both ends of paths `index` (P,) between one source and one receiver, as scatterers see them."""

    def __init__(self, paths: ScatteredPaths, index: NDArray[np.int64], times: Floats) -> None:
        self._paths, self._index = paths, index
        self._source, receiver = (end.trajectory for end in paths.ends(index))
        self.receiver = receiver.position(times)
        self.heard_at = np.ascontiguousarray(paths.image("after", index, self.receiver[None]))

    def emitted(self, times: Floats) -> tuple[Floats, Floats, Floats | None]:
        """Return images of the source, its places, and its velocities, None for rest, (P, T, 3) at times (P, T)."""
        if self._source.is_static:
            place = self._source.position(np.zeros((1, 1)))
            image = self._paths.image("before", self._index, place)
            return np.broadcast_to(image, (*times.shape, 3)), place, None
        place = self._source.position(times)
        return self._paths.image("before", self._index, place), place, self._source.velocity(times)

    def leaving(self, direction: Floats) -> Floats:
        """Return in which directions (P, T, 3) ways leave the source that reach the scatterer in given ones."""
        return self._paths.turned_back("before", self._index, direction)
