"""Gains from every fourth node: against gains from every node."""

import math
import re

import numpy as np
import pytest

import clsim
from clsim.opencl.launch import Launch
from clsim.render.opencl import nodes
from clsim.render.opencl.engine import CPU_LAYOUT, GPU_LAYOUT, OpenclEngine
from clsim.render.planning import plan_render

RATE = 192e3
SEGMENT = 18432
CURTAIN = clsim.Material.from_absorption([20e3, 30e3, 40e3, 50e3, 60e3], [0.1, 0.2, 0.4, 0.5, 0.5])


def _plan(turns: float = 0.0):
    """Return the plan of a source at 3 m/s, whose beam may turn so often a second, 2 segments long."""
    duration = 2 * SEGMENT / RATE
    times = np.linspace(0.0, duration, 41)
    angle = 2.0 * math.pi * turns * times
    facing = np.stack([0.0 * times, 0.0 * times, np.sin(0.5 * angle), np.cos(0.5 * angle)], axis=1)
    places = np.array([3.0, 3.0, 1.5]) + 3.0 * times[:, None] * np.array([0.6, 0.8, 0.0])
    way = clsim.Trajectory.waypoints(times, places, orientations=facing)
    source = clsim.Source("s", clsim.Signal.tone(40e3, duration, RATE, fade=0.01), way, clsim.Piston(0.004))
    receivers = [clsim.Receiver("a", clsim.Trajectory.fixed((7.0, 1.0, 2.0)))]
    room = clsim.Shoebox((9.0, 8.0, 4.0), CURTAIN)
    return plan_render(
        clsim.find_paths(clsim.Scene(room, clsim.Air(), [source], receivers), 1), RATE, duration=duration
    )


def _asked(plan, monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Return the error of smooth gains that is passed to launches of the nodes' kernel."""
    asked, launch = [], Launch.__call__

    def watched(self, *arguments, **named):
        asked.extend([named["smooth"]] if "smooth" in named else [])
        return launch(self, *arguments, **named)

    with monkeypatch.context() as patched:
        patched.setattr(Launch, "__call__", watched)
        OpenclEngine(plan).render(0, SEGMENT)
    return asked


@pytest.mark.usefixtures("device")
@pytest.mark.parametrize("layout", [CPU_LAYOUT, GPU_LAYOUT])
def test_gains_of_every_fourth_node_are_as_good_as_those_of_every_one(layout, monkeypatch: pytest.MonkeyPatch) -> None:
    plan = _plan()
    few = OpenclEngine(plan, layout).render(0, 2 * SEGMENT)[0, SEGMENT:]
    monkeypatch.setattr(nodes, "SMOOTH_SHARE", 0.0)
    every = OpenclEngine(plan, layout).render(0, 2 * SEGMENT)[0, SEGMENT:]
    difference_db = 20.0 * np.log10(np.linalg.norm(few - every) / np.linalg.norm(every))
    assert difference_db > -200.0  # they are not the same: some cells are smooth
    assert difference_db < plan.motion_error_db - 10.0  # the tenth of the square that they may add


@pytest.mark.usefixtures("device")
def test_beams_that_turn_fast_are_looked_at_in_every_block(monkeypatch: pytest.MonkeyPatch) -> None:
    slow, fast = _asked(_plan(1.0), monkeypatch), _asked(_plan(20.0), monkeypatch)
    assert min(slow) > 0.0
    assert fast[0] == 0.0


@pytest.mark.usefixtures("device")
def test_a_beam_over_the_sphere_is_held_within_what_is_told() -> None:
    # Between nodes a table of so few directions bends: with gains of every fourth one this is -91 dB.
    spots = np.array([(x, y, z) for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1) if (x, y, z) != (0, 0, 0)])
    unit = spots / np.linalg.norm(spots, axis=1, keepdims=True)
    pattern = (0.6 + 0.3 * unit[:, :1] + 0.1 * unit[:, 1:2]) * np.array([[1.0, 0.8 + 0.1j]])
    half = math.sqrt(0.5)
    turning = clsim.Trajectory.waypoints(
        [0.0, 0.5, 1.0],
        [(1.5, 1.5, 1.5), (1.7, 1.6, 1.5), (1.8, 1.9, 1.4)],
        [(0, 0, 0, 1), (0, 0, half, half), (0, 0, 1, 0)],
    )
    beam = clsim.SphericalDirectivity(unit, [20e3, 60e3], pattern)
    moving = clsim.Trajectory.line((4.0, 3.1, 0.9), (4.2, 2.2, 1.1), 1.0)
    scene = clsim.Scene(
        clsim.Shoebox((5.0, 4.0, 3.0), clsim.Material.from_reflection(0.9)), clsim.Air(),
        [clsim.Source("s", clsim.Signal.tone(40e3, 0.02, RATE, fade=0.002), turning, beam)],
        [clsim.Receiver("r", moving, beam, aim=(-1, 0, 0))],
    )  # fmt: skip
    paths = clsim.find_paths(scene, 1)
    heard, wanted = (clsim.render(paths, RATE, engine=engine) for engine in ("opencl", "reference"))
    told_db = min(
        float(found[1]) for note in heard.notes if (found := re.search(r"total error at most (-\d+) dB", note))
    )
    apart = np.linalg.norm(heard.samples - wanted.samples) / np.linalg.norm(wanted.samples)
    assert 20.0 * np.log10(apart) < told_db
