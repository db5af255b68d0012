"""Where warnings say that they come from."""

import warnings

import pytest

import clsim


def test_warnings_name_the_line_outside_that_called() -> None:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        clsim.Air(temperature_celsius=35.0)
        tone = clsim.Signal.tone(40.0, 0.5, 8e3)  # looks like kHz
        source = clsim.Source("s", tone, clsim.Trajectory.fixed((1.0, 1.0, 1.0)))
        receiver = clsim.Receiver("r", clsim.Trajectory.fixed((2.0, 2.0, 2.0)))
        room = clsim.Shoebox((4000.0, 3000.0, 2500.0), clsim.Material.from_reflection(0.9))
        scene = clsim.Scene(room, clsim.Air(), [source], [receiver])
        clsim.render(clsim.find_paths(scene, 0), 8e3, duration=0.1, engine="reference")
    assert len(caught) >= 2
    assert {w.filename for w in caught} == {__file__}
    assert all(issubclass(w.category, clsim.ClsimWarning) for w in caught)
    with pytest.raises(clsim.ClsimWarning, match="Cramer"):
        clsim.Air(temperature_celsius=35.0)
