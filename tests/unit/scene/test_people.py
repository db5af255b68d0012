"""People: walkers, hands and captured motions as scatterers."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import clsim
from clsim.numerics.quaternions import rotate
from clsim.scene.captured import read_joints
from clsim.scene.people import gait_at

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


BVH = """HIERARCHY
ROOT Hips
{
  OFFSET 1.0 90.0 2.0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
  JOINT LeftUpLeg
  {
    OFFSET 10.0 -5.0 0.0
    CHANNELS 3 Zrotation Xrotation Yrotation
    JOINT LeftLeg {
      OFFSET 0.0 -40.0 0.0
      CHANNELS 3 Yrotation Xrotation Zrotation
      End Site
      {
        OFFSET 0.0 -42.0 0.0
      }
    }
  }
}
MOTION
Frames: 5
Frame Time: 0.01
"""


def matrix(axis: int, degrees: float) -> np.ndarray:
    """Return the matrix that turns about an axis, written out."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    found, (i, j) = np.eye(3), ((1, 2), (2, 0), (0, 1))[axis]
    found[[i, i, j, j], [i, j, i, j]] = c, -s, s, c
    return found


def test_joints_of_bvh_are_turned_in_the_order_of_their_channels(tmp_path: Path, rng: np.random.Generator) -> None:
    rows = rng.uniform(-80.0, 80.0, (5, 12))
    path = tmp_path / "walk.bvh"
    path.write_text(BVH + "\n".join(" ".join(f"{x:.9f}" for x in row) for row in rows), "utf-8")
    found = read_joints(path)
    assert found.names == ("Hips", "LeftUpLeg", "LeftLeg", "LeftLeg end")
    assert found.times.tolist() == [0.0, 0.01, 0.02, 0.03, 0.04]
    for t, row in enumerate(np.round(rows, 9)):
        hips = matrix(2, row[3]) @ matrix(0, row[4]) @ matrix(1, row[5])
        thigh = hips @ matrix(2, row[6]) @ matrix(0, row[7]) @ matrix(1, row[8])
        shank = thigh @ matrix(1, row[9]) @ matrix(0, row[10]) @ matrix(2, row[11])
        wanted = [row[:3]]
        for turn, offset in ((hips, [10.0, -5.0, 0.0]), (thigh, [0.0, -40.0, 0.0]), (shank, [0.0, -42.0, 0.0])):
            wanted.append(wanted[-1] + turn @ offset)
        np.testing.assert_allclose(found.positions[:, t], wanted, atol=1e-10)
    legs = [("Hips", "LeftUpLeg", 0.05), ("LeftLeg", "LeftLeg end", 0.03)]
    parts = clsim.captured_person("Ada", path, segments=legs, scale=0.01, translate=(2.0, 3.0, 1.0), shape="capsule")
    assert [part.name for part in parts] == ["Ada Hips to LeftUpLeg", "Ada LeftLeg to LeftLeg end"]
    middle = 0.005 * (found.positions[2] + found.positions[3])[:, [2, 0, 1]] + [2.0, 3.0, 1.0]  # y goes up
    np.testing.assert_allclose(parts[1].trajectory.position(found.times), middle, atol=1e-3)
    assert (parts[1].shape.length, parts[1].shape.cylinder_radius) == pytest.approx((0.42, 0.03), abs=0.01)


def captured_ends(part: Any, times: np.ndarray) -> list[np.ndarray]:
    """Return the positions of both ends of a limb of a walking person (n, 3), the upper one first."""
    along = part.shape.semi_axes[2] * rotate(part.trajectory.orientation(times), np.array([0.0, 0.0, 1.0]))
    middle = part.trajectory.position(times)
    return [middle + along, middle - along]


def test_a_walk_that_is_captured_is_the_walk(tmp_path: Path) -> None:
    """Joints of `walking_person`, written at 100 Hz with usual names, give its parts back within 2 mm."""
    way = clsim.Trajectory.line((1.0, 2.0, 0.0), (3.6, 2.5, 0.0), 2.0)
    walk = {part.name.removeprefix("Ada "): part for part in clsim.walking_person("Ada", 1.8, way)}
    times = np.linspace(0.0, 2.0, 201)
    columns: dict[str, np.ndarray] = {}
    for side in ("left", "right"):
        for part, names in (
            ("thigh", ("hip", "knee")),
            ("shank", ("", "ankle")),
            ("upper arm", ("shoulder", "elbow")),
            ("forearm", ("", "wrist")),
        ):
            for joint, place in zip(names, captured_ends(walk[f"{side} {part}"], times), strict=True):
                columns |= {f"{side} {joint}": place} if joint else {}
    columns["hips"] = 0.5 * (columns["left hip"] + columns["right hip"])
    columns["neck"] = 0.5 * (columns["left shoulder"] + columns["right shoulder"])
    header = ",".join(["time", *(f"{name}_{axis}" for name in columns for axis in "xyz")])
    rows = np.column_stack([times + 5.0, *columns.values()])
    path = tmp_path / "walk.csv"
    np.savetxt(path, rows, delimiter=",", header=header, comments="", fmt="%.9f")
    parts = {part.name.removeprefix("Ada "): part for part in clsim.captured_person("Ada", path)}
    assert set(parts) == set(walk) - {"head", "left foot", "right foot"}
    at = np.linspace(0.02, 1.98, 57)
    for name, part in parts.items():
        if name in ("chest", "pelvis"):
            np.testing.assert_allclose(part.shape.semi_axes, walk[name].shape.semi_axes, rtol=1e-6)
            turned = [rotate(p.trajectory.orientation(at), np.array([0.0, 1.0, 0.0])) for p in (part, walk[name])]
            assert np.sum(turned[0] * turned[1], axis=1).min() > 0.98
            continue
        apart = part.trajectory.position(at) - walk[name].trajectory.position(at)
        assert np.linalg.norm(apart, axis=1).max() < 2e-3, name
        np.testing.assert_allclose(part.shape.semi_axes, walk[name].shape.semi_axes, rtol=1e-3)
        along = [rotate(p.trajectory.orientation(at), np.array([0.0, 0.0, 1.0])) for p in (part, walk[name])]
        assert np.abs(np.sum(along[0] * along[1], axis=1)).min() > 1.0 - 1e-4
        assert part.trajectory.peak_turn < 1.05 * max(walk[name].trajectory.peak_turn, 1.0)


