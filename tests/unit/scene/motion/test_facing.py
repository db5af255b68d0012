"""Aims that follow from the motion, aims at a point, and what is asked about missing ones."""

import warnings

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.special import j1

import clsim
from clsim import Receiver, Source, Trajectory

TONE = clsim.Signal.tone(40e3, 0.02, 192e3, fade=0.005)
ROOM = clsim.Shoebox((8.0, 6.0, 3.0), clsim.Material.from_reflection(0.0))
C = 340.0
HELD = 1e-4  # rad, as the docstring of Source says
BEAM = clsim.Piston(0.01)


def axes(end: Source | Receiver, times: np.ndarray) -> np.ndarray:
    """Return x, y and z of an end at times, (3, T, 3), by another implementation of quaternions."""
    turned = Rotation.from_quat(end.orientation(times))
    return np.array([turned.apply(axis) for axis in np.eye(3)])


def angles(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    second = second / np.linalg.norm(second, axis=-1, keepdims=True)
    return np.linalg.norm(np.cross(first, second), axis=-1) + np.pi * (np.sum(first * second, axis=-1) < 0.0)


def scene(source: Source, *receivers: Receiver) -> clsim.Scene:
    air = clsim.Air(speed_of_sound=C, absorption=False)
    return clsim.Scene(ROOM, air, [source], list(receivers) or [Receiver("r", Trajectory.fixed((6.0, 2.0, 1.0)))])


def test_forward_is_the_tangent_of_a_circle() -> None:
    tilted = Rotation.from_rotvec([0.4, 0.0, 0.0])
    lap = Trajectory.circle((4, 3, 1.5), 1.0, 0.4, 1.0, axis=tilted.apply([0, 0, 1]), phase=0.5)
    end, t = Source("s", TONE, lap, aim="forward"), np.linspace(0.0, 1.0, 997)
    step = 1e-6
    x, y, _ = axes(end, t)
    assert angles(x, lap.position(t + step) - lap.position(t - step)).max() < HELD
    assert np.abs(y[:, 2]).max() < 0.01  # no roll, but for that of great arcs from one orientation to the next
    assert end.aim is None
    np.testing.assert_array_equal(end.trajectory.position(t), lap.position(t))


def test_forward_turns_evenly_where_the_motion_rests() -> None:
    rest = Trajectory.waypoints([0, 1, 2, 3], [(1, 1, 1), (2, 1, 1), (2, 1, 1), (2, 2, 1)], smooth=False)
    x = axes(Source("s", TONE, rest, aim="forward"), np.linspace(1.0, 2.0, 11))[0]
    np.testing.assert_allclose(np.degrees(np.arctan2(x[:, 1], x[:, 0])), np.linspace(0.0, 90.0, 11), atol=0.1)


def test_aim_at_follows_the_point_and_stays_level() -> None:
    point, t = np.array([5.0, 3.0, 2.5]), np.linspace(0.0, 2.0, 1999)
    pass_by = Trajectory.line((2.0, 2.7, 1.0), (7.0, 2.7, 1.2), 2.0)
    for end in (Source("s", TONE, pass_by, aim_at=point), Receiver("r", pass_by, aim_at=tuple(point))):
        x, y, _ = axes(end, t)
        assert angles(x, point - pass_by.position(t)).max() < HELD
        assert np.abs(y[:, 2]).max() < HELD
    still = Receiver("r", Trajectory.fixed((5.0, 3.0, 0.5)), aim_at=point)
    np.testing.assert_allclose(axes(still, np.zeros(1))[0], [[0.0, 0.0, 1.0]], atol=1e-15)
    np.testing.assert_allclose(axes(still, np.zeros(1))[1], [[0.0, 1.0, 0.0]], atol=1e-15)


@pytest.mark.parametrize(
    ("motion", "aims", "message"),
    [
        (Trajectory.fixed((1, 1, 1)), {"aim": "forward"}, "aim: must be a direction, or aim_at given, where nothing moves"),
        (
            Trajectory.waypoints([0, 1, 2], [(1, 1, 1), (2, 1, 1), (2, 2, 1)], smooth=False),
            {"aim": "forward"},
            r'aim: must not be "forward" where the direction of motion jumps, but it turns by 90 degrees at 1\.000 s',
        ),
        (
            Trajectory.waypoints([0, 1, 2], [(1, 1, 1), (2, 1, 1), (1, 1, 1)]),
            {"aim": "forward"},
            r"turns by 180 degrees at (0\.9|1\.0)",
        ),
        (Trajectory.fixed((1, 1, 1)), {"aim": "foreward"}, 'aim: must be one of "forward", .*did you mean "forward"'),
        (Trajectory.fixed((1, 1, 1)), {"aim": (1, 0, 0), "aim_at": (2, 2, 2)}, "aim_at: must be left out where aim is"),
        (Trajectory.fixed((1, 1, 1), (0, 0, 0, 1)), {"aim_at": (2, 2, 2)}, "aim_at: must be left out, because the traj"),
        (Trajectory.fixed((1, 1, 1), (0, 0, 0, 1)), {"aim": "forward"}, "aim: must be left out, because the trajectory"),
        (
            Trajectory.line((1, 1, 1), (3, 1, 1), 1.0),
            {"aim_at": (2, 1, 1)},
            r"aim_at: must be 0\.001 m away at least, but is where it aims from at 0\.5 s",
        ),
        (Trajectory.fixed((1, 1, 1)), {"aim_at": (1, 2)}, "aim_at: must have the shape 3, but has 2"),
    ],
)  # fmt: skip
def test_what_no_direction_follows_from_is_refused(motion: Trajectory, aims: dict, message: str) -> None:
    with pytest.raises(clsim.InputError, match=message):
        Source("s", TONE, motion, BEAM, **aims)


@pytest.mark.parametrize("engine", ["opencl", "reference"])
def test_beams_are_heard_by_where_they_point(engine: str, request: pytest.FixtureRequest) -> None:
    """A piston that points at the receiver is as loud as a point; one that points ahead is what its formula says."""
    heard_at, way = np.array([6.0, 2.0, 1.0]), Trajectory.line((3.0, 3.0, 1.0), (3.5, 3.0, 1.0), 0.05)
    receiver = Receiver("r", Trajectory.fixed(heard_at))
    times = np.array([0.01, 0.02])
    gain, sound = {}, {}
    for name, aims in {"omni": {}, "at": {"aim_at": heard_at}, "forward": {"aim": "forward"}}.items():
        beam = clsim.Omni() if name == "omni" else BEAM
        paths = clsim.find_paths(scene(Source("s", TONE, way, beam, **aims), receiver), 0)
        gain[name] = paths.table(times).gain[0].real
        sound[name] = clsim.render(paths, 192e3, engine=engine, duration=0.03).pressure[0].astype(float)
    level = np.abs(sound["omni"]).max()
    # The piston's gain falls by (ka θ)² / 8 at 1e-4 rad, 1e-8; sounds are within -86 dB of what is heard.
    np.testing.assert_allclose(gain["at"], gain["omni"], rtol=1e-6)
    assert np.abs(sound["at"] - sound["omni"]).max() < 1e-4 * level
    delay = clsim.direct_path(paths, times).delay[0, 0]
    away = heard_at - way.position(times - delay)
    ka = 2.0 * np.pi * 40e3 / C * 0.01 * np.linalg.norm(away[:, 1:], axis=1) / np.linalg.norm(away, axis=1)
    np.testing.assert_allclose(gain["forward"] / gain["omni"], 2.0 * j1(ka) / ka, rtol=1e-3)


def test_who_moves_and_is_directional_is_asked_where_it_faces_once() -> None:
    walk, there = Trajectory.line((2, 2, 1), (3, 2, 1), 1.0), Trajectory.fixed((6.0, 2.0, 1.0))
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        sources = [Source("a", TONE, walk, BEAM), Source("b", TONE, walk, BEAM)]
        clsim.Scene(ROOM, clsim.Air(), sources, [Receiver("r", there)])
    assert [str(w.message).partition(" moves")[0] for w in found] == ["sources[0]: 'a'"]
    assert "faces +x all the time" in str(found[0].message)
    with pytest.warns(clsim.ClsimWarning, match=r"^receivers\[0\]: 'r' moves and is directional, but faces"):
        scene(Source("s", TONE, Trajectory.fixed((4, 4, 1))), Receiver("r", walk, BEAM))
    turned = Trajectory.waypoints([0, 1], [(2, 2, 1), (3, 2, 1)], [[0, 0, 0, 1]] * 2)
    for quiet in (
        Source("s", TONE, walk), Source("s", TONE, walk, BEAM, aim=(1, 0, 0)), Source("s", TONE, walk, BEAM, aim="forward"),
        Source("s", TONE, turned, BEAM), Source("s", TONE, there, BEAM),
    ):  # fmt: skip
        scene(quiet, Receiver("r", Trajectory.fixed((5.0, 4.0, 1.0))))  # warnings are errors


def test_a_point_is_aimed_at_in_the_coordinates_of_a_body() -> None:
    wood, quarter = clsim.Material.from_reflection(0.5), np.sqrt(0.5)
    turned = Trajectory.waypoints([0, 1], [(3, 2, 1), (4, 2, 1)], [[0, 0, quarter, quarter]] * 2)
    cart = clsim.Body.box("cart", (0.2, 0.2, 0.2), wood, turned)
    sonar = Source("s", TONE, Trajectory.fixed((0.3, 0.0, 0.0)), BEAM, mounted_on="cart", aim_at=(1.3, 1.0, 0.0))
    ears = [Receiver("r", Trajectory.fixed((6.0, 4.0, 1.0)))]
    end = clsim.Scene(ROOM, clsim.Air(), [sonar], ears, bodies=[cart]).sources[0]
    np.testing.assert_allclose(axes(end, np.array([0.5]))[0], [[-quarter, quarter, 0.0]], atol=1e-12)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda a: Trajectory.circle((4, 3, 1.5), 1.0, 1.0, 2.0, phase=a), "^phase: 90 rad are 14.3 turns; .* 1.5708 rad$"),
        (lambda a: Trajectory.swing((2, 0, 0), (0, 0, 1), [0, a], [0, 2]), "^angles: 90 rad are 14.3 turns; angles are in"),
    ],
)  # fmt: skip
def test_angles_that_look_like_degrees_are_questioned(make, message: str) -> None:
    with pytest.warns(clsim.ClsimWarning, match=message):
        make(90)
    make(-4.0 * np.pi)  # two turns; warnings are errors
