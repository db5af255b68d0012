"""Study files: TOML with a scene file and the fields to vary."""

from __future__ import annotations

import copy
import itertools
import json
import math
import os
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, ValidationError

from clsim.arrays import as_count, as_number
from clsim.errors import InputError, check_packages, inside
from clsim.files.input_files import read_toml
from clsim.scene_file.model import UNKNOWN, Model, explain
from clsim.scene_file.scene import SceneFile, build_scene, referenced_files
from clsim.study.draws import NoiseModel, Place, RandomModel, draws

_STEP = re.compile(r"([A-Za-z_][A-Za-z0-9_]*)|\[(\d+|\*)\]")
Keep = Literal["recording", "direct", "reverberant", "noise", "ground_truth", "paths", "room_measures", "metrics"]
PARTS = {"direct", "reverberant"}  # of the sound of paths
SOUNDS = PARTS | {"recording", "noise"}
DEFAULT_LIMIT = 1000
_COUNTABLE = 10**18  # members
TAKEN = ("member", "status", "seconds", "error", "receiver")  # names in the summary
# Of members in shards, beside those of variables.
LABELS = {"key", "warnings", "files", "sha256", "full_scale", *(f"full_scale_{part}" for part in SOUNDS)}


def parsed(path: str) -> list[str | int]:
    """Return the steps of a dotted path: keys, indices, and ``"*"`` for all of a list."""
    steps: list[str | int] = []
    at = 0
    while at < len(path):
        if at and path[at] == ".":
            at += 1
        elif at and path[at] != "[":
            break
        found = _STEP.match(path, at)
        if found is None:
            break
        key, index = found.groups()
        steps.append(key or (index if index == "*" else int(index)))
        at = found.end()
    if at < len(path) or not steps or not isinstance(steps[0], str):
        raise InputError("", f"must be a dotted path such as sources[0].trajectory.start, but is {path!r:.80}")
    return steps


def replaced(content: dict[str, Any], path: str, value: Any) -> dict[str, Any]:
    """Return the content of a scene file with another value of a field; tables that are missing are made."""
    content = copy.deepcopy(content)
    _put(content, parsed(path), value, "")
    return content


def _put(at: Any, steps: list[str | int], value: Any, where: str) -> None:
    step, rest = steps[0], steps[1:]
    if isinstance(step, int) or step == "*":
        if not isinstance(at, list):
            raise InputError("", f"must be a field of the scene, but {where} is no list")
        if isinstance(step, int) and step >= len(at):
            raise InputError("", f"must be a field of the scene, but {where} has {len(at)} entries and none [{step}]")
        chosen = [step] if isinstance(step, int) else range(len(at))
        for i in chosen:
            if rest:
                _put(at[i], rest, value, f"{where}[{i}]")
            else:
                at[i] = copy.deepcopy(value)
        return
    if not isinstance(at, dict):
        raise InputError("", f"must be a field of the scene, but {where} is no table")
    where = f"{where}.{step}" if where else str(step)
    if not rest:
        at[step] = copy.deepcopy(value)
        return
    if step not in at and not isinstance(rest[0], str):
        raise InputError("", f"must be a field of the scene, but {where} is not given there")
    _put(at.setdefault(step, {}), rest, value, where)


class _Range(Model):
    start: float
    stop: float
    count: Annotated[int, Field(ge=1)]


class _Vary(Model):
    field: str | list[str]
    name: str | list[str] | None = None
    values: list[Any] | None = None
    range: _Range | None = None
    random: RandomModel | None = None


class ShardsModel(Model):
    """The table ``[shards]`` of a study: results in archives of many members."""

    members: Annotated[int, Field(ge=1, le=100_000)] = 100  # of each
    format: Literal["wav", "flac"] = "wav"


class _StudyModel(Model):
    """A whole study file."""

    format: Annotated[int, Field(ge=1, le=1)]
    scene: str
    keep: list[Keep] | None = None
    metrics: str | None = None
    table_rate: float = 100.0
    draws: int | None = None
    seed: int = 0
    noise: NoiseModel | None = None
    shards: ShardsModel | None = None
    vary: Annotated[list[_Vary], Field(min_length=1)]


@dataclass(frozen=True, slots=True, eq=False)
class Member:
    """One scene of a study."""

    number: int  # from 0
    parameters: dict[str, Any]  # values of the varied fields, by name
    changes: dict[str, Any]  # the same by the fields' paths

    @property
    def name(self) -> str:
        """Name of its group in the store."""
        return f"m{self.number:06d}"


