"""Tables of what moves in a room: bodies and scatterers."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from pydantic import Field

from clsim.errors import InputError
from clsim.scene.body import Body
from clsim.scene.captured import SHAPES, UPS, captured_person
from clsim.scene.fluctuation import TargetFluctuation
from clsim.scene.people import hand, walking_person
from clsim.scene.room.mesh import MeshRoom
from clsim.scene.scatterer import Scatterer
from clsim.scene_file.ends import TrajectoryModel
from clsim.scene_file.model import Model, Pair, Quaternion, Table, Vector, one_of, table
from clsim.scene_file.rooms import MaterialModel, MeshModel

Corners = Annotated[list[int], Field(min_length=3, max_length=3)]


class _Body(Table):
    name: str
    trajectory: TrajectoryModel

    constructor = Body


class _Mesh(_Body):
    kind: Literal["mesh"]
    mesh: MeshModel


class _Faces(_Body):
    kind: Literal["faces"]
    vertices: list[Vector]
    triangles: list[Corners]
    material: MaterialModel

    def parts(self, base: Path) -> dict[str, Any]:
        arguments = super().parts(base)
        faces = [arguments.pop(name) for name in ("vertices", "triangles", "material")]
        if not self.triangles:
            raise InputError("triangles", "must hold at least one, but is empty")
        vertices = np.array(faces[0], dtype=np.float64).reshape(-1, 3)
        return arguments | {"mesh": MeshRoom(vertices, np.array(faces[1]), faces[2])}


class _Segment(Model):
    start: str
    end: str
    radius: float


def _segments(segments: list[_Segment] | None) -> list[tuple[str, str, float]] | None:
    return None if segments is None else [(s.start, s.end, s.radius) for s in segments]


class _Captured(Table):
    readers = {"segments": _segments}


if TYPE_CHECKING:
    BodyModel = Table
    ScattererModel = Table
else:
    BodyModel = one_of(table("box", Body.box, base=_Body, material=MaterialModel), _Mesh, _Faces)

    class _Scatterer(Table):
        name: str
        trajectory: TrajectoryModel
        fluctuation: table("", TargetFluctuation, name="_Fluctuation") | None = None

    _scatterer = partial(table, base=_Scatterer)
    ScattererModel = one_of(
        _scatterer("point", Scatterer.point),
        _scatterer("sphere", Scatterer.sphere, model=Literal["series", "geometrical", "outline"]),
        _scatterer("ellipsoid", Scatterer.ellipsoid),
        _scatterer("capsule", Scatterer.capsule),
        table("person", walking_person, trajectory=TrajectoryModel),
        table(
            "captured-person", captured_person, base=_Captured, segments=list[_Segment] | None, shape=Literal[SHAPES],
            up=Literal[UPS] | None, rotate=Quaternion,
        ),
        table("hand", hand, trajectory=TrajectoryModel, opening=float | list[Pair]),
    )  # fmt: skip
