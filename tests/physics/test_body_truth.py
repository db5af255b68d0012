"""What is told of bodies beyond line of sight: nearest points in closed form and by brute force, seen or hidden."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import clsim
from clsim.output.result_files import write_ground_truth

C = 343.0
WOOD = clsim.Material.from_reflection(0.9)
FIXED, LINE = clsim.Trajectory.fixed, clsim.Trajectory.line
TONE = clsim.Signal.tone(40e3, 0.05, 192e3)
EAR = np.array([1.0, 2.0, 1.2])


def scene_of(*bodies: clsim.Body, apart: float = 0.011, **air: Any) -> clsim.Scene:
    """Return bodies before a sonar whose source and receiver are beside each other."""
    up = np.array([0.0, 0.0, apart])
    ends = [clsim.Source("s", TONE, FIXED(EAR + up))], [clsim.Receiver("r", FIXED(EAR - up))]
    return clsim.Scene(clsim.Shoebox((8.0, 4.0, 2.5), WOOD), clsim.Air(speed_of_sound=C, **air), *ends, bodies=bodies)


def test_a_wall_that_comes_nearer_is_a_mirror() -> None:
    """On its face: delay and Doppler factor of a moving mirror; the bearing is its normal."""
    speed, time = 2.0, 0.1
    plate = clsim.Body.box("plate", (0.0, 1.0, 1.0), WOOD, LINE((4.0, 2.0, 1.2), (3.4, 2.0, 1.2), 0.3))
    truth = clsim.body_truth(scene_of(plate, apart=0.006), [time])
    mach, high = speed / C, 0.006
    # The sound meets x = 4 - v t at t_c; both legs are as long but for what is aside.
    leg = (4.0 - speed * time - 1.0) / (1.0 - mach)
    leg += high**2 / (2.0 * leg)
    assert truth.range[0, 0, 0, 0] == pytest.approx(leg, abs=1e-6)
    assert truth.doppler_factor[0, 0, 0, 0] == pytest.approx((1.0 + mach) / (1.0 - mach), abs=1e-7)
    assert truth.radial_speed[0, 0, 0, 0] == pytest.approx(-speed / (1.0 - mach), rel=1e-5)
    assert truth.bearing[0, 0, 0, 0] == pytest.approx([1.0, 0.0, 0.0], abs=3e-3)
    assert truth.visible.all()
    quasi = clsim.body_truth(scene_of(plate, apart=0.006), [time], "quasi-static")
    assert quasi.radial_speed[0, 0, 0, 0] == pytest.approx(-speed, rel=1e-5)


def test_edges_and_corners_are_nearest_where_no_face_is() -> None:
    """A door's free edge goes in a circle; a crate's corner is where it is."""
    turn, radius = 1.2, 0.9
    hinge = clsim.Trajectory.swing((3.0, 2.0, 1.2), (0, 0, 1), [np.pi, np.pi + 0.3 * turn], [0.0, 0.3])
    door = clsim.Body.box("door", (radius, 0.0, 1.0), WOOD, hinge, centre=(0.5 * radius, 0.0, 0.0))
    crate = clsim.Body.box("crate", (0.4, 0.4, 0.4), WOOD, FIXED((3.2, 3.2, 2.0)))
    times = np.array([0.12, 0.2])
    truth = clsim.body_truth(scene_of(door, crate, apart=0.006), times)
    for i, time in enumerate(times):
        met = time
        for _ in range(20):
            angle = np.pi + turn * met
            edge = np.array([3.0 + radius * np.cos(angle), 2.0 + radius * np.sin(angle), 1.2])
            away = np.hypot(np.linalg.norm(edge - EAR), 0.006)
            met = time - away / C
        assert truth.range[0, 0, 0, i] == pytest.approx(away, abs=1e-7)  # both legs meet 20 um off the middle
        velocity = radius * turn * np.array([-np.sin(angle), np.cos(angle), 0.0])
        mach = velocity @ (edge - EAR) / away / C
        assert truth.doppler_factor[0, 0, 0, i] == pytest.approx((1.0 - mach) / (1.0 + mach), abs=1e-8)
    corner = np.array([3.0, 3.0, 1.806]) - EAR
    exact = np.linalg.norm(corner)
    assert truth.range[1, 0, 0] == pytest.approx([exact, exact], abs=1e-12)
    assert truth.radial_speed[1] == pytest.approx(0.0, abs=1e-12)
    assert truth.bearing[1, 0, 0, 0] == pytest.approx(corner / exact, abs=1e-12)


def test_no_point_is_sooner() -> None:
    """A crate that slides and turns, apart from source and receiver: over a grid of its surface, none is."""
    t = np.linspace(0.0, 0.3, 7)
    turn = np.stack([0.3 * np.sin(t), 0 * t, np.sin(t), np.sqrt(1 - np.sin(t) ** 2 * 1.09)], axis=1)
    way = np.stack([3.5 - t, 2.0 + 0.3 * t, 1.2 + 0.1 * t], axis=1)
    crate = clsim.Body.box("crate", (0.5, 0.7, 0.3), WOOD, clsim.Trajectory.waypoints(t, way, turn))
    scene = clsim.Scene(
        clsim.Shoebox((8.0, 4.0, 2.5), WOOD), clsim.Air(speed_of_sound=C),
        [clsim.Source("s", TONE, LINE((1.0, 0.6, 1.0), (1.2, 0.6, 1.0), 0.3))],
        [clsim.Receiver("r", FIXED((2.0, 3.3, 1.4)))], bodies=[crate],
    )  # fmt: skip
    time = 0.2
    truth = clsim.body_truth(scene, [time])
    corners = crate.mesh.vertices[crate.mesh.triangles]
    grid = np.linspace(0.0, 1.0, 81)
    u, v = (x.ravel() for x in np.meshgrid(grid, grid))
    share = np.stack([1 - u - v, u, v], axis=1)[u + v <= 1.0 + 1e-12]
    own = np.einsum("pk,fkj->fpj", share, corners).reshape(-1, 3)
    late, early = np.full(len(own), 0.005), np.full(len(own), 0.005)
    for _ in range(30):
        place = crate.placed(own, time - late)
        late = np.linalg.norm(place - scene.receivers[0].trajectory.position(time), axis=1) / C
    for _ in range(30):
        left = time - late - early
        early = np.linalg.norm(place - scene.sources[0].trajectory.position(left), axis=1) / C
    soonest = float((late + early).min())
    found = float(truth.delay[0, 0, 0, 0])
    assert found <= soonest + 1e-15
    assert C * (soonest - found) < 1e-4  # a grid of 5 mm, whose ways are the shortest by the square of that


def test_what_is_hidden_is_told(tmp_path: Path) -> None:
    """A screen slides in between: hidden from when sound meets its edge; files hold it."""
    crate = clsim.Body.box("crate", (0.4, 0.4, 0.4), WOOD, FIXED((4.2, 2.0, 1.2)))
    screen = clsim.Body.box("screen", (0.0, 1.0, 1.0), WOOD, LINE((2.5, 1.0, 1.2), (2.5, 2.0, 1.2), 0.2))
    scene, times = scene_of(crate, screen), np.arange(0.05, 0.19, 0.001)
    truth = clsim.body_truth(scene, times)
    # Its upper edge is at y = 1.5 m + 5 m/s t; what comes back passes it 1.5 m before it is received.
    assert times[~truth.visible[0, 0, 0]][0] == pytest.approx(0.1 + 1.5 / C, abs=1.1e-3)
    assert truth.visible[1].all()
    assert truth.range[0, 0, 0] == pytest.approx(np.hypot(3.0, 0.011))
    direct = clsim.direct_path(clsim.find_paths(scene, 0), times)
    write_ground_truth(direct, tmp_path / "ground_truth.npz", [truth])
    with np.load(tmp_path / "ground_truth.npz") as found:
        assert found["body_names"].tolist() == ["crate", "screen"]
        np.testing.assert_array_equal(found["body_visible"], truth.visible)
        np.testing.assert_array_equal(found["body_radial_speed"], truth.radial_speed)
    with pytest.raises(clsim.InputError, match="scene: must hold bodies, but has none"):
        clsim.body_truth(scene_of(), times)