@dataclass(frozen=True, slots=True, eq=False)
class Study:
    """A study as read from its file."""

    content: dict[str, Any]  # of the scene file
    base: Path  # folder to which the scene's paths are relative
    folder: Path  # that of the study file, in which the metrics' module is looked for
    keep: tuple[str, ...]  # stored content of each member
    metrics: str  # ``"module:function"``, or empty
    table_rate: float  # instants of the ground truth per second
    members: tuple[Member, ...]  # all of them
    seed: int = 0  # of what is random
    shards: ShardsModel | None = None  # None for a store with a group per member

    def content_of(self, member: Member) -> dict[str, Any]:
        """Return the content of a member's scene file, with the table of its noise."""
        content = self.content
        for field, value in member.changes.items():
            content = replaced(content, field, value)
        return content

    def parts_of(self, member: Member) -> tuple[SceneFile, NoiseModel | None]:
        """Return a member's scene and its noise."""
        content = dict(self.content_of(member))
        noise = content.pop("noise", None)
        return build_scene(content, self.base), None if noise is None else as_noise(noise)

    def check(self, member: Member) -> list[Path]:
        """Check a member's scene; return the files that it names."""
        try:
            file, noise = self.parts_of(member)
            if noise is not None and any(len(r.directivity.channels) > 1 for r in file.scene.receivers):
                raise InputError("noise", "must come with receivers of one channel each, but some have several")
            if PARTS & set(self.keep) and any(r.electronics is not None for r in file.scene.receivers):
                named = ", ".join(sorted(PARTS & set(self.keep)))
                raise InputError("keep", f"must leave out {named} where receivers have electronics")
            return referenced_files(file)
        except InputError as error:
            keys = [".".join(s for s in parsed(f) if isinstance(s, str) and s != "*") for f in member.changes]
            unknown = ".".join(str(s) for s in parsed(error.field) if isinstance(s, str)) if error.field else ""
            if error.problem.startswith(UNKNOWN) and any(key.startswith(unknown) for key in keys):
                raise InputError("vary", f"must name fields of the scene, but {error.field} {error.problem}") from error
            values = ", ".join(f"{f} = {json.dumps(v, default=str):.40}" for f, v in member.changes.items())
            raise InputError(f"member {member.number} ({values:.200})", str(error)) from error


def as_noise(content: Any) -> NoiseModel:
    """Return the noise of a table."""
    with inside("noise"):
        try:
            return NoiseModel.model_validate(content).checked()
        except ValidationError as error:
            raise explain(error, content, NoiseModel) from error


def load_study(path: str | os.PathLike[str], limit: int = DEFAULT_LIMIT) -> Study:
    """Read a study file and the scene file that it names."""
    path = Path(path)
    content = read_toml(path)
    try:
        model = _StudyModel.model_validate(content)
    except ValidationError as error:
        raise explain(error, content, _StudyModel) from error
    as_count("seed", model.seed, at_least=0)
    if model.shards is not None:
        check_packages("shards", "a table of labels", "parquet", "pyarrow")
    if model.draws is not None:
        as_count("draws", model.draws, at_least=1)
    as_number("table_rate", model.table_rate, above=0.0, at_most=1e6, unit="Hz")
    keep = model.keep
    if keep is None:
        keep = ["ground_truth", "metrics"] if model.metrics else ["recording", "ground_truth"]
    if not keep:
        raise InputError("keep", "must name what is kept, but is empty")
    if ("metrics" in keep) != bool(model.metrics):
        raise InputError("metrics", 'must be given, "module:function", if and only if keep has "metrics"')
    if model.metrics is not None and not all(model.metrics.partition(":")):
        raise InputError("metrics", f'must be "module:function", but is {model.metrics!r:.80}')
    if "noise" in keep and model.noise is None:
        raise InputError("keep", "must leave out noise, because there is no table [noise]")
    scene = path.parent / model.scene
    try:
        base = read_toml(scene)
    except InputError as error:
        raise InputError("scene", str(error)) from error
    if model.noise is not None:
        with inside("noise"):
            base = base | {"noise": model.noise.checked().arguments()}
    folders = path.parent.resolve(), scene.parent.resolve()
    members = _members(model, base, as_count("limit", limit, at_least=1), *folders)
    return Study(
        base, folders[1], folders[0], tuple(keep), model.metrics or "", model.table_rate, members, model.seed,
        model.shards,
    )  # fmt: skip


