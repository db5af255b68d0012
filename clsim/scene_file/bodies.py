"""Tables of what moves in a room: bodies and scatterers."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from clsim.errors import InputError
from clsim.scene.body import Body
from clsim.scene.captured import captured_person
from clsim.scene.fluctuation import TargetFluctuation
from clsim.scene.people import hand, walking_person
from clsim.scene.room.mesh import MeshRoom
from clsim.scene.scatterer import Scatterer
from clsim.scene_file.materials import MaterialModel
from clsim.scene_file.model import Model, Pair, Quaternion, Vector, within
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
        material = within("material", lambda: self.material.build(base))
        return Body.box(size=self.size, centre=self.centre, material=material, **self.moving(base))


class _Mesh(_Body):
    kind: Literal["mesh"]
    mesh: MeshModel

    def build(self, base: Path) -> Body:
        return Body(mesh=within("mesh", lambda: self.mesh.build(base)), **self.moving(base))


class _Faces(_Body):
    kind: Literal["faces"]
    vertices: list[Vector]
    triangles: list[Corners]
    material: MaterialModel

    def build(self, base: Path) -> Body:
        material = within("material", lambda: self.material.build(base))
        if not self.triangles:
            raise InputError("triangles", "must hold at least one, but is empty")
        vertices = np.array(self.vertices, dtype=np.float64).reshape(-1, 3)
        return Body(mesh=MeshRoom(vertices, np.array(self.triangles), material), **self.moving(base))


BodyModel = Annotated[_Box | _Mesh | _Faces, Field(discriminator="kind")]


class _Fluctuation(Model):
    correlation_time: float
    steady: float = 0.0
    seed: int = 0

    def build(self) -> TargetFluctuation:
        return TargetFluctuation(**self.arguments())


class _Scatterer(Model):
    name: str
    trajectory: TrajectoryModel
    fluctuation: _Fluctuation | None = None

    def parts(self, base: Path) -> dict[str, Any]:
        """Return the arguments of the constructor of this kind."""
        noise = self.fluctuation
        return self.arguments() | {
            "trajectory": within("trajectory", lambda: self.trajectory.build(base)),
            "fluctuation": None if noise is None else within("fluctuation", noise.build),
        }


class _Point(_Scatterer):
    kind: Literal["point"]
    target_strength_db: float

    def build(self, base: Path) -> list[Scatterer]:
        return [Scatterer.point(**self.parts(base))]


class _Sphere(_Scatterer):
    kind: Literal["sphere"]
    radius: float
    model: Literal["series", "geometrical", "outline"] = "series"

    def build(self, base: Path) -> list[Scatterer]:
        return [Scatterer.sphere(**self.parts(base))]


class _Ellipsoid(_Scatterer):
    kind: Literal["ellipsoid"]
    semi_axes: Vector
    shadow: bool = False

    def build(self, base: Path) -> list[Scatterer]:
        return [Scatterer.ellipsoid(**self.parts(base))]


class _Capsule(_Scatterer):
    kind: Literal["capsule"]
    radius: float
    length: float
    shadow: bool = False

    def build(self, base: Path) -> list[Scatterer]:
        return [Scatterer.capsule(**self.parts(base))]


class _Person(Model):
    kind: Literal["person"]
    name: str
    height: float
    trajectory: TrajectoryModel
    shadow: bool = False

    def build(self, base: Path) -> list[Scatterer]:
        trajectory = within("trajectory", lambda: self.trajectory.build(base))
        return walking_person(**self.arguments() | {"trajectory": trajectory})


class _Segment(Model):
    start: str
    end: str
    radius: float


class _CapturedPerson(Model):
    kind: Literal["captured-person"]
    name: str
    path: str
    segments: list[_Segment] | None = None
    shape: Literal["ellipsoid", "capsule"] = "ellipsoid"
    scale: float = 1.0
    up: Literal["x", "y", "z"] | None = None
    rotate: Quaternion = [0.0, 0.0, 0.0, 1.0]
    translate: Vector = [0.0, 0.0, 0.0]
    time_offset: float = 0.0

    def build(self, base: Path) -> list[Scatterer]:
        arguments = self.arguments() | {"path": base / self.path}
        if self.segments is not None:
            arguments["segments"] = [(s.start, s.end, s.radius) for s in self.segments]
        return captured_person(**arguments)


class _Hand(Model):
    kind: Literal["hand"]
    name: str
    trajectory: TrajectoryModel
    length: float = 0.19
    opening: float | list[Pair] = 1.0
    shadow: bool = False

    def build(self, base: Path) -> list[Scatterer]:
        return hand(**self.arguments() | {"trajectory": within("trajectory", lambda: self.trajectory.build(base))})


ScattererModel = Annotated[
    _Point | _Sphere | _Ellipsoid | _Capsule | _Person | _CapturedPerson | _Hand, Field(discriminator="kind")
]
