"""Paths as chains of legs and vertices: the one family of all that clsim finds, see ``family.py``.

The support matrix tells which paths are possible in which medium, and whether a device or the host makes their nodes.
Refusals, the choice of device or host, and the table of ``docs/limitations.md`` are made from it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any, Self

import numpy as np

from clsim.arrays import Complexes, Floats, read_only
from clsim.errors import InputError
from clsim.paths.fades import Fades
from clsim.paths.family import (
    DIFFRACTION,
    TRANSMISSION,
    Instant,
    Integers,
    Links,
    PathFamily,
    PeakSpeeds,
    Rows,
    ends_at,
)
from clsim.paths.response import RETARDED, Arrivals, Kinematics, SceneResponse
from clsim.scene.air import Air
from clsim.scene.scene import Scene

_ROUNDS = 4  # of finding the time of emission
DEVICE, HOST, REFUSED = "device", "host", "refused"
MEDIA = ("still air", "wind", "air by height", "fluctuating air")


@dataclass(frozen=True, slots=True)
class Support:
    """Support of chains of one kind of leg and vertex."""

    paths: str  # the paths, in words
    where: tuple[str, str, str, str]  # in each of `MEDIA`: `DEVICE`, `HOST` or `REFUSED`
    program: str | None = None  # name of the columns of a device's program of nodes
    refusal: tuple[str, str] | None = None  # field and rule of the error where a medium is refused


_BODIES = ("bodies", "must be left out where the air depends on the height or fluctuates")
_SCATTERERS = ("scatterers", "must be left out where the air depends on the height or fluctuates")
_TWO_EDGES = ("diffraction", "must be at most 1 where the air depends on the height or fluctuates, but is 2 or 3")
_TWO_SCATTERERS = ("scatterers_in_row", "must be 1 where the air moves, depends on the height or fluctuates, but is 2")
_EDGE_AND_SCATTERER = ("edge_scattering", "must be false where the air moves, depends on the height or fluctuates")
_BEHIND_BODIES = HOST, HOST, REFUSED, REFUSED
_IN_STILL_AIR = HOST, REFUSED, REFUSED, REFUSED
SUPPORT = {  # by `Chain.kind`
    "static": Support("reflections, straight through panels too", (DEVICE, DEVICE, HOST, HOST), "images"),
    "static edge": Support("one edge", (DEVICE, HOST, HOST, HOST), "edges"),
    "static exact edge": Support('one edge, `diffraction_model="btm"`', (HOST, HOST, HOST, HOST)),
    "static edge pair": Support("two edges of one face", _BEHIND_BODIES, refusal=_TWO_EDGES),
    "static edge gap": Support("two edges with air between", _BEHIND_BODIES, refusal=_TWO_EDGES),
    "static edge and end": Support("an edge and an end of another", _BEHIND_BODIES, refusal=_TWO_EDGES),
    "static three edges": Support("three edges of one object", _BEHIND_BODIES, refusal=_TWO_EDGES),
    "static scatterer": Support("a scatterer", (DEVICE, DEVICE, REFUSED, REFUSED), "scatterers", _SCATTERERS),
    "static scatterer pair": Support("two scatterers", _IN_STILL_AIR, refusal=_TWO_SCATTERERS),
    "static edge scatterer": Support("an edge and a scatterer", _IN_STILL_AIR, refusal=_EDGE_AND_SCATTERER),
    "static scatterer edge": Support("a scatterer and an edge", _IN_STILL_AIR, refusal=_EDGE_AND_SCATTERER),
    "static edge scatterer edge": Support(
        "an edge, a scatterer and an edge", _IN_STILL_AIR, refusal=_EDGE_AND_SCATTERER
    ),
    "static shade": Support("shadows on reflections", (DEVICE, DEVICE, REFUSED, REFUSED), "shades", _SCATTERERS),
    "moving": Support("bodies", (DEVICE, DEVICE, REFUSED, REFUSED), "bodies", _BODIES),
    "moving edge": Support("bodies and an edge", _BEHIND_BODIES, refusal=_BODIES),
    "moving exact edge": Support('bodies and an edge, `diffraction_model="btm"`', _BEHIND_BODIES, refusal=_BODIES),
    "moving edge pair": Support("bodies and two edges of one face", _BEHIND_BODIES, refusal=_BODIES),
    "moving edge gap": Support("bodies and two edges with air between", _BEHIND_BODIES, refusal=_BODIES),
    "moving edge and end": Support("bodies, an edge and an end of another", _BEHIND_BODIES, refusal=_BODIES),
    "moving scatterer": Support("bodies and a scatterer", _BEHIND_BODIES, refusal=_BODIES),
}
# Names under which runs know chains, by kind of legs and of vertex.
_IDENTITIES = {
    "static": "specular.family.SpecularPaths",
    "static edge": "diffraction.family.EdgePaths",
    "static exact edge": "diffraction.exact.ExactEdgePaths",
    "static edge pair": "diffraction.double.DoubleEdgePaths",
    "static edge gap": "vertices.gap_pair.GapPaths",
    "static edge and end": "vertices.edge_end.EdgeEndPaths",
    "static three edges": "vertices.edge_third.ThirdEdgePaths",
    "static scatterer": "scattering.family.ScatteredPaths",
    "static edge scatterer": "vertices.edge_scatterer.EdgeScattererPaths",
    "static scatterer edge": "vertices.edge_scatterer.ScattererEdgePaths",
    "static edge scatterer edge": "vertices.edge_scatterer.EdgeScattererEdgePaths",
    "static scatterer pair": "vertices.scatterer_pair.ScattererPairPaths",
    "static shade": "vertices.shade.ShadedPaths",
    "moving": "moving.family.BodyPaths",
    "moving edge": "moving.edge_family.MovingEdgePaths",
    "moving exact edge": "moving.edge_family.MovingEdgePaths",
    "moving edge pair": "moving.edge_family.MovingEdgePairPaths",
    "moving edge gap": "vertices.gap_pair.MovingGapPaths",
    "moving edge and end": "vertices.edge_end.MovingEdgeEndPaths",
    "moving scatterer": "moving.scattered.BodyScatteredPaths",
}


def media_of(air: Air) -> tuple[str, ...]:
    """List which of `MEDIA` an air is: more than one where wind, heights and fluctuations come together."""
    found = air.wind is not None, bool(air.layers), air.fluctuation is not None
    return tuple(name for name, there in zip(MEDIA[1:], found, strict=True) if there) or MEDIA[:1]


def support(kind: str, air: Air) -> str:
    """Give the least support that a kind of chains has in the media of an air: `DEVICE`, `HOST` or `REFUSED`."""
    row = dict(zip(MEDIA, SUPPORT[kind].where, strict=True))
    return max((row[medium] for medium in media_of(air)), key=(DEVICE, HOST, REFUSED).index)


def check_support(kind: str, air: Air) -> None:
    """Refuse a kind of chains where the medium does not support it, with field and rule of the matrix."""
    refusal = SUPPORT[kind].refusal
    if refusal is not None and support(kind, air) == REFUSED:
        raise InputError(*refusal)


def program_of(kind: str, air: Air) -> str | None:
    """Name the device's program of nodes for a kind of chains; None where the host makes them."""
    return SUPPORT[kind].program if support(kind, air) == DEVICE else None


