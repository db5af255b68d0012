"""Scatterers as vertices: where and when sound meets them, and the pressure that they send on."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from clsim.acoustics.shade import LOUDEST_SHADE, shade
from clsim.acoustics.silhouette import ASPECTS
from clsim.arrays import Floats
from clsim.numerics.quaternions import inverse, rotate
from clsim.paths.family import SCATTERING, Columns, Instant, Links, Pair, Rows, ends_at, in_chunks
from clsim.paths.propagation import UniformAir
from clsim.paths.response import Arrivals, Kinematics, SceneResponse
from clsim.paths.vertices import scatterer_paths
from clsim.scene.scatterer import CapsuleShape, Scatterer
from clsim.scene.scene import Scene


@dataclass(frozen=True, slots=True, eq=False)
class ScattererVertex:
    """Scatterers that P paths meet."""

    scatterer: NDArray[np.int32]  # (P,) index in the scene
    # (P,) bound from below of the harmonic mean of the distances of both ends from the scatterer, over 2, m.
    nearest: Floats
    fastest: Floats  # (scatterers, 2) bounds of the speeds of centres and surfaces, m/s
    scatterers: tuple[Scatterer, ...]  # of the scene

    kind: ClassVar[str] = "scatterer"
    interaction: ClassVar[int] = SCATTERING
    costly: ClassVar[bool] = False
    one_by_one: ClassVar[bool] = True
    nodes_at_a_time: ClassVar[int] = 6144

    @staticmethod
    def of(scatterers: Sequence[Scatterer], which: NDArray[np.int32]) -> ScattererVertex:
        """Make vertices at scatterers (P,), with no bound of their distances yet."""
        speeds = np.array([scatterer.peak_speeds() for scatterer in scatterers])
        return ScattererVertex(which, np.zeros(len(which)), speeds, tuple(scatterers))

    def part(self, rows: Rows) -> ScattererVertex:
        """Return some of the vertices."""
        return ScattererVertex(self.scatterer[rows], self.nearest[rows], self.fastest, self.scatterers)

    def in_scene(self, scene: Scene) -> Self:
        """Return the same vertices with the scatterers of another scene."""
        return replace(self, scatterers=tuple(scene.scatterers))

    def named(self, moving: bool) -> Iterator[tuple[str, Any]]:
        """Yield the columns by name."""
        for name in ("scatterer", "nearest") if moving else ("scatterer", "fastest", "nearest"):
            yield name, getattr(self, name)

    @property
    def is_complex(self) -> bool:
        """Whether the field or the fluctuation of any scatterer has a phase."""
        return any(s.shape.is_complex or s.fluctuation is not None for s in self.scatterers)

    @property
    def varies(self) -> bool:
        """Whether the field of any scatterer has lobes or fringes, which a path passes one after another."""
        return any(scatterer.shape.is_complex for scatterer in self.scatterers)

    @property
    def outlined(self) -> bool:
        """Whether any scatterer has the shadow of its outline."""
        return any(scatterer.shape.outlined for scatterer in self.scatterers)

    @property
    def approximate(self) -> bool:
        """Whether the field of any scatterer is an approximation that has lobes or a shadow."""
        return self.outlined or any(isinstance(scatterer.shape, CapsuleShape) for scatterer in self.scatterers)

    @property
    def moves(self) -> bool:
        """Whether any scatterer moves or turns."""
        return not all(scatterer.is_static for scatterer in self.scatterers)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the scatterers."""
        return tuple(scatterer.name for scatterer in self.scatterers)

    @property
    def objects(self) -> NDArray[np.int32]:
        """Number of each scatterer among the names, (P,)."""
        return self.scatterer

    @property
    def swiftest(self) -> float:
        """Bound of the speed of any scatterer's surface, m/s."""
        return float(self.fastest[:, 1].max())

    @property
    def radius(self) -> Floats:
        """Radii (P,) of spheres about the centres that hold the scatterers, m."""
        return np.array([scatterer.shape.radius for scatterer in self.scatterers])[self.scatterer]

    @property
    def on_device(self) -> bool:
        """Whether a program of nodes knows these scatterers: none that fluctuate."""
        fluctuates = [scatterer.fluctuation is not None for scatterer in self.scatterers]
        return not np.array(fluctuates)[self.scatterer].any()

    def speeds(self, moving: bool) -> Floats:
        """Bounds (P,) of the speeds of scatterers, m/s: of their surfaces on moving legs, else of their centres."""
        return np.asarray(self.fastest[self.scatterer, int(moving)])

    def groups(self) -> list[NDArray[np.int64]]:
        """Vertices that are solved together: those of one scatterer."""
        return [np.flatnonzero(self.scatterer == which) for which in np.unique(self.scatterer)]

    def on_static_legs(self, links: Links, times: Floats, kinematics: Kinematics) -> Arrivals:
        """Solve paths between static legs."""
        return in_chunks(links, times, self.nodes_at_a_time, partial(self._columns, kinematics), self.alike())

    def alike(self) -> list[NDArray[np.int64]]:
        """Vertices whose paths are solved together: those of one scatterer, and of capsules of one kind."""
        shapes = [scatterer.shape for scatterer in self.scatterers]
        kinds = np.array([
            -1 - shape.outlined if isinstance(shape, CapsuleShape) else which for which, shape in enumerate(shapes)
        ])[self.scatterer]  # fmt: skip
        return [np.flatnonzero(kinds == kind) for kind in np.unique(kinds)]

    def _columns(self, kinematics: Kinematics, links: Links, times: Floats) -> Columns:
        """Arrivals (P, T) by one scatterer.

        What a moving thing scatters is received as from a moving source: the pressure is that of two points of the wave
        equation in a row, ``1 / (d1 (1 - M_s)) f / (d2 (1 - M_c))``, with the Mach numbers of the source towards the
        scatterer at emission, and of what scatters towards the receiver. What casts a shadow is raised by ``1 - M_1``
        with its Mach number off the source, as by a mirror: behind it that is the direct sound's strength.
        """
        retarded, ends = kinematics.retarded, PairEnds(links, times)
        solved, scatterer = _path_of(links, ends, times, retarded), links.vertex.together
        mach, coming, leaving = solved.mach, solved.coming, solved.leaving
        onwards, departing = links.legs[1].turned_back(solved.second.direction), ends.leaving(solved.first.direction)
        receding = solved.second.sound.growth(onwards, links.motions[1].velocity(times))
        rate, factor, ratio = receding - leaving + coming - mach, np.ones_like(mach), np.ones_like(mach)
        if retarded:  # not 1 less a number near 1: that would leave fewer digits
            rate = (receding * (1.0 - coming) + coming - mach - leaving * (1.0 - mach)) / ((1 - leaving) * (1 - mach))
            raised = 1.0 - coming if scatterer.shape.shadows else 1.0
            factor = ((1.0 - mach) * (1.0 - leaving) / raised) ** -kinematics.exponent
            ratio = 1.0 / (1.0 - mach)
        departure, arrival = solved.first.sound.normal(departing), -solved.second.sound.normal(onwards)
        first, second, late = solved.first.length, solved.second.length, solved.second.sound.time if retarded else 0.0
        strength = solved.strength
        if solved.first.sound.carried is not None:  # as of paths by walls in wind
            first = first * np.sum(departure * departing, axis=-1)
            second = second * -np.sum(arrival * onwards, axis=-1)
            if scatterer.shape.shadows:  # rest in wind is motion through still air
                strength = strength * first / solved.first.sound.through
        return {
            "delay": solved.delay, "delay_rate": rate, "departure": departure, "arrival": arrival,
            "length": first + second, "through": solved.first.sound.through + solved.second.sound.through,
            "emission_time": times - solved.delay if retarded else np.broadcast_to(times, solved.delay.shape),
            "mach_factor": factor, "frequency_ratio": ratio, "second_length": second,
            "strength": strength, "aspects": self._padded(solved.aspects),
            "event_time": np.broadcast_to(times - late, solved.delay.shape),
        }  # fmt: skip

    def on_moving_legs(
        self, links: Links, medium: UniformAir, times: Floats, kinematics: Kinematics
    ) -> scatterer_paths.ScatteredEvents:
        """Solve paths by one scatterer between moving legs."""
        before, after = links.legs
        legs = before.surfaces, after.surfaces
        path = before.mirrors, legs, self.one, links.motions
        return scatterer_paths.find_scattered(*path, medium, times, kinematics.retarded)

    def passed(self, events: scatterer_paths.ScatteredEvents, kinematics: Kinematics) -> Columns:
        """Columns of arrivals on moving legs.

        On the second leg what is scattered is received as from a source that moves with the scatterer: the pressure is
        ``1 / (d1 dt_c/dt_e) f / (d2 dt/dt_c)``, with the time of scattering t_c, and d of both legs from image events.
        """
        first, last, shadows = events.first, events.last, self.one.shape.shadows  # then as on static legs
        stretch = np.ones_like(events.time)
        if kinematics.retarded:
            stretch = first.stretch * last.stretch / (first.carried * last.carried)
            if shadows:
                stretch = stretch / (1.0 - events.coming)
        lengths = [leg.distance * leg.carried for leg in (first, last)]
        return {
            "length": lengths[0] + lengths[1], "second_length": lengths[1],
            "mach_factor": stretch**-kinematics.exponent, "event_time": events.time,
            "strength": events.strength * first.carried if shadows else events.strength,
            "aspects": self._padded(events.aspects),
        }  # fmt: skip

    def places(self, links: Links, ends: Pair, times: Floats, kinematics: Kinematics) -> tuple[Floats, ...]:
        """Points (P, 3), m, where sound that is received at a time (1,) is scattered between static legs."""
        place = np.empty((len(self), 3))
        for mine in self.groups():
            some = links.part(mine)
            place[mine] = _path_of(some, PairEnds(some, times), times, kinematics.retarded).place[:, 0]
        return place, place

    def lengths(self, links: Links, ends: Pair, images: Pair, times: Instant) -> Floats:
        """Lengths (P,) by the centres at times, between images of endpoints (P, 3) on static legs, m."""
        centre = ends_at(self.scatterers, self.scatterer, times)
        return np.asarray(sum(np.linalg.norm(image - centre, axis=1) for image in images))

    def moving_lengths(self, links: Links, places: Pair, times: Instant) -> Floats:
        """Lengths (P,) by the centres, between endpoints (P, 3) on moving legs, with all where it is at times, m."""
        return np.asarray(sum(self.leg_lengths(links, places, times)))

    def leg_lengths(self, links: Links, places: Pair, times: Instant) -> tuple[Floats, Floats]:
        """Lengths of both moving legs (P,), likewise."""
        centre, (before, after) = ends_at(self.scatterers, self.scatterer, times), links.legs
        first = before.mirrors.distances(before.surfaces, places[0], centre, times)
        return first, after.mirrors.distances(after.surfaces, centre, places[1], times)

    def respond(self, links: Links, found: Arrivals, times: Floats, passing: Any, at: SceneResponse) -> Any:
        """Responses (P, T, F) by the field of scatterers, and by what air and legs let pass, (P, T, F)."""
        more = found.more
        spreading = more["strength"] / ((found.length - more["second_length"]) * more["second_length"])
        response = passing.astype(np.complex128, copy=False) if links.chain.is_complex else passing
        response *= (found.mach_factor * spreading)[..., None]
        wave = 2.0 * np.pi * at.frequencies / links.chain.scene.air.speed_of_sound
        return self._sent_on(response, more, (wave, centre_of(links)), shades=links.legs[0].moving)

    def _sent_on(self, response: Any, more: Columns, waves: tuple[Floats, float], *, shades: bool = True) -> Any:
        """Multiply responses (P, T, F) by the fields and fluctuations of scatterers.

        waves: numbers (F,) and the central one, 1/m. shades: whether these include shadows of outlines; those on paths
        that walls reflect are paths of their own.
        """
        for mine in self.groups() if shades else self.alike():
            some = self.part(mine)
            shape: Any = some.together.shape
            aspects = more["aspects"][mine, :, : shape.aspects]
            past: Any = 0.0
            if shades and shape.outlined:
                past = self._past(mine, more["event_time"][mine], aspects, waves)
            field = shape.field(*waves, aspects, past)
            if field is not None:
                response[mine] *= field
        for mine in self.groups():
            fluctuation = self.part(mine).one.fluctuation
            if fluctuation is not None:
                response[mine] *= fluctuation.at(more["event_time"][mine])[..., None]
        return response

    def _past(self, mine: NDArray[np.int64], times: Floats, aspects: Floats, waves: tuple[Floats, float]) -> Any:
        """Shares (P, T, F) of the direct sound that scatterers before one in the scene let pass, see `shade`."""
        which, moments = int(self.scatterer[mine[0]]), times.ravel()
        own, past = self.scatterers[which].trajectory, np.ones((times.size, len(waves[0])), dtype=np.complex128)
        ends = aspects.reshape(-1, aspects.shape[-1])[:, -ASPECTS:][:, :6].reshape(-1, 2, 3)
        if own.has_orientation:
            ends = rotate(own.orientation(moments)[:, None], ends)
        ends = ends + own.position(moments)[:, None]
        for other in self.scatterers[:which]:
            shape: Any = other.shape
            if shape.outlined:
                seen = ends - other.trajectory.position(moments)[:, None]
                if other.trajectory.has_orientation:
                    seen = rotate(inverse(other.trajectory.orientation(moments))[:, None], seen)
                past *= shade(shape.outline, *waves, seen[:, 0], seen[:, 1])
        return past.reshape(*times.shape, -1)

    def largest(self, links: Links, at: SceneResponse) -> Floats:
        """Bounds (P, F) of what scatterers send on, times the lengths of the paths."""
        c, rows = links.chain.scene.air.speed_of_sound, links.rows
        wave = 2.0 * np.pi * at.frequencies / c
        bound = np.empty((len(self), len(wave)))
        for mine in self.groups():
            scatterer = self.part(mine).one
            most = 1.0 if scatterer.fluctuation is None else scatterer.fluctuation.most
            bound[mine] = most * scatterer.shape.largest(wave, self.nearest[mine])
            others = self.scatterers[: self.scatterer[mine[0]]]
            if scatterer.shape.outlined and any(other.shape.outlined for other in others):
                bound[mine] *= LOUDEST_SHADE
        if links.legs[0].moving:
            mach = links.chain.speeds[rows] / c
            return np.asarray(bound * ((1.0 + mach) / (1.0 - mach))[:, None])
        return np.asarray(bound / (1.0 - self.fastest[self.scatterer, 1:] / c) ** 2)

    @property
    def one(self) -> Scatterer:
        """The scatterer of vertices that are all of one."""
        return self.scatterers[int(self.scatterer[0])]

    @property
    def together(self) -> Scatterer | scatterer_paths.Capsules:
        """The scatterer of vertices that are all of one, or all capsules of vertices."""
        if np.all(self.scatterer == self.scatterer[:1]):
            return self.one
        return scatterer_paths.Capsules(self.scatterers, self.scatterer)

    def _padded(self, aspects: Floats) -> Floats:
        """Aspects (P, T, n) with as many numbers as the field of any scatterer takes."""
        most = max(scatterer.shape.aspects for scatterer in self.scatterers)
        return np.concatenate([aspects, np.zeros((*aspects.shape[:2], most - aspects.shape[-1]))], axis=-1)

    def __len__(self) -> int:
        return len(self.scatterer)


