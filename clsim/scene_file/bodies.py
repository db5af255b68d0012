"""Tables of bodies that move."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from clsim.errors import InputError
from clsim.scene.body import Body
from clsim.scene.room.mesh import MeshRoom
from clsim.scene_file.materials import MaterialModel
from clsim.scene_file.model import Model, Vector, within
from clsim.scene_file.motion_and_signals import TrajectoryModel
from clsim.scene_file.rooms import MeshModel

Corners = Annotated[list[int], Field(min_length=3, max_length=3)]


class _Body(Model):
    name: str
    trajectory: TrajectoryModel

    def moving(self, base: Path) -> dict[str, Any]:
        """Return the arguments that all kinds have."""
        return {"name": self.name, "trajectory": within("trajectory", lambda: self.trajectory.build(base))}


class _Box(_Body):
    kind: Literal["box"]
    size: Vector
    centre: Vector = [0.0, 0.0, 0.0]
    material: MaterialModel

    def build(self, base: Path) -> Body:
        """Return what it says."""
        material = within("material", lambda: self.material.build(base))
        return Body.box(size=self.size, centre=self.centre, material=material, **self.moving(base))


class _Mesh(_Body):
    kind: Literal["mesh"]
    mesh: MeshModel

    def build(self, base: Path) -> Body:
        """Return what it says."""
        return Body(mesh=within("mesh", lambda: self.mesh.build(base)), **self.moving(base))


class _Faces(_Body):
    kind: Literal["faces"]
    vertices: list[Vector]
    triangles: list[Corners]
    material: MaterialModel

    def build(self, base: Path) -> Body:
        """Return what it says."""
        material = within("material", lambda: self.material.build(base))
        if not self.triangles:
            raise InputError("triangles", "must hold at least one, but is empty")
        vertices = np.array(self.vertices, dtype=np.float64).reshape(-1, 3)
        return Body(mesh=MeshRoom(vertices, np.array(self.triangles), material), **self.moving(base))


BodyModel = Annotated[_Box | _Mesh | _Faces, Field(discriminator="kind")]
