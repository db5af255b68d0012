"""Measured rooms in clsim's own format: scenes, and the values that were measured in them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from clsim.arrays import Floats
from clsim.errors import ClsimError, InputError, not_one_of
from clsim.files.input_files import read_toml
from clsim.scene_file import load_scene
from clsim.scene_file.model import Model, explain
from clsim.scene_file.scene import SceneFile

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


@dataclass(frozen=True, slots=True, eq=False)
class Aim:
    """How near to the measurement a simulation is meant to be."""

    parameters: tuple[str, ...]
    states: tuple[str, ...]
    low: float  # Hz, of the lowest band's centre
    high: float  # Hz, of the highest one's
    most: float
    unit: str  # "JND" for the mean over bands and pairs; "%" or "dB" for the largest difference of a band's mean
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


class _Aim(Model):
    parameters: list[str]
    states: list[str]
    low: float
    high: float
    most: float
    unit: Literal["JND", "%", "dB"] = "JND"
    remark: str = ""


class _File(Model):
    name: str
    source: str
    notes: list[str] = []
    bands: Literal["octave", "third-octave"] = "octave"
    frequencies: list[float]
    pairs: list[list[str]] = []
    participants: str | None = None
    states: dict[str, _State]
    aims: list[_Aim] = []


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
        _check_pairs(path, file.pairs, scene)
        states.append(MeasuredState(key, scene, found["mean"], found["deviation"], theirs))
    key = name if name in BUILT_IN else path.parent.name or path.stem
    return MeasuredRoom(
        key, file.name, file.source, tuple(file.notes), file.bands, np.array(file.frequencies),
        tuple((pair[0], pair[1]) for pair in file.pairs), tuple(states),
        tuple(_aim(path, i, aim, states) for i, aim in enumerate(file.aims)),
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


def _aim(path: Path, i: int, aim: _Aim, states: list[MeasuredState]) -> Aim:
    """Make an aim, or refuse one of states or parameters that were not measured."""
    for name in aim.states:
        state = next((state for state in states if state.name == name), None)
        if state is None:
            raise InputError(str(path), f"aims[{i}].states {not_one_of(name, [state.name for state in states])}")
        for parameter in aim.parameters:
            if parameter not in state.mean:
                raise InputError(str(path), f"aims[{i}].parameters {not_one_of(parameter, state.mean)}")
    given = aim.arguments()
    return Aim(**given | {"parameters": tuple(aim.parameters), "states": tuple(aim.states)})


def _check_pairs(path: Path, pairs: list[list[str]], scene: SceneFile) -> None:
    """Refuse pairs that a scene does not have."""
    names = [end.name for end in scene.scene.sources], [end.name for end in scene.scene.receivers]
    for i, pair in enumerate(pairs):
        if len(pair) != 2 or pair[0] not in names[0] or pair[1] not in names[1]:
            raise InputError(str(path), f"pairs[{i}] must name a source and a receiver of the scene, but is {pair}")
