"""Paths by one scatterer, with faces of bodies among the mirrors before or after it."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, cast

import numpy as np

from clsim.arrays import read_only
from clsim.paths.arrivals import MACH_EXPONENT, Arrivals
from clsim.paths.family import BODY, NONE, SCATTERING, SPECULAR, ends_at
from clsim.paths.moving.moving_paths import MovingPaths
from clsim.paths.moving.scattered_way import find_scattered
from clsim.paths.propagation import UniformAir
from clsim.paths.scattering.family import ScatteredArrivals, largest_scattered, scatter

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.arrays import Complexes, Floats
    from clsim.paths.family import Instant, Rows
    from clsim.paths.moving.scattered_way import ScatteredEvents
    from clsim.paths.response import SceneResponse

    Walls = NDArray[np.signedinteger[Any]]

_AT_A_TIME = 6144  # nodes that are looked at together: what is worked on stays in the cache


@dataclass(frozen=True, slots=True, eq=False)
class BodyScatteredArrivals(ScatteredArrivals):
    """What paths by scatterers and bodies bring, with what their responses need."""

    cosine: Floats  # (P, T, N) of the angle of incidence at each mirror, those before the scatterer first


@dataclass(frozen=True, eq=False)
class BodyScatteredPaths(MovingPaths):
    """Paths by one scatterer each, and by mirrors of which one or more are faces of bodies.

    Attributes
    ----------
    before, after : ndarray (paths, N) int
        Mirrors on the way to the scatterer, and on that from it, as sound meets them, filled up with -1: walls of
        the room, and behind them the faces of bodies.
    """

    interactions: NDArray[np.signedinteger[Any]] = field(init=False, repr=False)
    objects: NDArray[np.signedinteger[Any]] = field(init=False, repr=False)
    before: NDArray[np.int32]
    after: NDArray[np.int32]
    scatterer: NDArray[np.int32]  # (paths,) index in the scene
    nearest: Floats  # (paths,) bound from below of the harmonic mean of the lengths of both legs, over 2, m

    columns: ClassVar[tuple[str, ...]] = ("before", "after", "scatterer", "nearest")

    def __post_init__(self) -> None:
        walls, faces = len(self.scene.room.faces), len(self.mirrors.owner) - len(self.scene.room.faces)
        met = np.concatenate([self.before, self.scatterer[:, None], self.after], axis=1)
        kinds = np.where(met < 0, np.int8(NONE), np.where(met >= walls, np.int8(BODY), np.int8(SPECULAR)))
        objects = met - walls * (kinds == BODY)
        kinds[:, self.before.shape[1]] = SCATTERING
        objects[:, self.before.shape[1]] = faces + self.scatterer
        order = np.argsort(kinds == NONE, axis=1, kind="stable")
        for name, values in (("interactions", kinds), ("objects", objects)):
            object.__setattr__(self, name, read_only(np.take_along_axis(values, order, axis=1)))
        super().__post_init__()

    @property
    def moves(self) -> bool:
        """Whether any body or scatterer moves or turns."""
        return super().moves or not all(scatterer.is_static for scatterer in self.scene.scatterers)

    @property
    def varies(self) -> bool:
        """Whether the field of any scatterer has lobes or fringes, which a path passes one after another."""
        return any(scatterer.shape.is_complex for scatterer in self.scene.scatterers)

    @property
    def is_complex(self) -> bool:
        """Whether the field or the fluctuation of any scatterer, a wall or a directivity has a phase."""
        things = any(s.shape.is_complex or s.fluctuation is not None for s in self.scene.scatterers)
        return things or super().is_complex

    @property
    def object_names(self) -> tuple[str, ...]:
        """Names of the faces of bodies, and of the scatterers."""
        faces = tuple(name for body in self.scene.bodies for name in body.faces)
        return (*faces, *(scatterer.name for scatterer in self.scene.scatterers))

    def arrivals(
        self, rows: Rows, times: Floats, motion: str = "retarded", amplitude: str = "wave-equation"
    ) -> Arrivals:
        """Return delays, directions and lengths of paths between one source and one receiver.

        On the second leg what is scattered sounds as from a source that moves with the scatterer: the pressure is ``1 /
        (d1 dt_c/dt_e) f / (d2 dt/dt_c)``, with the time of scattering t_c, and d of both legs from image events.
        """
        times, index = np.asarray(times, dtype=np.float64), np.arange(len(self))[rows]
        shape, mirrors = (len(index), len(times)), self.before.shape[1] + self.after.shape[1]
        wide = {"departure": 3, "arrival": 3, "aspects": self._aspects, "cosine": mirrors}
        names = [f.name for f in fields(BodyScatteredArrivals) if f.name != "means"]
        columns = {name: np.empty((*shape, wide[name]) if name in wide else shape) for name in names}
        for which in np.unique(self.scatterer[index]).tolist():
            mine = np.flatnonzero(self.scatterer[index] == which)
            parts = -(-len(times) * len(mine) // _AT_A_TIME)
            for part in range(parts):
                here = slice(part * len(times) // parts, (part + 1) * len(times) // parts)
                found = self._arrivals(which, index[mine], times[here], motion, amplitude)
                for name, column in columns.items():
                    column[mine, here] = found[name]
        return BodyScatteredArrivals(**columns, means=None)

    @property
    def _aspects(self) -> int:
        """Numbers that the field of any scatterer takes, at most."""
        return max(scatterer.shape.aspects for scatterer in self.scene.scatterers)

    def events(self, which: int, index: NDArray[np.int64], times: Floats, motion: str = "retarded") -> ScatteredEvents:
        """Events of paths (P,) by one scatterer between one source and one receiver.

        Shapes: index (P,); times (T,) s.
        """
        source, receiver = self.ends(index)
        medium, legs = self.medium(int(self.source[index[0]])), (self.before[index], self.after[index])
        assert isinstance(medium, UniformAir)
        ends = source.trajectory, receiver.trajectory
        return find_scattered(
            self.mirrors, legs, self.scene.scatterers[which], ends, medium, times, motion == "retarded"
        )

    def _arrivals(
        self, which: int, index: NDArray[np.int64], times: Floats, motion: str, amplitude: str
    ) -> dict[str, Floats]:
        """Return the columns (P, T) of arrivals by one scatterer."""
        found, retarded = self.events(which, index, times, motion), motion == "retarded"
        first, second, one = found.first, found.second, np.ones_like(found.time)
        delay, rate = first.delay + second.delay, first.rate + second.rate
        stretch, ratio, strength = one, one, found.strength
        shadows = self.scene.scatterers[which].shape.shadows  # then as in `ScatteredPaths.arrivals`
        if shadows:
            strength = strength * first.carried
        if retarded:
            rate = rate - first.rate * second.rate
            stretch = first.stretch * second.stretch / (first.carried * second.carried)
            if shadows:
                stretch = stretch / (1.0 - found.coming)
            ratio = 1.0 / (1.0 - first.mach)
        lengths = [leg.distance * leg.carried for leg in (first, second)]
        none = np.zeros((*delay.shape, self._aspects - found.aspects.shape[-1]))
        return {
            "delay": delay, "delay_rate": rate, "departure": first.departure, "arrival": second.arrival,
            "length": lengths[0] + lengths[1], "through": first.distance + second.distance,
            "emission_time": times - delay if retarded else np.broadcast_to(times, delay.shape),
            "mach_factor": stretch ** -MACH_EXPONENT[amplitude], "frequency_ratio": ratio,
            "second_length": lengths[1], "strength": strength,
            "aspects": np.concatenate([found.aspects, none], axis=-1), "event_time": found.time,
            "cosine": np.concatenate([first.cosine, second.cosine], axis=-1),
        }  # fmt: skip

    def response(self, rows: Rows, found: Arrivals, times: Floats, at: SceneResponse) -> Floats | Complexes:
        """Return received over emitted pressure (P, T, F): scatterers, spreading, air, walls, faces, directivities."""
        index, here = np.arange(len(self))[rows], cast("BodyScatteredArrivals", found)
        surfaces = np.concatenate([self.before[index], self.after[index]], axis=1)
        spreading = here.strength / ((here.length - here.second_length) * here.second_length)
        response: Any = at.air(found)
        if self.is_complex:
            response = response.astype(np.complex128, copy=False)
        response = response * at.reflection(surfaces)[:, None, :]
        response *= (found.mach_factor * spreading)[..., None]
        scatter(response, self.scene, self.scatterer[index], here, at.frequencies)
        for bounce, met in enumerate(surfaces.T):
            for wall in np.unique(met[at.angular[met]]).tolist():
                some = np.flatnonzero(met == wall)
                response[some] *= at.reflection_at(wall, here.cosine[some, :, bounce])
        at.apply_directivities(response, self.ends(rows), found, times)
        return cast("Floats", response)

    def vertices(self, rows: Rows, time: float, motion: str = "retarded") -> Floats:
        """Return source, points of reflection and scattering, and receiver (P, N + 2, 3) of paths of one pair."""
        index = np.arange(len(self))[rows]
        found = np.full((len(index), self.objects.shape[1] + 2, 3), np.nan)
        for which in np.unique(self.scatterer[index]).tolist():
            mine = np.flatnonzero(self.scatterer[index] == which)
            events = self.events(which, index[mine], np.array([time]), motion)
            counts = (np.sum(walls[index[mine]] >= 0, axis=1) for walls in (self.before, self.after))
            for p, way, back, n, m in zip(mine, events.first.place, events.second.place, *counts, strict=True):
                found[p, : n + 2] = way[0, : n + 2]
                found[p, n + 2 : n + m + 3] = back[0, 1 : m + 2]
        return found

    def _lengths(self, index: NDArray[np.int64], source: Floats, receiver: Floats, times: Instant) -> Floats:
        """Return the sums (P,) of both legs by centres of scatterers."""
        return sum(self.legs(index, source, receiver, times), np.zeros(len(source)))

    def _spare(self, index: NDArray[np.int64]) -> Floats:
        """Return the radii (P,) of spheres that hold the scatterers: their diameters may be taken off the way, m."""
        return np.array([scatterer.shape.radius for scatterer in self.scene.scatterers])[self.scatterer[index]]

    def legs(self, index: NDArray[np.int64], source: Floats, receiver: Floats, times: Instant) -> tuple[Floats, Floats]:
        """Lengths of both legs (P,) by centres of scatterers and bodies as they are at a time, or times (P,).

        Shapes: index (P,); source, receiver (P, 3) m.
        """
        centre = ends_at(self.scene.scatterers, self.scatterer[index], times)
        first = self.mirrors.distances(self.before[index], source, centre, times)
        return first, self.mirrors.distances(self.after[index], centre, receiver, times)

    @cached_property
    def speeds(self) -> Floats:
        """Sums (paths,) of the bounds of the speeds of what a path meets, m/s: bodies, and the scatterer's surface."""
        peak = np.array([body.peak_speed for body in self.scene.bodies])
        owner = np.append(self.mirrors.owner, -1)[np.concatenate([self.before, self.after], axis=1)]
        surface = np.array([scatterer.peak_speeds()[1] for scatterer in self.scene.scatterers])
        bodies = np.where(owner >= 0, np.append(peak, 0.0)[owner], 0.0).sum(axis=1)
        return read_only(bodies + surface[self.scatterer])

    def gain_bound(self, rows: Rows, at: SceneResponse) -> Floats:
        """Return the reflection factors' magnitudes (P, F) times a bound of what scatterers send back."""
        index = np.arange(len(self))[rows]
        mach = self.speeds[index] / self.scene.air.speed_of_sound
        bound = largest_scattered(self.scene, self.scatterer[index], self.nearest[index], at.frequencies)
        bound *= ((1.0 + mach) / (1.0 - mach))[:, None]
        surfaces = np.concatenate([self.before[index], self.after[index]], axis=1)
        return np.asarray(bound * at.largest_reflection(surfaces))
