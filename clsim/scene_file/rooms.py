"""Tables of rooms, their obstacles and materials."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import Discriminator, Field, Tag, ValidationError

from clsim.acoustics.room_acoustics import absorption_for
from clsim.arrays import as_floats
from clsim.errors import InputError, inside, not_one_of, with_field
from clsim.files.input_files import read_toml
from clsim.scene.material.material import Material
from clsim.scene.material.reflecting_surface import as_scattering
from clsim.scene.room.mesh import MeshRoom, by_group
from clsim.scene.room.shoebox import Shoebox
from clsim.scene.room.walls import FLATNESS
from clsim.scene_file.model import Hold, Model, Numbers, Table, Vector, built, explain, table

Corners = list[Annotated[list[float], Field(min_length=2, max_length=2)]]
# How many there are is checked in our own words; editors read it here.
Pair = Annotated[list[float], Field(json_schema_extra={"minItems": 2, "maxItems": 2})]
Complex = float | Pair  # a complex number is written [real, imaginary]


def _number(field: str, value: float | list[float]) -> float | complex:
    if not isinstance(value, list):
        return value
    if len(value) != 2:
        raise InputError(field, f"must be a number or [real, imaginary], but is {value!r:.80}")
    return complex(*value)


def _numbers(values: list[float | list[float]]) -> list[float | complex]:
    return [_number(f"[{i}]", value) for i, value in enumerate(values)]


class _Tabulated(Table):
    readers = {"factors": _numbers, "impedances": _numbers}


class _Echo(Table):
    reference: float = 0.0
    band: Pair | None = None
    outside: Hold = None
    tolerance: float = 0.05


class _Decay(Model):
    frequencies: list[float]
    seconds: list[float]


class _Scattering(Model):
    frequencies: list[float]
    values: list[float]


class _Transmission(Model):
    surface_mass: float | None = None
    frequencies: list[float] | None = None
    losses_db: list[float] | None = None


if TYPE_CHECKING:
    _Absorption = Table
    _Factors = Table
    _Impedance = Table
    _ImpulseResponse = Table
    _ImpulseResponseFile = Table
    _Solid = Table
    _Porous = Table
else:
    _material = partial(table, "", without="name scattering")
    _Absorption = _material(Material.from_absorption, name="_Absorption", frequencies=Numbers, coefficients=Numbers)
    _Factors = _material(
        Material.from_table, name="_Table", base=_Tabulated, frequencies=Numbers, factors=list[Complex], outside=Hold
    )
    _Impedance = _material(
        Material.from_impedance, name="_Impedance", base=_Tabulated, frequencies=Numbers, impedances=list[Complex],
        outside=Hold,
    )  # fmt: skip
    _ImpulseResponse = _material(Material.from_impulse_response, name="_ImpulseResponse", base=_Echo, samples=Numbers)
    _ImpulseResponseFile = _material(Material.from_wav, name="_ImpulseResponseFile", base=_Echo)
    _Solid = _material(Material.from_solid, name="_Solid")
    _Porous = _material(Material.from_porous, name="_Porous", outside=Literal["extend"] | None)


class MaterialModel(Table):
    """One description of a wall's material, its roughness (m), its scattering coefficient, and what passes it."""

    reflection: Complex | None = None
    named: str | None = None
    absorption: _Absorption | None = None
    table: _Factors | None = None
    impedance: _Impedance | None = None
    impulse_response: _ImpulseResponse | None = None
    wav: _ImpulseResponseFile | None = None
    solid: _Solid | None = None
    porous: _Porous | None = None
    reverberation_time: float | _Decay | None = None
    roughness: float = 0.0
    scattering: float | _Scattering | None = None
    transmission: _Transmission | None = None

    def build(self, base: Path = Path(), room: tuple[float, float] | None = None) -> Material:
        """Return the material; `room` has volume, m³, and area, m², of the room if all of its walls are of it."""
        makers = [name for name in type(self).model_fields if name not in ("roughness", "scattering", "transmission")]
        given = [name for name in makers if getattr(self, name) is not None]
        if len(given) != 1:
            problem = f"must have one of {', '.join(makers)}, but has {' and '.join(given) or 'none of them'}"
            raise InputError("", problem)
        material = self._built(given[0], base, room)
        if self.scattering is not None:
            scattered = self.scattering
            coefficients = scattered if isinstance(scattered, float) else (scattered.frequencies, scattered.values)
            material = replace(material, scattering=as_scattering(coefficients))
        if self.transmission is not None:
            try:
                material = material.transmitting(**self.transmission.arguments())
            except InputError as error:
                inner = "" if error.field == "transmission" else error.field
                raise InputError(inner, error.problem).within("transmission") from error
        with with_field("roughness"):
            return material.rough(self.roughness) if self.roughness else material

    def _built(self, maker: str, base: Path, room: tuple[float, float] | None) -> Material:
        value = getattr(self, maker)
        if maker == "reverberation_time":
            with inside(maker):
                return _decaying(value, room)
        if isinstance(value, Table):
            made: Material = built(maker, value, base)
            return made
        with with_field(maker):  # the constructor's word for it is another
            return Material.named(value) if isinstance(value, str) else Material.from_reflection(_number("", value))


def _decaying(given: float | _Decay, room: tuple[float, float] | None) -> Material:
    """Return the material of a room's walls that gives it a reverberation time."""
    if room is None:
        raise InputError("", "must be in the one material of all walls of a shoebox, but is elsewhere")
    frequencies, seconds = ([1000.0], [given]) if isinstance(given, float) else (given.frequencies, given.seconds)
    times = as_floats("" if isinstance(given, float) else "seconds", seconds, (len(frequencies),))
    if not (times > 0.0).all():
        raise InputError("", f"must be above 0 s, but is {times.min():g} s")
    absorbed = absorption_for(times, *room)
    if isinstance(given, float):
        return Material.from_reflection(math.sqrt(1.0 - absorbed[0]))
    return Material.from_absorption(frequencies, absorbed)


