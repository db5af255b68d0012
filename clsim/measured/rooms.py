"""Measured rooms: tables of them that come with clsim, files of others, and the seminar room of the BRAS."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from clsim.arrays import Floats
from clsim.errors import ClsimError, InputError, not_one_of
from clsim.files.input_files import LARGEST_TEXT, read_file, read_toml
from clsim.scene_file import load_scene
from clsim.scene_file.model import Model, explain
from clsim.scene_file.scene import SceneFile, build_scene

BUILT_IN = {"ptb-studio": "ptb_studio"}  # rooms that come with clsim, and their folders

Rows = list[list[float]]


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredState:
    """A state of a measured room, such as with its curtains closed."""

    name: str
    scene: SceneFile
    mean: dict[str, Floats]  # measured values (bands, pairs) by parameter
    deviation: dict[str, Floats]  # standard deviations of measurements, likewise
    participants: dict[str, dict[str, Floats]]  # values that other programs found, likewise, by program


class Aim(Model):
    """How near to the measurement a simulation is meant to be."""

    parameters: list[str]
    states: list[str]
    low: float  # Hz, of the lowest band's centre
    high: float  # Hz, of the highest one's
    most: float
    unit: Literal["JND", "%", "dB"] = "JND"  # JND: mean over bands and pairs; else largest difference of a band's mean
    remark: str = ""

    def bands(self, room: MeasuredRoom) -> NDArray[np.bool_]:
        """Mask (bands,) of the room's bands that count."""
        return np.asarray((room.frequencies > 0.97 * self.low) & (room.frequencies < 1.03 * self.high))


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredRoom:
    """A room and the values that were measured in it."""

    key: str  # of the command line, and of names of files
    name: str
    source: str
    notes: tuple[str, ...]  # what is known of the data
    bands: str  # "octave" or "third-octave"
    frequencies: Floats  # (bands,) Hz
    pairs: tuple[tuple[str, str], ...]  # source and receiver; none where values are means over all
    states: tuple[MeasuredState, ...]
    aims: tuple[Aim, ...] = ()


class _State(Model):
    scene: str
    mean: dict[str, Rows]
    deviation: dict[str, Rows] = {}


class _File(Model):
    name: str
    source: str
    notes: list[str] = []
    bands: Literal["octave", "third-octave"] = "octave"
    frequencies: list[float]
    pairs: list[list[str]] = []
    participants: str | None = None
    states: dict[str, _State]
    aims: list[Aim] = []


class _Participants(Model):
    participants: dict[str, dict[str, dict[str, Rows]]]


def measured_room(name: str) -> MeasuredRoom:
    """Read a measured room that comes with clsim, by its name, or one from a TOML file."""
    path = data_folder() / BUILT_IN[name] / "measured.toml" if name in BUILT_IN else Path(name)
    file = _read(path, _File)
    others = {} if file.participants is None else _read(path.parent / file.participants, _Participants).participants
    shape = len(file.frequencies), len(file.pairs) or 1
    states = []
    for key, state in file.states.items():
        found = {
            kind: {p: _array(path, f"states.{key}.{kind}.{p}", rows, shape) for p, rows in getattr(state, kind).items()}
            for kind in ("mean", "deviation")
        }
        theirs = {
            program: {p: _array(path, f"participants.{program}.{key}.{p}", rows, shape) for p, rows in by[key].items()}
            for program, by in others.items()
            if key in by
        }
        scene = load_scene(path.parent / state.scene)
        names = [end.name for end in scene.scene.sources], [end.name for end in scene.scene.receivers]
        for i, pair in enumerate(file.pairs):
            if len(pair) != 2 or pair[0] not in names[0] or pair[1] not in names[1]:
                problem = f"pairs[{i}] must name a source and a receiver of the scene, but is {pair}"
                raise InputError(str(path), problem)
        states.append(MeasuredState(key, scene, found["mean"], found["deviation"], theirs))
    key = name if name in BUILT_IN else path.parent.name or path.stem
    return MeasuredRoom(
        key, file.name, file.source, tuple(file.notes), file.bands, np.array(file.frequencies),
        tuple((pair[0], pair[1]) for pair in file.pairs), tuple(states), _checked(path, file.aims, states),
    )  # fmt: skip


@cache
def data_folder() -> Path:
    """Find the folder of measured rooms: in the installed package, or in a checkout."""
    package = Path(__file__).resolve().parents[1]
    for folder in (package / "examples" / "measured", package.parent / "examples" / "measured"):
        if folder.is_dir():
            return folder
    raise ClsimError(f"no measured rooms beside {package}: install clsim again")


def _read(path: Path, kind: type[Any]) -> Any:
    """Read a TOML file by its model."""
    content = read_toml(path)
    try:
        return kind.model_validate(content)
    except ValidationError as error:
        problem = explain(error, content, kind)
        raise InputError(str(path), str(problem)) from error


def _array(path: Path, field: str, rows: Rows, shape: tuple[int, int]) -> Floats:
    """Convert rows of a table to an array, or refuse it."""
    if len(rows) != shape[0] or any(len(row) != shape[1] for row in rows):
        found = f"{len(rows)} x {len(rows[0]) if rows else 0}"
        raise InputError(str(path), f"{field} must have {shape[0]} bands x {shape[1]} pairs, but has {found}")
    return np.array(rows, dtype=np.float64)


