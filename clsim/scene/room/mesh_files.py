"""Triangles from mesh files: OBJ by our own reader, every other format by trimesh, checked face by face."""

from __future__ import annotations

import json
import os
import re
import struct
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.arrays import FARTHEST, Floats, as_choice, as_number, read_only
from clsim.errors import InputError
from clsim.files.input_files import LARGEST_BINARY, LARGEST_TEXT, check_archive, check_file, open_file, read_file
from clsim.scene.room.polygons import cut_polygon, polygon_notes, read_ac3d

KNOWN_FORMATS = ("OBJ", "STL", "PLY", "GLB", "GLTF", "OFF", "3MF")

_ARCHIVES = ("zip", "bz2", "tar.gz", "tar.bz2")  # of whatever files, which are not read
_MOST_POINTS = LARGEST_BINARY // 16  # points in the arrays of a glTF file
Ints = NDArray[np.int64]
_LARGEST_SCALE = 1e9
_MOST_TRIANGLES = 10_000_000
_FARTHEST = _LARGEST_SCALE * FARTHEST  # in the unit of a file
_NAMELESS = (".stl", ".ply", ".off")  # formats whose single geometry has no name of its own
# Rows are the new x, y and z as read from the file's axes; each is a rotation (determinant 1).
_TO_Z_UP = {
    "x": np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]),
    "y": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]),
    "z": np.eye(3),
}


def load_by_trimesh(file: Path) -> Any:
    """Return content of a file as a trimesh scene."""
    import trimesh

    known = ", ".join(KNOWN_FORMATS)
    kind = file.suffix.lower().removeprefix(".")
    if kind not in trimesh.available_formats() or kind in _ARCHIVES:
        extra = " (3MF needs the packages networkx and lxml)" if kind == "3mf" else ""
        raise InputError(str(file), f"must be of a known format ({known}), but ends with {file.suffix!r}{extra}")
    try:
        _check_unpacked(file, kind)
        return trimesh.load_scene(file, process=False, resolver=_beside(file))
    except InputError:
        raise
    except Exception as error:  # the readers of trimesh raise whatever a broken file leads to
        reason = f"{type(error).__name__}: {error}"
        problem = f"must be a {kind.upper()} file of a mesh, but trimesh says {reason:.200}"
        raise InputError(str(file), problem) from error


def _check_unpacked(file: Path, kind: str) -> None:
    """Refuse a file whose header declares more memory than allowed."""
    if kind == "3mf":
        with open_file(file, LARGEST_BINARY) as stream:
            check_archive(stream)
    if kind in ("glb", "gltf"):
        data = read_file(file, LARGEST_BINARY)
        header = json.loads(data[20 : 20 + struct.unpack_from("<I", data, 12)[0]] if kind == "glb" else data)
        # Arrays without data of their own are zeros, as many as the file says.
        points = sum(int(array["count"]) for array in header.get("accessors", ()))
        if points > _MOST_POINTS:
            raise InputError(str(file), f"must hold at most {_MOST_POINTS} points, but says {points}")
        _check_nodes(file, header)


def _check_nodes(file: Path, header: dict[str, Any]) -> None:
    """Refuse nodes of a glTF file that are no trees: trimesh leaves out places of a node that has two parents."""
    # It never ends where a node is its own descendant.
    children = [list(node.get("children", ())) for node in header.get("nodes", ())]
    parents = Counter(child for several in children for child in several)
    reached = [node for node in range(len(children)) if node not in parents]
    for node in reached:  # which grows meanwhile
        reached += [child for child in children[node] if parents[child] == 1]
    if len(reached) != len(children):
        problem = "must hold nodes that form trees, but one has two parents, or is its own descendant"
        raise InputError(str(file), problem)


def _beside(file: Path) -> Any:
    """Return resolver of the files that a mesh file names: regular files of bounded size."""
    from trimesh.resolvers import FilePathResolver

    class Beside(FilePathResolver):
        def get(self, name: str) -> Any:
            name = name.strip()
            for place in dict.fromkeys((name, name.lstrip("/"), os.path.split(name)[-1])):
                if Path(self.parent, place).exists():
                    check_file(Path(self.parent, place), LARGEST_BINARY)
            return super().get(name)

    return Beside(str(file))


@dataclass(frozen=True, slots=True, eq=False)
class MeshFile:
    """Content of a mesh file, not welded or cleaned: vertices (V, 3) m, triangles (T, 3), and the group (T,) of each.

    Groups are materials (OBJ: ``usemtl``), or objects where a file names no material; ``("",)`` where it names nothing.
    """

    vertices: Floats
    triangles: Ints
    group: Ints
    groups: tuple[str, ...]
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class _Face:
    """A polygon of an OBJ file: the number of its line, its own number from 1, its corners and its names."""

    line: int
    number: int
    corners: tuple[int, ...]
    material: str
    part: str


