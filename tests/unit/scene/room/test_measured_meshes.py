"""Meshes of measured rooms close, and files of AC3D, in which some of them are written."""

import csv
import os
from pathlib import Path

import numpy as np
import pytest
from exhaustive import few

import clsim

WALL = clsim.Material.from_reflection(0.9)
# Where the published files of measured rooms are.
MEASURED = Path(
    os.environ.get("CLSIM_MEASURED_ROOMS", Path(__file__).resolve().parents[5] / "shared" / "data" / "measured")
)


AC = """AC3Db
MATERIAL "brick wall" rgb 1 1 1 amb 0 0 0 emis 0 0 0 spec 0 0 0 shi 0 trans 0
MATERIAL "glass" rgb 1 1 1 amb 0 0 0 emis 0 0 0 spec 0 0 0 shi 0 trans 0
OBJECT world
kids 1
OBJECT group
name "moved"
loc 0 2 0
rot 0 1 0 -1 0 0 0 0 1
kids 1
OBJECT poly
name "one side"
data 5
hello
loc 1 0 0
numvert 4
0 0 0
1 0 0
1 1 0
0 1 0
numsurf 2
SURF 0x20
mat 1
refs 4
0 0 0
1 0 0
2 0 0
3 0 0
SURF 0x2
mat 0
refs 2
0 0 0
1 0 0
kids 0
"""


def test_ac3d_files(tmp_path: Path) -> None:
    """Objects are turned and moved within the ones above; materials go by name, and lines are left out."""
    path = tmp_path / "side.ac"
    path.write_text(AC)
    glass = clsim.Material.from_reflection(0.5)
    room = clsim.MeshRoom.from_file(path, materials={"glass": glass})
    assert room.faces.materials == (glass,)
    # rot has the images of the axes as rows: x becomes (0, 1, 0), y becomes (-1, 0, 0); then 2 along y.
    assert sorted(map(tuple, room.vertices.round(9).tolist())) == [(-1, 3, 0), (-1, 4, 0), (0, 3, 0), (0, 4, 0)]
    for old, new, problem in (
        ("AC3Db", "OFF", "must be an AC3D file"), ("mat 1", "mat 7", "must use materials from 0 to 1, but uses 7"),
        ("numvert 4", "numvert 4e9", "line 16 must have a count"), ("2 0 0\n3", "9 0 0\n3", "must name a corner from 0 to 3"),
        ("0 1 0\nnumsurf", "0 nan\nnumsurf", "must have 3 numbers"), ("refs 4", "refs x", "must have 1 numbers"),
        ("0 1 0\nnumsurf", "0 nan 0\nnumsurf", "vertices must be finite"), ("SURF 0x20", "SURF red", "must have the flags"),
        ("SURF 0x20", "SURF 0x1", "must hold faces"),
    ):  # fmt: skip
        path.write_text(AC.replace(old, new, 1))
        with pytest.raises(clsim.InputError, match=problem):
            clsim.MeshRoom.from_file(path, materials=glass)


@pytest.mark.skipif(not MEASURED.exists(), reason="the measured rooms are not here")
def test_the_seminar_room_of_the_bras_closes() -> None:
    room = clsim.MeshRoom.from_file(MEASURED / "bras_cr2" / "scene9.ac", up="y", materials=WALL)
    assert room.is_closed
    assert room.volume == pytest.approx(146.1, rel=1e-3)
    assert room.surface_area == pytest.approx(202.5, rel=1e-3)
    assert any("healed: sides cut at 4 corners" in note for note in room.notes)


def volume_by_lines(corners: np.ndarray, step: float) -> float:
    """Volume within triangles (T, 3, 3): lengths of lines along z from every second wall to the next."""
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    count = np.ceil((high - low)[:2] / step).astype(int)
    size = (high - low)[:2] / count
    lines, heights = [], []
    for a, b, c in corners:
        normal = np.cross(b - a, c - a)
        if abs(normal[2]) < 1e-9:
            continue
        first, last = (np.ceil((f([a, b, c], axis=0) - low)[:2] / size - 0.5).astype(int) for f in (np.min, np.max))
        i, j = np.meshgrid(*map(np.arange, first, last), indexing="ij")
        x, y = ((k + 0.5) * size[axis] + low[axis] for axis, k in enumerate((i, j)))
        turn = [(q[0] - p[0]) * (y - p[1]) - (q[1] - p[1]) * (x - p[0]) for p, q in ((a, b), (b, c), (c, a))]
        met = (np.min(turn, axis=0) > 0.0) | (np.max(turn, axis=0) < 0.0)
        lines.append((i * count[1] + j)[met])
        heights.append((a[2] - (normal[0] * (x - a[0]) + normal[1] * (y - a[1])) / normal[2])[met])
    line, height = np.concatenate(lines), np.concatenate(heights)
    order = np.lexsort((height, line))
    assert np.all(np.bincount(line) % 2 == 0), "a line enters as often as it leaves"
    return float(np.diff(height[order].reshape(-1, 2), axis=1).sum() * np.prod(size))


@pytest.mark.skipif(not MEASURED.exists(), reason="the measured rooms are not here")
@pytest.mark.parametrize(("curtains", "window"), few([("closed", False), ("open", True), ("closed", True)], kept=()))
def test_the_studio_of_the_ptb_closes(curtains: str, window: bool) -> None:
    """Phase 3: 654 triangles without the window that lies in a wall, 8 more where it is cut out, and the curtains."""
    places: dict[int, list[float]] = {}
    for row in csv.DictReader((MEASURED / "ptb_studio" / "corners.csv").read_text("utf-8").splitlines()):
        if int(row["corner"]) not in places or row["phase"] == "3":
            places[int(row["corner"])] = [float(row[axis]) for axis in ("x_m", "y_m", "z_m")]
    number = {corner: i for i, corner in enumerate(places)}
    polygons, sheets = [], []
    for row in csv.DictReader((MEASURED / "ptb_studio" / "planes.csv").read_text("utf-8").splitlines()):
        replaced = row["sheet"] == "planes" and row["plane"] in (("10", "25") if window else ("8", "10", "25"))
        if row["curtains"] not in ("both", curtains) or replaced:
            continue
        sheets += [len(polygons)] if row["double_sided"] == "yes" else []
        polygons.append([number[int(corner)] for corner in row["corners"].split()])
    room = clsim.MeshRoom.from_polygons(list(places.values()), polygons, WALL, double_sided=sheets)
    assert room.is_closed
    assert len(sheets) == {"open": 6, "closed": 2}[curtains]
    solid = ~room.shape.sheets
    assert np.count_nonzero(solid) == (662 if window else 654)
    assert room.volume == pytest.approx(377.2, rel=1e-3)
    assert room.volume == pytest.approx(volume_by_lines(room.vertices[room.triangles[solid]], 0.01), rel=1e-3)
