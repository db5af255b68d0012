"""Scene files: TOML with the words of the constructors, checked field by field."""

from __future__ import annotations

import os
from dataclasses import MISSING, dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_type_hints

from pydantic import Discriminator, Field, Tag, ValidationError, create_model

from clsim.arrays import Floats, short_repr
from clsim.paths.options import DEFAULT_PATH_LIMIT
from clsim.render.baseband import Baseband
from clsim.render.interpolator import Bandlimited, Interpolator, Lagrange, TruncatedLagrange
from clsim.render.options import RenderOptions
from clsim.scene.air import Air
from clsim.scene.ends import Receiver, Source
from clsim.scene.fluctuation import Fluctuation
from clsim.scene.receiver_array import grid_positions, positions_from_file, receiver_array
from clsim.scene.scene import Scene
from clsim.scene_file.bodies import BodyModel, ScattererModel
from clsim.scene_file.explain import explain
from clsim.scene_file.model import Model, Pair, Vector, within
from clsim.scene_file.motion_and_signals import SignalModel, TrajectoryModel
from clsim.scene_file.rooms import RoomModel
from clsim.scene_file.transducers import DirectivityModel, ElectronicsModel, OmniModel, TransducerModel


class _Part(Model):
    def build(self) -> Any:
        raise NotImplementedError


class _Lagrange(_Part):
    kind: Literal["lagrange"]
    order: int = 12

    def build(self) -> Interpolator:
        return Lagrange(self.order)


class _TruncatedLagrange(_Part):
    kind: Literal["truncated-lagrange"]
    order: int
    length: int

    def build(self) -> Interpolator:
        return TruncatedLagrange(self.order, self.length)


class _Bandlimited(_Part):
    kind: Literal["bandlimited"] = "bandlimited"
    error_db: float = -90.0

    def build(self) -> Interpolator:
        return Bandlimited(self.error_db)


class _Baseband(_Part):
    carrier: float
    bandwidth: float
    sampling_rate: float | None = None

    def build(self) -> Baseband:
        return Baseband(self.carrier, self.bandwidth, self.sampling_rate)


InterpolatorModel = Annotated[_Lagrange | _TruncatedLagrange | _Bandlimited, Field(discriminator="kind")]
# Options whose values are no plain ones of TOML: type and default in the file.
_TABLES: dict[str, tuple[Any, Any]] = {
    "interpolator": (InterpolatorModel, _Bandlimited()),
    "baseband": (_Baseband | None, None),
}


class RenderTable(Model):
    """Base of the ``[render]`` table, to which `render_model` adds the keys."""

    def build(self) -> dict[str, Any]:
        """Return the keyword arguments of `render`."""
        return {
            name: within(name, value.build) if isinstance(value, _Part) else value
            for name, value in self.arguments().items()
        }


def render_model(options: type[Any]) -> type[RenderTable]:
    """Return the model of a scene file's table that has a key for each field of a dataclass of options."""
    types = get_type_hints(options)
    plain = {f.name: (types[f.name], ... if f.default is MISSING else f.default) for f in fields(options)}
    keys: dict[str, Any] = plain | {name: form for name, form in _TABLES.items() if name in plain}
    return create_model("_Render", __base__=RenderTable, **keys)


if TYPE_CHECKING:
    RenderModel = RenderTable
else:
    RenderModel = render_model(RenderOptions)


_PATHS = ("path", "phases_path")  # keys that name files


class _Fluctuation(Model):
    rms: float
    correlation_time: float
    correlation_length: float
    seed: int = 0


class _Air(Model):
    temperature_celsius: float | Pair = 20.0
    relative_humidity: float | Pair = 0.5
    pressure: float = 101_325.0
    speed_of_sound: float | Literal["iso9613"] | None = None
    absorption: bool = True
    dispersion: bool = False
    wind: Vector | None = None
    heights: Pair | None = None
    fluctuation: _Fluctuation | None = None

    def build(self) -> Air:
        arguments, noise = self.arguments(), self.fluctuation
        if noise is not None:
            arguments["fluctuation"] = within("fluctuation", lambda: Fluctuation(**noise.arguments()))
        return Air(**arguments)


class _Common(Model):
    name: str
    directivity: DirectivityModel = OmniModel()
    aim: Vector | Literal["forward"] | None = None
    aim_at: Vector | None = None
    transducer: TransducerModel | None = None
    flush: bool | Vector = False
    mounted_on: str | None = None

    def parts(self, base: Path) -> dict[str, Any]:
        """Return the arguments that sources, receivers and arrays of them share."""
        model = self.transducer
        return {
            "name": self.name,
            "directivity": within("directivity", lambda: self.directivity.build(base)),
            "aim": self.aim,
            "aim_at": self.aim_at,
            "flush": self.flush,
            "mounted_on": self.mounted_on,
            "transducer": None if model is None else within("transducer", lambda: model.build(base)),
        }


