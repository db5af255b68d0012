"""Tables of rooms, their obstacles and materials."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
from pydantic import Discriminator, Field, Tag, ValidationError

from clsim.errors import InputError, not_one_of
from clsim.files.input_files import read_toml
from clsim.scene.material.material import Material
from clsim.scene.room.mesh import MeshRoom, by_group
from clsim.scene.room.shoebox import Shoebox
from clsim.scene.room.walls import FLATNESS
from clsim.scene_file.explain import explain
from clsim.scene_file.materials import MaterialModel, is_material
from clsim.scene_file.model import Model, Vector, within

R = TypeVar("R", Shoebox, MeshRoom)
Corners = list[Annotated[list[float], Field(min_length=2, max_length=2)]]


class WallsModel(Model):
    """Materials of a shoebox's walls by name."""

    default: MaterialModel | None = None
    x_min: MaterialModel | None = None
    x_max: MaterialModel | None = None
    y_min: MaterialModel | None = None
    y_max: MaterialModel | None = None
    z_min: MaterialModel | None = None
    z_max: MaterialModel | None = None

    def build(self, base: Path) -> dict[str, Material]:
        """Return the materials; paths are relative to `base`."""
        given = {name: material for name, material in self.arguments().items() if material is not None}
        return {name: within(name, partial(material.build, base)) for name, material in given.items()}


def _walls_kind(value: Any) -> str:
    keys = set(value) if isinstance(value, dict) else set()
    return "walls" if keys & set(WallsModel.model_fields) else "material"


Materials = Annotated[
    Annotated[MaterialModel, Tag("material")] | Annotated[dict[str, MaterialModel], Tag("materials")],
    Discriminator(lambda value: "material" if is_material(value) else "materials"),
]


def _build_materials(materials: MaterialModel | dict[str, MaterialModel], base: Path) -> Material | dict[str, Material]:
    if isinstance(materials, MaterialModel):
        return materials.build(base)
    return {name: within(name, partial(material.build, base)) for name, material in materials.items()}


class MeshModel(Model):
    """A mesh file."""

    kind: Literal["mesh"] = "mesh"
    path: str
    scale: float = 1.0
    up: Literal["x", "y", "z"] = "z"
    flatness: float = FLATNESS
    heal: float | Literal["auto", "off"] = "auto"
    sheets_below: float = 0.0
    materials: Materials

    def build(self, base: Path) -> MeshRoom:
        materials = within("materials", lambda: _build_materials(self.materials, base))
        file = base / self.path
        try:
            mesh = MeshRoom.from_file(file, self.scale, self.up, materials, flatness=self.flatness, heal=self.heal)
        except InputError as error:
            if error.field != str(file):
                raise
            raise InputError("path", f"{file}: {error.problem}") from error
        return within("sheets_below", lambda: mesh.with_sheets(self.sheets_below)) if self.sheets_below else mesh


class PlanModel(Model):
    """A floor plan with pillars."""

    kind: Literal["plan"]
    outline: Corners
    height: float
    materials: Materials
    pillars: list[Corners] = []

    def build(self, base: Path) -> MeshRoom:
        materials = within("materials", lambda: _build_materials(self.materials, base))
        return MeshRoom.from_plan(self.outline, self.height, materials, [np.array(p) for p in self.pillars])


class PolygonsFile(Model):
    """A file of polygons: corners, m, and polygons of them by name, in tables by material."""

    sheets: list[str] = []
    corners: dict[str, Vector]
    polygons: dict[str, dict[str, list[int | str]]]

    def rows(self, leave_out: list[str]) -> tuple[list[list[int]], list[str], list[str]]:
        """Collect corners by number, material and name of every polygon, but for materials that are left out."""
        for field, listed in (("leave_out", leave_out), ("sheets", self.sheets)):
            for i, name in enumerate(listed):
                if name not in self.polygons:
                    raise InputError(f"{field}[{i}]", not_one_of(name, self.polygons))
        number = {name: i for i, name in enumerate(self.corners)}
        rows, groups, labels = [], [], []
        for group, polygons in self.polygons.items():
            for name, corners in () if group in leave_out else polygons.items():
                for i, corner in enumerate(corners):
                    if str(corner) not in number:
                        raise InputError(f"polygons.{group}.{name}[{i}]", f"must name a corner, but is {corner!r:.40}")
                rows.append([number[str(corner)] for corner in corners])
                groups.append(group)
                labels.append(f"{group} {name}")
        return rows, groups, labels


