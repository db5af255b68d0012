"""Things that scatter, in scene files."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from clsim.scene.captured import captured_person
from clsim.scene.fluctuation import TargetFluctuation
from clsim.scene.hands import hand
from clsim.scene.scatterer import Scatterer
from clsim.scene.walking import walking_person
from clsim.scene_file.model import Model, Pair, Quaternion, Vector, within
from clsim.scene_file.motion_and_signals import TrajectoryModel


class _Fluctuation(Model):
    correlation_time: float
    steady: float = 0.0
    seed: int = 0

    def build(self) -> TargetFluctuation:
        """Return what it says."""
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
        """Return what it says."""
        return [Scatterer.point(**self.parts(base))]


class _Sphere(_Scatterer):
    kind: Literal["sphere"]
    radius: float
    model: Literal["series", "geometrical"] = "series"

    def build(self, base: Path) -> list[Scatterer]:
        """Return what it says."""
        return [Scatterer.sphere(**self.parts(base))]


class _Ellipsoid(_Scatterer):
    kind: Literal["ellipsoid"]
    semi_axes: Vector

    def build(self, base: Path) -> list[Scatterer]:
        """Return what it says."""
        return [Scatterer.ellipsoid(**self.parts(base))]


class _Capsule(_Scatterer):
    kind: Literal["capsule"]
    radius: float
    length: float

    def build(self, base: Path) -> list[Scatterer]:
        """Return what it says."""
        return [Scatterer.capsule(**self.parts(base))]


class _Person(Model):
    kind: Literal["person"]
    name: str
    height: float
    trajectory: TrajectoryModel

    def build(self, base: Path) -> list[Scatterer]:
        """Return what it says."""
        return walking_person(self.name, self.height, within("trajectory", lambda: self.trajectory.build(base)))


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
        """Return what it says."""
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

    def build(self, base: Path) -> list[Scatterer]:
        """Return what it says."""
        return hand(**self.arguments() | {"trajectory": within("trajectory", lambda: self.trajectory.build(base))})


ScattererModel = Annotated[
    _Point | _Sphere | _Ellipsoid | _Capsule | _Person | _CapturedPerson | _Hand, Field(discriminator="kind")
]
