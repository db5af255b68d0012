"""From paths one by one to chains over edges of the room."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from clsim.acoustics.diffraction import TERMS
from clsim.arrays import read_only
from clsim.paths.chain import Chain
from clsim.paths.diffraction.visibility import ENDS_BESIDE, SIDES
from clsim.paths.family import DIFFRACTION, NONE, SPECULAR
from clsim.paths.legs.static import StaticLeg
from clsim.paths.moving.edge_lines import EdgeLines
from clsim.paths.specular.mesh import image_isometries
from clsim.paths.vertices.edge import COLUMNS, EdgeVertex
from clsim.paths.vertices.edge_pair import EdgePairVertex

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from clsim.scene.scene import Scene

    Found = list[dict[str, Any]]


def edge_chain(scene: Scene, model: str, order: int, rows: Found) -> Chain:
    """Make paths over one edge with the field of a model."""
    lines = EdgeLines.of(scene, of_bodies=False)
    return _chain(scene, order, rows, EdgeVertex(**_first_edges(rows), lines=lines, model=model))


def edge_pair_chain(scene: Scene, order: int, rows: Found) -> Chain:
    """Make paths over two edges that share a face."""
    lines, columns = EdgeLines.of(scene, of_bodies=False), _first_edges(rows)
    second = {
        "edge": np.array([r["edges"][1] for r in rows], dtype=np.int64),
        "lit": np.array([r["sides"][TERMS + 1 : 2 * TERMS + 1] for r in rows], dtype=np.int8).reshape(-1, TERMS),
    }
    last = EdgeVertex(**(columns | second), lines=lines, model="utd")
    shared = read_only(np.array([r["faces"] for r in rows], dtype=np.int64).reshape(-1, 2))
    vertex = EdgePairVertex(**columns, lines=lines, model="utd", last=last, shared=shared)
    return _chain(scene, order, rows, vertex)


def _first_edges(rows: Found) -> dict[str, Any]:
    """Columns of `EdgeVertex` of the first edges."""
    sides = np.array([r["sides"] for r in rows], dtype=np.int8).reshape(-1, SIDES)
    edge = np.array([r["edges"][0] for r in rows], dtype=np.int64)
    end = np.array([r["end_of"] for r in rows], dtype=np.int8)
    values: tuple[Any, ...] = (edge, end, sides[:, :TERMS], sides[:, TERMS], sides[:, ENDS_BESIDE])
    return {name: read_only(column) for name, column in zip(COLUMNS, values, strict=True)}


def _chain(scene: Scene, order: int, rows: Found, vertex: EdgeVertex) -> Chain:
    count, edges = len(rows), len(vertex.lines)
    objects = np.full((count, order + 2), -1, dtype=np.int32)
    kinds = np.full((count, order + 2), NONE, dtype=np.int8)
    for i, r in enumerate(rows):
        n, m = len(r["before"]), len(r["after"])
        things = r["edges"] if r["faces"][0] >= 0 else r["edges"][:1]
        if r["end_of"] >= 0:
            things = [edges + 2 * things[0] + r["end_of"]]
        objects[i, : n + m + len(things)] = [*r["before"], *things, *r["after"][::-1]]
        kinds[i, : n + m + len(things)] = [SPECULAR] * n + [DIFFRACTION] * len(things) + [SPECULAR] * m
    longest = order + max((1 + (r["faces"][0] >= 0) for r in rows), default=1)
    objects, kinds = read_only(objects[:, :longest]), read_only(kinds[:, :longest])
    legs = _leg(scene, order, [r["before"] for r in rows]), _leg(scene, order, [r["after"] for r in rows])
    columns: dict[str, Any] = {
        "source": np.array([r["source"] for r in rows], dtype=np.int32),
        "receiver": np.array([r["receiver"] for r in rows], dtype=np.int32),
        "order": np.sum(objects >= 0, axis=1).astype(np.int32),
        "start": np.array([r["start"] for r in rows], dtype=np.float64),
        "end": np.array([r["end"] for r in rows], dtype=np.float64),
    }
    held = {name: read_only(column) for name, column in columns.items()}
    return Chain(scene=scene, **held, interactions=kinds, objects=objects, legs=legs, vertex=vertex)


def _leg(scene: Scene, width: int, sequences: list[NDArray[np.int32]]) -> StaticLeg:
    """Make legs by sequences of walls."""
    found = np.full((len(sequences), width), -1, dtype=np.int32)
    for row, sequence in zip(found, sequences, strict=True):
        row[: len(sequence)] = sequence
    if not sequences:
        return StaticLeg(np.empty((0, 3, 3)), np.empty((0, 3)))
    return StaticLeg(*(read_only(x) for x in image_isometries(scene.room.as_mesh().walls, found)))
