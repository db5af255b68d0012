"""The two measured rooms as published files describe them: scenes for benchmarks of the tail."""

import csv
from pathlib import Path
from typing import Any

import numpy as np

import clsim

OCTAVES = [125.0, 250.0, 500.0, 1000.0, 2000.0, 4000.0]


def rows(path: Path) -> list[dict[str, str]]:
    """Return the rows of a table."""
    return list(csv.DictReader(path.read_text("utf-8").splitlines()))


def scene_in(room: Any, places: list[dict[str, str]], air: clsim.Air, sources: str) -> clsim.Scene:
    """Return a scene with omnidirectional sources and receivers at published places."""
    tone = clsim.Signal.tone(1e3, duration=0.1, sampling_rate=48e3)
    ends: tuple[list[Any], list[Any]] = ([], [])
    for place in places:
        at = clsim.Trajectory.fixed([float(place[axis]) for axis in ("x_m", "y_m", "z_m")])
        if place["name"].startswith(sources):
            ends[0].append(clsim.Source(place["name"], tone, at))
        else:
            ends[1].append(clsim.Receiver(place["name"], at))
    return clsim.Scene(room, air, *ends)


def seminar_room(folder: Path) -> clsim.Scene:
    """Return seminar room CR2 of the BRAS from a folder with its mesh, materials by thirds, and places."""
    materials = {}
    for path in sorted(folder.glob("material_*.csv")):
        f, absorption, scattering = np.loadtxt(path, delimiter=",")
        materials["mat_scene09_" + path.stem.removeprefix("material_")] = clsim.Material.from_absorption(
            f, absorption, scattering=(f, scattering)
        )
    room = clsim.MeshRoom.from_file(folder / "scene9.ac", up="y", materials=materials)
    return scene_in(room, rows(folder / "positions.csv"), clsim.Air(19.5, 0.417), "LS")


def studio(folder: Path, curtains: str) -> clsim.Scene:
    """Return the recording studio of the PTB, phase 3, from a folder with its corners, planes, materials and places."""
    places: dict[int, list[float]] = {}
    for row in rows(folder / "corners.csv"):
        if int(row["corner"]) not in places or row["phase"] == "3":
            places[int(row["corner"])] = [float(row[axis]) for axis in ("x_m", "y_m", "z_m")]
    number = {corner: i for i, corner in enumerate(places)}
    made = {}
    for row in rows(folder / "materials.csv"):
        absorption, scattering = (
            [float(row[f"{what}_{f:.0f}"]) for f in OCTAVES] for what in ("absorption", "scattering")
        )
        name = row["material"].replace("windowglass", "windowglas").replace("absorbers", "absorber")
        made[name] = clsim.Material.from_absorption(OCTAVES, absorption, scattering=(OCTAVES, scattering))
    polygons, materials, sheets = [], [], []
    for row in rows(folder / "planes.csv"):
        if row["curtains"] not in ("both", curtains) or (row["sheet"] == "planes" and row["plane"] in ("10", "25")):
            continue
        sheets += [len(polygons)] if row["double_sided"] == "yes" else []
        polygons.append([number[int(corner)] for corner in row["corners"].split()])
        materials.append(made[row["material"].replace("windowglass", "windowglas").replace("absorbers", "absorber")])
    room = clsim.MeshRoom.from_polygons(list(places.values()), polygons, materials, double_sided=sheets)
    return scene_in(room, rows(folder / "positions.csv"), clsim.Air(20.0, 0.5, 100e3), "S")
