"""A contribution that fails, to stop runs where one wants them to be stopped."""

from dataclasses import dataclass

import numpy as np

import clsim
from clsim.render.contributions import Stateless


@dataclass(frozen=True)
class Failing(Stateless):
    """Adds nothing, and fails at a sample."""

    at: int
    name: str = "failing"

    def describe(self) -> list[str]:
        return []

    def digest(self) -> str:
        return ""

    def begin(self) -> "Failing":
        return self

    def add(self, pressure: np.ndarray, start: int) -> None:
        if start == self.at:
            raise clsim.DeviceError("the device is lost")