def _members(model: _StudyModel, content: dict[str, Any], limit: int, folder: Path, base: Path) -> tuple[Member, ...]:
    """Return every combination of the axes' values; all random fields are one axis, drawn together."""
    for many in (model.draws or 0, *(vary.range.count for vary in model.vary if vary.range is not None)):
        _check_count(many, limit)  # before as many values are made
    axes: list[list[dict[str, Any]]] = []
    drawn: list[list[dict[str, Any]]] = []
    names: dict[str, str] = {}
    for i, vary in enumerate(model.vary):
        with inside(f"vary[{i}]"):
            fields = _fields(vary, content, names)
            if vary.random is None:
                axes.append(_values(vary, fields))
            else:
                if model.draws is None:
                    raise InputError("random", "must come with draws, the number of them, at the top of the study file")
                values = draws(vary.random, fields, model.seed, model.draws, folder, base)
                drawn.append([dict(zip(fields, row, strict=True)) for row in values])
    if drawn:
        axes.append([{f: v for part in row for f, v in part.items()} for row in zip(*drawn, strict=True)])
    elif model.draws is not None:
        raise InputError("draws", "must be left out, because nothing is random")
    _check_count(math.prod(len(axis) for axis in axes), limit)
    members = []
    for number, row in enumerate(itertools.product(*axes)):
        changes = _placed(content, {field: value for part in row for field, value in part.items()}, base)
        members.append(Member(number, {names[field]: value for field, value in changes.items()}, changes))
    return tuple(members)


def _placed(content: dict[str, Any], changes: dict[str, Any], base: Path) -> dict[str, Any]:
    """Put places into a member's own room."""
    places = {field: value for field, value in changes.items() if isinstance(value, Place)}
    if not places:
        return changes
    for field, value in changes.items():
        content = content if field in places else replaced(content, field, value)
    return changes | {field: place.within(content.get("room", {}), base) for field, place in places.items()}


def _check_count(count: int, limit: int) -> None:
    if count > limit:
        many = f"{count} (--limit {count} allows them)" if count < _COUNTABLE else f"more than {_COUNTABLE}"
        raise InputError("vary", f"must give at most {limit} members, but gives {many}")


def _fields(vary: _Vary, content: dict[str, Any], names: dict[str, str]) -> list[str]:
    """Return the fields of an entry, and add their names to those that are taken."""
    fields = [vary.field] if isinstance(vary.field, str) else vary.field
    if not fields:
        raise InputError("field", "must name at least one field, but is empty")
    called = [field.replace("*", "all") for field in fields] if vary.name is None else vary.name
    called = [called] if isinstance(called, str) else called
    if len(called) != len(fields):
        raise InputError("name", f"must be one per field, {len(fields)}, but are {len(called)}")
    for field, name in zip(fields, called, strict=True):
        with inside("field"):
            replaced(content, field, None)
        if field in names:
            raise InputError("field", f"must be varied once, but {field!r} is varied twice")
        if not name or name in names.values() or name in TAKEN or "/" in name or name.startswith("."):
            raise InputError("name", f"must be a name that is not taken, but is {name!r:.80}")
        names[field] = name
    given = [name for name in ("values", "range", "random") if getattr(vary, name) is not None]
    if len(given) != 1:
        raise InputError("", f"must have one of values, range, random, but has {' and '.join(given) or 'none'}")
    if len(fields) > 1 and vary.range is not None:
        raise InputError("field", f"must be a single one for {given[0]}, but are {len(fields)}")
    return fields


def _values(vary: _Vary, fields: list[str]) -> list[dict[str, Any]]:
    if vary.range is not None:
        if not math.isfinite(vary.range.stop - vary.range.start):
            raise InputError("range", f"must be of finite width, but is {vary.range.start:g} to {vary.range.stop:g}")
        steps = np.linspace(vary.range.start, vary.range.stop, vary.range.count).tolist()
        return [{fields[0]: value} for value in steps]
    values = vary.values or []
    if not values:
        raise InputError("values", "must hold at least one, but is empty")
    if len(fields) == 1:
        return [{fields[0]: value} for value in values]
    for k, row in enumerate(values):
        if not isinstance(row, list) or len(row) != len(fields):
            raise InputError(
                f"values[{k}]", f"must be a list of one value per field, {len(fields)}, but is {row!r:.80}"
            )
    return [dict(zip(fields, row, strict=True)) for row in values]


def checked(study: Study, advance: Callable[[float], None]) -> set[Path]:
    """Check the scenes of all members; return the files that they name."""
    files: set[Path] = set()
    for member in study.members:
        files.update(study.check(member))
        advance(1.0)
    return files
