"""A material and a directivity of one's own: nothing but this file knows of them.

Stores, commands, interpolators, rooms, kinds of paths, contributions and options have such tests beside their own.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

import clsim

RATE, C = 48e3, 343.0
AIR = clsim.Air(speed_of_sound=C, absorption=False)
TONE = clsim.Signal.tone(8e3, 0.08, RATE, fade=5e-3)
HERE, THERE = (1.0, 1.5, 1.2), (3.0, 1.4, 1.3)


@dataclass(frozen=True)
class Curtain:
    """Sends back half of what comes straight, and all that grazes."""

    is_complex = False
    depends_on_angle = True
    band = (100.0, 20e3)
    beyond = ""

    def factor(self, frequency: np.ndarray, cosine: np.ndarray, speed_of_sound: float) -> np.ndarray:
        return np.broadcast_to(1.0 - 0.5 * cosine, np.broadcast_shapes(frequency.shape, cosine.shape))

    def describe(self) -> str:
        return "curtain"


class Quadrupole(clsim.Directivity):
    """Louder to its left than to its right."""

    is_complex = False
    band = (0.0, np.inf)

    def gain_towards(self, direction: np.ndarray, frequency: Any, speed_of_sound: float) -> np.ndarray:
        return (1.0 + 0.4 * direction[..., 1]) * np.ones_like(np.asarray(frequency, dtype=float))


def rendered(engine: str, walls: clsim.Material, directivity: clsim.Directivity, order: int) -> tuple[Any, Any]:
    source = clsim.Source(
        "s", TONE, clsim.Trajectory.line(HERE, (1.02, 1.5, 1.2), 1.0), directivity=directivity, aim=(1, 0, 0)
    )
    receiver = clsim.Receiver("r", clsim.Trajectory.fixed(THERE))
    scene = clsim.Scene(clsim.Shoebox((4.0, 3.0, 2.5), walls), AIR, [source], [receiver])
    paths = clsim.find_paths(scene, order)
    made = clsim.render(paths, RATE, duration=0.08, engine=engine).pressure[0]
    times = np.arange(round(0.04 * RATE), round(0.07 * RATE)) / RATE
    table = paths.table(times)
    wanted = np.sum(table.gain * np.sin(2 * np.pi * 8e3 * (times - table.delay)), axis=0)
    return made[round(0.04 * RATE) : round(0.07 * RATE)], (table, wanted)


def test_a_material(engine: str) -> None:
    made, (table, wanted) = rendered(engine, clsim.Material(Curtain()), clsim.Omni(), 1)
    sent_back = np.abs(table.gain) * table.delay * C  # of each path, but for spreading
    floor = np.flatnonzero(table.walls[:, 0] == 4)[0]
    cosine = 2.5 / np.hypot(2.5, np.hypot(2.0, 0.1))  # 1.2 m and 1.3 m above it
    assert sent_back[floor, 0] == pytest.approx(1.0 - 0.5 * cosine, rel=5e-3)
    assert np.linalg.norm(made - wanted) < 10 ** (-70 / 20) * np.linalg.norm(wanted)
    with pytest.raises(clsim.InputError, match="covers"):
        clsim.Material(Curtain()).reflection_at(30e3)
    with pytest.raises(clsim.InputError, match=r"^model: must have what a SurfaceModel has"):
        clsim.Material(0.5)


def test_a_directivity(engine: str) -> None:
    made, (table, wanted) = rendered(engine, clsim.Material.from_reflection(0.8), Quadrupole(), 1)
    left = np.flatnonzero(table.walls[:, 0] == 3)[0]
    assert table.departure[left, 0, 1] > 0.5
    loud = table.gain[left, 0] * table.delay[left, 0] * C / 0.8
    assert loud == pytest.approx(1.0 + 0.4 * table.departure[left, 0, 1], rel=1e-3)
    assert np.linalg.norm(made - wanted) < 10 ** (-70 / 20) * np.linalg.norm(wanted)