@dataclass(frozen=True, eq=False)
class Chain(PathFamily):
    """Paths of one kind of leg and of one kind of vertex."""

    legs: tuple[Any, ...]  # one before and one after the vertex, or a single one
    vertex: Any = None  # None for paths that are only reflected; a shadow has a single leg
    level: Floats | None = None  # (paths,) pressure over that of the path's law; None for 1
    fades: Fades | None = None  # of paths over edges; None where none may fade

    @property
    def kind(self) -> str:
        """Kinds of leg and of vertex, in words."""
        return self.legs[0].kind if self.vertex is None else f"{self.legs[0].kind} {self.vertex.kind}"

    @property
    def identity(self) -> str:
        """Name of the kind, by which runs are resumed."""
        leaks = self.level is not None
        return f"clsim.paths.{'specular.cross_talk.CrossTalk' if leaks else _IDENTITIES[self.kind]}"

    def hashed(self) -> Iterator[tuple[str, Any]]:
        """Yield names and values of all columns."""
        for field in fields(PathFamily)[1:]:
            yield field.name, getattr(self, field.name)
        moving = self.legs[0].moving
        alone = ("surfaces",) if moving else ("image",)
        for leg, name in zip(self.legs, alone if len(self.legs) == 1 else ("before", "after"), strict=True):
            yield from leg.named(name)
        if self.vertex is not None:
            yield from self.vertex.named(moving)
        if self.level is not None:
            yield "level", self.level
        if self.fades is not None and self.fades.share.any():
            of = self.fades.columns
            yield from ((f"fade_{field.name}", getattr(of, field.name)) for field in fields(of))

    @property
    def is_specular(self) -> bool:
        """Whether paths are images: reflected by surfaces at rest, and nothing else."""
        return self.kind == "static"

    @property
    def moves(self) -> bool:
        """Whether paths change though both ends rest."""
        bodies = self.legs[0].moving and not all(body.is_static for body in self.scene.bodies)
        return bodies or (self.vertex is not None and self.vertex.moves) or self.scene.air.fluctuation is not None

    @property
    def varies(self) -> bool:
        """Whether the response of a path changes over a run so much that a few instants do not tell of all."""
        return self.vertex is not None and self.vertex.varies

    @property
    def one_by_one(self) -> bool:
        """Whether `response` takes an instant of its own for each path."""
        return self.vertex is None or self.vertex.one_by_one

    @property
    def costly(self) -> bool:
        """Whether responses are taken at few instants where they change slowly."""
        return self.vertex is not None and self.vertex.costly

    @property
    def is_complex(self) -> bool:
        """Whether responses have phases."""
        return (self.vertex is not None and self.vertex.is_complex) or super().is_complex

    @property
    def device(self) -> str | None:
        """Program that makes nodes of these paths on a device; None for the host."""
        if self.level is not None or (self.vertex is not None and not self.vertex.on_device):
            return None
        if self.scene.panels and self.vertex is not None and self.vertex.interaction == DIFFRACTION:
            return None  # the program does not know sheets that let sound pass
        return program_of(self.kind, self.scene.air)

    @property
    def object_names(self) -> tuple[str, ...]:
        """Names of faces of bodies, and of what is met at vertices."""
        moving = self.legs[0].moving
        faces = (name for body in self.scene.bodies for name in body.faces) if moving else ()
        return (*faces, *(() if self.vertex is None else self.vertex.names))

    @property
    def walls(self) -> Integers:
        """Walls (paths, N) from the source's side, -1 for what is none."""
        return self.objects if self.kind == "static" and not self.passes else super().walls

    @cached_property
    def passes(self) -> bool:
        """Whether any path goes straight through a panel."""
        return bool(self.scene.panels) and bool(np.any(self.interactions == TRANSMISSION))

    @cached_property
    def surfaces(self) -> Integers:
        """Walls (paths, N) as numbers of the scene's materials, the latter half of which are for sound that passes."""
        if not self.passes:
            return self.walls
        return np.where(self.interactions == TRANSMISSION, self.objects + len(self.scene.materials) // 2, self.walls)

    def arrivals(self, rows: Rows, times: Floats, kinematics: Kinematics = RETARDED) -> Arrivals:
        """Return delays, directions and lengths of paths between one source and one receiver."""
        return self.links(rows).solve(np.asarray(times, dtype=np.float64), kinematics)

    def response(self, rows: Rows, found: Arrivals, times: Floats, at: SceneResponse) -> Floats | Complexes:
        """Return received over emitted pressure (P, T, F): legs, vertex, spreading, air, directivities."""
        links = self.links(rows)
        vertex, response = links.vertex, at.air(found)
        if vertex is None or self.legs[0].moving:
            factors = at.reflection(links.all_surfaces)[:, None, :]
            response = np.multiply(response, factors, out=response if response.dtype == at.dtype else None)
        if vertex is None:
            response *= (found.mach_factor / found.length)[..., None]
        else:
            response = vertex.respond(links, found, times, response, at)
        if self.legs[0].moving:
            at.apply_angles(response, links.all_surfaces, found.more["cosine"])
        else:
            for walls, direction in zip(links.surfaces, (found.departure, found.arrival), strict=False):
                if vertex is not None:
                    response *= at.reflection(walls)[:, None, :]
                at.apply_angular_walls(response, walls, direction)
        at.apply_directivities(response, links.ends, found, times)
        if self.fades is not None:
            response = response * self.fades.part(rows).gain(found, times)[..., None]
        return response if self.level is None else response * self.level[rows][:, None, None]

    @property
    def adds(self) -> bool:
        """Whether paths are shadows on others."""
        return self.kind == "static shade"

    @property
    def silent_ends(self) -> bool:
        """Whether paths are shadows that begin and end where they take nothing away."""
        return self.adds and self.vertex.silent_ends

    def unshaded(self, rows: Rows, found: Arrivals, times: Floats, at: SceneResponse) -> Floats | Complexes:
        """Return responses (P, T, F) of paths, of those in a shadow as without it."""
        return (replace(self, vertex=None) if self.adds else self).response(rows, found, times, at)

    def vertices(self, rows: Rows, time: float, kinematics: Kinematics = RETARDED) -> Floats:
        """Return source, points of interaction and receiver (P, N + 2, 3) of paths of one pair."""
        return self.links(rows).places(time, kinematics)

    def lengths(self, rows: Rows, source: Floats, receiver: Floats) -> Floats:
        """Return lengths (P,) between endpoints at places (P, 3), m, by bodies and scatterers as they are at 0 s."""
        return self.links(rows).lengths(source, receiver, 0.0)

    def delays(self, rows: Rows, times: Floats) -> Floats:
        """Return the delays (n,) of rows at times (n,), s, as near as tells whether two are the same."""
        scene, source, delay = self.scene, self.source[rows], np.zeros(len(times))
        receiver = ends_at(scene.receivers, self.receiver[rows], times)
        for _ in range(_ROUNDS):
            sent = ends_at(scene.sources, source, times - delay)
            delay = self.lengths(rows, sent, receiver) / scene.air.speed_of_sound
        return delay

    @cached_property
    def speeds(self) -> Floats:
        """Sums (paths,) of bounds of the speeds of what moves on a path, by which its length changes twice, m/s."""
        moving, vertex = self.legs[0].moving, self.vertex
        at_vertex = np.zeros(len(self)) if vertex is None else vertex.speeds(moving)
        if not moving:
            return read_only(at_vertex)
        return read_only(self.legs[0].mirrors.speeds(self.links(slice(None)).all_surfaces) + at_vertex)

    def delay_bounds(self, rows: Rows, start: Instant, end: Instant, speeds: PeakSpeeds) -> tuple[Floats, Floats]:
        """Return bounds (P,) on the delays of paths of any pairs between two times of reception, s.

        A mirror, an edge or a scatterer that moves by d makes a path longer by at most 2 d. The path by a scatterer's
        surface is shorter than that by its centre, by at most its diameter.
        """
        scene, links = self.scene, self.links(rows)
        source, receiver = self.source[rows], self.receiver[rows]
        middle, half = 0.5 * (start + end), 0.5 * (end - start)
        places = ends_at(scene.sources, source, middle), ends_at(scene.receivers, receiver, middle)
        spare: Floats | float = 0.0 if links.vertex is None else links.vertex.radius
        emitting = speeds.source[source] + 2.0 * self.speeds[rows]
        slack = half * (emitting + speeds.receiver[receiver]) + spare
        length = links.lengths(*places, middle) - spare
        return self.speed_range.delay_bounds(length, slack, emitting)

    def max_rate(self, source_speed: float, receiver_speed: float) -> float:
        """Return a bound on how fast delays change with the time of reception, s/s, from the ends' speeds, m/s."""
        if self.legs[0].moving:
            most = float(self.speeds.max(initial=0.0))
        elif self.vertex is None or self.vertex.swiftest is None:
            return super().max_rate(source_speed, receiver_speed)
        else:
            most = self.vertex.swiftest
        c = self.speed_range.slowest
        return (c + receiver_speed) * (c + most) / ((c - most) * (c - source_speed)) - 1.0

    def gain_bound(self, rows: Rows, at: SceneResponse) -> Floats:
        """Return bounds (P, F) of responses without directivities, relative to free air of the same length."""
        links = self.links(rows)
        bound = at.largest_reflection(links.all_surfaces)
        if links.vertex is not None:
            bound = links.vertex.largest(links, at) * bound
        if self.fades is not None:
            bound = bound * self.fades.part(rows).largest[:, None]
        return bound if self.level is None else bound * self.level[rows][:, None]

    def fading(self, rows: Rows) -> Iterator[tuple[str, Any]]:
        """Yield names and columns of the fades of some paths over one edge, as `edge_view` of kernels/nodes/path.h."""
        if self.fades is not None:
            of = self.fades.columns[rows]
            yield "moment", of.moment
            yield "slip", of.sent / self.scene.air.speed_of_sound
            yield "span", np.where(of.share.any(axis=1, keepdims=True), of.span, 0.0)
            yield "share", np.stack([of.share.real, of.share.imag], axis=1)

    def links(self, rows: Rows) -> Links:
        """Take the legs and vertices of some paths."""
        vertex = None if self.vertex is None else self.vertex.part(rows)
        legs = tuple(leg.part(rows) for leg in self.legs)
        pairs = zip(self.source[rows][:1], self.receiver[rows][:1], strict=True)
        ends = tuple(end for s, r in pairs for end in (self.scene.sources[s], self.scene.receivers[r]))
        made: Links = legs[0].links(self, rows, legs, vertex, ends, tuple(end.trajectory for end in ends))
        return made

    def in_scene(self, scene: Scene) -> Self:
        """Return the same paths, by the same surfaces and vertices, in a scene that differs a little."""
        met = self.links(slice(None)).surfaces
        legs = tuple(leg.in_scene(scene, walls) for leg, walls in zip(self.legs, met, strict=True))
        vertex = None if self.vertex is None else self.vertex.in_scene(scene)
        return replace(self, scene=scene, legs=legs, vertex=vertex)

    def part(self, rows: Rows) -> Self:
        """Return some of the paths."""
        columns: dict[str, Any] = {field.name: getattr(self, field.name)[rows] for field in fields(PathFamily)[1:]}
        links, level = self.links(rows), None if self.level is None else self.level[rows]
        fades = None if self.fades is None else self.fades.part(rows)
        return replace(self, **columns, legs=links.legs, vertex=links.vertex, level=level, fades=fades)

    def check(self) -> None:
        """Refuse columns, legs and vertices with another number of rows than paths."""
        super().check()
        for part in (*self.legs, self.vertex, self.level, self.fades):
            if part is not None and len(part) != len(self):
                name = type(part).__name__
                raise InputError("legs", f"must have one row per path, {len(self)}, but {name} has {len(part)}")
