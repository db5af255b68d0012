"""Columns of paths as the programs of nodes take them, by leg and vertex."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.acoustics import fock, silhouette
from clsim.acoustics.diffraction import adjacent_reflections
from clsim.acoustics.outline import Outline, most_points, steps_of_points
from clsim.acoustics.sphere import sphere_modes
from clsim.arrays import Floats
from clsim.errors import InputError
from clsim.paths.cubics import face_knots, face_rate, pose_knots, pose_rate
from clsim.paths.family import Links, Rows
from clsim.paths.legs.mirrors import ROOM
from clsim.paths.response import Walls
from clsim.paths.vertices.edge_field import least_angle
from clsim.render.opencl.environment import Environment, end_table, field_tables, transition_table
from clsim.render.opencl.node_constants import (
    CAPSULE,
    EDGE,
    EDGE_VIEW,
    END_CELLS,
    MIRROR_VIEW,
    MOVING,
    NO_PATH,
    NONE,
    SCATTERER,
    SCATTERER_VIEW,
    SHADE,
    SHADE_VIEW,
    SHAPES,
    SPHERE,
    STATIC,
)
from clsim.render.plan import Plan
from clsim.tracks.basis import Basis
from clsim.tracks.tracks import SceneTracks

Bounces = tuple[NDArray[np.int32], NDArray[np.float32]]  # see `Environment.bounces`

_FACE_SHARE = 0.1  # of a source's allowed error: a mirror's error displaces images twice as far, and each mirror adds


@dataclass(frozen=True, slots=True, eq=False)
class Rendered:
    """What columns are made from: the plan, the paths of one family, tables by source, and an upload to the device."""

    plan: Plan
    tracks: SceneTracks
    family: Any
    environments: list[Environment]
    together: int  # nodes, or points of an outline, that are worked on side by side
    put: Callable[[NDArray[Any]], Any]

    def uploaded(self, **columns: NDArray[Any]) -> dict[str, Any]:
        return {name: self.put(column) for name, column in columns.items()}

    def tolerance(self, speed: float) -> float:
        """Convert the allowed error of the phase at the end of the band to a length, m, by the speed of sound, m/s."""
        swiftest = max(filters.swiftness for filters in self.plan.source_filters)
        return float(10 ** (self.plan.motion_error_db / 20) * speed / (2.0 * math.pi * swiftest))


@dataclass(eq=False)
class StaticColumns:
    """Columns of paths by one static leg: images."""

    _of: Rendered

    leg, vertex, mirrors = STATIC, NONE, 0
    state_numbers = 0  # of the state that goes with a delay, see kernels/nodes/path.h
    known_at = 1  # frequencies at which the strength of an outline's points is known

    @property
    def _family(self) -> Any:
        return self._of.family

    @property
    def constants(self) -> dict[str, int]:
        return {"LEG": self.leg, "VERTEX": self.vertex, "MIRRORS": self.mirrors}

    def met(self, rows: Rows) -> Walls:
        """Reflecting walls of paths, as rows of the scene's materials (P, N), -1 for none."""
        return np.asarray(self._family.surfaces[rows])

    def views(self, source: int, rows: NDArray[np.int64]) -> dict[str, Any]:
        """Images of paths (slots,) and what their leg and vertex add, as arguments of programs."""
        image = self._family.legs[0].part(rows)
        columns = {"image_matrix": image.matrix.reshape(-1, 9).T, "image_offset": image.offset.T}
        return self._of.uploaded(**columns) | {"views": None}

    def reflection(self, source: int, rows: NDArray[np.int64]) -> Floats:
        """Factors (slots, parts, nodes) of walls that are the same at every angle."""
        return self._of.environments[source].reflection(self.met(rows))

    def bounces(self, source: int, rows: NDArray[np.int64]) -> Bounces:
        """Walls of paths (slots,) whose factor depends on the angle."""
        return self._of.environments[source].bounces(self.met(rows))

    def field(self, source: int, rows: NDArray[np.int64]) -> dict[str, Any]:
        """Tables of the vertex's field of paths (slots,)."""
        return {"field_tables": None, "faces": None, "middle": 0.0, "modes": None}

    def poses(self, start: float, end: float) -> dict[str, Any]:
        """Poses of scatterers or faces that paths meet between two times, s."""
        return {"poses": None, "pose_cells": None, "pose_count": 0, "first_pose": 0.0, "pose_rate": 0.0}

    def check(self, shortest: float, start: float, end: float) -> None:
        """Refuse delays that report that a path was not found between two times, s."""


