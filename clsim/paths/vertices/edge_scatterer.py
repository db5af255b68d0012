"""An edge of the room and a scatterer in either order, or between two edges, as vertices between static legs.

From one side the scatterer is reached by a leg alone, from the other over the edge and a leg between both. There its
centre has the image of that end at the length of the path over the edge, in the direction in which the path arrives,
with the edge's field there. On a shadow boundary this is the end itself, whatever the scatterer's size, so that nothing
jumps as the centre passes it.
Images move with the end and with the scatterer, which Mach numbers take into account.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from clsim.acoustics.diffraction import ON_LINE, path_over_edge
from clsim.arrays import ByRow, Floats
from clsim.paths.family import Columns, Instant, Integers, Links, Pair, Rows, ends_at
from clsim.paths.legs.legs import StaticLeg, path_vertices
from clsim.paths.propagation import straight
from clsim.paths.response import Arrivals, Kinematics, SceneResponse
from clsim.paths.vertices.edge import EdgeVertex
from clsim.paths.vertices.edge_field import EdgeView, towards_edge
from clsim.paths.vertices.scatterer import ScattererVertex, centre_of
from clsim.paths.vertices.scatterer_paths import PATIENCE, Body, unseen
from clsim.scene.scatterer import Scatterer
from clsim.scene.scene import Scene

_ROUNDS, _CLOSE, _CONVERGED = 80, 1e-9, 1e-3  # of Newton's method; s and rad that end it, as for one scatterer


@dataclass(frozen=True, slots=True, eq=False)
class EdgeBeside(ByRow):
    """Edges on one side of scatterers (P,), and what reflects between both."""

    edge: EdgeVertex
    leg: StaticLeg  # image of the scatterer as the edge sees it
    walls: Integers  # (P, N) from the scatterer's side, -1 behind the last

    @property
    def view(self) -> EdgeView:
        """View of scatterers from the edges."""
        return EdgeView.of(self.leg.matrix, self.leg.offset, self.edge.frame)


@dataclass(frozen=True, slots=True, eq=False)
class EdgeScattererVertex(ScattererVertex):
    """Scatterers (P,) that P paths meet after an edge, before one, or both."""

    edges: tuple[EdgeBeside | None, EdgeBeside | None]  # (P,) before and after; None for legs alone

    kind: ClassVar[str] = "edge scatterer"

    @staticmethod
    def of(scatterers: Sequence[Scatterer], which: NDArray[np.int32], edges: Any = (None, None)) -> EdgeScattererVertex:
        """Make vertices at scatterers (P,) and edges (P,), with no bound of their distances yet."""
        kinds: dict[Any, Any] = {(False, True): ScattererEdgeVertex, (True, True): EdgeScattererEdgeVertex}
        kind = kinds.get(tuple(edge is not None for edge in edges), EdgeScattererVertex)
        speeds = np.array([scatterer.peak_speeds() for scatterer in scatterers])
        made: EdgeScattererVertex = kind(which, np.zeros(len(which)), speeds, tuple(scatterers), tuple(edges))
        return made

    @property
    def is_complex(self) -> bool:
        """Whether responses have phases: the field of an edge has."""
        return True

    @property
    def on_device(self) -> bool:
        """Whether a program of nodes knows these: none."""
        return False

    @property
    def names(self) -> tuple[str, ...]:
        """Names of edges and their ends, and of scatterers."""
        beside = next(beside for beside in self.edges if beside is not None)
        return (*beside.edge.names, *(scatterer.name for scatterer in self.scatterers))

    def part(self, rows: Rows) -> EdgeScattererVertex:
        """Return some of the vertices."""
        edges: Any = tuple(edge if edge is None else edge.part(rows) for edge in self.edges)
        return replace(self, scatterer=self.scatterer[rows], nearest=self.nearest[rows], edges=edges)

    def in_scene(self, scene: Scene) -> Self:
        """Return the same vertices with the scatterers of another scene, and their images by its walls."""
        edges: Any = tuple(
            None if beside is None else replace(beside, leg=beside.leg.in_scene(scene, beside.walls))
            for beside in self.edges
        )
        return replace(ScattererVertex.in_scene(self, scene), edges=edges)

    def named(self, moving: bool) -> Iterator[tuple[str, Any]]:
        """Yield the columns by name."""
        for beside in self.edges:
            if beside is not None:
                yield from beside.edge.named(moving)
                yield "model", beside.edge.model
                yield from beside.leg.named("between")
        for name in ("scatterer", "fastest", "nearest"):
            yield name, getattr(self, name)

    def places(self, links: Links, ends: Pair, times: Floats, kinematics: Kinematics) -> tuple[Floats, ...]:
        """Points (P, 3), m, where sound that is received at a time (1,) is diffracted, reflected and scattered."""
        place, apexes = np.empty((len(self), 3)), np.empty((2, len(self), 3))
        for mine in self.groups():
            some = links.part(mine)
            chain = _solved(some, times, kinematics.retarded)
            place[mine] = chain.place[:, 0]
            for apex, beside, over in zip(apexes, some.vertex.edges, chain.overs, strict=True):
                if over is not None:
                    apex[mine] = beside.edge.frame[:, 0] + over.along * beside.edge.frame[:, 3]
        faces = links.chain.scene.room.faces
        met: tuple[list[Floats], list[Floats]] = ([], [])
        for apex, beside, found in zip(apexes, self.edges, met, strict=True):
            if beside is not None:
                points = path_vertices((faces.normals, faces.offsets), beside.walls, place, apex)
                points[np.arange(len(self)), np.sum(beside.walls >= 0, axis=1) + 1] = np.nan  # the edge, added last
                found += [*np.moveaxis(points[:, 1:-1], 1, 0), apex]
        return (*met[0][::-1], place, *met[1])

    def lengths(self, links: Links, ends: Pair, images: Pair, times: Instant) -> Floats:
        """Lengths (P,) by the centres at times, between images of endpoints (P, 3), m."""
        centre, found = ends_at(self.scatterers, self.scatterer, times), np.zeros(len(self))
        for beside, image in zip(self.edges, images, strict=True):
            if beside is None:
                found += np.linalg.norm(image - centre, axis=1)
            else:
                room = EdgeView.of(np.eye(3)[None], np.zeros((1, 3)), beside.edge.frame)
                beyond, seen = room.places(image[:, None]), beside.view.places(centre[:, None])
                found += _Over.of(beside.edge, beyond, seen).length[:, 0]
        return found

    def alike(self) -> list[NDArray[np.int64]]:
        """Vertices whose paths are solved together."""
        return self.groups()

    def _columns(self, kinematics: Kinematics, links: Links, times: Floats) -> Columns:
        """Arrivals (P, T) over edges and by one scatterer: rates and amplitudes are those of the scatterer.

        At an edge after the scatterer frequencies are those that it sends.
        """
        retarded = kinematics.retarded
        chain = _solved(links, times, retarded)
        mach, coming, leaving, receding = chain.mach, chain.coming, chain.leaving, chain.receding
        rate, factor, ratio = receding + coming - leaving - mach, np.ones_like(mach), np.ones_like(mach)
        sent_on = ratio
        if retarded:
            rate = (receding * (1.0 - coming) + coming - mach - leaving * (1.0 - mach)) / ((1 - leaving) * (1 - mach))
            raised = 1.0 - coming if self.one.shape.shadows else 1.0
            factor = ((1.0 - mach) * (1.0 - leaving) / raised) ** -kinematics.exponent
            ratio = 1.0 / (1.0 - mach)
            sent_on = ratio * (1.0 - coming) / (1.0 - leaving)
        strength, delay = chain.strength, np.sum(chain.delays, axis=0)
        over_edges: Columns = {}
        for n, (over, length, at_edge) in enumerate(zip(chain.overs, chain.lengths, (ratio, sent_on), strict=True)):
            strength = strength / length
            if over is not None:
                strength = strength * over.length
                ends = np.moveaxis(over.end, 0, -1), np.moveaxis(over.seen, 0, -1)
                over_edges |= {f"end_{n}": ends[0], f"seen_{n}": ends[1], f"at_edge_{n}": at_edge}
                over_edges |= {f"towards_{n}": chain.towards[n]}
        return over_edges | {
            "delay": delay, "delay_rate": rate, "departure": chain.departure, "arrival": chain.arrival,
            "length": sum(chain.lengths), "through": sum(chain.lengths),
            "emission_time": times - delay if retarded else np.broadcast_to(times, delay.shape),
            "mach_factor": factor, "frequency_ratio": ratio, "strength": strength,
            "aspects": self._padded(chain.aspects),
            "event_time": np.broadcast_to(times - (chain.delays[1] if retarded else 0.0), delay.shape),
        }  # fmt: skip

    def respond(self, links: Links, found: Arrivals, times: Floats, passing: Any, at: SceneResponse) -> Any:
        """Responses (P, T, F) by the fields of edges and scatterers, and by what air and legs let pass, (P, T, F)."""
        more, wave = found.more, 2.0 * np.pi * at.frequencies / links.chain.scene.air.speed_of_sound
        response = passing * (found.mach_factor * more["strength"])[..., None].astype(np.complex128)
        for n, beside in enumerate(self.edges):
            if beside is not None:
                names = (f"end_{n}", f"seen_{n}") if n == 0 else (f"seen_{n}", f"end_{n}")
                sent, received = (np.moveaxis(more[name], -1, 0) for name in names)
                response *= beside.edge.static_field(sent, received, wave * more[f"at_edge_{n}"][..., None], at)
                response *= at.reflection(beside.walls)[:, None, :]
                at.apply_angular_walls(response, beside.walls, more[f"towards_{n}"])
        return self._sent_on(response, more, (wave, centre_of(links)))

    def largest(self, links: Links, at: SceneResponse) -> Floats:
        """Bounds (P, F) of what edges and scatterers send on, times the lengths of the paths."""
        loudest = [beside.edge.loudest for beside in self.edges if beside is not None]
        return np.asarray(np.prod(loudest) * ScattererVertex.largest(self, links, at))


@dataclass(frozen=True, slots=True, eq=False)
class ScattererEdgeVertex(EdgeScattererVertex):
    """Scatterers (P,) that P paths meet before an edge."""

    kind: ClassVar[str] = "scatterer edge"


@dataclass(frozen=True, slots=True, eq=False)
class EdgeScattererEdgeVertex(EdgeScattererVertex):
    """Scatterers (P,) that P paths meet between two edges."""

    kind: ClassVar[str] = "edge scatterer edge"


@dataclass(frozen=True, slots=True, eq=False)
class _Over:
    """Paths over edges between images of ends and centres of scatterers, (P, T), in the frames of the edges."""

    length: Floats  # m
    along: Floats  # where they meet the edges, m
    share: Floats  # distance of the end from there over that of the scatterer
    end: Floats  # (3, P, T) image of the end, m
    seen: Floats  # (3, P, T) the scatterer, m
    leaving: Floats  # (3, P, T) direction from the end to the edge

    @staticmethod
    def of(edge: EdgeVertex, end: Floats, seen: Floats) -> _Over:
        """Find the shortest ones over edges, or over their ends, between coordinates (3, P, T)."""
        end, seen = np.broadcast_arrays(end, seen)
        (r_s, z_s), (r_r, z_r) = ((np.maximum(np.hypot(x, y), ON_LINE), z) for x, y, z in (end, seen))
        fixed = edge.end_place[:, None]
        along = np.where(np.isnan(fixed), path_over_edge(r_s, z_s, r_r, z_r).apex, fixed)
        (leaving, one), (_, other) = towards_edge(end, along), towards_edge(seen, along)
        return _Over(one + other, along, one / np.maximum(other, ON_LINE), end, seen, leaving)

    @property
    def image(self) -> Floats:
        """Image (3, P, T) of the end: as far from the scatterer as the path is long, in the edge's direction, m."""
        return np.asarray(self._at_edge(self.along) * (1.0 + self.share) - self.share * self.seen)

    def image_velocity(self, edge: EdgeVertex, end: Floats, seen: Floats) -> Floats:
        """Velocity (3, P, T) of the image for those of the end and of the scatterer (3, P, T), m/s."""
        (r_s, slide_s), (r_r, slide_r) = (
            (r := np.maximum(np.hypot(x[0], x[1]), ON_LINE), (x[0] * v[0] + x[1] * v[1]) / r)
            for x, v in ((self.end, end), (self.seen, seen))
        )
        across, apart = r_s + r_r, self.seen[2] - self.end[2]
        slide = end[2] + (seen[2] - end[2]) * r_s / across + apart * (slide_s * r_r - r_s * slide_r) / across**2
        slide = np.where(np.isnan(edge.end_place)[:, None], slide, 0.0)
        rates = []
        for x, v in ((self.end, end), (self.seen, seen)):  # how fast distances from the place on the edge change
            away, drift = x - self._at_edge(self.along), v - self._at_edge(slide)
            distance = np.maximum(np.sqrt(np.sum(away**2, axis=0)), ON_LINE)
            rates.append(np.sum(away * drift, axis=0) / distance**2)
        change = self.share * (rates[0] - rates[1])
        return np.asarray(
            self._at_edge(slide) * (1.0 + self.share)
            - self.share * seen
            + change * (self._at_edge(self.along) - self.seen)
        )

    @staticmethod
    def _at_edge(along: Floats) -> Floats:
        return np.stack([np.zeros_like(along), np.zeros_like(along), along])


