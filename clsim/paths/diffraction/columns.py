"""From paths one by one to the columns of a family."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.acoustics.diffraction import TERMS
from clsim.arrays import read_only
from clsim.paths.diffraction.visibility import ENDS_BESIDE, SIDES
from clsim.paths.family import DIFFRACTION, NONE, SPECULAR
from clsim.paths.specular.mesh import image_isometries

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.scene.room.edges import Edges
    from clsim.scene.scene import Scene


def path_columns(scene: Scene, edges: Edges, order: int, rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the columns of paths over one edge, and those of the first edge of paths over two."""
    count = len(rows)
    before, after = (_padded([r[side] for r in rows], order) for side in ("before", "after"))
    edge, end = (np.array([name(r) for r in rows], dtype=np.int64) for name in (_first_edge, _end))
    objects = np.full((count, order + 2), -1, dtype=np.int32)
    kinds = np.full((count, order + 2), NONE, dtype=np.int8)
    for i, r in enumerate(rows):
        n, m = len(r["before"]), len(r["after"])
        things = r["edges"] if r["faces"][0] >= 0 else r["edges"][:1]
        if r["end_of"] >= 0:
            things = [len(edges) + 2 * things[0] + r["end_of"]]
        objects[i, : n + m + len(things)] = [*r["before"], *things, *r["after"][::-1]]
        kinds[i, : n + m + len(things)] = [SPECULAR] * n + [DIFFRACTION] * len(things) + [SPECULAR] * m
    longest = order + max((1 + (r["faces"][0] >= 0) for r in rows), default=1)
    objects, kinds = objects[:, :longest], kinds[:, :longest]
    sides = np.array([r["sides"] for r in rows], dtype=np.int8).reshape(-1, SIDES)
    isometries = [(np.empty((0, 3, 3)), np.empty((0, 3)))] * 2
    if count:
        walls = scene.room.as_mesh().walls
        isometries = [image_isometries(walls, w) for w in (before, after)]
    columns: dict[str, Any] = {
        "source": np.array([r["source"] for r in rows], dtype=np.int32),
        "receiver": np.array([r["receiver"] for r in rows], dtype=np.int32),
        "order": np.sum(objects >= 0, axis=1).astype(np.int32),
        "start": np.array([r["start"] for r in rows], dtype=np.float64),
        "end": np.array([r["end"] for r in rows], dtype=np.float64),
        "interactions": kinds,
        "objects": objects,
        "before_matrix": isometries[0][0],
        "before_offset": isometries[0][1],
        "after_matrix": isometries[1][0],
        "after_offset": isometries[1][1],
        "frame": edges.frames[edge],
        "n": edges.n[edge],
        "faces": edges.faces[edge],
        "lit": sides[:, :TERMS],
        "end_place": np.where(end < 0, np.nan, np.where(end == 0, 0.0, edges.length[edge])),
        "end_side": sides[:, TERMS],
        "beside": sides[:, ENDS_BESIDE],
    }
    return {name: read_only(column) for name, column in columns.items()}


def _first_edge(row: dict[str, Any]) -> int:
    return int(row["edges"][0])


def _end(row: dict[str, Any]) -> int:
    return int(row["end_of"])


def _padded(sequences: list[NDArray[np.int32]], width: int) -> NDArray[np.int32]:
    """Return sequences (n, width), filled up with -1."""
    found = np.full((len(sequences), width), -1, dtype=np.int32)
    for row, sequence in zip(found, sequences, strict=True):
        row[: len(sequence)] = sequence
    return found