def read_mesh(path: Any, *, scale: float = 1.0, up: str = "z") -> MeshFile:
    """Read a mesh file, see `MeshRoom.from_file`; several geometries in it are joined."""
    # Polygons of OBJ and AC3D files may be concave: they are cut by ear clipping in their own plane. trimesh cuts those
    # of other formats into fans, which is right for convex ones.
    scale = as_number("scale", scale, at_least=1.0 / _LARGEST_SCALE, at_most=_LARGEST_SCALE)
    turn = _TO_Z_UP[as_choice("up", up, ("x", "y", "z"))]
    try:
        file = Path(path)
    except TypeError as error:
        raise InputError("path", f"must be a path, but is {path!r:.80}") from error
    try:
        open_file(file, LARGEST_BINARY).close()
    except OSError as error:
        raise InputError(str(path), f"cannot be read: {error.strerror or error}") from error
    readers = {".obj": _read_obj, ".ac": _read_ac}
    mesh = readers.get(file.suffix.lower(), _read_by_trimesh)(file)
    # Adding zero turns -0 into 0.
    vertices = (mesh.vertices @ turn.T) * scale + 0.0
    triangles, group = read_only(mesh.triangles), read_only(mesh.group)
    return MeshFile(read_only(vertices), triangles, group, mesh.groups, mesh.notes)


# OBJ


def _read_obj(file: Path) -> MeshFile:
    """Read an OBJ file in its own axes and unit."""
    vertices, faces = _parse_obj(file)
    if not faces:
        raise InputError(str(file), "must hold faces, but has no line that begins with f")
    corners = np.concatenate([face.corners for face in faces])
    owner = np.repeat(np.arange(len(faces)), [len(face.corners) for face in faces])
    _check_corners(file, vertices, corners, lambda i: _where(faces[owner[i]]), first=1)
    triangles, owners = [], []
    counts = Counter[str]()
    for i, face in enumerate(faces):
        if len(face.corners) == 3:
            cut = np.array([face.corners], dtype=np.int64)
        else:
            try:
                cut = np.array(face.corners, dtype=np.int64)[cut_polygon(vertices[list(face.corners)], counts)]
            except ValueError as error:
                raise InputError(str(file), f"{_where(face)} {error}") from None
        triangles.append(cut)
        owners.append(np.full(len(cut), i))
    if not sum(map(len, triangles)):
        raise InputError(str(file), f"must hold faces with an area, but all {len(faces)} have none")
    owner = np.concatenate(owners)
    by_material = any(face.material for face in faces)
    names = [faces[i].material if by_material else faces[i].part for i in owner]
    number = {name: i for i, name in enumerate(dict.fromkeys(names))}
    group = np.array([number[name] for name in names], dtype=np.int64)
    return MeshFile(vertices, np.concatenate(triangles), group, tuple(number), polygon_notes(counts))


def _where(face: _Face) -> str:
    return f"line {face.line}: face {face.number}"


def _parse_obj(file: Path) -> tuple[Floats, list[_Face]]:
    """Return the vertices (V, 3) and the faces, their corners counted from 0 but not yet checked."""
    vertices: list[list[float]] = []
    faces: list[_Face] = []
    material = part = ""
    for line, key, rest in _statements(file):
        if key == "v":
            try:
                numbers = [float(cell) for cell in rest.split()[:3]]
            except ValueError:
                numbers = []
            if len(numbers) < 3:
                raise InputError(str(file), f"line {line}: a vertex must be three numbers, but is {rest!r:.60}")
            vertices.append(numbers)
        elif key == "f":
            number = len(faces) + 1
            where = f"line {line}: face {number}"
            corners = tuple(_corner(file, where, cell, len(vertices)) for cell in rest.split())
            if len(corners) < 3:
                raise InputError(str(file), f"{where} must have at least 3 corners, but has {len(corners)}")
            faces.append(_Face(line, number, corners, material, part))
        elif key == "usemtl":
            material = " ".join(rest.split())
        elif key in ("g", "o"):
            part = " ".join(rest.split())
    return np.array(vertices, dtype=np.float64).reshape(-1, 3), faces


def _statements(file: Path) -> Iterator[tuple[int, str, str]]:
    """Yield number of line, keyword and the rest, without comments and with continued lines joined."""
    try:
        data = read_file(file, LARGEST_TEXT)
    except OSError as error:
        raise InputError(str(file), f"cannot be read: {error.strerror or error}") from error
    if b"\0" in data:
        raise InputError(str(file), "must be an OBJ file, which is text, but holds a zero byte")
    try:
        text = data.decode("utf-8-sig")
    except ValueError:
        text = data.decode("latin-1")  # names in an old code page; the numbers are the same
    first, held = 1, ""
    # Not str.splitlines: it also ends a line at characters that may stand in a name.
    for number, line in enumerate((*re.split("\r\n|\n|\r", text), ""), start=1):
        first = first if held else number
        if line.rstrip().endswith("\\"):
            held += line.rstrip()[:-1] + " "
            continue
        key, _, rest = re.sub(r"(^|\s)#.*", "", held + line).strip().replace("\t", " ").partition(" ")
        held = ""
        if key:
            yield first, key, rest


