"""Rooms of any shape: walls made of triangles."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from clsim.arrays import FARTHEST, Complexes, Floats, as_count, as_floats, as_number, read_only, short_repr
from clsim.errors import InputError, check_kind, meant, settle
from clsim.scene.material.material import Material
from clsim.scene.room import mesh_cleaning
from clsim.scene.room.edges import Edges, find_edges, numbered
from clsim.scene.room.faces import NEAREST, Contact, Faces, Mount, first_of
from clsim.scene.room.healing import HEAL, clean_mesh, heal_mesh, healing_tolerance
from clsim.scene.room.mesh_cleaning import MeshShape, cross_products
from clsim.scene.room.polygons import checked_polygons, extruded_plan, triangulated
from clsim.scene.room.walls import FLATNESS, Walls, build_walls, first_contact, first_off, walls_at

Materials = Material | Mapping[str, Material] | Sequence[Material]
# Directions that no wall is likely to lie along; where one of them meets an edge, the two others outvote it.
_RAYS = np.array([[0.3607, 0.4783, 0.8007], [-0.7321, 0.5519, -0.3991], [0.5297, -0.8081, 0.2577]])
_BENT = 10.0  # m, beyond which nothing is flat
_CLEAR = 2.0  # steps off a wall at which an end in it is clear of this wall, and of no other
_PAIRS = 500_000  # of positions and walls at a time


@runtime_checkable
class _Part(Protocol):
    def as_mesh(self) -> MeshRoom:
        """Return it as a mesh."""


@dataclass(frozen=True, slots=True, eq=False)
class MeshRoom:
    """A room or objects in it, made of triangles; it may be open, and its walls are two-sided.

    Parameters
    ----------
    vertices : array_like (V, 3)
        m, z up.
    triangles : array_like (T, 3) of int
        Indices of corners; the winding does not matter.
    materials : Material or sequence of Material
        One for all, or one per triangle; kept as one per triangle.
    flatness : float
        Neighbours of one material whose corners lie this near to each other's planes are one wall, 0 to 10 m.
    labels : sequence of str, optional
        Group of each triangle, which names its wall.
    notes : sequence of str
        Earlier repairs.
    scale : float, optional
        Length of the unit of the files that it is from, m; None without files, or where they differ.
    healed_at : array_like (n, 3), optional
        Positions of repairs, m.

    Attributes
    ----------
    walls : Walls
        The triangles merged into flat walls.
    faces : Faces
        Planes, names and materials of the walls.
    shape : MeshShape
        Topology of the triangles.
    notes : tuple of str
        Repairs, one sentence each.

    Examples
    --------
    >>> corners = [(0, 0, 0), (2, 0, 0), (2, 0, 1), (0, 0, 1)]
    >>> screen = MeshRoom(corners, [(0, 1, 2), (0, 2, 3)], Material.from_reflection(0.95))
    >>> len(screen.walls), screen.shape.watertight
    (1, False)
    """

    vertices: Floats
    triangles: NDArray[np.int64]
    materials: Materials
    flatness: float = FLATNESS
    labels: Sequence[str] | None = None
    notes: tuple[str, ...] = ()
    scale: float | None = None
    healed_at: Floats | None = None
    walls: Walls = field(init=False)
    faces: Faces = field(init=False)
    shape: MeshShape = field(init=False)

    __repr__ = short_repr

    def __post_init__(self) -> None:
        vertices = as_floats("vertices", self.vertices, (None, 3), within=FARTHEST, unit="m")
        triangles = np.asarray(self.triangles)
        if triangles.ndim != 2 or triangles.shape[1] != 3 or not len(triangles) or triangles.dtype.kind not in "iu":
            raise InputError("triangles", f"must be n x 3 whole numbers, but have {triangles.shape} {triangles.dtype}")
        for i in np.flatnonzero(np.any((triangles < 0) | (triangles >= len(vertices)), axis=1))[:1]:
            problem = f"must be indices of {len(vertices)} vertices, but is {triangles[i].tolist()}"
            raise InputError(f"triangles[{i}]", problem)
        triangles = triangles.astype(np.int64)
        materials = _per_one(self.materials, len(triangles), "triangle")
        labels = ("",) * len(triangles) if self.labels is None else tuple(self.labels)
        if len(labels) != len(triangles):
            raise InputError("labels", f"must be one per triangle, {len(triangles)}, but are {len(labels)}")
        flatness = as_number("flatness", self.flatness, at_least=0.0, at_most=_BENT, unit="m")
        clean = clean_mesh(vertices, triangles)
        kept = [materials[i] for i in clean.kept]
        kinds = {id(m): i for i, m in enumerate({id(m): m for m in kept}.values())}
        walls = build_walls(clean.vertices, clean.triangles, np.array([kinds[id(m)] for m in kept]), flatness)
        first = np.unique(walls.of_triangle, return_index=True)[1]
        names = numbered([labels[clean.kept[i]] for i in first], "wall")
        healed_at = np.empty((0, 3)) if self.healed_at is None else np.asarray(self.healed_at)
        if healed_at.size:
            healed_at = as_floats("healed_at", healed_at, (None, 3), within=FARTHEST, unit="m")
        settle(
            self, healed_at=healed_at, vertices=read_only(clean.vertices), triangles=read_only(clean.triangles),
            materials=tuple(kept), flatness=flatness, labels=tuple(labels[i] for i in clean.kept),
            notes=(*self.notes, *clean.notes), walls=walls,
            faces=Faces(walls.normal, walls.offset, names, tuple(kept[i] for i in first)),
            shape=mesh_cleaning.mesh_shape(clean.vertices, clean.triangles),
        )  # fmt: skip

    @staticmethod
    def from_file(
        path: str | os.PathLike[str], scale: float = 1.0, up: str = "z",
        materials: Material | Mapping[str, Material] | None = None, *, flatness: float = FLATNESS,
        heal: str | float = HEAL,
    ) -> MeshRoom:  # fmt: skip
        """Return a room from an AC3D file or one that trimesh reads: OBJ, STL, PLY, GLB, OFF and more.

        Parameters
        ----------
        path : path-like
            The file.
        scale : float
            Length of the file's unit, m: 0.001 for millimetres.
        up : {"x", "y", "z"}
            Axis of the file that points up.
        materials : Material or mapping
            One for all walls, or materials by the file's own names (``usemtl`` groups of OBJ files, which messages
            list), where ``"default"`` stands for those not named.
        flatness : float
            As in `MeshRoom`, m; raise it for files with rounded coordinates.
        heal : {"auto", "off"} or float
            Largest distance by which corners are moved to meet others, m. Triangles are cut at corners that lie on
            them. With "auto" they are moved as far as closing the mesh takes, at most 12 mm and 2 per mille of its
            size. A mesh that is closed, or that gains nothing, keeps every bit. The notes state the changes.
        """
        from clsim.scene.room.mesh_files import read_mesh

        mesh = read_mesh(path, scale=scale, up=up)
        of_group = by_group(mesh.groups, Path(path).name, materials)
        stem = Path(path).stem
        names = [mesh.groups[g] for g in mesh.group]
        labels = [f"{stem} {name}".strip() for name in names]
        healed = heal_mesh(mesh.vertices, mesh.triangles, heal)
        return MeshRoom(
            healed.vertices, healed.triangles, [of_group[names[i]] for i in healed.origin], flatness,
            [labels[i] for i in healed.origin], (*mesh.notes, *healed.notes), float(scale), healed.places,
        )  # fmt: skip

    @staticmethod
    def from_polygons(
        corners: ArrayLike, polygons: Sequence[Sequence[int]], materials: Material | Sequence[Material], *,
        double_sided: Sequence[int] = (), heal: str | float = HEAL, flatness: float = FLATNESS,
        labels: Sequence[str] | None = None,
    ) -> MeshRoom:  # fmt: skip
        """Make a room of polygons, as round robins of room acoustics publish theirs.

        Parameters
        ----------
        corners : array_like (n, 3)
            m, z up.
        polygons : sequence of sequences of int
            Numbers of corners from 0, in order; concave ones are cut by ear clipping. One that lies in a larger one, a
            window in a wall, is cut out of it.
        materials : Material or sequence of Material
            One for all, or one per polygon.
        double_sided : sequence of int
            Numbers of polygons that are sheets in the room, such as curtains; they are not healed, nor cut out.
        heal : {"auto", "off"} or float
            As in `from_file`, m.
        flatness : float
            As in `MeshRoom`, m.
        labels : sequence of str, optional
            Names of the polygons; numbered when left out.

        Examples
        --------
        >>> box = [(x, y, z) for z in (0, 3) for y in (0, 4) for x in (0, 5)]
        >>> sides = [(0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5)]
        >>> room = MeshRoom.from_polygons(box, sides, Material.from_reflection(0.9))
        >>> len(room.walls), room.volume
        (6, 60.0)
        """
        points = as_floats("corners", corners, (None, 3), within=FARTHEST, unit="m")
        rows = checked_polygons(polygons, len(points))
        given = _per_one(materials, len(rows), "polygon")
        names = tuple(f"polygon {i}" for i in range(len(rows))) if labels is None else tuple(labels)
        if len(names) != len(rows):
            raise InputError("labels", f"must be one per polygon, {len(rows)}, but are {len(names)}")
        sheets = {as_count(f"double_sided[{i}]", n, at_most=len(rows) - 1) for i, n in enumerate(double_sided)}
        walls = [i for i in range(len(rows)) if i not in sheets]
        if not walls:
            raise InputError("double_sided", "must leave polygons that are walls of the room, but names them all")
        triangles, owner, notes = triangulated(points, rows, walls, healing_tolerance(points, heal))
        healed = heal_mesh(points, triangles, heal)
        more, of_sheet, _ = triangulated(points, rows, sorted(sheets), 0.0)
        count = len(healed.vertices)
        origin = [*owner[healed.origin].tolist(), *of_sheet.tolist()]
        return MeshRoom(
            np.concatenate([healed.vertices, points]), np.concatenate([healed.triangles, more + count]),
            [given[i] for i in origin], flatness, [names[i] for i in origin], (*notes, *healed.notes),
            healed_at=healed.places,
        )  # fmt: skip

    @staticmethod
    def from_plan(
        outline: ArrayLike,
        height: float,
        materials: Material | Mapping[str, Material],
        pillars: Sequence[ArrayLike] = (),
    ) -> MeshRoom:
        """Return a room of constant height over a floor plan, with pillars in it.

        Parameters
        ----------
        outline : array_like (n, 2)
            Corners of the floor in order, m; it may be concave.
        height : float
            Height of the ceiling above the floor at z = 0, m.
        materials : Material or mapping
            One for all walls, or materials by ``floor``, ``ceiling``, ``wall i`` (from corner i of the outline to the
            next) and ``pillar p wall i``, where ``default`` stands for those not named.
        pillars : sequence of array_like (n, 2)
            Outlines of pillars from floor to ceiling, m.

        Raises
        ------
        InputError
            If an outline crosses itself or another one, a pillar stands outside, or a wall has no material.

        Examples
        --------
        >>> corners = [(0, 0), (8, 0), (8, 5), (4, 5), (4, 9), (0, 9)]
        >>> room = MeshRoom.from_plan(corners, 3.0, Material.from_reflection(0.9))
        >>> len(room.walls), room.shape.watertight
        (8, True)
        """
        vertices, triangles, labels = extruded_plan(outline, height, pillars)
        of_label = by_group(tuple(dict.fromkeys(labels)), "the plan", materials)
        return MeshRoom(vertices, triangles, [of_label[label] for label in labels], labels=labels)

    @staticmethod
    def joined(parts: Sequence[_Part]) -> MeshRoom:
        """Return one room made of several `parts`: a room, furniture, screens.

        Examples
        --------
        >>> from clsim import Shoebox
        >>> wall = Material.from_reflection(0.9)
        >>> corners = [(2, 2, 0), (4, 2, 0), (4, 2, 1), (2, 2, 1)]
        >>> screen = MeshRoom(corners, [(0, 1, 2), (0, 2, 3)], wall)
        >>> len(MeshRoom.joined([Shoebox((8.0, 6.0, 3.0), wall), screen]).walls)
        7
        """
        if not isinstance(parts, Sequence) or not parts:
            raise InputError("parts", f"must be a list of at least one room, but is {parts!r:.80}")
        meshes = []
        for i, part in enumerate(parts):
            if isinstance(part, type) or not isinstance(part, _Part):
                raise InputError(f"parts[{i}]", f"must be a room, but is {part!r:.80}")
            meshes.append(part.as_mesh())
        first = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes[:-1])])
        scales = {mesh.scale for mesh in meshes if mesh.scale is not None}
        return MeshRoom(
            np.concatenate([mesh.vertices for mesh in meshes]),
            np.concatenate([mesh.triangles + count for mesh, count in zip(meshes, first, strict=True)]),
            [material for mesh in meshes for material in mesh.triangle_materials],
            max(mesh.flatness for mesh in meshes),
            [label for mesh in meshes for label in mesh.labels or ()],
            tuple(note for mesh in meshes for note in mesh.notes),
            scales.pop() if len(scales) == 1 else None,
            np.concatenate([mesh.healed_at for mesh in meshes if mesh.healed_at is not None]),
        )

    def with_sheets(self, thinner_than: float) -> MeshRoom:
        """Return the room with thin panels as sheets, round which sound diffracts at one edge.

        Parameters
        ----------
        thinner_than : float
            Panels of less thickness, each a shell of its own, become one layer in their middle, 0 to 10 m; two
            wavelengths are a good choice with `find_paths(…, diffraction=1)`.

        Examples
        --------
        >>> from clsim import Shoebox
        >>> door = Shoebox((0.9, 0.005, 2.0), Material.from_reflection(0.9)).as_mesh()
        >>> sheet = door.with_sheets(0.017)
        >>> len(sheet.walls), set(sheet.edges().n.tolist()), sheet.extent[0][1].round(9)
        (1, {2.0}, np.float64(0.0025))
        """
        thickness = as_number("thinner_than", thinner_than, at_least=0.0, at_most=_BENT, unit="m")
        labels, materials = tuple(self.labels or ()), self.triangle_materials
        vertices, triangles, origin, notes = mesh_cleaning.thin_panels(self.vertices, self.triangles, labels, thickness)
        return MeshRoom(
            vertices, triangles, [materials[i] for i in origin], self.flatness, [labels[i] for i in origin],
            (*self.notes, *notes), self.scale, self.healed_at,
        )  # fmt: skip

    def thin_panels(self, thinner_than: float) -> list[tuple[str, float]]:
        """Return name and thickness, m, of panels below `thinner_than`, m, of which `with_sheets` makes sheets."""
        found = mesh_cleaning.panels(self.vertices, self.triangles)
        of = self.labels or ()
        return [(of[mine[0]] or "a panel", thick) for mine, _, _, thick in found if 0.0 < thick < thinner_than]

    @property
    def extent(self) -> tuple[Floats, Floats]:
        """Lowest and highest corner, (3,) m each."""
        return self.vertices.min(axis=0), self.vertices.max(axis=0)

    @property
    def triangle_materials(self) -> tuple[Material, ...]:
        """The material of each triangle."""
        return tuple(self.faces.materials[wall] for wall in self.walls.of_triangle)

    @property
    def volume(self) -> float | None:
        """Volume inside a watertight mesh, as `contains` has it, whatever the winding, m³; None where it is open."""
        return _volume(self) if self.is_closed else None

    @property
    def surface_area(self) -> float:
        """Area of all triangles, one side of each, m²."""
        return float(0.5 * np.linalg.norm(cross_products(self.vertices[self.triangles]), axis=1).sum())

    @property
    def is_convex(self) -> bool:
        """False: what lies between two places may be walls, whatever the shape."""
        return False

    @property
    def is_closed(self) -> bool:
        """Whether the mesh is watertight, but for flat sheets in it."""
        return self.shape.watertight

    def reflections(self, frequency: ArrayLike) -> Floats | Complexes:
        """Return every wall's reflection factor (W, ...) at normal incidence by `frequency` (...) above 0 Hz."""
        return self.faces.reflections(frequency)

    def contains(self, positions: ArrayLike) -> NDArray[np.bool_]:
        """Return a mask (n,) of `positions` (n, 3), m, inside: most rays from them meet walls an odd number of times.

        Of use for watertight rooms only.
        """
        x = np.asarray(positions, dtype=np.float64).reshape(-1, 3)
        inside, other = (self._met(x, ray) % 2 == 1 for ray in _RAYS[:2])
        unsure = np.flatnonzero(inside != other)
        inside[unsure] = self._met(x[unsure], _RAYS[2]) % 2 == 1
        return np.asarray(inside)

    def surrounds(self, positions: ArrayLike) -> NDArray[np.bool_]:
        """Return a mask of positions with walls on all sides, by six rays; see `Room.surrounds`."""
        x = np.asarray(positions, dtype=np.float64).reshape(-1, 3)
        return np.asarray(np.all([self._met(x, sign * ray) > 0 for ray in _RAYS for sign in (1.0, -1.0)], axis=0))

    def clearance(self, positions: Floats, mount: Mount | None = None) -> Floats:
        """Return lower bounds of the distance from all walls, m; what is in a wall is on one; see `Room.clearance`."""
        if mount is not None:
            return np.minimum(mount.clearance(positions), 0.0)
        walls, found = self.walls, np.empty(len(positions))
        step = max(1, _PAIRS // len(walls))
        for first in range(0, len(positions), step):
            some = slice(first, first + step)
            beside = np.abs(positions[some] @ walls.normal.T - walls.offset)
            away = np.linalg.norm(positions[some, None] - walls.centre, axis=2) - walls.radius
            found[some] = np.maximum(beside, away).min(axis=1) - NEAREST
        return found

    def first_contact(self, positions: Floats, mount: Mount | None = None) -> Contact | None:
        """Return the first contact: on a wall, through a wall, or off its own wall; see `Room.first_contact`."""
        if mount is None:
            return self._first_met(positions, "; an end in a wall needs flush=")
        off = first_off(self.walls, mount.wall, positions)
        rule = f"must stay on the wall that it is flush with, {self.faces.names[mount.wall]!r}"
        return first_of(
            mount.first_off(positions),
            None if off is None else Contact(off, rule, "is"),
            self._first_met(mount.lifted(positions, _CLEAR), ""),
        )

    def _first_met(self, positions: Floats, hint: str) -> Contact | None:
        met = first_contact(self.walls, positions)
        if met is None:
            return None
        rule = f"must stay {NEAREST:g} m away from every wall and walk through none"
        return Contact(met[0], rule, f"meets the wall {self.faces.names[met[1]]!r}", hint)

    def walls_at(self, position: Floats) -> NDArray[np.int64]:
        """Return the walls that a position is on; see `Room.walls_at`."""
        found = walls_at(self.walls, position)
        return found[np.unique(self.walls.plane[found], return_index=True)[1]]

    def edges(self, wall: int | None = None) -> Edges:
        """Find the edges at which sound diffracts: of screens, of objects in the room, of its corners.

        Parameters
        ----------
        wall : int, optional
            On whose lines alone edges are looked for; of all walls when left out.

        Returns
        -------
        Edges
            In a watertight mesh those with air of the inside about them; of walls as they are merged, so that the
            triangles they are made of do not matter.

        Examples
        --------
        >>> corners = [(0, 0), (8, 0), (8, 5), (4, 5), (4, 9), (0, 9)]
        >>> edges = MeshRoom.from_plan(corners, 3.0, Material.from_reflection(0.9)).edges()
        >>> edges.names, edges.n.round(9).tolist(), edges.length.tolist()
        (('edge wall 3 | wall 2',), [1.5], [3.0])
        """
        return _edges(self, wall)

    def as_mesh(self) -> MeshRoom:
        """Return the room itself."""
        return self

    def describe(self) -> list[str]:
        r"""Return a description of the mesh, a line each: size, walls, shells, holes, winding, repairs.

        Examples
        --------
        >>> from clsim import Shoebox
        >>> box = Shoebox((8.0, 6.0, 3.0), Material.from_reflection(0.9)).as_mesh()
        >>> print(*box.describe(), sep="\n")
        room: 12 triangles, 6 walls in 6 planes, 8 x 6 x 3 m from (0, 0, 0) m
        room: watertight
        """
        return mesh_cleaning.describe_mesh(self.vertices, self.triangles, self.walls.plane, self.shape, self.notes)

    def _met(self, x: Floats, ray: Floats) -> NDArray[np.int64]:
        """Return number of walls (n,), but for sheets, hit by a ray from each of positions (n, 3)."""
        count, walls = np.zeros(len(x), dtype=int), self.walls
        for w in np.unique(walls.of_triangle[~self.shape.sheets]).tolist():
            away = (walls.offset[w] - x @ walls.normal[w]) / (walls.normal[w] @ ray)
            forward = np.flatnonzero(away > 0.0)
            if len(forward):
                count[forward] += walls.holds(w, x[forward] + away[forward, None] * ray)
        return count


@lru_cache(maxsize=8)  # every search of paths asks for them several times
def _edges(room: MeshRoom, wall: int | None) -> Edges:
    return find_edges(room.walls, room.faces, room.contains if room.is_closed else None, wall)


@lru_cache(maxsize=4)
def _volume(room: MeshRoom) -> float | None:
    return mesh_cleaning.enclosed_volume(
        room.vertices, room.triangles[~room.shape.sheets], room.walls.crossing, room.contains
    )


def _per_one(materials: object, count: int, of: str) -> list[Material]:
    if isinstance(materials, Material):
        return [materials] * count
    if not isinstance(materials, Sequence) or isinstance(materials, str):
        raise InputError("materials", f"must be a Material or one per {of}, but is {materials!r:.80}")
    if len(materials) != count:
        raise InputError("materials", f"must be one per {of}, {count}, but are {len(materials)}")
    for i, material in enumerate(materials):
        check_kind(f"materials[{i}]", material, Material, "a Material")
    return list(materials)


def by_group(groups: tuple[str, ...], name: str, materials: object) -> dict[str, Material]:
    """Return the material of each group of the mesh `name`."""
    if isinstance(materials, Material):
        return dict.fromkeys(groups, materials)
    if not isinstance(materials, Mapping) or not materials:
        raise InputError("materials", f"must be a Material or materials by group, but is {materials!r:.80}")
    listed = ", ".join(repr(g) for g in groups)
    for key, material in materials.items():
        if key != "default" and key not in groups:
            problem = f"is no group of {name}, whose groups are {listed}{meant(key, groups)}"
            raise InputError(f"materials.{key}", problem)
        check_kind(f"materials.{key}", material, Material, "a Material")
    missing = [g for g in groups if g not in materials]
    if missing and "default" not in materials:
        raise InputError("materials", f"must name the group {missing[0]!r} of {name} or a default")
    return {g: materials[g] if g in materials else materials["default"] for g in groups}
