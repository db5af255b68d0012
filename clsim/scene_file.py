"""Scene files: TOML with the words of the constructors, checked field by field."""

from __future__ import annotations

import os
import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar, get_args

import numpy as np
from pydantic import BaseModel, ConfigDict, Discriminator, Field, Tag, ValidationError

from clsim.errors import InputError
from clsim.render.interpolator import Bandlimited, Interpolator, Lagrange, TruncatedLagrange
from clsim.scene.air import Air
from clsim.scene.directivity import Cardioid, Directivity, Omni, Piston, named_directivity
from clsim.scene.material import Material
from clsim.scene.room import Shoebox
from clsim.scene.scene import Receiver, Scene, Source
from clsim.scene.signal import Signal
from clsim.scene.trajectory import Trajectory

T = TypeVar("T")
Vector = Annotated[list[float], Field(min_length=3, max_length=3)]
Quaternion = Annotated[list[float], Field(min_length=4, max_length=4)]


class _Model(BaseModel):
    """Unknown keys, texts for numbers, NaN and infinity are errors."""

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)

    def arguments(self) -> dict[str, Any]:
        """Return the fields as arguments of the constructor: all but the kind."""
        return {name: getattr(self, name) for name in type(self).model_fields if name != "kind"}


class _Absorption(_Model):
    frequencies: list[float]
    coefficients: list[float]


class _Material(_Model):
    reflection: float | None = None
    named: str | None = None
    absorption: _Absorption | None = None

    def build(self) -> Material:
        given = self.model_dump(exclude_none=True)
        if len(given) != 1:
            raise InputError(
                "", f"must have one of reflection, named, absorption, but has {', '.join(given) or 'none'}"
            )
        if self.reflection is not None:
            factor = self.reflection
            if not -1.0 <= factor <= 1.0:
                raise InputError("reflection", f"must be from -1 to 1, but is {factor:g}")
            return Material.from_reflection(factor)
        if self.named is not None:
            return Material.named(self.named)
        return _within("absorption", lambda: Material.from_absorption(**given["absorption"]))


class _Walls(_Model):
    default: _Material | None = None
    x_min: _Material | None = None
    x_max: _Material | None = None
    y_min: _Material | None = None
    y_max: _Material | None = None
    z_min: _Material | None = None
    z_max: _Material | None = None

    def build(self) -> dict[str, Material]:
        given = {name: material for name, material in self.arguments().items() if material is not None}
        return {name: _within(name, material.build) for name, material in given.items()}


def _walls_kind(value: Any) -> str:
    keys = set(value) if isinstance(value, dict) else set()
    return "walls" if keys & set(_Walls.model_fields) else "material"


class _Room(_Model):
    kind: Literal["shoebox"]
    size: Vector
    walls: Annotated[
        Annotated[_Material, Tag("material")] | Annotated[_Walls, Tag("walls")], Discriminator(_walls_kind)
    ]

    def build(self) -> Shoebox:
        walls: Any = self.walls
        return Shoebox(np.array(self.size), _within("walls", walls.build))


class _Air(_Model):
    temperature_celsius: float = 20.0
    relative_humidity: float = 0.5
    pressure: float = 101_325.0
    speed_of_sound: float | Literal["iso9613"] | None = None


class _Tone(_Model):
    kind: Literal["tone"]
    frequency: float
    duration: float
    sampling_rate: float
    amplitude: float = 1.0
    phase: float = 0.0
    fade: float = 0.0

    def build(self, base: Path) -> Signal:
        return Signal.tone(**self.arguments())


class _Chirp(_Model):
    kind: Literal["chirp"]
    start: float
    stop: float
    duration: float
    sampling_rate: float
    method: Literal["linear", "exponential"] = "linear"
    window: Literal["none", "tukey", "hann"] = "none"
    amplitude: float = 1.0

    def build(self, base: Path) -> Signal:
        return Signal.chirp(**self.arguments())


class _Noise(_Model):
    kind: Literal["noise"]
    duration: float
    sampling_rate: float
    seed: int
    band: Annotated[list[float], Field(min_length=2, max_length=2)] | None = None
    rms: float = 1.0

    def build(self, base: Path) -> Signal:
        return Signal.noise(**self.arguments())


class _Sequence(_Model):
    kind: Literal["sequence"]
    sequence: Literal["mls", "gold"] = "mls"
    carrier: float
    chip_rate: float
    sampling_rate: float
    bits: int = 10
    code: int = 0
    repeats: int = 1
    rolloff: float = 0.5
    amplitude: float = 1.0

    def build(self, base: Path) -> Signal:
        arguments = self.arguments()
        return Signal.sequence(kind=arguments.pop("sequence"), **arguments)