def centre_of(links: Links) -> float:
    """Wave number in the middle of the band of what the source of paths emits, 1/m."""
    return float(2.0 * np.pi * links.ends[0].emitted.centre_frequency / links.chain.scene.air.speed_of_sound)


def _path_of(links: Links, ends: PairEnds, times: Floats, retarded: bool) -> scatterer_paths.ScatteredPath:
    return scatterer_paths.scattered_path(links.medium, links.vertex.together, ends, times, retarded)


class PairEnds:
    """Both ends of paths between one source and one receiver, as scatterers see them by static legs."""

    def __init__(self, links: Links, times: Floats) -> None:
        self._before, after = links.legs
        self._source, receiver = links.motions
        self.receiver = receiver.position(times)
        self.receiver_at = np.ascontiguousarray(after.image(self.receiver[None]))

    def emitted(self, times: Floats) -> tuple[Floats, Floats, Floats | None]:
        """Return images of the source, its places, and its velocities, None for rest, (P, T, 3) at times (P, T)."""
        if self._source.is_static:
            place = self._source.position(np.zeros((1, 1)))
            return np.broadcast_to(self._before.image(place), (*times.shape, 3)), place, None
        place = self._source.position(times)
        return self._before.image(place), place, self._source.velocity(times)

    def leaving(self, direction: Floats) -> Floats:
        """Return in which directions (P, T, 3) paths leave the source that reach the scatterer in given ones."""
        return np.asarray(self._before.turned_back(direction))
