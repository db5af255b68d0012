"""Scene files: TOML with the words of the constructors, checked field by field."""

from __future__ import annotations

import os
from dataclasses import MISSING, dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_type_hints

from pydantic import Discriminator, Field, Tag, ValidationError, create_model

from clsim.arrays import short_repr
from clsim.errors import inside
from clsim.paths.options import DEFAULT_PATH_LIMIT, PathOptions
from clsim.render.baseband import Baseband
from clsim.render.interpolator import Bandlimited, Lagrange, TruncatedLagrange
from clsim.render.options import RenderOptions
from clsim.scene.air import Air
from clsim.scene.ends import Receiver, Source
from clsim.scene.fluctuation import Fluctuation
from clsim.scene.receiver_array import grid_positions, positions_from_file, receiver_array
from clsim.scene.scene import Scene
from clsim.scene_file import ends
from clsim.scene_file.model import PATHS, Model, Numbers, Pair, Table, Vector, built, explain, one_of, table
from clsim.scene_file.rooms import RoomModel


class _Bandlimited(Table):
    kind: Literal["bandlimited"] = "bandlimited"
    error_db: float = -90.0

    constructor = Bandlimited


# Options whose values are no plain ones of TOML: type and default in the file.
_TABLES: dict[str, tuple[Any, Any]] = {
    "interpolator": (
        one_of(table("lagrange", Lagrange), table("truncated-lagrange", TruncatedLagrange), _Bandlimited),
        _Bandlimited(),
    ),
    "baseband": (
        table("", Baseband, name="_Baseband", carrier=float, bandwidth=float, sampling_rate=float | None) | None,
        None,
    ),
}


class RenderTable(Table):
    """Base of the ``[render]`` table, whose keys `render_model` adds, and which gives keyword arguments of `render`."""

    constructor = dict


def render_model(options: type[Any]) -> type[RenderTable]:
    """Return the model of a scene file's table that has a key for each field of a dataclass of options."""
    types = get_type_hints(options)
    plain = {f.name: (types[f.name], ... if f.default is MISSING else f.default) for f in fields(options)}
    keys: dict[str, Any] = plain | {name: form for name, form in _TABLES.items() if name in plain}
    return create_model("_Render", __base__=RenderTable, **keys)


if TYPE_CHECKING:
    RenderModel = RenderTable
    AirModel = Table
    PositionsModel = Table
else:
    RenderModel = render_model(RenderOptions)
    AirModel = table(
        "", Air, name="_Air", without="extent _requested_speed", temperature_celsius=float | Pair,
        relative_humidity=float | Pair, speed_of_sound=float | Literal["iso9613"] | None, heights=Pair | None,
        fluctuation=table("", Fluctuation, name="_Fluctuation") | None,
    )  # fmt: skip
    PositionsModel = one_of(
        table("grid", grid_positions, x=float | Numbers, y=float | Numbers, z=float | Numbers),
        table("file", positions_from_file, name="_PositionsFile"),
    )


class _Common(Table):
    name: str
    directivity: ends.DirectivityModel = ends.OmniModel()
    aim: Vector | Literal["forward"] | None = None
    aim_at: Vector | None = None
    transducer: ends.TransducerModel | None = None
    flush: bool | Vector = False
    mounted_on: str | None = None


class _Receiver(_Common):
    trajectory: ends.TrajectoryModel
    electronics: ends.ElectronicsModel | None = None

    constructor = Receiver


class _ReceiverArray(_Common):
    positions: PositionsModel
    trajectory: ends.TrajectoryModel | None = None  # positions are in its frame then
    electronics: ends.ElectronicsModel | None = None

    constructor = staticmethod(receiver_array)


class _Source(_Common):
    trajectory: ends.TrajectoryModel
    signal: ends.SignalModel
    start: float = 0.0

    constructor = Source


class _Direct(Model):
    source: str
    receiver: str
    level_db: float | None = None  # left out without


class _Paths(Model):
    max_order: int
    diffraction: int = 0
    diffraction_model: Literal["utd", "btm"] | None = None  # "utd" where left out
    scatterers_in_row: int | None = None
    edge_scattering: bool | None = None
    scattering_order: int | None = None  # 0 where left out; scenes without scatterers do not name it
    body_order: int | None = None  # max_order where left out
    body_step: float | None = None  # 0.01 m where left out
    direct: bool | float | list[_Direct] | None = None  # true where left out
    finder: Literal["auto", "beam-tree", "shooting"] = "auto"
    resolution: float | None = None
    path_limit: int = DEFAULT_PATH_LIMIT

    def arguments(self) -> dict[str, Any]:
        """Return the arguments of `find_paths` that are given or have a default here."""
        own = super().arguments()
        given = {name: value for name, value in own.items() if value is not None or name == "resolution"}
        if isinstance(self.direct, list):
            levels = {(p.source, p.receiver): False if p.level_db is None else p.level_db for p in self.direct}
            given["direct"] = levels
        return given


