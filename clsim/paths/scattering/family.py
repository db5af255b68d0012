"""Paths by one scatterer, with reflections before and after it."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any, ClassVar, cast

import numpy as np

from clsim.paths.arrivals import MACH_EXPONENT, Arrivals
from clsim.paths.family import PeakSpeeds, ends_at
from clsim.paths.propagation import delay_bounds
from clsim.paths.scattering.way import Way, scattered_way
from clsim.paths.two_sided import TwoSidedPaths

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Complexes, Floats
    from clsim.paths.family import Instant, Rows
    from clsim.paths.response import SceneResponse
    from clsim.scene.motion.motion import Motion

_AT_A_TIME = 4096  # nodes that are looked at together: what is worked on stays in the cache


@dataclass(frozen=True, slots=True, eq=False)
class ScatteredArrivals(Arrivals):
    """What paths by scatterers bring, with what their responses need.

    Attributes
    ----------
    second_length : ndarray (P, T)
        From the scatterer to the receiver, m.
    strength, cosine : ndarray (P, T)
        Of the scatterer, m and 1, see `Shape`.
    """

    second_length: Floats
    strength: Floats
    cosine: Floats


@dataclass(frozen=True, slots=True, eq=False)
class ScatteredPaths(TwoSidedPaths):
    """Paths by one scatterer each.

    Attributes
    ----------
    scatterer : ndarray (paths,) int
        Index in the scene.
    speeds : ndarray (scatterers, 2)
        Bounds of the speeds of centres and surfaces, m/s.
    nearest : ndarray (paths,)
        Bound from below of the harmonic mean of the distances of both ends from the scatterer, over 2, m.
    """

    scatterer: NDArray[np.int32]
    speeds: Floats
    nearest: Floats

    columns: ClassVar[tuple[str, ...]] = (
        "before_matrix", "before_offset", "after_matrix", "after_offset", "scatterer", "nearest",
    )  # fmt: skip

    @property
    def moves(self) -> bool:
        """Whether any scatterer moves or turns."""
        return not all(scatterer.is_static for scatterer in self.scene.scatterers)

    @property
    def is_complex(self) -> bool:
        """Whether the field of any scatterer, a wall or a directivity has a phase."""
        shapes = any(scatterer.shape.is_complex for scatterer in self.scene.scatterers)
        return shapes or super(ScatteredPaths, self).is_complex

    @property
    def object_names(self) -> tuple[str, ...]:
        """Names of the scatterers."""
        return tuple(scatterer.name for scatterer in self.scene.scatterers)

    def arrivals(
        self, rows: Rows, times: Floats, motion: str = "retarded", amplitude: str = "wave-equation"
    ) -> Arrivals:
        """Return delays, directions and lengths of paths between one source and one receiver.

        Notes
        -----
        What a moving thing scatters is received as from a moving source: the pressure is that of two points of the wave
        equation in a row, ``1 / (d1 (1 - M_s)) f / (d2 (1 - M_c))``, with the Mach numbers of the source towards the
        scatterer at emission, and of what scatters towards the receiver.
        """
        times, index = np.asarray(times, dtype=np.float64), np.arange(len(self))[rows]
        shape = len(index), len(times)
        columns = {f.name: np.empty((*shape, 3) if f.name in ("departure", "arrival") else shape)
                   for f in fields(ScatteredArrivals)}  # fmt: skip
        for which in np.unique(self.scatterer[index]):
            mine = np.flatnonzero(self.scatterer[index] == which)
            step = max(1, _AT_A_TIME // len(mine))
            for first in range(0, len(times), step):
                here = slice(first, first + step)
                found = self._arrivals(int(which), index[mine], times[here], motion, amplitude)
                for name, column in columns.items():
                    column[mine, here] = found[name]
        return ScatteredArrivals(**columns)

    def _arrivals(
        self, which: int, index: NDArray[np.int64], times: Floats, motion: str, amplitude: str
    ) -> dict[str, Floats]:
        """Return the columns (P, T) of arrivals by one scatterer."""
        retarded = motion == "retarded"
        way = self._way(which, index, times, motion)
        receiver = self.ends(index)[1].trajectory
        receding = way.second.mach_at_arrival(self.turned("after", index, receiver.velocity(times)[None]))
        leaving = way.second.mach_at_departure(way.velocity)
        coming = way.first.mach_at_arrival(way.velocity)
        mach = way.first.mach_at_departure(way.source_velocity)
        rate, factor = receding - leaving + coming - mach, np.ones_like(mach)
        if retarded:  # not 1 less a number near 1: that would leave fewer digits
            rate = (receding * (1.0 - coming) + coming - mach - leaving * (1.0 - mach)) / ((1 - leaving) * (1 - mach))
            factor = ((1.0 - mach) * (1.0 - leaving)) ** -MACH_EXPONENT[amplitude]
        return {
            "delay": way.delay, "delay_rate": rate,
            "departure": np.einsum("pji,ptj->pti", self.before_matrix[index], way.first.departure),
            "arrival": -np.einsum("pji,ptj->pti", self.after_matrix[index], way.second.arrival),
            "length": way.first.length + way.second.length,
            "emission_time": times - way.delay if retarded else np.broadcast_to(times, way.delay.shape),
            "mach_factor": factor, "second_length": way.second.length, "strength": way.strength, "cosine": way.cosine,
        }  # fmt: skip

    def _way(self, which: int, index: NDArray[np.int64], times: Floats, motion: str) -> Way:
        """Return the ways of paths (P,) by one scatterer at times (T,)."""
        source, receiver = (end.trajectory for end in self.ends(index))

        def emitter(at: Floats) -> tuple[Floats, Floats]:
            return self._emitted(source, index, at)

        heard_at = np.ascontiguousarray(self.image("after", index, receiver.position(times)[None]))
        return scattered_way(
            self.medium, self.scene.scatterers[which], emitter, heard_at, times, motion == "retarded"
        )  # fmt: skip

    def _emitted(self, source: Motion, index: NDArray[np.int64], times: Floats) -> tuple[Floats, Floats]:
        """Return where images of a source are and how they move (P, T, 3) at times (P, T)."""
        if source.is_static:
            place = self.image("before", index, source.position(np.zeros(1))[None])
            return np.broadcast_to(place, (*times.shape, 3)), np.zeros((1, 1, 3))
        flat = times.ravel()
        place, velocity = (f(flat).reshape(*times.shape, 3) for f in (source.position, source.velocity))
        return self.image("before", index, place), self.turned("before", index, velocity)

    def response(self, rows: Rows, found: Arrivals, times: Floats, at: SceneResponse) -> Floats | Complexes:
        """Return received over emitted pressure (P, T, F): scatterers, spreading, air, walls, directivities."""
        index, here = np.arange(len(self))[rows], cast("ScatteredArrivals", found)
        spreading = here.strength / ((here.length - here.second_length) * here.second_length)
        response: Any = at.air(found.length).astype(np.complex128 if self.is_complex else np.float64)
        response *= (found.mach_factor * spreading)[..., None]
        wave = 2.0 * np.pi * at.frequencies / self.medium.slowest
        for which in np.unique(self.scatterer[index]):
            mine = np.flatnonzero(self.scatterer[index] == which)
            field = self.scene.scatterers[which].shape.field(wave, here.cosine[mine])
            if field is not None:
                response[mine] *= field
        self.reflect(response, index, found, at)
        at.apply_directivities(response, self.ends(rows), found, times)
        return cast("Floats", response)

    def vertices(self, rows: Rows, time: float, motion: str = "retarded") -> Floats:
        """Return source, points of reflection and scattering, and receiver (P, N + 2, 3) of paths of one pair."""
        index, now = np.arange(len(self))[rows], np.array([time])
        source, receiver = (end.trajectory for end in self.ends(rows))
        place, delay = np.empty((len(index), 3)), np.empty(len(index))
        for which in np.unique(self.scatterer[index]):
            mine = np.flatnonzero(self.scatterer[index] == which)
            way = self._way(int(which), index[mine], now, motion)
            place[mine], delay[mine] = way.place[:, 0], way.delay[:, 0]
        emitted_at = source.position(time - delay if motion == "retarded" else np.full(len(index), time))
        return self.vertices_by(index, emitted_at, place, np.broadcast_to(receiver.position(now), emitted_at.shape))

    def lengths(self, rows: Rows, source: Floats, receiver: Floats) -> Floats:
        """Return how long paths (P,) are by the centres of scatterers at 0 s, with their ends at places (P, 3), m."""
        return self._lengths(np.arange(len(self))[rows], source, receiver, 0.0)

    def _lengths(self, index: NDArray[np.int64], source: Floats, receiver: Floats, times: Instant) -> Floats:
        """Return the same at a time, or at times (P,)."""
        centre = ends_at(self.scene.scatterers, self.scatterer[index], times)
        sides = (("before", source), ("after", receiver))
        return np.asarray(sum(np.linalg.norm(self.image(side, index, x) - centre, axis=1) for side, x in sides))

    def delay_bounds(self, rows: Rows, start: Instant, end: Instant, speeds: PeakSpeeds) -> tuple[Floats, Floats]:
        """Return bounds (P,) on the delays of paths of any pairs between two times of reception, s.

        Notes
        -----
        The way by the surface is shorter than that by the centre, by at most the diameter of a sphere that holds the
        thing. A scatterer was elsewhere by its speed times a delay when the sound met it, which both legs see.
        """
        scene, index = self.scene, np.arange(len(self))[rows]
        source, receiver = self.source[index], self.receiver[index]
        middle, half = 0.5 * (start + end), 0.5 * (end - start)
        places = ends_at(scene.sources, source, middle), ends_at(scene.receivers, receiver, middle)
        radius = np.array([scatterer.shape.radius for scatterer in scene.scatterers])[self.scatterer[index]]
        length = self._lengths(index, *places, middle) - radius
        twice = 2.0 * self.speeds[self.scatterer[index], 0]
        emitting = speeds.source[source] + twice
        return delay_bounds(self.medium, length, half * (emitting + speeds.receiver[receiver]) + radius, emitting)

    def max_rate(self, source_speed: float, receiver_speed: float) -> float:
        """Return a bound on how fast delays change with the time of reception, s/s, from the ends' speeds, m/s."""
        c, most = self.medium.slowest, float(self.speeds[:, 1].max())
        squeezed = (c + receiver_speed) * (c + most) / ((c - most) * (c - source_speed))
        return squeezed - 1.0

    def gain_bound(self, rows: Rows, at: SceneResponse) -> Floats:
        """Return the reflection factors' magnitudes (P, F) times a bound of what scatterers send back."""
        index, c = np.arange(len(self))[rows], self.medium.slowest
        wave, sizes = 2.0 * np.pi * at.frequencies / c, []
        for scatterer, (_, surface) in zip(self.scene.scatterers, self.speeds, strict=True):
            field = scatterer.shape.field(wave, np.linspace(0.0, 1.0, 257))
            most = 1.0 if field is None else np.abs(field).max(axis=0)
            sizes.append(np.broadcast_to(scatterer.shape.strongest * most / (1.0 - surface / c) ** 2, len(wave)))
        bound = np.array(sizes)[self.scatterer[index]] / self.nearest[index][:, None]
        return np.asarray(bound * at.largest_reflection(self.walls[index]))