class _End(_Common):
    trajectory: TrajectoryModel

    def parts(self, base: Path) -> dict[str, Any]:
        """Return the arguments that sources and receivers share."""
        return super().parts(base) | {"trajectory": within("trajectory", lambda: self.trajectory.build(base))}


class _Receiver(_End):
    electronics: ElectronicsModel | None = None

    def build(self, base: Path) -> list[Receiver]:
        model = self.electronics
        electronics = None if model is None else within("electronics", model.build)
        return [Receiver(**self.parts(base), electronics=electronics)]


class _Grid(Model):
    kind: Literal["grid"]
    x: float | list[float]
    y: float | list[float]
    z: float | list[float]

    def build(self, base: Path) -> Floats:
        return grid_positions(self.x, self.y, self.z)


class _PositionsFile(Model):
    kind: Literal["file"]
    path: str

    def build(self, base: Path) -> Floats:
        return positions_from_file(base / self.path)


class _ReceiverArray(_Common):
    positions: Annotated[_Grid | _PositionsFile, Field(discriminator="kind")]
    electronics: ElectronicsModel | None = None

    def build(self, base: Path) -> list[Receiver]:
        model = self.electronics
        electronics = None if model is None else within("electronics", model.build)
        positions = within("positions", lambda: self.positions.build(base))
        return receiver_array(positions=positions, electronics=electronics, **self.parts(base))


def _receiver_kind(value: Any) -> str:
    return "array" if isinstance(value, dict) and "positions" in value else "one"


class _Source(_End):
    signal: SignalModel
    start: float = 0.0

    def build(self, base: Path) -> Source:
        signal = within("signal", lambda: self.signal.build(base))
        return Source(**self.parts(base), signal=signal, start=self.start)


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
        given = {
            name: value for name, value in super().arguments().items() if value is not None or name == "resolution"
        }
        if isinstance(self.direct, list):
            levels = [False if pair.level_db is None else pair.level_db for pair in self.direct]
            names = [(pair.source, pair.receiver) for pair in self.direct]
            given["direct"] = dict(zip(names, levels, strict=True))
        return given


class SceneModel(Model):
    """A whole scene file."""

    format: Annotated[int, Field(ge=1, le=1)]
    min_distance: float = 0.01
    room: RoomModel
    air: _Air = _Air()
    sources: list[_Source]
    receivers: list[
        Annotated[
            Annotated[_Receiver, Tag("one")] | Annotated[_ReceiverArray, Tag("array")], Discriminator(_receiver_kind)
        ]
    ]
    scatterers: list[ScattererModel] | None = None
    bodies: list[BodyModel] | None = None
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

    __repr__ = short_repr

    def with_render(self, **changes: Any) -> SceneFile:
        """Return the file with other values of its ``[render]``."""
        render = self.model.render.model_copy(update=changes)
        model = self.model.model_copy(update={"render": render})
        search = {name: value for name, value in changes.items() if name in self.paths}
        return replace(self, model=model, paths=self.paths | search, render=self.render | changes)

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
    sources = [within(f"sources[{i}]", partial(end.build, base)) for i, end in enumerate(model.sources)]
    entries = [within(f"receivers[{i}]", partial(entry.build, base)) for i, entry in enumerate(model.receivers)]
    receivers = [receiver for entry in entries for receiver in entry]
    things = [within(f"scatterers[{i}]", partial(t.build, base)) for i, t in enumerate(model.scatterers or [])]
    scatterers = [scatterer for thing in things for scatterer in thing]
    bodies = [within(f"bodies[{i}]", partial(body.build, base)) for i, body in enumerate(model.bodies or [])]
    room = within("room", lambda: model.room.build(base))
    air = within("air", model.air.build)
    scene = Scene(room, air, sources, receivers, model.min_distance, scatterers, bodies)
    arguments = within("render", model.render.build)
    search = model.paths.arguments() | {name: arguments[name] for name in ("engine", "device")}
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
    here = [(content, key) for key in _PATHS if isinstance(content, dict) and isinstance(content.get(key), str)]
    return [*here, *(found for part in parts for found in _paths_within(part))]


def scene_schema() -> dict[str, Any]:
    """Return the JSON schema of scene files, for editors."""
    return SceneModel.model_json_schema()