@dataclass(frozen=True, slots=True, eq=False)
class _SolvedPath:
    """Sound over an edge and by one scatterer (P, T)."""

    delays: Floats  # (2, P, T) to the scatterer, and from there, s
    lengths: tuple[Floats, Floats]  # likewise, m
    overs: tuple[_Over | None, _Over | None]
    towards: tuple[Any, Any]  # directions (P, T, 3) of these from the scatterer
    departure: Floats  # (P, T, 3)
    arrival: Floats  # likewise
    place: Floats  # (P, T, 3) of the scatterer, m
    mach: Floats  # numbers, as in `Way`
    coming: Floats
    leaving: Floats
    receding: Floats  # of the receiver
    strength: Floats
    aspects: Floats


@dataclass(frozen=True, slots=True, eq=False)
class _Image:
    """Image of an end (P, T, 3), m, and its velocities by the end's motion and by the scatterer's, m/s."""

    place: Floats
    by_end: Floats
    by_scatterer: Floats | float
    over: _Over | None  # the path over the edge, if any
    towards: Floats | None  # (P, T, 3) direction of that from the scatterer


class _Sides:
    """Both ends as scatterers see them, by a static leg alone or over an edge."""

    def __init__(self, links: Links, times: Floats) -> None:
        self._edges, self._legs = links.vertex.edges, links.legs
        self._centre, (self._source, receiver) = links.vertex.one.trajectory, links.motions
        self._receiver_at = receiver.position(times)[None], receiver.velocity(times)[None]
        self._views = [
            beside and (EdgeView.of(leg.matrix, leg.offset, beside.edge.frame), beside.view)
            for beside, leg in zip(self._edges, self._legs, strict=True)
        ]

    def images(self, emitted: Floats, events: Floats) -> tuple[_Image, _Image]:
        """Images of source and receiver at times (P, T) of emission and of scattering, s."""
        centre = self._centre.position(events), self._centre.velocity(events)
        sent = self._source.position(emitted), self._source.velocity(emitted)
        return self._image(0, sent, centre), self._image(1, self._receiver_at, centre)

    def _image(self, n: int, end: Pair, centre: Pair) -> _Image:
        """Image of one end, from places and velocities of it and of the scatterer."""
        beside, leg = self._edges[n], self._legs[n]
        if beside is None:
            return _Image(leg.image(end[0]), leg.turned(end[1]), 0.0, None, None)
        (beyond, here), edge = self._views[n], beside.edge
        over = _Over.of(edge, beyond.places(end[0]), here.places(centre[0]))
        moves = beyond.directions(end[1]), here.directions(centre[1])
        by_end = over.image_velocity(edge, moves[0], 0.0 * moves[1])
        by_centre = over.image_velocity(edge, 0.0 * moves[0], moves[1])
        place = centre[0] + here.back(over.image - over.seen)
        towards = here.back(towards_edge(over.seen, over.along)[0])
        return _Image(place, here.back(by_end), here.back(by_centre), over, towards)

    def leaving(self, n: int, image: _Image, direction: Floats) -> Floats:
        """Directions (P, T, 3) in which paths leave an end, which the scatterer sees in a direction from there."""
        if image.over is None:
            return np.asarray(self._legs[n].turned_back(direction))
        return np.asarray(self._views[n][0].back(image.over.leaving))


