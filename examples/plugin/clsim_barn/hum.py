"""A rendering method: the hum of the mains, added to receivers whose names begin with "mains"."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from clsim.render.contributions import Stateless
from clsim.render.plan import Plan

FREQUENCY = 50.0  # Hz
AMPLITUDE = 0.01  # Pa


@dataclass(frozen=True)
class Hum(Stateless):
    """A sine of 50 Hz; its samples depend on their number alone."""

    receivers: tuple[int, ...]
    sampling_rate: float
    name: str = "hum"

    def describe(self) -> list[str]:
        return [f"hum of {FREQUENCY:g} Hz at {len(self.receivers)} receivers"]

    def digest(self) -> str:
        return repr((self.receivers, FREQUENCY, AMPLITUDE))

    def begin(self) -> "Hum":
        return self

    def add(self, pressure: NDArray[Any], start: int) -> None:
        times = np.arange(start, start + pressure.shape[1]) / self.sampling_rate
        pressure[list(self.receivers)] += AMPLITUDE * np.sin(2.0 * np.pi * FREQUENCY * times)


def build(plan: Plan) -> Hum | None:
    """Build the hum of a plan in pass band; None where no receiver hums."""
    of_scene = plan.tracks.of_scene
    if of_scene is None or plan.options.baseband is not None:
        return None
    humming = tuple(i for i, end in enumerate(of_scene.scene.receivers) if end.name.startswith("mains"))
    return Hum(humming, plan.sampling_rate) if humming else None