class SceneModel(Model):
    """A whole scene file."""

    format: Annotated[int, Field(ge=1, le=1)]
    min_distance: float = 0.01
    room: RoomModel
    air: AirModel = AirModel()
    sources: list[_Source]
    receivers: list[
        Annotated[
            Annotated[_Receiver, Tag("one")] | Annotated[_ReceiverArray, Tag("array")],
            Discriminator(lambda given: "array" if isinstance(given, dict) and "positions" in given else "one"),
        ]
    ]
    scatterers: list[ends.ScattererModel] | None = None
    bodies: list[ends.BodyModel] | None = None
    paths: _Paths
    render: RenderModel


@dataclass(frozen=True, slots=True, eq=False)
class SceneFile:
    """A scene as read from a file."""

    scene: Scene  # what it describes
    paths: dict[str, Any]  # arguments of `find_paths`, but for the scene
    render: dict[str, Any]  # keyword arguments of `render`
    model: SceneModel  # the file itself, defaults included
    base: Path  # folder to which the file's paths are relative
    name: str = ""  # path of the file, which errors name; "" if fields were given otherwise

    __repr__ = short_repr

    def with_render(self, **changes: Any) -> SceneFile:
        """Return the file with other values of its ``[render]``."""
        render = self.model.render.model_copy(update=changes)
        model = self.model.model_copy(update={"render": render})
        search = {name: value for name, value in changes.items() if name in self.paths}
        name = "" if changes else self.name
        return replace(self, model=model, paths=self.paths | search, render=self.render | changes, name=name)

    def on_device(self, device: str) -> SceneFile:
        """Return the file with a device of this machine, unless the file names one."""
        if self.render["device"] is not None:
            return self
        return replace(self, paths=self.paths | {"device": device}, render=self.render | {"device": device})


def build_scene(content: dict[str, Any], base: Path) -> SceneFile:
    """Return the scene that the content of a scene file describes."""
    try:
        model = SceneModel.model_validate(content)
    except ValidationError as error:
        raise explain(error, content, SceneModel) from error
    parts: dict[str, Any] = {}
    for field in ("sources", "receivers", "scatterers", "bodies"):
        things = [built(f"{field}[{i}]", one, base) for i, one in enumerate(getattr(model, field) or [])]
        parts[field] = [one for found in things for one in (found if isinstance(found, list) else [found])]
    parts["room"], parts["air"] = (built(field, getattr(model, field), base) for field in ("room", "air"))
    arguments = built("render", model.render, base)
    scene = Scene(**parts, min_distance=model.min_distance)
    search = model.paths.arguments() | {name: arguments[name] for name in ("engine", "device")}
    with inside("paths"):
        PathOptions(**search)  # find_paths and render refuse the same, but later
    with inside("render"):
        RenderOptions(**arguments)
    return SceneFile(scene, search, arguments, model, base)


def completed_scene(file: SceneFile, folder: Path, **resolved: Any) -> str:
    """Return the text of a scene file with every default written out, that works from another folder."""
    import tomli_w

    content = file.model.model_dump(exclude_none=True, warnings=False)
    content["render"] |= resolved
    for part, key in _paths_within(content):
        part[key] = Path(os.path.relpath(file.base / part[key], folder)).as_posix()
    return tomli_w.dumps(content)


def referenced_files(file: SceneFile) -> list[Path]:
    """Return the files that a scene file names: meshes, sounds, tables, trajectories; all those of a bag's folder."""
    content = file.model.model_dump(exclude_none=True, warnings=False)
    named = [file.base / part[key] for part, key in _paths_within(content)]
    inside = {path: sorted(one for one in path.rglob("*") if one.is_file()) for path in named if path.is_dir()}
    return [found for path in named for found in inside.get(path, [path])]


def _paths_within(content: Any) -> list[tuple[dict[str, Any], str]]:
    """Return tables of a scene file, at any depth, that name a file, and the keys that do."""
    parts = content.values() if isinstance(content, dict) else content if isinstance(content, list) else ()
    here = [(content, key) for key in PATHS if isinstance(content, dict) and isinstance(content.get(key), str)]
    return [*here, *(found for part in parts for found in _paths_within(part))]


def scene_schema() -> dict[str, Any]:
    """Return the JSON schema of scene files, for editors."""
    return SceneModel.model_json_schema()
