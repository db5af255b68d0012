"""Scene files: TOML with the words of the constructors, checked field by field."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

from pydantic import Discriminator, Field, Tag, ValidationError

from clsim.arrays import Floats
from clsim.errors import InputError
from clsim.paths.find_paths import DEFAULT_PATH_LIMIT
from clsim.scene.air import Air
from clsim.scene.ends import Receiver, Source
from clsim.scene.fluctuation import Fluctuation
from clsim.scene.receiver_array import grid_positions, positions_from_file, receiver_array
from clsim.scene.scatterer import Scatterer
from clsim.scene.scene import Scene
from clsim.scene_file.bodies import BodyModel
from clsim.scene_file.directivities import DirectivityModel, OmniModel
from clsim.scene_file.model import Model, Pair, Vector, within
from clsim.scene_file.motion_and_signals import PulseModel, SignalModel, TrajectoryModel
from clsim.scene_file.render_options import InterpolatorModel, RenderModel
from clsim.scene_file.rooms import RoomModel
from clsim.scene_file.transducers import ElectronicsModel, TransducerModel

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
    aim: Vector | None = None
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


class _Scatterer(Model):
    name: str
    trajectory: TrajectoryModel

    def parts(self, base: Path) -> dict[str, Any]:
        """Return the arguments of the constructor of this kind."""
        return self.arguments() | {"trajectory": within("trajectory", lambda: self.trajectory.build(base))}


class _Point(_Scatterer):
    kind: Literal["point"]
    target_strength_db: float

    def build(self, base: Path) -> Scatterer:
        return Scatterer.point(**self.parts(base))


class _Sphere(_Scatterer):
    kind: Literal["sphere"]
    radius: float
    model: Literal["series", "geometrical"] = "series"

    def build(self, base: Path) -> Scatterer:
        return Scatterer.sphere(**self.parts(base))


class _Ellipsoid(_Scatterer):
    kind: Literal["ellipsoid"]
    semi_axes: Vector

    def build(self, base: Path) -> Scatterer:
        return Scatterer.ellipsoid(**self.parts(base))


ScattererModel = Annotated[_Point | _Sphere | _Ellipsoid, Field(discriminator="kind")]


class _Paths(Model):
    max_order: int
    diffraction: int = 0
    scattering_order: int | None = None  # 0 where left out; scenes without scatterers do not name it
    body_order: int | None = None  # max_order where left out
    body_step: float | None = None  # 0.01 m where left out
    direct: bool | None = None  # true where left out
    finder: Literal["auto", "beam-tree", "shooting"] = "auto"
    resolution: float | None = None
    path_limit: int = DEFAULT_PATH_LIMIT

    def arguments(self) -> dict[str, Any]:
        """Return the arguments of `find_paths` that are given or have a default here."""
        return {
            name: value
            for name, value in super().arguments().items()
            if name not in ("scattering_order", "body_order", "body_step", "direct") or value is not None
        }


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
    """A scene as read from a file.

    Attributes
    ----------
    scene : Scene
        What it describes.
    paths : dict
        Arguments of `find_paths`, but for the scene.
    render : dict
        Keyword arguments of `render`.
    model : SceneModel
        The file itself, defaults included.
    base : Path
        Folder to which the file's paths are relative.
    """

    scene: Scene
    paths: dict[str, Any]
    render: dict[str, Any]
    model: SceneModel
    base: Path

    def with_render(self, **changes: Any) -> SceneFile:
        """Return the file with other values of its ``[render]``."""
        render = self.model.render.model_copy(update=changes)
        model = self.model.model_copy(update={"render": render})
        search = {name: value for name, value in changes.items() if name in self.paths}
        return replace(self, model=model, paths=self.paths | search, render=self.render | changes)

    def on_device(self, device: str) -> SceneFile:
        """Return the file for a device of this machine, of which its text says nothing; one that it names stays."""
        if self.render["device"] is not None:
            return self
        return replace(self, paths=self.paths | {"device": device}, render=self.render | {"device": device})


def build_scene(content: dict[str, Any], base: Path) -> SceneFile:
    """Return the scene that the content of a scene file describes.

    Raises
    ------
    InputError
        If a field breaks a rule.
    """
    try:
        model = SceneModel.model_validate(content)
    except ValidationError as error:
        raise explain(error, content) from error
    sources = [within(f"sources[{i}]", partial(end.build, base)) for i, end in enumerate(model.sources)]
    entries = [within(f"receivers[{i}]", partial(entry.build, base)) for i, entry in enumerate(model.receivers)]
    receivers = [receiver for entry in entries for receiver in entry]
    things = model.scatterers or []
    scatterers = [within(f"scatterers[{i}]", partial(thing.build, base)) for i, thing in enumerate(things)]
    bodies = [within(f"bodies[{i}]", partial(body.build, base)) for i, body in enumerate(model.bodies or [])]
    room = within("room", lambda: model.room.build(base))
    air = within("air", model.air.build)
    scene = Scene(room, air, sources, receivers, model.min_distance, scatterers, bodies)
    arguments = within("render", model.render.build)
    search = model.paths.arguments() | {name: arguments[name] for name in ("engine", "device")}
    return SceneFile(scene, search, arguments, model, base)


def completed_scene(file: SceneFile, folder: Path, **resolved: Any) -> str:
    """Return the text of a scene file with every default written out, that works from another folder.

    Parameters
    ----------
    file : SceneFile
        What was read.
    folder : Path
        Where the text will be kept: paths are made relative to it.
    **resolved
        Values of ``[render]`` that were chosen for this run.
    """
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
    """Return the tables of a scene file that name a file, however deep they stand, and the keys that do."""
    parts = content.values() if isinstance(content, dict) else content if isinstance(content, list) else ()
    here = [(content, key) for key in _PATHS if isinstance(content, dict) and isinstance(content.get(key), str)]
    return [*here, *(found for part in parts for found in _paths_within(part))]


def scene_schema() -> dict[str, Any]:
    """Return the JSON schema of scene files, for editors."""
    return SceneModel.model_json_schema()


def explain(error: ValidationError, content: Any) -> InputError:
    """Return one of pydantic's complaints in our words, with the field's path."""
    # A misspelt key comes before what is then missing; of a number or a list of numbers, what is wrong within the list.
    complaints = error.errors(include_url=False)
    first = min(complaints, key=lambda complaint: complaint["type"] != "extra_forbidden")
    field = _field_of(first, content)
    for complaint in complaints:
        inner = _field_of(complaint, content)
        if inner.startswith(f"{field}["):
            first, field = complaint, inner
    kind, context = first["type"], first.get("ctx", {})
    if kind == "missing":
        return InputError(field, "must be given, but is missing")
    if kind == "extra_forbidden":
        return InputError(field, "is no known key")
    if kind == "union_tag_not_found":
        return InputError(f"{field}.kind", f"must be one of {_choices(field)}, but is missing")
    if kind == "union_tag_invalid":
        return InputError(f"{field}.kind", f"must be one of {context['expected_tags']}, but is {context['tag']!r:.80}")
    message = first["msg"].replace("Input should be ", "must be ")
    return InputError(field, f"{message}, but is {first['input']!r:.80}")


def _field_of(complaint: Any, content: Any) -> str:
    """Return the path of the field that pydantic complains of."""
    field, at, steps = "", content, complaint["loc"]
    for i, step in enumerate(steps):
        known = isinstance(at, dict | list) and (step in at if isinstance(at, dict) else isinstance(step, int))
        if isinstance(step, str) and not known and i < len(steps) - 1:
            continue  # the name of a union's member, which no file holds
        if isinstance(step, str) and not known and complaint["type"] not in ("missing", "extra_forbidden"):
            continue
        word = step or '""'  # an empty key is one, too
        field += f"[{step}]" if isinstance(step, int) else f".{word}" if field else str(word)
        at = at[step] if known else None
    return field


def _choices(field: str) -> str:
    """Return the kinds that a field can be of."""
    unions: dict[str, Any] = {
        "trajectory": TrajectoryModel,
        "signal": SignalModel,
        "directivity": DirectivityModel,
        "pulse": PulseModel,
        "transducer": TransducerModel,
        "room": RoomModel,
        "scatterers": ScattererModel,
        "bodies": BodyModel,
    }
    union = unions.get(field.rpartition(".")[2].partition("[")[0], InterpolatorModel)
    members = get_args(get_args(union)[0])
    return ", ".join(repr(get_args(member.model_fields["kind"].annotation)[0]) for member in members)