def test_who_stands_starts_and_turns_is_heard(tmp_path: Path) -> None:
    """A shank that stands, then sets off: no Doppler shift first, and that of its speed later."""
    times = np.linspace(0.0, 1.0, 101)
    ahead = np.where(times > 0.5, 4.0 * (times - 0.5) ** 3, 0.0)
    knee = np.column_stack([3.0 - ahead, 2.0 + 0.0 * times, 1.0 + 0.0 * times])
    rows = np.column_stack([times, knee, knee - [0.0, 0.0, 0.4]])
    path = tmp_path / "start.csv"
    np.savetxt(path, rows, delimiter=",", header="t,knee x,knee y,knee z,ankle x,ankle y,ankle z", comments="")
    shank = clsim.captured_person("Ada", path, segments=[("knee", "ankle", 0.05)])
    at = [clsim.Trajectory.fixed((1.0, y, 0.8)) for y in (1.9, 2.1)]
    tone = clsim.Signal.tone(40e3, 0.9, 192e3)
    room = clsim.Shoebox((5.0, 4.0, 3.0), clsim.Material.from_reflection(0.5))
    ends = [clsim.Source("s", tone, at[0])], [clsim.Receiver("r", at[1])]
    truth = clsim.scatterer_truth(clsim.Scene(room, clsim.Air(), *ends, scatterers=shank), [0.3, 0.9])
    still, moving = truth.radial_speed.ravel()
    assert still == pytest.approx(0.0, abs=1e-6)
    event = 0.9 - float(truth.range.ravel()[1]) / 343.0
    assert moving == pytest.approx(-12.0 * (event - 0.5) ** 2, rel=5e-3)


@pytest.mark.parametrize(
    ("text", "given", "message"),
    [
        (BVH.replace("Frames: 5", "Frames: 4") + "0 " * 12, {}, "a.txt, line 21: must be the number of frames that follow, 1,"),
        (BVH + "0 0 0", {}, r"a.txt, line 23: must hold 12 numbers, but is '0 0 0'"),
        (BVH.replace("CHANNELS 3 Y", "CHANNELS 2 Y"), {}, "line 12: must be CHANNELS, their number and their names"),
        (BVH.replace("Frame Time: 0.01", "Frame Time: 0"), {}, "must be Frames: N and Frame Time"),
        (BVH.partition("MOTION")[0], {}, "must come after MOTION, but there is none"),
        (BVH.replace("OFFSET 10.0 -5.0 0.0", "OFFSET 10.0"), {}, "line 8: must hold 3 numbers, but is '10.0'"),
        ("t,a x,a y\n0,1,2\n", {}, "line 1: must name t and NAME x, NAME y, NAME z of every joint, but 'a' lacks one"),
        ("t,a x,a y,a z\n0,1,2,3\n1,2,3,x\n", {}, "line 3: must hold 4 numbers"),
        ("t,a x,a y,a z\n0,1,2,3\n", {}, "line 2: must be the last of 4 rows at least, not of 1"),
        ("t,a x,a y,a z\n" + "0,1,2,3\n" * 4, {}, "column t: times: must increase strictly"),
        ("t,a x,a y,a z\n0,1,2,3\n1,1,2,3\n2,1,2,inf\n3,1,2,3\n", {}, "frame 3: 'a' must be at a finite place"),
        ("TABLE", {}, "must have a joint for the left hip, or segments given; its joints are a, b"),
        ("TABLE", {"segments": [("a", "c", 0.1)]}, r"segments\[0\]: must name joints of the file \(a, b\), but names 'c'"),
        ("TABLE", {"segments": [("a", "b", 0.0)]}, r"segments\[0\].radius: must be above 0 m"),
        ("TABLE", {"segments": [("a", "a", 0.1)]}, "must have a length"), ("TABLE", {"segments": []}, "segments: must be a list"),
        ("TABLE", {"shape": "box"}, "shape: must be one of"), ("TABLE", {"up": "w"}, "up: must be one of"),
        ("TABLE", {"time_offset": 1.0}, "time_offset: must be at most 0 s"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_told_with_its_line(tmp_path: Path, text: str, given: dict[str, Any], message: str) -> None:
    table = "t,a x,a y,a z,b x,b y,b z\n" + "\n".join(f"{t},1,2,1,1,2,1.{5 + t}" for t in range(4))
    (tmp_path / "a.txt").write_text(table if text == "TABLE" else text, "utf-8")
    with pytest.raises(clsim.InputError, match=message):
        clsim.captured_person("Ada", tmp_path / "a.txt", **given)
    with pytest.raises(clsim.InputError, match="path: cannot read"):
        clsim.captured_person("Ada", tmp_path / "none.bvh")


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
