"""Things that scatter, in scene files."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from clsim.scene.scatterer import Scatterer
from clsim.scene.target_fluctuation import TargetFluctuation
from clsim.scene_file.model import Model, Vector, within
from clsim.scene_file.motion_and_signals import TrajectoryModel


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
    model: Literal["series", "geometrical"] = "series"

    def build(self, base: Path) -> list[Scatterer]:
        return [Scatterer.sphere(**self.parts(base))]


class _Ellipsoid(_Scatterer):
    kind: Literal["ellipsoid"]
    semi_axes: Vector

    def build(self, base: Path) -> list[Scatterer]:
        return [Scatterer.ellipsoid(**self.parts(base))]


class _Capsule(_Scatterer):
    kind: Literal["capsule"]
    radius: float
    length: float

    def build(self, base: Path) -> list[Scatterer]:
        return [Scatterer.capsule(**self.parts(base))]


ScattererModel = Annotated[_Point | _Sphere | _Ellipsoid | _Capsule, Field(discriminator="kind")]