class _Wav(_Model):
    kind: Literal["wav"]
    path: str
    channel: int = 0
    scale: float = 1.0

    def build(self, base: Path) -> Signal:
        return Signal.from_wav(base / self.path, channel=self.channel, scale=self.scale)


_Pulse = Annotated[_Tone | _Chirp | _Noise | _Sequence | _Wav, Field(discriminator="kind")]


class _Pulses(_Model):
    kind: Literal["pulses"]
    pulse: _Pulse
    period: float
    count: int

    def build(self, base: Path) -> Signal:
        return Signal.pulses(_within("pulse", lambda: self.pulse.build(base)), self.period, self.count)


class _Fixed(_Model):
    kind: Literal["fixed"]
    position: Vector
    orientation: Quaternion | None = None

    def build(self, base: Path) -> Trajectory:
        return Trajectory.fixed(self.position, orientation=self.orientation)


class _Line(_Model):
    kind: Literal["line"]
    start: Vector
    end: Vector
    duration: float

    def build(self, base: Path) -> Trajectory:
        return Trajectory.line(self.start, self.end, self.duration)


class _Circle(_Model):
    kind: Literal["circle"]
    center: Vector
    radius: float
    period: float
    duration: float
    axis: Vector = [0.0, 0.0, 1.0]
    phase: float = 0.0

    def build(self, base: Path) -> Trajectory:
        return Trajectory.circle(**self.arguments())


class _Waypoints(_Model):
    kind: Literal["waypoints"]
    times: list[float]
    positions: list[Vector]
    orientations: list[Quaternion] | None = None
    smooth: bool = True

    def build(self, base: Path) -> Trajectory:
        return Trajectory.waypoints(**self.arguments())


class _File(_Model):
    kind: Literal["file"]
    path: str
    format: Literal["tum", "euroc", "csv"]
    smooth: bool | float = True
    time_offset: float = 0.0
    rotate: Quaternion = [0.0, 0.0, 0.0, 1.0]
    scale: float = 1.0
    translate: Vector = [0.0, 0.0, 0.0]
    repair: list[Literal["times", "gaps", "nan", "jumps"]] = []
    max_speed: float = 20.0
    max_gap: float | None = None

    def build(self, base: Path) -> Trajectory:
        arguments = self.arguments()
        return Trajectory.from_file(base / arguments.pop("path"), **arguments)


class _Omni(_Model):
    kind: Literal["omni"] = "omni"

    def build(self) -> Directivity:
        return Omni()


class _Cardioid(_Model):
    kind: Literal["cardioid"]
    weight: float = 0.5

    def build(self) -> Directivity:
        return Cardioid(self.weight)


class _Piston(_Model):
    kind: Literal["piston"]
    radius: float

    def build(self) -> Directivity:
        return Piston(self.radius)


class _Named(_Model):
    kind: Literal["named"]
    name: str

    def build(self) -> Directivity:
        return named_directivity(self.name)


_Signal = Annotated[_Tone | _Chirp | _Noise | _Sequence | _Wav | _Pulses, Field(discriminator="kind")]
_Trajectory = Annotated[_Fixed | _Line | _Circle | _Waypoints | _File, Field(discriminator="kind")]
_Directivity = Annotated[_Omni | _Cardioid | _Piston | _Named, Field(discriminator="kind")]


class _Receiver(_Model):
    name: str
    trajectory: _Trajectory
    directivity: _Directivity = _Omni()
    aim: Vector | None = None

    def build(self, base: Path) -> Receiver:
        trajectory = _within("trajectory", lambda: self.trajectory.build(base))
        return Receiver(self.name, trajectory, _within("directivity", self.directivity.build), self.aim)


class _Source(_Receiver):
    signal: _Signal
    start: float = 0.0

    def build(self, base: Path) -> Source:  # type: ignore[override]
        end = super().build(base)
        signal = _within("signal", lambda: self.signal.build(base))
        return Source(end.name, signal, end.trajectory, end.directivity, self.aim, self.start)


class _Lagrange(_Model):
    kind: Literal["lagrange"]
    order: int = 12

    def build(self) -> Interpolator:
        return Lagrange(self.order)


class _TruncatedLagrange(_Model):
    kind: Literal["truncated-lagrange"]
    order: int
    length: int

    def build(self) -> Interpolator:
        return TruncatedLagrange(self.order, self.length)


