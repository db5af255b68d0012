"""Mesh files read by trimesh, within bounds of memory."""

from __future__ import annotations

import json
import os
import struct
from collections import Counter
from pathlib import Path
from typing import Any

from clsim.errors import InputError
from clsim.files.input_files import LARGEST_BINARY, check_archive, check_file, open_file, read_file

KNOWN_FORMATS = ("OBJ", "STL", "PLY", "GLB", "GLTF", "OFF", "3MF")

_ARCHIVES = ("zip", "bz2", "tar.gz", "tar.bz2")  # of whatever files, which are not read
_MOST_POINTS = LARGEST_BINARY // 16  # points in the arrays of a glTF file


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
    """Refuse nodes of a glTF file that are no trees: trimesh leaves out places of a node that has two parents.

    It never ends where a node is its own descendant.
    """
    children = [list(node.get("children", ())) for node in header.get("nodes", ())]
    parents = Counter(child for several in children for child in several)
    reached = [node for node in range(len(children)) if node not in parents]
    for node in reached:  # which grows meanwhile
        reached += [child for child in children[node] if parents[child] == 1]
    if len(reached) != len(children):
        raise InputError(
            str(file), "must hold nodes that form trees, but one has two parents, or is its own descendant"
        )


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