def _checked(path: Path, aims: list[Aim], states: list[MeasuredState]) -> tuple[Aim, ...]:
    """Refuse aims of states or parameters that were not measured."""
    for i, aim in enumerate(aims):
        for name in aim.states:
            state = next((state for state in states if state.name == name), None)
            if state is None:
                raise InputError(str(path), f"aims[{i}].states {not_one_of(name, [state.name for state in states])}")
            for parameter in aim.parameters:
                if parameter not in state.mean:
                    raise InputError(str(path), f"aims[{i}].parameters {not_one_of(parameter, state.mean)}")
    return tuple(aims)


NAME = "bras-cr2"
_MESH = "scene9.ac"
_SURFACES = ("concrete", "windows", "ceiling", "plaster", "floor")  # of which the mesh's materials end
_MEASURED = {"T20": ("t20", 1.0), "EDT": ("edt", 1.0), "C80": ("c80", 1.0), "D50": ("d50", 0.01)}  # to SI units
_AIR = {"temperature_celsius": 19.5, "relative_humidity": 0.417}
_RATE = 48e3  # Hz


def bras_room(folder: Path) -> MeasuredRoom:
    """Read the room from a folder with its mesh, materials, positions and measured values, in subfolders or not."""
    if not folder.is_dir():
        raise InputError("--bras", f"must be a folder with the files of the BRAS, but is {folder}")
    frequencies, values = _measured(folder)
    materials = {f"mat_scene09_{name}": _material(_found(folder, f"material_{name}.csv")) for name in _SURFACES}
    ends: dict[str, list[dict[str, Any]]] = {"sources": [], "receivers": []}
    for row in _rows(_found(folder, "positions.csv"))[1:]:
        place = {"kind": "fixed", "position": _numbers(folder, [row[1:4]])[0]}
        if row[0].startswith("LS"):
            signal = {"kind": "tone", "frequency": 1e3, "duration": 0.1, "sampling_rate": _RATE, "fade": 0.01}
            ends["sources"].append({"name": row[0], "trajectory": place, "signal": signal})
        else:
            ends["receivers"].append({"name": row[0], "trajectory": place})
    room = {"kind": "mesh", "path": _found(folder, _MESH).name, "up": "y", "materials": materials}
    content = {
        "format": 1, "room": room, "air": _AIR, "paths": {"max_order": 2}, "render": {"sampling_rate": _RATE}, **ends,
    }  # fmt: skip
    try:
        scene = build_scene(content, _found(folder, _MESH).parent)
    except InputError as error:
        raise InputError(f"--bras: {error.field}", error.problem) from error
    path = data_folder() / "bras_cr2" / "about.toml"
    about, states = _read(path, _File), [MeasuredState("as measured", scene, values, {}, {})]
    return MeasuredRoom(
        NAME, about.name, about.source, tuple(about.notes), about.bands, frequencies, (), tuple(states),
        _checked(path, about.aims, states),
    )  # fmt: skip


def _measured(folder: Path) -> tuple[Floats, dict[str, Floats]]:
    """Read measured values (bands, 1) by parameter, and the centres (bands,) of their thirds of octaves, Hz."""
    values, frequencies = {}, np.empty(0)
    for name, (parameter, unit) in _MEASURED.items():
        rows = _rows(_found(folder, f"measured_{name}.csv"))
        # Files give rounded centres, such as 155 Hz: the nearest third is meant.
        rounded, found = _numbers(folder, rows[:2])
        frequencies = 1000.0 * 2.0 ** (np.round(3.0 * np.log2(np.array(rounded) / 1000.0)) / 3.0)
        values[parameter] = unit * np.array(found)[:, None]
    return frequencies, values


def _material(path: Path) -> dict[str, Any]:
    """Table of a scene file for a material: rows of frequencies, absorption and scattering."""
    frequencies, absorption, scattering = _numbers(path, _rows(path)[:3])
    return {
        "absorption": {"frequencies": frequencies, "coefficients": absorption},
        "scattering": {"frequencies": frequencies, "values": scattering},
    }


def _found(folder: Path, name: str) -> Path:
    """Find a file by its name in a folder or below."""
    found = sorted(path for path in folder.rglob("*") if path.name == name)
    if not found:
        raise InputError("--bras", f"must hold the file {name}, but {folder} does not")
    return found[0]


def _numbers(path: Path, rows: list[list[str]]) -> list[list[float]]:
    """Convert cells of a table to numbers."""
    try:
        return [[float(cell) for cell in row] for row in rows]
    except ValueError as error:
        raise InputError("--bras", f"must hold tables of numbers, but of {path}: {error}") from error


def _rows(path: Path) -> list[list[str]]:
    """Read rows of a table, empty ones left out."""
    try:
        text = read_file(path, LARGEST_TEXT).decode("utf-8")
        rows = [[cell.strip() for cell in row] for row in csv.reader(text.splitlines()) if row]
        if len(rows) < 2:
            raise ValueError("it has no second row")
        return rows
    except (OSError, ValueError) as error:
        raise InputError("--bras", f"must hold tables, but {path} is none: {error}") from error
