"""Nodes that the host makes by threads: the same to the last bit whatever the number of these."""

import threading

import numpy as np
import pytest

import clsim
from clsim.render.opencl import host_nodes
from clsim.render.opencl.engine import OpenclEngine
from clsim.render.opencl.host_nodes import side_by_side
from clsim.render.planning import plan_render

RATE = 192e3


def test_results_are_in_order_and_errors_are_raised() -> None:
    both = threading.Barrier(3, timeout=60.0)  # two threads and this one are at work at the same time

    def squared(number: int) -> int:
        if number < 2:
            both.wait()
        return number**2

    assert side_by_side(squared, range(5), meanwhile=both.wait, threads=2) == [0, 1, 4, 9, 16]
    done: list[int] = []
    assert side_by_side(lambda x: x + 1, [1], meanwhile=lambda: done.append(0)) == [2]
    assert done == [0]
    with pytest.raises(ZeroDivisionError):
        side_by_side(lambda x: 1 // x, [1, 0], threads=2)


def test_not_a_bit_depends_on_the_number_of_threads(device: None, monkeypatch: pytest.MonkeyPatch) -> None:
    hand = clsim.Scatterer.ellipsoid(
        "hand", (0.02, 0.05, 0.09), clsim.Trajectory.line((2, 2.5, 1.2), (1.4, 2.5, 1.2), 0.5),
        clsim.TargetFluctuation(0.5), shadow=False,  # of the former the device knows nothing
    )  # fmt: skip
    tone = clsim.Signal.chirp(38e3, 42e3, 0.09, RATE, window="hann")
    ears = [clsim.Receiver(f"ear {y:g}", clsim.Trajectory.fixed((1.0, y, 1.2))) for y in (2.4, 2.6)]
    scene = clsim.Scene(
        clsim.Shoebox((6.0, 5.0, 2.5), clsim.Material.from_reflection(0.8)), clsim.Air(),
        [clsim.Source("sonar", tone, clsim.Trajectory.fixed((1.0, 2.5, 1.2)))], ears, scatterers=[hand],
    )  # fmt: skip
    plan = plan_render(clsim.find_paths(scene, 0, scattering_order=1), RATE, duration=0.09)
    monkeypatch.setattr(host_nodes, "_PATHS_EACH", 16)  # 49 paths of each pair
    heard, at_work = [], set()
    part = host_nodes.HostNodeMaker._part

    def watched(*arguments):
        at_work.add(threading.get_ident())
        return part(*arguments)

    monkeypatch.setattr(host_nodes.HostNodeMaker, "_part", watched)
    for count in (1, 2, 7):
        at_work.clear()
        monkeypatch.setattr(host_nodes, "thread_count", lambda count=count: count)
        heard.append(OpenclEngine(plan).render(0, plan.samples))
        assert (len(at_work) > 1) == (count > 1)
    assert np.any(heard[0])
    np.testing.assert_array_equal(heard[1], heard[0])
    np.testing.assert_array_equal(heard[2], heard[0])
