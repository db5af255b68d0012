"""A contribution that fails, to stop runs where one wants them to be stopped; and runs that go on from there."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

import clsim
from clsim.cli import main
from clsim.render import planning
from clsim.render.contributions import Stateless
from clsim.workflow import checkpoint


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


def stopped_and_resumed(
    monkeypatch: pytest.MonkeyPatch, scene: Path, folder: Path, *, at: int = 18432, other: Path | None = None
) -> Path:
    """Run a scene whole into folder/a, and stopped and resumed into folder/b, bit for bit alike; another one is refused."""
    monkeypatch.setattr(checkpoint, "_PERIOD", -1.0)  # every chunk is noted
    fails = [-1]
    monkeypatch.setattr(planning, "BUILDERS", [*planning.BUILDERS, lambda plan: Failing(fails[0])])

    def run(file: Path, out: str, *more: str) -> int:
        return main(["run", str(file), "-o", str(folder / out), "--no-plots", *more])

    assert run(scene, "a") == 0
    fails[0] = at
    assert run(scene, "b") == 2
    fails[0] = -1
    assert other is None or run(other, "b", "--resume") == 2
    assert run(scene, "b", "--resume") == 0
    sounds = list((folder / "a").glob("*.wav"))
    assert sounds
    for sound in sounds:
        assert sound.read_bytes() == (folder / "b" / sound.name).read_bytes()
    return folder / "a"
