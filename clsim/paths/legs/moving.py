"""Legs by surfaces of which some move: images of events."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import ByRow, Floats, read_only
from clsim.paths.arrivals import Arrivals, Kinematics
from clsim.paths.chain import Chain
from clsim.paths.family import DIFFRACTION, Instant
from clsim.paths.legs.events import find_events
from clsim.paths.legs.mirrors import Mirrors
from clsim.paths.links import Columns, Integers, Links, Vertex, in_chunks, met_in_order
from clsim.paths.propagation import UniformAir
from clsim.scene.scene import Scene

_AT_A_TIME = 16384  # nodes that are solved together


@dataclass(frozen=True, slots=True, eq=False)
class MovingLinks(Links):
    """Legs of which some surfaces move, and vertices."""

    def solve(self, times: Floats, kinematics: Kinematics) -> Arrivals:
        """Solve the delay equations of paths at times of reception (T,), s."""
        nodes = _AT_A_TIME if self.vertex is None else self.vertex.nodes_at_a_time
        return in_chunks(self, times, nodes, partial(_columns, kinematics))

    def places(self, time: float, kinematics: Kinematics) -> Floats:
        """Source, points of interaction and receiver (P, N + 2, 3) at a time of reception, s."""
        found = np.full((len(self), self.chain.objects.shape[1] + 2, 3), np.nan)
        for mine in [np.arange(len(self))] if self.vertex is None else self.vertex.groups():
            some: Any = self.part(mine)
            events = some.events(np.array([time]), kinematics)
            first, last = (events, None) if self.vertex is None else (events.first, events.last)
            for i, p in enumerate(mine.tolist()):
                n = int(np.sum(some.legs[0].surfaces[i] >= 0))
                found[p, : n + 2] = first.place[i, 0, : n + 2]
                if last is None:  # the receiver stands behind all mirrors
                    continue
                m, two = int(np.sum(some.legs[1].surfaces[i] >= 0)), some.vertex.objects.ndim - 1
                if (between := some.between).shape[1]:
                    b = int(np.sum(between[i] >= 0))
                    found[p, n + 2 : n + 2 + b] = events.between.place[i, 0, 1 : b + 1]
                    n += b
                found[p, n + 2 : n + m + 3 + two] = last.place[i, 0, 1 - two : m + 2]
        return found

    def lengths(self, source: Floats, receiver: Floats, times: Instant) -> Floats:
        """Lengths of paths (P,) between places (P, 3), with all mirrors where they are at times, m."""
        if self.vertex is not None:
            return np.asarray(self.vertex.moving_lengths(self, (source, receiver), times))
        leg = self.legs[0]
        return np.asarray(leg.mirrors.distances(leg.surfaces, source, receiver, times))

    def events(self, times: Floats, kinematics: Kinematics) -> Any:
        """Events of paths: of reflection alone, or those of both legs with what the vertex found."""
        medium, leg = self.medium, self.legs[0]
        assert isinstance(medium, UniformAir)
        if self.vertex is not None:
            return self.vertex.on_moving_legs(self, medium, times, kinematics)
        return find_events(leg.mirrors, leg.surfaces, self.motions, medium, times, kinematics.retarded)

    @property
    def surfaces(self) -> tuple[Integers, ...]:
        """Mirrors (P, N) of each leg from the source's side."""
        return tuple(leg.surfaces for leg in self.legs)

    @property
    def all_surfaces(self) -> Integers:
        """Mirrors (P, N) of all legs, -1 for none."""
        return np.concatenate([*self.surfaces, self.between], axis=1)

    @property
    def between(self) -> Integers:
        """Mirrors (P, B) between two vertices, -1 for none."""
        none = np.empty((len(self), 0), dtype=np.int32)
        return none if self.vertex is None else getattr(self.vertex, "between", none)


def _columns(kinematics: Kinematics, links: Any, times: Floats) -> Columns:
    """Arrivals (P, T) of events.

    The pressure is that of images of the source: it falls with the distance d of each leg from its image event, and
    by the time of reception over that of emission, ``s(t - delay) / (d dt/dt_e)``, in which the Doppler factors of
    the source and of all mirrors are. Other conditions on moving faces differ by the order of their Mach number.
    """
    passed, retarded = links.events(times, kinematics), kinematics.retarded
    first, last = (passed, passed) if links.vertex is None else (passed.first, passed.last)
    mach = first.mach if retarded else np.zeros_like(first.mach)
    delay, rate, through, cosine = first.delay, first.rate, first.distance, first.cosine
    if links.vertex is None:
        stretch = first.stretch / first.carried if retarded else np.ones_like(first.stretch)
        own: Columns = {"length": first.distance * first.carried, "mach_factor": stretch**-kinematics.exponent}
    else:
        delay, rate, through = delay + last.delay, rate + last.rate, through + last.distance
        rate = rate - first.rate * last.rate if retarded else rate
        cosines = [passed.between.cosine] if links.between.shape[1] else []
        cosine = np.concatenate([cosine, last.cosine, *cosines], axis=2)
        own = links.vertex.passed(passed, kinematics)
    return {
        "delay": delay, "delay_rate": rate, "departure": first.departure, "arrival": last.arrival,
        "through": through, "frequency_ratio": 1.0 / (1.0 - mach), "cosine": cosine,
        "emission_time": times - delay if retarded else np.broadcast_to(times, delay.shape), **own,
    }  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class MovingLeg(ByRow):
    """Legs of P paths of which some surfaces belong to bodies."""

    # (P, N) mirrors from the source's side, -1 behind the last: walls of the room, and behind them the faces of
    # bodies.
    surfaces: NDArray[np.int32]
    mirrors: Mirrors  # of the scene

    kind: ClassVar[str] = "moving"
    moving: ClassVar[bool] = True
    links: ClassVar[type[Links]] = MovingLinks

    def in_scene(self, scene: Scene, surfaces: Integers) -> MovingLeg:
        """Return legs by the mirrors of another scene."""
        return MovingLeg(self.surfaces, Mirrors.of(scene))

    def named(self, name: str) -> Iterator[tuple[str, Any]]:
        """Yield the columns by name."""
        yield name, self.surfaces

    def __len__(self) -> int:
        return len(self.surfaces)


def moving_paths(
    scene: Scene, mirrors: Mirrors, columns: dict[str, Any], legs: tuple[str, ...], vertex: Vertex | None = None
) -> Chain:
    """Make paths of moving legs from columns, of which some are the surfaces of legs."""
    surfaces = tuple(columns[name] for name in legs)
    each: Any = vertex
    walls, at = len(scene.room.faces), None if vertex is None else (each.interaction, each.objects)
    counts = walls, walls + sum(len(body.faces) for body in scene.bodies)
    kinds, objects = met_in_order(counts, surfaces[0], at, surfaces[-1], getattr(vertex, "between", None))
    wide = np.int32 if at is not None and at[0] == DIFFRACTION else np.int64  # as they are hashed
    kinds, objects = read_only(kinds), read_only(objects.astype(wide))
    always: dict[str, Any] = {name: columns[name] for name in ("source", "receiver", "order", "start", "end")}
    moving = tuple(MovingLeg(met, mirrors) for met in surfaces)
    return Chain(scene=scene, **always, interactions=kinds, objects=objects, legs=moving, vertex=vertex)
