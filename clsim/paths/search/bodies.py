"""Every path by bodies: sequences from beam trees about poses of the bodies, and when each is heard."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, cached_property, lru_cache, partial
from itertools import pairwise
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import Floats, read_only
from clsim.errors import InputError
from clsim.paths.chain import Chain, check_support
from clsim.paths.family import PathFamily
from clsim.paths.legs.legs import moving_paths
from clsim.paths.legs.mirrors import Mirrors
from clsim.paths.options import PathOptions
from clsim.paths.propagation import UniformAir, mean_medium_of
from clsim.paths.search.beam_tree import BeamTree, TooManyBeamsError
from clsim.paths.search.mesh import BEAM_LIMIT, report, visibility_query
from clsim.paths.visibility.intervals import PERTURBATIONS, BoundingSpheres, joined
from clsim.paths.visibility.mirrors import MirrorEvaluation, PastBodies
from clsim.paths.visibility.obstacles import Obstacles
from clsim.paths.visibility.occlusion import WallLookup
from clsim.paths.visibility.rates import BodyRates, EndRates
from clsim.paths.visibility.subdivision import certified, evaluations, sampled
from clsim.scene.ends import Receiver, Source, find_mount
from clsim.scene.motion.motion import Motion, even_lengths
from clsim.scene.room.faces import Mount
from clsim.scene.room.walls import Walls, build_walls
from clsim.scene.scene import Scene

Progress = Callable[[float], None]
Span = tuple[float, float]

Found = TypeVar("Found")
_POSES = 0.3  # m, which images by bodies go, half way, from one pose in which sequences are looked for to the next
_RATE = 1000.0  # Hz, at which speeds are looked at
_SHORTEST = 1e-3  # s between poses
_FASTEST = 0.5  # of the speed of sound, of bodies and sources on a path together


@dataclass(frozen=True, slots=True, eq=False)
class PairQuery:
    """What is looked at between one source and one receiver."""

    ends: tuple[Motion, Motion]  # where they are as validity takes them
    medium: UniformAir  # what sound travels in
    rates: EndRates  # how fast these and the bodies are
    times: Floats  # (T,) looks, s, where nothing is certain
    resolution: float  # to which begins and ends are found, s

    @property
    def last(self) -> float:
        """Until when it is looked at, s."""
        return float(self.times[-1])

    def bounded(self, begin: Floats, end: Floats) -> tuple[Floats, Floats]:
        """Return intervals that reach from the first look or to the last one as endless."""
        return (np.where(begin <= self.times[0], -np.inf, begin), np.where(end >= self.times[-1], np.inf, end))


class _Lifted:
    """An end as validity takes it: off the wall that it sits in, and off planes of symmetry."""

    def __init__(self, motion: Motion, mount: Mount | None, shift: Floats) -> None:
        self._motion, self._mount, self._shift = motion, mount, shift
        self.is_static = motion.is_static

    def position(self, times: Floats) -> Floats:
        place = self._motion.position(times)
        if self._mount is not None:
            place = self._mount.lifted(place.reshape(-1, 3)).reshape(place.shape)
        return place + self._shift

    def velocity(self, times: Floats) -> Floats:
        return self._motion.velocity(times)


@dataclass(eq=False)
class BodySearch:
    """How paths by bodies, and what bodies hide, are looked for in a scene; see `find_paths`."""

    scene: Scene
    search: PathOptions

    def __post_init__(self) -> None:
        scene, search = self.scene, self.search
        check_support("moving", scene.air)
        self.order = search.max_order if search.body_order is None else min(search.body_order, search.max_order)
        self.room = scene.room.as_mesh()
        fastest = max(body.peak_speed for body in scene.bodies)
        most = _FASTEST * scene.air.slowest
        if 2.0 * fastest * self.order > most:
            bound = f"must be so low that bodies change the length of paths by at most {most:.6g} m/s"
            by = f"{self.order} reflections at up to {fastest:.6g} m/s they may by {2.0 * fastest * self.order:.6g} m/s"
            raise InputError("body_order", f"{bound}, but with {by}")
        self._known: BodyRates | None = None
        self.pair = cache(self._pair)
        self.posed = lru_cache(maxsize=1)(self._posed)  # edges are reached from both ends in one pose
        self.queries = [
            visibility_query(scene, self.room, source, search.max_order, search.resolution) for source in scene.sources
        ]

    @cached_property
    def obstacles(self) -> Obstacles:
        """What reflects and hides in the scene."""
        walls = (*(body.mesh.walls for body in self.scene.bodies), self.room.walls)
        return Obstacles(Mirrors.of(self.scene.room, self.scene.bodies), walls, self.scene.room.is_convex)

    def _pair(self, source: int, receiver: int) -> PairQuery:
        """Candidates between two endpoints."""
        scene, (query, longest) = self.scene, self.queries[source]
        ends: tuple[Source, Receiver] = (scene.sources[source], scene.receivers[receiver])
        moving = [body.trajectory.end for body in scene.bodies if not body.is_static]
        last = float(query.last[receiver])
        if all(math.isinf(end.trajectory.end) for end in ends):
            last = max((t for t in moving if math.isfinite(t)), default=0.0) + longest
        motions = ends[0].trajectory, ends[1].trajectory
        times = evaluations(scene.bodies, motions, last, longest, self.search.body_step)
        mounts = [find_mount(scene.room, end) for end in ends]
        lifted: Any = tuple(map(_Lifted, motions, mounts, PERTURBATIONS))
        medium = mean_medium_of(scene.air, ends[0].emitted.centre_frequency)
        rates = self._rates(longest, last).of_ends(motions[0], motions[1:])
        return PairQuery(lifted, medium, rates, times, query.resolution)

    def _pairs(self, source: int) -> list[PairQuery]:
        """Candidates between a source and each receiver."""
        return [self.pair(source, receiver) for receiver in range(len(self.scene.receivers))]

    def _rates(self, longest: float, last: float) -> BodyRates:
        """Largest speeds of bodies from before the first emission until a last time, s."""
        if self._known is None or longest > -self._known.first or last > self._known.last:
            self._known = BodyRates.of(self.scene.bodies, longest, last)
        return self._known

    def unhidden(self, family: PathFamily, progress: Progress = lambda share: None) -> PathFamily:
        """Return the paths of a kind that is reflected by no body without what bodies hide, rows cut as it takes."""
        found: list[tuple[Any, Any, Any]] = [(np.empty(0, dtype=np.int64), np.empty(0), np.empty(0))]
        pairs, bodies = list(family.pairs()), replace(self.obstacles, convex=True)  # alone: no wall hides anything
        for number, pair in enumerate(pairs):
            part = partial(report, progress, number / len(pairs), (number + 1) / len(pairs))
            query = self.pair(pair.source, pair.receiver)
            past = PastBodies(family, pair.index, bodies, query.rates, query.medium)
            if family.is_specular:
                every = np.arange(len(pair.index))
                spans = every, np.maximum(family.start[pair.index], 0.0), np.minimum(family.end[pair.index], query.last)
                path, begin, end = certified(past.evaluate, past.status, spans, query.resolution, part)
            else:
                path, begin, end = sampled(past.free, pair.index, query.times, query.resolution, past.nearby)
                part(1.0)
            begin, end = query.bounded(begin, end)
            path = pair.index[path]
            begin, end = np.maximum(begin, family.start[path]), np.minimum(end, family.end[path])
            kept = begin < end
            found.append((path[kept], begin[kept], end[kept]))
        path, begin, end = (np.concatenate(each) for each in zip(*found, strict=True))
        order = np.lexsort((begin, path))
        cut = family.part(path[order])
        return replace(cut, start=read_only(begin[order]), end=read_only(end[order]))

    def paths(self, progress: Progress = lambda share: None) -> Chain:
        """Return every path by bodies."""
        found: list[dict[str, NDArray[Any]]] = []
        count, sources = 0, len(self.scene.sources)
        for source in range(sources):
            found.append(
                self._with_intervals(source, partial(report, progress, source / sources, (source + 1) / sources))
            )
            count += len(found[-1]["order"])
            if count > self.search.path_limit:
                raise InputError(
                    "body_order", f"must give at most {self.search.path_limit} paths (path_limit), but gives more"
                )
        columns = {name: read_only(np.concatenate([each[name] for each in found])) for name in found[0]}
        return moving_paths(self.scene, self.obstacles.mirrors, columns, ("surfaces",))

    def _with_intervals(self, source: int, progress: Progress) -> dict[str, NDArray[Any]]:
        """Columns of the paths by mirrors from a source."""
        pairs = self._pairs(source)
        last = np.array([pair.last for pair in pairs])
        rows = self.cells(float(last.max()), partial(self._cell, source))
        bounds = np.array([0.0, *(end for (_, end), _ in rows)])
        surfaces, receiver = (np.concatenate([found[i] for _, found in rows]) for i in range(2))
        cell = np.repeat(np.arange(len(rows)), [len(found[0]) for _, found in rows])
        order = np.argsort(receiver, kind="stable")
        surfaces, receiver, cell = surfaces[order], receiver[order], cell[order]
        which, until = joined([receiver, *surfaces.T], cell, cell + 1)  # cells that touch as one
        begin, end = (np.minimum(bounds[at], last[receiver[which]]) for at in (cell[which], cell[until] + 1))
        real = end > begin
        evaluations, spans = self.mirror_evaluation(source)(surfaces, receiver), (which[real], begin[real], end[real])
        path, begin, end = certified(evaluations.evaluate, evaluations.status, spans, pairs[0].resolution, progress)
        for ear, pair in enumerate(pairs):
            mine = receiver[path] == ear
            begin[mine], end[mine] = pair.bounded(begin[mine], end[mine])
        met, ears = surfaces[path], receiver[path]
        one, other = joined([ears, np.sum(met >= 0, axis=1), *met.T], begin, end)
        met, ears = met[one], ears[one].astype(np.int32)
        return {
            "source": np.full(len(met), source, dtype=np.int32), "receiver": ears,
            "order": np.sum(met >= 0, axis=1).astype(np.int32), "start": begin[one], "end": end[other], "surfaces": met,
        }  # fmt: skip

    def mirror_evaluation(self, source: int) -> Callable[[NDArray[np.int32], NDArray[np.int64]], MirrorEvaluation]:
        """Return a function that makes the evaluation of paths by mirrors (P, N) from a source to receivers (P,)."""
        pairs = self._pairs(source)
        widest = max((pair.rates for pair in pairs), key=lambda rates: rates.bodies.last)
        rates = EndRates(
            widest.bodies, widest.source, tuple(pair.rates.receivers[0] for pair in pairs),
            np.concatenate([pair.rates.held for pair in pairs]),
        )  # fmt: skip
        emitter, medium, ears = pairs[0].ends[0], pairs[0].medium, [pair.ends[1] for pair in pairs]
        return partial(MirrorEvaluation, self.obstacles, emitter, ears, medium, rates, step=self.search.body_step)

    def cells(self, last: float, find: Callable[[Span], Found]) -> list[tuple[Span, Found]]:
        """Return stretches of time until a last one, s, and what is found in each, in order."""
        waiting, found, probed = self._spans(last)[::-1], [], False
        while waiting:
            begin, end = waiting.pop()
            try:
                found.append(((begin, end), find((begin, end))))
            except TooManyBeamsError as error:
                if end - begin < 2.0 * _SHORTEST:
                    raise InputError("body_order", str(error)) from error
                if not probed:  # whether halves of halves help at all: each tree that is too large takes long
                    probed = True
                    waiting += [(begin + _SHORTEST, end), (begin, begin + _SHORTEST)]
                    continue
                waiting += [(0.5 * (begin + end), end), (begin, 0.5 * (begin + end))]
        return found

    def _spans(self, last: float) -> list[Span]:
        """Return stretches of time until a last one, s, in each of which bodies are about one pose."""
        if self.order == 0:
            return [(0.0, last)]
        instants = np.arange(math.ceil(last * _RATE) + 1) / _RATE
        size = self.room.walls.size
        turning = [np.linalg.norm(body.trajectory.angular_velocity(instants), axis=-1) for body in self.scene.bodies]
        speed = np.sum([body.speed(instants) for body in self.scene.bodies], axis=0) + size * np.sum(turning, axis=0)
        waiting = list(np.minimum(even_lengths(np.minimum(speed, _POSES / _SHORTEST), _RATE, _POSES), last))
        return list(pairwise(waiting if len(waiting) > 1 else [0.0, last]))

    def _cell(self, source: int, span: Span) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
        """Return sequences (n, order) that hold a body, and the receiver of each, about one pose of the bodies.

        Beams run between balls that hold the ends. Unfold a path by the mirrors as they are in the pose, reflections at
        the place of the face at which it is: a line from ball to ball that is in all apertures, but bends at mirrors
        that are off their pose: by 2 a where they are turned by a, by 2 V / c as they move, and by what they are
        displaced, d, at both ends of a leg. A beam reaches all that lines from its ball through its last aperture do.
        Drawn on backwards, each leg passes the source by no more than the bends before it times the way to them. So no
        sequence is lost by a ball that is as much larger, but where the leg between two mirrors is shorter than those
        are displaced. What bodies hide in the pose they may not hide: nothing is taken to be hidden.
        """
        (query, longest), (begin, end) = self.queries[source], span
        ends = query.trajectory_tables
        middle = 0.5 * (begin - longest + end)
        slack = 2.0 * self.order * self.moved(middle, np.linspace(begin - longest, end, 9))
        walls = self.posed(middle)
        centre, radius = ends.sphere(0, begin - longest, end)
        ears = ends.receiver_spheres(begin, end)
        start = ends.position(np.zeros(1, dtype=np.int64), np.array([middle]))[0] + PERTURBATIONS[0]
        ears = BoundingSpheres(ears.centre, ears.radius + slack)
        air = WallLookup(walls).air_sides(start)
        tree = BeamTree(walls, centre, radius + slack, ears, BEAM_LIMIT, air, hides=False)
        first, width = len(self.scene.room.faces), max(self.order, 1)
        parts = [(np.empty((0, width), dtype=np.int32), np.empty(0, dtype=np.int64))]
        for batch in tree.candidates(self.order):
            rows = np.flatnonzero(np.any(batch.sequence >= first, axis=1)[batch.row])
            sequence = np.full((len(rows), width), -1, dtype=np.int32)
            sequence[:, : batch.sequence.shape[1]] = batch.sequence[batch.row[rows]]
            parts.append((sequence, batch.receiver[rows]))
        return np.concatenate([p[0] for p in parts]), np.concatenate([p[1] for p in parts])

    def moved(self, time: float, others: Floats) -> float:
        """Half the largest distance of images by bodies from those at a time, over times from first to last, m."""
        most, between = 0.0, 0.5 * float(np.diff(others).max(initial=0.0))
        length = 0.5 * (self.order + 1) * self.room.walls.size
        for body in self.scene.bodies:
            if not body.is_static:
                corners, motion = body.mesh.vertices, body.trajectory
                away = body.placed(corners[None], others[:, None]) - body.placed(corners, np.array(time))
                cosine = np.abs(motion.orientation(others) @ motion.orientation(np.array(time)))
                speed = float(body.speed(others).max())
                turned = float(2.0 * np.arccos(np.minimum(cosine, 1.0)).max()) + motion.peak_turn * between
                gone = float(np.linalg.norm(away, axis=-1).max()) + speed * between
                most = max(most, gone + length * (turned + speed / self.scene.air.slowest))
        return most

    def _posed(self, time: float) -> Walls:
        """Return the walls of the room and the faces of bodies as they are at a time, numbered as mirrors."""
        meshes = [self.room, *(body.mesh for body in self.scene.bodies)]
        placed = [self.room.vertices]
        placed += [body.placed(body.mesh.vertices, np.array(time)) for body in self.scene.bodies]
        corners = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes[:-1])])
        first = np.cumsum([0, *(len(mesh.walls) for mesh in meshes[:-1])])
        triangles = np.concatenate([mesh.triangles + c for mesh, c in zip(meshes, corners, strict=True)])
        surface = np.concatenate([mesh.walls.of_triangle + f for mesh, f in zip(meshes, first, strict=True)])
        flatness = max(mesh.flatness for mesh in meshes)
        return build_walls(np.concatenate(placed), triangles, surface, 10.0 * flatness)
