"""What is printed of a value is a line, however much it holds."""

import numpy as np

import clsim


def test_reprs_are_short() -> None:
    times = np.linspace(0.0, 1.0, 200)
    way = clsim.Trajectory.waypoints(times, np.column_stack([1.0 + times, 1.0 + 0.0 * times, 1.0 + 0.0 * times]))
    source = clsim.Source("robot", clsim.Signal.from_array(np.sin(np.arange(9600.0)), 96e3), way)
    ears = clsim.receiver_array("ceiling", clsim.grid_positions((0.5, 5.5, 20), (0.5, 3.5, 10), 2.3))
    box = clsim.Shoebox((6.0, 4.0, 2.5), clsim.Material.from_reflection(0.8))
    scene = clsim.Scene(box, clsim.Air(), [source], ears)
    paths = clsim.find_paths(scene, 1)
    values = [
        scene,
        box,
        box.as_mesh(),
        source,
        source.signal,
        ears[0],
        paths,
        paths.table([0.0, 0.5]),
        clsim.track(paths),
    ]
    for value in values:
        shown = repr(value)
        assert shown.startswith(f"{type(value).__name__}("), shown
        assert len(shown) < 600, shown
        assert "\n" not in shown
    assert repr(scene).startswith("Scene(room=Shoebox(")
    assert "<200 Receiver>" in repr(scene)