class VertexColumns(StaticColumns):
    """Columns of paths by one vertex between static legs, made once for a source: every chunk takes some of them."""

    def __init__(self, of: Rendered) -> None:
        super().__init__(of)
        self._known: dict[int, tuple[NDArray[np.int64], dict[str, NDArray[Any]]]] = {}

    def _made(self, source: int, links: Links) -> dict[str, NDArray[Any]]:
        """Make the vertices of paths as both ends are seen from them, "views", and what else vertices have (P, ...)."""
        raise NotImplementedError

    def _column(self, name: str, source: int, rows: NDArray[np.int64]) -> NDArray[Any]:
        """Take a column of some of a source's paths."""
        if source not in self._known:
            mine = np.flatnonzero(self._family.source == source)
            links, reflection = self._family.links(mine), super().reflection(source, mine)
            wall_of, normal = self._of.environments[source].bounces_of_sides(*links.surfaces)
            columns = self._made(source, links) | {"wall_of": wall_of.T, "normal": np.moveaxis(normal, 2, 0)}
            self._known[source] = mine, columns | {"reflection": reflection}
        mine, made = self._known[source]
        return made[name][np.searchsorted(mine, rows)]

    def views(self, source: int, rows: NDArray[np.int64]) -> dict[str, Any]:
        image = {"image_matrix": None, "image_offset": None}
        return self._of.uploaded(views=self._column("views", source, rows)) | image

    def reflection(self, source: int, rows: NDArray[np.int64]) -> Floats:
        return self._column("reflection", source, rows)

    def bounces(self, source: int, rows: NDArray[np.int64]) -> Bounces:
        """Walls of both sides whose factor depends on the angle."""
        wall_of, normal = (self._column(name, source, rows) for name in ("wall_of", "normal"))
        return wall_of.T, np.moveaxis(normal, 0, 2)