class _Bandlimited(_Model):
    kind: Literal["bandlimited"] = "bandlimited"
    error_db: float = -90.0

    def build(self) -> Interpolator:
        return Bandlimited(self.error_db)


_Interpolator = Annotated[_Lagrange | _TruncatedLagrange | _Bandlimited, Field(discriminator="kind")]


class _Paths(_Model):
    max_order: int


class _Render(_Model):
    sampling_rate: float
    interpolator: Annotated[_Lagrange | _TruncatedLagrange | _Bandlimited, Field(discriminator="kind")] = _Bandlimited()
    motion: Literal["retarded", "quasi-static"] = "retarded"
    amplitude: Literal["wave-equation", "static", "convective"] = "wave-equation"
    engine: Literal["opencl", "reference"] = "opencl"
    device: str | None = None
    duration: float | None = None
    chunk: int | None = None


class SceneModel(_Model):
    """A whole scene file."""

    format: Annotated[int, Field(ge=1, le=1)]
    min_distance: float = 0.01
    room: _Room
    air: _Air = _Air()
    sources: list[_Source]
    receivers: list[_Receiver]
    paths: _Paths
    render: _Render


@dataclass(frozen=True, slots=True, eq=False)
class SceneFile:
    """A scene as read from a file.

    Attributes
    ----------
    scene : Scene
        What it describes.
    max_order : int
        For `find_paths`.
    render : dict
        Keyword arguments of `render`.
    model : SceneModel
        The file itself, defaults included.
    base : Path
        Folder to which the file's paths are relative.
    """

    scene: Scene
    max_order: int
    render: dict[str, Any]
    model: SceneModel
    base: Path


def load_scene(path: str | os.PathLike[str]) -> SceneFile:
    """Read a scene file.

    Parameters
    ----------
    path : path-like
        A TOML file.

    Raises
    ------
    InputError
        If the file is missing or no TOML, or a field breaks a rule; the message names file or field, rule and value.
    """
    path = Path(path)
    try:
        content = tomllib.loads(path.read_text("utf-8"))
    except OSError as error:
        raise InputError(str(path), f"cannot be read: {error.strerror or error}") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(str(path), f"is no TOML file: {error}") from error
    return build_scene(content, path.parent)


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
        raise _explain(error, content) from error
    sources = [_within(f"sources[{i}]", partial(end.build, base)) for i, end in enumerate(model.sources)]
    receivers = [_within(f"receivers[{i}]", partial(end.build, base)) for i, end in enumerate(model.receivers)]
    room = _within("room", model.room.build)
    air = _within("air", lambda: Air(**model.air.arguments()))
    scene = Scene(room, air, sources, receivers, model.min_distance)
    arguments = model.render.arguments()
    arguments["interpolator"] = _within("render.interpolator", model.render.interpolator.build)
    return SceneFile(scene, model.paths.max_order, arguments, model, base)


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
    for end in [*content["sources"], *content["receivers"]]:
        for part in (end["trajectory"], end.get("signal", {}), end.get("signal", {}).get("pulse", {})):
            if "path" in part:
                part["path"] = Path(os.path.relpath(file.base / part["path"], folder)).as_posix()
    return tomli_w.dumps(content)


def scene_schema() -> dict[str, Any]:
    """Return the JSON schema of scene files, for editors."""
    return SceneModel.model_json_schema()


def _within(parent: str, build: Callable[[], T]) -> T:
    try:
        return build()
    except InputError as error:
        raise error.within(parent) from error


def _explain(error: ValidationError, content: Any) -> InputError:
    """Return the first of pydantic's complaints in our words, with the field's path."""
    first = error.errors(include_url=False)[0]
    field, at = "", content
    steps = first["loc"]
    for i, step in enumerate(steps):
        known = isinstance(at, dict | list) and (step in at if isinstance(at, dict) else isinstance(step, int))
        if isinstance(step, str) and not known and i < len(steps) - 1:
            continue  # the name of a union's member, which no file holds
        if isinstance(step, str) and not known and first["type"] not in ("missing", "extra_forbidden"):
            continue
        field += f"[{step}]" if isinstance(step, int) else f".{step}" if field else step
        at = at[step] if known else None
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


def _choices(field: str) -> str:
    """Return the kinds that a field can be of."""
    unions: dict[str, Any] = {
        "trajectory": _Trajectory,
        "signal": _Signal,
        "directivity": _Directivity,
        "pulse": _Pulse,
    }
    union = unions.get(field.rpartition(".")[2], _Interpolator)
    members = get_args(get_args(union)[0])
    return ", ".join(repr(get_args(member.model_fields["kind"].annotation)[0]) for member in members)