_WORDS = frozenset(MaterialModel.model_fields)


def is_material(value: Any) -> bool:
    """Whether a table is one material, not materials by name, which are tables themselves."""
    # A material's own tables (absorption, solid ...) could be names of groups in a mesh: what stands in them tells.
    return not isinstance(value, dict) or all(
        not isinstance(entry, dict) or (key in MaterialModel.model_fields and not entry.keys() & _WORDS)
        for key, entry in value.items()
    )


class WallsModel(Table):
    """Materials of a shoebox's walls by name."""

    default: MaterialModel | None = None
    x_min: MaterialModel | None = None
    x_max: MaterialModel | None = None
    y_min: MaterialModel | None = None
    y_max: MaterialModel | None = None
    z_min: MaterialModel | None = None
    z_max: MaterialModel | None = None

    def build(self, base: Path = Path()) -> dict[str, Material]:
        return {name: material for name, material in self.parts(base).items() if material is not None}


Materials = Annotated[
    Annotated[MaterialModel, Tag("material")] | Annotated[dict[str, MaterialModel], Tag("materials")],
    Discriminator(lambda value: "material" if is_material(value) else "materials"),
]


class MeshModel(Table):
    """A mesh file."""

    kind: Literal["mesh"] = "mesh"
    path: str
    scale: float = 1.0
    up: Literal["x", "y", "z"] = "z"
    flatness: float = FLATNESS
    heal: float | Literal["auto", "off"] = "auto"
    sheets_below: float = 0.0
    materials: Materials

    def build(self, base: Path = Path()) -> MeshRoom:
        materials = built("materials", self.materials, base)
        file = base / self.path
        try:
            mesh = MeshRoom.from_file(file, self.scale, self.up, materials, flatness=self.flatness, heal=self.heal)
        except InputError as error:
            if error.field != str(file):
                raise
            raise InputError("path", f"{file}: {error.problem}") from error
        with inside("sheets_below"):
            return mesh.with_sheets(self.sheets_below) if self.sheets_below else mesh


class PlanModel(Table):
    """A floor plan with pillars."""

    kind: Literal["plan"]
    outline: Corners
    height: float
    materials: Materials
    pillars: list[Corners] = []

    constructor = staticmethod(MeshRoom.from_plan)


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


class PolygonsModel(Table):
    """A room of polygons from a file."""

    kind: Literal["polygons"]
    path: str
    leave_out: list[str] = []
    flatness: float = FLATNESS
    heal: float | Literal["auto", "off"] = "auto"
    materials: Materials

    def build(self, base: Path = Path()) -> MeshRoom:
        materials = built("materials", self.materials, base)
        file = base / self.path
        content = read_toml(file)
        try:
            polygons = PolygonsFile.model_validate(content)
            rows, groups, labels = polygons.rows(self.leave_out)
        except ValidationError as error:
            raise InputError("path", f"{file}: {explain(error, content, PolygonsFile)}") from error
        except InputError as error:
            raise InputError(error.field, f"{file}: {error.problem}") from error
        by_name = by_group(tuple(dict.fromkeys(groups)), self.path, materials)
        return MeshRoom.from_polygons(
            list(polygons.corners.values()), rows, [by_name[group] for group in groups],
            double_sided=[i for i, group in enumerate(groups) if group in polygons.sheets], heal=self.heal,
            flatness=self.flatness, labels=labels,
        )  # fmt: skip


ObstacleModel = Annotated[
    Annotated[MeshModel, Tag("mesh")] | Annotated[PlanModel, Tag("plan")],
    Discriminator(lambda given: str(given.get("kind", "mesh")) if isinstance(given, dict) else "mesh"),
]


class _WithObstacles(Table):
    obstacles: list[ObstacleModel] = []

    def build(self, base: Path = Path()) -> Any:
        room = super().build(base)
        obstacles = [built(f"obstacles[{i}]", one, base) for i, one in enumerate(self.obstacles)]
        return MeshRoom.joined([room, *obstacles]) if obstacles else room

    def parts(self, base: Path) -> dict[str, Any]:
        return {name: value for name, value in super().parts(base).items() if name != "obstacles"}


class ShoeboxRoomModel(_WithObstacles):
    """A box-shaped room."""

    kind: Literal["shoebox"]
    size: Vector
    walls: Annotated[
        Annotated[MaterialModel, Tag("material")] | Annotated[WallsModel, Tag("walls")],
        Discriminator(
            lambda given: "walls" if isinstance(given, dict) and {*given} & {*WallsModel.model_fields} else "material"
        ),
    ]

    constructor = Shoebox

    def parts(self, base: Path) -> dict[str, Any]:
        walls, (x, y, z) = self.walls, self.size
        if not isinstance(walls, MaterialModel):
            return super().parts(base)
        room = x * y * z, 2.0 * (x * y + y * z + z * x)
        with inside("walls"):
            return {"size": self.size, "walls": walls.build(base, room)}


class MeshRoomModel(_WithObstacles, MeshModel):
    """A room from a mesh file."""

    kind: Literal["mesh"]


class PlanRoomModel(_WithObstacles, PlanModel):
    """A room over a floor plan."""

    kind: Literal["plan"]


class PolygonsRoomModel(_WithObstacles, PolygonsModel):
    """A room of polygons from a file."""


RoomModel = Annotated[ShoeboxRoomModel | MeshRoomModel | PlanRoomModel | PolygonsRoomModel, Field(discriminator="kind")]