class EdgeColumns(VertexColumns):
    """Columns of paths over one edge: both sides' isometries and the edge's axes."""

    vertex = EDGE

    def __init__(self, of: Rendered) -> None:
        super().__init__(of)
        self._transitions = [self._tables(filters.basis) for filters in of.plan.source_filters]

    def _tables(self, basis: Basis) -> dict[str, Any]:
        """Tables of the transition functions of edges and of their ends at the frequencies of a basis."""
        waves = basis.nodes / self._of.tracks.paths.scene.air.speed_of_sound
        table, middle = transition_table(waves, basis.parts)
        if np.any(self._family.vertex.end_side):  # costly, and read at ends of edges only
            table = np.concatenate([table, end_table(waves, basis.parts, middle, END_CELLS)])
        return self._of.uploaded(field_tables=field_tables(waves, table)) | {"middle": middle, "modes": None}

    def _made(self, source: int, links: Links) -> dict[str, NDArray[Any]]:
        """Make edges as both ends are seen from them, and factors of faces that are the same at every angle."""
        vertex, edges = links.vertex, np.zeros(len(links.vertex), dtype=EDGE_VIEW)
        for end, view in zip(("source", "receiver"), vertex.views(links), strict=True):
            edges[f"{end}_turn"], edges[f"{end}_shift"] = view.turn.reshape(-1, 9), view.shift
        own = [(name, getattr(vertex, name)) for name in ("n", "lit", "end_side", "corner")]
        for name, column in (*own, *self._family.fading(self._family.source == source)):
            edges[name] = column
        half_turns, edges["bounces"] = np.pi * edges["n"], adjacent_reflections(edges["n"])[:, 1:3]
        even, odd = (half_turns * (count // 2) for count in edges["bounces"].T)
        angles = {"wide": half_turns, "narrow": 0.5 * np.pi / edges["n"], "even": even, "odd": odd}
        for name, angle in angles.items():
            edges[name] = np.stack([np.sin(angle), np.cos(angle)], axis=1)
        edges["low"] = np.stack([least_angle(vertex.n, beside) for beside in vertex.beside.T], axis=1)
        env = self._of.environments[source]
        edges["end"], edges["face"] = np.nan_to_num(vertex.end_place), env.tables_of(vertex.faces)
        factors = env.reflection(vertex.faces.reshape(-1, 1)).astype(np.float32)
        return {"views": edges, "faces": factors.reshape(len(edges), 2, *factors.shape[1:])}

    def field(self, source: int, rows: NDArray[np.int64]) -> dict[str, Any]:
        return self._transitions[source] | self._of.uploaded(faces=self._column("faces", source, rows))


class _Posed(StaticColumns):
    """Columns of paths whose sound depends on where scatterers are: their poses."""

    def __init__(self, of: Rendered) -> None:
        super().__init__(of)
        scatterers = of.tracks.paths.scene.scatterers
        self._motions = tuple(scatterer.trajectory for scatterer in scatterers)
        radii = tuple(scatterer.shape.radius for scatterer in scatterers)
        # Either leg changes by as much as a scatterer moves.
        tolerance = 0.25 * of.tolerance(of.tracks.paths.scene.air.speed_of_sound)
        self._pose_rate = pose_rate(self._motions, radii, of.plan.duration, tolerance)
        self._turned = [motion.has_orientation and r > 0.0 for motion, r in zip(self._motions, radii, strict=True)]

    def _waves(self, basis: Basis) -> Floats:
        """Waves in a metre at the frequencies of a basis."""
        return np.asarray(basis.nodes / self._of.tracks.paths.scene.air.speed_of_sound)

    def _centre(self, source: int) -> float:
        """Waves in a metre in the middle of the band of a source's signal."""
        scene = self._of.tracks.paths.scene
        return float(scene.sources[source].emitted.centre_frequency / scene.air.speed_of_sound)

    def poses(self, start: float, end: float) -> dict[str, Any]:
        knots, cells, first = pose_knots(self._motions, start, end, self._pose_rate)
        count = {"pose_count": cells.shape[1] - 1, "first_pose": first, "pose_rate": self._pose_rate}
        return self._of.uploaded(poses=knots, pose_cells=cells) | count


class ScattererColumns(_Posed, VertexColumns):
    """Columns of paths by a scatterer: both sides' isometries, and poses and shapes of scatterers."""

    vertex, state_numbers = SCATTERER, 6

    def __init__(self, of: Rendered) -> None:
        super().__init__(of)
        scatterers = of.tracks.paths.scene.scatterers
        of_shape = np.zeros(len(scatterers), dtype=SCATTERER_VIEW)
        for row, scatterer in zip(of_shape, scatterers, strict=True):
            shape = scatterer.shape
            row["shape"], row["strength"] = SHAPES[shape.kind], getattr(shape, "strongest", 0.0)
            row["semi_axes"], row["modes"] = shape.semi_axes, int(shape.outlined)
        of_shape["thing"], of_shape["turned"] = np.arange(len(scatterers)), self._turned
        self._shapes = [of_shape.copy() for _ in of.plan.source_filters]
        for source, views in enumerate(self._shapes):
            views["strength"] = np.where(of_shape["modes"] > 0, self._centre(source), of_shape["strength"])
        self._fields = [self._tables(v, f.basis) for v, f in zip(self._shapes, of.plan.source_filters, strict=True)]

    def _tables(self, views: NDArray[Any], basis: Basis) -> dict[str, Any]:
        """Tables of ellipsoids, capsules and spheres; views are given the places where those of spheres begin."""
        outlined = bool(views["modes"].any())
        if views["shape"].max() < CAPSULE and not outlined:
            return {}
        waves = self._waves(basis)
        table, middle = transition_table(waves, basis.parts)
        parts = _fock_tables() if outlined else []  # reflection near grazing incidence is found at the beginning
        for view in np.flatnonzero(views["shape"] == SPHERE):
            modes = sphere_modes(tuple((2.0 * np.pi * waves * views["semi_axes"][view, 0]).tolist()))
            factors = np.stack([modes.step, modes.back, modes.weight.real, modes.weight.imag], axis=1)
            views["first_mode"][view] = sum(part.size for part in parts)
            views["modes"][view], views["least"][view] = len(factors), math.ceil(float(modes.ka.max()))
            parts += [modes.ka, factors.ravel()]
        known = np.concatenate(parts) if parts else np.zeros(0)
        found = self._of.uploaded(field_tables=field_tables(waves, table))
        return found | {"middle": middle, "modes": self._of.put(known) if known.size else None}

    def _made(self, source: int, links: Links) -> dict[str, NDArray[Any]]:
        views = self._shapes[source][links.vertex.scatterer]
        for end, leg in zip(("source", "receiver"), links.legs, strict=True):
            views[f"{end}_turn"], views[f"{end}_shift"] = leg.matrix.reshape(-1, 9), leg.offset
        return {"views": views}

    def field(self, source: int, rows: NDArray[np.int64]) -> dict[str, Any]:
        return super().field(source, rows) | self._fields[source]

    def check(self, shortest: float, start: float, end: float) -> None:
        """Refuse scatterers that are between both ends, or in them."""
        if shortest < 0.5 * NO_PATH:  # less a clock's error
            raise InputError(
                "scatterers",
                f"must be seen from both ends, but no way by one of them was found from {start:.6g} to {end:.6g} s",
            )


class ShadeColumns(_Posed):
    """Columns of shadows on paths by walls: images, their parts between walls, and poses and outlines of bodies."""

    vertex = SHADE

    def __init__(self, of: Rendered) -> None:
        super().__init__(of)
        self._tables = [
            self._of_basis(filters.basis) | {"middle": self._centre(source)}
            for source, filters in enumerate(of.plan.source_filters)
        ]

    def _of_basis(self, basis: Basis) -> dict[str, Any]:
        """Tables of Fock's functions, of bodies, of parts of paths and of points of outlines, see ``shade.h``."""
        waves, vertex = self._waves(basis), self._family.vertex
        self.known_at = max(self.known_at, silhouette.known_at(np.cbrt(np.pi * waves)))
        things = [i for i, scatterer in enumerate(vertex.scatterers) if scatterer.shape.outlined]
        casters, parts = np.zeros((len(things), 8)), np.append(vertex.matrix.reshape(-1, 9), vertex.offset, axis=1)
        tables = [*_fock_tables(), np.array([len(things)]), casters.reshape(-1), parts.ravel()]
        for caster, thing in zip(casters, things, strict=True):
            shape, start = vertex.scatterers[thing].shape, sum(table.size for table in tables)
            caster[:] = [thing, shape.kind == "capsule", self._turned[thing], *shape.semi_axes, start, shape.radius]
            tables.append(self._points(shape.outline, waves, start))
        found = self._of.uploaded(field_tables=waves.astype(np.float32), modes=np.concatenate(tables))
        return found | {"faces": None}

    def _points(self, outline: Outline, waves: Floats, start: int) -> Floats:
        """Numbers and places of an outline's points, in a table that starts at `start`, see ``outline.h``.

        Points that are worked on side by side have their numbers beside each other.
        """
        wave, together = 2.0 * math.pi * float(waves.max()), self._of.together
        steps = steps_of_points(most := most_points(outline, wave))
        tables = [outline.table(count).reshape(6, -1, together).swapaxes(0, 1).ravel() for _, count in steps]
        places = start + 5 + 3 * len(steps) + np.cumsum([0, *(table.size for table in tables)])
        rows = [(limit, count, place) for (limit, count), place in zip(steps, places[:-1], strict=True)]
        head = [len(steps), outline.fewest, wave, most, outline.largest]
        return np.concatenate([head, np.ravel(rows), *tables])

    def views(self, source: int, rows: NDArray[np.int64]) -> dict[str, Any]:
        first, path = self._family.vertex.first, self._family.vertex.path[rows]
        views = np.stack([first[path], np.diff(first)[path]], axis=1).astype(np.int32).view(SHADE_VIEW)[:, 0]
        return super().views(source, rows) | self._of.uploaded(views=views)

    def field(self, source: int, rows: NDArray[np.int64]) -> dict[str, Any]:
        return self._tables[source]


def _fock_tables() -> list[Floats]:
    """Tables of Fock's functions as kernels take them."""
    return [table.view(np.float64) for table in (fock.fock_table(), fock.lit_table())]


class MirrorColumns(StaticColumns):
    """Columns of paths by one moving leg: walls at rest as isometries, and faces of bodies that move."""

    leg = MOVING

    def __init__(self, of: Rendered) -> None:
        super().__init__(of)
        mirrors = of.family.legs[0].mirrors
        still = np.array([body.is_static for body in mirrors.bodies])
        # In wind everything moves through the air.
        self._moves = (mirrors.owner != ROOM) & ~still[mirrors.owner] | (of.tracks.paths.scene.air.wind is not None)
        of_paths = self._moving(of.family.legs[0].surfaces)
        self.mirrors = max(int(of_paths.sum(axis=1).max(initial=0)), 1)
        self.state_numbers = 4 * self.mirrors
        self._faces = np.unique(of.family.legs[0].surfaces[of_paths])
        every, nothing = np.arange(len(mirrors.owner)), np.zeros((len(mirrors.owner), 1))
        planes = mirrors.planes(every, nothing, nothing, None)  # of those at rest; the last row is that of no mirror
        self._normal = np.concatenate([np.where(self._moves[:, None], 0.0, planes.normal[:, 0]), np.zeros((1, 3))])
        self._offset = np.append(np.where(self._moves, 0.0, planes.offset[:, 0]), 0.0)
        peak = np.array([body.peak_speed for body in mirrors.bodies])[mirrors.owner]
        c = float(of.family.speed_range.slowest)
        self._peak = np.where(mirrors.owner == ROOM, 0.0, np.minimum(2.0 * peak, 0.5 * (peak + c)))
        self._face_rate = face_rate(mirrors, of.plan.duration, _FACE_SHARE * of.tolerance(c))

    def _moving(self, surfaces: NDArray[np.int32]) -> NDArray[np.bool_]:
        """Mask (P, N) of the mirrors of paths that move."""
        return np.asarray((surfaces >= 0) & self._moves[surfaces])

    def met(self, rows: Rows) -> Walls:
        return np.asarray(self._family.legs[0].surfaces[rows])

    def views(self, source: int, rows: NDArray[np.int64]) -> dict[str, Any]:
        """Images by the walls at rest, and the mirrors that move."""
        matrix, offset, views, _ = self._seen(self._family.legs[0].surfaces[rows])
        return self._of.uploaded(image_matrix=matrix.reshape(-1, 9).T, image_offset=offset.T, views=views)

    def _seen(self, surfaces: NDArray[np.int32]) -> tuple[Floats, Floats, NDArray[Any], Floats]:
        """View receiver (P, 3, 3), (P, 3), mirrors (P, MIRRORS) and normals (P, N, 3) from the source's own room."""
        count, every = len(surfaces), np.arange(len(surfaces))
        matrix, offset = np.tile(np.eye(3), (count, 1, 1)), np.zeros((count, 3))
        views, filled = np.zeros((count, self.mirrors), dtype=MIRROR_VIEW), np.zeros(count, dtype=np.int64)
        views["face"] = -1
        normal = np.zeros((*surfaces.shape, 3))
        moving = self._moving(surfaces)
        for bounce, met in enumerate(surfaces.T):
            here = every[moving[:, bounce]]
            view = np.zeros(len(here), dtype=MIRROR_VIEW)
            view["turn"], view["shift"] = matrix[here].reshape(-1, 9), offset[here]
            view["most"], view["face"] = self._peak[met[here]], np.searchsorted(self._faces, met[here])
            views[here, filled[here]] = view
            filled[here] += 1
            wall, height = self._normal[met], self._offset[met]
            normal[:, bounce] = np.einsum("pji,pj->pi", matrix, wall)
            matrix = matrix - 2.0 * wall[:, :, None] * np.einsum("pi,pij->pj", wall, matrix)[:, None]
            offset = offset - 2.0 * (np.sum(wall * offset, axis=1) - height)[:, None] * wall
        return matrix, offset, views, normal

    def bounces(self, source: int, rows: NDArray[np.int64]) -> Bounces:
        """Mirrors that depend on the angle, coded as in ``mirrored_field.h``, with the normals of those at rest."""
        env, surfaces = self._of.environments[source], self._family.legs[0].surfaces[rows]
        wall_of, columns = env.no_bounces(len(rows))
        if not env.angular:
            return wall_of, columns
        table, moving, normal = env.tables_of(surfaces), self._moving(surfaces), self._seen(surfaces)[3]
        before, filled = np.zeros(len(rows), dtype=np.int64), np.zeros(len(rows), dtype=np.int64)
        for bounce in range(surfaces.shape[1]):
            here = np.flatnonzero(table[:, bounce] >= 0)
            code = table[here, bounce] * (self.mirrors + 1) + before[here]
            wall_of[filled[here], here] = 2 * code + moving[here, bounce]
            columns[filled[here], :, here] = normal[here, bounce]
            filled[here] += 1
            before += moving[:, bounce]
        return wall_of, columns

    def poses(self, start: float, end: float) -> dict[str, Any]:
        knots, first = face_knots(self._family.legs[0].mirrors, self._faces, start, end, self._face_rate)
        given = {"pose_cells": None, "pose_count": knots.shape[1], "first_pose": first, "pose_rate": self._face_rate}
        return self._of.uploaded(poses=knots) | given


# By `PathFamily.device`; families of other values have their nodes made on the host.
COLUMNS: dict[str, type[StaticColumns]] = {
    "images": StaticColumns, "edges": EdgeColumns, "bodies": MirrorColumns, "scatterers": ScattererColumns,
    "shades": ShadeColumns,
}  # fmt: skip