def _solved(links: Links, times: Floats, retarded: bool) -> _SolvedPath:
    """Find the events (P, T) of sound that is received at times (T,), s, by Newton's method, the later one first."""
    scatterer, sides = links.vertex.one, _Sides(links, times)
    speed = float(links.chain.scene.air.speed_of_sound)
    body, shape = Body(scatterer), (len(links), len(times))
    now, delays, weight = np.broadcast_to(times, shape), np.zeros((2, *shape)), 1.0
    for done in range(_ROUNDS):
        event = now - delays[1] if retarded else now
        source, receiver = sides.images(event - delays[0] if retarded else now, event)
        place, velocity = body.seen(event, source.place, receiver.place, weight, done >= PATIENCE)
        (first, coming_to), (second, onwards) = straight(source.place, place), straight(place, receiver.place)
        mach, coming, leaving, receding = (
            np.sum(n * v, axis=-1) / speed
            for n, v in (
                (coming_to, source.by_end), (coming_to, velocity - source.by_scatterer),
                (onwards, velocity - receiver.by_scatterer), (onwards, receiver.by_end),
            )
        )  # fmt: skip
        change = np.stack([first, second]) / speed - delays
        if retarded:
            weight = (1.0 - coming) / (1.0 - leaving)
            change[1] = change[1] / (1.0 - leaving)
            change[0] = (change[0] + change[1] * (mach - coming)) / (1.0 - mach)
        delays = delays + change
        if done and body.change <= _CONVERGED and np.abs(change).max(initial=0.0) <= _CLOSE:
            departure, arrival = sides.leaving(0, source, coming_to), sides.leaving(1, receiver, -onwards)
            return _SolvedPath(
                delays, (first, second), (source.over, receiver.over), (source.towards, receiver.towards), departure,
                arrival, place, mach, coming, leaving, receding, *body.strength(shape),
            )  # fmt: skip
    raise unseen(f"the edges of its paths, but no path by {scatterer.name!r}", times)
