"""Hands: parts that meet at their joints, open and closed, on trajectories that move, rest and turn."""

from typing import Any

import numpy as np
import pytest

import clsim
from clsim.numerics.quaternions import rotate

FINGERS = ("thumb", "index", "middle", "ring", "little")


def ends_of(part: Any, time: float) -> np.ndarray:
    """Return the centres of both round ends of a finger's part (2, 3), the one nearer to the palm first."""
    at = np.array([time])
    along = 0.5 * part.shape.length * rotate(part.trajectory.orientation(at), np.array([0.0, 0.0, 1.0]))[0]
    return part.trajectory.position(at)[0] + np.array([[-1.0], [1.0]]) * along


def test_an_open_hand_is_flat_and_a_closed_one_a_fist() -> None:
    at = clsim.Trajectory.fixed((1.0, 2.0, 1.0))
    for opening in (1.0, 0.0):
        parts = {s.name.removeprefix("h "): s for s in clsim.hand("h", at, 0.2, opening)}
        assert all(part.is_static for part in parts.values())
        assert len(parts) == 11
        for finger in FINGERS:
            inner, outer = (ends_of(parts[finger + tip], 0.0) for tip in ("", " tip"))
            np.testing.assert_allclose(inner[1], outer[0], atol=1e-12)
            tip = outer[1] - [1.0, 2.0, 1.0]
            if opening == 1.0:
                assert tip[0] == pytest.approx(0.0, abs=1e-12)
            else:
                assert tip[0] > 0.15 * 0.2, finger  # before the palm
        middle = ends_of(parts["middle tip"], 0.0)[1] - [1.0, 2.0, 1.0]
        wanted = [0.0, 0.2 * 0.04, 0.2 * (0.26 + 0.42)] if opening else [0.2 * 0.23, 0.2 * 0.04, 0.2 * (0.26 - 0.19)]
        np.testing.assert_allclose(middle, wanted, atol=1e-12)


def test_a_gesture_on_a_hand_that_moves_and_turns() -> None:
    """It opens and closes in its own frame; parts stay together to the last slerp, and are as fast as they turn."""
    t = np.linspace(0.0, 1.0, 11)
    turns = np.stack([0.0 * t, 0.0 * t, np.sin(0.4 * t), np.cos(0.4 * t)], axis=1)
    way = clsim.Trajectory.waypoints(t, np.stack([1.0 + 0.2 * t, 2.0 + 0.0 * t, 1.0 + 0.1 * t], axis=1), turns)
    parts = {s.name.removeprefix("h "): s for s in clsim.hand("h", way, 0.2, [(0.2, 1.0), (0.5, 0.0), (0.8, 1.0)])}
    for time, opening in ((0.1, 1.0), (0.5, 0.0), (0.9, 1.0)):
        still = {
            s.name.removeprefix("h "): s for s in clsim.hand("h", clsim.Trajectory.fixed((0.0, 0.0, 0.0)), 0.2, opening)
        }
        for name in ("index", "index tip", "thumb tip"):
            wanted = rotate(way.orientation(time), ends_of(still[name], 0.0)) + way.position(time)
            np.testing.assert_allclose(ends_of(parts[name], time), wanted, atol=1e-6)
    for time in np.linspace(0.05, 0.95, 19):
        np.testing.assert_allclose(ends_of(parts["ring"], time)[1], ends_of(parts["ring tip"], time)[0], atol=1e-6)
    assert parts["ring tip"].trajectory.peak_turn == pytest.approx(1.875 * np.pi / 0.3, rel=0.15)
    assert parts["palm"].trajectory.peak_turn == pytest.approx(0.8, rel=0.05)
    resting = clsim.hand("h", clsim.Trajectory.fixed((1.0, 1.0, 1.0)), opening=[(0.1, 1.0), (0.6, 0.0)])
    assert [resting[3].trajectory.start, resting[3].trajectory.end] == [0.0, 0.6]


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"length": 0.0}, "length: must be above 0 m"), ({"opening": 1.2}, "opening: must be at most 1, but is 1.2"),
        ({"opening": [(0.0, 1.0), (1.0, -0.5)]}, r"opening\[1\]\[1\]: must be at least 0, but is -0.5"),
        ({"opening": [(1.0, 1.0), (1.0, 0.5)]}, "opening.times: must increase strictly"),
        ({"trajectory": 3}, "trajectory: must be a Trajectory"),
    ],
)  # fmt: skip
def test_what_is_no_hand(given: dict[str, Any], message: str) -> None:
    with pytest.raises(clsim.InputError, match=message):
        clsim.hand("h", **{"trajectory": clsim.Trajectory.fixed((1.0, 1.0, 1.0))} | given)


def test_a_hand_that_is_turned_and_rests_has_parts_at_rest() -> None:
    turned = clsim.Trajectory.fixed((1.0, 2.0, 1.0), orientation=(0.5, 0.5, 0.5, 0.5))
    parts = clsim.hand("h", turned)
    assert all(part.trajectory.is_static for part in parts)
    upright = {part.name: part for part in clsim.hand("h", clsim.Trajectory.fixed((1.0, 2.0, 1.0)))}
    for part in parts[1:]:
        expected = rotate(np.array([0.5, 0.5, 0.5, 0.5]), ends_of(upright[part.name], 0.0) - (1.0, 2.0, 1.0))
        np.testing.assert_allclose(ends_of(part, 0.0) - (1.0, 2.0, 1.0), expected, atol=1e-12)