def _corner(file: Path, where: str, cell: str, count: int) -> int:
    """Return the vertex of ``v``, ``v/vt``, ``v//vn`` or ``v/vt/vn``, from 0; negative ones count back."""
    try:
        index = int(cell.split("/")[0])
    except ValueError:
        raise InputError(str(file), f"{where} must have whole numbers as corners, but has {cell!r:.40}") from None
    if index == 0 or index < -count:
        raise InputError(str(file), f"{where} must use vertices from 1 (or -{count}) on, but uses {index}")
    return index - 1 if index > 0 else count + index


# Other formats


def _read_ac(file: Path) -> MeshFile:
    """Read an AC3D file in its own axes and unit; groups are materials."""
    vertices, polygons, of_polygon, materials = read_ac3d(file)
    triangles, owner, counts = [], [], Counter[str]()
    for i, polygon in enumerate(polygons):
        try:
            cut = polygon[cut_polygon(vertices[polygon], counts)] if len(polygon) > 3 else polygon[None]
        except ValueError as error:
            raise InputError(str(file), f"surface {i + 1} {error}") from None
        triangles.append(cut)
        owner.append(np.full(len(cut), of_polygon[i]))
    _check_corners(file, vertices, np.concatenate(triangles).ravel(), lambda i: f"face {i // 3 + 1}", first=0)
    used, group = np.unique(np.concatenate(owner), return_inverse=True)
    names = tuple(materials[i] for i in used.tolist())
    return MeshFile(vertices, np.concatenate(triangles), group.astype(np.int64), names, polygon_notes(counts))


def _read_by_trimesh(file: Path) -> MeshFile:
    """Read a file in its own axes and unit, its geometries joined."""
    scene = load_by_trimesh(file)
    vertices: list[Floats] = []
    triangles: list[Ints] = []
    names, others, count = [], 0, 0
    rank = {key: i for i, key in enumerate(scene.geometry)}
    # trimesh lists nodes in no order of the file's.
    nodes = sorted(scene.graph.nodes_geometry, key=lambda node: (rank[scene.graph[node][1]], str(node)))
    for node in nodes:
        transform, key = scene.graph[node]
        if not np.all(np.abs(transform) <= _FARTHEST):
            raise InputError(str(file), f"must place its parts by finite numbers, but has {transform.tolist()!s:.80}")
        geometry = scene.geometry[key]
        if not len(getattr(geometry, "faces", ())):
            others += 1
            continue
        faces = np.array(geometry.faces, dtype=np.int64)
        points = np.array(geometry.vertices, dtype=np.float64)
        _check_corners(file, points, faces.ravel(), lambda i: f"face {i // 3 + 1}", first=0)
        if np.linalg.det(transform[:3, :3]) < 0.0:  # a mirror: outside stays outside
            faces = faces[:, ::-1]
        count += len(faces)
        if count > _MOST_TRIANGLES:  # a few copied by many nodes may be more than memory holds
            raise InputError(str(file), f"must hold at most {_MOST_TRIANGLES} triangles")
        triangles.append(faces + sum(len(v) for v in vertices))
        vertices.append(points @ transform[:3, :3].T + transform[:3, 3])
        names.append(_name(file, geometry, key, alone=len(nodes) == 1))
    if not triangles:
        held = "only points or lines" if others else "nothing"
        raise InputError(str(file), f"must hold faces, but holds {held}")
    groups = tuple(dict.fromkeys(names))
    group = np.concatenate([np.full(len(t), groups.index(n)) for t, n in zip(triangles, names, strict=True)])
    parts = "1 part" if others == 1 else f"{others} parts"
    notes = (f"{parts} without faces (points or lines) left out.",) if others else ()
    return MeshFile(np.concatenate(vertices), np.concatenate(triangles), group, groups, notes)


def _check_corners(file: Path, vertices: Floats, corners: Ints, where: Callable[[int], str], first: int) -> None:
    """Refuse corners beyond the vertices, and vertices that are not finite; `first` is the file's first index."""
    for i in np.flatnonzero((corners < 0) | (corners >= len(vertices)))[:1]:
        last = len(vertices) - 1 + first
        problem = f"{where(i)} must use vertices from {first} to {last}, but uses {corners[i] + first}"
        raise InputError(str(file), problem)
    near = np.all(np.abs(vertices) <= _FARTHEST, axis=1)
    for i in np.flatnonzero(~near[corners])[:1]:
        k = corners[i]
        raise InputError(str(file), f"{where(i)} must have finite corners, but vertex {k + first} is {vertices[k]}")
    for k in np.flatnonzero(~near)[:1]:
        raise InputError(str(file), f"vertices must be finite, but vertex {k + first} (of no face) is {vertices[k]}")


def _name(file: Path, geometry: Any, key: str, *, alone: bool) -> str:
    """Return the name of a geometry's material, else its own, else nothing."""
    material = getattr(getattr(geometry, "visual", None), "material", None)
    name = getattr(material, "name", None)
    if file.suffix.lower() in _NAMELESS and alone:
        return ""
    return str(name or key)