class PolygonsModel(Model):
    """A room of polygons from a file."""

    kind: Literal["polygons"]
    path: str
    leave_out: list[str] = []
    flatness: float = FLATNESS
    heal: float | Literal["auto", "off"] = "auto"
    materials: Materials

    def build(self, base: Path) -> MeshRoom:
        materials = within("materials", lambda: _build_materials(self.materials, base))
        file = base / self.path
        content = read_toml(file)
        try:
            polygons = PolygonsFile.model_validate(content)
        except ValidationError as error:
            raise InputError("path", f"{file}: {explain(error, content, PolygonsFile)}") from error
        try:
            rows, groups, labels = polygons.rows(self.leave_out)
        except InputError as error:
            raise InputError(error.field, f"{file}: {error.problem}") from error
        by_name = by_group(tuple(dict.fromkeys(groups)), self.path, materials)
        return MeshRoom.from_polygons(
            list(polygons.corners.values()), rows, [by_name[group] for group in groups],
            double_sided=[i for i, group in enumerate(groups) if group in polygons.sheets], heal=self.heal,
            flatness=self.flatness, labels=labels,
        )  # fmt: skip


def _obstacle_kind(value: Any) -> str:
    return str(value.get("kind", "mesh")) if isinstance(value, dict) else "mesh"


ObstacleModel = Annotated[
    Annotated[MeshModel, Tag("mesh")] | Annotated[PlanModel, Tag("plan")], Discriminator(_obstacle_kind)
]


class _WithObstacles(Model):
    obstacles: list[ObstacleModel] = []

    def with_obstacles(self, room: R, base: Path) -> R | MeshRoom:
        """Return the room joined with its obstacles."""
        if not self.obstacles:
            return room
        parts: list[MeshRoom] = [
            within(f"obstacles[{i}]", partial(model.build, base)) for i, model in enumerate(self.obstacles)
        ]
        return MeshRoom.joined([room, *parts])


class ShoeboxRoomModel(_WithObstacles):
    """A box-shaped room."""

    kind: Literal["shoebox"]
    size: Vector
    walls: Annotated[
        Annotated[MaterialModel, Tag("material")] | Annotated[WallsModel, Tag("walls")], Discriminator(_walls_kind)
    ]

    def build(self, base: Path) -> Shoebox | MeshRoom:
        walls: Any = self.walls
        return self.with_obstacles(Shoebox(np.array(self.size), within("walls", partial(walls.build, base))), base)


class MeshRoomModel(_WithObstacles, MeshModel):
    """A room from a mesh file."""

    kind: Literal["mesh"]

    def build(self, base: Path) -> MeshRoom:
        return self.with_obstacles(super().build(base), base)


class PlanRoomModel(_WithObstacles, PlanModel):
    """A room over a floor plan."""

    kind: Literal["plan"]

    def build(self, base: Path) -> MeshRoom:
        return self.with_obstacles(super().build(base), base)


class PolygonsRoomModel(_WithObstacles, PolygonsModel):
    """A room of polygons from a file."""

    def build(self, base: Path) -> MeshRoom:
        return self.with_obstacles(super().build(base), base)


RoomModel = Annotated[ShoeboxRoomModel | MeshRoomModel | PlanRoomModel | PolygonsRoomModel, Field(discriminator="kind")]
