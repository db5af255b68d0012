"""Tables of rooms, their obstacles and materials."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
from pydantic import Discriminator, Field, Tag

from clsim.errors import InputError
from clsim.scene.material.material import Material
from clsim.scene.room.mesh import MeshRoom
from clsim.scene.room.shoebox import Shoebox
from clsim.scene.room.walls import FLATNESS
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


RoomModel = Annotated[ShoeboxRoomModel | MeshRoomModel | PlanRoomModel, Field(discriminator="kind")]
