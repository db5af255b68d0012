"""The seminar room CR2 of the BRAS, from a folder that the user downloaded.

L. Aspöck, F. Brinkmann, D. Ackermann, S. Weinzierl, M. Vorländer, "BRAS: Benchmark for Room Acoustical Simulation", TU
Berlin, 2020, doi:10.14279/depositonce-6726.3.
"""

from __future__ import annotations

import csv
import math
from pathlib import Path
from typing import Any

import numpy as np

from clsim.arrays import Floats
from clsim.errors import InputError
from clsim.files.input_files import LARGEST_TEXT, read_file
from clsim.measured.rooms import Aim, MeasuredRoom, MeasuredState
from clsim.scene_file.scene import build_scene

NAME = "bras-cr2"
_MESH = "scene9.ac"
_SURFACES = ("concrete", "windows", "ceiling", "plaster", "floor")  # of which the mesh's materials end
_MEASURED = {"T20": ("t20", 1.0), "EDT": ("edt", 1.0), "C80": ("c80", 1.0), "D50": ("d50", 0.01)}  # to SI units
_AIR = {"temperature_celsius": 19.5, "relative_humidity": 0.417}
_RATE = 48e3  # Hz
_STATES = ("as measured",)
_AIMS = (
    Aim(("t20",), _STATES, 500.0, 4000.0, 5.0, "%"),
    Aim(("c80",), _STATES, 500.0, 4000.0, 0.5, "dB"),
    Aim(("t20",), _STATES, 125.0, 125.0, 15.0, "%", "beyond what the data explain"),
    Aim(("t20",), _STATES, 250.0, 250.0, 15.0, "%", "beyond what the data explain"),
)
_NOTES = (
    "The absorption coefficients were fitted so that Eyring's formula gives the measured reverberation times, as the "
    "column of Eyring's times shows. With the stated scattering of 5 % alone, rays decay more slowly in this geometry: "
    "T20 is 7 to 22 % too long from 125 Hz to 1 kHz. Here walls also scatter by their limited size.",
    "Filters of thirds pass part of their neighbours. Sound lasts 1.4 times as long at 315 Hz as at 250 Hz, and both "
    "bands hold its end.",
    "C80 is off where measured values step by some 1 dB from one third to the next, as at 2520 Hz. Coefficients that "
    "vary little from third to third do not give such steps.",
    "The worst band in C80 is 2520 Hz with 0.77 dB. The mean over the ten bands is 0.35 dB. The worst band in T20 is "
    "794 Hz with 4.8 %.",
    "Measured values are means over the ten pairs, and so are clsim's.",
)


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
    state = MeasuredState(_STATES[0], scene, values, {}, {})
    source = "seminar room CR2 of the BRAS (Aspöck, Brinkmann, Ackermann, Weinzierl, Vorländer), RWTH Aachen"
    return MeasuredRoom(
        NAME, "BRAS seminar room CR2", source, _NOTES, "third-octave", frequencies, (), (state,), _AIMS
    )  # fmt: skip


def _measured(folder: Path) -> tuple[Floats, dict[str, Floats]]:
    """Read measured values (bands, 1) by parameter, and the centres (bands,) of their thirds of octaves, Hz."""
    values, frequencies = {}, np.empty(0)
    for name, (parameter, unit) in _MEASURED.items():
        rows = _rows(_found(folder, f"measured_{name}.csv"))
        # Files give rounded centres, such as 155 Hz: the nearest third is meant.
        rounded, found = _numbers(folder, rows[:2])
        frequencies = np.array([_third(f) for f in rounded])
        values[parameter] = unit * np.array(found)[:, None]
    return frequencies, values


def _third(frequency: float) -> float:
    """Exact centre of the third of an octave nearest to a frequency, Hz."""
    return float(1000.0 * 2.0 ** (round(3.0 * math.log2(frequency / 1000.0)) / 3.0))


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
