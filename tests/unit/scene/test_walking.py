"""People who walk: the published cycle, angles and lengths, soles on the ground, what no gait is known for."""

from typing import Any

import numpy as np
import pytest

import clsim
from clsim.numerics.quaternions import rotate
from clsim.scene.people import gait_at

TALL, SPEED = 1.75, 1.3
LEG = 0.53 * TALL
CYCLE = 1.346 / np.sqrt(SPEED / LEG)  # s
TIMES = np.arange(0.0, 2.8, 0.005)


@pytest.fixture(scope="module")
def parts() -> dict[str, Any]:
    """Return the positions of the parts of a person who walks straight along y."""
    way = clsim.Trajectory.line((1.0, 1.0, 0.2), (1.0, 6.2, 0.2), 4.0)
    return {s.name.removeprefix("Ada "): s for s in clsim.walking_person("Ada", TALL, way)}


def pitch(part: Any) -> np.ndarray:
    """Return the angle in degrees by which the lower end of a part leads, along y."""
    down = rotate(part.trajectory.orientation(TIMES), np.array([0.0, 0.0, -1.0]))
    return np.degrees(np.arctan2(down[:, 1], -down[:, 2]))


def test_steps_are_as_long_as_published(parts: dict[str, Any]) -> None:
    assert 1.1 < CYCLE < 1.2
    for side, other in (("right", "left"), ("left", "right")):
        for name in ("foot", "shank", "forearm"):
            path = parts[f"{side} {name}"].trajectory
            ahead = path.position(TIMES + CYCLE) - path.position(TIMES) - [0.0, SPEED * CYCLE, 0.0]
            assert np.abs(ahead).max() < 1e-4
            later = parts[f"{other} {name}"].trajectory.position(TIMES + 0.5 * CYCLE) - path.position(TIMES)
            assert np.abs(later[:, 1:] - [0.5 * SPEED * CYCLE, 0.0]).max() < 1e-4
    chest = parts["chest"].trajectory
    moved = chest.position(3 * CYCLE) - chest.position(0.0)
    np.testing.assert_allclose(moved, [0.0, 3 * SPEED * CYCLE, 0.0], atol=1e-4)
    speed = parts["pelvis"].trajectory.velocity(TIMES)[:, 1]
    # The pelvis goes to and fro by 0.021 leg lengths, twice in a cycle.
    assert np.abs(speed - SPEED).max() == pytest.approx(0.021 * LEG * 4.0 * np.pi / CYCLE, rel=0.02)


def test_joints_flex_as_published(parts: dict[str, Any]) -> None:
    fast = (SPEED / LEG - 1.3) / 1.7
    thigh = pitch(parts["right thigh"])
    assert thigh.max() == pytest.approx(25.0 + 6.0 * fast, abs=0.3)
    assert thigh.min() == pytest.approx(-15.0, abs=0.1)
    knee = thigh - pitch(parts["right shank"])
    assert knee.max() == pytest.approx(70.0 - 5.0 * fast, abs=0.1)
    assert knee.min() == pytest.approx(3.0, abs=0.1)
    arm = pitch(parts["left upper arm"])
    assert np.ptp(arm) == pytest.approx(2.0 * 9.88 * SPEED / LEG, abs=0.1)
    assert np.corrcoef(arm, thigh)[0, 1] > 0.8  # an arm swings with the leg of the other side
    slow = gait_at(np.linspace(0.0, 1.0, 1001), np.full(1001, 0.3))
    assert np.degrees(slow.hip.max()) == pytest.approx(15.0, abs=0.01)
    assert np.degrees(slow.knee.max()) == pytest.approx(42.0, abs=0.01)


def test_limbs_hang_together_and_soles_are_on_the_ground(parts: dict[str, Any]) -> None:
    def end(name: str, share: float) -> np.ndarray:
        part = parts[name]
        along = rotate(part.trajectory.orientation(TIMES), np.array([0.0, 0.0, share]))
        return part.trajectory.position(TIMES) + along * part.shape.semi_axes[2]

    for upper, lower in (("right thigh", "right shank"), ("left upper arm", "left forearm")):
        assert np.abs(end(upper, -1.0) - end(lower, 1.0)).max() < 1e-4
    lowest = []
    for side in ("right", "left"):
        foot = parts[f"{side} foot"]
        tip = 0.5 * 0.152 * TALL
        for x in (-tip, tip):
            offset = rotate(foot.trajectory.orientation(TIMES), np.array([x, 0.0, -0.02 * TALL]))
            lowest.append((foot.trajectory.position(TIMES) + offset)[:, 2])
    assert np.abs(np.min(lowest, axis=0) - 0.2).max() < 0.02
    assert np.ptp(parts["head"].trajectory.position(TIMES)[:, 2]) < 0.06
    top = parts["head"].trajectory.position(TIMES)[:, 2] + parts["head"].shape.semi_axes[2] - 0.2
    assert top.mean() == pytest.approx(TALL, abs=0.05)
    assert np.all(parts["left thigh"].trajectory.position(TIMES)[:, 0] < 1.0)  # left of one who walks along y


def test_walkers_look_where_they_go() -> None:
    around = clsim.Trajectory.circle((0.0, 0.0, 0.0), 2.0, 10.0, 10.0)
    head = clsim.walking_person("Ada", TALL, around)[0].trajectory
    for t in (1.0, 4.0, 9.0):
        ahead = rotate(head.orientation(t), np.array([1.0, 0.0, 0.0]))
        way = around.velocity(t) / np.linalg.norm(around.velocity(t))
        assert float(ahead @ way) > 0.98


@pytest.mark.parametrize(
    ("trajectory", "message"),
    [
        (clsim.Trajectory.fixed((1.0, 1.0, 0.0)), "must move"),
        (clsim.Trajectory.line((0, 0, 0), (9, 0, 0), 3.0), r"at 0.0927 to 2.78 m/s, but is at 3 m/s at 0 s"),
        (clsim.Trajectory.sampled(lambda t: np.stack([np.sin(t), 0 * t, 0 * t], axis=1), 2.0, 100.0), r"m/s at 1\.4"),
        ((1, 2), "must be a Trajectory"),
    ],
)
def test_no_gait_is_known(trajectory: Any, message: str) -> None:
    with pytest.raises(clsim.InputError, match=message):
        clsim.walking_person("Ada", TALL, trajectory)
